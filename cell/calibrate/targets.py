"""A sphere or a plane in the points of one scan, among points of other things. Scanner frame, metres.

It begins with the surface through a few points that leaves the least median distance (Rousseeuw, J. Am. Stat. Assoc.
79, 1984, doi:10.1080/01621459.1984.10477105), which half of the points may miss; from there on least squares with
Tukey's weights.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np

from planner.values import Floats, Value

FEWEST = 30
"""Points that a scan of a target needs."""

_DRAWS = 60
_JUDGES = 400  # points whose median distance is looked at
_OF_SPHERE, _OF_PLANE = 6, 3  # points of a first guess
_MOST = 5000  # points that stand for all of a scan
_TUKEY = 4.685
_STEPS = 50
_STILL = 1e-9  # m
_EXACT = 1e-9  # m; residuals below are rounding


class NoTargetError(Exception):
    """A scan shows no target; the message says why.

    Attributes:
        scan: which of them, from 0.
    """

    scan = 0


@dataclass(frozen=True, slots=True, eq=False)
class Sphere(Value):
    """A sphere in a scan.

    Attributes:
        centre: (3,) [m].
        radius: [m].
        radius_sd: standard deviation of the radius [m]; 0 where it was given.
        rms: distance of the points from it that count [m].
        used: share of the points that count.
    """

    centre: Annotated[Floats, "3"]
    radius: float
    radius_sd: float
    rms: float
    used: float


@dataclass(frozen=True, slots=True, eq=False)
class Plane(Value):
    """A plane in a scan.

    Attributes:
        points: (4, 3) on it, with the mean and the spread of those that were measured [m]: they stand for all.
        rms: distance of the points from it that count [m].
        used: share of the points that count.
    """

    points: Annotated[Floats, "4 3"]
    rms: float
    used: float


def sphere_in(points: Floats, radius: float | None, rng: np.random.Generator) -> Sphere:
    """The sphere in a scan.

    Args:
        points: (P, 3) [m].
        radius: known [m], or None.
        rng: of the first guesses.

    Raises:
        NoTargetError: if there are too few points, or they show no sphere.
    """
    points = _some(points)
    origin = points.mean(axis=0)
    near = points - origin
    c, r = _least_median(near, _OF_SPHERE, _sphere_through, _off, rng)
    r = r if radius is None else radius
    weight, J = np.ones(len(near)), np.empty((len(near), 4))
    for _ in range(_STEPS):
        away = near - c
        distance = np.linalg.norm(away, axis=1)
        left = distance - r
        weight = _tukey(left)
        J = np.column_stack([-away / distance[:, None], -np.ones(len(near))])[:, : 3 if radius is not None else 4]
        change = np.linalg.lstsq(np.sqrt(weight)[:, None] * J, -np.sqrt(weight) * left, rcond=None)[0]
        c = c + change[:3]
        r += 0.0 if radius is not None else float(change[3])
        if not np.isfinite(c).all() or not 0 < r < 1e3 * np.ptp(near, axis=0).max():
            raise NoTargetError("the points show no sphere; a target's surface has to be curved where it is seen")
        if np.abs(change).max() < _STILL:
            break
    left = np.linalg.norm(near - c, axis=1) - r
    counts = _tukey(left) > 0
    rms = float(np.sqrt(np.mean(left[counts] ** 2)))
    sd = 0.0 if radius is not None else rms * float(np.sqrt(np.linalg.inv(J[counts].T @ J[counts])[3, 3]))
    return Sphere(c + origin, r, sd, rms, float(counts.mean()))


def spheres_in(scans: Sequence[Floats], radius: float | None, rng: np.random.Generator) -> list[Sphere]:
    """The same sphere in several scans; an unknown radius is one for all, each scan weighted by what it tells of it.

    Raises:
        NoTargetError: as `sphere_in`.
    """
    found = _each(scans, lambda points: sphere_in(points, radius, rng))
    if radius is not None:
        return found
    weights = np.array([max(each.radius_sd, _EXACT) ** -2 for each in found])
    common = float(weights @ [each.radius for each in found] / weights.sum())
    sd = float(weights.sum() ** -0.5)
    again = _each(scans, lambda points: sphere_in(points, common, rng))
    return [Sphere(each.centre, common, sd, each.rms, each.used) for each in again]


def planes_in(scans: Sequence[Floats], rng: np.random.Generator) -> list[Plane]:
    """The same plane in several scans.

    Raises:
        NoTargetError: as `plane_in`.
    """
    return _each(scans, lambda points: plane_in(points, rng))


def plane_in(points: Floats, rng: np.random.Generator) -> Plane:
    """The plane in a scan.

    Args:
        points: (P, 3) [m].
        rng: of the first guesses.

    Raises:
        NoTargetError: if there are too few points, or they lie on a line.
    """
    points = _some(points)
    n, d = _least_median(points, _OF_PLANE, _plane_through, lambda each, plane: each @ plane[0] - plane[1], rng)
    weight = _tukey(points @ n - d)
    spread, axes, middle = np.zeros(3), np.eye(3), points[0]
    for _ in range(_STEPS):
        middle = weight @ points / weight.sum()
        away = points - middle
        spread, axes = np.linalg.eigh((away * weight[:, None]).T @ away / weight.sum())
        before, n = n, axes[:, 0]
        d = float(n @ middle)
        weight = _tukey(points @ n - d)
        if min(np.abs(n - before).max(), np.abs(n + before).max()) < _STILL:
            break
    if spread[1] < 1e-4 * spread[2]:
        raise NoTargetError("the points lie on a line and show no plane; scan more of the target")
    left, counts = points @ n - d, weight > 0
    ends = [sign * np.sqrt(2 * spread[k]) * axes[:, k] for k in (1, 2) for sign in (-1, 1)]
    return Plane(middle + np.stack(ends), float(np.sqrt(np.mean(left[counts] ** 2))), float(counts.mean()))


Found = TypeVar("Found")


def _each(scans: Sequence[Floats], find: Callable[[Floats], Found]) -> list[Found]:
    """What is found in each scan; an error knows in which it was raised."""
    found = []
    for number, points in enumerate(scans):
        try:
            found.append(find(points))
        except NoTargetError as error:
            error.scan = number
            raise
    return found


def _some(points: Floats) -> Floats:
    if len(points) < FEWEST:
        raise NoTargetError(f"{len(points)} points show no target; a scan of one needs at least {FEWEST}")
    if np.ptp(points, axis=0).max() < _EXACT:
        raise NoTargetError("the points show no target; they all lie in one place")
    return points[np.linspace(0, len(points) - 1, min(len(points), _MOST)).astype(np.int64)]


Surface = tuple[Floats, float]
"""Of a sphere centre (3,) and radius, of a plane normal (3,) and distance from the origin [m]."""


def _least_median(
    points: Floats,
    count: int,
    through: Callable[[Floats], Surface],
    off: Callable[[Floats, Surface], Floats],
    rng: np.random.Generator,
) -> Surface:
    """Of surfaces through few points, that with the least median distance from all."""
    best: tuple[float, Surface] | None = None
    judges = points[:: max(1, len(points) // _JUDGES)]
    for _ in range(_DRAWS):
        try:
            found = through(points[rng.choice(len(points), count, replace=False)])
        except np.linalg.LinAlgError:
            continue
        median = float(np.median(np.abs(off(judges, found))))
        if np.isfinite(median) and (best is None or median < best[0]):
            best = median, found
    if best is None:
        raise NoTargetError("the points show no target; any few of them lie on a line")
    return best[1]


def _sphere_through(points: Floats) -> Surface:
    """The algebraic least-squares sphere: |p|^2 = 2 c . p + (r^2 - |c|^2)."""
    A = np.column_stack([2 * points, np.ones(len(points))])
    solved = np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)[0]
    return solved[:3], float(np.sqrt(max(solved[3] + solved[:3] @ solved[:3], 0.0)))


def _off(points: Floats, sphere: Surface) -> Floats:
    return np.asarray(np.linalg.norm(points - sphere[0], axis=1) - sphere[1])


def _plane_through(points: Floats) -> Surface:
    across = np.cross(points[1] - points[0], points[2] - points[0])
    length = float(np.linalg.norm(across))
    if length == 0:
        raise np.linalg.LinAlgError
    return across / length, float(across @ points[0]) / length


def _tukey(left: Floats) -> Floats:
    """Tukey's weights, of which the scale is the median residual's."""
    scale = max(1.4826 * float(np.median(np.abs(left))), _EXACT)
    ratio = left / (_TUKEY * scale)
    return np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
