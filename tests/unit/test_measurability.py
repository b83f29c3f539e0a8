"""The measurability matrix: its layout, its arguments, several poses per column, and prediction."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples, samples_at_face_centres
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import apply_occluders, fill_matrix, find_measured
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone

SCANNER = LaserArea(resolution_deg=(2, 2))


def _box(size, centre=(0, 0, 0)):
    corners = (np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5) * size + centre
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return TriangleMesh(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def _caster(mesh):
    return EmbreeRayCaster(mesh.vertices, mesh.faces)


def _views(poses):
    n = len(poses)
    return Viewpoints(np.array(poses), np.full(n, -1), np.ones(n), np.zeros(n))


@pytest.fixture(scope="module")
def cube():
    """A cube of 100 mm with 600 samples and a viewpoint above each of its 12 triangles, twice (two rolls)."""
    mesh = _box(0.1)
    features = draw_samples(mesh, mesh, 600, np.random.default_rng(0))
    return mesh, _caster(mesh), features, optimal_scanning_zone(mesh, [0.3], [0.0, np.pi / 2])


def test_a_cube_s_side_is_measured_from_in_front_of_it_and_from_nowhere_else(cube):
    """Row i, column j is set exactly where sample and viewpoint belong to the same side: the other sides graze."""
    _, caster, features, views = cube
    result = fill_matrix(views, features, SCANNER, caster)
    assert result.shape == (600, 24)
    side_of_view = -views.T_object_scanner[:, 0, :3, 2]
    expected = features.normals @ side_of_view.T > 0.99
    assert (result.matrix().toarray() == expected).all()


def test_the_ray_grid_sets_the_rows_of_the_faces_that_it_hits(cube):
    """The paper's fill of the same cube: each view measures its own side's two faces."""
    mesh, caster, _, views = cube
    result = fill_matrix(views, samples_at_face_centres(mesh, mesh), SCANNER, caster, method="rays", part=mesh)
    side_of_view = -views.T_object_scanner[:, 0, :3, 2]
    normals = samples_at_face_centres(mesh, mesh).normals
    assert (result.matrix().toarray() == (normals @ side_of_view.T > 0.99)).all()


def test_faces_map_to_rows_and_minus_one_to_none(cube):
    """With one row per side, and one side left out, that row stays empty."""
    mesh, caster, _, views = cube
    rows = np.repeat(np.arange(6), 2)
    rows[rows == 3] = -1
    features = samples_at_face_centres(mesh, mesh)
    picked = pick_samples(features, np.arange(0, len(features), 2))
    result = fill_matrix(views, picked, SCANNER, caster, method="rays", part=mesh, row_of_face=rows)
    assert np.diff(result.indptr).tolist() == [4, 4, 4, 0, 4, 4]


def test_a_column_of_several_poses_measures_what_any_of_them_measures(cube):
    """Two poses per column, filled both ways, equal the two single columns joined."""
    mesh, caster, features, views = cube
    T = views.T_object_scanner
    pairs = _views(np.concatenate([T[:12], T[12:]], axis=1))
    for method, rows in (("aimed", features), ("rays", samples_at_face_centres(mesh, mesh))):
        keys = {"method": method, "part": mesh}
        single = fill_matrix(views, rows, SCANNER, caster, **keys).matrix().toarray()
        double = fill_matrix(pairs, rows, SCANNER, caster, **keys).matrix().toarray()
        assert (double == (single[:, :12] | single[:, 12:])).all()
        assert double.any()


def test_prediction_equals_the_matrix_for_all_views_and_for_each(cube):
    """`measured` on the matrix's own rows gives its columns, and their union."""
    _, caster, features, views = cube
    matrix = fill_matrix(views, features, SCANNER, caster).matrix().toarray()
    chosen = [0, 5, 14, 20]
    T = views.T_object_scanner[chosen]
    assert (find_measured(T, features, SCANNER, [caster], each=True) == matrix[:, chosen]).all()
    assert (find_measured(T, features, SCANNER, [caster]) == matrix[:, chosen].any(axis=1)).all()
    assert not find_measured(T[:0], features, SCANNER, [caster]).any()


