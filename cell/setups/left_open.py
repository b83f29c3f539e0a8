"""What no view of several set-ups measures: each held-out sample counts once, by the first reason that holds."""

from collections.abc import Mapping, Sequence

import numpy as np

from cell.runs.schema import PlannedOpen
from cell.session import default_effort
from cell.setups.measured import Setup
from planner.geometry.sampling import pick_samples
from planner.values import Bools
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.lines_of_sight import RayTargets


def left_open(setups: Mapping[int, Setup], chosen: Sequence[int], seen: Bools, rng: np.random.Generator) -> PlannedOpen:
    """The shares of the reasons.

    What no candidate measures is asked of any pose in the chosen set-ups, on seeded samples.

    Args:
        setups: all that are possible.
        chosen: those that are used.
        seen: (S,) held-out samples that a view measures.
        rng: draws the samples that are asked about.
    """
    samples = setups[chosen[0]].prediction.samples
    candidate = ~seen & np.logical_or.reduce([setup.coverable for setup in setups.values()])
    touched = ~seen & ~candidate & np.logical_and.reduce([setups[row].touched for row in chosen])
    rest = np.flatnonzero(~seen & ~candidate & ~touched)
    asked = np.sort(rng.permutation(rest)[: default_effort().searched_samples])
    measured, sighted = np.zeros(len(asked), dtype=np.bool_), np.zeros(len(asked), dtype=np.bool_)
    for row in chosen:
        free = np.flatnonzero(~setups[row].touched[asked] & ~measured)
        some = pick_samples(samples, asked[free])
        found = probe_attainable(RayTargets.of(some.points, some.normals, some.region), setups[row].arm(some))
        measured[free] |= found.measured
        sighted[free] |= found.visible
    left = len(rest) / len(samples)  # they stand for equal areas
    shares = [float(which.mean()) if len(asked) else 0.0 for which in (sighted & ~measured, measured, ~sighted)]
    missing = 1 - (len(asked) - 1) / (len(rest) - 1) if len(rest) > 1 else 0.0  # of a finite population
    worst = max(share * (1 - share) for share in shares) / max(len(asked), 1)
    return PlannedOpen(
        not_asked=float(candidate.mean()),
        in_contact=float(touched.mean()),
        out_of_reach=left * shares[0],
        other_poses=left * shares[1],
        out_of_sight=left * shares[2],
        standard_error=left * float(np.sqrt(worst * missing)),
    )
