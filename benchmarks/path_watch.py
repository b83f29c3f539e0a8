"""The watch of the path: arms that leave it, and false alarms of arms that do not.

Deviations are driven through the simulated controller with a plant that reports other axes than its reference, at full
speed and at a tenth. A row has the time of the move's end and its message with axis, deviation and limit. The tolerance
is that of a clearance of 10 mm.

False alarms are counted over moves through random via points with normal noise on every reported axis, a lag, and polls
of random length. `PATH_WATCH_MOVES` in the environment changes the 2,000 moves.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cell.robot import model as robot
from cell.world.travel import TravelBound
from drivers.clock import Clock, SimulatedClock
from drivers.contract import Driver
from drivers.errors import DriverError
from drivers.limits import Limits
from drivers.profile import Reference
from drivers.setpoints import PER_DEGREE, Floats, from_rad
from drivers.sim import HOME_DEG, SimDriver
from drivers.simulated_controller import Controller, IdealPlant

TOLERANCE_M = 0.005
NOISE_DEG, LAG_S, JITTER_S = 0.01, 0.04, 0.05

Law = Callable[[Floats, float], Floats]
"""Axes [rad] of an arm from via points (N, axes) [rad], the first at the start, and the passed share of the time."""


def kr16_limits(tolerance_m: float = TOLERANCE_M) -> Limits:
    """Return the limits of the KR 16 with the path tolerance of `cell scan`."""
    model = robot.load()
    allowed = np.degrees(tolerance_m / np.maximum(TravelBound(model).reach(6), 0.1)) * PER_DEGREE
    return replace(Limits.from_rad(robot.limits(model)), path_tolerance=allowed)


def _on_path(via: Floats, share: float) -> Floats:
    segment = min(int(share * (len(via) - 1)), len(via) - 2)
    return np.asarray(via[segment] + (share * (len(via) - 1) - segment) * (via[segment + 1] - via[segment]))


def _bump(axis: int, degrees: float) -> Law:
    def law(via: Floats, share: float) -> Floats:
        q = _on_path(via, share)
        q[axis] += np.radians(degrees) * np.sin(np.pi * share) ** 2
        return q

    return law


def _one_axis_after_another(via: Floats, share: float) -> Floats:
    count = len(via) - 1
    segment = min(int(share * count), count - 1)
    each = np.clip((share * count - segment) * via.shape[1] - np.arange(via.shape[1]), 0.0, 1.0)
    return np.asarray(via[segment] + each * (via[segment + 1] - via[segment]))


def _overshooting(via: Floats, share: float) -> Floats:
    q, count = _on_path(via, share), len(via) - 1
    segment = min(int(share * count), count - 1)
    if share * count - segment > 0.8:  # past the via point and back
        ahead = via[segment + 1] - via[segment]
        q = q + 0.1 * ahead * np.sin(np.pi * (share * count - segment - 0.8) / 0.2)
    return np.asarray(q)


DEVIATIONS: dict[str, Law] = {
    "via points skipped": lambda via, share: via[0] + share * (via[-1] - via[0]),
    "A2 30 deg off and back": _bump(1, 30.0),
    "A2 at 50 deg, limit 35": _bump(1, 140.0),
    "one axis after another": _one_axis_after_another,
    "overshooting": _overshooting,
    "back and forth": lambda via, share: _on_path(via, share - 0.2 * np.sin(2 * np.pi * share) ** 2 * (share > 0.5)),
    "stuck half-way": lambda via, share: _on_path(via, min(share, 0.5) if share < 1.0 else 0.5),
    "late, then rushing": lambda via, share: _on_path(via, max(0.0, 10.0 * share - 9.0)),
}
"""Arms that do not follow the path."""

VIA_DEG = np.add(HOME_DEG, [[15, 10, -10, 5, 5, 20], [30, -5, 5, -5, -10, -20], [0, 5, -10, 0, 10, 0]])


class DeviantPlant(IdealPlant):
    """An arm that drives a law in place of its reference, and stands at once when it is to brake.

    Args:
        start: (axes,) [rad].
        law: axes over the passed share of the time of a move.
    """

    def __init__(self, start: Floats, law: Law) -> None:
        super().__init__(start)
        self._law, self._stood = law, np.array(start, dtype=np.float64)
        self._is_driving = False

    @property
    def reported_axes(self) -> Floats:
        """(n,) axes of the arm [rad]."""
        if not self._is_driving:
            return self._stood
        return self._law(self._reference.via, min(self._elapsed / self._reference.duration, 1.0))

    def follow(self, reference: Reference) -> None:
        """Take a reference: a move if it begins at rest, else the end of one."""
        self._stood = self.reported_axes
        self._is_driving = self.settled and reference.duration > 0.0
        super().follow(reference)


class NoisyPlant(IdealPlant):
    """An arm on its reference whose encoders report noise and lag.

    Args:
        start: (axes,) [rad].
        rng: of the noise.
    """

    def __init__(self, start: Floats, rng: np.random.Generator) -> None:
        super().__init__(start)
        self._rng = rng

    @property
    def reported_axes(self) -> Floats:
        """(n,) late axes with noise [rad]."""
        late = self._reference.end
        if 0.0 < self._reference.duration > self._elapsed - LAG_S:
            late = self._reference.sample(np.array([self._elapsed - LAG_S]))[0][0]
        return np.asarray(late + np.radians(NOISE_DEG) * self._rng.standard_normal(len(late)))

    @property
    def settled(self) -> bool:
        """True if the report has ended too."""
        return self._elapsed >= self._reference.duration + LAG_S

    def advance(self, seconds: float) -> None:
        """Advance along the reference and past its end."""
        self._elapsed += seconds


class JitteringClock(Clock):
    """A clock whose waits last up to `JITTER_S` longer.

    Args:
        clock: the clock.
        rng: of the jitter.
    """

    def __init__(self, clock: Clock, rng: np.random.Generator) -> None:
        self._clock, self._rng = clock, rng

    def now(self) -> float:
        """Return the seconds of the clock."""
        return self._clock.now()

    def wait(self, seconds: float) -> None:
        """Wait `seconds` and a random time."""
        self._clock.wait(seconds + float(self._rng.uniform(0.0, JITTER_S)))


def count_false_alarms(moves: int, seed: int = 0) -> tuple[int, str]:
    """Return the number of moves that failed on `sim://` although the arm follows its path, and the last message."""
    rng, limits = np.random.default_rng(seed), kr16_limits()
    clock = JitteringClock(SimulatedClock(), rng)
    plant = NoisyPlant(np.radians(HOME_DEG), rng)
    with SimDriver(Controller(plant, limits, clock), clock) as driver:
        return drive_noisy_arm(driver, moves, rng)


def drive_noisy_arm(driver: Driver, moves: int, rng: np.random.Generator) -> tuple[int, str]:
    """Drive random moves; return the number of those that failed, and the last message."""
    home, alarms, message = from_rad(np.radians(HOME_DEG)), 0, ""
    for _ in range(moves):
        via = home + rng.integers(-20 * PER_DEGREE, 20 * PER_DEGREE, (int(rng.integers(1, 5)), 6))
        try:
            driver.move(via.astype(np.int32), float(rng.choice([0.1, 0.3, 1.0])))
        except DriverError as error:
            alarms, message = alarms + 1, str(error)
            driver.stop()
    return alarms, message


def drive_deviation(name: str, speed: float) -> dict[str, Any]:
    """Return the row of one deviation."""
    limits, clock, start = kr16_limits(), SimulatedClock(), np.radians(HOME_DEG)
    plant = DeviantPlant(start, DEVIATIONS[name])
    driver = SimDriver(Controller(plant, limits, clock), clock)
    ended = "done"
    with driver:
        try:
            driver.move(from_rad(np.radians(VIA_DEG)), speed)
        except DriverError as error:
            ended = f"{type(error).__name__}: {error}"
        state = driver.state()
    return {"arm": name, "speed": speed, "seconds": clock.now(), "at rest": state.at_rest, "end": ended}


def run() -> list[dict[str, Any]]:
    """Return a row for each deviation and speed, and one of the false alarms."""
    moves = int(os.environ.get("PATH_WATCH_MOVES", "2000"))
    rows = [drive_deviation(name, speed) for name in DEVIATIONS for speed in (1.0, 0.1)]
    alarms, message = count_false_alarms(moves)
    return [*rows, {"arm": f"{moves} moves on their path", "false alarms": alarms, "end": message}]
