"""Studies: trials, a table with a row for each outcome, and pictures and sentences from the rows, in one folder.

The folder has rows.csv (equal on every machine), seconds.csv (times of the trials where they were computed),
study.json, report.md, view.html and each picture as PNG and SVG. Every run of the study writes it again from the cached
trials.
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
from cell.files import atomic_write, file_errors
from cell.formatting import Summary
from cell.scene.file import load_scene, option_names, option_tables
from cell.scene.model import Scene
from cell.scene.options import Spell, flag, option_specs
from cell.session import ProgressReporter
from cell.study.trials import Outcome, Trial, Workers, run_trials
from cell.view.run_pages import PAGE_FILE
from cell.view.study_page import format_value, study_page

SCHEMA = "scan-cell/study/1"

SceneWith = Callable[[Mapping[str, Mapping[str, object]]], Scene]
"""Makes the scene with changed keys; raises SceneError if a scene cannot have them."""

Row = dict[str, Any]
"""A row: column (with its unit) and value."""


@dataclass(frozen=True, slots=True)
class Study:
    """A study.

    Attributes:
        name: of the study and of its folder.
        title: for people.
        trials: the trials.
        finalists: makes further trials from the outcomes of these.
        rows: makes at least one row for each successful trial.
        pictures: makes file stem and figure of each picture.
        sentences: summarises the rows in Markdown paragraphs.
        columns: of the table in a terminal; empty: all.
        options: makes the options of `cell plan` for a row (`plan_options`); None: there are none.
        best: selects the best row; None: no row is marked.
    """

    name: str
    title: str
    trials: Sequence[Trial]
    rows: Callable[[Sequence[Outcome]], list[Row]]
    pictures: Callable[[Sequence[Row]], Iterable[tuple[str, Figure]]] = field(default=lambda rows: ())
    sentences: Callable[[Sequence[Row]], Sequence[str]] = field(default=lambda rows: ())
    columns: Sequence[str] = ()
    options: Callable[[Row], str] | None = None
    best: Callable[[Sequence[Row]], Row | None] | None = None
    finalists: Callable[[Sequence[Outcome]], Sequence[Trial]] = field(default=lambda outcomes: ())


@dataclass(frozen=True, slots=True, repr=False)
class StudyResult(Summary):
    """Result of a study.

    Attributes:
        folder: of its files.
        rows: the rows.
        sentences: their summary.
        failed: outcomes of the failed trials.
        computed: number of trials computed now; the others were cached.
        columns: of the table in a terminal.
        commands: command that plans each row; empty without commands.
        best: number of the best row, from 0; None: no row is marked.
    """

    folder: Path
    rows: Sequence[Row]
    sentences: Sequence[str]
    failed: Sequence[Outcome]
    computed: int
    columns: Sequence[str]
    commands: Sequence[str] = ()
    best: int | None = None

    def facts(self) -> list[tuple[str, str]]:
        """Return folder, number of rows, and the command that plans the best row."""
        best = [] if self.best is None else [("best", self.commands[self.best])]
        return [("folder", str(self.folder)), ("rows", str(len(self.rows))), *best]

    def summary(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
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


def scene_maker(
    part: str | Path | None, scene: Path | None, options: Mapping[str, object], spell: Spell = str
) -> SceneWith:
    """Return a function that makes the scene of these options with further keys changed.

    Raises:
        UsageError: as `cell plan` for its options.
    """
    base_tables = option_tables(options, part, spell)

    def scene_with(changes: Mapping[str, Mapping[str, object]]) -> Scene:
        tables = {
            table: {**base_tables.get(table, {}), **changes.get(table, {})} for table in {**base_tables, **changes}
        }
        return load_scene(scene, tables, option_names(base_tables, spell))

    return scene_with


def plan_command(part: str | Path | None, scene: Path | None, options: Mapping[str, object]) -> list[object]:
    """Return the command that plans the scene of these options."""
    words = [flag(name) if value is True else f"{flag(name)}={value}" for name, value in options.items()]
    return ["cell", "plan", *([part] if part else []), *(["--scene", scene] if scene else []), *words]


def run_study(
    study: Study,
    workers: Workers,
    *,
    out: Path | None,
    reporter: ProgressReporter,
    plan: Sequence[object] = ("cell", "plan"),
) -> StudyResult:
    """Run a study and write its folder.

    Args:
        study: the study.
        workers: compute the trials.
        out: the folder; None: sim_runs/study-<name>.
        reporter: receives progress and failed trials.
        plan: command that plans the study's scene, to which the options of a row are appended.

    Raises:
        FileError: if the folder has other content or cannot be written.
    """
    folder = study_folder(study.name, out)

    def run(title: str, trials: Sequence[Trial]) -> list[Outcome]:
        with reporter.stage(title, time_left=True) as progress:

            def on_outcome(n_done: int, total: int, outcome: Outcome) -> None:
                progress(n_done, total)
                if outcome.failure:
                    reporter.note(f"trial {outcome.trial.settings} failed: {outcome.failure}; the study continues")

            return run_trials(trials, workers, on_outcome=on_outcome)

    outcomes = run(study.title, study.trials)
    if finalists := study.finalists([outcome for outcome in outcomes if not outcome.failure]):
        outcomes += run("plans of the best", finalists)
    rows = study.rows([outcome for outcome in outcomes if not outcome.failure])
    options = [study.options(row) for row in rows] if study.options else []
    best = study.best(rows) if study.best and rows else None
    result = StudyResult(
        folder,
        rows,
        list(study.sentences(rows)) if rows else [],
        [outcome for outcome in outcomes if outcome.failure],
        sum(not outcome.cached for outcome in outcomes),
        study.columns or _columns(rows),
        [f"{shlex.join(map(str, plan))} {each}".rstrip() for each in options],
        next((number for number, row in enumerate(rows) if row is best), None),
    )
    seconds = [{"trial": outcome.trial.settings, **outcome.seconds} for outcome in outcomes]
    write_folder(study.name, study.title, result, study.pictures(rows) if rows else (), seconds)
    return result


def study_folder(name: str, out: Path | None) -> Path:
    """Return the folder of a study.

    Raises:
        FileError: if it exists with other content.
    """
    folder = Path("sim_runs") / f"study-{name}" if out is None else out
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / "study.json").is_file())):
        raise FileError(f"{folder} exists and is not the folder of a study; choose another --out")
    return folder


def write_folder(
    name: str,
    title: str,
    result: StudyResult,
    pictures: Iterable[tuple[str, Figure]],
    seconds: Sequence[Mapping[str, object]],
) -> None:
    """Write the files of a study, see the module's docstring.

    Raises:
        FileError: if they cannot be written.
    """
    folder = result.folder
    with file_errors(f"{folder} cannot be written", "choose another --out"):
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder / "rows.csv", _csv(result.rows))
        _write(folder / "seconds.csv", _csv(seconds))
        files = [_draw(folder, stem, figure) for stem, figure in pictures]
        summary = {key: value for key, value in result.summary().items() if key not in ("folder", "computed")}
        content = {**summary, "name": name, "title": title, "pictures": [Path(each).stem for each in files]}
        _write(folder / "study.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
        _write(folder / "report.md", _report(title, result, files))
        _write(folder / PAGE_FILE, study_page(folder))


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
    """Write PNG and SVG; equal figures give equal bytes."""
    FigureCanvasAgg(figure)
    figure.savefig(folder / f"{stem}.png", metadata={"Software": None})
    with mpl.rc_context({"svg.hashsalt": stem}):
        FigureCanvasSVG(figure)
        figure.savefig(folder / f"{stem}.svg", metadata={"Date": None, "Creator": None})
    return f"{stem}.png"


def _report(title: str, result: StudyResult, pictures: Sequence[str]) -> str:
    lines = [f"# {title} ([view]({PAGE_FILE}))", ""]
    for sentence in result.sentences:
        lines += [sentence, ""]
    lines += [line for name in pictures for line in (f"![{Path(name).stem}]({name})", "")]
    lines += [*markdown_table(result.rows), ""]
    if result.failed:
        lines += ["## Trials that failed", ""]
        lines += [f"- `{outcome.trial.settings}`: {outcome.failure}" for outcome in result.failed]
    return "\n".join(lines).rstrip() + "\n"


def markdown_table(rows: Sequence[Row]) -> list[str]:
    """Return the lines of a Markdown table; numbers have at most four digits."""
    columns = _columns(rows)
    body = ["| " + " | ".join(format_value(row.get(column)) for column in columns) + " |" for row in rows]
    return ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns), *body] if rows else []


def plan_options(changes: Mapping[str, Mapping[str, object]]) -> str:
    """Return the words of `cell plan` for keys of a scene; keys without an option follow as a comment."""
    words: list[str] = []
    only_in_file: list[str] = []
    known = {key: spec for spec in option_specs(Scene).values() for key in spec.fields}
    for table, keys in changes.items():
        for key, value in keys.items():
            if (table, key) == ("part", "name"):
                words.insert(0, str(value))
            elif f"{table}.{key}" in known:
                values = value if isinstance(value, list | tuple) else [value]
                text = ",".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values)
                words.append(f"{flag(known[f'{table}.{key}'].name)}={text}")
            else:
                only_in_file.append(f"{key} = {json.dumps(value)} under [{table}]")
    comment = f"  # with {', '.join(only_in_file)} in the scene file" if only_in_file else ""
    return shlex.join(words) + comment
