"""Check results of the open benchmark for view planning: `python check.py [results/NAME.json ...]`.

The file needs numpy and embreex alone, and trusts neither matrices nor claimed numbers: lines of sight of the given
poses are cast anew, positions of an arm are computed from its URDF, times of a tour from its joint angles. Lengths are
millimetres, angles radians, poses 3 x 4 matrices that map the frame of the sensor to that of the part. The page
docs/benchmark.md of the project defines every formula.
"""

import argparse
import hashlib
import json
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

HERE = Path(__file__).resolve().parent
GAP = 0.02  # mm: a triangle this near to a sample does not hide it
N_FRESH = 100_000  # samples on which poses are judged
RIGID = 1e-6  # largest deviation of R R^T from the identity

Array = np.ndarray[Any, Any]


class CheckError(Exception):
    """A file or an entry that breaks a rule."""


class Surface:
    """Triangles (F, 3, 3) with outward normals, and further triangles that only hide."""

    def __init__(self, triangles: Array, occluders: Array | None = None) -> None:
        self.triangles = np.asarray(triangles, dtype=np.float64)
        edge = self.triangles[:, 1:] - self.triangles[:, :1]
        cross = np.cross(edge[:, 0], edge[:, 1])
        length = np.linalg.norm(cross, axis=1)
        self.areas = length / 2
        self.normals = cross / np.maximum(length, 1e-300)[:, None]
        self.low, self.high = self.triangles.min(axis=(0, 1)), self.triangles.max(axis=(0, 1))
        self.all = self.triangles if occluders is None else np.concatenate([self.triangles, occluders])

    @cached_property
    def _scene(self) -> tuple[Any, Array]:
        middle = (self.low + self.high) / 2
        corners = np.ascontiguousarray((self.all - middle).reshape(-1, 3), dtype=np.float32)
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
        scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))
        return scene, middle

    def draw(self, count: int, seed: int) -> tuple[Array, Array, Array]:
        """Draw points (n, 3) with normals (n, 3) and faces (n,): one point in each of n equal strips of the area."""
        u = np.random.default_rng(seed).random((3, count))
        total = np.cumsum(self.areas)
        face = np.searchsorted(total, (np.arange(count) + u[0]) / count * total[-1], side="right")
        face = np.minimum(face, len(total) - 1)
        root = np.sqrt(u[1])
        share = np.stack([1 - root, root * (1 - u[2]), root * u[2]], axis=1)
        return np.einsum("nk,nkj->nj", share, self.triangles[face]), self.normals[face], face

    def is_hidden(self, centre: Array, points: Array) -> Array:
        """Return (n,) whether a triangle lies between a centre (3,) and each point, `GAP` before it or farther."""
        scene, middle = self._scene
        along = points - centre
        length = np.linalg.norm(along, axis=1)
        along = (along / length[:, None]).astype(np.float32)
        start = np.tile((centre - middle).astype(np.float32), (len(points), 1))
        return scene.run(start, along, dists=(length - GAP).astype(np.float32), query="OCCLUDED") == 0

    def first_hits(self, centre: Array, rays: Array) -> tuple[Array, Array]:
        """Return the face (n,), -1 for none, and the distance (n,) of the first hit of unit rays from a centre."""
        scene, middle = self._scene
        start = np.tile((centre - middle).astype(np.float32), (len(rays), 1))
        found = scene.run(start, rays.astype(np.float32), output=True)
        return found["primID"].astype(np.int64), found["tfar"].astype(np.float64)


def measured(sensor: dict[str, Any], surface: Surface, pose: Array, points: Array, normals: Array) -> Array:
    """Return (n,) whether a pose (3, 4) measures points with normals, by the conditions of the page."""
    R, t = pose[:, :3], pose[:, 3]
    result = in_view(sensor, (points - t) @ R, normals @ R)
    for at in centres(sensor, pose):
        left = np.flatnonzero(result)
        result[left] = ~surface.is_hidden(at, points[left])
    return result


