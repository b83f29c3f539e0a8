"""Deviation of a mesh from the reference: statistics, histogram and closing faces."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.report import scan_report
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.registration.surface import measure_deviation, sample_by_area, sharp_edge_points

BOX = trimesh.creation.box((0.1, 0.1, 0.1))
REFERENCE = TriangleMesh(BOX.vertices, BOX.faces)


def test_a_mesh_that_is_the_reference_deviates_by_nothing() -> None:
    """The reference deviates from itself by rounding only, and the histogram contains the whole area."""
    result = measure_deviation(REFERENCE, REFERENCE, np.random.default_rng(0), count=1000)
    assert max(result.rms, abs(result.mean), result.quantile_95, result.largest) < 1e-15
    assert result.histogram.sum() == pytest.approx(1)


def test_statistics_are_weighted_by_area() -> None:
    """Two equal squares, one lifted by 1 mm and cut into 200 faces, have equal weight."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 0.1
    ticks = np.linspace(0, 0.1, 101)
    strip = np.concatenate(
        [np.stack([ticks, 0 * ticks, 0 * ticks], 1), np.stack([ticks, 0 * ticks + 0.1, 0 * ticks], 1)]
    )
    i = np.arange(100)
    fine = np.concatenate([np.stack([i, i + 1, i + 102], 1), np.stack([i, i + 102, i + 101], 1)])
    lifted = strip + np.array([0.2, 0, 0.001])
    mesh = TriangleMesh(np.concatenate([flat, lifted]), np.concatenate([[[0, 1, 2], [0, 2, 3]], fine + 4]))
    plane = np.array([[-1, -1, 0], [2, -1, 0], [2, 2, 0], [-1, 2, 0.0]])
    result = measure_deviation(
        mesh, TriangleMesh(plane, [[0, 1, 2], [0, 2, 3]]), np.random.default_rng(1), count=10_000
    )
    assert result.mean == pytest.approx(0.0005, rel=1e-3)
    assert result.rms == pytest.approx(0.001 / np.sqrt(2), rel=1e-3)
    assert result.largest == pytest.approx(0.001)
    np.testing.assert_allclose(result.at_vertices, np.r_[np.zeros(4), np.full(202, 0.001)], atol=1e-15)
    assert result.histogram[result.bin_edges[:-1] > 0.0005].sum() == pytest.approx(0.5, abs=1e-3)


