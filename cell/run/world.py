"""The checked cell of a run folder compiled again, as it was or with one thing taken out of it.

`scene.resolved.json` says all that stood in the cell; the true triangles of mesh fixtures are in the folder. So the
world is what was checked, whatever became of the scene file since. Metres, radians.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from cell.robot.frames import kuka_abc_from_pose
from cell.run.record import RunRecord, artefact, understood
from cell.scene.scene import Scene
from cell.world.world import World
from cell.world.world import compile as compile_world
from planner.ports import Floats
from planner.surface.mesh import TriangleMesh
from planner.values import readonly


def scene_of(run: RunRecord, resolved: Mapping[str, Any], *, without: Collection[str] = ()) -> Scene:
    """What stood in the cell, as a scene; scanner and plan keep their defaults (but for baseline and collision).

    Args:
        run: a run folder.
        resolved: its `scene.resolved.json`.
        without: names of fixtures to leave out; "post" leaves out the post.

    Raises:
        FileError: if the file is damaged, or the mesh of a fixture is missing or changed.
    """
    with understood(run.folder / "scene.resolved.json"):
        T_base_centre = _transform(resolved, "T_base_object") @ _transform(resolved, "T_object_centre")
        T_flange_scanner = _transform(resolved, "T_flange_scanner")
        T_scanner_housing = np.linalg.inv(T_flange_scanner) @ _transform(resolved["housing"], "T_flange_housing")
        built_in = {fixture["name"]: fixture for fixture in resolved["fixtures"] if fixture["built_in"]}
        pedestal, post = built_in.get("pedestal"), built_in.get("post")
        robot: dict[str, Any] = {"home_deg": [float(angle) for angle in resolved["home_deg"]]}
        robot["pedestal_height_mm"] = 0.0 if pedestal is None else float(pedestal["size_mm"][2])
        if pedestal is not None:
            robot["pedestal_size_mm"] = pedestal["size_mm"][:2]
        content = {
            "clearance_mm": float(resolved["clearance_mm"]),
            # Runs that do not say it were checked with the hull.
            "plan": {"collision": resolved["plan"].get("collision", "hull")},
            "robot": robot,
            "scanner": {"baseline_mm": float(resolved["scanner"].get("baseline_mm", 0.0))},
            "mount": _pose(T_flange_scanner),
            "housing": _pose(T_scanner_housing)
            | {
                "size_mm": resolved["housing"]["size_mm"],
                "bracket_diameter_mm": float(resolved["housing"]["bracket_diameter_mm"]),
            },
            "placement": _pose(T_base_centre),
            "post": {"enabled": False} if post is None or "post" in without else {"diameter_mm": post["size_mm"][0]},
            "fixtures": [
                _fixture(run, fixture)
                for fixture in resolved["fixtures"]
                if not fixture["built_in"] and fixture["name"] not in without
            ],
        }
        return Scene.model_validate(content)


def world_of(
    run: RunRecord, resolved: Mapping[str, Any], part: TriangleMesh, *, without: Collection[str] = ()
) -> World:
    """The compiled cell.

    Args:
        run: a run folder.
        resolved: its `scene.resolved.json`.
        part: the part [m], object frame.
        without: names of fixtures to leave out; "post" leaves out the post.

    Raises:
        FileError: if the run's files are damaged.
    """
    scene = scene_of(run, resolved, without=without)
    return compile_world(scene, part.vertices, part_faces=part.faces, refuse=False)


def _fixture(run: RunRecord, fixture: Mapping[str, Any]) -> dict[str, Any]:
    kept = {key: fixture[key] for key in ("name", "shape", "attached_to", "occludes")}
    if fixture["shape"] != "mesh":
        return kept | _pose(_transform(fixture, "pose")) | {"size_mm": fixture["size_mm"]}
    artefact(run, fixture["file"])  # checks that it is what the run wrote
    # The file holds the mesh in the frame that it is attached to: the pose is in its vertices.
    return kept | {"path": str((run.folder / fixture["file"]).absolute()), "units": "mm"}


def _transform(table: Mapping[str, Any], name: str) -> Floats:
    return readonly(name, table[name], (4, 4))


def _pose(T: Floats) -> dict[str, list[float]]:
    position, abc = kuka_abc_from_pose(T)
    return {"position_mm": (position * 1000).tolist(), "abc_deg": np.degrees(abc).tolist()}
