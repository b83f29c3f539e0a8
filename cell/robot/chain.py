"""A serial chain of six hinges as its axes say it: forward kinematics and Jacobian by products of exponentials.

An axis is a line of the base frame, given at q = 0 by a unit direction w and a point p on it. Turning about it by q is
the rigid motion exp(q [w, -w x p]); the flange is at exp(q1 ..) .. exp(q6 ..) T_zero (R. M. Murray, Z. Li,
S. S. Sastry, "A mathematical introduction to robotic manipulation", CRC Press 1994, Section 3.2). Nothing is assumed of
how the axes lie: this is what every closed form is measured against. Metres and radians.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.values import Floats, Value


@dataclass(frozen=True, slots=True, eq=False)
class Chain(Value):
    """The six axes and the flange at q = 0, base frame.

    Attributes:
        directions: (6, 3) unit vectors; positive q turns right-handed about them.
        points: (6, 3) a point on each axis [m].
        T_zero: (4, 4) T_base_flange at q = 0 [m].
    """

    directions: Annotated[Floats, "6 3"]
    points: Annotated[Floats, "6 3"]
    T_zero: Annotated[Floats, "4 4"]

    def forward(self, q: Floats) -> Floats:
        """(N, 4, 4) T_base_flange [m] at q (N, 6) [rad].

        Raises:
            PlannerError: if the shape is wrong.
        """
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != 6:
            raise PlannerError(f"q has shape {q.shape}; it must be (N, 6)")
        R = np.broadcast_to(self.T_zero[:3, :3], (len(q), 3, 3))
        t = np.broadcast_to(self.T_zero[:3, 3], (len(q), 3))
        for axis in range(5, -1, -1):
            turn = turns(self.directions[axis], q[:, axis])
            R = turn @ R
            t = (turn @ (t - self.points[axis])[..., None])[..., 0] + self.points[axis]
        T = np.zeros((len(q), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, t, 1.0
        return T

    def jacobian(self, q: Floats, at: Floats) -> Floats:
        """(N, 6, 6) geometric Jacobian at q (N, 6) [rad].

        Rows 0..2 are the velocity of the points `at` (N, 3) [m], rows 3..5 the angular velocity, base frame, for each
        axis' speed [rad/s].
        """
        rows = np.empty((len(q), 6, 6))
        R, t = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        for axis in range(6):
            w = R @ self.directions[axis]
            rows[:, :3, axis] = np.cross(w, at - (R @ self.points[axis] + t))
            rows[:, 3:, axis] = w
            turn = turns(self.directions[axis], q[:, axis])
            t = (R @ (self.points[axis] - turn @ self.points[axis])[..., None])[..., 0] + t
            R = R @ turn
        return rows


def turns(w: Floats, angle: Floats) -> Floats:
    """(N, 3, 3) rotations about the unit vector w by the angles (N,) (Rodrigues)."""
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    turns: Floats = np.eye(3) + s * K + (1.0 - c) * (K @ K)
    return turns
