"""Program for a controller, as values: the via points of a run's motion with the poses of flange and tool at each.

Read from the run's files. The joint angles are the planned ones (multiples of 1e-4 deg); every pose follows from
them by forward kinematics. Base frame: the robot's foot, KUKA's $ROBROOT. The tool centre point (TCP) is the scanner
frame. Metres, radians, seconds.

E6POS of KRL needs status S and turn T beside a pose to select one configuration. The bits of S mean: wrist centre
behind A1, A3 above the stretched elbow (-2.990345 deg), A5 < 0. Bit i - 1 of T means A_i < 0. Both exist only for an
arm with KUKA's axes; the program of another arm has neither and is not written in KRL.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError
from cell.export.names import check_name
from cell.export.options import ExportOptions, Language
from cell.robot.arm import chain_of, kinematics_of
from cell.robot.makers import maker_language
from cell.robot.model import ROUNDED, dimensions
from cell.runs import current_scene
from cell.runs.verification import verify_plan
from cell.session import ProgressReporter
from planner.geometry.rigid import rotation_vectors
from planner.kinematics.closed_form import KukaKinematics
from planner.kinematics.frames import kuka_abc_from_pose
from planner.kinematics.setpoints import STEPS_PER_DEGREE, to_steps
from planner.ports import ARM_AXES, JointLimits, Kinematics, axis_name
from planner.timing.motion import Motion
from planner.values import Floats, Value

AT_STOP_DEG = 0.1
"""Largest deviation of each axis from the end of the last motion at which a program continues."""

_MAX_TURN_DEG = 0.001  # a line that turns by less is straight: set-points of 1e-4 deg turn it by up to 0.0006


class Kind(StrEnum):
    """Type of the motion that ends at a via point."""

    START = "start"
    PTP = "ptp"
    LIN = "lin"


@dataclass(frozen=True, slots=True)
class ProgramInfo:
    """Description of a program.

    Attributes:
        name: of the program.
        language: of the program, or format of the table.
        part: name of the part.
        run: name of the run folder.
        digest: of the plan.
        speed: fraction of the axis speeds with which the plan was timed.
        acceleration: fraction of the axis accelerations.
        robot: name of the robot's file, or "kr16".
        clearance: smallest distance along the motion [m]; NaN if not measured.
        between: the pair at that distance.
    """

    name: str
    language: Language
    part: str
    run: str
    digest: str
    speed: float
    acceleration: float
    robot: str
    clearance: float
    between: str


@dataclass(frozen=True, slots=True)
class ProgramSettings:
    """Settings of the controller.

    Attributes:
        speed_percent: of the axis speeds, 1 to 100.
        acceleration_percent: of the axis accelerations, 1 to 100.
        signals: outputs, inputs and times between controller and scanner.
    """

    speed_percent: int
    acceleration_percent: int
    signals: ExportOptions


@dataclass(frozen=True, slots=True)
class Sweep:
    """Straight line of a sweep, from rest to rest.

    Attributes:
        begin: via point at which it begins.
        end: via point at which it ends.
        speed: of the TCP between the first and the last measuring pose [m/s].
        rate: angular speed there [rad/s].
        acceleration: of the TCP on the ramps before and after [m/s^2].
    """

    begin: int
    end: int
    speed: float
    rate: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Step:
    """A joint motion to a via point, with the scan or the sweep that follows there.

    Attributes:
        row: via point.
        title: sentence on the segment that begins with this motion; "" inside a segment.
        duration: planned time of the motion [s].
        view: number of the view that is scanned at rest at the via point; 0 for none.
        sweep: line that begins at the via point.
    """

    row: int
    title: str
    duration: float
    view: int
    sweep: Sweep | None


@dataclass(frozen=True, slots=True, eq=False)
class Program(Value):
    """The motion of a run, independent of the file format.

    Attributes:
        info: description of the program.
        kinds: type of the motion to each of the N via points; the first is `start`.
        q: via points [rad], multiples of 1e-4 deg.
        segment: number of the segment that ends at or passes the via point, from 0.
        view: number of the view that is scanned at the via point, from 1 in visiting order; 0 for none.
        pose: pose of that view: 0 for a view at rest, -1 for no view.
        candidate: row of viewpoints.npz of that view; -1 for none.
        t: planned time at the via point [s], without dwell times for scans.
        T_base_flange: [m].
        T_base_tcp: [m].
        T_flange_tcp: the tool [m].
        T_base_object: placement of the part [m].
        status: S of E6POS; None for an arm with other axes than KUKA's.
        turn: T of E6POS; None likewise.
        limits: joint limits with which the plan was timed.
        sweeps: lines in driving order; their via points have the kind `lin`, except the first.
        T_base_table: frame about whose z axis E1 turns the part, right-handed [m]; None without a rotary table.
        cos_axes_2_3: cosine of the angle between the directions of axes 2 and 3.
    """

    info: ProgramInfo
    kinds: Annotated[tuple[Kind, ...], "N"]
    q: Annotated[Floats, "N axes"]
    segment: Annotated[NDArray[np.int64], "N"]
    view: Annotated[NDArray[np.int64], "N"]
    pose: Annotated[NDArray[np.int64], "N"]
    candidate: Annotated[NDArray[np.int64], "N"]
    t: Annotated[Floats, "N"]
    T_base_flange: Annotated[Floats, "N 4 4"]
    T_base_tcp: Annotated[Floats, "N 4 4"]
    T_flange_tcp: Annotated[Floats, "4 4"]
    T_base_object: Annotated[Floats, "4 4"]
    status: Annotated[NDArray[np.int64], "N"] | None
    turn: Annotated[NDArray[np.int64], "N"] | None
    limits: JointLimits
    sweeps: tuple[Sweep, ...]
    T_base_table: Annotated[Floats, "4 4"] | None = None
    cos_axes_2_3: float = 1.0

    @property
    def n_views(self) -> int:
        """Number of views."""
        return int(self.view.max())

    def steps(self) -> Iterator[Step]:
        """Yield the joint motions in driving order, without the first via point, which is home."""
        sweeps, segment, title = {sweep.begin: sweep for sweep in self.sweeps}, -1, ""
        for row in range(1, len(self.q)):
            if self.segment[row] != segment:
                segment = int(self.segment[row])
                ahead = self.view[row:][self.segment[row:] == segment]
                title = f"segment {segment + 1}: {f'to view {ahead.max()}' if ahead.max(initial=0) else 'home'}"
            if self.kinds[row] is Kind.PTP:
                view = 0 if row in sweeps else int(self.view[row])
                yield Step(row, title, float(self.t[row] - self.t[row - 1]), view, sweeps.get(row))
                title = ""

    def sweep_view(self, sweep: Sweep) -> int:
        """Return the number of the view of a sweep."""
        return int(self.view[sweep.begin : sweep.end + 1].max())

    def header(self) -> Iterator[str]:
        """Yield sentences on the plan and the ranges of the axes, for the comments of a program."""
        info = self.info
        yield f"{self.n_views} views of {info.part}, planned by scan-cell; run folder {info.run}"
        yield f"digest of the plan {info.digest}"
        yield "before a start: the same robot, tool, base, part and fixtures as in the plan; first at reduced speed"
        position, abc = kuka_abc_from_pose(self.T_base_object)
        x, y, z, a, b, c = (float(value) + 0.0 for value in (*np.round(position * 1000, 3), *np.degrees(abc).round(4)))
        yield f"part: its frame in the robot's base is X {x:.3f} Y {y:.3f} Z {z:.3f} mm,"
        yield f"Rz({a:.4f} deg) Ry({b:.4f} deg) Rx({c:.4f} deg)"
        if np.isfinite(info.clearance):
            yield f"smallest distance along the planned motion: {info.clearance * 1000:.1f} mm ({info.between})"
        yield from self.axis_ranges()

    def axis_ranges(self) -> Iterator[str]:
        """Yield one sentence per axis: its range in this program, and the range of the plan's limits."""
        low, high = to_steps(self.q).min(axis=0), to_steps(self.q).max(axis=0)
        bounds = np.degrees(np.stack([self.limits.lower, self.limits.upper]))
        for axis in range(self.q.shape[1]):
            used = f"{low[axis] / STEPS_PER_DEGREE:.4f} to {high[axis] / STEPS_PER_DEGREE:.4f} deg"
            yield f"{axis_name(axis)} from {used}; planned within {bounds[0, axis]:.1f} to {bounds[1, axis]:.1f}"

    def time_factor(self, settings: ProgramSettings) -> float:
        """Return the factor, 1 at least, by which motions take longer than planned with the shares of the settings."""
        speed = self.info.speed * 100 / settings.speed_percent
        acceleration = self.info.acceleration * 100 / settings.acceleration_percent
        return max(1.0, speed, math.sqrt(acceleration))

    def require_straight_sweeps(self, statement: str) -> None:
        """Raise UsageError if a sweep turns.

        Args:
            statement: language and motion statement of a line, as in "a LIN of KRL".
        """
        for sweep in self.sweeps:
            T = self.T_base_tcp[[sweep.begin, sweep.end], :3, :3]
            turn = float(np.degrees(np.linalg.norm(rotation_vectors(T[1:] @ T[0].T))))
            if turn > _MAX_TURN_DEG:
                raise UsageError(
                    f"the sweep of view {self.sweep_view(sweep)} turns by {turn:.3f} deg, and {statement} may turn "
                    "differently from the planned and checked motion; choose --format csv or json, or plan with "
                    "sweep_mm in place of sweep_deg"
                )


