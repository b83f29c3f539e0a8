"""Write the leaderboard: `python -m benchmarks.open.table` checks all results, writes LEADERBOARD.md and two charts."""

import json
import sys
from collections import defaultdict
from typing import Any

from benchmarks.open import check
from benchmarks.open.tools import HERE

ORDER = (
    "greedy", "row-weighting", "meta-raps", "example-greedy", "scan-cell-low", "scan-cell-normal", "scan-cell-high",
    "nearest-neighbour", "uniform", "volumetric", "boundary",
)  # fmt: skip

Row = dict[str, Any]
Cell = tuple[float, float | None]
"""Value and processor seconds."""


def all_rows() -> list[Row]:
    """Return the judged entries of all result files.

    Raises:
        CheckError: for an invalid entry.
    """
    rows = [row for path in sorted((HERE / "results").glob("*.json")) for row in check.judge_file(path)]
    if invalid := [row for row in rows if "fault" in row]:
        raise check.CheckError(f"{len(invalid)} invalid entries, the first: {invalid[0]}")
    return rows


def grouped(rows: list[Row], tier: str, track: str | None, target: float | None) -> dict[str, dict[str, Row]]:
    """Return instance -> method -> row of a tier, track and target."""
    found: dict[str, dict[str, Row]] = defaultdict(dict)
    for row in rows:
        if row["instance"][0] in tier and row["track"] == track and row["target"] == target:
            found[row["instance"]][row["name"]] = row
    return dict(sorted(found.items()))


def methods_of(table: dict[str, dict[str, Row]]) -> list[str]:
    """Return the methods of a table in the order of the leaderboard, without collections of others."""
    names = {name for own in table.values() for name in own} - {"best-known", "exact"}
    return sorted(names, key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name))


def markdown(head: list[str], lines: list[list[str]]) -> str:
    """Return a table."""
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *lines]) + "\n"


def shown(row: Row | None, digits: int) -> str:
    """Return value and processor seconds of a row."""
    if row is None:
        return ""
    seconds = "" if row["cpu_s"] is None else f" ({row['cpu_s']:.3g} s)"
    return f"{row['value']:.{digits}f}{seconds}"


def views_table(rows: list[Row], track: str, target: float, proofs: Row, everywhere: Row) -> str:
    """Return the table of a track of tiers A and B."""
    table = grouped(rows, "AB", track, target)
    methods, lines = methods_of(table), []
    for name, own in table.items():
        best = int(own["best-known"]["value"])
        bound = proofs.get(name, {}).get(str(target), {}).get("bound", 1)
        where = str(everywhere.get(name, {}).get(str(target), {}).get("bound", ""))
        state = [f"{best}", where]
        if track == "cover":
            state = [f"{best}", "proven" if bound >= best else f"**open**, {bound}"]
        lines.append([name, *state, *(shown(own.get(method), 0) for method in methods)])
    head = ["best", "bound over candidates"] if track == "cover" else ["best", "bound over all poses"]
    return markdown(["instance", *head, *methods], lines)


def charts(rows: list[Row]) -> None:
    """Draw views over processor seconds, and views over the target."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    table = grouped(rows, "AB", "free", 0.99)
    figure, axes = plt.subplots(figsize=(6.5, 4.2))
    methods = [m for m in methods_of(table) if sum(m in each for each in table.values()) > len(table) // 2]
    common = [each for each in table.values() if all(method in each for method in methods)]
    for method in methods:
        excess = np.mean([100 * (each[method]["value"] / each["best-known"]["value"] - 1) for each in common])
        seconds = np.exp(np.mean([np.log(each[method]["cpu_s"]) for each in common]))
        axes.plot(seconds, excess, "o")
        axes.annotate(method, (seconds, excess), xytext=(5, 5), textcoords="offset points")
    axes.set_title(f"{len(common)} instances that all these methods have", fontsize=9)
    axes.set(xscale="log", xlabel="processor time, geometric mean [s]", ylabel="views above the best known, mean [%]")
    axes.margins(x=0.3, y=0.15)
    figure.tight_layout()
    figure.savefig(HERE / "views_over_seconds.png", dpi=110)
    figure, axes = plt.subplots(figsize=(6.5, 4.2))
    targets = [0.95, 0.99, 1.0]
    tables = [grouped(rows, "A", "cover", target) for target in targets]
    for name in tables[0]:
        if all(name in each for each in tables):
            axes.plot(range(3), [each[name]["best-known"]["value"] for each in tables], "o-", ms=3, lw=1, label=name)
    axes.set(yscale="log", ylabel="views, best known cover", xlabel="target", xticks=range(3), xticklabels=targets)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.legend(fontsize=6, ncols=2)
    figure.tight_layout()
    figure.savefig(HERE / "views_over_coverage.png", dpi=110)


def main() -> None:
    """Write table and charts."""
    rows = all_rows()
    proofs = json.loads((HERE / "best" / "proofs.json").read_text())
    everywhere = json.loads((HERE / "best" / "bounds.json").read_text())
    text = (
        "# Leaderboard\n\nMade by `python -m benchmarks.open.table` from `results/`. In brackets: processor seconds.\n"
    )
    for target in (0.95, 0.99, 1.0):
        text += f"\n## Track cover, target {target:g}: views\n\n"
        text += views_table(rows, "cover", target, proofs, everywhere)
    for target in (0.95, 0.99):
        if grouped(rows, "AB", "free", target):
            text += f"\n## Track free, target {target:g}: views\n\n"
            text += views_table(rows, "free", target, proofs, everywhere)
    table = grouped(rows, "C", None, None)
    methods, lines = methods_of(table), []
    for name, own in table.items():
        best, bound = own["best-known"]["value"], proofs[name]["bound"]
        state = "proven" if bound >= best * (1 - 1e-5) else f"**open**, {bound:.3f}"
        lines.append([name, f"{best:.3f}", state, *(shown(own.get(method), 3) for method in methods)])
    text += "\n## Tier C: seconds of motion\n\n" + markdown(["instance", "best", "bound", *methods], lines)
    table = grouped(rows, "D", None, None)
    methods = methods_of(table)
    lines = [[name, *(shown(own.get(method), 4) for method in methods)] for name, own in table.items()]
    text += "\n## Tier D: mean share of the reference at the budgets\n\n" + markdown(["instance", *methods], lines)
    (HERE / "LEADERBOARD.md").write_text(text)
    charts(rows)
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
