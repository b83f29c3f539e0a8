"""Stable poses of a part, and the post that supports each.

A body that is dropped at random comes to rest on a face of its convex hull (Goldberg, Mirtich, Zhuang, Craig, Carlisle,
Canny, "Part pose statistics", IEEE Trans. Robotics and Automation 1999, doi:10.1109/70.795796). That is on a plane. On
a round post only the contacts above its top support the part: it rests if its centre of mass is above their convex
hull, at least `MARGIN` from its edge. A part without volume has the centre of mass of its surface.
"""

from collections.abc import Iterator

import numpy as np

from cell.scene.model import Post
from cell.world.balance import centre_of_mass, hull_margin
from cell.world.solids import Solid
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

MARGIN = 0.002
"""Smallest distance of the centre of mass from the edge of the contact polygon, in plan view [m]."""

_CONTACT = 1e-5  # m; height of a contact above the lowest point: vertices of a face of the hull differ by rounding
_MIN_PROBABILITY = 0.01  # of a stable pose that is proposed
_FLAT = 1e-6  # thickness of a flat sheet, as a share of its longest side
_STEP_MM = 10.0  # diameters of proposed posts are multiples of this
_DIRECTIONS = 72  # points on the edge of a post


def stable_poses(part: TriangleMesh) -> Iterator[tuple[Floats, float]]:
    """Yield rotations (3, 3) in which the part rests on a plane, with their probabilities, the largest first."""
    import trimesh  # half a second of start-up

    centred = part.vertices - part.vertices.mean(axis=0)
    sides, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    if sides[2] <= _FLAT * sides[0]:  # its hull has no volume: it rests on either side
        up = axes * [[1.0], [1.0], [np.sign(np.linalg.det(axes))]]
        yield up, 0.5
        yield np.diag([1.0, -1.0, -1.0]) @ up, 0.5
        return
    hull = trimesh.Trimesh(part.vertices, part.faces, process=False).convex_hull
    mass = centre_of_mass(Solid("part", part.vertices, part.faces))
    transforms, probabilities = trimesh.poses.compute_stable_poses(hull, center_mass=mass)
    for k in np.argsort(-probabilities.round(9), kind="stable"):
        if probabilities[k] >= _MIN_PROBABILITY:
            yield transforms[k][:3, :3], float(probabilities[k])


class Underside:
    """The contacts of a part at rest on a plane, and its centre of mass, seen from above.

    Args:
        part: object frame [m].
        R: (3, 3) rotation of the part.
        axis: (3,) point of the part above the middle of a post, object frame [m].
    """

    def __init__(self, part: TriangleMesh, R: Floats, axis: Floats) -> None:
        used, corners = np.unique(part.faces, return_inverse=True)
        vertices, faces = (part.vertices[used] - axis) @ R.T, corners.reshape(-1, 3)
        is_low = vertices[:, 2] <= vertices[:, 2].min() + _CONTACT
        ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        self._points = vertices[is_low, :2]
        self._edges = vertices[ends[is_low[ends].all(axis=1)]][..., :2]
        self._triangles = vertices[faces[is_low[faces].all(axis=1)]][..., :2]
        self._mass = (R @ (centre_of_mass(Solid("part", part.vertices, part.faces)) - axis))[:2]
        self._extent = float(np.linalg.norm(self._points, axis=1).max())

    def margin(self, post: Post) -> float:
        """Return the distance of the centre of mass from the edge of the contact polygon on a post [m].

        It is negative outside the polygon, and -inf if post and part have no common area.
        """
        radius = post.diameter_mm / 2000
        corners = self._points[np.linalg.norm(self._points, axis=1) <= radius]
        rim = _rim(self._triangles, radius)
        return hull_margin(np.concatenate([corners, _crossings(self._edges, radius), rim]), self._mass)

    def supporting_post(self, post: Post) -> Post | None:
        """Return the thinnest post, no thinner than a given one, on which the part rests; None if there is none."""
        next_mm = _STEP_MM * (np.floor(post.diameter_mm / _STEP_MM) + 1)
        wider = np.arange(next_mm, 2000 * self._extent + 2 * _STEP_MM, _STEP_MM)
        posts = [post.model_copy(update={"diameter_mm": float(each)}) for each in (post.diameter_mm, *wider)]
        if self.margin(posts[-1]) < MARGIN:
            return None
        return next(each for each in posts if self.margin(each) >= MARGIN)


def _crossings(ends: Floats, radius: float) -> Floats:
    """Return the points (n, 2) where segments (m, 2, 2) meet a circle about the origin."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    a, b = (along**2).sum(axis=1), (start * along).sum(axis=1)
    c = (start**2).sum(axis=1) - radius**2
    root = b**2 - a * c
    start, along, a, b, root = (each[(root >= 0) & (a > 0)] for each in (start, along, a, b, root))
    share = (-b + np.array([[1.0], [-1.0]]) * np.sqrt(root)) / a
    points: Floats = (start + share[..., None] * along)[(share >= 0) & (share <= 1)]
    return points


def _rim(triangles: Floats, radius: float) -> Floats:
    """Return the points (n, 2) of a circle about the origin that are inside one of (m, 3, 2) triangles."""
    angles = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    edges = np.roll(triangles, -1, axis=1) - triangles
    # Of a fine mesh few triangles meet the circle: no point of one is farther from a corner than its longest edge.
    distance, longest = np.linalg.norm(triangles, axis=2), np.linalg.norm(edges, axis=2).max(axis=1)
    is_near = (distance.max(axis=1) >= radius - _CONTACT) & (distance.min(axis=1) <= radius + longest + _CONTACT)
    triangles, edges = triangles[is_near], edges[is_near]
    to_rim = rim[:, None, None] - triangles
    turns = edges[..., 0] * to_rim[..., 1] - edges[..., 1] * to_rim[..., 0]
    is_inside = (turns >= 0).all(axis=2) | (turns <= 0).all(axis=2)
    return rim[np.any(is_inside, axis=1)]


def needs_fixture(post: Post | None = None) -> str:
    """Return the end of a name of a pose in which the part does not rest on a post; None stands for any post."""
    support = "a post" if post is None else f"the post of {post.diameter_mm:g} mm"
    return f" (needs a fixture: on {support} the centre of mass is not {1000 * MARGIN:g} mm inside the contacts)"
