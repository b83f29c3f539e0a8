"""A line sensor above a flat plate: the measured strip and its shadow in closed form."""

import numpy as np
import pytest
import trimesh

from cell.scanners import sweep_columns
from cell.scanners.laser_line import LaserLine
from cell.world.embree import EmbreeRayCaster
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import apply_occluders, fill_matrix, find_measured
from planner.viewpoints.viewpoints import Viewpoints

HEIGHT = 0.3
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


def _plate(half: float = 0.25, count: int = 201) -> tuple[EmbreeRayCaster, SurfaceSamples]:
    """Return a plate in z = 0 and a grid of samples off the symmetry axes, so that none is on a limit by accident."""
    mesh = trimesh.creation.box([2 * half, 2 * half, 0.01])
    mesh.apply_translation([0, 0, -0.005])
    side = (np.arange(count) + 0.4871) / count * 2 * half - half
    x, y = np.meshgrid(side, side)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    n = len(points)
    area = np.full(n, (2 * half / count) ** 2)
    face = np.zeros(n, np.int32)
    samples = SurfaceSamples(points, np.tile([0.0, 0.0, 1.0], (n, 1)), area, face, face)
    return EmbreeRayCaster(mesh.vertices, mesh.faces), samples


def _view(scanner: LaserLine) -> Viewpoints:
    """Return one sweep, looking straight down from HEIGHT; the baseline is along the plate's x."""
    T = DOWN.copy()
    T[2, 3] = HEIGHT
    return sweep_columns(scanner, Viewpoints(T[None, None], np.array([-1]), np.array([HEIGHT]), np.array([0.0])))


def _row(M: Measurability) -> np.ndarray:
    return np.diff(M.indptr).astype(bool)


@pytest.mark.parametrize("steps", [1, 2, 9, 40])
@pytest.mark.parametrize(("fan", "length"), [(30.0, 120.0), (26.0, 61.7)])
def test_a_straight_sweep_measures_a_rectangle(fan: float, length: float, steps: int) -> None:
    """Exactly |x| <= length / 2, |y| <= height tan(fan / 2), for any number of poses; its area too."""
    scanner = LaserLine(fan_deg=fan, sweep_mm=length, sweep_steps=steps, baseline_mm=100, range_mm=(200, 400))
    caster, samples = _plate()
    row = _row(fill_matrix(_view(scanner), samples, scanner, caster))
    x, y, _ = samples.points.T
    half = HEIGHT * np.tan(np.radians(fan / 2))
    assert (row == ((np.abs(x) <= length / 2000) & (np.abs(y) <= half))).all()
    expected = length / 1000 * 2 * half
    ring = 2 * np.sqrt(samples.areas[0]) * (length / 1000 + 2 * half)
    assert abs(samples.areas[row].sum() - expected) <= ring
    assert 0 < row.sum() < len(row) / 2


@pytest.mark.parametrize("steps", [1, 4, 31])
def test_a_turned_sweep_measures_a_bow_tie_cut_by_the_range(steps: int) -> None:
    """In the wedge the length of the line follows from the depth at its pose, up to the end of the range."""
    angle, fan, far = 60.0, 28.0, 0.33
    scanner = LaserLine(
        fan_deg=fan, sweep_deg=angle, sweep_steps=steps, baseline_mm=80, range_mm=(200, far * 1000), grazing_max_deg=89
    )
    caster, samples = _plate()
    row = _row(fill_matrix(_view(scanner), samples, scanner, caster))
    x, y, _ = samples.points.T
    towards = np.arctan2(x, HEIGHT)
    cell = np.radians(angle) / steps
    pose = np.clip(np.floor(towards / cell + steps / 2), 0, steps - 1)
    depth = np.hypot(x, HEIGHT) * np.cos(towards - (pose + 0.5 - steps / 2) * cell)
    expected = (np.abs(towards) <= np.radians(angle / 2)) & (np.abs(y) <= np.tan(np.radians(fan / 2)) * depth)
    expected &= depth <= far
    edge = np.isclose(np.abs(towards / cell + steps / 2) % 1, 0, atol=1e-6)
    assert not edge.any(), "the test's own samples must not lie between two poses"
    assert (row == expected).all()
    assert row.any()
    assert not row.all()


def test_a_wall_along_the_line_casts_its_shadow_away_from_the_sensor_only() -> None:
    """The sheet is vertical, so the laser is free; behind the wall the sensor misses baseline x wall / height."""
    wall, baseline, steps, length = 0.04, 0.12, 60, 0.24
    scanner = LaserLine(
        fan_deg=30, sweep_mm=length * 1000, sweep_steps=steps, baseline_mm=baseline * 1000, range_mm=(150, 400)
    )
    caster, samples = _plate()
    body = trimesh.creation.box([0.002, 0.6, wall])
    body.apply_translation([0, 0, wall / 2])
    view = _view(scanner)
    M = apply_occluders(
        fill_matrix(view, samples, scanner, caster),
        view,
        scanner,
        EmbreeRayCaster(body.vertices, body.faces),
        ray_caster=caster,
    )
    x, y, _ = samples.points.T
    inside = (np.abs(x) <= length / 2) & (np.abs(y) <= HEIGHT * np.tan(np.radians(15)))
    distance = (
        -0.001 - x
    )  # how far a sample lies from the wall, on the side away from the sensor (scanner x is plate x)
    shadow = baseline * wall / HEIGHT
    blur = length / steps / 2 * wall / HEIGHT + 1e-9  # a pose is up to half a step off its sample
    row = _row(M)
    hidden = (distance >= 0) & (distance <= shadow - blur)
    lit = (distance >= shadow + blur) | (x >= 0.001 + blur)
    assert (inside & hidden).sum() > 100
    assert not row[inside & hidden].any()
    assert row[inside & lit].all()
    both = find_measured(view.T_object_scanner, samples, scanner, (caster, EmbreeRayCaster(body.vertices, body.faces)))
    assert (both == row).all()
