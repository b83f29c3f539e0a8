"""Limits of view planning: rays on tiny, huge and distant parts, grazing rays, coarse meshes, covers.

Truths: every line of sight against every triangle in float64; a plate that is visible everywhere; the measured share of
the plan of a fine planning mesh; the bound of the selection. Object frame, metres.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from benchmarks.methods.bumpy_body import body
from benchmarks.methods.stability_map import Map, MapPoint
from cell.errors import FileError
from cell.part import builtin, workpiece
from cell.part.workpiece import MAX_DISTANCE_SIZES, PLAUSIBLE_LENGTH_M
from cell.scanners.laser_area import LaserArea
from cell.scene import validation
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner import cover
from planner.cover import CoverStatus
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability import coverage
from planner.measurability.visibility import fill_matrix, find_measured
from planner.values import Floats
from planner.viewpoints.lines_of_sight import RayTargets, in_view
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone

_FACES, _VIEWS = 400, 40  # faces of the part that is evaluated in float64, and about as many views
_AWAY = np.array([0.8, -0.5, 0.33])  # direction of the offset
_ON_ITS_FACE = 1e-9  # share of a line of sight: a triangle this near to its end contains the end


@lru_cache(maxsize=1)
def _part() -> TriangleMesh:
    """Return the coarse body, 1 m long, its middle at the origin."""
    mesh = decimate(body(4).reference, _FACES)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return TriangleMesh((mesh.vertices - (low + high) / 2) / float((high - low).max()), mesh.faces)


def _question(size: float, count: int) -> tuple[LaserArea, SurfaceSamples, Viewpoints]:
    """Return scanner, samples and views for the part at a size [m]: all lengths in proportion."""
    part = _part()
    mesh = TriangleMesh(part.vertices * size, part.faces)
    scanner = LaserArea(range_mm=(200 * size, 3000 * size), baseline_mm=250 * size)
    features = draw_samples(mesh, mesh, count, np.random.default_rng(0))
    return scanner, features, optimal_scanning_zone(decimate(mesh, _VIEWS), [1.0 * size], [0.3])


def _by_brute_force(
    mesh: TriangleMesh, features: SurfaceSamples, views: Viewpoints, scanner: LaserArea
) -> NDArray[np.bool_]:
    """Return (S, V) visibility of samples in views.

    Every line of sight is tested against every triangle in float64 (Moeller and Trumbore 1997).
    """
    targets = RayTargets.of(features.points, features.normals)
    seen = np.zeros((len(features), len(views)), dtype=np.bool_)
    corner = mesh.vertices[mesh.faces[:, 0]]
    one, other = (mesh.vertices[mesh.faces[:, k]] - corner for k in (1, 2))
    for view, T in enumerate(views.T_object_scanner[:, 0]):
        rows = in_view(targets, T, scanner)
        free = np.ones(len(rows), dtype=np.bool_)
        for end in (scanner.source, scanner.sensor):
            origin = T[:3, :3] @ end + T[:3, 3]
            along = features.points[rows] - origin
            p = np.cross(along[:, None], other[None])
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = 1.0 / np.einsum("fj,nfj->nf", one, p)
                s = origin - corner
                u = scale * np.einsum("fj,nfj->nf", s, p)
                q = np.cross(s, one)
                v = scale * np.einsum("nj,fj->nf", along, q)
                t = scale * np.einsum("fj,fj->f", other, q)
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1 - _ON_ITS_FACE)
            hit[np.arange(len(rows)), features.face[rows]] = False
            free &= ~hit.any(axis=1)
        seen[rows[free], view] = True
    return seen


@lru_cache(maxsize=2)
def _truth(count: int) -> NDArray[np.bool_]:
    scanner, features, views = _question(1.0, count)
    return _by_brute_force(_part(), features, views, scanner)


def _agreeing(M: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Return the share of pairs on which both matrices agree, among the pairs that either has as measured."""
    return float((M & truth).sum() / (M | truth).sum())


def size(line: str, metres: float, count: int) -> MapPoint:
    """Test the fill for parts of any size: agreement with the matrix in float64."""
    part = _part()
    loaded = workpiece.from_mesh("part", part.vertices * metres, part.faces.astype(np.int64), "m", "")
    scanner, features, views = _question(metres, count)
    M = fill_matrix(views, features, scanner, EmbreeRayCaster(loaded.reference.vertices, loaded.reference.faces))
    agreeing = _agreeing(M.matrix().toarray(), _truth(count))
    says = " ".join(f.sentence for f in loaded.findings if f.kind is workpiece.Kind.UNITS)
    return MapPoint(agreeing, 100 * (1 - agreeing), says)


