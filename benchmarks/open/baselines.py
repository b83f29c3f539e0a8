"""Run the methods of the result files: `python -m benchmarks.open.baselines METHOD [INSTANCE ...]`.

Methods of the track `cover` select columns of the instance. In the track `free` they select from the same candidates on
own samples, and raise their own target until other own samples hold the requirement; the pose search of the project
moves the views as well. Entries are replaced in results/METHOD.json. Seconds are processor seconds of the whole method,
without the loading of files.
"""

import argparse
import json
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numba import njit

from benchmarks.open import check, tools
from benchmarks.open.check import Array, Instance
from benchmarks.open.tools import HERE, Bench, in_metres, in_millimetres, matrix_of
from planner.cover import EFFORT_PER_SECOND, CoverProblem, solve
from planner.measurability.direction_table import DirectionTable
from planner.measurability.visibility import VisibilityMemo
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import find_frustum
from planner.viewpoints.pose_search import EFFORTS, Place, SearchPoses, search_poses

SECONDS = 1.5  # of the searches that end by time; the planner gets as many seconds' worth of counted effort
N_OWN, N_HELD = 8000, 60_000  # own samples for the selection, and for the requirement
MARGIN = 4e-4  # share of the surface: error of the samples for the requirement
DATE = "2026-11-27"

Select = Callable[[Array, float], Array]
"""(S, V) matrix and number of rows to cover -> columns."""


def greedy(M: Array, required: float) -> Array:
    """Select the column that measures most uncovered rows until enough are covered (Johnson 1974)."""
    left, chosen = np.ones(len(M), dtype=bool), []
    while len(M) - left.sum() < required - 1e-9:
        chosen.append(int(np.argmax(M[left].sum(axis=0))))
        left &= ~M[:, chosen[-1]]
    return np.array(chosen)


def row_weighting(M: Array, required: float) -> Array:
    """Select by a row-weighting local search (Gao, Weise, Li 2015), stopped when enough rows are covered."""
    by_row = [np.flatnonzero(row) for row in M]
    start = np.concatenate([[0], np.cumsum([len(columns) for columns in by_row])])
    columns, end = np.concatenate(by_row), process_time() + SECONDS
    chosen = np.zeros(M.shape[1], dtype=bool)
    chosen[greedy(M, required)] = True
    state = (chosen, M[:, chosen].sum(axis=1), np.ones(len(M)), np.zeros(M.shape[1], np.int64), np.array([0]))
    best = np.flatnonzero(chosen)
    while process_time() < end:
        if _weighting_steps(M, start, columns, required, *state, 200, int(state[4][0])):
            best = np.flatnonzero(chosen)
    return best


@njit(cache=True)
def _weighting_steps(
    M: Array, start: Array, columns: Array, required: float, chosen: Array, count: Array, weight: Array, age: Array,
    clock: Array, steps: int, seed: int,
) -> bool:  # fmt: skip
    """Remove and exchange columns; return whether the selection is a smaller cover."""
    np.random.seed(seed)  # noqa: NPY002 (compiled code has no other generator)
    for _ in range(steps):
        while (count > 0).sum() >= required - 1e-9:
            _flip(M, chosen, count, _least_needed(M, chosen, count, weight, age, -1))
        clock[0] += 1
        removed = _least_needed(M, chosen, count, weight, age, clock[0] - 1)
        _flip(M, chosen, count, removed)
        open_rows = np.flatnonzero(count == 0)
        row = -1
        while row < 0 or start[row] == start[row + 1]:
            row = open_rows[np.random.randint(len(open_rows))]  # noqa: NPY002
        best, most = -1, -1.0
        for j in columns[start[row] : start[row + 1]]:
            if j == removed:
                continue
            gain = 0.0
            for i in open_rows:
                gain += weight[i] * M[i, j]
            if gain > most or (gain == most and age[j] < age[best]):
                best, most = j, gain
        best = removed if best < 0 else best
        _flip(M, chosen, count, best)
        age[best] = clock[0]
        for i in open_rows:
            if count[i] == 0:
                weight[i] += 1
        if (count > 0).sum() >= required - 1e-9:
            return True
    return False


