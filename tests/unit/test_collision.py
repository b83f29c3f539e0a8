"""Collision checker: names, consistency, independence of history, invalid input."""

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cell.scene.model import Scene
from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.errors import PlannerError

PART = np.array(trimesh.creation.icosphere(3, 0.12).vertices)


@pytest.fixture(scope="module")
def world() -> World:
    """Return the built-in cell with a ball as part."""
    return compile_world(Scene(), PART, baseline_mm=75.0)


@pytest.fixture
def checker(world: World) -> MujocoCollisionChecker:
    """Return a new checker."""
    return MujocoCollisionChecker(world)


def _random(world: World, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(world.limits.lower, world.limits.upper, (count, 6))


@pytest.mark.parametrize(
    ("q_deg", "position", "name"),
    [
        ([0, 30, 60, 0, 0, 0], [1200, 500, 0], "housing with floor"),
        ([-30, 30, 120, -270, -40, 110], [1200, 500, 0], "housing with pedestal"),
        ([0, -90, 90, 0, 90, 0], [930, 0, 920], "housing with part"),
        ([0, -90, 90, 0, 90, 0], [930, 0, 1500], "link_4 with part"),
        ([-185, -155, -130, -350, -130, -350], [1200, 500, 0], "housing with link_1"),
    ],
)
def test_contacts_are_named(world: World, q_deg: list, position: list, name: str) -> None:
    """Pairs in contact have the names of the scene, the more mobile body first."""
    T = np.eye(4)
    T[:3, 3] = np.array(position) / 1000
    checker = MujocoCollisionChecker(world, world.T_base_object_at(T))
    q = np.deg2rad(q_deg)
    assert name in checker.contacts(q)
    assert not checker.free(q[None])[0]


def test_contacts_come_nearest_first(world: World, checker: MujocoCollisionChecker) -> None:
    """Contacts are sorted by distance, and the first has the smallest distance of all pairs."""
    several = 0
    for q in _random(world, 1500):
        near = checker.pairs_within_clearance(q)
        gaps = [gap for _, gap in near]
        assert gaps == sorted(gaps)
        assert all(gap < checker.clearance for gap in gaps)
        if near:
            distance, _ = checker.distance(q[None])
            assert gaps[0] == pytest.approx(distance[0], abs=1e-9)
            several += len(near) > 1
    assert several > 5


def test_free_contacts_and_distance_agree(world: World, checker: MujocoCollisionChecker) -> None:
    """A configuration is free if and only if it has no contact and its distance is at least the clearance."""
    q = _random(world, 20000, seed=4)
    free = checker.free(q)
    distance, names = checker.distance(q)
    assert np.array_equal(free, distance >= checker.clearance)
    beside = np.flatnonzero((distance > 0) & (distance < 2 * checker.clearance))
    assert len(beside) > 100
    assert (free[beside].any(), free[beside].all()) == (True, False)
    for i in beside[:100]:
        assert bool(checker.contacts(q[i])) != free[i]
    for i in np.flatnonzero(~free)[:200]:
        assert names[i] == checker.contacts(q[i])[0]


def test_boxes_edge_to_edge_are_found() -> None:
    """The checker finds near pairs that MuJoCo's box-box margin misses, which the test verifies."""
    crate = {"name": "crate", "shape": "box", "size_mm": [300, 200, 100], "attached_to": "object"}
    scene = Scene.model_validate({"fixtures": [{**crate, "position_mm": [2000, 0, 0]}], "post": {"enabled": False}})
    world = compile_world(scene, PART, baseline_mm=75.0)
    data, rng, overlooked = world.data(), np.random.default_rng(0), 0
    q, boxes = world.home, [world.model.geom(name).id for name in ("crate", "housing")]
    moved = world.model.body("object").mocapid[0]
    for rotation in Rotation.random(6000, rng=rng):
        T = np.eye(4)
        T[:3, :3] = rotation.as_matrix()
        T[:3, 3] = data.geom("housing").xpos + rng.normal(0, 0.1, 3) - T[:3, 0] * 2.0
        data.mocap_pos[moved], data.mocap_quat[moved] = T[:3, 3], rotation.as_quat(scalar_first=True)
        mujoco.mj_kinematics(world.model, data)
        mujoco.mj_collision(world.model, data)
        if data.ncon == 0 and mujoco.mj_geomDistance(world.model, data, *boxes, 1.0, None) < 0.0099:
            overlooked += 1
            checker = MujocoCollisionChecker(world, T)
            assert not checker.free(q[None])[0]
            assert 0 < checker.pairs_within_clearance(q)[0][1] < checker.clearance
    assert overlooked > 0


def test_distance_is_capped_and_then_has_no_name() -> None:
    """If every pair is farther apart than the cap, the distance is the cap and the name is empty."""
    scene = Scene.model_validate(
        {"mount": {"position_mm": [0, 0, 900]}, "housing": {"size_mm": [10, 10, 10], "bracket_diameter_mm": 0}}
    )
    world = compile_world(scene, PART, baseline_mm=0.0)
    distance, names = MujocoCollisionChecker(world).distance(
        np.deg2rad([[-74, -75, -122, -263, 44, 103], [0, 30, 60, 0, 0, 0]])
    )
    assert (distance[0], names[0]) == (DISTANCE_CAP, "")
    assert distance[1] < DISTANCE_CAP
    assert names[1]


def test_answers_do_not_depend_on_history(world: World) -> None:
    """Results are bit-equal in any order, for any subset, with a used and with a new checker."""
    q = _random(world, 1500, seed=7)
    used = MujocoCollisionChecker(world)
    free, (distance, names) = used.free(q), used.distance(q)
    order = np.random.default_rng(1).permutation(len(q))
    assert np.array_equal(used.free(q[order]), free[order])
    again, again_names = used.distance(q[order])
    assert np.array_equal(again, distance[order])
    assert again_names == tuple(names[i] for i in order)
    for i in order[:50]:
        fresh = MujocoCollisionChecker(world)
        assert fresh.free(q[i : i + 1])[0] == free[i]
        assert fresh.distance(q[i : i + 1])[0][0] == distance[i]


def test_a_full_turn_of_a_joint_changes_nothing(world: World, checker: MujocoCollisionChecker) -> None:
    """Turning A4 and A6 by 360 degrees does not change the distance."""
    q = _random(world, 300, seed=2)
    turned = q + np.array([0, 0, 0, 2 * np.pi, 0, -2 * np.pi])
    np.testing.assert_allclose(checker.distance(turned)[0], checker.distance(q)[0], rtol=0, atol=1e-9)


def test_an_empty_batch_is_valid(checker: MujocoCollisionChecker) -> None:
    """An empty batch gives empty results."""
    none = np.zeros((0, 6))
    assert checker.free(none).shape == (0,)
    assert checker.travel(none, none).shape == (0,)
    distance, names = checker.distance(none)
    assert (distance.shape, names) == ((0,), ())


@pytest.mark.parametrize("q", [np.zeros(6), np.zeros((2, 5)), np.full((1, 6), np.nan)])
def test_invalid_input_is_refused(checker: MujocoCollisionChecker, q: np.ndarray) -> None:
    """A wrong shape or a value that is not finite is refused."""
    with pytest.raises(PlannerError, match="q h"):
        checker.free(q)
