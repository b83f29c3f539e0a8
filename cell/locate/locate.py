"""`cell locate`: where the part of a plan really stands, and whether the plan's motion may be driven there."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cell.errors import SceneError, UsageError
from cell.locate import measured, points_fit
from cell.locate.located import CheckedMotion, Located, Precision
from cell.locate.options import Locating
from cell.proof.motion_again import require_free
from cell.reconstruction import surface_fit
from cell.reconstruction.freedom import FreeKind, FreeMotion
from cell.reconstruction.rigid import RigidFit, told
from cell.robot.frames import kuka_abc_from_pose
from cell.runs.cell import world_of
from cell.runs.run import Run
from cell.session import ProgressReporter, Stream, random_stream
from cell.world import clearance
from cell.world.collision import MujocoCollisionChecker
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.values import Floats

_TURNS = (0.3, 1.1, 2.0)  # rad; a part that is the same after these turns about an axis is one of revolution
_LOOKED_AT = 2000  # points of the part that stand for all


def locate(run: Run, wanted: Locating, reporter: ProgressReporter) -> Located:
    """Find the placement, judge it, and check the plan's motion with the part there.

    Args:
        run: a finished plan; nothing in its folder changes.
        wanted: what was measured, and how it is fitted.
        reporter: is told what goes on.

    Raises:
        UsageError: if what is asked for is not there, or the points cannot say a placement.
        FileError: if a file is missing or damaged, or too few points lie near the part.
    """
    scene = run.scene
    nearest, centre = ClosestPointQuery(run.reference), scene.T_object_centre[:3, 3]
    vertices = run.reference.vertices[np.unique(run.reference.faces)]
    length = float(np.sqrt(((vertices - centre) ** 2).sum(axis=1).mean()))
    shown = vertices[np.linspace(0, len(vertices) - 1, _LOOKED_AT).astype(np.int64)]
    method, source, views, fit, doubts = _fitted(run, wanted, nearest, centre, length, reporter)
    planned = run.T_base_object
    T: Floats = fit.T if method != "best fit" else planned @ np.linalg.inv(fit.T)
    within = wanted.within_mm / 1000
    open_ = fit.undetermined(within)
    symmetric = tuple(motion for motion in open_ if _leaves_the_part(motion, shown, nearest, within))
    matters = tuple(motion for motion in open_ if motion not in symmetric)
    position, abc = kuka_abc_from_pose(T @ scene.T_object_centre)
    with reporter.stage("check the motion there"):
        checked = _checked(run, T)
    return Located(
        run=str(run.folder),
        method=method,
        source=source,
        views=views,
        T_base_object=T,
        placement_mm=_triple(1000 * position),
        placement_abc_deg=_triple(np.degrees(abc)),
        moved_mm=1000 * float(np.linalg.norm(position - (planned @ scene.T_object_centre)[:3, 3])),
        turned_deg=_angle_deg(T[:3, :3].T @ planned[:3, :3]),
        points=len(fit.residuals) if fit.used == 1 else round(len(fit.residuals) / fit.used),
        used=fit.used,
        rms_mm=1000 * fit.rms,
        precision=_precision(fit, T, shown),
        within_mm=wanted.within_mm,
        undetermined=(*([told(matters)] if matters else []), *fit.rivals),
        symmetric=(told(symmetric),) if symmetric else (),
        doubts=(*fit.doubts, *doubts),
        checked_motion=checked,
    )


def _fitted(
    run: Run, wanted: Locating, nearest: ClosestPointQuery, centre: Floats, length: float, reporter: ProgressReporter
) -> tuple[str, str, tuple[int, ...], RigidFit, tuple[str, ...]]:
    """Method, source, views, fit and doubts: what was measured, fitted as it was asked for."""
    sd = None if wanted.point_sd_mm is None else wanted.point_sd_mm / 1000
    ways: tuple[tuple[str, str | None, Callable[..., RigidFit]], ...] = (
        ("pairs", wanted.pairs, points_fit.of_pairs),
        ("3-2-1", wanted.three_two_one, points_fit.of_six),
    )
    for method, file, way in ways:
        if file is not None:
            names, nominal, there = measured.of_pairs(run, wanted, file)
            fit = way(nominal, there, centre, length, sd)
            return method, f"{file} ({', '.join(names)})", wanted.view, fit, ()
    if sd is not None:
        raise UsageError("point_sd is of named points; a best fit finds the scatter of its points itself")
    clouds = measured.of_execution(run, wanted) if wanted.points is None else measured.of_files(run, wanted)
    search = surface_fit.Search(wanted.search_mm / 1000, float(np.radians(wanted.search_deg)))
    with reporter.stage("fit the points"):
        rng = random_stream(run.seed, Stream.LOCALISATION_STARTS)
        fit = surface_fit.fit(clouds.clouds, nearest, centre, search, rng)
    doubts = ("the points are simulated: they say where the simulation has the part, not where it stands",)
    return "best fit", clouds.source, clouds.views, fit, doubts if clouds.simulated else ()


def _leaves_the_part(motion: FreeMotion, points: Floats, nearest: ClosestPointQuery, within: float) -> bool:
    """Whether a part is the same after a motion: a turn about its own axis."""
    if motion.kind is not FreeKind.ROTATION:
        return False
    from scipy.spatial.transform import Rotation

    turns = [Rotation.from_rotvec(angle * motion.direction).as_matrix() for angle in _TURNS]
    turned = np.concatenate([(points - motion.point) @ R.T + motion.point for R in turns])
    return bool(nearest.closest(turned).distance.max() <= within)


def _precision(fit: RigidFit, T_base_object: Floats, points: Floats) -> Precision | None:
    worst = fit.deviation_of(points)
    if fit.covariance is None or worst is None:
        return None
    R = T_base_object[:3, :3]
    of_centre, of_turn = R @ fit.covariance[:3, :3] @ R.T, R @ fit.covariance[3:, 3:] @ R.T
    return Precision(
        centre_mm=_triple(1000 * np.sqrt(np.diag(of_centre))),
        turn_deg=_triple(np.degrees(np.sqrt(np.diag(of_turn)))),
        worst_point_mm=1000 * worst,
    )


def _checked(run: Run, T_base_object: Floats) -> CheckedMotion:
    """The plan's motion in the cell with the part (and its post) there."""
    motion, problem = run.motion, ""
    limits = motion.limits
    try:
        # Compiled with the part there: a post beside a rotary table's axis swings, and is guarded for it.
        world = world_of(run, run.reference, T_base_object=T_base_object)
        checker, limits = MujocoCollisionChecker(world), replace(limits, table_turn_q=world.limits.table_turn_q)
    except SceneError as error:  # a table does not carry the part there
        problem = str(error)
        checker = MujocoCollisionChecker(world_of(run, run.reference), T_base_object)
    try:
        problem = problem or require_free(motion.via_q, checker, limits)
    except PlannerError as error:
        problem = str(error)
    found = clearance.of_motion(checker, motion.via_q, motion.segment, int(motion.segment[-1]) + 1)
    near = int(np.argmin(found.distance))
    return CheckedMotion(
        keeps_clearance=not problem,
        problem=problem,
        nearest_mm=1000 * float(found.distance[near]),
        between=found.between[near],
    )


def _angle_deg(R: Floats) -> float:
    """Angle of a rotation (3, 3) [deg], exact also where it is small."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1)))


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in np.round(values, 9) + 0.0)
    return x, y, z
