"""`cell plan` on the command line: output, run folder, reproducible bytes, exit codes and errors for invalid input."""

import json
import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.fixture_types import RunCommand, StartCommand

_QUICK = ("--candidates", "optimal-scanning-zone")

CONTRACT = {
    "manifest.json", "run.log", "scene.toml", "scene.resolved.json", "reference.ply", "planning.ply", "cell.xml",
    "viewpoints.npz", "reach.npz", "measurability.npz", "plan.json", "motion.npz", "report.md", "report.json",
    "view.html", "cell.png", "views.png", "cover.png", "reach.png", "motion.png",
}  # fmt: skip


def test_the_run_folder_is_complete_and_its_manifest_true(planned: Path) -> None:
    """Every file of the contract exists with the sha256 of the manifest, and the run is finished."""
    import hashlib

    names = {path.name for path in planned.iterdir()}
    assert names >= CONTRACT
    manifest = json.loads((planned / "manifest.json").read_text())
    assert (manifest["status"], manifest["exit_code"], manifest["seed"]) == ("finished", 0, 3)
    listed = manifest["artefacts"]
    assert set(listed) == names - {"manifest.json", "run.log"}
    for name, digest in listed.items():
        assert hashlib.sha256((planned / name).read_bytes()).hexdigest() == digest, name
    for name in ("manifest.json", "scene.resolved.json", "plan.json", "report.json"):
        assert json.loads((planned / name).read_text())["schema"] == "scan-cell/run/3"


@pytest.mark.usefixtures("full_effort", "drawn_pictures")
def test_equal_input_and_seed_give_equal_bytes(
    part_file: Path, tmp_path: Path, start_cell: StartCommand, run_cell: RunCommand, small_plan: tuple[str, ...]
) -> None:
    """A second run in another process and folder, with the matrix from the cache, has equal artefacts."""
    command = ("plan", part_file, "--units", "mm", *small_plan, "--faces", "40", "--coverage", "0.9", "--out")
    (tmp_path / "elsewhere").mkdir()
    run_cell(*command, "run", cwd=tmp_path, code=0)
    process = start_cell(*command, "again", cwd=tmp_path / "elsewhere")
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    runs = tmp_path / "run", tmp_path / "elsewhere" / "again"
    first, second = (json.loads((run / "manifest.json").read_text()) for run in runs)
    assert first["artefacts"] == second["artefacts"]


