"""What an execution needs of a run folder, as values: part, occluders, scanner, kinematics, placement and mount.

All of it is read from the run's own files, so that an execution scans exactly what was planned, whatever became of the
scene file or the part's file since. Object frame where nothing else is said, metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell import scanners
from cell.errors import FileError, SceneError, UsageError
from cell.rays.embree import EmbreeRayCaster
from cell.rays.occluders import box, floor_square, prism
from cell.run import reader as run_reader
from cell.run.record import RunRecord, artefact, understood
from planner.measurability.quality import Limited
from planner.ports import Floats, Scanner
from planner.surface.mesh import TriangleMesh
from planner.values import readonly

if TYPE_CHECKING:
    from cell.robot.kinematics import Kr16Kinematics


@dataclass(frozen=True, slots=True, eq=False)
class RunCell:
    """Part, surroundings and scanner of a run.

    Attributes:
        part_name: for reports.
        reference: the part [m], object frame.
        planning: its decimated copy [m], object frame.
        part_caster: casts rays on the reference.
        occluder_caster: casts rays on post, pedestal, floor and the fixtures that occlude, object frame.
        scanner: the sensor's law, at the resolution of this execution.
        scanner_parameters: what defines it, named as in the run folder.
        kinematics: of the arm.
        T_base_object: (4, 4) placement [m].
        T_flange_scanner: (4, 4) mount [m].
        speed: fraction of the axis speeds that the plan was timed with.
        required_visible: visible coverage that the plan was asked for, fraction.
    """

    part_name: str
    reference: TriangleMesh
    planning: TriangleMesh
    part_caster: EmbreeRayCaster
    occluder_caster: EmbreeRayCaster
    scanner: Scanner
    scanner_parameters: Mapping[str, Any]
    kinematics: Kr16Kinematics
    T_base_object: Floats
    T_flange_scanner: Floats
    speed: float
    required_visible: float

    def __post_init__(self) -> None:
        for name in ("T_base_object", "T_flange_scanner"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (4, 4)))

    def scanner_pose(self, q: Floats) -> Floats:
        """(4, 4) T_object_scanner [m] at (6,) joint angles [rad]."""
        T_base_scanner = self.kinematics.forward(np.asarray(q)[None])[0] @ self.T_flange_scanner
        T: Floats = np.linalg.inv(self.T_base_object) @ T_base_scanner
        return T


def read_cell(run: RunRecord, resolution_deg: float | None = None) -> RunCell:
    """Read the scene of a run.

    Args:
        run: a run folder with every artefact of a finished plan.
        resolution_deg: angle between neighbouring rays in place of the plan's; None keeps that.

    Raises:
        UsageError: if the resolution is not possible.
        FileError: if an artefact is missing, changed or damaged.
    """
    resolved = run_reader.resolved_scene(run)
    reference = run_reader.mesh(run, "reference.ply")
    T_base_object = run_reader.transform(run, resolved, "T_base_object")
    with understood(run.folder / "scene.resolved.json"):
        parameters = dict(resolved["scanner"])
        name = str(resolved["part"]["name"])
        speed = float(resolved["speed_scaling"])
        required = float(resolved["plan"]["required_visible"])
        max_sigma_mm = resolved["plan"].get("max_sigma_mm")
    if resolution_deg is not None:
        parameters["resolution_deg"] = [resolution_deg, resolution_deg]
    try:
        values = {key: value for key, value in parameters.items() if key != "type"}
        scanner: Any = scanners.make(str(parameters["type"]), values)
    except SceneError as error:
        if resolution_deg is None:
            raise
        raise UsageError(f"--resolution {resolution_deg:g} is not possible: {error}") from error
    if max_sigma_mm is not None:
        scanner = Limited(scanner, float(max_sigma_mm) / 1000)  # what the plan does not count, the scan does not take
    return RunCell(
        part_name=name,
        reference=reference,
        planning=run_reader.mesh(run, "planning.ply"),
        part_caster=EmbreeRayCaster(reference.vertices, reference.faces),
        occluder_caster=EmbreeRayCaster(*_one_mesh(_occluders(run, resolved, T_base_object))),
        scanner=scanner,
        scanner_parameters=parameters,
        kinematics=kinematics_of(run),
        T_base_object=T_base_object,
        T_flange_scanner=run_reader.transform(run, resolved, "T_flange_scanner"),
        speed=speed,
        required_visible=required,
    )


def kinematics_of(run: RunRecord) -> Kr16Kinematics:
    """Kinematics of the model that was checked, `cell.xml`.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    import mujoco

    from cell.robot.kinematics import Kr16Kinematics

    text = artefact(run, "cell.xml").decode("utf-8", errors="replace")
    try:
        return Kr16Kinematics.from_model(mujoco.MjModel.from_xml_string(text))
    except (ValueError, KeyError) as error:
        reason = " ".join(str(error).split())[:160]
        raise FileError(f"{run.folder / 'cell.xml'} is damaged: {reason}; plan again") from error


def _occluders(
    run: RunRecord, resolved: Mapping[str, Any], T_base_object: Floats
) -> list[tuple[Floats, NDArray[np.int32]]]:
    """Vertices (V, 3) and faces (F, 3) of all that occludes, object frame, as `cell.rays.occluders` gave them."""
    to_object = np.linalg.inv(T_base_object)
    found = []
    with understood(run.folder / "scene.resolved.json"):
        for fixture in resolved["fixtures"]:
            if not fixture["occludes"]:
                continue
            T = readonly("pose", fixture["pose"], (4, 4))
            size = np.array(fixture["size_mm"], dtype=np.float64) / 1000.0
            match fixture["shape"]:
                case "box":
                    vertices, faces = box(size / 2)
                case "cylinder":
                    vertices, faces = prism(float(size[0]) / 2, float(size[1]))
                case "plane":
                    vertices, faces = floor_square(float(T[2, 3]))
                    T = np.eye(4)
                case "mesh":
                    mesh = run_reader.mesh(run, fixture["file"])
                    vertices, faces = mesh.vertices, mesh.faces
                case shape:
                    raise ValueError(f"the fixture {fixture['name']} has the unknown shape {shape}")
            if fixture["attached_to"] == "base":
                T = to_object @ T
            found.append((vertices @ T[:3, :3].T + T[:3, 3], faces))
    return found


def _one_mesh(pieces: Sequence[tuple[Floats, NDArray[np.int32]]]) -> tuple[Floats, NDArray[np.int32]]:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [piece + start for (_, piece), start in zip(pieces, first[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces).astype(np.int32)
