"""`cell setups --table`: the part is turned over on a rotary table, and each set-up is a run with seven axes."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cell.runs.schema import SetupsFile
from cell.runs.setups import SetupsRun
from cell.runs.verification import verify_plan
from tests.seen_samples import seen_samples
from tests.support.fixture_types import RunCommand

SCENE = """
[part]
path = "{part}"
units = "mm"
[placement]
position_mm = [1100, 400, 100]
[table]
angles = 12
[plan]
standoffs_mm = [250]
faces = 30
samples_per_face = 2
seed = 3
candidates = "optimal-scanning-zone"
coverage = 1.0
"""


@pytest.fixture(scope="module")
def folder(made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return the set-ups of the small part on a table, chosen from three candidates."""

    def make(at: Path) -> None:
        (at / "cell.toml").write_text(SCENE.format(part=part_file))
        process = run_cell("setups", "--scene", "cell.toml", "--proposals", "3", "--out", "made", cwd=at)
        assert process.returncode == 0, process.stderr

    return made_once("setups-on-table", make) / "made"


def test_each_set_up_is_a_plan_of_seven_axes_on_the_same_table(folder: Path) -> None:
    """Each run has layout 2 and a motion that is verified again. The place of the table is equal in all runs."""
    run_of_setups = SetupsRun.opened(folder)
    tables = []
    for run in run_of_setups.folders:
        assert json.loads((run / "manifest.json").read_text())["schema"] == "scan-cell/run/3"
        stored = np.load(run / "motion.npz")
        assert (stored["via_q"].shape[1], stored["via_e"].shape[1]) == (6, 1)
        proven = verify_plan(run)
        assert proven.world.table is not None
        tables.append(proven.world.table.T_base_table)
    for table in tables[1:]:
        np.testing.assert_array_equal(table, tables[0])
    seen = [seen_samples(run) for run in run_of_setups.folders]
    assert run_of_setups.file.coverage.visible == pytest.approx(np.logical_or.reduce(seen).mean(), abs=1e-12)
    assert run_of_setups.file.coverage.visible_of_coverable >= 0.9


def test_a_pose_is_offered_once_where_the_table_turns_it(folder: Path) -> None:
    """Turned set-ups are not offered, because the table turns the part itself."""
    file: SetupsFile = SetupsRun.opened(folder).file
    assert len(file.candidates) == 3
    assert not any("turned" in offer.name for offer in file.candidates)
    assert len(file.selected) == file.setups_bound == 2


def test_they_are_scanned_and_exported_with_the_table(folder: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A part 5 mm and 2 deg off is located in each set-up. The exported programs have E1."""
    shutil.copytree(folder, tmp_path / "made")
    process = run_cell(
        "scan", "made", "--setup-error", "5mm,2deg", "--range-noise", "0.03", "--resolution", "1", "--json",
        cwd=tmp_path, code=0,
    )  # fmt: skip
    scanned = json.loads(process.stdout)
    assert scanned["missing_setups"] == []
    assert scanned["visible"] == pytest.approx(scanned["planned"], abs=0.02)
    for setup in scanned["setups"]:
        assert setup["localisation"]["error_mm"] <= 0.05
        assert setup["localisation"]["error_deg"] <= 0.02
    run_cell("export", "made", cwd=tmp_path, code=0)
    assert len(scanned["setups"]) == 2
    programs = sorted((tmp_path / "made" / "export").glob("*_[12].*"))
    assert programs
    assert sum("E1 " in program.read_text() for program in programs) >= 2


def test_set_ups_beyond_the_table_are_left_out(part_file: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A set-up that swings too wide is left out with the reason of the table. The others are kept."""
    wide = '[[setup]]\nname = "far off"\nposition_mm = [1700, 400, 100]\n'
    near = '[[setup]]\nname = "upright"\nposition_mm = [1100, 400, 100]\n'
    aside = '[[setup]]\nname = "aside and higher"\nposition_mm = [1150, 400, 120]\n'
    text = (
        SCENE.format(part=part_file)
        .replace("[1100, 400, 100]", "[9000, 0, 0]")
        .replace("coverage = 1.0", "coverage = 0.5")
    )
    (tmp_path / "cell.toml").write_text(text + near + aside + wide)
    process = run_cell("setups", "--scene", "cell.toml", "--out", "made", cwd=tmp_path, code=0)
    file = SetupsRun.opened(tmp_path / "made").file
    assert [bool(offer.cause) for offer in file.candidates] == [False, False, True]
    assert "swings through a circle of" in file.candidates[2].cause
    assert "the set-up 'far off' is omitted: the part swings" in process.stderr
