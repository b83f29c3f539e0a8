"""Output of a command: progress and notes on stderr, result tables on stdout."""

import logging
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Progress as Bars
from rich.table import Table
from rich.text import Text

from cell.cli.options import print_json
from planner.ports import Progress

log = logging.getLogger("cell.session")

_ROWS_SHOWN = 100
_FRAME = 3  # characters between two columns of a table


class Terminal:
    """Reporter of the command line: progress and notes on stderr (a bar only on a terminal), results on stdout."""

    def __init__(self, *, quiet_stdout: bool = False) -> None:
        """Open the consoles.

        Args:
            quiet_stdout: whether stdout is kept for one JSON object; tables then go to stderr.
        """
        self._errors = Console(stderr=True, highlight=False)
        self._results = self._errors if quiet_stdout else Console(highlight=False)
        first_time = logging.Handler()
        first_time.emit = lambda record: self.print_error(f"note: {record.getMessage()}")  # type: ignore[method-assign]
        for name in ("planner.compiled", "cell.world.self_collision"):
            logging.getLogger(name).handlers = [first_time]

    @contextmanager
    def stage(self, name: str, *, time_left: bool = False) -> Iterator[Progress]:
        """Show a stage while it runs; see `cell.session.ProgressReporter`."""
        log.info("stage: %s", name)
        with self._bars(spinner=True) as bars:
            task, tenths = bars.add_task(name, total=None), 0

            def update(n_done: int, total: int) -> None:
                nonlocal tenths
                bars.update(task, completed=n_done, total=total)
                reached = 10 * n_done // max(total, 1)
                if time_left and not self._errors.is_terminal and reached > tenths:  # long stages, written to a file
                    tenths = reached
                    self.print_error(f"{name}: {n_done} of {total}")

            yield update

    @contextmanager
    def rounds(self) -> Iterator[Callable[[str, int, int], None]]:
        """Show rounds of work, with a bar for each round when it begins.

        Yields:
            a callback `(round, done, total)`.
        """
        with self._bars() as bars:
            tasks: dict[str, TaskID] = {}

            def update(name: str, n_done: int, total: int) -> None:
                if name not in tasks:
                    log.info("round: %s", name)
                    tasks[name] = bars.add_task(name, total=total)
                bars.update(tasks[name], completed=n_done, total=total)

            yield update

    def ask(self, question: str) -> str:
        """Put a question to the person at the terminal and return the answer; Ctrl-D returns an empty one."""
        try:
            return self._errors.input(question, markup=False)
        except EOFError:
            return ""

    def note(self, sentence: str) -> None:
        """Report a finding that the user should know although the command continues."""
        log.warning("%s", sentence)
        self.print_error(f"note: {sentence}")

    def print_error(self, sentence: str) -> None:
        """Print a sentence on stderr."""
        self._errors.print(sentence, markup=False, soft_wrap=True)

    def print(self, sentence: str) -> None:
        """Print a sentence of the result."""
        self._results.print(sentence, markup=False, soft_wrap=True)

    def suggest(self, *commands: Sequence[object]) -> None:
        """Print next commands, each given by its words, as lines that can be pasted."""
        self.print("next:")
        for words in commands:
            self.print(f"  {shlex.join(map(str, words))}")

    def print_result(
        self, content: Mapping[str, object], title: str, rows: Iterable[tuple[str, str]], *following: Sequence[object]
    ) -> None:
        """Print the result of a command: one JSON object with --json, else names, values and next commands."""
        if self._results is self._errors:
            print_json(content)
            return
        self.print_pairs(title, rows)
        if following:
            self.suggest(*following)

    def print_pairs(self, title: str, rows: Iterable[tuple[str, str]]) -> None:
        """Print names and values under a title."""
        table = Table(title=escape(title), title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        for name, value in rows:
            table.add_row(name, escape(value))
        self._results.print(table)

    def print_table(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        title: str | None = None,
        at_most: int = _ROWS_SHOWN,
    ) -> None:
        """Print at most `at_most` rows; with a title, lines separate them.

        Columns that do not fit beside each other follow in further tables, each with the first column again.
        """
        shown_rows = rows[:at_most]
        cells = [[column, *(row[i] for row in shown_rows)] for i, column in enumerate(columns)]
        narrowest = [max((cell_len(word) for cell in each for word in cell.split()), default=0) for each in cells]
        widest = [max(cell_len(line) for cell in each for line in cell.split("\n")) for each in cells]
        groups = [[0]]
        for column in range(1, len(columns)):
            needed = 1 + sum(narrowest[i] + _FRAME for i in (*groups[-1], column))
            if needed > self._results.width and groups[-1] != [0]:
                groups.append([0])
            groups[-1].append(column)
        for group in groups:
            table = Table(title=title, title_justify="left", show_lines=title is not None)
            room = self._results.width - 1 - _FRAME * len(group)
            widths = _widths([narrowest[i] for i in group], [widest[i] for i in group], room)
            for column, width in zip(group, widths, strict=True):
                table.add_column(escape(columns[column]), overflow="fold", width=width)
            for row in shown_rows:
                table.add_row(*(escape(row[column]) for column in group))
            self._results.print(table)
        if len(rows) > at_most:
            self.print(f"... and {len(rows) - at_most} rows more")

    def _bars(self, *, spinner: bool = False) -> Bars:
        first = (SpinnerColumn(),) if spinner else ()
        return Bars(
            *first,
            TextColumn("{task.description:<28}"),
            BarColumn(bar_width=30),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            _Remaining(),
            console=self._errors,
            transient=True,
            disable=not self._errors.is_terminal,
        )


class _Remaining(ProgressColumn):
    """Finished steps, their total and the remaining time; empty without a total."""

    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        """Return the text of a task."""
        if task.total is None or task.finished:
            return Text("")
        seconds = task.time_remaining
        left = "" if seconds is None else f", {seconds // 60:.0f}:{seconds % 60:02.0f} left"
        return Text(f"{task.completed:,.0f} of {task.total:,.0f}{left}")


def _widths(narrowest: Sequence[int], widest: Sequence[int], room: int) -> list[int]:
    """Return column widths between those of the longest words and of the longest lines, within the room.

    Rich's own widths can exceed the room although the narrowest widths do not, and are cut then.
    """
    widths = list(narrowest)
    widths[-1] = min(widths[-1], max(room - sum(widths[:-1]), 1))  # a word that is longer than a line is folded
    while (spare := room - sum(widths)) > 0 and (narrow := [i for i, width in enumerate(widths) if width < widest[i]]):
        for i in narrow[:spare]:
            widths[i] += 1
    return widths