def load_program(
    run_folder: Path, name: str | None, options: ExportOptions, reporter: ProgressReporter | None
) -> Program:
    """Read the program of a finished run.

    Args:
        run_folder: of a finished plan.
        name: of the program; None uses `program_name`.
        options: language, and files that describe the cell today.
        reporter: reports which of them are missing, or accepted although they differ.

    Raises:
        UsageError: if the language does not accept the name, or the robot's maker is not known.
        SceneError: if the cell has changed since the plan.
        FileError: if the run is not finished, or the verification of its plan fails (`cell.runs.verification`).
    """
    verified = verify_plan(run_folder)
    current_scene.require_current_scene(verified, options, reporter, wire=False)
    scene = verified.scene
    robot = "kr16" if scene.robot is None else scene.robot.name
    language = options.kind or language_of(robot)
    if name is None:
        name = program_name(run_folder.resolve().name, verified.digest, language)
    check_name(name, language)
    clearance, between = verified.run.min_clearance
    info = ProgramInfo(
        name=name,
        language=language,
        part=scene.part.name,
        run=run_folder.resolve().name,
        digest=verified.digest,
        speed=scene.speed_scaling,
        acceleration=scene.acceleration_scaling,
        robot=robot,
        clearance=clearance,
        between=between,
    )
    kinematics = kinematics_of(verified.world.model)
    directions = chain_of(verified.world.model).directions
    program = program_of_motion(
        verified.motion,
        kinematics,
        scene.T_flange_scanner,
        scene.T_base_object,
        info,
        float(directions[1] @ directions[2]),
    )
    if program.status is None and (arm := dimensions(verified.world.model, ROUNDED)) is not None:
        status, turn = status_and_turn(program.q[:, :ARM_AXES], KukaKinematics(arm, kinematics.limits))
        program = replace(program, status=status, turn=turn)
    return program if scene.table is None else replace(program, T_base_table=scene.table.T_base_table)


