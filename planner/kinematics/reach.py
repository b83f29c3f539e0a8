"""Find the configurations with which the robot takes up candidate viewpoints (Section 3.4.3).

T_base_flange = T_base_object T_object_scanner inv(T_flange_scanner) for each pose of a viewpoint. Each branch of the
inverse kinematics is rounded to the set-points of a controller (multiples of 1e-4 deg), *then* compared with the joint
limits with all turns of +-360 deg that they allow, and *then* checked for collision: the commanded configuration is the
checked one. A turn does not move the arm's geometry, so each branch is checked once.

Rounding moves the scanner by at most 6 axes x 5e-5 deg x reach, about 8 micrometres at 1.6 m.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.geometry.rigid import inverse_rigid
from planner.kinematics.setpoints import Setpoints, first_setpoints, setpoints
from planner.ports import CollisionChecker, Kinematics, Progress, no_progress
from planner.values import Bools, DescribedEnum, Floats, Ints, Value, freeze, readonly
from planner.viewpoints.viewpoints import Viewpoints

_CHUNK = 512  # viewpoints between two progress reports: some thousand collision checks, a fraction of a second
_RIGID = 1e-6

MAX_FREE_CONFIGURATIONS = 16
"""Largest number of free geometries per pose: more than an arm has branches, so that only configurations at further
table angles are left out, the last ones of `Kinematics.inverse`."""


class Verdict(DescribedEnum):
    """Result of the search for one viewpoint; the values are stored in files."""

    REACHABLE = 0, "reachable without collision"
    OUT_OF_REACH = 1, "out of the arm's reach"
    JOINT_LIMIT = 2, "within the arm's reach, but every solution exceeds a joint limit"
    COLLISION = 3, "every solution within the joint limits collides"


@dataclass(frozen=True, slots=True, eq=False)
class Reach(Value):
    """Verdicts and configurations of V viewpoints.

    Attributes:
        verdict: (V,) `Verdict` values.
        q: (total, axes) free set-points [rad], KUKA signs, multiples of 1e-4 deg, ordered by viewpoint, branch, turn.
        offsets: (V + 1,) viewpoint v owns the rows offsets[v] to offsets[v + 1].
        blocker: V names of the closest objects, such as "housing with part"; "" unless the verdict is COLLISION.
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
        """(V,) whether the verdict is REACHABLE."""
        return np.asarray(self.verdict == Verdict.REACHABLE)

    def configurations_of(self, viewpoint: int) -> Floats:
        """Return (n, axes) free set-points of one viewpoint [rad]; empty unless it is reachable."""
        return self.q[self.offsets[viewpoint] : self.offsets[viewpoint + 1]]

    def counts(self) -> dict[Verdict, int]:
        """Return the number of viewpoints with each verdict."""
        return {verdict: int(np.count_nonzero(self.verdict == verdict)) for verdict in Verdict}

    def blockers(self) -> dict[str, int]:
        """Return the number of viewpoints that each blocker prevents, largest first."""
        return dict(Counter(name for name in self.blocker if name).most_common())


