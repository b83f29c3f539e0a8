"""`--acquire simulated`: the virtual scanner, with noise along the rays, pose errors and a displaced part.

Rays are traced from the true pose of the scanner, and the points are transformed as if they were seen from the reported
pose. So a pose error shows in merged data as in reality: complete scans are shifted and rotated against each other, and
all scans together if the part is displaced. Noise and pose errors are normal; the part is displaced by a given distance
and angle in a random direction.

A line sensor takes one line after the other along a sweep. The driver's moves are joint-linear with exact stops, so the
simulated sweep stops at each measuring pose and reports it (`cell.scan.execution`), while a real sensor takes its lines
in passing, far closer together. The poses of these lines are interpolated between the reported ones (position linearly,
orientation about one axis), and extrapolated beyond the first and the last one by half a step, as the sweep is driven:
each cell has the same number of lines (`lines_per_step`). Two approximations remain: the arm is at rest where the real
one passes, and between two reported poses it is assumed to be on the line through them, from which the planned line
deviates by less than `planner.path.sweeps.TUBE`. Object frame, metres, radians.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from cell.errors import UsageError
from cell.runs.cell import RunCell
from cell.runs.run import SIMULATED
from cell.scan.acquisition import Acquired, Context, View
from cell.scan.as_built import as_scanned
from cell.scan.options import ScanOptions
from cell.session import Stream, random_stream
from cell.world import virtual_scan
from cell.world.virtual_scan import Scan
from planner.geometry.rigid import rigid_transform, rotation_matrices, rotation_vectors
from planner.ports import Rejection
from planner.registration.rigid import motion_from_vector, transform_points
from planner.values import Floats

LINE_STEP, LINE_ANGLE = 0.001, float(np.radians(0.25))
"""Largest distance [m] and angle [rad] between lines, up to `_ROUNDING`."""

_ROUNDING = 0.01  # share of a line: set-points are rounded, and every view of a plan should have as many lines


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Standard deviation of each error; 0 disables it.

    Attributes:
        range_noise: along the ray [m].
        position: of the scanner's origin, along each axis [m].
        rotation: of the scanner, about each of its axes [rad].
        by_model: whether noise along the ray by the scanner's sigma model is added.
        part: (4, 4) motion from the planned to the true placement of the part, object frame; None if not displaced.
    """

    range_noise: float = 0.0
    position: float = 0.0
    rotation: float = 0.0
    by_model: bool = False
    part: Floats | None = None

    @classmethod
    def from_options(cls, options: ScanOptions, centre: Floats, rng: np.random.Generator) -> Self:
        """Return the errors of an execution.

        Args:
            options: of the execution.
            centre: (3,) of the part, about which it is rotated [m], object frame.
            rng: of the direction in which the part is displaced.
        """
        rotation, part = float(np.radians(options.pose_error_deg)), None
        if options.search_range is not None:
            axes = rng.standard_normal((2, 3))
            sizes = np.array(options.search_range) / np.linalg.norm(axes, axis=1)
            part = motion_from_vector((sizes[:, None] * axes).ravel(), centre)
        by_model = options.noise == "model"
        return cls(options.range_noise_mm / 1000, options.pose_error_mm / 1000, rotation, by_model, part)

    @property
    def moves_pose(self) -> bool:
        """Whether the true pose differs from the reported one."""
        return self.position > 0 or self.rotation > 0 or self.part is not None

    def true_pose(self, T_reported: Floats, rng: np.random.Generator) -> Floats:
        """Return the true pose (4, 4) for a reported pose; the same object without a pose error."""
        if not self.moves_pose:
            return T_reported
        position, rotation = (sd * rng.standard_normal(3) for sd in (self.position, self.rotation))
        T: Floats = T_reported @ rigid_transform(rotation_from_vector(rotation), position)
        return T if self.part is None else np.linalg.inv(self.part) @ T

    def reported_points(
        self,
        points: Floats,
        T_true: Floats,
        T_reported: Floats,
        source: Floats,
        rng: np.random.Generator,
        sigma: Floats | None = None,
    ) -> Floats:
        """Return the points with noise along their rays, transformed from the true to the reported pose.

        Args:
            points: (P, 3) intersections of the rays with the part [m], object frame.
            T_true: (4, 4) pose from which the rays were traced [m].
            T_reported: (4, 4) pose that the controller reports [m].
            source: (3,) origin of the rays [m], scanner frame.
            rng: of the noise.
            sigma: (P,) standard deviation of each point along its ray by the scanner's model [m]; for `by_model`.
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
        return transform_points(T_reported @ np.linalg.inv(T_true), points)


def rotation_from_vector(vector: Floats) -> Floats:
    """Return the rotation (3, 3) about a vector (3,) by its length [rad] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R: Floats = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    return R


