"""A run folder read back into values: the counterpart of `cell.plan.files`. docs/run_folder.md is the contract of both.

Every reader takes one artefact of an opened run (`cell.run.record.open_run`) and raises FileError with one sentence
where it is missing, changed or damaged. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.run import ply
from cell.run.record import RunRecord, arrays, artefact, artefact_json, understood
from planner.ports import Floats, JointLimits
from planner.reach.reach import Reach
from planner.surface.mesh import TriangleMesh
from planner.timing.motion import Motion
from planner.values import readonly
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    import mujoco


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
        sweeps: whether it is a sweep.
    """

    id: int
    roll: float
    q: Floats
    T_object_scanner: Floats
    T_base_scanner: Floats
    T_base_flange: Floats
    T_object_poses: Floats
    sweeps: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", readonly("q_deg", self.q, (6,)))
        poses = readonly("sweep.T_object_scanner", self.T_object_poses, (None, 4, 4))
        object.__setattr__(self, "T_object_poses", poses)
        for name in ("T_object_scanner", "T_base_scanner", "T_base_flange"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (4, 4)))


@dataclass(frozen=True, slots=True, eq=False)
class Tightest:
    """The tightest moment of the motion.

    Attributes:
        points: (2, 3) nearest points of the first and of the second [m], base frame.
        distance: between them [m].
        between: what they are on, "housing with part".
        time: of the motion [s].
    """

    points: Floats
    distance: float
    between: str
    time: float

    @property
    def sentence(self) -> str:
        """For captions and labels."""
        return f"{1000 * self.distance:.1f} mm {self.between}"


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPlan:
    """What commands ask for of `plan.json`; coverages are fractions of the surface.

    Attributes:
        views: in visiting order.
        visible: predicted visible coverage.
        coverable: what at least one reachable candidate measures.
        lower_bound: on the number of views.
        dropped: why, by candidate, views were given up that no path leads to.
        tightest: None where nothing comes near, or a version did not say it.
    """

    views: tuple[RecordedView, ...]
    visible: float
    coverable: float
    lower_bound: int
    dropped: Mapping[int, str]
    tightest: Tightest | None


def plan(run: RunRecord) -> RecordedPlan:
    """What the plan came to.

    Raises:
        FileError: if plan.json is missing, changed or damaged.
    """
    content = artefact_json(run, "plan.json")
    with understood(run.folder / "plan.json"):
        tightest = content.get("clearance", {}).get("tightest")
        return RecordedPlan(
            views=tuple(
                RecordedView(
                    int(view["id"]), float(np.radians(view["roll_deg"])), np.radians(view["q_deg"]),
                    view["T_object_scanner"], view["T_base_scanner"], view["T_base_flange"],
                    view.get("sweep", {}).get("T_object_scanner", [view["T_object_scanner"]]), "sweep" in view,
                )
                for view in content["views"]
            ),
            visible=float(content["coverage"]["visible"]),
            coverable=float(content["coverage"]["coverable"]),
            lower_bound=int(content["lower_bound"]),
            dropped={int(view["id"]): str(view["reason"]) for view in content["dropped"]},
            tightest=None if tightest is None else Tightest(
                readonly("points_in_base_mm", tightest["points_in_base_mm"], (2, 3)) / 1000.0,
                float(tightest["distance_mm"]) / 1000.0, str(tightest["between"]), float(tightest["time_s"]),
            ),
        )  # fmt: skip


def views(run: RunRecord) -> tuple[RecordedView, ...]:
    """The views of the plan in visiting order.

    Raises:
        FileError: if plan.json is missing, changed or damaged.
    """
    return plan(run).views


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
    if any(view.sweeps for view in views(run)) and not (found.pose > 0).any():
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
    with understood(run.folder / name):
        return ply.mesh(artefact(run, name))
