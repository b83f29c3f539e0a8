"""Which rigid motions of a scan its measurements cannot see, and what they are called.

Point-to-plane matching sees only what moves along the normals. A plane slides on itself, a cylinder turns and slides, a
sphere turns three ways: the 6x6 information matrix of the match then has small eigenvalues, and their eigenvectors are
exactly these motions (Gelfand et al., "Geometrically stable sampling for the ICP algorithm", 3DIM 2003,
doi:10.1109/IM.2003.1240258). Object frame, metres and radians.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np

from planner.values import Floats, Value

WEAK = 2e-4
"""A motion is free when its mean square along the normals is below this share of its mean square in all directions.

That is 1.4 % of the motion, as much as normals that are wrong by 0.8 degree pretend: a correction found from it would
be mostly noise. Planes, cylinders and spheres come out below 1e-5, a head seen from one side above 7e-4.
"""

_NO_TURN = 0.1  # a free motion whose turning part is below this share of it counts as a translation


class FreeKind(Enum):
    """What a free motion is."""

    TRANSLATION = "sliding along"
    ROTATION = "turning about"
    SCREW = "screwing along"


@dataclass(frozen=True, slots=True, eq=False)
class FreeMotion(Value):
    """A rigid motion that the measurements do not see.

    Attributes:
        kind: translation, rotation or screw.
        direction: (3,) unit vector of the translation or of the axis, object frame.
        point: (3,) a point on the axis [m], object frame; the scan's centre for a translation.
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


def split(information: Floats, weight: float, length: float) -> tuple[Floats, Floats]:
    """Directions that are seen and directions that are free.

    Args:
        information: (6, 6) of (translation [m], rotation about the scan's centre [rad]): the sum of w J^T J with
            J = (n, (p - centre) x n).
        weight: sum of the weights w.
        length: root mean square distance of the points from the centre [m]; makes turns comparable with translations.

    Returns:
        (6, r) seen and (6, 6 - r) free orthonormal directions, in coordinates (translation, length * rotation).
    """
    if not weight > 0 or not length > 0:
        return np.empty((6, 0)), np.eye(6)
    scale = np.array([1.0, 1.0, 1.0, 1 / length, 1 / length, 1 / length])
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale / weight)
    is_free = values < WEAK
    return vectors[:, ~is_free], vectors[:, is_free]


def of_surface(points: Floats, normals: Floats) -> tuple[FreeMotion, ...]:
    """Motions that a piece of surface does not show, so that they stay open where two scans share it alone.

    Args:
        points: (N, 3) of it, evenly spread [m].
        normals: (N, 3).
    """
    if len(points) < 6:
        return name(np.eye(6), np.zeros(3), 1.0)
    centre = points.mean(axis=0)
    arms = points - centre
    J = np.hstack([normals, np.cross(arms, normals)])
    length = float(np.sqrt((arms**2).sum(axis=1).mean()))
    return name(split(J.T @ J, float(len(points)), length)[1], centre, length)


def name(free: Floats, centre: Floats, length: float) -> tuple[FreeMotion, ...]:
    """Translations, rotations and screws that span the free directions; translations first.

    Args:
        free: (6, f) from `split`.
        centre: (3,) centre of the scan [m], object frame.
        length: as for `split` [m].
    """
    if free.shape[1] == 0:
        return ()
    # Combinations of the free motions, from the one that turns most to those that do not turn at all.
    turns, sizes, combinations = np.linalg.svd(free[3:])
    sizes = np.concatenate([sizes, np.zeros(max(0, len(combinations) - len(sizes)))])[: len(combinations)]
    motions = free @ combinations.T
    slides = motions[:3, sizes < _NO_TURN]
    slides = np.linalg.qr(slides)[0] if slides.shape[1] else slides
    found = [FreeMotion(FreeKind.TRANSLATION, _positive(slide), centre) for slide in slides.T]
    for column in np.flatnonzero(sizes >= _NO_TURN):
        axis = turns[:, column]
        shift = motions[:3, column] / sizes[column] * length  # metres a radian about `axis`
        shift = shift - slides @ (slides.T @ shift)  # sliding is free anyhow
        pitch = float(shift @ axis)
        kind = FreeKind.SCREW if abs(pitch) > 0.1 * length else FreeKind.ROTATION
        found.append(FreeMotion(kind, _positive(axis), centre + np.cross(axis, shift)))
    return tuple(found)


def shape_of(motions: tuple[FreeMotion, ...]) -> str:
    """The surface on which just these motions are free, or an empty string."""
    kinds = [motion.kind for motion in motions]
    n_slides, n_turns = kinds.count(FreeKind.TRANSLATION), kinds.count(FreeKind.ROTATION)
    if n_slides + n_turns != len(kinds):
        return "a helical surface" if len(kinds) == 1 else ""
    names = {(2, 1): "a plane", (1, 1): "a cylinder", (0, 3): "a sphere", (0, 1): "a surface of revolution"}
    return {**names, (1, 0): "an extruded profile"}.get((n_slides, n_turns), "")


def _positive(direction: Floats) -> Floats:
    """The vector or its opposite, so that the largest component is positive."""
    return direction if direction[np.argmax(np.abs(direction))] > 0 else -direction
