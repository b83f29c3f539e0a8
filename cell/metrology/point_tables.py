"""Tables of numbers in text files: separators, decimal commas, column names, counts.

A text whose numbers can be read in two ways is refused with its line; it is never guessed.
"""

import re
from dataclasses import dataclass

import numpy as np

from cell.text import decode, lines_of, parse_numbers
from planner.values import Floats

_COMMENTS = ("#", "//", "%", "/*")
_NAN = re.compile(r"[-+]?(?:1\.#\w+|nan\(\w*\)|n/?a|null)", re.IGNORECASE)
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")
_DECIMAL = re.compile(r"[-+]?\d*,\d*(?:[eE][-+]?\d+)?")
_AXIS = re.compile(r"(?:pos_?|coord_?|point_?)?([xyz])(?:[_ ]?(?:mm|cm|um|m|in))?\s*(?:[\[(].*)?")


class TableError(ValueError):
    """A text that is not a table of numbers; the message follows the name of the file."""


@dataclass(frozen=True, slots=True)
class Row:
    """The words of a line, with decimal points and without quotes.

    Attributes:
        line: number of the line, from 1.
        words: of the line.
    """

    line: int
    words: list[str]


def read_rows(content: bytes) -> tuple[list[Row], list[str]]:
    """Split a text into rows of words; blank lines and comments are left out.

    Returns:
        The rows, and the words of the last comment before the first row, which may name the columns.

    Raises:
        TableError: if commas can be separators as well as decimal or thousands separators.
    """
    try:
        lines = lines_of(decode(content))
    except UnicodeError as error:
        raise TableError("is not a text file") from error
    data: list[tuple[int, str]] = []
    names: list[str] = []
    for number, line in enumerate(lines, start=1):
        text = line.strip("\ufeff\0\x1a \t")
        if text.startswith(_COMMENTS):
            names = names if data else re.split(r"[;,\s]+", text.strip("#/%* \t"))
        elif text:
            data.append((number, text.replace('"', "").replace("'", "")))
    every = "\n".join(text for _, text in data)
    if "\0" in every:
        raise TableError("is not a text file, or has bytes without a character; export it again")
    if ";" in every and re.search(r",\s", every) and not re.search(r",(?!\s)", every):
        rows = [Row(number, [word.strip() for word in re.split("[;,]", text)]) for number, text in data]
    elif ";" in every:
        rows = [Row(number, [word.strip() for word in text.rstrip(";").split(";")]) for number, text in data]
    elif "," in every and (not re.search(r",(?!\s)", every) or not re.search(r"[\d.][ \t]+[-+.\d]", every)):
        rows = [Row(number, [word.strip() for word in text.rstrip(",").split(",")]) for number, text in data]
    else:
        rows = [Row(number, text.split()) for number, text in data]
    return [Row(row.line, words) for row, words in zip(rows, _with_points(rows), strict=True)], names


def _with_points(rows: list[Row]) -> list[list[str]]:
    """Return the words with decimal points in place of decimal commas."""
    with_comma = [(row.line, word) for row in rows for word in row.words if "," in word]
    numeric = [(line, word) for line, word in with_comma if re.fullmatch(r"[-+\d.,eE]+", word)]
    if not numeric:
        return [row.words for row in rows]
    for line, word in numeric:
        if "." in word or not _DECIMAL.fullmatch(word):
            raise TableError(
                f"has the number '{word[:40]}', line {line}: write decimal points and no thousands separators"
            )
    if all(_THOUSANDS.fullmatch(word) for _, word in numeric):
        line, word = numeric[0]
        raise TableError(
            f"has the number '{word[:40]}', line {line}, whose comma can be a decimal or a thousands separator: write "
            "decimal points"
        )
    return [[word.replace(",", ".") if _DECIMAL.fullmatch(word) else word for word in row.words] for row in rows]


def number_of(word: str) -> float | None:
    """Return the number of a word, NaN for a missing value as programs write it; None for other words."""
    if _NAN.fullmatch(word):
        return float("nan")
    try:
        return None if "_" in word else float(word)
    except ValueError:
        return None


