"""`cell scan SETUPS`: the set-ups are scanned in order and resumed after a stop; all scans form one model."""

import json
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from cell.errors import UsageError
from cell.runs.cell import read_cell
from cell.runs.run import open_run
from cell.runs.setups import SetupsRun
from cell.scan.options import ScanOptions
from cell.scan.safety import placement_warning
from cell.scan.setups import scan_setups
from cell.session import Session
from cell.world.prediction import held_out_samples
from cell.world.support_contact import in_contact
from planner.measurability.visibility import find_measured
from tests.support.fixture_types import Emulate, RunCommand, StartCommand

NOISY = ("--setup-error", "5mm,2deg", "--range-noise", "0.03", "--resolution", "1")


@pytest.fixture
def folder(made_setups: Path, tmp_path: Path) -> Path:
    """Return two set-ups of the small part without executions."""
    return Path(shutil.copytree(made_setups, tmp_path / "made"))


def test_set_ups_are_found_where_they_stand_and_measured_as_one(folder: Path, run_cell: RunCommand) -> None:
    """A part 5 mm and 2 deg off is located to 0.05 mm and 0.02 deg. The report covers both set-ups."""
    process = run_cell("scan", "made", "--setup", "1", *NOISY, "--json", cwd=folder.parent, code=0)
    first = json.loads(process.stdout)
    assert (first["missing_setups"], len(first["setups"]), first["common_surface"]) == ([2], 1, [])
    assert first["uncovered"]["not_scanned"] > 0.05
    process = run_cell(
        "scan", "made", "--resume", "latest", cwd=folder.parent, code=0
    )  # set-up 2 has the options of set-up 1
    assert "set-up 2 of 2: the part lies" in process.stderr
    report = json.loads((folder / "scanned" / "report.json").read_text())
    assert report["missing_setups"] == []
    for setup in report["setups"]:
        place = setup["localisation"]
        assert place["displacement_mm"] == pytest.approx(5, abs=0.05) or place["free_motions"]
        assert place["error_mm"] <= 0.05
        assert place["error_deg"] <= 0.02
    assert report["deviation"]["rms_mm"] < 0.5
    assert sum(setup["marginal_coverage"] for setup in report["setups"]) == pytest.approx(report["visible"], abs=1e-9)
    assert report["visible"] + sum(report["uncovered"].values()) == pytest.approx(1, abs=1e-9)
    assert report["visible"] == pytest.approx(report["planned"], abs=0.03)
    assert [pair["setups"] for pair in report["common_surface"]] == [[1, 2]]
    process = run_cell("scan", "made", cwd=folder.parent, code=2)
    assert "all 2 set-ups of made are scanned; --setup 1 scans one again" in process.stderr


def test_parts_in_their_places_are_measured_as_planned(folder: Path, run_cell: RunCommand) -> None:
    """Without errors, the coverage is the union of the samples that the views measure and no support touches."""
    process = run_cell("scan", "made", "--resolution", "1", "--json", cwd=folder.parent, code=0)
    report = json.loads(process.stdout)
    seen = []
    for setup in ("1", "2"):
        run = open_run(folder / "setups" / setup)
        cell = read_cell(run)
        samples = held_out_samples(cell.reference, cell.planning, run.seed)
        poses = []
        for name in sorted((run.folder / "executions" / "0001" / "scans").iterdir()):
            with np.load(name) as scan:
                poses.append(scan["T_object_scanner_true"])
        T = np.stack(poses)[:, None]
        found = find_measured(T, samples, cell.scanner, (cell.part_caster, cell.occluder_caster))
        seen.append(found & ~in_contact(samples, cell.occluders))
    assert report["visible"] == pytest.approx(np.logical_or.reduce(seen).mean(), abs=1e-12)
    assert all(setup["localisation"] is None for setup in report["setups"])
    again = (folder / "scanned" / "report.json").read_bytes()
    run_cell("scan", "made", "--report", "latest", cwd=folder.parent, code=0)
    assert (folder / "scanned" / "report.json").read_bytes() == again


