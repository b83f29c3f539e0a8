"""Lower bounds over all allowed poses: `python -m benchmarks.open.bounds [NAME ...]` writes best/bounds.json.

For any weights u >= 0 of the faces, n views that measure a required area satisfy

    n  >=  (least u-weight of a part of the surface with the required area)  /  (largest u-weight that a pose measures).

The numerator is a fractional knapsack. The denominator is bounded by branch and bound over boxes of the position of the
source (and, for a narrow field of view, over cells of the normal of its middle plane). A face counts for a node unless
it is certain that no pose of the node measures any of its points: by incidence at the source, by range, by the narrow
field, or because a ball inside the part lies across all segments between face and box. All tests are widened by the
radius of the face and of the box. The other limits of the sensor, its second line of sight, its roll and the arm are
left out, so the bound is valid and weak. The weights come from a linear programme over sampled positions.
"""

import heapq
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from scipy.optimize import linprog

from benchmarks.open import check
from benchmarks.open.check import Array, Instance
from benchmarks.open.tools import HERE, write_json
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh

SAMPLING = 0.003  # share of the surface: the error of the judge's samples, above four standard deviations
NARROW_DEG = 20.0  # fields of view below this are searched over their middle plane, too
SHRINK = 0.05  # mm, of the balls: rounding, and the gap before a sample
N_BALLS, N_PATCHES, N_POSITIONS, N_NODES, N_ROUNDS = 100, 150, 250, 12_000, 2
_FINEST = 3.0  # mm: boxes of this radius are not split further


@njit(cache=True)
def node_sets(nodes: Array, faces: Array, balls: Array, limits: Array, sets: Array) -> None:
    """Mark in (k, F) which faces may be measured from a pose of each node.

    Args:
        nodes: (k, 8) middle, radius [mm], normal of the middle plane, radius of its cell [rad] (above pi: any plane).
        faces: (F, 7) middle, radius [mm], normal.
        balls: (b, 4) middle, radius [mm].
        limits: near, far [mm], incidence, half of the narrow field [rad].
        sets: (k, F) result.
    """
    near, far, incidence, half = limits
    for k in range(len(nodes)):
        x, y, z, r = nodes[k, 0], nodes[k, 1], nodes[k, 2], nodes[k, 3]
        for f in range(len(faces)):
            sets[k, f] = False
            rho = faces[f, 3]
            vx, vy, vz = x - faces[f, 0], y - faces[f, 1], z - faces[f, 2]
            d2 = vx * vx + vy * vy + vz * vz
            d, spread = np.sqrt(d2), r + rho
            if d - spread > far or d + spread < near:
                continue
            if d <= spread:
                sets[k, f] = True
                continue
            error = np.arcsin(spread / d)
            cosine = (vx * faces[f, 4] + vy * faces[f, 5] + vz * faces[f, 6]) / d
            if incidence + error < np.pi and cosine < np.cos(incidence + error):
                continue
            slack = half + error + nodes[k, 7]
            if slack < np.pi / 2:
                off = abs(vx * nodes[k, 4] + vy * nodes[k, 5] + vz * nodes[k, 6]) / d
                if off > np.sin(slack):
                    continue
            is_hidden = False
            for b in range(len(balls)):
                ox, oy, oz = balls[b, 0] - faces[f, 0], balls[b, 1] - faces[f, 1], balls[b, 2] - faces[f, 2]
                t = (ox * vx + oy * vy + oz * vz) / d2
                if t <= 0 or t >= 1:
                    continue
                room = balls[b, 3] - (1 - t) * rho - t * r
                if room > 0 and ox * ox + oy * oy + oz * oz - t * t * d2 <= room * room:
                    is_hidden = True
                    break
            sets[k, f] = not is_hidden


