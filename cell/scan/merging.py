"""The scans of an execution as one cloud: by their reported poses, or registered. Object frame, metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.acquisition import SIMULATED
from cell.errors import FileError
from cell.runs.run import ExecutedScan
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.ports import Scanner
from planner.registration.cloud import PointCloud, ScanCloud, merge, point_spacing
from planner.registration.localisation import SearchRange
from planner.registration.localisation import fit_surface as fitted
from planner.registration.observability import RigidFit
from planner.registration.registration import Registration, register
from planner.values import Bools, Floats

_NOISE = 5.0  # robust sigma of the distances to the reference, beyond which a point is no noise
_EXACT = 1e-6  # m; nearer than this to the reference, a point is on it
_NEIGHBOURS = 8  # most of them have to be as far off ...
_APART = 3.0  # ... and half of them within so many spacings
_CLOUD_SAMPLES = 40_000  # points whose distance to the reference stands for that of all


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """All scans in the object frame.

    Attributes:
        cloud: merged, with normals.
        stop: (N,) number of the view of each point.
        poses: one (4, 4) T_object_scanner per scan, after registration [m].
        registration: None where it was not asked for.
        rms_before: of the points' distances to the reference by the reported poses [m]; NaN without points.
        rms_after: the same after registration [m].
        outliers: points off the reference that no neighbour bears out, left out; none of simulated ones.
        fit: the motion that took all scans onto the reference as one body; None where the part stands in its place.
    """

    cloud: PointCloud
    stop: NDArray[np.int32]
    poses: tuple[Floats, ...]
    registration: Registration | None
    rms_before: float
    rms_after: float
    outliers: int = 0
    fit: RigidFit | None = None


def merged(
    scans: Sequence[ExecutedScan], nearest: ClosestPointQuery, *, registered: bool, search: SearchRange | None = None,
    rng: np.random.Generator | None = None,
) -> Merged:  # fmt: skip
    """Bring the scans into the object frame by their reported poses, and register them if asked.

    Args:
        scans: of one execution.
        nearest: the reference.
        registered: whether to correct the reported poses by registration.
        search: how far the part may stand off its place, where it is to be found first.
        rng: of the motions that the search begins with.

    Raises:
        FileError: if too few points lie near the part to find it.
    """
    clouds = [ScanCloud(scan.points, scan.T_reported[:3, 3]) for scan in scans]
    before = _rms_to(nearest, clouds)
    after, registration, fit = before, None, None
    poses = [scan.T_reported for scan in scans]
    if search is not None and rng is not None and clouds:
        vertices = nearest.mesh.vertices
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        try:
            fit = fitted(clouds, nearest, centre, search, rng)
        except PlannerError as error:
            raise FileError(str(error)) from error
        clouds, poses = [cloud.transformed(fit.T) for cloud in clouds], [fit.T @ pose for pose in poses]
        after = _rms_to(nearest, clouds)
    if registered and clouds:
        registration = register(clouds, nearest)
        corrections = [result.T_correction for result in registration.scans]
        clouds = [cloud.transformed(T) for cloud, T in zip(clouds, corrections, strict=True)]
        poses = [T @ pose for T, pose in zip(corrections, poses, strict=True)]
        after = _rms_to(nearest, clouds)
    cloud, count = merge(clouds), sum(map(len, clouds))
    if any(scan.source != SIMULATED for scan in scans) and count:
        keep = ~_outliers(nearest, cloud)
        if not keep.all():
            parts = np.split(keep, np.cumsum([len(each) for each in clouds])[:-1])
            clouds = [ScanCloud(each.points[own], each.sensor) for each, own in zip(clouds, parts, strict=True)]
            cloud, after = merge(clouds), _rms_to(nearest, clouds)
    stop = np.array([scan.stop for scan in scans], dtype=np.int32)[cloud.scan]
    return Merged(cloud, stop, tuple(poses), registration, before, after, count - len(cloud), fit)


def sigma_of(merged: Merged, scans: Sequence[ExecutedScan], scanner: Scanner) -> Floats:
    """(N,) expected standard deviation of each merged point along its ray [m], by the scanner's own law.

    The law is asked about the normals of the cloud, from the registered poses. NaN where it says nothing: of a scanner
    without a law, of a sweep (which of its poses gave a point is not kept), of a point that is seen from behind.

    Args:
        merged: all scans.
        scans: the same, in the same order.
        scanner: that scanned.
    """
    sigma = np.full(len(merged.cloud), np.nan)
    law = getattr(scanner, "sigma", None)
    for number, (scan, T) in enumerate(zip(scans, merged.poses, strict=True)):
        own = merged.cloud.scan == number
        if callable(law) and len(scan.T_reported_poses) == 1 and own.any():
            R, t = T[:3, :3], T[:3, 3]
            sigma[own] = law((merged.cloud.points[own] - t) @ R, merged.cloud.normals[own] @ R)
    sigma[~np.isfinite(sigma)] = np.nan
    return sigma


def _outliers(nearest: ClosestPointQuery, cloud: PointCloud) -> Bools:
    """(N,) points that are off the reference by more than noise takes them, and that no neighbour bears out.

    A dent is borne out: the points beside it, not far away, are as far off. Simulated points meet the reference.
    """
    from scipy.spatial import cKDTree  # takes a tenth of a second, which simulated scans need not wait for

    points = cloud.points
    off = nearest.signed_distance(points)
    limit = max(_NOISE * 1.4826 * float(np.median(np.abs(off))), _EXACT)
    count = min(_NEIGHBOURS + 1, len(points))
    distance, index = (np.reshape(each, (len(points), count)) for each in cKDTree(points).query(points, count))
    alone = distance[:, count // 2] > _APART * point_spacing(points, cloud.scan)
    usual = np.median(off[index], axis=1)
    return np.asarray((np.abs(off) > limit) & (alone | (np.abs(off - usual) > limit)))


def _rms_to(nearest: ClosestPointQuery, clouds: Sequence[ScanCloud]) -> float:
    points = np.concatenate([np.empty((0, 3)), *(cloud.points for cloud in clouds)])
    if not len(points):
        return float("nan")
    chosen = points[np.linspace(0, len(points) - 1, min(len(points), _CLOUD_SAMPLES)).astype(np.int64)]
    return float(np.sqrt(np.mean(nearest.closest(chosen).distance ** 2)))


def executed_poses(scans: Sequence[ExecutedScan], merged: Merged) -> list[Floats]:
    """(K, 4, 4) poses of each scan [m]: the true ones of a simulation, else the registered ones."""
    return [
        T @ np.linalg.inv(scan.T_reported) @ scan.T_reported_poses if scan.T_true_poses is None else scan.T_true_poses
        for scan, T in zip(scans, merged.poses, strict=True)
    ]
