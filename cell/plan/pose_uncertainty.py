"""Pose errors in the planning: the layer of probabilities before the selection, and simulated executions after it.

What a plan promises was learned from an ensemble and from the matrix' samples. Whether it holds is asked of fresh
errors and of samples that the plan has not seen: each of `EXECUTIONS` executions draws an error of its own for every
view and measures anew. docs/internals/coverage_requests.md says what the figures mean.
"""

from collections.abc import Sequence

import numpy as np

from cell.runs.schema import Promise, RobustSelection
from cell.scene.model import PlanSettings
from cell.world.prediction import Prediction
from planner.geometry.sampling import pick_samples
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.measurability.pose_ensemble import (
    PoseError,
    ProbabilityLayer,
    credited_probability,
    probability_layer,
    simulate_executions,
)
from planner.measurability.visibility import find_measured
from planner.ports import Progress, RayCaster, Scanner
from planner.values import Floats
from planner.viewpoints.viewpoints import Viewpoints

EXECUTIONS = 200
"""Simulated executions."""

SAMPLES = 10_000
"""Held-out samples that they look at, drawn from those of the prediction: a share is then known to half a point."""


def pose_error(plan: PlanSettings) -> PoseError:
    """The scene's standard deviations in metres and radians."""
    return PoseError(plan.pose_sd_mm / 1000, float(np.deg2rad(plan.pose_sd_deg)))


def layer(
    plan: PlanSettings,
    M: Measurability,
    candidates: Viewpoints,
    reached: Reach,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    rng: np.random.Generator,
    progress: Progress,
) -> ProbabilityLayer:
    """Probabilities of the matrix' entries under the scene's pose error."""
    errors = pose_error(plan).draw(plan.ensemble, rng)
    return probability_layer(M, candidates, scanner, casters, errors, columns=reached.reachable, progress=progress)


def simulate(
    plan: PlanSettings,
    robust: RobustSelection,
    T_object_poses: Floats,
    prediction: Prediction,
    rng: np.random.Generator,
    progress: Progress,
) -> Promise:
    """Execute the plan's views with errors, and compare with what is promised of the same samples.

    Args:
        plan: the scene's table.
        robust: what the selection was to hold.
        T_object_poses: (n, K, 4, 4) views of the plan [m].
        prediction: held-out samples, scanner and casters.
        rng: draws samples, ensemble and executions.
        progress: told about the executions.
    """
    every = prediction.samples
    some = np.sort(rng.permutation(len(every))[:SAMPLES])
    samples = pick_samples(every, some)
    area = samples.areas / samples.areas.sum()
    error, n = pose_error(plan), len(T_object_poses)

    def each(T: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        return find_measured(T, samples, prediction.scanner, prediction.casters, each=True)

    hits = np.zeros((len(samples), n), dtype=np.int64)
    for member in error.draw(plan.ensemble, rng):
        hits += each(T_object_poses @ member)
    p = credited_probability(hits, plan.ensemble) * each(T_object_poses)
    promised = np.prod(1.0 - p, axis=1) <= plan.alpha
    errors = error.draw(EXECUTIONS * n, rng).reshape(EXECUTIONS, n, 4, 4)
    times, share = simulate_executions(
        T_object_poses, samples, prediction.scanner, prediction.casters, errors, progress=progress
    )
    frequency = times / EXECUTIONS
    met = frequency >= 1.0 - plan.alpha
    whole = float(area[promised].sum())
    return Promise(
        **dict(robust),
        executions=EXECUTIONS,
        samples=len(samples),
        promised=whole,
        achieved=float(area[met].sum()),
        kept=float(area[promised & met].sum()) / whole if whole else 1.0,
        frequency=float((area * frequency)[promised].sum()) / whole if whole else 1.0,
        coverage_mean=float(share.mean()),
        coverage_worst=float(share.min()),
    )
