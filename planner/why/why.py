"""Cause of an uncovered surface point: the condition that its closest candidate fails.

A candidate measures a point if these conditions hold, checked in this order:

    the scanner's own limits (field of view, range, grazing, ...: in the order of `planner.ports.Rejection`)
    the lines of sight of laser and sensor are free of the part
    the lines of sight of laser and sensor are free of all other objects (fixtures, post, floor)
    the arm reaches the pose (in reach, inside the joint limits, without collision, by a free path)
    the plan selects it

The *closest* candidate passes the most conditions. Of several, it is the one that misses the condition by least:
by the angle from the viewing axis (field of view), the logarithm of distance over standoff (range), the grazing angle
at source or sensor, and for conditions without a measure (occlusion, reach) by the grazing angle at the source.

`Reason` numbers the conditions in this order, so the closest candidate has the largest number. Object frame, metres,
radians.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.ports import Progress, RayCaster, Rejection, Scanner, no_progress
from planner.values import DescribedEnum, Floats, Ints, Value, readonly
from planner.viewpoints.lines_of_sight import BUNDLE, RayTargets, flatten_poses, rejections
from planner.viewpoints.viewpoints import Viewpoints


class Reason(DescribedEnum):
    """Condition that the closest candidate fails, in the order of the checks; files contain the values."""

    MEASURED = 0, "measured"
    OUT_OF_FOV = 10, "outside the field of view"
    OUT_OF_SENSOR_FOV = 12, "outside the sensor's field of view"
    OUT_OF_RANGE = 14, "outside the range"
    OUT_OF_DEPTH = 16, "outside the depth of field"
    GRAZING_SOURCE = 20, "grazing angle of the laser above the limit"
    GRAZING_SENSOR = 22, "grazing angle of the sensor above the limit"
    TOO_SPARSE = 23, "distance of neighbouring points above the limit"
    TOO_UNCERTAIN = 24, "expected sigma above the limit"
    SOURCE_SHADED_BY_PART = 30, "laser occluded"
    SENSOR_SHADED_BY_PART = 31, "sensor occluded"
    SOURCE_SHADED = 32, "laser occluded"
    SENSOR_SHADED = 33, "sensor occluded"
    OUT_OF_REACH = 40, "view out of the arm's reach"
    JOINT_LIMIT = 41, "view beyond a joint limit"
    COLLISION = 42, "view in collision"
    NO_PATH = 43, "no free path to the view"
    NOT_SELECTED = 50, "reachable view not selected"


REASON_OF_VERDICT = np.array(
    [Reason.NOT_SELECTED, Reason.OUT_OF_REACH, Reason.JOINT_LIMIT, Reason.COLLISION], dtype=np.uint8
)
"""Condition that a candidate fails which otherwise measures a point, by its reach verdict (`Verdict`)."""

_PASSES = 255  # no condition that needs no ray fails; above every Reason
_REASON_OF_REJECTION = np.full(256, Reason.OUT_OF_FOV, dtype=np.uint8)
_REASON_OF_REJECTION[Rejection.MEASURED] = _PASSES
for _rejection in Rejection:
    if _rejection.name in Reason.__members__ and _rejection is not Rejection.MEASURED:
        _REASON_OF_REJECTION[_rejection] = Reason[_rejection.name]


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis(Value):
    """Reason and closest candidate of n uncovered points.

    Attributes:
        reason: (n,) uint8 `Reason` values.
        pose: (n,) closest pose: candidate pose // K.
        grazing_source: (n,) angle between normal and direction to the source, at that pose [rad].
        grazing_sensor: (n,) the same for the sensor [rad].
        distance: (n,) distance of source and point, at that pose [m].
    """

    reason: Annotated[NDArray[np.uint8], "n"]
    pose: Annotated[Ints, "n"]
    grazing_source: Annotated[Floats, "n"]
    grazing_sensor: Annotated[Floats, "n"]
    distance: Annotated[Floats, "n"]


def diagnose(
    targets: RayTargets,
    rows: Ints,
    viewpoints: Viewpoints,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    fails: NDArray[np.uint8],
    *,
    progress: Progress = no_progress,
) -> Diagnosis:
    """Find the cause of uncovered points.

    Args:
        targets: surface points, object frame.
        rows: (n,) the uncovered ones.
        viewpoints: V candidates of K poses.
        scanner: the sensor's law.
        casters: of the part, and of all other occluders.
        fails: (V,) `Reason` that each candidate fails even for a point that it would measure: OUT_OF_REACH,
            JOINT_LIMIT, COLLISION, NO_PATH or NOT_SELECTED.
        progress: called with (poses done, all poses).

    Raises:
        PlannerError: if `fails` is not one of these reasons for each candidate, or there is no candidate.
    """
    if len(rows) and not len(viewpoints):
        raise PlannerError(f"there is no candidate, so none of {len(rows)} uncovered points has a closest one")
    fails = readonly("fails", fails, (len(viewpoints),), np.uint8)
    if len(fails) and fails.min() < Reason.OUT_OF_REACH:
        raise PlannerError(f"fails contains {fails.min()}; each value must be OUT_OF_REACH (40) or a later reason")
    poses = flatten_poses(viewpoints.T_object_scanner)
    K = viewpoints.T_object_scanner.shape[1]
    standoff = np.repeat(viewpoints.standoff, K)
    last = np.repeat(fails, K)  # largest reason that a pose can reach
    search = _Search(targets, rows, poses, scanner, casters, last)
    order = np.argsort(-last.astype(np.int64), kind="stable")  # best class first: its points need no other
    previous = -1
    for n_done, pose in enumerate(order):
        if last[pose] != previous:
            search.cast()
            search.retire(int(last[pose]))
            previous = int(last[pose])
        search.check(int(pose), float(standoff[pose]))
        if n_done % 32 == 31:
            progress(n_done + 1, len(poses))
    search.cast()
    progress(len(poses), len(poses))
    return _with_angles(targets, rows, poses, scanner, search.best, search.pose)


class _Search:
    """The best known reason of each row."""

    def __init__(
        self,
        targets: RayTargets,
        rows: Ints,
        poses: Floats,
        scanner: Scanner,
        casters: Sequence[RayCaster],
        last: NDArray[np.uint8],
    ) -> None:
        self.targets, self.rows, self.poses, self.scanner, self.casters = targets, rows, poses, scanner, casters
        self.last = last
        self.best = np.zeros(len(rows), dtype=np.uint8)
        self.miss = np.full(len(rows), np.inf)
        self.pose = np.full(len(rows), -1, dtype=np.int64)
        self.retire(Reason.NOT_SELECTED)
        self._waiting: list[tuple[int, Ints, Floats]] = []
        self._count = 0

    def retire(self, level: int) -> None:
        """Ignore the rows whose best reason is larger than that of any remaining candidate."""
        self.active = np.flatnonzero(self.best <= level)
        self._points = self.targets.points[:, self.rows[self.active]]
        self._normals = self.targets.normals[:, self.rows[self.active]]

    def check(self, pose: int, standoff: float) -> None:
        """Check the conditions of a pose that need no ray; rows that pass wait for ray casting."""
        if not len(self.active):
            return
        T = self.poses[pose]
        rotation = T[:3, :3].T
        points = rotation @ self._points - (rotation @ T[:3, 3])[:, None]
        normals = rotation @ self._normals
        codes = rejections(self.targets, self.rows[self.active], self.scanner, points, normals)
        reason = _REASON_OF_REJECTION[codes]
        passing = np.flatnonzero(reason == _PASSES)
        if len(passing):
            here = self.active[passing]
            miss = _angle(normals[:, passing], self.scanner.source[:, None] - points[:, passing])
            # If the row has reached as much already, at a smaller angle, the rays change nothing.
            useful = (self.best[here] < self.last[pose]) | (miss < self.miss[here])
            self._waiting.append((pose, here[useful], miss[useful]))
            self._count += int(useful.sum())
        failing = np.flatnonzero((reason != _PASSES) & (reason >= self.best[self.active]))
        if len(failing):
            here, level = self.active[failing], reason[failing]
            miss = self._miss(points[:, failing], normals[:, failing], level, standoff)
            self._keep_best(here, level, miss, np.full(len(here), pose))
        if self._count >= BUNDLE:
            self.cast()

    def cast(self) -> None:
        """Cast the rays of all waiting rows: first on the part, then on the other occluders."""
        if not self._count:
            self._waiting.clear()
            return
        pose = np.repeat([pose for pose, _, _ in self._waiting], [len(here) for _, here, _ in self._waiting])
        row = np.concatenate([here for _, here, _ in self._waiting])
        miss = np.concatenate([miss for _, _, miss in self._waiting])
        self._waiting.clear()
        self._count = 0
        level = self.last[pose].copy()
        free = np.arange(len(row))
        steps = (
            (self.casters[0], self.scanner.source, Reason.SOURCE_SHADED_BY_PART),
            (self.casters[0], self.scanner.sensor, Reason.SENSOR_SHADED_BY_PART),
            (self.casters[1], self.scanner.source, Reason.SOURCE_SHADED),
            (self.casters[1], self.scanner.sensor, Reason.SENSOR_SHADED),
        )
        for caster, position, reason in steps:
            origins = self.poses[:, :3, :3] @ position + self.poses[:, :3, 3]
            blocked = caster.blocked(origins[pose[free]], self.targets.lifted[self.rows[row[free]]])
            level[free[blocked]] = reason
            free = free[~blocked]
        # The best pair of each row comes first; a stable order keeps the earlier pose of equal ones.
        order = np.lexsort((miss, -level.astype(np.int64), row))
        first = np.ones(len(order), dtype=np.bool_)
        first[1:] = np.diff(row[order]) != 0
        best = order[first]
        self._keep_best(row[best], level[best], miss[best], pose[best])

    def _keep_best(self, row: Ints, level: NDArray[np.uint8], miss: Floats, pose: Ints) -> None:
        better = (level > self.best[row]) | ((level == self.best[row]) & (miss < self.miss[row]))
        at = row[better]
        self.best[at], self.miss[at], self.pose[at] = level[better], miss[better], pose[better]

    def _miss(self, points: Floats, normals: Floats, level: NDArray[np.uint8], standoff: float) -> Floats:
        """Return by how much each condition is missed, (n,); points and normals are (3, n), scanner frame."""
        miss = np.empty(len(level))
        in_fov = (level == Reason.OUT_OF_FOV) | (level == Reason.OUT_OF_SENSOR_FOV)
        in_range = (level == Reason.OUT_OF_RANGE) | (level == Reason.OUT_OF_DEPTH)
        at_sensor = level == Reason.GRAZING_SENSOR
        at_source = ~(in_fov | in_range | at_sensor)
        x, y, z = points[:, in_fov]
        miss[in_fov] = np.arctan2(np.hypot(x, y), z)
        with np.errstate(divide="ignore"):
            miss[in_range] = np.abs(np.log(np.sqrt(_dot(points[:, in_range], points[:, in_range])) / standoff))
        for here, end in ((at_sensor, self.scanner.sensor), (at_source, self.scanner.source)):
            miss[here] = _angle(normals[:, here], end[:, None] - points[:, here])
        return miss


def _dot(first: Floats, second: Floats) -> Floats:
    """Return the (n,) scalar products of (3, n) vectors."""
    return np.asarray(np.einsum("in,in->n", first, second))


def _angle(first: Floats, second: Floats) -> Floats:
    """Return the (n,) angles between (3, n) vectors [rad]; pi / 2 if one has no length."""
    length = np.sqrt(_dot(first, first) * _dot(second, second))
    cosine = np.divide(_dot(first, second), length, out=np.zeros_like(length), where=length > 0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _with_angles(
    targets: RayTargets, rows: Ints, poses: Floats, scanner: Scanner, reason: NDArray[np.uint8], pose: Ints
) -> Diagnosis:
    """Return the diagnosis, with grazing angles and distance at the closest poses."""
    points, normals = targets.points[:, rows], targets.normals[:, rows]
    source, sensor = (
        (poses[pose, :3, :3] @ position + poses[pose, :3, 3]).T - points
        for position in (scanner.source, scanner.sensor)
    )
    distance = np.sqrt(_dot(source, source))
    return Diagnosis(reason, pose, _angle(normals, source), _angle(normals, sensor), distance)


def occluders_of(
    targets: RayTargets,
    rows: Ints,
    diagnosis: Diagnosis,
    viewpoints: Viewpoints,
    scanner: Scanner,
    occluders: Mapping[str, RayCaster],
) -> list[str]:
    """Return the occluders of each row at its closest candidate: "part", names joined by " and ", or "".

    Args:
        targets: surface points.
        rows: (n,) the uncovered ones.
        diagnosis: of these rows.
        viewpoints: the diagnosed candidates.
        scanner: positions of source and sensor.
        occluders: a caster for each object beside the part.
    """
    poses = flatten_poses(viewpoints.T_object_scanner)
    names = np.full(len(rows), "", dtype=object)
    by_part = (diagnosis.reason == Reason.SOURCE_SHADED_BY_PART) | (diagnosis.reason == Reason.SENSOR_SHADED_BY_PART)
    names[by_part] = "part"
    ends = ((Reason.SOURCE_SHADED, scanner.source), (Reason.SENSOR_SHADED, scanner.sensor))
    for reason, position in ends:
        here = np.flatnonzero(diagnosis.reason == reason)
        if not len(here):
            continue
        pose = diagnosis.pose[here]
        origins = poses[pose, :3, :3] @ position + poses[pose, :3, 3]
        for name, caster in occluders.items():
            blocked = here[caster.blocked(origins, targets.lifted[rows[here]])]
            names[blocked] = [f"{before} and {name}" if before else name for before in names[blocked]]
    return [str(name) for name in names]
