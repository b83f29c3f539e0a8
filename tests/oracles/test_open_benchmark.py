"""The checker of the open benchmark against float64 brute force; its files, results and bounds."""

import hashlib
import json
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.open import bounds, check, tools, tours
from planner.measurability.visibility import find_measured
from planner.tour import generalised_tsp

FOLDER = check.HERE
INSTANCES = sorted(path.stem for path in (FOLDER / "instances").glob("*.json"))
RESULTS = sorted((FOLDER / "results").glob("*.json"))
OF_SENSOR = {"area": "A-housing-area", "line": "A-bracket-line", "camera": "A-knot-camera"}
N_FRESH = 100_000


def _hits(origin, direction, triangles):
    """Return distances along a ray to all triangles it crosses (Moeller, Trumbore 1997), float64."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, e2)
    det = np.einsum("fj,fj->f", e1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - a
        u = np.einsum("fj,fj->f", s, p) / det
        q = np.cross(s, e1)
        v = (q @ direction) / det
        t = np.einsum("fj,fj->f", e2, q) / det
    return t[(u >= 0) & (v >= 0) & (u + v <= 1)]


def _angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _margins(sensor, pose, point, normal):
    """Return all slacks of the conditions of the page, in degrees and millimetres, by angles and without matrices."""
    x, y, z = pose[:, 0], pose[:, 1], pose[:, 2]

    def planar(offset, axis_x, axis_z, fov):
        depth = offset @ axis_z
        angles = [np.degrees(np.arctan2(offset @ axis, depth)) for axis in (axis_x, y)]
        return [fov[k] / 2 - abs(angles[k]) for k in (0, 1)]

    offset = point - pose[:, 3]
    distance = np.linalg.norm(offset)
    found = planar(offset, x, z, sensor["fov_deg"])
    found += [distance - sensor["range_mm"][0], sensor["range_mm"][1] - distance]
    if sensor["depth_mm"]:
        found += [offset @ z - sensor["depth_mm"][0], sensor["depth_mm"][1] - offset @ z]
    found.append(sensor["incidence_max_deg"] - _angle(normal, -offset))
    if sensor["baseline_mm"]:
        second = offset - sensor["baseline_mm"] * x
        found.append(sensor["sensor_incidence_max_deg"] - _angle(normal, -second))
        turn = Rotation.from_rotvec(-np.radians(sensor["sensor_tilt_deg"]) * y)
        found += planar(second, turn.apply(x), turn.apply(z), sensor["sensor_fov_deg"])
    return np.array(found)


@pytest.mark.parametrize("sensor", OF_SENSOR)
def test_measured_agrees_with_brute_force(sensor):
    """A second implementation by angles and brute force over all triangles gives the same verdicts."""
    instance = check.load(OF_SENSOR[sensor])
    surface, poses = instance.surface, instance.arrays["poses"]
    points, normals, _ = surface.draw(60, 5)
    n_measured = n_hidden = 0
    for pose in poses[:: len(poses) // 12]:
        found = check.measured(instance.sensor, surface, pose, points, normals)
        for k, (point, normal) in enumerate(zip(points, normals, strict=True)):
            margins = _margins(instance.sensor, pose, point, normal)
            if np.abs(margins).min() < 1e-6:
                continue
            expected = bool((margins > 0).all())
            for centre in check.centres(instance.sensor, pose) if expected else []:
                length = np.linalg.norm(point - centre)
                hits = _hits(centre, (point - centre) / length, surface.all)
                expected &= not ((hits > 0) & (hits < length - check.GAP)).any()
                n_hidden += not expected
            assert found[k] == expected
            n_measured += expected
    assert n_measured > 40
    assert n_hidden > 5


@pytest.mark.parametrize(("before", "is_hidden"), [(0.01, False), (0.05, True), (100.0, True), (400.0, False)])
def test_a_triangle_before_the_sample_hides_it(before, is_hidden):
    """A triangle hides a sample from 0.02 mm before it up to the centre."""
    sample = np.array([[[-9, -9, 0], [9, -9, 0], [0, 9, 0]]], dtype=float)
    surface = check.Surface(sample, sample + np.array([0, 0, before]))
    assert surface.is_hidden(np.array([0.5, 0.5, 300.0]), np.array([[0.5, 0.5, 0.0]]))[0] == is_hidden


@pytest.mark.parametrize("name", [*OF_SENSOR.values(), "B-mseke-area"])
def test_measured_agrees_with_the_planner(name):
    """The planner's scanner and casters give the same verdicts, up to samples next to an edge."""
    instance = check.load(name)
    bench = tools.Bench(instance)
    samples = bench.samples(3000, 3)
    poses = instance.arrays["poses"][:25]
    theirs = find_measured(tools.in_metres(poses)[:, None], samples, bench.scanner, bench.casters, each=True).T
    ours = instance.measured_by(poses, 1000 * samples.points, samples.normals, each=True)
    assert (theirs != ours).mean() < 2e-4
    assert ours.mean() > 0.03


