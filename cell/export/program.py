"""What a controller is to do, as values: the via points of a run's motion with the poses of flange and tool at each.

Read from the run's own files. The joint angles are the planned ones (multiples of 1e-4 deg); every pose follows from
them by forward kinematics. Base frame: the robot's foot, KUKA's $ROBROOT. The tool centre point (TCP) is the scanner
frame. Metres, radians, seconds.

E6POS wants status and turn beside a pose, so that one joint solution is meant: bits of S say behind A1 (wrist centre),
elbow (A3 above the stretched arm, -2.990345 deg) and A5 < 0; bit i - 1 of T says A_i < 0. Both are of an arm with
KUKA's axes; the program of another has neither, and is not written in KRL.
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
from cell.runs.current_scene import CurrentFiles
from cell.runs.verification import verify_plan
from cell.session import ProgressReporter
from planner.kinematics.closed_form import KukaKinematics
from planner.kinematics.setpoints import STEPS_PER_DEGREE, to_steps
from planner.path.sweep_line import rotation_vectors
from planner.ports import ARM_AXES, JointLimits, Kinematics
from planner.timing.motion import Motion
from planner.values import Floats, Value


class Kind(StrEnum):
    """How a via point is reached."""

    START = "start"
    PTP = "ptp"
    LIN = "lin"


@dataclass(frozen=True, slots=True)
class Told:
    """What is said about a program.

    Attributes:
        name: of the program.
        part: name of the part.
        run: name of the run folder.
        digest: of all that drives.
        speed: fraction of the axis speeds that the plan was timed with.
        acceleration: the same of the accelerations.
        clearance: smallest distance found along the motion [m]; NaN where none was measured.
        between: the pair that is nearest there.
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
    """The line of a sweep, from rest to rest.

    Attributes:
        begin: via point at which it begins.
        end: via point at which it ends.
        speed: of the TCP between its first and its last pose [m/s].
        rate: of its turn there [rad/s].
        acceleration: of the TCP before and after [m/s^2].
    """

    begin: int
    end: int
    speed: float
    rate: float
    acceleration: float


@dataclass(frozen=True, slots=True, eq=False)
class Program(Value):
    """The motion of a run, ready to be written.

    Attributes:
        told: what is said about it.
        kinds: N ways in which the via points are reached; the first is where the motion begins.
        q: (N, axes) via points [rad], multiples of 1e-4 deg.
        leg: (N,) leg that ends at or passes the via point, from 0.
        stop: (N,) number of the view that is scanned at the via point, from 1 in visiting order; 0 for none.
        pose: (N,) pose of that view: 0 of a view at rest, -1 where none is.
        candidate: (N,) row of viewpoints.npz of that view; -1 for none.
        t: (N,) planned time at the via point [s], standstill for scans not counted.
        T_base_flange: (N, 4, 4) [m].
        T_base_tcp: (N, 4, 4) [m].
        T_flange_tcp: (4, 4) the tool [m].
        T_base_object: (4, 4) placement of the part [m].
        status: (N,) S of E6POS; None of an arm whose axes are not KUKA's.
        turn: (N,) T of E6POS; None likewise.
        limits: joint limits that the plan was timed with.
        sweeps: lines that are driven, in driving order; their via points have the kind `lin`, but for the first.
        T_base_table: (4, 4) about whose z E1 turns the part, right-handed [m]; None where nothing does.
    """

    told: Told
    kinds: Annotated[tuple[Kind, ...], "N"]
    q: Annotated[Floats, "N axes"]
    leg: Annotated[NDArray[np.int64], "N"]
    stop: Annotated[NDArray[np.int64], "N"]
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
    def views(self) -> int:
        """Number of views."""
        return int(self.stop.max())


