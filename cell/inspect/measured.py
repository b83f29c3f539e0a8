"""Measured features: points associated with the patches of a part, fitted shapes, and cells with their errors.

A point belongs to the patch that contains its closest point on the reference, if it is near and not at an edge. Points
are combined in cells. The mean of a cell averages noise, so that form is not the range of the noise of single points,
and carries the errors of its views: uncertainty follows from cells alone. The points of a plan are cells that have no
measured points yet. Object frame, metres.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from cell.inspect.features import Feature, InspectionPlan, Patch, PatchSurface, patch_surface
from planner.fitting.least_squares import MIN_POINTS, Fit, fit
from planner.fitting.shapes import N_COMPONENTS, Shape, ShapeKind
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats, Ints, Value

CELLS = 300
"""About the number of cells of a patch: enough for the form of a surface, few enough that noise averages."""

MAX_POINTS = 100_000
"""Points of a patch; more are thinned evenly."""

_CELL_POINTS = 16  # points of a cell where a patch has few
_OUTLIER = 6.0  # robust standard deviations beyond which a point is no part of the surface
_EDGE_SHARE = 6.0  # the edge band is at most this part of a patch's width
SPARSE = 0.6
"""Share of the median number of points below which a cell is not used for form."""
_EXACT = 1e-6  # m; points nearer than this to a shape are on it


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoints(Value):
    """Points with their errors.

    Attributes:
        points: (N, 3) [m].
        sigma: (N,) expected standard deviation along the surface normal [m]; 0 if it is not known.
        view: (N,) index of the view of each point.
        origins: (V, 3) scanner of each view, about which its pose is uncertain [m].
        pose_sd: (V, 2) standard deviation of its position along each axis [m] and rotation about each axis [rad].
        weight: (N,) number of points that each stands for; None: one.
        setup: (N,) row of `origins` and `pose_sd` with the registration of its set-up; None: one set-up.
    """

    points: Annotated[Floats, "N 3"]
    sigma: Annotated[Floats, "N"]
    view: Annotated[Ints, "N"]
    origins: Annotated[Floats, "V 3"]
    pose_sd: Annotated[Floats, "V 2"]
    weight: Annotated[Floats, "N"] | None = None
    setup: Annotated[Ints, "N"] | None = None

    @property
    def causes(self) -> list[Ints]:
        """Rows (N,) of `origins` and `pose_sd` with the poses that move each point: of its view, of its set-up."""
        return [self.view] if self.setup is None else [self.view, self.setup]


@dataclass(frozen=True, slots=True, eq=False)
class Cells(Value):
    """Cells of a patch.

    Attributes:
        points: (C, 3) means on the measured surface [m].
        normals: (C, 3) of the surface.
        noise: (C,) standard deviation of the mean from independent errors of the points [m].
        lever: (C, V, 6) displacement along the normal per translation and rotation of each view.
        gain: (7, C) change of the fitted shape per displacement of a cell along its normal.
        is_dense: (C,) whether a cell has enough points for form.
        shape_noise: (7, K) change of the fitted shape by independent errors of unit variance of the points.
        unit_noise: (7, K) the same for errors of 1 m of each point.
        shape_lever: (7, V, 6) change of the fitted shape per translation and rotation of each view.
    """

    points: Annotated[Floats, "C 3"]
    normals: Annotated[Floats, "C 3"]
    noise: Annotated[Floats, "C"]
    lever: Annotated[Floats, "C V 6"]
    gain: Annotated[Floats, "7 C"]
    is_dense: Annotated[Bools, "C"]
    shape_noise: Annotated[Floats, "7 K"]
    unit_noise: Annotated[Floats, "7 K"]
    shape_lever: Annotated[Floats, "7 V 6"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPatch:
    """A patch with its points.

    Attributes:
        patch: nominal.
        shape: fitted; the nominal one of a mesh without parameters, None if nothing is measured.
        cells: None if nothing is measured.
        corners: (K, 3) ends of its axis, or corners of its bounding rectangle [m].
        n_points: used points.
        n_outliers: points that are not used because they are off the shape.
        share: of the area that has points.
        sigma: standard deviation of the points about the shape [m].
        doubts: reasons why the shape is not determined.
        missed: demands on a plan that are not met.
        mean_views: of the measured surface.
        area: of the patch [m^2].
    """

    patch: Patch
    shape: Shape | None
    cells: Cells | None
    corners: Floats
    n_points: int = 0
    n_outliers: int = 0
    share: float = 0.0
    sigma: float = 0.0
    doubts: tuple[str, ...] = ()
    missed: tuple[str, ...] = ()
    mean_views: float = 0.0
    area: float = 0.0

    @property
    def spacing(self) -> float | None:
        """Mean distance of neighbouring points [m]; None without points."""
        return float(np.sqrt(self.area * self.share / self.n_points)) if self.n_points else None

    @property
    def deviations(self) -> Floats:
        """(C,) distances of its cells from the fitted element; of a mesh from its mean plane [m]."""
        assert self.cells is not None, "a patch without points has no deviations"
        assert self.shape is not None, "a patch with cells has a shape"
        return off_surface(self.shape, self.cells.points)

    @property
    def is_measured(self) -> bool:
        """Whether its points determine it and meet the demands of a plan."""
        return not self.doubts and not self.missed


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFeature:
    """A feature with its measured patches."""

    feature: Feature
    patches: tuple[MeasuredPatch, ...]

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why it has no value."""
        return tuple(doubt for each in self.patches for doubt in each.doubts)


