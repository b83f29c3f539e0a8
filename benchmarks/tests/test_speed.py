"""Speed fronts: the table of knobs, rows, sentences and pictures, and the measures."""

import re
from pathlib import Path
from typing import Any

import pytest

from benchmarks.__main__ import REGISTRY
from benchmarks.best_of import best_of
from benchmarks.methods.knobs import KNOBS, samples
from benchmarks.methods.speed import ELSEWHERE, pictures, select_knobs, sentences, speed_study
from cell.errors import UsageError
from cell.scene.file import load_scene
from cell.session import LoggedProgress
from cell.study.prepared_part import Bench
from cell.study.study import run_study
from cell.study.trials import Outcome, Processes, Trial

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", list(KNOBS))
def test_the_default_is_on_its_front(name: str) -> None:
    """The default of each knob lies between measured values."""
    knob = KNOBS[name]
    assert knob.default in knob.values[1:-1]
    assert len(set(knob.values)) == len(knob.values) >= 3
    assert knob.truth
    assert knob.error_unit in knob.measure


def test_the_page_has_the_same_ranges() -> None:
    """The page has the range and the default of each parameter as in the code."""
    page = (ROOT / "docs" / "internals" / "speed_accuracy.md").read_text(encoding="utf-8")
    entries = dict(re.findall(r"^- `(\w+)`: (.*?)(?=\n- |\n\n)", page, flags=re.MULTILINE | re.DOTALL))
    assert entries.keys() == KNOBS.keys()
    for name, knob in KNOBS.items():
        text = " ".join(entries[name].split())
        assert f"{knob.values[0]:g} to {knob.values[-1]:g}" in text, text
        assert f"(default {knob.default:g})" in text or "x default" in text, text


def test_what_is_no_knob_is_refused_with_where_it_is_measured() -> None:
    """An unknown knob is refused with the benchmark that measures it.

    Without names all knobs are selected.
    """
    assert select_knobs([]) == [*KNOBS]
    with pytest.raises(UsageError, match="there is no knob sampels; there are decimation, samples"):
        select_knobs(["samples", "sampels"])
    for name, benchmark in ELSEWHERE.items():
        assert benchmark in REGISTRY
        with pytest.raises(UsageError, match=f"python -m benchmarks {benchmark} "):
            select_knobs([name])


@pytest.mark.parametrize(("name", "text", "values"), [("samples", "1, 4", [1, 4]), ("scan", "1,0.5", [1.0, 0.5])])
def test_values_of_an_option_are_of_the_knob_s_kind(name: str, text: str, values: list[Any]) -> None:
    """Integers stay integers, and other values are numbers of the kind of the knob."""
    found = KNOBS[name].parsed(text)
    assert found == values
    assert [type(value) for value in found] == [type(value) for value in values]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("samples", "1.5"), ("samples", "0"), ("samples", ""), ("samples", "-1"), ("samples", "many"),
        ("scan", "nan"), ("scan", "inf"), ("scan", "0"),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_is_refused(name: str, text: str) -> None:
    """The refusal states the valid values."""
    with pytest.raises(UsageError, match="valid are"):
        KNOBS[name].parsed(text)


def _outcome(trial: Trial) -> Outcome:
    """Return an outcome of a trial with an error of 2, or of 0 for the value 16."""
    seconds = {"work": 2.0, "processor": 1.5, "total": 9.0}
    error = 0.0 if '"value": 16' in trial.settings else 2.0
    return Outcome(trial, {"error": error, "more": {"views": 5}}, "", seconds)


def test_rows_sentences_and_pictures_of_knobs() -> None:
    """The study has one row per value, and one picture is drawn, also for an error of zero."""
    scene = load_scene(None, {"part": {"name": "mug"}})
    study = speed_study([("samples", scene), ("scan", scene)])
    rows = study.rows([_outcome(trial) for trial in study.trials])
    assert [row["value"] for row in rows] == [*KNOBS["samples"].values, *KNOBS["scan"].values]
    assert {row["part"] for row in rows} == {"mug"}
    summaries = sentences(rows)
    assert len(summaries) == 2
    assert "1.00 times the time" in summaries[0]
    figures = dict(pictures(rows))
    assert list(figures) == ["speed_fronts"]
    for figure in figures.values():
        figure.canvas.draw()  # type: ignore[attr-defined]


def test_more_samples_bring_the_claim_closer() -> None:
    """The error with 32 samples per face is smaller than with one."""
    bench = Bench(load_scene(None, {"part": {"name": "mug"}, "plan": {"faces": 80}}), samples=20_000)
    errors = [samples(bench, count, 1).error for count in (1, 32)]
    assert errors[1] < errors[0]


def test_the_best_of_a_few_runs_counts() -> None:
    """The function is called the requested number of times, and the best time is returned."""
    runs: list[int] = []
    result, seconds = best_of(lambda: runs.append(1) or len(runs), 3)
    assert result == 3
    assert 0 <= seconds["work"] < 1
    assert set(seconds) == {"work", "processor"}


@pytest.mark.slow
def test_fronts_of_a_small_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reduced study of two values of each knob runs in a worker."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    scene = load_scene(None, {"part": {"name": "petanque"}, "plan": {"faces": 60}})
    study = speed_study([(name, scene) for name in KNOBS], values=(1, 2), repeats=1)
    with Processes(1) as workers:
        result = run_study(study, workers, out=tmp_path / "fronts", reporter=LoggedProgress())
    assert result.failed == []
    assert len(result.rows) == 2 * len(KNOBS)
    assert all(row["processor s"] > 0 and row["error"] >= 0 for row in result.rows)
    assert (result.folder / "speed_fronts.png").stat().st_size > 1000
