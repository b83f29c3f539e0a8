"""What an execution is off by, seeded: noise along the rays, errors of the executed poses, a part off its place.

Noise and pose errors are normal; the part is off by a given distance and angle, in a direction that is drawn.

The rays are traced from where the scanner really is; the data are told as seen from where the controller says it is.
So a pose error shows in merged data as it would in reality: whole scans are shifted and turned against each other,
and of a part that stands off its place all of them together.
Metres and radians inside.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from cell.scan.options import ScanOptions
from planner.registration.rigid import motion_from_vector
from planner.values import Floats


@dataclass(frozen=True, slots=True)
class Disturbance:
    """One sigma of each error; 0 switches it off.

    Attributes:
        range_noise: along the ray [m].
        position: of the scanner's origin, along each axis [m].
        rotation: of the scanner, about each of its axes [rad].
        by_model: draw noise along the ray by the scanner's own sigma as well.
        part: (4, 4) motion from where the part should stand to where it does, object frame; None where it does.
    """

    range_noise: float = 0.0
    position: float = 0.0
    rotation: float = 0.0
    by_model: bool = False
    part: Floats | None = None

    @classmethod
    def of(cls, options: ScanOptions, centre: Floats, rng: np.random.Generator) -> Self:
        """The errors that were asked for.

        Args:
            options: of the execution.
            centre: (3,) of the part, about which it is turned [m], object frame.
            rng: says in which direction the part is off.
        """
        rotation, part = float(np.radians(options.pose_error_deg)), None
        if options.search is not None:
            axes = rng.standard_normal((2, 3))
            sizes = np.array(options.search) / np.linalg.norm(axes, axis=1)
            part = motion_from_vector((sizes[:, None] * axes).ravel(), centre)
        return cls(
            options.range_noise_mm / 1000, options.pose_error_mm / 1000, rotation, options.noise == "model", part
        )

    @property
    def moves_pose(self) -> bool:
        """Whether the executed pose differs from the reported one."""
        return self.position > 0 or self.rotation > 0 or self.part is not None

    def true_pose(self, T_reported: Floats, rng: np.random.Generator) -> Floats:
        """(4, 4) where the scanner really is, given (4, 4) where it says it is; the very same without a pose error."""
        if not self.moves_pose:
            return T_reported
        off = np.eye(4)
        off[:3, 3] = self.position * rng.standard_normal(3)
        off[:3, :3] = rotation(self.rotation * rng.standard_normal(3))
        T: Floats = T_reported @ off
        return T if self.part is None else np.linalg.inv(self.part) @ T

    def as_reported(
        self,
        points: Floats,
        T_true: Floats,
        T_reported: Floats,
        source: Floats,
        rng: np.random.Generator,
        sigma: Floats | None = None,
    ) -> Floats:
        """Points as the data tell them: with noise along their rays, and seen from the reported pose.

        Args:
            points: (P, 3) where the rays met the part [m], object frame.
            T_true: (4, 4) pose from which they were traced [m].
            T_reported: (4, 4) pose that the controller reports [m].
            source: (3,) where the rays begin [m], scanner frame.
            rng: source of randomness.
            sigma: (P,) one sigma of each point along its ray by the scanner's model [m]; only for `by_model`.

        Returns:
            (P, 3) [m], object frame; the very same points without noise and pose error.
        """
        spread = np.full(len(points), self.range_noise)
        if self.by_model and sigma is not None:
            spread = np.hypot(spread, sigma)
        if (spread > 0).any():
            origin = T_true[:3, :3] @ source + T_true[:3, 3]
            rays = points - origin
            rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
            points = points + (spread * rng.standard_normal(len(points)))[:, None] * rays
        if T_true is T_reported:
            return points
        T = T_reported @ np.linalg.inv(T_true)
        moved: Floats = points @ T[:3, :3].T + T[:3, 3]
        return moved


def rotation(vector: Floats) -> Floats:
    """(3, 3) rotation about a vector (3,) by its length [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R: Floats = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    return R