def off_surface(shape: Shape, points: Floats) -> Floats:
    """Return the signed distance (N,) of points (N, 3) from a shape, of a circle from the cylinder around it [m]."""
    if shape.kind is ShapeKind.CIRCLE:
        shape = Shape(ShapeKind.CYLINDER, shape.point, shape.axis, shape.size)
    return shape.distances(points)


class Association:
    """Association of points with the features of a plan.

    Args:
        reference: the part.
        plan: features of the part.
    """

    def __init__(self, reference: TriangleMesh, plan: InspectionPlan) -> None:
        self.reference, self.plan = reference, plan
        self.nearest = ClosestPointQuery(reference)
        self.surfaces: dict[str, list[PatchSurface]] = {
            feature.name: [patch_surface(reference, patch.triangles) for patch in feature.patches]
            for feature in plan.features
        }

    def rows(self, points: Floats) -> dict[str, list[Ints]]:
        """Return the rows of points (N, 3) that lie on each patch of each feature, away from its edges."""
        closest = self.nearest.closest(points)
        near = closest.distance <= self.plan.reach_mm / 1000
        rows_of_feature: dict[str, list[Ints]] = {}
        for name, surfaces in self.surfaces.items():
            rows_of_feature[name] = []
            for surface in surfaces:
                own = np.flatnonzero(near & np.isin(closest.face, surface.triangles))
                rows_of_feature[name].append(own[self.off_edge(surface, closest.point[own])])
        return rows_of_feature

    def off_edge(self, surface: PatchSurface, points: Floats) -> Bools:
        """Return whether points (N, 3) of a patch are away from its edges."""
        band = min(self.plan.edge_mm / 1000, surface.width / _EDGE_SHARE)
        if not len(points) or not len(surface.outline) or band == 0:
            return np.ones(len(points), dtype=np.bool_)
        return np.asarray(cKDTree(surface.outline).query(points)[0]) >= band

    def without_facets(self, points: Floats) -> Floats:
        """Return points (N, 3) on the triangles of the reference moved to the surfaces that these approximate."""
        closest, smooth_points = self.nearest.closest(points), points.copy()
        for feature in self.plan.features:
            for patch, surface in zip(feature.patches, self.surfaces[feature.name], strict=True):
                shape = patch.shape
                if shape is not None and shape.kind is not ShapeKind.PLANE:
                    own = np.flatnonzero(np.isin(closest.face, surface.triangles))
                    foot = closest.point[own]
                    smooth_points[own] = points[own] - shape.distances(foot)[:, None] * shape.normals(foot)
        return smooth_points

    def corners(self, patch: Patch, surface: PatchSurface) -> Floats:
        """Return the ends (2, 3) of the axis of a patch, or the corners (4, 3) of a plane's bounding rectangle [m]."""
        shape = patch.shape
        vertices = self.reference.vertices[np.unique(self.reference.faces[surface.triangles])]
        if shape is None or shape.kind is ShapeKind.SPHERE:
            return vertices.mean(axis=0)[None] if shape is None else shape.point[None]
        local = (vertices - shape.point) @ shape.frame
        low, high = local.min(axis=0), local.max(axis=0)
        if shape.kind is ShapeKind.PLANE:
            corners = [(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])]
        else:
            corners = [(0.0, 0.0, low[2]), (0.0, 0.0, high[2])]
        return np.asarray(shape.point + np.array(corners) @ shape.frame.T)


def measure_features(association: Association, measured: MeasuredPoints) -> dict[str, MeasuredFeature]:
    """Return all features with their fitted shapes, by name."""
    rows = association.rows(measured.points)
    return {
        feature.name: MeasuredFeature(
            feature,
            tuple(
                measure_patch(association, feature, patch, surface, own, measured)
                for patch, surface, own in zip(
                    feature.patches, association.surfaces[feature.name], rows[feature.name], strict=True
                )
            ),
        )
        for feature in association.plan.features
    }