def scan(instance: "Instance", pose: Array, step_deg: float = 0.5) -> Array:
    """Return the points (n, 3) that a view of an unknown part gives: the measured first hits of a grid of rays."""
    counts = [round(fov / step_deg) for fov in instance.sensor["fov_deg"]]
    x, y = np.meshgrid(*(np.tan(np.radians((np.arange(n) + 0.5 - n / 2) * step_deg)) for n in counts))
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) @ pose[:, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    face, distance = instance.surface.first_hits(pose[:, 3], rays)
    hit = np.flatnonzero((face >= 0) & (face < len(instance.surface.triangles)))
    points, normals = pose[:, 3] + distance[hit, None] * rays[hit], instance.surface.normals[face[hit]]
    return points[measured(instance.sensor, instance.surface, pose, points, normals)]


def in_view(sensor: dict[str, Any], p: Array, n: Array) -> Array:
    """Return (n,) whether the conditions without lines of sight hold for points and normals in the sensor's frame."""

    def within(q: Array, fov_deg: list[float]) -> Array:
        half = np.tan(np.radians(fov_deg) / 2)
        return (q[:, 2] > 0) & (np.abs(q[:, 0]) <= q[:, 2] * half[0]) & (np.abs(q[:, 1]) <= q[:, 2] * half[1])

    distance = np.linalg.norm(p, axis=1)
    result = within(p, sensor["fov_deg"])
    result &= (distance >= sensor["range_mm"][0]) & (distance <= sensor["range_mm"][1])
    if sensor["depth_mm"] is not None:
        result &= (p[:, 2] >= sensor["depth_mm"][0]) & (p[:, 2] <= sensor["depth_mm"][1])
    result &= -np.einsum("nj,nj->n", n, p) >= distance * np.cos(np.radians(sensor["incidence_max_deg"]))
    if sensor["baseline_mm"] > 0:
        q = p - [sensor["baseline_mm"], 0.0, 0.0]
        towards = -np.einsum("nj,nj->n", n, q)
        result &= towards >= np.linalg.norm(q, axis=1) * np.cos(np.radians(sensor["sensor_incidence_max_deg"]))
        if sensor["sensor_fov_deg"] is not None:
            c, s = np.cos(np.radians(sensor["sensor_tilt_deg"])), np.sin(np.radians(sensor["sensor_tilt_deg"]))
            turned = np.stack([c * q[:, 0] + s * q[:, 2], q[:, 1], c * q[:, 2] - s * q[:, 0]], axis=1)
            result &= within(turned, sensor["sensor_fov_deg"])
    return result


def centres(sensor: dict[str, Any], pose: Array) -> list[Array]:
    """Return source and sensor of a pose (3, 4), in the frame of the part; one centre without a baseline."""
    source = pose[:, 3]
    return [source] if sensor["baseline_mm"] == 0 else [source, source + sensor["baseline_mm"] * pose[:, 0]]


@dataclass(frozen=True)
class Arm:
    """Joints and spheres of a serial arm, read from a URDF with revolute and fixed joints and collision spheres.

    Attributes:
        joints: of each joint from the base to the sensor: fixed transform (4, 4), axis (3,) or None.
        spheres: link number (joints before it), centre (3,) in the link, radius.
        limits: (n, 2) of the revolute joints [rad].
        speed: (n,) largest speeds [rad/s].
    """

    joints: tuple[tuple[Array, Array | None], ...]
    spheres: tuple[tuple[int, Array, float], ...]
    limits: Array
    speed: Array

    @classmethod
    def read(cls, path: Path) -> "Arm":
        """Read an arm; the chain begins at the link `base` and ends at the link `sensor`."""
        root = ElementTree.parse(path).getroot()
        by_parent = {_tag(joint, "parent").get("link"): joint for joint in root.findall("joint")}
        links = {link.get("name"): link for link in root.findall("link")}
        joints, spheres, limits, speed = [], [], [], []
        link: str | None = "base"
        while link is not None:
            for collision in links[link].findall("collision"):
                radius = _tag(_tag(collision, "geometry"), "sphere").get("radius", "")
                spheres.append((len(joints), 1000 * _origin(collision)[:3, 3], 1000 * float(radius)))
            if link == "sensor":
                break
            joint = by_parent[link]
            T = _origin(joint)
            T[:3, 3] *= 1000
            is_fixed = joint.get("type") == "fixed"
            joints.append((T, None if is_fixed else _numbers(_tag(joint, "axis").get("xyz"))))
            if not is_fixed:
                limit = _tag(joint, "limit")
                limits.append([float(limit.get(key, "nan")) for key in ("lower", "upper")])
                speed.append(float(limit.get("velocity", "nan")))
            link = _tag(joint, "child").get("link")
        return cls(tuple(joints), tuple(spheres), np.array(limits), np.array(speed))

    def frames(self, q: Array) -> list[Array]:
        """Return the frames (n, 4, 4) of base and of every link after it, at joint angles (n, axes)."""
        found, angles = [np.tile(np.eye(4), (len(q), 1, 1))], iter(q.T)
        for fixed, axis in self.joints:
            T = found[-1] @ fixed
            if axis is not None:
                K, a = np.cross(np.eye(3), axis), next(angles)[:, None, None]
                turn = np.zeros((len(q), 4, 4))
                turn[:, :3, :3] = np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * (K @ K)
                turn[:, 3, 3] = 1
                T = T @ turn
            found.append(T)
        return found

    def clearance(self, q: Array, boxes: Array) -> Array:
        """Return (n,) the smallest distance of the spheres from floor, boxes (k, 2, 3: centre, half sides), each other.

        Base and first link do not move towards floor and boxes, and links with at most one other between them may
        touch.
        """
        frames = self.frames(q)
        number = np.array([link for link, _, _ in self.spheres])
        at = np.stack([frames[link][:, :3] @ np.append(centre, 1.0) for link, centre, _ in self.spheres], axis=1)
        radius = np.array([size for _, _, size in self.spheres])
        moving = number > 1
        outside = np.maximum(np.abs(at[:, moving, None] - boxes[:, 0]) - boxes[:, 1], 0)
        least = (np.linalg.norm(outside, axis=3) - radius[moving, None]).min(axis=(1, 2))
        least = np.minimum(least, (at[:, moving, 2] - radius[moving]).min(axis=1))
        one, other = np.nonzero(number[:, None] - number > 2)
        apart = np.linalg.norm(at[:, one] - at[:, other], axis=2) - radius[one] - radius[other]
        return np.asarray(np.minimum(least, apart.min(axis=1, initial=np.inf)))


def _tag(element: ElementTree.Element, name: str) -> ElementTree.Element:
    found = element.find(name)
    if found is None:
        raise CheckError(f"the URDF has no <{name}> in <{element.tag}>")
    return found


def _numbers(text: str | None) -> Array:
    return np.array((text or "0 0 0").split(), dtype=np.float64)


def _origin(element: ElementTree.Element) -> Array:
    """Return (4, 4) of an <origin>; rpy are rotations about the fixed axes x, y, z."""
    T, origin = np.eye(4), element.find("origin")
    if origin is not None:
        T[:3, 3] = _numbers(origin.get("xyz"))
        (a, b, c), (d, e, f) = (g(_numbers(origin.get("rpy"))) for g in (np.cos, np.sin))
        T[:3, :3] = [
            [c * b, c * e * d - f * a, c * e * a + f * d],
            [f * b, f * e * d + c * a, f * e * a - c * d],
            [-e, b * d, b * a],
        ]
    return T


def read_stl(path: Path) -> Array:
    """Read the triangles (F, 3, 3) of a binary STL file."""
    data = path.read_bytes()
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, record, int.from_bytes(data[80:84], "little"), 84)["corners"].astype(np.float64)


