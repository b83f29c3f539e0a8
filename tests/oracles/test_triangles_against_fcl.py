"""Distances from true triangles against the tree of python-fcl, and against the definition of a distance.

fcl measures boxes against triangles to 1e-6 m or better. Its cylinders are up to a millimetre off, so those are judged
by a search over every triangle.
"""

from collections.abc import Callable

import fcl
import numpy as np
import pytest
import trimesh

from planner.geometry import distance as gjk
from planner.geometry.distance import TriangleTree
from planner.geometry.mesh import TriangleMesh

REQUEST = fcl.DistanceRequest(gjk_solver_type=fcl.GJKSolverType.GST_INDEP)
ZERO, UPRIGHT = np.zeros(3), np.eye(3).ravel()


def _mug() -> trimesh.Trimesh:
    """Return a closed mug without a handle: outer wall, inner wall, rim."""
    outline = [(0.0, 0.0), (0.04, 0.0), (0.04, 0.1), (0.036, 0.1), (0.036, 0.005), (0.0, 0.005)]
    return trimesh.creation.revolve(np.array(outline), sections=48)


def _sheet() -> trimesh.Trimesh:
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, 12), np.linspace(-0.1, 0.1, 12))
    points = np.column_stack([x.ravel(), y.ravel(), 0.03 * np.sin(20 * x.ravel())])
    faces = [[12 * i + j, 12 * i + j + 1, 12 * i + j + 12] for i in range(11) for j in range(11)]
    return trimesh.Trimesh(points, faces, process=False)


def _soup() -> trimesh.Trimesh:
    rng = np.random.default_rng(5)
    corners = rng.normal(0, 0.05, (80, 1, 3)) + rng.normal(0, 0.02, (80, 3, 3))
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(240).reshape(-1, 3), process=False)


MESHES: dict[str, Callable[[], trimesh.Trimesh]] = {
    "a mug": _mug,
    "a torus": lambda: trimesh.creation.torus(0.08, 0.02),
    "an open, wavy sheet": _sheet,
    "triangles that cross each other": _soup,
    "one triangle": lambda: trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]], process=False),
    "a sliver and a point": lambda: trimesh.Trimesh(
        [[0, 0, 0], [0.1, 1e-9, 0], [0.2, 0, 0], [0.1, 0.1, 0.1]], [[0, 1, 2], [3, 3, 3]], process=False
    ),
}


def _tree(mesh: trimesh.Trimesh) -> TriangleTree:
    return TriangleTree(TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)))


def _model(mesh: trimesh.Trimesh) -> fcl.CollisionObject:
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(np.array(mesh.vertices), np.array(mesh.faces))
    model.endModel()
    return fcl.CollisionObject(model)


def _from_cylinder(points: np.ndarray, radius: float, half: float) -> np.ndarray:
    """Return the distance of points (..., 3) from an upright cylinder about the origin, in closed form."""
    across = np.maximum(np.linalg.norm(points[..., :2], axis=-1) - radius, 0.0)
    return np.hypot(across, np.maximum(np.abs(points[..., 2]) - half, 0.0))


def _least_over_triangles(corners: np.ndarray, radius: float, half: float) -> float:
    """Return the smallest distance of triangles (F, 3, 3) from that cylinder: convex over each, by a refined grid."""
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-1, 1, 9)] * 2))
    middle, width, best = np.full((len(corners), 1, 2), 1 / 3), 1.0, np.inf
    for _ in range(40):
        at = middle + width * np.stack([u, v], axis=1)
        at = np.clip(at, 0, 1)
        at = np.concatenate([at / np.maximum(1.0, at.sum(axis=2, keepdims=True)), middle], axis=1)
        s, t = at[..., :1], at[..., 1:]
        points = corners[:, None, 0] * (1 - s - t) + corners[:, None, 1] * s + corners[:, None, 2] * t
        distance = _from_cylinder(points, radius, half)
        middle = np.take_along_axis(at, np.argmin(distance, axis=1)[:, None, None], axis=1)
        best, width = min(best, float(distance.min())), width * 0.7
    return best