@njit(cache=True)
def _least_needed(M: Array, chosen: Array, count: Array, weight: Array, age: Array, tabu: int) -> int:
    best, least = -1, np.inf
    alone = np.flatnonzero(count == 1)
    for j in np.flatnonzero(chosen):
        if age[j] == tabu and tabu > 0:
            continue
        loss = 0.0
        for i in alone:
            loss += weight[i] * M[i, j]
        if loss < least:
            best, least = j, loss
    return best if best >= 0 else np.flatnonzero(chosen)[0]


@njit(cache=True)
def _flip(M: Array, chosen: Array, count: Array, j: int) -> None:
    sign = -1 if chosen[j] else 1
    chosen[j] = not chosen[j]
    for i in range(len(count)):
        count[i] += sign * M[i, j]


def by_planner(solver: str, seconds: float = SECONDS) -> Select:
    """Return the selection by a solver of `planner.cover`."""

    def select(M: Array, required: float) -> Array:
        coverable = int(M.any(axis=1).sum())
        problem = CoverProblem(M, np.ones(len(M)), coverage=min(1.0, required / coverable))
        effort = int(seconds * EFFORT_PER_SECOND)
        return solve(problem, rng=np.random.default_rng(0), solver=solver, effort_budget=effort).views

    return select


METHODS: dict[str, tuple[Select, str, str]] = {
    "greedy": (greedy, "", "Greedy cover (Johnson 1974)."),
    "row-weighting": (row_weighting, "", f"Row-weighting local search (Gao, Weise, Li 2015), {SECONDS:g} s."),
    "meta-raps": (by_planner("meta-raps"), "", f"Meta-RaPS (Lan, DePuy, Whitehouse 2007) of the paper, {SECONDS:g} s."),
    "scan-cell-low": (by_planner("auto", 1.0), "low", "planner.cover and pose search of scan-cell, low effort."),
    "scan-cell-normal": (by_planner("auto"), "normal", "planner.cover and pose search of scan-cell, normal effort."),
    "scan-cell-high": (by_planner("auto", 20.0), "high", "planner.cover and pose search of scan-cell, high effort."),
}
"""Selection, effort of the pose search ("": none), and description."""


def cover_entry(method: str, instance: Instance, target: float) -> dict[str, Any]:
    """Return the entry of a method in the track `cover`."""
    M, since = matrix_of(instance), process_time()
    columns = METHODS[method][0](M, target * instance.data["coverable_rows"])
    return _entry(instance, target, "cover", since) | {"columns": np.sort(columns).tolist()}


class FreeTrack:
    """Own samples of an instance, with the matrix of its candidates, and the seconds that these take."""

    def __init__(self, bench: Bench) -> None:
        since = process_time()
        self.bench, self.pool = bench, in_metres(bench.instance.arrays["poses"])
        self.samples, held = bench.samples(N_OWN, 1), bench.samples(N_HELD, 2)
        self.memo = VisibilityMemo(held, bench.scanner, bench.casters)
        self.M = bench.measured(self.pool, self.samples).T
        self.seconds = process_time() - since

    def held(self, T: Array) -> float:
        """Return the share of the samples for the requirement that poses (n, 4, 4) measure."""
        return float(self.memo.measured(T[:, None]).mean())

    def entry(self, method: str, target: float) -> dict[str, Any] | None:
        """Return the entry of a method; None if all that its samples ask of the candidates is not enough."""
        instance, since = self.bench.instance, process_time() - self.seconds
        select, effort, _ = METHODS[method]
        required = target * instance.data["reference"] + MARGIN
        goal, coverable = required, float(self.M.any(axis=1).mean())
        while True:
            columns = select(self.M, min(goal, coverable) * len(self.M))
            missing = required - self.held(self.pool[columns])
            if missing <= 0 or goal >= coverable:
                break
            goal += max(missing, 2e-4)
        T = self.pool[columns]
        if effort and len(columns) > 1:
            T = self.moved(columns, EFFORTS[effort], required)
        if self.held(T) < required:
            return None
        entry = _entry(instance, target, "free", since)
        if instance.tier == "A":
            return entry | {"poses": in_millimetres(T).reshape(-1, 12).tolist()}
        return entry | {"configurations": np.round(self.bench.configure(in_millimetres(T)), 9).tolist()}

    def moved(self, columns: Array, effort: int, required: float) -> Array:
        """Return fewer views (n, 4, 4) by the pose search of the planner; the given ones if it finds none."""
        bench = self.bench
        targets = RayTargets.of(self.samples.points, self.samples.normals)
        places, centres = find_frustum(bench.scanner).points, np.stack([bench.scanner.source, bench.scanner.sensor])
        distance = np.linalg.norm(places[:, None] - centres, axis=2)
        ends = float(distance.min()), float(distance.max())
        table = DirectionTable.build(targets, bench.scanner, bench.casters[0], bench.casters[1:], ends)
        n = len(self.pool)
        aim = np.full(n, sum(ends) / 2)
        pool = SearchPoses(self.pool, aim, np.arange(n), np.zeros(n, dtype=bool), np.zeros(n, dtype=np.int64))
        found = search_poses(
            columns, pool, [Place(table, bench.is_allowed)], np.full(len(targets), 1 / len(targets)),
            shortfall=lambda views: required - self.held(views.T_object_scanner),
            effort=round(effort * max(1.0, len(columns) / 25)), rng=np.random.default_rng(0),
        )  # fmt: skip
        held = [views.T_object_scanner for views in found.found if self.held(views.T_object_scanner) >= required]
        return held[-1] if held else self.pool[columns]


