"""A finished run folder judged from its files alone by separate kinematics, python-fcl and brute-force rays."""

import json
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path
from typing import Any

import fcl
import numpy as np
import pytest
import trimesh

HOME = np.array([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])


def turn(axis: str, degrees: float) -> np.ndarray:
    """Return a rotation (4, 4) about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T = np.eye(4)
    T[i, i] = T[j, j] = c
    T[i, j], T[j, i] = -s, s
    return T


def shift(x: float, y: float, z: float) -> np.ndarray:
    """Return a translation (4, 4), given in millimetres."""
    T = np.eye(4)
    T[:3, 3] = np.array([x, y, z]) / 1000
    return T


def links(q_deg: np.ndarray) -> list[np.ndarray]:
    """Return the frames of base, link_1..link_6 and flange from the data sheet's lengths, by a separate chain."""
    a1, a2, a3, a4, a5, a6 = q_deg
    frames = [np.eye(4)]
    for step in (
        shift(0, 0, 675) @ turn("z", -a1), shift(260, 0, 0) @ turn("y", a2), shift(680, 0, 0) @ turn("y", a3),
        shift(670, 0, -35) @ turn("x", -a4), turn("y", a5), turn("x", -a6), shift(158, 0, 0) @ turn("y", 90),
    ):  # fmt: skip
        frames.append(frames[-1] @ step)
    return frames


def files_of(folder: Path) -> dict[str, Any]:
    """Return all files of a run folder that the judge reads."""
    found: dict[str, Any] = {
        name: json.loads((folder / f"{name}.json").read_text()) for name in ("plan", "scene.resolved", "report")
    }
    for name in ("viewpoints", "reach", "motion", "measurability"):
        with np.load(folder / f"{name}.npz") as arrays:
            found[name] = dict(arrays)
    found["reference"] = trimesh.load(folder / "reference.ply", process=False)
    found["folder"] = folder
    return found


@pytest.fixture(scope="module")
def run(planned: Path) -> dict[str, Any]:
    """Return the plan of the small part."""
    return files_of(planned)


def test_every_view_is_where_its_joint_angles_put_it(run: dict[str, Any]) -> None:
    """FK(q_deg) gives the flange, the mount gives the scanner, the placement gives the object frame, within 1e-9 m."""
    scene = run["scene.resolved"]
    T_flange_scanner, T_base_object = np.array(scene["T_flange_scanner"]), np.array(scene["T_base_object"])
    limits = np.array(scene["joint_limits_deg"])
    for view in run["plan"]["views"]:
        q = np.array(view["q_deg"])
        assert (np.abs(q * 1e4 - np.round(q * 1e4)) < 1e-6).all()
        assert ((q >= limits[:, 0]) & (q <= limits[:, 1])).all()
        T_base_flange = links(q)[-1]
        np.testing.assert_allclose(T_base_flange, view["T_base_flange"], atol=1e-9)
        np.testing.assert_allclose(T_base_flange @ T_flange_scanner, view["T_base_scanner"], atol=1e-9)
        np.testing.assert_allclose(
            T_base_object @ np.array(view["T_object_scanner"]), view["T_base_scanner"], atol=1e-9
        )
        nominal = run["viewpoints"]["T_object_scanner"][view["id"], 0]
        assert np.linalg.norm(nominal[:3, 3] - np.array(view["T_object_scanner"])[:3, 3]) < 20e-6


def test_the_motion_visits_every_view_from_home_and_back(run: dict[str, Any]) -> None:
    """The via points hold home, each view's set-points in order, and home again; samples pass through all of them."""
    motion = run["motion"]
    via = np.degrees(motion["via_q"])
    np.testing.assert_allclose(via[[0, -1]], [HOME, HOME], atol=1e-9)
    stops = motion["view"] >= 0
    assert motion["view"][stops].tolist() == [view["id"] for view in run["plan"]["views"]]
    np.testing.assert_allclose(via[stops], [view["q_deg"] for view in run["plan"]["views"]], atol=1e-9)
    for q, t in zip(motion["via_q"], motion["via_t"], strict=True):
        nearest = np.abs(motion["t"] - t).argmin()
        np.testing.assert_allclose(motion["q"][nearest], q, atol=1e-12)
        assert np.abs(motion["qd"][nearest]).max() == pytest.approx(0.0, abs=1e-12)