def _poses(count: int, near: float, far: float, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        direction = rng.normal(size=3)
        R = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
        found.append((direction / np.linalg.norm(direction) * rng.uniform(near, far), np.ascontiguousarray(R)))
    return found


@pytest.mark.parametrize("name", MESHES)
def test_distances_of_boxes_are_those_of_fcl(name: str) -> None:
    """A housing and a thin bar, near and far: never larger than fcl's, and smaller by 1e-5 m at most."""
    mesh = MESHES[name]()
    tree, model = _tree(mesh), _model(mesh)
    for half in (np.array([0.08, 0.04, 0.03]), np.array([0.002, 0.002, 0.2])):
        box = fcl.CollisionObject(fcl.Box(*(2 * half)))
        for position, R in _poses(60, 0.0, 0.3, 1):
            box.setTransform(fcl.Transform(R, position))
            truth = 0.0 if fcl.collide(box, model) else fcl.distance(box, model, REQUEST)
            measured = abs(tree.distance(gjk.BOX, half, position, R.ravel(), ZERO, UPRIGHT, 1.0))
            assert truth - 1e-5 <= measured <= truth + 1e-9


@pytest.mark.parametrize("name", ["an open, wavy sheet", "triangles that cross each other", "one triangle"])
def test_distances_of_cylinders_are_those_of_the_nearest_point(name: str) -> None:
    """The distances equal a search over every triangle with the closed form for points."""
    mesh = MESHES[name]()
    tree, radius, half = _tree(mesh), 0.039, 0.06
    for position, R in _poses(25, 0.02, 0.3, 2):
        measured = tree.distance(gjk.CYLINDER, np.array([radius, half, 0.0]), position, R.ravel(), ZERO, UPRIGHT, 1.0)
        truth = _least_over_triangles((mesh.triangles - position) @ R, radius, half)
        assert measured == pytest.approx(truth, abs=2e-6)


@pytest.mark.parametrize("name", MESHES)
def test_the_nearest_points_are_on_both_bodies(name: str) -> None:
    """One on the body, one on a triangle, as far apart as the distance: so it is never too large."""
    mesh = MESHES[name]()
    tree = _tree(mesh)
    half, points = np.array([0.08, 0.04, 0.03]), np.zeros((2, 3))
    seen = 0
    for position, R in _poses(80, 0.05, 0.4, 3):
        measured = tree.distance(gjk.BOX, half, position, R.ravel(), ZERO, UPRIGHT, 1.0, points=points)
        if measured <= 0:
            continue
        seen += 1
        assert np.linalg.norm(points[0] - points[1]) == pytest.approx(measured, abs=2e-8)
        assert (np.abs(R.T @ (points[0] - position)) <= half + 1e-9).all()
        on_triangle = trimesh.triangles.closest_point(mesh.triangles, np.tile(points[1], (len(mesh.faces), 1)))
        assert np.linalg.norm(on_triangle - points[1], axis=1).min() < 1e-9
    assert seen > 20


def test_a_body_in_the_material_is_in_contact_and_one_in_the_cavity_is_not() -> None:
    """A closed solid has an inside, which excludes the cavity of a mug; an open mesh has none."""
    crumb = np.full(3, 0.001)
    mug, ball = _tree(MESHES["a mug"]()), _tree(trimesh.creation.icosphere(3, 0.1))
    sheet = _tree(MESHES["an open, wavy sheet"]())
    at = np.array([0.0, 0.0, 0.05])
    assert mug.closed
    assert ball.closed
    assert not sheet.closed
    assert mug.distance(gjk.BOX, crumb, at, UPRIGHT, ZERO, UPRIGHT, 1.0) == pytest.approx(0.0345, abs=3e-4)
    assert mug.distance(gjk.BOX, crumb, np.array([0.038, 0.0, 0.05]), UPRIGHT, ZERO, UPRIGHT, 1.0) <= 0
    assert mug.distance(gjk.BOX, crumb, np.array([0.0, 0.0, 0.0025]), UPRIGHT, ZERO, UPRIGHT, 1.0) < 0
    assert ball.distance(gjk.BOX, crumb, at, UPRIGHT, ZERO, UPRIGHT, 1.0) < -0.04
    assert sheet.distance(gjk.BOX, crumb, at, UPRIGHT, ZERO, UPRIGHT, 1.0) > 0


def test_a_hull_beside_the_middle_of_its_box_is_not_inside() -> None:
    """A ball in the middle of the box of a tetrahedron is outside the tetrahedron, at a distance of known size."""
    corner = _tree(trimesh.convex.convex_hull(0.1 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])))
    ball = _tree(trimesh.creation.icosphere(3, 0.01))
    frames = (ZERO, UPRIGHT), (np.full(3, -0.05), UPRIGHT)
    measured = ball.distance_to_hull(corner, frames, 1.0, any_nearer=False, points=None)
    assert measured == pytest.approx(0.05 / np.sqrt(3) - 0.01, abs=2e-4)
    large = _tree(trimesh.creation.icosphere(3, 0.5))
    assert large.distance_to_hull(corner, frames, 1.0, any_nearer=False, points=None) < -0.3


@pytest.mark.parametrize("name", ["a mug", "a torus", "triangles that cross each other"])
def test_distances_of_two_meshes_are_those_of_fcl(name: str) -> None:
    """Triangles against triangles, apart and crossing, and against a convex mesh by its hull: to 2e-6 m."""
    rng = np.random.default_rng(3)
    ball, other = trimesh.creation.icosphere(2, 0.05), MESHES[name]()
    trees, models = [], []
    for mesh in (ball, other):
        faces = np.asarray(mesh.faces, dtype=np.int32)
        trees.append(TriangleTree(TriangleMesh(mesh.vertices, faces)))
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(faces))
        model.addSubModel(np.asarray(mesh.vertices), faces)
        model.endModel()
        models.append(model)
    apart = 0
    for _ in range(40):
        turns = [trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3] for _ in trees]
        places = [np.zeros(3), rng.uniform(-0.15, 0.15, 3)]
        frames = tuple((place, turn.ravel()) for place, turn in zip(places, turns, strict=True))
        one, two = (
            fcl.CollisionObject(model, fcl.Transform(turn, place))
            for model, turn, place in zip(models, turns, places, strict=True)
        )
        truth = 0.0 if fcl.collide(one, two) else fcl.distance(one, two)
        points = np.zeros((2, 3))
        measured = abs(trees[0].distance_to_tree(trees[1], frames, 1.0, points=points))
        assert measured == pytest.approx(truth, abs=2e-6)
        assert np.linalg.norm(points[0] - points[1]) == pytest.approx(measured, abs=2e-6)
        assert abs(
            trees[1].distance_to_hull(trees[0], frames[::-1], 1.0, any_nearer=False, points=None)
        ) == pytest.approx(truth, abs=2e-6)
        if truth > 1e-3:
            apart += 1
            assert abs(trees[0].distance_to_tree(trees[1], frames, 0.9 * truth, any_nearer=True)) == 0.9 * truth
            assert abs(trees[0].distance_to_tree(trees[1], frames, 1.1 * truth, any_nearer=True)) < 1.1 * truth
    assert apart > 5
