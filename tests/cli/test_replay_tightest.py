"""The tightest moment in `cell replay`: where plan.json says, drawn there, and refused where nothing is known of it."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cell.commands.terminal import Terminal
from cell.errors import FileError, UsageError
from cell.replay.options import ReplayOptions
from cell.replay.replay import load_show, replay
from cell.replay.show import Show
from cell.replay.still import Still, write_picture
from cell.replay.tightest_moment import near_camera
from cell.replay.viewer import Player
from cell.runs.run import open_run
from cell.view.pieces import cell_of_run

Run = Callable[..., subprocess.CompletedProcess[str]]

_SIZE = (480, 360)
_END = 269


@pytest.fixture(scope="module")
def show(planned: Path) -> Show:
    """The finished run, ready to be drawn."""
    return load_show(open_run(planned), None, Terminal())


def test_the_show_stands_where_the_plan_says_that_it_is_tightest(planned: Path, show: Show) -> None:
    """Joint angles at that moment of the show are those of plan.json; its points are as far apart as it says."""
    told = json.loads((planned / "plan.json").read_text())["clearance"]
    tightest, closest = told["tightest"], show.closest
    assert closest is not None
    np.testing.assert_allclose(np.degrees(show.timeline.at(closest.time)), tightest["q_deg"], atol=0.3)
    assert show.timeline.moved(closest.time) == pytest.approx(tightest["time_s"], abs=1e-6)
    assert np.linalg.norm(closest.points[0] - closest.points[1]) == pytest.approx(closest.distance, abs=1e-6)
    assert tightest["distance_mm"] == min(segment["minimum_mm"] for segment in told["segments"])
    assert all(segment["at_least_mm"] <= segment["minimum_mm"] for segment in told["segments"])
    assert f"tightest: {closest.sentence}" in show.caption(closest.time)
    assert "tightest" not in show.caption(closest.time + 1.0)


def test_the_end_key_goes_to_the_tightest_moment_and_stands_there(show: Show) -> None:
    """Without one it does nothing."""
    assert show.closest is not None
    player = Player(show.timeline, tightest=show.closest.time)
    player.press(_END)
    assert (player.t, player.playing) == (show.closest.time, False)
    without = Player(show.timeline)
    without.press(_END)
    assert (without.t, without.playing) == (0.0, True)


def test_both_points_and_the_line_are_in_the_picture(planned: Path, show: Show, tmp_path: Path) -> None:
    """From near by, they stand in the middle of it; without them the picture is another one there only."""
    closest, run = show.closest, open_run(planned)
    assert closest is not None
    cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
    show.pose(closest.time)
    camera = near_camera(show.theatre.model, show.data, closest, _SIZE)
    columns, rows, far = camera.project(closest.points).T
    assert (np.abs(columns - _SIZE[0] / 2) < 40).all()
    assert (np.abs(rows - _SIZE[1] / 2) < 40).all()
    assert (far > 0).all()
    write_picture(Still(show, cell, part, ()), tmp_path / "p.png", _SIZE, closest.time)
    drawn = np.asarray(Image.open(tmp_path / "p.png")).astype(int)
    red = (drawn[..., 0] > drawn[..., 1] + 50) & (drawn[..., 0] > drawn[..., 2] + 50)
    assert red[_SIZE[1] // 2 - 40 : _SIZE[1] // 2 + 40, _SIZE[0] // 2 - 40 : _SIZE[0] // 2 + 40].sum() > 20


def test_a_picture_of_another_moment_does_not_have_the_pair(planned: Path, show: Show, tmp_path: Path) -> None:
    """With the arm elsewhere it would hang in the air: the tour is the same picture with and without."""
    assert show.closest is not None
    run = open_run(planned)
    cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
    away = max((stop.begin for stop in show.timeline.stops), key=lambda t: abs(t - show.closest.time))
    pictures = {}
    for moment in (away, show.closest.time):
        for drawn in (show, Show(show.theatre, show.timeline)):
            write_picture(Still(drawn, cell, part, ()), tmp_path / "p.png", _SIZE, moment, (-60.0, 20.0))
            pictures[drawn is show, moment] = np.asarray(Image.open(tmp_path / "p.png")).astype(int)
    changed = {
        moment: int((np.abs(pictures[True, moment] - pictures[False, moment]) > 25).any(axis=2).sum())
        for moment in (away, show.closest.time)
    }
    assert changed[away] == 0
    assert changed[show.closest.time] > 20


def test_the_command_draws_it(planned: Path, tmp_path: Path, run_cell: Run) -> None:
    """`--tightest --picture` is another picture than that of the tour; with --view it is refused."""
    done = run_cell("replay", planned, "--tightest", "--picture", "t.png", "--size", "320x240", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, f"next:\n  cell scan {planned}\n")
    done = run_cell("replay", planned, "--picture", "p.png", "--size", "320x240", cwd=tmp_path)
    pictures = [np.asarray(Image.open(tmp_path / name)).astype(int) for name in ("t.png", "p.png")]
    assert (np.abs(pictures[0] - pictures[1]) > 25).any(axis=2).mean() > 0.2
    done = run_cell("replay", planned, "--tightest", "--view", "1", "--picture", "x.png", cwd=tmp_path)
    assert done.returncode == 2
    assert "--tightest says where to begin, and so does the view" in done.stderr


def test_a_run_that_does_not_know_it_says_so(planned: Path, tmp_path: Path) -> None:
    """An older run is shown as before, without; asked for, it is refused; a damaged entry is named."""
    folder = Path(shutil.copytree(planned, tmp_path / "run"))
    manifest = json.loads((folder / "manifest.json").read_text())
    plan = json.loads((folder / "plan.json").read_text())

    def written(content: dict[str, object]) -> None:
        manifest["artefacts"].pop("plan.json", None)
        (folder / "manifest.json").write_text(json.dumps(manifest))
        (folder / "plan.json").write_text(json.dumps(content))

    written({key: value for key, value in plan.items() if key != "clearance"})
    assert load_show(open_run(folder), None, Terminal()).closest is None
    with pytest.raises(UsageError, match="this replay knows none"):
        replay(folder, ReplayOptions(tightest=True, picture=tmp_path / "x.png", size=_SIZE), Terminal())
    written(plan | {"clearance": {"tightest": {"time_s": "soon"}}})
    with pytest.raises(FileError, match=r"plan\.json"):
        load_show(open_run(folder), None, Terminal())
