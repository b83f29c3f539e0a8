"""What a person sees while a command runs: stages with progress on stderr, notes, and the tables at the end."""

import logging
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars
from rich.table import Table

from planner.ports import Progress

log = logging.getLogger("cell.session")

_ROWS_SHOWN = 100
_FRAME = 3  # characters between two columns of a table


class Terminal:
    """The reporter of the command line: progress and notes on stderr (a bar only on a terminal), results on stdout."""

    def __init__(self, *, quiet_stdout: bool = False) -> None:
        """Open the consoles."""
        self._errors = Console(stderr=True, highlight=False)
        self._results = self._errors if quiet_stdout else Console(highlight=False)
        compiling = logging.Handler()
        compiling.emit = lambda record: self.error(f"note: {record.getMessage()}")  # type: ignore[method-assign]
        logging.getLogger("planner.compiled").handlers = [compiling]

    @contextmanager
    def stage(self, name: str, *, time_left: bool = False) -> Iterator[Progress]:
        """Show a stage while it runs; see `cell.session.ProgressReporter`."""
        log.info("stage: %s", name)
        left: tuple[ProgressColumn, ...] = (TextColumn("left"), TimeRemainingColumn()) if time_left else ()
        with self._bars(*left, spinner=True) as bars:
            task, tenths = bars.add_task(name, total=None), 0

            def told(done: int, total: int) -> None:
                nonlocal tenths
                bars.update(task, completed=done, total=total)
                reached = 10 * done // max(total, 1)
                if time_left and not self._errors.is_terminal and reached > tenths:  # minutes to hours, into a file
                    tenths = reached
                    self.error(f"{name}: {done} of {total}")

            yield told

    @contextmanager
    def rounds(self) -> Iterator[Callable[[str, int, int], None]]:
        """Show work in rounds that are not known beforehand, a bar each.

        Yields:
            a callback `(round, done, total)`.
        """
        with self._bars() as bars:
            tasks: dict[str, TaskID] = {}

            def told(name: str, done: int, total: int) -> None:
                if name not in tasks:
                    log.info("round: %s", name)
                    tasks[name] = bars.add_task(name, total=total)
                bars.update(tasks[name], completed=done, total=total)

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
        self.error(f"note: {sentence}")

    def error(self, sentence: str) -> None:
        """Say something on stderr that is part of the answer."""
        self._errors.print(sentence, markup=False, soft_wrap=True)

    def say(self, sentence: str) -> None:
        """Say something as a result."""
        self._results.print(sentence, markup=False, soft_wrap=True)

    def then(self, *commands: Sequence[object] | str) -> None:
        """What to do next: lines that can be pasted, of words, or as they are."""
        self.say("next:")
        for words in commands:
            self.say(f"  {words if isinstance(words, str) else shlex.join(map(str, words))}")

    def pairs(self, title: str, rows: Iterable[tuple[str, str]]) -> None:
        """A result of names and values, under a title."""
        table = Table(title=escape(title), title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        for name, value in rows:
            table.add_row(name, escape(value))
        self._results.print(table)

    def grid(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        title: str | None = None,
        at_most: int = _ROWS_SHOWN,
    ) -> None:
        """A result of rows and columns, no more than `at_most` of them; a title makes lines between the rows.

        Nothing is cut: columns that do not fit beside each other stand below, the first one in front of them again.
        """
        shown_rows = rows[:at_most]
        cells = [[column, *(row[i] for row in shown_rows)] for i, column in enumerate(columns)]
        least = [max((cell_len(word) for cell in each for word in cell.split()), default=0) for each in cells]
        most = [max(cell_len(line) for cell in each for line in cell.split("\n")) for each in cells]
        groups = [[0]]
        for column in range(1, len(columns)):
            if 1 + sum(least[i] + _FRAME for i in (*groups[-1], column)) > self._results.width and groups[-1] != [0]:
                groups.append([0])
            groups[-1].append(column)
        for shown in groups:
            table = Table(title=title, title_justify="left", show_lines=title is not None)
            room = self._results.width - 1 - _FRAME * len(shown)
            for column, width in zip(
                shown, _widths([least[i] for i in shown], [most[i] for i in shown], room), strict=True
            ):
                table.add_column(escape(columns[column]), overflow="fold", width=width)
            for row in shown_rows:
                table.add_row(*(escape(row[column]) for column in shown))
            self._results.print(table)
        if len(rows) > at_most:
            self.say(f"... and {len(rows) - at_most} rows more")

    def _bars(self, *columns: ProgressColumn, spinner: bool = False) -> Bars:
        first = (SpinnerColumn(),) if spinner else ()
        return Bars(
            *first,
            TextColumn("{task.description:<28}"),
            BarColumn(bar_width=30),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            *columns,
            console=self._errors,
            transient=True,
            disable=not self._errors.is_terminal,
        )


def without(argv: Sequence[str], option: str) -> list[str]:
    """The words of a command without an option and its value."""
    words = [word for word in argv if not word.startswith(f"{option}=")]
    while option in words:
        at = words.index(option)
        del words[at : at + 2]
    return words


def _widths(least: Sequence[int], most: Sequence[int], room: int) -> list[int]:
    """Widths of columns between what their longest words and their longest lines need, in all no more than there is.

    Rich's own choice may need more than the room although the least widths do not, and is cut then.
    """
    widths = list(least)
    widths[-1] = min(widths[-1], max(room - sum(widths[:-1]), 1))  # a word that is longer than a line is folded
    while (spare := room - sum(widths)) > 0 and (narrow := [i for i, width in enumerate(widths) if width < most[i]]):
        for i in narrow[:spare]:
            widths[i] += 1
    return widths