def solve_reach(
    viewpoints: Viewpoints,
    T_base_object: ArrayLike,
    T_flange_scanner: ArrayLike,
    kinematics: Kinematics,
    checker: CollisionChecker,
    *,
    progress: Progress = no_progress,
) -> Reach:
    """Compute verdict and all free set-points of each viewpoint, for one placement of the part.

    A viewpoint with several poses (K > 1, a sweep) is reachable if each of its poses is. Verdict and blocker are those
    of the first pose that fails; q holds the set-points of the first pose. This function does not decide whether the
    sweep can be driven from pose to pose on one branch. The blocker is the closest pair in most configurations.

    Args:
        viewpoints: V candidates.
        T_base_object: (4, 4) placement of the part [m].
        T_flange_scanner: (4, 4) mount of the scanner [m].
        kinematics: of the arm, with its joint limits.
        checker: collision checker of the cell at this placement.
        progress: called with (viewpoints done, V) after each chunk; its exceptions end the search.
    """
    total = len(viewpoints)
    axes = len(kinematics.limits.lower)
    if viewpoints.T_object_scanner.shape[1] == 0:
        raise PlannerError("T_object_scanner has no pose per viewpoint; K must be 1 or more")
    verdict = np.full(total, Verdict.REACHABLE, dtype=np.uint8)
    blocker = [""] * total
    free_q: list[Floats] = []
    free_count = np.zeros(total, dtype=np.int64)
    for chunk, poses in _flange_poses(viewpoints.T_object_scanner, T_base_object, T_flange_scanner):
        alive, q, owner = chunk, np.empty((0, axes)), np.empty(0, dtype=np.int64)
        for k, T_base_flange in enumerate(poses):
            verdicts, solved, free = _solve_poses(T_base_flange[alive - chunk[0]], kinematics, checker)
            verdict[alive] = verdicts
            for row in np.flatnonzero(verdicts == Verdict.COLLISION):
                blocker[alive[row]] = _blocker(solved.q[solved.first[solved.pose[solved.first] == row]], checker)
            if k == 0:
                q, owner = solved.q[free], alive[solved.pose[free]]
            alive = alive[verdicts == Verdict.REACHABLE]
        is_reachable = verdict[owner] == Verdict.REACHABLE
        free_q.append(q[is_reachable])
        free_count[chunk] = np.bincount(owner[is_reachable] - chunk[0], minlength=len(chunk))
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
    """Return (N,) whether views (N, K, 4, 4) [m] are reachable in all their K poses, by the rules of `solve_reach`.

    Branches are checked in batches of 1, 1, 2, 4, ..., until one of the pose is free, which saves most of the collision
    checks. The other arguments are those of `solve_reach`.
    """
    reachable = np.zeros(len(T_object_scanner), dtype=np.bool_)
    for chunk, poses in _flange_poses(T_object_scanner, T_base_object, T_flange_scanner):
        alive = chunk
        for T_base_flange in poses:
            alive = alive[_any_free(T_base_flange[alive - chunk[0]], kinematics, checker)]
        reachable[alive] = True
    return reachable


def _flange_poses(
    T_object_scanner: Floats, T_base_object: ArrayLike, T_flange_scanner: ArrayLike
) -> Iterator[tuple[Ints, Iterator[Floats]]]:
    """Yield chunks of views: their numbers (n,), and T_base_flange (n, 4, 4) [m] of each of their K poses in turn."""
    T_base_object = _require_rigid("T_base_object", T_base_object)
    T_scanner_flange = inverse_rigid(_require_rigid("T_flange_scanner", T_flange_scanner))
    total, poses = T_object_scanner.shape[:2]
    for start in range(0, total, _CHUNK):
        chunk = np.arange(start, min(start + _CHUNK, total))
        yield chunk, (T_base_object @ T_object_scanner[chunk, k] @ T_scanner_flange for k in range(poses))


def _any_free(T_base_flange: Floats, kinematics: Kinematics, checker: CollisionChecker) -> Bools:
    """Return (N,) whether a configuration of each pose is within the limits and free."""
    q, pose = first_setpoints(kinematics.inverse(T_base_flange), kinematics.limits)
    is_free = np.zeros(len(T_base_flange), dtype=np.bool_)
    number = np.arange(len(pose)) - np.searchsorted(pose, pose)  # among the branches of the pose within the limits
    start, end = 0, 1
    while start <= number.max(initial=-1):  # most poses are free with an early branch: then few are checked in vain
        rows = np.flatnonzero((number >= start) & (number < end) & ~is_free[pose])
        is_free[pose[rows[checker.free(q[rows])]]] = True
        start, end = end, 2 * end
    return is_free


