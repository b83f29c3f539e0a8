"""The measurability matrix: layout, arguments, several poses per column, prediction, appended rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from cell.scanners.laser_area import LaserArea
from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples, draw_samples, samples_at_face_centres
from planner.measurability.matrix import Measurability, append_rows
from planner.measurability.visibility import any_unoccluded, apply_occluders, fill_matrix, find_measured
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone
from tests.support.meshes import block, caster_of

SCANNER = LaserArea(resolution_deg=(2, 2))


def _views(poses):
    n = len(poses)
    return Viewpoints(np.array(poses), np.full(n, -1), np.ones(n), np.zeros(n))


@pytest.fixture(scope="module")
def cube():
    """Return a cube of 100 mm with 600 samples and a viewpoint above each of its 12 triangles, twice (two rolls)."""
    mesh = block(0.1)
    samples = draw_samples(mesh, mesh, 600, np.random.default_rng(0))
    return mesh, caster_of(mesh), samples, optimal_scanning_zone(mesh, [0.3], [0.0, np.pi / 2])


def test_a_side_of_a_cube_is_measured_from_in_front_of_it_only(cube):
    """Row i, column j is set if and only if sample and viewpoint belong to the same side."""
    _, caster, samples, views = cube
    result = fill_matrix(views, samples, SCANNER, caster)
    assert result.shape == (600, 24)
    side_of_view = -views.T_object_scanner[:, 0, :3, 2]
    expected = samples.normals @ side_of_view.T > 0.99
    assert (result.matrix().toarray() == expected).all()


def test_the_ray_grid_sets_the_rows_of_the_faces_that_it_hits(cube):
    """With the method `rays`, each view of the same cube measures the two faces of its side."""
    mesh, caster, _, views = cube
    result = fill_matrix(views, samples_at_face_centres(mesh, mesh), SCANNER, caster, method="rays", part=mesh)
    side_of_view = -views.T_object_scanner[:, 0, :3, 2]
    normals = samples_at_face_centres(mesh, mesh).normals
    assert (result.matrix().toarray() == (normals @ side_of_view.T > 0.99)).all()


def test_faces_map_to_rows_and_minus_one_to_none(cube):
    """With one row per side and one side left out, the row of this side stays empty."""
    mesh, caster, _, views = cube
    rows = np.repeat(np.arange(6), 2)
    rows[rows == 3] = -1
    samples = samples_at_face_centres(mesh, mesh)
    picked = samples.pick(np.arange(0, len(samples), 2))
    result = fill_matrix(views, picked, SCANNER, caster, method="rays", part=mesh, row_of_face=rows)
    assert np.diff(result.indptr).tolist() == [4, 4, 4, 0, 4, 4]


def test_a_column_of_several_poses_measures_the_union(cube):
    """Two poses per column, filled with both methods, equal the union of the single columns."""
    mesh, caster, samples, views = cube
    T = views.T_object_scanner
    pairs = _views(np.concatenate([T[:12], T[12:]], axis=1))
    for method, rows in (("aimed", samples), ("rays", samples_at_face_centres(mesh, mesh))):
        keys = {"method": method, "part": mesh}
        single = fill_matrix(views, rows, SCANNER, caster, **keys).matrix().toarray()
        double = fill_matrix(pairs, rows, SCANNER, caster, **keys).matrix().toarray()
        assert (double == (single[:, :12] | single[:, 12:])).all()
        assert double.any()


def test_prediction_equals_the_matrix_for_all_views_and_for_each(cube):
    """`find_measured` on the rows of the matrix gives its columns, and their union."""
    _, caster, samples, views = cube
    matrix = fill_matrix(views, samples, SCANNER, caster).matrix().toarray()
    columns = [0, 5, 14, 20]
    T = views.T_object_scanner[columns]
    assert (find_measured(T, samples, SCANNER, [caster], each=True) == matrix[:, columns]).all()
    assert (find_measured(T, samples, SCANNER, [caster]) == matrix[:, columns].any(axis=1)).all()
    assert not find_measured(T[:0], samples, SCANNER, [caster]).any()


def test_an_occluder_removes_the_hidden_entries_only(cube):
    """A wall in front of one side empties only the rows of that side, for one and for two poses per column."""
    _, caster, samples, views = cube
    wall = caster_of(block((0.01, 0.5, 0.5), (0.15, 0, 0)))
    part_only = fill_matrix(views, samples, SCANNER, caster)
    hidden = apply_occluders(part_only, views, SCANNER, wall).matrix().toarray()
    on_that_side = samples.normals[:, 0] > 0.99
    assert not hidden[on_that_side].any()
    assert (hidden[~on_that_side] == part_only.matrix().toarray()[~on_that_side]).all()
    T = views.T_object_scanner
    pairs = _views(np.concatenate([T[:12], T[12:]], axis=1))
    double = apply_occluders(fill_matrix(pairs, samples, SCANNER, caster), pairs, SCANNER, wall, ray_caster=caster)
    assert (double.matrix().toarray() == (hidden[:, :12] | hidden[:, 12:])).all()
    joint = find_measured(T, samples, SCANNER, [caster, wall], each=True)
    assert (joint == hidden).all()


def test_samples_that_usable_candidates_measure_past_occluders_are_those_of_the_matrix(cube):
    """The union of the usable columns behind a wall, for one and for two poses per column; it hides some samples."""
    _, caster, samples, views = cube
    wall = caster_of(block((0.01, 0.5, 0.5), (0.15, 0.02, 0)))
    T = views.T_object_scanner
    for some in (views, _views(np.concatenate([T[:12], T[12:]], axis=1))):
        M = fill_matrix(some, samples, SCANNER, caster)
        hidden = apply_occluders(M, some, SCANNER, wall, ray_caster=caster).matrix().toarray()
        for usable in (np.ones(len(some), bool), np.arange(len(some)) % 3 == 0, np.zeros(len(some), bool)):
            found = any_unoccluded(M, some, usable, SCANNER, wall, ray_caster=caster)
            np.testing.assert_array_equal(found, hidden[:, usable].any(axis=1))
            assert not usable.any() or found.sum() < M.matrix().toarray()[:, usable].any(axis=1).sum()


def test_progress_ends_at_all_poses(cube):
    """The reported numbers increase up to (all, all)."""
    _, caster, samples, views = cube
    calls = []
    fill_matrix(views, samples, SCANNER, caster, progress=lambda n_done, total: calls.append((n_done, total)))
    assert calls[-1] == (24, 24)
    assert calls == sorted(calls)


def test_no_viewpoint_and_a_view_of_nothing_give_empty_matrices(cube):
    """No viewpoints give zero columns, and a view away from the part gives an empty column."""
    _, caster, samples, views = cube
    assert fill_matrix(_views(np.zeros((0, 1, 4, 4))), samples, SCANNER, caster).shape == (600, 0)
    away = np.array(views.T_object_scanner[:1])
    away[:, :, :3, [0, 2]] *= -1
    assert len(fill_matrix(_views(away), samples, SCANNER, caster).indices) == 0


def test_wrong_arguments_are_named(cube):
    """Each message names the valid values."""
    mesh, caster, samples, views = cube
    with pytest.raises(PlannerError, match="'pencil' is unknown; valid are: aimed, rays"):
        fill_matrix(views, samples, SCANNER, caster, method="pencil")
    with pytest.raises(PlannerError, match="needs `part`"):
        fill_matrix(views, samples, SCANNER, caster, method="rays")
    with pytest.raises(PlannerError, match="12 faces and there are 600 rows"):
        fill_matrix(views, samples, SCANNER, caster, method="rays", part=mesh)
    with pytest.raises(PlannerError, match="valid are -1 to 599"):
        fill_matrix(views, samples, SCANNER, caster, method="rays", part=mesh, row_of_face=np.full(12, 600))
    with pytest.raises(PlannerError, match="not a rigid motion"):
        fill_matrix(_views(2 * np.array(views.T_object_scanner)), samples, SCANNER, caster)
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    with pytest.raises(PlannerError, match="not a rigid motion"):
        fill_matrix(_views(views.T_object_scanner @ mirror), samples, SCANNER, caster)
    part_only = fill_matrix(views, samples, SCANNER, caster)
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
    """The constructor refuses errors of the layout."""
    two = SurfaceSamples(np.zeros((2, 3)), np.zeros((2, 3)), np.ones(2), np.zeros(2), np.zeros(2))
    assert Measurability([0, 1, 2], [2, 0], two, 3).matrix().toarray().tolist() == [[0, 0, 1], [1, 0, 0]]
    with pytest.raises(PlannerError, match=words):
        Measurability(indptr, indices, two, 3)


def _matrix(dense, planning_face, area):
    """Return M of a dense matrix with equal areas."""
    count = len(dense)
    rows = csr_array(np.array(dense, dtype=bool))
    samples = SurfaceSamples(
        np.arange(3.0 * count).reshape(count, 3),
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.full(count, area),
        np.arange(count, dtype=np.int32),
        np.array(planning_face, dtype=np.int32),
    )
    return Measurability(rows.indptr.astype(np.int64), rows.indices.astype(np.int32), samples, len(dense[0]))


def _spread(face_areas, region=None):
    """Return a sample on each planning face that has an area."""
    faces = np.flatnonzero(face_areas)
    samples = _matrix(np.zeros((len(faces), 1)), faces, 0.0).samples
    return replace(samples, areas=face_areas[faces], region=region)


def test_appended_rows_share_the_area_of_their_face():
    """Entries equal the dense stack, and three samples on a face of area 6 have 2 each, with the same sum."""
    M = _matrix([[1, 0, 1], [0, 0, 0]], [4, 7], 3.0)
    more = _matrix([[0, 1, 0], [1, 1, 1], [0, 0, 1]], [4, 4, 9], 0.5)
    face_areas = np.array([9, 9, 9, 9, 6, 9, 9, 3, 9, 1.0])
    both = append_rows(M, more, _spread(face_areas))
    dense = [[1, 0, 1], [0, 0, 0], [0, 1, 0], [1, 1, 1], [0, 0, 1]]
    np.testing.assert_array_equal(both.matrix().toarray(), np.array(dense, dtype=bool))
    np.testing.assert_allclose(both.samples.areas, np.array([2.0, 3.0, 2.0, 2.0, 1.0]) * 0.6)
    np.testing.assert_array_equal(both.samples.planning_face, [4, 7, 4, 4, 9])
    np.testing.assert_array_equal(both.samples.points, np.concatenate([M.samples.points, more.samples.points]))


def test_two_regions_on_a_face_keep_their_areas():
    """Areas 1 and 3 on a face of 4 are kept, with five rows on the small region and one on the large."""
    M, more = _matrix([[1], [0]], [0, 0], 2.0), _matrix([[1], [0], [1], [0]], [0, 0, 0, 0], 0.1)
    M = replace(M, samples=replace(M.samples, areas=np.array([1.0, 3.0]), region=np.array([0, 1], dtype=np.int32)))
    more = replace(more, samples=replace(more.samples, region=np.zeros(4, dtype=np.int32)))
    spread = replace(
        _matrix(np.zeros((4, 1)), [0, 0, 0, 0], 1.0).samples, region=np.array([1, 0, 1, 1], dtype=np.int32)
    )
    both = append_rows(M, more, spread).samples
    np.testing.assert_allclose(both.areas, [0.2, 3.0, 0.2, 0.2, 0.2, 0.2])
    np.testing.assert_allclose(np.bincount(both.region, both.areas), [1.0, 3.0])


def test_sigma_is_kept_or_refused():
    """Both matrices must have the layer of sigma or neither, and their columns must be equal."""
    M, more = _matrix([[1, 1]], [0], 1.0), _matrix([[0, 1]], [0], 1.0)
    layered = [replace(m, sigma=np.full(len(m.indices), s, dtype=np.float32)) for m, s in ((M, 1.0), (more, 2.0))]
    np.testing.assert_array_equal(
        append_rows(*layered, _spread(np.ones(1))).sigma, np.array([1, 1, 2], dtype=np.float32)
    )
    with pytest.raises(PlannerError, match="only one"):
        append_rows(M, layered[1], _spread(np.ones(1)))
    with pytest.raises(PlannerError, match="of 3 viewpoints"):
        append_rows(M, _matrix([[0, 1, 0]], [0], 1.0), _spread(np.ones(1)))
