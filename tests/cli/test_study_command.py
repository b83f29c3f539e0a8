"""`cell study` and `cell place` from the command line: folders, resumption, and what is refused."""

import csv
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

_TABLE = ("study", "table2", "--part", "humerus", "--faces-share", "0.1", "--processes", "1")


@pytest.fixture(scope="module")
def table(run_cell: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reduced table of one part."""
    folder = tmp_path_factory.mktemp("study")
    done = run_cell(*_TABLE, "--out", "table", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "4 trials computed now" in done.stdout
    return folder / "table"


def test_a_table_leaves_tidy_rows_and_pictures(table: Path) -> None:
    """Paper, its method and ours in one row."""
    rows = list(csv.DictReader((table / "rows.csv").read_text().splitlines()))
    assert [row["parameter"] for row in rows] == ["5", "10", "30", "50"]
    assert [row["views paper"] for row in rows] == ["17", "10", "6", "7"]
    for row in rows:
        assert int(row["bound ours"]) <= int(row["views ours"])
        assert 0 <= float(row["visible ours %"]) <= 100
    for name in ("report.md", "study.json", "seconds.csv", "table2.png", "table2.svg"):
        assert (table / name).stat().st_size > 100, name


def test_the_same_study_again_computes_nothing_and_leaves_the_same_bytes(table: Path, run_cell: Run) -> None:
    """Rows, report and pictures."""
    done = run_cell(*_TABLE, "--out", "again", "--json", cwd=table.parent)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["computed"] == 0
    for name in ("rows.csv", "seconds.csv", "study.json", "report.md", "table2.png", "table2.svg"):
        assert (table / name).read_bytes() == (table.parent / "again" / name).read_bytes(), name


def test_a_changed_parameter_computes_only_what_depends_on_it(table: Path, run_cell: Run) -> None:
    """One more standoff costs one trial."""
    arguments = ("study", "standoff", "humerus", "--processes", "1", "--json")
    first = run_cell(*arguments, "--values", "20,30", "--out", "a", cwd=table.parent)
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["computed"] == 2
    second = run_cell(*arguments, "--values", "20,30,40", "--out", "b", cwd=table.parent)
    answer = json.loads(second.stdout)
    assert answer["computed"] == 1
    assert [row["standoff mm"] for row in answer["rows"]] == [20, 30, 40]
    assert "Best standoff distance" in answer["sentences"][0]


def test_a_map_names_the_best_place_and_keeps_places_out_of_reach(run_cell: Run, tmp_path: Path) -> None:
    """At 9 m nothing is reached: a row with zero, not a failure."""
    done = run_cell(
        "study", "placement", "petanque", "--x", "1000,9000", "--y", "400", "--processes", "1",
        "--out", "map", "--json", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    near, far = answer["rows"]
    assert (near["x mm"], far["x mm"]) == (1000, 9000)
    assert near["coverable %"] > 50
    assert (far["coverable %"], far["views"], far["cycle s"]) == (0, None, None)
    assert "--place 1000,400,0" in answer["sentences"][0]
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
        (("study", "table1", "--part", "teapot"), 2, "teapot"),
        (("study", "speed", "samples", "--values", "1,4"), 2, "is now python -m benchmarks speed"),
        (("study", "stability", "ik", "--quick"), 2, "is now python -m benchmarks stability"),
        (("study", "table1", "--faces-share", "0"), 2, "--faces-share"),
        (("study", "table1", "--processes", "0"), 2, "--processes 0"),
        (("study", "table5", "--cluster", "no://where:1"), 2, "no://where:1"),
        (("study", "placement", "teapot"), 2, "teapot"),
        (("place", "--x", "9:1"), 2, "--x 9:1"),
        (("place", "petanque", "--x", "9000", "--y", "0", "--z", "0", "--yaw", "0", "--processes", "1"), 4, "nothing"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_gets_one_sentence_and_its_code(
    arguments: tuple[str, ...], code: int, words: str, run_cell: Run, tmp_path: Path
) -> None:
    """No traceback, nothing on stdout, no folder."""
    done = run_cell(*arguments, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert done.stdout == ""
    assert not (tmp_path / "sim_runs").exists()
