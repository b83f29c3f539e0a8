"""Near singularities: the joint speed for 100 mm/s at the tool.

Three singularities, each approached along one joint: the wrist straight (A5 towards 0), the arm stretched (A3) and the
wrist centre over A1 (A3 as well). At each distance the tool, 120 mm beyond the flange, moves at 100 mm/s in its worst
direction without rotation; the share of the speed limit is the largest of all axes. The accuracy of the inverse
kinematics there is a map of `python -m benchmarks stability ik`.
"""

from typing import Any

import numpy as np
from scipy.optimize import brentq

from cell.robot.arm import kr16_kinematics
from planner.kinematics.closed_form import KukaKinematics
from planner.values import Floats

_TOOL, _SPEED = 0.12, 0.1  # m, m/s
_DISTANCES = 10.0 ** np.arange(-5.0, 0.01, 0.25)  # at smaller distances the differences lose digits
_STEP = 1e-6  # step of the central differences [rad]: their error is 1e-10


def run() -> list[dict[str, Any]]:
    """Return a row for each singularity and decade of distance."""
    kinematics = kr16_kinematics()
    rows = []
    for name, (q, joint) in _singular(kinematics).items():
        for distance in _DISTANCES:
            beside = q.copy()
            beside[joint] += distance
            rows.append({"singularity": name, "distance rad": float(distance)} | _beside(kinematics, beside))
    return rows


def _singular(kinematics: KukaKinematics) -> dict[str, tuple[Floats, int]]:
    """Return singular configurations [rad], and the joint along which they are left."""
    arm = kinematics.arm
    stretched = -np.arctan2(-arm.a3, arm.d4)
    a2 = np.radians(-120.0)

    def over_a1(a3: float) -> float:  # distance of the wrist centre from the A1 axis [m]
        return float(arm.a1 + arm.a2 * np.cos(a2) + arm.d4 * np.cos(a2 + a3) + arm.a3 * np.sin(a2 + a3))

    above = brentq(over_a1, np.radians(20), np.radians(50), xtol=1e-15)
    return {
        "wrist straight": (np.radians([20.0, -80, 100, 40, 0, -10]), 4),
        "arm stretched": (np.array([0.0, np.radians(-45), stretched, 0, np.radians(40), 0]), 2),
        "wrist centre over A1": (np.array([0.3, a2, above, 0, np.radians(60), 0]), 2),
    }


def _beside(kinematics: KukaKinematics, q: Floats) -> dict[str, float]:
    jacobian = _jacobian(kinematics, q)
    needed = _SPEED * np.linalg.norm(np.linalg.inv(jacobian)[:, :3], axis=1)
    share = needed / kinematics.limits.velocity
    return {
        "speed of the limit": float(share.max()),
        "axis": int(share.argmax()) + 1,
        "deg/s": float(np.degrees(needed[share.argmax()])),
    }


def _jacobian(kinematics: KukaKinematics, q: Floats) -> Floats:
    """Return the Jacobian (6, 6): velocity of the tool [m/s] and angular velocity [rad/s] per joint speed [rad/s]."""
    nudges = _STEP * np.eye(6)
    ahead, behind = kinematics.forward(q + nudges), kinematics.forward(q - nudges)
    here = kinematics.forward(q[None])[0]
    linear = ((ahead - behind)[:, :3, 3] + _TOOL * (ahead - behind)[:, :3, 2]) / (2 * _STEP)
    spin = (ahead - behind)[:, :3, :3] @ here[:3, :3].T / (2 * _STEP)
    angular = 0.5 * np.stack(
        [spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], axis=1
    )
    return np.concatenate([linear, angular], axis=1).T


def chart(rows: list[dict[str, Any]], folder: Any) -> None:
    """Draw the joint speed over the distance, one line for each singularity."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.5, 4.5))
    for name in dict.fromkeys(row["singularity"] for row in rows):
        points = [row for row in rows if row["singularity"] == name]
        axes.plot([row["distance rad"] for row in points], [row["speed of the limit"] for row in points], label=name)
    axes.axhline(1.0, color="k", lw=0.8)
    axes.text(1.2e-5, 1.15, "speed limit of the axis", fontsize=8)
    axes.set(
        xscale="log", yscale="log", xlabel="distance from the singularity [rad]",
        ylabel="joint speed for 100 mm/s at the tool / limit",
    )  # fmt: skip
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(folder / "singularities.png", dpi=150)
    plt.close(figure)
