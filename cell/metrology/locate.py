"""`cell locate`: find the placement of the part from measured points and check the plan's motion there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from cell.errors import FileError, SceneError, UsageError, errors_as
from cell.metrology import point_files, point_tables
from cell.metrology.options import LocateOptions
from cell.part.workpiece import UNITS
from cell.runs.cell import world_of
from cell.runs.run import Run, read_execution
from cell.runs.schema import JsonTable, Transform, Triple
from cell.runs.verification import find_collision
from cell.session import ProgressReporter, Stream, random_stream
from cell.world import clearance
from cell.world.collision import MujocoCollisionChecker
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.rigid import pose_difference
from planner.kinematics.frames import kuka_abc_from_pose
from planner.registration.cloud import ScanCloud
from planner.registration.localisation import SearchRange, fit_pairs, fit_surface, fit_three_two_one
from planner.registration.observability import FreeKind, FreeMotion, RigidFit, describe
from planner.registration.rigid import transform_points
from planner.values import Floats

_TURNS = (0.3, 1.1, 2.0)  # rad; a part of revolution is unchanged by these rotations about its axis
_SHOWN_POINTS = 2000  # points of the part that represent all


class Precision(JsonTable):
    """Standard deviations of the determined directions from the scatter of the points, without correlated errors."""

    centre_mm: Triple = Field(description="of the part's centre along x, y, z of base")
    rotation_deg: Triple = Field(description="of its orientation about x, y, z of base")
    max_point_sd_mm: float = Field(description="of the least precisely known point of the part")


class MotionCheck(JsonTable):
    """Result of checking the plan's motion with the part at its located placement."""

    keeps_clearance: bool = Field(description="whether every segment is certified again")
    problem: str = Field(description='reason for a failure; "" without one')
    minimum_clearance_mm: float = Field(description="smallest measured distance along the motion; 300 if farther")
    between: str = Field(description='the nearest pair of objects; "" if all are farther')


class LocateResult(JsonTable):
    """Result of `cell locate --json`."""

    run: str = Field(description="run folder")
    method: str = Field(description="'best fit', 'pairs' or '3-2-1'")
    source: str = Field(description="source of the measured points")
    views: tuple[int, ...] = Field(description="views of the fitted points, in visiting order from 1")
    T_base_object: Transform = Field(description="placement of the part: frame of its file in base")
    placement_mm: Triple = Field(description="of the part's centre in base, as --place takes it")
    placement_abc_deg: Triple = Field(description="its orientation, KUKA A B C")
    displacement_mm: float = Field(description="distance of the centre from its planned position")
    rotation_deg: float = Field(description="angle from its planned orientation")
    points: int = Field(description="number of fitted points")
    inlier_share: float = Field(description="share of inliers among them")
    rms_mm: float = Field(description="of the residuals; for 3-2-1 along the planes, which the rule leaves free")
    precision: Precision | None = Field(description="null if the precision of the points is not known")
    tolerance_mm: float = Field(description="required precision of a direction")
    free_motions: tuple[str, ...] = Field(
        description="motions that the points do not determine: free, where the planned placement is assumed, or known "
        "less precisely than `tolerance_mm`"
    )
    symmetries: tuple[str, ...] = Field(description="further such motions, under which the part is unchanged")
    contradictions: tuple[str, ...] = Field(description="contradictions found in the points, a sentence each")
    motion_check: MotionCheck

    @property
    def place(self) -> str:
        """The value of --place for this placement."""
        return ",".join(f"{number:.10g}" for number in (*self.placement_mm, *self.placement_abc_deg))

    def require_determined(self) -> None:
        """Refuse an undetermined placement.

        Raises:
            UsageError: with the undetermined motions.
        """
        if self.free_motions:
            raise UsageError(
                f"the points do not determine the placement ({'; '.join(self.free_motions)}); measure more of the "
                "part, or give --keep-planned to keep the planned placement in these directions"
            )

    def rows(self) -> list[tuple[str, str]]:
        """Return the result as names and values."""
        check, precision = self.motion_check, self.precision
        rows = [
            ("by", f"{self.method} of {self.points} points, {self.source}"),
            ("part's centre", f"{_listed(self.placement_mm)} mm in base, A B C {_listed(self.placement_abc_deg)} deg"),
            ("against the plan", f"{self.displacement_mm:.3f} mm and {self.rotation_deg:.4f} deg away"),
            ("left over", f"{self.rms_mm:.4f} mm rms; {100 * self.inlier_share:.1f} % of the points are inliers"),
            (
                "standard deviation",
                "not known: give --point-sd"
                if precision is None
                else f"centre {_listed(precision.centre_mm, 4)} mm, turn {_listed(precision.rotation_deg, 5)} deg; "
                f"worst point of the part {precision.max_point_sd_mm:.4f} mm"
                + (", in the observed directions" if self.free_motions else ""),
            ),
            ("not determined", "\n".join(self.free_motions) or f"nothing (to {self.tolerance_mm:g} mm)"),
        ]
        if self.symmetries:
            rows.append(("without meaning", "\n".join(self.symmetries) + ": the part is unchanged by it"))
        if self.contradictions:
            rows.append(("doubts", "\n".join(self.contradictions)))
        clearance_kept = "keeps its clearance there" if check.keeps_clearance else check.problem
        near = f"; nearest {check.minimum_clearance_mm:.1f} mm ({check.between})" if check.between else ""
        return [*rows, ("the plan's motion", clearance_kept + near)]


