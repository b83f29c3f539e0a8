"""The clearance of a motion against distances at thousands of configurations along it, for hull and triangles."""

import itertools

import numpy as np
import pytest
import trimesh

from cell.scene.model import Scene
from cell.world.clearance import TOLERANCE, motion_clearance, tightest_at
from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from cell.world.model import World, compile_world

_SAMPLES = 1500
SHARE = 0.05  # of the distance, as the documentation promises


def _cup() -> trimesh.Trimesh:
    outline = [(0.0, 0.0), (0.16, 0.0), (0.16, 0.3), (0.15, 0.3), (0.15, 0.01), (0.0, 0.01)]
    return trimesh.creation.revolve(np.array(outline), sections=40)


@pytest.fixture(scope="module", params=["hull", "exact", "base", "object"])
def world(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> World:
    """Return a cup beside the robot as hull or triangles, or as a mesh fixture with a cube as part in it."""
    cup, tables = _cup(), {"placement": {"position_mm": [1100, 300, 0]}, "plan": {"collision": "exact"}}
    if request.param in ("base", "object"):
        path = tmp_path_factory.mktemp("cup") / "cup.stl"
        cup.apply_translation((0, 0, -0.15)).export(path)
        fixture = {"name": "cup", "shape": "mesh", "path": str(path), "units": "m", "attached_to": request.param}
        tables["fixtures"] = [fixture | ({} if request.param == "object" else tables["placement"])]
        cup = trimesh.creation.box((0.05, 0.05, 0.05))
    else:
        tables["plan"] = {"collision": request.param}
    return compile_world(Scene.model_validate(tables), cup.vertices, part_faces=np.array(cup.faces), baseline_mm=75.0)


def _via() -> tuple[np.ndarray, np.ndarray]:
    """Return three segments: past the cup, two moves, and a stop."""
    home = np.radians([0.0, -90, 90, 0, 90, 0])
    past = np.radians([25.0, -40, 80, 0, 60, 0])
    beside = np.radians([-40.0, -35, 85, 20, 50, 30])
    back = np.radians([-60.0, -80, 100, 0, 80, 90])
    return np.stack([home, past, beside, back, back]), np.array([0, 0, 1, 1, 2])


@pytest.mark.usefixtures("full_effort")
def test_samples_lie_between_lower_bound_and_distance(world: World) -> None:
    """The reported distance is an upper bound on the motion, and the proven one is a lower bound within 5 %."""
    checker = MujocoCollisionChecker(world)
    via, segment = _via()
    found = motion_clearance(checker, via, segment, 3)
    assert found.checks < 4_000
    for number in range(3):
        rows = np.flatnonzero(segment[1:] == number) + 1
        dense = np.concatenate([np.linspace(via[k - 1], via[k], _SAMPLES) for k in rows])
        distance, names = checker.distance(dense)
        least = float(distance.min())
        assert found.lower_bound[number] <= least + 1e-9
        assert found.distance[number] <= least + max(TOLERANCE, SHARE * least) + 1e-9
        assert (
            found.lower_bound[number] >= found.distance[number] - max(TOLERANCE, SHARE * found.distance[number]) - 1e-9
        )
        if found.distance[number] < DISTANCE_CAP:
            near = {names[k] for k in np.flatnonzero(distance < least + 0.003)}
            assert found.between[number] in near


def test_the_tightest_moment_is_on_the_motion(world: World) -> None:
    """The configuration has the reported distance, and its points are on the named shapes."""
    checker = MujocoCollisionChecker(world)
    via, segment = _via()
    found = motion_clearance(checker, via, segment, 3)
    tightest = found.tightest
    assert tightest is not None
    assert tightest.distance == found.distance.min() == found.distance[tightest.segment]
    assert tightest.between == found.between[tightest.segment]
    distance, names = checker.distance(tightest.q[None])
    assert distance[0] == pytest.approx(tightest.distance, abs=2e-8)
    assert names[0] == tightest.between
    assert np.linalg.norm(tightest.points[0] - tightest.points[1]) == pytest.approx(tightest.distance, abs=1e-6)
    on_way = [_off(a, b, tightest.q) for a, b in itertools.pairwise(via)]
    assert min(on_way) < 1e-9
    again = tightest_at(checker, tightest.q)
    assert again is not None
    assert again.points.tolist() == tightest.points.tolist()


def _off(a: np.ndarray, b: np.ndarray, q: np.ndarray) -> float:
    """Return the distance of q from the straight move a to b [rad]."""
    way = b - a
    length = float(way @ way)
    share = np.clip((q - a) @ way / length, 0, 1) if length > 0 else 0.0
    return float(np.linalg.norm(a + share * way - q))
