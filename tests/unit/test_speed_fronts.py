"""The table of knobs, the rows, sentences and pictures of the fronts, and the shared cores beneath them."""

import re
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

from cell.errors import UsageError
from cell.reconstruction import reconstruct
from cell.scene.presets import PRESETS
from cell.scene.scene import load_scene
from cell.study import whole
from cell.study.bench import Bench
from cell.study.dense_moves import DenseMove, passes
from cell.study.fronts import WHOLE, pictures, presets_at, sentences, speed_study
from cell.study.knobs import KNOBS
from cell.study.timed import timed
from cell.study.trial import Outcome, Trial, compute, sources_digest
from cell.study.turned import samples
from planner.ports import Floats

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", list(KNOBS))
def test_every_value_that_a_preset_has_is_on_its_front(name: str) -> None:
    """So that each mark of the picture is measured."""
    knob = KNOBS[name]
    for preset in PRESETS:
        assert knob.of_preset(preset) in knob.values, preset
    assert len(set(knob.values)) == len(knob.values) >= 3
    assert knob.truth
    assert knob.error_unit in knob.measure


def test_the_page_has_the_same_table() -> None:
    """Knob, range, default, truth and error measure, in the order of the code."""
    page = (ROOT / "docs" / "speed_accuracy.md").read_text(encoding="utf-8")
    for name, knob in KNOBS.items():
        text = ", ".join(value if isinstance(value, str) else f"{value:,g}" for value in knob.values)
        default = knob.default if isinstance(knob.default, str) else f"{knob.default:,g}"
        unit = f" {knob.unit}" if knob.unit else ""
        row = f"| `{name}` | {knob.title} | {text}{unit} | {default} | {knob.truth} | {knob.measure} |"
        assert row in page, row


def test_the_page_and_the_table_agree_on_the_presets() -> None:
    """Prices and values."""
    page = (ROOT / "docs" / "speed_accuracy.md").read_text(encoding="utf-8")
    for name, preset in PRESETS.items():
        assert f"`{name}`" in page
        assert preset.price in page


def test_the_default_of_the_grid_is_that_of_the_reconstruction() -> None:
    """It is no key of the scene, so the table names it."""
    assert KNOBS["grid"].default == reconstruct._GRID


def test_knobs_that_presets_turn() -> None:
    """Marked on their fronts at other values; the others have all three at the default."""
    turned = {name for name, knob in KNOBS.items() if knob.turned_by_presets}
    assert turned == {"decimation", "samples", "scan"}
    assert presets_at(KNOBS["rays"], 1.0) == list(PRESETS)
    assert presets_at(KNOBS["samples"], 16) == []


@pytest.mark.parametrize(
    ("name", "text", "values"),
    [
        ("samples", "1, 4", [1, 4]),
        ("solver", "0,0.5", [0.0, 0.5]),
        ("edges", "2,certified", [2.0, "certified"]),
        ("collision", "hull", ["hull"]),
    ],
)
def test_values_of_an_option_are_of_the_knob_s_kind(name: str, text: str, values: list[Any]) -> None:
    """Whole numbers stay whole."""
    found = KNOBS[name].parsed(text)
    assert found == values
    assert [type(value) for value in found] == [type(value) for value in values]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("samples", "1.5"), ("samples", "0"), ("samples", ""), ("samples", "-1"), ("grid", "nan"), ("grid", "inf"),
        ("grid", "0"), ("collision", "sphere"), ("collision", "3"), ("edges", "proven"),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_is_refused(name: str, text: str) -> None:
    """With what is valid."""
    with pytest.raises(UsageError, match="valid are"):
        KNOBS[name].parsed(text)


def _outcome(trial: Trial) -> Outcome:
    """What a trial might give: time grows, error falls."""
    seconds = {"work": 2.0, "processor": 1.5, "scan work": 4.0, "scan processor": 3.0, "total": 9.0}
    if trial.name == "measurable":
        return Outcome(trial, {"measurable": 0.9, "candidates": 10, "reachable": 5}, "", seconds)
    if trial.name == "whole":
        own = {"views": 9, "lower_bound": 8, "visible": 0.88, "motion_s": 7.0, "sampled": 0.8, "rms_um": None}
        return Outcome(trial, own, "", seconds)
    error = 0.0 if '"value": 16' in trial.settings else 2.0
    return Outcome(trial, {"error": error, "more": {"views": 5}}, "", seconds)


