"""Hand-eye calibration from scans of a target: exact, noisy and degenerate sets, comparison with SciPy."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from planner.errors import PlannerError
from planner.registration import hand_eye
from planner.registration.hand_eye import PoseError, TargetScans, solve_hand_eye
from planner.registration.observability import FreeKind
from planner.values import Floats

TARGET, NORMAL = np.array([1.1, 0.3, 0.0]), np.array([0.1, -0.2, 0.97])
PLAIN = PoseError(1e-9, 1e-9)  # equal weights of all residuals


def _pose(R: Floats, t: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


MOUNT = _pose(Rotation.from_euler("zyx", [30, 10, -15], degrees=True).as_matrix(), np.array([0.03, -0.02, 0.12]))


def _seen(plane: bool, seed: int = 0, count: int = 8, tilt: float = 50.0, noise: float = 0.0) -> TargetScans:
    """Return exact scans from random poses, with errors of the flange poses of `noise` [rad] and `noise` times 1 m."""
    rng = np.random.default_rng(seed)
    normal = NORMAL / np.linalg.norm(NORMAL)
    poses, points = [], []
    for _ in range(count):
        turned = Rotation.from_euler("zyz", rng.uniform((0, 0, 0), (360, tilt, 360)), degrees=True)
        R = (turned * Rotation.from_euler("x", 180, degrees=True)).as_matrix()
        place = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.2, 0.4)])
        off = _pose(Rotation.from_rotvec(rng.normal(0, noise or 1e-300, 3)).as_matrix(), rng.normal(0, noise, 3))
        poses.append(_pose(R, TARGET - R @ place) @ np.linalg.inv(MOUNT) @ off)
        if plane:
            on = np.cross(normal, rng.standard_normal((4, 3))) * 0.05
            points.append((on + TARGET - (TARGET - R @ place)) @ R)
        else:
            points.append(place[None])
    return TargetScans(np.stack(poses), np.stack(points), plane)


@pytest.mark.parametrize("plane", [False, True])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_exact_scans_give_the_mount(plane: bool, seed: int) -> None:
    """Exact scans give the mount to rounding, with no undetermined motion and no alternative."""
    found = solve_hand_eye(_seen(plane, seed), PoseError(), np.random.default_rng(seed))
    np.testing.assert_allclose(found.T, MOUNT, atol=1e-8)
    assert found.undetermined_motions(1e-4) == ()
    assert found.alternatives == ()


@pytest.mark.parametrize("plane", [False, True])
def test_against_least_squares_in_other_coordinates(plane: bool) -> None:
    """The unweighted mount equals SciPy's least squares with Euler angles and an explicit target."""
    seen = _seen(plane, noise=3e-4)
    T_base_flange = seen.T_base_flange

    def off(x: Floats) -> Floats:
        mount = _pose(Rotation.from_euler("xyz", x[3:6]).as_matrix(), x[:3])
        there = T_base_flange @ mount
        world = np.einsum("kab,kjb->kja", there[:, :3, :3], seen.points) + there[:, None, :3, 3]
        if not plane:
            return np.asarray((world - x[6:9]).ravel())
        n = np.array([np.cos(x[6]) * np.cos(x[7]), np.sin(x[6]) * np.cos(x[7]), np.sin(x[7])])
        return np.asarray((world @ n - x[8]).ravel())

    n = NORMAL / np.linalg.norm(NORMAL)
    target = [np.arctan2(n[1], n[0]), np.arcsin(n[2]), n @ TARGET] if plane else TARGET
    begin = np.concatenate([MOUNT[:3, 3], Rotation.from_matrix(MOUNT[:3, :3]).as_euler("xyz"), target])
    solved = least_squares(off, begin, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x
    found = solve_hand_eye(seen, PLAIN, np.random.default_rng(0))
    np.testing.assert_allclose(found.T[:3, 3], solved[:3], atol=2e-6)
    np.testing.assert_allclose(found.T[:3, :3], Rotation.from_euler("xyz", solved[3:6]).as_matrix(), atol=2e-5)


@pytest.mark.parametrize(("sets", "factor"), [(4, 4.0), pytest.param(16, 2.5, marks=pytest.mark.slow)])
def test_the_standard_deviations_are_the_scatter_of_mounts(sets: int, factor: float) -> None:
    """The mean square error over the reported variance of noisy sets is one, to within a factor."""
    rng, exact = np.random.default_rng(5), _seen(plane=False, count=12)
    ratios = []
    for _ in range(sets):
        off = np.stack(
            [_pose(Rotation.from_rotvec(rng.normal(0, 3e-4, 3)).as_matrix(), rng.normal(0, 3e-5, 3)) for _ in range(12)]
        )
        found = solve_hand_eye(TargetScans(exact.T_base_flange @ off, exact.points, False), PoseError(3e-5, 3e-4), rng)
        assert found.covariance is not None
        ratios.append((found.T[:3, 3] - MOUNT[:3, 3]) ** 2 / np.diag(found.covariance)[:3])
    assert 1 / factor < float(np.mean(ratios)) < factor


def test_degenerate_sets_have_undetermined_motions() -> None:
    """Without rotation every translation is undetermined, and with rotation about one axis that along the axis.

    With rotation about the ball every rotation about it is undetermined.
    """
    many, rng = _seen(plane=False, count=12), np.random.default_rng(0)
    turned = many.T_base_flange.copy()
    turned[:, :3, :3] = turned[0, :3, :3]
    points = (TARGET - turned[:, :3, 3]) @ turned[0, :3, :3]  # in the flange frame
    still = TargetScans(turned, ((points - MOUNT[:3, 3]) @ MOUNT[:3, :3])[:, None], False)
    kinds = [motion.kind for motion in solve_hand_eye(still, PoseError(), rng).undetermined_motions(5e-4)]
    assert kinds == [FreeKind.TRANSLATION] * 3

    axis = np.array([0.0, 0.0, 1.0])
    spun = turned.copy()
    spun[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, 5, 12)[:, None] * axis).as_matrix() @ turned[0, :3, :3]
    points = np.einsum("kba,kb->ka", spun[:, :3, :3], TARGET - spun[:, :3, 3])
    one_axis = TargetScans(spun, ((points - MOUNT[:3, 3]) @ MOUNT[:3, :3])[:, None], False)
    (slide,) = solve_hand_eye(one_axis, PoseError(), rng).undetermined_motions(5e-4)
    assert slide.kind is FreeKind.TRANSLATION
    assert abs(slide.direction @ (turned[0, :3, :3].T @ axis)) == pytest.approx(1.0, abs=1e-6)

    spot = np.array([0.01, 0.0, 0.3])
    about = many.T_base_flange.copy()
    about[:, :3, 3] = TARGET - about[:, :3, :3] @ (MOUNT[:3, :3] @ spot + MOUNT[:3, 3])
    pivoted = TargetScans(about, np.tile(spot, (12, 1, 1)), False)
    kinds = [motion.kind for motion in solve_hand_eye(pivoted, PoseError(), rng).undetermined_motions(5e-4)]
    assert kinds == [FreeKind.ROTATION] * 3


