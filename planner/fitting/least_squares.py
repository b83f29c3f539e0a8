"""Orthogonal least squares: shapes with the least sum of squared distances from points, and their uncertainty.

Lines and planes are principal components. A circle in space is the circle of the points projected onto their plane, as
in the reference pairs of NIST (Shakarji, J. Res. NIST 103(6), 1998, doi:10.6028/jres.103.043). Spheres, cylinders and
cones are found by Levenberg-Marquardt from several axes, and then by Gauss-Newton steps until these no longer shrink:
a sum of squares alone shows a parameter only to the root of the rounding error.

A fit is linear in small displacements of the points. `Fit.gain` states its answer to each, so that noise of any size
and errors common to many points are propagated alike (JCGM 102).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.fitting.shapes import (
    COMPONENT_NAMES,
    N_COMPONENTS,
    PARAMETERS,
    SIZE,
    TILT_X,
    TILT_Y,
    Shape,
    ShapeKind,
    X,
    Y,
    Z,
)
from planner.values import Floats, Value

_AXES = 60  # directions of half a sphere, 17 deg apart: a start that near converges
_STARTS = 12  # refined starts with the least distances
_START_POINTS = 400  # points that represent all in the search of a start
_ITERATIONS = 200
_ROUGH_STEPS = 25  # of every start
_CLOSE = 1.5  # sum of squares, as a multiple of the least, up to which a start is refined further
_SINGULAR = 1e-7  # singular value, as a share of the largest, below which a direction is not determined
_EQUAL = 1e-6  # relative difference of the sums of squares of two fits that are equally good
_OTHER = 1e-4  # difference of two shapes, as a share of the points' extent, beyond which they are different

MIN_POINTS = {ShapeKind.LINE: 2, ShapeKind.PLANE: 3, ShapeKind.CIRCLE: 3, ShapeKind.SPHERE: 4, ShapeKind.CYLINDER: 5,
              ShapeKind.CONE: 6}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Value):
    """A shape fitted to points.

    Attributes:
        shape: its point is the foot of the points' mean.
        frame: (3, 3) of the components of a change.
        residuals: (N,) distances of the points from the shape [m].
        gain: (7, N, 3) change of each component per displacement of each point.
        condition: ratio of the largest and the smallest singular value of the normal matrix's root, lengths in units
            of the points' extent.
        doubts: one sentence for each reason why the shape is not unique; empty for a unique one.
    """

    shape: Shape
    frame: Annotated[Floats, "3 3"]
    residuals: Annotated[Floats, "N"]
    gain: Annotated[Floats, "7 N 3"]
    condition: float
    doubts: tuple[str, ...] = ()

    @property
    def rms(self) -> float:
        """Root mean square distance of the points from the shape [m]."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def sigma(self) -> float:
        """Standard deviation of a point by the residuals and the degrees of freedom [m]; 0 without redundancy.

        A point has two residuals from a line, and two from a circle: in its plane and across. If the plane of a circle
        is given, so that no point moves it (`gain`), it has one, and three unknowns are left.
        """
        kind, count = self.shape.kind, len(self.residuals)
        if kind is ShapeKind.CIRCLE and not self.gain[[Z, TILT_X, TILT_Y]].any():
            freedom = count - 3
        else:
            freedom = count * (2 if kind in (ShapeKind.LINE, ShapeKind.CIRCLE) else 1) - len(PARAMETERS[kind])
        return float(np.sqrt((self.residuals**2).sum() / freedom)) if freedom > 0 else 0.0

    def covariance(self, sigma: Floats | float | None = None) -> Floats:
        """Return the covariance (7, 7) of the components for independent points.

        Args:
            sigma: standard deviation of each point (N,) or of all along the normal [m]; None takes the residuals'.
        """
        weighted = self.gain * np.reshape(self.sigma if sigma is None else sigma, (-1, 1))
        flat = weighted.reshape(N_COMPONENTS, -1)
        return np.asarray(flat @ flat.T)


