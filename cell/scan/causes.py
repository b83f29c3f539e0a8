"""What points contradict, and the likely cause: units, a mirrored frame, another frame, swapped views.

Each cause is tried: the points are taken as if it were so, and what is left is their distance from the reference, the
median of each view, averaged over the views. The cause that leaves least is told where it leaves less than half of what
is left as the points are given. Simulated points are not asked. Object frame, metres.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cell.acquisition import SIMULATED
from cell.acquisition.sources import FRAMES
from cell.part.workpiece import UNITS
from cell.runs.cell import RunCell
from cell.runs.run import ExecutedScan
from planner.geometry.closest import ClosestPointQuery
from planner.values import Floats

_SAMPLES = 200  # points of a view that are asked
_SMALLEST = 0.001  # of the part's diagonal: nearer than this, points are where they should be
_LARGEST = 0.03  # farther off than registration reaches
_BETTER = 0.5
_SPOT = 0.02  # of the part's diagonal: points that come down to a spot may be on the part by chance
_OUTSIDE = 0.2  # share of a view's points that may be outliers

Guess = tuple[str, Sequence[Floats]]
"""A sentence, and the points of each view as they would be."""


def doubts(scans: Sequence[ExecutedScan], cell: RunCell, nearest: ClosestPointQuery, units: str | None) -> list[str]:
    """What is wrong with points that are not simulated, a sentence each; none where all is well.

    Args:
        scans: of one execution, by their reported poses.
        cell: part and scanner.
        nearest: the reference.
        units: that the points were said to be in; None where the source has none.
    """
    scans = [scan for scan in scans if scan.source != SIMULATED and len(scan.points)]
    if not scans:
        return []
    diagonal = cell.reference.diagonal
    given = [scan.points[np.linspace(0, len(scan.points) - 1, _SAMPLES).astype(np.int64)] for scan in scans]
    left = _left(given, nearest, diagonal)
    if left.mean() > _SMALLEST * diagonal:
        found = [
            (float(_left(points, nearest, diagonal).mean()), why)
            for why, points in _guesses(given, scans, cell, units)
            if np.median([np.linalg.norm(np.ptp(view, axis=0)) for view in points]) > _SPOT * diagonal
        ]
        found += _swapped(given, scans, nearest, diagonal)
        least, why = min(found, default=(np.inf, ""))
        if least < _BETTER * left.mean():
            return [
                f"the points lie {1000 * left.mean():.3g} mm off the part as they are given, and {1000 * least:.3g} mm "
                f"off if {why}; correct that and acquire again"
            ]
    said = [
        f"the points of view {scan.stop} lie {1000 * off:.3g} mm off the part, farther than registration reaches, and "
        "neither units, frame nor another view explain it; look at mount, placement and the scanner's calibration"
        for scan, off in zip(scans, left, strict=True)
        if off > _LARGEST * diagonal
    ]
    return said or _outside(given, scans, cell)


def _left(views: Sequence[Floats], nearest: ClosestPointQuery, diagonal: float) -> Floats:
    """(n,) median distance of each view's points from the reference [m], a diagonal at most."""
    distance = nearest.closest(np.concatenate(views)).distance.reshape(len(views), -1)
    return np.minimum(np.median(distance, axis=1), diagonal)


def _T_object(scan: ExecutedScan, frame: str, cell: RunCell) -> Floats:
    """(4, 4) from a frame to the object's, at the reported pose of a scan [m]."""
    T: Floats = {
        "scanner": scan.T_reported,
        "flange": scan.T_reported @ np.linalg.inv(cell.scene.T_flange_scanner),
        "base": np.linalg.inv(cell.in_base(scan.q_reported, cell.scene.T_base_object)),
        "object": np.eye(4),
    }[frame]
    return T


def _moved(T: NDArray[np.floating[Any]], points: Floats) -> Floats:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3], dtype=np.float64)


def _guesses(
    given: Sequence[Floats], scans: Sequence[ExecutedScan], cell: RunCell, units: str | None
) -> Iterator[Guess]:
    """What may be wrong with all views alike: their unit, a mirrored frame, another frame."""
    frames = [_T_object(scan, scan.frame, cell) for scan in scans]
    raw = [_moved(np.linalg.inv(T), points) for T, points in zip(frames, given, strict=True)]

    def scaled(factor: Floats) -> list[Floats]:
        return [_moved(T, points * factor) for T, points in zip(frames, raw, strict=True)]

    said, frame_said = UNITS.get(units or "m", 1.0), scans[0].frame
    for name, metres in UNITS.items():
        if name != units:
            yield f"their unit is {name}, not {units}", scaled(np.full(3, metres / said))
    for k, axis in enumerate("xyz"):
        why = f"their frame is mirrored in {axis} (a left-handed frame, or a wrong sign)"
        yield why, scaled(np.where(np.arange(3) == k, -1.0, 1.0))
    for frame in FRAMES:
        if frame != frame_said:
            there = [_T_object(scan, frame, cell) for scan in scans]
            moved = [_moved(T, points) for T, points in zip(there, raw, strict=True)]
            yield f"they are in the {frame} frame, not in the {frame_said} frame", moved


def _swapped(
    given: Sequence[Floats], scans: Sequence[ExecutedScan], nearest: ClosestPointQuery, diagonal: float
) -> list[tuple[float, str]]:
    """What is left where the points of views are exchanged as fits best; only frames that travel can tell."""
    if len(scans) < 2 or scans[0].frame not in ("scanner", "flange"):
        return []
    poses = [scan.T_reported for scan in scans]
    back = [np.linalg.inv(T) for T in poses]
    left = np.stack(
        [
            _left([_moved(T @ back[k], points) for T in poses], nearest, diagonal)
            for k, points in enumerate(given)
        ]
    )  # fmt: skip
    rows, columns = linear_sum_assignment(left)
    moved = [
        (scans[k].stop, scans[n].stop)
        for k, n in zip(rows.tolist(), columns.tolist(), strict=True)
        if left[k, n] < _BETTER * left[k, k] and k != n
    ]
    if not moved:
        return []
    names = ", ".join(f"{one} is of view {other}" for one, other in moved)
    return [(float(left[rows, columns].mean()), f"views are swapped (what is given as view {names})")]


def _outside(given: Sequence[Floats], scans: Sequence[ExecutedScan], cell: RunCell) -> list[str]:
    """Views with many points that the scanner cannot have seen."""
    keys = cell.scanner_keys.own
    fov, reach = keys.get("fov_deg"), keys.get("range_mm")
    said = []
    for points, scan in zip(given, scans, strict=True):
        if not isinstance(fov, list) or not isinstance(reach, list) or len(scan.T_reported_poses) > 1:
            break
        seen = _moved(np.linalg.inv(scan.T_reported), points)
        half = np.tan(np.radians(np.asarray(fov, dtype=np.float64)) / 2)
        distance = 1000 * np.linalg.norm(seen, axis=1)
        low, high = (float(limit) for limit in reach)  # type: ignore[arg-type]
        beside = (np.abs(seen[:, :2]) > 1.02 * half * seen[:, 2:]).any(axis=1)
        beyond = (distance < 0.98 * low) | (distance > 1.02 * high)
        for share, what in ((beside.mean(), "field of view"), (beyond.mean(), "range")):
            if share > _OUTSIDE:
                said.append(
                    f"{100 * share:.0f} % of the points of view {scan.stop} lie outside the scanner's {what}; the "
                    "scene describes another scanner, or another mount"
                )
    return said
