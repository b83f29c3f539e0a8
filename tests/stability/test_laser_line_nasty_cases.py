"""Difficult line sensors; each case has a name."""

import numpy as np
import pytest
import trimesh

from cell.scanners import sweep_columns
from cell.scanners.laser_line import LaserLine
from cell.world.embree import EmbreeRayCaster
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import apply_occluders, fill_matrix
from planner.ports import Rejection
from planner.viewpoints.viewpoints import Viewpoints, view_sphere

_MESH = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
_BALL = TriangleMesh(_MESH.vertices, _MESH.faces.astype(np.int32))


def _ball() -> tuple[SurfaceSamples, EmbreeRayCaster]:
    samples = draw_samples(_BALL, _BALL, 400, np.random.default_rng(1))
    return samples, EmbreeRayCaster(_BALL.vertices, _BALL.faces)


def _views(distance: float = 0.3) -> Viewpoints:
    return view_sphere(np.zeros(3), distance, np.pi / 3, np.pi / 2)


# name: keys of the scanner, smallest and largest share of the ball's samples that some view measures
CASES = {
    "one pose a sweep": ({"sweep_mm": 120, "sweep_steps": 1}, 0.95, 1.0),
    "a hundred poses": ({"sweep_mm": 120, "sweep_steps": 100}, 0.95, 1.0),
    "sweep a hundred times the part": ({"sweep_mm": 10_000, "sweep_steps": 8}, 0.0, 1.0),
    "sweep of a micrometre": ({"sweep_mm": 0.001}, 0.0, 0.01),
    "fan of 179 degrees": ({"fan_deg": 179, "sweep_mm": 120}, 0.95, 1.0),
    "fan of a thousandth of a degree": ({"fan_deg": 0.001, "sweep_mm": 120}, 0.0, 0.01),
    "turned by 179 degrees": ({"sweep_deg": 179, "sweep_steps": 30}, 0.95, 1.0),
    "baseline 0": ({"baseline_mm": 0, "sweep_mm": 120}, 0.95, 1.0),
    "baseline ten times the standoff": ({"baseline_mm": 3000, "sweep_mm": 120}, 0.2, 0.95),
    "grazing limit 0": ({"grazing_max_deg": 0, "sweep_mm": 120}, 0.0, 0.0),
    "grazing limit 90": ({"grazing_max_deg": 90, "sweep_mm": 120}, 0.95, 1.0),
    "range from 0": ({"range_mm": (0, 450), "sweep_mm": 120}, 0.95, 1.0),
    "range behind the part": ({"range_mm": (400, 450), "sweep_mm": 120}, 0.0, 0.0),
}


@pytest.mark.parametrize("case", CASES)
def test_measured_share_of_a_ball(case: str) -> None:
    """The measured share is within its geometric limits, without NaN or an error."""
    keys, least, most = CASES[case]
    scanner = LaserLine(**{"fan_deg": 30, "baseline_mm": 75, "range_mm": (150, 450), **keys})
    samples, caster = _ball()
    views = sweep_columns(scanner, _views())
    M = fill_matrix(views, samples, scanner, caster)
    share = (np.diff(M.indptr) > 0).mean()
    assert least <= share <= most
    empty = EmbreeRayCaster(_BALL.vertices + 10.0, _BALL.faces)
    assert (apply_occluders(M, views, scanner, empty, ray_caster=caster).indices == M.indices).all()


def test_sensor_inside_the_part_measures_nothing() -> None:
    """From inside, every outward normal points away."""
    scanner = LaserLine(range_mm=(1, 100), baseline_mm=5, sweep_mm=20)
    samples, caster = _ball()
    assert len(fill_matrix(sweep_columns(scanner, _views(0.01)), samples, scanner, caster).indices) == 0


def test_no_points_have_no_codes() -> None:
    """An empty batch gives no codes."""
    for keys in ({"sweep_mm": 10}, {"sweep_deg": 10}):
        scanner = LaserLine(**keys)
        assert scanner.reject(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)


def test_points_at_and_behind_the_source_and_at_infinity() -> None:
    """Depth 0 and below, infinity and NaN are rejected without a warning."""
    points = np.array([[0, 0, 0], [0, 0, -0.3], [0, 0, np.inf], [np.nan, 0, 0.3], [0, np.nan, 0.3], [0, 0, np.nan]])
    for keys in ({"sweep_mm": 10}, {"sweep_deg": 10}):
        with np.errstate(invalid="ignore"):
            codes = LaserLine(range_mm=(0, 450), **keys).reject(points, np.tile([0.0, 0.0, -1.0], (6, 1)))
        assert (codes != Rejection.MEASURED).all()


def test_a_part_ten_metres_from_the_origin_is_measured_alike() -> None:
    """With part and views moved together, at most a few samples on a limit change."""
    scanner = LaserLine(fan_deg=30, baseline_mm=75, range_mm=(150, 450), sweep_mm=120)
    samples, caster = _ball()
    here = fill_matrix(sweep_columns(scanner, _views()), samples, scanner, caster).matrix().toarray()
    shift = np.array([10.0, -7.0, 3.0])
    there_samples = SurfaceSamples(
        samples.points + shift, samples.normals, samples.areas, samples.face, samples.planning_face
    )
    views = view_sphere(shift, 0.3, np.pi / 3, np.pi / 2)
    there_caster = EmbreeRayCaster(_BALL.vertices + shift, _BALL.faces)
    there = fill_matrix(sweep_columns(scanner, views), there_samples, scanner, there_caster).matrix().toarray()
    assert (here != there).sum() <= 2e-3 * here.sum()


def test_a_sweep_of_a_sweep_is_refused() -> None:
    """Columns of a sweep cannot be swept again."""
    scanner = LaserLine(sweep_mm=10)
    with pytest.raises(PlannerError, match="8 poses each"):
        sweep_columns(scanner, sweep_columns(scanner, _views()))
