"""Rows of runs, stored one by one so that a stopped benchmark can continue, and the tables made of them."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any

from benchmarks.covers.instances import Task, best_known
from benchmarks.covers.one_run import run, version_of

Row = dict[str, Any]


class Store:
    """Rows in `rows.jsonl` of a folder; a task is not run again with the same version of its solver."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / "rows.jsonl"
        lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.is_file() else []
        self._rows = {_key(row): row for row in map(json.loads, lines)}

    def rows(self, tasks: Iterable[Task]) -> list[Row]:
        """Return the rows of these tasks; missing ones are computed and stored."""
        rows = []
        for task in tasks:
            key = (task.question, task.solver, task.seconds, task.seed, version_of(task.solver))
            if key not in self._rows:
                self._rows[key] = run(task)
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(self._rows[key]) + "\n")
            rows.append(self._rows[key])
        return rows


def _key(row: Row) -> tuple[Any, ...]:
    task = Task(**{name: row[name] for name in Task.__dataclass_fields__})
    return task.question, task.solver, task.seconds, task.seed, row["version"]


def covers(rows: Sequence[Row]) -> list[Row]:
    """Return a line per question: each solver's cost at the best seed, mean over seeds, bound and processor seconds.

    *over* is the excess of the mean over the best known cost, or over the best of these rows if no list has it.
    """
    lines = []
    for same in _grouped(rows, "instance", "weighted", "coverage", "max_views"):
        answered = [row for row in same if row["views"]]
        known = None if same[0]["weighted"] or same[0]["coverage"] < 1 else best_known(same[0]["instance"])
        best = min([row["cost"] for row in answered] + ([] if known is None else [known]))
        line = {"instance": same[0]["name"], "coverage": same[0]["coverage"], "best": best}
        for mine in _grouped(same, "solver"):
            solver, costs = mine[0]["solver"], [row["cost"] for row in mine if row["views"]]
            bounds = [row["bound"] for row in mine if row["bound"]]
            line[solver] = min(costs) if costs else "none"
            if len(mine) > 1 and costs:
                line[f"{solver} mean"] = mean(costs)
            if bounds:
                line[f"{solver} bound"] = max(bounds)
            line[f"{solver} over %"] = round(100 * (mean(costs) / best - 1), 2) if costs else None
            line[f"{solver} cpu s"] = round(mean(row["cpu_s"] for row in mine), 2) if costs else None
        lines.append(line)
    return lines


def sums(lines: Sequence[Row]) -> list[str]:
    """Summarise a table of covers: mean excess of each solver, number of best answers and of proofs."""
    lines_of_text = []
    for solver in dict.fromkeys(key.removesuffix(" over %") for line in lines for key in line if " over %" in key):
        mine = [line for line in lines if line.get(f"{solver} over %") is not None]
        over = mean(line[f"{solver} over %"] for line in mine) if mine else float("nan")
        gaps = [line[solver] - line[f"{solver} bound"] for line in mine if f"{solver} bound" in line]
        lines_of_text.append(
            f"{solver}: {over:.2f} % over the best on average, the best in {sum(x[solver] == x['best'] for x in mine)} "
            f"of {len(lines)}, an answer in {len(mine)}"
            + (
                f"; proven in {sum(gap < 1 - 1e-6 for gap in gaps)}, within 1 in {sum(g < 2 - 1e-6 for g in gaps)}"
                * bool(gaps)
            )
        )
    return lines_of_text


def by_part(rows: Sequence[Row]) -> list[Row]:
    """Return a line per part; columns for alone and in the cell, coverage and solver: `views (bound), seconds`.

    Proven answers have no bound; the first of several seeds is shown.
    """
    lines = []
    for row in rows:
        row["part"] = row["name"].removesuffix(".robot")
    for same in _grouped(rows, "part"):
        line: Row = {"part": same[0]["part"]}
        for row in same:
            where = "in the cell" if row["name"].endswith(".robot") else "alone"
            column = f"{where}, {row['coverage']:g}" + f", {row['solver']}" * (row["solver"] != "ours")
            bound = "" if not row["views"] or row["bound"] > row["cost"] - 1 + 1e-6 else f" ({row['bound']:g})"
            line.setdefault(column, f"{row['cost']}{bound}, {row['cpu_s']:.1f} s" if row["views"] else "none")
        lines.append(line)
    return lines


def most(rows: Sequence[Row]) -> list[Row]:
    """Return a line per part and number of views: coverage at the worst and the best seed [%], bounds, proofs."""
    lines = []
    for same in _grouped(rows, "instance", "max_views"):
        coverable = same[0]["coverable"]
        line: Row = {"instance": same[0]["name"], "k": same[0]["max_views"]}
        for mine in _grouped([row for row in same if row["views"]], "solver"):
            solver, covered = mine[0]["solver"], [row["covered"] for row in mine]
            bound = min(row["bound"] for row in mine)
            line |= {
                f"{solver} worst %": round(100 * min(covered) / coverable, 3),
                f"{solver} best %": round(100 * max(covered) / coverable, 3),
                f"{solver} bound %": round(100 * bound / coverable, 3),
                f"{solver} proven": bound < max(covered) + 1 - 1e-6,
                f"{solver} cpu s": round(mean(row["cpu_s"] for row in mine), 2),
            }
        lines.append(line)
    return lines


def steady(rows: Sequence[Row]) -> tuple[list[Row], list[str]]:
    """Return processor seconds for each second of budget, and the ratio of the largest to the median."""
    lines = [
        {
            "instance": row["name"], "asked": row["coverage"], "budget s": row["seconds"], "cpu s": row["cpu_s"],
            "proven": row["bound"] > row["cost"] - 1 + 1e-6, "cpu s / budget s": row["cpu_s"] / row["seconds"],
        }
        for row in rows
    ]  # fmt: skip
    ratios = [line["cpu s / budget s"] for line in lines]
    searched = [line["cpu s / budget s"] for line in lines if not line["proven"]] or ratios
    middle, top, low = median(searched), max(ratios), min(searched)
    text = f"median of those without a proof {middle:.2f}, smallest {low:.2f}; largest of all {top:.2f}"
    return lines, [f"{text}, {top / middle:.2f} times the median"]


def large(rows: Sequence[Row]) -> list[Row]:
    """Return processor seconds, memory and gap of large instances."""
    return [
        {
            "instance": row["name"], "solver": row["solver"], "budget s": row["seconds"], "cpu s": row["cpu_s"],
            "peak MB": row.get("peak_mb"), "of it the matrix": row.get("peak_mb_before"), "cost": row["cost"],
            "bound": row["bound"], "gap %": 100 * (1 - row["bound"] / row["cost"]) if row["views"] else None,
        }
        for row in rows
    ]  # fmt: skip


def _grouped(rows: Sequence[Row], *keys: str) -> list[list[Row]]:
    """Group rows by these keys, in order of appearance."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(groups.values())
