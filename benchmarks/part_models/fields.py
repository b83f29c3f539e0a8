"""Implicit shapes: functions that are negative inside, positive outside, and close to a distance near the surface.

The formulas are the usual ones of constructive solid geometry with distance fields (I. Quilez, "Distance functions",
iquilezles.org/articles/distfunctions). A field takes points (3, N) float32 [mm] and returns (N,) float32 [mm].
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]
Values = NDArray[np.float32]
Field = Callable[[Points], Values]
Vector = Sequence[float]


def ellipsoid(centre: Vector, semi_axes: Vector, turn: NDArray[np.float32] | None = None) -> Field:
    """Return an ellipsoid; the distance is of first order (exact on the surface).

    Args:
        centre: [mm].
        semi_axes: [mm], along the rows of `turn`.
        turn: (3, 3) rotation from the part to the ellipsoid's axes; none for axis-parallel.
    """
    c = np.array(centre, np.float32)[:, None]
    s = np.array(semi_axes, np.float32)[:, None]
    deepest = np.float32(-s.min())  # near the centre the quotient overestimates the depth

    def field(p: Points) -> Values:
        q = _about(p, c, turn)
        q /= s
        k0 = _length(q)
        q /= s
        k1 = _length(q)
        value: Values = np.maximum(k0 * (k0 - 1) / np.maximum(k1, np.float32(1e-6)), deepest)
        value[k1 < 1e-6] = deepest  # the centre itself, where the quotient is 0 / 0
        return value

    return field


def capsule(a: Vector, b: Vector, radius_a: float, radius_b: float | None = None) -> Field:
    """Return a round rod from a to b with a linearly changing radius [mm]."""
    start = np.array(a, np.float32)[:, None]
    axis = np.array(b, np.float32)[:, None] - start
    squared = np.float32((axis**2).sum())
    ra = np.float32(radius_a)
    rb = np.float32(radius_a if radius_b is None else radius_b)

    def field(p: Points) -> Values:
        q = p - start
        h = np.clip((q * axis).sum(axis=0) / squared, 0, 1)
        q -= h * axis
        value: Values = _length(q) - (ra + (rb - ra) * h)
        return value

    return field


def tube(points: Sequence[Vector], radii: Sequence[float], blend: float = 0.0) -> Field:
    """Return round rods through a chain of points, one radius [mm] per point."""
    rods = [capsule(points[i], points[i + 1], radii[i], radii[i + 1]) for i in range(len(points) - 1)]
    return union(blend, *rods)


def cylinder(a: Vector, b: Vector, radius: float, rounding: float = 0.0) -> Field:
    """Return a cylinder from a to b with flat ends and rounded rims [mm]."""
    start = np.array(a, np.float32)[:, None]
    axis = np.array(b, np.float32)[:, None] - start
    length = np.float32(np.sqrt((axis**2).sum()))
    axis /= length
    middle = np.asarray(start + axis * length / 2, np.float32)
    r, round_ = np.float32(radius - rounding), np.float32(rounding)
    half = np.float32(length / 2 - rounding)

    def field(p: Points) -> Values:
        q: Points = np.subtract(p, middle)
        along: Values = (q * axis).sum(axis=0)
        q -= along * axis
        return _corner(_length(q) - r, np.abs(along) - half) - round_

    return field


def box(centre: Vector, half_sides: Vector, rounding: float = 0.0, turn: NDArray[np.float32] | None = None) -> Field:
    """Return a box with rounded edges [mm]; `turn` as for `ellipsoid`."""
    c = np.array(centre, np.float32)[:, None]
    half = np.array(half_sides, np.float32)[:, None] - np.float32(rounding)
    round_ = np.float32(rounding)

    def field(p: Points) -> Values:
        q = _about(p, c, turn)
        np.subtract(np.abs(q), half, out=q)
        outside = _length(np.maximum(q, np.float32(0)).astype(np.float32, copy=False))
        value: Values = outside + np.minimum(q.max(axis=0), 0) - round_
        return value

    return field


def torus(centre: Vector, axis: int, radius: float, thickness: float, squash: float = 1.0) -> Field:
    """Return a ring about a coordinate axis.

    `thickness` is the radius of its section [mm], `squash` widens it along the axis.
    """
    c = np.array(centre, np.float32)[:, None]
    i, j = (k for k in range(3) if k != axis)

    def field(p: Points) -> Values:
        q = p - c
        ring = np.sqrt(q[i] ** 2 + q[j] ** 2) - np.float32(radius)
        value: Values = np.sqrt(ring**2 + (q[axis] / np.float32(squash)) ** 2) - np.float32(thickness)
        return value

    return field


def revolve(axis: int, along: Sequence[float], radii: Sequence[float]) -> Field:
    """Return a solid of revolution about a coordinate axis through the origin: a polyline of radii [mm], flat ends.

    The distance is divided by the slope of the profile, so that it never overestimates.
    """
    s = np.array(along, np.float32)
    r = np.array(radii, np.float32)
    steepest = np.float32(np.sqrt(1 + (np.abs(np.diff(r) / np.diff(s)).max()) ** 2))
    i, j = (k for k in range(3) if k != axis)

    def field(p: Points) -> Values:
        t = p[axis]
        rim = np.interp(t, s, r).astype(np.float32)
        side = (np.sqrt(p[i] ** 2 + p[j] ** 2) - rim) / steepest
        return _corner(side, np.maximum(s[0] - t, t - s[-1]))

    return field


def union(blend: float, *fields: Field) -> Field:
    """Return the union of the shapes; creases where two are nearer than `blend` [mm] are filled."""
    if blend <= 0:
        return lambda p: _fold(np.minimum, fields, p)
    k = np.float32(blend)
    return lambda p: _fold(lambda a, b: _smooth_minimum(a, b, k), fields, p)


def without(blend: float, body: Field, *holes: Field) -> Field:
    """Return the body minus the holes; edges are rounded over `blend` [mm]."""
    k = np.float32(max(blend, 1e-6))

    def field(p: Points) -> Values:
        value = body(p)
        for hole in holes:
            value = -_smooth_minimum(-value, hole(p), k)
        return value

    return field


def displaced(body: Field, height: Field) -> Field:
    """Return the shape with its surface moved outward by a height that depends on the place [mm]."""

    def field(p: Points) -> Values:
        value: Values = body(p) - height(p)
        return value

    return field


def ripples(rng: np.random.Generator, amplitude: float, wavelength: float, waves: int = 6) -> Field:
    """Return random ripples: seeded plane waves of random direction and phase, about one wavelength [mm]."""
    direction = rng.normal(size=(waves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    k = (2 * np.pi / wavelength * rng.uniform(0.6, 1.4, (waves, 1)) * direction).astype(np.float32)
    phase = rng.uniform(0, 2 * np.pi, (waves, 1)).astype(np.float32)
    a = np.float32(amplitude / np.sqrt(waves))
    return lambda p: a * np.sin(k @ p + phase).sum(axis=0)


def mirrored(axis: int, field: Field) -> Field:
    """Return the shape on the positive side of a coordinate plane and its mirror image."""

    def both(p: Points) -> Values:
        q = p.copy()
        q[axis] = np.abs(q[axis])
        return field(q)

    return both


def rotation(axis: int, degrees: float) -> NDArray[np.float32]:
    """Return the (3, 3) rotation about a coordinate axis, right handed."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3, dtype=np.float32)
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = -s, s
    return turn


