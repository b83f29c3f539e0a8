"""Time of the dynamic plant: any division gives the same trajectory, bit for bit."""

from itertools import pairwise

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cell.robot.plant import MujocoPlant, PlantSettings
from drivers.profile import Reference, interpolate
from drivers.simulated_controller import Plant
from tests.support.arms import HOME, KR16

STEP = PlantSettings().time_step


def reference(end: tuple[float, ...]) -> Reference:
    """Return the reference from home to home plus `end` [rad]."""
    limits = KR16
    return interpolate(HOME, HOME[None] + np.array(end), limits.velocity, limits.acceleration, limits.jerk)


def driven(first: list[float], second: list[float], cut: float) -> tuple[bytes, bool, bool]:
    """Return the state after two moves, the second beginning within a step, and whether the arm was settled."""
    plant: Plant = MujocoPlant(HOME)
    move = reference((0.05, -0.03, 0.04, 0.1, -0.1, 0.2))
    plant.follow(move)
    for seconds in first:
        plant.advance(seconds)
    settled = plant.settled
    plant.follow(move.braking_from(cut))
    for seconds in second:
        plant.advance(seconds)
    assert isinstance(plant, MujocoPlant)
    state = np.concatenate([plant.data.qpos, plant.data.qvel, plant.data.ctrl])
    return state.tobytes(), settled, plant.settled


def cuts(total: float, at: list[float]) -> list[float]:
    """Divide `total` at fractions; the parts sum to it except for rounding."""
    marks = [0.0, *sorted(at), 1.0]
    return [total * (b - a) for a, b in pairwise(marks)]


fractions = st.lists(st.floats(0.0, 1.0), max_size=12)


@settings(max_examples=settings.default.max_examples // 2)
@given(fractions, fractions, st.floats(0.05, 0.2))
@example([], [], 0.1)
@example([0.1] * 5, [k / 40 for k in range(40)], 0.123456789)
@example([1e-9, 1.0], [1.0 - 1e-9], 0.05)
def test_the_division_of_time_does_not_matter(first: list[float], second: list[float], cut: float) -> None:
    """One advance and any division of it give the same state, also with a new reference within a step."""
    cut = round(cut, 6) + 0.4e-9  # not within rounding of the edge between two nanoseconds
    assert driven(cuts(cut, first), cuts(0.4, second), cut) == driven([cut], [0.4], cut)


@settings(max_examples=settings.default.max_examples // 4)
@given(st.lists(st.floats(0.0, 0.02), max_size=20))
def test_the_same_commands_and_times_give_the_same_bytes(times: list[float]) -> None:
    """Two plants with equal inputs have equal states."""
    assert driven(times, times, 0.1) == driven(times, times, 0.1)


@settings(max_examples=settings.default.max_examples // 4)
@given(st.floats(0.0, 3e-3))
def test_nothing_moves_between_two_steps(seconds: float) -> None:
    """The axes are those at the last whole step; the remaining time is carried over."""
    steps: list[float] = []
    plant = MujocoPlant(HOME, observer=lambda _, times, axes: steps.extend(times))
    plant.follow(reference((0.1,) * 6))
    plant.advance(seconds)
    assert len(steps) == int(seconds / STEP + 1e-6)
    before = plant.reported_axes
    plant.advance(max(0.0, (len(steps) + 1) * STEP - seconds - 2e-9))
    assert plant.reported_axes.tobytes() == before.tobytes()
    plant.advance(2e-9)
    assert len(steps) == int(seconds / STEP + 1e-6) + 1
