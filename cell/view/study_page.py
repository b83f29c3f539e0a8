"""The page of a study: what it says, its pictures, for each row the command that plans there. No script, no address."""

import base64
import html
import re
from pathlib import Path
from typing import Self

from pydantic import JsonValue, model_validator

from cell.errors import FileError
from cell.runs.schema import JsonTable, parsed
from cell.view.page import filled, head, text


class StudyFile(JsonTable):
    """What the page shows of study.json; versions before had no title, pictures and commands in it."""

    name: str
    title: str = ""
    sentences: list[str]
    rows: list[dict[str, JsonValue]]
    failed: list[dict[str, JsonValue]]
    pictures: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    best: int | None = None

    @model_validator(mode="after")
    def _one_command_a_row(self) -> Self:
        if self.commands and len(self.commands) != len(self.rows):
            raise ValueError(f"has {len(self.commands)} commands for {len(self.rows)} rows")
        if self.best is not None and not 0 <= self.best < len(self.commands):
            raise ValueError(f".best must be the number of a row with a command, not {self.best}")
        return self


def study_page(folder: Path) -> str:
    """The page of a study's folder.

    Raises:
        FileError: if its files are missing or damaged.
    """
    path = folder / "study.json"
    try:
        study = parsed(StudyFile, path.read_bytes(), path)
        stems = study.pictures or sorted(each.stem for each in folder.glob("*.svg"))
        pictures = [_picture(folder / f"{Path(stem).name}.svg") for stem in stems]
    except OSError as error:
        raise FileError(f"{error.filename} cannot be read: {(error.strerror or str(error)).lower()}") from error
    parts = [f"<h1>{html.escape(study.title or study.name)}</h1>"]
    parts += [f"<p>{_marked(sentence)}</p>" for sentence in study.sentences]
    if study.best is not None:
        parts.append(f"<p>Plan there: <code>{html.escape(study.commands[study.best])}</code></p>")
    parts += [*pictures, *_table(study)]
    reasons = [f"<li>{html.escape(str(each.get('reason', '')))}</li>" for each in study.failed]
    parts += ["<h2>Trials that failed</h2><ul>", *reasons, "</ul>"] if reasons else []
    top = head(study.title or study.name, "study.css", "style-src 'unsafe-inline'; img-src data:")
    return filled(text("study.html"), HEAD=top, BODY="\n".join(parts))


def _picture(path: Path) -> str:
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{html.escape(path.stem)}" src="data:image/svg+xml;base64,{content}">'


def _table(study: StudyFile) -> list[str]:
    """Rows with the command that plans there; the best one is marked."""
    columns = list(dict.fromkeys(key for row in study.rows for key in row))
    if not columns:
        return []
    heads = "".join(f"<th>{html.escape(each)}</th>" for each in [*columns, *["plan there"] * bool(study.commands)])
    lines = ["<h2>Rows</h2><div><table>", f"<tr>{heads}</tr>"]
    for number, row in enumerate(study.rows):
        cells = "".join(f"<td>{html.escape(shown(row.get(column)))}</td>" for column in columns)
        command = f"<td><code>{html.escape(study.commands[number])}</code></td>" if study.commands else ""
        lines.append(f"<tr{' class=best' if number == study.best else ''}>{cells}{command}</tr>")
    return [*lines, "</table></div>"]


def _marked(sentence: str) -> str:
    """A sentence whose `code` and **weight** are marked as in report.md."""
    text = re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(sentence))
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", text)


def shown(value: object) -> str:
    """A value as people read it: numbers with at most four digits."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