def box_triangles(boxes: Array) -> Array:
    """Return the (12 n, 3, 3) triangles of boxes (n, 2, 3: centre, half sides)."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([[a, b, c] for a, b, c, _ in quads] + [[a, c, d] for a, _, c, d in quads])
    return np.concatenate([(centre + half * corner)[faces] for centre, half in np.asarray(boxes, dtype=np.float64)])


class Instance:
    """An instance: its JSON file, and its arrays beside it."""

    def __init__(self, name: str, root: Path = HERE) -> None:
        path = root / "instances" / f"{name}.json"
        if not path.resolve().is_relative_to((root / "instances").resolve()) or not path.is_file():
            raise CheckError(f"there is no instance {name!r}")
        self.name, self.root, self.data = name, root, json.loads(path.read_text())
        self.tier = self.data["tier"]

    @cached_property
    def sensor(self) -> dict[str, Any]:
        """The sensor model."""
        loaded: dict[str, Any] = json.loads((self.root / "sensors" / f"{self.data['sensor']}.json").read_text())
        return loaded

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """Samples, poses and configurations."""
        with np.load(self.root / "instances" / f"{self.name}.npz", allow_pickle=False) as loaded:
            return {
                key: loaded[key].astype(np.float64) if loaded[key].dtype.kind == "f" else loaded[key] for key in loaded
            }

    @cached_property
    def surface(self) -> Surface:
        """The part, with the boxes of the cell as occluders."""
        path = self.root / "parts" / f"{self.data['part']}.stl"
        if hashlib.sha256(path.read_bytes()).hexdigest() != self.data["part_sha256"]:
            raise CheckError(f"{path.name} is not the part of {self.name}: its hash differs")
        if "arm" not in self.data:
            return Surface(read_stl(path))
        T = np.asarray(self.data["T_base_part"])
        return Surface(read_stl(path), (box_triangles(self.obstacles) - T[:, 3]) @ T[:, :3])

    @cached_property
    def arm(self) -> Arm:
        """The arm of tiers B and C."""
        return Arm.read(self.root / "arm" / f"{self.data['arm']}.urdf")

    @property
    def obstacles(self) -> Array:
        """Boxes (n, 2, 3: centre, half sides) of the cell, base frame."""
        return np.asarray(self.data["boxes"], dtype=np.float64)

    @cached_property
    def keep_out(self) -> Array:
        """Boxes that the arm must not touch: those of the cell, and the bounding box of the part."""
        T = np.asarray(self.data["T_base_part"])
        ends = np.array([self.surface.low, self.surface.high]) @ T[:, :3].T + T[:, 3]
        part = np.stack([ends.mean(axis=0), np.abs(ends[1] - ends[0]) / 2])
        return np.concatenate([self.obstacles, part[None]])

    def pose_of(self, q: Array) -> Array:
        """Return the pose (3, 4) of the sensor in the frame of the part, at joint angles (n,)."""
        T = np.asarray(self.data["T_base_part"])
        sensor = self.arm.frames(q[None])[-1][0, :3]
        return np.column_stack([T[:, :3].T @ sensor[:, :3], T[:, :3].T @ (sensor[:, 3] - T[:, 3])])

    def pose_fault(self, pose: Array) -> str:
        """Return why a pose (3, 4) is not allowed; "" if it is."""
        if not np.isfinite(pose).all() or np.abs(pose[:, :3] @ pose[:, :3].T - np.eye(3)).max() > RIGID:
            return "is not a rigid transform"
        if np.linalg.det(pose[:, :3]) < 0:
            return "is a reflection"
        margin = self.data["clearance_mm"]
        for at in centres(self.sensor, pose):
            if ((at >= self.surface.low - margin) & (at <= self.surface.high + margin)).all():
                return f"has a centre less than {margin} mm from the bounding box of the part"
        return ""

    def configuration_fault(self, q: Array) -> str:
        """Return why joint angles are not allowed; "" if they are."""
        if q.shape != (len(self.arm.limits),) or not np.isfinite(q).all():
            return f"needs {len(self.arm.limits)} finite joint angles"
        if (q < self.arm.limits[:, 0]).any() or (q > self.arm.limits[:, 1]).any():
            return "exceeds a joint limit"
        return "" if self.arm.clearance(q[None], self.keep_out)[0] > 0 else "is in collision"

    def measured_by(self, poses: Array, points: Array, normals: Array, *, each: bool = False) -> Array:
        """Return (n,) whether any of poses (k, 3, 4) measures each point; with `each` (k, n)."""
        if each:
            return np.array([measured(self.sensor, self.surface, pose, points, normals) for pose in poses])
        return self.first_measuring(poses, points, normals) < len(poses)

    def first_measuring(self, poses: Array, points: Array, normals: Array) -> Array:
        """Return (n,) the first of poses (k, 3, 4) that measures each point; k for none."""
        first = np.full(len(points), len(poses))
        for number, pose in enumerate(poses):
            left = np.flatnonzero(first == len(poses))
            first[left[measured(self.sensor, self.surface, pose, points[left], normals[left])]] = number
        return first

    def rows(self) -> tuple[Array, Array]:
        """Return points (S, 3) and normals (S, 3) of the samples of the file."""
        return self.arrays["points"], self.surface.normals[self.arrays["face"]]


@cache
def load(name: str) -> Instance:
    """Return an instance by name."""
    return Instance(name)


def judge(entry: dict[str, Any], instance: Instance, n_fresh: int = N_FRESH) -> dict[str, Any]:
    """Judge an entry: return its value (views, seconds or coverage), and coverage where it applies.

    Raises:
        CheckError: with the broken rule.
    """
    judges = {"A": _judge_views, "B": _judge_views, "C": _judge_tour, "D": _judge_budgets}
    return judges[instance.tier](entry, instance, n_fresh)


def _judge_views(entry: dict[str, Any], instance: Instance, n_fresh: int) -> dict[str, Any]:
    target = entry["target"]
    if target not in instance.data["targets"]:
        raise CheckError(f"the target {target} is not one of {instance.data['targets']}")
    if entry["track"] == "cover":
        columns = np.asarray(entry["columns"])
        n_poses = len(instance.arrays["poses"])
        if columns.dtype.kind != "i" or columns.ndim != 1 or not ((columns >= 0) & (columns < n_poses)).all():
            raise CheckError(f"columns must be numbers from 0 to {n_poses - 1}")
        poses = _allowed(instance, [_pose_of_column(instance, column) for column in columns])
        count = int(instance.measured_by(poses, *instance.rows()).sum())
        required, share = target * instance.data["coverable_rows"], count / len(instance.arrays["points"])
        if count < required - 1e-9:
            raise CheckError(f"{count} samples are measured; {required:.2f} are required")
    elif entry["track"] == "free" and target < 1:
        if instance.tier == "B":
            configurations = np.asarray(entry["configurations"], dtype=np.float64)
            _require_configurations(instance, configurations)
            poses = np.array([instance.pose_of(q) for q in configurations])
        else:
            poses = np.asarray(entry["poses"], dtype=np.float64).reshape(-1, 3, 4)
        poses = _allowed(instance, list(poses))
        points, normals, _ = instance.surface.draw(n_fresh, _fresh_seed(poses))
        share = float(instance.measured_by(poses, points, normals).mean())
        required = target * instance.data["reference"]
        if share < required:
            raise CheckError(f"{100 * share:.3f} % of the surface are measured; {100 * required:.3f} % are required")
    else:
        raise CheckError("the track must be cover, or free with a target below 1")
    return {"value": len(poses), "coverage": share}


def _pose_of_column(instance: Instance, column: int) -> Array:
    if instance.tier == "A":
        return instance.arrays["poses"][column]
    q = instance.arrays["configurations"][column]
    _require_configurations(instance, q[None])
    return instance.pose_of(q)


def _require_configurations(instance: Instance, configurations: Array) -> None:
    for number, q in enumerate(configurations):
        if fault := instance.configuration_fault(q):
            raise CheckError(f"configuration {number} {fault}")


def _allowed(instance: Instance, poses: list[Array]) -> Array:
    for number, pose in enumerate(poses):
        if fault := instance.pose_fault(pose):
            raise CheckError(f"pose {number} {fault}")
    if not poses:
        raise CheckError("there is no pose")
    return np.array(poses)


def _fresh_seed(poses: Array) -> int:
    """Return a seed that depends on the solution, so that no solution can be fitted to its samples."""
    text = np.round(np.sort(poses.reshape(len(poses), -1), axis=0), 6) + 0.0
    return int.from_bytes(hashlib.sha256(text.astype("<f8").tobytes()).digest()[:8], "little")


def move_times(a: Array, b: Array, speed: Array, acceleration_s: float) -> Array:
    """Return (n,) seconds of joint moves from a (axes,) to b (n, axes): the slowest joint counts.

    A joint has a trapezoidal speed, and reaches its largest speed in `acceleration_s`.
    """
    in_full = np.abs(b - a) / speed
    times = np.where(in_full >= acceleration_s, in_full + acceleration_s, 2 * np.sqrt(in_full * acceleration_s))
    return np.asarray(times.max(axis=1))


def _judge_tour(entry: dict[str, Any], instance: Instance, _: int) -> dict[str, Any]:
    nodes, group = np.asarray(entry["tour"]), instance.arrays["group"]
    if nodes.dtype.kind != "i" or nodes.ndim != 1 or not ((nodes >= 0) & (nodes < len(group))).all():
        raise CheckError(f"the tour must be node numbers from 0 to {len(group) - 1}")
    if sorted(group[nodes]) != list(range(int(group.max()) + 1)):
        raise CheckError("the tour must visit one node of every group")
    home = np.asarray(instance.data["home"])
    q = np.concatenate([home[None], instance.arrays["configurations"][nodes], home[None]])
    speed, acceleration_s = instance.arm.speed, instance.data["acceleration_s"]
    return {"value": float(sum(move_times(a, b[None], speed, acceleration_s)[0] for a, b in pairwise(q)))}


def _judge_budgets(entry: dict[str, Any], instance: Instance, n_fresh: int) -> dict[str, Any]:
    poses = _allowed(instance, list(np.asarray(entry["poses"], dtype=np.float64).reshape(-1, 3, 4)))
    budgets, first = instance.data["budgets"], np.asarray(instance.data["first"])
    if len(poses) > max(budgets) or np.abs(poses[0] - first).max() > RIGID:
        raise CheckError(f"the first pose must be that of the instance, and {max(budgets)} poses are allowed")
    points, normals, _ = instance.surface.draw(n_fresh, _fresh_seed(poses))
    measuring = instance.first_measuring(poses, points, normals)
    shares = [float((measuring < budget).mean()) / instance.data["reference"] for budget in budgets]
    return {"value": float(np.mean(shares)), "shares": shares}


def judge_file(path: Path, n_fresh: int = N_FRESH) -> list[dict[str, Any]]:
    """Judge all entries of a result file; an invalid entry has `fault` in place of `value`."""
    content = json.loads(path.read_text())
    missing = {"name", "authors", "date", "method", "hardware", "entries"} - content.keys()
    if missing or content["name"] != path.stem:
        raise CheckError(
            f"{path.name} lacks {sorted(missing)}" if missing else f"{path.name} is named otherwise inside"
        )
    rows = []
    for entry in content["entries"]:
        row = {key: entry.get(key) for key in ("instance", "target", "track", "cpu_s")} | {"name": content["name"]}
        try:
            row |= judge(entry, load(entry["instance"]), n_fresh)
        except (CheckError, KeyError, ValueError, TypeError) as error:
            row["fault"] = f"{type(error).__name__}: {error}" if not isinstance(error, CheckError) else str(error)
        rows.append(row)
    return rows


def main() -> int:
    """Check the named files, or all of `results`; return 1 if an entry is invalid."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--samples", type=int, default=N_FRESH, help="samples on which poses are judged")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for path in options.files or sorted((HERE / "results").glob("*.json")):
        try:
            rows += judge_file(path, options.samples)
        except (CheckError, OSError, ValueError) as error:
            sys.exit(f"{path}: {error}")
    if options.json:
        json.dump(rows, sys.stdout, indent=1)
    else:
        for row in rows:
            verdict = row.get("fault") or f"{row['value']:g}" + (
                f", {100 * row['coverage']:.3f} %" if "coverage" in row else ""
            )
            sys.stdout.write(f"{row['name']} {row['instance']} {row['target'] or ''} {row['track'] or ''}: {verdict}\n")
    return 1 if any("fault" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