def measure_patch(
    association: Association,
    feature: Feature,
    patch: Patch,
    surface: PatchSurface,
    rows: Ints,
    measured: MeasuredPoints,
) -> MeasuredPatch:
    """Fit the shape of a patch to some rows of points, and combine them in cells."""
    shape, corners = patch.shape, association.corners(patch, surface)
    if len(rows) > MAX_POINTS:
        rows = rows[np.linspace(0, len(rows) - 1, MAX_POINTS).astype(np.int64)]
    needed = 1 if shape is None else MIN_POINTS[shape.kind]
    if len(rows) < needed:
        word = "no point lies" if not len(rows) else f"only {len(rows)} points lie"
        return MeasuredPatch(patch, None, None, corners, doubts=(f"{word} on it",))
    area = float(association.reference.areas[surface.triangles].sum())
    count = len(rows)
    if shape is None:
        closest = association.nearest.closest(measured.points[rows])
        normals = association.nearest.normals(closest)
        off = np.einsum("nj,nj->n", measured.points[rows] - closest.point, normals)
        keep = _inliers(off)
        gain = np.zeros((N_COMPONENTS, int(keep.sum())))
        rows, off, normals = rows[keep], off[keep], normals[keep]
        nominal = Shape(ShapeKind.PLANE, np.array(patch.point_mm) / 1000, np.array(patch.axis))
        cells, sigma = _cells(measured, rows, nominal, normals, off, gain, area), float(np.std(off))
        share = _share(association, surface, measured.points[rows])
        return MeasuredPatch(patch, nominal, cells, corners, len(rows), count - len(rows), share, sigma, area=area)
    weight = measured.weight
    patch_fit = fit_patch(feature, shape, measured.points[rows], None if weight is None else weight[rows])
    keep = _inliers(patch_fit.residuals)
    if not keep.all() and keep.sum() >= needed:
        rows = rows[keep]
        patch_fit = fit_patch(feature, shape, measured.points[rows], None if weight is None else weight[rows])
    is_circle = feature.kind == "circle"
    normals = _radial(patch_fit, measured, rows) if is_circle else patch_fit.shape.normals(measured.points[rows])
    gain = np.einsum("knj,nj->kn", patch_fit.gain, normals)
    cells = _cells(measured, rows, patch_fit.shape, normals, patch_fit.residuals, gain, area, patch_fit.sigma)
    share = _share(association, surface, measured.points[rows])
    return MeasuredPatch(
        patch, patch_fit.shape, cells, corners, len(rows), count - len(rows), share, patch_fit.sigma,
        patch_fit.doubts, area=area,
    )  # fmt: skip


def fit_patch(feature: Feature, nominal: Shape, points: Floats, weights: Floats | None = None) -> Fit:
    """Fit the shape of a patch; its axis points as the nominal one. A circle is a cylinder with the nominal axis."""
    if feature.kind != "circle":
        patch_fit = fit(nominal.kind, points, nominal, weights)
        turned = nominal.kind is ShapeKind.CYLINDER and float(patch_fit.shape.axis @ nominal.axis) < 0
        return replace_axis(patch_fit) if turned else patch_fit
    along = (points - nominal.point) @ nominal.axis
    flat = points - along[:, None] * nominal.axis
    patch_fit = fit(ShapeKind.CIRCLE, flat, Shape(ShapeKind.CIRCLE, nominal.point, nominal.axis, nominal.size), weights)
    residuals = np.linalg.norm(flat - patch_fit.shape.point, axis=1) - patch_fit.shape.size
    across = np.eye(3) - np.outer(nominal.axis, nominal.axis)
    shape = Shape(ShapeKind.CIRCLE, patch_fit.shape.point, nominal.axis, patch_fit.shape.size)
    # The frame of a circle depends on its axis alone, which the projection makes the nominal one.
    turn = shape.frame.T @ patch_fit.frame
    gain = patch_fit.gain @ across
    gain[:2] = np.einsum("ij,jnk->ink", turn[:2, :2], gain[:2])
    gain[2:5] = 0.0
    return Fit(shape, shape.frame, residuals, gain, patch_fit.condition, patch_fit.doubts)


