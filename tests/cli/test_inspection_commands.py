"""`cell features` and `cell inspect`: lists, pictures, results with verdicts and exit codes."""

import csv
import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from cell.part.workpiece import load
from cell.runs.run import open_finished
from planner.geometry.sampling import draw_samples
from planner.registration.rigid import motion_from_vector, transform_points
from tests.qif_files import bored_block_qif
from tests.step_files import bored_block, needs_cascadio
from tests.support.cover_oracle import fewest_views
from tests.support.fixture_types import RunCommand


@needs_cascadio
def test_features_are_listed_and_drawn(
    run_cell: RunCommand, tmp_path: Path, drawing: Callable[[], AbstractContextManager[None]]
) -> None:
    """Features and characteristics of a QIF file have their faces, tolerances and datums."""
    (tmp_path / "block.stp").write_text(bored_block())
    (tmp_path / "block.qif").write_text(bored_block_qif())
    words = ("features", "block.stp", "--qif", "block.qif", "--out", "drawn")
    with drawing():
        message = json.loads(run_cell(*words, "--json", cwd=tmp_path, code=0).stdout)
    assert [each["name"] for each in message["characteristics"]] == ["Flatness 41", "Diameter 42", "Position 43"]
    assert (tmp_path / "drawn" / "features.png").stat().st_size > 10_000
    assert "cylinder, diameter 16 mm" in run_cell(*words, cwd=tmp_path, code=0).stdout
    assert run_cell("features", "block.stp", cwd=tmp_path).returncode == 2


