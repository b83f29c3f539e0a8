"""Hand-eye calibration: the mount (flange to scanner) from one target scanned from several poses of the flange.

Every scan observes the centre s_i of a sphere, or points q_ij on a plane. With the flange at T_i and the mount X

    sphere:  T_i X s_i = c          plane:  n . (T_i X q_ij) = d

where c, or n and d, describe the target in base: unknown, and solved for together with X (nine unknowns). Gauss-Newton
least squares starts from many rotations, because the scanner may be mounted in any orientation. The final steps are
weighted by the effect of flange pose errors on each residual: an error of rotation moves a point across its lever, not
along it.

The information that remains for X after elimination of the target (the Schur complement) tells the motions of the mount
that the poses do not determine (`planner.registration.observability`). These keep their start value.

The target in a scan, among points of other objects: the start is the surface through a few random points with the least
median distance (Rousseeuw, J. Am. Stat. Assoc. 79, 1984, doi:10.1080/01621459.1984.10477105), which tolerates half of
the points as outliers. Least squares with Tukey's weights refine it. Metres, radians.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from operator import itemgetter
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from planner.errors import PlannerError
from planner.geometry.rigid import rigid_transform
from planner.registration.observability import RigidFit, split_directions
from planner.registration.rigid import length_scale, motion_from_screw, restricted_covariance, screw_from_motion, skew
from planner.values import Floats, Value

MIN_SCANS = 5
"""Smallest number of scans: each gives three conditions for nine unknowns, and several mounts satisfy three scans."""

_FIRST, _STEPS = 10, 60
_PROMISING = 4  # starts that continue
_LARGEST = 0.5  # rad; a step with a larger rotation is shortened
_STILL = 1e-12
_ROUNDING = 1e-9
_AS_GOOD = 4.0  # ratio of the sums of squares up to which another mount fits about as well
_SAME = 0.02  # of the distance to the target: mounts that are no farther apart are the same
_RANDOM = 24  # random start rotations
_FLOOR = 1e-5  # m; smallest standard deviation of a target's position in a scan


@dataclass(frozen=True, slots=True)
class PoseError:
    """Standard deviations of the reported flange pose: position along each axis [m], rotation about each axis [rad]."""

    position: float = 3e-5
    rotation: float = float(np.radians(0.02))


@dataclass(frozen=True, slots=True, eq=False)
class TargetScans(Value):
    """Points of the target in each scan.

    Attributes:
        T_base_flange: (K, 4, 4) [m].
        points: (K, J, 3) in the scanner frame [m]: the centre of a sphere, or four points of a plane.
        is_plane: whether the target is a plane.
    """

    T_base_flange: Annotated[Floats, "K 4 4"]
    points: Annotated[Floats, "K _ 3"]
    is_plane: bool


def solve_hand_eye(scans: TargetScans, error: PoseError, rng: np.random.Generator) -> RigidFit:
    """Compute T_flange_scanner, with its covariance about the scanner's origin in the axes of the flange.

    The residuals are one distance a scan.

    Args:
        scans: the target in each scan.
        error: of the flange poses; only the ratio of the two counts, their size follows from the residuals.
        rng: of the start rotations.

    Raises:
        PlannerError: if there are too few scans.
    """
    count = len(scans.points)
    if count < MIN_SCANS:
        raise PlannerError(
            f"{count} scans do not determine the mount; give at least {MIN_SCANS}, from rotated flange poses"
        )
    length = float(np.sqrt((scans.points**2).sum(axis=2).mean()))
    started = []
    for R in _start_rotations(rng):
        started.append(_descend(scans, rigid_transform(R, np.zeros(3)), length, _FIRST))
    results = [_descend(scans, T, length, _STEPS) for _, T in sorted(started, key=itemgetter(0))[:_PROMISING]]
    results = sorted((_descend(scans, T, length, _STEPS, error) for _, T in results), key=itemgetter(0))
    T = results[0][1]
    plain, weighted = _linearise(scans, T), _linearise(scans, T, error)
    observed, free = split_directions(plain.information, plain.weight, length)
    surplus = 3 * count - 3 - observed.shape[1]
    variance = float(weighted.residual @ weighted.residual) / surplus if surplus > 0 else None
    covariance = None if variance is None else variance * restricted_covariance(weighted.information, observed, length)
    residuals = np.sqrt((plain.residual.reshape(count, -1) ** 2).sum(axis=1) / (4 if scans.is_plane else 1))
    return RigidFit(T, covariance, free, T[:3, 3], length, residuals, alternatives=_alternatives(results, free, length))


def _alternatives(results: Sequence[tuple[float, Floats]], free: Floats, length: float) -> tuple[str, ...]:
    """Describe other mounts that fit about as well and do not differ by a free motion alone."""
    (least, T), *others = results
    observed = np.eye(6) - free @ free.T
    sentences = []
    for cost, other in others:
        change = screw_from_motion(other @ np.linalg.inv(T), T[:3, 3])
        distance = np.linalg.norm(observed @ (change * length_scale(length)))
        if cost < _AS_GOOD * max(least, 1.0) and distance > _SAME * length:
            position = ", ".join(f"{1000 * value:.1f}" for value in other[:3, 3])
            sentences.append(f"a mount at {position} mm fits about as well; take more scans")
    return tuple(dict.fromkeys(sentences))


@dataclass(frozen=True, slots=True, eq=False)
class _Equations(Value):
    """Linear least-squares problem at a mount, with the target eliminated.

    Attributes:
        residual: (M,) in metres or in standard deviations.
        information: (6, 6) for a small motion (translation, rotation) about the scanner's origin, axes of the flange.
        slope: (6,) the gradient.
        weight: of all residuals.
    """

    residual: Annotated[Floats, "_"]
    information: Annotated[Floats, "6 6"]
    slope: Annotated[Floats, "6"]
    weight: float


def _linearise(scans: TargetScans, T: Floats, error: PoseError | None = None) -> _Equations:
    """Linearise the problem at a mount (4, 4); with a pose error, in its standard deviations."""
    R, t = scans.T_base_flange[:, None, :3, :3], scans.T_base_flange[:, None, :3, 3]
    turned = scans.points @ T[:3, :3].T
    arm = turned + T[:3, 3]
    there = (R @ arm[..., None])[..., 0] + t
    residual = there - there.mean(axis=(0, 1))
    R = np.broadcast_to(R, (*turned.shape, 3))
    of_mount, of_flange = (np.concatenate([R, -R @ skew(lever)], axis=-1) for lever in (turned, arm))
    count = len(residual)
    if scans.is_plane:
        axes = np.linalg.svd(residual.reshape(-1, 3), full_matrices=False)[2]
        of_target = np.concatenate([residual @ axes[:2].T, -np.ones((*residual.shape[:2], 1))], axis=-1)
        residual, of_mount, of_flange = (
            np.einsum("a,kja...->kj...", axes[2], each) for each in (residual, of_mount, of_flange)
        )
    else:
        of_target = np.broadcast_to(-np.eye(3), (*residual.shape, 3))
    residual, of_mount, of_target, of_flange = (
        each.reshape(count, -1, *each.shape[3 - scans.is_plane :])
        for each in (residual, of_mount, of_target, of_flange)
    )
    if error is not None:
        sd = np.array([*[error.position] * 3, *[error.rotation] * 3])
        spread = (of_flange * sd**2) @ of_flange.transpose(0, 2, 1) + _FLOOR**2 * np.eye(residual.shape[1])
        whiten = np.linalg.inv(np.linalg.cholesky(spread))
        residual, of_mount, of_target = (whiten @ residual[..., None])[..., 0], whiten @ of_mount, whiten @ of_target
    residual, of_mount, of_target = residual.reshape(-1), of_mount.reshape(-1, 6), of_target.reshape(-1, 3)
    project = np.eye(len(residual)) - of_target @ np.linalg.pinv(of_target, rcond=_ROUNDING)
    residual, J = project @ residual, project @ of_mount
    return _Equations(residual, J.T @ J, J.T @ residual, float(len(residual)))


def _descend(
    scans: TargetScans, T: Floats, length: float, steps: int, error: PoseError | None = None
) -> tuple[float, Floats]:
    """Take Gauss-Newton steps from a mount in the observed directions; return sum of squares and mount (4, 4)."""
    for _ in range(steps):
        equations = plain = _linearise(scans, T)
        if error is not None:
            equations = _linearise(scans, T, error)
        observed, _ = split_directions(plain.information, plain.weight, length)
        change = -restricted_covariance(equations.information, observed, length) @ equations.slope
        change /= max(1.0, float(np.abs(change[3:]).max()) / _LARGEST)
        T = motion_from_screw(change, T[:3, 3]) @ T
        if np.abs(change).max() < _STILL:
            break
    return float((_linearise(scans, T, error).residual ** 2).sum()), T


def _start_rotations(rng: np.random.Generator) -> Sequence[Floats]:
    """Return the 24 rotations that map axes to axes, and random ones."""
    rotations = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(R) > 0:
            rotations.append(R)
    return [*rotations, *Rotation.random(_RANDOM, random_state=rng).as_matrix()]


MIN_POINTS = 30
"""Points that a scan of a target needs."""

_DRAWS = 60
_JUDGES = 400  # points of the median distance
_OF_SPHERE, _OF_PLANE = 6, 3  # points of a random surface
_MAX_POINTS = 5000  # points used of a scan
_TUKEY = 4.685
_TARGET_STEPS = 50
_TARGET_STILL = 1e-9  # m
_EXACT = 1e-9  # m; smaller residuals are rounding errors
_NO_SPHERE = "the points do not determine a sphere; the scanned surface of a target must be curved"


class TargetNotFoundError(PlannerError):
    """A scan shows no target; the message gives scan and reason."""


@dataclass(frozen=True, slots=True, eq=False)
class Target(Value):
    """A sphere or a plane in a scan.

    Attributes:
        points: (J, 3) [m]: the centre of a sphere, or four points on a plane with the mean and the spread of the
            measured points, which they represent.
        rms: root mean square distance of the inliers [m].
        used: share of inliers among the points.
        radius: of a sphere [m]; 0 for a plane.
        radius_sd: standard deviation of the radius [m]; 0 for a given radius.
    """

    points: Annotated[Floats, "_ 3"]
    rms: float
    used: float
    radius: float = 0.0
    radius_sd: float = 0.0


def fit_sphere(points: Floats, radius: float | None, rng: np.random.Generator) -> Target:
    """Fit a sphere to the points (P, 3) of a scan.

    Args:
        points: [m].
        radius: known radius [m], or None.
        rng: of the start.

    Raises:
        TargetNotFoundError: if there are too few points, or they show no sphere.
    """
    points = _thinned(points)
    origin = points.mean(axis=0)
    near = points - origin
    c, r = _least_median(near, _OF_SPHERE, _sphere_through, _distance_to_sphere, rng)
    r = r if radius is None else radius
    weight, J = np.ones(len(near)), np.empty((len(near), 4))
    for _ in range(_TARGET_STEPS):
        away = near - c
        distance = np.linalg.norm(away, axis=1)
        residual = distance - r
        weight = _tukey(residual)
        J = np.column_stack([-away / distance[:, None], -np.ones(len(near))])[:, : 3 if radius is not None else 4]
        change = np.linalg.lstsq(np.sqrt(weight)[:, None] * J, -np.sqrt(weight) * residual, rcond=None)[0]
        c = c + change[:3]
        r += 0.0 if radius is not None else float(change[3])
        if not np.isfinite(c).all() or not 0 < r < 1e3 * np.ptp(near, axis=0).max():
            raise TargetNotFoundError(_NO_SPHERE)
        if np.abs(change).max() < _TARGET_STILL:
            break
    residual = np.linalg.norm(near - c, axis=1) - r
    is_inlier = _tukey(residual) > 0
    rms = float(np.sqrt(np.mean(residual[is_inlier] ** 2)))
    if np.linalg.matrix_rank(J[is_inlier]) < J.shape[1]:
        raise TargetNotFoundError(_NO_SPHERE)
    sd = 0.0 if radius is not None else rms * float(np.sqrt(np.linalg.inv(J[is_inlier].T @ J[is_inlier])[3, 3]))
    return Target((c + origin)[None], rms, float(is_inlier.mean()), r, sd)


def fit_spheres(
    scans: Sequence[Floats], radius: float | None, rng: np.random.Generator, names: Sequence[str] = ()
) -> list[Target]:
    """Fit the same sphere in several scans; an unknown radius is common, each scan weighted by its precision.

    Raises:
        TargetNotFoundError: as `fit_sphere`, with the name of the scan.
    """
    targets = _fit_each(scans, names, lambda points: fit_sphere(points, radius, rng))
    if radius is not None:
        return targets
    weights = np.array([max(each.radius_sd, _EXACT) ** -2 for each in targets])
    common = float(weights @ [each.radius for each in targets] / weights.sum())
    sd = float(weights.sum() ** -0.5)
    return [
        replace(each, radius_sd=sd) for each in _fit_each(scans, names, lambda points: fit_sphere(points, common, rng))
    ]


def fit_planes(scans: Sequence[Floats], rng: np.random.Generator, names: Sequence[str] = ()) -> list[Target]:
    """Fit a plane in each of several scans.

    Raises:
        TargetNotFoundError: as `fit_plane`, with the name of the scan.
    """
    return _fit_each(scans, names, lambda points: fit_plane(points, rng))


def _fit_each(scans: Sequence[Floats], names: Sequence[str], fit: Callable[[Floats], Target]) -> list[Target]:
    """Fit a target in each scan; name the scan in errors."""
    targets = []
    for number, points in enumerate(scans):
        try:
            targets.append(fit(points))
        except TargetNotFoundError as error:
            raise TargetNotFoundError(f"{names[number] if names else f'scan {number + 1}'}: {error}") from error
    return targets


def fit_plane(points: Floats, rng: np.random.Generator) -> Target:
    """Fit a plane to the points (P, 3) of a scan [m].

    Raises:
        TargetNotFoundError: if there are too few points, or they lie on a line.
    """
    points = _thinned(points)
    n, d = _least_median(points, _OF_PLANE, _plane_through, lambda each, plane: each @ plane[0] - plane[1], rng)
    weight = _tukey(points @ n - d)
    spread, axes, middle = np.zeros(3), np.eye(3), points[0]
    for _ in range(_TARGET_STEPS):
        middle = weight @ points / weight.sum()
        away = points - middle
        spread, axes = np.linalg.eigh((away * weight[:, None]).T @ away / weight.sum())
        before, n = n, axes[:, 0]
        d = float(n @ middle)
        weight = _tukey(points @ n - d)
        if min(np.abs(n - before).max(), np.abs(n + before).max()) < _TARGET_STILL:
            break
    if spread[1] < 1e-4 * spread[2]:
        raise TargetNotFoundError("the points lie on a line and do not determine a plane; scan more of the target")
    residual, is_inlier = points @ n - d, weight > 0
    ends = [sign * np.sqrt(2 * spread[k]) * axes[:, k] for k in (1, 2) for sign in (-1, 1)]
    return Target(middle + np.stack(ends), float(np.sqrt(np.mean(residual[is_inlier] ** 2))), float(is_inlier.mean()))


def _thinned(points: Floats) -> Floats:
    """Return at most `_MAX_POINTS` of the points (P, 3) of a scan; refuse points that cannot show a target."""
    if len(points) < MIN_POINTS:
        raise TargetNotFoundError(
            f"{len(points)} points do not determine a target; a scan of one needs at least {MIN_POINTS}"
        )
    if np.ptp(points, axis=0).max() < _EXACT:
        raise TargetNotFoundError("the points do not determine a target; all of them coincide")
    return points[np.linspace(0, len(points) - 1, min(len(points), _MAX_POINTS)).astype(np.int64)]


Surface = tuple[Floats, float]
"""Centre (3,) and radius of a sphere, or normal (3,) and distance from the origin of a plane [m]."""


def _least_median(
    points: Floats,
    count: int,
    through: Callable[[Floats], Surface],
    distance: Callable[[Floats, Surface], Floats],
    rng: np.random.Generator,
) -> Surface:
    """Return the surface with the least median distance among surfaces through `count` random points."""
    best: tuple[float, Surface] | None = None
    judges = points[:: max(1, len(points) // _JUDGES)]
    for _ in range(_DRAWS):
        try:
            surface = through(points[rng.choice(len(points), count, replace=False)])
        except np.linalg.LinAlgError:
            continue
        median = float(np.median(np.abs(distance(judges, surface))))
        if np.isfinite(median) and (best is None or median < best[0]):
            best = median, surface
    if best is None:
        raise TargetNotFoundError("the points do not determine a target; all random subsets of them lie on a line")
    return best[1]


def _sphere_through(points: Floats) -> Surface:
    """Fit the algebraic least-squares sphere: |p|^2 = 2 c . p + (r^2 - |c|^2)."""
    A = np.column_stack([2 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)[0]
    return solution[:3], float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0)))


def _distance_to_sphere(points: Floats, sphere: Surface) -> Floats:
    return np.asarray(np.linalg.norm(points - sphere[0], axis=1) - sphere[1])


def _plane_through(points: Floats) -> Surface:
    across = np.cross(points[1] - points[0], points[2] - points[0])
    length = float(np.linalg.norm(across))
    if length == 0:
        raise np.linalg.LinAlgError
    return across / length, float(across @ points[0]) / length


def _tukey(residual: Floats) -> Floats:
    """Return Tukey's weights with the scale of the median residual."""
    scale = max(1.4826 * float(np.median(np.abs(residual))), _EXACT)
    ratio = residual / (_TUKEY * scale)
    return np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