def test_a_coverage_is_kept_where_the_samples_were_too_few(
    part_file: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """With few faces, one sample each and 99.9 %, samples are added where the plan fails, also in the matrix."""
    process = run_cell(
        "plan", str(part_file), "--units", "mm", "--place", "1100,400,100", "--faces", "40", "--samples", "1",
        "--standoff", "250", "--coverage", "0.999", "--json", "--out", "run", cwd=tmp_path,
    )  # fmt: skip
    report = json.loads(process.stdout)
    assert process.returncode == 0, process.stderr
    assert report["coverage"]["visible_of_coverable"] >= 0.999
    with np.load(tmp_path / "run" / "measurability.npz") as stored:
        assert stored["shape"][0] == report["n_samples"] > 40


def test_json_prints_one_object_on_stdout(planned: Path) -> None:
    """The report has the number of views, its bound and coverages as fractions."""
    summary = json.loads((planned / "report.json").read_text())
    assert summary["lower_bound"] <= summary["n_views"]
    assert 0.5 < summary["coverage"]["visible"] <= summary["coverage"]["coverable"] <= 1.0
    assert len(summary["views"]) == summary["n_views"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("plan", "no_such.stl", "--units", "mm"), 6, "no_such.stl"),
        (("plan", "PART", "--place", "1200,500,0"), 2, "mm, cm, m, um or in"),
        (("plan", "PART", "--units", "furlong"), 2, "mm"),
        (("plan", "text.stl", "--units", "mm"), 6, "text.stl"),
        (("plan", "nan.ply", "--units", "mm"), 6, "nan.ply"),
        (("plan", "empty.obj", "--units", "mm"), 6, "empty.obj"),
        (("plan", ".", "--units", "mm"), 6, "."),
        (("plan", "mzeke"), 2, "mseke"),
        (("plan", "mseke", "--units", "mm"), 2, "--units"),
        (("plan", "PART", "--units", "mm", "--place", "1200,500"), 2, "--place"),
        (("plan", "PART", "--units", "mm", "--scene", "typo.toml"), 2, "did you mean"),
        (("plan", "PART", "--units", "mm", "--scene", "absent.toml"), 2, "absent.toml"),
        (("plan", "PART", "--units", "mm", "--scene", "short_range.toml", "--standoff", "600"), 2, "range"),
        (("plan", "PART", "--units", "mm", "--faces", "100", "--percent", "5"), 2, "one of them"),
        (("plan", "PART", "--units", "mm", "--coverage", "1.2"), 2, "coverage"),
        (("plan", "PART", "--units", "mm", "--solver", "magic"), 2, "solver"),
        (("plan", "PART", "--units", "mm", "--out", "taken"), 6, "taken"),
        (("plan", "PART", "--units", "mm", "--out", "."), 6, "has no name"),
        (("plan", "PART", "--units", "mm", "--bogus"), 2, "No such option"),
        (("plan", "PART", "--units", "mm", "--seed", "1.5"), 2, "--seed"),
        (("plan", "PART", "--units", "mm", "--speed", "1.5"), 2, "--speed is 1.5; it must be at most 1"),
        (("plan", "PART", "another.stl"), 2, "another.stl"),
        (("plan", "PART", "--units", "mm", "--scene", "no_clearance.toml"), 2, "clearance_mm is 0"),
        (("plan", "PART", "--units", "mm", "--scene", "blind.toml"), 2, "own field of view"),
    ],
)  # fmt: skip
def test_bad_input_gets_one_sentence_and_its_code(
    arguments: tuple[str, ...],
    code: int,
    words: str,
    part_file: Path,
    tmp_path: Path,
    run_cell: RunCommand,
    blob: Callable[[int], Any],
) -> None:
    """The error has no traceback, names the cause, and has the documented exit code."""
    (tmp_path / "text.stl").write_text("this is no mesh\n")
    (tmp_path / "empty.obj").write_text("# nothing\n")
    mesh = blob(1)
    mesh.vertices[3, 1] = np.nan
    (tmp_path / "nan.ply").write_bytes(mesh.export(file_type="ply"))
    (tmp_path / "typo.toml").write_text("[scaner]\nbaseline_mm = 5\n")
    (tmp_path / "short_range.toml").write_text("[scanner]\nrange_mm = [100, 400]\n")
    (tmp_path / "no_clearance.toml").write_text("clearance_mm = 0\n")
    (tmp_path / "blind.toml").write_text("[housing]\nposition_mm = [0, 0, 100]\n")
    (tmp_path / "taken").mkdir()
    quick = ("--faces", "60") if "--faces" not in arguments else ()
    process = run_cell(
        *(str(part_file) if word == "PART" else word for word in arguments), *quick, *_QUICK, cwd=tmp_path, code=code
    )
    assert "Traceback" not in process.stderr
    assert words in process.stderr
    assert process.stdout == ""