class Simulated:
    """Points of the virtual scanner in a cell.

    Args:
        cell: part, occluders and scanner.
        disturbance: noise and errors of the pose.
        seed: of the disturbance.
    """

    source = SIMULATED

    def __init__(self, cell: RunCell, disturbance: Disturbance, seed: int) -> None:
        if disturbance.part is not None:  # objects that do not support the part stay in place
            cell = cell.about_part(np.asarray(np.linalg.inv(disturbance.part), dtype=np.float64))
        self._cell, self._disturbance, self._seed = cell, disturbance, seed

    def take(self, view: View) -> Acquired:
        """Trace the rays of a view.

        Each view has its own random stream, so its errors are the same when it is scanned alone.
        """
        pose_seed = [self._seed, int(Stream.POSE_DISTURBANCE), view.stop]
        noise = random_stream(self._seed, Stream.RANGE_NOISE, view.stop)
        T_true, points, scans = simulate_scan(view.T_object_scanner, self._cell, self._disturbance, pose_seed, noise)
        rays = len(scans[0].codes)
        rows, columns = scans[0].grid_shape
        codes = np.concatenate([scan.codes for scan in scans])
        arrays = {
            "T_object_scanner_true": T_true[view.middle],
            "face": np.concatenate([scan.face for scan in scans]),
            "pixel": np.concatenate([scan.pixel + np.int32(line * rays) for line, scan in enumerate(scans)]),
            "grid_shape": np.array([rows * len(scans), columns], dtype=np.int64),
            "codes": codes,
            "counts": np.bincount(codes, minlength=len(Rejection)),
        }
        if len(T_true) > 1:
            arrays["sweep_T_object_scanner_true"] = T_true[view.order]
        return Acquired(points, "object", arrays)


def simulated(argument: str, context: Context) -> Simulated:
    """Make the virtual scanner; the entry point of `--acquire simulated`.

    Raises:
        UsageError: if there is an argument.
    """
    if argument:
        raise UsageError(
            "--acquire simulated takes no argument; its errors are --range-noise, --pose-error and --setup-error"
        )
    scene = context.cell.scene
    # Each placement has its own random stream, so a turned part is displaced in another direction.
    rng = random_stream(context.seed, Stream.PART_DISTURBANCE, zlib.crc32(scene.T_base_object.tobytes()))
    options = ScanOptions.from_manifest(context.options)
    errors = Disturbance.from_options(options, scene.T_object_centre[:3, 3], rng)
    return Simulated(as_scanned(context.cell, context.options), errors, context.seed)


def lines_per_step(T: Floats) -> int:
    """Return the number of lines in each cell of a sweep of (K, 4, 4) poses; 1 for a view at rest."""
    if len(T) < 2:
        return 1
    step = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).max()
    turn = np.linalg.norm(rotation_vectors(T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], 1, 2)), axis=1).max()
    return max(1, int(np.ceil(max(step / LINE_STEP, turn / LINE_ANGLE) - _ROUNDING)))


def line_poses(T: Floats, each: int) -> Floats:
    """Return the poses (K * each, 4, 4) of the lines of a sweep with `each` lines in a cell.

    `T` (K, 4, 4) are the measuring poses in driving order [m].
    """
    count = len(T)
    if count < 2:
        return np.repeat(T, each, axis=0)
    place = (np.arange(count * each) + 0.5) / each - 0.5  # in steps; the measuring poses are at whole numbers
    low = np.clip(np.floor(place).astype(int), 0, count - 2)
    share = (place - low)[:, None]
    turn = rotation_vectors(T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], 1, 2))
    poses: Floats = T[low].copy()
    poses[:, :3, 3] += share * (T[low + 1, :3, 3] - T[low, :3, 3])
    poses[:, :3, :3] = rotation_matrices(share * turn[low], scale_first=True) @ poses[:, :3, :3]
    return poses


def simulate_scan(
    T_reported: Floats, cell: RunCell, disturbance: Disturbance, pose_seed: Sequence[int], noise: np.random.Generator
) -> tuple[Floats, Floats, list[Scan]]:
    """Scan from one pose or along a sweep, which has one pose error for all its lines.

    Args:
        T_reported: (K, 4, 4) poses that the controller reports, in driving order [m].
        cell: part, occluders and scanner.
        disturbance: noise and pose error.
        pose_seed: of the pose error.
        noise: random generator of the points.

    Returns:
        (K, 4, 4) true poses [m], (P, 3) reported points [m], and the scans of all lines.
    """

    def true_pose(T: Floats) -> Floats:
        return disturbance.true_pose(T, np.random.default_rng(list(pose_seed)))

    lines = T_reported if len(T_reported) == 1 else line_poses(T_reported, lines_per_step(T_reported))
    points, scans = [np.empty((0, 3))], []
    for T in lines:
        T_true = true_pose(T)
        scan = virtual_scan.scan(cell.scanner, T_true, cell.part_caster, cell.reference, cell.occluder_caster)
        sigma = scan.sigma(cell.scanner, cell.reference) if disturbance.by_model else None
        points.append(disturbance.reported_points(scan.points, T_true, T, cell.scanner.source, noise, sigma))
        scans.append(scan)
    return np.stack([true_pose(T) for T in T_reported]), np.concatenate(points), scans
