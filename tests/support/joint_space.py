"""Limits of a KR 16 and a toy cell in joint space: a point among boxes, whose distances are exact."""

import numpy as np

from planner.path.certified_edge import quantise
from planner.ports import JointLimits

RANGE = np.radians([185, 150, 150, 350, 130, 350])
SPEED = np.radians([156.0, 156, 156, 330, 330, 615])
KR16_LIMITS = JointLimits(
    np.radians([-185, -155, -130, -350, -130, -350]), np.radians([185, 35, 154, 350, 130, 350]), SPEED, 2 * SPEED
)
SYMMETRIC_LIMITS = JointLimits(-RANGE, RANGE, SPEED, 2 * SPEED)
BIG = 100.0


class Boxes:
    """A collision checker of a 'tool' among boxes: it moves 1 m per rad along three axes, 1 cm along the others.

    Attributes:
        checked: number of configurations that were checked.
        interrupt_after: number of configurations after which a check raises Ctrl-C.
    """

    clearance = 0.01
    scale = np.array([1, 1, 1, 0.01, 0.01, 0.01])

    def __init__(self, *boxes: tuple[list[float], list[float]]) -> None:
        self.low, self.high = (np.array([box[side] for box in boxes]).reshape(-1, 6) for side in (0, 1))
        self.checked, self.interrupt_after = 0, np.inf

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Return (N, boxes) distances [m]."""
        q = q * self.scale
        return np.linalg.norm(np.maximum(np.maximum(self.low - q[:, None], q[:, None] - self.high), 0.0), axis=2)

    def free(self, q: np.ndarray) -> np.ndarray:
        """Return whether each configuration keeps the clearance."""
        self.checked += len(q)
        if self.checked > self.interrupt_after:
            raise KeyboardInterrupt
        return (self.distances(q) >= self.clearance).all(axis=1)

    def contacts(self, q: np.ndarray) -> tuple[str, ...]:
        """Return the names of the pairs that are too close, the closest first."""
        near = self.distances(q[None])[0]
        return tuple(f"tool with box {k}" for k in np.argsort(near) if near[k] < self.clearance)

    def distance(self, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        """Return the smallest distances [m] and the names of their pairs."""
        near = np.concatenate([self.distances(q), np.full((len(q), 1), 9.0)], axis=1)
        return near.min(axis=1), tuple(f"tool with box {k}" for k in near.argmin(axis=1))

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        """Return an upper bound on the length of the tool's path [m]."""
        return np.abs(np.asarray(q_to) - q_from) @ self.scale


def box(**sides: tuple[float, float]) -> tuple[list[float], list[float]]:
    """Return a box with limits on some axes (x, y, z), unbounded on the others."""
    low, high = [-BIG] * 6, [BIG] * 6
    for axis, (a, b) in sides.items():
        low["xyz".index(axis)], high["xyz".index(axis)] = a, b
    return low, high


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return a set-point with the tool at a place."""
    return quantise([x, y, z, 0, 0, 0])