def test_a_failed_run_keeps_its_folder_with_status_and_stage(
    part_file: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """If nothing is reachable, the folder stays as .part. Manifest and JSON object have the status and the reason."""
    process = run_cell(
        "plan", str(part_file), "--units", "mm", "--place", "9000,0,0", "--faces", "60", *_QUICK, "--out", "far",
        "--json", cwd=tmp_path,
    )  # fmt: skip
    answer = json.loads(process.stdout)
    assert (process.returncode, answer["exit_code"], answer["status"]) == (4, 4, "failed")
    assert "reachable" in answer["reason"]
    assert "--place" in process.stderr
    folder = tmp_path / "far.part"
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (manifest["status"], manifest["stage"], manifest["exit_code"]) == ("failed", "reach", 4)
    assert "out of the arm's reach" in manifest["reason"]
    assert (folder / "reach.npz").exists()
    assert not (tmp_path / "far").exists()


def test_a_required_coverage_that_is_missed_ends_with_code_3(
    part_file: Path, tmp_path: Path, run_cell: RunCommand, small_plan: tuple[str, ...]
) -> None:
    """`--require 1` is impossible, because the part is on its post: exit code 3, and the finished run is kept."""
    run_cell(
        "plan", str(part_file), "--units", "mm", *small_plan, "--require", "1", "--out", "run", cwd=tmp_path, code=3
    )
    assert json.loads((tmp_path / "run" / "manifest.json").read_text())["status"] == "finished"


def test_a_negative_placement_is_not_taken_for_an_option(
    part_file: Path, tmp_path: Path, run_cell: RunCommand, small_plan: tuple[str, ...]
) -> None:
    """`--place -1100,400,100` is read as a placement behind the robot."""
    arguments = ("plan", str(part_file), "--units", "mm", "--place", "-1100,400,100", *small_plan[2:])
    process = run_cell(*arguments, "--faces", "24", "--out", "run", cwd=tmp_path)
    assert process.returncode in (0, 4), process.stderr
    folder = tmp_path / ("run" if process.returncode == 0 else "run.part")
    T = np.array(json.loads((folder / "scene.resolved.json").read_text())["T_base_object"])
    centre = np.array(json.loads((folder / "scene.resolved.json").read_text())["T_object_centre"])
    np.testing.assert_allclose((T @ centre)[:3, 3], [-1.1, 0.4, 0.1], atol=1e-9)


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    ("stage", "faces"),
    [
        pytest.param("reach", 1000, marks=pytest.mark.slow),
        ("measurability", 1000),
        pytest.param("order and connect", 600, marks=pytest.mark.slow),
    ],
)
def test_ctrl_c_in_any_stage_keeps_the_finished_files(
    stage: str, faces: int, part_file: Path, tmp_path: Path, start_cell: StartCommand
) -> None:
    """An interrupt ends with code 130 and one sentence. The folder records the status and keeps its artefacts."""
    process = start_cell(
        "plan", part_file, "--units", "mm", "--faces", faces, "--no-cache",
        "--place", "1100,400,100", "--samples", "4", "--out", "run", cwd=tmp_path,
    )  # fmt: skip
    manifest = tmp_path / "run.part" / "manifest.json"
    deadline = time.monotonic() + 120
    seen = ""
    while time.monotonic() < deadline and process.poll() is None:
        seen = json.loads(manifest.read_text())["stage"] if manifest.exists() else ""
        if seen == stage:
            break
        time.sleep(0.005)
    assert seen == stage, f"the stage never came; it ended at {seen!r}"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert f"stopped by Ctrl-C; finished results are kept in {Path('run.part')}" in errors
    assert "Traceback" not in errors
    content = json.loads(manifest.read_text())
    assert (content["status"], content["exit_code"]) == ("interrupted", 130)
    assert (tmp_path / "run.part" / "reference.ply").exists()


def test_ctrl_c_in_the_pose_search_keeps_the_fewest_views_so_far(
    part_file: Path, tmp_path: Path, start_cell: StartCommand
) -> None:
    """An interrupt of the pose search ends the search alone: the plan is finished with the views found until then."""
    process = start_cell(
        "plan", part_file, "--units", "mm", "--faces", 100, "--no-cache", "--effort", "100000000",
        "--place", "1100,400,100", "--out", "run", cwd=tmp_path,
    )  # fmt: skip
    log = tmp_path / "run.part" / "run.log"
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline and process.poll() is None:
        if log.exists() and log.read_text().count("stage: search fewer than") > 1:  # it found fewer views
            break
        time.sleep(0.05)
    begin = int(re.findall(r"search fewer than (\d+) views", log.read_text())[0])
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=240)
    assert process.returncode == 0, errors
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["n_views"] < begin
    assert "Pose search (interrupted, 100000000 effort" in report["status"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_reported_and_earlier_files_stay(tmp_path: Path) -> None:
    """A write to a full device raises an error, and earlier artefacts stay."""
    from datetime import UTC, datetime

    from cell.errors import FileError
    from cell.runs.folder import RunFolder

    folder = RunFolder.create(tmp_path / "run", [], 0, {}, datetime.now(UTC))
    folder.write_text("first.txt", "finished")
    (folder.path / "second.txt").symlink_to("/dev/full")
    with pytest.raises(FileError, match="the disk is full"):
        folder.write_text("second.txt", "x" * 100_000)
    folder.fail("failed", 6, "the disk is full")
    assert (folder.path / "first.txt").read_text() == "finished"
    assert json.loads((folder.path / "manifest.json").read_text())["status"] == "failed"


def test_no_write_permission_is_reported_before_any_computation(
    part_file: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """A run folder below a plain file is refused with exit code 6."""
    (tmp_path / "file").write_text("")
    process = run_cell(
        "plan", str(part_file), "--units", "mm", "--out", "file/run", "--place", "1100,400,100", cwd=tmp_path, code=6
    )
    assert "writable --out" in process.stderr
