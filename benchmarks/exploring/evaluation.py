"""Evaluate an exploration in simulation against the true part, which its planning does not know.

`plan_known_model` is `cell plan --curve` on the true model, in a separate run folder. Its curve bounds the coverage
of any n of its candidates. For the coverage that the exploration reached, a set cover with branch and bound on the same
matrix gives a stronger lower bound on the number of views. Coverage is visible coverage on the held-out samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ConfigDict, Field

from cell.explore import state
from cell.explore.prepare import ExplorationContext
from cell.plan import pipeline
from cell.runs.cell import read_cell, world_of
from cell.runs.run import ExecutedScan, Run, open_finished
from cell.runs.schema import ExploreFile, JsonTable, parsed
from cell.session import Session, Stream, random_stream
from cell.world import clearance
from cell.world.collision import MujocoCollisionChecker
from cell.world.prediction import held_out_samples
from planner.cover.problem import CoverProblem
from planner.cover.solve import solve
from planner.measurability.coverage import marginal_coverage
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import find_measured
from planner.values import Floats


class CurvePoint(JsonTable):
    """A point of the coverage curve in curve.json."""

    model_config = ConfigDict(extra="ignore")

    n_views: int = Field(description="number of views")
    coverage: float = Field(description="share of the surface")
    upper_bound: float = Field(description="share of the surface")


class _Curve(JsonTable):
    model_config = ConfigDict(extra="ignore")

    points: tuple[CurvePoint, ...]


@dataclass(frozen=True, slots=True)
class CoverageBound:
    """The coverage that a number of views can reach with the candidates of the true model.

    Attributes:
        views: number of views.
        found: share of the surface that the best known selection measures.
        at_most: upper bound on the share that any selection measures.
    """

    views: int
    found: float
    at_most: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """An exploration compared with the plan that knows the model; coverages are shares of the true surface.

    Attributes:
        visible: visible coverage of the executed views.
        by_views: visible coverage after the first, second, ... view in driving order.
        known_model_visible: visible coverage of the plan that knows the model.
        known_model_views: its number of views.
        coverable: share that its reachable candidates measure.
        fewest: lower bound on the number of its candidates that reach the coverage of the exploration.
        fewest_found: number of views of the best such selection.
        bound: coverage bounds over the number of views.
        nearest_mm: smallest distance of arm or tool to anything, with the true part in its place [mm].
        nearest: names of the two nearest bodies.
    """

    visible: float
    by_views: tuple[float, ...]
    known_model_visible: float
    known_model_views: int
    coverable: float
    fewest: int
    fewest_found: int
    bound: tuple[CoverageBound, ...]
    nearest_mm: float
    nearest: str


def plan_known_model(work: ExplorationContext, out: Path) -> None:
    """Plan the true part of a simulated exploration with its coverage curve, in the run folder `out`."""
    plan = work.scene.plan.model_copy(update={"max_views": None, "curve": True})
    pipeline.plan(Session(None, out=out), work.scene.model_copy(update={"plan": plan}), part=work.part)


def evaluate(work: ExplorationContext, file: ExploreFile, known_model: Path) -> Evaluation:
    """Evaluate a simulated exploration.

    Args:
        work: the inputs of the exploration.
        file: its explore.json.
        known_model: run folder of `plan_known_model`.
    """
    assert work.ground_truth is not None
    scans = state.read_scans(work.paths, file.batches)
    run = open_finished(known_model)
    cell, report = read_cell(run), run.report
    samples = held_out_samples(cell.reference, cell.planning, run.seed)
    to_object = np.linalg.inv(work.ground_truth.T_explored_object)
    poses = np.stack([to_object @ _true_pose(scan) for scan in scans])[:, None]
    seen = find_measured(poses, samples, cell.scanner, (cell.part_caster, cell.occluder_caster), each=True)
    by_views = np.cumsum(marginal_coverage(seen))
    reached = float(by_views[-1])
    points = parsed(_Curve, run.artefact("curve.json"), known_model / "curve.json").points
    M = run.measurability
    on_rows = find_measured(poses, M.samples, cell.scanner, (cell.part_caster, cell.occluder_caster))
    share = float(M.samples.areas[on_rows].sum() / M.samples.areas.sum())
    fewest, found = fewest_views(run, M, share)
    bounded = min(share, max(point.upper_bound for point in points))
    fewest = max(fewest, min(point.n_views for point in points if point.upper_bound >= bounded))
    bound = bounds(points, share, fewest, found)
    if report.coverage.visible >= reached:  # other samples: the plan itself shows that its number of views suffices
        fewest, found = min(fewest, report.n_views), min(found, report.n_views)
    nearest, between = _nearest(run, [work.paths.root / stage.folder for stage in file.batches])
    return Evaluation(
        visible=reached,
        by_views=tuple(by_views.tolist()),
        known_model_visible=report.coverage.visible,
        known_model_views=report.n_views,
        coverable=report.coverage.coverable,
        fewest=fewest,
        fewest_found=found,
        bound=bound,
        nearest_mm=1000 * nearest,
        nearest=between,
    )


def bounds(points: Sequence[CurvePoint], reached: float, fewest: int, found: int) -> tuple[CoverageBound, ...]:
    """Tighten the curve: fewer views than `fewest` do not reach the coverage `reached`, `found` views do."""
    return tuple(
        CoverageBound(
            views=point.n_views,
            found=point.coverage if point.n_views < found else max(point.coverage, min(point.upper_bound, reached)),
            at_most=point.upper_bound
            if point.n_views >= fewest
            else max(point.coverage, min(point.upper_bound, reached)),
        )
        for point in points
    )


def fewest_views(run: Run, M: Measurability, coverage: float) -> tuple[int, int]:
    """Return a lower bound on the number of reachable candidates that reach a coverage, and the best number found.

    Args:
        run: the plan.
        M: its matrix.
        coverage: share of the surface, or of all that the candidates measure where that is less.
    """
    reachable = run.reach.reachable
    matrix, areas = M.matrix(), M.samples.areas
    coverable = float(areas[matrix[:, np.flatnonzero(reachable)].sum(axis=1) > 0].sum())
    share = min(coverage * float(areas.sum()) / coverable, 1.0)
    rng = random_stream(run.seed, Stream.FEWEST_VIEWS)
    cover = solve(CoverProblem(matrix, areas, reachable, coverage=share), rng=rng)
    return cover.lower_bound, len(cover.views)


def _true_pose(scan: ExecutedScan) -> Floats:
    """Return the true scanner pose (4, 4), explored frame [m]."""
    return scan.T_reported if scan.T_true is None else scan.T_true


def _nearest(run: Run, stages: Sequence[Path]) -> tuple[float, str]:
    """Return the smallest distance [m] of arm or tool to anything in the true cell along all motions, and its pair."""
    checker = MujocoCollisionChecker(world_of(run, run.mesh("reference.ply")))
    found: list[tuple[float, str]] = []
    for stage in stages:
        motion = open_finished(stage).motion
        clearances = clearance.motion_clearance(checker, motion.via_q, motion.segment, int(motion.segment.max()) + 1)
        found += list(zip(clearances.distance.tolist(), clearances.between, strict=True))
    return min(found)