def offset(line: str, sizes: float, count: int) -> MapPoint:
    """Test the fill for a part far from the origin of its file, at the precision of the file."""
    part, shift = _part(), sizes * _AWAY / np.linalg.norm(_AWAY)
    moved = part.vertices + shift
    if line == _SINGLE:
        moved = moved.astype(np.float32).astype(np.float64)
    off = 100 * float(np.sqrt(((moved - shift - part.vertices) ** 2).sum(axis=1).mean()))
    try:
        loaded = workpiece.from_mesh("part", moved, part.faces.astype(np.int64), "m", "")
    except FileError as error:
        return MapPoint(0.0, off, str(error))
    says = " ".join(f.sentence for f in loaded.findings if f.kind is workpiece.Kind.FAR)
    mesh = loaded.reference
    if len(mesh.faces) != len(part.faces):  # degenerate faces were removed
        return MapPoint(0.0, off, says)
    scanner, features, views = _question(1.0, count)
    there = _carried(features, part, mesh)
    T = np.array(views.T_object_scanner)
    T[..., :3, 3] += shift
    views = Viewpoints(T, views.face, views.standoff, views.roll)
    M = fill_matrix(views, there, scanner, EmbreeRayCaster(mesh.vertices, mesh.faces))
    return MapPoint(_agreeing(M.matrix().toarray(), _truth(count)), off, says)


