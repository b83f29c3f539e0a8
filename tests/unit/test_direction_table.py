"""Direction table: compared with exact rays of the same samples, poses and scanner."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.direction_table import DirectionTable
from planner.measurability.quality import LimitedScanner
from planner.measurability.visibility import find_measured
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import aim_viewpoints

pytestmark = pytest.mark.usefixtures("four_threads")

DISTANCES = (0.1, 0.4)


@pytest.fixture(scope="module")
def case():
    """Return samples, caster and 60 poses around two boxes that hide parts of each other."""
    boxes = [trimesh.creation.box((0.06, 0.06, 0.06)), trimesh.creation.box((0.03, 0.08, 0.1))]
    boxes[1].apply_translation((0.06, 0.01, 0.0))
    both = trimesh.util.concatenate(boxes)
    mesh = TriangleMesh(both.vertices, both.faces)
    samples = draw_samples(mesh, mesh, 2000, np.random.default_rng(1))
    outward = np.random.default_rng(2).normal(size=(57, 3))
    outward = np.concatenate([outward, np.eye(3)])  # views along the axes as well
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    views = aim_viewpoints(0.04 * outward, outward, np.full(60, -1), [0.2], [0.3])
    return samples, EmbreeRayCaster(mesh.vertices, mesh.faces), views.T_object_scanner[:, 0]


def _table(case, scanner):
    samples, caster, _ = case
    targets = RayTargets.of(samples.points, samples.normals)
    return DirectionTable.build(targets, scanner, caster, (), DISTANCES)


@pytest.mark.parametrize(
    "scanner",
    [
        LaserArea(),
        LaserArea(fov_deg=(30, 20), sensor_fov_deg=(25, 30), depth_of_field_mm=(180, 220), grazing_max_deg=60),
        LaserArea(sensor_grazing_max_deg=70, baseline_mm=150),
        LaserArea(max_spacing_mm=1.2),
        LimitedScanner(LaserArea(), 20e-6),
    ],
    ids=["default", "sensor and depth", "wide baseline", "spacing", "sigma"],
)
def test_table_agrees_with_exact_rays(case, scanner):
    """At most 3 % of the samples differ at any pose, 0.5 % on average, and errors of both signs balance."""
    samples, caster, T = case
    exact = find_measured(T[:, None], samples, scanner, (caster,), each=True)
    table = _table(case, scanner)
    found = table.measured(T).T
    assert exact.mean() > 0.02
    assert (found != exact).mean(axis=0).max() < 0.03
    assert (found != exact).mean() < 0.005
    assert abs(found.mean() - exact.mean()) < 0.002


def test_compiled_limits_equal_the_law(case):
    """The compiled conditions and `reject` differ by rounding to float32 alone."""
    table = _table(case, LaserArea(sensor_fov_deg=(50, 50)))
    by_law = replace(table, limits=None)
    assert table.limits is not None
    assert (table.measured(case[2]) != by_law.measured(case[2])).mean() < 1e-4


def test_sums_are_those_of_the_measured_rows(case):
    """Sums over some rows are close to those of exact marks; below a threshold they are partial, above it complete."""
    _, _, T = case
    table, rng = _table(case, LaserArea()), np.random.default_rng(3)
    sets = [rng.permutation(2000)[:n] for n in (700, 1, 0)]
    rows, starts = np.concatenate(sets), np.array([0, 700, 701, 701])
    poses, weights, all_sums = np.stack([T, T, T]), rng.random(2000), np.full(3, -np.inf)
    expected = table.weights_measured(poses, rows, starts, weights, all_sums)
    exact = np.array([table.measured(T, own) @ weights[own] for own in sets])
    assert abs(expected - exact)[0].mean() < 0.01 * exact[0].mean()
    assert (abs(expected - exact)[1:] > 0).mean() < 0.02
    by_law = replace(table, limits=None).weights_measured(poses, rows, starts, weights, all_sums)
    np.testing.assert_allclose(by_law, exact, rtol=1e-3)
    threshold = float(np.median(expected[0]))
    some = table.weights_measured(poses, rows, starts, weights, np.array([threshold, 0.0, 0.0]))[0]
    above = expected[0] >= threshold
    np.testing.assert_allclose(some[above], expected[0][above], rtol=1e-12)
    assert (some[~above] < threshold).all()


def test_some_samples_are_those_of_the_whole_table(case):
    """A table of some samples measures the same."""
    _, _, T = case
    table, rows = _table(case, LaserArea()), np.arange(5, 2000, 7)
    np.testing.assert_array_equal(table.pick(rows).measured(T), table.measured(T)[:, rows])


def test_selected_samples_are_occluded(case):
    """Selected samples are measured by no pose, the others as before."""
    _, _, T = case
    rows = np.arange(2000) % 3 == 0
    for table in (_table(case, LaserArea()), _table(case, LaserArea(max_spacing_mm=1.2))):
        found = table.without(rows).measured(T)
        assert not found[:, rows].any()
        np.testing.assert_array_equal(found[:, ~rows], table.measured(T)[:, ~rows])


def test_occluders_hide(case):
    """A plate above the part hides everything from above and nothing from below."""
    samples, caster, _ = case
    plate = trimesh.creation.box((2.0, 2.0, 0.01))
    plate.apply_translation((0, 0, 0.1))
    targets = RayTargets.of(samples.points, samples.normals)
    occluder = EmbreeRayCaster(plate.vertices, plate.faces)
    table = DirectionTable.build(targets, LaserArea(), caster, (occluder,), DISTANCES)
    outward = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    T = aim_viewpoints(np.zeros((2, 3)), outward, np.full(2, -1), [0.25], [0.0]).T_object_scanner[:, 0]
    above, below = table.measured(T).sum(axis=1)
    assert above == 0
    assert below == _table(case, LaserArea()).measured(T)[1].sum() > 100


def test_occluders_behind_the_scanner_do_not_hide(case):
    """Exact rays agree for a plate behind the source, in front of it and without a plate."""
    samples, caster, _ = case
    targets = RayTargets.of(samples.points, samples.normals)
    outward = np.array([[0.0, 0.0, 1.0]])
    T = aim_viewpoints(np.zeros((1, 3)), outward, np.full(1, -1), [0.22], [0.0]).T_object_scanner[:, 0]
    measured = []
    for height in (0.12, 0.32):
        plate = trimesh.creation.box((2.0, 2.0, 0.01))
        plate.apply_translation((0, 0, height))
        occluder = EmbreeRayCaster(plate.vertices, plate.faces)
        table = DirectionTable.build(targets, LaserArea(), caster, (occluder,), DISTANCES)
        exact = find_measured(T[:, None], samples, LaserArea(), (caster, occluder))
        assert (table.measured(T)[0] != exact).mean() < 0.01
        measured.append(int(exact.sum()))
    assert measured[0] == 0
    assert measured[1] > 100