@pytest.mark.slow
def test_a_killed_chain_goes_on_where_it_was(folder: Path, run_cell: RunCommand, start_cell: StartCommand) -> None:
    """After kill -9 in the first set-up, each view is scanned once, and the second set-up has the same options."""
    process = start_cell("scan", folder, "--resolution", "1", "--realtime")
    scans = folder / "setups" / "1" / "executions" / "0001" / "scans"
    deadline = time.monotonic() + 240
    while not (scans.is_dir() and any(scans.glob("*.npz"))):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    completed = run_cell("scan", "made", "--resume", "latest", "--json", cwd=folder.parent, code=0)
    assert "views are scanned already" in completed.stderr
    report = json.loads(completed.stdout)
    assert report["missing_setups"] == []
    assert [setup["execution"] for setup in report["setups"]] == ["0001", "0001"]
    for number, setup in enumerate(report["setups"], start=1):
        execution = folder / "setups" / str(number) / "executions" / "0001"
        assert len(list((execution / "scans").glob("*.npz"))) == setup["views"]
        assert json.loads((execution / "manifest.json").read_text())["options"]["resolution_deg"] == 1.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("made", "--setup", "3"), "there is no set-up 3 of made; there are 1 to 2"),
        (("made", "--view", "1"), "--view applies to one run: give its folder instead of that of all set-ups"),
        (("made", "--report", "0001"), "--report latest"),
        (("made/setups/1", "--setup", "1"), "--setup needs a folder of cell setups"),
    ],
)
def test_invalid_requests_are_refused(words: tuple[str, ...], message: str, folder: Path, run_cell: RunCommand) -> None:
    """Invalid options are refused with exit code 2, and nothing is scanned."""
    process = run_cell("scan", *words, cwd=folder.parent, code=2)
    assert message in process.stderr
    assert not (folder / "setups" / "1" / "executions").exists()


def test_a_chain_of_points_from_files_halts_after_each_set_up(folder: Path, run_cell: RunCommand) -> None:
    """Each set-up needs its own points: the next set-up is not begun automatically, also after a resumed one."""
    beside = folder.parent
    run_cell("scan", "made/setups/1", "--resolution", "1", cwd=beside, code=0)
    scans, points = folder / "setups" / "1" / "executions" / "0001", beside / "points"
    points.mkdir()
    for path in sorted((scans / "scans").iterdir()):
        with np.load(path) as scan:
            T = np.linalg.inv(scan["T_object_scanner"])
            seen = 1000 * (scan["points"] @ T[:3, :3].T + T[:3, 3])
        np.savetxt(points / f"{path.stem}.xyz", seen)
    shutil.rmtree(scans.parent)
    first = (points / "0001.xyz").rename(beside / "kept.xyz")
    files = ("--acquire", "files:points", "--points-frame", "scanner", "--points-units", "mm")
    process = run_cell("scan", "made", *files, cwd=beside, code=6)
    assert (
        "view 1 of set-up 1 has no points (1 such views); cell scan made --resume latest scans them" in process.stderr
    )
    assert not (folder / "setups" / "2" / "executions").exists()
    first.rename(points / "0001.xyz")
    process = run_cell("scan", "made", "--resume", "latest", "--json", cwd=beside, code=0)
    assert json.loads(process.stdout)["missing_setups"] == [2]
    assert not (folder / "setups" / "2" / "executions").exists()
    process = run_cell("scan", "made", "--resume", "latest", cwd=beside, code=2)
    assert "files:points has the points of set-up 1; run cell scan made --setup 2" in process.stderr


def test_one_view_that_was_scanned_alone_is_no_chain_that_was_stopped(folder: Path, run_cell: RunCommand) -> None:
    """A stopped execution of one view is not resumed: the set-up is scanned completely as a new execution."""
    beside = folder.parent
    run_cell("scan", "made/setups/1", "--view", "1", "--resolution", "1", cwd=beside, code=0)
    manifest = folder / "setups" / "1" / "executions" / "0001" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"status": "finished"', '"status": "interrupted"'))
    process = run_cell("scan", "made", "--setup", "1", "--resume", "latest", "--json", cwd=beside, code=0)
    report = json.loads(process.stdout)
    assert (report["missing_setups"], [setup["execution"] for setup in report["setups"]]) == ([2], ["0002"])


