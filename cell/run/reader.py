"""A run folder read back into values: the counterpart of `cell.plan.files`. docs/run_folder.md is the contract of both.

Every reader takes one artefact of an opened run (`cell.run.record.open_run`) and raises FileError with one sentence
where it is missing, changed or damaged. Lengths in metres, angles in radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.run.record import RunRecord, arrays, artefact, artefact_json, understood
from planner.ports import Floats, JointLimits
from planner.reach.reach import Reach
from planner.surface.mesh import TriangleMesh
from planner.timing.motion import Motion
from planner.values import readonly
from planner.viewpoints.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class RecordedView:
    """One view of `plan.json`.

    Attributes:
        id: candidate, row of viewpoints.npz.
        roll: about the viewing axis [rad].
        q: (6,) set-points [rad], KUKA signs.
        T_object_scanner: (4, 4) [m]; of a sweep its middle pose, as the next two.
        T_base_scanner: (4, 4) [m].
        T_base_flange: (4, 4) [m].
        T_object_poses: (K, 4, 4) all poses of a sweep [m]; of a view at rest `T_object_scanner` alone.
    """

    id: int
    roll: float
    q: Floats
    T_object_scanner: Floats
    T_base_scanner: Floats
    T_base_flange: Floats
    T_object_poses: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", readonly("q_deg", self.q, (6,)))
        poses = readonly("sweep.T_object_scanner", self.T_object_poses, (None, 4, 4))
        object.__setattr__(self, "T_object_poses", poses)
        for name in ("T_object_scanner", "T_base_scanner", "T_base_flange"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (4, 4)))


def plan_json(run: RunRecord) -> dict[str, Any]:
    """`plan.json` as it stands: coverage, solver, status, bound, views.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return artefact_json(run, "plan.json")


def resolved_scene(run: RunRecord) -> dict[str, Any]:
    """`scene.resolved.json` as it stands: all that was used.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return artefact_json(run, "scene.resolved.json")


def transform(run: RunRecord, scene: Mapping[str, Any], name: str) -> Floats:
    """(4, 4) one of the transforms of `scene.resolved.json` [m]: T_base_object, T_object_centre, T_flange_scanner.

    Raises:
        FileError: if it is not there or not 4 x 4.
    """
    with understood(run.folder / "scene.resolved.json"):
        return readonly(name, scene[name], (4, 4))


def views(run: RunRecord) -> tuple[RecordedView, ...]:
    """The views of the plan in visiting order.

    Raises:
        FileError: if plan.json is missing, changed or damaged.
    """
    listed = plan_json(run)
    with understood(run.folder / "plan.json"):
        return tuple(
            RecordedView(
                int(view["id"]), float(np.radians(view["roll_deg"])), np.radians(view["q_deg"]),
                view["T_object_scanner"], view["T_base_scanner"], view["T_base_flange"],
                view.get("sweep", {}).get("T_object_scanner", [view["T_object_scanner"]]),
            )
            for view in listed["views"]
        )  # fmt: skip


def motion(run: RunRecord) -> Motion:
    """The timed motion of the plan.

    Raises:
        FileError: if motion.npz is missing, changed or damaged.
    """
    return motion_of(arrays(run, "motion.npz"), run.folder / "motion.npz")


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
