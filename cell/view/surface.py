"""What views do to a part's surface, for pictures and pages: which view measures which sample, how finely, how surely.

A face of the mesh that is drawn takes the values of the nearest held-out sample that looks the same way, so that a thin
wall shows its own side. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cell.view.rays import direction
from cell.world.embree import EmbreeRayCaster
from planner.geometry.closest import closest_facing_faces
from planner.geometry.decimation import cluster_vertices, decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.quality import best_values
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Bools, Floats, Ints, Value

_WALL = 0.02  # of the diagonal: two samples that look apart by a right angle count as 1.4 times this far apart
_SIDES = ((-60.0, 22.0), (120.0, 22.0), (30.0, -30.0), (-150.0, -30.0))  # looked from where nothing asks for more
_ASKED = 2000  # samples that directions are judged by
_LIFT = 2e-3  # of the diagonal: the mesh that is drawn may stand over its samples
_LEAST = 0.02  # of them: what a further direction shows at least


FACES = 120_000
"""Most faces of a mesh that is drawn."""

_FINE = 40_000  # faces into which those of a coarser mesh are split, so that each can have its own colour


@dataclass(frozen=True, slots=True, eq=False)
class Canvas(Value):
    """A surface made ready to be coloured.

    Attributes:
        mesh: clustered or decimated above `FACES` faces, large faces split.
        normals: of its faces.
        caster: of the mesh.
        samples: S of the true surface.
        own: (F,) sample whose values a face has.
        note: what is not as it is; "" where nothing is.
        aside: (F,) faces that nobody cares for; None: somebody cares for all.
    """

    mesh: TriangleMesh
    normals: Annotated[Floats, "F 3"]
    caster: EmbreeRayCaster
    samples: SurfaceSamples
    own: Annotated[Ints, "F"]
    note: str
    aside: Annotated[Bools, "F"] | None = None

    def at_vertices(self) -> Ints:
        """(V,) sample whose values a vertex has: that of one of its faces, where it has one of those that count."""
        own = np.zeros(len(self.mesh.vertices), dtype=np.int64)
        own[self.mesh.faces] = self.own[:, None]
        if self.aside is not None:
            own[self.mesh.faces[~self.aside]] = self.own[~self.aside, None]
        return own

    @property
    def counted(self) -> TriangleMesh:
        """The faces that somebody cares for, with all vertices."""
        return self.mesh if self.aside is None else TriangleMesh(self.mesh.vertices, self.mesh.faces[~self.aside])


def canvas_of(reference: TriangleMesh, samples: SurfaceSamples) -> Canvas:
    """Make a part ready to be coloured.

    Args:
        reference: the part.
        samples: of it.
    """
    count = len(reference.faces)
    mesh = cluster_vertices(reference, FACES) or decimate(reference, FACES if count > FACES else max(count, _FINE))
    weight = _WALL * reference.diagonal
    tree = cKDTree(np.hstack([samples.points, weight * samples.normals]), balanced_tree=False, compact_nodes=False)
    normals = mesh.normals
    _, own = tree.query(np.hstack([mesh.centres, weight * normals]))
    note = f"drawn with {len(mesh.faces):,} of {count:,} faces" if len(mesh.faces) < count else ""
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    aside = None
    if reference.region is not None:
        aside = reference.region[closest_facing_faces(mesh.centres, normals, reference)] < 0
    return Canvas(mesh, normals, caster, samples, np.asarray(own, dtype=np.int64), note, aside)


@dataclass(frozen=True, slots=True, eq=False)
class Surface(Value):
    """What some views measure of the samples of a surface.

    Attributes:
        samples: S of them.
        seen: (S, n) whether a view measures a sample.
        layers: (S,) values by name [mm], the best of the views that measure the sample, NaN where none does: `sigma`,
            the expected standard deviation, and `spacing`, the larger distance between neighbouring points, of scanners
            that know them.
    """

    samples: SurfaceSamples
    seen: Annotated[NDArray[np.bool_], "S n"]
    layers: dict[str, Floats]


def surface_of(
    samples: SurfaceSamples,
    T_object_scanner: Floats,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    seen: Bools | None = None,
) -> Surface:
    """Ask the views about the samples.

    Args:
        samples: of the part.
        T_object_scanner: (n, K, 4, 4) poses of the views [m].
        scanner: the sensor's law.
        casters: the part's and the occluders'.
        seen: (S, n) which samples each view measures, where that is known; None asks.
    """
    poses = np.asarray(T_object_scanner)
    if seen is None:
        seen = find_measured(poses, samples, scanner, casters, each=True)
    known = {name: law for name in ("spacing", "sigma") if callable(law := getattr(scanner, name, None))}
    best = best_values(list(known.values()), poses, samples, seen, scanner)
    layers = {name: 1000 * values for name, values in zip(known, best, strict=True)}
    return Surface(samples, seen, layers)


def sides(canvas: Canvas, wanted: NDArray[np.bool_], count: int) -> list[Floats]:
    """Directions to look from: each shows most of what is wanted and no earlier one shows.

    Args:
        canvas: the surface.
        wanted: (S,) samples that should be shown.
        count: how many directions; where nothing more is shown, they are around the part.

    Returns:
        `count` unit vectors from the part to the eye.
    """
    rows = np.flatnonzero(wanted)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(np.int64)] if len(rows) else rows
    ways = np.array([direction(a, e) for e in (-62, -30, 0, 25, 60) for a in range(0, 360, 30)])
    shown = np.zeros((len(ways), len(rows)))
    diagonal, normals = canvas.mesh.diagonal, canvas.samples.normals[rows]
    points = canvas.samples.points[rows] + _LIFT * diagonal * normals
    for i, way in enumerate(ways):
        facing = normals @ way
        ahead = np.flatnonzero(facing > 0.1)
        free = ~canvas.caster.blocked(points[ahead] + 2 * diagonal * way, points[ahead])
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