def read_points(content: bytes) -> Floats:
    """Return the columns x, y and z (P, 3) of a text file.

    A header line or a comment can name the columns. Without names, the first three are x, y and z. A first line with
    one integer announces the number of points.

    Raises:
        TableError: with the line, if a row is incomplete, a word is not a number, or the columns are ambiguous.
    """
    plain = content.decode("ascii", errors="replace")
    if not re.search(r"[^\d\s.eE+-]", plain[:2000]) and (quick := _plain_points(plain)) is not None:
        return quick
    rows, comment = read_rows(content)
    names = comment
    if rows and any(number_of(word) is None for word in rows[0].words):
        names = rows.pop(0).words
        if len(_axes(names)) < 3:
            line = 1 if not rows else rows[0].line - 1
            word = next(word for word in names if number_of(word) is None)
            raise TableError(f"has '{word[:40]}' where a number or the names x, y and z are expected, line {line}")
    announced = None
    if len(rows) > 1 and len(rows[0].words) == 1 and len(rows[1].words) > 1:
        announced = number_of(rows.pop(0).words[0])
    if not rows:
        raise TableError("has no points, only names or comments; scan again")
    width = len(rows[0].words)
    for row in rows:
        if len(row.words) != width:
            raise TableError(f"has {len(row.words)} numbers in line {row.line} and {width} in line {rows[0].line}")
    if width < 3:
        raise TableError(f"has {width} numbers in line {rows[0].line}; x, y and z are needed")
    axes = _axes(names)
    is_named = len(axes) == 3 and len(names) == width
    columns = [axes[axis] for axis in "xyz"] if is_named else range(width)
    values = np.empty((len(rows), len(columns)))
    for k, row in enumerate(rows):
        for column, word in enumerate(row.words[column] for column in columns):
            number = number_of(word)
            if number is None and column < 3:
                raise TableError(f"has '{word[:40]}' where a number is expected, line {row.line}")
            values[k, column] = np.nan if number is None else number
    if announced is not None and announced != len(rows):
        raise TableError(
            f"announces {announced:g} points but has {len(rows)}; it is cut short, export or copy it again"
        )
    if is_named:
        return values
    _require_plain_columns(values, "." in "".join(rows[0].words), rows[0].line)
    return values[:, :3]


def _plain_points(text: str) -> Floats | None:
    """Return the points of a text of numbers with as many numbers in each line; None for any other text."""
    lines = [line for line in lines_of(text) if line.strip()]
    widths = {len(line.split()) for line in lines}
    if len(widths) != 1 or min(widths) < 3:
        return None
    width = widths.pop()
    numbers = parse_numbers("\n".join(lines), width * len(lines))
    if numbers is None:
        return None
    values = numbers.reshape(-1, width)
    _require_plain_columns(values, True, 1)
    return values[:, :3]


def _axes(names: list[str]) -> dict[str, int]:
    """Return the columns of x, y and z among names."""
    axes: dict[str, int] = {}
    for column, name in enumerate(names):
        match = _AXIS.fullmatch(name.strip().lower().lstrip("/#"))
        if match:
            axes.setdefault(match[1], column)
    return axes


def _require_plain_columns(values: Floats, has_points: bool, line: int) -> None:
    """Refuse columns without names whose first counts the points, or whose commas separate decimals too."""
    if len(values) > 2 and values.shape[1] > 3 and (np.diff(values[:, 0]) == 1).all() and (values[:, 0] % 1 == 0).all():
        raise TableError(
            f"has {values.shape[1]} columns without names, and the first counts the points; name the columns in a "
            "first line, such as 'id x y z'"
        )
    is_integer = (values == np.round(values)).all(axis=0)
    if values.shape[1] > 3 and is_integer[0] and not is_integer[1:4].all():
        raise TableError(
            f"has {values.shape[1]} columns without names, and the first has only integers; name the columns in a "
            "first line, such as 'id x y z'"
        )
    if not has_points and values.shape[1] == 6 and (values % 1 == 0).all():
        raise TableError(
            f"has six integers in line {line}, which can be three numbers with decimal commas; name the columns in a "
            "first line, such as 'x y z r g b'"
        )
