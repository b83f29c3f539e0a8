"""`cell why`: why parts of the surface stay open in a finished plan, and the smallest single change that measures them.

`answer_of` shows the whole on one screen: the held-out samples that the plan's views leave open get a reason each
(`planner.why.why`), samples of one reason make a group and connected ones a patch, changes are tried on representatives
(`cell.why.changes`), and those that are named are asked about every sample that they are named for. The plan is never
touched; files go to `why/` in the run folder. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError
from cell.runs.cell import collision_note, read_cell, world_of
from cell.runs.run import Run, open_finished, reading
from cell.runs.schema import PlanFile, PlanView, WhyReport
from cell.session import ProgressReporter, default_effort
from cell.view.contents import of_views
from cell.view.surface import canvas_of
from cell.why import files as why_files
from cell.why.answer import Answer
from cell.why.changes import Changes
from cell.why.groups import grouped
from cell.why.search import search
from cell.world.embree import EmbreeRayCaster
from cell.world.prediction import held_out_samples
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints
from planner.why import why
from planner.why.reasons import REASON_OF_VERDICT, Reason


@dataclass(frozen=True, slots=True, eq=False)
class WhyOutcome:
    """What `cell why` leaves.

    Attributes:
        folder: of its files.
        summary: its why.json.
    """

    folder: Path
    summary: WhyReport


def explain(run_folder: Path, reporter: ProgressReporter, *, samples: int | None = None) -> WhyOutcome:
    """Say why a finished plan leaves parts of the surface open, and write the files.

    Args:
        run_folder: of a finished plan.
        reporter: is told what goes on.
        samples: how many held-out samples; None takes those of the definition.

    Raises:
        CellError: with one sentence and the exit code.
    """
    if samples is not None and samples < 1:
        raise UsageError(f"--samples {samples} is not possible; at least 1 sample is needed")
    run = open_finished(run_folder)
    answer = answer_of(run, reporter, default_effort().held_out_samples if samples is None else samples)
    with reporter.stage("write"):
        summary = why_files.report_of(answer, run)
        folder = why_files.write(run, answer, summary)
    return WhyOutcome(folder, summary)


def answer_of(run: Run, reporter: ProgressReporter, count: int) -> Answer:
    """The whole on one screen."""
    with reporter.stage("read the run"):
        cell, plan = read_cell(run), run.plan
        candidates = _as_executed(run.candidates, plan.views)
        fails, blockers = _failing(run, plan, len(candidates))
        world = world_of(run, cell.reference)
        for sentence in collision_note(cell.scene):
            reporter.note(sentence)
        scanner, part_caster, occluder_caster = cell.scanner, cell.part_caster, cell.occluder_caster
    with reporter.stage("what stays open"):
        samples = held_out_samples(cell.reference, cell.planning, run.seed, count)
        targets = RayTargets.of(samples.points, samples.normals, samples.region)
        views = candidates.T_object_scanner[[view.id for view in plan.views]]
        surface = of_views(cell, samples, list(views))
        rows = np.flatnonzero(~surface.seen.any(axis=1))
    with reporter.stage("reasons") as progress:
        diagnosis = why.diagnose(
            targets, rows, candidates, scanner, part_caster, occluder_caster, fails, progress=progress
        )
        casters = {piece.name: EmbreeRayCaster(piece.vertices, piece.faces) for piece in cell.occluders}
        what = why.occluders_of(targets, rows, diagnosis, candidates, scanner, casters)
        K = candidates.T_object_scanner.shape[1]
        of_robot = (diagnosis.reason >= Reason.OUT_OF_REACH) & (diagnosis.reason < Reason.NOT_SELECTED)
        for i in np.flatnonzero(of_robot):
            what[i] = blockers[diagnosis.pose[i] // K]
    with reporter.stage("changes") as progress:
        changes = Changes(
            world, lambda name: world_of(run, cell.reference, without=(name,)), cell, candidates,
            np.flatnonzero(fails == Reason.NOT_SELECTED),
        )  # fmt: skip
        groups = grouped(samples, rows, diagnosis, what, cell.planning, cell.scanner_keys, cell.scene.regions or ())
        found = search(changes, targets, samples, groups, progress)
    return Answer(canvas_of(cell.reference, samples), surface, rows, *found, cell.scene.part.name)


def _as_executed(candidates: Viewpoints, views: Sequence[PlanView]) -> Viewpoints:
    """The candidates, those of the plan's views at the poses of the rounded joint angles, as coverage takes them."""
    T = np.array(candidates.T_object_scanner)
    if T.shape[1] == 1:
        for view in views:
            T[view.id, 0] = view.T_object_scanner
    return Viewpoints(T, candidates.face, candidates.standoff, candidates.roll)


def _failing(run: Run, plan: PlanFile, count: int) -> tuple[NDArray[np.uint8], list[str]]:
    """At what each candidate fails even for a point that it would measure, and what is in its way."""
    reached = run.reach
    fails = np.array([REASON_OF_VERDICT[verdict] for verdict in REASON_OF_VERDICT], dtype=np.uint8)[reached.verdict]
    blockers = list(reached.blocker)
    with reading(run.folder / "plan.json"):
        if len(fails) != count:
            raise ValueError(f"reach.npz has {len(fails)} verdicts and viewpoints.npz {count} candidates")
        for view in plan.dropped:
            fails[view.id], blockers[view.id] = Reason.NO_PATH, view.reason
    return fails, blockers
