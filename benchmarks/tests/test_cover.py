"""View selection benchmark: generators, rivals, evaluation, tables, and a reduced form of each figure."""

import json
from itertools import combinations
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from benchmarks.covers import figures, instances, rivals, row_weighting
from benchmarks.covers.chart import curve, draw, family
from benchmarks.covers.figures import Store
from benchmarks.covers.generators import clr, cyc, generate
from benchmarks.covers.instances import Instance, Task, evaluate_answer, load
from benchmarks.covers.ours import ours

SMALL = "uniform:30x14:0.15:3"


def fewest(M: Any, costs: Any, enough: Any) -> int:
    """Return the least cost of the sufficient column sets, by enumeration."""
    n = M.shape[1]
    return min(
        int(costs[list(columns)].sum())
        for size in range(n + 1)
        for columns in combinations(range(n), size)
        if enough(M[:, list(columns)].sum(axis=1) > 0)
    )


@pytest.mark.parametrize("n", [3, 4, 5])
def test_rows_of_cyc_are_the_four_cycles_of_the_cube(n: int) -> None:
    """The rows are the cycles of four edges of the n-cube.

    The fewest edges that meet all cycles of the 3-cube are 3 (Chung 1992).
    """
    M, costs = cyc(n)
    assert M.shape == (n * (n - 1) * 2 ** (n - 3), n * 2 ** (n - 1))
    assert set(np.diff(M.indptr)) == {4}
    assert set(M.sum(axis=0)) == {n - 1}  # an edge lies in a square with each other direction
    assert len({tuple(row) for row in M.indices.reshape(-1, 4)}) == M.shape[0]
    assert M.indices.reshape(-1, 4)[:3].tolist() == [[0, 1, 2, 3], [0, 4, 5, 6], [1, 4, 7, 8]]  # as in scpcyc06
    if n == 3:
        assert fewest(M.toarray(), costs, np.all) == 3


def test_rows_of_clr_are_colourings() -> None:
    """A colouring of a and b points leaves the 4-subsets of both classes in one colour."""
    n = 7
    M, _ = clr(n)
    assert M.shape == (2 ** (n - 1) - 1, comb(n, 4))
    ones = np.array([r.bit_count() for r in range(1, 2 ** (n - 1))])
    assert np.array_equal(np.diff(M.indptr), [comb(a, 4) + comb(n - a, 4) for a in ones])


@pytest.mark.parametrize("name", ["rail:40x600:1", SMALL, "caps:50x40:0.2:2"])
def test_seeded_instances_are_the_same_again_and_coverable(name: str) -> None:
    """Equal seeds give equal instances. Every row has a column, and costs are positive."""
    first, again = generate(name), generate(name)
    assert first is not None
    assert again is not None
    assert np.array_equal(first[0].indices, again[0].indices)
    assert np.array_equal(first[1], again[1])
    assert np.diff(first[0].indptr).min() >= 1
    assert first[1].min() >= 1
    assert generate("scp41.txt") is None


@pytest.mark.parametrize("seed", range(6))
def test_the_textbook_search_finds_the_cheapest_of_small_instances(seed: int) -> None:
    """The search finds the least cost of enumeration.

    Every yielded cover is complete and cheaper than the one before.
    """
    rng = np.random.default_rng(seed)
    dense = rng.random((18, 11)) < 0.25
    dense[np.arange(18), rng.integers(0, 11, 18)] = True
    dense[:, 0] |= dense.sum(axis=1) < 2  # the search has no reduction: every row has an alternative
    dense[:, 1] |= dense.sum(axis=1) < 2
    costs = rng.integers(1, 5, 11) if seed % 2 else np.ones(11, np.int64)
    ticks = iter(range(100))
    M = sp.csr_array(dense)
    found = list(row_weighting.row_weighting_search(M, costs, seed, 40, lambda: next(ticks)))
    for _, cost, columns in found:
        assert dense[:, columns].any(axis=1).all()
        assert cost == costs[columns].sum()
    assert [cost for _, cost, _ in found] == sorted({cost for _, cost, _ in found}, reverse=True)
    assert found[-1][1] == fewest(dense, costs, np.all)


@pytest.mark.parametrize("options", [{}, {"coverage": 0.8}, {"max_views": 3}])
@pytest.mark.parametrize("solver", [ours, rivals.highs])
def test_solvers_agree_with_brute_force(solver: Any, options: dict[str, Any]) -> None:
    """Covers, a share of the area, and the most area with k views equal the results of enumeration.

    Bounds equal the results, in the units of the evaluation.
    """
    pytest.importorskip("highspy")
    task = Task(SMALL, "any", 1.0, **options)
    instance = load(task.instance, False)
    dense = instance.M.toarray()
    answer = solver(instance, task)
    found = evaluate_answer(task, answer.columns)
    assert found["good"]
    if task.max_views is None:
        need = instances.required_units(task.coverage, len(dense))
        best = fewest(dense, instance.costs, lambda covered: covered.sum() >= need)
        assert found["cost"] == best
    else:
        best = max(
            int(dense[:, list(columns)].any(axis=1).sum()) for columns in combinations(range(14), task.max_views)
        )
        assert found["covered"] == best
    assert answer.bound == pytest.approx(best, abs=0.999)


