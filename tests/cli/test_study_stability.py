"""`cell study stability --quick`: every map asked at a few values, drawn, and silent only where its method is good."""

import csv
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from cell.study.stability import MAPS

Run = Callable[..., subprocess.CompletedProcess[str]]

_SPEAKS = {"limits", "reach", "path", "plant", "size", "offset", "grazing", "decimation", "sparse", "noise"}
"""All but inverse kinematics and, of so small matrices, the selection: good at every value."""


@pytest.fixture(scope="module")
def answer(run_cell: Run, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, object], Path]:
    """The study's JSON and its folder."""
    folder = tmp_path_factory.mktemp("stability")
    done = run_cell("study", "stability", "--quick", "--processes", "1", "--out", "maps", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), folder / "maps"


def test_no_method_fails_in_silence(answer: tuple[dict[str, object], Path]) -> None:
    """Where the program says nothing, the method is good; beyond, every map but one has a sentence."""
    result, folder = answer
    assert result["failed"] == []
    assert not any("silent" in str(said) for said in list(result["sentences"]))  # type: ignore[call-overload] - JSON
    rows = list(csv.DictReader((folder / "rows.csv").read_text().splitlines()))
    assert {row["map"] for row in rows} == set(MAPS)
    assert {row["map"] for row in rows if row["says"]} == _SPEAKS


def test_every_map_is_drawn(answer: tuple[dict[str, object], Path]) -> None:
    """As PNG and SVG, and shown by the report."""
    _, folder = answer
    report = (folder / "report.md").read_text()
    for name in MAPS:
        assert (folder / f"stability_{name}.svg").stat().st_size > 1000
        assert f"stability_{name}.png" in report


def test_an_unknown_map_is_refused(run_cell: Run, tmp_path: Path) -> None:
    """One sentence, no folder."""
    done = run_cell("study", "stability", "teapot", "--processes", "1", cwd=tmp_path)
    assert done.returncode == 2
    assert "there is no stability map teapot" in done.stderr
    assert not (tmp_path / "sim_runs").exists()