def test_the_motion_keeps_every_limit(run: dict[str, Any]) -> None:
    """Speeds, accelerations (2 / s of the speed) and differences of the samples are within the data sheet's limits."""
    motion = run["motion"]
    speed = np.radians([156, 156, 156, 330, 330, 615])
    assert (np.abs(motion["qd"]) <= speed).all()
    assert (np.abs(motion["qdd"]) <= 2 * speed).all()
    dt = np.diff(motion["t"])[:, None]
    assert (dt > 0).all()
    between = np.diff(motion["q"], axis=0) / dt
    assert (np.abs(between) <= speed * (1 + 1e-9)).all()
    np.testing.assert_allclose(between, (motion["qd"][1:] + motion["qd"][:-1]) / 2, atol=2e-2 * speed.max())


def fcl_shapes(folder: Path) -> dict[str, list[tuple[str, Any, np.ndarray]]]:
    """Return the convex shapes of cell.xml per body with their pose in the body, parsed without MuJoCo."""
    tree = ET.parse(folder / "cell.xml").getroot()
    type_of = {}
    for default in tree.iter("default"):  # a class without a type inherits it; the default of shapes is a box
        geom = default.find("geom")
        if default.get("class") and geom is not None:
            type_of[default.get("class")] = geom.get("type", "box")
    corners = {
        mesh.get("name"): np.array(mesh.get("vertex", "").split(), dtype=float).reshape(-1, 3)
        for mesh in tree.iter("mesh")
    }
    found: dict[str, list[tuple[str, Any, np.ndarray]]] = {}

    def visit(body: ET.Element, name: str, inherited: str | None) -> None:
        inherited = body.get("childclass", inherited)
        for geom in body.findall("geom"):
            kind = geom.get("type") or type_of.get(geom.get("class", inherited), "sphere")
            size = [float(value) for value in geom.get("size", "").split()]
            T = np.eye(4)
            T[:3, 3] = [float(value) for value in geom.get("pos", "0 0 0").split()]
            w, x, y, z = (float(value) for value in geom.get("quat", "1 0 0 0").split())
            T[:3, :3] = trimesh.transformations.quaternion_matrix([w, x, y, z])[:3, :3]
            if kind == "box":
                found.setdefault(name, []).append((geom.get("name", ""), fcl.Box(*(2 * s for s in size)), T))
            elif kind == "cylinder":
                found.setdefault(name, []).append((geom.get("name", ""), fcl.Cylinder(size[0], 2 * size[1]), T))
            elif kind == "mesh" and name != "object":
                hull = trimesh.convex.convex_hull(corners[geom.get("mesh")])
                faces = np.column_stack([np.full(len(hull.faces), 3), hull.faces]).astype(np.int32).ravel()
                solid = fcl.Convex(np.array(hull.vertices), len(hull.faces), faces)
                found.setdefault(name, []).append((geom.get("name", ""), solid, T))
        for child in body.findall("body"):
            visit(child, child.get("name", ""), inherited)

    world = tree.find("worldbody")
    assert world is not None
    visit(world, "world", None)
    return found


def test_the_motion_touches_nothing_when_checked_ten_times_finer(run: dict[str, Any]) -> None:
    """python-fcl: primitives of links and tool against the part's true triangles, post, pedestal and floor."""
    scene, shapes = run["scene.resolved"], fcl_shapes(run["folder"])
    moving = {name: shapes[name] for name in shapes if name.startswith("link_") and name != "link_1"}
    assert len(moving) == 5
    part = run["reference"]
    T_base_object = np.array(scene["T_base_object"])
    model = fcl.BVHModel()
    model.beginModel(len(part.vertices), len(part.faces))
    vertices = trimesh.transform_points(part.vertices / 1000, T_base_object)
    model.addSubModel(vertices, part.faces)
    model.endModel()
    obstacles = [fcl.CollisionObject(model)]
    for fixture in scene["fixtures"]:
        T = np.array(fixture["pose"])
        size = np.array(fixture["size_mm"]) / 1000
        shape: Any = {
            "box": lambda s: fcl.Box(*s), "cylinder": lambda s: fcl.Cylinder(s[0] / 2, s[1]),
            "plane": lambda _: fcl.Box(20, 20, 0.001),
        }[fixture["shape"]](size)  # fmt: skip
        obstacles.append(fcl.CollisionObject(shape, fcl.Transform(T[:3, :3], T[:3, 3])))
    housing = np.array(scene["housing"]["T_flange_housing"])
    box = fcl.Box(*(np.array(scene["housing"]["size_mm"]) / 1000))
    bodies = [(int(name[-1]), geometry, T) for name, items in moving.items() for _, geometry, T in items]
    bodies.append((7, box, housing))

    manager = fcl.DynamicAABBTreeCollisionManager()
    manager.registerObjects(obstacles)
    manager.setup()
    via = np.degrees(run["motion"]["via_q"])
    checked, smallest = 0, np.inf
    objects = [(link, fcl.CollisionObject(geometry), T) for link, geometry, T in bodies]
    for start, end in pairwise(via):
        steps = max(2, int(np.ceil(np.abs(end - start).max() / 0.5)))
        for share in np.linspace(0, 1, steps):
            frames = links(start + share * (end - start))
            for link, body, T in objects:
                pose = frames[link] @ T
                body.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
                data = fcl.CollisionData()
                manager.collide(body, data, fcl.defaultCollisionCallback)
                assert not data.result.is_collision, f"link {link} touches something at {start + share * (end - start)}"
            checked += 1
    assert checked > 200
    for view in run["plan"]["views"]:
        frames = links(np.array(view["q_deg"]))
        for link, body, T in objects:
            pose = frames[link] @ T
            body.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
            data = fcl.DistanceData()
            manager.distance(body, data, fcl.defaultDistanceCallback)
            smallest = min(smallest, data.result.min_distance)
    assert smallest >= scene["clearance_mm"] / 1000 - 1e-4


