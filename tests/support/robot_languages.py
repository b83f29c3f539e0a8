"""Interpreters of the exported RAPID, URScript and LS programs. They share no code with the exporter.

Each reads the statements that the documentation of its language defines, drives a `Robot` and rejects every other
statement. RAPID and URScript are rewritten as Python and executed; LS is interpreted line by line.
"""

import re
from collections.abc import Callable
from math import degrees, radians
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.robot_programs import Robot

_STEP = 0.01  # between two looks at an input [s]


def _move(robot: Robot, kind: str, axes: list[float], seconds: float) -> None:
    robot.wait(seconds)
    robot.axes = list(axes)
    robot.moves.append((kind, {f"A{axis}": angle for axis, angle in enumerate(axes, start=1)}))
    robot.events.append((kind, robot.now))


def _halt(robot: Robot) -> None:
    robot.events.append(("HALT", robot.now))
    assert robot.operator, "the program halts"
    robot.operator(robot)


def _set_output(robot: Robot, number: int, value: bool) -> None:
    if value != robot.outputs.get(number, False):
        robot.events.append((f"OUT{number}={value}", robot.now))
    robot.outputs[number] = value
    robot.scanner(robot)


def _wait_input(robot: Robot, number: int, value: bool, timeout: float) -> bool:
    """Wait for an input; return whether it came in time."""
    end = robot.now + timeout
    while robot.inputs.get(number, False) != value:
        if robot.now > end:
            return False
        robot.wait(_STEP)
    return True


def _python(lines: list[tuple[int, str]]) -> str:
    """Return statements with their depths as Python."""
    return "\n".join(f"{'    ' * depth}{line}" for depth, line in lines) + "\n"


def run_urscript(files: dict[str, bytes], robot: Robot) -> None:
    """Run the only `.script`."""
    (content,) = (text.decode("ascii") for name, text in files.items() if name.endswith(".script"))
    depth, translated, last = 0, list[tuple[int, str]](), ""
    for raw in content.split("\r\n"):
        line = raw.split("#")[0].strip()
        if not line:
            continue
        if line == "end":
            if last.endswith(":"):
                translated.append((depth, "pass"))
            depth -= 1
            last = line
            continue
        line = re.sub(r"^(global|local) ", "", line)
        line = re.sub(r"\bsc_(trigger|gate|done|settle|timeout|near|view|scanned|stop)\b", r"G.\1", line)
        translated.append((depth, line))
        depth += line.endswith(":")
        last = line
    assert depth == 0, "a block without end"

    def movej(q: list[float], a: float, v: float, t: float = 0.0) -> None:
        _move(robot, "movej", [degrees(angle) for angle in q], t)

    def movel(q: list[float], a: float, v: float) -> None:
        robot.variables.setdefault("speeds", []).append(v)
        _move(robot, "movel", [degrees(angle) for angle in q], 1.0)

    def popup(text: str, title: str, warning: bool, error: bool, blocking: bool) -> None:
        assert blocking
        _halt(robot)

    scope: dict[str, Any] = {
        "G": SimpleNamespace(),
        "d2r": radians,
        "norm": abs,
        "movej": movej,
        "movel": movel,
        "popup": popup,
        "sleep": robot.wait,
        "get_actual_joint_positions": lambda: [radians(angle) for angle in robot.axes],
        "set_standard_digital_out": lambda number, value: _set_output(robot, number, value),
        "get_standard_digital_in": lambda number: robot.inputs.get(number, False),
    }
    exec(_python(translated), scope)
    robot.variables["view"] = scope["G"].view


class _JointTarget:
    """A jointtarget: `robax.rax_1`, ..., `extax.eax_a`."""

    def __init__(self, axes: list[float], external: list[float]) -> None:
        self.axes = [*axes, *(value for value in external if value != 9e9)]
        self.robax = SimpleNamespace(**{f"rax_{axis}": angle for axis, angle in enumerate(axes, start=1)})
        self.extax = SimpleNamespace(eax_a=external[0])


RAPID_SIGNALS = {"scTrigger": 7, "scGate": 9, "scDone": 8}
"""Numbers, in a test's `Robot`, of the signals that the controller knows by name."""


