"""`cell plan` with requests beyond the fewest views: content of the run folder, refusals."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

from cell.session import default_effort, effort_of
from tests.support.fixture_types import RunCommand


@pytest.fixture(scope="module")
def ask(
    part_file: Path, small_plan: tuple[str, ...], run_cell: RunCommand, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., tuple[Path, dict[str, Any]]]:
    """Return a function that plans the small part with more options and returns the folder and the JSON object."""
    folder = tmp_path_factory.mktemp("requests")

    def run(name: str, *options: str, code: int = 0) -> tuple[Path, dict[str, Any]]:
        process = run_cell(
            "plan",
            str(part_file),
            "--units",
            "mm",
            *small_plan,
            *options,
            "--out",
            name,
            "--json",
            cwd=folder,
            code=code,
        )
        return folder / name, json.loads(process.stdout)

    return run


def matrix(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the dense matrix and the areas of a run."""
    with np.load(folder / "measurability.npz") as arrays:
        M = csr_array(
            (np.ones(len(arrays["indices"]), bool), arrays["indices"], arrays["indptr"]), shape=tuple(arrays["shape"])
        )
        return M.toarray(), arrays["areas"]


def covered(folder: Path) -> tuple[list[int], float]:
    """Return the views of a run and the share of its samples that they cover, from its files."""
    M, areas = matrix(folder)
    views = [view["id"] for view in json.loads((folder / "plan.json").read_text())["views"]]
    return views, float(areas[M[:, views].any(axis=1)].sum() / areas.sum())


def test_a_plan_without_requests_has_no_keys_of_requests(planned: Path) -> None:
    """A plan without requests has no further key in plan.json and report.json, and no curve."""
    plan, report = (json.loads((planned / name).read_text()) for name in ("plan.json", "report.json"))
    assert not {"max_coverage", "overlap", "promise", "multiplicity", "cost", "curve"} & (set(plan) | set(report))
    assert not {"max_views", "pinned", "alpha", "overlap_share"} & set(report["settings"])
    assert not (planned / "curve.png").exists()


@pytest.mark.usefixtures("drawn_pictures")
def test_the_most_coverage_around_pinned_and_banned_views_with_its_curve(
    ask: Callable[..., tuple[Path, dict[str, Any]]], planned: Path
) -> None:
    """The report for three views, with one pinned and two banned, matches the files. The curve contains the plan."""
    plain = [view["id"] for view in json.loads((planned / "plan.json").read_text())["views"]]
    with np.load(planned / "reach.npz") as arrays:
        reachable = np.flatnonzero(arrays["verdict"] == 0)
    pinned, banned = int(np.setdiff1d(reachable, plain)[0]), plain[:2]
    folder, output = ask(
        "most", "--max-views", "3", "--curve", "--pin", str(pinned), "--ban", str(banned[0]), "--ban", str(banned[1])
    )
    views, share = covered(folder)
    assert len(views) == 3
    assert pinned in views
    assert not set(banned) & set(views)
    assert output["settings"]["pinned"] == [pinned]
    assert output["max_coverage"]["coverage"] == pytest.approx(share)
    assert share <= output["max_coverage"]["upper_bound"] + 1e-12
    curve = json.loads((folder / "curve.json").read_text())
    M, areas = matrix(folder)
    for point in curve["points"]:
        real = areas[M[:, point["views"]].any(axis=1)].sum() / areas.sum()
        assert (len(point["views"]), point["coverage"]) == (point["n_views"], pytest.approx(real))
        assert point["coverage"] <= point["upper_bound"] + 1e-12
        assert pinned in point["views"]
        assert not set(banned) & set(point["views"])
    assert curve["points"][0]["n_views"] == 1
    assert curve["points"][2]["coverage"] >= share - 1e-12
    assert curve["points"][-1]["coverage"] == pytest.approx(curve["coverable"])
    assert (
        curve["minimum_views"][-1]["lower_bound"]
        <= curve["minimum_views"][-1]["views"]
        == curve["points"][-1]["n_views"]
    )
    assert (folder / "curve.png").stat().st_size > 10_000
    page = (folder / "report.md").read_text()
    assert "curve.png" in page
    assert "no selection of 3 views covers more than" in page


def test_an_unreachable_pinned_view_is_refused_with_its_verdict(
    part_file: Path, small_plan: tuple[str, ...], run_cell: RunCommand, planned: Path, tmp_path: Path
) -> None:
    """The error names the candidate and its verdict. A candidate that does not exist is refused as well."""
    with np.load(planned / "reach.npz") as arrays:
        verdict = arrays["verdict"]
    unreachable = int(np.flatnonzero(verdict != 0)[0])
    for view, words in (
        (unreachable, f"plan.pinned names candidate {unreachable}, which is"),
        (10**6, "there are candidates 0 to"),
    ):
        pin = ("--pin", str(view), "--out", f"run{view}")
        process = run_cell("plan", str(part_file), "--units", "mm", *small_plan, *pin, cwd=tmp_path, code=2)
        assert words in " ".join(process.stderr.split())


