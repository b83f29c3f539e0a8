"""Verify from the run folder alone that a plan may be driven or exported.

A person who confirms a digest confirms *which* motion is driven; verification decides whether it may be driven. It
checks in this order and reports the first violation in one sentence:

1. every driving artefact exists, has the sha256 in the manifest, and is covered by the plan's digest;
2. the cell of scene.resolved.json, compiled again with this version's robot model, equals `cell.xml`. Both state
   transforms, sizes and limits, so neither file can be changed alone, and a plan of another robot model is detected;
3. plan.json and motion.npz have the same views in the same order, at poses that follow from the joint angles;
4. the sweeps of a line sensor are proven again; speeds, times and samples follow from the via points and the limits,
   which equal those of the model;
5. every segment is certified collision-free again in that cell (`planner.path.certified_edge`).

A path that is planned at execution time passes the limits and step 5 before its first move:
`VerifiedPlan.require_path_free`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue
from scipy.spatial import ConvexHull, cKDTree

from cell.errors import FileError
from cell.robot import model as robot
from cell.runs import digest
from cell.runs.cell import scene_of_run, world_of
from cell.runs.facts import degrees, limits_deg, resolved_fixtures, resolved_table, sweep_values, table_values
from cell.runs.run import Run, open_finished, reading
from cell.runs.schema import Clearance, JsonTable, PlanFile, PlanView, ResolvedScene
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from cell.world.shapes import quaternion
from planner.errors import PlannerError
from planner.kinematics.setpoints import from_steps, to_steps
from planner.path import indexed
from planner.path.certified_edge import certify_many
from planner.path.sweep_line import DEFAULT_SPEED
from planner.path.sweeps import SweepPath, TimedSweep, find_sweeps
from planner.ports import ARM_AXES, CollisionChecker, JointLimits, Kinematics
from planner.timing.limits import require_inside, scale_limits
from planner.timing.motion import Motion, retime
from planner.values import Floats, Ints
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedPlan:
    """A plan that may be driven.

    Attributes:
        run: its run folder.
        digest: digest of the driving artefacts.
        scene: scene.resolved.json.
        plan: plan.json.
        motion: motion.npz.
        world: the cell, compiled again.
        checker: collision checker of the cell.
    """

    run: Run
    digest: str
    scene: ResolvedScene
    plan: PlanFile
    motion: Motion
    world: World
    checker: MujocoCollisionChecker

    def require_path_free(self, via: Floats) -> None:
        """Raise FileError unless a path of (N, axes) via points [rad] keeps limits and clearance."""
        try:
            problem = find_collision(via, self.checker, self.motion.limits)
        except PlannerError as error:
            problem = f"leaves the joint range: {error}"
        if problem:
            raise FileError(f"the path {problem}; nothing was moved")


def verify_plan(folder: Path) -> VerifiedPlan:
    """Verify the plan of a run folder; raise FileError with the first violation."""
    run = open_finished(folder)
    digest = require_intact(run)
    resolved, plan, motion, stored = run.scene, run.plan, run.motion, run.arrays("motion.npz")
    _require_manifest(run)
    if not len(plan.views) or len(motion.via_q) < 2:
        refuse(run.folder / "motion.npz", "has no motion: it visits no view")
    for name in ("pose", "line", "limit_jerk"):  # readers add them to runs of earlier versions
        if name not in stored:
            refuse(run.folder / "motion.npz", f"has no {name}")
    world = verify_cell(run)
    if resolved.plan.collision != world.collision:
        refuse(run.folder / "scene.resolved.json", "contradicts itself at plan.collision")
    kinematics, checker = world.kinematics, MujocoCollisionChecker(world)
    with reading(run.folder / "motion.npz"):
        verify_views(run, world, kinematics)
        verify_clearance(run, stored, world.collision)
        full = model_limits(resolved, world)
        limits = scale_limits(full, resolved.speed_scaling, resolved.acceleration_scaling)
        sweeps = verify_sweeps(run, world, kinematics, checker, limits, full)
        verify_timing(run, limits, sweeps, world.T_flange_scanner, kinematics)
        if (to_steps(motion.via_q[[0, -1]]) != to_steps(world.home)).any():
            refuse(run.folder / "motion.npz", "does not begin and end at home_deg of scene.resolved.json")
        if problem := find_collision(motion.via_q, checker, limits):
            refuse(run.folder / "motion.npz", problem)
    motion = replace(motion, limits=replace(motion.limits, table_turn_q=limits.table_turn_q))  # not stored in the file
    return VerifiedPlan(run, digest, resolved, plan, motion, world, checker)


def _require_manifest(run: Run) -> None:
    """Compare the values that manifest and scene.resolved.json share."""
    stated = run.manifest.inputs.get("part"), run.manifest.seed
    if stated != (run.scene.part.sha256, run.scene.plan.seed):
        refuse(run.folder / "manifest.json", "has another part or seed than scene.resolved.json")


def refuse(path: Path, problem: str) -> NoReturn:
    """Raise FileError about an artefact that contradicts the others."""
    raise FileError(
        f"{path} {problem}; the plan is neither driven nor exported; a run folder is never edited, plan again"
    )


def require_intact(run: Run) -> str:
    """Return the digest of a plan after checking every driving artefact.

    Raises FileError if the manifest has no digest, as in runs of earlier versions, or if a file is missing or changed.
    """
    manifest = run.folder / "manifest.json"
    if not run.digest:
        raise FileError(
            f"{manifest} has no digest: the plan was made by an earlier version, or the manifest was changed; "
            "it can be read and replayed, but not driven: plan again"
        )
    for name in digest.driving_artefacts(run.manifest.artefacts):
        if name not in run.manifest.artefacts:
            refuse(manifest, f"has no sha256 of {name}")
        run.artefact(name)
    if digest.plan_digest(run.manifest.artefacts) != run.digest:
        refuse(manifest, f"has the digest {run.digest[: digest.SHORT_DIGEST]}, and its files have another one")
    return run.digest


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file; "" if it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


_MODEL_TOLERANCE = 1e-8  # m, and of a quaternion's entries
_MESH_TOLERANCE = 1e-6  # m, of the vertices of hulls


def verify_cell(run: Run) -> World:
    """Compile the cell of a run again and return it; raise FileError unless it equals the checked cell."""
    path, resolved = run.folder / "scene.resolved.json", run.scene
    with reading(path):
        scene = scene_of_run(run)
        world = world_of(run, run.mesh("reference.ply"))
        occluding = {fixture.name: fixture.occludes for fixture in resolved.fixtures}
        standing = [
            each.model_copy(update={"occludes": occluding.get(each.name, True)})
            for each in resolved_fixtures(scene, world)
        ]
        expected = resolved.model_copy(
            update={
                "T_base_object": world.T_base_object,
                "T_object_centre": world.T_object_centre,
                "T_flange_scanner": world.T_flange_scanner,
                "housing": resolved.housing.model_copy(update={"T_flange_housing": world.T_flange_housing}),
                "fixtures": tuple(standing),
                "table": resolved_table(scene, world),
                "joint_limits_deg": tuple((low, high) for low, high in limits_deg(world.limits)["joint_limits_deg"]),
            }
        )
        if key := first_difference(resolved, expected):
            refuse(path, f"contradicts itself, or the part, at {key}")
        fastest = np.asarray(limits_deg(robot.limits(world.model))["joint_velocity_limits_deg_s"])
        if (np.asarray(resolved.joint_velocity_limits_deg_s) > fastest + 1e-6).any():
            refuse(path, "has joint_velocity_limits_deg_s above those of the robot model")
    if what := _other_shape(run.cell_model(), world):
        refuse(
            run.folder / "cell.xml", f"is not the cell of scene.resolved.json with this version's robot model: {what}"
        )
    return world


def _other_shape(checked: mujoco.MjModel, world: World) -> str:
    """Return the first difference between the checked model and the one compiled again; "" if there is none."""
    recompiled = world.model
    placed = {"object": world.T_base_object, "post": world.T_base_post(world.T_base_object)}
    counts = [(each.nbody, each.ngeom, each.njnt, each.nsite) for each in (checked, recompiled)]
    if counts[0] != counts[1]:
        return "it has other bodies, shapes, axes or frames"
    if not np.array_equal(np.sort(checked.exclude_signature), np.sort(recompiled.exclude_signature)):
        return "it has other allowed collision pairs"
    for number in range(recompiled.nbody):
        one, two = checked.body(number), recompiled.body(number)
        pos, turned = two.pos, _at_reference(checked, recompiled, number)
        if (T := placed.get(two.name)) is not None:  # the file has mocap bodies at their placement
            pos, turned = T[:3, 3], quaternion(T[:3, :3])
        if (
            one.name != two.name
            or one.parentid != two.parentid
            or _differs(one.pos, pos)
            or _is_rotated(one.quat, turned)
        ):
            return f"the body '{two.name}' has another pose"
    for number in range(recompiled.njnt):
        one, two = checked.joint(number), recompiled.joint(number)
        values = (one.axis, two.axis), (one.pos, two.pos), (one.range, two.range)
        if one.name != two.name or one.bodyid != two.bodyid or any(_differs(*pair) for pair in values):
            return f"the axis '{two.name}' differs"
    for number in range(recompiled.ngeom):
        one, two = checked.geom(number), recompiled.geom(number)
        kinds = [(each.name, *each.type, *each.bodyid, *each.contype, *each.conaffinity) for each in (one, two)]
        if kinds[0] != kinds[1] or _differs(one.margin, two.margin):
            return f"the shape '{two.name}' differs"
        same = not (_differs(one.pos, two.pos) or _is_rotated(one.quat, two.quat) or _differs(one.size, two.size))
        if two.dataid[0] >= 0:
            a, b = (robot.mesh_of(model, number).vertices for model in (checked, recompiled))
            same = not (_exceeds(a, b) or _exceeds(b, a))
        if not same:
            return f"the shape '{two.name}' has another pose or size"
    for number in range(recompiled.nsite):
        one, two = checked.site(number), recompiled.site(number)
        same = (one.name, *one.bodyid) == (two.name, *two.bodyid)
        if not same or _differs(one.pos, two.pos) or _is_rotated(one.quat, two.quat):
            return f"the frame '{two.name}' differs"
    if _numerics(checked) != _numerics(recompiled):
        return "its custom numbers differ"
    home = world.mimic_joints.qpos(world.home[:ARM_AXES])
    keys = [checked.key(number) for number in range(checked.nkey)]
    if len(keys) != 1 or keys[0].name != "home" or _differs(keys[0].qpos, home):
        return "home is missing or has another pose"
    return ""


def _numerics(model: mujoco.MjModel) -> list[tuple[str, list[float]]]:
    """Return names and values of the custom numbers of a model: limits, sizes and clearances of the arm."""
    numbers = (model.numeric(index) for index in range(model.nnumeric))
    return sorted((each.name, np.round(each.data, 9).tolist()) for each in numbers)


def _differs(one: Floats, two: Floats) -> bool:
    return not bool((np.abs(np.asarray(one) - np.asarray(two)) <= _MODEL_TOLERANCE).all())  # NaN differs


def _is_rotated(one: Floats, two: Floats) -> bool:
    return not abs(abs(float(np.dot(one, two))) - 1.0) <= _MODEL_TOLERANCE  # NaN is rotated


def _at_reference(checked: mujoco.MjModel, recompiled: mujoco.MjModel, body: int) -> Floats:
    """Return the (4,) orientation of a body of `recompiled` at the reference angle of its joint in `checked` (home)."""
    import mujoco

    quat = np.array(recompiled.body_quat[body])
    if recompiled.body_jntnum[body]:
        joint = recompiled.body_jntadr[body]
        turn, turned = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(
            turn, recompiled.jnt_axis[joint], float(checked.qpos0[joint] - recompiled.qpos0[joint])
        )
        mujoco.mju_mulQuat(turned, quat, turn)
        quat = turned
    return quat


def _exceeds(points: Floats, hull: Floats) -> bool:
    """Return whether points lie outside the hull of others.

    Points on edges and faces of a hull may be among its corners or not, so only points without an equal one are tested.
    """
    points = points[cKDTree(hull).query(points)[0] > _MESH_TOLERANCE]
    if not len(points):
        return False
    planes = ConvexHull(hull).equations
    return bool((points @ planes[:, :3].T + planes[:, 3]).max() > _MESH_TOLERANCE)


_JSON_TOLERANCE = 1e-7
"""Tolerance of equal numbers, absolute and relative: 0.1 um, above the rounding of the files."""


def first_difference(stored: JsonTable, expected: JsonTable) -> str:
    """Return the key of the first difference between a stored and a recomputed table; "" if there is none."""
    ours, theirs = dict(_leaves(stored.as_json())), dict(_leaves(expected.as_json()))
    for key in {**theirs, **ours}:
        if key not in ours or key not in theirs or not _same(ours[key], theirs[key]):
            return key
    return ""


def _leaves(value: JsonValue, key: str = "") -> Iterator[tuple[str, JsonValue]]:
    """Yield every number, string and empty container with its key, such as "views[3].q_deg[0]"."""
    if isinstance(value, dict) and value:
        for name, each in value.items():
            yield from _leaves(each, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and value:
        for number, each in enumerate(value):
            yield from _leaves(each, f"{key}[{number}]")
    else:
        yield key, value


def _same(stored: JsonValue, expected: JsonValue) -> bool:
    numbers = isinstance(stored, int | float) and isinstance(expected, int | float)
    if numbers and not isinstance(stored, bool) and not isinstance(expected, bool):
        difference = abs(stored - expected)  # type: ignore[operator]  # both are numbers
        return bool(difference <= _JSON_TOLERANCE * max(1.0, abs(expected)))  # type: ignore[arg-type]  # likewise
    return bool(stored == expected)


_MOTION_TOLERANCE = 1e-7  # s, rad, rad/s, rad/s^2
_TIMED = ("via_t", "t", "q", "qd", "qdd", "segment_of_sample")
_LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def model_limits(resolved: ResolvedScene, world: World) -> JointLimits:
    """Return the limits at full speed: the model's joint ranges, and the scene's speeds, accelerations and jerks [rad].

    The speeds of the scene do not exceed those of the model. The limits of a rotary table are those of the scene.
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


