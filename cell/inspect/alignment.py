"""Datum reference frames and reference point systems: motions from measured to nominal features.

A datum constrains what the datums before it leave free: the first plane of three takes one translation and two
rotations, the second one of each, the third the last translation (3-2-1). Every combination of planes, axes and points
follows from this rule (ISO 5459): each datum is solved in the null space of those before it. Directions that no datum
constrains keep the given alignment. Object frame, metres, radians.
"""

from collections.abc import Sequence

import numpy as np

from planner.fitting.shapes import Shape, ShapeKind
from planner.registration.rigid import motion_from_vector, transform_points
from planner.values import Floats

_STEPS = 5
_DIFFERENCE = 1e-6  # of the components of a motion, for derivatives [m, rad]
_FREE = 1e-2  # relative displacement of a datum below which a motion does not move it


def moved(shape: Shape, T: Floats) -> Shape:
    """Return a shape after a motion (4, 4)."""
    point = T[:3, :3] @ shape.point + T[:3, 3]
    return Shape(shape.kind, point, T[:3, :3] @ shape.axis, shape.size, shape.half_angle)


def datum_residual(nominal: Shape, measured: Shape, length: float) -> Floats:
    """Return the deviations (n,) of a measured datum from its nominal place, rotations times `length` [m]."""
    x, y, axis = nominal.frame.T
    if nominal.kind is ShapeKind.SPHERE:
        return nominal.frame.T @ (measured.point - nominal.point)
    tilt = length * np.array([measured.axis @ x, measured.axis @ y])
    off = measured.point - nominal.point
    if nominal.kind is ShapeKind.PLANE:
        return np.array([*tilt, measured.axis @ off])
    at_height = off - measured.axis * (off @ axis) / (measured.axis @ axis)
    across = np.array([at_height @ x, at_height @ y])
    return across if nominal.kind is ShapeKind.CIRCLE else np.array([*tilt, *across])


def common_element(nominal: Shape, shapes: Sequence[Shape], ends: Sequence[Floats]) -> Shape:
    """Return the common plane or axis of several features: nearest to their ends by least squares.

    Args:
        nominal: plane, or shape on the axis; the axis of the result points as its own.
        shapes: plane or axis of each feature.
        ends: (K, 3) ends of each axis, or corners of each plane, which are moved to it [m].
    """
    is_plane, points = nominal.kind is ShapeKind.PLANE, []
    for shape, places in zip(shapes, ends, strict=True):
        along = ((places - shape.point) @ shape.axis)[:, None]
        points.append(places - along * shape.axis if is_plane else shape.point + along * shape.axis)
    every = np.concatenate(points)
    axis = np.linalg.svd(every - every.mean(axis=0), full_matrices=False)[2][2 if is_plane else 0]
    kind = ShapeKind.PLANE if is_plane else ShapeKind.LINE
    return Shape(kind, every.mean(axis=0), axis if axis @ nominal.axis >= 0 else -axis)


def datum_frame(nominal: Sequence[Shape], measured: Sequence[Shape], length: float) -> Floats:
    """Return the motion (4, 4) of the measured part that brings its datums, in their order, to the nominal ones.

    Args:
        nominal: datums of the part.
        measured: datums by the points.
        length: of the part, which makes rotations comparable with translations [m].
    """
    T, centre = np.eye(4), np.mean([shape.point for shape in nominal], axis=0)
    scale = np.array([1, 1, 1, 1 / length, 1 / length, 1 / length])

    def residuals(change: Floats) -> list[Floats]:
        there = motion_from_vector(scale * change, centre) @ T
        return [datum_residual(one, moved(other, there), length) for one, other in zip(nominal, measured, strict=True)]

    for _ in range(_STEPS):
        now = residuals(np.zeros(6))
        ahead = [residuals(_DIFFERENCE * row) for row in np.eye(6)]
        change, free = np.zeros(6), np.eye(6)
        for k, off in enumerate(now):
            J = np.stack([each[k] - off for each in ahead], axis=1) / _DIFFERENCE
            u, s, vt = np.linalg.svd(J @ free)
            rank = int((s > _FREE).sum())
            change = change - free @ (vt[:rank].T @ ((u[:, :rank].T @ (off + J @ change)) / s[:rank]))
            free = free @ vt[rank:].T
            if not free.shape[1]:
                break
        T = motion_from_vector(scale * change, centre) @ T
    return T


def fit_reference_points(
    nominal: Floats, directions: Floats, weights: Floats, measured: Floats, normals: Floats
) -> tuple[Floats, Floats]:
    """Return the motion (4, 4) that moves measured surface to reference points along their directions.

    Args:
        nominal: (N, 3) reference points [m].
        directions: (N, 3) unit directions along which the part is held.
        weights: (N,) of the squared deviations.
        measured: (N, 3) point of the measured surface near each reference point [m].
        normals: (N, 3) unit normals of the surface there.

    Returns:
        The motion, and the deviations (N,) that remain [m].
    """
    T, centre = np.eye(4), nominal.mean(axis=0)
    for _ in range(_STEPS):
        points, turned = transform_points(T, measured), normals @ T[:3, :3].T
        slope = np.einsum("nj,nj->n", turned, directions)
        off = np.einsum("nj,nj->n", points - nominal, turned) / slope
        J = np.hstack([turned, np.cross(nominal - centre, turned)]) / slope[:, None]
        root = np.sqrt(weights)
        change = np.linalg.lstsq(root[:, None] * J, -root * off, rcond=1e-6)[0]
        T = motion_from_vector(change, centre) @ T
    return T, off
