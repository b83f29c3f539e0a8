"""Registration: joint corrections of the reported poses from the scans' overlap and the reference model.

Gauss-Newton on six unknowns a scan (translation and rotation about its centre). A match is a point p of a scan, a unit
normal n and the residual n . (p - q) to the plane through its partner q. A point near the model is matched along the
model's normal (Chen and Medioni, Image Vision Comput. 10(3), 1992, doi:10.1016/0262-8856(92)90066-C), a point near
another scan along that scan's normal, and moves both. Weights are Tukey's with the scale from the median, so that
outliers and surface missing in the model do not count. Unobserved motions (a plane slides, a sphere turns) are reported
and not corrected: the step is restricted to the observed directions of each scan. Object frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud, ScanCloud, estimate_normals, point_spacing
from planner.registration.observability import WEAK, FreeMotion, describe, free_motions, split_directions
from planner.registration.rigid import length_scale, motion_from_vector, screw_from_motion, transform_points
from planner.values import Floats, Ints, Value

MIN_MATCHES = 12
"""Matches that a scan needs for a correction: twice the unknowns."""

_SAME_SIDE = 0.5  # smallest cosine between the normals of a match: the other side of a wall is no match
_MAX_OFFSET = 2.0  # point spacings between foot and partner in another scan: beyond, that scan has ended
_TUKEY = 4.685  # 95 % efficiency on normal residuals
_MIN_SCALE = 1e-6  # m; the residuals of exact data must not let one kind of match dominate the others
_GAUGE = 1e-6  # relative eigenvalue below which a common motion of the scans changes no match
_MIN_PAIR_SAMPLES = 200
_WEIGHTINGS = 30  # of linearised distances
_BLOCKS = 4  # along each axis, whose deviations are taken as independent


class MovingScan:
    """A scan with its current correction T.

    Args:
        scan: object frame by the reported pose; merged scans move as one body.
        samples: maximum number of matched points, spread evenly over the scan's order.
    """

    def __init__(self, scan: ScanCloud | PointCloud, samples: int) -> None:
        self._all_points = scan.points
        self._all_normals = scan.normals if isinstance(scan, PointCloud) else estimate_normals(scan.points, scan.sensor)
        self._scan_of_point = scan.scan if isinstance(scan, PointCloud) else None
        count = min(samples, len(scan))
        rows = (np.arange(count) * len(scan)) // max(count, 1)
        self._points, self._normals = scan.points[rows], self._all_normals[rows]
        self.T: Floats = np.eye(4)

    def __len__(self) -> int:
        return len(self._points)

    @cached_property
    def spacing(self) -> float:
        """Distance of neighbouring points [m], as `point_spacing`."""
        return point_spacing(self._all_points, self._scan_of_point)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._all_points, balanced_tree=False, compact_nodes=False)

    @property
    def points(self) -> Floats:
        """(S, 3) sampled points after the correction [m]."""
        return transform_points(self.T, self._points)

    @property
    def normals(self) -> Floats:
        """(S, 3) their normals after the correction."""
        return self._normals @ self.T[:3, :3].T

    @property
    def centre(self) -> Floats:
        """(3,) mean of the sampled points after the correction [m]; the origin for an empty scan."""
        return self.points.mean(axis=0) if len(self) else np.zeros(3)

    @property
    def length(self) -> float:
        """Root mean square distance of the points from their centre [m]."""
        return float(np.sqrt(((self.points - self.centre) ** 2).sum(axis=1).mean())) if len(self) else 0.0

    def nearest(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return distance (N,) [m], corrected point (N, 3) [m] and normal (N, 3) of the scan's nearest points."""
        distance, index = map(np.asarray, self._tree.query((points - self.T[:3, 3]) @ self.T[:3, :3]))
        rotation = self.T[:3, :3].T
        return distance, self._all_points[index] @ rotation + self.T[:3, 3], self._all_normals[index] @ rotation