def test_predicted_coverage_is_true_by_brute_force(run: dict[str, Any]) -> None:
    """The visible coverage agrees with float64 Moeller-Trumbore over every triangle, with separate samples."""
    rng = np.random.default_rng(99)
    mesh, scene = run["reference"], run["scene.resolved"]
    triangles = mesh.vertices[mesh.faces] / 1000
    count = 800
    area = mesh.area_faces / mesh.area_faces.sum()
    face = rng.choice(len(area), count, p=area)
    u, v = rng.random(count), rng.random(count)
    fold = u + v > 1
    u[fold], v[fold] = 1 - u[fold], 1 - v[fold]
    corners = triangles[face]
    points = corners[:, 0] + u[:, None] * (corners[:, 1] - corners[:, 0]) + v[:, None] * (corners[:, 2] - corners[:, 0])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    post = next(fixture for fixture in scene["fixtures"] if fixture["name"] == "post")
    T_post_object = np.linalg.inv(np.array(post["pose"])) @ np.array(scene["T_base_object"])
    scanner = scene["scanner"]
    half = np.radians(scanner["fov_deg"]) / 2
    seen = np.zeros(count, dtype=bool)
    for view in run["plan"]["views"]:
        T = np.array(view["T_object_scanner"])
        local = (points - T[:3, 3]) @ T[:3, :3]
        distance = np.linalg.norm(local, axis=1)
        near, far = np.array(scanner["range_mm"]) / 1000
        source = T[:3, 3]
        sensor = (T @ [scanner["baseline_mm"] / 1000, 0, 0, 1])[:3]
        fits = (
            (local[:, 2] > 0)
            & (np.abs(np.arctan2(local[:, 0], local[:, 2])) <= half[0])
            & (np.abs(np.arctan2(local[:, 1], local[:, 2])) <= half[1])
            & (distance >= near)
            & (distance <= far)
        )
        for origin, limit in ((source, scanner["grazing_max_deg"]), (sensor, scanner["sensor_grazing_max_deg"])):
            towards = origin - points
            cosine = np.einsum("ij,ij->i", towards, normals) / np.linalg.norm(towards, axis=1)
            fits &= cosine >= np.cos(np.radians(limit))
        for row in np.flatnonzero(fits & ~seen):
            seen[row] = all(
                not blocked(origin, points[row], triangles)
                and not behind_post(origin, points[row], T_post_object, post)
                for origin in (source, sensor)
            )
    predicted = run["plan"]["coverage"]["visible"]
    error = abs(seen.mean() - predicted)
    assert error < 3 * np.sqrt(predicted * (1 - predicted) / count) + 0.005, (seen.mean(), predicted)


def blocked(origin: np.ndarray, target: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether a triangle crosses the segment before the last micrometre."""
    direction = target - origin
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, e2)
    det = np.einsum("ij,ij->i", e1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - triangles[:, 0]
        u = np.einsum("ij,ij->i", s, p) / det
        q = np.cross(s, e1)
        v = q @ direction / det
        t = np.einsum("ij,ij->i", e2, q) / det
    end = 1 - 2e-6 / np.linalg.norm(direction)
    return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < end)).any())


def behind_post(origin: np.ndarray, target: np.ndarray, T_post_object: np.ndarray, post: dict[str, Any]) -> bool:
    """Return whether the segment passes through the post, by points half a millimetre apart."""
    radius, half = post["size_mm"][0] / 2000, post["size_mm"][1] / 2000
    a, b = (T_post_object @ np.append(p, 1.0) for p in (origin, target))
    along = a[:3] + np.linspace(0, 0.999, 800)[:, None] * (b[:3] - a[:3])
    inside = (np.hypot(along[:, 0], along[:, 1]) < radius - 1e-4) & (np.abs(along[:, 2]) < half - 1e-4)
    return bool(inside.any())
