"""Pose errors, credited probabilities, and the layer of probabilities on a matrix."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from cell.scan.simulated import Disturbance
from planner.errors import PlannerError
from planner.geometry.rigid import rotation_matrices
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.pose_ensemble import (
    PoseError,
    ProbabilityLayer,
    credited_probability,
    probability_layer,
    simulate_executions,
)
from planner.measurability.visibility import fill_matrix
from planner.ports import Hits, Rejection
from planner.viewpoints.viewpoints import Viewpoints


class Cone:
    """A toy sensor that measures points within 10 degrees of its axis at any distance."""

    source = np.zeros(3)
    sensor = np.zeros(3)
    grid_shape = (1, 1)

    def ray_directions(self):
        return np.array([[0.0, 0.0, 1.0]])

    def reject(self, points, normals):
        inside = np.hypot(points[:, 0], points[:, 1]) <= np.tan(np.radians(10)) * points[:, 2] + 1e-12
        return np.where(inside, Rejection.MEASURED, Rejection.OUT_OF_FOV).astype(np.uint8)


class Nothing:
    """A ray caster without geometry."""

    def first_hit(self, origins, directions):
        return Hits(np.full(len(origins), -1), np.full(len(origins), np.inf))

    def blocked(self, origins, targets):
        return np.zeros(len(origins), dtype=bool)


def scene(offsets_deg):
    """Return a view at the origin along +z, and samples 1 m away at angles off its axis."""
    angle = np.radians(np.asarray(offsets_deg, dtype=float))
    points = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    n = len(angle)
    samples = SurfaceSamples(points, -points, np.ones(n), np.zeros(n, int), np.zeros(n, int))
    views = Viewpoints(np.eye(4)[None, None], np.zeros(1, int), np.ones(1), np.zeros(1))
    return samples, views


def test_a_drawn_error_moves_a_pose_as_an_execution_does() -> None:
    """The same normal numbers give the pose from which `cell scan` traces its rays."""
    T = np.eye(4)
    T[:3, 3] = 0.3, -0.2, 0.9
    T[:3, :3] = rotation_matrices(np.array([[0.4, -1.1, 0.6]]))[0]
    for seed in range(5):
        found = T @ PoseError(0.002, 0.01).draw(1, np.random.default_rng(seed))[0]
        executed = Disturbance(position=0.002, rotation=0.01).true_pose(T, np.random.default_rng(seed))
        np.testing.assert_allclose(found, executed, atol=1e-15)


def test_rotations_are_rotations_also_at_zero() -> None:
    """The matrices are orthonormal, with determinant 1 and the angle of the vector; zero gives the identity."""
    vectors = np.concatenate([np.zeros((1, 3)), np.random.default_rng(0).normal(size=(20, 3))])
    R = rotation_matrices(vectors)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_array_equal(R[0], np.eye(3))
    angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(np.cos(angle), np.cos(np.linalg.norm(vectors, axis=1)), atol=1e-12)


def test_credit_is_capped_and_nothing_counts_for_no_hit() -> None:
    """(hits + 1/2) / (members + 1), 0 without a hit, 1 for exact poses."""
    np.testing.assert_allclose(credited_probability(np.array([0, 1, 16, 32]), 32), [0.0, 1.5 / 33, 0.5, 32.5 / 33])
    np.testing.assert_array_equal(credited_probability(np.array([0, 0]), 0), [1.0, 1.0])


def test_the_layer_is_the_share_of_a_normal_distribution() -> None:
    """At the edge of a cone half of the poses measure the sample, 1 sigma inside 84 %, and far inside all."""
    sd = 0.5
    samples, views = scene([10.0, 10.0 - sd, 5.0, 14.0])
    M = fill_matrix(views, samples, Cone(), Nothing())
    members = 4000
    errors = PoseError(0.0, np.radians(sd)).draw(members, np.random.default_rng(0))
    layer = probability_layer(M, views, Cone(), (Nothing(),), errors)
    assert M.matrix().toarray()[:, 0].tolist() == [True, True, True, False]  # the last sample has no entry
    share = layer.hits / members
    np.testing.assert_allclose(share, [0.5, 0.8413, 1.0], atol=4 * 0.5 / np.sqrt(members))


def test_only_selected_columns_are_evaluated() -> None:
    """Entries of excluded columns have no hit, and an ensemble without errors has exact poses."""
    samples, views = scene([0.0, 5.0])
    M = fill_matrix(views, samples, Cone(), Nothing())
    errors = PoseError(0.0, 0.001).draw(3, np.random.default_rng(0))
    assert probability_layer(M, views, Cone(), (Nothing(),), errors).hits.tolist() == [3, 3]
    unasked = probability_layer(M, views, Cone(), (Nothing(),), errors, columns=np.zeros(1, bool))
    assert unasked.hits.tolist() == [0, 0]
    exact = probability_layer(M, views, Cone(), (Nothing(),), np.zeros((0, 4, 4)))
    assert (exact.members, exact.probability.tolist()) == (0, [1.0, 1.0])


def test_a_sweep_measures_from_any_of_its_poses() -> None:
    """A column of two poses, turned by 8 degrees, has the ensemble of their union."""
    samples, _ = scene([12.0])
    turned = np.eye(4)
    turned[:3, :3] = rotation_matrices(np.array([[0.0, np.radians(8.0), 0.0]]))[0]
    both = Viewpoints(np.stack([np.eye(4), turned])[None], np.zeros(1, int), np.ones(1), np.zeros(1))
    errors = PoseError(0.0, np.radians(0.2)).draw(50, np.random.default_rng(0))
    layer = probability_layer(fill_matrix(both, samples, Cone(), Nothing()), both, Cone(), (Nothing(),), errors)
    assert layer.hits.tolist() == [50]


def test_simulated_executions_find_the_probability_again() -> None:
    """Two equal views with independent errors measure the edge in 1 - (1 - p)^2 of the executions."""
    samples, _ = scene([10.0, 0.0, 60.0])
    executions = 2000
    errors = PoseError(0.0, np.radians(0.5)).draw(2 * executions, np.random.default_rng(1))
    poses = np.broadcast_to(np.eye(4), (2, 1, 4, 4))
    times, share = simulate_executions(poses, samples, Cone(), (Nothing(),), errors.reshape(executions, 2, 4, 4))
    assert times[1:].tolist() == [executions, 0]
    assert times[0] / executions == pytest.approx(0.75, abs=4 * np.sqrt(0.75 * 0.25 / executions))
    np.testing.assert_allclose(share.mean(), (times / executions).mean())


def test_a_layer_follows_a_matrix_that_lost_entries() -> None:
    """Hits of the remaining entries stay; entries outside the layer are refused."""
    M = csr_array(np.array([[1, 1, 0], [0, 1, 1]], dtype=bool))
    layer = ProbabilityLayer(M.indptr, M.indices, np.array([1, 2, 3, 4]), 4)

    class Matrix:
        """The used part of a measurability matrix."""

        def __init__(self, dense):
            rows = csr_array(np.array(dense, dtype=bool))
            self.indptr, self.indices, self.n_viewpoints = rows.indptr, rows.indices, 3

    assert layer.restricted_to(Matrix([[0, 1, 0], [0, 1, 1]])).hits.tolist() == [2, 3, 4]
    assert layer.restricted_to(Matrix([[0, 0, 0], [0, 0, 0]])).hits.tolist() == []
    with pytest.raises(PlannerError, match="lacks"):
        layer.restricted_to(Matrix([[1, 1, 1], [0, 0, 0]]))


@pytest.mark.parametrize(("position", "orientation"), [(-1.0, 0.0), (0.0, np.nan), (np.inf, 0.0)])
def test_invalid_standard_deviations_are_refused(position: float, orientation: float) -> None:
    """Negative, infinite and NaN standard deviations are refused."""
    with pytest.raises(PlannerError, match="standard deviation"):
        PoseError(position, orientation)