def test_closing_faces_are_counted_apart() -> None:
    """Closing faces have their own statistics, and the deviation at vertices includes them."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 0.1
    mesh = TriangleMesh(
        np.concatenate([flat, flat + np.array([0, 0, 0.003])]), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    )
    reference = TriangleMesh(flat, [[0, 1, 2], [0, 2, 3]])
    closed = np.array([False, False, True, True])
    result = measure_deviation(mesh, reference, np.random.default_rng(3), closed=closed, count=1000)
    assert (result.rms, result.largest) == pytest.approx((0, 0), abs=1e-15)
    assert result.closed is not None
    assert [result.closed.rms, result.closed.mean, result.closed.largest] == pytest.approx([0.003] * 3)
    np.testing.assert_allclose(result.at_vertices, np.repeat([0, 0.003], 4), atol=1e-15)
    none = measure_deviation(mesh, reference, np.random.default_rng(3), closed=np.zeros(4, dtype=bool), count=1000)
    assert none.closed is None
    assert none.rms == pytest.approx(0.003 / np.sqrt(2))


def test_samples_lie_on_the_mesh_and_follow_its_area() -> None:
    """Each side of a cube holds a sixth of the samples to within one or two strata."""
    points = sample_by_area(REFERENCE, 6000, np.random.default_rng(2))
    assert np.abs(np.abs(points).max(axis=1) - 0.05).max() < 1e-12
    sides = [(np.abs(points[:, axis] - side) < 1e-12).sum() for axis in range(3) for side in (-0.05, 0.05)]
    assert np.abs(np.array(sides) - 1000).max() <= 4


def test_no_samples_and_no_area_are_refused() -> None:
    """A sample count of zero and a mesh without area are refused."""
    with pytest.raises(PlannerError, match="count is 0"):
        measure_deviation(REFERENCE, REFERENCE, np.random.default_rng(0), count=0)
    line = TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(PlannerError, match="no area"):
        sample_by_area(line, 10, np.random.default_rng(0))


def test_rounded_edges_are_left_out_of_the_numbers_and_stated_beside_them() -> None:
    """A box whose edges are cut by 2 mm deviates there only: not at all without a band of 4 mm."""
    vertices = trimesh.creation.box((0.1, 0.1, 0.1)).vertices
    cut = np.concatenate([vertices * np.where(np.arange(3) == axis, 1, 1 - 0.04) for axis in range(3)])
    hull = trimesh.convex.convex_hull(cut)
    mesh = TriangleMesh(np.asarray(hull.vertices), np.asarray(hull.faces))
    result = measure_deviation(mesh, REFERENCE, np.random.default_rng(4), count=20_000, edge_band=0.004)
    assert (result.rms, result.largest) == pytest.approx((0, 0), abs=1e-12)
    assert result.with_edges is not None
    assert 0.001 < result.with_edges.largest <= 0.002 * 2 / 3 + 1e-9  # middle of a cut edge, and of a cut corner
    assert result.with_edges.rms > 1e-4
    # Six squares of 92 mm are outside of the band; the band has the rest of the surface of the cut box.
    assert result.edge_share == pytest.approx(1 - 6 * 0.092**2 / hull.area, abs=0.005)
    everywhere = measure_deviation(mesh, REFERENCE, np.random.default_rng(4), count=20_000, edge_band=0.2)
    assert everywhere.with_edges is None
    assert everywhere.rms == pytest.approx(result.with_edges.rms)


@pytest.mark.parametrize(("overhang", "is_left_out"), [(0.006, True), (0.009, False)])
def test_a_surface_that_runs_on_beyond_an_edge_is_left_out(overhang: float, is_left_out: bool) -> None:
    """An overhang is an error of the surface up to twice the band of 4 mm; a longer one is an error of the part."""
    x = 0.05 + overhang
    plate = TriangleMesh(
        [[-0.04, -0.04, 0.05], [x, -0.04, 0.05], [x, 0.04, 0.05], [-0.04, 0.04, 0.05]], [[0, 1, 2], [0, 2, 3]]
    )
    result = measure_deviation(plate, REFERENCE, np.random.default_rng(4), count=20_000, edge_band=0.004)
    assert result.with_edges is not None
    assert result.with_edges.largest == pytest.approx(overhang, abs=1e-9)
    assert result.largest == pytest.approx(0.0 if is_left_out else overhang, abs=1e-9)


def test_points_of_sharp_edges_are_those_of_a_box_and_none_of_a_sphere() -> None:
    """A box has 12 sharp edges; the diagonals of its faces and a finely divided sphere have none."""
    points = sharp_edge_points(REFERENCE, 0.001)
    at_border = np.isclose(np.abs(points), 0.05).sum(axis=1)
    assert (at_border >= 2).all()
    assert len(points) == 12 * 101
    ball = trimesh.creation.icosphere(3)
    assert len(sharp_edge_points(TriangleMesh(ball.vertices, ball.faces), 0.001)) == 0


@pytest.mark.usefixtures("drawn_pictures")
def test_the_source_in_the_picture_is_no_formula(tmp_path: Path) -> None:
    """A command may contain dollar signs."""
    deviation = measure_deviation(REFERENCE, REFERENCE, np.random.default_rng(0), count=1000)
    scan_report.draw_deviation(tmp_path / "picture.png", REFERENCE, deviation, "points: command shoot $VIEW_$OUT")
    assert (tmp_path / "picture.png").stat().st_size > 1000
