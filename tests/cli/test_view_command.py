"""`cell view` end to end."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from cell.cli.terminal import Terminal
from cell.view import view_command
from tests.support.fixture_types import RunCommand


def test_a_run_is_never_changed(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The page in the run folder is opened. A new page is written elsewhere, and never into the folder."""
    before = sorted((path.name, path.stat().st_mtime_ns) for path in planned.rglob("*"))
    process = run_cell("view", planned, "--no-open", cwd=tmp_path)
    assert (process.returncode, process.stdout.strip()) == (0, str(planned / "view.html")), process.stderr
    assert f"next:\n  cell scan {planned}\n" in process.stderr
    process = run_cell("view", planned, "--no-open", "--out", "again.html", cwd=tmp_path)
    assert (process.returncode, process.stdout.strip()) == (0, "again.html"), process.stderr
    process = run_cell("view", planned, "--no-open", "--out", planned / "other.html", cwd=tmp_path)
    assert (process.returncode, "never changed" in process.stderr) == (2, True)
    assert sorted((path.name, path.stat().st_mtime_ns) for path in planned.rglob("*")) == before


@pytest.mark.usefixtures("drawn_pictures")
def test_an_execution_has_its_surface_and_points(executed: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The page has the deviation and the cloud. A second page has the same bytes."""
    folder = executed / "executions" / "0001"
    page = (folder / "view.html").read_text(encoding="utf-8")
    assert '"name":"surface"' in page
    assert '"kind":"signed"' in page
    assert '"cloud":{"low"' in page
    assert (folder / "report.md").read_text().splitlines()[0].endswith("([view](view.html))")
    run_cell("view", folder, "--no-open", "--out", "again.html", cwd=tmp_path, code=0)
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == page


def test_the_page_of_a_scene_shows_the_results_of_check(
    blob: Callable[[int], trimesh.Trimesh], run_cell: RunCommand, tmp_path: Path
) -> None:
    """The page of the built-in scene has its contacts at home. A part in the pedestal is a problem in the page."""
    run_cell("view", "--no-open", "--out", "a.html", cwd=tmp_path, code=0)
    assert "contacts at home" in (tmp_path / "a.html").read_text()
    blob(1).export(tmp_path / "part.stl")
    part = '[part]\npath = "part.stl"\nunits = "mm"\n'
    (tmp_path / "mine.toml").write_text(f"{part}[placement]\nposition_mm = [0, 0, 0]\n")
    assert run_cell("view", "mine.toml", "--no-open", "--out", "b.html", cwd=tmp_path).returncode == 0
    assert re.search(r'"problems":\["[^"]+', (tmp_path / "b.html").read_text())
    process = run_cell("view", "--watch", "--no-open", cwd=tmp_path)
    assert (process.returncode, "cell view my_cell.toml --watch" in process.stderr) == (2, True)


def test_a_watched_scene_is_drawn_again_after_each_save(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page is drawn for a valid scene, an invalid one with its error, and a valid one again."""
    scene, page = tmp_path / "mine.toml", tmp_path / "p.html"
    texts = iter(["[placement\n", "[placement]\nposition_mm = [1000, 0, 0]\n"])
    scene.write_text("[placement]\nposition_mm = [1100, 0, 0]\n")
    seen: list[tuple[str, str]] = []

    def wait(_: float) -> None:
        seen.append((page.read_text(), page.with_name("p.html.stamp.js").read_text()))
        text = next(texts, None)
        if text is None:
            raise KeyboardInterrupt
        scene.write_text(text)

    opened: list[Path] = []
    with pytest.raises(KeyboardInterrupt):
        view_command.watch(scene, page, Terminal(), opened.append, wait)
    assert opened == [page]
    stamps = [re.search(r'"watch_stamp":"([^"]+)"', text) for text, _ in seen]
    assert [f"reloadIfNew({stamp[1]!r});\n" if stamp else "" for stamp in stamps] == [script for _, script in seen]
    assert len({script for _, script in seen}) == 3
    assert ['"problems":[]' in text for text, _ in seen] == [True, False, True]
    assert "mine.toml" in capsys.readouterr().err