def test_arm_agrees_with_scipy_rotations():
    """Frames of the arm agree with a chain of scipy rotations, read from the file a second time."""
    path = FOLDER / "arm" / "arm.urdf"
    arm = check.Arm.read(path)
    joints = ElementTree.parse(path).getroot().findall("joint")
    rng = np.random.default_rng(0)
    for q in rng.uniform(arm.limits[:, 0], arm.limits[:, 1], (5, 6)):
        R, t, angles = Rotation.identity(), np.zeros(3), iter(q)
        for joint in joints:
            origin = joint.find("origin").attrib
            t = t + R.apply(1000 * np.array(origin["xyz"].split(), float))
            R = R * Rotation.from_euler("xyz", np.array(origin.get("rpy", "0 0 0").split(), float))
            if joint.get("type") == "revolute":
                R = R * Rotation.from_rotvec(next(angles) * np.array(joint.find("axis").get("xyz").split(), float))
        last = arm.frames(q[None])[-1][0]
        np.testing.assert_allclose(last[:3, :3], R.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(last[:3, 3], t, atol=1e-9)


def test_clearance_agrees_with_dense_points_of_the_boxes():
    """The clearance from boxes is the distance to their nearest point, found among dense points."""
    arm = check.Arm.read(FOLDER / "arm" / "arm.urdf")
    box = np.array([[[600.0, 150.0, 500.0], [70.0, 60.0, 80.0]]])
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 25)] * 3), axis=-1).reshape(-1, 3)
    points = box[0, 0] + grid * box[0, 1]
    rng = np.random.default_rng(1)
    compared = 0
    for q in rng.uniform(arm.limits[:, 0] / 2, arm.limits[:, 1] / 2, (120, 6)):
        frames = [frame[0] for frame in arm.frames(q[None])]
        spheres = [(link, frames[link][:3, :3] @ c + frames[link][:3, 3], r) for link, c, r in arm.spheres]
        to_box = min(np.linalg.norm(points - c, axis=1).min() - r for link, c, r in spheres if link > 1)
        to_floor = min(c[2] - r for link, c, r in spheres if link > 1)
        to_self = min(np.linalg.norm(c - d) - r - s for i, c, r in spheres for j, d, s in spheres if i - j > 2)
        least, found = min(to_box, to_floor, to_self), arm.clearance(q[None], box)[0]
        if to_box > 0:
            assert found <= least + 1e-9
            assert found >= least - 6.0
            compared += to_box == least
    assert compared > 3


@pytest.mark.parametrize("name", [name for name in INSTANCES if name[0] in "AB"])
def test_matrices_are_those_of_the_poses(name):
    """Columns of the stored matrix are recomputed from the poses; poses follow from the configurations."""
    instance = check.Instance(name)
    M, poses = tools.matrix_of(instance), instance.arrays["poses"]
    some = np.linspace(0, len(poses) - 1, 5).astype(int)
    found = instance.measured_by(poses[some], *instance.rows(), each=True).T
    assert (found != M[:, some]).sum() <= 1
    assert int(M.any(axis=1).sum()) == instance.data["coverable_rows"]
    assert [instance.pose_fault(pose) for pose in poses[some]] == [""] * 5
    if instance.tier == "B":
        q = instance.arrays["configurations"][some]
        np.testing.assert_allclose([instance.pose_of(each) for each in q], poses[some], atol=1e-9)
        assert [instance.configuration_fault(each) for each in q] == [""] * 5


def test_parts_have_the_listed_hashes():
    """Every part is the one of sha256.json."""
    listed = json.loads((FOLDER / "parts" / "sha256.json").read_text())
    actual = {path.stem: hashlib.sha256(path.read_bytes()).hexdigest() for path in (FOLDER / "parts").glob("*.stl")}
    assert actual == listed
    assert len(actual) == 14


