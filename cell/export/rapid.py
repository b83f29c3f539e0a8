r"""Program in RAPID for controllers of ABB: the module `<name>.mod` with the routine `<name>_run`.

Every motion has a jointtarget, so neither tool nor work object moves a target; a sweep is a MoveL whose orientation is
constant. `\T` gives every joint motion its planned time, made longer by the requested shares of speed and acceleration.
Every motion ends in a stop point (`fine`). The signals scTrigger, scDone and, for sweeps, scGate are digital signals of
the controller's I/O configuration.

At a view the module waits `scSettle`, waits until scDone is off, sets scTrigger, waits for scDone and resets scTrigger.
After a time-out it stops with a message; Start repeats the scan. `Stop\NoRegain` keeps the arm from returning by itself
to the stop position. Before each trigger every axis must be within `scNear` of the last stop, else it stops again.
"""

from collections.abc import Iterator, Sequence

from cell.export.program import AT_STOP_DEG, Program, ProgramSettings, Sweep, angles_deg
from cell.export.text import encoded, fixed_lines
from planner.ports import ARM_AXES
from planner.values import Floats

_UNUSED_AXIS = "9E9"
_N_EXTERNAL_AXES = 6
_LINE = (500, 5000, 1000)  # orientation [deg/s] and external axes [mm/s, deg/s] of speeddata


def files(name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]) -> dict[str, bytes]:
    """Return `<name>.mod`. Its routine `<name>_run` stops before each of several set-ups.

    Raises:
        UsageError: if a sweep turns.
    """
    for program in programs:
        program.require_straight_sweeps("a MoveL of RAPID")
    return {f"{name}.mod": encoded(_module(name, programs, settings))}


def _module(name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]) -> Iterator[str]:
    signals, n_axes = settings[0].signals, programs[0].q.shape[1]
    yield f"MODULE {name}"
    yield "  ! joint angles are those of the robot file: compare one position with the pendant before the first run"
    if n_axes > ARM_AXES:
        yield "  ! eax_a is the rotary table [deg]"
    yield "  ! flange frame; enter mass [kg] and centre of gravity [mm] of scanner and bracket"
    yield "  PERS tooldata scTool:=[TRUE,[[0,0,0],[1,0,0,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];"
    yield "  ! settling time before a scan [s], time-out of the scanner [s], largest deviation at a stop [deg]"
    yield f"  CONST num scSettle:={signals.settle:.3f};"
    yield f"  CONST num scTimeout:={signals.timeout:.3f};"
    yield f"  CONST num scNear:={AT_STOP_DEG:.3f};"
    yield "  VAR jointtarget scStop;"
    yield "  VAR num scView:=0;"
    yield "  VAR bool scScanned:=FALSE;"
    yield "  VAR bool scLate:=FALSE;"
    if len(programs) > 1:
        yield from ("", f"  PROC {name}_run()")
        for number, program in enumerate(programs, start=1):
            yield f'    TPWrite "set-up {number}: put the part at its place, then start";'
            yield "    Stop\\NoRegain;"
            yield f"    {program.info.name}_run;"
        yield "  ENDPROC"
    for program, program_settings in zip(programs, settings, strict=True):
        yield from _routine(program, program.time_factor(program_settings))
    yield from fixed_lines("rapid.mod")
    places = [f"robax.rax_{axis + 1}" for axis in range(ARM_AXES)] + ["extax.eax_a"] * (n_axes - ARM_AXES)
    for place in places:
        yield f"    IF Abs(scNow.{place}-scStop.{place})>scNear THEN"
        yield "      RETURN FALSE;"
        yield "    ENDIF"
    yield from ("    RETURN TRUE;", "  ENDFUNC", "ENDMODULE")


def _routine(program: Program, factor: float) -> Iterator[str]:
    """Yield the routine of one set-up; its motions take `factor` times as long as planned."""
    home = _jointtarget(program.q[0])
    yield ""
    yield from (f"  ! {sentence}" for sentence in program.header())
    yield f"  PROC {program.info.name}_run()"
    yield "    SetDO scTrigger,0;"
    if program.sweeps:
        yield "    SetDO scGate,0;"
        yield "    ConfL\\Off;"
    yield "    ! the path to home was not checked: the program continues only from home"
    yield f"    scStop:={home};"
    yield "    scStand;"
    yield f"    MoveAbsJ {home}\\NoEOffs,v10,fine,scTool;"
    for step in program.steps():
        if step.title:
            yield f"    ! {step.title}"
        target = _jointtarget(program.q[step.row])
        yield f"    MoveAbsJ {target}\\NoEOffs,v100\\T:={step.duration * factor:.3f},fine,scTool;"
        if step.view or step.sweep is not None:
            yield f"    scStop:={target};"
        if step.sweep is not None:
            yield from _sweep(program, step.sweep, factor)
        elif step.view:
            yield f"    scScan {step.view};"
    yield "  ENDPROC"


def _sweep(program: Program, sweep: Sweep, factor: float) -> Iterator[str]:
    """Yield one line between trigger and answer, repeated from its beginning until the scanner answers."""
    speed = f"[{max(sweep.speed * 1000 / factor, 1.0):.3f},{','.join(str(value) for value in _LINE)}]"
    begin, end = _jointtarget(program.q[sweep.begin]), _jointtarget(program.q[sweep.end])
    yield "    scScanned:=FALSE;"
    yield "    WHILE NOT scScanned DO"
    yield f"      scBegin {program.sweep_view(sweep)};"
    yield "      SetDO scGate,1;"
    yield f"      MoveL CalcRobT({end},scTool),{speed},fine,scTool;"
    yield "      SetDO scGate,0;"
    yield f"      scStop:={end};"
    yield "      scEnd;"
    yield "      IF NOT scScanned THEN"
    yield f"        MoveL CalcRobT({begin},scTool),{speed},fine,scTool;"
    yield f"        scStop:={begin};"
    yield "      ENDIF"
    yield "    ENDWHILE"


def _jointtarget(q: Floats) -> str:
    """Return (axes,) joint angles [rad] as an aggregate in degrees."""
    angles = [f"{angle:.4f}" for angle in angles_deg(q)]
    external = angles[ARM_AXES:] + [_UNUSED_AXIS] * (_N_EXTERNAL_AXES - len(angles) + ARM_AXES)
    return f"[[{','.join(angles[:ARM_AXES])}],[{','.join(external)}]]"
