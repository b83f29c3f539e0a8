"""One hard move of the dynamic arm, recorded at every simulation step.

Three segments with every axis, at full speed and acceleration and without a jerk limit, so that accelerations jump. It
is the reference for the comparison of time steps, integrators and gains. Metres, radians, seconds.
"""

from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from cell.robot import model as robot
from cell.robot.arm import kinematics_of
from cell.robot.model import load
from cell.robot.plant import PlantSettings
from cell.scan import plants
from drivers.profile import Reference, interpolate
from drivers.simulated_controller import SETTLE_LIMIT
from planner.kinematics.closed_form import KukaKinematics
from planner.values import Floats

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
MOVE = np.radians([[60, -60, 60, 40, 60, 100], [-40, -20, 20, -80, 30, -100], [0, -90, 90, 0, 90, 0]])
MOUNT = 0.12
"""From the flange to the point that is watched [m]."""

_POLL = 0.004  # period of a controller's check for rest [s]


class Trace:
    """Record of a plant's observer."""

    def __init__(self) -> None:
        self.references: list[Reference] = []
        self.steps: list[list[tuple[Floats, Floats]]] = []

    def __call__(self, reference: Reference, times: Floats, axes: Floats) -> None:
        """Record steps, as a `cell.robot.plant.Observer`."""
        if not self.references or self.references[-1] is not reference:
            self.references.append(reference)
            self.steps.append([])
        self.steps[-1].append((times, axes))

    def axes(self) -> tuple[Floats, Floats]:
        """Return times (N,) since the beginning of the first reference, and axes (N, 6) during it."""
        times, axes = (np.concatenate(parts) for parts in zip(*self.steps[0], strict=True))
        return times, axes

    def errors(self, kinematics: KukaKinematics, T_flange_scanner: Floats) -> dict[str, Floats]:
        """Return for each step reference and true position (N, 3) [m], speed (N,) [m/s], path deviation (N,) [m]."""
        found: dict[str, list[Floats]] = {"reference": [], "true": [], "velocity": [], "off": []}

        def position(q: Floats) -> Floats:
            return np.asarray((kinematics.forward(q) @ T_flange_scanner)[:, :3, 3])

        for reference, steps in zip(self.references, self.steps, strict=True):
            times, axes = (np.concatenate(parts) for parts in zip(*steps, strict=True))
            ahead = position(reference.sample(times + 5e-6)[0]) - position(reference.sample(times - 5e-6)[0])
            path = position(reference.sample(np.linspace(0.0, reference.duration, 20_000))[0])
            true = position(axes)
            found["reference"].append(position(reference.sample(times)[0]))
            found["true"].append(true)
            found["velocity"].append(ahead / 1e-5)
            found["off"].append(_to_polyline(true, path))
        return {name: np.concatenate(parts) for name, parts in found.items()}


def _to_polyline(points: Floats, path: Floats) -> Floats:
    """Return distances (N,) of points (N, 3) to a dense path (M, 3), to the segments at the nearest vertex."""
    nearest = cKDTree(path).query(points)[1]
    best = np.full(len(points), np.inf)
    for first in (np.maximum(nearest - 1, 0), np.minimum(nearest, len(path) - 2)):
        a, b = path[first], path[first + 1]
        length = np.maximum(((b - a) ** 2).sum(axis=1), 1e-30)
        s = np.clip(((points - a) * (b - a)).sum(axis=1) / length, 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - s[:, None] * (b - a), axis=1))
    return best


@dataclass(frozen=True, slots=True, eq=False)
class OneMove:
    """The simulated move.

    Attributes:
        outcome: settled; restless (not at rest within the controller's limit); failed.
        trace: every step.
        duration: of the reference [s].
        processor_s: processor time of the simulation [s].
        waited: time from the end of the reference until the arm was at rest [s].
    """

    outcome: str
    trace: Trace
    duration: float
    processor_s: float
    waited: float

    def tracking_error(self) -> float:
        """Return the largest distance of the flange's point from its reference at the same time [m]."""
        errors = self.trace.errors(kinematics_of(load()), _mount())
        return float(np.linalg.norm(errors["true"] - errors["reference"], axis=1).max())

    def positions(self) -> tuple[Floats, Floats]:
        """Return times (N,) [s] and positions (N, 3) [m] of the flange's point at each step."""
        times, axes = self.trace.axes()
        return times, np.asarray((kinematics_of(load()).forward(axes) @ _mount())[:, :3, 3])


def one_move(settings: PlantSettings) -> OneMove:
    """Drive the move with a plant of these settings."""
    limits = robot.limits(load())
    reference = interpolate(HOME, MOVE, limits.velocity, limits.acceleration)
    trace = Trace()
    plant: Any = plants.built_in_plants(settings, trace)["mujoco"](HOME)
    plant.follow(reference)
    seconds = process_time()
    plant.advance(reference.duration)
    seconds = process_time() - seconds
    waited = 0.0
    while not plant.settled and not plant.failure and waited < SETTLE_LIMIT:
        plant.advance(_POLL)
        waited += _POLL
    outcome = "failed" if plant.failure else "settled" if plant.settled else "restless"
    return OneMove(outcome, trace, reference.duration, seconds, waited)


def _mount() -> Floats:
    T = np.eye(4)
    T[2, 3] = MOUNT
    return T