class Relaxation:
    """Faces, balls and limits of an instance, and sets of faces of nodes."""

    def __init__(self, instance: Instance) -> None:
        surface, sensor = instance.surface, instance.sensor
        middle = surface.triangles.mean(axis=1)
        radius = np.linalg.norm(surface.triangles - middle[:, None], axis=2).max(axis=1)
        self.faces = np.column_stack([middle, radius, surface.normals])
        self.areas, self.balls = surface.areas, inner_balls(surface)
        tangents = np.tan(np.radians(sensor["fov_deg"]) / 2)
        near, far = sensor["range_mm"]
        if sensor["depth_mm"] is not None:  # z is at most the distance, and at least its share at a corner of the field
            near = max(near, sensor["depth_mm"][0])
            far = min(far, sensor["depth_mm"][1] * float(np.sqrt(1 + (tangents**2).sum())))
        self.narrow = sensor["fov_deg"][0] < NARROW_DEG
        self.limits = np.array(
            [near, far, np.radians(sensor["incidence_max_deg"]), np.radians(sensor["fov_deg"][0]) / 2]
        )
        margin = instance.data["clearance_mm"]
        self.inner = np.array([surface.low - margin, surface.high + margin])
        self.outer = np.array([surface.low - far, surface.high + far])

    def sets(self, nodes: Array) -> Array:
        """Return (k, F) which faces may be measured from each node."""
        found = np.empty((len(nodes), len(self.faces)), dtype=bool)
        node_sets(np.ascontiguousarray(nodes), self.faces, self.balls, self.limits, found)
        return found

    def is_outside(self, nodes: Array) -> Array:
        """Return (k,) whether a box of the node has a point outside the clearance of the part."""
        half = (nodes[:, 3] / np.sqrt(3))[:, None]
        return ((nodes[:, :3] - half < self.inner[0]) | (nodes[:, :3] + half > self.inner[1])).any(axis=1)

    def random_nodes(self, count: int, rng: np.random.Generator) -> Array:
        """Return small nodes at random positions within the range of a random face."""
        towards = self.faces[rng.integers(len(self.faces), size=count)]
        direction = rng.standard_normal((count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        flip = np.sign(np.einsum("nj,nj->n", direction, towards[:, 4:]))
        at = towards[:, :3] + direction * flip[:, None] * rng.uniform(*self.limits[:2], (count, 1))
        normal = np.cross(direction, rng.standard_normal((count, 3)))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cell = np.full(count, 0.02 if self.narrow else 4.0)
        nodes = np.column_stack([at, np.full(count, 4.0), normal, cell])
        return nodes[self.is_outside(nodes)]

    def largest(self, u: Array, budget: int) -> tuple[float, Array]:
        """Return an upper bound on the u-weight that a pose measures, and the nodes with the largest weights."""
        edge = self.outer[1] - self.outer[0]
        side = edge.max() / 8
        steps = [np.arange(low + side / 2, high + side / 2, side) for low, high in self.outer.T]
        at = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        cells = hemisphere_cells() if self.narrow else np.array([[0.0, 0.0, 1.0, 4.0]])
        nodes = np.concatenate(
            [
                np.column_stack([np.full((len(cells), 3), p), np.full(len(cells), side * np.sqrt(3) / 2), cells])
                for p in at
            ]
        )
        heap: list[tuple[float, int, Array]] = []
        count, finest = 0, 0.0
        least: list[Array] = []
        while True:
            nodes = nodes[self.is_outside(nodes)]
            for start in range(0, len(nodes), 512):
                some = nodes[start : start + 512]
                for value, node in zip((self.sets(some) @ u).tolist(), some, strict=True):
                    heapq.heappush(heap, (-value, count, node))
                    count += 1
            parents = []
            while heap and len(parents) < 32:
                value, _, node = heapq.heappop(heap)
                if node[3] <= _FINEST:
                    finest = max(finest, -value)
                    least.append(node)
                else:
                    parents.append(node)
                    if len(parents) == 1:
                        top = -value
            if not parents or count > budget or finest >= top:
                best = max([finest, *([top] if parents else []), *([-heap[0][0]] if heap else [])])
                return best, np.array([*least[:20], *parents, *(node for _, _, node in heapq.nsmallest(60, heap))])
            nodes = np.concatenate([split(node, self.limits[0]) for node in parents])


def split(node: Array, distance: float) -> Array:
    """Return the children of a node: eight boxes, or four cells of the normal."""
    if node[7] > 3 or node[3] / distance >= node[7]:
        corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        children = np.tile(node, (8, 1))
        children[:, :3] += corners * (node[3] / np.sqrt(3) / 2)
        children[:, 3] /= 2
        return children
    axis = np.eye(3)[np.argmin(np.abs(node[4:7]))]
    a = np.cross(node[4:7], axis)
    a /= np.linalg.norm(a)
    b = np.cross(node[4:7], a)
    children = np.tile(node, (4, 1))
    # Balls of radius R / sqrt(2) about the middles of the quarters cover a disc of radius R; the rest is for curvature.
    for k, (s, t) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        n = node[4:7] + np.tan(node[7] / 2) * (s * a + t * b)
        children[k, 4:7] = n / np.linalg.norm(n)
    children[:, 7] *= 0.75
    return children


def hemisphere_cells() -> Array:
    """Return (k, 4) normals and radii [rad] of cells that cover the half sphere: the faces of a cube, 4 x 4 each."""
    grid = (np.arange(4) + 0.5) / 2 - 1
    found = []
    for axis in range(3):
        for s in grid:
            for t in grid:
                centre = np.insert(np.array([s, t]), axis, 1.0)
                corners = [np.insert(np.array([s + i, t + j]), axis, 1.0) for i in (-0.25, 0.25) for j in (-0.25, 0.25)]
                centre /= np.linalg.norm(centre)
                cosines = [corner @ centre / np.linalg.norm(corner) for corner in corners]
                found.append([*centre, np.arccos(min(cosines)) * 1.001])
    return np.array(found)


def inner_balls(surface: check.Surface) -> Array:
    """Return (b, 4) middles and radii of balls inside the part [mm]; the radius is the distance to the surface."""
    vertices, faces = np.unique(surface.triangles.reshape(-1, 3), axis=0, return_inverse=True)
    query = ClosestPointQuery(TriangleMesh(vertices, faces.reshape(-1, 3).astype(np.int32)))
    rng = np.random.default_rng(5)
    points = rng.uniform(surface.low, surface.high, (20_000, 3))
    depth = -query.signed_distance(points)
    chosen: list[Array] = []
    while len(chosen) < N_BALLS and depth.max() > 0.5:
        best = int(depth.argmax())
        chosen.append(np.array([*points[best], depth[best]]))
        away = np.linalg.norm(points - points[best], axis=1)
        depth[away < 0.6 * depth[best]] = -1
    balls = np.array(chosen).reshape(-1, 4)
    if len(balls):
        balls[:, 3] = query.closest(balls[:, :3]).distance - SHRINK
    return balls


def least_weight(u: Array, areas: Array, required: float) -> float:
    """Return the least u-weight of a part of the surface with a required area (faces are divisible)."""
    order = np.argsort(u / areas, kind="stable")
    before = np.cumsum(areas[order]) - areas[order]
    share = np.clip((required - before) / areas[order], 0, 1)
    return float((share * u[order]).sum())


def patches(relaxation: Relaxation, rng: np.random.Generator) -> Array:
    """Return (F,) patch of each face: nearest of seeds, by place and normal."""
    size = np.linalg.norm(relaxation.inner[1] - relaxation.inner[0])
    features = np.column_stack([relaxation.faces[:, :3] / size, 0.25 * relaxation.faces[:, 4:]])
    share = relaxation.areas / relaxation.areas.sum()
    seeds = features[rng.choice(len(features), min(N_PATCHES, len(features)), replace=False, p=share)]
    return np.argmin(((features[:, None] - seeds) ** 2).sum(axis=2), axis=1)


def best_weights(areas: Array, patch: Array, sets: Array, required: float) -> Array:
    """Return (F,) weights of the faces that maximise the bound over given sets (k, F): a linear programme.

    With u_f = a_f (x - s_p) in patch p: maximise required x - sum of s_p area_p, u-weight of every set at most 1.
    """
    count = int(patch.max()) + 1
    by_patch = np.bincount(patch, areas, count)
    shares = np.array([np.bincount(patch, areas * row, count) for row in sets])
    A = np.vstack([np.column_stack([shares.sum(axis=1), -shares]), np.column_stack([-np.ones(count), np.eye(count)])])
    b = np.concatenate([np.ones(len(sets)), np.zeros(count)])
    scale = areas.sum()
    A[: len(sets)] /= scale
    found = linprog(
        np.concatenate([[-required / scale], by_patch / scale]), A_ub=A, b_ub=b, bounds=(0, None), method="highs"
    )
    return np.maximum(areas / scale * (found.x[0] - found.x[1:][patch]), 0)


def bound_all_poses(instance: Instance, n_nodes: int = N_NODES) -> dict[str, Any]:
    """Return the bound for each target, with the weight that decides it."""
    relaxation = Relaxation(instance)
    areas, rng = relaxation.areas, np.random.default_rng(1)
    shares = {target: max(target * instance.data["reference"] - SAMPLING, 0) for target in instance.data["targets"]}
    patch = patches(relaxation, rng)
    nodes = relaxation.random_nodes(N_POSITIONS, rng)
    best = {target: 1.0 for target in shares}
    for number in range(N_ROUNDS):
        u = best_weights(areas, patch, relaxation.sets(nodes), shares[0.99] * areas.sum())
        last = number == N_ROUNDS - 1
        largest, worst = relaxation.largest(u, n_nodes if last else n_nodes // 6)
        for target, share in shares.items():
            best[target] = max(best[target], least_weight(u, areas, share * areas.sum()) / largest)
        small = worst.copy()
        small[:, 3] = np.minimum(small[:, 3], 8.0)
        nodes = np.concatenate([nodes, small])
    return {
        str(target): {"bound": int(np.ceil(value - 1e-6)), "exact": round(value, 3)} for target, value in best.items()
    }


def main() -> None:
    """Compute and store the bounds of the named instances of tiers A and B, or of all without one."""
    path = HERE / "best" / "bounds.json"
    known: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    names = sys.argv[1:] or [
        p.stem for p in sorted(Path(HERE / "instances").glob("[AB]-*.json")) if p.stem not in known
    ]
    for name in names:
        known[name] = bound_all_poses(check.load(name))
        sys.stdout.write(f"{name}: {known[name]}\n")
        sys.stdout.flush()
        write_json(path, dict(sorted(known.items())))


if __name__ == "__main__":
    main()
