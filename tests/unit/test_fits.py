"""Least-squares fits recover shapes, state their uncertainty, and report points that do not determine them."""

import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.inspect.measured import fit_patch
from planner.errors import PlannerError
from planner.fitting.extremal import Criterion, fit_extremal
from planner.fitting.least_squares import Fit, fit
from planner.fitting.shapes import ANGLE, PARAMETERS, SIZE, TILT_X, Shape, ShapeKind
from planner.values import Floats

AXIS = np.array([2.0, -1.0, 2.0]) / 3
CENTRE = np.array([0.4, -0.7, 0.2])


def points_on(kind: ShapeKind, count: int = 200, arc_deg: float = 360, length: float = 0.06, seed: int = 0) -> Floats:
    """Return points (N, 3) on a shape of radius 20 mm (cone: half angle 20 deg) about `CENTRE` [m]."""
    rng = np.random.default_rng(seed)
    turn, along = np.radians(rng.uniform(0, arc_deg, count)), rng.uniform(-length / 2, length / 2, count)
    radius = np.full(count, 0.02)
    match kind:
        case ShapeKind.LINE:
            radius = np.zeros(count)
        case ShapeKind.PLANE:
            radius, along = rng.uniform(0, 0.02, count), np.zeros(count)
        case ShapeKind.CIRCLE:
            along = np.zeros(count)
        case ShapeKind.SPHERE:
            along = rng.uniform(-0.02, 0.02, count)
            radius = np.sqrt(0.02**2 - along**2)
        case ShapeKind.CONE:
            radius = radius + along * np.tan(np.radians(20))
    local = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), along])
    return local @ Shape(ShapeKind.PLANE, CENTRE, AXIS).frame.T + CENTRE


def lobed(count: int = 300) -> tuple[Floats, Fit]:
    """Return a circle of 10 m with three lobes of 0.05 m, and its least-squares fit."""
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    radius = 10 + 0.05 * np.cos(3 * turn)
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(count)])
    return points, fit(ShapeKind.CIRCLE, points)