def program_of_motion(
    motion: Motion,
    kinematics: Kinematics,
    T_flange_tcp: Floats,
    T_base_object: Floats,
    info: ProgramInfo,
    cos_axes_2_3: float = 1.0,
) -> Program:
    """Return the program of a motion.

    Args:
        motion: from home to home.
        kinematics: of the arm alone.
        T_flange_tcp: (4, 4) the tool [m].
        T_base_object: (4, 4) placement of the part, a rotary table at 0 [m].
        info: description of the program.
        cos_axes_2_3: cosine of the angle between the directions of axes 2 and 3.
    """
    T_base_flange = kinematics.forward(motion.via_q[:, :ARM_AXES])
    T_base_tcp = T_base_flange @ T_flange_tcp
    at_view = np.flatnonzero(motion.view >= 0)
    view = np.zeros(len(motion.view), dtype=np.int64)
    view[at_view] = np.cumsum(np.diff(motion.view[at_view], prepend=-1) != 0)
    kuka = kinematics if isinstance(kinematics, KukaKinematics) else None
    status, turn = (None, None) if kuka is None else status_and_turn(motion.via_q[:, :ARM_AXES], kuka)
    return Program(
        info=info,
        kinds=(Kind.START, *(Kind.LIN if line >= 0 else Kind.PTP for line in motion.line[1:])),
        q=motion.via_q,
        segment=motion.segment,
        view=view,
        pose=motion.pose,
        candidate=motion.view,
        t=motion.via_t,
        T_base_flange=T_base_flange,
        T_base_tcp=T_base_tcp,
        T_flange_tcp=T_flange_tcp,
        T_base_object=T_base_object,
        status=status,
        turn=turn,
        limits=motion.limits,
        sweeps=tuple(_sweep(motion, number, T_base_tcp) for number in range(int(motion.line.max()) + 1)),
        cos_axes_2_3=cos_axes_2_3,
    )


