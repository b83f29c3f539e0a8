"""`cell export` end to end: files, names, errors with exit codes, reproducible bytes."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cell.errors import UsageError
from cell.export import export
from cell.export.names import check_name
from cell.runs.run import open_finished
from tests.support.fixture_types import RunCommand

_RESERVED_NAMES = (
    "PULSE", "ANIN", "ANOUT", "DIGIN", "SEC", "CHANNEL", "CONFIRM", "CCLOSE", "B_AND", "PRIO", "Tool_Data", "XHOME",
    "XHOME3", "DEF_OV_PRO", "PDEFAULT", "PGNO", "BAS_COMMAND", "CHANNEL_7", "SIN", "STRUC", "LOAD",
)  # fmt: skip


def test_files_are_written_below_the_run_folder_and_are_reproducible(
    planned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """Each call replaces `export/` and leaves the plan unchanged. Repeated exports have equal bytes and no path."""
    run = Path(shutil.copytree(planned, tmp_path / "trial"))
    before = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    process = run_cell("export", str(run), cwd=tmp_path, code=0)
    assert process.stdout.split() == [str(run / "export" / name) for name in ("trial.src", "trial.dat")]
    assert "docs/export.md" in process.stderr
    first = {path.name: path.read_bytes() for path in (run / "export").iterdir()}
    assert run_cell("export", str(run), "--settle", "1", cwd=tmp_path).returncode == 0
    assert (run / "export" / "trial.dat").read_bytes() != first["trial.dat"]
    assert run_cell("export", str(run), cwd=tmp_path).returncode == 0
    assert {path.name: path.read_bytes() for path in (run / "export").iterdir()} == first
    assert not any(str(tmp_path).encode() in content for content in first.values())
    assert {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()} == before


def test_csv_and_json_agree_with_each_other_and_with_the_plan(
    planned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """Every via point has its axes to 1e-9 deg, every view its poses of TCP and flange as in plan.json."""
    from planner.kinematics.frames import pose_from_kuka_abc

    for kind in ("csv", "json"):
        run_cell("export", str(planned), "--format", kind, "--name", "PART", "--out", "out", cwd=tmp_path, code=0)
    content = json.loads((tmp_path / "out" / "PART.json").read_text())
    with (tmp_path / "out" / "PART.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    motion, plan = np.load(planned / "motion.npz"), json.loads((planned / "plan.json").read_text())
    axes = np.array([[float(row[f"A{axis}_deg"]) for axis in range(1, 7)] for row in rows])
    np.testing.assert_allclose(axes, np.degrees(motion["via_q"]), atol=1e-9, rtol=0)
    np.testing.assert_allclose([float(row["t_s"]) for row in rows], motion["via_t"], atol=1e-6)
    assert [int(row["view"]) for row in rows if row["view"]] == list(range(1, len(plan["views"]) + 1))
    for name in ("scanner", "flange"):
        column = "tcp" if name == "scanner" else name
        poses = np.array([
            [float(row[f"{column}_{place}"]) for place in ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")]
            for row in rows if row["view"]
        ])  # fmt: skip
        T = pose_from_kuka_abc(poses[:, :3] / 1000, np.radians(poses[:, 3:]))
        np.testing.assert_allclose(T, [view[f"T_base_{name}"] for view in plan["views"]], atol=1e-7)
    assert [int(row["candidate"]) for row in rows if row["view"]] == [view["id"] for view in plan["views"]]
    for row, point in zip(rows, content["via_points"], strict=True):
        assert [point["number"], point["segment"], point["status"], point["turn"]] == [
            int(row[name]) for name in ("number", "segment", "status", "turn")
        ]
        assert point["axes_deg"] == [float(row[f"A{axis}_deg"]) for axis in range(1, 7)]
        assert point["tcp_xyz_mm_abc_deg"] == [float(row[name]) for name in row if name.startswith("tcp_")]
        assert point["kind"] == row["kind"]
    assert rows[0]["kind"] == "start"
    assert content["schema"] == "scan-cell/run/3"


def test_json_option_prints_one_object(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """Stdout is one object with the name, the speed and the files."""
    process = run_cell("export", str(planned), "--name", "A1", "--out", "x", "--speed", "0.07", "--json", cwd=tmp_path)
    outcome = json.loads(process.stdout)
    assert (outcome["name"], outcome["speed_percent"]) == ("A1", 7)
    assert [Path(name).name for name in outcome["files"]] == ["A1.src", "A1.dat"]
    assert b"BAS(#VEL_PTP,7)\r\n" in (tmp_path / "x" / "A1.src").read_bytes()


def test_default_speed_is_low_and_never_above_the_plan(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The defaults are 20 % of the speeds and 30 % of the accelerations, or the scaling of the plan if it is lower."""
    process = run_cell("export", str(planned), "--name", "A1", "--out", "x", "--json", cwd=tmp_path)
    outcome = json.loads(process.stdout)
    assert (outcome["speed_percent"], outcome["acceleration_percent"]) == (20, 30)
    source = (tmp_path / "x" / "A1.src").read_bytes()
    assert b"BAS(#VEL_PTP,20)\r\nBAS(#ACC_PTP,30)\r\n" in source
    assert [export.percent(None, default, 0.079) for default in (20, 30)] == [7, 7]
    assert export.percent(0.5, 20, 0.079) == 50
    assert [export.percent(share, 20, 1.0) for share in (0.019, 0.29, 0.57, 1.0)] == [1, 29, 57, 100]  # never faster