def verify_timing(
    run: Run,
    limits: JointLimits,
    sweeps: Sequence[tuple[int, SweepPath]],
    T_flange_scanner: Floats,
    kinematics: Kinematics,
) -> None:
    """Check that the motion has the limits of the model, and times and samples that follow from its via points.

    Args:
        run: the run.
        limits: limits of the model (`model_limits`), scaled.
        sweeps: first via point of each sweep, and the sweep as proven again.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of the arm.
    """
    path, motion = run.folder / "motion.npz", run.motion
    for name in _LIMITS:
        if not np.allclose(
            getattr(motion.limits, name), getattr(limits, name), rtol=_MOTION_TOLERANCE, atol=_MOTION_TOLERANCE
        ):
            refuse(path, f"has limit_{name} other than those of the robot model and the scene")
    require_inside("via point", motion.via_q, limits)
    if np.abs(from_steps(to_steps(motion.via_q)) - motion.via_q).max(initial=0.0) > 1e-12:
        refuse(path, "has via points that are not multiples of 1e-4 deg and cannot be sent to a controller")
    lines: Mapping[int, TimedSweep] = {
        begin: TimedSweep(sweep, T_flange_scanner, kinematics) for begin, sweep in sweeps
    }
    again = retime(motion.via_q, motion.segment, motion.view, motion.limits, pose=motion.pose, lines=lines)
    for name in _TIMED:
        stored, expected = getattr(motion, name), getattr(again, name)
        if stored.shape != expected.shape or not np.allclose(
            stored, expected, rtol=_MOTION_TOLERANCE, atol=_MOTION_TOLERANCE
        ):
            refuse(path, f"has {name} that do not follow from its via points and limits")


