"""Interpreter of KRL: the statements that `drivers.wires.kvp_program` uses, translated into Python generators.

A generator yields True between statements and False where it waits for time or motion. Between any two statements a
client may read and write variables, as on a controller, where the interpreter and the proxy run side by side.
"""

import re
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final

Steps = Generator[bool, None, None]

_WORDS: Final = {"AND": "and", "OR": "or", "NOT": "not", "TRUE": "True", "FALSE": "False"}
_TOKEN: Final = re.compile(r"(?P<enum>#\w+)|(?P<part>\.[A-Za-z_]\w*)|(?P<name>\$?[A-Za-z_]\w*)|(?P<differs><>)")
_LITERAL: Final = re.compile(r"\s*([{},:]|#\w+|[A-Za-z_]\w*|-?\d+(?:\.\d*)?(?:[Ee][-+]?\d+)?)")
_PLACE: Final = re.compile(r"(\$?[A-Z_]\w*)(?:\[(\d+)\])?(?:\.([A-Z_]\w*))?")


class Struct(dict[str, Any]):
    """An aggregate whose components are attributes too."""

    __setattr__ = dict.__setitem__

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None


class Resume(Exception):  # noqa: N818  the statement RESUME
    """The statement RESUME: leave all routines up to the one that declared the interrupt."""


@dataclass
class _Interrupt:
    condition: Callable[[], Any]
    routine: Callable[[], Steps]
    depth: int
    was_true: bool = False
    is_on: bool = False
    is_pending: bool = False


class Interpreter:
    """One program with its variables.

    Args:
        source: content of `.src`; the first routine is the main program.
        data: content of `.dat`.
        variables: system variables, and those of the program, which are added.
        motion: `ptp(target)`, `wait(seconds)`, `brake()` and `bas(command, value)` of the controller.
    """

    def __init__(self, source: str, data: str, variables: dict[str, Any], motion: Any) -> None:
        self.variables, self._motion = variables, motion
        self._interrupts: dict[int, _Interrupt] = {}
        self._depth = 0
        for name, size, value in re.findall(r"DECL GLOBAL \w+ (\w+)(?:\[(\d+)\])?(?:=(.*))?", data):
            variables[name] = {n: Struct() for n in range(1, int(size) + 1)} if size else parse(value.strip())
        names = re.findall(r"^DEF (\w+)\(", source, re.MULTILINE)
        self._routines: dict[str, Any] = {"v": variables, "m": self, "Resume": Resume}
        exec(compile(_translated(source, set(names)), names[0], "exec"), self._routines)
        self._main: str = names[0]

    def start(self) -> Steps:
        """Return the main program from its beginning."""
        self._interrupts, self._depth = {}, 0
        steps: Steps = self._routines[self._main]()
        return steps

    def note_edges(self) -> None:
        """Remember interrupts whose condition has become true."""
        for interrupt in self._interrupts.values():
            is_true = bool(interrupt.condition())
            interrupt.is_pending |= is_true and not interrupt.was_true and interrupt.is_on
            interrupt.was_true = is_true

    def step(self) -> Steps:
        """Let others act after a statement, then execute interrupts."""
        yield True
        yield from self._interrupted()

    def call(self, routine: Steps) -> Steps:
        """Execute a routine; RESUME leaves it if its caller declared the interrupt."""
        depth = self._depth
        self._depth += 1
        try:
            yield from routine
        except Resume:
            if all(interrupt.depth != depth for interrupt in self._interrupts.values()):
                raise
        finally:
            self._depth = depth

    def declare(self, number: int, condition: Callable[[], Any], routine: Callable[[], Steps]) -> None:
        """Declare an interrupt in the current routine."""
        self._interrupts[number] = _Interrupt(condition, routine, self._depth, bool(condition()))

    def switch(self, number: int, on: bool) -> None:
        """Switch an interrupt on or off."""
        if number in self._interrupts:
            self._interrupts[number].is_on, self._interrupts[number].is_pending = on, False

    def ptp(self, target: Struct) -> Steps:
        """Drive to a target."""
        for is_busy in self._motion.ptp(target):
            yield is_busy
            yield from self._interrupted()

    def wait(self, seconds: float) -> Steps:
        """Wait."""
        for is_busy in self._motion.wait(seconds):
            yield is_busy
            yield from self._interrupted()

    def wait_for(self, condition: Callable[[], Any]) -> Steps:
        """Wait for a condition."""
        while not condition():
            yield False

    def brake(self) -> None:
        """Brake on the path."""
        self._motion.brake()

    def bas(self, command: str, value: float) -> None:
        """Set speed or acceleration."""
        self._motion.bas(command, value)

    def _interrupted(self) -> Steps:
        self.note_edges()
        for interrupt in list(self._interrupts.values()):
            if interrupt.is_pending:
                interrupt.is_pending = False
                yield from interrupt.routine()


def parse(text: str) -> Any:
    """Return the value of a KRL text.

    Raises:
        ValueError: if it is none.
    """
    tokens = _LITERAL.findall(text)
    if "".join(tokens) != re.sub(r"\s", "", text) or not tokens:
        raise ValueError(f"{text[:60]!r} is no value")
    value = _parse(tokens)
    if tokens:
        raise ValueError(f"{text[:60]!r} has more than a value")
    return value


def _parse(tokens: list[str]) -> Any:
    token = tokens.pop(0)
    if token == "{":
        value = Struct()
        if len(tokens) > 1 and tokens[1] == ":":
            del tokens[:2]
        while tokens and tokens[0] != "}":
            name = tokens.pop(0)
            if not tokens:
                break
            value[name] = _parse(tokens)
            if tokens and tokens[0] == ",":
                tokens.pop(0)
        if not tokens:
            raise ValueError("an aggregate does not end")
        tokens.pop(0)
        return value
    if token in ("TRUE", "FALSE"):
        return token == "TRUE"
    if token.startswith("#"):
        return token
    return float(token) if re.search(r"[.Ee]", token) else int(token)


