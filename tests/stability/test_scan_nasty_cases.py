"""Scans at which the chain from rays to surface may fail: all rays grazing, nearly grazing, thin sheets."""

import numpy as np
import pytest

from cell.metrology.reconstruct import ReconstructionStatus, reconstruct
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import Scan, scan
from planner.geometry.mesh import TriangleMesh
from planner.ports import Rejection
from planner.registration.cloud import ScanCloud, merge
from planner.registration.registration import RegistrationStatus, register

PLATE = TriangleMesh(
    np.array([[-0.05, -0.05, 0.0], [0.05, -0.05, 0.0], [0.05, 0.05, 0.0], [-0.05, 0.05, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)


def _aslant(angle_deg: float) -> Scan:
    """Return a scan of the plate from 300 mm at this angle to its normal, with the baseline along y."""
    angle = np.radians(angle_deg)
    out = np.array([np.sin(angle), 0.0, np.cos(angle)])
    x = np.array([0.0, 1.0, 0.0])
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(-out, x), -out], axis=1)
    T[:3, 3] = 0.3 * out
    caster = EmbreeRayCaster(PLATE.vertices, PLATE.faces)
    return scan(LaserArea(fov_deg=(20.0, 20.0), resolution_deg=(0.2, 0.2)), T, caster, PLATE)


def test_a_scan_of_which_all_rays_graze_is_empty_and_stays_harmless() -> None:
    """At 87 degrees all rays are rejected as grazing, and registration and reconstruction report too few points."""
    seen = _aslant(87.0)
    met = seen.hit_face >= 0
    assert met.sum() > 50
    assert (seen.codes[met] == Rejection.GRAZING_SOURCE).all()
    cloud = ScanCloud(seen.points, seen.T_object_scanner[:3, 3])
    assert len(cloud) == 0
    assert register([cloud], PLATE).scans[0].status is RegistrationStatus.EMPTY
    assert reconstruct(merge([cloud])).status is ReconstructionStatus.TOO_FEW_POINTS


@pytest.mark.parametrize("angle_deg", [60.0, 72.0])
def test_a_surface_from_nearly_grazing_rays_is_flat_and_its_normals_face_the_scanner(angle_deg: float) -> None:
    """With rows several spacings apart, all vertices are on the plate and all normals are within one degree."""
    seen = _aslant(angle_deg)
    cloud = merge([ScanCloud(seen.points, seen.T_object_scanner[:3, 3])])
    assert len(cloud) > 200
    assert cloud.normals[:, 2].min() > np.cos(np.radians(1.0))
    mesh = reconstruct(cloud).mesh
    assert mesh is not None
    assert np.abs(mesh.vertices[:, 2]).max() < 1e-6


def _sheet(side: float) -> ScanCloud:
    """Return one face of a rippled sheet of 0.3 mm, seen from its side (+1 or -1); points 0.8 mm apart."""
    steps = (np.arange(50) - 24.5) * 0.8e-3
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    middle = 0.002 * np.sin(x / 0.004) * np.cos(y / 0.005)
    return ScanCloud(np.stack([x, y, middle + side * 0.15e-3], axis=1), np.array([0.0, 0.0, side * 0.3]))


def test_the_two_faces_of_a_thin_sheet_are_not_matched_to_each_other() -> None:
    """Scans of both sides, 0.3 mm apart, form no pair and keep their pose."""
    result = register([_sheet(1.0), _sheet(-1.0)], None)
    assert result.overlaps == ()
    assert all(one.status is RegistrationStatus.NO_OVERLAP for one in result.scans)
    assert all(one.T_correction.tobytes() == np.eye(4).tobytes() for one in result.scans)


@pytest.mark.parametrize(
    ("off_mm", "status"), [(0.1, RegistrationStatus.CONVERGED), (0.25, RegistrationStatus.NO_OVERLAP)]
)
def test_a_thin_sheet_is_registered_up_to_half_its_thickness(off_mm: float, status: RegistrationStatus) -> None:
    """A scan nearer to its own face is corrected to 10 micrometres, and one nearer to the other face keeps its pose."""
    n = 161
    steps = np.linspace(-0.025, 0.025, n)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (index[i : i + n - 1, j : j + n - 1].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    up = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    middle = 0.002 * np.sin(x / 0.004) * np.cos(y / 0.005)
    faces = [np.stack([x, y, middle + side * 0.15e-3], axis=1) for side in (1.0, -1.0)]
    model = TriangleMesh(np.concatenate(faces), np.concatenate([up, up[:, ::-1] + n * n]))
    exact = [_sheet(1.0), _sheet(-1.0)]
    inward = [np.array([0.0, 0.0, -np.sign(s.sensor[2]) * off_mm * 1e-3]) for s in exact]
    moved = [ScanCloud(s.points + shift, s.sensor) for s, shift in zip(exact, inward, strict=True)]
    for before, original, one in zip(moved, exact, register(moved, model).scans, strict=True):
        assert one.status is status
        error = np.linalg.norm(before.transformed(one.T_correction).points - original.points, axis=1).max()
        assert error < (10e-6 if status is RegistrationStatus.CONVERGED else off_mm * 1.001e-3)