def test_rows_sentences_and_pictures_of_knobs_and_of_the_whole() -> None:
    """One row a value, one a way to run the whole; an error of zero has a place on a logarithmic axis."""
    scene = load_scene(None, {"part": {"name": "mug"}})
    study = speed_study([("samples", "mug", scene), ("collision", "mug", scene)], [("mug", scene, ["mug"])])
    rows = study.rows([_outcome(trial) for trial in study.trials])
    knobs = [row for row in rows if row["knob"] != WHOLE]
    assert [row["value"] for row in knobs] == [*KNOBS["samples"].values, *KNOBS["collision"].values]
    assert {row["presets"] for row in knobs if row["knob"] == "samples"} == {"fast", "balanced", "accurate", ""}
    ends = [row for row in rows if row["knob"] == WHOLE]
    assert [row["value"] for row in ends] == list(whole.METHODS)
    assert ends[0]["error"] == pytest.approx(2.0)
    said = sentences(rows)
    assert len(said) == 2 + 3
    assert "1.00 times the time" in said[0]
    drawn = dict(pictures(rows))
    assert list(drawn) == ["speed_fronts", "speed_whole"]
    for figure in drawn.values():
        figure.canvas.draw()  # type: ignore[attr-defined]


def test_a_truth_that_failed_leaves_out_only_its_part() -> None:
    """An error against nothing would be a lie."""
    scene = load_scene(None, {"part": {"name": "mug"}})
    study = speed_study([("samples", "mug", scene)], [("mug", scene, ["mug"])])
    rows = study.rows([_outcome(trial) for trial in study.trials if trial.name != "measurable"])
    assert {row["knob"] for row in rows} == {"samples"}


def test_a_trial_gives_the_same_values_again_and_its_seconds_apart() -> None:
    """Values are equal to the bit; seconds are no value."""
    scene = {"scene": {"part": {"name": "petanque"}, "plan": {"faces": 60}}, "files": {}}
    trial = Trial.of("knob", {**scene, "knob": "samples", "value": 1, "repeats": 1})
    first, second = (compute(trial, sources_digest()) for _ in range(2))
    assert not first.failure
    assert first.values == second.values
    assert first.values["error"] >= 0
    assert set(first.seconds) == {"work", "processor", "total"}


def test_more_samples_bring_the_claim_closer() -> None:
    """The front falls from its first to its last value."""
    bench = Bench(load_scene(None, {"part": {"name": "petanque"}, "plan": {"faces": 80}}), samples=20_000)
    errors = [samples(bench, count, 1).error for count in (1, 32)]
    assert errors[1] < errors[0]


class _Wall:
    """A point on a line with a wall at 1; axis 1 is its position."""

    clearance = 0.01

    def free(self, q: Floats) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """As the protocol."""
        return self.distance(q)[0] >= self.clearance

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """As the protocol."""
        return ()

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """The wall is 2 mm thick."""
        return np.maximum(np.abs(q[:, 0] - 1.0) - 0.001, 0.0), ("point with wall",) * len(q)

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """As the protocol."""
        return np.abs((q_to - q_from)[:, 0])


def _at(position: float) -> Floats:
    return np.array([position, 0, 0, 0, 0, 0], dtype=float)


def test_a_move_knows_what_of_the_clearance_it_uses_up() -> None:
    """Nothing far from the wall, some near it, all through it."""
    assert DenseMove(_at(0.0), _at(0.9), _Wall()).intrusion == 0.0
    assert DenseMove(_at(0.0), _at(0.995), _Wall()).intrusion == pytest.approx(0.006, abs=1e-9)
    assert DenseMove(_at(0.0), _at(2.0), _Wall()).intrusion == pytest.approx(0.01, abs=1e-9)


def test_a_coarse_step_leaps_over_a_thin_wall_and_a_fine_one_does_not() -> None:
    """The reason for certification."""
    assert passes(_at(0.0), _at(1.5), _Wall(), 1.5 / 4)
    assert not passes(_at(0.0), _at(1.5), _Wall(), 0.01)
    assert passes(_at(0.0), _at(0.9), _Wall(), 0.001)


def test_the_best_of_a_few_runs_counts() -> None:
    """And the work is done as often as asked."""
    runs: list[int] = []
    result, seconds = timed(lambda: runs.append(1) or len(runs), 3)
    assert result == 3
    assert 0 <= seconds["work"] < 1
    assert set(seconds) == {"work", "processor"}


def test_the_help_names_every_knob() -> None:
    """The command's words are the table's."""
    from cell.commands.study import speed

    text = get_type_hints(speed, include_extras=True)["names"].__metadata__[0].help
    assert all(re.search(rf"\b{name}\b", text) for name in (*KNOBS, WHOLE))
