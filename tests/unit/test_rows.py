"""Rows added to M: entries, areas per planning face, sigma."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability, append_rows


def _matrix(dense, planning_face, area):
    """M of a dense matrix; its features stand for equal areas."""
    count = len(dense)
    rows = csr_array(np.array(dense, dtype=bool))
    features = SurfaceSamples(
        np.arange(3.0 * count).reshape(count, 3),
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.full(count, area),
        np.arange(count, dtype=np.int32),
        np.array(planning_face, dtype=np.int32),
    )
    return Measurability(rows.indptr.astype(np.int64), rows.indices.astype(np.int32), features, len(dense[0]))


def _spread(face_areas, region=None):
    """A sample on each planning face that has an area."""
    faces = np.flatnonzero(face_areas)
    made = _matrix(np.zeros((len(faces), 1)), faces, 0.0).samples
    return replace(made, areas=face_areas[faces], region=region)


def test_entries_stand_below_each_other_and_share_the_area_of_their_face():
    """Against the dense stack; a face of 6 with three features gives each 2; the sum stays what it was."""
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
    """One of 1 and one of 3 on a face of 4, five rows on the small one and one on the large: by hand, and each by each.

    By face alone the six would stand for 4 / 6 each, and a target of the small region for 3.3 of 4.
    """
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
    """Both matrices have the layer or neither; other columns are refused."""
    M, more = _matrix([[1, 1]], [0], 1.0), _matrix([[0, 1]], [0], 1.0)
    layered = [replace(m, sigma=np.full(len(m.indices), s, dtype=np.float32)) for m, s in ((M, 1.0), (more, 2.0))]
    np.testing.assert_array_equal(
        append_rows(*layered, _spread(np.ones(1))).sigma, np.array([1, 1, 2], dtype=np.float32)
    )
    with pytest.raises(PlannerError, match="only one"):
        append_rows(M, layered[1], _spread(np.ones(1)))
    with pytest.raises(PlannerError, match="of 3 viewpoints"):
        append_rows(M, _matrix([[0, 1, 0]], [0], 1.0), _spread(np.ones(1)))
