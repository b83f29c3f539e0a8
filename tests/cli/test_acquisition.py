"""Points from other sources than the simulation: files in each frame, commands, sources of other distributions."""

import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.cli.terminal import Terminal
from cell.errors import UsageError
from cell.runs import ply
from cell.runs.run import open_run, read_scan
from cell.scan import scan as scan_command
from cell.scan.acquisition import Acquired, Context, Files, View
from cell.scan.options import ScanOptions
from cell.scan.results import ScanOutcome
from cell.session import Session
from planner.geometry.closest import ClosestPointQuery

PACKAGE = Path(__file__).parents[1] / "third_party_points"


@pytest.fixture
def run(executed: Path, tmp_path: Path) -> Path:
    """Return a copy of the executed run."""
    return Path(shutil.copytree(executed, tmp_path / "run"))


def scan(run: Path, **options: Any) -> ScanOutcome:
    """Execute a scan in this process."""
    session = Session(None, Terminal(quiet_stdout=True))
    return scan_command.scan(session, run, ScanOptions(**{"resolution_deg": 1.0, **options}))


def frames(run: Path, stored: Any) -> dict[str, np.ndarray]:
    """Return the (4, 4) transforms from the object frame to the other frames at the reported pose of a scan."""
    scene = open_run(run).scene
    T_scanner_object = np.linalg.inv(stored["T_object_scanner"])
    return {
        "scanner": T_scanner_object,
        "flange": np.array(scene.T_flange_scanner) @ T_scanner_object,
        "base": np.array(scene.T_base_object),
    }


def export(
    run: Path,
    execution: str,
    to: Path,
    write: Callable[[Path, np.ndarray], None],
    frame: str = "scanner",
    change: Callable[[int, np.ndarray], np.ndarray] = lambda stop, points: points,
) -> list[Path]:
    """Write the scans of an execution as files in mm and return their paths without suffix."""
    to.mkdir()
    files = []
    for path in sorted((run / "executions" / execution / "scans").iterdir()):
        scan = read_scan(path)
        T = frames(run, scan.stored)[frame]
        points = change(int(scan.stored["number"]), 1000 * (scan.points @ T[:3, :3].T + T[:3, 3]))
        write(to / path.stem, points)
        files.append(to / path.stem)
    return files


def as_ply(form: str) -> Callable[[Path, np.ndarray], None]:
    """Return a function that writes little-endian binary PLY of '<f8' or '<f4'."""
    name = {"<f8": "double", "<f4": "float"}[form]

    def write(path: Path, points: np.ndarray) -> None:
        header = "".join(f"property {name} {axis}\n" for axis in "xyz")
        text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{header}end_header\n"
        path.with_suffix(".ply").write_bytes(text.encode() + points.astype(form).tobytes())

    return write


def as_xyz(path: Path, points: np.ndarray) -> None:
    """Write text with all digits."""
    lines = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    path.with_suffix(".xyz").write_text("# x y z\n" + lines)


def as_pcd(path: Path, points: np.ndarray) -> None:
    """Write binary PCD of floats. The last point is NaN."""
    rows = np.concatenate([points.astype("<f4"), np.full((1, 3), np.nan, "<f4")])
    text = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nPOINTS {len(rows)}\nDATA binary\n"
    )
    path.with_suffix(".pcd").write_bytes(text.encode() + rows.tobytes())