def test_the_judge_sees_what_is_missing() -> None:
    """The evaluation rejects a cover without one of its columns, and a column that may not be used."""
    instance = load(SMALL, False)
    everything = list(range(14))
    assert evaluate_answer(Task(SMALL, "any"), everything)["good"]
    assert not evaluate_answer(Task(SMALL, "any", max_views=3), everything)["good"]
    alone = int(instance.M.indices[instance.M.indptr[:-1][np.diff(instance.M.indptr) == 1]][0])
    assert not evaluate_answer(Task(SMALL, "any"), [j for j in everything if j != alone])["good"]


def test_units_are_whole_and_uncoverable_rows_do_not_count() -> None:
    """Rows of one area count 1 each; a row that only an unusable column covers is not coverable."""
    M = sp.csr_array(np.array([[True, False], [False, True]]))
    ones = np.ones(2, np.int64)
    even = Instance(M, ones, np.full(2, 1e-7), np.array([True, False]))
    assert even.units.tolist() == [1, 1]
    assert even.coverable.tolist() == [True, False]
    assert Instance(M, ones, np.array([1.0, 3.0]), np.ones(2, bool)).units.tolist() == [500_000, 1_500_000]


def test_reduced_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drawn_pictures: None) -> None:
    """Tasks run in separate processes, and stored rows are not computed again.

    The tables have the numbers of the rows, and the chart is drawn.
    """
    monkeypatch.chdir(Path(__file__).parents[2])
    tasks = [Task("cyc4", solver, 0.2, weighted=False) for solver in ("ours", "textbook")]
    rows = Store(tmp_path).rows(tasks)
    assert [row["cost"] for row in rows] == [8, 8]  # Chung 1992: 32 edges less the 24 that hold no square
    assert all(row["cpu_s"] < 5 for row in rows)
    monkeypatch.setattr(figures, "run", lambda task: pytest.fail(f"{task} is kept and need not run"))
    assert Store(tmp_path).rows(tasks) == [json.loads(json.dumps(row)) for row in rows]
    (line,) = figures.covers(rows)
    assert line["best"] == line["ours"] == line["textbook"] == 8
    assert any(sentence.startswith("ours: 0.00 % over") for sentence in figures.sums([line]))
    lines, sentences = figures.steady(rows)
    assert len(lines) == 2
    assert sentences == [sentences[0]]
    assert " times the median" in sentences[0]
    assert figures.by_part(rows)[0].keys() == {"part", "alone, 1", "alone, 1, textbook"}
    (line,) = figures.large(rows[:1])
    assert line["gap %"] == pytest.approx(100 * (1 - rows[0]["bound"] / 8))
    draw(rows, tmp_path / "chart.png")
    assert (tmp_path / "chart.png").stat().st_size > 5000


def test_the_most_coverage_is_proven_where_the_bound_meets_it() -> None:
    """The table has the worst and the best seed in percent of the coverable area.

    A bound less than one unit above the result is a proof.
    """
    shared = {"instance": "a", "name": "a", "max_views": 3, "coverable": 200, "views": 3, "cpu_s": 1.0}
    rows = [
        shared | {"solver": "ours", "covered": 150, "bound": 160.0},
        shared | {"solver": "ours", "covered": 152, "bound": 158.0},
        shared | {"solver": "HiGHS", "covered": 152, "bound": 152.4},
        shared | {"solver": "CP-SAT", "views": 0, "covered": 0, "bound": None},
    ]
    (line,) = figures.most(rows)
    assert (line["ours worst %"], line["ours best %"], line["ours bound %"]) == (75.0, 76.0, 79.0)
    assert (line["ours proven"], line["HiGHS proven"]) == (False, True)
    assert not any(key.startswith("CP-SAT") for key in line)


def test_a_curve_holds_the_mean_of_what_was_known_at_a_time() -> None:
    """The curve is the mean over the traces of two instances.

    A missing answer counts as the upper limit of the chart.
    """
    rows = [
        {"instance": "a", "trace": [(0.1, 12), (0.5, 10)], "seconds": 1.0, "cpu_s": 1.0, "cost": 10, "views": 9},
        {"instance": "b", "trace": [(0.2, 20)], "seconds": 1.0, "cpu_s": 1.0, "cost": 20, "views": 9},
        {"instance": "b", "trace": [], "seconds": 1.0, "cpu_s": None, "cost": 0, "views": 0},
    ]
    times, excess = curve(rows, {"a": 10, "b": 20})
    assert times == [0.1, 0.2, 0.5, 1.0]
    assert excess == pytest.approx([40.0, 10.0, 0.0, 0.0])
    assert [family(name) for name in ("scp41", "scpclr10", "scpnre1", "rail:500x200:1", "cyc9")] == [
        "scp4", "scpclr", "scpnre", "rail", "cyc",
    ]  # fmt: skip
