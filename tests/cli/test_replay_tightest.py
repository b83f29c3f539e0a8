"""The tightest moment in `cell replay`: as in plan.json, drawn, and an error if unknown."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cell.cli.terminal import Terminal
from cell.errors import FileError, UsageError
from cell.runs.run import open_run
from cell.view.pieces import cell_of_run
from cell.view.playback import Playback
from cell.view.replay import load_playback, replay
from cell.view.replay_options import ReplayOptions
from cell.view.replay_pictures import PictureInputs, write_picture
from cell.view.tightest_moment import closeup_camera
from cell.view.viewer import Player
from tests.support.fixture_types import RunCommand

_SIZE = (480, 360)
_END = 269


@pytest.fixture(scope="module")
def playback(planned: Path) -> Playback:
    """Return the playback of the finished run."""
    return load_playback(open_run(planned), None, Terminal())


def test_the_playback_has_the_tightest_moment_of_the_plan(planned: Path, playback: Playback) -> None:
    """Joint angles and distance of the points at that moment equal those of plan.json."""
    clearance = json.loads((planned / "plan.json").read_text())["clearance"]
    planned_moment, tightest = clearance["tightest"], playback.tightest
    assert tightest is not None
    np.testing.assert_allclose(np.degrees(playback.timeline.at(tightest.time)), planned_moment["q_deg"], atol=0.3)
    assert playback.timeline.moved(tightest.time) == pytest.approx(planned_moment["time_s"], abs=1e-6)
    assert np.linalg.norm(tightest.points[0] - tightest.points[1]) == pytest.approx(tightest.distance, abs=1e-6)
    assert planned_moment["distance_mm"] == min(segment["minimum_mm"] for segment in clearance["segments"])
    assert all(segment["lower_bound_mm"] <= segment["minimum_mm"] for segment in clearance["segments"])
    assert f"tightest: {tightest.sentence}" in playback.caption(tightest.time)
    assert "tightest" not in playback.caption(tightest.time + 1.0)


def test_the_end_key_goes_to_the_tightest_moment_and_pauses(playback: Playback) -> None:
    """The key sets the time and pauses. Without a tightest moment the key has no effect."""
    assert playback.tightest is not None
    player = Player(playback.timeline, tightest=playback.tightest.time)
    player.press(_END)
    assert (player.t, player.playing) == (playback.tightest.time, False)
    without = Player(playback.timeline)
    without.press(_END)
    assert (without.t, without.playing) == (0.0, True)


def test_both_points_and_their_line_are_in_the_picture(planned: Path, playback: Playback, tmp_path: Path) -> None:
    """In the close-up both points are in the middle of the picture."""
    tightest, run = playback.tightest, open_run(planned)
    assert tightest is not None
    cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
    playback.pose(tightest.time)
    camera = closeup_camera(playback.replay_model.model, playback.data, tightest, _SIZE)
    columns, rows, far = camera.project(tightest.points).T
    assert (np.abs(columns - _SIZE[0] / 2) < 40).all()
    assert (np.abs(rows - _SIZE[1] / 2) < 40).all()
    assert (far > 0).all()
    write_picture(PictureInputs(playback, cell, part, ()), tmp_path / "p.png", ReplayOptions(size=_SIZE), tightest.time)
    image = np.asarray(Image.open(tmp_path / "p.png")).astype(int)
    red = (image[..., 0] > image[..., 1] + 50) & (image[..., 0] > image[..., 2] + 50)
    assert red[_SIZE[1] // 2 - 40 : _SIZE[1] // 2 + 40, _SIZE[0] // 2 - 40 : _SIZE[0] // 2 + 40].sum() > 20


def test_the_command_draws_the_tightest_moment(planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """`--tightest --picture` differs from the picture of the tour. `--tightest` with `--view` is an error."""
    process = run_cell("replay", planned, "--tightest", "--picture", "t.png", "--size", "320x240", cwd=tmp_path)
    assert (process.returncode, process.stderr) == (0, f"next:\n  cell scan {planned}\n")
    process = run_cell("replay", planned, "--picture", "p.png", "--size", "320x240", cwd=tmp_path)
    pictures = [np.asarray(Image.open(tmp_path / name)).astype(int) for name in ("t.png", "p.png")]
    assert (np.abs(pictures[0] - pictures[1]) > 25).any(axis=2).mean() > 0.2
    process = run_cell("replay", planned, "--tightest", "--view", "1", "--picture", "x.png", cwd=tmp_path, code=2)
    assert "--tightest and view both set the start" in process.stderr


def test_an_unknown_tightest_moment_is_an_error(planned: Path, tmp_path: Path) -> None:
    """A run without clearance has no tightest moment, and --tightest is an error. A damaged entry is an error too."""
    folder = Path(shutil.copytree(planned, tmp_path / "run"))
    manifest = json.loads((folder / "manifest.json").read_text())
    plan = json.loads((folder / "plan.json").read_text())

    def write(content: dict[str, object]) -> None:
        manifest["artefacts"].pop("plan.json", None)
        (folder / "manifest.json").write_text(json.dumps(manifest))
        (folder / "plan.json").write_text(json.dumps(content))

    write({key: value for key, value in plan.items() if key != "clearance"})
    assert load_playback(open_run(folder), None, Terminal()).tightest is None
    with pytest.raises(UsageError, match="which this replay does not have"):
        replay(folder, ReplayOptions(tightest=True, picture=tmp_path / "x.png", size=_SIZE), Terminal())
    write(plan | {"clearance": {"tightest": {"time_s": "soon"}}})
    with pytest.raises(FileError, match=r"plan\.json"):
        load_playback(open_run(folder), None, Terminal())
