"""Difficult parts viewed from all sides without an arm: the known space and the believed surface."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from cell import scanners
from cell.explore import belief
from cell.explore.frustum import SensorFrustum
from cell.part import workpiece
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner.explore.space import FREE, OCCUPIED, UNKNOWN, VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats
from planner.viewpoints.viewpoints import aim_viewpoints

RADIUS, HEIGHT, EDGE, SPACING = 0.05, 0.08, 0.0015, 0.0015
NEAR, FAR = 0.05, 0.2
CLEARANCE = 0.01

_SCANNER = scanners.make(
    "laser-area",
    {
        "fov_deg": (60.0, 60.0), "resolution_deg": (0.5, 0.5), "range_mm": (1000 * NEAR, 1000 * FAR),
        "baseline_mm": 25.0, "grazing_max_deg": 75.0, "sensor_grazing_max_deg": 75.0,
    },
)  # fmt: skip


def _mesh(*parts: trimesh.Trimesh) -> TriangleMesh:
    whole = trimesh.util.concatenate(list(parts))
    return TriangleMesh(np.asarray(whole.vertices, dtype=np.float64), np.asarray(whole.faces, dtype=np.int32))


def _ball(x: float, radius: float = 0.015) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(3, radius)
    ball.apply_translation((x, 0.0, 0.0))
    return ball


def _wires() -> TriangleMesh:
    return _mesh(*(
        trimesh.creation.cylinder(0.0003, segment=[[x, -0.03, -0.03], [x, 0.03, 0.03]], sections=8)
        for x in (-0.02, 0.0, 0.02)
    ))  # fmt: skip


def _torus() -> TriangleMesh:
    return _mesh(trimesh.creation.torus(0.03, 0.008, major_sections=48, minor_sections=24))


def _hollow() -> TriangleMesh:
    inside = trimesh.creation.box((0.04, 0.04, 0.03))
    inside.invert()
    return _mesh(trimesh.creation.box((0.05, 0.05, 0.04)), inside)


PARTS = {"wires": _wires(), "ring": _torus(), "two bodies": _mesh(_ball(-0.025), _ball(0.025)), "closed box": _hollow()}


def _poses(count: int = 14) -> Floats:
    """Return (n, 4, 4) poses spread evenly about the cylinder, at the middle of the range."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    out = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    views = aim_viewpoints(np.zeros((count, 3)), out, np.full(count, -1), [(NEAR + FAR) / 2], [0.0])
    return np.asarray(views.T_object_scanner[:, 0])


def _points(mesh: TriangleMesh, T: Floats) -> Floats:
    return np.asarray(virtual_scan.scan(_SCANNER, T, EmbreeRayCaster(mesh.vertices, mesh.faces), mesh).points)


def _learned(space: VoxelSpace, points: Floats, T: Floats) -> VoxelSpace:
    rays = np.asarray(_SCANNER.ray_directions())
    source, sensor = np.asarray(_SCANNER.source), np.asarray(_SCANNER.sensor)
    eye = SensorFrustum(source, sensor, rays, _SCANNER.grid_shape[1], NEAR, FAR, float(np.arccos(rays[0] @ rays[1])))
    stands = [T[:3, :3] @ at + T[:3, 3] for at in (source, sensor)]
    space = space.with_points(points, stands) if len(points) else space
    return space.with_votes(points, *stands, eye.blank(points, T), NEAR, FAR)


@cache
def _explored(name: str, noise: float = 0.0, pose: float = 0.0) -> VoxelSpace:
    """Return the space after views from all sides, with noise of points and errors of reported positions [m]."""
    mesh = PARTS[name]
    rng, space = np.random.default_rng(0), VoxelSpace.from_cylinder(RADIUS, HEIGHT, EDGE, SPACING)
    for T in _poses():
        points = _points(mesh, T)
        off = rng.normal(0, pose, 3)
        reported = np.array(T)
        reported[:3, 3] += off
        points = points + off + rng.normal(0, noise, points.shape)
        assert space.contradicted_share(points) < 0.01
        space = _learned(space, points, reported)
    return space


