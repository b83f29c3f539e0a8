"""Page of a study: sentences, pictures, and a table with the command that plans each row. No script, no address."""

import base64
import html
import re
from pathlib import Path
from typing import Self

from pydantic import ConfigDict, JsonValue, model_validator

from cell.errors import FileError
from cell.runs.schema import JsonTable, parsed
from cell.view.page import fill_template, page_head, resource_text


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
    parts += [*pictures, *_rows_table(study)]
    reasons = [f"<li>{html.escape(str(each.get('reason', '')))}</li>" for each in study.failed]
    parts += ["<h2>Trials that failed</h2><ul>", *reasons, "</ul>"] if reasons else []
    top = page_head(study.title or study.name, "study.css", "style-src 'unsafe-inline'; img-src data:")
    return fill_template(resource_text("study.html"), HEAD=top, BODY="\n".join(parts))


def _picture(path: Path) -> str:
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{html.escape(path.stem)}" src="data:image/svg+xml;base64,{content}">'


def _rows_table(study: StudyFile) -> list[str]:
    """Return the table of rows with their commands; the best row is marked."""
    columns = list(dict.fromkeys(key for row in study.rows for key in row))
    if not columns:
        return []
    heads = "".join(f"<th>{html.escape(each)}</th>" for each in [*columns, *["plan there"] * bool(study.commands)])
    lines = ["<h2>Rows</h2><div><table>", f"<tr>{heads}</tr>"]
    for number, row in enumerate(study.rows):
        cells = "".join(f"<td>{html.escape(format_value(row.get(column)))}</td>" for column in columns)
        command = f"<td><code>{html.escape(study.commands[number])}</code></td>" if study.commands else ""
        lines.append(f"<tr{' class=best' if number == study.best else ''}>{cells}{command}</tr>")
    return [*lines, "</table></div>"]


def _markup(sentence: str) -> str:
    """Return a sentence as HTML, with `code` and **bold** as in report.md."""
    text = re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(sentence))
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", text)


def format_value(value: object) -> str:
    """Return a value as text: numbers with at most four digits."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