def _solve_poses(
    T_base_flange: Floats, kinematics: Kinematics, checker: CollisionChecker
) -> tuple[NDArray[np.uint8], Setpoints, Bools]:
    """Return the verdict of each pose, its set-points within the limits, and whether each of these is free."""
    solved = setpoints(kinematics.inverse(T_base_flange), kinematics.limits)
    free = _free_geometries(solved, checker)[solved.geometry]
    verdicts = np.where(solved.real, Verdict.JOINT_LIMIT, Verdict.OUT_OF_REACH).astype(np.uint8)
    verdicts[solved.pose] = Verdict.COLLISION
    verdicts[solved.pose[free]] = Verdict.REACHABLE
    return verdicts, solved, free


def _free_geometries(solved: Setpoints, checker: CollisionChecker) -> Bools:
    """Return (g,) whether each geometry is free; beyond `MAX_FREE_CONFIGURATIONS` of a pose none is."""
    q, pose = solved.q[solved.first], solved.pose[solved.first]
    free = np.zeros(len(q), dtype=np.bool_)
    number = np.arange(len(pose)) - np.searchsorted(pose, pose)
    n_free = np.zeros(len(solved.real), dtype=np.int64)
    batch = MAX_FREE_CONFIGURATIONS
    for start in range(0, int(number.max(initial=-1)) + 1, batch):
        rows = np.flatnonzero((number >= start) & (number < start + batch) & (n_free[pose] < batch))
        free[rows] = checker.free(q[rows])
        n_free += np.bincount(pose[rows[free[rows]]], minlength=len(n_free))
    return free


def _blocker(q: Floats, checker: CollisionChecker) -> str:
    """Return the closest pair in most of the first configurations of q (n, axes); the earlier one decides a tie."""
    closest = []
    for configuration in q[:MAX_FREE_CONFIGURATIONS]:
        names = checker.contacts(configuration)
        if not names:
            raise PlannerError(
                f"the collision checker calls q = {np.rad2deg(configuration).round(4).tolist()} deg not free but names "
                "no contact; free and contacts must use the same clearance"
            )
        closest.append(names[0])
    return Counter(closest).most_common(1)[0][0]


def _require_rigid(name: str, T: ArrayLike) -> Floats:
    pose = readonly(name, T, (4, 4))
    R = pose[:3, :3]
    off = max(np.abs(R @ R.T - np.eye(3)).max(), np.abs(pose[3] - (0, 0, 0, 1)).max(), abs(np.linalg.det(R) - 1.0))
    if not (off < _RIGID and np.isfinite(pose).all()):
        raise PlannerError(
            f"{name} is not a rigid transform; its rotation must be right-handed and orthonormal to {_RIGID:g}"
        )
    return pose


def add_configurations(reached: Reach, views: Ints, q: Floats) -> Reach:
    """Add one configuration (n, axes) [rad] to each of (n,) reachable viewpoints that does not have it yet."""
    more = [k for k, view in enumerate(views) if not (reached.configurations_of(int(view)) == q[k]).all(axis=1).any()]
    ends = reached.offsets[1:].copy()
    for view in views[more]:
        ends[view:] += 1
    rows = np.insert(reached.q, reached.offsets[views[more] + 1], q[more], axis=0)
    return replace(reached, q=rows, offsets=np.concatenate([[0], ends]))


def join_reach(parts: Sequence[Reach]) -> Reach:
    """Concatenate verdicts and configurations."""
    counts = np.concatenate([np.diff(part.offsets) for part in parts])
    return Reach(
        np.concatenate([part.verdict for part in parts]),
        np.concatenate([part.q for part in parts]),
        np.concatenate([[0], np.cumsum(counts)]),
        tuple(name for part in parts for name in part.blocker),
    )


def pick_reach(reached: Reach, which: Ints) -> Reach:
    """Return verdicts and configurations of the viewpoints (n,) `which`, in this order."""
    counts = np.diff(reached.offsets)[which]
    rows = np.repeat(reached.offsets[which] - np.cumsum(counts) + counts, counts) + np.arange(int(counts.sum()))
    return Reach(
        reached.verdict[which],
        reached.q[rows],
        np.concatenate([[0], np.cumsum(counts)]),
        tuple(reached.blocker[view] for view in which),
    )
