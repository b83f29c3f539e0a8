"""Which candidate viewpoints the robot can take up: inverse kinematics, turns, joint limits, collision (Section 3.4.3).

For each pose of a viewpoint T_base_flange = T_base_object T_object_scanner inv(T_flange_scanner). Every branch of the
inverse kinematics is rounded to the set-points that a controller takes (multiples of 1e-4 deg), *then* held against the
joint limits with all the turns of +-360 deg that they leave room for, and *then* checked for collision: what is found
free is what will be commanded. A turn does not move the arm's geometry, so each branch is checked once.

Rounding moves the scanner by at most 6 axes x 5e-5 deg x reach, about 8 micrometres at 1.6 m.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.kinematics.setpoints import Setpoints, setpoints
from planner.ports import CollisionChecker, Kinematics, Progress
from planner.values import Bools, Floats, Ints, Value, freeze, readonly
from planner.viewpoints.viewpoints import Viewpoints
from planner.worded import Worded

# Viewpoints between two calls of the progress callback: some thousand collision checks, a fraction of a second.
_CHUNK = 512
_RIGID = 1e-6

MAX_FREE_CONFIGURATIONS = 16
"""Free geometries of a pose after which no more are looked at: more than an arm has branches, so that only those of the
angles of a table are left out, the ones that come last in `Kinematics.inverse`."""


class Verdict(Worded):
    """What became of a viewpoint; the value is kept in files."""

    REACHABLE = 0, "reachable without collision"
    OUT_OF_REACH = 1, "out of the arm's reach"
    JOINT_LIMIT = 2, "within the arm's reach, but every solution exceeds a joint limit"
    COLLISION = 3, "every solution within the joint limits collides"


@dataclass(frozen=True, slots=True, eq=False)
class Reach(Value):
    """Verdict and joint solutions of each viewpoint.

    Attributes:
        verdict: (V,) uint8 `Verdict` values.
        q: (total, axes) free set-points [rad], KUKA signs, multiples of 1e-4 deg, ordered by viewpoint, branch, turn.
        offsets: (V + 1,) int64; viewpoint v owns the rows offsets[v] to offsets[v + 1].
        blocker: V names of what blocks, such as "housing with part"; "" unless the verdict is COLLISION.
    """

    verdict: Annotated[NDArray[np.uint8], "V"]
    q: Annotated[Floats, "total axes"]
    offsets: Annotated[Ints, "V+1"]
    blocker: Annotated[tuple[str, ...], "V"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocker", tuple(self.blocker))
        freeze(self)
        counts = np.diff(self.offsets)
        if self.offsets[0] != 0 or self.offsets[-1] != len(self.q) or (counts < 0).any():
            raise PlannerError(f"offsets must rise from 0 to {len(self.q)}, the number of rows of q")
        if ((counts > 0) != (self.verdict == Verdict.REACHABLE)).any():
            raise PlannerError("a viewpoint must have rows of q if, and only if, its verdict is REACHABLE")

    def __len__(self) -> int:
        return len(self.verdict)

    @property
    def reachable(self) -> Bools:
        """(V,) True where the verdict is REACHABLE: the columns that a view plan may use."""
        return np.asarray(self.verdict == Verdict.REACHABLE)

    def configurations_of(self, viewpoint: int) -> Floats:
        """(n, axes) free set-points of one viewpoint [rad]; empty unless it is reachable."""
        return self.q[self.offsets[viewpoint] : self.offsets[viewpoint + 1]]

    def counts(self) -> dict[Verdict, int]:
        """How many viewpoints have each verdict."""
        return {verdict: int(np.count_nonzero(self.verdict == verdict)) for verdict in Verdict}

    def blockers(self) -> dict[str, int]:
        """How many viewpoints each blocker costs, the worst first."""
        return dict(Counter(name for name in self.blocker if name).most_common())


def solve_reach(
    viewpoints: Viewpoints,
    T_base_object: ArrayLike,
    T_flange_scanner: ArrayLike,
    kinematics: Kinematics,
    checker: CollisionChecker,
    *,
    progress: Progress | None = None,
) -> Reach:
    """Verdict and all free set-points of every viewpoint, at one placement of the part.

    A viewpoint of several poses (K > 1, a sweep) is reachable when each of its poses is; verdict and blocker are those
    of the first pose that fails, q holds the set-points of the first pose. Whether the sweep can be driven from pose to
    pose without a change of branch is not asked here.

    The blocker is the name that is nearest in most of the solutions of the pose.

    Args:
        viewpoints: V candidates.
        T_base_object: (4, 4) placement of the part [m].
        T_flange_scanner: (4, 4) mount of the scanner [m].
        kinematics: of the arm; its limits are the joint limits.
        checker: of the cell at this placement.
        progress: called with (viewpoints done, V) after each chunk; what it raises ends the search.

    Raises:
        PlannerError: if a transform is not rigid.
    """
    T_base_object, T_scanner_flange = _rigid("T_base_object", T_base_object), _inverse_mount(T_flange_scanner)
    total, poses = viewpoints.T_object_scanner.shape[:2]
    axes = len(kinematics.limits.lower)
    if poses == 0:
        raise PlannerError("T_object_scanner has no pose per viewpoint; K must be 1 or more")
    verdict = np.full(total, Verdict.REACHABLE, dtype=np.uint8)
    blocker = [""] * total
    free_q: list[Floats] = []
    free_count = np.zeros(total, dtype=np.int64)
    for start in range(0, total, _CHUNK):
        chunk = np.arange(start, min(start + _CHUNK, total))
        alive, q, owner = chunk, np.empty((0, axes)), np.empty(0, dtype=np.int64)
        for k in range(poses):
            T_base_flange = T_base_object @ viewpoints.T_object_scanner[alive, k] @ T_scanner_flange
            found, solved, free = _solve_poses(T_base_flange, kinematics, checker)
            verdict[alive] = found
            for row in np.flatnonzero(found == Verdict.COLLISION):
                blocker[alive[row]] = _blocker(solved.q[solved.first[solved.pose[solved.first] == row]], checker)
            if k == 0:
                q, owner = solved.q[free], alive[solved.pose[free]]
            alive = alive[found == Verdict.REACHABLE]
        kept = verdict[owner] == Verdict.REACHABLE
        free_q.append(q[kept])
        free_count[chunk] = np.bincount(owner[kept] - start, minlength=len(chunk))
        if progress is not None:
            progress(int(chunk[-1]) + 1, total)
    offsets = np.concatenate(([0], np.cumsum(free_count)))
    return Reach(verdict, np.concatenate(free_q) if free_q else np.empty((0, axes)), offsets, tuple(blocker))


def are_reachable(
    T_object_scanner: Floats,
    T_base_object: ArrayLike,
    T_flange_scanner: ArrayLike,
    kinematics: Kinematics,
    checker: CollisionChecker,
) -> Bools:
    """Whether the arm takes up each view, by the same rules as `solve`, which tells how and why not as well.

    A branch is looked at only where none before it was free, which saves most of the collision checks.

    Args:
        T_object_scanner: (N, K, 4, 4) views of K poses [m], all of which must be taken up.
        T_base_object: (4, 4) placement of the part [m].
        T_flange_scanner: (4, 4) mount of the scanner [m].
        kinematics: of the arm; its limits are the joint limits.
        checker: of the cell at this placement.

    Returns:
        (N,) True where a view is reachable.

    Raises:
        PlannerError: if a transform is not rigid.
    """
    T_base_object, T_scanner_flange = _rigid("T_base_object", T_base_object), _inverse_mount(T_flange_scanner)
    taken = np.zeros(len(T_object_scanner), dtype=np.bool_)
    for start in range(0, len(T_object_scanner), _CHUNK):
        alive = np.arange(start, min(start + _CHUNK, len(T_object_scanner)))
        for k in range(T_object_scanner.shape[1]):
            T_base_flange = T_base_object @ T_object_scanner[alive, k] @ T_scanner_flange
            alive = alive[_any_free(T_base_flange, kinematics, checker)]
        taken[alive] = True
    return taken


def _any_free(T_base_flange: Floats, kinematics: Kinematics, checker: CollisionChecker) -> Bools:
    """(N,) whether a solution of each pose is within the limits and free."""
    solved = setpoints(kinematics.inverse(T_base_flange), kinematics.limits)
    q, pose = solved.q[solved.first], solved.pose[solved.first]
    found = np.zeros(len(T_base_flange), dtype=np.bool_)
    turn = np.arange(len(pose)) - np.searchsorted(pose, pose)  # of the branches within the limits, which it is
    for branch in range(int(turn.max(initial=-1)) + 1):
        asked = np.flatnonzero((turn == branch) & ~found[pose])
        found[pose[asked[checker.free(q[asked])]]] = True
    return found


def _inverse_mount(T_flange_scanner: ArrayLike) -> Floats:
    """(4, 4) T_scanner_flange [m]."""
    T_flange_scanner = _rigid("T_flange_scanner", T_flange_scanner)
    T_scanner_flange = np.eye(4)
    T_scanner_flange[:3, :3] = T_flange_scanner[:3, :3].T
    T_scanner_flange[:3, 3] = -T_flange_scanner[:3, :3].T @ T_flange_scanner[:3, 3]
    return T_scanner_flange


def _solve_poses(
    T_base_flange: Floats, kinematics: Kinematics, checker: CollisionChecker
) -> tuple[NDArray[np.uint8], Setpoints, Bools]:
    """Verdict of each pose, its set-points within the limits, and which of these are free."""
    solved = setpoints(kinematics.inverse(T_base_flange), kinematics.limits)
    free = _free(solved, checker)[solved.geometry]
    found = np.where(solved.real, Verdict.JOINT_LIMIT, Verdict.OUT_OF_REACH).astype(np.uint8)
    found[solved.pose] = Verdict.COLLISION
    found[solved.pose[free]] = Verdict.REACHABLE
    return found, solved, free


def _free(solved: Setpoints, checker: CollisionChecker) -> Bools:
    """(g,) which geometries are free, of each pose until `ENOUGH` are; the others count as not free."""
    q, pose = solved.q[solved.first], solved.pose[solved.first]
    free = np.zeros(len(q), dtype=np.bool_)
    number = np.arange(len(pose)) - np.searchsorted(pose, pose)
    found = np.zeros(len(solved.real), dtype=np.int64)
    for start in range(0, int(number.max(initial=-1)) + 1, MAX_FREE_CONFIGURATIONS):
        asked = np.flatnonzero(
            (number >= start) & (number < start + MAX_FREE_CONFIGURATIONS) & (found[pose] < MAX_FREE_CONFIGURATIONS)
        )
        free[asked] = checker.free(q[asked])
        found += np.bincount(pose[asked[free[asked]]], minlength=len(found))
    return free


def _blocker(q: Floats, checker: CollisionChecker) -> str:
    """What is nearest in most of the first configurations of q (n, axes); the earlier one decides a tie."""
    nearest = []
    for configuration in q[:MAX_FREE_CONFIGURATIONS]:
        names = checker.contacts(configuration)
        if not names:
            raise PlannerError(
                f"the collision checker calls q = {np.rad2deg(configuration).round(4).tolist()} deg not free but names "
                "no contact; free and contacts must use the same clearance"
            )
        nearest.append(names[0])
    return Counter(nearest).most_common(1)[0][0]


def _rigid(name: str, T: ArrayLike) -> Floats:
    pose = readonly(name, T, (4, 4))
    R = pose[:3, :3]
    off = max(np.abs(R @ R.T - np.eye(3)).max(), np.abs(pose[3] - (0, 0, 0, 1)).max(), abs(np.linalg.det(R) - 1.0))
    if not (off < _RIGID and np.isfinite(pose).all()):
        raise PlannerError(
            f"{name} is not a rigid transform; its rotation must be right-handed and orthonormal to {_RIGID:g}"
        )
    return pose


def add_configurations(reached: Reach, views: Ints, q: Floats) -> Reach:
    """The same with a joint solution (n, axes) [rad] of each of (n,) reachable viewpoints, where it is not there."""
    more = [k for k, view in enumerate(views) if not (reached.configurations_of(int(view)) == q[k]).all(axis=1).any()]
    ends = reached.offsets[1:].copy()
    for view in views[more]:
        ends[view:] += 1
    solutions = np.insert(reached.q, reached.offsets[views[more] + 1], q[more], axis=0)
    return replace(reached, q=solutions, offsets=np.concatenate([[0], ends]))


def join_reach(parts: Sequence[Reach]) -> Reach:
    """Verdicts and solutions in the order of the parts."""
    counts = np.concatenate([np.diff(part.offsets) for part in parts])
    return Reach(
        np.concatenate([part.verdict for part in parts]),
        np.concatenate([part.q for part in parts]),
        np.concatenate([[0], np.cumsum(counts)]),
        tuple(name for part in parts for name in part.blocker),
    )


def pick_reach(reached: Reach, which: Ints) -> Reach:
    """Verdicts and solutions of some viewpoints, (n,) rows in the order that is wanted."""
    counts = np.diff(reached.offsets)[which]
    rows = np.repeat(reached.offsets[which] - np.cumsum(counts) + counts, counts) + np.arange(int(counts.sum()))
    return Reach(
        reached.verdict[which],
        reached.q[rows],
        np.concatenate([[0], np.cumsum(counts)]),
        tuple(reached.blocker[view] for view in which),
    )
