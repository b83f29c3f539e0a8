"""Collision shapes, hull or triangles: missed collisions, false rejections and time against triangle-exact truth.

Configurations are joint configurations of candidate viewpoints (those that `reach` checks) and of random scanner poses
near the surface, restricted to those at which only the part can be too near. Truth is python-fcl on the true triangles
of the part: boxes as boxes, cylinders between the prisms around and inside them. The few configurations for which these
two prisms disagree, or within 10 um of the clearance, are omitted. Times are processor times of one run.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fcl
import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.configurations_beside_part import configurations
from benchmarks.parts import meshes
from benchmarks.triangle_cell import polytope
from cell.part import workpiece
from cell.part.builtin import NAMES
from cell.part.workpiece import Workpiece
from cell.plan.candidates import generate_viewpoints
from cell.robot.arm import kinematics_of
from cell.scene.file import load_scene
from cell.scene.model import Scene
from cell.scene.settle import settle
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.geometry.decimation import decimate
from planner.geometry.distance import BOX, TriangleTree
from planner.kinematics import reach
from planner.values import Floats

FIDELITIES = ("hull", "exact")
_CANDIDATES, _NEAR = 250, 250  # configurations of each kind, per part
_SIDES = 96
_UNDECIDED = 1e-5  # m
_REPEATS = 3
_TREE_POSES = 400


def run() -> list[dict[str, Any]]:
    """Measure one row per part and fidelity, and one over all parts for each fidelity."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, part, scene in _parts(Path(folder)):
            rows += _rows(name, part, scene)
    for fidelity in FIDELITIES:
        of = [row for row in rows if row["collision"] == fidelity]
        total: dict[str, Any] = {"part": "all", "collision": fidelity}
        for column in ("configurations", "truly free", "missed", "refused falsely", "reachable", "setup s"):
            total[column] = round(sum(row[column] for row in of), 2)
        total["us each"] = round(float(np.mean([row["us each"] for row in of])), 1)
        total["reach s"] = round(sum(row["reach s"] for row in of), 2)
        rows.append(total)
    return rows + _tree_rows()


def _tree_rows() -> list[dict[str, Any]]:
    """Compare distances of the housing from a mug's triangles with python-fcl: times and differences."""
    part = workpiece.load("mug")
    mesh = part.reference
    tree = TriangleTree(mesh)
    model = fcl.CollisionObject(_bvh(mesh.vertices, mesh.faces))
    half = np.array([0.08, 0.04, 0.03])
    box = fcl.CollisionObject(fcl.Box(*(2 * half)))
    rng = np.random.default_rng(0)
    away = rng.normal(size=(_TREE_POSES, 3))
    positions = part.centre + away / np.linalg.norm(away, axis=1)[:, None] * rng.uniform(0.06, 0.25, (_TREE_POSES, 1))
    turns = [np.ascontiguousarray(Rotation.random(rng=rng).as_matrix()) for _ in positions]
    zero, upright = np.zeros(3), np.eye(3).ravel()
    posed = list(zip(positions, turns, strict=True))

    def own(reach: float, any_nearer: bool) -> Floats:
        return np.array([
            tree.distance(BOX, half, p, R.ravel(), zero, upright, reach, any_nearer=any_nearer) for p, R in posed
        ])  # fmt: skip

    def theirs() -> Floats:
        found = []
        for p, R in posed:
            box.setTransform(fcl.Transform(R, p))
            found.append(0.0 if fcl.collide(box, model) else fcl.distance(box, model))
        return np.array(found)

    own(1.0, False)
    rows, truth = [], None
    for name, ask in (
        ("python-fcl, distance", theirs),
        ("own tree, distance", lambda: own(1.0, False)),
        ("own tree, nearer than 10 mm?", lambda: own(0.01, True)),
    ):
        started = time.process_time()
        found = ask()
        seconds = time.process_time() - started
        truth = found if truth is None else truth
        whole = name.endswith("distance")
        row = {"part": "mug", "collision": name, "configurations": len(posed)}
        row["us each"] = round(1e6 * seconds / len(posed), 1)
        row["largest difference um"] = round(1e6 * float(np.abs(found - truth).max()), 2) if whole else ""
        rows.append(row)
    return rows


