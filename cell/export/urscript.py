"""Program in URScript for Universal Robots: `<name>.script`, one function that is called at its end.

Every motion has joint angles (`d2r` of degrees), so no TCP moves a target; a sweep is a movel to joint angles whose
orientation is constant. The time of every movej is the planned one, made longer by the requested shares of speed and
acceleration. No motion is blended.

At a view the program settles, waits until the scanner's input is off, sets the trigger output, waits for the input and
resets the trigger. After a time-out a message halts the program until a person confirms; then the scan is repeated.
Before each trigger every joint must be within `sc_near` of the last stop, else the program halts again.
"""

from collections.abc import Iterator, Sequence

from cell.errors import UsageError
from cell.export.program import AT_STOP_DEG, Program, ProgramSettings, Sweep, angles_deg
from cell.export.text import encoded, fixed_lines
from planner.ports import ARM_AXES
from planner.values import Floats

_LAST_SIGNAL = 7
_MIN_SPEED = 0.001  # of a line [m/s]


def files(name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]) -> dict[str, bytes]:
    """Return `<name>.script`. It halts before each of several set-ups.

    Raises:
        UsageError: if a sweep turns, the cell has a rotary table, or the controller has not the signals.
    """
    if programs[0].q.shape[1] > ARM_AXES:
        raise UsageError(
            "URScript moves no external axis, and the plan turns a rotary table; choose --format csv or json"
        )
    settings[0].signals.require_signals("URScript", 0, _LAST_SIGNAL)
    for program in programs:
        program.require_straight_sweeps("a movel of URScript")
    return {f"{name}.script": encoded(_script(name, programs, settings))}


def _script(name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]) -> Iterator[str]:
    signals = settings[0].signals
    yield "# joint angles are those of the robot file: compare one position with the pendant before the first run"
    yield "# enter the payload of scanner and bracket in the installation"
    yield f"def {name}():"
    yield "  # outputs that start a scan and are on during a sweep, input that reports the end of a scan"
    yield f"  global sc_trigger = {signals.trigger_output}"
    yield f"  global sc_gate = {signals.gate_output}"
    yield f"  global sc_done = {signals.done_input}"
    yield "  # settling time before a scan [s], time-out of the scanner [s], largest deviation at a stop [rad]"
    yield f"  global sc_settle = {signals.settle:.3f}"
    yield f"  global sc_timeout = {signals.timeout:.3f}"
    yield f"  global sc_near = d2r({AT_STOP_DEG:.3f})"
    yield "  global sc_view = 0"
    yield "  global sc_scanned = False"
    yield f"  global sc_stop = {_joints(programs[0].q[0])}"
    yield from fixed_lines("urscript.script")
    yield "  set_standard_digital_out(sc_trigger, False)"
    if any(program.sweeps for program in programs):
        yield "  set_standard_digital_out(sc_gate, False)"
    for number, (program, program_settings) in enumerate(zip(programs, settings, strict=True), start=1):
        yield ""
        yield from (f"  # {sentence}" for sentence in program.header())
        if len(programs) > 1:
            yield f'  popup("Put the part at the place of set-up {number}.", "scan-cell", True, False, True)'
        yield from _motions(program, program.time_factor(program_settings))
    yield from ("end", f"{name}()")


def _motions(program: Program, factor: float) -> Iterator[str]:
    """Yield the motions and scans of one set-up; motions take `factor` times as long as planned."""
    home = _joints(program.q[0])
    yield "  # the path to home was not checked: the program continues only from home"
    yield f"  sc_stop = {home}"
    yield "  sc_stand()"
    yield f"  movej({home}, 0.1, 0.1)"
    for step in program.steps():
        if step.title:
            yield f"  # {step.title}"
        target = _joints(program.q[step.row])
        yield f"  movej({target}, 1.4, 1.05, {step.duration * factor:.3f})"
        if step.view or step.sweep is not None:
            yield f"  sc_stop = {target}"
        if step.sweep is not None:
            yield from _sweep(program, step.sweep, factor)
        elif step.view:
            yield f"  sc_scan({step.view})"


def _sweep(program: Program, sweep: Sweep, factor: float) -> Iterator[str]:
    """Yield one line between trigger and answer, repeated from its beginning until the scanner answers."""
    speed = max(sweep.speed / factor, _MIN_SPEED)
    acceleration = max(sweep.acceleration / factor**2, _MIN_SPEED)
    begin, end = _joints(program.q[sweep.begin]), _joints(program.q[sweep.end])
    yield "  sc_scanned = False"
    yield "  while not sc_scanned:"
    yield f"    sc_begin({program.sweep_view(sweep)})"
    yield "    set_standard_digital_out(sc_gate, True)"
    yield f"    movel({end}, {acceleration:.7f}, {speed:.7f})"
    yield "    set_standard_digital_out(sc_gate, False)"
    yield f"    sc_stop = {end}"
    yield "    sc_end()"
    yield "    if not sc_scanned:"
    yield f"      movel({begin}, {acceleration:.7f}, {speed:.7f})"
    yield f"      sc_stop = {begin}"
    yield "    end"
    yield "  end"


def _joints(q: Floats) -> str:
    """Return (6,) joint angles [rad] as a list."""
    return "[" + ", ".join(f"d2r({angle:.4f})" for angle in angles_deg(q)) + "]"
