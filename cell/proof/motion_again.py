"""The motion of a plan timed again within the limits of the robot model, and its certificate of freedom made again."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cell.proof.artefacts import refuse
from cell.runs.run import Run
from cell.runs.schema import ResolvedScene
from cell.world.model import World
from planner.kinematics.setpoints import from_steps, to_steps
from planner.path import indexed
from planner.path.certified_edge import certify_many
from planner.path.sweeps import SweepPath, TimedSweep
from planner.ports import ARM_AXES, CollisionChecker, JointLimits, Kinematics
from planner.timing.limits import require_inside
from planner.timing.motion import Motion, retime
from planner.values import Floats

_NEAR = 1e-7  # s, rad, rad/s, rad/s^2
_TIMED = ("via_t", "t", "q", "qd", "qdd", "segment_of_sample")
_LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def limits_of(resolved: ResolvedScene, world: World) -> JointLimits:
    """The limits at full speed: the model's ranges, and what the scene says of speeds, accelerations and jerks [rad].

    Args:
        resolved: of the plan; its speeds are known to be none above the model's.
        world: the cell, compiled again; a rotary table's limits are those of the scene.
    """
    jerks = resolved.joint_jerk_limits_deg_s3 or (None,) * ARM_AXES
    arm = JointLimits(
        world.limits.lower[:ARM_AXES],
        world.limits.upper[:ARM_AXES],
        np.radians(resolved.joint_velocity_limits_deg_s),
        np.radians(resolved.joint_acceleration_limits_deg_s2),
        np.radians([np.inf if jerk is None else jerk for jerk in jerks]),
    )
    return arm if world.table is None else replace(world.table.limits(arm), table_turn_q=world.limits.table_turn_q)


def require_timed(
    run: Run,
    motion: Motion,
    limits: JointLimits,
    sweeps: Sequence[tuple[int, SweepPath]],
    T_flange_scanner: Floats,
    kinematics: Kinematics,
) -> None:
    """The motion's limits are those of the model, and its times and samples those that follow from its via points.

    Args:
        run: for the sentences.
        motion: of the plan.
        limits: of the model (`limits_of`).
        sweeps: via point at which each begins, and the sweep proven again.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of the arm.

    Raises:
        FileError: if one of them is not.
        PlannerError: if a via point lies outside the joint range, or the motion cannot be timed.
    """
    path = run.folder / "motion.npz"
    for name in _LIMITS:
        if not np.allclose(getattr(motion.limits, name), getattr(limits, name), rtol=_NEAR, atol=_NEAR):
            refuse(path, f"has limit_{name} that are not those of the robot model and the scene")
    require_inside("via point", motion.via_q, limits)
    if np.abs(from_steps(to_steps(motion.via_q)) - motion.via_q).max(initial=0.0) > 1e-12:
        refuse(path, "has via points that are no multiples of 1e-4 deg, which no controller can be sent")
    lines: Mapping[int, TimedSweep] = {
        begin: TimedSweep(sweep, T_flange_scanner, kinematics) for begin, sweep in sweeps
    }
    again = retime(motion.via_q, motion.segment, motion.view, motion.limits, pose=motion.pose, lines=lines)
    for name in _TIMED:
        found, due = getattr(motion, name), getattr(again, name)
        if found.shape != due.shape or not np.allclose(found, due, rtol=_NEAR, atol=_NEAR):
            refuse(path, f"has {name} that do not follow from its via points and limits")


def require_free(via: Floats, checker: CollisionChecker, limits: JointLimits) -> str:
    """Whether a way keeps inside the joint range and is certified free, and turns an indexed table as it may be.

    Args:
        via: (N, axes) via points [rad], joined by straight joint moves.
        checker: of the cell.
        limits: of the model.

    Returns:
        "" where it is, else what is wrong with it.

    Raises:
        PlannerError: if a via point lies outside the joint range.
    """
    require_inside("via point", via, limits)
    free = checker.free(via)
    if not free.all():
        row = int(np.argmin(free))
        near = next(iter(checker.contacts(via[row])), "")
        return f"comes nearer than the clearance at via point {row} ({near})"
    certified, _ = certify_many(via[:-1], via[1:], checker)
    if not certified.all():
        return f"is not free of collision on the way to via point {int(np.argmin(certified)) + 1}"
    return indexed.find_violation(via, checker, limits)
