"""`cell scan --actual`: form errors of an as-built mesh appear in the deviation; the nominal part is the reference."""

import json
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell import api
from cell.errors import UsageError
from cell.part.ply_elements import read_elements
from cell.scan.results import ScanOutcome
from tests.support.fixture_types import RunCommand

SIDES = np.array([90.0, 70.0, 40.0])
RAISED = 0.2


def box(folder: Path, name: str, top: float = 0.0) -> Path:
    """Write a box in mm whose upper face is raised by `top`, and return its path."""
    mesh = trimesh.creation.box(SIDES)
    mesh.vertices[:, 2] += np.where(mesh.vertices[:, 2] > 0, top, 0.0)
    mesh.export(folder / name)
    return folder / name


@pytest.fixture(scope="module")
def box_plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the run folder of a plan of the nominal box."""
    folder = tmp_path_factory.mktemp("box")
    options = {"place": (1150, 400, 60), "faces": 60, "candidates": "optimal-scanning-zone", "out": folder / "run"}
    run = api.plan(box(folder, "box.stl"), units="mm", **options)
    assert run.exit_code == 0
    return run.folder


@pytest.fixture(scope="module")
def nominal(box_plan: Path, drawing: Callable[[], AbstractContextManager[None]]) -> ScanOutcome:
    """Return a scan of the nominal box, with its pictures."""
    with drawing():
        return api.scan(box_plan, resolution=0.8)


def test_a_raised_face_deviates_by_its_height(nominal: ScanOutcome, box_plan: Path, tmp_path: Path) -> None:
    """The upper face is 0.2 mm high in mesh.ply, the sides are exact; coverage and reference are the nominal part's."""
    actual = api.scan(box_plan, resolution=0.8, actual=box(tmp_path, "high.stl", RAISED), actual_units="mm")
    found = read_elements((actual.folder / "mesh.ply").read_bytes())["vertex"]
    points, deviation = found.columns("x", "y", "z"), found.scalars["scalar_deviation_mm"]
    inner = (np.abs(points) < SIDES / 2 - 8).sum(axis=1) == 2
    upper = inner & (points[:, 2] > SIDES[2] / 2 - 4)
    side = inner & (np.abs(points[:, 2]) < SIDES[2] / 2 - 8)
    assert min(upper.sum(), side.sum()) > 20
    assert np.abs(deviation[upper] - RAISED).max() < 0.005
    assert np.abs(deviation[side]).max() < 0.005
    assert actual.report.deviation.quantile_95_mm == pytest.approx(RAISED, abs=0.005)
    assert nominal.report.deviation.quantile_95_mm < 0.01
    assert actual.report.coverage.visible == nominal.report.coverage.visible
    assert actual.report.settings.actual == str(tmp_path / "high.stl")
    assert "as-built mesh" in (actual.folder / "report.md").read_text()


def test_numbers_with_and_without_edges_are_everywhere(nominal: ScanOutcome) -> None:
    """report.json, report.md, the page and the terminal state both."""
    from cell.report import scan_report

    note = nominal.report.deviation.edge_note
    assert "about sharp edges" in note
    assert nominal.report.deviation.with_edges.max_mm >= nominal.report.deviation.max_mm
    assert note in dict(scan_report.table(nominal.report))["surface"]
    assert note in (nominal.folder / "report.md").read_text()
    assert note in (nominal.folder / "view.html").read_text()


def test_a_resumed_execution_needs_the_same_file(box_plan: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """The file is named by its sha256; with the file the remaining views are scanned on it."""
    run = tmp_path / "run"
    shutil.copytree(box_plan, run)
    actual = box(tmp_path, "high.stl", RAISED)
    whole = api.scan(run, resolution=0.8, actual=actual, actual_units="mm")
    name = whole.folder.name
    manifest = json.loads((whole.folder / "manifest.json").read_text())
    assert manifest["options"]["actual"] == str(actual)
    last = sorted((whole.folder / "scans").glob("*.npz"))[-1]
    expected = np.load(last)["points"]
    last.unlink()
    manifest |= {
        "status": "stopped",
        "artefacts": {k: v for k, v in manifest["artefacts"].items() if last.name not in k},
    }
    (whole.folder / "manifest.json").write_text(json.dumps(manifest))
    content = actual.read_bytes()
    actual.write_bytes(box(tmp_path, "other.stl", 2 * RAISED).read_bytes())
    process = run_cell("scan", run, "--resume", name, cwd=tmp_path, code=2)
    assert "its sha256 differs" in process.stderr
    actual.write_bytes(content)
    run_cell("scan", run, "--resume", name, cwd=tmp_path, code=0)
    np.testing.assert_allclose(np.load(last)["points"], expected)


def test_an_actual_part_in_the_clearance_is_refused(box_plan: Path, tmp_path: Path) -> None:
    """A part 60 mm too high reaches into the proven motion, and no execution is left."""
    before = len(list((box_plan / "executions").glob("*"))) if (box_plan / "executions").exists() else 0
    with pytest.raises(UsageError, match=r"reaches up to 60\.00 mm outside .* mm of clearance"):
        api.scan(box_plan, actual=box(tmp_path, "tall.stl", 60.0), actual_units="mm")
    with pytest.raises(UsageError, match="give --actual-units"):
        api.scan(box_plan, actual=box(tmp_path, "tall.stl"))
    assert len(list((box_plan / "executions").glob("*"))) == before


def test_a_real_scanner_measures_the_real_part(box_plan: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """The option is refused with another source of points."""
    process = run_cell(
        "scan", box_plan, "--acquire", f"files:{tmp_path}", "--points-frame", "base", "--points-units", "mm",
        "--actual", box(tmp_path, "b.stl"), cwd=tmp_path, code=2,
    )  # fmt: skip
    assert "a real scanner measures the real part; omit --actual" in process.stderr


def test_all_setups_are_scanned_on_the_same_mesh(
    made_setups: Path, part_file: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """Each execution records the mesh; the nominal mesh as the actual one gives the points of a scan without it."""
    points = []
    for name, actual in (("plain", ()), ("actual", ("--actual", part_file, "--actual-units", "mm"))):
        shutil.copytree(made_setups, tmp_path / name)
        run_cell("scan", tmp_path / name, "--resolution", "4", *actual, cwd=tmp_path)
        scans = sorted((tmp_path / name).rglob("executions/0001/scans/0001.npz"))
        assert len(scans) >= 1
        points.append([np.load(scan)["points"] for scan in scans])
    for manifest in (tmp_path / "actual").rglob("executions/0001/manifest.json"):
        options = json.loads(manifest.read_text())["options"]
        assert (options["actual"], len(options["actual_sha256"])) == (str(part_file), 64)
    for one, other in zip(*points, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
