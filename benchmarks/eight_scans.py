"""Eight virtual scans around a part, with optional noise, for measurements of reconstruction and registration."""

import numpy as np

from cell.part.workpiece import Workpiece
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import scan
from planner.registration.cloud import ScanCloud

STANDOFF = 0.3
"""Of the scanner from the part's middle [m]."""

DIRECTIONS = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 1, 1), (-1, -1, -1))


def eight_scans(part: Workpiece, resolution_deg: float) -> list[ScanCloud]:
    """Return exact scans from `STANDOFF` beyond the middle of the part, along `DIRECTIONS`.

    Args:
        part: the scanned part.
        resolution_deg: angle between rays [deg].
    """
    caster = EmbreeRayCaster(part.reference.vertices, part.reference.faces)
    scanner = LaserArea(resolution_deg=(resolution_deg, resolution_deg))
    clouds = []
    for direction in DIRECTIONS:
        out = np.array(direction, dtype=float) / np.linalg.norm(direction)
        across = np.cross([0.0, 0.0, 1.0], -out) if abs(out[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        T = np.eye(4)
        T[:3, :3] = np.stack([across, np.cross(-out, across), -out], axis=1)
        T[:3, 3] = part.centre + STANDOFF * out
        clouds.append(ScanCloud(scan(scanner, T, caster, part.reference).points, T[:3, 3]))
    return clouds


def noisy(scans: list[ScanCloud], sigma: float) -> list[ScanCloud]:
    """Return the scans with normal noise along their rays, with a fixed seed.

    Args:
        scans: exact scans.
        sigma: standard deviation of the noise [m].
    """
    rng = np.random.default_rng(0)
    disturbed = []
    for cloud in scans:
        rays = cloud.points - cloud.sensor
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        disturbed.append(ScanCloud(cloud.points + rng.normal(0, 1, (len(rays), 1)) * sigma * rays, cloud.sensor))
    return disturbed
