"""`cell study speed` from the command line, reduced: a front's files, its values again, and what is refused."""

import csv
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

_FRONT = ("study", "speed", "samples", "petanque", "--values", "1,4", "--repeats", "1")


@pytest.fixture(scope="module")
def front(run_cell: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A front of two points."""
    folder = tmp_path_factory.mktemp("speed")
    done = run_cell(*_FRONT, "--out", "front", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "front"


def _rows(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "rows.csv").read_text().splitlines()))


def test_a_front_leaves_seconds_and_errors_and_pictures(front: Path) -> None:
    """Tidy rows; the default is marked."""
    rows = _rows(front)
    assert [(row["knob"], row["part"], row["value"]) for row in rows] == [
        ("samples", "petanque", "1"), ("samples", "petanque", "4"),
    ]  # fmt: skip
    assert [row["presets"] for row in rows] == ["", "balanced"]
    for row in rows:
        assert float(row["seconds"]) > 0
        assert float(row["processor s"]) > 0
        assert 0 <= float(row["error"]) <= 100
    for name in ("report.md", "study.json", "seconds.csv", "speed_fronts.png", "speed_fronts.svg"):
        assert (front / name).stat().st_size > 100, name


def test_the_same_front_again_is_kept_and_computed_anew_has_the_same_errors(
    front: Path, run_cell: Run, tmp_path: Path
) -> None:
    """Another number of repeats is another trial: its seconds differ, its errors do not."""
    again = run_cell(*_FRONT, "--out", "again", "--json", cwd=front.parent)
    assert json.loads(again.stdout)["computed"] == 0
    anew = run_cell(*_FRONT[:-1], "2", "--out", "anew", "--json", cwd=tmp_path)
    assert json.loads(anew.stdout)["computed"] == 2
    own = ("error", "views", "visible %")
    assert [[row[key] for key in own] for row in _rows(front)] == [
        [row[key] for key in own] for row in _rows(tmp_path / "anew")
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("study", "speed", "sampels", "mug"), "did you mean samples"),
        (("study", "speed", "samples", "teapot"), "teapot"),
        (("study", "speed", "--values", "1,4"), "--values"),
        (("study", "speed", "whole", "--values", "1,4"), "--values"),
        (("study", "speed", "samples", "--values", "1,many"), "many"),
        (("study", "speed", "samples", "--repeats", "0"), "--repeats 0"),
        (("plan", "--preset", "quick"), "--preset is 'quick'"),
        (("check", "--preset", "quick"), "--preset is 'quick'"),
        (("place", "--preset", "quick"), "--preset is 'quick'"),
        (("study", "standoff", "--preset", "quick"), "--preset is 'quick'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_is_refused(arguments: tuple[str, ...], words: str, run_cell: Run, tmp_path: Path) -> None:
    """One sentence, exit code 2, nothing left behind."""
    done = run_cell(*arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_preset_is_recorded_and_what_it_fills_in(run_cell: Run, tmp_path: Path) -> None:
    """An option goes before it."""
    done = run_cell(
        "plan", "petanque", "--preset", "fast", "--faces", "60", "--out", "run", "--json", cwd=tmp_path
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    resolved = json.loads((tmp_path / "run" / "scene.resolved.json").read_text())
    assert resolved["plan"]["preset"] == "fast"
    assert resolved["plan"]["samples_per_face"] == 2
    assert resolved["plan"]["faces"] == 60
    assert resolved["scanner"]["resolution_deg"] == [0.5, 0.5]


@pytest.mark.parametrize(
    ("arguments", "angle"),
    [
        (("--preset", "fast"), 0.5),
        (("--preset", "balanced"), None),
        (("--preset", "fast", "--resolution", "1.5"), 1.5),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_scan_takes_the_angle_of_its_preset_where_nobody_gives_one(
    arguments: tuple[str, ...], angle: float | None, run_cell: Run, planned: Path, tmp_path: Path
) -> None:
    """Recorded with the execution; None is the plan's."""
    shutil.copytree(planned, tmp_path / "run")
    done = run_cell("scan", "run", "--view", "1", *arguments, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (manifest,) = (tmp_path / "run" / "executions").glob("*/manifest.json")
    assert json.loads(manifest.read_text())["options"]["resolution_deg"] == angle


def test_a_scan_refuses_an_unknown_preset(run_cell: Run, planned: Path, tmp_path: Path) -> None:
    """One sentence, before anything moves."""
    done = run_cell("scan", str(planned), "--preset", "quick", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "--preset is 'quick'; valid are: fast, balanced, accurate" in done.stderr