@dataclass(slots=True)
class Matches:
    """Matches of sampled points of one scan with one partner.

    Attributes:
        scan: index of the scan.
        partner: index of another scan, or -1 for the model.
        points: (M, 3) [m].
        normals: (M, 3) of the partner.
        residual: (M,) along the normals [m].
        weight: (M,) [1/m^2]; zero if the match is too far, on the other side or an outlier.
    """

    scan: int
    partner: int
    points: Floats
    normals: Floats
    residual: Floats
    weight: Floats


class JointProblem:
    """All scans, the optional model, and their matches.

    Args:
        scans: `step` updates their corrections.
        model: the reference, or None.
        reach: largest distance of a match [m].
        overlap: whether scans are matched with each other.
    """

    def __init__(
        self, scans: Sequence[MovingScan], model: ClosestPointQuery | None, reach: float, *, overlap: bool
    ) -> None:
        self.scans = scans
        self._model = model
        self._reach = reach
        usable = [i for i, scan in enumerate(scans) if len(scan) >= MIN_MATCHES]
        self._to_model = usable if model is not None else []
        ordered = [(i, j) for i in usable for j in usable if i != j and self._boxes_meet(i, j)] if overlap else []
        each = {i: max(1, sum(first == i for first, _ in ordered)) for i in usable}
        self._stride = {i: max(1, len(scans[i]) // max(_MIN_PAIR_SAMPLES, len(scans[i]) // each[i])) for i in usable}
        self.pairs = ordered
        matches = [m for m in self.match() if m.partner >= 0]
        self.pairs = [(m.scan, m.partner) for m in matches if (m.weight > 0).sum() >= MIN_MATCHES]

    def match(self) -> list[Matches]:
        """Match at the current corrections, always the same points in the same order."""
        matches = []
        if self._model is not None and self._to_model:
            clouds = [self.scans[i].points for i in self._to_model]
            closest = self._model.closest(np.concatenate(clouds))  # one call for all: the tree's threads start once
            smooth = self._model.normals(closest)
            start = 0
            for i, points in zip(self._to_model, clouds, strict=True):
                part = slice(start, start + len(points))
                start += len(points)
                scan_normals, foot, distance = self.scans[i].normals, closest.point[part], closest.distance[part]
                matches.append(self._weigh(i, -1, points, foot, smooth[part], scan_normals, distance, np.inf))
        for i, j in self.pairs:
            every = slice(None, None, self._stride[i])
            points = self.scans[i].points[every]
            distance, partner, normals = self.scans[j].nearest(points)
            limit = _MAX_OFFSET * self.scans[j].spacing
            matches.append(self._weigh(i, j, points, partner, normals, self.scans[i].normals[every], distance, limit))
        return matches

    def normal_equations(self, matches: Sequence[Matches]) -> tuple[Floats, Floats, Floats, Ints]:
        """Assemble the normal equations of all matches.

        Returns:
            (6 N, 6 N) information matrix and (6 N,) gradient of (translation, rotation about the scan's centre) scan by
            scan, (N,) sum of weights, (N,) number of matches with a positive weight.
        """
        count = len(self.scans)
        matrix, gradient = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
        weight, used = np.zeros(count), np.zeros(count, dtype=np.int64)
        centres = [scan.centre for scan in self.scans]
        for m in matches:
            block, partner_block = slice(6 * m.scan, 6 * m.scan + 6), slice(6 * m.partner, 6 * m.partner + 6)
            j_own = np.hstack([m.normals, np.cross(m.points - centres[m.scan], m.normals)])
            weighted = m.weight[:, None] * j_own
            matrix[block, block] += weighted.T @ j_own
            gradient[block] += weighted.T @ m.residual
            weight[m.scan] += m.weight.sum()
            used[m.scan] += (m.weight > 0).sum()
            if m.partner >= 0:
                # Both levers end at the same point, so that a motion of all scans together costs exactly nothing.
                j_other = -np.hstack([m.normals, np.cross(m.points - centres[m.partner], m.normals)])
                cross = weighted.T @ j_other
                matrix[block, partner_block] += cross
                matrix[partner_block, block] += cross.T
                weighted = m.weight[:, None] * j_other
                matrix[partner_block, partner_block] += weighted.T @ j_other
                gradient[partner_block] += weighted.T @ m.residual
                weight[m.partner] += m.weight.sum()
                used[m.partner] += (m.weight > 0).sum()
        return matrix, gradient, weight, used

    def step(self) -> Floats:
        """Move the scans by one Gauss-Newton step, restricted to the observed directions of each scan.

        Returns:
            (N,) upper bound on the displacement of the points of each scan [m].
        """
        matrix, gradient, weight, used = self.normal_equations(self.match())
        bases = []
        for i, scan in enumerate(self.scans):
            block = slice(6 * i, 6 * i + 6)
            seen, _ = split_directions(matrix[block, block], weight[i] if used[i] >= MIN_MATCHES else 0.0, scan.length)
            per_length = np.array([1.0, 1.0, 1.0, *([1 / scan.length] * 3)]) if seen.shape[1] else np.ones(6)
            bases.append(per_length[:, None] * seen / np.sqrt(weight[i] or 1.0))
        edges = np.cumsum([0, *(basis.shape[1] for basis in bases)])
        basis = np.zeros((len(gradient), edges[-1]))
        for i, part in enumerate(bases):
            basis[6 * i : 6 * i + 6, edges[i] : edges[i + 1]] = part
        values, vectors = np.linalg.eigh(basis.T @ matrix @ basis)
        holds = values > _GAUGE * values.max(initial=0.0)
        solved = vectors[:, holds] @ ((vectors[:, holds].T @ -(basis.T @ gradient)) / values[holds])
        change = (basis @ solved).reshape(-1, 6)
        moved = np.zeros(len(self.scans))
        for i, scan in enumerate(self.scans):
            if bases[i].shape[1]:
                radius = float(np.linalg.norm(scan.points - scan.centre, axis=1).max())
                moved[i] = np.linalg.norm(change[i, :3]) + radius * np.linalg.norm(change[i, 3:])
                scan.T = motion_from_vector(change[i], scan.centre) @ scan.T
        return moved

    def _weigh(
        self, i: int, j: int, points: Floats, partner: Floats, normals: Floats, own_normals: Floats, distance: Floats,
        max_offset: float,
    ) -> Matches:  # fmt: skip
        """Weight matches by Tukey's function, with its scale from the median residual."""
        residual = np.einsum("nj,nj->n", points - partner, normals)
        is_match = (distance <= self._reach) & (distance**2 - residual**2 <= max_offset**2)
        is_match &= np.einsum("nj,nj->n", own_normals, normals) >= _SAME_SIDE
        scale = 1.4826 * float(np.median(np.abs(residual[is_match]))) if is_match.any() else 0.0
        scale = max(scale, _MIN_SCALE)
        ratio = residual / (_TUKEY * scale)
        weight = np.where(is_match & (np.abs(ratio) < 1), (1 - ratio**2) ** 2, 0.0) / scale**2
        return Matches(i, j, points, normals, residual, weight)

    def _boxes_meet(self, i: int, j: int) -> bool:
        """Return whether the bounding boxes of two scans come within reach of each other."""
        a, b = self.scans[i].points, self.scans[j].points
        return bool(
            (a.min(axis=0) <= b.max(axis=0) + self._reach).all()
            and (b.min(axis=0) <= a.max(axis=0) + self._reach).all()
        )


SAMPLES = 2000
"""Matched points of a scan: a correction of six unknowns needs no more."""

TOLERANCE = 2e-6
"""Finished when no point of any scan moves by more than this in a step [m]; a tenth of a good scanner's noise."""

_STILL = 10 * TOLERANCE  # a scan with alternating matches moves within the noise and has converged [m]
_ITERATIONS = 40
_REACH = 0.03  # of the diagonal: largest distance of a match


class RegistrationStatus(Enum):
    """Result of registration for one scan; the value is a sentence."""

    CONVERGED = "registered in all six directions"
    PARTLY_FREE = "registered, except for motions that its surface does not determine: those were not corrected"
    NOT_CONVERGED = "still moving after the last iteration: the reported pose was kept"
    TOO_FAR = "the correction exceeds the largest distance of a match: the reported pose was kept"
    REJECTED = "the correction made the match worse: the reported pose was kept"
    NO_OVERLAP = "too few of its points lie near the model or another scan: the reported pose was kept"
    TOO_FEW_POINTS = f"fewer than {MIN_MATCHES} points: the reported pose was kept"
    EMPTY = "the scan is empty"


_MOVED = (RegistrationStatus.CONVERGED, RegistrationStatus.PARTLY_FREE)


@dataclass(frozen=True, slots=True, eq=False)
class ScanRegistration(Value):
    """Correction of one scan.

    Attributes:
        status: result of the registration.
        T_correction: (4, 4) applied to the scan's points in the object frame; the identity if not corrected.
        rms_before: root mean square distance of the inliers along the normals at the reported pose [m]; NaN without
            inliers.
        rms_after: the same points after the correction [m].
        used: share of inliers among the matched points.
        rank: number of observed directions, at most six.
        free: motions in the other directions.
        free_directions: (6, 6 - rank) the same, orthonormal in coordinates (translation, length * rotation).
        centre: (3,) of the scan's points [m].
        length: root mean square distance of the points from it [m].
    """

    status: RegistrationStatus
    T_correction: Annotated[Floats, "4 4"]
    rms_before: float
    rms_after: float
    used: float
    rank: int
    free: tuple[FreeMotion, ...]
    free_directions: Annotated[Floats, "6 _"]
    centre: Annotated[Floats, "3"]
    length: float

    def split_motion(self, T: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
        """Split a motion (4, 4) of the scan, such as an error of its pose, at the centre of its points.

        Returns:
            Translation [m] and rotation [rad] along the observed directions, and along the free ones.
        """
        scale = length_scale(self.length or 1.0)
        screw = scale * screw_from_motion(T, self.centre)
        free = self.free_directions @ (self.free_directions.T @ screw)
        observed, unobserved = (screw - free) / scale, free / scale
        first, second = (
            (float(np.linalg.norm(part[:3])), float(np.linalg.norm(part[3:]))) for part in (observed, unobserved)
        )
        return first, second

    @property
    def is_corrected(self) -> bool:
        """Whether the pose was corrected; otherwise the reported pose is kept."""
        return self.status in _MOVED

    @property
    def sentence(self) -> str:
        """Status and free motions of the scan, for a report."""
        return f"{self.status.value} ({describe(self.free)})" if self.free else self.status.value


def fit_majority(points: Floats, nearest: ClosestPointQuery, T: Floats, reach: float, rounds: int = 3) -> Floats:
    """Return the motion (4, 4) of points to a surface that most of them fit, from one near it.

    A redescending weight alone may lock in a moved feature, with most of the surface as outliers. The sum of absolute
    distances has one minimum in the linear range; from it, Tukey's weights remove the influence of outliers. Motions
    that the surface hardly determines, such as turns of a cylinder about its axis, are left as they are.

    Args:
        points: (N, 3) [m].
        nearest: the surface.
        T: (4, 4) motion that brings the points near it.
        reach: largest distance of a point that counts [m].
        rounds: of closest points.
    """
    for number in range(rounds):
        points_on_part = transform_points(T, points)
        closest = nearest.closest(points_on_part)
        near = closest.distance <= reach
        if near.sum() < MIN_MATCHES:
            break
        normals, centre = nearest.normals(closest)[near], points_on_part[near].mean(axis=0)
        off = np.einsum("nj,nj->n", (points_on_part - closest.point)[near], normals)
        length = float(np.sqrt(((points_on_part[near] - centre) ** 2).sum(axis=1).mean()))
        J = np.hstack([normals, np.cross((points_on_part[near] - centre) / length, normals)])
        change = np.zeros(6)
        for _ in range(_WEIGHTINGS):
            left = np.abs(off + J @ change)
            if number == rounds - 1:
                scale = max(_TUKEY * 1.4826 * float(np.median(left)), _MIN_SCALE)
                weight = np.maximum(1 - (left / scale) ** 2, 0) ** 2
            else:
                weight = 1 / np.maximum(left, _MIN_SCALE)
            change = -np.linalg.pinv((J * weight[:, None]).T @ J, WEAK) @ (J.T @ (weight * off))
        T = motion_from_vector(np.concatenate([change[:3], change[3:] / length]), centre) @ T
    return T


def placement_sd(points: Floats, nearest: ClosestPointQuery) -> tuple[float, float]:
    """Return the standard deviations of the placement of registered points: along [m] and about [rad] any axis.

    Delete-one jackknife (Efron 1982, doi:10.1137/1.9781611970319) over blocks of a grid: deviations of a part from its
    model, unlike noise, are alike at neighbouring points and do not average out. The larger ones of all axes count;
    rotations are about the mean of the points.

    Args:
        points: (N, 3) after registration [m].
        nearest: the reference.
    """
    closest = nearest.closest(points)
    normals, centre = nearest.normals(closest), points.mean(axis=0)
    off = np.einsum("nj,nj->n", points - closest.point, normals)
    keep = np.abs(off - np.median(off)) <= 3 * 1.4826 * np.median(np.abs(off - np.median(off))) + _MIN_SCALE
    points, normals, off = points[keep], normals[keep], off[keep]
    length = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
    J = np.hstack([normals, np.cross((points - centre) / length, normals)])
    low, high = points.min(axis=0), points.max(axis=0)
    cell = np.minimum((_BLOCKS * (points - low) / np.maximum(high - low, _MIN_SCALE)).astype(np.int64), _BLOCKS - 1)
    block = np.unique(cell, axis=0, return_inverse=True)[1].ravel()
    n = int(block.max()) + 1
    A, b = np.zeros((n, 6, 6)), np.zeros((n, 6))
    np.add.at(b, block, J * off[:, None])
    for k in range(n):
        A[k] = J[block == k].T @ J[block == k]
    estimates = np.stack([np.linalg.pinv(A.sum(axis=0) - A[k], 1e-6) @ (b.sum(axis=0) - b[k]) for k in range(n)])
    covariance = (n - 1) / n * (estimates - estimates.mean(axis=0)).T @ (estimates - estimates.mean(axis=0))
    along, about = (float(np.sqrt(np.linalg.eigvalsh(part)[-1])) for part in (covariance[:3, :3], covariance[3:, 3:]))
    return along, about / length


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Corrections of all scans.

    Attributes:
        scans: one result per scan, in the given order.
        rms_before: over all inliers [m]; NaN without any.
        rms_after: the same after the corrections [m].
        iterations: number of steps.
        overlaps: pairs of scans that were matched with each other.
    """

    scans: tuple[ScanRegistration, ...]
    rms_before: float
    rms_after: float
    iterations: int
    overlaps: tuple[tuple[int, int], ...]


def register(
    scans: Sequence[ScanCloud | PointCloud],
    model: TriangleMesh | ClosestPointQuery | None,
    *,
    reach: float | None = None,
    samples: int = SAMPLES,
    iterations: int = _ITERATIONS,
) -> Registration:
    """Correct the poses of scans.

    Args:
        scans: clouds in the object frame by their reported poses; merged scans move as one body.
        model: the reference, object frame; None matches the scans with each other only and keeps the mean of their
            motions at zero, because their common pose is then undetermined.
        reach: largest distance of a match [m]; default 3 % of the diagonal of model or scans. Larger pose errors need
            more.
        samples: matched points a scan, > 0.
        iterations: maximum number of steps, > 0.
    """
    if samples < 1 or iterations < 1 or (reach is not None and not reach > 0):
        raise PlannerError(f"samples {samples}, iterations {iterations} and reach {reach} must be positive")
    nearest = ClosestPointQuery(model) if isinstance(model, TriangleMesh) else model
    clouds = [scan.points for scan in scans if len(scan)]
    extent = nearest.mesh.vertices if nearest else np.concatenate(clouds) if clouds else np.zeros((1, 3))
    diagonal = float(np.linalg.norm(np.ptp(extent, axis=0)))
    moving = [MovingScan(scan, samples) for scan in scans]
    reach = _REACH * diagonal if reach is None else reach
    problem = JointProblem(moving, nearest, reach, overlap=True)
    before = problem.match()
    steps, moved = 0, np.full(len(moving), np.inf)
    while steps < iterations and moved.max(initial=0.0) >= TOLERANCE:
        moved = problem.step()
        steps += 1
    after = problem.match()
    matrix, _, weight, used = problem.normal_equations(after)
    results, squares = [], []
    for i, scan in enumerate(moving):
        block = slice(6 * i, 6 * i + 6)
        _, free = split_directions(matrix[block, block], weight[i] if used[i] >= MIN_MATCHES else 0.0, scan.length)
        pair = _residuals(i, before, after, nearest is not None)
        result = _judge(scan, pair, free, used[i] >= MIN_MATCHES, bool(moved[i] < _STILL), reach)
        results.append(result)
        squares.append(np.stack(pair[:2] if result.is_corrected else (pair[0], pair[0])) ** 2)
    pooled = np.concatenate(squares, axis=1) if squares else np.empty((2, 0))
    rms_before, rms_after = np.sqrt(pooled.mean(axis=1)) if pooled.shape[1] else (float("nan"), float("nan"))
    overlaps = tuple(sorted({(min(pair), max(pair)) for pair in problem.pairs}))
    return Registration(tuple(results), float(rms_before), float(rms_after), steps, overlaps)


def _residuals(
    i: int, before: Sequence[Matches], after: Sequence[Matches], has_model: bool
) -> tuple[Floats, Floats, float]:
    """Return residuals of scan i [m] before and after for the final inliers, and the share of inliers.

    The partner is the model if there is one, else the other scans.
    """
    pairs = [(a, b) for a, b in zip(before, after, strict=True) if b.scan == i and (b.partner < 0) == has_model]
    if not pairs:
        return np.empty(0), np.empty(0), 0.0
    counts = np.concatenate([b.weight > 0 for _, b in pairs])
    first = np.concatenate([a.residual for a, _ in pairs])[counts]
    last = np.concatenate([b.residual for _, b in pairs])[counts]
    return first, last, float(counts.mean())


def _judge(
    scan: MovingScan,
    residuals: tuple[Floats, Floats, float],
    free: Floats,
    is_matched: bool,
    is_still: bool,
    reach: float,
) -> ScanRegistration:
    """Accept or reject the correction of one scan.

    Small residuals alone prove nothing: a scan that slid along the part fits as well. A correction that moves a point
    farther than `reach` [m] has left its initial matches.
    """
    first, last, used = residuals
    rms_before, rms_after = (float(np.sqrt(np.mean(r**2))) if len(r) else float("nan") for r in (first, last))
    if len(scan) == 0:
        status = RegistrationStatus.EMPTY
    elif len(scan) < MIN_MATCHES:
        status = RegistrationStatus.TOO_FEW_POINTS
    elif not is_matched:
        status = RegistrationStatus.NO_OVERLAP
    elif rms_after > rms_before + TOLERANCE:
        status = RegistrationStatus.REJECTED
    elif not is_still:
        status = RegistrationStatus.NOT_CONVERGED
    elif _farthest_move(scan) > reach:
        status = RegistrationStatus.TOO_FAR
    else:
        status = RegistrationStatus.PARTLY_FREE if free.shape[1] else RegistrationStatus.CONVERGED
    T = scan.T if status in _MOVED else np.eye(4)
    rms_after = rms_after if status in _MOVED else rms_before
    motions = free_motions(free, scan.centre, scan.length) if is_matched else ()
    return ScanRegistration(
        status, T, rms_before, rms_after, used, 6 - free.shape[1], motions, free, scan.centre, scan.length
    )


def _farthest_move(scan: MovingScan) -> float:
    """Return the largest displacement of a sampled point by the correction [m]."""
    back = (scan.points - scan.T[:3, 3]) @ scan.T[:3, :3]
    return float(np.linalg.norm(scan.points - back, axis=1).max(initial=0.0))
