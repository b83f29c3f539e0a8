"""Runs of the schemas scan-cell/run/1 and scan-cell/run/2 open, verify, replay, scan, export and report."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cell.errors import FileError
from cell.runs.run import Execution, open_finished, read_execution
from cell.runs.verification import verify_plan
from tests.support.former_runs import make_former

SCHEMAS = {"scan-cell/run/1": "executed", "scan-cell/run/2": "turned"}


@pytest.fixture(params=SCHEMAS)
def former(request: pytest.FixtureRequest, tmp_path: Path, resealed: Callable[[Path], str]) -> tuple[Path, Path]:
    """Return a run of a former schema with an execution, and the run of this schema that it was made from."""
    present: Path = request.getfixturevalue(SCHEMAS[request.param])
    run = tmp_path / "run"
    shutil.copytree(present, run)
    make_former(run, request.param)
    digest = resealed(run)
    for path in (run / "executions").glob("*/manifest.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"digest": digest, "artefacts": {}}))
    return run, present


def test_it_reads_as_the_run_of_this_schema(former: tuple[Path, Path]) -> None:
    """Plan, report, scene, execution and scans have the same values under their present names."""
    run, present = (open_finished(folder) for folder in former)
    assert '"n_features"' in (former[0] / "report.json").read_text()
    assert '"at_least_mm"' in (former[0] / "plan.json").read_text()
    assert "clearance_at_least" in np.load(former[0] / "motion.npz").files
    assert (run.plan.as_json(), run.report.as_json()) == (present.plan.as_json(), present.report.as_json())
    assert run.scene.as_json() == present.scene.as_json()
    one, other = (Execution.open(folder / "executions" / "0001").report.as_json() for folder in former)
    assert one == other
    scans = [read_execution(each, "0001").scans for each in (run, present)]
    assert [scan.stop for scan in scans[0]] == [scan.stop for scan in scans[1]]
    assert all(np.array_equal(a.points, b.points) for a, b in zip(*scans, strict=True))


def test_it_is_verified_by_the_digest_of_its_own_bytes(former: tuple[Path, Path]) -> None:
    """The digest covers the files as they are stored, and a changed one is refused."""
    run, present = former
    verified = verify_plan(run)
    assert verified.digest == json.loads((run / "manifest.json").read_text())["digest"]
    assert verified.digest != json.loads((present / "manifest.json").read_text())["digest"]
    (run / "plan.json").write_text((run / "plan.json").read_text().replace('"at_least_mm": ', '"at_least_mm": 1', 1))
    with pytest.raises(FileError, match="its sha256 differs"):
        verify_plan(run)


def test_it_is_scanned_exported_and_replayed(
    former: tuple[Path, Path], run_cell: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """Each command accepts it; a scan and a program are those of the run of this schema."""
    run, present = former
    for arguments in (
        ("replay", run, "--picture", "t.png"),
        ("scan", run, "--resolution", "1"),
        ("export", run, "--format", "csv", "--name", "FORMER", "--out", "of-former"),
        ("export", present, "--format", "csv", "--name", "FORMER", "--out", "of-present"),
    ):
        process = run_cell(*map(str, arguments), cwd=run.parent)
        assert process.returncode == 0, process.stderr
    assert (run.parent / "t.png").stat().st_size > 1000
    folders = [folder / "executions" / name for folder, name in ((run, "0002"), (present, "0001"))]
    assert json.loads((folders[0] / "manifest.json").read_text())["schema"] == "scan-cell/run/3"
    assert Execution.open(folders[0]).coverage == Execution.open(folders[1]).coverage
    programs = [(run.parent / f"of-{name}" / "FORMER.csv").read_text().splitlines() for name in ("former", "present")]
    assert [line for line in programs[0] if not line.startswith("#")] == [
        line for line in programs[1] if not line.startswith("#")
    ]
