"""Parts for which hull and triangles differ, or on which a tree of triangles may fail, by name."""

from collections.abc import Callable
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh

from cell.errors import SceneError
from cell.robot.arm import kinematics_of
from cell.scene.model import Scene
from cell.view.overlays import find_violations
from cell.world.checks import find_problems
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from cell.world.shapes import ShapeDistances

FIDELITIES = ("hull", "exact")
PLACE_MM = (1100.0, 0.0, -100.0)


def _world(mesh: trimesh.Trimesh, collision: str, **tables: object) -> World:
    scene = Scene.model_validate(
        {"plan": {"collision": collision}, "placement": {"position_mm": PLACE_MM}, "post": {"enabled": False}} | tables
    )
    return compile_world(scene, mesh.vertices, part_faces=np.array(mesh.faces), baseline_mm=75.0)


def _bucket() -> trimesh.Trimesh:
    outline = [(0.0, 0.0), (0.24, 0.0), (0.24, 0.36), (0.228, 0.36), (0.228, 0.012), (0.0, 0.012)]
    return trimesh.creation.revolve(np.array(outline), sections=80)


def _looking_down(world: World, depth: float) -> np.ndarray:
    """Return configurations (N, 6) with the scanner on the part's axis, aimed down, `depth` below its top [m]."""
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    centre = (world.T_base_object @ world.T_object_centre)[:3, 3]
    T[:3, 3] = centre + np.array([0.0, 0.0, np.ptp(world.part_hull.vertices[:, 2]) / 2 - depth])
    kinematics = kinematics_of(world.model)
    q = kinematics.inverse((T @ np.linalg.inv(world.T_flange_scanner))[None])[0]
    q = q[np.isfinite(q).all(axis=1)]
    return q[((q >= world.limits.lower) & (q <= world.limits.upper)).all(axis=1)]


@pytest.fixture(scope="module")
def buckets() -> dict[str, World]:
    """Return a deep bucket as hull and as triangles."""
    return {collision: _world(_bucket(), collision) for collision in FIDELITIES}


def test_a_deep_cavity_is_closed_to_the_hull_and_open_to_the_triangles(buckets: dict[str, World]) -> None:
    """With triangles a scanner 120 mm below the rim is free. Both reject it after a shift of the part."""
    verdicts = {}
    for collision, world in buckets.items():
        q = _looking_down(world, 0.12)
        assert len(q)
        checker = MujocoCollisionChecker(world)
        verdicts[collision] = checker.free(q)
        if collision == "hull":
            assert all("housing with part" in checker.contacts(one) for one in q)
        shifted = MujocoCollisionChecker(world, world.T_base_object + np.outer([0.2, 0, 0, 0], [0, 0, 0, 1]))
        assert not shifted.free(q).any()
    assert not verdicts["hull"].any()
    assert verdicts["exact"].any()


def test_replay_shows_no_contact_with_a_hull_that_was_not_the_part(buckets: dict[str, World]) -> None:
    """In the bucket replay reports no violation with triangles, and one with the hull."""
    world = buckets["exact"]
    q = next(q for q in _looking_down(world, 0.12) if MujocoCollisionChecker(world).free(q[None])[0])
    data = world.data()
    data.qpos[:] = q
    mujoco.mj_kinematics(world.model, data)
    replay_model = SimpleNamespace(
        model=world.model, geom_names=world.entities, clearance=world.clearance, shapes=world.shapes, pair_clearances={}
    )
    assert find_violations(replay_model, data) == ()
    replay_model.shapes = ShapeDistances(world.model, {}, ())
    assert any("part" in touch.names for touch in find_violations(replay_model, data))


def _sheet() -> trimesh.Trimesh:
    corners = [[-0.2, -0.1, 0], [0.2, -0.1, 0], [0.2, 0.1, 0], [-0.2, 0.1, 0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def _open_bowl() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(3, 0.15)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.02])


def _inside_out() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(2, 0.15)
    return trimesh.Trimesh(ball.vertices, ball.faces[:, ::-1], process=False)


def _shells() -> trimesh.Trimesh:
    balls = [trimesh.creation.icosphere(2, 0.03) for _ in range(5)]
    for k, ball in enumerate(balls):
        ball.apply_translation([0.0, 0.1 * k, 0.03 * (k % 2)])
    return trimesh.util.concatenate(balls)


PARTS: dict[str, Callable[[], trimesh.Trimesh]] = {
    "a thin sheet": _sheet,
    "a bowl that is not closed": _open_bowl,
    "a ball that is inside out": _inside_out,
    "five shells": _shells,
    "a ring around nothing": lambda: trimesh.creation.annulus(0.18, 0.2, 0.03),
    "one triangle": lambda: trimesh.Trimesh([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]], [[0, 1, 2]], process=False),
    "a triangle given twice": lambda: trimesh.Trimesh(
        [[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]], [[0, 1, 2], [0, 2, 1]], process=False
    ),
}


@pytest.mark.parametrize("name", PARTS)
def test_nasty_parts_compile_and_are_found_in_every_fidelity(name: str) -> None:
    """The housing at its centre of mass is a contact, home is free, for hull and triangles."""
    mesh = PARTS[name]()
    for collision in FIDELITIES:
        world = _world(mesh, collision)
        checker = MujocoCollisionChecker(world)
        assert checker.free(world.home[None])[0]
        # Put a vertex of the part into the middle of the housing at home.
        data = world.data()
        housing = data.geom_xpos[world.model.geom("housing").id]
        T = np.eye(4)
        T[:3, 3] = housing - mesh.vertices[mesh.faces[0, 0]]
        at_housing = MujocoCollisionChecker(world, T)
        assert not at_housing.free(world.home[None])[0]
        distance, names = at_housing.distance(world.home[None])
        assert distance[0] <= 0
        assert "housing with part" in at_housing.contacts(world.home)
        assert names[0].endswith("part")


@pytest.mark.parametrize("collision", FIDELITIES)
def test_a_part_that_cuts_into_the_pedestal_is_refused_and_one_that_stands_on_it_is_not(collision: str) -> None:
    """A part 5 mm deep in the pedestal is refused, and a flush one is accepted."""
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    for depth_mm, refused in ((5.0, True), (0.0, False), (-5.0, False)):
        place = {"position_mm": [-450.0, 450.0, 50.0 - depth_mm]}
        problems = find_problems(_world(box, collision, placement=place, robot={"pedestal_size_mm": [1200.0, 1200.0]}))
        assert any("the part intersects the pedestal" in output for output in problems) == refused


def test_vertices_alone_are_taken_as_their_hull() -> None:
    """Without triangles the world reports the hull."""
    ball = trimesh.creation.icosphere(2, 0.1)
    assert compile_world(Scene(), ball.vertices, baseline_mm=75.0).collision == "hull"


def test_a_fidelity_that_does_not_exist_is_named() -> None:
    """The message has the valid ones. A part without a finite vertex is refused before its triangles are used."""
    with pytest.raises(ValueError, match="'hull' or 'exact'"):
        Scene.model_validate({"plan": {"collision": "convex"}})
    with pytest.raises(SceneError, match="no finite vertices"):
        _world(trimesh.Trimesh([[np.nan] * 3] * 3, [[0, 1, 2]], process=False), "exact")
