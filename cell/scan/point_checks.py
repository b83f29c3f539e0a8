"""Find contradictions in measured points and their likely cause: units, a mirrored or wrong frame, swapped views.

Each cause is tested: the points are transformed as if it were true, and the cost is their distance from the reference,
the median of each view, averaged over the views. The cause with the smallest cost is reported if that is less than half
of the cost of the points as given. Simulated points are not checked. Object frame, metres.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from cell.part.workpiece import UNITS
from cell.runs.cell import RunCell
from cell.runs.run import SIMULATED, ExecutedScan
from cell.scan.acquisition import FRAMES
from planner.geometry.closest import ClosestPointQuery
from planner.registration.rigid import transform_points
from planner.values import Floats

_SAMPLES = 200  # tested points of a view
_SMALLEST = 0.001  # of the part's diagonal: points that are nearer are consistent
_LARGEST = 0.03  # of the part's diagonal: farther than the reach of registration
_BETTER = 0.5
_SPOT = 0.02  # of the part's diagonal: points that shrink to a spot may be on the part by chance
_OUTSIDE = 0.2  # share of a view's points that may be outliers

Hypothesis = tuple[str, Sequence[Floats]]
"""A cause in words, and the points of each view if it is true."""


def find_contradictions(
    scans: Sequence[ExecutedScan], cell: RunCell, nearest: ClosestPointQuery, units: str | None
) -> list[str]:
    """Return one sentence for each contradiction in points that are not simulated.

    Args:
        scans: of one execution, by their reported poses.
        cell: part and scanner.
        nearest: the reference.
        units: given unit of the points; None if the source gives them in metres.
    """
    scans = [scan for scan in scans if scan.source != SIMULATED and len(scan.points)]
    if not scans:
        return []
    diagonal = cell.reference.diagonal
    clouds = [scan.points[np.linspace(0, len(scan.points) - 1, _SAMPLES).astype(np.int64)] for scan in scans]
    distance = _distances(clouds, nearest, diagonal)
    if distance.mean() > _SMALLEST * diagonal:
        costs = [
            (float(_distances(points, nearest, diagonal).mean()), cause)
            for cause, points in _hypotheses(clouds, scans, cell, units)
            if np.median([np.linalg.norm(np.ptp(view, axis=0)) for view in points]) > _SPOT * diagonal
        ]
        costs += _swapped_views(clouds, scans, nearest, diagonal)
        least, cause = min(costs, default=(np.inf, ""))
        if least < _BETTER * distance.mean():
            return [
                f"the points lie {1000 * distance.mean():.3g} mm off the part as they are given, and "
                f"{1000 * least:.3g} mm off if {cause}; correct that and acquire again"
            ]
    far = [
        f"the points of view {scan.stop} lie {1000 * off:.3g} mm off the part, beyond the reach of registration, and "
        "neither units, frame nor another view explain it; check mount, placement and the scanner's calibration"
        for scan, off in zip(scans, distance, strict=True)
        if off > _LARGEST * diagonal
    ]
    return far or _outside_sensor_limits(clouds, scans, cell)


def _distances(views: Sequence[Floats], nearest: ClosestPointQuery, diagonal: float) -> Floats:
    """Return the median distance (n,) of each view's points from the reference [m], at most the diagonal."""
    distance = nearest.closest(np.concatenate(views)).distance.reshape(len(views), -1)
    return np.minimum(np.median(distance, axis=1), diagonal)


def _T_object(scan: ExecutedScan, frame: str, cell: RunCell) -> Floats:
    """Return the pose (4, 4) of a frame in the object frame at the reported pose of a scan [m]."""
    T: Floats = {
        "scanner": scan.T_reported,
        "flange": scan.T_reported @ np.linalg.inv(cell.scene.T_flange_scanner),
        "base": np.linalg.inv(cell.in_base(scan.q_reported, cell.scene.T_base_object)),
        "object": np.eye(4),
    }[frame]
    return T


