"""Properties of scene and collision: placement is data, obstacles only add contacts, symmetry, the travel bound."""

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.triangle_cell import polytope
from cell.scene.model import Scene, pose
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world

PART = np.array(trimesh.creation.icosphere(3, 0.12).vertices) * [1.0, 0.6, 1.4]
ANGLE = st.floats(-180, 180)
PLACE = st.tuples(st.floats(-1500, 1500), st.floats(-1500, 1500), st.floats(-300, 1500))


@pytest.fixture(scope="module")
def world() -> World:
    """Return the built-in cell."""
    return compile_world(Scene(), PART, baseline_mm=75.0)


def _near_the_part(world: World, T_base_object: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return random configurations and those of many that are nearest to the part: about a third touch it."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(world.limits.lower, world.limits.upper, (20 * count, 6))
    data = world.data(T_base_object)
    centre, gap = (T_base_object @ world.T_object_centre)[:3, 3], np.empty(len(q))
    for i, configuration in enumerate(q):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(world.model, data)
        gap[i] = np.linalg.norm(data.geom("housing").xpos - centre)
    return np.concatenate([q[:count], q[np.argsort(gap)[: count // 2]]])


@settings(max_examples=settings.default.max_examples // 4)
@given(place=PLACE, abc=st.tuples(ANGLE, ANGLE, ANGLE))
def test_a_new_placement_is_a_recompiled_model(world: World, place: tuple, abc: tuple) -> None:
    """Moved mocap bodies give the results of a model compiled for that placement."""
    T = world.T_base_object_at(pose(place, abc))
    scene = Scene.model_validate({"placement": {"position_mm": place, "abc_deg": abc}})
    recompiled = MujocoCollisionChecker(compile_world(scene, PART, baseline_mm=75.0))
    moved = MujocoCollisionChecker(world, T)
    q = _near_the_part(world, T, 120, seed=1)
    assert np.array_equal(moved.free(q), recompiled.free(q))
    distance, names = moved.distance(q)
    expected, expected_names = recompiled.distance(q)
    np.testing.assert_allclose(distance, expected, rtol=0, atol=1e-9)
    assert sum(a != b for a, b in zip(names, expected_names, strict=True)) <= 1  # a tie may fall either way


@settings(max_examples=settings.default.max_examples // 4)
@given(
    shape=st.sampled_from(["box", "cylinder"]),
    size=st.lists(st.floats(1, 800), min_size=3, max_size=3),
    place=PLACE,
    abc=st.tuples(ANGLE, ANGLE, ANGLE),
    attached_to=st.sampled_from(["base", "object"]),
)
def test_a_fixture_never_frees_a_configuration(
    world: World, shape: str, size: list, place: tuple, abc: tuple, attached_to: str
) -> None:
    """With more obstacles a subset of the configurations is free, and no distance grows."""
    fixture = {"name": "f", "shape": shape, "size_mm": size if shape == "box" else size[:2],
               "position_mm": place, "abc_deg": abc, "attached_to": attached_to}  # fmt: skip
    crowded = compile_world(Scene.model_validate({"fixtures": [fixture]}), PART, baseline_mm=75.0)
    q = np.random.default_rng(3).uniform(world.limits.lower, world.limits.upper, (1500, 6))
    before, after = MujocoCollisionChecker(world), MujocoCollisionChecker(crowded)
    assert not (after.free(q) & ~before.free(q)).any()
    assert (after.distance(q[:400])[0] <= before.distance(q[:400])[0] + 1e-12).all()


@settings(max_examples=settings.default.max_examples // 4)
@given(turn=ANGLE, seed=st.integers(0, 2**31), offset=st.floats(0, 0.25), abc=st.tuples(ANGLE, ANGLE, ANGLE))
def test_turning_part_and_arm_together_changes_no_distance(
    world: World, turn: float, seed: int, offset: float, abc: tuple
) -> None:
    """The part turned about the A1 axis and A1 with it (KUKA's sign) is the same scene."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(world.limits.lower, world.limits.upper)
    data = world.data()
    data.qpos[:] = q
    mujoco.mj_kinematics(world.model, data)
    T = pose((0, 0, 0), abc)  # near or inside the housing, so that distances are comparable
    T[:3, 3] = data.geom("housing").xpos + offset * data.geom("housing").xmat.reshape(3, 3)[:, 2]
    here = MujocoCollisionChecker(world, world.T_base_object_at(T))
    there = MujocoCollisionChecker(world, world.T_base_object_at(pose((0, 0, 0), (turn, 0, 0)) @ T))
    first, second = (
        {name: gap for name, gap in checker.pairs_within_clearance(angles) if name.endswith(("with part", "with post"))}
        for checker, angles in ((here, q), (there, q - np.deg2rad([turn, 0, 0, 0, 0, 0])))
    )
    for name in first.keys() | second.keys():
        one, other = first.get(name, here.clearance), second.get(name, there.clearance)
        # Depths in contact come from another algorithm than distances and are not compared so finely.
        assert one == pytest.approx(other, abs=1e-6 if min(one, other) >= 0 else 1e-3)
    if offset < 0.1:
        assert "housing with part" in first


def _surface_points(world: World) -> list[tuple[int, np.ndarray]]:
    """Return points on edges and rims of each moving geom in its own frame, thousands of them."""
    model, found = world.model, []
    ring = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for geom, name in enumerate(world.entities):
        size = model.geom_size[geom]
        if not name.startswith(("link_", "housing", "bracket")):
            continue
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            local = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            local = np.array(polytope(model, geom).vertices)
        else:
            local = np.array([[size[0] * np.cos(a), size[0] * np.sin(a), z] for a in ring for z in (-size[1], size[1])])
        found.append((geom, local))
    return found


def _swept(world: World, q_from: np.ndarray, q_to: np.ndarray, steps: int) -> np.ndarray:
    """Return positions (steps + 1, P, 3) of all surface points along the joint segment [m]."""
    data, points = world.data(), _surface_points(world)
    places = []
    for t in np.linspace(0.0, 1.0, steps + 1):
        data.qpos[:] = q_from + t * (q_to - q_from)
        mujoco.mj_kinematics(world.model, data)
        places.append(np.concatenate([p @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g] for g, p in points]))
    return np.array(places)


@pytest.mark.parametrize("scale", [1e-3, 0.02, 0.2, 1.0])
def test_travel_bounds_the_motion_of_every_point(world: World, scale: float) -> None:
    """No surface point moves farther than the bound between ANY two sampled configurations of the segment."""
    rng = np.random.default_rng(int(1 / scale))
    checker = MujocoCollisionChecker(world)
    lower, upper = world.limits.lower, world.limits.upper
    ratios = []
    for _ in range(20):
        q_from = rng.uniform(lower, upper)
        goal = rng.uniform(lower, upper)
        only = rng.random(6) < rng.choice([0.2, 0.5, 1.0])  # single joints too, where the bound is tightest
        q_to = q_from + scale * np.where(only, goal - q_from, 0.0)
        places = _swept(world, q_from, q_to, 24)
        moved = max(np.linalg.norm(places[i] - places[i + 1 :], axis=2).max(initial=0) for i in range(len(places) - 1))
        bound = checker.travel(q_from[None], q_to[None])[0]
        assert bound >= moved
        length = np.linalg.norm(np.diff(places, axis=0), axis=2).sum(axis=0).max()
        assert bound >= length  # it bounds the length of the path, not only the displacement
        if moved > 0:
            ratios.append(bound / length)
    assert np.median(ratios) < (1.6 if scale <= 0.02 else 2.5)