class TestLeastSquares:
    @pytest.mark.parametrize("kind", list(ShapeKind))
    def test_exact_points_give_the_shape(self, kind: ShapeKind) -> None:
        found = fit(kind, points_on(kind))
        shape = found.shape.at_foot(CENTRE)
        assert not found.doubts
        assert np.abs(found.residuals).max() < 1e-12
        assert np.linalg.norm(shape.point - CENTRE) < 1e-11
        if kind is not ShapeKind.SPHERE:
            assert np.linalg.norm(np.cross(shape.axis, AXIS)) < 1e-10
        expected = {ShapeKind.CIRCLE: 0.02, ShapeKind.SPHERE: 0.02, ShapeKind.CYLINDER: 0.02,
                    ShapeKind.CONE: 0.02 * np.cos(np.radians(20))}.get(kind, 0.0)  # fmt: skip
        assert shape.size == pytest.approx(expected, abs=1e-11)
        assert np.degrees(shape.half_angle) == pytest.approx(20 if kind is ShapeKind.CONE else 0, abs=1e-8)

    @pytest.mark.parametrize("kind", list(ShapeKind))
    def test_gain_predicts_the_answer_to_displaced_points(self, kind: ShapeKind) -> None:
        points = points_on(kind, 60, 200)
        before = fit(kind, points)
        off = 1e-7 * np.random.default_rng(1).standard_normal(points.shape)
        after = fit(kind, points + off, before.shape).shape.at_foot(before.shape.point)
        predicted = before.shape.changed(np.einsum("kni,ni->k", before.gain, off)).at_foot(before.shape.point)
        assert np.linalg.norm(after.point - predicted.point) < 1e-11
        assert np.linalg.norm(np.cross(after.axis, predicted.axis)) < 1e-9
        assert after.size == pytest.approx(predicted.size, abs=1e-11)
        assert after.half_angle == pytest.approx(predicted.half_angle, abs=1e-9)

    @pytest.mark.parametrize("kind", [ShapeKind.PLANE, ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.CONE])
    def test_covariance_is_that_of_repeated_fits(self, kind: ShapeKind) -> None:
        points, sigma, rng = points_on(kind, 80, 150), 2e-5, np.random.default_rng(2)
        exact = fit(kind, points)
        normals = exact.shape.normals(points)
        found = []
        for _ in range(200):
            noisy = fit(kind, points + sigma * rng.standard_normal((len(points), 1)) * normals, exact.shape)
            shape = noisy.shape.at_foot(exact.shape.point)
            shift, turn = exact.frame.T @ (shape.point - exact.shape.point), exact.frame.T @ shape.axis
            found.append([*shift, turn[0], turn[1], shape.size - exact.shape.size, shape.half_angle])
        observed = np.std(found, axis=0)
        predicted = np.sqrt(np.diag(exact.covariance(sigma)))
        components = list(PARAMETERS[kind])
        assert observed[components] == pytest.approx(predicted[components], rel=0.15)

    @pytest.mark.parametrize("kind", [ShapeKind.LINE, ShapeKind.PLANE, ShapeKind.CIRCLE, ShapeKind.SPHERE])
    def test_few_points_tell_their_standard_deviation(self, kind: ShapeKind) -> None:
        """The mean variance of fits to six noisy points is that of the noise in each direction."""
        sigma, rng = 2e-5, np.random.default_rng(1)
        exact = points_on(kind, 6, seed=3)
        variances = [fit(kind, exact + sigma * rng.standard_normal(exact.shape)).sigma ** 2 for _ in range(200)]
        assert np.mean(variances) == pytest.approx(sigma**2, rel=0.15)

    def test_five_points_of_a_circle_in_a_given_plane_tell_their_standard_deviation(self) -> None:
        """Two of the five distances are redundant: the plane is not fitted."""
        sigma, rng, nominal = 2e-5, np.random.default_rng(1), Shape(ShapeKind.CYLINDER, CENTRE, AXIS, 0.02)
        feature: Any = SimpleNamespace(kind="circle")
        exact = points_on(ShapeKind.CIRCLE, 5, seed=3)
        noisy = (exact + sigma * rng.standard_normal(exact.shape) for _ in range(400))
        variances = [fit_patch(feature, nominal, points).sigma ** 2 for points in noisy]
        assert np.mean(variances) == pytest.approx(sigma**2, rel=0.15)

    def test_a_slender_cone_on_three_short_lines_is_exact_and_uncertain(self) -> None:
        """Lines of 5 mm at a radius of 20 mm determine the angle with a standard deviation of tenths of a degree."""
        half = np.radians(1.6)
        along = np.tile(np.linspace(0, 5, 47), 3)
        turn = np.repeat(np.radians([0, 40, 80]), 47)
        radius = 20 + along * np.tan(half)
        points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), along])
        points += (
            0.005
            * np.random.default_rng(0).standard_normal((141, 1))
            * Shape(ShapeKind.CONE, np.zeros(3), np.array([0, 0, 1.0]), 20 * np.cos(half), half).normals(points)
        )
        found = fit(ShapeKind.CONE, points)
        assert not found.doubts
        sd = np.degrees(np.sqrt(found.covariance()[ANGLE, ANGLE]))
        assert 0.05 < sd < 2
        assert abs(np.degrees(found.shape.half_angle) - 1.6) < 3 * sd
        gradient = found.shape.jacobian(points)[:, list(PARAMETERS[ShapeKind.CONE])].T @ found.residuals
        assert np.abs(gradient).max() < 1e-8

    @pytest.mark.parametrize(
        ("kind", "points"),
        [
            (ShapeKind.CONE, points_on(ShapeKind.CONE, 6)),
            (ShapeKind.PLANE, points_on(ShapeKind.LINE, 30)),
            (ShapeKind.CYLINDER, points_on(ShapeKind.CIRCLE, 50)),
            (ShapeKind.LINE, np.zeros((5, 3))),
        ],
    )
    def test_points_that_do_not_determine_the_shape_are_reported(self, kind: ShapeKind, points: Floats) -> None:
        found = fit(kind, points)
        assert found.doubts

    def test_too_few_points_are_refused(self) -> None:
        with pytest.raises(PlannerError, match="at least 5 points"):
            fit(ShapeKind.CYLINDER, points_on(ShapeKind.CYLINDER, 4))

    def test_weights_move_the_fit_to_the_precise_points(self) -> None:
        points = points_on(ShapeKind.SPHERE, 100)
        grown = points.copy()
        grown[50:] += 1e-4 * (points[50:] - CENTRE) / 0.02
        weights = np.repeat([1e6, 1.0], 50)
        assert fit(ShapeKind.SPHERE, grown, weights=weights).shape.size == pytest.approx(0.02, abs=1e-8)


