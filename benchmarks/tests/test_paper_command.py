"""`python -m benchmarks paper`: rows, pictures and trends of a reduced table, and refused options."""

import csv
import json
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from benchmarks.paper.study import TOLERANCE_POINTS
from planner.cover import DEFAULT_EFFORT, solve

Run = Callable[..., subprocess.CompletedProcess[str]]

_TABLE = ("table2", "--part", "mug", "--faces-share", "0.05", "--processes", "1")


@pytest.fixture(scope="module")
def table(
    run_benchmarks: Run, made_once: Callable[..., Path], drawing: Callable[[], AbstractContextManager[None]]
) -> Path:
    """Return the folder of a reduced table of one part."""

    def make(folder: Path) -> None:
        with drawing(), pytest.MonkeyPatch.context() as patch:
            patch.setattr(solve, "__kwdefaults__", {**solve.__kwdefaults__, "effort_budget": DEFAULT_EFFORT // 60})
            process = run_benchmarks("paper", *_TABLE, "--out", "table", cwd=folder)
        assert process.returncode == 0, process.stderr
        assert "4 trials computed now" in process.stdout

    return made_once("study", make) / "table"


def test_a_table_leaves_tidy_rows_and_pictures(table: Path, run_cell: Run) -> None:
    """A row has the values of the paper, its method and ours.

    The page has the command that plans each row. Report, tables and pictures are written.
    """
    process = run_cell("view", table, "--no-open", cwd=table)
    assert (process.returncode, process.stdout) == (0, f"{table / 'view.html'}\n"), process.stderr
    options = "--sensor=paper --roll=0 --candidates=optimal-scanning-zone --faces=37 --samples=80 --standoff=300"
    assert f"cell plan mug {options}" in (table / "view.html").read_text()
    rows = list(csv.DictReader((table / "rows.csv").read_text().splitlines()))
    assert [row["parameter"] for row in rows] == ["50", "100", "300", "500"]
    assert [row["views paper"] for row in rows] == ["13", "12", "58", "107"]
    for row in rows:
        assert int(row["bound ours"]) <= int(row["views ours"])
        assert 0 <= float(row["visible ours %"]) <= 100
    for name in ("report.md", "study.json", "seconds.csv", "table2.png", "table2.svg"):
        assert (table / name).stat().st_size > 100, name


def test_the_paper_s_trend_and_that_ours_needs_no_more_views(table: Path) -> None:
    """The best standoff lies inside the range.

    At equal coverage ours has no more views than the method of the paper. test_paper_trends.py has all tables (slow).
    """
    rows = list(csv.DictReader((table / "rows.csv").read_text().splitlines()))
    views = [int(row["views rays"]) for row in rows]
    assert min(views[1:-1]) <= min(views[0], views[-1]) < max(views)
    for row in rows:
        assert int(row["views ours at visible rays"]) <= int(row["views rays"]), row
        assert float(row["visible ours at views rays %"]) >= float(row["visible rays %"]) - TOLERANCE_POINTS, row
        assert int(row["bound rays"]) <= int(row["views rays"])


@pytest.mark.usefixtures("drawn_pictures")
def test_the_same_study_again_computes_nothing_and_leaves_the_same_bytes(
    table: Path, tmp_path: Path, run_benchmarks: Run
) -> None:
    """A repeated study computes nothing and writes the same rows, report and pictures."""
    process = run_benchmarks("paper", *_TABLE, "--out", "again", "--json", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    assert json.loads(process.stdout)["computed"] == 0
    for name in ("rows.csv", "seconds.csv", "study.json", "report.md", "view.html", "table2.png", "table2.svg"):
        assert (table / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("table9",), "table9 is no table"),
        (("table1", "--part", "teapot"), "teapot"),
        (("table1", "--faces-share", "0"), "--faces-share"),
        (("table1", "--processes", "0"), "--processes 0"),
    ],
)
def test_wrong_options_end_with_one_sentence(
    words: tuple[str, ...], sentence: str, run_benchmarks: Run, tmp_path: Path
) -> None:
    """Wrong options end with exit code 2 and one sentence on stderr, without a folder."""
    process = run_benchmarks("paper", *words, cwd=tmp_path)
    assert process.returncode == 2, process.stderr
    assert sentence in process.stderr
    assert process.stdout == ""
    assert not list(tmp_path.iterdir())
