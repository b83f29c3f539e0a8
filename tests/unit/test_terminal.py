"""Tables of the command line are printed completely at any width of the terminal."""

import numpy as np
import pytest
from rich.progress import Progress

from cell.cli.terminal import Terminal, _Remaining


@pytest.mark.parametrize("seed", range(25))
def test_borders_are_whole_at_any_width(
    seed: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Random tables at random widths have all words, and each line ends with its border."""
    rng = np.random.default_rng(seed)
    width, n_columns = int(rng.integers(50, 120)), int(rng.integers(2, 10))
    monkeypatch.setenv("COLUMNS", str(width))

    def words(most: int) -> str:
        return " ".join("abcdefghijklmnop"[: rng.integers(1, 12)] for _ in range(rng.integers(1, most)))

    columns = [words(3) for _ in range(n_columns)]
    rows = [[words(6) for _ in columns] for _ in range(3)]
    Terminal().print_table(columns, rows)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert {line[-1] for line in lines} == set("┓┃┩│┘")
    assert {word for cell in (*columns, *(each for row in rows for each in row)) for word in cell.split()} <= set(
        " ".join(lines).split()
    )


def test_a_long_stage_tells_each_tenth_where_no_bar_is_seen(capsys: pytest.CaptureFixture[str]) -> None:
    """A long stage writes at most ten lines into a file or a pipe; a short stage writes none."""
    with Terminal().stage("short") as progress:
        progress(1, 1)
    assert capsys.readouterr().err == ""
    with Terminal().stage("long", time_left=True) as progress:
        for n_done in range(87):
            progress(n_done, 86)
    lines = capsys.readouterr().err.splitlines()
    assert (len(lines), lines[0], lines[-1]) == (10, "long: 9 of 86", "long: 86 of 86")


def test_a_bar_states_total_and_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps without a total have none; with a total, the time of the finished steps gives the rest."""
    column, bars = _Remaining(), Progress(get_time=lambda: now)
    now = 0.0
    number = bars.add_task("stage", total=None)
    task = bars.tasks[number]
    assert str(column.render(task)) == ""
    for n_done in range(5):
        now = 10.0 * n_done
        bars.update(task.id, completed=20 * n_done, total=200)
    assert str(column.render(task)) == "80 of 200, 1:00 left"
