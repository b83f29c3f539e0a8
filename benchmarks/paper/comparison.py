"""Our plan on the terms of another method: fewest views for its coverage, most coverage with its number of views."""

from dataclasses import replace

import numpy as np

from cell.study.bench import Bench, Judged, Mask
from planner import cover
from planner.cover import CoverProblem
from planner.viewpoints.viewpoints import Viewpoints

DENSER = 4
"""Factor on the samples per face if a plan that covers all regular samples does not suffice."""

_MAX_RAISES = 6  # of the target; one or two close the gap on the held-out samples
_MARGIN = 0.0005  # added to the gap [share], since a target without it can be missed by a rounding


def fewest_for(bench: Bench, candidates: Viewpoints, allowed: Mask | None, visible: float, full: Judged) -> Judged:
    """Select few views (`aimed`) that measure at least a share of the surface, on the held-out samples.

    The target on the matrix's samples is raised by the gap on the held-out samples, and above the coverage of a plan
    that is selected twice, until the gap is closed. If full coverage of the samples does not suffice, the matrix gets
    `DENSER` times as many samples.

    Args:
        bench: part and scanner.
        candidates: viewpoints.
        allowed: (V,) usable candidates; None: all.
        visible: target share of the surface.
        full: the plan that covers all regular samples.

    Returns:
        The selection. It misses the target only if a plan for all denser samples misses it, and then it measures at
        least as much as `full`.
    """
    density = 1 if full.visible >= visible else DENSER
    M = bench.matrix("aimed", candidates, density)
    by_row = M.matrix().tocsr() if allowed is None else M.matrix().tocsr()[:, allowed]
    coverable = float(M.samples.areas[np.diff(by_row.indptr) > 0].sum() / M.samples.areas.sum())
    share = min(1.0, visible / coverable) if coverable > 0 else 1.0
    before: list[int] = []
    for _ in range(_MAX_RAISES):
        found = bench.select("aimed", candidates, allowed, solver="auto", share=share, density=density)
        if found.visible >= visible:
            return found
        if share >= 1.0:
            break
        share += (visible - found.visible) / coverable + _MARGIN
        if found.cover.views.tolist() == before:  # few views can cover far more of the matrix than the target
            share = max(share, found.cover.covered_area / found.cover.coverable_area + _MARGIN)
        share, before = min(1.0, share), found.cover.views.tolist()
    if density > 1 and share < 1.0:
        found = bench.select("aimed", candidates, allowed, solver="auto", density=density)
    return full if density == 1 or full.visible >= found.visible else found


def most_with(bench: Bench, candidates: Viewpoints, allowed: Mask | None, views: int, full: Judged) -> Judged:
    """Select at most a number of views with the most coverage (`aimed`), on the held-out samples.

    If this number covers all samples of the matrix, the matrix gets `DENSER` times as many samples, and the better of
    both plans is returned.

    Args:
        bench: part and scanner.
        candidates: viewpoints.
        allowed: (V,) usable candidates; None: all.
        views: most views.
        full: the plan that covers all regular samples.
    """
    enough = len(full.cover.views) <= views
    M = bench.matrix("aimed", candidates, DENSER if enough else 1)
    rng = np.random.default_rng(bench.scene.plan.seed)
    most = cover.solve(CoverProblem(M.matrix(), M.samples.areas, allowed, max_views=views), rng=rng)
    found = replace(bench.judged(most, candidates), density=DENSER if enough else 1)
    return full if enough and full.visible >= found.visible else found