def _parts(folder: Path) -> Iterator[tuple[str, Workpiece, Scene]]:
    for name in NAMES:
        yield name, workpiece.load(name), load_scene(None, {"part": {"name": name}, "post": {"enabled": False}})
    bucket = folder / "bucket.stl"
    deep_bucket().export(bucket)
    files = [("bucket", (str(bucket), "--units", "mm")), *meshes(folder)]
    for name, (path, _, units) in files:
        table = {"path": path, "units": units}
        near: dict[str, dict[str, object]] = {"plan": {"standoffs_mm": [100.0]}, "scanner": {"sensor": "paper"}}
        scene = load_scene(None, {"part": table, "post": {"enabled": False}, **(near if name == "bucket" else {})})
        yield name.removesuffix(" (file)"), workpiece.load(path, units), scene


def deep_bucket() -> trimesh.Trimesh:
    """Return a bucket 480 mm wide and 360 mm deep with a 12 mm wall [mm]: the scanner has to enter it."""
    outline = [(0.0, 0.0), (240.0, 0.0), (240.0, 360.0), (228.0, 360.0), (228.0, 12.0), (0.0, 12.0)]
    return trimesh.creation.revolve(np.array(outline), sections=160)


def _rows(name: str, part: Workpiece, scene: Scene) -> list[dict[str, Any]]:
    mesh = part.reference
    settings = settle(scene, part).settings
    planning = decimate(mesh, settings.faces)
    views = generate_viewpoints(scene, settings, part, planning)
    worlds, rows, decision = {}, [], None
    for fidelity in FIDELITIES:
        table = scene.model_dump(exclude_unset=True)
        variant = Scene.model_validate({**table, "plan": {**table.get("plan", {}), "collision": fidelity}})
        started = time.process_time()
        worlds[fidelity] = world = compile_world(variant, mesh.vertices, part_faces=mesh.faces, baseline_mm=75.0)
        setup = time.process_time() - started
        checker = MujocoCollisionChecker(world)
        checker.distance(world.home[None])
        if decision is None:
            q = configurations(
                world, part, views.T_object_scanner[:, 0], settings.standoffs[0], (_CANDIDATES, _NEAR),
                np.random.default_rng(0),
            )  # fmt: skip
            decision = _decide(world, part, q)
        q, truth = decision
        checker.free(q)
        seconds = []
        for _ in range(_REPEATS):
            started = time.process_time()
            free = checker.free(q)
            seconds.append(time.process_time() - started)
        kinematics = kinematics_of(world.model)
        started = time.process_time()
        reached = reach.solve_reach(views, world.T_base_object, world.T_flange_scanner, kinematics, checker)
        rows.append(
            {
                "part": name,
                "collision": fidelity,
                "configurations": len(q),
                "truly free": int(truth.sum()),
                "missed": int((free & ~truth).sum()),
                "refused falsely": int((~free & truth).sum()),
                "us each": round(1e6 * min(seconds) / max(1, len(q)), 1),
                "setup s": round(setup, 2),
                "reachable": int(reached.reachable.sum()),
                "of": len(views),
                "reach s": round(time.process_time() - started, 2),
            }
        )
    return rows


