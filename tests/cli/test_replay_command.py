"""`cell replay` tested by pixels: moving arm, part at its planned pose, failed runs."""

import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from ctypes.util import find_library
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from cell.cli.terminal import Terminal
from cell.errors import FileError, UsageError
from cell.runs.run import open_run, read_execution
from cell.view import overlays
from cell.view.cell_picture import tour_camera
from cell.view.pieces import cell_of_run
from cell.view.playback import Playback, set_visible_groups
from cell.view.replay import load_playback, replay
from cell.view.replay_options import ReplayOptions
from cell.view.viewer import set_camera
from planner.values import Floats
from tests.support.fixture_types import RunCommand

_SIZE = (480, 360)
_PLACED_AT = np.array([1.1, 0.4, 0.1])  # --place of the fixture's plan

_NO_EGL = "EGL cannot be loaded; install libegl1 libegl-mesa0 libgl1-mesa-dri"
draws = pytest.mark.skipif(find_library("EGL") is None, reason=_NO_EGL)


class OffScreen:
    """MuJoCo's renderer, which draws like its viewer."""

    def __init__(self, model: mujoco.MjModel) -> None:
        model.vis.global_.offwidth, model.vis.global_.offheight = _SIZE
        model.vis.quality.offsamples = 4
        self.renderer, self.option = mujoco.Renderer(model, _SIZE[1], _SIZE[0], 20_000), mujoco.MjvOption()
        set_visible_groups(self.option)

    def picture(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, decorate: Callable[[mujoco.MjvScene], None] | None = None
    ) -> NDArray[np.uint8]:
        """Return MuJoCo's (height, width, 3) picture."""
        self.renderer.update_scene(data, camera, self.option)
        if decorate:
            decorate(self.renderer.scene)
        picture: NDArray[np.uint8] = self.renderer.render()
        return picture


def _initial_camera(planned: Path, playback: Playback) -> mujoco.MjvCamera:
    """Return the camera with which the viewer opens."""
    run = open_run(planned)
    cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
    half = np.tan(np.radians(playback.replay_model.model.vis.global_.fovy) / 2)
    poses = [playback.timeline.at(stop.begin) for stop in playback.timeline.stops]
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(playback.replay_model.model, camera)
    set_camera(camera, tour_camera(cell, part, poses, playback.path, _SIZE, half), playback.replay_model.centre)
    return camera


@pytest.fixture(scope="module")
def playback(planned: Path) -> Playback:
    """Return the playback of the finished run."""
    return load_playback(open_run(planned), None, Terminal())


@pytest.fixture(scope="module")
def screen(playback: Playback) -> Iterator[OffScreen]:
    """Yield an off-screen renderer of the playback."""
    opened = OffScreen(playback.replay_model.model)
    yield opened
    opened.renderer.close()


def _project(camera: mujoco.MjvCamera, fovy_deg: float, points: Floats) -> Floats:
    """Return (N, 2) column and row of (N, 3) points in a pinhole model of the free camera."""
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    seen = points - (np.array(camera.lookat) - camera.distance * forward)
    scale = _SIZE[1] / 2 / np.tan(np.radians(fovy_deg) / 2) / (seen @ forward)
    return np.stack(
        [_SIZE[0] / 2 + scale * (seen @ right), _SIZE[1] / 2 - scale * (seen @ np.cross(right, forward))], axis=1
    )


