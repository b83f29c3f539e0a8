"""Limits of the reconstruction: clouds of decreasing density, and of increasing noise.

Eight virtual scans around a part; the truth is the part itself. Success is the share of the visible samples that have
reconstructed surface near them. Object frame, metres.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from benchmarks.eight_scans import eight_scans, noisy
from benchmarks.methods.bumpy_body import body
from benchmarks.methods.stability_map import Map, MapPoint
from cell.metrology.reconstruct import Reconstruction, reconstruct
from cell.part.workpiece import Workpiece
from cell.world.embree import EmbreeRayCaster
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.sampling import draw_samples
from planner.registration.cloud import ScanCloud, merge, point_spacing
from planner.registration.surface import measure_deviation
from planner.values import Floats

_FINEST_DEG = 1.0
_NEAR = 0.01  # of the diagonal: largest distance of a sample from its reconstructed surface


@lru_cache(maxsize=1)
def _part() -> Workpiece:
    return body()


@lru_cache(maxsize=1)
def _nearest() -> ClosestPointQuery:
    return ClosestPointQuery(_part().reference)


@lru_cache(maxsize=8)
def _scans(step_deg: float) -> tuple[ScanCloud, ...]:
    return tuple(eight_scans(_part(), step_deg))


def _diagonal() -> float:
    return float(np.linalg.norm(_part().size))


@lru_cache(maxsize=2)
def _in_sight(count: int) -> Floats:
    """Return (n, 3) samples of the part that a source of the eight scans sees."""
    reference = _part().reference
    samples = draw_samples(reference, reference, count, np.random.default_rng(0))
    caster = EmbreeRayCaster(reference.vertices, reference.faces)
    seen = np.zeros(count, dtype=np.bool_)
    lifted = samples.points + 1e-6 * _diagonal() * samples.normals
    for scan in _scans(_FINEST_DEG):
        sight = scan.sensor - samples.points
        facing = np.einsum("nj,nj->n", sight, samples.normals) > 0.3 * np.linalg.norm(sight, axis=1)
        seen |= facing & ~caster.blocked(np.broadcast_to(scan.sensor, lifted.shape), lifted)
    return np.asarray(samples.points[seen])


def _evaluate(result: Reconstruction, count: int) -> MapPoint:
    says = " ".join(result.doubts) if result.mesh is not None else result.status.value
    spacing = {"spacing mm": 1e3 * result.spacing if np.isfinite(result.spacing) else None}
    if result.mesh is None:
        return MapPoint(0.0, None, says, spacing)
    places = _in_sight(count)
    near = ClosestPointQuery(result.mesh).closest(places).distance <= _NEAR * _diagonal()
    off = measure_deviation(result.mesh, _nearest(), np.random.default_rng(0), count=count)
    return MapPoint(
        float(near.mean()), 100 * off.rms / _diagonal(), says,
        {**spacing, "rms mm": 1e3 * off.rms, "holes": result.holes, "outliers": result.outliers,
         "noise mm": 1e3 * result.noise, "faces": len(result.mesh.faces)},
    )  # fmt: skip


def sparse(line: str, step_deg: float, count: int) -> MapPoint:
    """Evaluate the surface of scans with a larger angle between rays."""
    return _evaluate(reconstruct(merge(list(_scans(step_deg)))), count)


def noise(line: str, spacings: float, count: int) -> MapPoint:
    """Evaluate the surface of scans with noise along the rays, in point spacings."""
    step = float(line.split()[0])
    spacing = _spacing(step)
    point = _evaluate(reconstruct(merge(noisy(list(_scans(step)), spacings * spacing))), count)
    if point.error is None:
        return point
    return replace(point, error=point.error / 100 * _diagonal() / spacing)


@lru_cache(maxsize=4)
def _spacing(step_deg: float) -> float:
    """Return the point spacing of the exact scans [m]."""
    scans = _scans(step_deg)
    points = np.concatenate([scan.points for scan in scans])
    return point_spacing(points, np.repeat(np.arange(len(scans)), [len(scan) for scan in scans]))


MAPS = {
    "sparse": Map(
        "Reconstruction from sparse clouds: eight scans of a bumpy body from 300 mm", "angle between rays [deg]",
        "surface in sight that has mesh within 1 % of the diagonal", "rms deviation [% of the diagonal]", 0.2,
        (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 12.0, 20.0), (1.0, 8.0), sparse, (5000, 500),
    ),
    "noise": Map(
        "Reconstruction from noisy clouds: eight scans of a bumpy body from 300 mm",
        "noise along the rays, one sigma [point spacings]",
        "surface in sight that has mesh within 1 % of the diagonal", "rms deviation [point spacings]", 0.25,
        (0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 1.0, 1.5, 2.5), (0.1, 1.0), noise, (5000, 500),
        lines=("1 deg", "0.7 deg"), quick_lines=1,
    ),
}  # fmt: skip
"""Of the reconstruction."""