def _listed(numbers: Triple, digits: int = 3) -> str:
    return ", ".join(str(np.round(number, digits) + 0.0) for number in numbers)


def locate(run: Run, options: LocateOptions, reporter: ProgressReporter) -> LocateResult:
    """Find the placement of the part, judge it, and check the plan's motion there; the run folder is not changed.

    Raises:
        UsageError: if the options do not match the run, or the points determine no placement.
        FileError: if a file is missing or damaged, or too few points lie near the part.
    """
    scene = run.scene
    nearest, centre = ClosestPointQuery(run.reference), scene.T_object_centre[:3, 3]
    vertices = run.reference.vertices[np.unique(run.reference.faces)]
    length = float(np.sqrt(((vertices - centre) ** 2).sum(axis=1).mean()))
    shown = vertices[np.linspace(0, len(vertices) - 1, _SHOWN_POINTS).astype(np.int64)]
    planned = run.T_base_object
    measured, fit = _fit(run, options, nearest, centre, length, reporter)
    T: Floats = fit.T if measured.method != "best fit" else planned @ np.linalg.inv(fit.T)
    within = options.tolerance_mm / 1000
    undetermined = fit.undetermined_motions(within)
    symmetric = tuple(motion for motion in undetermined if _is_symmetry(motion, shown, nearest, within))
    relevant = tuple(motion for motion in undetermined if motion not in symmetric)
    position, abc = kuka_abc_from_pose(T @ scene.T_object_centre)
    with reporter.stage("check the motion there"):
        checked = _check_motion(run, T)
    return LocateResult(
        run=str(run.folder),
        method=measured.method,
        source=measured.source,
        views=measured.views,
        T_base_object=T,
        placement_mm=(np.round(1000 * position, 9) + 0.0).tolist(),
        placement_abc_deg=(np.round(np.degrees(abc), 9) + 0.0).tolist(),
        displacement_mm=1000 * float(np.linalg.norm(position - (planned @ scene.T_object_centre)[:3, 3])),
        rotation_deg=float(np.degrees(pose_difference(T, planned)[1])),
        points=len(fit.residuals) if fit.used == 1 else round(len(fit.residuals) / fit.used),
        inlier_share=fit.used,
        rms_mm=1000 * fit.rms,
        precision=_precision(fit, T, shown),
        tolerance_mm=options.tolerance_mm,
        free_motions=(*([describe(relevant)] if relevant else []), *fit.alternatives),
        symmetries=(describe(symmetric),) if symmetric else (),
        contradictions=(*fit.doubts, *measured.doubts),
        motion_check=checked,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Measured points.

    Attributes:
        method: of the fit, as in the result.
        source: in words.
        views: numbers of the views.
        clouds: one a view, object frame as if the part stood at its planned placement; of a best fit.
        doubts: one sentence each.
    """

    method: str
    source: str
    views: tuple[int, ...]
    clouds: Sequence[ScanCloud] = ()
    doubts: tuple[str, ...] = ()


def _fit(
    run: Run,
    options: LocateOptions,
    nearest: ClosestPointQuery,
    centre: Floats,
    length: float,
    reporter: ProgressReporter,
) -> tuple[_Measured, RigidFit]:
    """Read the measured points and fit them by the requested method."""
    sd = None if options.point_sd_mm is None else options.point_sd_mm / 1000
    methods: tuple[tuple[str, str | None, Callable[..., RigidFit]], ...] = (
        ("pairs", options.pairs, fit_pairs),
        ("3-2-1", options.three_two_one, fit_three_two_one),
    )
    for method, file, fit in methods:
        if file is not None:
            names, nominal, measured_points = _read_named_points(run, options, file)
            with errors_as(UsageError, PlannerError):
                result = fit(nominal, measured_points, centre, length, sd)
            return _Measured(method, f"{file} ({', '.join(names)})", options.view), result
    if sd is not None:
        raise UsageError("point_sd is for named points; a best fit computes the scatter of its points itself")
    measured = _scans_of_execution(run, options) if options.points is None else _clouds_of_files(run, options)
    search = SearchRange(options.search_mm / 1000, float(np.radians(options.search_deg)))
    with reporter.stage("fit the points"):
        rng = random_stream(run.seed, Stream.LOCALISATION_STARTS)
        with errors_as(FileError, PlannerError):
            return measured, fit_surface(measured.clouds, nearest, centre, search, rng)


def _clouds_of_files(run: Run, options: LocateOptions) -> _Measured:
    """Read the points of a file, or of a folder's files."""
    path, views = Path(str(options.points)).expanduser(), options.view or (1,)
    if not path.is_dir() and len(views) > 1:
        raise UsageError(f"{path} is one file, and {len(views)} views are given; give one view, or a folder of files")
    clouds = []
    for view in views:
        file = point_files.file_of_view(path, view) if path.is_dir() else path
        if file is None:
            raise FileError(point_files.missing_file(path, view))
        points = transform_points(_T_object_frame(run, options, view), point_files.read(file) * _metres(options))
        clouds.append(ScanCloud(points, run.plan.views[view - 1].T_object_scanner[:3, 3]))
    return _Measured("best fit", f"{path} ({options.points_frame} frame, {options.points_units})", views, clouds)


def _scans_of_execution(run: Run, options: LocateOptions) -> _Measured:
    """Read the scans of an execution."""
    recorded = read_execution(run, options.execution or "latest")
    scans = {scan.stop: scan for scan in recorded.scans}
    views = options.view or tuple(sorted(scans))[:1]
    missing = [view for view in views if view not in scans]
    if missing or not views:
        available = ", ".join(map(str, sorted(scans))) or "none"
        raise FileError(f"{recorded.folder} has no scan of view {(*missing, 1)[0]}; it has {available}")
    sources = dict.fromkeys(scans[view].source for view in views)
    return _Measured(
        "best fit",
        f"execution {recorded.folder.name} ({'; '.join(sources)})",
        views,
        [ScanCloud(scans[view].points, scans[view].T_reported[:3, 3]) for view in views],
        ("the points are simulated: the result is the placement in the simulation, not that of a real part",)
        if any(scans[view].T_true is not None for view in views)
        else (),
    )


def _read_named_points(run: Run, options: LocateOptions, file: str) -> tuple[tuple[str, ...], Floats, Floats]:
    """Read names, nominal points (N, 3) in the object frame and measured points (N, 3) in base [m]."""
    path, views = Path(file).expanduser(), options.view or (1,)
    if len(views) > 1:
        raise UsageError(f"named points are measured from one view, and {len(views)} are given; give one of them")
    names, rows = [], []
    for row in point_files.read_rows(path):
        words = row.words
        numbers = [point_tables.number_of(word) for word in words[1:]]
        if len(numbers) != 6 or None in numbers or not np.isfinite(np.array(numbers, np.float64)).all():
            raise FileError(
                f"{path}, line {row.line}: it must be a name and six numbers: x y z on the part, x y z measured"
            )
        if words[0] in names:
            raise FileError(f"{path}, line {row.line}: the point '{words[0]}' occurs twice; name each point once")
        names.append(words[0])
        rows.append(numbers)
    table = np.array(rows, dtype=np.float64).reshape(-1, 6) * _metres(options)
    T_base = run.T_base_object @ _T_object_frame(run, options, views[0])
    return tuple(names), table[:, :3], transform_points(T_base, table[:, 3:])


def _metres(options: LocateOptions) -> float:
    """Return the metres in one unit of the points."""
    return UNITS[str(options.points_units)]


def _T_object_frame(run: Run, options: LocateOptions, number: int) -> Floats:
    """Return the pose (4, 4) of the points' frame at a view, in the object frame at the planned placement [m]."""
    if not 1 <= number <= len(run.plan.views):
        raise UsageError(f"there is no view {number}; the plan has the views 1 to {len(run.plan.views)}")
    view = run.plan.views[number - 1]
    T_object_base = np.linalg.inv(run.T_base_object if view.T_base_object is None else view.T_base_object)
    frames = {"scanner": view.T_object_scanner, "flange": T_object_base @ view.T_base_flange, "base": T_object_base}
    return np.asarray(frames[str(options.points_frame)], dtype=np.float64)


def _is_symmetry(motion: FreeMotion, points: Floats, nearest: ClosestPointQuery, within: float) -> bool:
    """Return whether a rotation about an axis leaves the part unchanged."""
    if motion.kind is not FreeKind.ROTATION:
        return False
    turns = [Rotation.from_rotvec(angle * motion.direction).as_matrix() for angle in _TURNS]
    turned = np.concatenate([(points - motion.point) @ R.T + motion.point for R in turns])
    return bool(nearest.closest(turned).distance.max() <= within)


def _precision(fit: RigidFit, T_base_object: Floats, points: Floats) -> Precision | None:
    worst = fit.worst_point_sd(points)
    if fit.covariance is None or worst is None:
        return None
    R = T_base_object[:3, :3]
    of_centre, of_turn = R @ fit.covariance[:3, :3] @ R.T, R @ fit.covariance[3:, 3:] @ R.T
    return Precision(
        centre_mm=(np.round(1000 * np.sqrt(np.diag(of_centre)), 9) + 0.0).tolist(),
        rotation_deg=(np.round(np.degrees(np.sqrt(np.diag(of_turn))), 9) + 0.0).tolist(),
        max_point_sd_mm=1000 * worst,
    )


def _check_motion(run: Run, T_base_object: Floats) -> MotionCheck:
    """Check the plan's motion in the cell with the part (and its post) at a placement."""
    motion, problem = run.motion, ""
    limits = motion.limits
    try:
        # Compiled with the part there: a post off the rotary table's axis swings, and its motion is checked as well.
        world = world_of(run, run.reference, T_base_object=T_base_object)
        checker, limits = MujocoCollisionChecker(world), replace(limits, table_turn_q=world.limits.table_turn_q)
    except SceneError as error:  # a table does not support the part there
        problem = str(error)
        checker = MujocoCollisionChecker(world_of(run, run.reference), T_base_object)
    try:
        problem = problem or find_collision(motion.via_q, checker, limits)
    except PlannerError as error:
        problem = str(error)
    clearances = clearance.motion_clearance(checker, motion.via_q, motion.segment, int(motion.segment[-1]) + 1)
    near = int(np.argmin(clearances.distance))
    return MotionCheck(
        keeps_clearance=not problem,
        problem=problem,
        minimum_clearance_mm=1000 * float(clearances.distance[near]),
        between=clearances.between[near],
    )
