"""Plans with arms from files: `ROBOT_FILES=a.urdf:b.xml SCENES=10 python -m benchmarks robots`.

The default scene with the built-in Mseke, scaled to a longest side of a tenth of the arm's reach, at random positions
in front of the arm. `surface %` is the share of the surface that reachable candidates measure, `visible %` the share of
that which the plan measures. `contacts` counts configurations, half a degree apart along the motion, at which true
triangles of the file touch each other or the part, by fcl and MuJoCo's frames of the file itself, without neighbours
and pairs that `cell robot` lists as excluded. `limits` is the largest share of a limit of angle, speed, acceleration or
jerk.
"""

from __future__ import annotations

import itertools
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import fcl
import mujoco
import numpy as np
import trimesh

from benchmarks.cell_process import run_cell
from cell.errors import CellError
from cell.part import workpiece
from cell.robot import robot_file
from cell.robot.arm import kinematics_of
from cell.robot.model import mesh_of
from cell.robot.robot_file import RobotFile
from cell.world.robot_check import report
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

_DRAWS = 10
_STEP = np.radians(0.5)


def run() -> list[dict[str, Any]]:
    """Return one row for each scene."""
    files = [Path(each) for each in os.environ.get("ROBOT_FILES", "").split(":") if each]
    if not files:
        raise SystemExit("no arm is given; ROBOT_FILES=a.urdf:b.xml names them")
    return [_row(file, number) for file in files for number in range(int(os.environ.get("SCENES", "2")))]


def _row(file: Path, number: int) -> dict[str, Any]:
    """Return the row of the first feasible draw of a scene: in others the part collides with the arm at home, say."""
    for draw in range(_DRAWS):
        try:
            return _scene(file, number, draw)
        except CellError as error:
            message = str(error)
    raise RuntimeError(f"none of {_DRAWS} draws of scene {number} can be planned: {message}")


def _scene(file: Path, number: int, draw: int) -> dict[str, Any]:
    rng = np.random.default_rng([number, draw])
    found, model = report(file)
    kinematics = kinematics_of(model)
    sampled = kinematics.forward(rng.uniform(kinematics.limits.lower, kinematics.limits.upper, (5000, 6)))
    reach = float(np.linalg.norm(sampled[:, :3, 3], axis=1).max())
    part = workpiece.load("mseke").reference
    vertices = (part.vertices - part.vertices.mean(axis=0)) * 0.1 * reach / np.ptp(part.vertices, axis=0).max()
    away, bearing = reach * rng.uniform(0.45, 0.6), np.radians(rng.uniform(-40, 40))
    at = 1000 * np.array([away * np.cos(bearing), away * np.sin(bearing), reach * rng.uniform(0.15, 0.4)])
    with tempfile.TemporaryDirectory() as folder:
        trimesh.Trimesh(1000 * vertices, part.faces).export(Path(folder) / "part.stl")
        scene = f'[robot]\nmodel = "{file.absolute()}"\n[placement]\nposition_mm = {at.round(1).tolist()}\n'
        (Path(folder) / "cell.toml").write_text(scene, encoding="utf-8")
        part_file, scene_file, out = (str(Path(folder) / name) for name in ("part.stl", "cell.toml", "run"))
        words = ("plan", part_file, "--units", "mm", "--scene", scene_file, "--out", out)
        _, took = run_cell(Path(folder), *words)
        plan = json.loads((Path(folder) / "run/report.json").read_text(encoding="utf-8"))
        resolved = json.loads((Path(folder) / "run/scene.resolved.json").read_text(encoding="utf-8"))
        with np.load(Path(folder) / "run/motion.npz") as motion:
            stored = {name: motion[name] for name in motion.files}
        placed = np.array(resolved["T_base_object"])
        read = trimesh.load(Path(folder) / "run/reference.ply", process=False)
        surface = TriangleMesh(np.asarray(read.vertices) / 1000, np.asarray(read.faces, dtype=np.int32))
    excused = {frozenset(pair.split(" with ")) for pair in found.excused}
    contacts, looked = _contacts(robot_file.read_robot(file), stored["via_q"], surface, placed, excused)
    coverage = plan["coverage"]
    return {
        "arm": file.stem,
        "scene": number,
        "views": int((stored["view"] >= 0).sum()),
        "surface %": round(100 * coverage["coverable"], 2),
        "visible %": round(100 * coverage["visible"] / coverage["coverable"], 2),
        "contacts": contacts,
        "of": looked,
        "limits": round(_share_of_limits(stored), 6),
        "cpu s": round(took["cpu s"], 1),
    }