def test_too_few_scans_are_refused() -> None:
    """Four scans are refused; at least five are required."""
    few = _seen(plane=False, count=4)
    with pytest.raises(PlannerError, match="at least 5"):
        solve_hand_eye(few, PoseError(), np.random.default_rng(0))


@pytest.mark.parametrize("known", [True, False])
def test_a_ball_among_other_points(known: bool) -> None:
    """Centre and radius of a ball are found to the noise among points of a table and outliers."""
    rng = np.random.default_rng(2)
    on = rng.standard_normal((6000, 3))
    on /= np.linalg.norm(on, axis=1, keepdims=True)
    centre, radius = np.array([0.02, -0.03, 0.3]), 0.019
    cap = centre + radius * on[on[:, 2] < -0.4] + rng.normal(0, 3e-5, (int((on[:, 2] < -0.4).sum()), 3))
    table = np.column_stack([rng.uniform(-0.05, 0.05, (400, 2)), np.full(400, 0.33)])
    wild = rng.uniform((-0.05, -0.05, 0.25), (0.05, 0.05, 0.35), (200, 3))
    points = np.concatenate([cap, table, wild])
    (ball,) = hand_eye.fit_spheres([points], radius if known else None, np.random.default_rng(0))
    np.testing.assert_allclose(ball.points[0], centre, atol=3e-5)
    assert ball.radius == pytest.approx(radius, abs=3e-5)
    assert ball.used == pytest.approx(len(cap) / len(points), abs=0.05)


def test_the_points_of_a_fitted_plane_have_its_moments() -> None:
    """The four points of a fitted plane have mean and covariance of the measured points.

    The sum of squared distances to any plane is thus the same.
    """
    rng = np.random.default_rng(1)
    flat = np.column_stack([rng.uniform(-0.1, 0.1, 2000), rng.uniform(-0.02, 0.05, 2000), np.zeros(2000)])
    R = Rotation.random(random_state=3).as_matrix()
    (plane,) = hand_eye.fit_planes([flat @ R.T + [0.1, 0.2, 0.3]], np.random.default_rng(0))
    np.testing.assert_allclose(plane.points.mean(axis=0), R @ flat.mean(axis=0) + [0.1, 0.2, 0.3], atol=1e-9)
    spread = (plane.points - plane.points.mean(axis=0)).T @ (plane.points - plane.points.mean(axis=0)) / 4
    np.testing.assert_allclose(spread, R @ np.cov(flat.T, bias=True) @ R.T, atol=1e-9)


def test_a_flat_surface_is_no_sphere() -> None:
    """Points of a plane, and points of which all but one coincide, are reported as no sphere."""
    flat = np.column_stack([np.random.default_rng(0).random((50, 2)), np.zeros(50)])
    for points in (flat, np.vstack([np.zeros((49, 3)), np.ones(3)])):
        with pytest.raises(hand_eye.TargetNotFoundError, match="do not determine a sphere"):
            hand_eye.fit_spheres([points], None, np.random.default_rng(0))


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.zeros((100, 3)), np.linspace(0, 1, 300).reshape(100, 3)])
def test_points_without_a_target_are_refused(points: Floats) -> None:
    """Too few points, coincident points and collinear points are reported as no target."""
    for find in (lambda: hand_eye.fit_spheres([points], None, np.random.default_rng(0)),
                 lambda: hand_eye.fit_planes([points], np.random.default_rng(0))):  # fmt: skip
        with pytest.raises(hand_eye.TargetNotFoundError):
            find()