def _orange(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the pixels that show the robot's orange."""
    red, green, blue = (picture[..., channel].astype(int) for channel in range(3))
    return (red > 90) & (red > 2 * green) & (green > blue)


def _geoms(screen: OffScreen, data: mujoco.MjData, camera: mujoco.MjvCamera) -> np.ndarray:
    """Return the (height, width) number of the geom at each pixel, -1 for none, without marks."""
    screen.renderer.enable_segmentation_rendering()
    screen.renderer.update_scene(data, camera, screen.option)
    number, kind = np.moveaxis(screen.renderer.render(), 2, 0)
    screen.renderer.disable_segmentation_rendering()
    return np.where(kind == mujoco.mjtObj.mjOBJ_GEOM, number, -1)


@draws
def test_the_part_is_drawn_at_its_planned_pose(planned: Path, playback: Playback, screen: OffScreen) -> None:
    """The outline of the part in a close-up equals that of the reference mesh, projected separately (1 mm)."""
    playback.pose(0.0)
    camera = _initial_camera(planned, playback)
    assert (_geoms(screen, playback.data, camera) == playback.replay_model.model.geom("surface").id).sum() > 150
    camera.lookat[:] = _PLACED_AT + np.array([0.02, -0.03, 0.01])
    camera.distance = 0.45
    numbers = _geoms(screen, playback.data, camera)
    part = numbers == playback.replay_model.model.geom("surface").id
    reference = open_run(planned).mesh("reference.ply").vertices
    centre = (reference.min(axis=0) + reference.max(axis=0)) / 2
    fovy = playback.replay_model.model.vis.global_.fovy
    pixels = _project(camera, fovy, reference - centre + _PLACED_AT)
    rows, columns = np.nonzero(part)
    assert part.sum() > 5_000
    outline = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
    np.testing.assert_allclose(outline, [pixels.min(axis=0), pixels.max(axis=0)], atol=1.5)
    column, row = _project(camera, fovy, _PLACED_AT[None])[0].astype(int)
    assert part[row, column]
    colour = screen.picture(playback.data, camera)[row, column].astype(int)
    assert colour[0] >= colour[1] > colour[2] > 60  # the part's ivory, lit
    assert not _orange(colour[None, None].astype(np.uint8)).any()


@draws
def test_the_arm_is_drawn_at_its_planned_poses(planned: Path, playback: Playback, screen: OffScreen) -> None:
    """At each view the housing is drawn at its pose in plan.json or is hidden, and is drawn nowhere else."""
    camera, model = _initial_camera(planned, playback), playback.replay_model.model
    fovy, housing = model.vis.global_.fovy, model.geom("housing").id
    resolved = json.loads((planned / "scene.resolved.json").read_text())
    T_flange_housing = np.array(resolved["housing"]["T_flange_housing"])
    views = open_run(planned).plan.views
    seen, pictures = 0, []
    for stop, view in zip(playback.timeline.stops, views, strict=True):
        playback.pose(stop.begin)
        numbers = _geoms(screen, playback.data, camera)
        pictures.append(_orange(screen.picture(playback.data, camera)))
        middle = (view.T_base_flange @ T_flange_housing)[:3, 3]
        column, row = _project(camera, fovy, middle[None])[0].astype(int)
        seen += int(numbers[row, column] == housing)
        pixels = np.argwhere(numbers == housing)
        if len(pixels):  # each point of it is within half its diagonal, 95 mm, of its middle
            edge = np.abs(
                _project(camera, fovy, middle + 0.095 * np.concatenate([np.eye(3), -np.eye(3)])) - [column, row]
            )
            assert np.linalg.norm(pixels - [row, column], axis=1).max() < 1.5 * edge.max() + 2
    assert seen > len(views) / 2
    assert all(picture.sum() > 2000 for picture in pictures)
    for one, other in itertools.pairwise(pictures):
        assert (one != other).mean() > 0.002


@draws
def test_marks_are_drawn_over_the_model(planned: Path, playback: Playback, screen: OffScreen) -> None:
    """Path and frustum change pixels. The frustum is translucent teal over the part."""
    stop = playback.timeline.stops[0]
    playback.pose(stop.begin)
    camera = _initial_camera(planned, playback)
    bare = screen.picture(playback.data, camera).astype(int)
    still = screen.picture(playback.data, camera, playback.add_static_marks).astype(int)
    beam = screen.picture(playback.data, camera, lambda scene: playback.add_moment_marks(scene, stop.begin)).astype(int)
    blue = (still != bare).any(axis=2)
    assert blue.sum() > 100
    assert (still[blue][:, 2] > still[blue][:, 0]).mean() > 0.8  # the others are its edges in front of the orange arm
    tinted = (beam - bare)[(beam != bare).any(axis=2)]
    assert len(tinted) > 2000
    assert (tinted[:, 0] < tinted[:, 1]).mean() > 0.9  # red decreases most


def test_visual_meshes_do_not_change_contacts(planned: Path, playback: Playback) -> None:
    """At 300 random configurations, all contacts equal those of cell.xml, to the last digit."""
    plain = mujoco.MjModel.from_xml_path(str(planned / "cell.xml"))
    dressed = playback.replay_model.model
    rng = np.random.default_rng(3)
    violations = 0
    for _ in range(300):
        q = rng.uniform(plain.jnt_range[:, 0], plain.jnt_range[:, 1])
        found = []
        for model in (plain, dressed):
            data = mujoco.MjData(model)
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            contacts = data.contact[: data.ncon]
            found.append(sorted((*sorted(model.geom(geom).name for geom in c.geom), float(c.dist)) for c in contacts))
        assert found[0] == found[1]
        violations += bool(found[0])
    assert 10 < violations < 200


def test_a_contact_is_named(playback: Playback) -> None:
    """A contact of the arm with the floor is reported with both names. At the planned views there is no contact."""
    for stop in playback.timeline.stops:
        playback.pose(stop.begin)
        assert playback.violations() == ()
    playback.data.qpos[:] = np.radians([0, 35, 60, 0, 0, 0])
    mujoco.mj_kinematics(playback.replay_model.model, playback.data)
    violations = playback.violations()
    assert any(each.names.endswith("with floor") and each.distance < 0 for each in violations)
    assert "CONTACT" in playback.caption(0.0, violations)
    playback.pose(0.0)


def test_frames_through_the_command_line(
    planned: Path, tmp_path: Path, run_cell: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames are numbered PNGs of the requested size and need no OpenGL. A folder with frames is an error."""
    monkeypatch.setenv("MUJOCO_GL", "off")
    arguments = ("replay", str(planned), "--frames", "film", "--fps", "0.3", "--size", "320x240")
    process = run_cell(*arguments, cwd=tmp_path)
    assert (process.returncode, process.stderr) == (0, f"next:\n  cell scan {planned}\n")
    frames = [np.asarray(Image.open(path)) for path in sorted((tmp_path / "film").glob("frame_*.png"))]
    assert f"{len(frames)} frames in film" in process.stdout
    assert len(frames) > 2
    assert {frame.shape for frame in frames} == {(240, 320, 3)}
    assert all(_orange(frame).sum() > 800 for frame in frames)
    assert all((one[40:] != other[40:]).any() for one, other in itertools.pairwise(frames[:-1]))
    with pytest.raises(FileError, match="film holds frames already"):
        replay(planned, ReplayOptions(frames=tmp_path / "film"), Terminal())


def test_a_picture_needs_no_opengl_and_hides_named_pieces(
    planned: Path, tmp_path: Path, run_cell: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without EGL and OSMesa pictures are reproducible. `--hide` and `--camera` change the picture."""
    monkeypatch.setenv("MUJOCO_GL", "off")

    def picture(*options: str) -> NDArray[np.uint8]:
        process = run_cell("replay", planned, "--picture", "p.png", "--size", "320x240", *options, cwd=tmp_path)
        assert (process.returncode, process.stderr) == (0, f"next:\n  cell scan {planned}\n")
        return np.asarray(Image.open(tmp_path / "p.png"))

    first = picture()
    assert _orange(first).sum() > 2000
    np.testing.assert_array_equal(picture(), first)
    assert _orange(picture("--hide", "robot")).sum() < 300
    assert (picture("--camera", "120,35") != first).any(axis=2).mean() > 0.3
    for wrong, words in ((("--hide", "fence"), "it has: post, pedestal"), (("--camera", "up"), "azimuth,elevation")):
        process = run_cell("replay", planned, "--picture", "x.png", *wrong, cwd=tmp_path)
        assert (process.returncode, words in process.stderr) == (2, True), process.stderr


@draws
def test_an_execution_shows_its_points(
    planned: Path, tmp_path: Path, screen: OffScreen, playback: Playback, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stopped execution is shown up to its last complete scan. The points cover only the part."""
    folder = Path(shutil.copytree(planned, tmp_path / "run"))
    scans = folder / "executions" / "0001" / "scans"
    scans.mkdir(parents=True)
    run = open_run(folder)
    points = run.mesh("reference.ply").vertices
    for number, view in enumerate(run.plan.views[:3], start=1):
        np.savez_compressed(
            scans / f"{number:04d}.npz", stop=number, view=view.id, q_commanded=view.q, q_reported=view.q + 1e-3,
            T_object_scanner=view.T_object_scanner, source="files", points=points,
        )  # fmt: skip
    (scans / "0003.npz").write_bytes((scans / "0003.npz").read_bytes()[:500])
    executed = load_playback(run, read_execution(run, "latest"), Terminal())
    assert "0003.npz is damaged or cut short" in capsys.readouterr().err
    assert len(executed.timeline.stops) == 2
    np.testing.assert_allclose(executed.timeline.at(executed.timeline.stops[1].begin), run.plan.views[1].q + 1e-3)
    camera = _initial_camera(planned, playback)
    camera.distance *= 0.7  # the part is larger in the picture
    screen_of_execution = OffScreen(executed.replay_model.model)
    executed.pose(0.0)
    part = _geoms(screen_of_execution, executed.data, camera) == executed.replay_model.model.geom("surface").id
    bare = screen_of_execution.picture(executed.data, camera).astype(int)
    with_points = screen_of_execution.picture(
        executed.data, camera, lambda scene: overlays.add_clouds(scene, executed.replay_model, [0, 1], 1, executed.data)
    ).astype(int)
    screen_of_execution.renderer.close()
    changed = np.argwhere((np.abs(with_points - bare) > 25).any(axis=2))
    assert len(changed) > 0.3 * part.sum()
    rows, columns = np.nonzero(part)
    assert (changed >= [rows.min() - 2, columns.min() - 2]).all()
    assert (changed <= [rows.max() + 2, columns.max() + 2]).all()
    with pytest.raises(UsageError, match="--view 3 is not a view of this run; valid are 1 to 2, in visiting order"):
        replay(folder, ReplayOptions(execution="latest", view=3, picture=tmp_path / "x.png", size=_SIZE), Terminal())


def test_a_failed_run_shows_home_and_candidates(planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """The failure is reported, and the picture shows the arm and the candidates."""
    folder = Path(shutil.copytree(planned, tmp_path / "run.part"))
    for name in ("motion.npz", "plan.json", "report.json", "measurability.npz"):
        (folder / name).unlink()
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest |= {"status": "failed", "stage": "measurability", "reason": "the disk is full"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    process = run_cell("replay", "run.part", "--picture", "p.png", "--size", "480x360", cwd=tmp_path, code=0)
    assert "failed in the stage 'measurability': the disk is full" in process.stderr
    assert "candidate viewpoints" in process.stderr
    picture = np.asarray(Image.open(tmp_path / "p.png")).astype(int)
    assert _orange(picture.astype(np.uint8)).sum() > 1000
    green = (picture[..., 1] > picture[..., 0] + 60) & (picture[..., 1] > picture[..., 2] + 20)
    assert green.sum() > 50  # reachable candidates
    (folder / "cell.xml").unlink()
    options = ReplayOptions(picture=tmp_path / "q.png")
    with pytest.raises(FileError, match="so there is no cell to show: the run failed"):
        replay(folder, options, Terminal())
    with pytest.raises(FileError, match=r"run\.part does"):
        replay(tmp_path / "run", options, Terminal())


def test_without_a_display_the_message_names_the_alternatives(
    planned: Path, tmp_path: Path, run_cell: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message names --frames and --picture; exit code 2."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    process = run_cell("replay", planned, cwd=tmp_path)
    assert (process.returncode, process.stderr.count("\n")) == (2, 1), process.stderr
    assert "--frames DIR or --picture" in process.stderr


_WATCH = """
import json, sys, time
from pathlib import Path
import numpy as np
from PIL import ImageGrab
from cell.cli.terminal import Terminal
from cell.view.replay_options import ReplayOptions
from cell.view.replay import replay

ticks, oranges, columns, shown = [0.0], [], [], []

def clock():
    return ticks[0]

def wait(seconds):
    # The viewer draws on its own thread: wait until the picture changes, at most 0.25 s.
    deadline = time.monotonic() + 0.25
    while True:
        picture = np.asarray(ImageGrab.grab()).astype(int)
        if time.monotonic() > deadline or not (shown and (picture == shown[-1]).all()):
            break
    shown.append(picture)
    red, green, blue = (picture[..., channel] for channel in range(3))
    orange = (red > 90) & (red > 2 * green) & (green > blue)
    oranges.append(int(orange.sum()))
    columns.append(float(np.nonzero(orange)[1].mean()) if orange.any() else None)
    ticks[0] += 1.6

replay(Path(sys.argv[1]), ReplayOptions(once=True), Terminal(), clock=clock, wait=wait)
print(json.dumps({"oranges": oranges, "columns": columns}))
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="the viewer needs a display: install xvfb")
def test_the_viewer_shows_a_moving_arm_and_ends(planned: Path) -> None:
    """On a virtual display with a simulated clock, the orange arm moves on the screen. `--once` ends the viewer."""
    environment = {key: value for key, value in os.environ.items() if key not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    process = subprocess.run(
        ["xvfb-run", "-a", "-s", "-screen 0 1024x768x24", sys.executable, "-c", _WATCH, str(planned)],
        env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    watched = json.loads(process.stdout.strip().splitlines()[-1])
    columns = [column for column, orange in zip(watched["columns"], watched["oranges"], strict=True) if orange > 2000]
    assert len(columns) > 4
    settled = columns[2:]  # the first pictures may have the default camera of the window
    assert max(settled) - min(settled) > 10
