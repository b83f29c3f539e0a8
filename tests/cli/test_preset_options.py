"""`--preset` on the command line: what it fills in, what goes before it, and what is refused."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.parametrize(
    "command", [("plan",), ("check",), ("place",), ("study", "standoff")], ids=lambda command: " ".join(command)
)
def test_an_unknown_preset_is_refused(command: tuple[str, ...], run_cell: Run, tmp_path: Path) -> None:
    """One sentence, exit code 2, nothing left behind."""
    done = run_cell(*command, "--preset", "quick", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "--preset is 'quick'" in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_preset_is_recorded_and_what_it_fills_in(run_cell: Run, part_file: Path, tmp_path: Path) -> None:
    """An option goes before it."""
    done = run_cell(
        "plan", part_file, "--units", "mm", "--place", "1100,400,100", "--preset", "fast", "--faces", "60",
        "--out", "run", "--json", cwd=tmp_path,
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
