r"""Program in KRL: `<name>.src` with the motion, `<name>.dat` with the numbers that are changed at commissioning.

Plain KRL without inline forms compiles without the pendant's parameter lists. Every motion is an exact stop, because
only the straight moves between the via points were checked for collision. `$ADVANCE=0` keeps the interpreter from
running ahead of the arm. At a view:

    WAIT SEC settle                          the arm settles
    $OUT[trigger]=TRUE                       the scan starts
    WAIT FOR $IN[done] OR $TIMER_FLAG[n]     the scanner answers or the time-out ends. WAIT FOR has no time-out of its
                                             own: a timer counts up from -time-out; its flag is TRUE above 0
    $OUT[trigger]=FALSE

A sweep is one LIN from rest to rest between trigger and answer; `$OUT[gate]` is TRUE during the motion. Its
orientation is constant. Between two orientations KRL swivels the tool direction and turns about it, which in general
is not the planned turn about one axis; a sweep that turns is therefore refused.

After a time-out the program halts. Start repeats the scan; a sweep first returns with a LIN to its beginning. Before
every trigger and before that LIN, each axis must be at the end of the last motion (`SC_STOP`); if the arm was jogged
while the program was halted, it halts again. The scanner resets its answer when the trigger falls. The trigger
rises only after the answer to the previous view is gone.

The routines are those of `krl.src`, which ends in the function that compares the axes with `SC_STOP`:

    SC_SCAN(n)     scan view n at rest; repeat after each time-out
    SC_BEGIN(n)    settle, wait until the previous answer is gone, trigger
    SC_END()       wait for the answer or the time-out, reset the trigger
    SC_STAND()     halt until the arm is at the end of the last motion, `SC_STOP`
    SC_CLOCK()     start the time-out

Numbers: joint angles exact to 1e-4 deg, lengths to 1e-3 mm, angles of frames to 1e-4 deg (a REAL of KRL has 7
digits). Lines end with CR LF; characters are ASCII.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from cell.errors import UsageError
from cell.export.program import AT_STOP_DEG, Program, ProgramSettings, Sweep, angles_deg
from cell.export.text import encoded, fixed_lines
from planner.kinematics.frames import kuka_abc_from_pose
from planner.kinematics.setpoints import from_steps, to_steps
from planner.ports import ARM_AXES, axis_name
from planner.values import Floats

_MAX_EXTERNAL_AXES = 6
_MIN_LINE_SPEED = 0.001  # of a line without length: KRL accepts no speed 0 [m/s]
_BEGIN = (
    ";FOLD INI",
    ";FOLD BASISTECH INI",
    "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "INTERRUPT ON 3",
    "BAS (#INITMOV,0 )",
    ";ENDFOLD (BASISTECH INI)",
    ";ENDFOLD (INI)",
)
"""Initialisation of KUKA's templates."""


def files(name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]) -> dict[str, bytes]:
    """Return `.src` and `.dat` of each set-up; for several also the `<name>.src` that calls them.

    It halts before each. During the halt, $BASE is the part's frame in the next set-up: the pendant shows where the
    part has to lie.

    Raises:
        UsageError: if the arm's axes are not KUKA's, a sweep turns or the controller has not the signals.
    """
    contents: dict[str, bytes] = {}
    for program, program_settings in zip(programs, settings, strict=True):
        contents[f"{program.info.name}.src"] = source(program, program_settings)
        contents[f"{program.info.name}.dat"] = data(program, program_settings)
    if len(programs) > 1:
        contents[f"{name}.src"] = encoded(_main(name, programs))
    return contents


def source(program: Program, settings: ProgramSettings) -> bytes:
    """Return the content of `<name>.src`."""
    if program.status is None:
        raise UsageError("KRL drives only arms with KUKA's axes, and this arm has others; choose another --format")
    settings.signals.require_signals("KRL", 1, 4096)
    program.require_straight_sweeps("a LIN of KRL")
    return encoded(_source(program, settings))


def data(program: Program, settings: ProgramSettings) -> bytes:
    """Return the content of `<name>.dat`."""
    return encoded(_data(program, settings))


