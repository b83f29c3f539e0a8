"""`cell setups`: which poses a part is measured in, and from which views in each, planned as one cover.

Every offered set-up is reached, grown and measured over one set of samples; the cover over all of them is connected in
every set-up that it uses, and chosen again without what cannot be connected. Each set-up is then a run folder of its
own below `setups/`.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cell.errors import SceneError, UnreachableError, UsageError
from cell.part.workpiece import Workpiece
from cell.plan import candidates, pipeline, steps
from cell.plan import files as plan_files
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import Problem
from cell.plan.steps import Job, PlanSession
from cell.runs.run import open_finished
from cell.runs.schema import (
    ChosenSetup,
    OfferedSetup,
    SetupsCoverage,
    SetupsFile,
    SetupsRegion,
    ViewsFirst,
)
from cell.scene.model import Scene, with_rest
from cell.session import Session, Stream
from cell.setups.left_open import left_open
from cell.setups.measured import Setup, compiled_world, measured_setup
from cell.setups.offered import Offer, given, proposed, with_table_kept
from cell.setups.options import SetupOptions
from cell.setups.report import page, status
from cell.setups.search import Search
from cell.setups.shared import apart, shared
from cell.setups.wishes import Asked, require_named
from cell.words import percent
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface, surface_samples
from cell.world.model import World
from planner.cover.grouped import GroupedCover
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.values import Bools
from planner.viewpoints import growth

PROPOSED = 24
"""Poses that are proposed where neither the scene nor the user says which."""

_SAME = 1e-5  # m, and entries of a rotation


def plan_setups(session: Session[None], scene: Scene, *, options: SetupOptions, part: Workpiece | None = None) -> Path:
    """Plan several set-ups.

    Args:
        session: without a folder; this function makes it.
        scene: the checked scene; its placement says where the part's centre and its lowest point are.
        options: how many set-ups, and which.
        part: in place of the scene's.

    Returns:
        The folder: setups.json, report.md, and a run folder for each set-up below setups/.

    Raises:
        UsageError: for a wish that a cover of several set-ups does not answer.
        UnreachableError: if no set-up that is offered measures anything.
    """
    options.check(scene)
    if options.offer == 0 and not scene.setup:
        raise UsageError("no set-up is offered: give [[setup]] tables in the scene, or let some be proposed")
    return pipeline.plan(session, scene, part=part, steps_of=partial(_steps, options), drawn=scene.plan.curve)


def _steps(options: SetupOptions, session: PlanSession, job: Job) -> int:
    """All of it, into the open folder; returns 0, or 3 where a coverage that was asked for is missed."""
    usual = 0 if job.scene.setup else PROPOSED
    surface, offers, tried = _offered(session, job, usual if options.offer is None else options.offer)
    setups = {row: found for row, found in enumerate(tried) if isinstance(found, Setup)}
    if not any(len(setup.measured.M.indices) for setup in setups.values()):
        told = next((found for found in tried if isinstance(found, str)), "no candidate measures anything")
        raise UnreachableError(f"none of the {len(offers)} set-ups offered can be planned ({told}); move the part")
    require_named(options, tried)
    with session.stage("select and connect"):
        asked = Asked.of(job.scene, options)
        search = Search(session, surface, setups, asked)
        found, connected = search.result()
        first = search.views_first(found)
        setups = dict(search.setups)
    visible = {row: setups[row].visible(plan.T_object_poses) for row, (_, plan) in connected.items()}
    seen = np.logical_or.reduce(list(visible.values()))
    for row, each in enumerate(offers):
        if each.given is not None and row not in connected:
            session.note(f"the set-up '{each.name}' is left out: {left_out(setups.get(row, tried[row]), seen)}")
    order = sorted(visible, key=lambda row: (-int(visible[row].sum()), row))
    for number, row in enumerate(order, start=1):
        setup, (problem, plan) = setups[row], connected[row]
        pipeline.plan(
            session.closed(session.folder.path / "setups" / str(number)), setup.job.scene, part=job.part,
            steps_of=partial(_write, surface, problem, plan),
        )  # fmt: skip
    used = [(row, visible[row]) for row in order]
    file = _file(session, job, asked, setups, found, offers, tried, used).model_copy(
        update={"views_first": None if first is None else ViewsFirst(setups=first[0], views=first[1])}
    )
    if job.scene.plan.curve:
        with session.stage("coverage over views"):
            file = file.model_copy(update={"curve": search.curve(connected)})
            for path in session.plots.finish():
                session.folder.adopt(path.name)
    session.folder.write_json("setups.json", file.as_json())
    session.folder.write_text("report.md", page(file))
    for number in apart(file.shared, range(1, len(order) + 1)):
        session.note(
            f"what set-up {number} measures together with others leaves its scans free to move against theirs, and no "
            "candidate helps: the reference alone will hold them together"
        )
    missed = asked.promises and file.coverage.visible_of_coverable < file.coverage.asked < 1
    if missed:
        session.note(
            f"the set-ups measure {100 * file.coverage.visible_of_coverable:.2f} % of what can be measured, less than "
            f"the {100 * file.coverage.asked:g} % asked for; allow more set-ups, or ask for less"
        )
    return 3 if missed or file.coverage.visible < job.scene.plan.required_visible else 0


def _offered(session: PlanSession, job: Job, most: int) -> tuple[PartSurface, list[Offer], list[Setup | str]]:
    """The rows that all set-ups share, what is offered, and each as it was measured, or why it cannot be."""
    with session.stage("decimate and sample"):
        reference = job.part.reference
        planning = decimate(reference, job.settings.faces)
        shared = candidates.first(job.scene, job.settings, job.part, planning)
        features = surface_samples(job.scene, reference, planning, session.rng(Stream.MATRIX_SAMPLES))
        surface = PartSurface(reference, planning, features, EmbreeRayCaster(reference.vertices, reference.faces))
        scouts = draw_samples(reference, planning, growth.N_SCOUTS, session.rng(Stream.SCOUTS))
        poses = given(job.scene)
        # Where none is proposed, the scene's own placement is none of those that are offered.
        placed = [job.scene] if most else [job.scene.model_copy(update={"placement": each.placement}) for each in poses]
        scene, world = _first_cell(job, placed, reference)
        job = replace(job, scene=with_table_kept(scene, world))
        offers = _distinct([*poses, *proposed(world, reference, most)])
        if job.scene.setup == () and len({offer.name.split(",")[0] for offer in offers}) == 1 < most:
            turned = ", turned," if len(offers) > 1 else ""
            session.note(f"the part has no other stable pose: it is offered as it is placed{turned} alone")
    tried = [measured_setup(session, job, surface, world, each, shared, scouts) for each in offers]
    return surface, offers, tried


def _first_cell(job: Job, scenes: Sequence[Scene], reference: TriangleMesh) -> tuple[Scene, World]:
    """The first of some scenes that can be compiled, and its cell.

    Raises:
        SceneError: if none can; of the last.
    """
    for scene in scenes[:-1]:
        with suppress(SceneError):  # its set-up will be left out, and said why
            return scene, compiled_world(job, scene, reference)
    return scenes[-1], compiled_world(job, scenes[-1], reference)


def left_out(found: Setup | str, seen: Bools) -> str:
    """Why a set-up is not used, of what (S,) held-out samples the others measure."""
    if isinstance(found, str):
        return found
    adds = float((found.coverable & ~seen).mean())
    if not adds:
        return "it adds nothing that the others do not measure"
    return f"what was asked for does not need it (it can add {percent(adds)} of the surface)"


def _distinct(offers: list[Offer]) -> list[Offer]:
    """The offers without those in which the part lies as in an earlier one, among the same fixtures."""
    kept: list[Offer] = []
    for offer in offers:
        alike = (
            np.abs(offer.placement.T - other.placement.T).max() < _SAME and not (other.given and other.given.fixtures)
            for other in kept
        )
        if offer.given is not None or not any(alike):
            kept.append(offer)
    return kept


def _write(surface: PartSurface, problem: Problem, chosen: ConnectedPlan, session: PlanSession, job: Job) -> int:
    """The run folder of one set-up, of what is known already."""
    with session.stage("write the plan"):
        plan_files.write_meshes(session.folder, surface.reference, surface.planning)
        session.plots.part_ready(session.folder.path)
    steps.compile_cell(session, job, surface)
    plan_files.write_viewpoints(session.folder, problem.candidates)
    plan_files.write_reach(session.folder, problem.reached)
    plan_files.write_measurability(session.folder, problem.M)
    session.plots.cell_ready(session.folder.path)
    status = "one of several set-ups that one cover was planned for; how few views are needed stands there"
    told = {"status": status, "of_several": True}
    pipeline.finish(session, job, surface.planning, problem, chosen, told)
    return 0


def _file(
    session: PlanSession, job: Job, asked: Asked, setups: Mapping[int, Setup], found: GroupedCover, offers: list[Offer],
    tried: list[Setup | str], used: list[tuple[int, Bools]],
) -> SetupsFile:  # fmt: skip
    """What setups.json says."""
    chosen, seen = [], np.zeros_like(used[0][1])
    for number, (row, visible) in enumerate(used, start=1):
        plan = open_finished(session.folder.path / "setups" / str(number))
        adds = float((visible & ~seen).mean())
        seen = seen | visible
        chosen.append(
            ChosenSetup(
                folder=f"setups/{number}",
                digest=plan.digest,
                offered=row,
                views=len(plan.q),
                visible=float(visible.mean()),
                adds=adds,
            )
        )
    can = np.logical_or.reduce([setup.coverable for setup in setups.values()]) | seen
    coverage = SetupsCoverage(
        visible=float(seen.mean()), coverable=float(can.mean()), visible_of_coverable=float(seen.sum() / can.sum()),
        asked=job.scene.plan.coverage, required=job.scene.plan.required_visible,
    )  # fmt: skip
    return SetupsFile(
        part=job.part.name,
        seed=session.seed,
        coverage=coverage,
        status=status(found, len(offers), asked.request.asked),
        setups_bound=found.group_bound,
        views=sum(each.views for each in chosen),
        views_bound=found.view_bound,
        seconds=None if found.price is None else found.price[0],
        seconds_bound=None if found.price is None else found.price[1],
        kept=None if asked.once else found.share,
        regions=tuple(_regions(job, _samples(setups), seen, can)),
        chosen=tuple(chosen),
        offered=tuple(_told(offer, each) for offer, each in zip(offers, tried, strict=True)),
        shared=shared({number: visible for number, (_, visible) in enumerate(used, start=1)}, _samples(setups)),
        open=left_open(setups, [row for row, _ in used], seen, session.rng(Stream.ATTAINABLE_SAMPLES)),
    )


def _regions(job: Job, samples: SurfaceSamples, seen: Bools, can: Bools) -> Iterator[SetupsRegion]:
    """What all set-ups measure of each region that counts; nothing where the part has none."""
    for number, wishes in enumerate(with_rest(job.scene.region)):
        own = samples.region == number
        if wishes.cared and np.any(own):
            visible, coverable = float(seen[own].mean()), float(can[own].mean())
            yield SetupsRegion(
                name=wishes.name,
                asked=job.scene.plan.coverage if wishes.coverage is None else wishes.coverage,
                visible=visible,
                coverable=coverable,
                visible_of_coverable=visible / coverable if coverable else 1.0,
            )


def _samples(setups: Mapping[int, Setup]) -> SurfaceSamples:
    """The held-out samples, which all set-ups have."""
    return next(iter(setups.values())).prediction.samples


def _told(offer: Offer, found: Setup | str) -> OfferedSetup:
    possible = isinstance(found, Setup)
    return OfferedSetup(
        name=offer.name,
        placement_mm=offer.placement.position_mm,
        placement_abc_deg=offer.placement.abc_deg,
        reachable=int(found.measured.reached.reachable.sum()) if isinstance(found, Setup) else 0,
        coverable=float(found.coverable.mean()) if isinstance(found, Setup) else 0.0,
        in_contact=float(found.touched.mean()) if isinstance(found, Setup) else 0.0,
        left_out="" if possible else str(found),
    )
