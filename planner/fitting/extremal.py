"""Minimum zone, minimum circumscribed and maximum inscribed shapes by sequential linear programming.

The distances are linear in a small change of the shape (Anthony and others, "Reference software for finding Chebyshev
best-fit geometric elements", Precision Engineering 19, 1996, doi:10.1016/0141-6359(95)00054-2). Each linear program
bounds the distances of the critical points only; points that exceed its zone are added until none does. Object frame,
metres.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.optimize import linprog

from planner.fitting.shapes import N_COMPONENTS, PARAMETERS, SIZE, TILT_X, TILT_Y, Shape, ShapeKind, X, Y, Z
from planner.values import Floats

FULL_STEPS = 40
"""Linear programs of a search at most; it ends when the shape no longer improves."""

_CRITICAL = 40  # points at either end with which a program starts
_TRUST = 0.05  # largest first change, as a share of the points' extent
_ROOM = 1e-6  # smallest growth of all distances per change, beyond which points leave room for it
_DONE = 1e-9  # relative gain of a step that ends the search


class Criterion(Enum):
    """Property that an extremal shape optimises."""

    ZONE = "minimum zone"
    CIRCUMSCRIBED = "minimum circumscribed"
    INSCRIBED = "maximum inscribed"


@dataclass(frozen=True, slots=True, eq=False)
class Extremal:
    """An extremal shape.

    Attributes:
        shape: its size is that of the circumscribed or inscribed shape, else in the middle of the zone.
        zone: width between the innermost and the outermost point [m].
    """

    shape: Shape
    zone: float


def fit_extremal(criterion: Criterion, points: Floats, start: Shape, steps: int = FULL_STEPS) -> Extremal:
    """Return the extremal shape near a start, such as the least-squares fit.

    Args:
        criterion: property to optimise. A plane, and a cone, have only a zone.
        points: (N, 3) of a plane, circle (projected onto its plane), sphere, cylinder or cone [m].
        start: shape near the solution.
        steps: linear programs at most.
    """
    shape, free = _with_changes(start)
    centre = points.mean(axis=0)
    extent = float(np.sqrt(np.mean(((points - centre) ** 2).sum(axis=1)))) or 1.0
    local = (points - centre) / extent
    point = (shape.point - centre) / extent
    shape = Shape(shape.kind, point, shape.axis, shape.size / extent, shape.half_angle).at_foot(np.zeros(3))
    trust, value = _TRUST, _objective(criterion, shape.distances(local), shape.size)
    for _ in range(steps):
        candidate = shape.changed(_program(criterion, shape, local, free, trust)).at_foot(np.zeros(3))
        other = _objective(criterion, candidate.distances(local), candidate.size)
        if other < value - _DONE * abs(value) * 1e-3:
            shape, gained, value = candidate, value - other, other
            if gained <= _DONE * abs(value):
                break
        else:
            trust /= 4
            if trust < 1e-12:
                break
    distances = shape.distances(local)
    low, high = float(distances.min()), float(distances.max())
    ends = {Criterion.ZONE: (low + high) / 2, Criterion.CIRCUMSCRIBED: high, Criterion.INSCRIBED: low}
    if shape.kind is ShapeKind.PLANE:
        point, size = shape.point + ends[criterion] * shape.axis, 0.0
    else:
        point, size = shape.point, shape.size + ends[criterion]
    placed = Shape(start.kind, centre + extent * point, shape.axis, extent * size, shape.half_angle)
    return Extremal(placed, extent * (high - low))


def surround(points: Floats, shape: Shape) -> bool:
    """Return whether points (N, 3) hold a circle, sphere or cylinder: no small shift or tilt leaves all of them.

    Otherwise a larger inscribed shape always exists, and the circumscribed one is smaller than the shape. Points on one
    side leave room for a shift. Points on one side of one end and on the other side of the other end leave room for a
    tilt.
    """
    shape, free = _with_changes(shape)
    centre = points.mean(axis=0)
    along = np.abs((points - centre) @ shape.axis).max()
    J = shape.at_foot(centre).jacobian(points)
    J[:, [TILT_X, TILT_Y]] /= along if along > 0 else 1.0
    n = len(free)
    A = np.hstack([-J[:, free], np.ones((len(points), 1))])  # each distance grows by at least the last variable
    solution = linprog([0.0] * n + [-1.0], A, np.zeros(len(A)), bounds=[(-1, 1)] * n + [(0, 1)], method="highs").x
    assert solution is not None, "the origin is a solution"
    return bool(solution[n] < _ROOM)


def _with_changes(shape: Shape) -> tuple[Shape, list[int]]:
    """Return a shape, of a circle the cylinder with its axis, and the changes that move distances unequally."""
    offset = Z if shape.kind is ShapeKind.PLANE else SIZE  # a change that moves all distances alike
    if shape.kind is ShapeKind.CIRCLE:
        return Shape(ShapeKind.CYLINDER, shape.point, shape.axis, shape.size), [X, Y]
    return shape, [each for each in PARAMETERS[shape.kind] if each != offset]


def _objective(criterion: Criterion, distances: Floats, size: float) -> float:
    """Return the value that a criterion minimises, for distances (N,) from a shape of this size."""
    match criterion:
        case Criterion.ZONE:
            return float(distances.max() - distances.min())
        case Criterion.CIRCUMSCRIBED:
            return size + float(distances.max())
    return -size - float(distances.min())


def _program(criterion: Criterion, shape: Shape, points: Floats, free: list[int], trust: float) -> Floats:
    """Return the change (7,) that is best for the linearised distances, at most `trust` in each component."""
    distances, J = shape.distances(points), shape.jacobian(points)[:, free]
    order = np.argsort(distances, kind="stable")
    critical = np.unique(np.concatenate([order[:_CRITICAL], order[-_CRITICAL:]]))
    n = len(free)
    cost = np.zeros(n + 2)  # the components, the lower and the upper end of the zone
    cost[n] = 0.0 if criterion is Criterion.CIRCUMSCRIBED else -1.0
    cost[n + 1] = 0.0 if criterion is Criterion.INSCRIBED else 1.0
    bounds = [(-trust, trust)] * n + [(None, None)] * 2
    change = np.zeros(N_COMPONENTS)
    while True:
        one, zero = np.ones((len(critical), 1)), np.zeros((len(critical), 1))
        A = np.block([[-J[critical], one, zero], [J[critical], zero, -one]])
        b = np.concatenate([distances[critical], -distances[critical]])
        solution = linprog(cost, A, b, bounds=bounds, method="highs").x
        assert solution is not None, "a bounded zone around points always exists"
        reached = distances + J @ solution[:n]
        low = -np.inf if criterion is Criterion.CIRCUMSCRIBED else reached[critical].min()
        high = np.inf if criterion is Criterion.INSCRIBED else reached[critical].max()
        beyond = np.flatnonzero((reached < low - 1e-12) | (reached > high + 1e-12))
        beyond = np.setdiff1d(beyond, critical)
        if not len(beyond):
            change[free] = solution[:n]
            return change
        worst = np.argsort(-np.maximum(low - reached[beyond], reached[beyond] - high), kind="stable")
        critical = np.union1d(critical, beyond[worst[:_CRITICAL]])
