"""What a simulation knows and the planning does not: the true part, its coverage, and the fewest views for that.

The bound is that of `cell plan --curve` on the true model, a run folder of its own (truth/): no so many of *its*
candidates measure more of its samples. For the coverage that was reached it is asked anew, as a set cover with branch
and bound, which proves more than the curve does for each number of views, for the coverage of the same samples.
Coverage that is told is visible coverage on the held-out samples, as everywhere.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import Field

from cell.explore.hidden import Hidden
from cell.part.workpiece import Workpiece
from cell.plan import pipeline
from cell.runs.cell import read_cell, world_of
from cell.runs.run import ExecutedScan, Run, open_finished
from cell.runs.schema import BoundAt, JsonTable, Truth, parsed
from cell.scene.model import Scene
from cell.session import Origin, Session, Stream, random_stream
from cell.world import clearance
from cell.world.collision import MujocoCollisionChecker
from cell.world.prediction import held_out
from planner.cover.problem import CoverProblem
from planner.cover.selection import solve
from planner.measurability.coverage import marginal_coverage
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import find_measured

FOLDER = "truth"


class _Point(JsonTable):
    n_views: int = Field(description="how many")
    covered: float = Field(description="share of the surface")
    upper_bound: float = Field(description="share of the surface")


class _Curve(JsonTable):
    """The part of curve.json that is read here."""

    points: tuple[_Point, ...]


@dataclass(frozen=True, slots=True)
class Explored:
    """What was executed.

    Attributes:
        stages: run folders, in order.
        scans: of all stages, in driving order.
    """

    stages: tuple[Path, ...]
    scans: tuple[ExecutedScan, ...]


def plan_truth(session: Session[None], scene: Scene, part: Workpiece, folder: Path) -> Path:
    """`cell plan --curve` on the true model, below the exploration; the one that is there, where there is one."""
    out = folder / FOLDER
    if out.is_dir():
        return out
    for left in folder.glob(f"{FOLDER}.part*"):  # of one that was stopped
        shutil.rmtree(left)
    plan = scene.plan.model_copy(update={"max_views": None, "curve": True})
    inner = replace(session.closed(out), origin=Origin())
    return pipeline.plan(inner, scene.model_copy(update={"plan": plan}), part=part)


def truth_of(truth: Path, hidden: Hidden, explored: Explored) -> Truth:
    """The truth beside an exploration.

    Args:
        truth: run folder of the plan that knows the model.
        hidden: the part in the explored frame.
        explored: what was executed.
    """
    run = open_finished(truth)
    cell, report = read_cell(run), run.report
    samples = held_out(cell.reference, cell.planning, run.seed)
    to_object = np.linalg.inv(hidden.T_explored_object)
    poses = np.stack([to_object @ _true_pose(scan) for scan in explored.scans])[:, None]
    seen = find_measured(poses, samples, cell.scanner, (cell.part_caster, cell.occluder_caster), each=True)
    by_views = np.cumsum(marginal_coverage(seen))
    reached = float(by_views[-1])
    points = parsed(_Curve, run.artefact("curve.json"), truth / "curve.json").points
    M = run.measurability
    on_rows = find_measured(poses, M.samples, cell.scanner, (cell.part_caster, cell.occluder_caster))
    share = float(M.samples.areas[on_rows].sum() / M.samples.areas.sum())
    fewest, found = _fewest(run, M, share)
    most = min(share, max(point.upper_bound for point in points))
    fewest = max(fewest, min(point.n_views for point in points if point.upper_bound >= most))
    bound = _bound(points, share, fewest, found)
    if report.coverage.visible >= reached:  # of other samples: the plan that measured as much has no fewer views
        fewest, found = min(fewest, report.n_views), min(found, report.n_views)
    nearest, between = _nearest(run.folder, explored.stages)
    return Truth(
        visible=reached,
        by_views=tuple(round(float(share), 6) for share in by_views),
        known_model_visible=report.coverage.visible,
        known_model_views=report.n_views,
        coverable=report.coverage.coverable,
        fewest=fewest,
        fewest_found=found,
        bound=bound,
        nearest_mm=round(1000 * nearest, 4),
        nearest=between,
    )


def _bound(points: Sequence[_Point], reached: float, fewest: int, found: int) -> tuple[BoundAt, ...]:
    """The curve, and that fewer views than the fewest do not measure as much as was reached, and those found do."""
    at = ((point, min(point.upper_bound, reached)) for point in points)
    return tuple(
        BoundAt(
            views=point.n_views,
            found=point.covered if point.n_views < found else max(point.covered, likewise),
            at_most=point.upper_bound if point.n_views >= fewest else max(point.covered, likewise),
        )
        for point, likewise in at
    )


def _fewest(run: Run, M: Measurability, coverage: float) -> tuple[int, int]:
    """Views that a plan's candidates need at least for a coverage, or for all that they measure, and that suffice.

    Args:
        run: the plan.
        M: its matrix.
        coverage: share of the surface that the matrix' rows stand for.
    """
    reachable = run.reach.reachable
    matrix, areas = M.matrix(), M.samples.areas
    coverable = float(areas[matrix[:, np.flatnonzero(reachable)].sum(axis=1) > 0].sum())
    share = min(coverage * float(areas.sum()) / coverable, 1.0)
    rng = random_stream(run.seed, Stream.FEWEST_VIEWS)
    cover = solve(CoverProblem(matrix, areas, reachable, coverage=share), rng=rng)
    return cover.lower_bound, len(cover.views)


def _true_pose(scan: ExecutedScan) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(4, 4) from where the rays went out, explored frame [m]."""
    return scan.T_reported if scan.T_true is None else scan.T_true


def _nearest(truth: Path, stages: Sequence[Path]) -> tuple[float, str]:
    """Smallest distance [m] of arm or tool to anything in the true cell along the motions of all stages, and what."""
    run = open_finished(truth)
    checker = MujocoCollisionChecker(world_of(run, run.mesh("reference.ply")))
    found: list[tuple[float, str]] = []
    for stage in stages:
        motion = open_finished(stage).motion
        measured_ = clearance.of_motion(checker, motion.via_q, motion.segment, int(motion.segment.max()) + 1)
        found += list(zip(measured_.distance.tolist(), measured_.between, strict=True))
    return min(found)