@needs_cascadio
@pytest.mark.usefixtures("drawn_pictures")
def test_points_of_a_file_are_inspected(run_cell: RunCommand, tmp_path: Path) -> None:
    """A bore that is 0.5 too large fails, exit code 3; the table, the page and the QIF file have its value."""
    (tmp_path / "block.stp").write_text(bored_block())
    (tmp_path / "block.qif").write_text(bored_block_qif())
    part = load(tmp_path / "block.stp")
    points = draw_samples(part.reference, part.reference, 8_000, np.random.default_rng(0)).points.copy()
    radial = points[:, :2] - [0.03, 0.02]
    distance = np.linalg.norm(radial, axis=1)
    bore = distance < 0.0080001
    points[bore, :2] += 0.00025 * radial[bore] / distance[bore, None]
    np.savetxt(tmp_path / "points.xyz", 1000 * points, fmt="%.6f")
    words = ("inspect", "points.xyz", "--part", "block.stp", "--qif", "block.qif", "--out", "checked")
    assert run_cell(*words, cwd=tmp_path).returncode == 2  # without a unit
    message = json.loads(run_cell(*words, "--points-units", "mm", "--json", cwd=tmp_path, code=3).stdout)
    verdicts = {each["name"]: each["verdict"] for each in message["characteristics"]}
    assert verdicts == {"Flatness 41": "pass", "Diameter 42": "fail", "Position 43": "pass"}
    with (tmp_path / "checked" / "characteristics.csv").open(newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert abs(float(rows["Diameter 42"]["value"]) - 16.5) < 0.05
    for name in ("report.md", "report.pdf", "features.html", "features.png", "features.json", "results.qif"):
        assert (tmp_path / "checked" / name).is_file()
    assert "<CharacteristicStatusEnum>FAIL" in (tmp_path / "checked" / "results.qif").read_text()


@needs_cascadio
@pytest.mark.usefixtures("drawn_pictures")
def test_a_solid_that_states_its_unit_is_inspected_without_one(run_cell: RunCommand, tmp_path: Path) -> None:
    """A nominal STEP file as measured mesh has the nominal diameter; a second unit is refused."""
    (tmp_path / "block.stp").write_text(bored_block())
    (tmp_path / "block.qif").write_text(bored_block_qif())
    words = ("inspect", "block.stp", "--part", "block.stp", "--qif", "block.qif", "--out", "checked")
    message = json.loads(run_cell(*words, "--json", cwd=tmp_path).stdout)
    values = {each["name"]: each["value"] for each in message["characteristics"]}
    assert values["Diameter 42"] == pytest.approx(16, abs=0.02)
    assert run_cell(*words, "--points-units", "mm", cwd=tmp_path).returncode == 2


def test_options_of_a_file_are_refused_for_an_execution(run_cell: RunCommand, tmp_path: Path) -> None:
    """A search or a precision of points would not apply to its points."""
    (tmp_path / "executions" / "0001").mkdir(parents=True)
    for option in (("--search", "1mm,1deg"), ("--point-sd", "0.1"), ("--points-units", "mm")):
        process = run_cell("inspect", "executions/0001", *option, cwd=tmp_path, code=2)
        assert "are for points of a file" in process.stderr


def test_two_clouds_are_compared(run_cell: RunCommand, tmp_path: Path) -> None:
    """A plane that is 0.2 higher, of which one end is missing."""
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    np.savetxt(tmp_path / "a.xyz", np.column_stack([grid, np.zeros(1600)]))
    np.savetxt(tmp_path / "b.xyz", np.column_stack([grid[grid[:, 0] < 30], np.full(1200, 0.2)]))
    assert run_cell("diff", "a.xyz", "b.xyz", cwd=tmp_path).returncode == 2
    words = ("diff", "a.xyz", "b.xyz", "--points-units", "mm")
    found = json.loads(run_cell(*words, "--json", cwd=tmp_path, code=0).stdout)
    assert abs(found["rms_mm"] - 0.2) < 1e-6
    assert abs(found["only_a"] - 0.15) < 0.03
    assert found["only_b"] == 0
    assert "spacing of A 1 mm" in run_cell(*words, cwd=tmp_path, code=0).stdout


_RPS = [  # three points on the top, two on the front, one on the left, and one on the raised part of the right
    ((10, 8, 30), (0, 0, 1), 1.0), ((50, 8, 30), (0, 0, 1), 1.0), ((10, 32, 30), (0, 0, 1), 1.0),
    ((15, 0, 15), (0, -1, 0), 1.0), ((45, 0, 15), (0, -1, 0), 1.0), ((0, 20, 15), (-1, 0, 0), 1.0),
    ((60, 34, 15), (1, 0, 0), 1e-6),
]  # fmt: skip
_FEATURES = """
[[feature]]
name = "top"
faces = [6]
datum = "A"
[[feature]]
name = "front"
faces = [3]
datum = "B"
[[feature]]
name = "left"
faces = [1]
datum = "C"
[[feature]]
name = "bore"
faces = [7]
characteristic = [
    {kind = "position", datums = ["A", "B", "C"], tolerance_mm = 0.5},
    {kind = "position", name = "free", tolerance_mm = 9},
]
"""


@needs_cascadio
@pytest.mark.parametrize(
    ("alignment", "shift_mm", "turn_deg", "search"),
    [
        ("best-fit", 9.0, 4.0, "20mm,8deg"),
        ("best-fit", 0.3, 0.2, None),
        ("rps", 0.5, 0.5, None),
        ("none", 0.3, 0.2, None),
    ],
)
def test_a_displaced_part_is_aligned(
    run_cell: RunCommand, tmp_path: Path, alignment: str, shift_mm: float, turn_deg: float, search: str | None
) -> None:
    """The motion in features.json undoes a known one, though a side is raised by 0.4 and the bore is moved by 0.1."""
    (tmp_path / "block.stp").write_text(bored_block())
    points_of_rps = "".join(
        f"[[inspection.rps]]\npoint_mm = {list(at)}\ndirection = {list(along)}\nweight = {weight}\n"
        for at, along, weight in _RPS
    )
    (tmp_path / "block.toml").write_text(
        f'[part]\npath = "block.stp"\n[inspection]\nalignment = "{alignment}"\n{points_of_rps}{_FEATURES}'
    )
    part, rng = load(tmp_path / "block.stp"), np.random.default_rng(0)
    samples = draw_samples(part.reference, part.reference, 10_000, rng)
    points = 1000 * samples.points + 0.003 * rng.standard_normal((10_000, 1)) * samples.normals
    points[(points[:, 0] > 59.9) & (points[:, 1] > 28), 0] += 0.4
    points[np.linalg.norm(points[:, :2] - [30, 20], axis=1) < 8.02, 0] += 0.1
    axis = np.array([0.5, -0.3, 0.8]) / np.linalg.norm([0.5, -0.3, 0.8])
    T = motion_from_vector(np.concatenate([shift_mm * axis[::-1], np.radians(turn_deg) * axis]), 1000 * part.centre)
    np.savetxt(tmp_path / "points.xyz", transform_points(T, points), fmt="%.6f")
    words = ("inspect", "points.xyz", "--points-units", "mm", "--scene", "block.toml", "--out", "checked", "--json")
    found = json.loads(run_cell(*words, *(["--search", search] if search else []), cwd=tmp_path, code=0).stdout)
    corners = 1000 * part.reference.vertices
    back = transform_points(np.array(found["T_part_points"]), transform_points(T, corners))
    off = np.linalg.norm(back - corners, axis=1).max()
    expected = np.linalg.norm(transform_points(T, corners) - corners, axis=1).max()
    if alignment == "none":
        assert off == pytest.approx(expected, abs=1e-6)
    else:
        assert off < {"best-fit": 0.01, "rps": 0.02}[alignment]
    values = {each["name"]: each["value"] for each in found["characteristics"]}
    assert values["bore: position"] == pytest.approx(0.2, abs=0.02)  # by its datums in every alignment
    free = (
        0.2
        if alignment != "none"
        else 2 * np.linalg.norm((transform_points(T, [[30.1, 20, 15]]) - [30, 20, 15])[:, :2])
    )
    assert values["free"] == pytest.approx(free, abs=0.03 if alignment != "none" else 0.15)


_UNCERTAIN = """
[part]
path = "block.stp"
[[feature]]
name = "top"
faces = [6]
characteristic = [{kind = "form", name = "too narrow", tolerance_mm = 0.01}]
[[feature]]
name = "right"
faces = [2]
datum = "A"
[[feature]]
name = "left"
faces = [1]
characteristic = [{kind = "parallelism", datums = ["A"], tolerance_mm = 0.276}]
[[feature]]
name = "slot"
faces = [1, 2]
kind = "width"
"""


@needs_cascadio
def test_views_are_added_until_u_is_within_its_limit(run_cell: RunCommand, tmp_path: Path) -> None:
    """Two views measure the coverage, but not the datum. Once it is measured, 1.7 times as many points are needed.

    The bound is that of the coverage alone: that of the integer programme over the run folder's matrix.
    """
    (tmp_path / "block.stp").write_text(bored_block())
    (tmp_path / "block.toml").write_text(_UNCERTAIN)
    words = ("--place", "1100,400,100", "--faces", "60", "--samples", "2", "--seed", "3", "--candidates", "grown")
    words += ("--effort", "0", "--coverage", "0.6", "--out", "run")
    message = run_cell("plan", "--scene", "block.toml", *words, cwd=tmp_path, code=0).stderr
    (sentence,) = (line for line in message.splitlines() if "times as many points" in line)
    assert "too narrow: about" in sentence
    assert "left: parallelism" not in message
    found = json.loads((tmp_path / "run" / "uncertainty.json").read_text())["characteristics"]
    u = {each["name"]: each["expanded_uncertainty"] for each in found}
    assert u["left: parallelism"] <= 0.0276
    assert u["too narrow"] > 0.001
    run, plan = open_finished(tmp_path / "run"), json.loads((tmp_path / "run" / "plan.json").read_text())
    M, areas = run.measurability.matrix().tocsc(), run.measurability.samples.areas
    fewest = fewest_views(M[:, run.reach.reachable], areas, plan["coverage"]["target_on_samples"] - 1e-9)
    assert len(plan["views"]) > fewest
    assert 1 <= plan["lower_bound"] <= fewest
    features = json.loads((tmp_path / "run" / "features.json").read_text())["features"]
    (patch,) = next(each for each in features if each["name"] == "right")["patches"]
    own = np.isin(run.measurability.samples.face, patch["triangles"])
    by_two = M[:, [view["id"] for view in plan["views"]]].sum(axis=1) >= 2
    assert areas[own & by_two].sum() >= 0.6 * areas[own].sum()
