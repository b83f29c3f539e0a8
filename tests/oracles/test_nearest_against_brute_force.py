"""Closest points and signed distances against brute force, python-fcl and closed forms."""

import fcl
import numpy as np
import pytest
import trimesh

from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.surface import measure_deviation
from tests.support.meshes import as_triangles


def _slivers() -> trimesh.Trimesh:
    """Return a box of 1000 : 1 : 1 next to a fine ball: long thin faces beside small ones."""
    return trimesh.util.concatenate(
        [
            trimesh.creation.box((1.0, 0.001, 0.001)),
            trimesh.creation.icosphere(3, 0.02).apply_translation((0.1, 0.1, 0)),
        ]
    )


MESHES = {
    "box of 12 faces": trimesh.creation.box((0.1, 0.2, 0.05)),
    "ball": trimesh.creation.icosphere(3, 0.1),
    "torus": trimesh.creation.torus(0.1, 0.03),
    "slivers": _slivers(),
    "one triangle": trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]], [[0, 1, 2]], process=False),
    "a face without area": trimesh.Trimesh(
        [[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0.05, 0, 0]], [[0, 1, 2], [0, 3, 1]], process=False
    ),
}


def _edge_distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (F, N) distances of N points to F edges."""
    along = (b - a)[:, None]
    length = np.maximum((along**2).sum(axis=-1), 1e-300)
    step = np.clip(((points - a[:, None]) * along).sum(axis=-1) / length, 0, 1)
    return np.linalg.norm(points - a[:, None] - step[..., None] * along, axis=-1)


def _brute(points: np.ndarray, mesh: TriangleMesh) -> np.ndarray:
    """Return the distance to the nearest triangle: to its plane if the foot is inside, else to its edges."""
    best = np.full(len(points), np.inf)
    for faces in np.array_split(mesh.faces, len(mesh.faces) // 100 + 1):
        a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
        here = np.minimum.reduce([_edge_distance(points, *edge) for edge in ((a, b), (b, c), (c, a))])
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(size > 0, normal / np.maximum(size, 1e-300), 0.0)[:, None]
        height = ((points - a[:, None]) * normal).sum(axis=-1)
        foot = points - height[..., None] * normal
        inside = np.broadcast_to(size > 0, height.shape)
        for start, end in ((a, b), (b, c), (c, a)):
            inside = inside & ((np.cross((end - start)[:, None], foot - start[:, None]) * normal).sum(axis=-1) >= 0)
        best = np.minimum(best, np.where(inside, np.abs(height), here).min(axis=0))
    return best


@pytest.mark.parametrize("name", MESHES)
def test_distance_equals_brute_force(name: str) -> None:
    """The distance is exact (to 1e-9 of the size) near the surface, far from it, at its middle and on its corners."""
    mesh = as_triangles(MESHES[name])
    rng = np.random.default_rng(1)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float(np.linalg.norm(high - low))
    points = np.concatenate(
        [
            rng.uniform(low - size / 2, high + size / 2, (150, 3)),
            mesh.vertices[rng.integers(len(mesh.vertices), size=50)],
            mesh.vertices[mesh.faces].mean(axis=1)[rng.integers(len(mesh.faces), size=50)]
            + rng.normal(0, 1e-3, (50, 3)),
            [mesh.vertices.mean(axis=0), low, 20 * high],
        ]
    )
    closest = ClosestPointQuery(mesh).closest(points)
    np.testing.assert_allclose(closest.distance, _brute(points, mesh), rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(np.linalg.norm(points - closest.point, axis=1), closest.distance, atol=1e-12 * size)
    for point, face in zip(closest.point, mesh.faces[closest.face], strict=True):
        assert _brute(point[None], TriangleMesh(mesh.vertices, face[None]))[0] <= 1e-12 * size


def test_where_thousands_of_faces_are_about_as_near_the_distance_is_exact() -> None:
    """On the medial axis, in the middle, far away, on corners and on edges the distance is exact."""
    ball, torus = trimesh.creation.icosphere(4, 0.1), trimesh.creation.torus(0.1, 0.03, 36, 36)
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = 0.1 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    rng = np.random.default_rng(7)
    away = rng.normal(size=(40, 3))
    for solid, axis in ((ball, np.zeros((40, 3))), (torus, ring)):
        mesh = as_triangles(solid)
        edges = mesh.vertices[mesh.faces[:40, [0, 1]]].mean(axis=1)
        points = np.concatenate(
            [axis, axis + 1e-3 * away, [mesh.vertices.mean(axis=0)], 5 * away, mesh.vertices[:40], edges]
        )
        found = ClosestPointQuery(mesh).closest(points)
        np.testing.assert_allclose(found.distance, _brute(points, mesh), rtol=1e-13, atol=1e-12)


def test_distance_equals_fcl() -> None:
    """Outside a torus the distance equals that of python-fcl."""
    torus = MESHES["torus"]
    model = fcl.BVHModel()
    model.beginModel(len(torus.vertices), len(torus.faces))
    model.addSubModel(np.asarray(torus.vertices), np.asarray(torus.faces))
    model.endModel()
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.2, 0.2, (300, 3))
    points = points[np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.1, points[:, 2]) > 0.035]
    assert len(points) > 200
    radius = 1e-5
    found = [
        fcl.distance(
            fcl.CollisionObject(model), fcl.CollisionObject(fcl.Sphere(radius), fcl.Transform(np.eye(3), point))
        )
        for point in points
    ]
    distance = ClosestPointQuery(as_triangles(torus)).closest(points).distance
    np.testing.assert_allclose(np.array(found) + radius, distance, atol=2e-6)


def test_sign_on_a_closed_mesh_is_inside_or_outside() -> None:
    """The signed distance of a box equals its closed form, also near edges and corners."""
    half = np.array([0.05, 0.1, 0.025])
    nearest = ClosestPointQuery(as_triangles(MESHES["box of 12 faces"]))
    points = np.random.default_rng(3).uniform(-2, 2, (3000, 3)) * half
    excess = np.abs(points) - half
    exact = np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0)
    np.testing.assert_allclose(nearest.signed_distance(points), exact, atol=1e-12)


def test_faces_without_area_change_no_sign() -> None:
    """With degenerate faces, points close to every corner keep their sign."""
    ball = MESHES["ball"]
    first, second, _ = ball.faces[:300].T
    lines, dots = np.stack([first, second, first], axis=1), np.stack([second] * 3, axis=1)
    mesh = TriangleMesh(ball.vertices, np.concatenate([lines, ball.faces, dots]))
    nearest = ClosestPointQuery(mesh)
    for factor in (0.99, 1.01):
        points = factor * mesh.vertices
        assert (np.sign(nearest.signed_distance(points)) == np.sign(factor - 1)).all()
        assert (nearest.closest(points).face // 300 > 0).all()
        assert (nearest.closest(points).face < 300 + len(ball.faces)).all()


def test_normals_are_smooth_but_for_creases() -> None:
    """On a fine ball the normal is radial to one degree, and on a box it is that of the face."""
    ball, box = as_triangles(trimesh.creation.icosphere(4, 0.1)), as_triangles(MESHES["box of 12 faces"])
    rng = np.random.default_rng(5)
    for mesh, tolerance in ((ball, np.radians(1.0)), (box, 1e-12)):
        nearest = ClosestPointQuery(mesh)
        closest = nearest.closest(mesh.vertices.max(axis=0) * rng.uniform(-1.2, 1.2, (2000, 3)))
        radial = closest.point / np.linalg.norm(closest.point, axis=1, keepdims=True)
        expected = radial if mesh is ball else mesh.normals[closest.face]
        np.testing.assert_allclose(nearest.normals(closest), expected, atol=tolerance)


def test_points_and_meshes_without_a_distance_are_refused() -> None:
    """A point that is not finite and a mesh without area are refused."""
    with pytest.raises(PlannerError, match="points contains infinity or NaN"):
        ClosestPointQuery(as_triangles(MESHES["ball"])).closest(np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(PlannerError, match="no face of the mesh has an area"):
        ClosestPointQuery(TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]))


def test_deviation_of_a_grown_ball_is_its_growth() -> None:
    """A ball 0.3 mm too large or too small deviates by +0.3 or -0.3 mm everywhere, up to its facets."""
    reference = as_triangles(trimesh.creation.icosphere(5, 0.05))
    rng = np.random.default_rng(4)
    sagitta = 0.05 * (0.05 / 0.05 / 2**5) ** 2  # generous: facets of an edge of about R / 2^5
    for growth in (3e-4, -3e-4):
        result = measure_deviation(
            as_triangles(trimesh.creation.icosphere(5, 0.05 + growth)), reference, rng, count=20_000
        )
        assert result.mean == pytest.approx(growth, abs=sagitta)
        assert result.rms == pytest.approx(abs(growth), abs=sagitta)
        assert result.quantile_95 == pytest.approx(abs(growth), abs=sagitta)
        np.testing.assert_allclose(result.at_vertices, growth, atol=sagitta)