def _entry(instance: Instance, target: float, track: str, since: float) -> dict[str, Any]:
    return {"instance": instance.name, "target": target, "track": track, "cpu_s": round(process_time() - since, 2)}


def store(method: str, about: str, entries: list[dict[str, Any]], root: Path = HERE) -> None:
    """Replace entries in the result file of a method."""
    path = root / "results" / f"{method}.json"
    content = {
        "name": method, "authors": "scan-cell", "date": DATE, "method": about,
        "hardware": f"one core, {platform.machine()}", "entries": [],
    }  # fmt: skip
    if path.exists():
        content["entries"] = json.loads(path.read_text())["entries"]
    keys = ("instance", "target", "track")
    new = {tuple(entry.get(key) for key in keys) for entry in entries}
    kept = [entry for entry in content["entries"] if tuple(entry.get(key) for key in keys) not in new]
    content["entries"] = sorted(kept + entries, key=lambda entry: [str(entry.get(key)) for key in keys])
    lines = ",\n".join(json.dumps(entry) for entry in content["entries"])
    head = json.dumps(content | {"entries": []}, indent=1)
    path.write_text(head.replace('"entries": []', f'"entries": [\n{lines}\n]') + "\n")


def main() -> None:
    """Run methods on instances."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("method", nargs="+", choices=sorted(METHODS))
    parser.add_argument("--instance", nargs="*", default=[])
    parser.add_argument("--track", choices=("cover", "free", "both"), default="both")
    parser.add_argument("--target", type=float, nargs="*", default=[])
    options = parser.parse_args()
    names = options.instance or [path.stem for path in sorted((HERE / "instances").glob("[AB]-*.json"))]
    global SECONDS
    seconds, SECONDS = SECONDS, 0.01  # compiles before the clock starts
    row_weighting(~np.eye(4, dtype=bool), 4)
    SECONDS = seconds
    for name in names:
        instance, free = check.load(name), None
        targets = options.target or instance.data["targets"]
        for method in options.method:
            entries = []
            if options.track != "free":
                entries += [cover_entry(method, instance, target) for target in targets]
            if options.track != "cover":
                free = free or FreeTrack(tools.bench_of(name))
                found = (free.entry(method, target) for target in targets if target < 1)
                entries += [entry for entry in found if entry is not None]
            store(method, METHODS[method][2], entries)
            for entry in entries:
                size = len(entry.get("columns") or entry.get("poses") or entry.get("configurations"))
                sys.stdout.write(f"{method} {name} {entry['target']} {entry['track']}: {size}, {entry['cpu_s']} s\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
