"""Decoding of text files: byte order marks, other encodings than UTF-8, and lines with any line end."""

import codecs
import re
import warnings

import numpy as np

from planner.values import Floats

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # before UTF-16, whose mark it begins with
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def decode(content: bytes) -> str:
    """Decode a text by its byte order mark, else as UTF-8, else as Latin-1, in which every byte is a character.

    Numbers and keywords are ASCII in all of them; only names and comments can differ.

    Raises:
        ValueError: if a text with the mark of UTF-16 or UTF-32 is broken.
    """
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return content.decode(encoding, errors="replace" if encoding == "utf-8-sig" else "strict")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def lines_of(text: str) -> list[str]:
    """Split a text at CR LF, LF and CR only; `str.splitlines` also splits at characters that names can contain."""
    return re.split(r"\r\n|\n|\r", text)


def parse_numbers(text: str, count: int) -> Floats | None:
    """Return the numbers of a text that white space separates; None if it has not `count` words, all numbers."""
    with warnings.catch_warnings(action="ignore"):  # numpy warns and stops at the first word that is not a number
        try:
            numbers = np.fromstring(text, sep=" ")
        except ValueError:
            return None
    return numbers if len(numbers) == count else None
