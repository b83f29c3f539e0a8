"""A sweep on one joint branch as a value: its set-points and speed, or why it cannot be driven.

A sweep as a tour sees it: where the arm arrives, where it leaves, and how long it takes.

All ways to drive a column of poses as a sweep: branches, whole turns and directions, each proven and certified.

The driven set-points are vertices on the line, at most `TUBE` from it between them; all measuring poses are among them.
What is proven stands in `planner.path.sweep_line`. Base frame, metres, radians, seconds.

Joint angles, speeds and accelerations of a sweep over time. Base frame, metres, radians, seconds.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.kinematics.setpoints import from_steps, to_steps
from planner.path.certified_edge import certify_many
from planner.path.sweep_line import (
    DEFAULT_SPEED,
    RefusedSweep,
    ScannerArm,
    SweepLine,
    SweepProof,
    SweepRefusal,
    SweepSpeed,
    follow_branch,
    join_axis_names,
    joint_derivatives,
    line_through,
    prove_branch,
    rotation_vectors,
)
from planner.ports import CollisionChecker, JointLimits, Kinematics
from planner.timing.s_curve import Profile, sample_profile
from planner.values import Floats, Ints, Value


@dataclass(frozen=True, slots=True, eq=False)
class SweepPath(Value):
    """A sweep on one branch, in one direction.

    Attributes:
        line: in the direction in which it is driven.
        branch: slot of the inverse kinematics.
        q: (m, 6) vertices [rad], multiples of 1e-4 deg; at rest at the first and the last, passed without stop between.
        u: (m,) their parameters, rising from 0 to 1.
        pose: (m,) pose of the column that is measured at the vertex, -1 for none; falling where driven backwards.
        profile: of u over time.
        sigma: smallest singular value of the Jacobian on it (linear rows over the largest lever); 0 is singular.
    """

    line: SweepLine
    branch: int
    q: Annotated[Floats, "m 6"]
    u: Annotated[Floats, "m"]
    pose: Annotated[Ints, "m"]
    profile: Profile
    sigma: float

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return float(self.profile.duration)

    @property
    def measured_q(self) -> Floats:
        """(K, 6) set-points of the measuring poses, in the order of the column [rad]."""
        rows = np.flatnonzero(self.pose >= 0)
        return np.asarray(self.q[rows[np.argsort(self.pose[rows])]])

    def reversed(self) -> "SweepPath":
        """The same sweep driven from its end to its beginning."""
        line = SweepLine(
            self.line.at(np.ones(1))[0], -self.line.displacement, -self.line.turn, self.line.poses
        )  # the turn's axis keeps its direction
        return SweepPath(line, self.branch, self.q[::-1], 1.0 - self.u[::-1], self.pose[::-1], self.profile, self.sigma)


@dataclass(frozen=True, slots=True, eq=False)
class DrivableSweeps:
    """What can be driven of a column of poses.

    Attributes:
        paths: every branch and turn that can be driven, each in both directions.
        refused: the other branches that exist, and why not.
    """

    paths: tuple[SweepPath, ...]
    refused: tuple[RefusedSweep, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SweepTraversal(Value):
    """What the arm does at a view between arriving and leaving: the line of a sweep.

    Attributes:
        via: (m, axes) via points [rad], certified, the first where the arm arrives and the last where it leaves.
        pose: (m,) pose of the view that is taken at each, -1 for none.
        duration: of the passage [s].
        leaves: joint solution of the same view (its index) that begins where this one ends.
    """

    via: Annotated[Floats, "m axes"]
    pose: Annotated[Ints, "m"]
    duration: float
    leaves: int

    @property
    def middle(self) -> Floats:
        """(axes,) joint angles at the middle one of its poses [rad]."""
        return np.asarray(self.via[int(np.flatnonzero(self.pose == (self.pose >= 0).sum() // 2)[0])])


def sweep_traversals(paths: Sequence[SweepPath]) -> list[SweepTraversal]:
    """The sweeps of one view as passages of a tour; the reverse of each must be among them, unless it stands.

    Raises:
        PlannerError: if a sweep cannot be left for want of its reverse.
    """
    begins = {tuple(to_steps(path.q[0]).tolist()): i for i, path in enumerate(paths)}
    passages = []
    for path in paths:
        leaves = begins.get(tuple(to_steps(path.q[-1]).tolist()))
        if leaves is None:
            raise PlannerError("a sweep's reverse is missing; give both directions of every sweep")
        passages.append(SweepTraversal(path.q, path.pose, path.duration, leaves))
    return passages


TUBE = 5e-5
"""Largest distance [m] of the scanner frame on the joint-linear segments between vertices from the line."""

TUBE_ANGLE = 5e-4
"""Largest angle [rad] likewise."""

_FINEST = 64  # segments in half a cell at most


def find_sweeps(
    T_base_scanner: ArrayLike,
    T_flange_scanner: Floats,
    kinematics: Kinematics,
    limits: JointLimits,
    speed: SweepSpeed = DEFAULT_SPEED,
    checker: CollisionChecker | None = None,
) -> DrivableSweeps:
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
        return DrivableSweeps((), (RefusedSweep(-1, SweepRefusal.NO_LINE, ""),))
    arm = ScannerArm(kinematics, np.asarray(T_flange_scanner, dtype=np.float64))
    paths: list[SweepPath] = []
    refused: list[RefusedSweep] = []
    branches = kinematics.inverse(arm.flange(line.at(np.array([0.0, 0.5, 1.0]))))
    for branch in np.flatnonzero(~np.isnan(branches).any(axis=2).all(axis=0)).tolist():
        found = _on_branch(line, branch, arm, limits, speed)
        if isinstance(found, RefusedSweep):
            refused.append(found)
            continue
        if checker is not None and (blocker := _collides(found[0].q, checker)) is not None:
            refused.append(RefusedSweep(branch, SweepRefusal.COLLISION, blocker))
            continue
        for path in found:
            paths += [path] if line.is_stationary else [path, path.reversed()]
    if not paths and not refused:
        refused.append(RefusedSweep(-1, SweepRefusal.OUT_OF_REACH, ""))
    return DrivableSweeps(tuple(paths), tuple(refused))


def _on_branch(
    line: SweepLine, branch: int, arm: ScannerArm, limits: JointLimits, speed: SweepSpeed
) -> list[SweepPath] | RefusedSweep:
    """The sweep on one branch, once for each turn that the limits allow; or why not."""
    if line.is_stationary:
        q = from_steps(to_steps(follow_branch(line, branch, arm, np.zeros(1))[0]))
        proven: SweepProof | RefusedSweep = SweepProof(q, q, 0.0, float("nan"))
    else:
        proven = prove_branch(line, branch, arm, limits, line.cruise(speed))
    if isinstance(proven, RefusedSweep):
        return proven
    turns = _turns(proven.low, proven.high, limits)
    if isinstance(turns, str):
        return RefusedSweep(branch, SweepRefusal.JOINT_LIMIT, turns)
    vertices, u, pose = _vertices(line, branch, arm)
    profile = line.profile(proven.cruise)
    return [
        SweepPath(line, branch, np.clip(from_steps(to_steps(vertices + turn)), limits.lower, limits.upper), u, pose,
                  profile, proven.sigma)
        for turn in turns
    ]  # fmt: skip


def _vertices(line: SweepLine, branch: int, arm: ScannerArm) -> tuple[Floats, Floats, Ints]:
    """Set-points whose joint-linear segments stay within the tube about the line, their u, and which pose each is."""
    if line.is_stationary:  # all poses are one
        q = from_steps(to_steps(follow_branch(line, branch, arm, np.zeros(1))))
        return np.tile(q, (line.poses, 1)), np.linspace(0.0, 1.0, line.poses), np.arange(line.poses)
    fine = 1
    while fine <= _FINEST:
        u = np.linspace(0.0, 1.0, 2 * line.poses * fine + 1)
        q = follow_branch(line, branch, arm, u)
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
        return join_axis_names(np.array([not fits for fits in choices]))
    return [np.array(turn) for turn in itertools.product(*choices)]


def _collides(q: Floats, checker: CollisionChecker) -> str | None:
    """What the vertices or the segments between them come too near to; "" where only a segment does, None if free."""
    free = checker.free(q)
    if not free.all():
        return next(iter(checker.contacts(q[int(free.argmin())])), "")
    certified, _ = certify_many(q[:-1], q[1:], checker)
    return None if certified.all() else ""


@dataclass(frozen=True, slots=True, eq=False)
class TimedSweep:
    """A sweep with what times it: `planner.timing.motion.TimedLine`.

    Attributes:
        path: the sweep.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of the arm.
    """

    path: SweepPath
    T_flange_scanner: Floats
    kinematics: Kinematics

    @property
    def times(self) -> Floats:
        """(m,) times after the start at which the vertices are passed [s]."""
        path = self.path
        low, high = np.zeros(len(path.u)), np.full(len(path.u), path.duration)
        if path.line.is_stationary:
            return low
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = sample_profile(path.profile, middle)[0] < path.u
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        high[0], high[-1] = 0.0, path.duration
        return high

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Joint angles, speeds and accelerations.

        The ends are the path's set-points; in between the angles follow the line, the ends' rounding (at most 5e-5 deg)
        faded from one to the other.

        Args:
            t: (n,) times after the start [s], in [0, duration].

        Returns:
            (n, 6) q [rad], (n, 6) qd [rad/s], (n, 6) qdd [rad/s^2].
        """
        path = self.path
        if path.line.is_stationary:
            return np.repeat(path.q[:1], len(t), axis=0), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        arm = ScannerArm(self.kinematics, np.asarray(self.T_flange_scanner, dtype=np.float64))
        u, ud, udd = sample_profile(path.profile, t)
        grid = np.concatenate([path.u, u])
        order = np.argsort(grid, kind="stable")
        q = np.empty((len(grid), 6))
        q[order] = follow_branch(path.line, path.branch, arm, grid[order])
        q += 2.0 * np.pi * np.round((path.q[0] - q[0]) / (2.0 * np.pi))
        error = path.q[[0, -1]] - q[[0, len(path.u) - 1]]
        q = q[len(path.u) :]
        first, second = joint_derivatives(path.line, q, arm)[:2]
        fade = error[1] - error[0]
        q = q + error[0] + u[:, None] * fade
        first = first + fade
        return q, first * ud[:, None], second * ud[:, None] ** 2 + first * udd[:, None]