def _share_of_limits(motion: dict[str, Any]) -> float:
    """Return the largest share of a limit that a sampled motion uses."""
    low, high = motion["limit_lower"], motion["limit_upper"]
    shares = [np.abs((2 * motion["q"] - low - high) / (high - low)).max()]
    for name, limit in (("qd", "limit_velocity"), ("qdd", "limit_acceleration")):
        if name in motion:
            shares.append((np.abs(motion[name]) / motion[limit]).max())
    jerk = np.diff(motion["qdd"], axis=0) / np.diff(motion["t"])[:, None]  # mean jerk between samples
    shares.append((np.abs(jerk) / motion["limit_jerk"]).max())
    return float(max(shares))


def _contacts(
    file: RobotFile, via: Floats, part: TriangleMesh, T_base_object: Floats, excused: set[frozenset[str]]
) -> tuple[int, int]:
    """Return the number of configurations of a motion with touching triangles, and the number checked."""
    model, data = file.model, mujoco.MjData(file.model)
    base = model.body(file.base).id
    links = {int(model.jnt_bodyid[model.joint(name).id]): f"link_{i + 1}" for i, name in enumerate(file.joints)}
    links |= {
        int(model.joint(each.joint).bodyid[0]): model.body(model.joint(each.joint).bodyid[0]).name
        for each in file.mimic_joints
    }
    links[base] = "base"
    pieces: dict[str, list[tuple[int, Any]]] = {}
    above: dict[str, str] = {}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        while body not in links and body > 0:
            body = int(model.body_parentid[body])
        pieces.setdefault(links[body], []).append((int(model.geom_bodyid[geom]), _bvh(mesh_of(model, geom))))
        parent = int(model.body_parentid[body])
        while parent not in links and parent > 0:
            parent = int(model.body_parentid[parent])
        above[links[body]] = links.get(parent, "")
    names = list(pieces)
    pairs = [
        (one, other)
        for i, one in enumerate(names)
        for other in names[i + 1 :]
        if other not in (above[one],) and one != above[other] and frozenset((one, other)) not in excused
    ]
    stands = fcl.CollisionObject(_bvh(part), fcl.Transform(T_base_object[:3, :3], T_base_object[:3, 3]))
    touching = looked = 0
    for q_from, q_to in itertools.pairwise(via):
        steps = max(1, int(np.ceil(np.abs(q_to - q_from).max() / _STEP)))
        for share in np.arange(steps) / steps:
            q = q_from + share * (q_to - q_from)
            for name, angle in zip(file.joints, q, strict=True):
                data.joint(name).qpos = angle
            for each in file.mimic_joints:
                data.joint(each.joint).qpos = each.ratio * q[each.axis] + each.offset
            mujoco.mj_kinematics(model, data)
            R, origin = data.xmat[base].reshape(3, 3), data.xpos[base]
            at = {
                name: [
                    fcl.CollisionObject(
                        bvh,
                        fcl.Transform(R.T @ data.xmat[body].reshape(3, 3), R.T @ (data.xpos[body] - origin)),
                    )
                    for body, bvh in shapes
                ]
                for name, shapes in pieces.items()
            }
            touch = any(fcl.collide(a, b) for one, other in pairs for a in at[one] for b in at[other])
            touch = touch or any(fcl.collide(each, stands) for name in names for each in at[name])
            touching, looked = touching + touch, looked + 1
    return touching, looked


def _bvh(mesh: TriangleMesh) -> Any:
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    model.endModel()
    return model
