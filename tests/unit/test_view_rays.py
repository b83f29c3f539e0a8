"""Pictures by ray casting: projection, hidden lines, translucent pieces, labels without overlaps."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cell.errors import UsageError
from cell.report import figures
from cell.runs.run import open_run
from cell.view import rays
from cell.view.cell_picture import best_view, draw_cell
from cell.view.palette import LENGTHS, OPEN, REASONS, SEEN, SIGNED, rgb
from cell.view.pieces import CellGeometry, Piece, cell_of_run
from cell.world.embree import EmbreeRayCaster
from cell.world.occluders import box_triangles
from planner.geometry.mesh import TriangleMesh

_SIZE = (160, 120)


@pytest.mark.parametrize("parallel", [True, False])
def test_rays_and_projection_agree(parallel: bool) -> None:
    """A point on a pixel's ray is projected to that pixel and distance; all fitted points are in the picture."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3)) * [0.5, 0.2, 0.3] + [1.0, 2.0, 3.0]
    camera = rays.fit_camera(points, rays.direction(30, 25), _SIZE, parallel=parallel)
    origins, directions = camera.rays()
    far = rng.uniform(0.5, 2.0, len(origins))
    at = camera.project(origins + far[:, None] * directions)
    pixel = np.arange(len(origins))
    np.testing.assert_allclose(at[:, 0], pixel % _SIZE[0] + 0.5, atol=1e-6)
    np.testing.assert_allclose(at[:, 1], pixel // _SIZE[0] + 0.5, atol=1e-6)
    np.testing.assert_allclose(at[:, 2], far, atol=1e-9)
    seen = camera.project(points)
    assert (seen[:, :2] >= 0).all()
    assert (seen[:, :2] <= _SIZE).all()


def test_a_line_behind_a_surface_is_hidden() -> None:
    """The ends of a line through a box are visible, and its middle has the colour of hidden pieces."""
    vertices, faces = box_triangles(np.array([0.1, 0.1, 0.1]))
    caster = EmbreeRayCaster(vertices, faces)
    around = np.array([[-0.3, -0.3, -0.3], [0.3, 0.3, 0.3]])
    camera = rays.fit_camera(around, np.array([1.0, 0.0, 0.0]), (200, 200), parallel=True)
    image, seen = rays.render(
        camera, lambda o, d: (np.ones((len(o), 3)), caster.first_hit(o, d).distance)
    )  # all pixels are white
    stroke = np.array([[[0.0, -0.25, 0.0], [0.0, 0.25, 0.0]]])
    rays.draw_lines(image, seen, stroke, "#ff0000", width=3, hidden="#0000ff")
    row = np.asarray(image)[100].astype(int)
    red, blue = np.flatnonzero(row[:, 0] - row[:, 2] > 100), np.flatnonzero(row[:, 2] - row[:, 0] > 100)
    assert len(red) > 50
    assert len(blue) > 50
    assert red.min() < blue.min() < blue.max() < red.max()


def test_labels_do_not_overlap() -> None:
    """Thirty numbers at one place have as many dark pixels as thirty separate ones."""

    def ink(places: np.ndarray) -> int:
        image = Image.new("RGB", (600, 600), "white")
        rays.draw_labels(image, places, [str(k) for k in range(10, 40)], size=12)
        dark = np.asarray(image).astype(int)
        return int((dark.max(axis=2) < 60).sum())

    apart = np.array([[60 + 90 * (k % 6), 60 + 100 * (k // 6)] for k in range(30)], dtype=float)
    crowded = np.full((30, 2), 300.0)
    assert ink(crowded) > 0.85 * ink(apart)


@pytest.fixture(scope="module")
def planned_view(planned: Path) -> tuple[CellGeometry, TriangleMesh, np.ndarray, np.ndarray]:
    """Return the planned cell, its part, the joint angles at a view, and all views."""
    run = open_run(planned)
    cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
    views = run.plan.views
    poses = np.stack([view.T_base_scanner for view in views])
    return cell, part, views[best_view(cell, part, poses)].q, poses


def test_a_wall_in_front_is_translucent(
    planned_view: tuple[CellGeometry, TriangleMesh, np.ndarray, np.ndarray],
) -> None:
    """The robot is visible through the wall. From the other side the wall is opaque, and it can be hidden."""
    cell, part, q, views = planned_view
    vertices, faces = box_triangles(np.array([1.2, 0.02, 1.2]))
    wall = Piece("wall", 0, vertices + np.array([0.6, -1.2, 0.4]), faces, np.array([0.2, 0.3, 0.9]))
    walled = replace(cell, pieces=(*cell.pieces, wall))

    def colours(azimuth: float, *hide: str, of: CellGeometry = walled) -> np.ndarray:
        image, _ = draw_cell(
            of, part, q, views=views, path=np.zeros((0, 3)), size=_SIZE, camera=(azimuth, 10.0), hide=hide
        )
        return np.asarray(image).astype(int)

    def orange(picture: np.ndarray) -> int:
        return int((picture[..., 0] > picture[..., 2] + 60).sum())

    bare = colours(-90, of=cell)
    assert orange(colours(-90)) > 0.8 * orange(bare) > 500
    np.testing.assert_array_equal(colours(-90, "wall"), bare)
    behind = colours(90)
    assert orange(behind) > 500
    assert int((behind[..., 2] > behind[..., 0] + 60).sum()) > 500
    with pytest.raises(UsageError, match=r"--hide door is not a piece of this cell; it has: post, pedestal, .*wall"):
        colours(0, "door")


def test_the_picture_of_the_report_obeys_its_options(planned: Path, tmp_path: Path) -> None:
    """A hidden robot has no orange pixels; an unknown name is ignored; another camera gives another picture."""
    shutil.copytree(planned, tmp_path / "run")
    views = open_run(planned).plan.views
    q, poses = np.stack([view.q for view in views]), np.stack([view.T_base_scanner for view in views])

    def picture(camera: tuple[float, ...], *hide: str) -> np.ndarray:
        path = tmp_path / "run" / "mine.png"
        way, hidden = np.zeros((0, 3)), np.array(hide, dtype=np.str_)
        figures.cell_with_arm(
            path, q=q, T_base_scanner=poses, source_path=way, camera_deg=np.array(camera), hide=hidden
        )
        with Image.open(path) as image:
            return np.asarray(image).astype(int)

    def orange(seen: np.ndarray) -> int:
        return int(((seen[..., 0] > 150) & (seen[..., 2] < 40)).sum())

    usual = picture(())
    assert orange(usual) > 1000 + orange(picture((), "robot", "turntable"))
    assert (picture((200.0, 10.0)) != usual).any()


def test_colours_differ_for_every_colour_vision() -> None:
    """For deuteranopes and protanopes (Vienot 1999), uncovered and measured colours differ; scales are monotonic."""
    linear = np.array([rgb(colour) for colour in (OPEN, *SEEN)]) ** 2.2
    to_lms = np.array([[17.8824, 43.5161, 4.1194], [3.4557, 27.1554, 3.8671], [0.02996, 0.18431, 1.4670]])
    deutan = np.array([[1.0, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]])
    protan = np.array([[0, 2.02344, -2.52581], [0, 1.0, 0], [0, 0, 1]])
    for loss in (np.eye(3), deutan, protan):
        seen = (linear @ (np.linalg.inv(to_lms) @ loss @ to_lms).T).clip(0, 1) ** (1 / 2.2)
        apart = np.linalg.norm(seen[0] - seen[1:], axis=1)
        assert apart.min() > 0.35
    for scale in (LENGTHS, SIGNED[:5], SIGNED[4:][::-1]):
        bright = [float(rgb(colour) @ [0.30, 0.59, 0.11]) for colour in scale]
        assert (np.diff(bright) > 0).all()
    assert len(set(REASONS)) == len(REASONS)
