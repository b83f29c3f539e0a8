"""`cell plan --open-of` as a user meets it: a second and a third set-up, and what cannot be one."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.api import open_run
from cell.setups.earlier import EarlierSetup, measured_by
from cell.world.prediction import held_out_samples
from tests.seen_samples import seen_and_touching

Cell = Callable[..., Any]

OVER = "1100,400,100,0,0,180"


@pytest.fixture(scope="module")
def second(made_once: Callable[..., Path], planned: Path, run_cell: Cell) -> Path:
    """Run folder of a second set-up of the small part, upside down, with grown candidates."""

    def make(folder: Path) -> None:
        done = run_cell("plan", "--open-of", planned, "--place", OVER, "--out", "run", cwd=folder)
        assert done.returncode == 0, done.stderr
        (folder / "stdout").write_text(done.stdout)

    return made_once("second_setup", make) / "run"


def test_the_rows_are_what_no_view_measures_and_candidates_keep_their_numbers(planned: Path, second: Path) -> None:
    """Every row is a sample of the first run, to the bit; none is measured by a view there; the others are."""
    first = np.load(planned / "measurability.npz")
    open_ = np.load(second / "measurability.npz")
    known = {tuple(point): row for row, point in enumerate(first["points"].tolist())}
    rows = [known[tuple(point)] for point in open_["points"].tolist()]
    assert 0 < len(rows) < len(known)
    views = [view["id"] for view in json.loads((planned / "plan.json").read_text())["views"]]
    measured_rows = [
        row for row in range(len(known))
        if np.isin(first["indices"][first["indptr"][row] : first["indptr"][row + 1]], views).any()
    ]  # fmt: skip
    assert set(rows) | set(measured_rows) == set(range(len(known)))
    assert len(set(rows) & set(measured_rows)) <= 1  # set-points are rounded
    before, after = np.load(planned / "viewpoints.npz"), np.load(second / "viewpoints.npz")
    np.testing.assert_array_equal(after["T_object_scanner"][: len(before["face"])], before["T_object_scanner"])


def test_the_plan_says_what_both_measure_together(planned: Path, second: Path) -> None:
    """The union over held-out samples, each view asked for all of them; what a support touches counts in neither."""
    said = json.loads((second / "plan.json").read_text())["open_of"]
    assert said["digests"] == [open_run(planned).digest]
    (one, touched_before), (other, touches) = seen_and_touching(planned), seen_and_touching(second)
    before = one & ~touched_before
    assert said["before"] == pytest.approx(before.mean(), abs=1e-12)
    assert said["together"] == pytest.approx((before | (other & ~touches)).mean(), abs=1e-12)
    assert said["in_contact"] == pytest.approx((touches & ~before).mean(), abs=1e-12)
    assert said["before"] + 0.02 < said["together"] <= said["coverable"] <= 1 - said["in_contact"]
    text = " ".join((second.parent / "stdout").read_text().replace("│", " ").split())
    assert f"all set-ups together {100 * said['together']:.2f} % of the surface" in text
    assert f"{100 * said['together']:.2f} % of the surface" in (second / "report.md").read_text()


def test_a_second_set_up_is_driven_as_any_run(second: Path, run_cell: Cell, tmp_path: Path) -> None:
    """Proof, motion and scan take the folder as it is; what is achieved is what its own views were to measure."""
    shutil.copytree(second, tmp_path / "run")
    done = run_cell("scan", "run", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    achieved = json.loads(done.stdout)["coverage"]["visible"]
    assert achieved == pytest.approx(open_run(second).coverage.visible, abs=1e-3)


def test_a_third_goes_on_from_both(planned: Path, second: Path, run_cell: Cell, tmp_path: Path) -> None:
    """What two measure is what was said of them together; where no sample is left, that is said in place of a plan."""
    setups = [EarlierSetup.of(open_run(run)) for run in (planned, second)]
    samples = held_out_samples(setups[0].cell.reference, setups[0].cell.planning, 3)
    said = json.loads((second / "plan.json").read_text())["open_of"]["together"]
    assert measured_by(setups, samples).mean() == pytest.approx(said, abs=1e-12)
    runs = ("--open-of", planned, "--open-of", second)
    done = run_cell("plan", *runs, "--place", "1100,400,100,0,90,0", "--out", "third", cwd=tmp_path)
    assert done.returncode == 4
    assert "nothing is left to plan" in done.stderr


@pytest.mark.parametrize(
    ("options", "code", "told"),
    [
        (("--place", "1100,400,100"), 2, "the part lies as in"),
        ((), 2, "--open-of needs another pose of the part"),
        (("--place", "9000,0,100,0,0,180"), 4, "candidate viewpoints is reachable"),
    ],
)
def test_what_cannot_be_a_set_up(
    options: tuple[str, ...], code: int, told: str, planned: Path, run_cell: Cell, tmp_path: Path
) -> None:
    """One sentence, and no folder that could be taken for a plan."""
    done = run_cell("plan", "--open-of", planned, *options, "--out", "run", cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert told in done.stderr
    assert not (tmp_path / "run").exists()


def test_an_edit_of_a_further_set_up_is_not_repaired(second: Path, run_cell: Cell, tmp_path: Path) -> None:
    """A repair would ask for what the other set-ups measure already."""
    done = run_cell("edit", second, "--drop", "1", "--repair", "--out", "edited", cwd=tmp_path)
    assert done.returncode == 2
    assert "only for what other set-ups leave open" in done.stderr
