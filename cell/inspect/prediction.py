"""Predicted uncertainty of the characteristics of a plan, and demands on the measured share of each feature.

Each patch has samples on its nominal surface. A view that measures a sample yields points in its surroundings: rays
per solid angle times the solid angle of the area, each with the noise of the scanner's model, and with the error of the
view's pose in common. The fit of all these points has the same linear answer as that of measured ones, so that the
predicted uncertainty is that of a scan without systematic errors. Object frame, metres.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cell.inspect.evaluation import Evaluation, Measurement, Verdict
from cell.inspect.features import Feature, InspectionPlan, Patch, PatchSurface
from cell.inspect.measured import (
    SPARSE,
    Association,
    Cells,
    MeasuredFeature,
    MeasuredPatch,
    cells_of_points,
    fit_patch,
)
from planner.fitting.shapes import N_COMPONENTS, Shape, ShapeKind
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Bools, Floats

SHARE = 0.5
"""Smallest share of a patch that has points."""

ARC_DEG = 180.0
"""Smallest arc of a cylinder or cone that has points."""

_SAMPLES = 600  # of a patch
_SECTORS = 36  # of an arc
_SEED = 20261126  # of the samples; a plan needs no other


class PointDensity:
    """Points per area that a scanner yields, from the solid angle of each ray of its grid.

    Args:
        scanner: sensor model.
    """

    def __init__(self, scanner: Scanner) -> None:
        self._source, rays = scanner.source, scanner.ray_directions()
        grid = rays.reshape(*scanner.grid_shape, 3)
        self._tree, self._solid = None, np.empty(0)
        if min(scanner.grid_shape) > 1:
            step = np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1))
            self._solid = np.linalg.norm(step, axis=2).ravel()
            self._tree = cKDTree(rays)
        self._spacing = getattr(scanner, "spacing", None)

    def __call__(self, points: Floats, normals: Floats) -> Floats:
        """Return the points per area (N,) [1/m^2] at points and normals (N, 3), scanner frame."""
        if self._tree is None:  # a line, whose step between lines is that of its spacing
            assert callable(self._spacing), "a line sensor knows its spacing"
            return np.asarray(1 / self._spacing(points, normals) ** 2)
        rays = points - self._source
        distance = np.linalg.norm(rays, axis=1)
        rays /= distance[:, None]
        cosine = np.maximum(-np.einsum("nj,nj->n", rays, normals), 0.0)
        return np.asarray(cosine / (distance**2 * self._solid[self._tree.query(rays)[1]]))


def predict_features(
    association: Association,
    T_object_poses: Floats,
    scanner: Scanner,
    casters: Sequence[RayCaster],
) -> dict[str, MeasuredFeature]:
    """Return the features with the cells that views yield.

    Args:
        association: features on the reference.
        T_object_poses: (n, K, 4, 4) poses of the views [m].
        scanner: with a model of the standard deviation of its points.
        casters: of the part and of occluders.
    """
    density, found, rng = PointDensity(scanner), {}, np.random.default_rng(_SEED)
    for feature in association.plan.features:
        patches = [
            _predict_patch(association, feature, patch, surface, T_object_poses, scanner, casters, density, rng)
            for patch, surface in zip(feature.patches, association.surfaces[feature.name], strict=True)
        ]
        found[feature.name] = MeasuredFeature(feature, tuple(patches))
    return found


def _predict_patch(
    association: Association, feature: Feature, patch: Patch, surface: PatchSurface, T_object_poses: Floats,
    scanner: Scanner, casters: Sequence[RayCaster], density: PointDensity, rng: np.random.Generator,
) -> MeasuredPatch:  # fmt: skip
    mesh, corners = association.reference, association.corners(patch, surface)
    own = TriangleMesh(mesh.vertices, mesh.faces[surface.triangles])
    samples = draw_samples(own, own, _SAMPLES, rng)
    keep = association.off_edge(surface, samples.points)
    points, normals = samples.points[keep], samples.normals[keep]
    area = float(samples.areas[0])
    some = SurfaceSamples(points, normals, samples.areas[keep], samples.face[keep], samples.planning_face[keep])
    count, variance = _yield(some, T_object_poses, scanner, casters, density)
    total = count.sum(axis=1)
    seen = total > 0
    share = float(seen.mean())
    missed = tuple(_missed_demands(patch.shape, points, seen)) if seen.any() else ()
    nothing = MeasuredPatch(patch, None, None, corners, doubts=("no view of the plan measures it",))
    if not seen.any():
        return nothing
    shape = patch.shape
    n_points = int(area * total.sum())
    rows = np.flatnonzero(seen)
    if (wanted := cells_of_points(n_points)) < len(rows):  # each sample stands for a cell of a scan
        area *= len(rows) / wanted
        rows = rows[np.linspace(0, len(rows) - 1, wanted).astype(np.int64)]
    points, normals, count, variance, total = points[rows], normals[rows], count[rows], variance[rows], total[rows]
    weights = area * total
    if shape is not None:
        points = points - shape.distances(points)[:, None] * shape.normals(points)
    origins = T_object_poses[:, T_object_poses.shape[1] // 2, :3, 3]
    gain, doubts, fitted = np.zeros((N_COMPONENTS, len(points))), tuple[str, ...](), shape
    if shape is not None:
        if len(points) < N_COMPONENTS:
            return replace(nothing, doubts=("the plan measures too little of it",))
        found = fit_patch(feature, shape, points, weights)
        fitted, doubts = found.shape, found.doubts
        turned = fitted.normals(points) if feature.kind != "circle" else _across(normals, shape)
        gain, normals = np.einsum("knj,nj->kn", found.gain, turned), turned
    else:
        fitted = Shape(ShapeKind.PLANE, np.array(patch.point_mm) / 1000, np.array(patch.axis))
    lever = np.einsum("nv,nvk->nvk", count / total[:, None], _levers(points, normals, origins))
    noise = np.sqrt((count * variance).sum(axis=1) / area) / total
    cells = Cells(points, normals, noise, lever, gain, total >= SPARSE * np.median(total))
    sigma = float(np.sqrt((count * variance).sum() / count.sum()))
    return MeasuredPatch(patch, fitted, cells, corners, n_points, 0, share, sigma, doubts, missed)


def _across(normals: Floats, shape: Shape) -> Floats:
    flat = normals - (normals @ shape.axis)[:, None] * shape.axis
    return np.asarray(flat / np.linalg.norm(flat, axis=1, keepdims=True))


def _levers(points: Floats, normals: Floats, origins: Floats) -> Floats:
    """Return the displacement (N, V, 6) along the normals per translation and rotation about each origin (V, 3)."""
    off = points[:, None, :] - origins[None]
    repeated = np.broadcast_to(normals[:, None, :], off.shape)
    return np.concatenate([repeated, np.cross(off, repeated)], axis=2)


def _yield(
    samples: SurfaceSamples, T_object_poses: Floats, scanner: Scanner, casters: Sequence[RayCaster],
    density: PointDensity,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return points per area (S, n) of each view at each sample, and their variance along the normal [m^2]."""
    seen = find_measured(T_object_poses, samples, scanner, casters, each=True)
    count, variance = np.zeros(seen.shape), np.zeros(seen.shape)
    law = getattr(scanner, "sigma", None)
    for view in range(seen.shape[1]):
        rows = np.flatnonzero(seen[:, view])
        T = T_object_poses[view, T_object_poses.shape[1] // 2]
        points = (samples.points[rows] - T[:3, 3]) @ T[:3, :3]
        normals = samples.normals[rows] @ T[:3, :3]
        count[rows, view] = density(points, normals)
        if callable(law):
            rays = points - scanner.source
            cosine = np.abs(np.einsum("nj,nj->n", rays, normals)) / np.linalg.norm(rays, axis=1)
            variance[rows, view] = (law(points, normals) * cosine) ** 2
    count[~np.isfinite(count) | ~np.isfinite(variance)] = 0.0
    return count, np.where(count > 0, variance, 0.0)


def predicted_measurements(
    plan: InspectionPlan, association: Association, features: Mapping[str, MeasuredFeature], pose_sd: Floats
) -> list[Measurement]:
    """Return the measurements with predicted uncertainties; a demand that is not met is the cause of a missing one."""
    evaluation = Evaluation(plan, features, association.nearest, pose_sd)
    found = []
    for characteristic in plan.characteristics:
        measurement = evaluation.measure(characteristic)
        causes = [measurement.cause] if measurement.cause else []
        for feature in plan.features_of(characteristic):
            causes += [f"{feature.name}: {each}" for patch in features[feature.name].patches for each in patch.missed]
        tolerance, uncertainty = characteristic.tolerance, measurement.expanded_uncertainty
        if plan.u_over_t is not None and tolerance and uncertainty and uncertainty > plan.u_over_t * tolerance:
            limit = plan.u_over_t * tolerance
            causes.append(f"U is {uncertainty:.4f} {characteristic.unit}, more than {plan.u_over_t:g} T = {limit:.4f}")
        verdict = Verdict.NOT_MEASURED if uncertainty is None else measurement.verdict
        found.append(replace(measurement, verdict=verdict, cause="; ".join(dict.fromkeys(causes))))
    return found


def _missed_demands(shape: Shape | None, points: Floats, seen: Bools) -> Iterator[str]:
    """Yield a sentence about each demand on the measured share that is not met.

    Args:
        shape: nominal.
        points: (N, 3) of the whole patch [m].
        seen: (N,) whether a view measures each of them.
    """
    if (share := float(seen.mean())) < SHARE:
        yield f"{share:.0%} of it is measured, less than {SHARE:.0%}"
    if shape is None or shape.kind not in (ShapeKind.CYLINDER, ShapeKind.CONE):
        return
    local = (points - shape.point) @ shape.frame
    sector = np.floor(np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi / _SECTORS))
    whole, arc = (360.0 / _SECTORS * len(np.unique(each)) for each in (sector, sector[seen]))
    if arc < min(ARC_DEG, 0.8 * whole):
        yield f"an arc of {arc:.0f} deg of it is measured, less than {min(ARC_DEG, 0.8 * whole):.0f} deg"
    thirds = np.quantile([local[:, 2].min(), local[:, 2].max()], [1 / 3, 2 / 3])
    if local[seen, 2].min() > thirds[0] or local[seen, 2].max() < thirds[1]:
        yield "only one end of it is measured"
