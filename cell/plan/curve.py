"""Coverage over the number of views in the run folder: `curve.json` and `curve.png`."""

from collections.abc import Callable

import numpy as np

from cell.plan.request import Request, Selected
from cell.runs.folder import RunFolder
from cell.runs.schema import Curve, Fewest
from cell.session import PlotQueue
from planner.cover import CoverProblem
from planner.cover.curve import CoverageCurve, coverage_curve
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability

ASKED = (0.9, 0.95, 0.98, 0.99, 0.995, 1.0)
"""Shares of the coverable area for which the fewest views are read off."""


def curve_of(
    request: Request, selected: Selected, M: Measurability, reached: Reach, rng: np.random.Generator, work: int
) -> CoverageCurve:
    """The curve of a plan's matrix; the plan is a point of it.

    Args:
        request: what was asked for: pinned and banned views hold for the curve too.
        selected: the answer.
        M: the matrix, as arm and occluders leave it.
        reached: which candidates may be used.
        rng: randomness of the search.
        work: of search and bound.
    """
    chosen = selected.cover
    full = request.exchangeable and selected.target == 1.0 and request.costs is None
    plan = request.plan
    problem = CoverProblem(M.matrix(), M.samples.areas, reached.reachable, pinned=plan.pinned, banned=plan.banned)
    fewest_for_all = chosen.lower_bound if full else 0
    return coverage_curve(
        problem, rng=rng, known_selections=[chosen.views], min_views_full_coverage=fewest_for_all, effort_budget=work
    )


def fewest_of(curve: CoverageCurve) -> Curve:
    """The fewest views for round shares of what can be measured, for report.json."""
    fewest = {share: curve.fewest_views(share) for share in ASKED}
    return Curve(fewest=[Fewest(of_coverable=share, views=n, at_least=least) for share, (n, least) in fewest.items()])


def write(
    folder: RunFolder, plots: PlotQueue, curve: CoverageCurve, plan_views: int, plan_area: float,
    named: Callable[[int], int | str] = int,
) -> None:  # fmt: skip
    """Data and picture of a curve.

    Args:
        folder: the run folder.
        plots: where the picture is drawn.
        curve: what to write.
        plan_views: number of views of the plan.
        plan_area: area of the matrix' samples that the plan measures [m^2].
        named: what a column of the matrix is called.
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
                    "views": [named(view) for view in views],
                }
                for n, area, upper, views in zip(
                    curve.n_views, curve.covered_area, curve.upper_area, curve.views, strict=True
                )
            ],
            **fewest_of(curve).as_json(),
        },
    )
    percent = 100 / max(curve.coverable_area, 1e-300)
    plots.send(
        "coverage_over_views",
        folder.path / "curve.png",
        n_views=curve.n_views,
        covered=percent * curve.covered_area,
        bound=percent * curve.upper_area,
        plan_views=plan_views,
        plan=percent * plan_area,
    )