def _surface(mesh: TriangleMesh) -> Floats:
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(whole, 5000, seed=0)[0])


@pytest.mark.parametrize("name", PARTS)
def test_no_surface_is_farther_than_the_clearance_from_unseen_space(name: str) -> None:
    """Free space ends within the clearance of the true surface, even for wires that most rays miss."""
    space = _explored(name)
    away = ndimage.distance_transform_edt(space.state == FREE) * space.edge
    assert space.values_at(_surface(PARTS[name]), away).max() < CLEARANCE


def test_the_believed_ring_has_its_hole() -> None:
    """The hole of a ring is not believed to be part, and more than 95 % of the ring is measured."""
    space = _explored("ring")
    middle = np.zeros((1, 3))
    assert not space.values_at(middle, space.belief_voxels())[0]
    points = _surface(PARTS["ring"])
    middle = 0.03 * points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    normals = points - np.column_stack([middle, np.zeros(len(points))])
    assert space.is_measured(points, normals / np.linalg.norm(normals, axis=1, keepdims=True)).mean() > 0.95


def test_two_bodies_are_believed_as_two() -> None:
    """Two bodies are believed as two separate components."""
    labels, count = ndimage.label(_explored("two bodies").belief_voxels(), np.ones((3, 3, 3)))
    sizes = np.bincount(labels.ravel())[1:]
    assert (sizes > 0.2 * sizes.max()).sum() == 2, (count, sizes)


def test_the_inside_of_a_closed_box_stays_unknown_and_is_reported() -> None:
    """No voxel in a closed box is free, and its volume is reported as unseen."""
    space = _explored("closed box")
    x, y, z = np.abs(space.centres(space.state == FREE)).T
    assert not ((x < 0.02) & (y < 0.02) & (z < 0.015)).any()
    inside = trimesh.creation.box((0.03, 0.03, 0.02))
    assert (space.values_at(np.asarray(inside.vertices), space.state) == UNKNOWN).all()
    assert space.unseen_volume >= 0.8 * 0.04 * 0.04 * 0.03


def test_noise_and_pose_errors_are_no_part_that_moved() -> None:
    """Noise of 0.25 mm and position errors of 0.5 mm are not taken for a moved part."""
    space = _explored("ring", noise=0.00025, pose=0.0005)
    assert (space.state == OCCUPIED).any()


@pytest.mark.parametrize("name", ["ring", "two bodies", "closed box"])
@pytest.mark.parametrize("shift", [(0.008, 0, 0), (-0.008, 0, 0), (0, 0.008, 0), (0, 0, 0.008)])
def test_a_part_that_was_moved_is_noticed(name: str, shift: tuple[float, float, float]) -> None:
    """Points of a shifted part contradict the known space."""
    space, moved = _explored(name), PARTS[name].vertices + np.array(shift)
    mesh = replace(PARTS[name], vertices=moved)
    shares = [space.contradicted_share(points) for T in _poses(5) if len(points := _points(mesh, T))]
    assert np.mean(shares) > 0.01


def test_a_believed_surface_is_closed_before_and_after() -> None:
    """Tight and coarse believed surfaces are watertight, before the first view and after the last."""
    unknown = VoxelSpace.from_cylinder(RADIUS, HEIGHT, EDGE, SPACING)
    for space in (unknown, _explored("ring")):
        for mesh in (belief.surface_about(space, space.belief_voxels()), belief.coarse_surface(space)):
            assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight


@pytest.mark.parametrize("name", ["ring", "closed box"])
def test_a_believed_surface_needs_no_repair(name: str) -> None:
    """The checks of a mesh file change nothing in a believed surface, cavities included."""
    space = _explored(name)
    surface = belief.surface_about(space, space.belief_voxels())
    checked = workpiece.from_arrays(name, surface.vertices, surface.faces, "m").reference
    volumes = [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume for mesh in (surface, checked)]
    assert volumes[0] > 0
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-9)
    assert belief.belief_part(surface, name).reference is surface
