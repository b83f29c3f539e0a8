"""Standard deviations of a registered part's placement against repeated fits and the covariance of least squares."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.registration.registration import placement_sd
from planner.values import Floats

SIZES = np.array([0.3, 0.2, 0.08])
DRAWS = 100


def plate(n: int = 1500) -> tuple[ClosestPointQuery, Floats, Floats]:
    """Return a plate, and points and normals (N, 3) on it."""
    box = trimesh.creation.box(SIZES)
    mesh = TriangleMesh(np.array(box.vertices), np.array(box.faces, dtype=np.int32))
    samples = draw_samples(mesh, mesh, n, np.random.default_rng(0))
    return ClosestPointQuery(mesh), samples.points, samples.normals


def deviations(points: Floats, rng: np.random.Generator, sd: float, blocks: int | None) -> Floats:
    """Return deviations (N,): of each point its own, or one for each cell of `blocks` along every axis."""
    if blocks is None:
        return sd * rng.standard_normal(len(points))
    cell = np.minimum(((points / SIZES + 0.5) * blocks).astype(np.int64), blocks - 1)
    return np.asarray(sd * rng.standard_normal((blocks,) * 3)[tuple(cell.T)])


def refit(points: Floats, normals: Floats, centre: Floats) -> Floats:
    """Return translation and rotation vector (6,) about a centre that move points best onto their nominal planes."""
    heights = np.abs(normals) @ SIZES / 2

    def off(change: Floats) -> Floats:
        there = Rotation.from_rotvec(change[3:]).apply(points - centre) + centre + change[:3]
        return np.asarray(np.einsum("nj,nj->n", there, normals) - heights)

    return np.asarray(least_squares(off, np.zeros(6), x_scale=[1e-5] * 3 + [1e-4] * 3).x)


@pytest.mark.parametrize("blocks", [4, None])
def test_it_is_the_scatter_of_repeated_fits(blocks: int | None) -> None:
    """Deviations of the part are alike within a block, or each point has its own."""
    nearest, points, normals = plate()
    rng, centre, sd = np.random.default_rng(1), points.mean(axis=0), 1e-4 if blocks is None else 1e-5
    stated, placed = [], []
    for _ in range(DRAWS):
        made = points + deviations(points, rng, sd, blocks)[:, None] * normals
        stated.append(placement_sd(made, nearest))
        placed.append(refit(made, normals, centre))
    covariance = np.cov(np.array(placed).T)
    observed = [np.sqrt(np.linalg.eigvalsh(part)[-1]) for part in (covariance[:3, :3], covariance[3:, 3:])]
    assert np.sqrt(np.mean(np.square(stated), axis=0)) / observed == pytest.approx([1, 1], abs=0.2)


def test_of_noise_it_is_the_covariance_of_least_squares() -> None:
    """The covariance of least squares is sigma^2 (J' J)^-1."""
    nearest, points, normals = plate()
    rng, sd, centre = np.random.default_rng(2), 2e-5, points.mean(axis=0)
    J = np.hstack([normals, np.cross(points - centre, normals)])
    covariance = sd**2 * np.linalg.inv(J.T @ J)
    expected = [np.sqrt(np.linalg.eigvalsh(part)[-1]) for part in (covariance[:3, :3], covariance[3:, 3:])]
    stated = [placement_sd(points + deviations(points, rng, sd, None)[:, None] * normals, nearest) for _ in range(40)]
    assert np.sqrt(np.mean(np.square(stated), axis=0)) / expected == pytest.approx([1, 1], abs=0.2)
