"""Predicted uncertainty of the characteristics of a plan, and demands on the measured share of each feature.

Each patch has samples on its nominal surface. A view that measures a sample yields points in its surroundings: rays
per solid angle times the solid angle of the area, each with the noise of the scanner's model, and with the error of the
view's pose in common. The fit of all these points has the same linear answer as that of measured ones, so that the
predicted uncertainty is that of a scan without systematic errors. Object frame, metres.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cell.inspect.evaluation import Evaluation, Measurement
from cell.inspect.features import Characteristic, Feature, InspectionPlan, Patch, PatchSurface
from cell.inspect.measured import (
    MAX_POINTS,
    Association,
    MeasuredFeature,
    MeasuredPatch,
    MeasuredPoints,
    cells_of_points,
    measure_patch,
)
from planner.fitting.shapes import Shape, ShapeKind
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Bools, Floats

SHARE = 0.5
"""Smallest share of a patch that has points."""

ARC_DEG = 180.0
"""Smallest arc of a cylinder or cone that has points."""

MAIN = 0.5
"""Share of a variance from which other features, or pose errors, are named as the main source."""

_NODES = 1200  # of a patch, four in a cell
_DRAWN = 20_000  # samples of a patch, which are combined in its nodes
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


@dataclass(frozen=True, slots=True, eq=False)
class PlannedViews:
    """Views of a set-up.

    Attributes:
        T_object_poses: (n, K, 4, 4) poses of the views [m].
        scanner: with a model of the standard deviation of its points.
        casters: of the part and of occluders.
    """

    T_object_poses: Floats
    scanner: Scanner
    casters: Sequence[RayCaster]

    @property
    def T_object_scanner(self) -> Floats:
        """(n, 4, 4) pose of each view, of a sweep in its middle."""
        return self.T_object_poses[:, self.T_object_poses.shape[1] // 2]


def predict_features(association: Association, setups: Sequence[PlannedViews]) -> dict[str, MeasuredFeature]:
    """Return the features with the cells that the views of one or several set-ups yield."""
    densities, features, rng = [PointDensity(each.scanner) for each in setups], {}, np.random.default_rng(_SEED)
    for feature in association.plan.features:
        patches = [
            _predict_patch(association, feature, patch, surface, setups, densities, rng)
            for patch, surface in zip(feature.patches, association.surfaces[feature.name], strict=True)
        ]
        features[feature.name] = MeasuredFeature(feature, tuple(patches))
    return features


def _predict_patch(
    association: Association, feature: Feature, patch: Patch, surface: PatchSurface, setups: Sequence[PlannedViews],
    densities: Sequence[PointDensity], rng: np.random.Generator,
) -> MeasuredPatch:  # fmt: skip
    own = TriangleMesh(association.reference.vertices, association.reference.faces[surface.triangles])
    samples = draw_samples(own, own, _DRAWN, rng)
    area = float(samples.areas[0])
    samples = samples.pick(association.off_edge(surface, samples.points))
    size = float(np.sqrt(area * len(samples) / _NODES))
    frame = patch.shape or Shape(ShapeKind.PLANE, np.array(patch.point_mm) / 1000, np.array(patch.axis))
    cell, rows, _ = cells_of_points(samples.points, frame, size)
    nodes = replace(samples.pick(rows), areas=(area * np.bincount(cell)).astype(np.float64))
    yields = [_yield(nodes, each, density) for each, density in zip(setups, densities, strict=True)]
    count, variance = (np.hstack(each) for each in zip(*yields, strict=True))
    weight = nodes.areas[:, None] * count
    seen = np.asarray((count > 0).any(axis=1))
    if not seen.any():
        corners = association.corners(patch, surface)
        return MeasuredPatch(patch, None, None, corners, doubts=("no view of the plan measures it",))
    weight *= min(1.0, MAX_POINTS / weight.sum())
    row, view = np.nonzero(count)
    origins = np.concatenate([each.T_object_scanner[:, :3, 3] for each in setups])
    points = nodes.points
    if patch.shape is not None:
        points = points - patch.shape.distances(points)[:, None] * patch.shape.normals(points)
    measured = MeasuredPoints(
        points[row], np.sqrt(variance[row, view]), view, origins, np.zeros((len(origins), 2)), weight[row, view]
    )
    prediction = measure_patch(association, feature, patch, surface, np.arange(len(row)), measured)
    share = float(nodes.areas[seen].sum() / nodes.areas.sum())
    missed = tuple(_missed_demands(patch.shape, nodes.points, seen, share))
    mean_views = float((count[seen] > 0).sum(axis=1).mean())
    return replace(prediction, n_points=int(weight.sum()), share=share, missed=missed, mean_views=mean_views)


def _yield(samples: SurfaceSamples, views: PlannedViews, density: PointDensity) -> tuple[Floats, Floats]:
    """Return points per area (S, n) of each view at each sample, and their variance along the normal [m^2]."""
    scanner = views.scanner
    seen = find_measured(views.T_object_poses, samples, scanner, views.casters, each=True)
    count, variance = np.zeros(seen.shape), np.zeros(seen.shape)
    law = getattr(scanner, "sigma", None)
    for view, T in enumerate(views.T_object_scanner):
        rows = np.flatnonzero(seen[:, view])
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
    measurements = []
    for characteristic in plan.characteristics:
        measurement = evaluation.measure(characteristic)
        causes = [*filter(None, [measurement.cause, measurement.note])]
        for feature in plan.features_of(characteristic):
            causes += [f"{feature.name}: {each}" for patch in features[feature.name].patches for each in patch.missed]
        tolerance, uncertainty = characteristic.tolerance, measurement.expanded_uncertainty
        if plan.u_over_t is not None and tolerance and uncertainty and uncertainty > plan.u_over_t * tolerance:
            limit = plan.u_over_t * tolerance
            text = f"U is {uncertainty:.4f} {characteristic.unit}, more than {plan.u_over_t:g} T = {limit:.4f}"
            source = main_source(plan, characteristic, measurement.contributions)
            if measurement.pose_share > MAIN:
                source = f"{measurement.pose_share:.0%} of the variance is from pose errors"
            causes.append("; ".join(filter(None, [text, source])))
        measurements.append(replace(measurement, cause="; ".join(dict.fromkeys(causes))))
    return measurements


def main_source(plan: InspectionPlan, characteristic: Characteristic, contributions: Mapping[str, float]) -> str:
    """Return a clause about the datums, or another feature, if most of the variance from points is theirs; else "".

    Args:
        plan: features.
        characteristic: of the value.
        contributions: share of each feature in the variance from points.
    """
    datums = {
        each.name: letter
        for letter in "-".join(characteristic.datums).split("-") if letter
        for each in [plan.datum(letter)] if each.name != characteristic.feature
    }  # fmt: skip
    share = sum(contributions.get(name, 0.0) for name in datums)
    if share > MAIN:
        name = max(datums, key=lambda each: contributions.get(each, 0.0))
        frame = "|".join(characteristic.datums)
        return f"{share:.0%} of the variance from points is from the datums {frame}, mostly {datums[name]} ({name})"
    share = contributions.get(characteristic.to or "", 0.0)
    return f"{share:.0%} of the variance from points is from {characteristic.to}" if share > MAIN else ""


def _missed_demands(shape: Shape | None, points: Floats, seen: Bools, share: float) -> Iterator[str]:
    """Yield a sentence about each demand on the measured share that is not met.

    Args:
        shape: nominal.
        points: (N, 3) of the whole patch [m].
        seen: (N,) whether a view measures each of them.
        share: of the area.
    """
    if share < SHARE:
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
