"""Interpreter of exported KRL programs. It shares no code with the exporter.

It reads plain KRL (declarations, IF, WHILE, calls, WAIT, motions), has a clock, inputs and outputs, and rejects every
unknown statement.
"""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.support.robot_programs import Robot


class _Return(Exception):  # noqa: N818 - control flow of the interpreter, not an error
    pass


class _Struct(dict[str, float]):
    """An aggregate; `name.A1` reads a component."""

    def __getattr__(self, component: str) -> float:
        return self[component]


class Krl:
    """One module: `.src` and `.dat`."""

    def __init__(self, src: bytes, dat: bytes, robot: Robot) -> None:
        assert src.endswith(b"\r\n")
        assert src.count(b"\n") == src.count(b"\r\n")
        self.robot = robot
        self.routines: dict[str, tuple[list[str], list[str]]] = {}
        lines = self._lines(dat)
        assert re.fullmatch(r"DEFDAT (\w+) PUBLIC", lines[0])
        assert lines[-1] == "ENDDAT"
        assert lines[1] == "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
        for line in lines[2:-1]:
            match = re.fullmatch(r"DECL (INT|REAL|FRAME|BOOL|E6AXIS) (\w+)=(.+)", line)
            assert match, line
            assert len(match[2]) <= 24
            robot.variables[match[2]] = self._value(match[3])
        current: list[str] | None = None
        for line in self._lines(src):
            match = re.fullmatch(r"(?:DEF|DEFFCT \w+) (\w+)\s*\((.*)\)", line)
            if match:
                assert current is None
                assert len(match[1]) <= 24
                parameters = [piece.split(":")[0].strip() for piece in match[2].split(",") if piece.strip()]
                current = []
                self.routines[match[1]] = (parameters, current)
            elif line in ("END", "ENDFCT"):
                assert current is not None
                current = None
            else:
                assert current is not None, line
                current.append(line)
        self.name = next(iter(self.routines))

    @staticmethod
    def _lines(content: bytes) -> list[str]:
        """Statements without comments, folds and file attributes."""
        lines = [line.split(";")[0].strip() for line in content.decode("ascii").split("\r\n")]
        return [line for line in lines if line and not line.startswith("&")]

    def run(self) -> None:
        """Run the main routine."""
        self._call(self.name, [])

    def _call(self, name: str, arguments: list[Any]) -> Any:
        parameters, body = self.routines[name]
        self.robot.variables |= dict(zip(parameters, arguments, strict=True))
        try:
            self._block(body, 0, len(body))
        except _Return as back:
            return back.args[0]
        return None

    def _block(self, body: list[str], first: int, last: int) -> None:
        at = first
        while at < last:
            line = body[at]
            if match := re.fullmatch(r"WHILE (.+)", line):
                end = self._end(body, at, "WHILE", "ENDWHILE")
                for _ in range(10_000):
                    if not self._value(match[1]):
                        break
                    self._block(body, at + 1, end)
                else:
                    pytest.fail("an endless loop")
                at = end
            elif match := re.fullmatch(r"IF (.+) THEN", line):
                end = self._end(body, at, "IF", "ENDIF")
                if self._value(match[1]):
                    self._block(body, at + 1, end)
                at = end
            else:
                self._statement(line)
            at += 1

    @staticmethod
    def _end(body: list[str], at: int, begin: str, end: str) -> int:
        depth = 0
        for row in range(at, len(body)):
            depth += body[row].split()[0] == begin
            depth -= body[row] == end
            if depth == 0:
                return row
        pytest.fail(f"{begin} without {end}")

    def _statement(self, line: str) -> None:
        robot = self.robot
        if match := re.fullmatch(r"(PTP|LIN) (\{.+\})", line):
            goal = self._value(match[2])
            robot.wait(1.0)
            if match[1] == "PTP":
                robot.axes = [goal[f"A{axis}"] for axis in range(1, 7)]
            else:
                assert robot.line, "unexpected LIN"
                robot.axes = robot.line(robot, goal)
            robot.moves.append((match[1], goal))
            robot.events.append((match[1], robot.now))
        elif match := re.fullmatch(r"WAIT SEC (.+)", line):
            robot.wait(self._value(match[1]))
        elif match := re.fullmatch(r"WAIT FOR (.+)", line):
            for _ in range(100_000):
                if self._value(match[1]):
                    return
                robot.wait(0.012)
            pytest.fail(f"waits forever: {line}")
        elif match := re.fullmatch(r"\$(OUT|TIMER|TIMER_STOP)\[(.+?)\]=(.+)", line):
            number, value = self._value(match[2]), self._value(match[3])
            if match[1] == "OUT":
                if value != robot.outputs.get(number, False):
                    robot.events.append((f"OUT{number}={value}", robot.now))
                robot.outputs[number] = value
                robot.scanner(robot)
            elif match[1] == "TIMER":
                robot.timers[number] = robot.now - value / 1000
        elif match := re.fullmatch(r"\$(ORI_TYPE|IPO_MODE)=#\w+", line):
            robot.variables[match[1]] = match[0].split("#")[1]
        elif match := re.fullmatch(r"(\$?[A-Z_.]+(?:\.\w+)?)=(.+)", line):
            robot.variables[match[1]] = self._value(match[2])
        elif match := re.fullmatch(r"RETURN (.+)", line):
            raise _Return(self._value(match[1]))
        elif line == "HALT":
            robot.events.append(("HALT", robot.now))
            assert robot.operator, "the program halts"
            robot.operator(robot)
        elif match := re.fullmatch(r"BAS ?\(#(\w+),(\d+) ?\)", line):
            robot.variables[match[1]] = int(match[2])
        elif match := re.fullmatch(r"(\w+)\((.*)\)", line):
            self._call(match[1], [self._value(match[2])] if match[2].strip() else [])
        else:
            known = (
                r"(GLOBAL INTERRUPT DECL 3 WHEN \$STOPMESS==TRUE DO IR_STOPM \( \)|INTERRUPT ON 3|DECL (INT|BOOL) \w+)"
            )
            assert re.fullmatch(known, line), f"unknown statement: {line}"

    def _value(self, text: str) -> Any:
        text = text.strip()
        if text.startswith("{"):
            inner = re.sub(r"^\w+:", "", text[1:-1].strip())
            return _Struct((name, float(number)) for name, number in (piece.split() for piece in inner.split(",")))
        robot = self.robot
        scope = {
            "IN": _Signals(robot.inputs),
            "TIMER_FLAG": _Flags(robot),
            "AXIS_ACT": type("Axes", (), {f"A{axis}": angle for axis, angle in enumerate(robot.axes, start=1)}),
            "ABS": abs,
            "TRUE": True,
            "FALSE": False,
            **{name: value for name, value in robot.variables.items() if name.isidentifier()},
            **{name: (lambda n: lambda: self._call(n, []))(name) for name in self.routines},
        }
        python = re.sub(r"\b(NOT|AND|OR)\b", lambda word: word[0].lower(), text.replace("$", ""))
        return eval(python, {"__builtins__": {}}, scope)


