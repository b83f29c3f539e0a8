"""Why a surface point stays open: the condition at which the candidate that came closest to measuring it fails.

A candidate measures a point if it passes these conditions, asked in this order:

    the scanner's own (field of view, range, grazing, ...: the order of `planner.ports.Rejection`)
    the laser's leg, then the sensor's, are free of the part
    the laser's leg, then the sensor's, are free of everything else (fixtures, post, floor)
    the arm takes the pose up (in reach, inside the joint limits, without collision, a free path leads to it)
    the plan has chosen it

The *closest* candidate is the one that passes most of them. Of several, it is the one that misses the condition by
least: by the angle off the viewing axis (field of view), the logarithm of distance over standoff (range), the grazing
angle of that leg, and, where a condition has no degree (shading, reach), the one that sees the point most squarely.

`planner.why.reasons` numbers a condition by its place in the order, so the closest candidate has the largest. Object
frame, metres, radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.ports import Progress, RayCaster, Rejection, Scanner
from planner.values import Floats, Ints, Value, readonly
from planner.viewpoints.lines_of_sight import BUNDLE, RayTargets, flatten_poses, rejections
from planner.viewpoints.viewpoints import Viewpoints
from planner.why.reasons import Reason

_PASSES = 255  # no condition that needs no ray fails; above every Reason
_REASON_OF_CODE = np.full(256, Reason.OUT_OF_FOV, dtype=np.uint8)
_REASON_OF_CODE[Rejection.MEASURED] = _PASSES
for _code in Rejection:
    if _code.name in Reason.__members__ and _code is not Rejection.MEASURED:
        _REASON_OF_CODE[_code] = Reason[_code.name]


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis(Value):
    """Reason and closest candidate of n open points.

    Attributes:
        reason: (n,) uint8 `Reason` values.
        pose: (n,) int64 pose that came closest: candidate pose // K; -1 where there are no candidates.
        grazing_source: (n,) angle between normal and the direction to the source, at that pose [rad].
        grazing_sensor: (n,) the same for the sensor [rad].
        distance: (n,) from source to point, at that pose [m].
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
    part_caster: RayCaster,
    occluder_caster: RayCaster,
    fails: NDArray[np.uint8],
    *,
    progress: Progress | None = None,
) -> Diagnosis:
    """Why points stay open.

    Args:
        targets: surface points, object frame.
        rows: (n,) those that stay open.
        viewpoints: V candidates of K poses.
        scanner: the sensor's law.
        part_caster: casts on the part.
        occluder_caster: casts on everything else that occludes.
        fails: (V,) `Reason` at which each candidate fails even for a point that it would measure: OUT_OF_REACH,
            JOINT_LIMIT, COLLISION, NO_PATH or NOT_SELECTED.
        progress: called with (poses done, poses in all).

    Raises:
        PlannerError: if `fails` is not one such reason for each candidate.
    """
    fails = readonly("fails", fails, (len(viewpoints),), np.uint8)
    if len(fails) and fails.min() < Reason.OUT_OF_REACH:
        raise PlannerError("fails must hold what a candidate fails at that would measure: OUT_OF_REACH or later")
    poses = flatten_poses(viewpoints.T_object_scanner)
    K = viewpoints.T_object_scanner.shape[1]
    standoff = np.repeat(viewpoints.standoff, K)
    last = np.repeat(fails, K)  # the farthest that a pose can come
    search = _Search(targets, rows, poses, scanner, (part_caster, occluder_caster), last)
    order = np.argsort(-last.astype(np.int64), kind="stable")  # the best class first: what it measures needs no other
    previous = -1
    for done, pose in enumerate(order):
        if last[pose] != previous:
            search.cast()
            search.retire(int(last[pose]))
            previous = int(last[pose])
        search.ask(int(pose), float(standoff[pose]))
        if progress and done % 32 == 31:
            progress(done + 1, len(poses))
    search.cast()
    if progress:
        progress(len(poses), len(poses))
    return _with_angles(targets, rows, poses, scanner, search.best, search.pose)


