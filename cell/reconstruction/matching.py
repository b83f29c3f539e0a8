"""The least-squares problem of registration: matches of scans to model and to each other, and one Gauss-Newton step.

A match is a point p of a scan, a unit normal n and the residual n . (p - q) to the plane through its partner q. Object
frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cell.reconstruction.cloud import PointCloud, ScanCloud, estimate_normals, point_spacing
from cell.reconstruction.freedom import split
from planner.geometry.closest import ClosestPointQuery
from planner.values import Floats, Ints

FEWEST = 12
"""Matches that a scan needs to be moved: twice the unknowns."""

_SAME_SIDE = 0.5  # cosine between the normals of a match: the other side of a wall is no match
_BESIDE = 2.0  # point spacings that a partner in another scan may lie beside the foot: beyond, that scan has ended
_TUKEY = 4.685  # 95 % efficiency on normal residuals
_SMALLEST_SCALE = 1e-6  # m; the residuals of exact data must not make one kind of match drown the others
_GAUGE = 1e-6  # relative eigenvalue below which scans move together without any match noticing
_FEWEST_PAIR_SAMPLES = 200


class MovingScan:
    """A scan with its correction so far.

    Args:
        scan: object frame by the reported pose; merged scans move as one.
        samples: most points to match, spread evenly over the scan's order.
    """

    def __init__(self, scan: ScanCloud | PointCloud, samples: int) -> None:
        self._all_points = scan.points
        self._all_normals = scan.normals if isinstance(scan, PointCloud) else estimate_normals(scan.points, scan.sensor)
        self._tree = cKDTree(scan.points, balanced_tree=False, compact_nodes=False) if len(scan) else None
        count = min(samples, len(scan))
        chosen = (np.arange(count) * len(scan)) // max(count, 1)
        self._points, self._normals = scan.points[chosen], self._all_normals[chosen]
        self.spacing = point_spacing(scan.points, scan.scan if isinstance(scan, PointCloud) else None)
        self.T: Floats = np.eye(4)

    def __len__(self) -> int:
        return len(self._points)

    @property
    def points(self) -> Floats:
        """(S, 3) sampled points after the correction [m]."""
        return self._points @ self.T[:3, :3].T + self.T[:3, 3]

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
        """Nearest of all the scan's points: distance (N,) [m], point (N, 3) [m] and normal (N, 3), corrected."""
        assert self._tree is not None  # only scans with points are paired
        distance, index = map(np.asarray, self._tree.query((points - self.T[:3, 3]) @ self.T[:3, :3]))
        rotation = self.T[:3, :3].T
        return distance, self._all_points[index] @ rotation + self.T[:3, 3], self._all_normals[index] @ rotation


@dataclass(slots=True)
class Matches:
    """Matches of some points of one scan to one partner.

    Attributes:
        scan: whose points.
        partner: another scan, or -1 for the model.
        points: (M, 3) [m].
        normals: (M, 3) of the partner.
        residual: (M,) along the normals [m].
        weight: (M,) [1/m^2]; zero where the match is too far, on the other side or an outlier.
    """

    scan: int
    partner: int
    points: Floats
    normals: Floats
    residual: Floats
    weight: Floats