@pytest.mark.parametrize(
    ("frame", "write", "off_mm"),
    [("scanner", as_ply("<f8"), 1e-6), ("flange", as_xyz, 1e-6), ("base", as_pcd, 1e-3)],
)  # fmt: skip
def test_an_execution_s_own_scans_read_back_give_the_same(
    run: Path, tmp_path: Path, frame: str, write: Callable[[Path, np.ndarray], None], off_mm: float
) -> None:
    """Cloud, mesh and deviation are equal. The reports differ only in source, rejection counts and kind of coverage."""
    export(run, "0001", tmp_path / "files", write, frame)
    outcome = scan(
        run, acquire=f"files:{tmp_path / 'files'}", points_frame=frame, points_units="mm", registration=False
    )
    assert outcome.exit_code == 0
    ours, theirs = outcome.folder, run / "executions" / "0001"
    first, second = (ply.elements((folder / "cloud.ply").read_bytes())["vertex"] for folder in (theirs, ours))
    for axis in "xyz":
        np.testing.assert_allclose(second[axis], first[axis], atol=off_mm)
    first, second = (trimesh.load(folder / "mesh.ply", process=False) for folder in (theirs, ours))
    if off_mm < 1e-3:  # single precision may change a cell of the grid
        assert (first.faces == second.faces).all()
        np.testing.assert_allclose(second.vertices, first.vertices, atol=off_mm)
    before, after = (json.loads((folder / "report.json").read_text()) for folder in (theirs, ours))
    assert after["deviation"]["rms_mm"] == pytest.approx(before["deviation"]["rms_mm"], abs=off_mm)
    differ = set(_differing(before, after, 2 * off_mm))
    views = {f"views.{k}.{name}" for k in range(len(before["views"])) for name in (
        "rays", "pose_error_mm", "pose_error_deg", "pose_error_after_mm", "pose_error_after_deg")}  # fmt: skip
    assert (
        {"source", "coverage.kind"}
        <= differ
        <= {"source", "coverage.kind", *views}
        | (set() if off_mm < 1e-3 else {"surface.faces", "surface.vertices", "surface.holes", "deviation.max_mm"})
    )
    assert after["views"][0]["rays"] is None
    manifest = json.loads((ours / "manifest.json").read_text())
    assert manifest["source"] == after["source"] != "simulated"
    assert before["source"] == "simulated"
    page = (ours / "report.md").read_text()
    assert str(tmp_path / "files") in page.splitlines()[0]
    assert "computed by the model" in page
    for name in ("cloud.ply", "mesh.ply"):
        assert b"comment points: files of" in (ours / name).read_bytes()[:400]
        assert b"comment points: simulated" in (theirs / name).read_bytes()[:400]
    assert ", simulated" in (theirs / "report.md").read_text().splitlines()[0]
    stored = read_scan(ours / "scans" / "0001.npz").stored
    assert {"face", "pixel", "codes", "counts", "T_object_scanner_true"}.isdisjoint(stored)