def test_twice_measured_in_the_shortest_time(ask: Callable[..., tuple[Path, dict[str, Any]]]) -> None:
    """Each sample has two views, or all available ones. Scan and settling take 2.5 s for each view."""
    folder, output = ask("twice", "--faces", "60", "--multiplicity", "2", "--cost", "time")
    views, _ = covered(folder)
    M, _ = matrix(folder)
    with np.load(folder / "reach.npz") as arrays:
        able = M[:, arrays["verdict"] == 0].sum(axis=1)
    assert (M[:, views].sum(axis=1) >= np.minimum(able, 2)).mean() > 0.99  # except for samples that arms occlude
    assert output["multiplicity"]["views_per_sample"] == 2
    assert output["cost"]["seconds"] == pytest.approx(2.5 * len(views) + output["motion"]["duration_s"], abs=1e-6)
    assert 0 < output["cost"]["seconds_bound"] <= output["cost"]["seconds"] + 1e-9


def test_scans_that_hang_together(ask: Callable[..., tuple[Path, dict[str, Any]]]) -> None:
    """The overlap graph of the views is connected in networkx. The extra views are as reported."""
    import networkx as nx

    effort = replace(default_effort(), constrained_work=300_000_000)  # the search for fewer views is not tested
    with effort_of(effort):
        folder, output = ask("overlap", "--faces", "60", "--overlap", "50%", "--overlap-in-order")
    views, _ = covered(folder)
    M, areas = matrix(folder)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(views)))
    for a in range(len(views)):
        for b in range(a):
            shared = areas[M[:, views[a]] & M[:, views[b]]].sum()
            if shared >= 0.5 * min(areas[M[:, views[a]]].sum(), areas[M[:, views[b]]].sum()) * (1 - 1e-9):
                graph.add_edge(a, b)
    assert output["overlap"]["connected"]
    assert nx.is_connected(graph)
    assert output["overlap"]["extra_views"] == len(views) - output["overlap"]["views_without_overlap"] >= 0
    assert all(set(graph[k]) & set(range(k)) for k in range(1, len(views)))  # views are in visiting order
    assert output["overlap"]["views_without_earlier_overlap"] == 0


def test_a_promise_under_pose_errors_is_kept_in_simulated_executions(
    ask: Callable[..., tuple[Path, dict[str, Any]]],
) -> None:
    """In 200 simulated executions with pose errors, the promised samples are measured at the promised rate."""
    _, output = ask("promise", "--faces", "60", "--pose-sd", "1mm,0.5deg", "--alpha", "0.1", "--coverage", "1")
    promise = output["robust"]
    assert (promise["executions"], promise["samples"], promise["alpha"]) == (200, 10_000, 0.1)
    assert promise["robust_on_samples"] <= output["coverage"]["planned_on_samples"] + 1e-12
    assert promise["robust_on_samples"] == pytest.approx(promise["robust_coverable_on_samples"])
    assert promise["mean_frequency"] >= 0.9
    assert promise["confirmed_share"] > 0.98
    assert promise["coverage_min"] <= promise["coverage_mean"] <= output["coverage"]["coverable"] + 0.01


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--max-views", "3", "--coverage", "0.9"), "both limit the plan"),
        (("--max-views", "0"), "--max-views is 0; it must be at least 1"),
        (("--max-views", "1", "--pin", "1,2"), "2 views are pinned"),
        (("--pin", "4", "--ban", "4"), "both name candidate 4"),
        (("--pin", "four"), "by their numbers"),
        (("--overlap", "20"), "20% or --overlap 500mm2"),
        (("--overlap", "0%"), "--overlap is 0.0; it must be above 0"),
        (("--overlap", "20%", "--max-views", "3"), "cannot be combined"),
        (("--overlap-in-order",), "needs an overlap"),
        (("--overlap", "20%", "--solver", "exact"), "its own search"),
        (("--pose-sd", "0.5,0.1"), "with their units"),
        (("--pose-sd", "0.5mm", "--alpha", "0"), "--alpha is 0.0; it must be above 0"),
        (("--pose-sd", "0.5mm", "--fill", "rays"), "need aimed samples"),
        (("--pose-sd", "0.5mm", "--multiplicity", "2"), "cannot be combined"),
        (("--cost", "money"), "valid are: views, time"),
    ],
)
def test_requests_that_contradict_each_other_are_refused(
    options: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """Contradictory requests are refused with exit code 2 before any computation."""
    from cell.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["cell", "plan", *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert words in " ".join(capsys.readouterr().err.split())
