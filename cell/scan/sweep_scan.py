"""What a line sensor sees on its way along a sweep: one line after the other, from poses between the reported ones.

The driver's moves are joint-linear with exact stops, so the simulated sweep stops at each measuring pose and reports
where it stands (`cell.scan.execute`). A real sensor takes its lines in passing, far closer together. The poses of
these lines are interpolated between the reported ones (position linearly, orientation about one axis), and beyond the
first and the last one by half a step, as the sweep is driven: `lines_between` of them share each cell equally.

What is approximated: the arm stands where the real one passes; between two reported poses it is taken to be on the line
through them, from which the planned one is off by less than `planner.path.sweeps.TUBE`. Object frame, metres.
"""

from collections.abc import Sequence

import numpy as np

from cell.runs.cell import RunCell
from cell.scan.pose_error import Disturbance
from cell.world import virtual_scan
from cell.world.virtual_scan import Scan
from planner.geometry.rigid import rotation_matrices, rotation_vectors
from planner.values import Floats

LINE_STEP, LINE_ANGLE = 0.001, float(np.radians(0.25))
"""Lines are at most so far apart [m] and turned against each other by at most so much [rad], up to `_ROUNDING`."""

_ROUNDING = 0.01  # share of a line: set-points are rounded, and every view of a plan should have as many lines


def lines_between(T: Floats) -> int:
    """Lines in each cell of a sweep of (K, 4, 4) poses."""
    if len(T) < 2:
        return 1
    step = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).max()
    turn = np.linalg.norm(rotation_vectors(T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], 1, 2)), axis=1).max()
    return max(1, int(np.ceil(max(step / LINE_STEP, turn / LINE_ANGLE) - _ROUNDING)))


def line_poses(T: Floats, each: int) -> Floats:
    """(K * each, 4, 4) poses of the lines of a sweep.

    Args:
        T: (K, 4, 4) measuring poses, in the order in which they were taken [m].
        each: lines in each cell.
    """
    count = len(T)
    if count < 2:
        return np.repeat(T, each, axis=0)
    place = (np.arange(count * each) + 0.5) / each - 0.5  # in steps; the poses stand at whole numbers
    low = np.clip(np.floor(place).astype(int), 0, count - 2)
    share = (place - low)[:, None]
    turn = rotation_vectors(T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], 1, 2))
    poses: Floats = T[low].copy()
    poses[:, :3, 3] += share * (T[low + 1, :3, 3] - T[low, :3, 3])
    poses[:, :3, :3] = rotation_matrices(share * turn[low], scale_first=True) @ poses[:, :3, :3]
    return poses


def scan_of(
    T_reported: Floats, cell: RunCell, disturbance: Disturbance, pose_seed: Sequence[int], noise: np.random.Generator
) -> tuple[Floats, Floats, list[Scan]]:
    """Scan from one pose, or along a sweep.

    The error of the pose is one of the whole sweep: its lines do not scatter against each other.

    Args:
        T_reported: (K, 4, 4) poses that the controller reports, in driving order [m].
        cell: part, surroundings and scanner.
        disturbance: noise and pose error.
        pose_seed: of the pose error.
        noise: randomness of the points.

    Returns:
        (K, 4, 4) true poses [m], (P, 3) points as the data tell them [m], and the scans of all lines.
    """

    def true_of(T: Floats) -> Floats:
        return disturbance.true_pose(T, np.random.default_rng(list(pose_seed)))

    lines = T_reported if len(T_reported) == 1 else line_poses(T_reported, lines_between(T_reported))
    points, scans = [np.empty((0, 3))], []
    for T in lines:
        T_true = true_of(T)
        seen = virtual_scan.scan(cell.scanner, T_true, cell.part_caster, cell.reference, cell.occluder_caster)
        sigma = seen.sigma(cell.scanner, cell.reference) if disturbance.by_model else None
        points.append(disturbance.as_reported(seen.points, T_true, T, cell.scanner.source, noise, sigma))
        scans.append(seen)
    return np.stack([true_of(T) for T in T_reported]), np.concatenate(points), scans
