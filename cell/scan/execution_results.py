"""Step 11: what an execution's scans amount to: merged cloud, registration, coverage achieved beside predicted.

Everything is calculated from what stands on disk, so a report can be made anew, and of a stopped execution as well.
Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.acquisition import SIMULATED
from cell.errors import FileError
from cell.rays.prediction import held_out
from cell.reconstruction.cloud import PointCloud, ScanCloud, merge, point_spacing
from cell.reconstruction.registration import Registration, register
from cell.run.cell import RunCell, scanner_of
from cell.run.executions import RecordedExecution, RecordedScan
from cell.run.plan_json import PlanFile, PlanView
from cell.run.record import file_bytes, understood
from cell.view.contents import of_views
from cell.view.surface import Surface
from planner.measurability import coverage
from planner.measurability.quality import best_spacing
from planner.ports import Rejection, Scanner
from planner.surface.closest import NearestSurface
from planner.surface.sample import SurfaceSamples
from planner.values import Bools, Floats, readonly

_NOISE = 5.0  # robust sigma of the distances to the reference, beyond which a point is no noise
_EXACT = 1e-6  # m; nearer than this to the reference, a point is on it
_NEIGHBOURS = 8  # most of them have to be as far off ...
_APART = 3.0  # ... and half of them within so many spacings
_CLOUD_SAMPLES = 40_000  # points whose distance to the reference stands for that of all


@dataclass(frozen=True, slots=True, eq=False)
class ExecutedScan:
    """One readable scan of an execution.

    Attributes:
        stop: number of the view, from 1 in visiting order.
        view: its candidate, row of viewpoints.npz.
        q_commanded: (6,) [rad].
        q_reported: (6,) [rad].
        T_reported: (4, 4) T_object_scanner by the controller's report [m].
        T_reported_poses: (K, 4, 4) all poses of a sweep [m], of which `T_reported` is the middle one; at rest it alone.
        T_true: (4, 4) from where the rays were traced [m]; None where the points are not simulated.
        T_true_poses: (K, 4, 4) likewise [m].
        points: (P, 3) as the data tell them [m].
        counts: rays by `Rejection`; None where the points are not simulated.
        source: where the points come from.
        frame: that they came in.
    """

    stop: int
    view: int
    q_commanded: Floats
    q_reported: Floats
    T_reported: Floats
    T_reported_poses: Floats
    T_true: Floats | None
    T_true_poses: Floats | None
    points: Floats
    counts: tuple[int, ...] | None
    source: str
    frame: str

    def __post_init__(self) -> None:
        # A sentence names the array as the file does.
        for name, stored, shape in (
            ("T_reported", "T_object_scanner", (4, 4)),
            ("T_reported_poses", "sweep_T_object_scanner", (None, 4, 4)),
            ("T_true", "T_object_scanner_true", (4, 4)),
            ("T_true_poses", "sweep_T_object_scanner_true", (None, 4, 4)),
        ):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(stored, getattr(self, name), shape))
        if self.counts is None:
            return
        if not 0 < len(self.counts) <= len(Rejection):  # reasons are appended: an older scan has fewer
            raise ValueError(f"it has {len(self.counts)} counts of rays; there must be 1 to {len(Rejection)}")
        object.__setattr__(self, "counts", (*self.counts, *[0] * (len(Rejection) - len(self.counts))))

    @property
    def cloud(self) -> ScanCloud:
        """The points, seen from the reported source."""
        return ScanCloud(self.points, self.T_reported[:3, 3])


def usable(
    recorded: RecordedExecution, planned: Sequence[PlanView]
) -> tuple[tuple[ExecutedScan, ...], tuple[str, ...]]:
    """The scans that can be used, in driving order, and a sentence about each file that cannot.

    Args:
        recorded: what the execution left.
        planned: the plan's views in visiting order.
    """
    left_out = list(recorded.unreadable)
    scans: list[ExecutedScan] = []
    known = recorded.manifest.artefacts
    for scan in recorded.scans:
        try:
            _require_unchanged(recorded, scan, known.get(f"scans/{scan.name}"))
            scans.append(_of_the_plan(recorded, _executed(recorded, scan), scan.name, planned))
        except FileError as error:
            left_out.append(str(error))
    here = f"{recorded.folder}/"
    return tuple(scans), tuple(sentence.replace(here, "") for sentence in left_out)


def _executed(recorded: RecordedExecution, scan: RecordedScan) -> ExecutedScan:
    with understood(recorded.folder / "scans" / scan.name):
        stored = scan.stored
        source = str(stored.get("source", SIMULATED))  # earlier scans do not say it
        T, is_simulated = stored["T_object_scanner"], source == SIMULATED
        T_true = stored["T_object_scanner_true"] if is_simulated else None
        poses = None if T_true is None else stored.get("sweep_T_object_scanner_true", T_true[None])
        counts = tuple(int(count) for count in stored["counts"]) if is_simulated else None
        return ExecutedScan(
            int(stored["stop"]), scan.view, scan.q_commanded, scan.q_reported, T,
            stored.get("sweep_T_object_scanner", T[None]), T_true, poses, scan.points, counts, source,
            str(stored.get("frame", "object")),
        )  # fmt: skip


def _of_the_plan(
    recorded: RecordedExecution, scan: ExecutedScan, name: str, planned: Sequence[PlanView]
) -> ExecutedScan:
    """The scan, if it is that of the view that its file is named after; a stop has one file name, so none repeats."""
    path = recorded.folder / "scans" / name
    if not 1 <= scan.stop <= len(planned):
        raise FileError(f"{path} is of view {scan.stop}, and the plan has the views 1 to {len(planned)}")
    if name != scan_name(scan.stop):
        raise FileError(f"{path} is of view {scan.stop}, whose file is {scan_name(scan.stop)}")
    if scan.view != planned[scan.stop - 1].id:
        raise FileError(
            f"{path} is of candidate {scan.view}, and view {scan.stop} of the plan is candidate "
            f"{planned[scan.stop - 1].id}"
        )
    return scan


def scan_name(stop: int) -> str:
    """Name of the file of a view, by its number from 1 in visiting order."""
    return f"{stop:04d}.npz"


def _require_unchanged(recorded: RecordedExecution, scan: RecordedScan, expected: str | None) -> None:
    import hashlib

    path = recorded.folder / "scans" / scan.name
    if expected is not None and hashlib.sha256(file_bytes(path)).hexdigest() != expected:
        raise FileError(f"{path} is not what the execution wrote (its sha256 is not the manifest's); scan again")


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
    """

    cloud: PointCloud
    stop: NDArray[np.int32]
    poses: tuple[Floats, ...]
    registration: Registration | None
    rms_before: float
    rms_after: float
    outliers: int = 0