def load(run_folder: Path, name: str | None, now: CurrentFiles, reporter: ProgressReporter | None) -> Program:
    """Read the program of a finished run.

    Args:
        run_folder: of a finished plan.
        name: of the program; None takes the folder's where it is a name in KRL, else one made of the plan's digest.

        now: where the cell is described now.
        reporter: is told what of that is gone, or accepted; None: nobody.

    Raises:
        UsageError: if the name is none in KRL.
        SceneError: if the cell is described otherwise now.
        FileError: if the run is not finished, or its plan may not be driven (`cell.runs.verification`).
    """
    if name is not None:
        check_name(name)
    proven = verify_plan(run_folder)
    current_scene.require_current_scene(proven, now, reporter, wire=False)
    scene = proven.scene
    clearance, between = proven.run.min_clearance
    folder = run_folder.resolve().name
    told = Told(
        name=name if name is not None else name_of(folder, proven.digest),
        part=scene.part.name,
        run=folder,
        digest=proven.digest,
        speed=scene.speed_scaling,
        acceleration=scene.acceleration_scaling,
        clearance=clearance,
        between=between,
    )
    kinematics = kinematics_of(proven.world.model)
    program = of_motion(proven.motion, kinematics, scene.T_flange_scanner, scene.T_base_object, told)
    return program if scene.table is None else replace(program, T_base_table=scene.table.T_base_table)


def of_motion(
    motion: Motion, kinematics: Kinematics, T_flange_tcp: Floats, T_base_object: Floats, told: Told
) -> Program:
    """The program of a motion.

    Args:
        motion: from home to home.
        kinematics: of the arm alone.
        T_flange_tcp: (4, 4) the tool [m].
        T_base_object: (4, 4) placement of the part, a rotary table at 0 [m].
        told: what is said about it.
    """
    T_base_flange = kinematics.forward(motion.via_q[:, :ARM_AXES])
    T_base_tcp = T_base_flange @ T_flange_tcp
    at_view = np.flatnonzero(motion.view >= 0)
    stop = np.zeros(len(motion.view), dtype=np.int64)
    stop[at_view] = np.cumsum(np.diff(motion.view[at_view], prepend=-1) != 0)
    kuka = kinematics if isinstance(kinematics, KukaKinematics) else None
    status, turn = (None, None) if kuka is None else status_and_turn(motion.via_q[:, :ARM_AXES], kuka)
    return Program(
        told=told,
        kinds=(Kind.START, *(Kind.LIN if line >= 0 else Kind.PTP for line in motion.line[1:])),
        q=motion.via_q,
        leg=motion.segment,
        stop=stop,
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
    """S and T of E6POS.

    Args:
        q: (N, axes) joint angles [rad], KUKA signs.
        kinematics: of the arm.

    Returns:
        (N,) status and (N,) turn, as decimal numbers.
    """
    arm = kinematics.arm
    s = q[:, 1] + q[:, 2]
    radius = arm.a1 + arm.a2 * np.cos(q[:, 1]) + arm.d4 * np.cos(s) + arm.a3 * np.sin(s)
    stretched = np.arctan2(arm.a3, arm.d4)
    status = (radius < 0) * 1 + (q[:, 2] >= stretched) * 2 + (to_steps(q[:, 4]) < 0) * 4
    turn = ((to_steps(q) < 0) * (1 << np.arange(6))).sum(axis=1)
    return status.astype(np.int64), turn.astype(np.int64)


def angles_deg(q: Floats) -> list[float]:
    """Joint angles in degrees as the multiples of 1e-4 that they are."""
    return [int(step) / STEPS_PER_DEGREE for step in to_steps(q)]


def _sweep(motion: Motion, number: int, T_base_tcp: Floats) -> Sweep:
    """The line of a sweep, its speed told by the times at which its poses are passed.

    The ramps take half a step each, four fifths of it to rise and one to ease (`planner.path.sweep_line`): a speed of
    a step in the time d needs the acceleration step / (0.8 d^2).
    """
    own = np.flatnonzero(motion.line == number)
    begin, end = int(own[0]) - 1, int(own[-1])
    poses = begin + np.flatnonzero(motion.pose[begin : end + 1] >= 0)
    first, last = int(poses[0]), int(poses[-1])
    time = float(motion.via_t[last] - motion.via_t[first])
    if time <= 0.0:
        return Sweep(begin, end, 0.0, 0.0, 0.0)
    path = float(np.linalg.norm(T_base_tcp[last, :3, 3] - T_base_tcp[first, :3, 3]))
    turn = float(np.linalg.norm(rotation_vectors(T_base_tcp[[last], :3, :3] @ T_base_tcp[first, :3, :3].T)))
    each = 0.8 * time / (len(poses) - 1)
    return Sweep(begin, end, path / time, turn / time, path / time / each)


def name_of(folder: str, digest: str) -> str:
    """A program's name: the folder's where KRL takes it, else one made of a digest."""
    try:
        check_name(folder)
    except UsageError:
        return f"scan_{digest[:8]}"
    return folder