@pytest.mark.parametrize("count", [4, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_results_are_valid(path, count):
    """At least `count` entries of every file, or all, pass the checker."""
    content = json.loads(path.read_text())
    for entry in content["entries"][:: max(1, len(content["entries"]) // count)]:
        check.judge(entry, check.load(entry["instance"]), N_FRESH)


def test_bounds_do_not_exceed_the_best_known():
    """No bound is above a solution, of any track."""
    best = {}
    for entry in json.loads((FOLDER / "results" / "best-known.json").read_text())["entries"]:
        value = check.judge(entry, check.load(entry["instance"]), 1000)["value"] if "tour" in entry else None
        size = len(entry.get("columns") or entry.get("configurations") or entry["poses"]) if value is None else value
        best[entry["instance"], str(entry.get("target")), entry.get("track")] = size
    proofs = json.loads((FOLDER / "best" / "proofs.json").read_text())
    everywhere = json.loads((FOLDER / "best" / "bounds.json").read_text())
    for (name, target, track), value in best.items():
        if name.startswith("C-"):
            assert proofs[name]["bound"] <= value + 1e-6
        elif name[0] in "AB":
            bound = proofs[name][target]["bound"] if track == "cover" else everywhere[name][target]["bound"]
            assert bound <= value


ENTRY = next(entry for entry in json.loads((FOLDER / "results" / "example-greedy.json").read_text())["entries"])


def _entry(**changes):
    return {**ENTRY, **changes}


def _with_pose(change):
    poses = np.array(ENTRY["poses"]).reshape(-1, 3, 4)
    change(poses[0])
    return _entry(poses=poses.reshape(-1, 12).tolist())


def _mirror(pose):
    pose[:, 0] *= -1


def _skew(pose):
    pose[0, 0] += 1e-3


def _approach(pose):
    pose[:, 3] = 0


@pytest.mark.parametrize(
    ("entry", "rule"),
    [
        (_entry(poses=ENTRY["poses"][:-4]), "are required"),
        (_entry(poses=[]), "no pose"),
        (_entry(target=0.5), "not one of"),
        (_entry(track="other"), "the track"),
        (_entry(target=1.0), "the track"),
        (_with_pose(_mirror), "reflection"),
        (_with_pose(_skew), "rigid"),
        (_with_pose(_approach), "bounding box"),
        (_entry(track="cover", columns=[0]), "are required"),
        (_entry(track="cover", columns=[-1]), "from 0 to"),
        (_entry(track="cover", columns=[0.5]), "from 0 to"),
    ],
)
def test_broken_rules_are_refused(entry, rule):
    """An entry that breaks a rule is refused with the rule."""
    with pytest.raises(check.CheckError, match=rule):
        check.judge(entry, check.load(entry["instance"]), 20_000)


def test_tours_must_visit_every_group_once():
    """Tours that miss, repeat or invent nodes are refused; the time is the sum over the moves."""
    instance = check.load("C-mseke")
    group = instance.arrays["group"]
    nodes = np.array([np.flatnonzero(group == g)[0] for g in range(group.max() + 1)])
    for tour in (nodes[:-1], [*nodes, nodes[0]], [-1, *nodes[1:]], nodes + 0.5):
        with pytest.raises(check.CheckError, match="the tour must"):
            check.judge({"tour": np.asarray(tour).tolist()}, instance)
    q = [np.array(instance.data["home"]), *instance.arrays["configurations"][nodes], np.array(instance.data["home"])]
    total = 0.0
    for a, b in pairwise(q):  # integrates the speed of each joint in small steps
        slowest = 0.0
        for distance, speed in zip(np.abs(b - a), instance.arm.speed, strict=True):
            rate = speed / instance.data["acceleration_s"]
            peak = min(speed, np.sqrt(distance * rate))
            slowest = max(slowest, peak / rate * 2 + (distance - peak**2 / rate) / peak if peak > 0 else 0.0)
        total += slowest
    assert check.judge({"tour": nodes.tolist()}, instance)["value"] == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_tours_are_proven_as_by_dynamic_programming(seed):
    """Bound and tour of the vertex sets are the optimum of a dynamic programme over subsets, from any known tour."""
    rng = np.random.default_rng(seed)
    group = np.sort(np.concatenate([np.arange(7), rng.integers(0, 7, 9)]))
    at = rng.random((1 + len(group), 2)) * 10
    cost = np.abs(at[:, None] - at).max(axis=2)
    first = np.concatenate([[0, 1], 1 + np.cumsum(np.bincount(group))])
    optimum = generalised_tsp.solve_exactly(generalised_tsp.make_instance(cost, first)).cost
    for known in (optimum, 1.3 * optimum):
        bound, _, tour = tours.prove(cost, group, known)
        assert bound == pytest.approx(optimum, rel=1e-6)
        assert bound <= optimum
        assert sorted(group[tour]) == list(range(7))
        nodes = np.concatenate([[0], 1 + tour])
        assert cost[nodes, np.roll(nodes, -1)].sum() == pytest.approx(optimum, rel=1e-9)


@pytest.mark.parametrize("name", ["A-housing-area", "A-bracket-line", "A-knot-camera"])
def test_measured_faces_are_within_the_sets_of_the_bounds(name):
    """A pose measures no sample of a face outside the relaxed sets of nodes that contain the pose."""
    instance = check.load(name)
    relaxation = bounds.Relaxation(instance)
    points, normals, face = instance.surface.draw(4000, 8)
    rng, poses = np.random.default_rng(0), instance.arrays["poses"]
    for pose in poses[rng.permutation(len(poses))[:60]]:
        radius, cell = 10 ** rng.uniform(0, 2), rng.uniform(0.01, 0.4) if relaxation.narrow else 4.0
        shift = rng.uniform(-1, 1, 3) * radius / np.sqrt(3)
        turn = rng.standard_normal(3)
        turn *= rng.uniform(0, min(cell, 1.0)) / np.linalg.norm(turn)
        normal = Rotation.from_rotvec(turn).apply(pose[:, 0])
        node = np.array([[*(pose[:, 3] + shift), radius, *normal, cell]])
        inside = relaxation.sets(node)[0]
        seen = check.measured(instance.sensor, instance.surface, pose, points, normals)
        assert inside[face[seen]].all()
        assert not inside.all()


def test_children_of_a_node_cover_it():
    """Every position and normal of a node lies in one of its children."""
    rng = np.random.default_rng(3)
    for cell in bounds.hemisphere_cells()[::7]:
        box = np.array([5.0, -7.0, 11.0, 40.0, *cell[:3], 0.0])
        half = 40.0 / np.sqrt(3)
        children = bounds.split(box, 150.0)
        for point in box[:3] + rng.uniform(-half, half, (200, 3)):
            assert (np.abs(children[:, :3] - point).max(axis=1) <= children[:, 3] / np.sqrt(3) + 1e-9).any()
        node = np.array([0.0, 0.0, 0.0, 1e-3, *cell])
        children = bounds.split(node, 150.0)
        turns = rng.standard_normal((300, 3))
        turns *= cell[3] * rng.uniform(0, 1, (300, 1)) / np.linalg.norm(turns, axis=1, keepdims=True)
        for normal in Rotation.from_rotvec(turns).apply(cell[:3]):
            assert (np.arccos(np.clip(children[:, 4:7] @ normal, -1, 1)) <= children[:, 7]).any()
    directions = rng.standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cells = bounds.hemisphere_cells()
    angles = np.arccos(np.clip(np.abs(directions @ cells[:, :3].T), -1, 1))
    assert (angles <= cells[:, 3]).any(axis=1).all()


def test_largest_weight_is_not_below_any_pose():
    """The bound of the branch and bound is at least the weight of thousands of candidates."""
    instance = check.load("A-housing-area")
    relaxation = bounds.Relaxation(instance)
    weights = np.random.default_rng(0).random(len(relaxation.areas)) * relaxation.areas
    largest, _ = relaxation.largest(weights, 3000)
    points, normals, face = instance.surface.draw(20_000, 1)
    density = (weights / relaxation.areas)[face] * relaxation.areas.sum() / len(points)
    each = instance.measured_by(instance.arrays["poses"][::4], points, normals, each=True)
    assert (each @ density).max() <= largest
    assert largest < weights.sum()


def test_least_weight_is_the_fractional_knapsack():
    """The least weight with a required area equals that of a linear programme."""
    from scipy.optimize import linprog

    rng = np.random.default_rng(2)
    u, areas = rng.random(40), rng.random(40)
    for share in (0.2, 0.9, 1.0):
        expected = linprog(u, A_ub=-areas[None], b_ub=[-share * areas.sum()], bounds=(0, 1)).fun
        assert bounds.least_weight(u, areas, share * areas.sum()) == pytest.approx(expected, rel=1e-9)


def test_scan_gives_measured_points_of_the_surface():
    """Points of a scan lie on the part, and their view measures them."""
    instance = check.load("D-mug")
    first = np.array(instance.data["first"])
    points = check.scan(instance, first)
    assert len(points) > 200
    triangles = instance.surface.triangles
    for point in points[:: len(points) // 20]:
        ray = (point - first[:, 3]) / np.linalg.norm(point - first[:, 3])
        assert np.abs(_hits(first[:, 3], ray, triangles) - np.linalg.norm(point - first[:, 3])).min() < 1e-3


def test_checker_needs_numpy_and_embreex_alone():
    """check.py imports the standard library, numpy and embreex."""
    import ast
    import sys

    tree = ast.parse((Path(check.__file__)).read_text())
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names.add(str(node.module).split(".")[0])
    assert names - set(sys.stdlib_module_names) == {"numpy", "embreex"}
