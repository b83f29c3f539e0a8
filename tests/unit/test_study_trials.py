"""Trials of studies: keys, cached results, and failures."""

import json
from pathlib import Path
from typing import Any

import pytest

from cell.errors import FileError
from cell.study import trials
from cell.study.scanner_study import select_views
from cell.study.trials import Outcome, Processes, Trial, compute, load, run_trials, save

_SMALL: dict[str, Any] = {"part": "petanque", "faces": 30, "samples_per_face": 4}


def _save(folder: Path, **change: Any) -> Outcome:
    outcome = Outcome(Trial.of(select_views, _SMALL), {"views": 3}, "", {"total": 1.5})
    save(outcome, folder)
    (path,) = folder.rglob("*.json")
    if change:
        path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    return outcome


def test_equal_settings_in_any_order_are_one_trial() -> None:
    """The key depends on the content and not on the order."""
    one = Trial.of(select_views, {"part": "mug", "faces": 40})
    assert one == Trial.of(select_views, {"faces": 40, "part": "mug"})
    assert one.key != Trial.of(select_views, {"faces": 41, "part": "mug"}).key


def test_a_changed_program_changes_the_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results of another version are not used."""
    before = Trial.of(select_views, _SMALL).key
    monkeypatch.setattr(trials, "sources_digest", lambda package: "another")
    assert Trial.of(select_views, _SMALL).key != before


def test_a_benchmark_trial_depends_on_the_sources_of_the_benchmarks_too() -> None:
    """Keys of benchmark trials depend on the sources of the benchmarks, keys of the product's trials do not."""
    assert trials.sources_digest("planner") == trials.sources_digest("cell") != trials.sources_digest("benchmarks")


def test_a_changed_table_of_the_program_changes_the_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables (.csv) are inputs of a trial like sources."""
    monkeypatch.setattr(trials, "__file__", str(tmp_path / "cell" / "study" / "trials.py"))
    table = tmp_path / "drivers" / "registers.csv"
    table.parent.mkdir()
    digests = [table.write_text(text) and trials.sources_digest.__wrapped__("cell") for text in ("1\n", "2\n")]
    assert digests[0] != digests[1]


def test_settings_that_json_cannot_hold_exactly_are_refused() -> None:
    """NaN is refused, because it does not equal itself and its key would not be found again."""
    with pytest.raises(ValueError, match="JSON"):
        Trial.of(select_views, {"faces": float("nan")})


def test_a_cached_result_is_returned_and_marked(tmp_path: Path) -> None:
    """The cached outcome has its values and seconds, and nothing is computed."""
    outcome = _save(tmp_path)
    calls: list[tuple[int, int, Outcome]] = []
    (found,) = run_trials([outcome.trial], Processes(1), folder=tmp_path, on_outcome=lambda *each: calls.append(each))
    assert found == Outcome(outcome.trial, {"views": 3}, "", {"total": 1.5}, cached=True)
    assert calls == [(1, 1, found)]


@pytest.mark.parametrize(
    "change",
    [{"schema": "scan-cell/trial/0"}, {"settings": "{}"}, {"failure": "no memory"}, {"values": 3}, {"seconds": None}],
    ids=lambda change: next(iter(change)),
)
def test_only_a_finished_result_of_the_trial_is_used(change: dict[str, Any], tmp_path: Path) -> None:
    """A file of another version, with other settings, with a failure or damaged is not used."""
    outcome = _save(tmp_path, **change)
    assert load(outcome.trial, tmp_path) is None


def test_a_cut_file_is_not_used(tmp_path: Path) -> None:
    """A cut file counts as missing."""
    outcome = _save(tmp_path)
    (path,) = tmp_path.rglob("*.json")
    path.write_text(path.read_text()[:40])
    assert load(outcome.trial, tmp_path) is None


def test_an_unwritable_folder_is_one_sentence(tmp_path: Path) -> None:
    """The message names the environment variable that moves the folder."""
    (tmp_path / "file").write_text("")
    outcome = Outcome(Trial.of(select_views, _SMALL), {}, "", {})
    with pytest.raises(FileError, match="XDG_CACHE_HOME"):
        save(outcome, tmp_path / "file")


def test_a_failed_trial_has_its_reason_and_is_not_cached(tmp_path: Path) -> None:
    """A missing file is the reason of the failure, and the failure is not cached."""
    bad = Trial.of(select_views, {"scene": {}, "files": {"gone.stl": "0"}, "robot": False})
    outcome = compute(bad, bad.digest)
    assert outcome.failure.startswith("gone.stl cannot be read")
    assert outcome.values == {}
    save(outcome, tmp_path)
    assert load(bad, tmp_path) is None


def test_a_worker_of_another_version_refuses() -> None:
    """A worker of another version fails, because its result would be cached under the key of this version."""
    outcome = compute(Trial.of(select_views, _SMALL), "another program")
    assert "version" in outcome.failure