class _Signals:
    def __init__(self, values: dict[int, bool]) -> None:
        self._values = values

    def __getitem__(self, number: int) -> bool:
        return self._values.get(number, False)


class _Flags:
    """`$TIMER_FLAG[n]`: whether the timer is above 0."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def __getitem__(self, number: int) -> bool:
        return self._robot.now > self._robot.timers[number]


def straight_line(kinematics: Any) -> Callable[[Robot, dict[str, float]], list[float]]:
    """Return a function for the axes after a LIN: the configuration of the goal nearest to the start."""
    from planner.kinematics.frames import pose_from_kuka_abc

    def frame(of: dict[str, float]) -> np.ndarray:
        return pose_from_kuka_abc([of[axis] / 1000 for axis in "XYZ"], np.radians([of[angle] for angle in "ABC"]))

    def drive(robot: Robot, goal: dict[str, float]) -> list[float]:
        assert robot.variables["ORI_TYPE"] == "CONSTANT"
        T = frame(robot.variables["$BASE"]) @ frame(goal) @ np.linalg.inv(frame(robot.variables["$TOOL"]))
        T[3] = (0, 0, 0, 1)
        now = np.radians(robot.axes)
        solutions = kinematics.inverse(T[None])[0]
        solutions = solutions[~np.isnan(solutions).any(axis=1)]
        solutions += 2 * np.pi * np.round((now - solutions) / (2 * np.pi))
        return np.degrees(solutions[np.abs(solutions - now).max(axis=1).argmin()]).tolist()

    return drive


def run_krl(files: dict[str, bytes], robot: Robot) -> None:
    """Run the module with the only `.dat`."""
    ((name, dat),) = ((name, text) for name, text in files.items() if name.endswith(".dat"))
    Krl(files[f"{name[:-4]}.src"], dat, robot).run()