def find_collision(via: Floats, checker: CollisionChecker, limits: JointLimits) -> str:
    """Return the first violation of clearance on a path, or "".

    Args:
        via: (N, axes) via points [rad], joined by straight joint moves.
        checker: collision checker of the cell.
        limits: limits of the model; a via point outside raises PlannerError.
    """
    require_inside("via point", via, limits)
    free = checker.free(via)
    if not free.all():
        row = int(np.argmin(free))
        near = next(iter(checker.contacts(via[row])), "")
        return f"violates the clearance at via point {row} ({near})"
    certified, _ = certify_many(via[:-1], via[1:], checker)
    if not certified.all():
        return f"is not certified collision-free on the segment to via point {int(np.argmin(certified)) + 1}"
    return indexed.find_violation(via, checker, limits)


_POSE_TOLERANCE = 5e-5  # of a candidate from the pose of its rounded set-points: m, and entries of the rotation


def verify_views(run: Run, world: World, kinematics: Kinematics) -> None:
    """Check that the motion visits the views of plan.json in order, at their set-points and poses."""
    path, plan, motion = run.folder / "motion.npz", run.plan, run.motion
    rows = np.flatnonzero(motion.view >= 0)
    number = np.cumsum(np.diff(motion.view[rows], prepend=-1) != 0) - 1
    order = motion.view[rows[np.flatnonzero(np.diff(number, prepend=-1))]].tolist()
    if order != [view.id for view in plan.views]:
        refuse(path, "visits other views than plan.json, or in another order")
    if not len(rows) or (motion.pose[motion.view < 0] != -1).any() or (motion.view < -1).any():
        refuse(path, "has poses at via points without a view")
    ends = []
    for k, view in enumerate(plan.views):
        view_rows = rows[number == k]
        poses = 1 if view.sweep is None else len(view.sweep.q_deg)
        backwards = view.sweep is not None and view.sweep.backwards
        if motion.pose[view_rows].tolist() != list(range(poses))[:: -1 if backwards else 1]:
            refuse(path, f"does not pass the poses of view {k + 1} in order")
        expected = _view(view, motion.via_q[view_rows][:: -1 if backwards else 1], run.candidates, world, kinematics)
        if key := first_difference(view, expected):
            refuse(
                run.folder / "plan.json", f"differs from motion.npz, the mount or the candidates at views[{k}].{key}"
            )
        last = int(view_rows[-1])
        ends.append(last if view.sweep is None else int(np.flatnonzero(motion.line == motion.line[last])[-1]))
    segment = np.searchsorted(ends, np.arange(len(motion.via_q)), side="left")
    if not np.array_equal(motion.segment, segment):
        refuse(path, "has segments that do not end at its views")