def run_rapid(files: dict[str, bytes], robot: Robot) -> None:
    """Run the routine of the only `.mod`."""
    ((name, text),) = ((name, text.decode("ascii")) for name, text in files.items() if name.endswith(".mod"))
    translated, depth = list[tuple[int, str]](), 0
    lines = [line.split("!")[0].strip() for line in text.split("\r\n")]
    lines = [line for line in lines if line]
    assert lines[0] == f"MODULE {name[:-4]}"
    assert lines[-1] == "ENDMODULE"
    for line in lines[1:-1]:
        if line in ("ENDPROC", "ENDFUNC", "ENDWHILE", "ENDIF"):
            depth -= 1
            continue
        statement, opens = _rapid_statement(line)
        translated.append((depth, statement))
        depth += opens
    assert depth == 0

    def wait_di(signal: int, value: int, seconds: float) -> bool:
        return not _wait_input(robot, signal, bool(value), seconds)

    def move_l(target: _JointTarget, speed: list[float]) -> None:
        robot.variables.setdefault("speeds", []).append(speed[0] / 1000)
        _move(robot, "MoveL", target.axes, 1.0)

    scope: dict[str, Any] = {
        **RAPID_SIGNALS,
        "G": SimpleNamespace(),
        "J": _JointTarget,
        "Abs": abs,
        "CJointT": lambda: _JointTarget(robot.axes[:6], [*robot.axes[6:], 9e9]),
        "move_abs_j": lambda target, seconds: _move(robot, "MoveAbsJ", target.axes, seconds),
        "move_l": move_l,
        "set_do": lambda signal, value: _set_output(robot, signal, bool(value)),
        "wait_di": wait_di,
        "wait_time": robot.wait,
        "halt": lambda: _halt(robot),
    }
    exec(_python(translated), scope)
    scope[f"{name[:-4]}_run"]()
    robot.variables["view"] = scope["G"].scView


def _rapid_value(text: str) -> str:
    """Return an expression of RAPID in Python."""
    text = re.sub(r"\[\[([^\]]*)\],\[([^\]]*)\]\]", r"J([\1],[\2])", text)
    text = re.sub(r"\bNOT\b", "not", text).replace("TRUE", "True").replace("FALSE", "False").replace("9E9", "9e9")
    return re.sub(r"\b(sc(?:Settle|Timeout|Near|Stop|View|Scanned|Late))\b", r"G.\1", text)


def _rapid_statement(line: str) -> tuple[str, bool]:
    """Return a statement of RAPID in Python, and whether it opens a block."""
    forms: list[tuple[str, Callable[[re.Match[str]], tuple[str, bool]]]] = [
        (r"PROC (\w+)\((?:num (\w+))?\)", lambda m: (f"def {m[1]}({m[2] or ''}):", True)),
        (r"FUNC bool (\w+)\(\)", lambda m: (f"def {m[1]}():", True)),
        (r"WHILE (.+) DO", lambda m: (f"while {_rapid_value(m[1])}:", True)),
        (r"IF (.+) THEN", lambda m: (f"if {_rapid_value(m[1])}:", True)),
        (r"PERS tooldata scTool:=\[TRUE,\[\[0,0,0\],\[1,0,0,0\]\],.+\];", lambda m: ("pass", False)),
        (r"(?:CONST|VAR) (?:num|bool) (\w+):=(.+);", lambda m: (f"G.{m[1]} = {_rapid_value(m[2])}", False)),
        (r"VAR jointtarget \w+;", lambda m: ("pass", False)),
        (r"SetDO (\w+),([01]);", lambda m: (f"set_do({m[1]}, {m[2]})", False)),
        (r"ConfL\\Off;", lambda m: ("pass", False)),
        (r"WaitTime (.+);", lambda m: (f"wait_time({_rapid_value(m[1])})", False)),
        (
            r"WaitDI (\w+),([01])\\MaxTime:=(\w+)\\TimeFlag:=(\w+);",
            lambda m: (f"G.{m[4]} = wait_di({m[1]}, {m[2]}, G.{m[3]})", False),
        ),
        (r'TPWrite "[^"]{1,80}"(\\Num:=scView)?;', lambda m: ("pass", False)),
        (r"Stop\\NoRegain;", lambda m: ("halt()", False)),
        (
            r"MoveAbsJ (\[\[.+\]\])\\NoEOffs,v\d+(?:\\T:=([\d.]+))?,fine,scTool;",
            lambda m: (f"move_abs_j({_rapid_value(m[1])}, {m[2] or 1.0})", False),
        ),
        (
            r"MoveL CalcRobT\((\[\[.+\]\]),scTool\),(\[[\d.,]+\]),fine,scTool;",
            lambda m: (f"move_l({_rapid_value(m[1])}, {m[2]})", False),
        ),
        (r"RETURN (.+);", lambda m: (f"return {_rapid_value(m[1])}", False)),
        (r"(scStop|scView|scScanned):=(.+);", lambda m: (f"G.{m[1]} = {_rapid_value(m[2])}", False)),
        (r"(scNow):=(.+);", lambda m: (f"{m[1]} = {_rapid_value(m[2])}", False)),
        (r"(\w+)(?: (\w+))?;", lambda m: (f"{m[1]}({m[2] or ''})", False)),
    ]
    for pattern, translate in forms:
        if match := re.fullmatch(pattern, line):
            return translate(match)
    pytest.fail(f"unknown statement: {line}")