class TestExtremalShapes:
    def test_extremal_circles_of_three_lobes(self) -> None:
        points, start = lobed()
        assert start.shape.size == pytest.approx(10, abs=1e-6)
        assert fit_extremal(Criterion.CIRCUMSCRIBED, points, start.shape).shape.size == pytest.approx(10.05, abs=1e-9)
        assert fit_extremal(Criterion.INSCRIBED, points, start.shape).shape.size == pytest.approx(9.95, abs=1e-9)
        assert fit_extremal(Criterion.ZONE, points, start.shape).zone == pytest.approx(0.1, abs=1e-9)

    def test_the_minimum_zone_of_a_plane_is_narrower_than_that_of_least_squares(self) -> None:
        """A bump in one corner tilts the least-squares plane; the zone of a flat plate and a bump is known."""
        x, y = (each.ravel() for each in np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41)))
        z = np.where((x > 0.8) & (y > 0.8), 0.01, 0.0)
        points = np.column_stack([x, y, z])
        start = fit(ShapeKind.PLANE, points)
        zone = fit_extremal(Criterion.ZONE, points, start.shape).zone
        assert zone < np.ptp(start.residuals)
        directions = np.random.default_rng(0).normal([0, 0, 1], 0.005, (4000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        assert zone <= np.ptp(points @ directions.T, axis=0).min()
        assert zone > 0.005

    def test_minimum_zone_of_a_cylinder_ignores_its_tilted_start(self) -> None:
        points = points_on(ShapeKind.CYLINDER, 500)
        start = fit(ShapeKind.CYLINDER, points).shape
        change = np.zeros(7)
        change[[TILT_X, SIZE]] = 2e-3, 1e-4
        assert fit_extremal(Criterion.ZONE, points, start.changed(change)).zone < 1e-9

    @pytest.mark.parametrize("seed", range(5))
    def test_the_zone_of_a_plane_is_the_least_width_of_the_points(self, seed: int) -> None:
        """The width of a polytope is least across a face, or across two parallel edges: all are tried."""
        points = np.random.default_rng(seed).normal(0, [1, 1, 0.05], (14, 3))
        pairs = np.array(list(itertools.combinations(range(14), 2)))
        edges = points[pairs[:, 0]] - points[pairs[:, 1]]
        normals = np.concatenate([np.cross(edges[k], edges[k + 1 :]) for k in range(len(edges) - 1)])
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None]
        found = fit_extremal(Criterion.ZONE, points, fit(ShapeKind.PLANE, points).shape).zone
        assert found == pytest.approx(np.ptp(points @ normals.T, axis=0).min(), rel=1e-6)

    @pytest.mark.parametrize("seed", range(5))
    def test_extremal_circles_are_those_of_all_triples_and_centres(self, seed: int) -> None:
        """Circumscribed: the smallest of all circles by two or three points; the others by a search of centres."""
        rng = np.random.default_rng(seed)
        turn = rng.uniform(0, 2 * np.pi, 25)
        flat = (10 + rng.normal(0, 0.1, 25))[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        points = np.column_stack([flat, np.zeros(25)])
        start = fit(ShapeKind.CIRCLE, points, Shape(ShapeKind.CIRCLE, np.zeros(3), np.array([0, 0, 1.0]), 10.0)).shape
        centres = [(flat[i] + flat[j]) / 2 for i, j in itertools.combinations(range(25), 2)]
        for i, j, k in itertools.combinations(range(25), 3):
            A = 2 * (flat[[j, k]] - flat[i])
            centres.append(np.linalg.solve(A, (flat[[j, k]] ** 2).sum(axis=1) - (flat[i] ** 2).sum()))
        radii = np.linalg.norm(np.array(centres)[:, None] - flat, axis=2).max(axis=1)
        found = fit_extremal(Criterion.CIRCUMSCRIBED, points, start).shape
        assert found.size == pytest.approx(radii.min(), rel=1e-7)

        def best(value: Callable[[Floats], Floats]) -> float:
            """Return the least value over centres, on grids that shrink about the best one."""
            centre, width = start.point[:2], 1.0
            for _ in range(40):
                grid = centre + width * np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 21)]), axis=-1).reshape(-1, 2)
                found = value(np.linalg.norm(grid[:, None] - flat, axis=2))
                centre, width = grid[found.argmin()], 0.6 * width
            return float(found.min())

        zone = fit_extremal(Criterion.ZONE, points, start).zone
        assert zone == pytest.approx(best(lambda r: np.ptp(r, axis=1)), rel=1e-5)
        inscribed = fit_extremal(Criterion.INSCRIBED, points, start).shape.size
        assert inscribed == pytest.approx(best(lambda r: -r.min(axis=1)) * -1, rel=1e-5)
