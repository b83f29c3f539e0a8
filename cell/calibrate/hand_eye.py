"""The mount (flange to scanner) from one target that was scanned from several poses of the flange.

Of a sphere, every scan sees the centre s_i; of a plane, points q_ij on it. With the flange at T_i and the mount X

    sphere:  T_i X s_i = c          plane:  n . (T_i X q_ij) = d

where c, or n and d, are where the target stands in base: not known, and solved for with X (nine unknowns). Least
squares by Gauss and Newton from many beginnings, because the scanner may sit in any way; in the end weighted by what
errors of the flange's pose do to each residual: an error of its rotation moves a point across its lever, not along it.

Which motions of the mount the set of poses does not show follows from the information that is left for X when the
target is eliminated (the Schur complement), named as for registration (`cell.reconstruction.freedom`). They stay as
the beginning had them. Metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Annotated

import numpy as np

from cell.errors import UsageError
from cell.reconstruction.freedom import split
from cell.reconstruction.rigid import RigidFit, covariance_of, hat, motion_of, screw_of
from planner.values import Floats, Value

FEWEST = 5
"""Scans: each gives three conditions for nine unknowns, and three scans are met exactly by several mounts."""

_FIRST, _STEPS = 10, 60
_PROMISING = 4  # beginnings that go on
_LARGEST = 0.5  # rad; a step that turns farther is shortened
_STILL = 1e-12
_ROUNDING = 1e-9
_AS_GOOD = 4.0  # times the sum of squares: another mount that fits about as well
_SAME = 0.02  # of the distance to the target: mounts no farther apart are one
_RANDOM = 24  # beginnings beside those along the axes
_FLOOR = 1e-5  # m; what points leave of a target's place at best


@dataclass(frozen=True, slots=True)
class PoseError:
    """Standard deviation of the flange's pose about what the controller says.

    Attributes:
        position: along each axis [m].
        rotation: about each axis [rad].
    """

    position: float = 3e-5
    rotation: float = float(np.radians(0.02))


@dataclass(frozen=True, slots=True, eq=False)
class Observed(Value):
    """What the scans see of the target.

    Attributes:
        T_base_flange: (K, 4, 4) [m].
        points: (K, J, 3) points of the target in each scan, scanner frame [m]: the centre of a sphere, or four of a
            plane.
        plane: whether it is a plane.
    """

    T_base_flange: Annotated[Floats, "K 4 4"]
    points: Annotated[Floats, "K _ 3"]
    plane: bool


def solve(seen: Observed, error: PoseError, rng: np.random.Generator) -> RigidFit:
    """T_flange_scanner, with its covariance about the scanner's origin in the axes of the flange.

    Args:
        seen: the target in each scan.
        error: of the flange's poses; only the ratio of the two counts, their size is taken from what is left over.
        rng: of the beginnings.

    Returns:
        The mount; residuals are one distance a scan.

    Raises:
        UsageError: if there are too few scans.
    """
    count = len(seen.points)
    if count < FEWEST:
        raise UsageError(f"{count} scans say no mount; give at least {FEWEST}, from flange poses that are turned about")
    length = float(np.sqrt((seen.points**2).sum(axis=2).mean()))
    began = []
    for R in _beginnings(rng):
        T = np.eye(4)
        T[:3, :3] = R
        began.append(_descended(seen, T, length, _FIRST))
    ended = [_descended(seen, T, length, _STEPS) for _, T in sorted(began, key=_cost)[:_PROMISING]]
    ended = sorted((_descended(seen, T, length, _STEPS, error) for _, T in ended), key=_cost)
    T = ended[0][1]
    plain, at = _linearised(seen, T), _linearised(seen, T, error)
    directions, free = split(plain.information, plain.weight, length)
    surplus = 3 * count - 3 - directions.shape[1]
    variance = float(at.left @ at.left) / surplus if surplus > 0 else None
    covariance = None if variance is None else variance * covariance_of(at.information, directions, length)
    residuals = np.sqrt((plain.left.reshape(count, -1) ** 2).sum(axis=1) / (4 if seen.plane else 1))
    return RigidFit(T, covariance, free, T[:3, 3], length, residuals, rivals=_rivals(ended, free, length))


def _rivals(ended: Sequence[tuple[float, Floats]], free: Floats, length: float) -> tuple[str, ...]:
    """Sentences about other mounts that fit about as well and are not the first one moved along what is free."""
    (least, T), *others = ended
    seen = np.eye(6) - free @ free.T
    found = []
    for cost, other in others:
        change = screw_of(other @ np.linalg.inv(T), T[:3, 3])
        apart = np.linalg.norm(seen @ (change * [1.0, 1.0, 1.0, length, length, length]))
        if cost < _AS_GOOD * max(least, 1.0) and apart > _SAME * length:
            position = ", ".join(f"{1000 * value:.1f}" for value in other[:3, 3])
            found.append(f"a mount at {position} mm fits about as well; take more scans")
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True, slots=True, eq=False)
class _Equations(Value):
    """The linear least-squares problem at a mount, the target where it then fits best.

    Attributes:
        left: (M,) residuals, in metres or in standard deviations.
        information: (6, 6) for a small motion (translation, rotation) about the scanner's origin, axes of the flange.
        slope: (6,) the gradient.
        weight: of all residuals.
    """

    left: Annotated[Floats, "_"]
    information: Annotated[Floats, "6 6"]
    slope: Annotated[Floats, "6"]
    weight: float


def _linearised(seen: Observed, T: Floats, error: PoseError | None = None) -> _Equations:
    """The problem at a mount (4, 4); with an error of the poses, in its standard deviations."""
    R, t = seen.T_base_flange[:, None, :3, :3], seen.T_base_flange[:, None, :3, 3]
    turned = seen.points @ T[:3, :3].T
    arm = turned + T[:3, 3]
    there = (R @ arm[..., None])[..., 0] + t
    left = there - there.mean(axis=(0, 1))
    R = np.broadcast_to(R, (*turned.shape, 3))
    of_mount, of_flange = (np.concatenate([R, -R @ hat(lever)], axis=-1) for lever in (turned, arm))
    count = len(left)
    if seen.plane:
        axes = np.linalg.svd(left.reshape(-1, 3), full_matrices=False)[2]
        of_target = np.concatenate([left @ axes[:2].T, -np.ones((*left.shape[:2], 1))], axis=-1)
        left, of_mount, of_flange = (
            np.einsum("a,kja...->kj...", axes[2], each) for each in (left, of_mount, of_flange)
        )
    else:
        of_target = np.broadcast_to(-np.eye(3), (*left.shape, 3))
    left, of_mount, of_target, of_flange = (
        each.reshape(count, -1, *each.shape[3 - seen.plane :]) for each in (left, of_mount, of_target, of_flange)
    )
    if error is not None:
        sd = np.array([*[error.position] * 3, *[error.rotation] * 3])
        spread = (of_flange * sd**2) @ of_flange.transpose(0, 2, 1) + _FLOOR**2 * np.eye(left.shape[1])
        whiten = np.linalg.inv(np.linalg.cholesky(spread))
        left, of_mount, of_target = (whiten @ left[..., None])[..., 0], whiten @ of_mount, whiten @ of_target
    left, of_mount, of_target = left.reshape(-1), of_mount.reshape(-1, 6), of_target.reshape(-1, 3)
    through = np.eye(len(left)) - of_target @ np.linalg.pinv(of_target, rcond=_ROUNDING)
    left, of_mount_left = through @ left, through @ of_mount
    return _Equations(left, of_mount_left.T @ of_mount_left, of_mount_left.T @ left, float(len(left)))


def _descended(
    seen: Observed, T: Floats, length: float, steps: int, error: PoseError | None = None
) -> tuple[float, Floats]:
    """Sum of squares and mount (4, 4) to which Gauss and Newton come from a mount, in the directions that are seen."""
    for _ in range(steps):
        at = plain = _linearised(seen, T)
        if error is not None:
            at = _linearised(seen, T, error)
        directions, _ = split(plain.information, plain.weight, length)
        change = -covariance_of(at.information, directions, length) @ at.slope
        change /= max(1.0, float(np.abs(change[3:]).max()) / _LARGEST)
        T = motion_of(change, T[:3, 3]) @ T
        if np.abs(change).max() < _STILL:
            break
    return float((_linearised(seen, T, error).left ** 2).sum()), T


def _cost(ended: tuple[float, Floats]) -> float:
    return ended[0]


def _beginnings(rng: np.random.Generator) -> Sequence[Floats]:
    """Rotations: the 24 that map axes to axes, and random ones."""
    from scipy.spatial.transform import Rotation

    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(R) > 0:
            found.append(R)
    return [*found, *Rotation.random(_RANDOM, random_state=rng).as_matrix()]