class _Ls:
    """Programs of a controller of Fanuc: statements, labels, positions [deg], registers."""

    def __init__(self, files: dict[str, bytes], robot: Robot) -> None:
        self.robot, self.registers = robot, dict[int, float]()
        self.position_registers: dict[int, list[float]] = {}
        self.programs = {name.removesuffix(".LS"): text.decode("ascii").split("\r\n") for name, text in files.items()}
        self.timeout = 0.0

    def run(self, name: str, argument: int | None = None) -> None:
        lines = self.programs[name]
        assert lines[0] == f"/PROG  {name}"
        begin, end = lines.index("/MN"), lines.index("/POS")
        assert f"LINE_COUNT = {end - begin - 1};" in lines
        positions = self._positions(" ".join(lines[end + 1 : lines.index("/END")]))
        statements = []
        for number, line in enumerate(lines[begin + 1 : end], start=1):
            match = re.fullmatch(r"( *\d+):(.+) ;", line)
            assert match, line
            assert int(match[1]) == number
            statements.append(match[2].strip())
        labels = {
            int(match[1]): row
            for row, line in enumerate(statements)
            if (match := re.fullmatch(r"LBL\[(\d+)(?::.+)?\]", line))
        }
        at = 0
        while at < len(statements):
            target = self._statement(statements[at], positions, argument)
            if target == 0:
                return
            at = at + 1 if target is None else labels[target]

    @staticmethod
    def _positions(text: str) -> dict[int, list[float]]:
        return {
            int(number): [float(angle) for angle in re.findall(r"[JE]\d= *(-?\d+\.\d{3}) deg", body)]
            for number, body in re.findall(r"P\[(\d+)\]\{(.+?)\};", text)
        }

    def _statement(self, line: str, positions: dict[int, list[float]], argument: int | None) -> int | None:
        """Execute a statement; return the label of a jump, or 0 at the end of the program."""
        robot, line = self.robot, re.sub(r"(R\[\d+):\w+\]", r"\1]", line)
        if line.startswith("!"):
            assert len(line) <= 33
        elif match := re.fullmatch(r"LBL\[\d+(?::.+)?\]|UFRAME_NUM=0|UTOOL_NUM=1|MESSAGE\[[^\]]{1,24}\]", line):
            pass
        elif match := re.fullmatch(r"J P\[(\d+)\] (?:(\d+)msec|([\d.]+)sec|1%) FINE", line):
            seconds = float(match[2]) / 1000 if match[2] else float(match[3] or 1.0)
            _move(robot, "J", positions[int(match[1])], seconds)
        elif match := re.fullmatch(r"L P\[(\d+)\] (\d+)cm/min FINE", line):
            robot.variables.setdefault("speeds", []).append(int(match[2]) / 6000)
            _move(robot, "L", positions[int(match[1])], 1.0)
        elif match := re.fullmatch(r"DO\[(\d+)\]=(ON|OFF)", line):
            _set_output(robot, int(match[1]), match[2] == "ON")
        elif match := re.fullmatch(r"WAIT ([\d.]+)\(sec\)", line):
            robot.wait(float(match[1]))
        elif match := re.fullmatch(r"\$WAITTMOUT=(\d+)", line):
            self.timeout = int(match[1]) / 100
        elif match := re.fullmatch(r"WAIT DI\[(\d+)\]=(ON|OFF) TIMEOUT,LBL\[(\d+)\]", line):
            if not _wait_input(robot, int(match[1]), match[2] == "ON", self.timeout):
                return int(match[3])
        elif match := re.fullmatch(r"PR\[(\d+)\]=(JPOS|P\[(\d+)\])", line):
            self.position_registers[int(match[1])] = list(
                robot.axes if match[2] == "JPOS" else positions[int(match[3])]
            )
        elif match := re.fullmatch(r"R\[(\d+)\]=PR\[(\d+),(\d+)\]-PR\[(\d+),(\d+)\]", line):
            a, b = (self.position_registers[int(match[k])][int(match[k + 1]) - 1] for k in (2, 4))
            self.registers[int(match[1])] = a - b
        elif match := re.fullmatch(r"R\[(\d+)\]=(AR\[1\]|\d+)", line):
            self.registers[int(match[1])] = float(argument or 0) if match[2] == "AR[1]" else float(match[2])
        elif match := re.fullmatch(r"IF R\[(\d+)\]([=<>])\(?(-?[\d.]+)\)?,JMP LBL\[(\d+)\]", line):
            value, bound = self.registers[int(match[1])], float(match[3])
            if {"=": value == bound, "<": value < bound, ">": value > bound}[match[2]]:
                return int(match[4])
        elif match := re.fullmatch(r"JMP LBL\[(\d+)\]", line):
            return int(match[1])
        elif match := re.fullmatch(r"CALL (\w+)(?:\((AR\[1\]|\d+)\))?", line):
            self.run(match[1], argument if match[2] == "AR[1]" else int(match[2] or 0))
        elif line == "PAUSE":
            _halt(robot)
        elif line == "END":
            return 0
        else:
            pytest.fail(f"unknown statement: {line}")
        return None


def run_ls(files: dict[str, bytes], robot: Robot) -> None:
    """Run the program with the shortest name."""
    machine = _Ls(files, robot)
    machine.run(min(machine.programs, key=len))
    robot.variables["view"] = machine.registers[190]
