"""What views do to a part's surface, for pictures and pages: which view measures which sample, how finely, how surely.

Any place of the surface takes the values of the nearest held-out sample that looks the same way, so that a thin wall
shows its own side. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.rays.embree import EmbreeRayCaster
from cell.view.rays import direction
from planner.measurability.matrix import measured
from planner.ports import RayCaster, Scanner
from planner.surface.mesh import TriangleMesh, cross_products
from planner.surface.sample import SurfaceSamples
from planner.values import Floats, Ints, Value
from planner.viewpoints.lines_of_sight import Targets, in_view

_WALL = 0.02  # of the diagonal: two samples that look apart by a right angle count as 1.4 times this far apart
_SIDES = ((-60.0, 22.0), (120.0, 22.0), (30.0, -30.0), (-150.0, -30.0))  # looked from where nothing asks for more
_ASKED = 2000  # samples that directions are judged by
_LEAST = 0.02  # of them: what a further direction shows at least


@dataclass(frozen=True, slots=True, eq=False)
class Surface(Value):
    """A part's samples with what some views measure of them.

    Attributes:
        reference: the part.
        samples: S of them.
        seen: (S, n) whether a view measures a sample.
        layers: (S,) values by name [mm], the best of the views that measure the sample, NaN where none does: `sigma`,
            the expected standard deviation, of scanners that know it; `spacing`, the larger distance between
            neighbouring points, of scanners with a grid of rays.
    """

    reference: TriangleMesh
    samples: SurfaceSamples
    seen: Annotated[NDArray[np.bool_], "S n"]
    layers: dict[str, Floats]


def surface_of(
    reference: TriangleMesh,
    samples: SurfaceSamples,
    T_object_scanner: Floats,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    resolution_deg: float | None,
) -> Surface:
    """Ask the views about the samples.

    Args:
        reference: the part.
        samples: of it.
        T_object_scanner: (n, K, 4, 4) poses of the views [m].
        scanner: the sensor's law.
        casters: the part's and the occluders'.
        resolution_deg: larger angle between neighbouring rays; None for a scanner without such a grid.
    """
    poses = np.asarray(T_object_scanner)
    seen = measured(poses, samples, scanner, casters, each=True)
    sigma_of = getattr(scanner, "sigma", None)
    best = {"spacing": resolution_deg is not None, "sigma": sigma_of is not None}
    layers = {name: np.full(len(samples), np.inf) for name, known in best.items() if known}
    targets = Targets.of(samples.points, samples.normals)
    for view, column in enumerate(poses):
        rows = np.flatnonzero(seen[:, view])
        for T in column:
            here = rows if len(column) == 1 else rows[np.isin(rows, in_view(targets, T, scanner, rows))]
            points, normals = (samples.points[here] - T[:3, 3]) @ T[:3, :3], samples.normals[here] @ T[:3, :3]
            if sigma_of is not None:
                layers["sigma"][here] = np.minimum(layers["sigma"][here], 1000 * sigma_of(points, normals))
            if resolution_deg is not None:
                # Rays a small angle apart meet a plane at distance r under the angle t to its normal r * angle / cos t
                # apart, in the direction in which it is inclined.
                r2 = np.einsum("ij,ij->i", points, points)
                facing = np.abs(np.einsum("ij,ij->i", points, normals))
                gap = 1000 * np.radians(resolution_deg) * r2 / np.maximum(facing, 1e-9)
                layers["spacing"][here] = np.minimum(layers["spacing"][here], gap)
    for values in layers.values():
        values[~np.isfinite(values)] = np.nan
    return Surface(reference, samples, seen, layers)


def nearest(samples: SurfaceSamples, points: Floats, normals: Floats, diagonal: float) -> Ints:
    """(N,) for each place of the surface the nearest sample that looks the same way.

    Args:
        samples: of the surface.
        points: (N, 3) on it [m].
        normals: (N, 3) outward unit normals there.
        diagonal: of the part's bounding box [m].
    """
    from scipy.spatial import cKDTree

    weight = _WALL * diagonal
    tree = cKDTree(np.hstack([samples.points, weight * samples.normals]), balanced_tree=False, compact_nodes=False)
    return np.asarray(tree.query(np.hstack([points, weight * normals]))[1], dtype=np.int64)


def vertex_normals(mesh: TriangleMesh) -> Floats:
    """(V, 3) unit normals, each face weighted with its area; zero for a vertex without faces."""
    cross, normals = cross_products(mesh.vertices, mesh.faces), np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], cross)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def sides(
    caster: EmbreeRayCaster, samples: SurfaceSamples, wanted: NDArray[np.bool_], diagonal: float, count: int
) -> list[Floats]:
    """Directions to look from: each shows most of what is wanted and no earlier one shows.

    Args:
        caster: of the part.
        samples: of its surface.
        wanted: (S,) those that should be shown.
        diagonal: of the part's bounding box [m].
        count: how many directions; where nothing more is shown, they are around the part.

    Returns:
        `count` unit vectors from the part to the eye.
    """
    rows = np.flatnonzero(wanted)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(np.int64)] if len(rows) else rows
    ways = np.array([direction(a, e) for e in (-62, -30, 0, 25, 60) for a in range(0, 360, 30)])
    shown = np.zeros((len(ways), len(rows)))
    points, normals = samples.points[rows], samples.normals[rows]
    for i, way in enumerate(ways):
        facing = normals @ way
        ahead = np.flatnonzero(facing > 0.1)
        free = ~caster.blocked(points[ahead] + 2 * diagonal * way, points[ahead])
        shown[i, ahead[free]] = facing[ahead[free]]
    chosen: list[Floats] = []
    left = np.ones(len(rows))
    while len(chosen) < count and len(rows) and (shown @ left).max() > _LEAST * len(rows):
        best = int(np.argmax(shown @ left))
        chosen.append(ways[best])
        left *= 1 - np.minimum(1.0, 2 * shown[best])
    for azimuth, elevation in _SIDES:
        way = direction(azimuth, elevation)
        if len(chosen) < count and all(way @ other < 0.6 for other in chosen):
            chosen.append(way)
    return (chosen + [direction(*_SIDES[0])] * count)[:count]
