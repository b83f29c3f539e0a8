"""A study: its trials, the tidy rows made of their outcomes, the pictures and sentences made of the rows; one folder.

The folder holds rows.csv (equal on every machine), seconds.csv (what the trials took, where they were computed),
study.json, report.md, view.html and each picture as PNG and SVG. It is made anew from the kept trials by every run of
the study, so nothing in it needs to be kept by hand.
"""

import csv
import io
import json
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from cell.errors import FileError
from cell.files import atomic_write
from cell.session import ProgressReporter
from cell.study.run import run
from cell.study.trial import Outcome, Trial
from cell.study.workers import Workers
from cell.view.contents import PAGE_FILE
from cell.view.study_page import format_value, study_page

SCHEMA = "scan-cell/study/1"

Row = dict[str, Any]
"""One tidy row: column (with its unit) and value."""


@dataclass(frozen=True, slots=True)
class Study:
    """What is asked, and how the answer is shown.

    Attributes:
        name: of the study and of its folder.
        title: for people.
        trials: what is computed.
        rows: one row per trial that succeeded, or more.
        pictures: file stem and figure of each picture.
        sentences: what the rows say, for a reader in a hurry; Markdown paragraphs.
        shown: columns for a terminal, where the whole table is too wide; empty: all.
        options: of `cell plan`, that plan as a row says (`cell.study.plan_command`); None: there are none.
        best: the row to prefer; None: all are shown alike.
    """

    name: str
    title: str
    trials: Sequence[Trial]
    rows: Callable[[Sequence[Outcome]], list[Row]]
    pictures: Callable[[Sequence[Row]], Iterable[tuple[str, Figure]]] = field(default=lambda rows: ())
    sentences: Callable[[Sequence[Row]], Sequence[str]] = field(default=lambda rows: ())
    shown: Sequence[str] = ()
    options: Callable[[Row], str] | None = None
    best: Callable[[Sequence[Row]], Row] | None = None


@dataclass(frozen=True, slots=True)
class StudyResult:
    """What a study left.

    Attributes:
        folder: where its files are.
        rows: the tidy rows.
        sentences: what they say.
        failed: trials that failed, each with its reason.
        computed: how many trials were computed now; the others were kept from before.
        shown: columns for a terminal.
        commands: for each row the one that plans as it says; empty: there are none.
        best: number of the row to prefer, from 0; None: none is.
    """

    folder: Path
    rows: Sequence[Row]
    sentences: Sequence[str]
    failed: Sequence[Outcome]
    computed: int
    shown: Sequence[str]
    commands: Sequence[str] = ()
    best: int | None = None

    def summary(self) -> dict[str, object]:
        """The object that `--json` prints."""
        return {
            "schema": SCHEMA,
            "folder": str(self.folder),
            "rows": list(self.rows),
            "sentences": list(self.sentences),
            "commands": list(self.commands),
            "best": self.best,
            "failed": [{**json.loads(each.trial.settings), "reason": each.failure} for each in self.failed],
            "computed": self.computed,
        }


def conduct(
    study: Study,
    workers: Workers,
    *,
    out: Path | None,
    reporter: ProgressReporter,
    plan: Sequence[object] = ("cell", "plan"),
) -> StudyResult:
    """Run a study and write its folder.

    Args:
        study: what is asked.
        workers: who computes.
        out: the folder; None: sim_runs/study-<name>.
        reporter: is told of progress and of trials that fail.
        plan: the command that plans the study's scene, to which a row's options are added.

    Raises:
        FileError: if the folder holds something else or cannot be written.
    """
    folder = study_folder(study.name, out)
    with reporter.stage(study.title, time_left=True) as progress:

        def told(done: int, total: int, outcome: Outcome) -> None:
            progress(done, total)
            if outcome.failure:
                reporter.note(f"trial {outcome.trial.settings} failed: {outcome.failure}; the study goes on")

        outcomes = run(study.trials, workers, told=told)
    rows = study.rows([outcome for outcome in outcomes if not outcome.failure])
    options = [study.options(row) for row in rows] if study.options else []
    best = study.best(rows) if study.best and rows else None
    result = StudyResult(
        folder,
        rows,
        list(study.sentences(rows)) if rows else [],
        [outcome for outcome in outcomes if outcome.failure],
        sum(not outcome.cached for outcome in outcomes),
        study.shown or _columns(rows),
        [f"{shlex.join(map(str, plan))} {each}".rstrip() for each in options],
        next((number for number, row in enumerate(rows) if row is best), None),
    )
    seconds = [{"trial": outcome.trial.settings, **outcome.seconds} for outcome in outcomes]
    write_folder(study.name, study.title, result, study.pictures(rows) if rows else (), seconds)
    return result


def study_folder(name: str, out: Path | None) -> Path:
    """Where a study of this name leaves its files.

    Raises:
        FileError: if the folder is there and holds something else.
    """
    folder = Path("sim_runs") / f"study-{name}" if out is None else out
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / "study.json").is_file())):
        raise FileError(f"{folder} exists and is no study's folder; choose another --out")
    return folder


def write_folder(
    name: str,
    title: str,
    result: StudyResult,
    pictures: Iterable[tuple[str, Figure]],
    seconds: Sequence[Mapping[str, object]],
) -> None:
    """Write the files of a study; the module's docstring lists them.

    Raises:
        FileError: if they cannot be written.
    """
    folder = result.folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder / "rows.csv", _csv(result.rows))
        _write(folder / "seconds.csv", _csv(seconds))
        drawn = [_draw(folder, stem, figure) for stem, figure in pictures]
        told = {key: value for key, value in result.summary().items() if key not in ("folder", "computed")}
        content = {**told, "name": name, "title": title, "pictures": [Path(each).stem for each in drawn]}
        _write(folder / "study.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
        _write(folder / "report.md", _report(title, result, drawn))
        _write(folder / PAGE_FILE, study_page(folder))
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror or error}; choose another --out") from error


def _columns(rows: Sequence[Mapping[str, object]]) -> list[str]:
    return list(dict.fromkeys(key for row in rows for key in row))


def _csv(rows: Sequence[Mapping[str, object]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, _columns(rows), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _write(path: Path, content: str) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text(content, encoding="utf-8")


def _draw(folder: Path, stem: str, figure: Figure) -> str:
    """PNG and SVG; equal rows give equal bytes."""
    FigureCanvasAgg(figure)
    figure.savefig(folder / f"{stem}.png", metadata={"Software": None})
    with mpl.rc_context({"svg.hashsalt": stem}):
        FigureCanvasSVG(figure)
        figure.savefig(folder / f"{stem}.svg", metadata={"Date": None, "Creator": None})
    return f"{stem}.png"


def _report(title: str, result: StudyResult, pictures: Sequence[str]) -> str:
    lines = [f"# {title} ([look at it]({PAGE_FILE}))", ""]
    for sentence in result.sentences:
        lines += [sentence, ""]
    lines += [line for name in pictures for line in (f"![{Path(name).stem}]({name})", "")]
    lines += [*markdown_table(result.rows), ""]
    if result.failed:
        lines += ["## Trials that failed", ""]
        lines += [f"- `{outcome.trial.settings}`: {outcome.failure}" for outcome in result.failed]
    return "\n".join(lines).rstrip() + "\n"


def markdown_table(rows: Sequence[Row]) -> list[str]:
    """The rows as lines of a Markdown table; numbers with at most four digits."""
    columns = _columns(rows)
    body = ["| " + " | ".join(format_value(row.get(column)) for column in columns) + " |" for row in rows]
    return ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns), *body] if rows else []
