r"""The program in KRL: `<name>.src` with the motion, `<name>.dat` with the numbers that a commissioner changes.

Plain KRL without inline forms, so it compiles without the pendant's parameter lists. Every motion is an exact stop,
because only the straight moves between the via points were checked for collision, and `$ADVANCE=0` keeps the
interpreter from running ahead of the arm. A stop:

    WAIT SEC settle                          the arm stands and has calmed down
    $OUT[trigger]=TRUE                       scan
    WAIT FOR $IN[done] OR $TIMER_FLAG[n]     the scanner's answer, or the time-out: KRL's WAIT FOR has none of its own,
                                             so a timer counts up from -time-out; its flag is TRUE above 0
    $OUT[trigger]=FALSE

A sweep is one LIN between trigger and answer, from rest to rest; `$OUT[gate]` is TRUE while it is driven. Its
orientation is constant: between two orientations KRL swivels the tool direction and turns about it, which is not the
planned turn about one axis for every axis, so a sweep that turns is refused.

After a time-out the program halts; Start makes the same scan again, a sweep after a LIN back to its beginning. Before
every trigger, and before that LIN, each axis must be where the last motion ended (`SC_STOP`): an arm that was jogged
while the program stood halts it again. The scanner takes its answer back when the trigger falls; an answer that still
stands from the view before is waited for before the trigger rises.

Numbers: joint angles exact to 1e-4 deg, lengths to 1e-3 mm, angles of frames to 1e-4 deg (a REAL of KRL has 7
digits). Lines end with CR LF; characters are ASCII.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cell.errors import UsageError
from cell.export.krl_routines import BEGIN, routines
from cell.export.options import ExportOptions
from cell.export.program import Kind, Program, Sweep, angles_deg
from planner.kinematics.frames import kuka_abc_from_pose
from planner.kinematics.setpoints import STEPS_PER_DEGREE, from_steps, to_steps
from planner.path.sweep_line import rotation_vectors
from planner.ports import ARM_AXES, axis_name
from planner.values import Floats

_MOST_EXTERNAL = 6
_AT_STOP_DEG = 0.1  # an axis farther from the last stop is not there: the program halts
_TURNS_DEG = 0.001  # a line that turns by less is straight: set-points of 1e-4 deg turn it by up to 0.0006
_LEAST_SPEED = 0.001  # of a line that has no length: KRL takes no speed 0 [m/s]
_LONGEST_LINE = 400  # characters; KRL's own limit is 471 on a KR C2 (from memory)


@dataclass(frozen=True, slots=True)
class KrlOptions:
    """What the controller's side needs.

    Attributes:
        speed_percent: of the axis speeds, 1 to 100.
        acceleration_percent: of the axis accelerations, 1 to 100.
        signals: between controller and scanner.
    """

    speed_percent: int
    acceleration_percent: int
    signals: ExportOptions


def source(program: Program, options: KrlOptions) -> bytes:
    """The content of `<name>.src`.

    Raises:
        UsageError: if the arm's axes are not KUKA's, or a sweep turns.
    """
    if program.status is None:
        raise UsageError("this arm's axes are not KUKA's, so no KRL drives it; choose --format csv or json")
    for sweep in program.sweeps:
        T = program.T_base_tcp[[sweep.begin, sweep.end], :3, :3]
        turn = float(np.degrees(np.linalg.norm(rotation_vectors(T[1:] @ T[0].T))))
        if turn > _TURNS_DEG:
            raise UsageError(
                f"the sweep of view {_number(program, sweep)} turns by {turn:.3f} deg, and a LIN of KRL need not turn "
                "as it was planned and checked; choose --format csv or json, or plan with sweep_mm in place of "
                "sweep_deg"
            )
    return _file(_source(program, options))


def main_source(name: str, programs: Sequence[Program]) -> bytes:
    """The content of `<name>.src` that calls the programs of several set-ups, halting before each.

    While it stands, $BASE is the part's frame of the set-up to come, so that the pendant shows where it has to lie.
    """
    return _file(_main(name, programs))


def _main(name: str, programs: Sequence[Program]) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEF {name}( )")
    yield f"; {len(programs)} set-ups of {programs[0].told.part}, planned by scan-cell; each begins and ends at home"
    yield from BEGIN
    for number, program in enumerate(programs, start=1):
        frame_of_part = frame(program.T_base_object)
        yield from ("", f"; set-up {number}: {program.views} views; digest of the plan {program.told.digest}")
        yield f"$BASE={frame_of_part}"
        yield f"HALT ; set-up {number}: put the part where its frame is $BASE, then start again"
        yield f"{program.told.name}( )"
    yield from ("", "END")


def data(program: Program, options: KrlOptions) -> bytes:
    """The content of `<name>.dat`."""
    return _file(_data(program, options))


def _file(lines: Iterator[str]) -> bytes:
    """One line each, whatever the names in the comments hold: a line break in one would begin a statement."""
    return "".join(f"{_one_line(line)}\r\n" for line in lines).encode("ascii", errors="replace")


def _one_line(line: str) -> str:
    shown = "".join(character if character.isprintable() else "?" for character in line)
    return shown if len(shown) <= _LONGEST_LINE else shown[: _LONGEST_LINE - 3] + "..."  # comments alone are so long


def _source(program: Program, options: KrlOptions) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEF {program.told.name}( )")
    yield from _comments(program)
    yield from BEGIN
    yield f"BAS(#VEL_PTP,{options.speed_percent})"
    yield f"BAS(#ACC_PTP,{options.acceleration_percent})"
    yield "; base: the robot's foot, equal to the world as long as $ROBROOT is zero; every motion between views is in"
    yield "; axis angles, which no base moves"
    yield "$BASE={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}"
    yield "$TOOL=SC_TOOL"
    if program.sweeps:
        yield "; along a line the orientation does not change; the base stands still"
        yield from ("$ORI_TYPE=#CONSTANT", "$IPO_MODE=#BASE")
    yield "; nothing runs ahead of the arm, and every motion ends in an exact stop"
    yield "$ADVANCE=0"
    yield "$OUT[SC_TRIGGER]=FALSE"
    if program.sweeps:
        yield "$OUT[SC_GATE]=FALSE"
    yield ""
    yield "; the way to home was not checked: the program goes on only from there"
    yield f"SC_STOP={e6axis(program.q[0])}"
    yield "SC_STAND( )"
    yield f"PTP {e6axis(program.q[0])} ; home: block coincidence"
    leg = -1
    begins = {sweep.begin: sweep for sweep in program.sweeps}
    for row in range(1, len(program.q)):
        if program.leg[row] != leg:
            leg = int(program.leg[row])
            ahead = program.stop[row:][program.leg[row:] == leg]
            to = f"to view {ahead.max()}" if ahead.max(initial=0) else "home"
            yield from ("", f"; leg {leg + 1}: {to}")
        if program.kinds[row] is Kind.LIN:
            continue
        yield f"PTP {e6axis(program.q[row])}"
        if row not in begins and not program.stop[row]:
            continue
        # Behind the motion, and the motion with its own goal: whichever line is selected, no old stop is driven to.
        yield f"SC_STOP={e6axis(program.q[row])}"
        if row in begins:
            yield from _sweep(program, begins[row], _slower(program, options))
        else:
            yield f"SC_SCAN({program.stop[row]}) ; candidate {program.candidate[row]}"
    yield from ("", "END", "")
    yield from routines([axis_name(axis) for axis in range(program.q.shape[1])])


def _sweep(program: Program, sweep: Sweep, slower: float) -> Iterator[str]:
    """One line between trigger and answer; back and again while the scanner does not answer.

    A line that takes s times as long has 1/s of the speed and 1/s^2 of the acceleration: its ramps stay as long as
    they are, so that the speed is constant from the first measuring pose to the last.
    """
    own = slice(sweep.begin, sweep.end + 1)
    poses, candidate = int((program.pose[own] >= 0).sum()), int(program.candidate[own].max())
    speed, acceleration = sweep.speed * slower, sweep.acceleration * slower**2
    stands = sweep.speed < _LEAST_SPEED
    yield f"; sweep of candidate {candidate}: {poses} poses at {speed * 1000:.3f} mm/s"
    yield f"$VEL.CP={_LEAST_SPEED if stands else speed:.7f}"
    yield f"$ACC.CP={_LEAST_SPEED if stands else acceleration:.7f}"
    yield "SC_SCANNED=FALSE"
    yield "WHILE NOT SC_SCANNED"
    yield f"  SC_BEGIN({_number(program, sweep)})"
    yield "  $OUT[SC_GATE]=TRUE"
    yield f"  LIN {e6pos(program.T_base_tcp[sweep.end])}"
    yield "  $OUT[SC_GATE]=FALSE"
    yield f"  SC_STOP={e6axis(program.q[sweep.end])}"
    yield "  SC_END( )"
    yield "  IF NOT SC_SCANNED THEN"
    yield f"    LIN {e6pos(program.T_base_tcp[sweep.begin])}"
    yield f"    SC_STOP={e6axis(program.q[sweep.begin])}"
    yield "  ENDIF"
    yield "ENDWHILE"


def _number(program: Program, sweep: Sweep) -> int:
    """Of the view that a sweep is."""
    return int(program.stop[sweep.begin : sweep.end + 1].max())


def _slower(program: Program, options: KrlOptions) -> float:
    """The speed of lines as a fraction of the planned one: as the axis speeds, but never faster than planned."""
    return min(1.0, options.speed_percent / 100 / program.told.speed)


def _data(program: Program, options: KrlOptions) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEFDAT {program.told.name} PUBLIC")
    yield "; KUKA's own routine, declared where KUKA's templates declare it; a KR C2 may not find it otherwise"
    yield "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
    yield "; tool: the scanner frame on the flange, as it was planned; put the calibrated tool here only after planning"
    yield "; again with it, since the joint angles in the program depend on it"
    yield f"DECL FRAME SC_TOOL={frame(program.T_flange_tcp)}"
    yield "; number of $OUT that starts a scan, of $IN that says it is done, of the timer for the time-out"
    yield f"DECL INT SC_TRIGGER={options.signals.trigger_output}"
    if program.sweeps:
        yield "; number of $OUT that is TRUE while a sweep is driven"
        yield f"DECL INT SC_GATE={options.signals.gate_output}"
    yield f"DECL INT SC_DONE={options.signals.done_input}"
    yield f"DECL INT SC_TIMER={options.signals.timer}"
    yield "; standstill before a scan [s], longest wait for the scanner [ms]"
    yield f"DECL REAL SC_SETTLE={options.signals.settle:.3f}"
    yield f"DECL INT SC_TIMEOUT={round(options.signals.timeout * 1000)}"
    yield "; where the last motion ended, and how near to it every axis must stand before the program goes on [deg]"
    yield f"DECL E6AXIS SC_STOP={e6axis(program.q[0])}"
    yield f"DECL REAL SC_NEAR={_AT_STOP_DEG:.3f}"
    yield "; view that is scanned, for the one who reads it after a time-out; 0: none yet"
    yield "DECL INT SC_VIEW=0"
    yield "; whether its scan is done"
    yield "DECL BOOL SC_SCANNED=FALSE"
    yield "ENDDAT"


def _comments(program: Program) -> Iterator[str]:
    """What the program is, and within which limits it moves."""
    yield f"; {program.views} views of {program.told.part}, planned by scan-cell; run folder {program.told.run}"
    yield f"; digest of the plan {program.told.digest}"
    yield "; before it runs: the same robot, tool, base, part and fixtures as in the plan; first in T1 at 10 %"
    if program.q.shape[1] > ARM_AXES:
        yield "; external axes: E1 is the rotary table, 0 where the part stands as below, positive right-handed about z"
        yield "; of its frame; it moves together with A1 to A6; every motion sends E2 to E6 to 0"
    else:
        yield "; external axes: every motion sends E1 to E6 to 0; the plan knows of none"
    if program.T_base_table is not None:
        yield f"; rotary table: its frame in the base of this program is {frame(program.T_base_table)}"
    yield f"; part: its frame in the base of this program is {frame(program.T_base_object)}"
    if np.isfinite(program.told.clearance):
        nearest = f"{program.told.clearance * 1000:.1f} mm ({program.told.between})"
        yield f"; nearest distance found along the planned motion: {nearest}"
    low, high = to_steps(program.q).min(axis=0), to_steps(program.q).max(axis=0)
    bounds = np.degrees(np.stack([program.limits.lower, program.limits.upper]))
    for axis in range(program.q.shape[1]):
        used = f"{low[axis] / STEPS_PER_DEGREE:.4f} to {high[axis] / STEPS_PER_DEGREE:.4f} deg"
        yield f"; {axis_name(axis)} from {used}; planned within {bounds[0, axis]:.1f} to {bounds[1, axis]:.1f}"


def e6axis(q: Floats) -> str:
    """(axes,) joint angles [rad] as an aggregate; external axes that the plan does not have are 0."""
    angles = ",".join(f"{axis_name(axis)} {angle:.4f}" for axis, angle in enumerate(angles_deg(q)))
    return "{E6AXIS: " + angles + _at_0(len(q) - ARM_AXES) + "}"


def _at_0(used: int) -> str:
    """The external axes behind those that are used."""
    return "".join(f",E{axis} 0" for axis in range(used + 1, _MOST_EXTERNAL + 1))


def e6pos(T_base_tcp: Floats) -> str:
    """(4, 4) a pose [m] as an aggregate; without S and T, which LIN does not read."""
    return "{E6POS: " + _xyzabc(T_base_tcp) + _at_0(0) + "}"


def frame(T: Floats) -> str:
    """(4, 4) a transform [m] as an aggregate."""
    return "{X " + _xyzabc(T)[2:] + "}"


def _xyzabc(T: Floats) -> str:
    position, abc = kuka_abc_from_pose(T)
    mm = np.round(position * 1000, 3) + 0.0  # no minus zero
    deg = np.degrees(from_steps(to_steps(abc))) + 0.0
    pieces = [f"{name} {value:.3f}" for name, value in zip("XYZ", mm, strict=True)]
    return ",".join(pieces + [f"{name} {value:.4f}" for name, value in zip("ABC", deg, strict=True)])
