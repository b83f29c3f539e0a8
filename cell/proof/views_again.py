"""plan.json against motion.npz: the same views in the same order, at poses that follow from the motion's angles."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.proof.artefacts import refuse
from cell.proof.compare import difference
from cell.run.plan_facts import degrees, sweep_of, turned_at
from cell.runs.run import Run
from cell.runs.schema import Clearance, PlanFile, PlanView
from cell.world.model import World
from planner.kinematics.setpoints import to_steps
from planner.path.sweep_line import DEFAULT_SPEED
from planner.path.sweeps import SweepPath, find_sweeps
from planner.ports import ARM_AXES, CollisionChecker, JointLimits, Kinematics
from planner.timing.motion import Motion
from planner.values import Floats, Ints
from planner.viewpoints.viewpoints import Viewpoints

_OFF = 5e-5  # of a candidate from the pose of its rounded set-points: m, and entries of the rotation


def require_same_views(
    run: Run, plan: PlanFile, motion: Motion, candidates: Viewpoints, world: World, kinematics: Kinematics
) -> None:
    """The motion visits the views of plan.json, one after the other, at the set-points and poses that stand there.

    Raises:
        FileError: naming the first difference.
    """
    path = run.folder / "motion.npz"
    rows = np.flatnonzero(motion.view >= 0)
    number = np.cumsum(np.diff(motion.view[rows], prepend=-1) != 0) - 1
    order = motion.view[rows[np.flatnonzero(np.diff(number, prepend=-1))]].tolist()
    if order != [view.id for view in plan.views]:
        refuse(path, "visits other views than plan.json has, or in another order")
    if not len(rows) or (motion.pose[motion.view < 0] != -1).any() or (motion.view < -1).any():
        refuse(path, "has poses where it takes no view")
    ends = []
    for k, view in enumerate(plan.views):
        own = rows[number == k]
        poses = 1 if view.sweep is None else len(view.sweep.q_deg)
        backwards = view.sweep is not None and view.sweep.backwards
        if motion.pose[own].tolist() != list(range(poses))[:: -1 if backwards else 1]:
            refuse(path, f"does not pass the poses of view {k + 1} one after the other")
        due = _view(view, motion.via_q[own][:: -1 if backwards else 1], candidates, world, kinematics)
        if key := difference(view, due):
            refuse(
                run.folder / "plan.json", f"differs from motion.npz, the mount or the candidates at views[{k}].{key}"
            )
        ends.append(int(own[-1]) if view.sweep is None else _line_end(motion, int(own[-1])))
    segment = np.searchsorted(ends, np.arange(len(motion.via_q)), side="left")
    if not np.array_equal(motion.segment, segment):
        refuse(path, "has segments that do not end where its views do")


def _view(view: PlanView, q: Floats, candidates: Viewpoints, world: World, kinematics: Kinematics) -> PlanView:
    """What plan.json must say of a view that is taken at set-points (K, axes) in the order of its column [rad].

    A candidate that is not there, or stands elsewhere, leaves NaN, which is like no number of a file.
    """
    T_part_flange = kinematics.forward(q)  # with a table turned back
    T_base_flange = world.in_base(q, T_part_flange)
    T_base_scanner = T_base_flange @ world.T_flange_scanner
    T_object_scanner = np.linalg.inv(world.T_base_object) @ T_part_flange @ world.T_flange_scanner
    middle = len(q) // 2
    there = 0 <= view.id < len(candidates.roll)
    here = there and np.allclose(candidates.T_object_scanner[view.id], T_object_scanner, rtol=0.0, atol=_OFF)
    sweep = view.sweep and view.sweep.model_copy(
        update={"T_object_scanner": tuple(T_object_scanner), "q_deg": tuple(tuple(degrees(each)) for each in q)}
    )
    return view.model_copy(
        update={
            "roll_deg": float(np.degrees(candidates.roll[view.id]).round(9)) if here else float("nan"),
            "T_object_scanner": T_object_scanner[middle],
            "T_base_scanner": T_base_scanner[middle],
            "T_base_flange": T_base_flange[middle],
            "q_deg": tuple(degrees(q[middle][:ARM_AXES])),
            **turned_at(world, q[middle]),
            "sweep": sweep,
        }
    )


def _line_end(motion: Motion, row: int) -> int:
    """The last via point of the line on which a via point lies."""
    return int(np.flatnonzero(motion.line == motion.line[row])[-1])


def sweeps_again(
    run: Run,
    plan: PlanFile,
    motion: Motion,
    candidates: Viewpoints,
    world: World,
    kinematics: Kinematics,
    checker: CollisionChecker,
    limits: JointLimits,
    full: JointLimits,
) -> list[tuple[int, SweepPath]]:
    """The sweeps of the motion, proven again from the candidates; none of a plan whose views are at rest.

    Args:
        run: for the sentences.
        plan: its views are those of the motion (`require_same_views`).
        motion: of the plan.
        candidates: the columns of poses.
        world: the cell.
        kinematics: of the arm.
        checker: of the cell.
        limits: under which the motion is timed.
        full: the same at full speed.

    Returns:
        The via point at which each begins, and the sweep.

    Raises:
        FileError: if a sweep of the motion is none of those that can be driven of its view, or plan.json says another.
    """
    path, speed = run.folder / "motion.npz", DEFAULT_SPEED.slowed(limits, full)
    found: list[tuple[int, SweepPath]] = []
    on_line = np.full(len(motion.line), -1)
    for k, view in enumerate(plan.views):
        if view.sweep is None:
            continue
        row = int(np.flatnonzero(motion.view == view.id)[0])
        own = np.flatnonzero(motion.line == motion.line[row])
        driven: Ints = to_steps(motion.via_q[max(0, int(own[0]) - 1) : int(own[-1]) + 1])
        column = world.T_base_object @ candidates.T_object_scanner[view.id]
        ways = find_sweeps(column, world.T_flange_scanner, kinematics, limits, speed, checker).paths
        match = next((way for way in ways if np.array_equal(to_steps(way.q), driven)), None)
        if match is None:
            refuse(path, f"drives no line for the sweep of view {k + 1} that can be proven")
        if key := difference(view.sweep, sweep_of(view.T_object_poses, match)):
            refuse(run.folder / "plan.json", f"says another sweep than motion.npz drives at views[{k}].sweep.{key}")
        on_line[own] = len(found)
        found.append((int(own[0]) - 1, match))
    if not np.array_equal(on_line, motion.line):
        refuse(path, "has lines that are not those of its sweeps")
    return found


def require_same_clearance(
    run: Run, plan: PlanFile, motion: Motion, stored: Mapping[str, NDArray[Any]], collision: str
) -> None:
    """plan.json and motion.npz say the same of the clearance.

    Args:
        run: for the sentences.
        plan: plan.json.
        motion: of the plan.
        stored: the arrays of motion.npz.
        collision: what stands for the part: hull or exact.

    Raises:
        FileError: if they do not.
    """
    said = plan.clearance
    if said is None:
        refuse(run.folder / "plan.json", "does not say the motion's clearance")
    nearest, proven, between = (stored[name] for name in ("minimum_clearance", "clearance_at_least", "between"))
    due = Clearance(
        collision=collision,
        segments=[
            {
                "minimum_mm": round(1000 * float(low), 4),
                "at_least_mm": round(1000 * float(least), 4),
                "between": str(what),
            }
            for low, least, what in zip(nearest, proven, between, strict=True)
        ],
        tightest=said.tightest,
    )
    if len(due.segments) != int(motion.segment[-1]) + 1:
        refuse(run.folder / "motion.npz", "has another number of segments than clearances")
    key = difference(said, due)
    if not key and said.tightest is not None:
        row = int(np.argmin(nearest))
        again = said.tightest.model_copy(
            update={
                "segment": row,
                "distance_mm": due.segments[row].minimum_mm,
                "between": due.segments[row].between,
            }
        )
        key = difference(said.tightest, again)
    if key:
        refuse(run.folder / "plan.json", f"says another clearance than motion.npz at {key}")
