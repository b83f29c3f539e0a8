"""Coverage over the number of views, with candidates only and with free poses: plans of several requested coverages.

Parts, samples and variables as in `benchmarks.pose_search`, with the efforts 0 (candidates only) and normal.
"""

import math
from pathlib import Path
from typing import Any

from benchmarks import pose_search


def run() -> list[dict[str, Any]]:
    """Return one row for each part, effort and requested coverage."""
    return pose_search.run(efforts="0,normal", coverages="0.7,0.8,0.9,0.95,0.98,0.99,0.995")


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw a panel for each part, a line for each effort."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    parts = list(dict.fromkeys(row["part"] for row in rows))
    columns = math.ceil(math.sqrt(len(parts)))
    n_rows = math.ceil(len(parts) / columns)
    figure, panels = plt.subplots(n_rows, columns, figsize=(3.6 * columns, 2.9 * n_rows), squeeze=False)
    for axes, part in zip(panels.flat, parts, strict=False):
        for effort in dict.fromkeys(row["effort"] for row in rows):
            own = [row for row in rows if row["part"] == part and row["effort"] == effort]
            label = "candidates" if effort == "0" else f"pose search, {effort} effort"
            axes.plot([row["views"] for row in own], [row["coverage %"] for row in own], "o-", ms=3, label=label)
        axes.set(xlabel="views", ylabel="coverage [% of surface]", title=part)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.3)
    for axes in list(panels.flat)[len(parts) :]:
        axes.set_axis_off()
    panels.flat[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "coverage_over_views.png", dpi=120)
    plt.close(figure)