def _main(name: str, programs: Sequence[Program]) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEF {name}( )")
    yield f"; {len(programs)} set-ups of {programs[0].info.part}, planned by scan-cell; each begins and ends at home"
    yield from _BEGIN
    for number, program in enumerate(programs, start=1):
        yield from ("", f"; set-up {number}: {program.n_views} views; digest of the plan {program.info.digest}")
        yield f"$BASE={frame(program.T_base_object)}"
        yield f"HALT ; set-up {number}: put the part where its frame is $BASE, then start again"
        yield f"{program.info.name}( )"
    yield from ("", "END")


def _source(program: Program, settings: ProgramSettings) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEF {program.info.name}( )")
    yield from _head(program)
    yield from _BEGIN
    yield f"BAS(#VEL_PTP,{settings.speed_percent})"
    yield f"BAS(#ACC_PTP,{settings.acceleration_percent})"
    yield "; base: the robot's foot, equal to the world if $ROBROOT is zero; motions between views are in axis angles,"
    yield "; which do not depend on the base"
    yield "$BASE={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}"
    yield "$TOOL=SC_TOOL"
    if program.sweeps:
        yield "; the orientation is constant along a line; the base does not move"
        yield from ("$ORI_TYPE=#CONSTANT", "$IPO_MODE=#BASE")
    yield "; no advance run; every motion ends in an exact stop"
    yield "$ADVANCE=0"
    yield "$OUT[SC_TRIGGER]=FALSE"
    if program.sweeps:
        yield "$OUT[SC_GATE]=FALSE"
    yield ""
    yield "; the path to home was not checked: the program continues only from home"
    yield f"SC_STOP={e6axis(program.q[0])}"
    yield "SC_STAND( )"
    yield f"PTP {e6axis(program.q[0])} ; home: block coincidence"
    # Lines slow down with the axes, but are never faster than planned.
    speed_factor = min(1.0, settings.speed_percent / 100 / program.info.speed)
    for step in program.steps():
        if step.title:
            yield from ("", f"; {step.title}")
        goal = e6axis(program.q[step.row])
        yield f"PTP {goal}"
        if step.view or step.sweep is not None:
            # SC_STOP is set after the motion, which names its own goal: if a person selects another line of the
            # program, no motion goes to an old stop.
            yield f"SC_STOP={goal}"
        if step.sweep is not None:
            yield from _sweep(program, step.sweep, speed_factor)
        elif step.view:
            yield f"SC_SCAN({step.view}) ; candidate {program.candidate[step.row]}"
    yield from ("", "END", "")
    yield from fixed_lines("krl.src")
    for axis in range(program.q.shape[1]):
        name = axis_name(axis)
        yield from (f"IF ABS($AXIS_ACT.{name}-SC_STOP.{name})>SC_NEAR THEN", "   RETURN FALSE", "ENDIF")
    yield from ("RETURN TRUE", "ENDFCT")


def _sweep(program: Program, sweep: Sweep, speed_factor: float) -> Iterator[str]:
    """Yield one line between trigger and answer, repeated from its beginning until the scanner answers.

    A line that takes s times as long has 1/s of the speed and 1/s^2 of the acceleration. The length of its ramps stays
    the same, so the speed is constant from the first measuring pose to the last.
    """
    rows = slice(sweep.begin, sweep.end + 1)
    n_poses, candidate = int((program.pose[rows] >= 0).sum()), int(program.candidate[rows].max())
    speed, acceleration = sweep.speed * speed_factor, sweep.acceleration * speed_factor**2
    has_length = sweep.speed >= _MIN_LINE_SPEED
    yield f"; sweep of candidate {candidate}: {n_poses} poses at {speed * 1000:.3f} mm/s"
    yield f"$VEL.CP={speed if has_length else _MIN_LINE_SPEED:.7f}"
    yield f"$ACC.CP={acceleration if has_length else _MIN_LINE_SPEED:.7f}"
    yield "SC_SCANNED=FALSE"
    yield "WHILE NOT SC_SCANNED"
    yield f"   SC_BEGIN({program.sweep_view(sweep)})"
    yield "   $OUT[SC_GATE]=TRUE"
    yield f"   LIN {e6pos(program.T_base_tcp[sweep.end])}"
    yield "   $OUT[SC_GATE]=FALSE"
    yield f"   SC_STOP={e6axis(program.q[sweep.end])}"
    yield "   SC_END( )"
    yield "   IF NOT SC_SCANNED THEN"
    yield f"      LIN {e6pos(program.T_base_tcp[sweep.begin])}"
    yield f"      SC_STOP={e6axis(program.q[sweep.begin])}"
    yield "   ENDIF"
    yield "ENDWHILE"


