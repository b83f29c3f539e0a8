"""The sigma of a point against simulated triangulation, simulated light spots and the textbook's closed form."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea

SCANNER = LaserArea(range_mm=(100, 600), baseline_mm=75, sigma_angle_mdeg=2.0)
POINTS = np.array([[0, 0, 0.3], [0.1, 0, 0.25], [-0.12, 0.05, 0.4], [0.05, -0.15, 0.5], [0.075, 0.02, 0.2]])


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _halfway(points, scanner):
    """Return normals at equal angles to both legs, and the cosine of that angle."""
    normals = _unit(_unit(-points) + _unit(scanner.sensor - points))
    return normals, np.einsum("ij,ij->i", normals, _unit(-points))


def test_sigma_is_the_scatter_of_triangulated_points():
    """The sensor's direction is perturbed in float64 and met with the laser ray: the scatter along it is sigma."""
    rng = np.random.default_rng(1)
    normals, cosine = _halfway(POINTS, SCANNER)
    spread = np.radians(SCANNER.sigma_angle_mdeg / 1000) / (cosine * np.sqrt(cosine))
    draws = 200_000
    for point, expected, sigma in zip(POINTS, SCANNER.sigma(POINTS, normals), spread, strict=True):
        ray, sight = _unit(point), _unit(point - SCANNER.sensor)
        across = _unit(ray - (ray @ sight) * sight)  # in the plane of the triangle, across the line of sight
        angle = sigma * rng.standard_normal(draws)
        # s ray = sensor + t (cos sight + sin across), for s by Cramer's rule on the axes (sight, across)
        sensor = np.array([SCANNER.sensor @ sight, SCANNER.sensor @ across])
        laser = np.array([ray @ sight, ray @ across])
        s = (sensor[0] * np.sin(angle) - sensor[1] * np.cos(angle)) / (
            laser[0] * np.sin(angle) - laser[1] * np.cos(angle)
        )
        assert np.mean(s) == pytest.approx(np.linalg.norm(point), rel=1e-4)
        assert np.std(s) == pytest.approx(expected, abs=4 * expected / np.sqrt(2 * draws))


@pytest.mark.parametrize(("laser_deg", "sight_deg"), [(0, 0), (60, 0), (0, 70), (45, 30), (70, 70)])
def test_incidence_widens_the_spot_and_dims_it(laser_deg, sight_deg):
    """The centroid of a spot's photons scatters by the model's factor over that of a surface that faces both."""
    rng = np.random.default_rng(2)
    photons, spots = 400, 4_000

    def scatter(length: float, brightness: float) -> float:
        counts = rng.poisson(photons * brightness, spots)
        return float(np.std([rng.normal(0, length, n).mean() for n in counts]))

    cos_laser, cos_sight = np.cos(np.radians([laser_deg, sight_deg]))
    found = scatter(1 / cos_laser, cos_sight) / scatter(1.0, 1.0)
    assert found == pytest.approx(1 / (cos_laser * np.sqrt(cos_sight)), rel=0.05)


def test_the_model_applies_that_factor():
    """Turning the surface alone changes sigma by exactly 1 / (cos(theta) sqrt(cos(phi)))."""
    rng = np.random.default_rng(3)
    normals = _unit(rng.normal(size=(5, 40, 3)) + 1.5 * _unit(-POINTS)[:, None])
    for point, turned in zip(POINTS, normals, strict=True):
        theta, phi = turned @ _unit(-point), turned @ _unit(SCANNER.sensor - point)
        lit = (theta > 0) & (phi > 0)
        assert lit.sum() > 20
        halfway, cosine = _halfway(point[None], SCANNER)
        best = SCANNER.sigma(point[None], halfway)[0] * cosine[0] ** 1.5
        sigma = SCANNER.sigma(np.tile(point, (40, 1)), turned)
        np.testing.assert_allclose(sigma[lit], best / (theta[lit] * np.sqrt(phi[lit])), rtol=1e-12)
        assert np.isinf(sigma[~lit]).all()


def test_on_the_axis_it_is_the_textbook_s_depth_error():
    """Sigma equals z^2 / (f b) sigma_image of a camera with an axis parallel to z."""
    z, b, focal, sigma_image = 0.3, 0.075, 0.016, 1e-6
    sigma_angle = sigma_image / focal * z**2 / (z**2 + b**2)
    scanner = LaserArea(baseline_mm=1000 * b, sigma_angle_mdeg=1000 * np.degrees(sigma_angle))
    point = np.array([[0, 0, z]])
    normals, cosine = _halfway(point, scanner)
    facing = scanner.sigma(point, normals) * cosine**1.5
    assert facing == pytest.approx(z**2 / (focal * b) * sigma_image, rel=1e-12)
