"""`cell locate`: a displaced part is located from several kinds of points and the plan is moved; refusals."""

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.api import locate, open_run
from cell.errors import FileError, UsageError
from cell.runs.cell import read_cell
from cell.runs.run import Run
from cell.runs.verification import verify_plan
from cell.world import virtual_scan
from planner.registration.rigid import motion_from_screw
from planner.values import Floats
from tests.support.fixture_types import RunCommand


def _set_down(run: Run, mm: tuple[float, float, float], deg: tuple[float, float, float]) -> Floats:
    """Return T_base_object of a displaced part, turned about its centre; axes of base."""
    centre = (run.T_base_object @ run.scene.T_object_centre)[:3, 3]
    return motion_from_screw(np.concatenate([np.array(mm) / 1000, np.radians(deg)]), centre) @ run.T_base_object


def _scanned(run: Run, T_base_object: Floats, view: int) -> Floats:
    """Return (P, 3) points of the part measured at a planned view: scanner frame [m], noise of 0.03 mm."""
    cell = read_cell(run)
    T = np.linalg.inv(T_base_object) @ run.T_base_scanner[view - 1]
    seen = virtual_scan.scan(cell.scanner, T, cell.part_caster, cell.reference)
    back = np.linalg.inv(T)
    points = seen.points @ back[:3, :3].T + back[:3, 3]
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(points + rays * np.random.default_rng(view).normal(0, 3e-5, (len(points), 1)))


def test_one_scan_finds_the_part_and_the_plan_is_taken_there(
    run_cell: RunCommand, planned: Path, tmp_path: Path
) -> None:
    """A part 15 mm and 4 deg off is located to 0.05 mm. The new plan keeps most views, is verified and scanned."""
    run = open_run(planned)
    T = _set_down(run, (-9.0, 12.0, 2.0), (1.0, -2.0, 3.4))
    np.savetxt(tmp_path / "scan_0001.xyz", 1000 * _scanned(run, T, 1), fmt="%.6f")
    output = ("--points", tmp_path, "--points-frame", "scanner", "--points-units", "mm")
    process = run_cell("locate", planned, *output, "--out", tmp_path / "there", "--repair", "--json", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr
    found = json.loads(process.stdout)
    off = np.array(found["T_base_object"]) @ np.linalg.inv(T)
    corners = run.reference.vertices @ T[:3, :3].T + T[:3, 3]
    assert np.linalg.norm(corners @ off[:3, :3].T + off[:3, 3] - corners, axis=1).max() < 5e-5
    assert found["displacement_mm"] == pytest.approx(15.13, abs=0.1)
    assert found["free_motions"] == []
    there = open_run(tmp_path / "there")
    remaining = [candidate for candidate in run.candidate.tolist() if candidate in there.candidate.tolist()]
    assert len(remaining) > len(run.candidate) / 2
    for candidate in remaining:
        one, other = (each.T_object_scanner[each.candidate.tolist().index(candidate)] for each in (run, there))
        np.testing.assert_allclose(one, other, atol=2e-5)
    np.testing.assert_allclose(there.T_base_object, found["T_base_object"], atol=1e-9)
    assert there.digest != run.digest
    assert verify_plan(there.folder).digest == there.digest
    assert run_cell("scan", there.folder, "--view", "1", "--resolution", "2", cwd=tmp_path).returncode == 0


def test_named_points_find_the_part(planned: Path, tmp_path: Path) -> None:
    """Pairs in base, pairs in the scanner frame of a view, and 3-2-1 give the same placement from exact points."""
    run = open_run(planned)
    T = _set_down(run, (5.0, -3.0, 1.0), (0.5, 0.2, -1.0))
    nominal = run.reference.vertices[np.linspace(0, len(run.reference.vertices) - 1, 6).astype(int)]
    base = nominal @ T[:3, :3].T + T[:3, 3]
    back = np.linalg.inv(run.T_base_scanner[2])
    for name, measured in (("base", base), ("scanner", base @ back[:3, :3].T + back[:3, 3])):
        rows = [f"p{k}, " + ", ".join(f"{1000 * value:.9f}" for value in (*nominal[k], *measured[k])) for k in range(6)]
        (tmp_path / f"{name}.csv").write_text("# name, on the part, measured\n" + "\n".join(rows))
    for options in (
        {"pairs": tmp_path / "base.csv", "points_frame": "base"},
        {"pairs": tmp_path / "scanner.csv", "points_frame": "scanner", "view": 3},
        {"three_two_one": tmp_path / "base.csv", "points_frame": "base", "point_sd": 0.05},
    ):
        texts = {name: str(value) if isinstance(value, Path) else value for name, value in options.items()}
        found = locate(run, points_units="mm", **texts)
        np.testing.assert_allclose(found.T_base_object, T, atol=1e-8)
        assert found.precision is not None
        assert found.free_motions == () or "three_two_one" in options  # random points: the uncertainty may be large


def test_the_scans_of_an_execution_are_where_they_were_planned(executed: Path) -> None:
    """A simulated execution gives the planned placement and the report says so. The motion keeps its clearance."""
    found = locate(executed)
    assert found.displacement_mm < 0.01
    for free, is_limited in (((), False), (("sliding along (0, 0, 1)",), True)):
        rows = dict(found.model_copy(update={"free_motions": free}).rows())
        assert rows["standard deviation"].endswith("in the observed directions") == is_limited
    assert any("simulated" in doubt for doubt in found.contradictions)
    assert found.motion_check.keeps_clearance
    nearest = open_run(Path(found.run)).plan.clearance
    assert nearest is not None
    assert found.motion_check.minimum_clearance_mm == pytest.approx(
        min(s.minimum_mm for s in nearest.segments), abs=0.3
    )


def test_a_part_in_contact_with_the_motion_is_reported(planned: Path, tmp_path: Path) -> None:
    """For a part at the scanner's first view, the checked motion does not keep its clearance."""
    run = open_run(planned)
    T = run.T_base_object.copy()
    centre = (T @ run.scene.T_object_centre)[:3, 3]
    T[:3, 3] += run.T_base_scanner[0, :3, 3] - centre
    nominal = run.reference.vertices[[0, 40, 90, 200]]
    rows = [
        f"p{k} " + " ".join(f"{1000 * value:.9f}" for value in (*p, *(T[:3, :3] @ p + T[:3, 3])))
        for k, p in enumerate(nominal)
    ]
    (tmp_path / "touched.txt").write_text("\n".join(rows))
    found = locate(run, pairs=str(tmp_path / "touched.txt"), points_frame="base", points_units="mm")
    assert not found.motion_check.keeps_clearance
    assert "violates the clearance" in found.motion_check.problem


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a 1 2 3 4 5", "line 1: it must be a name and six numbers"),
        ("a 1 2 3 4 5 6\na 1 2 3 4 5 6", "line 2: the point 'a' occurs twice"),
        ("a 1 2 3 4 5 nan", "line 1: it must be"),
    ],
)
def test_files_of_named_points_that_are_none(content: str, message: str, planned: Path, tmp_path: Path) -> None:
    """The error names the line and the valid format."""
    (tmp_path / "touched.txt").write_text(content)
    with pytest.raises(FileError, match=message):
        locate(planned, pairs=str(tmp_path / "touched.txt"), points_frame="base", points_units="mm")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"points": "x.ply", "points_frame": "base"}, "points_units is missing"),
        ({"points": "x.ply", "points_units": "mm"}, "points_frame is missing"),
        ({"points": "x.ply", "pairs": "y.csv"}, "give one of them"),
        ({"points_units": "mm"}, "which records its own"),
        ({"points": "x.ply", "points_frame": "base", "points_units": "mm", "view": 99}, "there is no view 99"),
    ],
)
def test_invalid_options_are_refused(options: dict[str, Any], message: str, planned: Path) -> None:
    """Incomplete or contradictory options are refused with the remedy."""
    with pytest.raises((UsageError, FileError), match=message):
        locate(planned, **options)