def test_a_folder_name_that_is_invalid_in_krl_is_replaced_by_the_digest(
    planned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """A folder name that begins with a digit and one that is a keyword are replaced."""
    for name in ("20261121T030106Z-1f0c2a9b", "pulse"):
        run = tmp_path / name
        shutil.copytree(planned, run)
        outcome = json.loads(run_cell("export", str(run), "--json", cwd=tmp_path).stdout)
        assert outcome["name"] == f"scan_{open_finished(planned).digest[:8]}"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--name", "a" * 25), "has 25 characters; a name in KRL has at most 24"),
        (("--name", "7up"), "--name 7up is not a name in KRL"),
        (("--name", "a-b"), "--name a-b is not a name in KRL"),
        (("--name", "ünder"), "is not a name in KRL"),
        (("--name", ""), "is not a name in KRL"),
        (("--name", "Lin"), "--name Lin is reserved in KRL"),
        (("--name", "BAS"), "is reserved in KRL, in $CONFIG.DAT or in the exported program"),
        (("--name", "con"), "is reserved in KRL, in $CONFIG.DAT or in the exported program"),
        (("--name", "SC_TOOL"), "is reserved in KRL, in $CONFIG.DAT or in the exported program"),
        (("--speed", "0"), "--speed is 0.0; it must be above 0"),
        (("--speed", "0.004"), "--speed is 0.004; it must be at least 0.01"),
        (("--speed", "20"), "--speed is 20; it is a share of the speed, at most 1: give 0.2 for 20 %"),
        (("--acceleration", "0"), "--acceleration is 0.0; it must be above 0"),
        (("--trigger-output", "0"), "--trigger-output is 0; in KRL it must be from 1 to 4096"),
        (("--done-input", "4097"), "--done-input is 4097; it must be at most 4096"),
        (("--timer", "0"), "--timer is 0; it must be at least 1"),
        (("--gate-output", "1"), "--gate-output is 1, as is the trigger output"),
        (("--timeout", "0"), "--timeout is 0.0; it must be at least 0.1"),
        (("--timeout", "nan"), "--timeout is nan; it must be a finite number"),
        (("--settle", "-1"), "--settle is -1.0; it must be at least 0"),
        (("--format", "karel"), "--format is 'karel'; did you mean 'krl'? valid are: krl, rapid"),
        (("--format", "rapid", "--name", "Trap"), "--name Trap is reserved in RAPID"),
        (("--format", "rapid", "--name", "scStop"), "--name scStop is reserved in RAPID or in the exported program"),
        (("--format", "rapid", "--name", "SCSTOP"), "--name SCSTOP is reserved in RAPID or in the exported program"),
        (("--format", "urscript", "--name", "halt"), "--name halt is reserved in URScript"),
        (("--format", "urscript", "--name", "Con"), "--name Con is reserved in URScript"),
        (("--format", "ls", "--name", "COM1"), "--name COM1 is reserved in LS"),
        (("--format", "ls", "--name", "pause"), "--name pause is reserved in LS"),
        (("--format", "ls", "--done-input", "0"), "--done-input is 0; in LS it must be from 1 to 4096"),
        (
            ("--format", "urscript", "--trigger-output", "8"),
            "--trigger-output is 8; in URScript it must be from 0 to 7",
        ),
    ],
)
def test_invalid_options_give_one_sentence_and_code_2(
    planned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], sentence: str
) -> None:
    """The command writes no file and prints one line."""
    from cell.cli import app
    from cell.cli.failures import report_errors

    words = ["export", str(planned), "--out", str(tmp_path / "out"), *options]
    assert report_errors(lambda: app(args=words, prog_name="cell", standalone_mode=False), as_json=False) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert (printed.out, len(printed.err.strip().splitlines())) == ("", 1)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", _RESERVED_NAMES)
