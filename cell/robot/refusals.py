"""Reasons why MuJoCo refuses a description, in words of this program: place, cause, cure."""

import re
import tomllib
from functools import cache
from importlib import resources


def describe_refusal(error: ValueError, *, has_lines: bool = True) -> str:
    """Return place, cause and cure of a description that MuJoCo refuses.

    Args:
        error: MuJoCo's.
        has_lines: whether its line numbers are those of the user's file.
    """
    words = " ".join(str(error).split())
    words = words if has_lines else re.sub(r", line \d+", "", words)
    sentence, _, element = words.partition(" Element ")
    cause, place = _cause(re.sub(r"^(?:(?:XML )?Error: )*", "", sentence)), _place(sentence, element)
    return f"{place}: {cause}" if place else cause


@cache
def _causes() -> list[tuple[str, str]]:
    """Return patterns of MuJoCo's words, and our sentences with their groups."""
    content = (resources.files("cell.robot") / "refusals.toml").read_text(encoding="utf-8")
    causes: list[tuple[str, str]] = tomllib.loads(content)["causes"]
    return causes


def _cause(sentence: str) -> str:
    for pattern, ours in _causes():
        if match := re.search(pattern, sentence):
            return ours.format(*(_shorten(group.strip()) for group in match.groups()))
    return f"MuJoCo's compiler reports '{sentence[:120]}'; correct or remove this element"


def _shorten(words: str) -> str:
    """Return the last 60 characters: a path ends with the name of its file."""
    return words if len(words) <= 60 else f"...{words[-57:]}"


def _place(sentence: str, element: str) -> str:
    """Return kind, name and line of the element that MuJoCo names."""
    line = re.search(r"line (\d+)", element)
    at = f"line {line[1]}" if line and line[1] != "1" else ""
    if match := re.match(r"name '([^']*)', id (\d+)", element):
        kind = re.search(r" in (geom|joint|body|light|camera|site)\b", sentence)
        which = f"{kind[1] if kind else 'element'} "
        return ", ".join(
            each for each in (which + (f"'{match[1]}'" if match[1] else f"number {int(match[2]) + 1}"), at) if each
        )
    tag = re.match(r"'(\w+)'", element)
    return ", ".join(each for each in (f"<{tag[1]}>" if tag else "", at) if each)