def _pairs(run: Run, nominal: np.ndarray, path: Path) -> tuple[object, ...]:
    """Write pairs of points at the planned placement, and return the options that read them."""
    T = run.T_base_object
    rows = [
        f"p{k} " + " ".join(f"{1000 * value:.9f}" for value in (*p, *(T[:3, :3] @ p + T[:3, 3])))
        for k, p in enumerate(nominal)
    ]
    path.write_text("\n".join(rows))
    return "--pairs", path, "--points-frame", "base", "--points-units", "mm"


def test_pairs_on_a_line_are_refused(run_cell: RunCommand, planned: Path, tmp_path: Path) -> None:
    """They leave a rotation undetermined: exit code 2 with and without a new run."""
    nominal = np.array([0.02, 0.0, 0.03]) + np.linspace(0, 0.04, 3)[:, None] * [0, 0, 1]
    options = _pairs(open_run(planned), nominal, tmp_path / "line.txt")
    for out in ((), ("--out", tmp_path / "there")):
        process = run_cell("locate", planned, *options, *out, cwd=tmp_path, code=2)
        assert "the nominal points lie on a line, and any rotation about it fits as well" in process.stderr
    assert not list(tmp_path.glob("there*"))


def test_an_undetermined_placement_is_refused_and_its_next_command_is_not(
    run_cell: RunCommand, planned: Path, tmp_path: Path
) -> None:
    """Pairs near a line leave the rotation about it undetermined; the next command keeps that of the plan."""
    nominal = np.array([0.02, 0.0, 0.03]) + np.linspace(0, 0.04, 4)[:, None] * [0, 0, 1]
    nominal[1, 0] += 0.0005
    options = (*_pairs(open_run(planned), nominal, tmp_path / "near.txt"), "--point-sd", "0.05")
    process = run_cell("locate", planned, *options, "--out", tmp_path / "there", cwd=tmp_path, code=2)
    assert "turning about" in process.stderr
    assert not list(tmp_path.glob("there*"))
    (tmp_path / "sim_runs" / "there").mkdir(parents=True)
    process = run_cell("locate", planned, *options, cwd=tmp_path, code=0)
    (line,) = [line for line in process.stdout.splitlines() if line.strip().startswith("cell locate")]
    assert "--keep-planned" in line
    run_cell(*shlex.split(line)[1:], cwd=tmp_path, code=0)
    assert open_run(tmp_path / "sim_runs" / "there-2").report.n_views == open_run(planned).report.n_views