def test_the_confirmation_of_a_motion_names_the_pose_of_the_part(folder: Path, emulate: Emulate) -> None:
    """The question names the set-up and its pose. Without a yes, no motion starts."""
    emulated, questions = emulate("modbus", "--time-scale", "20"), list[str]()
    session = Session(None, confirm=lambda question: questions.append(question) or "no")
    with pytest.raises(UsageError, match="nothing was moved"):
        scan_setups(session, folder, ScanOptions(driver=emulated.url, accept_time_scale=20.0), setup=2, resumed=False)
    planned = SetupsRun.opened(folder).file
    name = planned.candidates[planned.selected[1].candidate].name
    assert questions[-1].startswith(f"set-up 2 of 2: the part lies {name}, ")
    assert emulated.entries("move") == []


def test_the_warning_about_a_displaced_part_is_repeated_when_resumed(folder: Path, run_cell: RunCommand) -> None:
    """The warning is reported before the first and before the resumed execution."""
    (folder.parent / "none").mkdir()
    files = ("--acquire", "files:none", "--points-frame", "scanner", "--points-units", "mm")
    for words in ((*files, "--setup-error", "500mm,2deg"), ("--resume", "latest")):
        process = run_cell("scan", "made", "--setup", "1", *words, cwd=folder.parent, code=6)
        assert "the part may be displaced by up to 50" in process.stderr


def test_set_ups_whose_folders_were_exchanged_are_not_driven(folder: Path, run_cell: RunCommand) -> None:
    """A run folder that is not the plan of setups.json is refused, and no execution is created."""
    setups = folder / "setups"
    (setups / "1").rename(setups / "3")
    (setups / "2").rename(setups / "1")
    (setups / "3").rename(setups / "2")
    process = run_cell("scan", "made", "--setup", "1", cwd=folder.parent, code=6)
    assert "setups/1 is not the plan that setups.json names" in process.stderr
    assert not (setups / "1" / "executions").exists()


def test_programs_halt_before_each_set_up(folder: Path, run_cell: RunCommand) -> None:
    """The main program sets the base, halts and calls the program of each run."""
    run_cell("export", "made", "--name", "TURNED", "--json", cwd=folder.parent, code=0)
    lines = (folder / "export" / "TURNED.src").read_bytes().decode("ascii").split("\r\n")
    order = [line.split(" ;")[0] for line in lines if line.startswith(("$BASE", "HALT", "TURNED_"))]
    assert [line.split("=")[0] for line in order] == ["$BASE", "HALT", "TURNED_1( )", "$BASE", "HALT", "TURNED_2( )"]
    assert {path.name for path in (folder / "export").iterdir()} == {
        "TURNED.src", "TURNED_1.src", "TURNED_1.dat", "TURNED_2.src", "TURNED_2.dat",
    }  # fmt: skip
    for number in (1, 2):
        source = (folder / "export" / f"TURNED_{number}.src").read_text()
        assert f"DEF TURNED_{number}( )" in source


def test_a_part_that_is_off_rests_on_its_post(planned: Path) -> None:
    """For a part simulated higher than planned, the post moves with the part, and the floor stays in base."""
    cell = read_cell(open_run(planned))
    up = np.eye(4)
    up[2, 3] = -0.004
    before, after = ({each.name: each.vertices for each in of.occluders} for of in (cell, cell.about_part(up)))
    np.testing.assert_array_equal(after["post"], before["post"])
    np.testing.assert_allclose(after["floor"], before["floor"] + up[:3, 3])


def test_a_displacement_above_the_clearance_has_a_warning(planned: Path) -> None:
    """A displacement of 5 mm and 2 deg moves the farthest point by a known distance. The warning begins there."""
    cell = read_cell(open_run(planned))
    centre = cell.scene.T_object_centre[:3, 3]
    radius = np.linalg.norm(cell.reference.vertices - centre, axis=1).max()
    moved = 0.005 + 2 * radius * np.sin(np.radians(1.0))
    off = ScanOptions(setup_error_mm=5.0, setup_error_deg=2.0)
    assert placement_warning(off, cell, moved * 1.001) == ""
    assert f"the part may be displaced by up to {1000 * moved:.1f} mm" in placement_warning(off, cell, moved * 0.999)
    assert placement_warning(ScanOptions(), cell, 0.0) == ""
