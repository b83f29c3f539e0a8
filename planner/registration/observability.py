"""Rigid motions that measurements do not determine, and the value of a fitted rigid motion.

Point-to-plane matching observes only motion along the normals. A plane slides on itself, a cylinder turns and slides, a
sphere turns about three axes: the 6 x 6 information matrix of the match then has small eigenvalues, and their
eigenvectors are exactly these free motions (Gelfand et al., "Geometrically stable sampling for the ICP algorithm", 3DIM
2003, doi:10.1109/IM.2003.1240258). Metres and radians; axes of the body.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np

from planner.registration.rigid import length_scale, screw_from_motion, skew
from planner.values import Floats, Value

WEAK = 2e-4
"""A motion is free when its mean square along the normals is below this share of its mean square in all directions.

The limit is 1.4 % of the motion. Normals that are wrong by 0.8 degree appear to observe that much, and a correction
from it would be mostly noise. Planes, cylinders and spheres come out below 1e-5, a head seen from one side above 7e-4.
"""

N_SIGMA = 2.0
"""A direction is determined if this number of standard deviations is within the limit (95 of 100 cases)."""

_NO_TURN = 0.1  # a free motion whose rotational part is below this share of it counts as a translation
_ENDLESS = 1e3  # lengths: the standard deviation assigned to a free motion


class FreeKind(Enum):
    """Kind of a free motion."""

    TRANSLATION = "sliding along"
    ROTATION = "turning about"
    SCREW = "screwing along"


@dataclass(frozen=True, slots=True, eq=False)
class FreeMotion(Value):
    """A rigid motion that the measurements do not observe.

    Attributes:
        kind: translation, rotation or screw.
        direction: (3,) unit vector of the translation or of the axis.
        point: (3,) a point on the axis [m]; the scan's centre for a translation.
    """

    kind: FreeKind
    direction: Annotated[Floats, "3"]
    point: Annotated[Floats, "3"]

    @property
    def sentence(self) -> str:
        """The motion in words, such as `turning about (0.00, 0.00, 1.00) through (0.0, 0.0, 12.5) mm`."""
        x, y, z = (round(float(value), 2) + 0.0 for value in self.direction)  # + 0.0 turns -0.0 into 0.0
        text = f"{self.kind.value} ({x:.2f}, {y:.2f}, {z:.2f})"
        if self.kind is FreeKind.TRANSLATION:
            return text
        a, b, c = (round(float(value) * 1e3, 1) + 0.0 for value in self.point)
        return f"{text} through ({a:.1f}, {b:.1f}, {c:.1f}) mm"


@dataclass(frozen=True, slots=True, eq=False)
class RigidFit(Value):
    """A rigid motion fitted to points, with its uncertainty.

    Attributes:
        T: (4, 4) the fitted motion [m].
        covariance: (6, 6) of (translation, rotation) about `centre` in the observed directions [m, rad]; None if the
            precision of the points is not known.
        free: (6, f) orthonormal unobserved directions, in coordinates (translation, length * rotation).
        centre: (3,) of the body [m].
        length: of the body [m].
        residuals: (N,) distances that remain [m].
        used: share of inliers among the points.
        alternatives: one sentence about each other motion that fits about as well.
        doubts: one sentence for each sign that the fit is wrong.
    """

    T: Annotated[Floats, "4 4"]
    covariance: Annotated[Floats, "6 6"] | None
    free: Annotated[Floats, "6 _"]
    centre: Annotated[Floats, "3"]
    length: float
    residuals: Annotated[Floats, "_"]
    used: float = 1.0
    alternatives: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def rms(self) -> float:
        """Root mean square of the residuals [m]; 0 without any."""
        return float(np.sqrt(np.mean(self.residuals**2))) if len(self.residuals) else 0.0

    def undetermined_motions(self, within: float) -> tuple[FreeMotion, ...]:
        """Return free motions and those whose `N_SIGMA` deviations move the body's points by more than `within` [m]."""
        return free_motions(self.undetermined_directions(within), self.centre, self.length)

    def undetermined_directions(self, within: float) -> Floats:
        """Return these motions as (6, f) orthonormal directions, in coordinates (translation, length * rotation)."""
        scale = length_scale(self.length)
        known = np.zeros((6, 6)) if self.covariance is None else self.covariance * scale[:, None] * scale
        values, vectors = np.linalg.eigh(known + (_ENDLESS * self.length) ** 2 * self.free @ self.free.T)
        return np.asarray(vectors[:, N_SIGMA * np.sqrt(np.maximum(values, 0.0)) > within])

    def determined_part(self, T: Floats, within: float) -> tuple[float, float]:
        """Return translation [m] and rotation [rad] of a motion (4, 4) along the determined directions."""
        scale, undetermined = length_scale(self.length), self.undetermined_directions(within)
        screw = scale * screw_from_motion(T, self.centre)
        part = (screw - undetermined @ (undetermined.T @ screw)) / scale
        return float(np.linalg.norm(part[:3])), float(np.linalg.norm(part[3:]))

    def worst_point_sd(self, points: Floats) -> float | None:
        """Return the largest standard deviation of (N, 3) points of the body [m], each along its worst direction.

        Free motions are excluded. None if the precision of the measured points is not known.
        """
        if self.covariance is None:
            return None
        J = np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -skew(points - self.centre)], axis=2)
        return float(np.sqrt(np.linalg.eigvalsh(J @ self.covariance @ J.transpose(0, 2, 1)).max(initial=0.0)))


