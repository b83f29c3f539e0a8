"""`cell view`: page of a scene, a run, an execution, an exploration or a study; never written into a run."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cell import scanners
from cell.errors import CellError, UsageError
from cell.files import atomic_write, file_errors
from cell.runs.run import Execution, execution_of, open_run, read_execution
from cell.runs.schema import EXPLORE_FILE, ScannerKeys
from cell.scene.file import load_scene
from cell.scene.model import Scene
from cell.session import ProgressReporter
from cell.view.explore_page import explore_page
from cell.view.page import PageContents, PageScene, PageSurface, render_page, thin_mesh
from cell.view.pieces import cell_of_world
from cell.view.run_pages import PAGE_FILE, execution_page, run_page
from cell.view.study_page import study_page
from cell.world.checks import check_cell, settle_and_compile

_POLL_INTERVAL_S = 0.3
_OUTDATED_NOTE = "the page shows the last valid scene"


def make_page(source: Path | None, out: Path | None, reporter: ProgressReporter) -> Path:
    """Return the page in a folder, or make the page of a scene file or folder.

    Args:
        source: scene file, or folder of a run, an execution, an exploration or a study; None for the built-in scene.
        out: file to write; None writes a temporary file.
        reporter: shows the progress.

    Raises:
        CellError: if a file cannot be read or written.
    """
    if source is not None and source.is_dir() and out is None and (source / PAGE_FILE).is_file():
        return source / PAGE_FILE
    with reporter.stage("draw the page"):
        if source is not None and (source / "study.json").is_file():
            text = study_page(source)
        elif source is not None and (source / EXPLORE_FILE).is_file():
            text = explore_page(source)
        elif source is None or not source.is_dir():
            text = render_page(*scene_page(load_scene(source)))
        elif (execution := execution_of(source)) is not None:
            run = open_run(execution[0])
            text = execution_page(run, read_execution(run, execution[1]), Execution.open(source))
        else:
            text = run_page(open_run(source))
        return write_page(text, out)


def scene_page(scene: Scene, watch_stamp: str = "") -> tuple[PageScene, PageContents]:
    """Return the page of a scene: the cell with the arm at home, and the results of `cell check`.

    Args:
        scene: validated.
        watch_stamp: version of a page that is updated repeatedly.

    Raises:
        CellError: if the cell does not compile.
    """
    settled, world = settle_and_compile(scene)
    result = check_cell(settled, world)
    keys = ScannerKeys(**scanners.describe(scene.scanner.type, settled.scanner))
    cell = cell_of_world(world, keys)
    part = PageSurface("part", thin_mesh(settled.part.reference))
    page = PageScene(f"Cell with {settled.part.name}", cell, [part], watch_stamp=watch_stamp)
    return page, PageContents(rows=result.rows(), problems=result.problems)


def write_page(text: str, out: Path | None) -> Path:
    """Write a page to a file, or to a temporary folder for None.

    Raises:
        UsageError: if the file would be in the folder of a run.
        FileError: if it cannot be written.
    """
    path = Path(tempfile.mkdtemp(prefix="cell-view-")) / PAGE_FILE if out is None else out
    if (path.parent / "manifest.json").is_file():
        raise UsageError(f"--out {path} is in the folder of a run, and runs are never changed; choose another folder")
    # A browser never reads half a page.
    with file_errors(f"{path} cannot be written"), atomic_write(path) as beside:
        beside.write_text(text, encoding="utf-8")
    return path


def watch(
    file: Path,
    out: Path | None,
    reporter: ProgressReporter,
    on_first_page: Callable[[Path], None],
    wait: Callable[[float], None],
) -> None:
    """Update the page of a scene file whenever the file is saved, until the wait is interrupted.

    The page shows an error of the scene beside the last valid cell.

    Args:
        file: the scene file.
        out: file to write; None writes a temporary file.
        reporter: shows errors of the scene.
        on_first_page: is called with the first page.
        wait: sleeps for a number of seconds.

    Raises:
        CellError: if the scene is invalid when it is read for the first time.
    """
    path, before, scene = out, "", None
    while True:
        stamp = _file_stamp(file)
        if stamp != before:
            try:
                scene, contents = scene_page(load_scene(file), stamp)
            except CellError as error:
                if scene is None:
                    raise
                reporter.note(str(error))
                scene = replace(scene, watch_stamp=stamp)
                contents = PageContents(problems=[str(error)], notes=[_OUTDATED_NOTE])
            first, path = path is None or not before, write_page(render_page(scene, contents), path)
            path.with_name(path.name + ".stamp.js").write_text(f"reloadIfNew({stamp!r});\n", encoding="utf-8")
            if first:
                on_first_page(path)
            before = stamp
        wait(_POLL_INTERVAL_S)


def _file_stamp(file: Path) -> str:
    """Return time and size of a file; "none" while an editor replaces it."""
    try:
        status = file.stat()
    except OSError:
        return "none"
    return f"{status.st_mtime_ns}-{status.st_size}"
