"""Coverage over the number of views in the run folder: `curve.json` and `curve.png`."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cell.plan.pictures import save
from cell.plan.request import Request, Selected
from cell.run.folder import RunFolder
from planner.cover.curve import CoverageCurve, coverage_curve
from planner.measurability.matrix import Measurability
from planner.reach.reach import Reach

ASKED = (0.9, 0.95, 0.98, 0.99, 0.995, 1.0)
"""Shares of the coverable area for which the fewest views are read off."""


def curve_of(
    request: Request, selected: Selected, M: Measurability, reached: Reach, rng: np.random.Generator
) -> CoverageCurve:
    """The curve of a plan's matrix; the plan is a point of it.

    Args:
        request: what was asked for: pinned and banned views hold for the curve too.
        selected: the answer.
        M: the matrix, as arm and occluders leave it.
        reached: which candidates may be used.
        rng: randomness of the search.
    """
    chosen = selected.cover
    full = request.exchangeable and selected.target == 1.0 and request.costs is None
    return coverage_curve(
        M.matrix(), M.features.areas, reached.reachable, rng=rng, known=[chosen.views],
        fewest_for_all=chosen.lower_bound if full else 0, pinned=request.plan.pinned, banned=request.plan.banned,
    )  # fmt: skip


def summary(curve: CoverageCurve) -> dict[str, Any]:
    """The fewest views for round shares of what can be measured, for report.json."""
    return {
        "fewest": [
            {"of_coverable": share, "views": curve.fewest(share)[0], "at_least": curve.fewest(share)[1]}
            for share in ASKED
        ]
    }


def write(folder: RunFolder, curve: CoverageCurve, plan_views: int, plan_area: float) -> None:
    """Data and picture of a curve.

    Args:
        folder: the run folder.
        curve: what to write.
        plan_views: number of views of the plan.
        plan_area: area of the matrix' samples that the plan measures [m^2].
    """
    folder.write_json(
        "curve.json",
        {
            "units": "fractions of the surface's area, over the samples of measurability.npz",
            "coverable": curve.coverable_area / curve.total_area,
            "points": [
                {
                    "n_views": int(n),
                    "covered": float(area) / curve.total_area,
                    "upper_bound": float(upper) / curve.total_area,
                    "views": views.tolist(),
                }
                for n, area, upper, views in zip(
                    curve.n_views, curve.covered_area, curve.upper_area, curve.views, strict=True
                )
            ],
            **summary(curve),
        },
    )
    draw(folder.path / "curve.png", curve, plan_views, plan_area)
    folder.adopt("curve.png")


def draw(path: Path, curve: CoverageCurve, plan_views: int, plan_area: float) -> None:
    """Covered share of what can be measured over the number of views, the bound above it, and the plan.

    The lower half shows what is missing on a logarithmic scale, where the last views differ.
    """
    figure = Figure(figsize=(7.2, 6.4), dpi=110, layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    n = curve.n_views
    covered, bound = (100 * area / max(curve.coverable_area, 1e-300) for area in (curve.covered_area, curve.upper_area))
    plan = 100 * plan_area / max(curve.coverable_area, 1e-300)
    upper.fill_between(n, covered, bound, color="#f5b7b1", lw=0, label="not excluded by the bound")
    upper.plot(n, bound, "-", color="#b03a2e", lw=1, label="no views of this number measure more")
    upper.plot(n, covered, "o-", color="#2471a3", ms=4, lw=1.2, label="best views found")
    upper.plot([plan_views], [plan], "*", color="#111111", ms=11, label="the plan")
    upper.set(ylabel="measured [% of what can be measured]", ylim=(0, 103), xlim=(float(n[0]), float(max(n[-1], 1))))
    upper.legend(loc="lower right", fontsize=8)
    floor = 100 * _smallest(curve)
    missing, open_still = np.maximum(100 - covered, floor), np.maximum(100 - bound, floor)
    lower.semilogy(n, missing, "o-", color="#2471a3", ms=4, lw=1.2)
    lower.semilogy(n, open_still, "-", color="#b03a2e", lw=1)
    lower.fill_between(n, open_still, missing, color="#f5b7b1", lw=0)
    lower.semilogy([plan_views], [max(100 - plan, floor)], "*", color="#111111", ms=11)
    lower.set(xlabel="number of views", ylabel=f"not measured [%]\n(all measured: {floor:.2g})")
    lower.xaxis.set_major_locator(MaxNLocator(integer=True))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    save(figure, path)


def _smallest(curve: CoverageCurve) -> float:
    """Half of the smallest share that any point lacks, where the logarithmic axis ends; 0.1 % without any."""
    missing = 1 - np.concatenate((curve.covered_area, curve.upper_area)) / max(curve.coverable_area, 1e-300)
    missing = missing[missing > 1e-9]
    return float(missing.min()) / 2 if len(missing) else 1e-3