def split_directions(information: Floats, weight: float, length: float) -> tuple[Floats, Floats]:
    """Separate observed from free directions.

    Args:
        information: (6, 6) of (translation [m], rotation about the scan's centre [rad]): the sum of w J^T J with
            J = (n, (p - centre) x n).
        weight: sum of the weights w.
        length: root mean square distance of the points from the centre [m].

    Returns:
        (6, r) observed and (6, 6 - r) free orthonormal directions, in coordinates (translation, length * rotation).
    """
    if not weight > 0 or not length > 0:
        return np.empty((6, 0)), np.eye(6)
    scale = np.array([1.0, 1.0, 1.0, 1 / length, 1 / length, 1 / length])
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale / weight)
    is_free = values < WEAK
    return vectors[:, ~is_free], vectors[:, is_free]


def free_motions_of_surface(points: Floats, normals: Floats) -> tuple[FreeMotion, ...]:
    """Return the motions that a piece of surface leaves free between two scans that share nothing else.

    Args:
        points: (N, 3) of the piece, evenly spread [m].
        normals: (N, 3).
    """
    if len(points) < 6:
        return free_motions(np.eye(6), np.zeros(3), 1.0)
    centre = points.mean(axis=0)
    arms = points - centre
    J = np.hstack([normals, np.cross(arms, normals)])
    length = float(np.sqrt((arms**2).sum(axis=1).mean()))
    return free_motions(split_directions(J.T @ J, float(len(points)), length)[1], centre, length)


def free_motions(free: Floats, centre: Floats, length: float) -> tuple[FreeMotion, ...]:
    """Return translations, rotations and screws that span the free directions (6, f); translations first.

    Args:
        free: from `split_directions`.
        centre: (3,) centre of the scan [m].
        length: as for `split_directions` [m].
    """
    if free.shape[1] == 0:
        return ()
    # Combinations of the free motions, from the one that turns most to those that do not turn at all.
    turns, sizes, combinations = np.linalg.svd(free[3:])
    sizes = np.concatenate([sizes, np.zeros(max(0, len(combinations) - len(sizes)))])[: len(combinations)]
    motions = free @ combinations.T
    slides = motions[:3, sizes < _NO_TURN]
    slides = np.linalg.qr(slides)[0] if slides.shape[1] else slides
    all_motions = [FreeMotion(FreeKind.TRANSLATION, _positive(slide), centre) for slide in slides.T]
    for column in np.flatnonzero(sizes >= _NO_TURN):
        axis = turns[:, column]
        shift = motions[:3, column] / sizes[column] * length  # metres a radian about `axis`
        shift = shift - slides @ (slides.T @ shift)  # the translations are free already
        pitch = float(shift @ axis)
        kind = FreeKind.SCREW if abs(pitch) > 0.1 * length else FreeKind.ROTATION
        all_motions.append(FreeMotion(kind, _positive(axis), centre + np.cross(axis, shift)))
    return tuple(all_motions)


def surface_type(motions: Sequence[FreeMotion]) -> str:
    """Return the type of surface on which exactly these motions are free, or an empty string."""
    kinds = [motion.kind for motion in motions]
    n_slides, n_turns = kinds.count(FreeKind.TRANSLATION), kinds.count(FreeKind.ROTATION)
    if n_slides + n_turns != len(kinds):
        return "a helical surface" if len(kinds) == 1 else ""
    names = {(2, 1): "a plane", (1, 1): "a cylinder", (0, 3): "a sphere", (0, 1): "a surface of revolution"}
    return {**names, (1, 0): "an extruded profile"}.get((n_slides, n_turns), "")


def describe(motions: Sequence[FreeMotion]) -> str:
    """Return undetermined motions in words: the surface type and each motion; an empty string for none."""
    shape = surface_type(motions)
    return (f"{shape}: " if shape else "") + "; ".join(motion.sentence for motion in motions)


def _positive(direction: Floats) -> Floats:
    """Return the vector or its opposite, so that the largest component is positive."""
    return direction if direction[np.argmax(np.abs(direction))] > 0 else -direction
