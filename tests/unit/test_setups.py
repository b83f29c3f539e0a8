"""Set-ups: contact with supports, proposed candidates, recommended commands."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cell.errors import SceneError
from cell.part import workpiece
from cell.plan.setup_candidates import first_possible_cell, proposed_candidates, with_fixed_table
from cell.plan.stable_poses import MARGIN, Underside, stable_poses
from cell.runs.run import Run
from cell.runs.schema import Manifest
from cell.scene.model import Post, Scene
from cell.scene.settle import SettledScene, settle
from cell.why import advise
from cell.world.balance import support_margin
from cell.world.model import compile_world
from cell.world.occluders import Occluder
from cell.world.support_contact import in_contact
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples


def _samples(points: Any, normals: Any) -> SurfaceSamples:
    n = len(points)
    flat = np.zeros(n, dtype=np.int32)
    return SurfaceSamples(np.asarray(points, dtype=float), np.asarray(normals, dtype=float), np.ones(n), flat, flat)


def _table(low: float, high: float) -> Occluder:
    """Return a plate of 400 x 400 mm between two heights [m]."""
    box = trimesh.creation.box(bounds=[[-0.2, -0.2, low], [0.2, 0.2, high]])
    return Occluder("table", box.vertices, box.faces)


@pytest.mark.parametrize(
    ("height_mm", "normal", "touched"),
    [
        (0.0, (0, 0, -1), True),
        (0.99, (0, 0, -1), True),
        (1.01, (0, 0, -1), False),
        (-0.05, (0, 0, -1), True),  # the largest depth that a scene may have
        (0.3, (0, 0, 1), False),  # the upper side of a sheet
        (0.0, (1, 0, 0), False),  # a wall that rises from the table
        (0.5, (np.sin(1.2), 0, -np.cos(1.2)), False),  # 1.38 mm along its normal
        (0.5, (np.sin(1.0), 0, -np.cos(1.0)), True),  # 0.93 mm
    ],
)
def test_a_sample_touches_where_its_normal_meets_the_support_within_a_millimetre(
    height_mm: float, normal: tuple[float, float, float], touched: bool
) -> None:
    """Contact above a plate depends on height and normal; a sample outside the plate has no contact."""
    samples = _samples([[0.01, 0.02, height_mm / 1000], [0.3, 0, height_mm / 1000]], [normal, normal])
    assert in_contact(samples, [_table(-0.05, 0.0)]).tolist() == [touched, False]


def test_a_support_does_not_touch_through_a_sheet() -> None:
    """Each side of a sheet of 0.3 mm between two plates is in contact with its own plate only."""
    samples = _samples([[0, 0, 0], [0, 0, 0.0003]], [[0, 0, -1], [0, 0, 1]])
    below, above = _table(-0.05, 0.0), _table(0.0003, 0.05)
    assert in_contact(samples, [below]).tolist() == [True, False]
    assert in_contact(samples, [above]).tolist() == [False, True]


def test_a_ball_touches_with_the_cap_that_is_near() -> None:
    """The normal at an angle t from below meets the plate after (R - R cos t) / cos t: cos t >= R / (R + 1 mm)."""
    radius = 0.05
    normals = np.random.default_rng(0).normal(size=(200_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    samples = _samples(normals * radius + [0, 0, radius], normals)
    touched = in_contact(samples, [_table(-0.05, 0.0)])
    np.testing.assert_array_equal(touched, -normals[:, 2] >= radius / (radius + 1e-3))
    assert touched.mean() == pytest.approx(1e-3 / (radius + 1e-3) / 2, rel=0.1)


def test_a_box_is_offered_on_its_six_sides() -> None:
    """Each side is proposed at four turns, all different. Centre and height of the lowest point are kept."""
    box = trimesh.creation.box(extents=[0.06, 0.1, 0.16])
    scene = Scene.model_validate({"placement": {"position_mm": [1200, 500, 30]}})
    world = compile_world(scene, box.vertices, part_faces=box.faces, baseline_mm=75.0)
    offers = proposed_candidates(world, TriangleMesh(box.vertices, box.faces.astype(np.int32)), 100)
    assert len(offers) == 24
    assert offers[0].placement == scene.placement
    assert len({offer.name for offer in offers[:4]}) == 4
    T = np.stack([offer.placement.T for offer in offers])
    apart = np.abs(T[:, None, :3, :3] - T[None, :, :3, :3]).max(axis=(2, 3)) + np.eye(24)
    assert apart.min() > 0.5
    np.testing.assert_allclose(T[:, :2, 3], [[1.2, 0.5]] * 24, atol=1e-9)
    lowest = [(box.vertices @ pose[:3, :3].T)[:, 2].min() + pose[2, 3] for pose in T]
    np.testing.assert_allclose(lowest, -0.05, atol=2e-6)  # angles are rounded to a thousandth of a degree
    assert [offer.placement for offer in proposed_candidates(world, TriangleMesh(box.vertices, box.faces), 5)] == [
        offer.placement for offer in offers[:5]
    ]


@pytest.mark.parametrize(
    ("table", "turned"),
    [
        ({"enabled": True}, 0),  # under the part's centre, endless
        ({"enabled": True, "limits_deg": [-90, 90]}, 3),
        ({"position_mm": [1200, 480, -350]}, 3),  # off the axis the table moves the part along a circle
    ],
)
def test_a_turn_that_the_table_makes_is_not_proposed(table: dict[str, object], turned: int) -> None:
    """A table that fully turns the part about its centre gives one pose per side. Other tables give four."""
    box = trimesh.creation.box(extents=[0.06, 0.1, 0.16])
    scene = Scene.model_validate({"placement": {"position_mm": [1200, 500, 30]}, "table": table})
    world = compile_world(scene, box.vertices, part_faces=box.faces, baseline_mm=75.0)
    offers = proposed_candidates(world, TriangleMesh(box.vertices, box.faces.astype(np.int32)), 4)
    assert sum("turned" in offer.name for offer in offers) == turned
    fixed = with_fixed_table(scene, world)
    for offer in offers:  # the table keeps its pose
        again = compile_world(offer.scene(fixed), box.vertices, part_faces=box.faces, baseline_mm=75.0)
        assert again.table is not None
        assert world.table is not None
        np.testing.assert_allclose(again.table.T_base_table, world.table.T_base_table, atol=1e-9)
        assert again.T_base_post(again.T_base_object)[2, 3] == pytest.approx(-0.05, abs=2e-6)


def test_no_set_up_is_proposed_on_a_tilted_table() -> None:
    """No pose is stable on a tilted table, and the message names the required option."""
    box = trimesh.creation.box(extents=[0.06, 0.1, 0.16])
    scene = Scene.model_validate({"table": {"abc_deg": [0, 30, 0]}})
    world = compile_world(scene, box.vertices, part_faces=box.faces, baseline_mm=75.0)
    part = TriangleMesh(box.vertices, box.faces.astype(np.int32))
    assert proposed_candidates(world, part, 0) == []
    with pytest.raises(SceneError, match="this one is tilted; give"):
        proposed_candidates(world, part, 4)


def test_advice_is_a_command_that_can_be_pasted(tmp_path: Path) -> None:
    """The run is the fixed first set-up of a command for set-ups. A new placement gives the command of the run."""
    T = np.eye(4)
    T[:3, 3] = 1.2, 0.5, 0
    run = Run(tmp_path / "run", Manifest(argv=("plan", "mug", "--place", "1,2,3", "--faces", "60", "--out", "run")))
    first = f"--first {run.folder} --proposals 1 --place 1200,500,0,0,0,0"
    assert advise.setup_command(run, T) == f"cell setups {first}"
    assert advise.replan_command(run, T) == "cell plan mug --faces 60 --place 1200,500,0,0,0,0"
    with_equals = Manifest(argv=("plan", "mug", "--place-origin=1,2,3", "--out=run", "--faces=60"))
    again = advise.replan_command(Run(tmp_path / "run", with_equals), T)
    assert again == "cell plan mug --faces=60 --place 1200,500,0,0,0,0"
    several = Run(tmp_path / "setups" / "1", Manifest(argv=("setups", "mug", "--place", "1,2,3", "--max-setups", "2")))
    assert advise.replan_command(several, T) == "cell setups mug --max-setups 2 --place 1200,500,0,0,0,0"


def _mesh(*boxes: Any) -> TriangleMesh:
    """Return the boxes with these bounds [m] as one mesh."""
    mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in boxes])
    return TriangleMesh(mesh.vertices, mesh.faces.astype(np.int32))


BRACKET = _mesh([[0, 0, 0], [0.1, 0.01, 0.05]], [[0, 0.01, 0], [0.01, 0.1, 0.05]])
"""An L of two legs of 100 mm, 10 mm thick and 50 mm wide: both legs and the centre of mass are off its middle."""


@pytest.mark.parametrize(
    ("diameter_mm", "margin_mm"),
    [
        (40.0, 15.0),  # a square of 30 mm is inside the post
        (30.0, 15.0 * np.cos(np.pi / 72)),  # a polygon of 72 corners inside the square
    ],
)
def test_the_margin_on_a_post_is_the_distance_to_the_edge_of_the_contacts(diameter_mm: float, margin_mm: float) -> None:
    """Post and part limit the contact polygon."""
    cube = _mesh([[-0.015, -0.015, 0], [0.015, 0.015, 0.03]])
    found = Underside(cube, np.eye(3), np.zeros(3)).margin(Post(diameter_mm=diameter_mm))
    assert 1000 * found == pytest.approx(margin_mm, rel=1e-9 if diameter_mm == 40 else 2e-3)


def test_a_pose_has_the_thinnest_post_that_supports_it() -> None:
    """The flat L has contacts on its legs only, and its centre of mass 34 mm from its middle along the diagonal.

    The contacts are checked against rays from below, the centre of mass against the centres of the two boxes.
    """
    middle = np.array([0.05, 0.05, 0.025])
    mass = (0.1 * np.array([0.05, 0.005]) + 0.09 * np.array([0.005, 0.055])) / 0.19 - middle[:2]
    side = Underside(BRACKET, np.eye(3), middle)
    post = side.supporting_post(Post())
    assert post is not None

    def margin(diameter_mm: float) -> float:
        x, y = (each.ravel() for each in np.meshgrid(*[np.arange(0.0, 0.1, 0.0002) - 0.05] * 2))
        on_part = (x < -0.04) | (y < -0.04)
        points = np.column_stack([x, y])[on_part & (np.hypot(x, y) <= diameter_mm / 2000)]
        if len(points) < 3:
            return -np.inf
        hull = ConvexHull(points)
        return -float((hull.equations[:, :2] @ mass + hull.equations[:, 2]).max())

    assert margin(post.diameter_mm) >= MARGIN - 0.0004
    assert margin(post.diameter_mm - 10) < MARGIN + 0.0004
    assert side.margin(Post()) == -np.inf
    for diameter_mm in (90.0, 110.0, 150.0):
        assert side.margin(Post(diameter_mm=diameter_mm)) == pytest.approx(margin(diameter_mm), abs=4e-4)


def test_a_bracket_is_proposed_on_posts_that_support_it() -> None:
    """Every proposed pose but the placed one rests on its post; the placed one needs a fixture and says so."""
    scene = Scene.model_validate({"placement": {"position_mm": [1200, 500, 200]}})
    world = compile_world(scene, BRACKET.vertices, part_faces=BRACKET.faces, baseline_mm=75.0)
    offers = proposed_candidates(world, BRACKET, 100)
    assert all("needs a fixture: on the post of 40 mm" in offer.name for offer in offers[:4])
    assert len(offers) > 8
    for offer in offers[4:]:
        post = offer.scene(scene).post
        R = offer.placement.T[:3, :3]
        assert f"on a post of {post.diameter_mm:g} mm" in offer.name
        lowest = BRACKET.vertices @ R[2]
        assert (lowest <= lowest.min() + 1e-5).sum() >= 3
    assert {offer.post.diameter_mm for offer in offers[4:] if offer.post} >= {50.0, 90.0}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("turn", [np.eye(3), Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()])
def test_a_flat_sheet_rests_on_either_side(turn: np.ndarray) -> None:
    """It has no volume and no convex hull. Both sides are poses of the same probability, with its plane level."""
    corners = np.array([[0, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0], [0, 0.1, 0]]) @ turn.T
    sheet = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    poses = list(stable_poses(sheet))
    assert [probability for _, probability in poses] == [0.5, 0.5]
    assert poses[0][0][2] @ poses[1][0][2] == pytest.approx(-1)
    for R, _ in poses:
        assert np.ptp(corners @ R[2]) < 1e-12
        assert np.linalg.det(R) == pytest.approx(1)
        assert Underside(sheet, R, corners.mean(axis=0)).supporting_post(Post()) == Post()


def test_without_a_post_a_pose_rests_on_fixtures_or_is_not_possible() -> None:
    """A plate below the part supports it; beside it, nothing does."""
    box = trimesh.creation.box(extents=[0.06, 0.06, 0.06])

    def margin(x_mm: float) -> float:
        plate = {"name": "plate", "shape": "box", "position_mm": [x_mm, 500, 160], "size_mm": [100, 100, 20]}
        tables = {"placement": {"position_mm": [1200, 500, 200]}, "post": {"enabled": False}, "fixtures": [plate]}
        world = compile_world(Scene.model_validate(tables), box.vertices, part_faces=box.faces, baseline_mm=75.0)
        return support_margin(world)

    assert margin(1200) == pytest.approx(0.03, abs=2e-3)
    assert margin(1270) == pytest.approx(-0.02, abs=2e-3)
    assert margin(1400) == -np.inf


def test_a_set_up_that_the_table_cannot_carry_leaves_the_others() -> None:
    """The first set-up that compiles gives the cell. Without any, an error is raised."""
    part = workpiece.load("mug", None)
    table = {"position_mm": [1200, 500, -350], "diameter_mm": 300.0}

    def settled(x: float) -> SettledScene:
        tables = {"part": {"name": "mug"}, "placement": {"position_mm": [x, 500, 0]}, "table": table}
        return settle(Scene.model_validate(tables), part)

    near, far, farther = settled(1200), settled(1900), settled(2600)
    assert first_possible_cell([far, near], part.reference)[0] is near
    with pytest.raises(SceneError):
        first_possible_cell([far, farther], part.reference)