def _view(view: PlanView, q: Floats, candidates: Viewpoints, world: World, kinematics: Kinematics) -> PlanView:
    """Return the plan.json entry of a view at set-points (K, axes) [rad].

    A candidate that does not exist or has another pose gives NaN, which differs from any number in a file.
    """
    T_part_flange = kinematics.forward(q)  # with a table turned back
    T_base_flange = world.in_base(q, T_part_flange)
    T_base_scanner = T_base_flange @ world.T_flange_scanner
    T_object_scanner = np.linalg.inv(world.T_base_object) @ T_part_flange @ world.T_flange_scanner
    middle = len(q) // 2
    there = 0 <= view.id < len(candidates.roll)
    here = there and np.allclose(candidates.T_object_scanner[view.id], T_object_scanner, rtol=0.0, atol=_POSE_TOLERANCE)
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
            **table_values(world, q[middle]),
            "sweep": sweep,
        }
    )


def verify_sweeps(
    run: Run, world: World, kinematics: Kinematics, checker: CollisionChecker, limits: JointLimits, full: JointLimits
) -> list[tuple[int, SweepPath]]:
    """Prove the sweeps of the motion again; return the first via point and the path of each.

    Args:
        run: the run, its plan verified against its motion (`verify_views`).
        world: the cell.
        kinematics: of the arm.
        checker: collision checker of the cell.
        limits: limits used for timing.
        full: limits at full speed.
    """
    path, motion, speed = run.folder / "motion.npz", run.motion, DEFAULT_SPEED.slowed(limits, full)
    sweep_paths: list[tuple[int, SweepPath]] = []
    on_line = np.full(len(motion.line), -1)
    for k, view in enumerate(run.plan.views):
        if view.sweep is None:
            continue
        row = int(np.flatnonzero(motion.view == view.id)[0])
        line_rows = np.flatnonzero(motion.line == motion.line[row])
        driven: Ints = to_steps(motion.via_q[max(0, int(line_rows[0]) - 1) : int(line_rows[-1]) + 1])
        column = world.T_base_object @ run.candidates.T_object_scanner[view.id]
        paths = find_sweeps(column, world.T_flange_scanner, kinematics, limits, speed, checker).paths
        match = next((path for path in paths if np.array_equal(to_steps(path.q), driven)), None)
        if match is None:
            refuse(path, f"drives a line for the sweep of view {k + 1} that cannot be proven")
        if key := first_difference(view.sweep, sweep_values(view.T_object_poses, match)):
            refuse(run.folder / "plan.json", f"states another sweep than motion.npz at views[{k}].sweep.{key}")
        on_line[line_rows] = len(sweep_paths)
        sweep_paths.append((int(line_rows[0]) - 1, match))
    if not np.array_equal(on_line, motion.line):
        refuse(path, "has lines that do not belong to its sweeps")
    return sweep_paths


