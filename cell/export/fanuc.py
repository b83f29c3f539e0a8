"""Program for controllers of Fanuc as text (LS): `<NAME>.LS` and its routines `<NAME>_S`, `_B`, `_E`, `_C`.

Every position is in joint representation, so neither UFRAME nor UTOOL moves it; a sweep is an L motion whose
orientation is constant. Every J motion has its planned time, made longer by the requested shares of speed and
acceleration. Every motion ends in FINE. Joint angles have three decimals: each is at most 0.0005 deg from the plan.

Axis 3 of these controllers counts against the horizontal: J3 = axis 3 + c * axis 2 of the robot file, where c is the
cosine of the angle between the two axes, -1 in the usual files.

At a view `_B` settles, waits until the scanner's input is off and sets the trigger; `_E` waits for the input and resets
the trigger. After a time-out the program pauses with a message; continued, it repeats the scan. Before each trigger
`_C` pauses unless every axis is within 0.1 deg of the last stop.

Used registers: R[190] view, R[191] whether it is scanned, R[192] difference, PR[98] position, PR[99] last stop.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from cell.errors import UsageError
from cell.export.options import ExportOptions
from cell.export.program import AT_STOP_DEG, Program, ProgramSettings, Sweep, angles_deg
from cell.export.text import encoded, fixed_lines
from planner.ports import ARM_AXES
from planner.values import Floats

_VIEW, _SCANNED, _DIFFERENCE = "R[190:view]", "R[191:scanned]", "R[192:difference]"
_NOW, _STOP = 98, 99
_MAX_COMMENT = 32
_MAX_MS = 32000  # of a motion time in msec; longer times are in tenths of a second
_PARALLEL = 1e-6


def files(name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]) -> dict[str, bytes]:
    """Return the program and its routines. For several set-ups `<NAME>` calls their programs and pauses before each.

    Raises:
        UsageError: if a sweep turns, axes 2 and 3 are not parallel or the controller has not the signals.
    """
    name, signals = name.upper(), settings[0].signals
    signals.require_signals("LS", 1, 4096)
    if abs(abs(programs[0].cos_axes_2_3) - 1.0) > _PARALLEL:
        raise UsageError("axes 2 and 3 of this arm are not parallel; choose --format csv or json")
    contents = {
        f"{name}_{letter}": _file(f"{name}_{letter}", statements, ())
        for letter, statements in _routines(name, signals, programs[0].q.shape[1]).items()
    }
    main: list[str] = []
    for number, (program, program_settings) in enumerate(zip(programs, settings, strict=True), start=1):
        program.require_straight_sweeps("an L motion of LS")
        title = program.info.name.upper()
        contents[title] = _file(title, list(_statements(program, program_settings, name)), _positions(program))
        main += [f"MESSAGE[PUT PART FOR SET-UP {number}]", "PAUSE", f"CALL {title}"]
    if len(programs) > 1:
        contents[name] = _file(name, main, ())
    return {f"{title}.LS": encoded(lines) for title, lines in contents.items()}


def _routines(name: str, signals: ExportOptions, n_axes: int) -> dict[str, tuple[str, ...]]:
    """Return the statements of the routines by their letters."""
    trigger, answer = f"DO[{signals.trigger_output}]", f"DI[{signals.done_input}]"
    time_out = f"$WAITTMOUT={round(signals.timeout * 100)}"  # hundredths of a second
    compare = [
        line
        for axis in range(1, n_axes + 1)
        for line in (
            f"{_DIFFERENCE}=PR[{_NOW},{axis}]-PR[{_STOP},{axis}]",
            f"IF {_DIFFERENCE}>{AT_STOP_DEG},JMP LBL[9]",
            f"IF {_DIFFERENCE}<(-{AT_STOP_DEG}),JMP LBL[9]",
        )
    ]
    return {
        "S": ("LBL[1:scan]", f"CALL {name}_B(AR[1])", f"CALL {name}_E", f"IF {_SCANNED}=0,JMP LBL[1]"),
        "B": (
            f"{_VIEW}=AR[1]", "LBL[1:again]", f"WAIT {signals.settle:.2f}(sec)", time_out,
            f"WAIT {answer}=OFF TIMEOUT,LBL[9]", f"CALL {name}_C", f"{trigger}=ON", "END", "LBL[9:answer not reset]",
            "MESSAGE[SCANNER INPUT STILL ON]", "PAUSE", "JMP LBL[1]",
        ),
        "E": (
            f"{_SCANNED}=1", time_out, f"WAIT {answer}=ON TIMEOUT,LBL[9]", f"{trigger}=OFF", "END", "LBL[9:no answer]",
            f"{_SCANNED}=0", f"{trigger}=OFF", "MESSAGE[SCANNER TIME-OUT]", "PAUSE", f"CALL {name}_C",
        ),
        "C": (
            "LBL[1:compare]", f"PR[{_NOW}]=JPOS", *compare, "END", "LBL[9:not at the last stop]",
            "MESSAGE[ARM IS NOT AT STOP]", "PAUSE", "JMP LBL[1]",
        ),
    }  # fmt: skip


def _statements(program: Program, settings: ProgramSettings, name: str) -> Iterator[str]:
    factor, trigger, gate = program.time_factor(settings), settings.signals.trigger_output, settings.signals.gate_output
    yield from _comments([*program.header(), "J3 is against the horizontal", "set PAYLOAD of scanner and bracket"])
    yield from ("UFRAME_NUM=0", "UTOOL_NUM=1", f"DO[{trigger}]=OFF")
    if program.sweeps:
        yield f"DO[{gate}]=OFF"
    yield from _comments(["only from home"])
    yield from (f"PR[{_STOP}]=P[1]", f"CALL {name}_C", "J P[1] 1% FINE")
    for step in program.steps():
        if step.title:
            yield from _comments([step.title])
        yield f"J P[{step.row + 1}] {_duration(step.duration * factor)} FINE"
        if step.view or step.sweep is not None:
            yield f"PR[{_STOP}]=P[{step.row + 1}]"
        if step.sweep is not None:
            yield from _sweep(program, step.sweep, factor, name, gate)
        elif step.view:
            yield f"CALL {name}_S({step.view})"


def _sweep(program: Program, sweep: Sweep, factor: float, name: str, gate: int) -> Iterator[str]:
    """Yield one line between trigger and answer, repeated from its beginning until the scanner answers."""
    view, speed = program.sweep_view(sweep), f"{max(int(sweep.speed * 6000 / factor), 1)}cm/min"
    yield f"LBL[{view}:sweep]"
    yield f"CALL {name}_B({view})"
    yield f"DO[{gate}]=ON"
    yield f"L P[{sweep.end + 1}] {speed} FINE"
    yield f"DO[{gate}]=OFF"
    yield f"PR[{_STOP}]=P[{sweep.end + 1}]"
    yield f"CALL {name}_E"
    yield f"IF {_SCANNED}=1,JMP LBL[{1000 + view}]"
    yield f"L P[{sweep.begin + 1}] {speed} FINE"
    yield f"PR[{_STOP}]=P[{sweep.begin + 1}]"
    yield f"JMP LBL[{view}]"
    yield f"LBL[{1000 + view}:scanned]"


def _duration(seconds: float) -> str:
    """Return the time of a J motion, rounded up."""
    ms = max(int(np.ceil(seconds * 1000)), 1)
    return f"{ms}msec" if ms <= _MAX_MS else f"{np.ceil(seconds * 10) / 10:.1f}sec"


def _comments(sentences: Sequence[str]) -> Iterator[str]:
    """Yield comments of at most 32 characters each, broken between words."""
    for sentence in sentences:
        line = ""
        for word in sentence.replace(";", ",").split():
            if line and len(line) + 1 + len(word) > _MAX_COMMENT:
                yield f"!{line}"
                line = ""
            line = f"{line} {word}".strip()
            while len(line) > _MAX_COMMENT:
                yield f"!{line[:_MAX_COMMENT]}"
                line = line[_MAX_COMMENT:]
        yield f"!{line}"


def _file(name: str, statements: Sequence[str], positions: Sequence[str]) -> Iterator[str]:
    yield f"/PROG  {name}"
    yield from (line.format(count=len(statements)) for line in fixed_lines("fanuc.ls"))
    for number, statement in enumerate(statements, start=1):
        separator = "" if statement.startswith(("J ", "L ")) else "  "
        yield f"{number:4d}:{separator}{statement} ;"
    yield "/POS"
    yield from positions
    yield "/END"


def _positions(program: Program) -> list[str]:
    """Return every via point in joint representation."""
    lines = []
    for row, q in enumerate(program.q):
        lines += [f"P[{row + 1}]{{", "   GP1:", "    UF : 0, UT : 1,"]
        lines += [f"    {', '.join(f'{name}= {angle:9.3f} deg' for name, angle in _angles(q, program.cos_axes_2_3))}"]
        lines += ["};"]
    return lines


def _angles(q: Floats, cos_axes_2_3: float) -> list[tuple[str, float]]:
    """Return names and angles [deg] of (axes,) joint angles [rad] in the controller's convention."""
    angles = angles_deg(q)
    angles[2] += round(cos_axes_2_3) * angles[1]
    names = [f"J{axis + 1}" if axis < ARM_AXES else f"E{axis - ARM_AXES + 1}" for axis in range(len(angles))]
    return [(name, round(angle, 3) + 0.0) for name, angle in zip(names, angles, strict=True)]