class _Search:
    """The running best of every row."""

    def __init__(
        self, targets: RayTargets, rows: Ints, poses: Floats, scanner: Scanner,
        casters: tuple[RayCaster, RayCaster], last: NDArray[np.uint8],
    ) -> None:  # fmt: skip
        self.targets, self.rows, self.poses, self.scanner, self.casters = targets, rows, poses, scanner, casters
        self.last = last
        self.best = np.zeros(len(rows), dtype=np.uint8)
        self.miss = np.full(len(rows), np.inf)
        self.pose = np.full(len(rows), -1, dtype=np.int64)
        self.retire(Reason.NOT_SELECTED)
        self._waiting: list[tuple[int, Ints, Floats]] = []
        self._count = 0

    def retire(self, level: int) -> None:
        """Leave out the rows that have come farther than any candidate that is still to be asked."""
        self.active = np.flatnonzero(self.best <= level)
        self._points = self.targets.points[:, self.rows[self.active]]
        self._normals = self.targets.normals[:, self.rows[self.active]]

    def ask(self, pose: int, standoff: float) -> None:
        """One pose: judge what fails without a ray; what does not waits for its legs."""
        if not len(self.active):
            return
        T = self.poses[pose]
        into = T[:3, :3].T
        points = into @ self._points - (into @ T[:3, 3])[:, None]
        normals = into @ self._normals
        codes = rejections(self.targets, self.rows[self.active], self.scanner, points, normals)
        reason = _REASON_OF_CODE[codes]
        passing = np.flatnonzero(reason == _PASSES)
        if len(passing):
            here = self.active[passing]
            miss = _angle(normals[:, passing], self.scanner.source[:, None] - points[:, passing])
            # Where the row has come as far already, and more squarely, the rays cannot change anything.
            useful = (self.best[here] < self.last[pose]) | (miss < self.miss[here])
            self._waiting.append((pose, here[useful], miss[useful]))
            self._count += int(useful.sum())
        failing = np.flatnonzero((reason != _PASSES) & (reason >= self.best[self.active]))
        if len(failing):
            here, level = self.active[failing], reason[failing]
            miss = self._miss(points[:, failing], normals[:, failing], level, standoff)
            self._keep(here, level, miss, np.full(len(here), pose))
        if self._count >= BUNDLE:
            self.cast()

    def cast(self) -> None:
        """Cast the legs of all that waits: the part's first, then the rest's."""
        if not self._count:
            self._waiting.clear()
            return
        pose = np.repeat([pose for pose, _, _ in self._waiting], [len(here) for _, here, _ in self._waiting])
        row = np.concatenate([here for _, here, _ in self._waiting])
        miss = np.concatenate([miss for _, _, miss in self._waiting])
        self._waiting.clear()
        self._count = 0
        level = self.last[pose].copy()
        alive = np.arange(len(row))
        steps = (
            (self.casters[0], self.scanner.source, Reason.SOURCE_SHADED_BY_PART),
            (self.casters[0], self.scanner.sensor, Reason.SENSOR_SHADED_BY_PART),
            (self.casters[1], self.scanner.source, Reason.SOURCE_SHADED),
            (self.casters[1], self.scanner.sensor, Reason.SENSOR_SHADED),
        )
        for caster, position, reason in steps:
            origins = self.poses[:, :3, :3] @ position + self.poses[:, :3, 3]
            blocked = caster.blocked(origins[pose[alive]], self.targets.lifted[self.rows[row[alive]]])
            level[alive[blocked]] = reason
            alive = alive[~blocked]
        # Of a row's pairs the best comes first; a stable order keeps the earlier pose where all is equal.
        order = np.lexsort((miss, -level.astype(np.int64), row))
        first = np.ones(len(order), dtype=np.bool_)
        first[1:] = np.diff(row[order]) != 0
        chosen = order[first]
        self._keep(row[chosen], level[chosen], miss[chosen], pose[chosen])

    def _keep(self, row: Ints, level: NDArray[np.uint8], miss: Floats, pose: Ints) -> None:
        better = (level > self.best[row]) | ((level == self.best[row]) & (miss < self.miss[row]))
        at = row[better]
        self.best[at], self.miss[at], self.pose[at] = level[better], miss[better], pose[better]

    def _miss(self, points: Floats, normals: Floats, level: NDArray[np.uint8], standoff: float) -> Floats:
        """By how much a condition is missed, (n,); see the module. Points and normals (3, n), scanner frame."""
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
    """(n,) scalar products of vectors (3, n)."""
    return np.asarray(np.einsum("in,in->n", first, second))


def _angle(first: Floats, second: Floats) -> Floats:
    """(n,) angles between vectors (3, n) [rad]; pi / 2 where one has no length."""
    length = np.sqrt(_dot(first, first) * _dot(second, second))
    cosine = np.divide(_dot(first, second), length, out=np.zeros_like(length), where=length > 0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _with_angles(
    targets: RayTargets, rows: Ints, poses: Floats, scanner: Scanner, reason: NDArray[np.uint8], pose: Ints
) -> Diagnosis:
    if not len(poses):
        nothing = np.full(len(rows), np.nan)
        return Diagnosis(reason, pose, nothing, nothing, nothing)
    points, normals = targets.points[:, rows], targets.normals[:, rows]
    source, sensor = (
        (poses[pose, :3, :3] @ position + poses[pose, :3, 3]).T - points
        for position in (scanner.source, scanner.sensor)
    )
    distance = np.sqrt(_dot(source, source))
    return Diagnosis(reason, pose, _angle(normals, source), _angle(normals, sensor), distance)


def occluders_of(
    targets: RayTargets, rows: Ints, diagnosis: Diagnosis, viewpoints: Viewpoints, scanner: Scanner,
    occluders: Mapping[str, RayCaster],
) -> list[str]:  # fmt: skip
    """What shades each row from its closest candidate: "part", the occluders' names joined by " and ", or "".

    Args:
        targets: surface points.
        rows: (n,) the open ones.
        diagnosis: of these rows.
        viewpoints: the candidates that were asked.
        scanner: where source and sensor are.
        occluders: a caster for each thing beside the part.
    """
    poses = flatten_poses(viewpoints.T_object_scanner)
    found = np.full(len(rows), "", dtype=object)
    by_part = (diagnosis.reason == Reason.SOURCE_SHADED_BY_PART) | (diagnosis.reason == Reason.SENSOR_SHADED_BY_PART)
    found[by_part] = "part"
    ends = ((Reason.SOURCE_SHADED, scanner.source), (Reason.SENSOR_SHADED, scanner.sensor))
    for reason, position in ends:
        here = np.flatnonzero(diagnosis.reason == reason)
        if not len(here):
            continue
        pose = diagnosis.pose[here]
        origins = poses[pose, :3, :3] @ position + poses[pose, :3, 3]
        for name, caster in occluders.items():
            blocked = here[caster.blocked(origins, targets.lifted[rows[here]])]
            found[blocked] = [f"{before} and {name}" if before else name for before in found[blocked]]
    return [str(name) for name in found]
