"""Page of a study: sentences, a map of the rows, pictures, and a table with the command that plans each row.

The map and the sorting are of `study.js`, the only script that the page allows; it requests no address.
"""

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Self

from pydantic import ConfigDict, JsonValue, model_validator

from cell.errors import FileError
from cell.runs.schema import JsonTable, parsed
from cell.view.page import fill_template, page_head, resource_text

ACCURACY = {"%": 1.0, "views": 1.0, "s": 0.5, "bound": 1.0}
"""Smallest range of a colour scale by the last word of a column; two standard errors of a share of 3,000 samples are
0.8 points at 95 %. A smaller range would show noise."""

_DARK = (
    "<style>:root{--paper:#ffffff;color:#1b1f23;fill:currentColor}"
    "@media(prefers-color-scheme:dark){:root{--paper:#22262b;color:#e6e9ec}}</style>"
)
_CHART = """<div id="chart"><label>x <select id="x"></select></label><label>y <select id="y"></select></label>
<label>colour <select id="colour"></select></label>
<svg id="map" role="img" aria-label="Map of the rows"></svg><p id="values"></p><code id="command"></code></div>"""


class StudyFile(JsonTable):
    """The fields of study.json on the page; earlier versions had no title, pictures and commands."""

    model_config = ConfigDict(extra="ignore")

    name: str
    title: str = ""
    sentences: list[str]
    rows: list[dict[str, JsonValue]]
    failed: list[dict[str, JsonValue]]
    pictures: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    best: int | None = None

    @model_validator(mode="after")
    def _require_one_command_per_row(self) -> Self:
        if self.commands and len(self.commands) != len(self.rows):
            raise ValueError(f"has {len(self.commands)} commands for {len(self.rows)} rows")
        if self.best is not None and not 0 <= self.best < len(self.commands):
            raise ValueError(f".best is {self.best}; it must be the number of a row with a command")
        return self


def study_page(folder: Path) -> str:
    """Return the page of a study's folder.

    Raises:
        FileError: if a file is missing or damaged.
    """
    path = folder / "study.json"
    try:
        study = parsed(StudyFile, path.read_bytes(), path)
        stems = study.pictures or sorted(each.stem for each in folder.glob("*.svg"))
        pictures = [_picture(folder / f"{Path(stem).name}.svg") for stem in stems]
    except OSError as error:
        raise FileError(f"{error.filename} cannot be read: {(error.strerror or str(error)).lower()}") from error
    parts = [f"<h1>{html.escape(study.title or study.name)}</h1>"]
    parts += [f"<p>{_markup(sentence)}</p>" for sentence in study.sentences]
    if study.best is not None:
        parts.append(f"<p>Plan there: <code>{html.escape(study.commands[study.best])}</code></p>")
    parts += [_CHART, *pictures, *_rows_table(study)]
    reasons = [f"<li>{html.escape(str(each.get('reason', '')))}</li>" for each in study.failed]
    parts += ["<h2>Trials that failed</h2><ul>", *reasons, "</ul>"] if reasons else []
    script = resource_text("study.js")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    policy = f"script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:"
    top = page_head(study.title or study.name, "study.css", policy)
    columns = _columns(study)
    data = {
        "rows": study.rows,
        "columns": columns,
        "accuracy": {column: ACCURACY[unit] for column in columns if (unit := column.split(" ")[-1]) in ACCURACY},
        "commands": study.commands,
        "best": study.best,
    }
    written = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return fill_template(resource_text("study.html"), HEAD=top, BODY="\n".join(parts), DATA=written, SCRIPT=script)


def colour_limits(values: Iterable[float], column: str) -> tuple[float, float]:
    """Return the limits of a colour scale: the range of the values, at least their accuracy."""
    known = list(values)
    low, high = min(known), max(known)
    more = max(ACCURACY.get(column.rsplit(" ", maxsplit=1)[-1], 0.0) - (high - low), 0.0) / 2
    return low - more, high + more


def _picture(path: Path) -> str:
    """Return a picture whose lines, text and paper follow the colour scheme of the reader."""
    text = path.read_text(encoding="utf-8").replace("#000000", "currentColor").replace("#ffffff", "var(--paper)")
    text = re.sub(r"(<svg[^>]*>)", lambda match: match[1] + _DARK, text, count=1)
    content = base64.b64encode(text.encode("utf-8")).decode("ascii")
    return f'<img alt="{html.escape(path.stem)}" src="data:image/svg+xml;base64,{content}">'


def _rows_table(study: StudyFile) -> list[str]:
    """Return the table of rows with their commands; the best row is marked."""
    columns = _columns(study)
    if not columns:
        return []
    heads = "".join(f"<th>{html.escape(each)}</th>" for each in [*columns, *["plan there"] * bool(study.commands)])
    lines = ["<h2>Rows</h2><div><table>", f"<thead><tr>{heads}</tr></thead><tbody>"]
    for number, row in enumerate(study.rows):
        cells = "".join(f"<td>{html.escape(format_value(row.get(column)))}</td>" for column in columns)
        command = f"<td><code>{html.escape(study.commands[number])}</code></td>" if study.commands else ""
        best = " class=best" if number == study.best else ""
        lines.append(f"<tr data-row={number}{best}>{cells}{command}</tr>")
    return [*lines, "</tbody></table></div>"]


def _columns(study: StudyFile) -> list[str]:
    return list(dict.fromkeys(key for row in study.rows for key in row))


def _markup(sentence: str) -> str:
    """Return a sentence as HTML, with `code` and **bold** as in report.md."""
    text = re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(sentence))
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", text)


def format_value(value: object) -> str:
    """Return a value as text: numbers with at most four digits."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
