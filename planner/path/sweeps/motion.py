"""All ways to drive a column of poses as a sweep: branches, whole turns and directions, each proven and certified.

The driven set-points are vertices on the line, at most `TUBE` from it between them; all measuring poses are among them.
What is proven stands in `planner.path.sweeps.proof`. Base frame, metres, radians, seconds.
"""

import itertools

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.path.certified_edge import certify_many
from planner.path.sweeps.arm import ScannerArm, axes_named, follow
from planner.path.sweeps.line import DEFAULT_SPEED, SweepLine, SweepSpeed, line_through, rotation_vectors
from planner.path.sweeps.path import Refused, SweepPath, SweepRefusal, Sweeps
from planner.path.sweeps.proof import Proof, prove
from planner.ports import CollisionChecker, JointLimits, Kinematics
from planner.reach.setpoints import from_steps, to_steps
from planner.values import Floats, Ints

TUBE = 5e-5
"""Largest distance [m] of the scanner frame on the joint-linear segments between vertices from the line."""

TUBE_ANGLE = 5e-4
"""Largest angle [rad] likewise."""

_FINEST = 64  # segments in half a cell at most


def sweeps_of(
    T_base_scanner: ArrayLike,
    T_flange_scanner: Floats,
    kinematics: Kinematics,
    limits: JointLimits,
    speed: SweepSpeed = DEFAULT_SPEED,
    checker: CollisionChecker | None = None,
) -> Sweeps:
    """All ways to drive a sweep.

    Args:
        T_base_scanner: (K, 4, 4) the column's poses [m], base frame.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of an arm of six revolute axes.
        limits: range, speeds, accelerations and jerks that hold.
        speed: at which the sweep is driven.
        checker: certifies the vertices' segments where it is given.
    """
    line = line_through(T_base_scanner)
    if line is None:
        return Sweeps((), (Refused(-1, SweepRefusal.NO_LINE, ""),))
    arm = ScannerArm(kinematics, np.asarray(T_flange_scanner, dtype=np.float64))
    paths: list[SweepPath] = []
    refused: list[Refused] = []
    branches = kinematics.inverse(arm.flange(line.at(np.array([0.0, 0.5, 1.0]))))
    for branch in np.flatnonzero(~np.isnan(branches).any(axis=2).all(axis=0)).tolist():
        found = _on_branch(line, branch, arm, limits, speed)
        if isinstance(found, Refused):
            refused.append(found)
            continue
        if checker is not None and (blocker := _collides(found[0].q, checker)) is not None:
            refused.append(Refused(branch, SweepRefusal.COLLISION, blocker))
            continue
        for path in found:
            paths += [path] if line.stands else [path, path.reversed()]
    if not paths and not refused:
        refused.append(Refused(-1, SweepRefusal.OUT_OF_REACH, ""))
    return Sweeps(tuple(paths), tuple(refused))


def _on_branch(
    line: SweepLine, branch: int, arm: ScannerArm, limits: JointLimits, speed: SweepSpeed
) -> list[SweepPath] | Refused:
    """The sweep on one branch, once for each turn that the limits allow; or why not."""
    if line.stands:
        q = from_steps(to_steps(follow(line, branch, arm, np.zeros(1))[0]))
        proven: Proof | Refused = Proof(q, q, 0.0, float("nan"))
    else:
        proven = prove(line, branch, arm, limits, line.cruise(speed))
    if isinstance(proven, Refused):
        return proven
    turns = _turns(proven.low, proven.high, limits)
    if isinstance(turns, str):
        return Refused(branch, SweepRefusal.JOINT_LIMIT, turns)
    vertices, u, pose = _vertices(line, branch, arm)
    profile = line.profile(proven.cruise)
    return [
        SweepPath(line, branch, np.clip(from_steps(to_steps(vertices + turn)), limits.lower, limits.upper), u, pose,
                  profile, proven.sigma)
        for turn in turns
    ]  # fmt: skip


def _vertices(line: SweepLine, branch: int, arm: ScannerArm) -> tuple[Floats, Floats, Ints]:
    """Set-points whose joint-linear segments stay within the tube about the line, their u, and which pose each is."""
    if line.stands:  # all poses are one
        q = from_steps(to_steps(follow(line, branch, arm, np.zeros(1))))
        return np.tile(q, (line.poses, 1)), np.linspace(0.0, 1.0, line.poses), np.arange(line.poses)
    fine = 1
    while fine <= _FINEST:
        u = np.linspace(0.0, 1.0, 2 * line.poses * fine + 1)
        q = follow(line, branch, arm, u)
        rounded = from_steps(to_steps(q))
        middle = arm.scanner(0.5 * (rounded[:-1] + rounded[1:]))
        T = line.at(0.5 * (u[:-1] + u[1:]))
        off = np.linalg.norm(middle[:, :3, 3] - T[:, :3, 3], axis=1).max()
        turned = rotation_vectors(middle[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2))
        if off <= TUBE and np.linalg.norm(turned, axis=1).max() <= TUBE_ANGLE:
            pose = np.full(len(u), -1)
            pose[fine :: 2 * fine] = np.arange(line.poses)
            return q, u, pose
        fine *= 2
    raise PlannerError(
        f"set-points of 1e-4 deg cannot follow a sweep within {TUBE * 1e6:g} micrometres: at the end of this arm they "
        f"are {off * 1e6:.0f} off"
    )


def _turns(low: Floats, high: Floats, limits: JointLimits) -> list[Floats] | str:
    """Whole turns (6,) [rad] that keep all of a sweep within the limits, no turn first; or the axes that forbid it."""
    choices = []
    for axis in range(6):
        counts = sorted(range(-2, 3), key=lambda k: (abs(k), k))
        fits = [
            2.0 * np.pi * k
            for k in counts
            if low[axis] + 2.0 * np.pi * k >= limits.lower[axis] and high[axis] + 2.0 * np.pi * k <= limits.upper[axis]
        ]
        choices.append(fits)
    if not all(choices):
        return axes_named(np.array([not fits for fits in choices]))
    return [np.array(turn) for turn in itertools.product(*choices)]


def _collides(q: Floats, checker: CollisionChecker) -> str | None:
    """What the vertices or the segments between them come too near to; "" where only a segment does, None if free."""
    free = checker.free(q)
    if not free.all():
        return next(iter(checker.contacts(q[int(free.argmin())])), "")
    certified, _ = certify_many(q[:-1], q[1:], checker)
    return None if certified.all() else ""
