"""`cell plan --open-of RUN`: a further set-up for what the views of finished plans leave open.

Samples, candidates and seed are those of the first run. Its candidates are reached again where the part lies now, and
more are grown for what is open; the matrix has the open samples alone as rows, and a coverage below 1 is kept on the
open ones of the held-out samples. What a support touches in this set-up is asked of none of its views.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from cell import scanners
from cell.errors import UnreachableError, UsageError
from cell.plan import files as plan_files
from cell.plan import pipeline, steps
from cell.plan.appended_candidates import behind
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.of_run import part_of, surface_of
from cell.plan.problem import Problem
from cell.plan.reachable import require_reachable
from cell.plan.steps import Cell, Job, PlanSession
from cell.runs.cell import scene_of_run
from cell.runs.run import Run
from cell.runs.schema import OpenOf
from cell.scene.model import Scene
from cell.session import ProgressReporter, Session, Stream
from cell.setups.contact import touching
from cell.setups.earlier import EarlierSetup, measured_by, require_one_part
from cell.setups.growing import with_grown
from cell.world.measurability import PartSurface
from cell.world.occluders import Occluder, fixed_occluders
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples
from planner.kinematics.reach import Reach
from planner.values import Bools
from planner.viewpoints import growth
from planner.viewpoints.viewpoints import Viewpoints

_SAME = 1e-6  # m, and entries of a rotation


@dataclass(frozen=True, slots=True, eq=False)
class _Open:
    """What earlier set-ups leave open, as far as this one can be asked for it.

    Attributes:
        setups: those that are planned.
        supports: what the part lies on or among in this one, object frame.
    """

    setups: Sequence[EarlierSetup]
    supports: Sequence[Occluder]

    def asks(self, samples: SurfaceSamples) -> Bools:
        """(S,) samples that no view measures and that are free here."""
        return ~measured_by(self.setups, samples) & ~touching(samples, self.supports)


def plan_open(session: Session[None], runs: Sequence[Run], scene: Scene) -> Path:
    """Plan a further set-up.

    Args:
        session: without a folder; without a scene file that of the first run is the origin.
        runs: finished plans of one part, the one first whose samples and candidates all have.
        scene: of the set-up; part and seed are those of the first run whatever it says.

    Returns:
        The run folder; its exit code is 3 where the plan stays below a coverage that was asked for.

    Raises:
        UsageError: if the runs do not belong together, or the set-up is one of theirs.
        UnreachableError: if nothing that is open can be measured in this set-up.
        FileError: if a run is damaged, or the folder cannot be written.
    """
    with session.stage("read the plans"):
        setups = [EarlierSetup.of(run) for run in runs]
        require_one_part(setups)
    first = runs[0]
    plan = scene.plan.model_copy(update={"seed": first.seed})
    scene = scene.model_copy(update={"part": scene_of_run(first).part, "plan": plan})
    origin = replace(session.origin, scene_path=session.origin.scene_path or first.folder / "scene.toml")
    session = replace(session, origin=origin)
    return pipeline.plan(session, scene, part=part_of(first), steps_of=partial(_steps, setups))


def _steps(setups: Sequence[EarlierSetup], session: PlanSession, job: Job) -> int:
    """Steps 2 to 9 on what is open; returns 0, or 3 where the plan stays below a coverage that was asked for."""
    surface = surface_of(setups[0].run, session, job)
    session.plots.part_ready(session.folder.path)
    cell = steps.compile_cell(session, job, surface)
    _require_another(setups, cell)
    session.plots.cell_ready(session.folder.path)
    left = _Open(setups, fixed_occluders(cell.world))
    with session.stage("what is open"):
        rows = left.asks(surface.samples)
        if not rows.any():
            raise UnreachableError(
                "nothing is left to plan: the views before measure every sample that is free of its support here; one "
                "set-up fewer will do, or turn the part"
            )
        surface = replace(surface, samples=pick_samples(surface.samples, rows))
    candidates, reached = _candidates(left, session, job, surface, cell)
    measured, prediction = steps.measure(session, job, surface, cell, candidates, reached)
    with session.stage("what is open of the held-out samples"):
        samples = prediction.samples
        before, touched = measured_by(setups, samples), touching(samples, left.supports)
        prediction = replace(prediction, required=~before & ~touched, is_required=left.asks)
    problem = steps.ask(session, job, cell, measured, prediction)
    problem, chosen = steps.connect(session, problem, surface, behind(session, job, cell, surface))
    found = _together(setups, before, touched, problem, chosen)
    pipeline.finish(session, job, surface.planning, problem, chosen, {"open_of": found})
    return 3 if _below(session.reporter, job, found) else 0


def _require_another(setups: Sequence[EarlierSetup], cell: Cell) -> None:
    """Refuse a set-up in which the part stands where it stood.

    Raises:
        UsageError: naming the run.
    """
    for setup in setups:
        if np.abs(setup.cell.scene.T_base_object - cell.world.T_base_object).max() <= _SAME:
            raise UsageError(
                f"the part lies as in {setup.run.folder}: the set-ups are equal and nothing more can be measured; give "
                "another --place x,y,z,A,B,C, or cell edit the run"
            )


def _candidates(
    left: _Open, session: PlanSession, job: Job, surface: PartSurface, cell: Cell
) -> tuple[Viewpoints, Reach]:
    """The first run's candidates, reached where the part lies now, and more for what is open.

    Raises:
        UnreachableError: if the arm reaches none.
    """
    with session.stage("reach and grow the candidates") as progress:
        scouts = draw_samples(surface.reference, surface.planning, growth.N_SCOUTS, session.rng(Stream.SCOUTS))
        scouts = pick_samples(scouts, left.asks(scouts))
        first = left.setups[0]
        shared, _ = scanners.viewpoints_of_columns(first.cell.scanner, first.run.candidates)
        candidates, reached = with_grown(job, surface, cell, shared, scouts, progress)
    plan_files.write_viewpoints(session.folder, scanners.sweep_columns(job.scanner, candidates))
    plan_files.write_reach(session.folder, reached)
    require_reachable(job.scene.plan, job.part, reached)
    return candidates, reached


def _together(
    setups: Sequence[EarlierSetup], before: Bools, touched: Bools, problem: Problem, chosen: ConnectedPlan
) -> OpenOf:
    """What all set-ups measure of the held-out samples.

    Args:
        setups: those before.
        before: (S,) what they measure.
        touched: (S,) what a support touches in this one.
        problem: this one's candidates.
        chosen: this one's views.
    """
    prediction = problem.prediction
    areas = prediction.samples.areas
    seen = np.asarray(chosen.visible.covered) & ~touched
    can = np.asarray(prediction.coverable.covered) & ~touched

    def share(which: Bools) -> float:
        return float(areas[which].sum() / areas.sum())

    return OpenOf(
        digests=tuple(setup.run.digest for setup in setups),
        before=share(before),
        together=share(before | seen),
        coverable=share(before | seen | can),
        in_contact=share(touched & ~before),
    )


def _below(reporter: ProgressReporter, job: Job, found: OpenOf) -> bool:
    """Whether a coverage that was asked for is missed; says which, and what would help."""
    plan = job.scene.plan
    plain = plan.max_views is None and plan.multiplicity == 1 and plan.pose_sd_mm == 0 == plan.pose_sd_deg
    missed = plain and plan.coverage < 1 and found.share < plan.coverage
    if missed:
        reporter.note(
            f"this set-up measures {100 * found.share:.2f} % of what was open and can be measured in it, less than the "
            f"{100 * plan.coverage:g} % asked for: what is left is shaded by the arm or falls between all samples"
        )
    if found.together < plan.required_visible:
        reporter.note(
            f"all set-ups measure {100 * found.together:.2f} % of the surface, less than the "
            f"{100 * plan.required_visible:g} % required; go on with another set-up of what these leave open"
        )
        return True
    return missed
