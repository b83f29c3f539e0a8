"""Program for a controller, as values: the via points of a run's motion with the poses of flange and tool at each.

Read from the run's files. The joint angles are the planned ones (multiples of 1e-4 deg); every pose follows from
them by forward kinematics. Base frame: the robot's foot, KUKA's $ROBROOT. The tool centre point (TCP) is the scanner
frame. Metres, radians, seconds.

E6POS needs status S and turn T beside a pose to select one configuration. The bits of S mean: wrist centre behind A1,
A3 above the stretched elbow (-2.990345 deg), A5 < 0. Bit i - 1 of T means A_i < 0. Both exist only for an arm with
KUKA's axes; the program of another arm has neither and is not written in KRL.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError
from cell.export.krl_names import check_name
from cell.robot.arm import kinematics_of
from cell.runs import current_scene
from cell.runs.current_files import CurrentFiles
from cell.runs.verification import verify_plan
from cell.session import ProgressReporter
from planner.geometry.rigid import rotation_vectors
from planner.kinematics.closed_form import KukaKinematics
from planner.kinematics.setpoints import STEPS_PER_DEGREE, to_steps
from planner.ports import ARM_AXES, JointLimits, Kinematics
from planner.timing.motion import Motion
from planner.values import Floats, Value


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
        part: name of the part.
        run: name of the run folder.
        digest: of the plan.
        speed: fraction of the axis speeds with which the plan was timed.
        acceleration: fraction of the axis accelerations.
        clearance: smallest distance along the motion [m]; NaN if not measured.
        between: the pair at that distance.
    """

    name: str
    part: str
    run: str
    digest: str
    speed: float
    acceleration: float
    clearance: float
    between: str


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

    @property
    def n_views(self) -> int:
        """Number of views."""
        return int(self.view.max())


def load_program(
    run_folder: Path, name: str | None, current: CurrentFiles, reporter: ProgressReporter | None
) -> Program:
    """Read the program of a finished run.

    Args:
        run_folder: of a finished plan.
        name: of the program; None uses `program_name`.
        current: files that describe the cell today.
        reporter: reports which of them are missing, or accepted although they differ.

    Raises:
        UsageError: if KRL does not accept the name.
        SceneError: if the cell has changed since the plan.
        FileError: if the run is not finished, or the verification of its plan fails (`cell.runs.verification`).
    """
    if name is not None:
        check_name(name)
    verified = verify_plan(run_folder)
    current_scene.require_current_scene(verified, current, reporter, wire=False)
    scene = verified.scene
    clearance, between = verified.run.min_clearance
    folder = run_folder.resolve().name
    info = ProgramInfo(
        name=name if name is not None else program_name(folder, verified.digest),
        part=scene.part.name,
        run=folder,
        digest=verified.digest,
        speed=scene.speed_scaling,
        acceleration=scene.acceleration_scaling,
        clearance=clearance,
        between=between,
    )
    kinematics = kinematics_of(verified.world.model)
    program = program_of_motion(verified.motion, kinematics, scene.T_flange_scanner, scene.T_base_object, info)
    return program if scene.table is None else replace(program, T_base_table=scene.table.T_base_table)


def program_of_motion(
    motion: Motion, kinematics: Kinematics, T_flange_tcp: Floats, T_base_object: Floats, info: ProgramInfo
) -> Program:
    """Return the program of a motion.

    Args:
        motion: from home to home.
        kinematics: of the arm alone.
        T_flange_tcp: (4, 4) the tool [m].
        T_base_object: (4, 4) placement of the part, a rotary table at 0 [m].
        info: description of the program.
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


def program_name(folder: str, digest: str) -> str:
    """Return the folder's name if it is valid in KRL, else a name made of a digest."""
    try:
        check_name(folder)
    except UsageError:
        return f"scan_{digest[:8]}"
    return folder


def _sweep(motion: Motion, number: int, T_base_tcp: Floats) -> Sweep:
    """Return the line of a sweep; its speed follows from the times at which it passes its poses.

    Each ramp covers half a step: the speed rises during four fifths of it and eases during the last fifth
    (`planner.path.sweep_line`). A speed of one step in the time d needs the acceleration step / (0.8 d^2).
    """
    own = np.flatnonzero(motion.line == number)
    begin, end = int(own[0]) - 1, int(own[-1])
    poses = begin + np.flatnonzero(motion.pose[begin : end + 1] >= 0)
    first, last = int(poses[0]), int(poses[-1])
    duration = float(motion.via_t[last] - motion.via_t[first])
    if duration <= 0.0:
        return Sweep(begin, end, 0.0, 0.0, 0.0)
    length = float(np.linalg.norm(T_base_tcp[last, :3, 3] - T_base_tcp[first, :3, 3]))
    turn = float(np.linalg.norm(rotation_vectors(T_base_tcp[[last], :3, :3] @ T_base_tcp[first, :3, :3].T)))
    ramp_time = 0.8 * duration / (len(poses) - 1)
    return Sweep(begin, end, length / duration, turn / duration, length / duration / ramp_time)
