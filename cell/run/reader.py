"""A run folder read back into values: the counterpart of `cell.plan.files`. docs/run_folder.md is the contract of both.

Every reader takes one artefact of an opened run (`cell.run.record.open_run`) and raises FileError with one sentence
where it is missing, changed or damaged. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.run.plan_json import PlanFile
from cell.run.record import RunRecord, arrays, artefact, artefact_value, understood
from cell.run.report_json import Report
from cell.run.scene_json import ResolvedScene
from planner.ports import JointLimits
from planner.reach.reach import Reach
from planner.surface.mesh import TriangleMesh
from planner.timing.motion import Motion
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    import mujoco


def plan_file(run: RunRecord) -> PlanFile:
    """plan.json: the views in visiting order, and what is known of their selection.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return artefact_value(run, "plan.json", PlanFile)


def report(run: RunRecord) -> Report:
    """report.json: what the page, the table and `cell plan --json` say.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return artefact_value(run, "report.json", Report)


def resolved_scene(run: RunRecord) -> ResolvedScene:
    """scene.resolved.json: all that was used.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return artefact_value(run, "scene.resolved.json", ResolvedScene)


def motion(run: RunRecord) -> Motion:
    """The timed motion of the plan.

    Raises:
        FileError: if motion.npz is missing, changed or damaged.
    """
    return motion_of(arrays(run, "motion.npz"), run.folder / "motion.npz")


def driven_motion(run: RunRecord) -> Motion:
    """The same, if it passes every pose of the plan's views: what can be executed.

    Raises:
        FileError: if motion.npz or plan.json is missing, changed or damaged, or the motion leaves out poses of sweeps.
    """
    found = motion(run)
    if any(view.sweep for view in plan_file(run).views) and not (found.pose > 0).any():
        raise FileError(
            f"the views of {run.folder} are sweeps, and its motion holds only their first poses, as earlier versions "
            "planned them; plan again"
        )
    return found


def nearest(run: RunRecord) -> tuple[float, str]:
    """Smallest clearance that was measured along the motion [m], and between what; (NaN, "") where none was.

    Raises:
        FileError: if motion.npz is missing, changed or damaged.
    """
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
        limits = JointLimits(*(stored[f"limit_{name}"] for name in ("lower", "upper", "velocity", "acceleration")))
        if "limit_jerk" in stored:  # motions of earlier versions were timed without a limit of jerk
            limits = replace(limits, jerk=stored["limit_jerk"])
        fields = ["via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample"]
        fields += [name for name in ("pose", "line") if name in stored]  # motions of earlier versions do not sweep
        return Motion(**{name: stored[name] for name in fields}, duration=float(stored["via_t"][-1]), limits=limits)


def candidates(run: RunRecord) -> Viewpoints:
    """The candidate viewpoints.

    Raises:
        FileError: if viewpoints.npz is missing, changed or damaged.
    """
    stored = arrays(run, "viewpoints.npz")
    with understood(run.folder / "viewpoints.npz"):
        return Viewpoints(*(stored[name] for name in ("T_object_scanner", "face", "standoff", "roll")))


def reached(run: RunRecord) -> Reach:
    """Verdicts and joint solutions of the candidates.

    Raises:
        FileError: if reach.npz is missing, changed or damaged.
    """
    stored = arrays(run, "reach.npz")
    with understood(run.folder / "reach.npz"):
        return Reach(stored["verdict"], stored["q"], stored["offsets"], tuple(stored["blocker"].tolist()))


def cell_spec(run: RunRecord) -> mujoco.MjSpec:
    """`cell.xml`, the model that was checked, to be changed before it is compiled.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    import mujoco

    text = artefact(run, "cell.xml").decode("utf-8", errors="replace")
    with compiles(run):
        return mujoco.MjSpec.from_string(text)


def cell_model(run: RunRecord) -> mujoco.MjModel:
    """`cell.xml` compiled.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
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
        reason = " ".join(str(error).split())[:160]
        raise FileError(f"{run.folder / 'cell.xml'} is damaged: {reason}; plan again") from error


def mesh(run: RunRecord, name: str) -> TriangleMesh:
    """`reference.ply` or `planning.ply`, object frame [m].

    Read without any merging: vertices and faces have the numbers that they had in the plan. The file holds
    millimetres, so a coordinate may differ from the one used by the last bit of a double.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    content = artefact(run, name)
    header, separator, body = content.partition(b"end_header\n")
    with understood(run.folder / name):
        counts = {
            words[1]: int(words[2])
            for words in (line.split() for line in header.decode("ascii").splitlines())
            if words[:1] == ["element"]
        }
        split = 24 * counts["vertex"]
        faces = np.frombuffer(body[split:], dtype=[("n", "u1"), ("v", "<i4", 3)])
        if not separator or len(faces) != counts["face"]:
            raise ValueError("its header and its length differ")
        return TriangleMesh(np.frombuffer(body[:split], "<f8").reshape(-1, 3) / 1000.0, faces["v"])
