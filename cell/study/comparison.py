"""Ours on the terms of another method: few views for its coverage, most coverage with its number of views."""

from dataclasses import replace

import numpy as np

from cell.study.bench import Bench, Judged, Mask
from planner import cover
from planner.cover import CoverProblem
from planner.viewpoints.viewpoints import Viewpoints

DENSER = 4
"""Times as many samples per face where a plan that covers all usual ones is not enough."""

_RAISES = 6  # of a target; one or two close the gap that the held-out samples show
_STEP = 0.0005  # beyond the gap [share]: without it the raised target would aim at the edge


def fewest_for(bench: Bench, candidates: Viewpoints, allowed: Mask | None, visible: float, full: Judged) -> Judged:
    """Few views (`aimed`) that measure at least a share of the surface, on the held-out samples.

    The target on the matrix's samples is raised by what the held-out ones show to be missing, beyond what a plan covers
    that comes back unchanged, until it is enough. Where covering all of them is not, the matrix gets `DENSER` times as
    many samples.

    Args:
        bench: the part and the scanner.
        candidates: viewpoints.
        allowed: (V,) which may be used; None: all.
        visible: share of the surface.
        full: the plan that covers all usual samples.

    Returns:
        The selection; it measures less than was asked for only where covering all of the denser samples does, and never
        less than `full` then.
    """
    density = 1 if full.visible >= visible else DENSER
    M = bench.matrix("aimed", candidates, density)
    by_row = M.matrix().tocsr() if allowed is None else M.matrix().tocsr()[:, allowed]
    coverable = float(M.samples.areas[np.diff(by_row.indptr) > 0].sum() / M.samples.areas.sum())
    share = min(1.0, visible / coverable) if coverable > 0 else 1.0
    before: list[int] = []
    for _ in range(_RAISES):
        found = bench.select("aimed", candidates, allowed, solver="auto", share=share, density=density)
        if found.visible >= visible:
            return found
        if share >= 1.0:
            break
        share += (visible - found.visible) / coverable + _STEP
        if found.cover.views.tolist() == before:  # few views may cover far more of the matrix than was asked
            share = max(share, found.cover.covered_area / found.cover.coverable_area + _STEP)
        share, before = min(1.0, share), found.cover.views.tolist()
    if density > 1 and share < 1.0:
        found = bench.select("aimed", candidates, allowed, solver="auto", density=density)
    return full if density == 1 or full.visible >= found.visible else found


def most_with(bench: Bench, candidates: Viewpoints, allowed: Mask | None, views: int, full: Judged) -> Judged:
    """The most coverage (`aimed`) with at most so many views, on the held-out samples.

    Where so many views cover all samples of the matrix, it gets `DENSER` times as many, and the better plan counts.

    Args:
        bench: the part and the scanner.
        candidates: viewpoints.
        allowed: (V,) which may be used; None: all.
        views: how many at most.
        full: the plan that covers all usual samples.
    """
    enough = len(full.cover.views) <= views
    M = bench.matrix("aimed", candidates, DENSER if enough else 1)
    rng = np.random.default_rng(bench.scene.plan.seed)
    most = cover.solve(CoverProblem(M.matrix(), M.samples.areas, allowed, max_views=views), rng=rng)
    found = replace(bench.judged(most, candidates), density=DENSER if enough else 1)
    return full if enough and full.visible >= found.visible else found