def _data(program: Program, settings: ProgramSettings) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEFDAT {program.info.name} PUBLIC")
    yield "; KUKA's own routine, declared where KUKA's templates declare it; a KR C2 may not find it otherwise"
    yield "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
    yield "; tool: the planned scanner frame on the flange; the joint angles in the program depend on it: if the"
    yield "; calibrated tool differs, plan again with it"
    yield f"DECL FRAME SC_TOOL={frame(program.T_flange_tcp)}"
    yield "; numbers: $OUT that starts a scan, $IN that reports its end, timer for the time-out"
    yield f"DECL INT SC_TRIGGER={settings.signals.trigger_output}"
    if program.sweeps:
        yield "; number of $OUT that is TRUE during a sweep"
        yield f"DECL INT SC_GATE={settings.signals.gate_output}"
    yield f"DECL INT SC_DONE={settings.signals.done_input}"
    yield f"DECL INT SC_TIMER={settings.signals.timer}"
    yield "; settling time before a scan [s], time-out of the scanner [ms]"
    yield f"DECL REAL SC_SETTLE={settings.signals.settle:.3f}"
    yield f"DECL INT SC_TIMEOUT={round(settings.signals.timeout * 1000)}"
    yield "; end of the last motion, and the largest deviation of each axis at which the program continues [deg]"
    yield f"DECL E6AXIS SC_STOP={e6axis(program.q[0])}"
    yield f"DECL REAL SC_NEAR={AT_STOP_DEG:.3f}"
    yield "; current view, to be read after a time-out; 0: none yet"
    yield "DECL INT SC_VIEW=0"
    yield "; TRUE if its scan is done"
    yield "DECL BOOL SC_SCANNED=FALSE"
    yield "ENDDAT"


def _head(program: Program) -> Iterator[str]:
    """Yield comments on the plan, the frames and the range of each axis."""
    info = program.info
    yield f"; {program.n_views} views of {info.part}, planned by scan-cell; run folder {info.run}"
    yield f"; digest of the plan {info.digest}"
    yield "; before a start: the same robot, tool, base, part and fixtures as in the plan; first in T1 at 10 %"
    if program.q.shape[1] > ARM_AXES:
        yield "; external axes: E1 is the rotary table, 0 at the part frame below, positive right-handed about z of its"
        yield "; frame; it moves together with A1 to A6; every motion sends E2 to E6 to 0"
    else:
        yield "; external axes: every motion sends E1 to E6 to 0; the plan has none"
    if program.T_base_table is not None:
        yield f"; rotary table: its frame in the base of this program is {frame(program.T_base_table)}"
    yield f"; part: its frame in the base of this program is {frame(program.T_base_object)}"
    if np.isfinite(info.clearance):
        yield f"; smallest distance along the planned motion: {info.clearance * 1000:.1f} mm ({info.between})"
    yield from (f"; {sentence}" for sentence in program.axis_ranges())


def e6axis(q: Floats) -> str:
    """Return (axes,) joint angles [rad] as an aggregate; external axes that the plan does not have are 0."""
    angles = ",".join(f"{axis_name(axis)} {angle:.4f}" for axis, angle in enumerate(angles_deg(q)))
    return "{E6AXIS: " + angles + _unused_axes(len(q) - ARM_AXES) + "}"


def _unused_axes(n_used: int) -> str:
    return "".join(f",E{axis} 0" for axis in range(n_used + 1, _MAX_EXTERNAL_AXES + 1))


def e6pos(T_base_tcp: Floats) -> str:
    """Return a (4, 4) pose [m] as an aggregate without S and T, which LIN ignores."""
    return "{E6POS: " + _xyzabc(T_base_tcp) + _unused_axes(0) + "}"


def frame(T: Floats) -> str:
    """Return a (4, 4) transform [m] as an aggregate."""
    return "{X " + _xyzabc(T)[2:] + "}"


def _xyzabc(T: Floats) -> str:
    position, abc = kuka_abc_from_pose(T)
    mm = np.round(position * 1000, 3) + 0.0  # no minus zero
    deg = np.degrees(from_steps(to_steps(abc))) + 0.0
    pieces = [f"{name} {value:.3f}" for name, value in zip("XYZ", mm, strict=True)]
    return ",".join(pieces + [f"{name} {value:.4f}" for name, value in zip("ABC", deg, strict=True)])