def _carried(features: SurfaceSamples, part: TriangleMesh, mesh: TriangleMesh) -> SurfaceSamples:
    """Return the samples at the same places of the same faces on a mesh with moved vertices."""
    a, b, c = (part.vertices[part.faces[features.face, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    v = np.einsum("nj,nj->n", np.cross(features.points - a, c - a), n) / (n * n).sum(axis=1)
    w = np.einsum("nj,nj->n", np.cross(b - a, features.points - a), n) / (n * n).sum(axis=1)
    weights = np.stack([1 - v - w, v, w], axis=1)
    points = np.einsum("nc,ncj->nj", weights, mesh.vertices[mesh.faces[features.face]])
    return SurfaceSamples(points, mesh.normals[features.face], features.areas, features.face, features.face)


_PLATE_M, _AT_M, _PART_M = 0.05, 0.3, 0.4  # a plate in front of the scanner; the diagonal of its part


def grazing(line: str, angle_deg: float, count: int) -> MapPoint:
    """Test a visible plate at a grazing angle: the predicted share, and the share that a scan finds."""
    tilt, half = np.radians(angle_deg), _PLATE_M / 2
    across, along = np.array([1.0, 0, 0]), np.array([0.0, np.cos(tilt), np.sin(tilt)])
    corners = [
        np.array([0, 0, _AT_M]) + half * (i * across + j * along) for i, j in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    plate = TriangleMesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))
    caster = EmbreeRayCaster(plate.vertices, plate.faces)
    step = float(line.removesuffix(" deg"))
    scanner = LaserArea(resolution_deg=(step, step), grazing_max_deg=90.0)
    samples = draw_samples(plate, plate, count, np.random.default_rng(0))
    predicted = find_measured(np.eye(4)[None, None], samples, scanner, [caster])
    points = virtual_scan.scan(scanner, np.eye(4), caster, plate).points
    found = np.zeros(count, dtype=np.bool_)
    if len(points):
        near, _ = cKDTree(points).query(samples.points)
        found = np.asarray(near <= 0.01 * _PART_M)
    return MapPoint(
        float(predicted.mean()), 100 * float((predicted & ~found).mean()), validation.grazing_note(angle_deg),
        {"scan points": len(points)},
    )  # fmt: skip


_FINE = 1000
_STANDOFF_M, _ROLLS = 0.3, (0.0, np.pi / 2)


@lru_cache(maxsize=1)
def _evaluated_part(line: str, samples: int) -> tuple[TriangleMesh, EmbreeRayCaster, SurfaceSamples]:
    """Return a part, its ray caster, and samples for the evaluation."""
    mesh = body(5).reference if line == _BUMPY else builtin.load(line)
    held_out = draw_samples(mesh, mesh, samples, np.random.default_rng(1))
    return mesh, EmbreeRayCaster(mesh.vertices, mesh.faces), held_out


@lru_cache(maxsize=2)
def _measured_by(line: str, faces: int, samples: int) -> tuple[float, int, int, float]:
    """Return measured share and views of a plan, faces of its planning mesh, and deviation of the part from that."""
    mesh, caster, held_out = _evaluated_part(line, samples)
    planning, scanner = decimate(mesh, faces), LaserArea()
    views = optimal_scanning_zone(planning, [_STANDOFF_M], _ROLLS)
    features = draw_samples(mesh, planning, 4 * len(planning.faces), np.random.default_rng(0))
    M = fill_matrix(views, features, scanner, caster)
    plan = cover.solve(
        cover.CoverProblem(M.matrix(), features.areas), rng=np.random.default_rng(0), solver="greedy", effort_budget=0
    )
    visible = coverage.visible_coverage(views.T_object_scanner[plan.views], held_out, scanner, (caster,)).fraction
    return visible, len(plan.views), len(planning.faces), validation.mesh_deviation(features, planning)


def decimation(line: str, faces: float, samples: int) -> MapPoint:
    """Test a plan from a coarse planning mesh: the share of the part that it measures."""
    fine, *_ = _measured_by(line, _FINE, samples)
    visible, views, came_out, off = _measured_by(line, round(faces), samples)
    return MapPoint(
        min(visible / fine, 1.0), 100 * off, validation.coarse_mesh_note(off, came_out),
        {"faces": came_out, "views": views, "visible %": 100 * visible},
    )  # fmt: skip


def selection(line: str, percent: float, count: int) -> MapPoint:
    """Test the selection over the density of the matrix: the gap between the plan and its bound."""
    rng = np.random.default_rng(0)
    if line == _CAPS:  # each view measures a cap of the sphere that has this share of its area
        rows, columns = (_on_sphere(rng, count) for _ in range(2))
        M = rows @ columns.T >= 1 - 2 * percent / 100
    else:
        M = rng.random((count, count)) < percent / 100
    found = cover.solve(cover.CoverProblem(csr_array(M), np.ones(count)), rng=np.random.default_rng(0))
    proven = found.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE)
    return MapPoint(
        1.0, 100 * found.gap, "" if proven else found.sentence,
        {"views": len(found.views), "bound": found.lower_bound, "work": found.effort, "proven": proven},
    )  # fmt: skip


def _on_sphere(rng: np.random.Generator, count: int) -> Floats:
    points = rng.normal(size=(count, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


_SINGLE, _DOUBLE, _CAPS, _BUMPY = "single precision (STL)", "double precision", "caps on a sphere", "bumpy body"

MAPS = {
    "size": Map(
        "The matrix over the part's size, everything in proportion", "longest side of the part [m]",
        "pairs as every triangle in float64 has them", "pairs that differ [%]", 1.0,
        tuple(10.0**k for k in range(-6, 3)), (1e-6, 0.1, 100.0), size, (1500, 200), borders=PLAUSIBLE_LENGTH_M,
    ),
    "offset": Map(
        "The matrix over the part's offset in its file", "distance from the file's origin [sizes of the part]",
        "pairs as at the origin, in float64", "vertices off by the file's precision, rms [% of the part]", 0.01,
        (1.0, 10.0, 100.0, 500.0, 2e3, 1e4, 1e5, 1e6, 1e7, 1e8), (1.0, 1e5), offset, (1500, 200),
        lines=(_SINGLE, _DOUBLE),
        borders=(None, MAX_DISTANCE_SIZES),
    ),
    "grazing": Map(
        "Prediction towards grazing rays, a plate at 300 mm, part of 400 mm", "grazing angle [deg]",
        "surface predicted as measured (all of it is in sight)",
        "predicted, and no point of the scan within 1 % of the part's diagonal [points]", 1.0,
        (0.0, 30.0, 45.0, 60.0, 70.0, 75.0, 77.0, 78.0, 79.0, 80.0, 82.0, 84.0, 86.0, 88.0, 89.0, 89.9),
        (45.0, 75.0, 89.0), grazing, (4000, 500), lines=("0.25 deg", "0.05 deg"), quick_lines=1,
        borders=(None, validation.STEEPEST_GRAZING_DEG), scale="linear",
    ),
    "decimation": Map(
        "A plan from fewer and fewer planning faces, judged on the part itself", "faces of the planning mesh",
        "measured, of what the plan of 1000 faces measures",
        "a twentieth of the part is farther off the mesh [% of the diagonal]", 100 * validation.COARSEST_MESH,
        (700.0, 500.0, 350.0, 250.0, 150.0, 100.0, 50.0, 12.0), (500.0, 50.0), decimation, (10_000, 1000),
        lines=(_BUMPY, "mseke", "robinet"), quick_lines=1, judged_by_error=True, enough=0.98,
        towards_small=True,
    ),
    "cover": Map(
        "Selection over the density of the matrix, 400 x 400", "density of the matrix [%]",
        "covers that meet the target", "gap between plan and bound [%]", 0.0,
        (0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0), (0.1, 5.0, 50.0), selection, (400, 60),
        lines=(_CAPS, "random"),
    ),
}  # fmt: skip
"""Of view planning."""