def _fold(combine: Callable[[Values, Values], Values], fields: Sequence[Field], p: Points) -> Values:
    value = fields[0](p)
    for field in fields[1:]:
        value = combine(value, field(p))
    return value


def _smooth_minimum(a: Values, b: Values, k: np.float32) -> Values:
    """Return the quadratic smooth minimum: the minimum where |a - b| >= k, lower by k / 4 where a = b."""
    h = np.maximum(k - np.abs(a - b), 0) / k
    value: Values = np.minimum(a, b) - h * h * (k / np.float32(4))
    return value


def _corner(side: Values, end: Values) -> Values:
    """Return the distance to the intersection of two half spaces at right angles."""
    value: Values = np.minimum(np.maximum(side, end), 0) + np.sqrt(np.maximum(side, 0) ** 2 + np.maximum(end, 0) ** 2)
    return value


def _about(p: Points, centre: Points, turn: NDArray[np.float32] | None) -> Points:
    """Return the points in the frame of a shape: from its centre, along its axes."""
    q: Points = np.subtract(p, centre)
    if turn is not None:
        q = np.matmul(turn, q).astype(np.float32, copy=False)
    return q


def _length(q: Points) -> Values:
    value: Values = np.sqrt(np.einsum("ij,ij->j", q, q))
    return value
