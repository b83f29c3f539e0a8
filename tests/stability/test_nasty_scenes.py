"""Difficult scenes: flat and huge and tiny parts, far origins, touching fixtures, no clearance, invalid values."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.errors import CellError, SceneError
from cell.scene.file import load_scene
from cell.scene.model import Scene
from cell.world.checks import require_feasible
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import compile_world
from cell.world.shapes import collision_hull
from planner.geometry.hull import MIN_THICKNESS, solid_hull

RNG = np.random.default_rng(0)
BALL = np.array(trimesh.creation.icosphere(3, 0.1).vertices)
TURN = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]

PARTS = {
    "flat sheet": np.array([[x, y, 0.0] for x in (0, 0.2) for y in (0, 0.3)]),
    "flat sheet, turned": np.array([[x, y, 0.0] for x in (0, 0.2) for y in (0, 0.3)]) @ TURN,
    "one triangle": np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.0]]),
    "straight wire": np.linspace([0, 0, 0], [0.1, 0.2, 0.05], 7),
    "a point": np.zeros((3, 3)),
    "almost flat": np.column_stack([RNG.uniform(-0.1, 0.1, (200, 2)), RNG.uniform(-1e-8, 1e-8, 200)]),
    "a hair": np.column_stack([RNG.uniform(-0.1, 0.1, 100), RNG.uniform(-1e-9, 1e-9, (100, 2))]),
    "9 mm": BALL * 0.045,
    "0.2 mm": BALL * 0.001,
    "5 m, far away": BALL * 25,
    "100 m from its origin": BALL + np.array([100.0, -50.0, 20.0]),
    "every vertex ten times": np.repeat(BALL, 10, axis=0),
    "10,000 vertices on the hull": np.array(trimesh.creation.icosphere(5, 0.1).vertices),
    "box with coplanar grids": np.array([[x, y, z] for x in range(6) for y in range(6) for z in range(6)]) * 0.03,
}


@pytest.mark.parametrize("name", PARTS)
def test_every_part_becomes_a_solid_that_contains_it(name: str) -> None:
    """The hull is closed, outward, has volume and contains every vertex; only the thickening enlarges it."""
    vertices = PARTS[name]
    hull = solid_hull(vertices)
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert (np.ptp(hull.vertices, axis=0) <= np.ptp(vertices, axis=0) + 1.001 * MIN_THICKNESS * np.sqrt(3)).all()
    normals, corners = mesh.face_normals, hull.vertices[hull.faces[:, 0]]
    some = np.flatnonzero(mesh.area_faces > 0)[:: max(1, len(normals) // 500)]
    normals, corners = normals[some], corners[some]
    outside = (vertices @ normals.T - np.einsum("fj,fj->f", normals, corners)).max()
    assert outside < 1e-9 * (1 + np.abs(vertices).max())


@pytest.mark.parametrize("name", PARTS)
def test_every_part_compiles_and_collides(name: str) -> None:
    """Home is free with the part at its placement, and not free with the part in the scanner."""
    vertices = PARTS[name]
    far = {"position_mm": [4500, 4500, 2500]} if name.startswith("5 m") else {}
    scene = Scene.model_validate({"placement": far})
    world = compile_world(scene, vertices, baseline_mm=75.0)
    assert MujocoCollisionChecker(world).free(world.home[None])[0]
    inside = np.eye(4)
    inside[:3, 3] = world.data().geom("housing").xpos
    contacts = MujocoCollisionChecker(world, world.T_base_object_at(inside)).contacts(world.home)
    assert "housing with part" in contacts


def test_a_part_of_five_metres_at_the_default_place_is_refused() -> None:
    """The overlaps with robot, pedestal and floor are reported in one line each."""
    world = compile_world(Scene(), PARTS["5 m, far away"], baseline_mm=75.0)
    with pytest.raises(SceneError) as caught:
        require_feasible(world)
    text = str(caught.value)
    assert "below the floor" in text
    assert "the part intersects the pedestal" in text


@pytest.mark.parametrize(
    "vertices", [np.zeros((0, 3)), np.full((4, 3), np.nan), np.full((4, 3), np.inf), np.zeros((4, 2))]
)
def test_invalid_vertices_are_refused(vertices: np.ndarray) -> None:
    """A part without vertices and vertices that are not finite are refused."""
    with pytest.raises(SceneError, match="no finite vertices"):
        collision_hull(vertices, "part")


@pytest.mark.parametrize("depth_mm", [-0.001, 0.0, 0.001, 30.0])
def test_a_fixture_may_touch_or_enter_the_part(depth_mm: float) -> None:
    """Clamps may touch parts: such a scene compiles, and only the robot has a clearance."""
    fixture = {"name": "clamp", "shape": "box", "size_mm": [50, 50, 50], "attached_to": "object",
               "position_mm": [0, 0, 125 - depth_mm]}  # fmt: skip
    table = {"name": "table", "shape": "box", "size_mm": [300, 300, 20], "position_mm": [1200, 500, -110 + depth_mm]}
    world = compile_world(Scene.model_validate({"fixtures": [fixture, table]}), BALL, baseline_mm=75.0)
    assert MujocoCollisionChecker(world).contacts(world.home) == ()


def test_zero_clearance_allows_touch_but_no_overlap() -> None:
    """A gap of a micrometre is free and an overlap of a micrometre is not."""
    scene = Scene.model_validate({"clearance_mm": 0, "post": {"enabled": False}})
    box = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    world = compile_world(scene, box, baseline_mm=75.0)
    front = world.data().geom("housing").xpos + np.array([0.0, 0.0, -0.03])  # the scanner is aimed down at home
    for gap, free in ((1e-6, True), (-1e-6, False)):
        T = np.eye(4)
        T[:3, 3] = front - [0.0, 0.0, 0.1 + gap]
        assert MujocoCollisionChecker(world, world.T_base_object_at(T)).free(world.home[None])[0] == free


@pytest.mark.parametrize("clearance_mm", [0.001, 1, 10, 80])
def test_the_clearance_is_kept_to_a_micrometre(clearance_mm: float) -> None:
    """Slightly inside the clearance is not free, slightly outside is, for any clearance."""
    scene = Scene.model_validate({"clearance_mm": clearance_mm, "post": {"enabled": False}})
    world = compile_world(scene, BALL, baseline_mm=75.0)
    front = world.data().geom("housing").xpos + np.array([0.0, 0.0, -0.03])
    for margin, free in ((1e-6, True), (-1e-6, False)):
        T = np.eye(4)
        T[:3, 3] = front - [0.0, 0.0, 0.1 + clearance_mm / 1000 + margin]
        assert MujocoCollisionChecker(world, world.T_base_object_at(T)).free(world.home[None])[0] == free


def test_no_pedestal_no_post_no_bracket() -> None:
    """Without all optional objects the floor is at the robot's foot."""
    scene = Scene.model_validate(
        {"robot": {"pedestal_height_mm": 0}, "post": {"enabled": False}, "housing": {"bracket_diameter_mm": 0},
         "placement": {"position_mm": [1200, 500, 100]}}
    )  # fmt: skip
    world = compile_world(scene, BALL, baseline_mm=0.0)
    assert world.floor == 0.0
    assert {"pedestal", "post", "bracket"}.isdisjoint(world.entities)
    assert MujocoCollisionChecker(world).free(world.home[None])[0]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("vice.stl", b"solid nothing\nendsolid nothing\n", "vice.stl"),
        ("vice.stl", b"this is no mesh", "vice.stl"),
        ("vice.txt", b"text", "not supported"),
    ],
)
def test_an_invalid_fixture_mesh_is_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    """The message names the file."""
    (tmp_path / name).write_bytes(content)
    path = tmp_path / "scene.toml"
    path.write_text(f"[[fixtures]]\nname='vice'\nshape='mesh'\npath='{name}'\nunits='mm'\n")
    with pytest.raises(CellError, match=words):
        compile_world(load_scene(path), BALL, baseline_mm=75.0)


def test_a_flat_fixture_mesh_collides(tmp_path: Path) -> None:
    """A mesh without thickness is still an obstacle."""
    sheet = trimesh.Trimesh([[0, -500, -500], [0, 500, -500], [0, 500, 500], [0, -500, 500]], [[0, 1, 2], [0, 2, 3]])
    path = tmp_path / "sheet.ply"
    sheet.export(path)
    fixture = {"name": "sheet", "shape": "mesh", "path": str(path), "units": "mm", "position_mm": [600, 0, 1300]}
    world = compile_world(Scene.model_validate({"fixtures": [fixture]}), BALL, baseline_mm=75.0)
    with pytest.raises(SceneError, match="the fixture 'sheet' intersects the robot's"):
        require_feasible(world)