def _differing(one: Any, other: Any, near: float, at: str = "") -> list[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        return [d for k in {*one, *other} for d in _differing(one.get(k), other.get(k), near, f"{at}.{k}".strip("."))]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return [d for k, pair in enumerate(zip(one, other, strict=True)) for d in _differing(*pair, near, f"{at}.{k}")]
    if isinstance(one, float) and isinstance(other, float):
        return [] if abs(one - other) <= near else [at]
    return [] if one == other else [at]


def test_noise_outliers_and_a_missing_view(run: Path, tmp_path: Path) -> None:
    """The views are registered like simulated ones. The missing view is resumable. The cloud has few outliers."""
    errors = {"range_noise_mm": 0.03, "pose_error_mm": 0.5, "pose_error_deg": 0.1}
    simulated = scan(run, **errors)
    stray: list[np.ndarray] = []

    def dirty(stop: int, points: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(stop)
        count = len(points) // 9  # a tenth of all points
        low, high = points.min(axis=0) - 30, points.max(axis=0) + 30
        stray.append(rng.uniform(low, high, (count, 3)))
        return np.concatenate([points, stray[-1]])

    files = export(run, simulated.folder.name, tmp_path / "files", as_ply("<f8"), change=dirty)
    content = files[1].with_suffix(".ply").read_bytes()
    files[1].with_suffix(".ply").unlink()
    options = {"acquire": f"files:{tmp_path / 'files'}", "points_frame": "scanner", "points_units": "mm"}
    outcome = scan(run, **options)
    assert outcome.exit_code == 6
    assert outcome.report.missing_views == (2,)
    files[1].with_suffix(".ply").write_bytes(content)
    outcome = scan_command.resume(Session(None, Terminal(quiet_stdout=True)), run, outcome.folder.name, None)
    assert outcome.report.missing_views == ()
    ours, theirs = outcome.report, simulated.report
    assert ours.contradictions == ()
    assert ours.registration.uncorrected_scans == theirs.registration.uncorrected_scans == 0
    assert ours.registration.rms_after_mm == pytest.approx(theirs.registration.rms_after_mm, rel=0.25)
    points = ply.positions(ply.elements((outcome.folder / "cloud.ply").read_bytes())["vertex"])
    clean = ply.positions(ply.elements((simulated.folder / "cloud.ply").read_bytes())["vertex"])
    reference = open_run(run).mesh("reference.ply")
    off = ClosestPointQuery(reference).closest(points).distance
    assert (off > 0.3e-3).mean() < 1e-3
    assert len(points) > 0.97 * len(clean)
    assert ours.cloud.outliers > 0.9 * sum(len(each) for each in stray)


def test_points_in_another_unit_are_reported(run: Path, tmp_path: Path) -> None:
    """The report of an execution has the cause. tests/unit/test_causes.py tests each cause without an execution."""
    export(run, "0001", tmp_path / "files", as_ply("<f8"), change=lambda stop, points: points / 1000)
    outcome = scan(run, acquire=f"files:{tmp_path / 'files'}", points_frame="scanner", points_units="mm")
    (doubt,) = outcome.report.contradictions
    assert "their unit is m, not mm" in doubt


def test_a_command_is_called_with_view_pose_and_file(run: Path, tmp_path: Path) -> None:
    """A command that fails is called a second time. View 2 fails both times and is recorded as missing."""
    program = tmp_path / "scanner.py"
    program.write_text(
        "import json, pathlib, sys\n"
        "view, pose, out = sys.argv[1:]\n"
        "said = json.loads(pathlib.Path(pose).read_text())\n"
        "assert said['view'] == int(view) and len(said['T_base_scanner'][0]) == 4\n"
        "mark = pathlib.Path(out).with_suffix('.tried')\n"
        "if view == '2' or not mark.exists():\n"
        "    mark.touch(); print('warming up'); sys.exit(3)\n"
        "rows = '0 0 250\\n1 0 250\\n0 1 250\\n'\n"
        "header = 'ply\\nformat ascii 1.0\\nelement vertex 3\\n'\n"
        "names = ''.join(f'property float {axis}\\n' for axis in 'xyz')\n"
        "pathlib.Path(out).write_text(header + names + 'end_header\\n' + rows)\n"
    )
    outcome = scan(
        run, acquire=f"command:{sys.executable} {program}", points_frame="scanner", points_units="mm",
        registration=False,
    )  # fmt: skip
    assert outcome.report.missing_views == (2,)
    events = [json.loads(line) for line in (outcome.folder / "events.jsonl").read_text().splitlines()]
    scan_events = [event for event in events if event["event"] == "scan"]
    assert {event["calls"] for event in scan_events} == {2}
    assert [event["number"] for event in events if event["event"] == "missing"] == [2]
    stored = read_scan(outcome.folder / "scans" / "0001.npz")
    T = stored.stored["T_object_scanner"]
    np.testing.assert_allclose(stored.points[0], T[:3, 3] + 0.25 * T[:3, 2], atol=1e-12)


def test_a_slow_command_is_ended(run: Path) -> None:
    """A call is ended after its time-out, and the view is missing."""
    outcome = scan(
        run, acquire=f"command:{sys.executable} -c 'import time; time.sleep(60)'", points_frame="base",
        points_units="mm", view=1, acquire_timeout_s=0.2,
    )  # fmt: skip
    assert outcome.report.missing_views == (1,)


def test_a_growing_file_is_read_when_its_size_is_constant(run: Path, tmp_path: Path) -> None:
    """A file that appears and grows is read once its size is constant. A view without a file is missing."""
    folder, message = tmp_path / "files", []
    folder.mkdir()
    path, time_ = folder / "view_7.xyz", [0.0]

    def sleep(seconds: float) -> None:
        time_[0] += seconds
        if time_[0] < 1:
            with path.open("a") as file:
                file.write("1 2 3\n")

    options = {"points_frame": "base", "points_units": "cm", "acquire_wait_s": 5.0}
    context = Context(None, options, 0, tmp_path, message.append)  # type: ignore[arg-type]
    files = Files(str(folder), context, now=lambda: time_[0], sleep=sleep)
    eye = np.eye(4)[None]
    view = View(7, 70, np.zeros((1, 6)), eye, eye, np.eye(4), np.zeros(1, dtype=np.int64))
    acquired = files.take(view)
    assert isinstance(acquired, Acquired)
    np.testing.assert_allclose(acquired.points, [[0.01, 0.02, 0.03]] * 4)
    assert acquired.details["points_of"] == str(path)
    assert "view 7" in message[0]
    assert files.take(View(8, 70, np.zeros((1, 6)), eye, eye, np.eye(4), np.zeros(1, dtype=np.int64))) is None
    assert "view 8 is missing" in message[-1]


def test_a_folder_that_is_away_for_a_moment(tmp_path: Path) -> None:
    """The arm waits for the points; without them the view is missing, and its cause is named."""
    folder, away, message, time_ = tmp_path / "files", tmp_path / "away", [], [0.0]
    folder.mkdir()

    def sleep(seconds: float) -> None:
        time_[0] += seconds
        if away.exists():
            away.rename(folder)

    options = {"points_frame": "base", "points_units": "cm", "acquire_wait_s": 5.0}
    context = Context(None, options, 0, tmp_path, message.append)  # type: ignore[arg-type]
    files = Files(str(folder), context, now=lambda: time_[0], sleep=sleep)
    (folder / "view_7.xyz").write_text("1 2 3\n")
    eye = np.eye(4)[None]
    view = View(7, 70, np.zeros((1, 6)), eye, eye, np.eye(4), np.zeros(1, dtype=np.int64))
    folder.rename(away)
    assert isinstance(files.take(view), Acquired)
    shutil.rmtree(folder)
    assert files.take(view) is None
    assert re.search(r"view 7 is missing: .*files cannot be read: No such file", message[-1])


def test_a_file_of_an_earlier_execution_is_not_taken(tmp_path: Path) -> None:
    """While the arm waits, a file that was there before is refused by name, until the scanner replaces it."""
    path, message, time_, replaced_at = tmp_path / "view_7.xyz", [], [0.0], 9.0
    path.write_text("1 2 3\n")

    def sleep(seconds: float) -> None:
        time_[0] += seconds
        if time_[0] > replaced_at:
            path.write_text("4 5 6\n7 8 9\n")

    options = {"points_frame": "base", "points_units": "m", "acquire_wait_s": 5.0}
    context = Context(None, options, 0, tmp_path, message.append)  # type: ignore[arg-type]
    files = Files(str(tmp_path), context, now=lambda: time_[0], sleep=sleep)
    eye = np.eye(4)[None]
    view = View(7, 70, np.zeros((1, 6)), eye, eye, np.eye(4), np.zeros(1, dtype=np.int64))
    assert files.take(view) is None
    assert "view_7.xyz is older than this execution; remove it" in message[-1]
    acquired = files.take(view)
    assert isinstance(acquired, Acquired)
    np.testing.assert_allclose(acquired.points, [[4, 5, 6], [7, 8, 9]])
    options["acquire_wait_s"] = 0.0
    assert isinstance(Files(str(tmp_path), context).take(view), Acquired)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"acquire": "files:/nowhere"}, "is not a folder"),
        ({"acquire": "laser"}, "installed are: command, files, genicam, simulated"),
        ({"acquire": "command:"}, "names no command"),
        ({"acquire": "command:true"}, "never guessed"),
        ({"acquire": "simulated:fast"}, "takes no argument"),
    ],
)
def test_invalid_sources_leave_no_execution(run: Path, options: dict[str, Any], words: str) -> None:
    """Invalid sources are refused before any motion, and no execution is created."""
    with pytest.raises(UsageError, match=re.escape(words)):
        scan(run, **options)
    assert [path.name for path in (run / "executions").iterdir()] == ["0001"]


def test_a_source_of_another_distribution(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A source of ten lines in another distribution is found by its entry point."""
    shutil.copy(PACKAGE / "wall_points.py", tmp_path)
    info = tmp_path / "example_wall_points-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: example-wall-points\nVersion: 0.1.0\n")
    (info / "entry_points.txt").write_text("[cell.acquisition]\nwall = wall_points:Wall\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    outcome = scan(run, acquire="wall:300", registration=False)
    assert outcome.report.source == "a wall at 300 mm"
    stored = read_scan(outcome.folder / "scans" / "0001.npz")
    T = stored.stored["T_object_scanner"]
    np.testing.assert_allclose((stored.points - T[:3, 3]) @ T[:3, 2], 0.3, atol=1e-12)
