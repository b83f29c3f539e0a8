"""`cell study` and `cell place` from the command line: folders, resumption, and what is refused."""

import csv
import json
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Self

import pytest

from cell.study.tables import TOLERANCE_POINTS
from cell.study.trial import Outcome, Trial, compute
from planner.cover import DEFAULT_EFFORT, solve

Run = Callable[..., subprocess.CompletedProcess[str]]

_TABLE = ("study", "table2", "--part", "mug", "--faces-share", "0.05", "--processes", "1")


_COARSE = "[plan]\nfaces = 60\nsamples_per_face = 2\n"


class _Here:
    """Computes trials in this process; those of their own are looked at in tests/faults/test_study_workers.py."""

    def __init__(self, count: int) -> None:
        pass

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Each trial's outcome."""
        for trial in trials:
            yield compute(trial, trial.digest)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass


@pytest.fixture(scope="module", autouse=True)
def _no_processes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cell.study.workers.Processes", _Here)
        yield


@pytest.fixture(scope="module")
def table(run_cell: Run, made_once: Callable[..., Path], drawn: Callable[[], AbstractContextManager[None]]) -> Path:
    """A reduced table of one part."""

    def make(folder: Path) -> None:
        with drawn(), pytest.MonkeyPatch.context() as patch:
            patch.setattr(solve, "__kwdefaults__", {**solve.__kwdefaults__, "budget": DEFAULT_EFFORT // 60})
            done = run_cell(*_TABLE, "--out", "table", cwd=folder)
        assert done.returncode == 0, done.stderr
        assert "4 trials computed now" in done.stdout

    return made_once("study", make) / "table"


def test_a_table_leaves_tidy_rows_and_pictures(table: Path, run_cell: Run) -> None:
    """Paper, its method and ours in one row; the page, which cell view shows, has what plans each."""
    done = run_cell("view", table, "--no-open", cwd=table)
    assert (done.returncode, done.stdout) == (0, f"{table / 'view.html'}\n"), done.stderr
    wish = "--sensor=paper --roll=0 --candidates=optimal-scanning-zone --faces=37 --samples=80 --standoff=300"
    assert f"cell plan mug {wish}" in (table / "view.html").read_text()
    rows = list(csv.DictReader((table / "rows.csv").read_text().splitlines()))
    assert [row["parameter"] for row in rows] == ["50", "100", "300", "500"]
    assert [row["views paper"] for row in rows] == ["13", "12", "58", "107"]
    for row in rows:
        assert int(row["bound ours"]) <= int(row["views ours"])
        assert 0 <= float(row["visible ours %"]) <= 100
    for name in ("report.md", "study.json", "seconds.csv", "table2.png", "table2.svg"):
        assert (table / name).stat().st_size > 100, name


def test_the_paper_s_trend_and_that_ours_needs_no_more_views(table: Path) -> None:
    """There is a best standoff inside; at the coverage of the paper's method ours has no more views. All tables: slow.

    tests/golden/test_paper_trends.py has that form.
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
    table: Path, tmp_path: Path, run_cell: Run
) -> None:
    """Rows, report and pictures."""
    done = run_cell(*_TABLE, "--out", "again", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["computed"] == 0
    for name in ("rows.csv", "seconds.csv", "study.json", "report.md", "view.html", "table2.png", "table2.svg"):
        assert (table / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_a_changed_parameter_computes_only_what_depends_on_it(part_file: Path, tmp_path: Path, run_cell: Run) -> None:
    """One more standoff costs one trial."""
    (tmp_path / "coarse.toml").write_text(_COARSE)
    options = ("--units", "mm", "--scene", "coarse.toml", "--processes", "1", "--json")
    arguments = ("study", "standoff", part_file, *options)
    first = run_cell(*arguments, "--values", "200,250", "--out", "a", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["computed"] == 2
    second = run_cell(*arguments, "--values", "200,250,300", "--out", "b", cwd=tmp_path)
    answer = json.loads(second.stdout)
    assert answer["computed"] == 1
    assert [row["standoff mm"] for row in answer["rows"]] == [200, 250, 300]
    assert "Best standoff distance" in answer["sentences"][0]
    assert answer["sentences"][-1].startswith("The scanner is `paper`")


def test_a_map_names_the_best_place_and_keeps_places_out_of_reach(
    part_file: Path, run_cell: Run, tmp_path: Path
) -> None:
    """At 9 m nothing is reached: a row with zero, not a failure."""
    (tmp_path / "coarse.toml").write_text(_COARSE)
    done = run_cell(
        "study", "placement", part_file, "--units", "mm", "--scene", "coarse.toml", "--x", "1000,9000", "--y", "400",
        "--processes", "1", "--out", "map", "--json", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    near, far = answer["rows"]
    assert (near["x mm"], far["x mm"]) == (1000, 9000)
    assert near["coverable %"] > 50
    assert (far["coverable %"], far["views"], far["cycle s"]) == (0, None, None)
    assert "--place 1000,400,0,0,0,0" in answer["sentences"][0]
    assert answer["commands"][0] == f"cell plan {part_file} --scene coarse.toml --units=mm --place 1000,400,0,0,0,0"
    assert answer["best"] == 0
    assert (tmp_path / "map" / "map_z0_yaw0.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("study", "placement", "--x", "5:1:1"), 2, "--x 5:1:1"),
        (("study", "standoff", "--values", "-5"), 2, "standoff"),
        (("study", "scanner"), 2, "give one of"),
        (("study", "scanner", "--fov", "10", "--baseline", "5"), 2, "give one of"),
        (("study", "scanner", "--fov", "200"), 2, "below 180"),
        (("study", "scanner", "--sensors", "nosuch"), 2, "nosuch"),
        (("study", "scanner", "--sensors", "gocator-2340"), 2, "does not state its baseline"),
        (("study", "scanner", "--sensors", "gocator-2340,nosuch", "--baseline", "100"), 2, "nosuch"),
        (("study", "table1", "--part", "teapot"), 2, "teapot"),
        (("study", "speed", "samples", "--values", "1,4"), 2, "is now python -m benchmarks speed"),
        (("study", "stability", "ik", "--quick"), 2, "is now python -m benchmarks stability"),
        (("study", "table1", "--faces-share", "0"), 2, "--faces-share"),
        (("study", "table1", "--processes", "0"), 2, "--processes 0"),
        (("study", "placement", "teapot"), 2, "teapot"),
        (("place", "--x", "9:1"), 2, "--x 9:1"),
        (
            ("place", "PART", "--units", "mm", "--x", "9000", "--y", "0", "--z", "0", "--yaw", "0", "--processes", "1"),
            4,
            "nothing",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_gets_one_sentence_and_its_code(
    arguments: tuple[str, ...],
    code: int,
    words: str,
    part_file: Path,
    run_cell: Run,
    tmp_path: Path,
) -> None:
    """No traceback, nothing on stdout, no folder."""
    done = run_cell(*(part_file if word == "PART" else word for word in arguments), cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert done.stdout == ""
    assert not (tmp_path / "sim_runs").exists()