def test_an_occluder_removes_exactly_what_it_hides(cube):
    """A wall in front of one side empties that side's rows and nothing else; for one and for two poses per column."""
    _, caster, features, views = cube
    wall = _caster(_box((0.01, 0.5, 0.5), (0.15, 0, 0)))
    part_only = fill_matrix(views, features, SCANNER, caster)
    hidden = apply_occluders(part_only, views, SCANNER, wall).matrix().toarray()
    on_that_side = features.normals[:, 0] > 0.99
    assert not hidden[on_that_side].any()
    assert (hidden[~on_that_side] == part_only.matrix().toarray()[~on_that_side]).all()
    T = views.T_object_scanner
    pairs = _views(np.concatenate([T[:12], T[12:]], axis=1))
    double = apply_occluders(fill_matrix(pairs, features, SCANNER, caster), pairs, SCANNER, wall, ray_caster=caster)
    assert (double.matrix().toarray() == (hidden[:, :12] | hidden[:, 12:])).all()
    joint = find_measured(T, features, SCANNER, [caster, wall], each=True)
    assert (joint == hidden).all()


def test_progress_ends_at_all_poses(cube):
    """The last call says that everything is done, and the numbers rise."""
    _, caster, features, views = cube
    calls = []
    fill_matrix(views, features, SCANNER, caster, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (24, 24)
    assert calls == sorted(calls)


def test_no_viewpoint_and_a_view_of_nothing_give_empty_matrices(cube):
    """Zero columns, and one column that looks away."""
    _, caster, features, views = cube
    assert fill_matrix(_views(np.zeros((0, 1, 4, 4))), features, SCANNER, caster).shape == (600, 0)
    away = np.array(views.T_object_scanner[:1])
    away[:, :, :3, [0, 2]] *= -1
    assert len(fill_matrix(_views(away), features, SCANNER, caster).indices) == 0


def test_wrong_arguments_are_named(cube):
    """Each message says what would be valid."""
    mesh, caster, features, views = cube
    with pytest.raises(PlannerError, match="'pencil' is unknown; valid are: aimed, rays"):
        fill_matrix(views, features, SCANNER, caster, method="pencil")
    with pytest.raises(PlannerError, match="needs `part`"):
        fill_matrix(views, features, SCANNER, caster, method="rays")
    with pytest.raises(PlannerError, match="12 faces and there are 600 rows"):
        fill_matrix(views, features, SCANNER, caster, method="rays", part=mesh)
    with pytest.raises(PlannerError, match="valid are -1 to 599"):
        fill_matrix(views, features, SCANNER, caster, method="rays", part=mesh, row_of_face=np.full(12, 600))
    with pytest.raises(PlannerError, match="not a rigid motion"):
        fill_matrix(_views(2 * np.array(views.T_object_scanner)), features, SCANNER, caster)
    part_only = fill_matrix(views, features, SCANNER, caster)
    with pytest.raises(PlannerError, match="24 viewpoints and 12"):
        apply_occluders(part_only, _views(views.T_object_scanner[:12]), SCANNER, caster)
    pairs = _views(np.repeat(np.array(views.T_object_scanner), 2, axis=1))
    with pytest.raises(PlannerError, match="need `ray_caster`"):
        apply_occluders(part_only, pairs, SCANNER, caster)


@pytest.mark.parametrize(
    ("indptr", "indices", "words"),
    [
        ([0, 1, 2], [0], "indptr"),
        ([0, 2, 1], [0], "indptr"),
        ([0, 1, 1], [3], "0 to 2"),
        ([0, 2, 2], [1, 1], "rise"),
        ([0, 2, 2], [2, 1], "rise"),
    ],
)
def test_a_broken_matrix_is_refused(indptr, indices, words):
    """Layout errors are found where the matrix is made, not where it is used."""
    two = SurfaceSamples(np.zeros((2, 3)), np.zeros((2, 3)), np.ones(2), np.zeros(2), np.zeros(2))
    assert Measurability([0, 1, 2], [2, 0], two, 3).matrix().toarray().tolist() == [[0, 0, 1], [1, 0, 0]]
    with pytest.raises(PlannerError, match=words):
        Measurability(indptr, indices, two, 3)