def replace_axis(patch_fit: Fit) -> Fit:
    """Return the same fit of a cylinder with its axis reversed."""
    shape = Shape(patch_fit.shape.kind, patch_fit.shape.point, -patch_fit.shape.axis, patch_fit.shape.size)
    turn = shape.frame.T @ patch_fit.frame
    gain = patch_fit.gain.copy()
    gain[:3] = np.einsum("ij,jnk->ink", turn, patch_fit.gain[:3])
    gain[3:5] = -np.einsum("ij,jnk->ink", turn[:2, :2], patch_fit.gain[3:5])
    return replace(patch_fit, shape=shape, frame=shape.frame, gain=gain)


def _radial(patch_fit: Fit, measured: MeasuredPoints, rows: Ints) -> Floats:
    off = measured.points[rows] - patch_fit.shape.point
    off = off - (off @ patch_fit.shape.axis)[:, None] * patch_fit.shape.axis
    return np.asarray(off / np.maximum(np.linalg.norm(off, axis=1), np.finfo(float).tiny)[:, None])


def _inliers(residuals: Floats) -> Bools:
    middle = float(np.median(residuals))
    scale = max(1.4826 * float(np.median(np.abs(residuals - middle))), _EXACT)
    return np.asarray(np.abs(residuals - middle) <= _OUTLIER * scale)


def _share(association: Association, surface: PatchSurface, points: Floats) -> float:
    """Return the share of the area of a patch whose triangles have a point near.

    A point is near a triangle's centre within a quarter of the patch's width, or the root of the triangle's area.
    """
    mesh = association.reference
    centres, areas = mesh.centres[surface.triangles], mesh.areas[surface.triangles]
    reach = np.maximum(surface.width / 4, np.sqrt(areas))
    distance = np.asarray(cKDTree(points).query(centres)[0])
    return float(areas[distance <= reach].sum() / areas.sum())


def cells_of_points(points: Floats, shape: Shape, size: float) -> tuple[Ints, Ints, Floats]:
    """Combine points (N, 3) in the cells of a grid in the frame of a shape, in which a plane lies in one layer.

    Returns:
        (N,) cell of each point, (C,) the point nearest to the middle of each cell, and (C, 3) these middles. On a
        curved surface a middle lies off the surface.
    """
    local = (points - shape.point) @ shape.frame
    _, cell = np.unique(np.floor(local / size + 0.5).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    middle = np.stack([np.bincount(cell, weights=column) for column in points.T], axis=1) / count[:, None]
    order = np.lexsort((np.linalg.norm(points - middle[cell], axis=1), cell))
    return cell, order[np.concatenate([[0], np.cumsum(count)[:-1]])], middle


def _cells(
    measured: MeasuredPoints, rows: Ints, shape: Shape, normals: Floats, residuals: Floats, gain: Floats, area: float,
    scatter: float = 0.0,
) -> Cells:  # fmt: skip
    """Combine the points of a patch in cells."""
    points = measured.points[rows]
    weight = np.ones(len(rows)) if measured.weight is None else measured.weight[rows]
    feet = points - residuals[:, None] * normals
    size = float(np.sqrt(area / min(CELLS, max(weight.sum() / _CELL_POINTS, 12))))
    cell, first, _ = cells_of_points(feet, shape, size)
    count, n_views = np.bincount(cell, weights=weight), len(measured.origins)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(cell, weights=weight * values) / count)

    variance, of_poses = measured.sigma[rows] ** 2, np.zeros(len(rows))
    lever, shape_lever = np.zeros((len(count), n_views, 6)), np.zeros((N_COMPONENTS, n_views, 6))
    for pose in (each[rows] for each in measured.causes):
        columns = np.hstack([normals, np.cross(points - measured.origins[pose], normals)])
        of_poses += (columns**2 * np.repeat(measured.pose_sd[pose] ** 2, 3, axis=1)).sum(axis=1)
        np.add.at(lever, (cell, pose), weight[:, None] * columns)
        for own, row in zip(shape_lever, gain, strict=True):
            np.add.at(own, pose, row[:, None] * columns)
    # Scatter beyond the models of scanner and poses, or in their absence, is noise of the points.
    known = float(np.average(variance, weights=weight))
    left = max(scatter**2 - float(np.average(of_poses, weights=weight)), 0.0)
    variance = variance * max(1.0, left / known) if known > 0 else np.full(len(rows), left)
    return Cells(
        feet[first] + mean(residuals)[:, None] * normals[first],
        normals[first],
        np.sqrt(mean(variance) / count),
        lever / count[:, None, None],
        np.stack([np.bincount(cell, weights=row) for row in gain]),
        count >= SPARSE * np.median(count),
        np.asarray(np.linalg.qr((gain * np.sqrt(variance / weight)).T, mode="r")).T,
        np.asarray(np.linalg.qr((gain / np.sqrt(weight)).T, mode="r")).T,
        shape_lever,
    )