def _hypotheses(
    clouds: Sequence[Floats], scans: Sequence[ExecutedScan], cell: RunCell, units: str | None
) -> Iterator[Hypothesis]:
    """Yield causes that affect all views alike: unit, mirrored frame, other frame."""
    poses = [_T_object(scan, scan.frame, cell) for scan in scans]
    raw = [transform_points(np.linalg.inv(T), points) for T, points in zip(poses, clouds, strict=True)]

    def scaled(factor: Floats) -> list[Floats]:
        return [transform_points(T, points * factor) for T, points in zip(poses, raw, strict=True)]

    given, given_frame = units or "m", scans[0].frame
    for name, metres in UNITS.items():
        if name != given:
            yield f"their unit is {name}, not {given}", scaled(np.full(3, metres / UNITS[given]))
    for k, axis in enumerate("xyz"):
        cause = f"their frame is mirrored in {axis} (a left-handed frame, or a wrong sign)"
        yield cause, scaled(np.where(np.arange(3) == k, -1.0, 1.0))
    for frame in FRAMES:
        if frame != given_frame:
            other_poses = [_T_object(scan, frame, cell) for scan in scans]
            moved = [transform_points(T, points) for T, points in zip(other_poses, raw, strict=True)]
            yield f"they are in the {frame} frame, not in the {given_frame} frame", moved


def _swapped_views(
    clouds: Sequence[Floats], scans: Sequence[ExecutedScan], nearest: ClosestPointQuery, diagonal: float
) -> list[tuple[float, str]]:
    """Return cost and cause of the best exchange of views; only points in a moving frame reveal one."""
    if len(scans) < 2 or scans[0].frame not in ("scanner", "flange"):
        return []
    poses = [scan.T_reported for scan in scans]
    inverse = [np.linalg.inv(T) for T in poses]
    costs = np.stack(
        [
            _distances([transform_points(T @ inverse[k], points) for T in poses], nearest, diagonal)
            for k, points in enumerate(clouds)
        ]
    )
    rows, columns = linear_sum_assignment(costs)
    swapped = [
        (scans[k].stop, scans[n].stop)
        for k, n in zip(rows.tolist(), columns.tolist(), strict=True)
        if costs[k, n] < _BETTER * costs[k, k] and k != n
    ]
    if not swapped:
        return []
    names = ", ".join(f"{one} belongs to view {other}" for one, other in swapped)
    return [(float(costs[rows, columns].mean()), f"views are swapped (what is given as view {names})")]


def _outside_sensor_limits(clouds: Sequence[Floats], scans: Sequence[ExecutedScan], cell: RunCell) -> list[str]:
    """Return a sentence for each view with many points outside field of view or range of the scanner."""
    keys = cell.scanner_keys.own
    fov, limits = keys.get("fov_deg"), keys.get("range_mm")
    sentences: list[str] = []
    for points, scan in zip(clouds, scans, strict=True):
        if not isinstance(fov, list) or not isinstance(limits, list) or len(scan.T_reported_poses) > 1:
            break
        local = transform_points(np.linalg.inv(scan.T_reported), points)
        half = np.tan(np.radians(np.asarray(fov, dtype=np.float64)) / 2)
        distance = 1000 * np.linalg.norm(local, axis=1)
        low, high = (float(limit) for limit in limits)  # type: ignore[arg-type]
        outside_fov = (np.abs(local[:, :2]) > 1.02 * half * local[:, 2:]).any(axis=1)
        outside_range = (distance < 0.98 * low) | (distance > 1.02 * high)
        for share, limit in ((outside_fov.mean(), "field of view"), (outside_range.mean(), "range")):
            if share > _OUTSIDE:
                sentences.append(
                    f"{100 * share:.0f} % of the points of view {scan.stop} lie outside the scanner's {limit}; the "
                    "scene describes another scanner, or another mount"
                )
    return sentences