def _decide(world: World, part: Workpiece, q: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the configurations that fcl decides, and whether they keep the clearance from the true triangles."""
    mesh = part.reference
    T = world.T_base_object
    placed = fcl.CollisionObject(
        _bvh(mesh.vertices, mesh.faces), fcl.Transform(np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy())
    )
    tree = cKDTree(mesh.vertices @ T[:3, :3].T + T[:3, 3])
    corners = mesh.vertices[mesh.faces]
    longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
    data = world.data()
    moving = [g for g in range(world.model.ngeom) if _moves(world, g)]
    shapes = {g: _fcl_shapes(world, g) for g in moving}
    decided, truth = [], []
    for k, configuration in enumerate(q):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(world.model, data)
        low = high = 1.0
        for geom in moving:
            position, R = data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy()
            if tree.query(position)[0] - longest - world.model.geom_rbound[geom] > world.clearance + _UNDECIDED:
                continue
            gaps = []
            for shape in shapes[geom]:
                shape.setTransform(fcl.Transform(R, position))
                gaps.append(0.0 if fcl.collide(shape, placed) else fcl.distance(shape, placed))
            low, high = min(low, gaps[0]), min(high, gaps[-1])
            if high < world.clearance - _UNDECIDED:
                break
        free = low >= world.clearance + _UNDECIDED
        if free or high < world.clearance - _UNDECIDED:
            decided.append(k)
            truth.append(free)
    return q[decided], np.array(truth, dtype=bool)


def _bvh(vertices: Floats, faces: NDArray[np.integer]) -> fcl.BVHModel:
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(np.array(vertices), np.array(faces))
    model.endModel()
    return model


def _moves(world: World, geom: int) -> bool:
    """Return whether a shape is checked with the part."""
    part = {g for g, entity in enumerate(world.entities) if entity == "part"}
    return any(geom in pair and part & set(pair) for pair in world.pairs.tolist() if geom not in part)


def _fcl_shapes(world: World, geom: int) -> list[fcl.CollisionObject]:
    """Return the shape, or prisms around and inside it."""
    size = world.model.geom_size[geom]
    if world.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return [fcl.CollisionObject(fcl.Box(*(2 * size)))]
    if world.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        solid = polytope(world.model, geom)
        return [fcl.CollisionObject(_bvh(solid.vertices, solid.faces))]
    found = []
    for radius in (size[0] / np.cos(np.pi / _SIDES), size[0]):
        prism = trimesh.creation.cylinder(radius, 2 * size[1], sections=_SIDES)
        found.append(fcl.CollisionObject(_bvh(prism.vertices, prism.faces)))
    return found


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw `collision_fidelity.png`: false refusals per part and fidelity; time and misses over all of them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    colours = {"hull": "#c4622d", "exact": "#2a6f97"}
    figure = Figure(figsize=(11, 3.9), dpi=120, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.1, 1))
    names = list(dict.fromkeys(row["part"] for row in rows if row["part"] != "all"))
    for k, fidelity in enumerate(FIDELITIES):
        of = {row["part"]: row for row in rows if row["collision"] == fidelity}
        shares = [100 * of[name]["refused falsely"] / max(1, of[name]["truly free"]) for name in names]
        at = np.arange(len(names)) + 0.4 * (k - 0.5)
        bars = left.bar(at, shares, 0.38, color=colours[fidelity], label=fidelity)
        left.bar_label(
            bars,
            [f"{share:.0f}" if share >= 0.5 else "0" if share == 0 else "<1" for share in shares],
            fontsize=7,
            color="0.3",
        )
        total = of["all"]
        blocked = total["configurations"] - total["truly free"]
        row = 1 - k
        right.barh(row, total["us each"], 0.5, color=colours[fidelity])
        right.text(
            total["us each"] + 0.6, row,
            f"{total['us each']:.0f} us, prepared in {total['setup s'] / len(names):.1f} s\n"
            f"{total['missed']:.0f} of {blocked:.0f} contacts missed\n"
            f"{total['refused falsely']:.0f} of {total['truly free']:.0f} refused falsely",
            va="center", fontsize=8, color="0.2",
        )  # fmt: skip
    left.set_xticks(range(len(names)), names, rotation=20, ha="right", fontsize=8)
    left.set_title("free by the true triangles, and refused [%]", fontsize=10, loc="left")
    left.legend(frameon=False, fontsize=9)
    right.set_yticks([1, 0], FIDELITIES, fontsize=9)
    right.set_title("time for a check near the part [us]", fontsize=10, loc="left")
    right.set_xlim(0, 2.1 * max(row["us each"] for row in rows if row["part"] == "all"))
    for axis in (left, right):
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    FigureCanvasAgg(figure)
    figure.savefig(folder / "collision_fidelity.png", format="png", metadata={"Software": "scan-cell"})