def test_reserved_names_are_refused(name: str) -> None:
    """Names of KRL's statements, of $CONFIG.DAT and of KUKA's programs are no names of programs."""
    with pytest.raises(UsageError, match="is reserved in KRL"):
        check_name(name, "krl")


def test_a_changed_file_in_an_output_folder_is_not_replaced(
    planned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """With `--out`, a file with other content stays. An equal file may be written again."""
    assert run_cell("export", str(planned), "--name", "P", "--out", "out", cwd=tmp_path).returncode == 0
    assert run_cell("export", str(planned), "--name", "P", "--out", "out", cwd=tmp_path).returncode == 0
    edited = tmp_path / "out" / "P.dat"
    edited.write_bytes(edited.read_bytes().replace(b"SC_DONE=1", b"SC_DONE=9"))
    content = edited.read_bytes()
    process = run_cell("export", str(planned), "--name", "P", "--out", "out", cwd=tmp_path, code=6)
    assert "P.dat exists already with other content" in process.stderr
    assert edited.read_bytes() == content


def test_a_folder_name_cannot_inject_a_statement(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A folder name with line breaks and more characters than a KRL line stays one comment."""
    run = tmp_path / ("moved\r\nPTP {A1 170}\n" + "x" * 200 + "ü")
    shutil.copytree(planned, run)
    assert run_cell("export", str(run), "--name", "P", "--out", "out", cwd=tmp_path).returncode == 0
    source = (tmp_path / "out" / "P.src").read_bytes().decode("ascii")
    lines = source.split("\r\n")
    assert not any("\n" in line or "\r" in line for line in lines)
    assert [line[:2] for line in lines if "A1 170}" in line] == ["; "]
    assert max(map(len, lines)) <= 400


def test_runs_that_cannot_be_exported(
    planned: Path, run_cell: RunCommand, tmp_path: Path, resealed: Callable[[Path], str]
) -> None:
    """A missing, unfinished or damaged run and a run without motion have exit code 6 with the cause."""
    process = run_cell("export", "nowhere", cwd=tmp_path)
    assert (process.returncode, "the run folder nowhere does not exist" in process.stderr) == (6, True)

    unfinished = Path(shutil.copytree(planned, tmp_path / "unfinished.part"))
    manifest = json.loads((unfinished / "manifest.json").read_text())
    changed = manifest | {"status": "failed", "stage": "reach", "reason": "none is reachable"}
    (unfinished / "manifest.json").write_text(json.dumps(changed))
    process = run_cell("export", str(unfinished), cwd=tmp_path, code=6)
    assert "has no finished plan: the run failed in the stage 'reach': none is reachable" in process.stderr

    damaged = Path(shutil.copytree(planned, tmp_path / "damaged"))
    (damaged / "motion.npz").write_bytes(b"PK")
    process = run_cell("export", str(damaged), cwd=tmp_path, code=6)
    assert "is not the file that the run wrote" in process.stderr

    still = Path(shutil.copytree(planned, tmp_path / "still"))
    with np.load(still / "motion.npz") as stored:
        arrays = dict(stored)
    for name in ("via_q", "segment", "view", "via_t", "pose", "line"):
        arrays[name] = arrays[name][:1]
    np.savez_compressed(still / "motion.npz", **arrays)
    resealed(still)
    process = run_cell("export", str(still), cwd=tmp_path, code=6)
    assert "has no motion" in process.stderr
    assert not (still / "export").exists()


def test_status_and_turn_as_controllers_export_them() -> None:
    """HOME has S 2. T has a bit for each negative axis. The bits of S are shoulder, elbow and wrist of a branch."""
    from cell.export.program import status_and_turn
    from cell.robot.arm import kr16_kinematics

    kinematics = kr16_kinematics()
    q = np.radians([
        [0.0, -90.0, 90.0, 0.0, 0.0, 0.0],
        [-1.0, -90.0, 90.0, 0.0, 30.0, -5.0],
        [10.0, -90.0, 90.0, 0.0, -30.0, 5.0],
        [0.0, -130.0, -40.0, 10.0, 30.0, 0.0],
    ])  # fmt: skip
    status, turn = status_and_turn(q, kinematics)
    assert status.tolist()[:3] == [2, 2, 6]
    assert turn.tolist() == [2, 35, 18, 6]
    branches = kinematics.inverse(kinematics.forward(np.radians([[12.0, -75, 110, 35, -60, 140]])))[0]
    status, _ = status_and_turn(branches, kinematics)
    slots = np.arange(8)
    expected = (slots // 4) + 2 * (1 - slots // 2 % 2) + 4 * (slots % 2)
    real = ~np.isnan(branches).any(axis=1)
    assert real.sum() >= 4
    assert status[real].tolist() == expected[real].tolist()
