"""Drivable sweeps: the branches, full turns and directions of a column of poses, each proven and certified.

The set-points of a sweep are vertices on its line (`planner.path.sweep_line`); between them the path deviates from the
line by at most `TUBE`. All measuring poses are vertices. Base frame, metres, radians, seconds.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.geometry.rigid import rotation_vectors
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
)
from planner.ports import CollisionChecker, JointLimits, Kinematics
from planner.timing.s_curve import Profile, sample_profile
from planner.values import Floats, Ints, Value

TUBE = 5e-5
"""Largest distance [m] of the scanner frame from the line on the joint-linear segments between vertices."""

TUBE_ANGLE = 5e-4
"""Largest angle [rad] likewise."""

_FINEST = 64  # largest number of segments in half a cell


@dataclass(frozen=True, slots=True, eq=False)
class SweepPath(Value):
    """A sweep on one branch, in one direction.

    Attributes:
        line: in the driven direction.
        branch: index in the inverse kinematics.
        q: (m, 6) vertices [rad], multiples of 1e-4 deg; at rest at the first and the last, no stop between.
        u: (m,) their parameters, rising from 0 to 1.
        pose: (m,) pose of the column that is measured at the vertex, -1 for none; falling if driven backwards.
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
        """Return the same sweep driven from its end to its beginning; the axis of the turn keeps its direction."""
        line = SweepLine(self.line.at(np.ones(1))[0], -self.line.displacement, -self.line.turn, self.line.poses)
        return SweepPath(line, self.branch, self.q[::-1], 1.0 - self.u[::-1], self.pose[::-1], self.profile, self.sigma)


@dataclass(frozen=True, slots=True, eq=False)
class DrivableSweeps:
    """All ways to drive a column of poses.

    Attributes:
        paths: every branch and turn that can be driven, in both directions.
        refused: the other branches that exist, with reasons.
    """

    paths: tuple[SweepPath, ...]
    refused: tuple[RefusedSweep, ...]


def find_sweeps(
    T_base_scanner: ArrayLike,
    T_flange_scanner: Floats,
    kinematics: Kinematics,
    limits: JointLimits,
    speed: SweepSpeed = DEFAULT_SPEED,
    checker: CollisionChecker | None = None,
) -> DrivableSweeps:
    """Find all ways to drive a sweep.

    Args:
        T_base_scanner: (K, 4, 4) poses of the column [m].
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of an arm with six revolute axes.
        limits: range, speeds, accelerations and jerks of the axes.
        speed: of the sweep.
        checker: certifies the segments between the vertices; None: no collision check.
    """
    line = line_through(T_base_scanner)
    if line is None:
        return DrivableSweeps((), (RefusedSweep(-1, SweepRefusal.NO_LINE, ""),))
    arm = ScannerArm(kinematics, np.asarray(T_flange_scanner, dtype=np.float64))
    paths: list[SweepPath] = []
    refused: list[RefusedSweep] = []
    branches = kinematics.inverse(arm.flange(line.at(np.array([0.0, 0.5, 1.0]))))
    for branch in np.flatnonzero(~np.isnan(branches).any(axis=2).all(axis=0)).tolist():
        outcome = _on_branch(line, branch, arm, limits, speed)
        if isinstance(outcome, RefusedSweep):
            refused.append(outcome)
            continue
        if checker is not None and (blocker := _find_blocker(outcome[0].q, checker)) is not None:
            refused.append(RefusedSweep(branch, SweepRefusal.COLLISION, blocker))
            continue
        for path in outcome:
            paths += [path] if line.is_stationary else [path, path.reversed()]
    if not paths and not refused:
        refused.append(RefusedSweep(-1, SweepRefusal.OUT_OF_REACH, ""))
    return DrivableSweeps(tuple(paths), tuple(refused))


def _on_branch(
    line: SweepLine, branch: int, arm: ScannerArm, limits: JointLimits, speed: SweepSpeed
) -> list[SweepPath] | RefusedSweep:
    """Return the sweep on one branch, once per turn that the limits allow, or the refusal."""
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
    rounded = (np.clip(from_steps(to_steps(vertices + turn)), limits.lower, limits.upper) for turn in turns)
    return [SweepPath(line, branch, q, u, pose, profile, proven.sigma) for q in rounded]


def _vertices(line: SweepLine, branch: int, arm: ScannerArm) -> tuple[Floats, Floats, Ints]:
    """Return set-points whose joint-linear segments stay in the tube about the line, their u, and the pose of each."""
    if line.is_stationary:
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
    """Return full turns (6,) [rad] that keep the sweep within the limits, none first; or the axes that prevent it."""
    choices = [
        [
            2.0 * np.pi * k
            for k in (0, -1, 1, -2, 2)
            if low[axis] + 2.0 * np.pi * k >= limits.lower[axis] and high[axis] + 2.0 * np.pi * k <= limits.upper[axis]
        ]
        for axis in range(6)
    ]
    if not all(choices):
        return join_axis_names(np.array([not fits for fits in choices]))
    return [np.array(turn) for turn in itertools.product(*choices)]


def _find_blocker(q: Floats, checker: CollisionChecker) -> str | None:
    """Return the pair that is too close at a vertex, "" if only a segment collides, None if all is free."""
    free = checker.free(q)
    if not free.all():
        return next(iter(checker.contacts(q[int(free.argmin())])), "")
    certified, _ = certify_many(q[:-1], q[1:], checker)
    return None if certified.all() else ""


@dataclass(frozen=True, slots=True, eq=False)
class SweepTraversal(Value):
    """Motion of the arm at a view between arriving and leaving, as a tour sees it: the line of a sweep.

    Attributes:
        via: (m, axes) certified via points [rad], from the arrival to the departure.
        pose: (m,) pose of the view taken at each, -1 for none.
        duration: of the traversal [s].
        leaves: index of the configuration of the same view at which the next traversal would begin here.
    """

    via: Annotated[Floats, "m axes"]
    pose: Annotated[Ints, "m"]
    duration: float
    leaves: int

    @property
    def middle(self) -> Floats:
        """(axes,) joint angles at the middle pose [rad]."""
        return np.asarray(self.via[int(np.flatnonzero(self.pose == (self.pose >= 0).sum() // 2)[0])])


def sweep_traversals(paths: Sequence[SweepPath]) -> list[SweepTraversal]:
    """Return the sweeps of one view as traversals; each needs its reverse among them, unless it is stationary."""
    begins = {tuple(to_steps(path.q[0]).tolist()): i for i, path in enumerate(paths)}
    traversals = []
    for path in paths:
        leaves = begins.get(tuple(to_steps(path.q[-1]).tolist()))
        if leaves is None:
            raise PlannerError("a sweep's reverse is missing; give both directions of every sweep")
        traversals.append(SweepTraversal(path.q, path.pose, path.duration, leaves))
    return traversals


@dataclass(frozen=True, slots=True, eq=False)
class TimedSweep:
    """A sweep with its timing: a `planner.timing.motion.TimedLine`.

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
        """(m,) times of the vertices after the start [s]."""
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
        """Return joint angles (n, 6) [rad], speeds [rad/s], accelerations [rad/s^2] at (n,) times from the start [s].

        The ends are the set-points of the path. Between them the angles follow the line; the rounding of the ends (at
        most 5e-5 deg) is blended from one to the other.
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
