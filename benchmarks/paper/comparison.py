"""Our plan on the terms of another method: fewest views for its coverage, most coverage with its number of views."""

from functools import cached_property

import numpy as np

from cell.study.prepared_part import Bench, EvaluatedCover
from planner import cover
from planner.cover import CoverProblem
from planner.values import Bools
from planner.viewpoints.viewpoints import Viewpoints

DENSER = 4
"""Factor on the samples per face if a plan that covers all regular samples does not suffice."""

_MAX_RAISES = 6  # raises of the target; one or two close the gap on the held-out samples
_MARGIN = 0.0005  # added to the gap [share], since a target without it can be missed by a rounding


class PaperBench(Bench):
    """A bench with a second one that has `DENSER` times as many samples per face."""

    is_denser = False

    @cached_property
    def denser(self) -> "PaperBench":
        """The bench with more samples."""
        samples_per_face = DENSER * self.scene.plan.samples_per_face
        plan = self.scene.plan.model_copy(update={"samples_per_face": samples_per_face})
        bench = PaperBench(self.scene.model_copy(update={"plan": plan}), samples=self.n_samples)
        bench.is_denser = True
        return bench


def fewest_for(
    bench: PaperBench, candidates: Viewpoints, allowed: Bools | None, visible: float, full: EvaluatedCover
) -> tuple[EvaluatedCover, bool]:
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
        The selection, and whether it is for the denser samples. It misses the target only if a plan for all denser
        samples misses it, and then it measures at least as much as `full`.
    """
    bench = bench if full.visible >= visible else bench.denser
    M = bench.matrix("aimed", candidates)
    by_row = M.matrix().tocsr() if allowed is None else M.matrix().tocsr()[:, allowed]
    coverable = float(M.samples.areas[np.diff(by_row.indptr) > 0].sum() / M.samples.areas.sum())
    share = min(1.0, visible / coverable) if coverable > 0 else 1.0
    before: list[int] = []
    for _ in range(_MAX_RAISES):
        found = bench.select("aimed", candidates, allowed, solver="auto", share=share)
        if found.visible >= visible:
            return found, bench.is_denser
        if share >= 1.0:
            break
        share += (visible - found.visible) / coverable + _MARGIN
        if found.cover.views.tolist() == before:  # few views can cover far more of the matrix than the target
            share = max(share, found.cover.covered_area / found.cover.coverable_area + _MARGIN)
        share, before = min(1.0, share), found.cover.views.tolist()
    if bench.is_denser and share < 1.0:
        found = bench.select("aimed", candidates, allowed, solver="auto")
    return (found, True) if bench.is_denser and found.visible > full.visible else (full, False)


def most_with(
    bench: PaperBench, candidates: Viewpoints, allowed: Bools | None, views: int, full: EvaluatedCover
) -> tuple[EvaluatedCover, bool]:
    """Select at most a number of views with the most coverage (`aimed`), on the held-out samples.

    If this number covers all samples of the matrix, the matrix gets `DENSER` times as many samples, and the better of
    both plans is returned.

    Args:
        bench: part and scanner.
        candidates: viewpoints.
        allowed: (V,) usable candidates; None: all.
        views: most views.
        full: the plan that covers all regular samples.

    Returns:
        The selection, and whether it is for the denser samples.
    """
    suffices = len(full.cover.views) <= views
    bench = bench.denser if suffices else bench
    M = bench.matrix("aimed", candidates)
    rng = np.random.default_rng(bench.scene.plan.seed)
    most = cover.solve(CoverProblem(M.matrix(), M.samples.areas, allowed, max_views=views), rng=rng)
    found = bench.evaluate(most, candidates)
    return (full, False) if suffices and full.visible >= found.visible else (found, bench.is_denser)
