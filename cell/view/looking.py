"""`cell view`: the page of a scene, a run, an execution, an exploration or a study; never written into a run."""

from __future__ import annotations

import os
import sys
import tempfile
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cell import scanners
from cell.errors import CellError, FileError, UsageError
from cell.files import atomic_write
from cell.runs.run import EXECUTIONS, Execution, open_run, read_execution
from cell.runs.schema import EXPLORE_FILE as EXPLORATION
from cell.runs.schema import ScannerKeys
from cell.scene.file import load_scene
from cell.scene.model import Scene
from cell.session import ProgressReporter
from cell.view.contents import NAME, execution_page, run_page
from cell.view.explore_page import explore_page
from cell.view.page import Play, Shown, Stage, html_of, thinned
from cell.view.pieces import cell_of_world
from cell.view.study_page import study_page
from cell.world.checks import check_cell, settle_and_compile

_LOOK_S = 0.3  # between two looks at a file that is watched
_WITHOUT_PART = "the page shows the last scene that could be read"


def page_of(what: Path | None, out: Path | None, reporter: ProgressReporter) -> Path:
    """The page of a scene file, run, execution, exploration or study: the one in its folder, else one that is made.

    Args:
        what: scene file, or folder of a run, an execution, an exploration or a study; None is the built-in scene.
        out: file to write; None writes a temporary one.
        reporter: is told what goes on.

    Raises:
        CellError: if it cannot be read or written.
    """
    if what is not None and what.is_dir() and out is None and (what / NAME).is_file():
        return what / NAME
    with reporter.stage("draw the page"):
        if what is not None and (what / "study.json").is_file():
            text = study_page(what)
        elif what is not None and (what / EXPLORATION).is_file():
            text = explore_page(what)
        elif what is None or not what.is_dir():
            text = html_of(*scene_page(load_scene(what)))
        elif what.absolute().parent.name == EXECUTIONS:
            run = open_run(what.absolute().parent.parent)
            text = execution_page(run, read_execution(run, what.absolute().name), Execution.open(what))
        else:
            text = run_page(open_run(what))
        return write(text, out)


def scene_page(scene: Scene, watched: str = "") -> tuple[Stage, Play]:
    """The cell as a scene file describes it, the arm at home, beside what `cell check` says.

    Args:
        scene: checked.
        watched: stamp of a page that is written again and again.

    Raises:
        CellError: if it does not compile.
    """
    settled, world = settle_and_compile(scene)
    result = check_cell(settled, world)
    keys = ScannerKeys(**scanners.describe(scene.scanner.type, settled.scanner))
    cell = cell_of_world(world, keys)
    stage = Stage(
        f"Cell with {settled.part.name}", cell, [Shown("part", thinned(settled.part.reference))], watched=watched
    )
    return stage, Play(rows=result.rows(), problems=result.problems)


def write(text: str, out: Path | None) -> Path:
    """Write a page; None takes a temporary folder.

    Raises:
        UsageError: if it would lie in a folder of a run.
        FileError: if it cannot be written.
    """
    path = Path(tempfile.mkdtemp(prefix="cell-view-")) / NAME if out is None else out
    if (path.parent / "manifest.json").is_file():
        raise UsageError(f"--out {path} is in a finished folder, and these are never changed; choose another place")
    try:
        with atomic_write(path) as beside:  # a browser never reads half a page
            beside.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path} cannot be written: {(error.strerror or str(error)).lower()}") from error
    return path


def watch(
    file: Path,
    out: Path | None,
    reporter: ProgressReporter,
    opened: Callable[[Path], None],
    wait: Callable[[float], None],
) -> None:
    """Draw a scene file again whenever it is saved, until the wait is interrupted.

    What is wrong with it stands in the page beside the last cell that could be drawn.

    Args:
        file: the scene file.
        out: file to write; None writes a temporary one.
        reporter: is told what is wrong.
        opened: called with the page when it is there.
        wait: lets seconds pass.

    Raises:
        CellError: if the scene cannot be drawn when it is read for the first time.
    """
    path, before, stage = out, "", None
    while True:
        stamp = _stamp(file)
        if stamp != before:
            try:
                stage, play = scene_page(load_scene(file), stamp)
            except CellError as error:
                if stage is None:
                    raise
                reporter.note(str(error))
                stage = replace(stage, watched=stamp)
                play = Play(problems=[str(error)], notes=[_WITHOUT_PART])
            first, path = path is None or not before, write(html_of(stage, play), path)
            path.with_name(path.name + ".stamp.js").write_text(f"drawn({stamp!r});\n", encoding="utf-8")
            if first:
                opened(path)
            before = stamp
        wait(_LOOK_S)


def _stamp(file: Path) -> str:
    """Changes whenever a file is saved; "none" while an editor has taken it away."""
    try:
        found = file.stat()
    except OSError:
        return "none"
    return f"{found.st_mtime_ns}-{found.st_size}"


def open_browser(path: Path) -> bool:
    """Open a page in the user's browser; False where there is none that could show it."""
    has_screen = sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    try:
        return has_screen and webbrowser.open(path.absolute().as_uri())
    except webbrowser.Error:
        return False