class JointProblem:
    """All scans, the model if there is one, and their matches.

    Args:
        scans: with their corrections so far; `step` updates them.
        model: the reference, or None.
        reach: farthest match [m].
        overlap: whether scans are matched to each other.
    """

    def __init__(
        self, scans: Sequence[MovingScan], model: ClosestPointQuery | None, reach: float, *, overlap: bool
    ) -> None:
        self.scans = scans
        self._model = model
        self._reach = reach
        usable = [i for i, scan in enumerate(scans) if len(scan) >= FEWEST]
        self._to_model = usable if model is not None else []
        ordered = [(i, j) for i in usable for j in usable if i != j and self._boxes_meet(i, j)] if overlap else []
        each = {i: max(1, sum(first == i for first, _ in ordered)) for i in usable}
        self._stride = {i: max(1, len(scans[i]) // max(_FEWEST_PAIR_SAMPLES, len(scans[i]) // each[i])) for i in usable}
        self.pairs = ordered
        self.pairs = [(m.scan, m.partner) for m in self.match() if m.partner >= 0 and (m.weight > 0).sum() >= FEWEST]

    def match(self) -> list[Matches]:
        """Matches at the present corrections, always of the same points in the same order."""
        found = []
        if self._model is not None and self._to_model:
            clouds = [self.scans[i].points for i in self._to_model]
            closest = self._model.closest(np.concatenate(clouds))  # one call for all: the tree's threads start once
            smooth = self._model.normals(closest)
            start = 0
            for i, points in zip(self._to_model, clouds, strict=True):
                part = slice(start, start + len(points))
                start += len(points)
                own, foot, distance = self.scans[i].normals, closest.point[part], closest.distance[part]
                found.append(self._weighted(i, -1, points, foot, smooth[part], own, distance, np.inf))
        for i, j in self.pairs:
            every = slice(None, None, self._stride[i])
            points = self.scans[i].points[every]
            distance, partner, normals = self.scans[j].nearest(points)
            beside = _BESIDE * self.scans[j].spacing
            found.append(self._weighted(i, j, points, partner, normals, self.scans[i].normals[every], distance, beside))
        return found

    def information(self, matches: Sequence[Matches]) -> tuple[Floats, Floats, Floats, Ints]:
        """Normal equations of all matches.

        Returns:
            (6 N, 6 N) information matrix and (6 N,) gradient of (translation, rotation about the scan's centre) scan by
            scan, (N,) sum of weights, (N,) number of matches that count.
        """
        count = len(self.scans)
        matrix, gradient = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
        weight, used = np.zeros(count), np.zeros(count, dtype=np.int64)
        centres = [scan.centre for scan in self.scans]
        for m in matches:
            own, other = slice(6 * m.scan, 6 * m.scan + 6), slice(6 * m.partner, 6 * m.partner + 6)
            j_own = np.hstack([m.normals, np.cross(m.points - centres[m.scan], m.normals)])
            weighted = m.weight[:, None] * j_own
            matrix[own, own] += weighted.T @ j_own
            gradient[own] += weighted.T @ m.residual
            weight[m.scan] += m.weight.sum()
            used[m.scan] += (m.weight > 0).sum()
            if m.partner >= 0:
                # Both levers end at the same point, so that a motion of all scans together costs exactly nothing.
                j_other = -np.hstack([m.normals, np.cross(m.points - centres[m.partner], m.normals)])
                cross = weighted.T @ j_other
                matrix[own, other] += cross
                matrix[other, own] += cross.T
                weighted = m.weight[:, None] * j_other
                matrix[other, other] += weighted.T @ j_other
                gradient[other] += weighted.T @ m.residual
                weight[m.partner] += m.weight.sum()
                used[m.partner] += (m.weight > 0).sum()
        return matrix, gradient, weight, used

    def step(self) -> Floats:
        """Move the scans by one Gauss-Newton step, only in the directions that each of them sees.

        Returns:
            (N,) the farthest that any point of each scan has moved, at most [m].
        """
        matrix, gradient, weight, used = self.information(self.match())
        bases = []
        for i, scan in enumerate(self.scans):
            own = slice(6 * i, 6 * i + 6)
            seen, _ = split(matrix[own, own], weight[i] if used[i] >= FEWEST else 0.0, scan.length)
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
                scan.T = small_motion(change[i], scan.centre) @ scan.T
        return moved

    def _weighted(
        self,
        i: int,
        j: int,
        points: Floats,
        partner: Floats,
        normals: Floats,
        own_normals: Floats,
        distance: Floats,
        beside: float,
    ) -> Matches:
        """Matches with Tukey's weights, of which the scale is the median residual's."""
        residual = np.einsum("nj,nj->n", points - partner, normals)
        is_match = (distance <= self._reach) & (distance**2 - residual**2 <= beside**2)
        is_match &= np.einsum("nj,nj->n", own_normals, normals) >= _SAME_SIDE
        scale = 1.4826 * float(np.median(np.abs(residual[is_match]))) if is_match.any() else 0.0
        scale = max(scale, _SMALLEST_SCALE)
        ratio = residual / (_TUKEY * scale)
        weight = np.where(is_match & (np.abs(ratio) < 1), (1 - ratio**2) ** 2, 0.0) / scale**2
        return Matches(i, j, points, normals, residual, weight)

    def _boxes_meet(self, i: int, j: int) -> bool:
        """Whether the bounding boxes of two scans come within reach of each other."""
        a, b = self.scans[i].points, self.scans[j].points
        return bool(
            (a.min(axis=0) <= b.max(axis=0) + self._reach).all()
            and (b.min(axis=0) <= a.max(axis=0) + self._reach).all()
        )


def small_motion(change: Floats, centre: Floats) -> Floats:
    """(4, 4) rotation by the vector change[3:] about `centre`, then translation by change[:3] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(change[3:]))
    x, y, z = change[3:] / angle if angle > 0 else np.zeros(3)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = centre + change[:3] - rotation @ centre
    return T