def status_and_turn(q: Floats, kinematics: KukaKinematics) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return S and T of E6POS, (N,) each, for (N, axes) joint angles [rad] with KUKA's signs."""
    arm = kinematics.arm
    s = q[:, 1] + q[:, 2]
    radius = arm.a1 + arm.a2 * np.cos(q[:, 1]) + arm.d4 * np.cos(s) + arm.a3 * np.sin(s)
    stretched = np.arctan2(arm.a3, arm.d4)
    status = (radius < 0) * 1 + (q[:, 2] >= stretched) * 2 + (to_steps(q[:, 4]) < 0) * 4
    turn = ((to_steps(q) < 0) * (1 << np.arange(6))).sum(axis=1)
    return status.astype(np.int64), turn.astype(np.int64)


def angles_deg(q: Floats) -> list[float]:
    """Return joint angles in degrees, as exact multiples of 1e-4."""
    return [int(step) / STEPS_PER_DEGREE for step in to_steps(q)]


def program_name(folder: str, digest: str, language: Language) -> str:
    """Return the folder's name if it is valid in the language, else a name made of a digest."""
    try:
        check_name(folder, language)
    except UsageError:
        return f"scan_{digest[:8]}"
    return folder


def language_of(robot: str) -> Language:
    """Return the language of the maker of a robot.

    Args:
        robot: name of the robot's file, or "kr16".

    Raises:
        UsageError: if the name shows no maker, or one without a program.
    """
    language = maker_language(robot)
    if language == "inform":
        raise UsageError(
            f"a program for {robot} in INFORM has pulses in place of angles, and the robot's file has no pulses per "
            "degree; choose --format csv or json"
        )
    if language is None:
        raise UsageError(f"the name of the robot's file, {robot}, shows no maker; choose --format, for instance json")
    return language


def _sweep(motion: Motion, number: int, T_base_tcp: Floats) -> Sweep:
    """Return the line of a sweep; its speed follows from the times at which it passes its poses.

    Each ramp covers half a step: the speed rises during four fifths of it and eases during the last fifth
    (`planner.path.sweep_line`). A speed of one step in the time d needs the acceleration step / (0.8 d^2).
    """
    rows = np.flatnonzero(motion.line == number)
    begin, end = int(rows[0]) - 1, int(rows[-1])
    poses = begin + np.flatnonzero(motion.pose[begin : end + 1] >= 0)
    first, last = int(poses[0]), int(poses[-1])
    duration = float(motion.via_t[last] - motion.via_t[first])
    if duration <= 0.0:
        return Sweep(begin, end, 0.0, 0.0, 0.0)
    length = float(np.linalg.norm(T_base_tcp[last, :3, 3] - T_base_tcp[first, :3, 3]))
    turn = float(np.linalg.norm(rotation_vectors(T_base_tcp[[last], :3, :3] @ T_base_tcp[first, :3, :3].T)))
    ramp_time = 0.8 * duration / (len(poses) - 1)
    return Sweep(begin, end, length / duration, turn / duration, length / duration / ramp_time)