def fit(kind: ShapeKind, points: Floats, start: Shape | None = None, weights: Floats | None = None) -> Fit:
    """Fit a shape to points (N, 3) [m].

    Args:
        kind: of the shape.
        points: at least `MIN_POINTS`.
        start: a shape near the solution, such as the nominal one; None searches over all axes.
        weights: (N,) of the squared distances, above 0; None weights all alike.

    Raises:
        PlannerError: for too few points, or points that are not finite.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < MIN_POINTS[kind] or not np.isfinite(points).all():
        raise PlannerError(f"a {kind} needs at least {MIN_POINTS[kind]} points with finite coordinates")
    w = np.ones(len(points)) if weights is None else np.asarray(weights, dtype=np.float64)
    centre = (w[:, None] * points.astype(np.longdouble)).sum(axis=0) / w.sum()
    local = np.asarray(points - centre, dtype=np.float64)
    extent = float(np.sqrt(np.mean((local**2).sum(axis=1)))) or 1.0
    found, others = _solve(kind, local / extent, None if start is None else _scaled(start, centre, extent), w)
    found = found.at_foot(np.zeros(3))
    return _with_uncertainty(found, local / extent, w, centre, extent, others)


def _solve(kind: ShapeKind, points: Floats, start: Shape | None, w: Floats) -> tuple[Shape, list[Shape]]:
    """Return the best shape of centred points of unit extent, and others that fit equally well."""
    if kind is ShapeKind.LINE or kind is ShapeKind.PLANE:
        axes = np.linalg.svd(np.sqrt(w)[:, None] * points, full_matrices=False)[2]
        axis = axes[0] if kind is ShapeKind.LINE else axes[2]
        return Shape(kind, np.zeros(3), axis if start is None or axis @ start.axis >= 0 else -axis), []
    if kind is ShapeKind.CIRCLE:
        plane, _ = _solve(ShapeKind.PLANE, points, start, w)
        return _planar_circle(plane, points, w), []
    if kind is ShapeKind.SPHERE:
        return _refine(_algebraic_sphere(points, w), points, w), []
    starts = [start] if start is not None else _starts(kind, points, w)
    if start is None:
        starts = [_descend(each, points, w, _ROUGH_STEPS) for each in starts]
        rough = np.array([_cost(each, points, w) for each in starts])
        starts = [each for each, cost in zip(starts, rough, strict=True) if cost <= _CLOSE * rough.min() + 1e-24]
    shapes = [_refine(each, points, w) for each in starts]
    costs = np.array([_cost(each, points, w) for each in shapes])
    best = shapes[int(costs.argmin())]
    limit = costs.min() * (1 + _EQUAL) + 1e-24 * len(points)
    others = [each for each, cost in zip(shapes, costs, strict=True) if cost <= limit and _differ(best, each)]
    return best, others


def _with_uncertainty(
    shape: Shape, points: Floats, w: Floats, centre: Floats, extent: float, others: list[Shape]
) -> Fit:
    """Return the fit in the units of the caller; shape and points (N, 3) are centred and of unit extent."""
    frame, kind, count = shape.frame, shape.kind, len(points)
    gain = np.zeros((N_COMPONENTS, count, 3))
    conditions, lost = [], list[int]()
    for components, J, directions in _rows(shape, points):
        root = np.sqrt(np.tile(w, len(J) // count))[:, None]
        u, s, vt = np.linalg.svd(root * J, full_matrices=False)
        held = s > _SINGULAR * s[0]
        conditions.append(float(s[0] / s[-1]) if held.all() else np.inf)
        lost += [components[int(np.abs(v).argmax())] for v in vt[~held]]
        inverse = (vt[held].T / s[held]) @ (u[:, held] * root).T
        for start in range(0, len(J), count):
            gain[list(components)] -= inverse[:, start : start + count, None] * directions[start : start + count]
    length = np.array([1, 1, 1, 1 / extent, 1 / extent, 1, 1 / extent])  # gain per displacement in the caller's unit
    doubts = [f"the points do not determine its {COMPONENT_NAMES[each]}" for each in dict.fromkeys(lost)]
    if kind is ShapeKind.CONE and count == len(PARAMETERS[kind]):
        doubts.append("as many points as unknowns; several cones contain them")
    elif others:
        doubts.append(f"another {kind} fits the points equally well")
    placed = Shape(
        kind, np.asarray(centre + extent * shape.point, dtype=np.float64), shape.axis, extent * shape.size,
        shape.half_angle,
    )  # fmt: skip
    residuals = extent * shape.distances(points)
    return Fit(placed, frame, residuals, gain * length[:, None, None], max(conditions), tuple(doubts))


def _rows(shape: Shape, points: Floats) -> list[tuple[tuple[int, ...], Floats, Floats]]:
    """Return independent linear problems: their components, the Jacobian, and the displacement that each row sees."""
    frame, count = shape.frame, len(points)
    u, v, w = ((points - shape.point) @ frame).T
    if shape.kind is ShapeKind.LINE:
        J = np.zeros((2 * count, 4))
        J[:count, 0], J[:count, 2], J[count:, 1], J[count:, 3] = -1, -w, -1, -w
        return [((X, Y, TILT_X, TILT_Y), J, np.repeat(frame.T[:2], count, axis=0))]
    if shape.kind is ShapeKind.CIRCLE:
        radial = np.column_stack([u, v]) / np.maximum(np.hypot(u, v), np.finfo(np.float64).tiny)[:, None]
        plane = np.column_stack([np.full(count, -1.0), u, v])
        along = np.tile(shape.axis, (count, 1))
        circle = np.column_stack([-radial, np.full(count, -1.0)])
        return [((Z, TILT_X, TILT_Y), plane, along), ((X, Y, SIZE), circle, radial @ frame.T[:2])]
    components = PARAMETERS[shape.kind]
    return [(components, shape.jacobian(points)[:, list(components)], shape.normals(points))]


def _scaled(shape: Shape, centre: Floats, extent: float) -> Shape:
    point = np.asarray((shape.point - centre) / extent, dtype=np.float64)
    return Shape(shape.kind, point, shape.axis, shape.size / extent, shape.half_angle).at_foot(np.zeros(3))


def _cost(shape: Shape, points: Floats, w: Floats) -> float:
    return float((w * shape.distances(points) ** 2).sum())


def _step(shape: Shape, points: Floats, w: Floats, damping: float = 0.0) -> Floats:
    """Return the (damped) Gauss-Newton step (7,)."""
    components, root = list(PARAMETERS[shape.kind]), np.sqrt(w)
    J = root[:, None] * shape.jacobian(points)[:, components]
    J = np.concatenate([J, np.sqrt(damping) * np.eye(len(components))])
    target = np.concatenate([-root * shape.distances(points), np.zeros(len(components))])
    change = np.zeros(N_COMPONENTS)
    change[components] = np.linalg.lstsq(J, target, rcond=None)[0]
    return change


def _descend(shape: Shape, points: Floats, w: Floats, iterations: int) -> Shape:
    """Return the shape after steps of Levenberg-Marquardt."""
    damping, cost = 1e-3, _cost(shape, points, w)
    for _ in range(iterations):
        step = _step(shape, points, w, damping)
        candidate = shape.changed(step).at_foot(np.zeros(3))
        other = _cost(candidate, points, w)
        if other < cost:
            shape, damping, gained = candidate, damping / 10, cost - other
            cost = other
            if gained <= 1e-14 * cost:
                break
        elif damping > 1e6 or np.abs(step).max() < 1e-15:
            break
        else:
            damping *= 10
    return shape


def _refine(shape: Shape, points: Floats, w: Floats) -> Shape:
    """Return the nearest minimum: Levenberg-Marquardt, then Gauss-Newton until the steps no longer shrink."""
    shape, last = _descend(shape, points, w, _ITERATIONS), np.inf
    for _ in range(_ITERATIONS):
        step = _step(shape, points, w)
        size = float(np.abs(step).max())
        if not size < last or size > 1e-3:
            break
        shape, last = shape.changed(step).at_foot(np.zeros(3)), size
    return shape


def _starts(kind: ShapeKind, points: Floats, w: Floats) -> list[Shape]:
    """Return the most promising cylinders or cones over all directions of the axis."""
    every = max(1, len(points) // _START_POINTS)
    points, w = points[::every], w[::every]
    k = np.arange(_AXES) + 0.5
    height, turn = k / _AXES, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - height**2)
    axes = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
    axes = np.concatenate([axes, np.linalg.svd(points, full_matrices=False)[2]])
    build: Callable[[Floats, Floats, Floats], Shape] = _cylinder_about if kind is ShapeKind.CYLINDER else _cone_about
    shapes = [build(axis, points, w) for axis in axes]
    order = np.argsort([_cost(each, points, w) for each in shapes], kind="stable")[:_STARTS]
    return [shapes[int(index)] for index in order]


def _cylinder_about(axis: Floats, points: Floats, w: Floats) -> Shape:
    circle = _algebraic_circle(Shape(ShapeKind.PLANE, np.zeros(3), axis), points, w)
    return Shape(ShapeKind.CYLINDER, circle.point, axis, circle.size)


def _cone_about(axis: Floats, points: Floats, w: Floats) -> Shape:
    """Return a cone with a given axis: an algebraic circle whose radius is linear along the axis."""
    frame = Shape(ShapeKind.PLANE, np.zeros(3), axis).frame
    u, v, height = (points @ frame).T
    root = np.sqrt(w)
    A = np.column_stack([2 * u, 2 * v, np.ones(len(u)), height, height**2])
    x, y, *_ = np.linalg.lstsq(root[:, None] * A, root * (u**2 + v**2), rcond=None)[0]
    radial = np.hypot(u - x, v - y)
    B = np.column_stack([np.ones(len(u)), height])
    radius, slope = np.linalg.lstsq(root[:, None] * B, root * radial, rcond=None)[0]
    angle = float(np.arctan(slope))
    point, size = frame @ np.array([x, y, 0.0]), float(radius * np.cos(angle))
    return Shape(ShapeKind.CONE, point, axis if angle >= 0 else -axis, size, abs(angle))


def _algebraic_sphere(points: Floats, w: Floats) -> Shape:
    root = np.sqrt(w)
    A = np.column_stack([2 * points, np.ones(len(points))])
    *centre, rest = np.linalg.lstsq(root[:, None] * A, root * (points**2).sum(axis=1), rcond=None)[0]
    size = float(np.sqrt(max(rest + np.dot(centre, centre), 0.0)))
    return Shape(ShapeKind.SPHERE, np.array(centre), np.array([0.0, 0.0, 1.0]), size)


def _algebraic_circle(plane: Shape, points: Floats, w: Floats) -> Shape:
    frame = plane.frame
    local, root = (points @ frame)[:, :2], np.sqrt(w)
    A = np.column_stack([2 * local, np.ones(len(local))])
    x, y, rest = np.linalg.lstsq(root[:, None] * A, root * (local**2).sum(axis=1), rcond=None)[0]
    size = float(np.sqrt(max(rest + x**2 + y**2, 0.0)))
    return Shape(ShapeKind.CIRCLE, frame @ np.array([x, y, 0.0]), plane.axis, size)


def _planar_circle(plane: Shape, points: Floats, w: Floats) -> Shape:
    """Return the least-squares circle of points projected onto a plane: a cylinder with its axis fixed."""
    circle = _algebraic_circle(plane, points, w)
    root, last = np.sqrt(w), np.inf
    for _ in range(_ITERATIONS):
        flat = (points - circle.point) @ circle.frame
        radial = np.hypot(flat[:, 0], flat[:, 1])
        J = np.column_stack([flat[:, :2] / np.maximum(radial, 1e-300)[:, None], np.ones(len(points))])
        step = np.linalg.lstsq(root[:, None] * J, root * (radial - circle.size), rcond=None)[0]
        size = float(np.abs(step).max())
        if not size < last:
            break
        last = size
        change = np.zeros(N_COMPONENTS)
        change[[X, Y, SIZE]] = step
        circle = circle.changed(change)
    return circle


def _differ(a: Shape, b: Shape) -> bool:
    """Return whether two cylinders or cones of points of unit extent are different."""
    turned = np.linalg.norm(np.cross(a.axis, b.axis))
    distance = np.linalg.norm(a.at_foot(np.zeros(3)).point - b.at_foot(np.zeros(3)).point)
    return bool(max(float(turned), float(distance), abs(a.size - b.size), abs(a.half_angle - b.half_angle)) > _OTHER)
