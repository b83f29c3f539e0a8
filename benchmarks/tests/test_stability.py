"""Stability maps: map and program have the same border, and no method fails without a message."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.hard_move import one_move
from benchmarks.methods import arm_maps
from benchmarks.methods.stability import MAPS, at, broken_promises, sentences, stability_study
from cell.errors import UsageError
from cell.robot.plant import MAX_ACCURATE_STEP, PlantSettings
from cell.session import LoggedProgress
from cell.study.study import run_study
from cell.study.trials import Outcome, Processes, Trial

_NUMBERS = [
    (name, line, border, outward)
    for name, each in MAPS.items()
    for border, outward in zip(each.borders, (-1, 1), strict=True)
    if border is not None
    for line in each.lines
    if line not in each.compared
]


@pytest.mark.parametrize(("name", "line", "border", "outward"), _NUMBERS)
def test_the_program_begins_to_speak_at_the_border_that_the_map_shades(
    name: str, line: str, border: float, outward: int
) -> None:
    """Slightly inside the border there is no message and the result is good.

    Slightly beyond it there is a message.
    """
    each = MAPS[name]
    hair = max(1e-2 * abs(border), 1e-12)
    inside, outside = (each.method(line, border + sign * outward * hair, each.sizes[1]) for sign in (-1, 1))
    assert inside.says == ""
    assert inside.success >= each.enough
    assert inside.error is None or inside.error <= each.tolerated
    assert len(outside.says.split()) > 3


def test_inverse_kinematics_is_held_against_joint_angles_that_are_known() -> None:
    """Inverse kinematics finds the known joint angles near the stretched arm.

    A pose out of reach has a large residual.
    """
    point = MAPS["ik"].method("arm stretched", 1e-6, 50)
    assert (point.success, point.says) == (1.0, "")
    assert point.more["own joint angles off rad"] < 1e-8
    T = np.tile(np.eye(4), (1, 1, 1))
    T[0, 0, 3] = 9.0
    assert arm_maps._numeric(T[0], 0) > 1.0


def _outcome(name: str, line: str, value: float, success: float, error: float | None, says: str) -> Outcome:
    size = MAPS[name].sizes[1]
    trial = Trial.of(at, {"map": name, "line": line, "value": value, "size": size})
    return Outcome(trial, {"success": success, "error": error, "says": says, "more": {}}, "", {})


def _rows(said_beyond: str) -> list[dict[str, Any]]:
    study = stability_study(["grazing"], quick=True)
    answers = {45.0: (1.0, 0.0, ""), 75.0: (1.0, 0.1, ""), 89.0: (1.0, 99.0, said_beyond)}
    outcomes = []
    for trial in study.trials:
        settings = json.loads(trial.settings)
        outcomes.append(_outcome("grazing", settings["line"], settings["value"], *answers[settings["value"]]))
    return study.rows(outcomes)


def test_a_promise_is_broken_where_a_method_fails_in_silence() -> None:
    """A value with a bad result and without a message is a broken promise, and the sentence states it."""
    assert broken_promises(_rows("too steep")) == []
    assert "silent" not in sentences(_rows("too steep"))[0]
    silent = _rows("")
    assert [row["value"] for row in broken_promises(silent)] == [89.0]
    assert "silent although not good at 89" in sentences(silent)[0]


def test_each_map_is_drawn_and_shaded() -> None:
    """A map has two panels with the safe region in both."""
    ((stem, figure),) = stability_study(["grazing"], quick=True).pictures(_rows("too steep"))
    assert stem == "stability_grazing"
    assert len(figure.axes) == 2
    assert all(len(axes.patches) == 1 for axes in figure.axes)


def test_an_unknown_map_is_named_with_those_that_there_are() -> None:
    """An unknown map is refused with the list of maps."""
    with pytest.raises(UsageError, match="there is no stability map teapot; there are ik, limits"):
        stability_study(["teapot"])


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_the_dynamic_arm_is_good_up_to_the_time_step_that_it_warns_of(integrator: str) -> None:
    """The hard move settles within 0.15 mm of its reference at the largest time step without a warning."""
    settings = PlantSettings(time_step=MAX_ACCURATE_STEP, integrator=integrator)
    move = one_move(settings)
    assert settings.warning == ""
    assert move.outcome == "settled"
    assert move.tracking_error() < 1.5e-4


@pytest.mark.slow
def test_no_method_fails_in_silence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the reduced study every map is run and drawn, and has no broken promise."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with Processes(1) as workers:
        result = run_study(stability_study([], quick=True), workers, out=tmp_path / "maps", reporter=LoggedProgress())
    assert result.failed == []
    assert broken_promises(result.rows) == []
    # Inverse kinematics, and the selection on small matrices, are good at every value.
    assert {row["map"] for row in result.rows if row["says"]} == set(MAPS) - {"ik", "cover"}
    assert all((result.folder / f"stability_{name}.svg").stat().st_size > 1000 for name in MAPS)
