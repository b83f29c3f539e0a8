"""A run folder read back into values, as `cell.plan.files` wrote it; docs/internals/run_folder.md is the contract.

Every reader takes one artefact of an opened run (`cell.run.record.open_run`) and raises FileError with one sentence
where it is missing, changed or damaged. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.run import ply
from cell.run.axes import joined
from cell.run.json_table import parsed
from cell.run.plan_json import PlanFile
from cell.run.record import RunRecord, arrays, artefact, understood
from cell.run.report_json import Report
from cell.run.scene_json import ResolvedScene
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.ports import JointLimits
from planner.timing.motion import Motion
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    import mujoco


def plan(run: RunRecord) -> PlanFile:
    """The views of the plan, and what is known about them."""
    return parsed(PlanFile, artefact(run, "plan.json"), run.folder / "plan.json")


def report(run: RunRecord) -> Report:
    """What the plan's page and `cell plan --json` say."""
    return parsed(Report, artefact(run, "report.json"), run.folder / "report.json")


def scene(run: RunRecord) -> ResolvedScene:
    """All that the plan used, and all that stood in the cell."""
    return parsed(ResolvedScene, artefact(run, "scene.resolved.json"), run.folder / "scene.resolved.json")


def motion(run: RunRecord) -> Motion:
    """The timed motion of the plan."""
    return motion_of(arrays(run, "motion.npz"), run.folder / "motion.npz")


def nearest(run: RunRecord) -> tuple[float, str]:
    """Smallest clearance that was measured along the motion [m], and between what; (NaN, "") where none was."""
    stored = arrays(run, "motion.npz")
    with understood(run.folder / "motion.npz"):
        clearance = np.asarray(stored["minimum_clearance"], dtype=np.float64)
        if not np.isfinite(clearance).any():
            return float("nan"), ""
        leg = int(np.nanargmin(clearance))
        return float(clearance[leg]), str(stored["between"][leg])


def motion_of(stored: Mapping[str, NDArray[Any]], path: Path) -> Motion:
    """A motion from the arrays of a motion.npz.

    Args:
        stored: the arrays.
        path: for the sentences.

    Raises:
        FileError: if an array is missing or has the wrong shape.
    """
    with understood(path):
        names = ("lower", "upper", "velocity", "acceleration")
        # Motions of earlier versions were timed without a limit of jerk.
        jerk = stored.get("limit_jerk", np.full_like(stored["limit_lower"], np.inf))
        limits = JointLimits(**{name: stored[f"limit_{name}"] for name in names}, jerk=jerk)
        stored = {**stored, **{name: joined(stored, name) for name in ("via_q", "q", "qd", "qdd")}}
        fields = ["via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample"]
        fields += [name for name in ("pose", "line") if name in stored]  # motions of earlier versions do not sweep
        return Motion(**{name: stored[name] for name in fields}, duration=float(stored["via_t"][-1]), limits=limits)


def candidates(run: RunRecord) -> Viewpoints:
    """The candidate viewpoints."""
    stored = arrays(run, "viewpoints.npz")
    with understood(run.folder / "viewpoints.npz"):
        return Viewpoints(*(stored[name] for name in ("T_object_scanner", "face", "standoff", "roll")))


def reached(run: RunRecord) -> Reach:
    """Verdicts and joint solutions of the candidates."""
    stored = arrays(run, "reach.npz")
    with understood(run.folder / "reach.npz"):
        return Reach(stored["verdict"], joined(stored, "q"), stored["offsets"], tuple(stored["blocker"].tolist()))


def measurability(run: RunRecord) -> Measurability:
    """The measurability matrix with occluders applied, and its features."""
    stored = arrays(run, "measurability.npz")
    with understood(run.folder / "measurability.npz"):
        named: tuple[str, ...] = ("points", "normals", "areas", "face", "planning_face")
        features = SurfaceSamples(
            *(stored[name] for name in named), *([stored["region"]] if "region" in stored else [])
        )
        return Measurability(
            stored["indptr"], stored["indices"], features, int(stored["shape"][1]), stored.get("sigma")
        )


def cell_spec(run: RunRecord) -> mujoco.MjSpec:
    """`cell.xml`, the model that was checked, to be changed before it is compiled."""
    import mujoco

    text = artefact(run, "cell.xml").decode("utf-8", errors="replace")
    with compiles(run):
        return mujoco.MjSpec.from_string(text)


def cell_model(run: RunRecord) -> mujoco.MjModel:
    """`cell.xml` compiled."""
    with compiles(run):
        return cell_spec(run).compile()


@contextmanager
def compiles(run: RunRecord) -> Iterator[None]:
    """Turn what MuJoCo says of a model inside the block into the sentence about `cell.xml`.

    Raises:
        FileError: if it says anything.
    """
    try:
        yield
    except ValueError as error:
        raise FileError(f"{run.folder / 'cell.xml'} is damaged: it is no model of a cell; plan again") from error


def mesh(run: RunRecord, name: str) -> TriangleMesh:
    """`reference.ply` or `planning.ply`, object frame [m].

    Read without any merging: vertices and faces have the numbers that they had in the plan. The file holds
    millimetres, so a coordinate may differ from the one used by the last bit of a double.
    """
    with understood(run.folder / name):
        return ply.mesh(artefact(run, name))
