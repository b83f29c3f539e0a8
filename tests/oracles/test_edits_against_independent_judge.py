"""Random edits of the small plan: accepted edits pass the judge, and refusals have a true reason."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.diff_recount import recounted
from benchmarks.edit_judge import EditJudge
from benchmarks.random_edits import RandomEdit, random_edit
from cell.api import edit, open_run
from cell.errors import CellError, UnreachableError, UsageError
from cell.report.diff import compare_runs
from cell.runs.run import Run
from cell.session import LoggedProgress


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))


@pytest.fixture(scope="module")
def run(planned: Path) -> Run:
    """Return the plan of the small part."""
    return open_run(planned)


@pytest.fixture(scope="module")
def judge(run: Run) -> EditJudge:
    """Return a judge of edits of the plan."""
    return EditJudge(run)


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 60))])
def test_random_edits(seed: int, run: Run, judge: EditJudge, tmp_path: Path) -> None:
    """The judge has no finding, and the reported differences from the earlier plan agree with the files."""
    requests = random_edit(np.random.default_rng(seed), run)
    result, refusal = None, None
    try:
        result = edit(run, out=tmp_path / "edited", **requests.options)
    except CellError as error:
        refusal = error
    if result is None:
        assert refusal is not None
        assert judge.refused(requests, refusal) == [], str(refusal)
        return
    assert not requests.wrong
    assert judge.accepted(run, requests, result) == []
    found, _ = recounted(compare_runs(run.folder, result.folder, LoggedProgress()))
    assert found == []


def test_the_judge_finds_errors(run: Run, judge: EditJudge, tmp_path: Path) -> None:
    """The judge reports an edit that differs from its request, and refusals with a false reason."""
    result = edit(run, out=tmp_path / "edited", drop=[1])
    no_change, away = RandomEdit({}), np.eye(4)
    assert any("lost" in each for each in judge.accepted(run, no_change, result))
    turned = replace(no_change, poses={"view 2": run.T_base_scanner[1] @ np.diag([-1.0, -1.0, 1.0, 1.0])})
    assert any("from the requested position" in each for each in judge.accepted(run, turned, result)[:1])
    away[:3, 3] = 9.0
    for output, pose, found in (
        ("is out of the arm's reach", run.T_base_scanner[1], "solutions"),
        ("is within the arm's reach, but every solution exceeds a joint limit", away, "0 of 0"),
        ("has every solution within the joint limits collides (housing with part)", run.T_base_scanner[1], "are free"),
    ):
        message = UnreachableError(f"view 2 cannot be used: it {output}; move it to another pose, or drop it")
        assert found in judge.refused(RandomEdit({}, {"view 2": pose}), message)[0]
    assert judge.refused(replace(no_change, wrong="view 2 twice"), UsageError("no view is left"))