def render(value: Any) -> str:
    """Return a value as a KRL text; a REAL has seven digits."""
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, dict):
        return "{" + ",".join(f"{name} {render(each)}" for name, each in value.items()) + "}"
    return f"{value:.7g}" if isinstance(value, float) else str(value)


def read(variables: dict[str, Any], name: str) -> Any:
    """Return the value at a place such as `SC_POINT[3]` or `SC_STATE.OWNER`.

    Raises:
        KeyError: if there is none.
    """
    match = _PLACE.fullmatch(name.upper())
    if match is None:
        raise KeyError(name)
    value = variables[match[1]]
    value = value[int(match[2])] if match[2] else value
    return value[match[3]] if match[3] else value


def write(variables: dict[str, Any], name: str, value: Any) -> None:
    """Write a value at a place; of an aggregate the given components.

    Raises:
        KeyError, ValueError: if there is no such place, or the value does not fit.
    """
    old, match = read(variables, name), _PLACE.fullmatch(name.upper())
    if isinstance(old, dict) is not isinstance(value, dict) or isinstance(old, bool) is not isinstance(value, bool):
        raise ValueError(f"{name} cannot be {value!r}")
    assert match is not None
    if isinstance(old, dict):
        old.update(value)
        return
    keys: list[Any] = [match[1], *([int(match[2])] if match[2] else []), *([match[3]] if match[3] else [])]
    holder: Any = variables
    for key in keys[:-1]:
        holder = holder[key]
    holder[keys[-1]] = value


def _translated(source: str, routines: set[str]) -> str:
    """Return the program in Python."""
    lines, indent, local = [], 0, set[str]()
    for number, raw in enumerate(source.splitlines(), start=1):
        line = raw.split(";")[0].strip()
        if not line or line.startswith("&") or line.startswith(("GLOBAL INTERRUPT", "INTERRUPT ON 3", "BAS (#INITMOV")):
            continue
        if match := re.fullmatch(r"DEF (\w+)\((.*)\)", line):
            local = set(re.findall(r"(\w+) :IN", match[2]))
            lines.append(f"def {match[1]}({', '.join(sorted(local))}):")
            indent = 1
            lines.append("    yield True")
            continue
        if line.startswith("DECL INT "):
            declared = set(line.removeprefix("DECL INT ").split(",")) - local
            local |= declared
            line_out = [f"{name} = 0" for name in sorted(declared)]
        elif line == "END":
            indent = 0
            continue
        elif line in ("ENDIF", "ENDFOR", "ENDLOOP"):
            indent -= 1
            continue
        else:
            if line == "ELSE":
                indent -= 1
            line_out = _statement(line, local, routines, number)
        lines.extend("    " * indent + each for each in line_out)
        indent += line_out[-1].endswith(":") if line_out else 0
    return "\n".join(lines) + "\n"


def _statement(line: str, local: set[str], routines: set[str], number: int) -> list[str]:
    """Return a statement in Python; what follows a colon is its block."""
    after = "yield from m.step()"

    def of(text: str) -> str:
        return _expression(text, local)

    if match := re.fullmatch(r"IF (.+) THEN", line):
        return [after, f"if {of(match[1])}:"]
    if line == "ELSE":
        return ["else:"]
    if line == "LOOP":
        return ["while True:"]
    if match := re.fullmatch(r"FOR (\w+)=(.+) TO (.+)", line):
        return [f"for {match[1]} in range({of(match[2])}, {of(match[3])} + 1):"]
    if line == "RETURN":
        return ["return"]
    if line == "RESUME":
        return ["raise Resume"]
    if line == "BRAKE":
        return ["m.brake()"]
    if match := re.fullmatch(r"PTP (.+)", line):
        return [f"yield from m.ptp({of(match[1])})"]
    if match := re.fullmatch(r"WAIT SEC (.+)", line):
        return [f"yield from m.wait({of(match[1])})"]
    if match := re.fullmatch(r"WAIT FOR (.+)", line):
        return [f"yield from m.wait_for(lambda: {of(match[1])})"]
    if match := re.fullmatch(r"BAS\(#(\w+),(.+)\)", line):
        return [f"m.bas({match[1]!r}, {of(match[2])})"]
    if match := re.fullmatch(r"INTERRUPT DECL (\d+) WHEN (.+) DO (\w+)\( \)", line):
        return [f"m.declare({match[1]}, lambda: {of(match[2])}, {match[3]})"]
    if match := re.fullmatch(r"INTERRUPT (ON|OFF) (\d+)", line):
        return [f"m.switch({match[2]}, {match[1] == 'ON'})"]
    if (match := re.fullmatch(r"(\w+)\((.*)\)", line)) and match[1] in routines:
        return [after, f"yield from m.call({match[1]}({of(match[2].strip())}))"]
    if match := re.fullmatch(r"([$\w.\[\]]+)=(.+)", line):
        return [f"{of(match[1])} = {of(match[2])}", after]
    raise ValueError(f"line {number} is no statement that this interpreter knows: {line}")


def _expression(text: str, local: set[str]) -> str:
    def token(match: re.Match[str]) -> str:
        word = match[0]
        if match["enum"]:
            return repr(word)
        if match["part"]:
            return word
        if match["differs"]:
            return "!="
        return _WORDS.get(word) or (word if word in local else f"v[{word!r}]")

    return _TOKEN.sub(token, text)
