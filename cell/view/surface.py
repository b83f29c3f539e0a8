"""Measured samples of a part's surface for pictures and pages: views, point spacing and standard deviation.

A face of the drawn mesh takes the values of the nearest held-out sample with a similar normal, so that each side of a
thin wall shows its own values. Object frame, metres.
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

_NORMAL_WEIGHT = 0.02  # of the diagonal: normals at a right angle add 1.4 times this to the distance of two samples
_DEFAULT_DEG = ((-60.0, 22.0), (120.0, 22.0), (30.0, -30.0), (-150.0, -30.0))  # azimuth and elevation
_N_SAMPLES = 2000  # samples that rate a viewing direction
_LIFT = 2e-3  # of the diagonal: the drawn mesh may lie above its samples
_MIN_SHARE = 0.02  # of the target samples, which a further direction must show

MAX_FACES = 120_000
"""Largest number of faces of a drawn mesh."""

_MIN_FACES = 40_000  # a coarser mesh is split into this many faces, so that each can have its own colour


@dataclass(frozen=True, slots=True, eq=False)
class Canvas(Value):
    """A mesh whose faces take their colours from samples of the true surface.

    Attributes:
        mesh: clustered or decimated above `MAX_FACES` faces; large faces are split.
        normals: of its faces.
        caster: of the mesh.
        samples: of the true surface.
        face_samples: sample that gives each face its values.
        note: difference between mesh and part in a sentence, or "".
        ignored: faces outside all regions that count; None if every face counts.
    """

    mesh: TriangleMesh
    normals: Annotated[Floats, "F 3"]
    caster: EmbreeRayCaster
    samples: SurfaceSamples
    face_samples: Annotated[Ints, "F"]
    note: str
    ignored: Annotated[Bools, "F"] | None = None

    def vertex_samples(self) -> Ints:
        """Return the (V,) sample of each vertex, taken from an adjacent face that counts if there is one."""
        samples = np.zeros(len(self.mesh.vertices), dtype=np.int64)
        samples[self.mesh.faces] = self.face_samples[:, None]
        if self.ignored is not None:
            samples[self.mesh.faces[~self.ignored]] = self.face_samples[~self.ignored, None]
        return samples

    @property
    def counted_mesh(self) -> TriangleMesh:
        """The faces that count, with all vertices."""
        return self.mesh if self.ignored is None else TriangleMesh(self.mesh.vertices, self.mesh.faces[~self.ignored])


def canvas_of(reference: TriangleMesh, samples: SurfaceSamples) -> Canvas:
    """Return the canvas of a part with samples of its surface."""
    count = len(reference.faces)
    n_faces = MAX_FACES if count > MAX_FACES else max(count, _MIN_FACES)
    mesh = cluster_vertices(reference, MAX_FACES) or decimate(reference, n_faces)
    weight = _NORMAL_WEIGHT * reference.diagonal
    tree = cKDTree(np.hstack([samples.points, weight * samples.normals]), balanced_tree=False, compact_nodes=False)
    normals = mesh.normals
    _, face_samples = tree.query(np.hstack([mesh.centres, weight * normals]))
    note = f"drawn with {len(mesh.faces):,} of {count:,} faces" if len(mesh.faces) < count else ""
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    ignored = None
    if reference.region is not None:
        ignored = reference.region[closest_facing_faces(mesh.centres, normals, reference)] < 0
    return Canvas(mesh, normals, caster, samples, np.asarray(face_samples, dtype=np.int64), note, ignored)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSamples(Value):
    """Samples of a surface and the views that measure them.

    Attributes:
        samples: S of them.
        seen: whether a view measures a sample.
        layers: (S,) values by name [mm], of the best view that measures the sample, NaN without one: `sigma`, the
            expected standard deviation, and `spacing`, the larger distance between neighbouring points, if the scanner
            models them.
    """

    samples: SurfaceSamples
    seen: Annotated[NDArray[np.bool_], "S n"]
    layers: dict[str, Floats]


def measure_samples(
    samples: SurfaceSamples,
    T_object_scanner: Floats,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    seen: Bools | None = None,
) -> MeasuredSamples:
    """Compute which views measure which samples, and the best values of each sample.

    Args:
        samples: of the part.
        T_object_scanner: (n, K, 4, 4) poses of the views [m].
        scanner: the sensor model.
        casters: the part's and the occluders'.
        seen: (S, n) whether a view measures a sample, if known already.
    """
    poses = np.asarray(T_object_scanner)
    if seen is None:
        seen = find_measured(poses, samples, scanner, casters, each=True)
    known = {name: law for name in ("spacing", "sigma") if callable(law := getattr(scanner, name, None))}
    best = best_values(list(known.values()), poses, samples, seen, scanner)
    layers = {name: 1000 * values for name, values in zip(known, best, strict=True)}
    return MeasuredSamples(samples, seen, layers)


def viewing_directions(canvas: Canvas, targets: NDArray[np.bool_], count: int) -> list[Floats]:
    """Return viewing directions, each of which shows most of the target samples that earlier ones do not show.

    Args:
        canvas: the surface.
        targets: (S,) samples that should be visible.
        count: number of directions; default directions around the part are added if fewer suffice.

    Returns:
        `count` unit vectors from the part to the eye.
    """
    rows = np.flatnonzero(targets)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _N_SAMPLES)).astype(np.int64)] if len(rows) else rows
    directions = np.array([direction(a, e) for e in (-62, -30, 0, 25, 60) for a in range(0, 360, 30)])
    visibility = np.zeros((len(directions), len(rows)))
    diagonal, normals = canvas.mesh.diagonal, canvas.samples.normals[rows]
    points = canvas.samples.points[rows] + _LIFT * diagonal * normals
    for i, toward in enumerate(directions):
        facing = normals @ toward
        ahead = np.flatnonzero(facing > 0.1)
        free = ~canvas.caster.blocked(points[ahead] + 2 * diagonal * toward, points[ahead])
        visibility[i, ahead[free]] = facing[ahead[free]]
    selection: list[Floats] = []
    left = np.ones(len(rows))
    while len(selection) < count and len(rows) and (visibility @ left).max() > _MIN_SHARE * len(rows):
        best = int(np.argmax(visibility @ left))
        selection.append(directions[best])
        left *= 1 - np.minimum(1.0, 2 * visibility[best])
    for angles in _DEFAULT_DEG:
        toward = direction(*angles)
        if len(selection) < count and all(toward @ other < 0.6 for other in selection):
            selection.append(toward)
    return (selection + [direction(*_DEFAULT_DEG[0])] * count)[:count]
