"""What is lost: what a plan measures beside what any pose would measure that this robot takes up here.

Both figures stand on the same held-out samples. What the plan or a reachable candidate measures is known of all of
them; of the rest up to `Effort.searched_samples` are drawn and searched for one by one.
"""

import numpy as np

from cell.plan.candidates import arm_of
from cell.plan.problem import Problem
from cell.runs.schema import Attainable
from cell.session import default_effort
from planner.geometry.sampling import pick_samples
from planner.measurability.coverage import Coverage
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.lines_of_sight import RayTargets

TOLD_BELOW = 0.8
"""Share of the surface below which a plan says why it measures no more."""


def of_plan(problem: Problem, visible: Coverage, rng: np.random.Generator) -> Attainable:
    """What this robot can measure here."""
    prediction = problem.prediction
    arm = arm_of(problem.world, problem.kinematics, problem.checker, prediction.scanner, prediction.casters)
    samples = prediction.samples
    known = np.asarray(prediction.coverable.covered | visible.covered)
    rest = np.flatnonzero(~known)
    asked = np.sort(rng.permutation(rest)[: default_effort().searched_samples])
    some = pick_samples(samples, asked)
    found = probe_attainable(RayTargets.of(some.points, some.normals, some.region), arm)
    total = float(samples.areas.sum())
    left = float(samples.areas[rest].sum()) / total
    share, out_of_reach = (
        float(which.mean()) if len(asked) else 0.0 for which in (found.measured, found.visible & ~found.measured)
    )
    missing = 1 - (len(asked) - 1) / (len(rest) - 1) if len(rest) > 1 else 0.0  # of a finite population
    return Attainable(
        share=float(samples.areas[known].sum()) / total + left * share,
        standard_error=left * float(np.sqrt(share * (1 - share) / max(len(asked), 1) * missing)),
        asked=len(asked),
        out_of_reach=left * out_of_reach,
        out_of_sight=left * (1 - share - out_of_reach),
    )


def sentence(visible: float, coverable: float, found: Attainable) -> str:
    """What is lost, in one line, the largest loss named where little is measured."""
    told = (
        f"{100 * visible:.2f} % measured of {100 * found.share:.2f} % that this robot can measure here (standard error "
        f"{100 * found.standard_error:.2f})"
    )
    if visible >= TOLD_BELOW:
        return told
    losses = (
        (
            found.out_of_reach,
            "the arm takes up no pose that sees it (cell place finds another place, cell why a second set-up)",
        ),
        (found.out_of_sight, "no pose sees it past the part and what stands about it, within the scanner's limits"),
        (
            found.share - coverable,
            "no candidate measures it, though other poses would (--candidates grown)",
        ),
        (coverable - visible, "the plan was not asked for it (--coverage, --max-views)"),
    )
    area, why = max(losses)
    return f"{told}; {100 * area:.1f} % of the surface is lost because {why}"
