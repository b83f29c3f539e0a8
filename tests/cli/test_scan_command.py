"""`cell scan` on the command line: execution folder, numbers, reproducible bytes, stopped executions."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.cli.terminal import Terminal
from cell.errors import DriverFailureError, FileError
from cell.runs import folder as process
from cell.runs import ply
from cell.runs.run import Run, open_run, read_execution, read_scan
from cell.runs.schema import Manifest
from cell.scan import results
from cell.scan import scan as scan_command
from cell.scan.options import ScanOptions
from cell.scan.results import ScanOutcome
from cell.session import Session
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.ports import Rejection
from tests.support.fixture_types import RunCommand, StartCommand

CONTRACT = {
    "manifest.json", "events.jsonl", "cloud.ply", "mesh.ply", "report.json", "report.md", "view.html",
    "views.png", "cover.png", "deviation.png",
}  # fmt: skip


@pytest.fixture
def copied(executed: Path, tmp_path: Path) -> Path:
    """Return a copy of the executed run whose execution looks killed: status running, no sha256."""
    run = Path(shutil.copytree(executed, tmp_path / "run"))
    path = run / "executions" / "0001" / "manifest.json"
    manifest = json.loads(path.read_text())
    for name in ("artefacts", "exit_code", "motion_s"):
        manifest.pop(name)
    path.write_text(json.dumps({**manifest, "status": "running"}))
    return run


def _without_schema(folder: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    assert report.pop("schema") == "scan-cell/run/3"
    return report


def _scan(run: Path, **options: Any) -> ScanOutcome:
    """Execute a scan in this process, at 1 degree by default."""
    requests = ScanOptions(**{"resolution_deg": 1.0, **options})
    return scan_command.scan(Session(None, Terminal(quiet_stdout=True)), run, requests)


def _remake(run: Path, execution: str = "0001") -> dict[str, Any]:
    return results.make_report(Session(None, Terminal(quiet_stdout=True)), run, execution).report


def _rewrite(path: Path, **changed: Any) -> None:
    with np.load(path) as stored:
        content = {name: stored[name] for name in stored.files}
    np.savez_compressed(path, **{**content, **changed})


def test_the_execution_is_complete_and_its_manifest_true(executed: Path) -> None:
    """Every file is present with the sha256 of the manifest, and the status is finished."""
    folder = executed / "executions" / "0001"
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    n_views = len(json.loads((executed / "plan.json").read_text())["views"])
    assert files == CONTRACT | {f"scans/{k:04d}.npz" for k in range(1, n_views + 1)}
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (manifest["status"], manifest["exit_code"], manifest["schema"]) == ("finished", 0, "scan-cell/run/3")
    assert set(manifest["artefacts"]) == files - {"manifest.json", "events.jsonl"}
    for name, digest in manifest["artefacts"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name


def test_one_json_object_on_stdout_is_the_report(executed: Path) -> None:
    """The output of `--json` equals the content of report.json."""
    assert json.loads((executed.parent / "scan.json").read_text()) == _without_schema(executed / "executions" / "0001")


def test_the_plan_stays_untouched(executed: Path, planned: Path) -> None:
    """The files of the plan are unchanged, and only executions/ is added."""
    names = {path.name for path in executed.iterdir()}
    assert names == {path.name for path in planned.iterdir()} | {"executions"}
    for name in names - {"executions"}:
        assert (executed / name).read_bytes() == (planned / name).read_bytes(), name


def test_without_pose_error_reported_equals_commanded_and_the_plan(executed: Path) -> None:
    """Joint angles are equal to the last bit. Poses of scans and plan are equal to 1e-12."""
    plan = json.loads((executed / "plan.json").read_text())
    for stop, view in enumerate(plan["views"], start=1):
        scan = read_scan(executed / "executions" / "0001" / "scans" / f"{stop:04d}.npz")
        assert scan.view == view["id"]
        assert (scan.q_commanded == scan.q_reported).all()
        assert np.degrees(scan.q_commanded).round(4).tolist() == view["q_deg"]
        assert (scan.stored["T_object_scanner"] == scan.stored["T_object_scanner_true"]).all()
        np.testing.assert_allclose(scan.stored["T_object_scanner"], view["T_object_scanner"], atol=1e-12)


def test_points_lie_on_the_part_and_rays_are_all_accounted_for(executed: Path) -> None:
    """Each point is on the plane of its face of reference.ply. The counts of the codes sum to the grid of 60 x 60."""
    mesh = trimesh.load(executed / "reference.ply", process=False)
    for path in sorted((executed / "executions" / "0001" / "scans").iterdir()):
        scan = read_scan(path)
        corners = mesh.triangles[scan.stored["face"]] / 1000
        height = np.einsum("nj,nj->n", scan.points - corners[:, 0], mesh.face_normals[scan.stored["face"]])
        assert np.abs(height).max() < 1e-6
        counts = np.bincount(scan.stored["codes"], minlength=len(Rejection))
        assert (counts == scan.stored["counts"]).all()
        assert counts.sum() == 3600
        assert (np.flatnonzero(scan.stored["codes"] == Rejection.MEASURED) == scan.stored["pixel"]).all()


def test_achieved_visible_coverage_is_the_predicted_one(executed: Path) -> None:
    """Without pose error the executed poses measure exactly the samples that the plan predicts."""
    report = _without_schema(executed / "executions" / "0001")
    planned = json.loads((executed / "plan.json").read_text())["coverage"]
    coverage = report["coverage"]
    assert coverage["visible"] == coverage["predicted"] == planned["visible"]
    assert sum(view["marginal_coverage"] for view in report["views"]) == pytest.approx(planned["visible"], abs=1e-12)
    assert 0 < coverage["sampled"] < 1
    assert coverage["sampled_radius_mm"] == pytest.approx(
        0.01 * np.linalg.norm(np.ptp(trimesh.load(executed / "reference.ply").vertices, axis=0)), rel=1e-6
    )


def test_cloud_and_mesh_are_readable_and_agree_with_the_report(executed: Path) -> None:
    """The cloud is PLY in mm with unit normals and the view of each point. The mesh is close to the reference."""
    folder = executed / "executions" / "0001"
    report = _without_schema(folder)
    content = (folder / "cloud.ply").read_bytes()
    header, _, body = content.partition(b"end_header\n")
    assert f"element vertex {report['n_points']}".encode() in header
    kinds = [*((name, "<f8") for name in "xyz"), *((name, "<f4") for name in ("nx", "ny", "nz")), ("view", "<i4")]
    kinds += [("scalar_view", "<f4"), ("scalar_sigma_mm", "<f4")]
    rows = np.frombuffer(body, dtype=kinds)
    scans = [read_scan(path) for path in sorted((folder / "scans").iterdir())]
    points = np.concatenate([scan.points for scan in scans])
    np.testing.assert_allclose(np.stack([rows[axis] for axis in "xyz"], axis=1), points * 1000, atol=1e-9)
    assert rows["view"].tolist() == np.repeat(np.arange(1, len(scans) + 1), [len(s.points) for s in scans]).tolist()
    length = np.sqrt(rows["nx"] ** 2 + rows["ny"] ** 2 + rows["nz"] ** 2)
    np.testing.assert_allclose(length, 1, atol=1e-5)
    assert (rows["scalar_view"] == rows["view"]).all()
    mesh = trimesh.load(folder / "mesh.ply", process=False)
    assert len(mesh.faces) == report["surface"]["faces"] > 500
    off = ply.elements((folder / "mesh.ply").read_bytes())["vertex"]["scalar_deviation_mm"]
    assert report["deviation"]["rms_mm"] < 0.5
    reference = trimesh.load(executed / "reference.ply")
    near = ClosestPointQuery(TriangleMesh(np.array(reference.vertices), np.array(reference.faces, dtype=np.int32)))
    np.testing.assert_allclose(off, near.signed_distance(np.array(mesh.vertices)), atol=1e-4)
    assert np.abs(mesh.bounds - reference.bounds).max() < 5.0


@pytest.mark.usefixtures("drawn_pictures")
def test_equal_seed_gives_equal_bytes(executed: Path, tmp_path: Path) -> None:
    """A second execution in this process has the same sha256 for scans, cloud, mesh, report and pictures."""
    again = Path(shutil.copytree(executed, tmp_path / "run"))
    outcome = _scan(again)
    assert outcome.folder.name == "0002"
    first, second = (
        json.loads((again / "executions" / name / "manifest.json").read_text())["artefacts"]
        for name in ("0001", "0002")
    )
    assert first == second


@pytest.mark.usefixtures("drawn_pictures")
def test_a_report_made_again_is_the_same(executed: Path, tmp_path: Path) -> None:
    """`--report` on a finished execution changes no byte of any artefact."""
    again = Path(shutil.copytree(executed, tmp_path / "run"))
    path = again / "executions" / "0001" / "manifest.json"
    before = json.loads(path.read_text())
    _remake(again, "latest")
    after = json.loads(path.read_text())
    assert after["artefacts"] == before["artefacts"]
    assert (after["status"], after["exit_code"]) == ("finished", 0)


def test_report_files_hold_no_clock_value(executed: Path) -> None:
    """The date of the execution is in its manifest and its events, not in report.md and report.json."""
    folder = executed / "executions" / "0001"
    day = json.loads((folder / "manifest.json").read_text())["start_time"][:10]
    for name in ("report.md", "report.json"):
        assert day not in (folder / name).read_text()
    assert day in (folder / "events.jsonl").read_text()


def test_one_view_is_scanned_as_in_the_whole_execution(executed: Path, tmp_path: Path) -> None:
    """`--view 2` gives the same scan. The prediction is that of the view, and the executed motion is stored."""
    run = Path(shutil.copytree(executed, tmp_path / "run"))
    outcome = _scan(run, view=2)
    scans = sorted((outcome.folder / "scans").iterdir())
    assert [path.name for path in scans] == ["0002.npz"]
    assert scans[0].read_bytes() == (run / "executions" / "0001" / "scans" / "0002.npz").read_bytes()
    coverage = outcome.report.coverage
    assert coverage.visible == coverage.predicted < coverage.predicted_all_views
    assert outcome.report.complete
    recorded = read_execution(open_run(run), outcome.folder.name)
    assert recorded.motion is not None
    assert recorded.motion.duration == pytest.approx(outcome.report.motion.planned_s)
    assert outcome.report.motion.executed_s == pytest.approx(recorded.motion.duration, abs=1e-4)


def test_pose_error_is_compensated_by_registration(executed: Path, tmp_path: Path) -> None:
    """With 0.5 mm and 0.1 deg, the distance to the reference decreases at least 4 times. Commands are unchanged."""
    run = Path(shutil.copytree(executed, tmp_path / "run"))
    outcome = _scan(run, pose_error_mm=0.5, pose_error_deg=0.1, range_noise_mm=0.02, seed=9)
    cloud = outcome.report.cloud
    assert cloud.rms_to_reference_as_reported_mm > 0.3
    assert cloud.rms_to_reference_mm < cloud.rms_to_reference_as_reported_mm / 4
    for view in outcome.report.views:
        assert view.reported_minus_commanded_deg == 0
        assert view.determined_error_after_mm < view.determined_error_mm / 4
        assert (view.undetermined_error_mm == 0) == (view.free_directions == 0)
    assert "undetermined mm" in (outcome.folder / "report.md").read_text()
    assert "as reported" in (outcome.folder / "report.md").read_text()
    one = read_scan(outcome.folder / "scans" / "0001.npz")
    assert (one.q_commanded == one.q_reported).all()
    assert (one.stored["T_object_scanner"] != one.stored["T_object_scanner_true"]).any()
    raw = _scan(run, pose_error_mm=0.5, pose_error_deg=0.1, range_noise_mm=0.02, seed=9, registration=False)
    assert raw.report.registration is None
    assert raw.report.cloud.rms_to_reference_mm == cloud.rms_to_reference_as_reported_mm
    assert raw.report.deviation.rms_mm > 1.5 * outcome.report.deviation.rms_mm


def test_closed_holes_are_marked_and_reported(copied: Path) -> None:
    """The closing faces are marked in mesh.ply, are reported separately and are the difference to the open mesh."""
    open_faces = _without_schema(copied / "executions" / "0001")["surface"]["faces"]
    outcome = _scan(copied, close_holes=True)
    model = outcome.report.surface
    assert model.closed_faces > 0
    assert model.faces == open_faces + model.closed_faces
    body = (outcome.folder / "mesh.ply").read_bytes().partition(b"end_header\n")[2]
    faces = np.frombuffer(body[28 * model.vertices :], dtype=[("n", "u1"), ("v", "<i4", 3), ("closed", "u1")])
    assert faces["closed"].sum() == model.closed_faces
    apart = outcome.report.deviation.closed_holes
    page = (outcome.folder / "report.md").read_text()
    assert "are not measured, are marked `closed` in mesh.ply, and do not count in the deviation below" in page
    assert f"deviate by {apart.rms_mm:.4f} mm rms, by {apart.max_mm:.4f} mm at most" in page


def test_an_execution_that_sees_nothing_is_reported(copied: Path) -> None:
    """With the scanner metres off, the scan is empty, nothing is measured, and the report states both."""
    outcome = _scan(copied, pose_error_mm=5000.0, view=1)
    assert outcome.report.n_points == 0
    assert outcome.report.registration.uncorrected_scans == 1
    assert outcome.report.coverage.visible == outcome.report.coverage.sampled == 0
    assert outcome.report.deviation is None
    text = (outcome.folder / "report.md").read_text()
    assert "View 1 has no point of the part." in text
    assert "No surface" in text
    assert "1 scan of 1 could not be registered and stayed at the reported pose" in text
    assert not (outcome.folder / "mesh.ply").exists()


def test_one_empty_scan_among_others_is_reported_and_the_others_are_used(copied: Path) -> None:
    """An empty view is in the table with no point, and the surface is made from the other views."""
    path = copied / "executions" / "0001" / "scans" / "0002.npz"
    counts = np.zeros(len(Rejection), dtype=np.int64)
    counts[Rejection.NO_HIT] = 3600
    none = np.empty(0, dtype=np.int32)
    _rewrite(path, points=np.empty((0, 3)), face=none, pixel=none, counts=counts)
    summary = _remake(copied)
    assert summary.complete
    assert summary.views[1].points == 0
    assert summary.deviation is not None
    assert "View 2 has no point" in (copied / "executions" / "0001" / "report.md").read_text()


def test_a_truncated_scan_and_one_with_nan_are_named_and_left_out(copied: Path) -> None:
    """The report is made from the other views. Page and JSON name the two files and the cause."""
    scans = copied / "executions" / "0001" / "scans"
    (scans / "0002.npz").write_bytes((scans / "0002.npz").read_bytes()[:200])
    points = read_scan(scans / "0003.npz").points.copy()
    points[4, 1] = np.nan
    _rewrite(scans / "0003.npz", points=points)
    summary = _remake(copied)
    assert not summary.complete
    assert summary.missing_views == (2, 3)
    cut, nan = summary.unusable_files
    assert cut.startswith("scans/0002.npz is damaged or cut short")
    assert nan.startswith("scans/0003.npz is damaged: points contains NaN")
    assert [view.number for view in summary.views] == [1, *range(4, summary.n_views_planned + 1)]
    assert summary.coverage.visible == summary.coverage.predicted
    assert summary.coverage.visible < summary.coverage.predicted_all_views
    text = (copied / "executions" / "0001" / "report.md").read_text()
    assert "Not complete" in text
    assert "view 2, 3" in text
    assert "Unusable: scans/0002.npz" in text
    assert str(copied) not in text
    manifest = json.loads((copied / "executions" / "0001" / "manifest.json").read_text())
    assert manifest["status"] == "incomplete"


def test_a_scan_that_was_changed_afterwards_is_left_out(executed: Path, tmp_path: Path) -> None:
    """A scan whose content differs from the manifest of a finished execution is not used."""
    run = Path(shutil.copytree(executed, tmp_path / "run"))
    path = run / "executions" / "0001" / "scans" / "0001.npz"
    _rewrite(path, points=read_scan(path).points + 1e-3)
    summary = _remake(run)
    assert summary.missing_views == (1,)
    assert "Scan again with `cell scan RUN --view 1`" in (run / "executions" / "0001" / "report.md").read_text()
    assert "is not the file that the execution wrote" in summary.unusable_files[0]


def test_a_scan_file_that_is_not_that_of_its_view_is_named_and_left_out(copied: Path) -> None:
    """Scans of an invalid stop, of another file, of another candidate and of a repeated stop are named and not used."""
    scans = copied / "executions" / "0001" / "scans"
    n = len(json.loads((copied / "plan.json").read_text())["views"])
    _rewrite(scans / "0001.npz", stop=np.array(n + 7))
    _rewrite(scans / "0002.npz", view=np.array(10**6))
    _rewrite(scans / "0003.npz", stop=np.array(4))
    shutil.copy(scans / "0004.npz", scans / "copy.npz")
    summary = _remake(copied)
    assert summary.missing_views == (1, 2, 3)
    assert [view.number for view in summary.views] == list(range(4, n + 1))
    assert [sentence.split(" ")[0] for sentence in summary.unusable_files] == [
        "scans/0001.npz", "scans/0002.npz", "scans/0003.npz", "scans/copy.npz",
    ]  # fmt: skip
    assert f"views 1 to {n}" in summary.unusable_files[0]
    assert "candidate 1000000" in summary.unusable_files[1]
    assert "whose file is 0004.npz" in summary.unusable_files[2]


def test_a_damaged_manifest_of_an_execution_is_reported_and_the_scans_are_used(copied: Path) -> None:
    """Invalid JSON and entries of wrong type are reported in left_out, and the report is made from the scans."""
    path = copied / "executions" / "0001" / "manifest.json"
    good = json.loads(path.read_text())
    for content in ("{", json.dumps({**good, "seed": "three"}), json.dumps({**good, "options": [1]})):
        path.write_text(content)
        summary = _remake(copied)
        assert summary.n_views == summary.n_views_planned
        (sentence,) = summary.unusable_files
        assert sentence.startswith("manifest.json is damaged")
        assert sentence.endswith("the report is made without it")
        assert json.loads(path.read_text())["status"] == "incomplete"


@pytest.mark.skipif(os.name != "posix", reason="processes")
def test_an_execution_that_still_runs_is_not_reported_and_that_of_a_dead_process_is(copied: Path) -> None:
    """While the process of an execution is alive, nothing is changed. After its end the report is made."""
    path = copied / "executions" / "0001" / "manifest.json"
    manifest = json.loads(path.read_text())
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    here = process.with_process(Manifest())
    entries = Manifest(pid=child.pid, pid_start=process._stat(child.pid)[1], machine=here.machine)
    for living in (here, entries):
        path.write_text(json.dumps({**manifest, **living.as_json()}))
        before = path.read_bytes()
        with pytest.raises(FileError, match=f"still running .process {living.pid}"):
            _remake(copied)
        assert path.read_bytes() == before
    assert not process.is_running(here.but(machine=f"{here.machine}-other"))
    child.communicate()
    assert not process.is_running(entries)
    assert _remake(copied).complete


def test_moves_that_the_controller_refuses_leave_no_execution(planned: Path) -> None:
    """Start and steps of all path segments are checked before a folder is created."""
    with pytest.raises(DriverFailureError, match="nothing was moved"):
        _scan(planned, driver="sim://?start=0,-80,90,0,90,0")
    assert not (planned / "executions").exists()


def test_the_columns_of_the_table_of_scans_add_up_to_the_rays(copied: Path) -> None:
    """Points and rejections of each row sum to the 3600 rays, also with rejections that are rare."""
    path = copied / "executions" / "0001" / "scans" / "0002.npz"
    counts = read_scan(path).stored["counts"].copy()
    most = 1 + int(np.argmax(counts[1:8]))
    moved = int(counts[most]) // 2
    counts[most] -= moved
    counts[Rejection.OUT_OF_SENSOR_FOV] += moved
    assert moved > 0
    _rewrite(path, counts=counts)
    summary = _remake(copied)
    lines = (copied / "executions" / "0001" / "report.md").read_text().partition("## Scans in driving order")[2]
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines.splitlines() if line.startswith("|")]
    points = table[0].index("points")
    assert "outside the sensor's field of view" in table[0]
    assert "too uncertain" not in table[0]
    assert len(table) == 2 + summary.n_views
    for row in table[2:]:
        assert sum(int(cell.replace(",", "")) for cell in row[points:]) == 3600


@pytest.mark.parametrize("entry", [{"seed": "three"}, {"seed": -1}, {"artefacts": []}, {"status": 5}])
def test_a_damaged_value_in_the_manifest_of_the_plan_is_a_file_error(copied: Path, entry: dict[str, Any]) -> None:
    """The error names the entry, for a new scan and for a report."""
    path = copied / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **entry}))
    for work in (_scan, _remake):
        with pytest.raises(FileError, match=f"damaged: {next(iter(entry))} is"):
            work(copied)


def test_executions_are_those_with_a_number_in_order_of_it(tmp_path: Path) -> None:
    """Folders with a number are executions, in numerical order. "latest" is the highest number."""
    for name in ("9999", "10000", "0002", "notes", "0001.bak"):
        (tmp_path / "executions" / name).mkdir(parents=True)
    (tmp_path / "executions" / "20000").write_text("")
    run = Run(tmp_path, Manifest())
    assert run.execution_ids == ["0002", "9999", "10000"]
    assert read_execution(run, "latest").folder.name == "10000"


def test_an_execution_without_any_scan_is_reported(copied: Path) -> None:
    """After a kill before the first scan, all views are missing, the coverage is zero, and no picture remains."""
    folder = copied / "executions" / "0001"
    shutil.rmtree(folder / "scans")
    (folder / "scans").mkdir()
    summary = _remake(copied)
    assert results.make_report(Session(None, Terminal(quiet_stdout=True)), copied, "0001").exit_code == 6
    assert summary.missing_views == tuple(range(1, summary.n_views_planned + 1))
    assert summary.coverage.visible == 0
    assert not list(folder.glob("*.png"))
    assert not (folder / "mesh.ply").exists()


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_stopped_execution_keeps_its_scans_and_is_reported(
    how: signal.Signals, planned: Path, tmp_path: Path, run_cell: RunCommand, start_cell: StartCommand
) -> None:
    """If stopped after the first scan, status and exit code report it, and `--report` uses the available scans."""
    run = Path(shutil.copytree(planned, tmp_path / "run"))
    process = start_cell("scan", "run", "--resolution", "2", "--realtime", cwd=tmp_path)
    folder = run / "executions" / "0001"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None and not (folder / "scans" / "0001.npz").exists():
        time.sleep(0.005)
    process.send_signal(how)
    _, errors = process.communicate(timeout=60)
    manifest = json.loads((folder / "manifest.json").read_text())
    if how == signal.SIGINT:
        assert process.returncode == 130, errors
        assert (manifest["status"], manifest["exit_code"]) == ("interrupted", 130)
        assert json.loads((folder / "events.jsonl").read_text().splitlines()[-1])["event"] == "interrupted"
    else:
        assert process.returncode == -signal.SIGKILL
        assert manifest["status"] == "running"
    there = len(list((folder / "scans").glob("*.npz")))
    completed = run_cell("scan", "run", "--report", "latest", "--json", cwd=tmp_path, code=6)
    summary = json.loads(completed.stdout)
    assert 1 <= summary["n_views"] == there < summary["n_views_planned"]
    assert summary["missing_views"] == list(range(there + 1, summary["n_views_planned"] + 1))
    assert "did not finish" in completed.stderr
    output = f"the execution is incomplete: {there} of {summary['n_views_planned']} views are scanned"
    assert output in completed.stderr
    after = json.loads((folder / "manifest.json").read_text())
    ended = ("interrupted", 130) if how == signal.SIGINT else ("incomplete", None)
    assert (after["status"], after["exit_code"]) == ended
    assert "pid" not in after


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("scan", "absent"), 6, "does not exist"),
        (("scan", "."), 6, "manifest.json"),
        (("scan", "run", "--view", "99"), 2, "views 1 to"),
        (("scan", "run", "--driver", "sym://"), 5, "sim://"),
        (("scan", "run", "--driver", "sim://?speed=2"), 5, "no option 'speed'"),
        (("scan", "run", "--driver", "sim://?start=0,-80,90,0,90,0"), 5, "nothing was moved"),
        (("scan", "run", "--pose-error", "0.5"), 2, "with their units"),
        (("scan", "run", "--range-noise", "-1"), 2, "--range-noise"),
        (("scan", "run", "--resolution", "0"), 2, "--resolution"),
        (("scan", "run", "--report", "0007"), 6, "0007"),
        (("scan", "run", "--report", "latest", "--view", "1"), 2, "--report"),
    ],
)
def test_bad_input_gets_one_sentence_and_its_code(
    arguments: tuple[str, ...], code: int, words: str, executed: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """The error has no traceback, names the cause, and has the documented exit code."""
    (tmp_path / "run").symlink_to(executed)
    completed = run_cell(*arguments, cwd=tmp_path, code=code)
    assert words in completed.stderr
    assert completed.stdout == ""


def test_an_unfinished_plan_is_not_executed(planned: Path, tmp_path: Path) -> None:
    """A failed run is refused, and the error names the stage in which it ended."""
    run = Path(shutil.copytree(planned, tmp_path / "run.part"))
    manifest = json.loads((run / "manifest.json").read_text())
    (run / "manifest.json").write_text(json.dumps({**manifest, "status": "failed", "stage": "reach"}))
    with pytest.raises(FileError, match="stage 'reach'"):
        _scan(run)


def test_a_required_coverage_that_is_missed_ends_with_code_3(
    planned: Path, tmp_path: Path, resealed: Callable[[Path], str]
) -> None:
    """The requirement of the plan holds for the execution, but not for a single view."""
    run = Path(shutil.copytree(planned, tmp_path / "run"))
    resolved = json.loads((run / "scene.resolved.json").read_text())
    resolved["plan"]["required_visible"] = 1.0
    (run / "scene.resolved.json").write_text(json.dumps(resolved))
    resealed(run)
    assert _scan(run, resolution_deg=3.0).exit_code == 3
    assert _scan(run, resolution_deg=3.0, view=1).exit_code == 0
