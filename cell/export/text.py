"""Text of a program: ASCII lines that a comment cannot break."""

from collections.abc import Iterable
from importlib import resources

MAX_LINE_LENGTH = 400
"""Longest line [characters]; KRL's own limit is 471 on a KR C2 (from memory)."""


def fixed_lines(name: str) -> list[str]:
    """Return the lines of a file of this package that every program of a language contains."""
    return (resources.files("cell.export") / name).read_text(encoding="ascii").splitlines()


def encoded(lines: Iterable[str]) -> bytes:
    """Return lines as a file. Names in comments may hold line breaks, which would begin a statement."""
    return "".join(f"{_single_line(line)}\r\n" for line in lines).encode("ascii", errors="replace")


def _single_line(line: str) -> str:
    text = "".join(character if character.isprintable() else "?" for character in line)
    return text if len(text) <= MAX_LINE_LENGTH else text[: MAX_LINE_LENGTH - 3] + "..."  # only comments