def merged(scans: Sequence[ExecutedScan], nearest: NearestSurface, *, registered: bool) -> Merged:
    """Bring the scans into the object frame by their reported poses, and register them if asked.

    Args:
        scans: of one execution.
        nearest: the reference.
        registered: whether to correct the reported poses by registration.
    """
    clouds = [scan.cloud for scan in scans]
    before = _rms_to(nearest, clouds)
    after, registration = before, None
    poses = [scan.T_reported for scan in scans]
    if registered and clouds:
        registration = register(clouds, nearest)
        corrections = [result.T_correction for result in registration.scans]
        clouds = [cloud.moved(T) for cloud, T in zip(clouds, corrections, strict=True)]
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
    return Merged(cloud, stop, tuple(poses), registration, before, after, count - len(cloud))


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


def _outliers(nearest: NearestSurface, cloud: PointCloud) -> Bools:
    """(N,) points that are off the reference by more than noise takes them, and that no neighbour bears out.

    A dent is borne out: the points beside it, not far away, are as far off. Simulated points meet the reference.
    """
    from scipy.spatial import cKDTree  # takes a tenth of a second, which simulated scans need not wait for

    points = cloud.points
    off = nearest.signed(points)
    limit = max(_NOISE * 1.4826 * float(np.median(np.abs(off))), _EXACT)
    count = min(_NEIGHBOURS + 1, len(points))
    distance, index = (np.reshape(each, (len(points), count)) for each in cKDTree(points).query(points, count))
    alone = distance[:, count // 2] > _APART * point_spacing(points, cloud.scan)
    usual = np.median(off[index], axis=1)
    return np.asarray((np.abs(off) > limit) & (alone | (np.abs(off - usual) > limit)))


def _rms_to(nearest: NearestSurface, clouds: Sequence[ScanCloud]) -> float:
    points = np.concatenate([np.empty((0, 3)), *(cloud.points for cloud in clouds)])
    if not len(points):
        return float("nan")
    chosen = points[np.linspace(0, len(points) - 1, min(len(points), _CLOUD_SAMPLES)).astype(np.int64)]
    return float(np.sqrt(np.mean(nearest.closest(chosen).distance ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class Achieved:
    """Coverage of an execution, as fractions of the surface.

    Attributes:
        visible: measured from at least one executed pose: the true one of a simulation, else the registered one.
        predicted: the same from the planned poses of the views that were scanned.
        sampled: within `radius` of a scan point.
        dense: measured, and within 1.5 x the spacing planned there of a scan point; None: not known, or
            a sensor that sweeps, whose lines `cell.scan.sweep_scan` takes farther apart than it does.
        radius: of sampled coverage [m].
        adds: (n,) what each scan adds to visible coverage, in driving order.
        largest_first: (n,) what each adds when the one that adds most comes first.
        surface: what the scans measure of the held-out samples.
    """

    visible: float
    predicted: float
    sampled: float
    dense: float | None
    radius: float
    adds: Floats
    largest_first: Floats
    surface: Surface


def achieved(
    scans: Sequence[ExecutedScan],
    plan: PlanFile,
    merged: Merged,
    cell: RunCell,
    plan_seed: int,
) -> Achieved:
    """Measure coverage on the samples on which the plan predicted it.

    Args:
        scans: of one execution.
        plan: its views, and what was predicted for all of them.
        merged: the same scans.
        cell: part, surroundings and scanner.
        plan_seed: seed of the plan, from which its held-out samples were drawn.
    """
    samples = held_out(cell.reference, cell.planning, plan_seed)
    surface = of_views(cell, samples, executed_poses(scans, merged))
    measured = surface.seen
    predicted = plan.coverage.visible
    poses = [plan.views[scan.stop - 1].T_object_poses for scan in scans]
    if sorted(scan.stop for scan in scans) != list(range(1, len(plan.views) + 1)):
        predicted = _share(of_views(cell, samples, poses).seen, samples)
    radius = coverage.sampling_radius(cell.reference)
    order = _largest_first(measured)
    spacing = None
    if poses and len(poses[0]) == 1:
        # The plan's scanner: its grid counts, whatever the resolution of the scan.
        planned = scanner_of(cell.scene, cell.scene.scanner)
        spacing = best_spacing(np.stack(poses), samples, measured, planned)
    return Achieved(
        visible=_share(measured, samples),
        predicted=predicted,
        sampled=coverage.sampled(merged.cloud.points, samples, radius).fraction,
        dense=None if spacing is None else coverage.dense(merged.cloud.points, samples, spacing).fraction,
        radius=radius,
        adds=coverage.added(measured),
        largest_first=coverage.added(measured[:, order]),
        surface=surface,
    )


def executed_poses(scans: Sequence[ExecutedScan], merged: Merged) -> list[Floats]:
    """(K, 4, 4) poses of each scan [m]: the true ones of a simulation, else the registered ones."""
    return [
        T @ np.linalg.inv(scan.T_reported) @ scan.T_reported_poses if scan.T_true_poses is None else scan.T_true_poses
        for scan, T in zip(scans, merged.poses, strict=True)
    ]


def source_of(scans: Sequence[ExecutedScan]) -> str:
    """Where the points of scans come from, in words; "no points" without any."""
    return "; ".join(dict.fromkeys(scan.source for scan in scans)) or "no points"


def _share(measured: NDArray[np.bool_], samples: SurfaceSamples) -> float:
    covered = np.any(measured, axis=1)
    return float(samples.areas[covered].sum()) / float(samples.areas.sum())


def _largest_first(measured: NDArray[np.bool_]) -> list[int]:
    left = list(range(measured.shape[1]))
    still_open = np.ones(len(measured), dtype=np.bool_)
    order = []
    while left:
        best = max(left, key=lambda column: int((measured[:, column] & still_open).sum()))
        left.remove(best)
        order.append(best)
        still_open &= ~measured[:, best]
    return order


def counts_by_reason(counts: Sequence[int]) -> dict[str, int]:
    """Rays by the name of what became of them."""
    return {reason.name.lower(): int(counts[reason]) for reason in Rejection}