def verify_clearance(run: Run, stored: Mapping[str, NDArray[Any]], collision: str) -> None:
    """Check that plan.json and motion.npz (`stored`) state the same clearance; `collision` is the part's shape."""
    stated = run.plan.clearance
    if stated is None:
        refuse(run.folder / "plan.json", "does not state the clearance of the motion")
    nearest, proven, between = (stored[name] for name in ("minimum_clearance", "clearance_lower_bound", "between"))
    expected = Clearance(
        collision=collision,
        segments=[
            {
                "minimum_mm": round(1000 * float(low), 4),
                "lower_bound_mm": round(1000 * float(least), 4),
                "between": str(what),
            }
            for low, least, what in zip(nearest, proven, between, strict=True)
        ],
        tightest=stated.tightest,
    )
    if len(expected.segments) != int(run.motion.segment[-1]) + 1:
        refuse(run.folder / "motion.npz", "has another number of segments than clearances")
    key = first_difference(stated, expected)
    if not key and stated.tightest is not None:
        row = int(np.argmin(nearest))
        again = stated.tightest.model_copy(
            update={
                "segment": row,
                "distance_mm": expected.segments[row].minimum_mm,
                "between": expected.segments[row].between,
            }
        )
        key = first_difference(stated.tightest, again)
    if key:
        refuse(run.folder / "plan.json", f"states another clearance than motion.npz at {key}")
