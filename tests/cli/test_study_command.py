"""`cell study` and `cell place`: folders, cached trials, and refused options."""

import csv
import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from cell.study.planned_placement import N_PLANNED
from cell.study.trials import Outcome, Trial, Workers, compute
from tests.support.fixture_types import RunCommand

_COARSE = '[plan]\nfaces = 60\nsamples_per_face = 2\ncandidates = "optimal-scanning-zone"\n'


class _Here(Workers):
    """Workers in this process. tests/faults/test_study_workers.py tests separate processes."""

    def __init__(self, count: int) -> None:
        pass

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Yield the outcome of each trial."""
        for trial in trials:
            yield compute(trial, trial.digest)

    def close(self) -> None:
        """Do nothing: there are no processes."""


@pytest.fixture(scope="module", autouse=True)
def _no_processes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cell.study.trials.Processes", _Here)
        yield


def test_a_study_leaves_rows_and_pictures_and_the_same_bytes_again(
    part_file: Path, tmp_path: Path, run_cell: RunCommand, drawn_pictures: None
) -> None:
    """The page has the command for each row. A repeated study computes nothing and has equal bytes."""
    (tmp_path / "coarse.toml").write_text(_COARSE)
    words = ("study", "standoff", part_file, "--units", "mm", "--scene", "coarse.toml", "--processes", "1")
    process = run_cell(*words, "--values", "210,310", "--out", "a", cwd=tmp_path, code=0)
    assert "2 trials computed now" in process.stdout
    process = run_cell("view", "a", "--no-open", cwd=tmp_path)
    assert (process.returncode, process.stdout) == (0, "a/view.html\n"), process.stderr
    options = "--sensor=paper --standoff=310"
    assert (
        f"cell plan {part_file} --scene coarse.toml --units=mm {options}" in (tmp_path / "a" / "view.html").read_text()
    )
    rows = list(csv.DictReader((tmp_path / "a" / "rows.csv").read_text().splitlines()))
    assert [row["standoff mm"] for row in rows] == ["210.0", "310.0"]
    assert all(int(row["fewest views"]) <= int(row["views"]) for row in rows)
    process = run_cell(*words, "--values", "210,310", "--out", "b", "--json", cwd=tmp_path, code=0)
    assert json.loads(process.stdout)["computed"] == 0
    names = ("rows.csv", "seconds.csv", "study.json", "report.md", "view.html", "standoff.png", "standoff.svg")
    for name in names:
        assert (tmp_path / "a" / name).stat().st_size > 100, name
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_an_added_value_computes_one_trial(part_file: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """The outcomes of the other standoffs are read from the cache."""
    (tmp_path / "coarse.toml").write_text(_COARSE)
    options = ("--units", "mm", "--scene", "coarse.toml", "--processes", "1", "--json")
    arguments = ("study", "standoff", part_file, *options)
    first = run_cell(*arguments, "--values", "200,250", "--out", "a", cwd=tmp_path, code=0)
    assert json.loads(first.stdout)["computed"] == 2
    second = run_cell(*arguments, "--values", "200,250,300", "--out", "b", cwd=tmp_path)
    answer = json.loads(second.stdout)
    assert answer["computed"] == 1
    assert [row["standoff mm"] for row in answer["rows"]] == [200, 250, 300]
    assert "Best standoff distance" in answer["sentences"][0]
    assert answer["sentences"][-1].startswith("The scanner is `paper`")


def test_a_map_names_the_best_placement_and_keeps_unreachable_ones(
    part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """At 9 m nothing is reachable: the row has coverage 0, and the study does not fail."""
    (tmp_path / "coarse.toml").write_text(_COARSE)
    process = run_cell(
        "study", "placement", part_file, "--units", "mm", "--scene", "coarse.toml", "--x", "1000,9000", "--y", "400",
        "--processes", "1", "--out", "map", "--json", cwd=tmp_path, code=0,
    )  # fmt: skip
    answer = json.loads(process.stdout)
    near, far = answer["rows"]
    assert (near["x mm"], far["x mm"]) == (1000, 9000)
    assert near["coverable %"] > 50
    assert (far["coverable %"], far["views"], far["cycle s"]) == (0, None, None)
    assert "--place 1000,400,0,0,0,0" in answer["sentences"][0]
    assert answer["commands"][0] == f"cell plan {part_file} --scene coarse.toml --units=mm --place 1000,400,0,0,0,0"
    assert answer["best"] == 0
    assert (tmp_path / "map" / "map_z0_yaw0.png").is_file()


def test_the_recommended_placement_is_no_worse_than_that_of_the_scene(
    part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """The printed command gives the coverage, views and time of its row; the placement of the scene is planned too."""
    (tmp_path / "coarse.toml").write_text(_COARSE + "[placement]\nposition_mm = [1150, 420, 60]\n")
    options = ("--units", "mm", "--scene", "coarse.toml")
    process = run_cell(
        "study", "placement", part_file, *options, "--x", "1000,1300", "--y", "300,600", "--z", "0,100",
        "--processes", "1", "--out", "map", "--json", cwd=tmp_path, code=0,
    )  # fmt: skip
    answer = json.loads(process.stdout)
    (best,) = [row for row in answer["rows"] if row["best"]]
    assert answer["rows"][answer["best"]] == best
    (own,) = [row for row in answer["rows"] if (row["x mm"], row["y mm"], row["z mm"]) == (1150, 420, 60)]
    assert own["reachable %"] is None  # not on the grid: only planned
    assert sum(row["planned views"] is not None for row in answer["rows"]) == N_PLANNED + 1
    planned = {}
    for name, command in (("best", answer["commands"][answer["best"]]), ("scene", "cell plan --scene coarse.toml")):
        words = shlex.split(command)[1:] if name == "best" else ["plan", part_file, *options]
        report = json.loads(run_cell(*words, "--json", "--out", name, cwd=tmp_path, code=0).stdout)
        planned[name] = report["coverage"]["visible"], report["n_views"], report["motion"]["duration_s"]
    for name, row in (("best", best), ("scene", own)):
        visible, views, seconds = planned[name]
        assert (row["planned %"], row["planned views"]) == (pytest.approx(100 * visible), views)
        assert row["planned s"] == pytest.approx(seconds, abs=1e-3)
    key = {name: (-visible, views, seconds) for name, (visible, views, seconds) in planned.items()}
    assert key["best"] <= key["scene"]


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
        (("study", "table1", "--part", "mug"), 2, "is now python -m benchmarks paper table1"),
        (("study", "speed", "samples", "--values", "1,4"), 2, "is now python -m benchmarks speed"),
        (("study", "stability", "ik", "--quick"), 2, "is now python -m benchmarks stability"),
        (("study", "standoff", "--processes", "0"), 2, "--processes 0"),
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
    arguments: tuple[str, ...], code: int, words: str, part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """The error has no traceback, nothing on stdout, and no folder is created."""
    process = run_cell(*(part_file if word == "PART" else word for word in arguments), cwd=tmp_path, code=code)
    assert words in process.stderr
    assert process.stdout == ""
    assert not (tmp_path / "sim_runs").exists()
