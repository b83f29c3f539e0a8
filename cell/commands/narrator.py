"""What a person sees while a command runs: stages with progress on stderr, notes, and the summary tables at the end."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

if TYPE_CHECKING:
    from cell.plan.pipeline import PlanOutcome
    from cell.scan.work import ScanOutcome
    from cell.study.study import StudyResult
    from cell.why.explain import WhyOutcome
    from cell.world.check import CheckResult

log = logging.getLogger(__name__)
log.addHandler(logging.NullHandler())  # without a run.log, Python would print each warning a second time

_ROWS_SHOWN = 100

ProgressCallback = Callable[[int, int], None]


class Narrator:
    """Progress and notes go to stderr (a bar only on a terminal), results to stdout."""

    def __init__(self, *, quiet_stdout: bool = False) -> None:
        """Open the consoles.

        Args:
            quiet_stdout: leave stdout to a JSON object.
        """
        self._errors = Console(stderr=True, highlight=False)
        self._results = self._errors if quiet_stdout else Console(highlight=False)

    @contextmanager
    def stage(self, name: str, *, time_left: bool = False) -> Iterator[ProgressCallback]:
        """Show a stage while it runs.

        Args:
            name: of the stage.
            time_left: whether the time left is told beside the time that has passed.

        Yields:
            a callback `(done, total)` for stages that can tell how far they are.
        """
        log.info("stage: %s", name)
        left: tuple[ProgressColumn, ...] = (TextColumn("left"), TimeRemainingColumn()) if time_left else ()
        with Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<28}"),
            BarColumn(bar_width=30),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            *left,
            console=self._errors,
            transient=True,
            disable=not self._errors.is_terminal,
        ) as progress:
            task = progress.add_task(name, total=None)
            yield lambda done, total: progress.update(task, completed=done, total=total)

    @contextmanager
    def rounds(self) -> Iterator[Callable[[str, int, int], None]]:
        """Show work in rounds that are not known beforehand, a bar each.

        Yields:
            a callback `(round, done, total)`.
        """
        with Progress(
            TextColumn("{task.description:<28}"),
            BarColumn(bar_width=30),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            console=self._errors,
            transient=True,
            disable=not self._errors.is_terminal,
        ) as progress:
            bars: dict[str, TaskID] = {}

            def told(name: str, done: int, total: int) -> None:
                if name not in bars:
                    log.info("round: %s", name)
                    bars[name] = progress.add_task(name, total=total)
                progress.update(bars[name], completed=done, total=total)

            yield told

    def ask(self, question: str) -> str:
        """Put a question to the person at the terminal and return the answer; Ctrl-D is none."""
        try:
            return self._errors.input(question, markup=False)
        except EOFError:
            return ""

    def note(self, sentence: str) -> None:
        """Say something that the user should know although the work goes on."""
        log.warning("%s", sentence)
        self._errors.print(f"note: {sentence}", markup=False, soft_wrap=True)

    def plan_table(self, outcome: "PlanOutcome") -> None:
        """The summary of a plan."""
        from cell.plan import told as requests

        summary = outcome.summary
        coverage, motion = summary["coverage"], summary["motion"]
        table = Table(title=f"View plan of {summary['part']['name']}", title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column()
        table.add_row("views", f"{summary['n_views']}  ({summary['status']})")
        table.add_row("lower bound", f"{_views(summary['lower_bound'])} for these candidates and samples")
        table.add_row(
            "visible coverage",
            f"{100 * coverage['visible']:.2f} % of the surface, "
            f"{100 * coverage['visible_of_coverable']:.2f} % of what reachable candidates can measure",
        )
        for name, told in requests.rows(summary):
            table.add_row(name, told)
        verdicts = summary["verdicts"]
        table.add_row("candidates", ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in verdicts.items()))
        if summary["dropped"]:
            table.add_row("dropped", "; ".join(f"view {view['id']}: {view['reason']}" for view in summary["dropped"]))
        clearance, bound = motion["minimum_clearance_mm"], motion["jerk_free_bound_s"]
        table.add_row(
            "motion",
            f"{motion['duration_s']:.1f} s from home to home through {motion['via_points']} points"
            + (f", {motion['duration_s'] / bound:.3f} x the time-optimal bound without jerk limit" if bound else "")
            + ("" if clearance is None else f"; nearest {clearance:.1f} mm ({motion['between']})"),
        )
        table.add_row("run folder", str(outcome.folder))
        self._results.print(table)

    def study_table(self, result: "StudyResult") -> None:
        """What a study says; the rows are in its folder."""
        from cell.study.study import shown

        if result.rows:
            table = Table(*result.shown)
            for row in result.rows[:_ROWS_SHOWN]:
                table.add_row(*(shown(row.get(column)) for column in result.shown))
            self._results.print(table)
            if len(result.rows) > _ROWS_SHOWN:
                self._results.print(f"... and {len(result.rows) - _ROWS_SHOWN} rows more in rows.csv")
        for sentence in result.sentences:
            self._results.print(sentence, markup=False)
        kept = len(result.rows) and f"{result.computed} trials computed now"
        failed = f", {len(result.failed)} failed (see report.md)" if result.failed else ""
        self._results.print(f"{kept or 'nothing succeeded'}{failed}; study folder {result.folder}", markup=False)

    def scan_table(self, outcome: "ScanOutcome") -> None:
        """The summary of an execution."""
        from cell.scan.execution_report import left_as_reported

        summary = outcome.summary
        coverage, deviation, registration = summary["coverage"], summary["deviation"], summary["registration"]
        motion, cloud = summary["motion"], summary["cloud"]
        table = Table(title=f"Scan of {summary['part']['name']}", title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column()
        missing = "" if summary["complete"] else "  (not complete, see report.md)"
        table.add_row("views", f"{summary['n_views']} of {summary['n_views_planned']}{missing}")
        table.add_row("points", f"{summary['n_points']:,}")
        table.add_row(
            "visible coverage",
            f"{100 * coverage['visible']:.2f} % of the surface, predicted {100 * coverage['predicted']:.2f} %",
        )
        table.add_row(
            "sampled coverage",
            f"{100 * coverage['sampled']:.2f} % within {coverage['sampled_radius_mm']:.3g} mm of a point",
        )
        if registration is not None and cloud["rms_to_reference_mm"] is not None:
            table.add_row(
                "registration",
                f"points to reference {cloud['rms_to_reference_as_reported_mm']:.4f} mm rms as reported, "
                f"{cloud['rms_to_reference_mm']:.4f} mm registered",
            )
            if left := left_as_reported(summary):
                table.add_row("", left)
        table.add_row(
            "surface",
            summary["model"]["status"]
            if deviation is None
            else f"{summary['model']['faces']:,} faces, deviation {deviation['rms_mm']:.3f} mm rms, "
            f"95 % within {deviation['quantile_95_mm']:.3f} mm, largest {deviation['largest_mm']:.3f} mm",
        )
        took = "" if motion["executed_s"] is None else f", {motion['executed_s']:.1f} s by the controller"
        table.add_row("motion", f"{motion['planned_s']:.1f} s planned{took}")
        table.add_row("execution", str(outcome.folder))
        self._results.print(table)

    def why_table(self, outcome: "WhyOutcome") -> None:
        """Why parts of the surface stay open, by area."""
        from cell.why import files as why_files

        summary = outcome.summary
        table = Table(
            title=f"Why {100 * summary['open']:.2f} % of {summary['part']} stay open",
            title_justify="left",
            show_lines=True,
        )
        for name in ("reason", "of the surface", "where (mm, part)", "what would measure it"):
            table.add_column(name)
        for row in why_files.table_rows(summary):
            table.add_row(*(escape(cell) for cell in row))
        self._results.print(table if summary["groups"] else "nothing stays open")
        self._results.print(f"files: {outcome.folder}", markup=False, soft_wrap=True)

    def check_table(self, result: "CheckResult") -> None:
        """What `cell check` found."""
        table = Table(title="Scene", title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column()
        for name, value in result.rows():
            table.add_row(name, value)
        self._results.print(table)
        for problem in result.problems:
            self._errors.print(f"wrong: {problem}", markup=False, soft_wrap=True)


def _views(number: int) -> str:
    return "1 view" if number == 1 else f"{number} views"
