"""Closed-form kinematics: poses per second and worst error of the round trip.

Half of the poses are uniform in the joint limits; the other half lie near the wrist's or the elbow's singularity, at
distances from 1e-16 to 1 rad.
"""

import time
from typing import Any

import numpy as np

from cell.robot.arm import kr16_kinematics
from planner.kinematics.closed_form import BRANCHES
from planner.kinematics.setpoints import setpoints

POSES = 100_000
REPEATS = 7


def run() -> list[dict[str, Any]]:
    """Return one row each for inverse kinematics, forward kinematics, and turns and limits."""
    kinematics = kr16_kinematics()
    limits = kinematics.limits
    rng = np.random.default_rng(0)
    q = rng.uniform(limits.lower, limits.upper, (POSES, 6))
    quarter = POSES // 4
    q[:quarter, 4] *= 10.0 ** rng.uniform(-16, 0, quarter)
    stretched = -np.arctan2(-kinematics.arm.a3, kinematics.arm.d4)
    q[quarter : 2 * quarter, 2] = stretched + 10.0 ** rng.uniform(-16, 0, quarter)

    T = kinematics.forward(q)
    branches = kinematics.inverse(T)
    real = ~np.isnan(branches[..., 0])
    back = kinematics.forward(branches.reshape(-1, 6)).reshape(POSES, BRANCHES, 4, 4)
    translation = np.linalg.norm(back[..., :3, 3] - T[:, None, :3, 3], axis=-1)[real]
    # The angle of a small rotation, from the chord: |R - R'| = 2 sqrt(2) sin(angle / 2).
    chord = np.linalg.norm((back - T[:, None])[..., :3, :3], axis=(-2, -1))[real]
    rotation = 2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0))
    reached = setpoints(branches, limits)
    return [
        {
            "what": "inverse, all branches",
            "poses/s": POSES / _best(lambda: kinematics.inverse(T)),
            "worst error m": float(translation.max()),
            "worst error rad": float(rotation.max()),
            "poses without a solution": int((~real.any(axis=1)).sum()),
            "branches a pose": float(real.sum() / POSES),
        },
        {"what": "forward", "poses/s": POSES / _best(lambda: kinematics.forward(q))},
        {
            "what": "limits and turns",
            "poses/s": POSES / _best(lambda: setpoints(branches, limits)),
            "branches a pose": float(len(reached.first) / POSES),
            "set-points a pose": float(len(reached.q) / POSES),
        },
    ]


def _best(work: Any) -> float:
    """Return the shortest of several runs [s]; longer ones are disturbed by other processes."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)
