"""Several set-ups of a part, planned as one cover: fewest set-ups, then fewest views, each with a bound.

Every set-up candidate is reached, grown and measured over one set of samples (`cell.plan.setup_candidates`). One cover
is searched over all of them (`cell.plan.setup_search`). Each set-up becomes a run folder below `setups/`. A finished
plan can be a fixed first set-up: its views stay as they are, and only the other set-ups are planned.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cell.errors import UnreachableError, UsageError
from cell.formatting import percent
from cell.part.workpiece import Workpiece
from cell.plan import files, pipeline
from cell.plan.candidates import PlanSession
from cell.plan.evaluation import Verdict, estimated_share, judge, no_samples
from cell.plan.setup_candidates import FixedSetup, PlannedSetup, Setup, SetupCandidate, try_candidates, with_table_at
from cell.plan.setup_options import SetupOptions, format_candidate
from cell.plan.setup_search import ConnectedSetup, SetupSearch, SetupsRequest
from cell.plan.shared_surface import shared_surfaces, unconnected_setups
from cell.report.setups_report import page, status
from cell.runs.cell import scene_of_run
from cell.runs.run import Run, open_finished
from cell.runs.schema import (
    CandidateSetup,
    SelectedSetup,
    SetupsCoverage,
    SetupsFile,
    SetupsRegion,
    UncoveredShares,
    ViewsFirst,
)
from cell.scene.file import load_scene, option_names, option_tables
from cell.scene.model import Scene, with_rest
from cell.scene.options import Spell
from cell.scene.settle import SettledScene
from cell.session import Session, Stream
from cell.world.measurability import PartSurface
from planner.cover.grouped import GroupedCover
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.lines_of_sight import RayTargets


def plan_setups(session: Session[None], scene: Scene, *, options: SetupOptions, part: Workpiece | None = None) -> Path:
    """Plan several set-ups.

    Args:
        session: of the command.
        scene: checked; its placement gives the position of the part's centre and the height of its lowest point.
        options: number and choice of the set-ups.
        part: in place of the scene's part.

    Returns:
        The folder: setups.json, report.md, and a run folder for each set-up below setups/.

    Raises:
        UsageError: if an option cannot be combined with several set-ups.
        UnreachableError: if no set-up candidate measures anything.
    """
    options.check(scene)
    first = None if options.first is None else open_finished(Path(options.first))
    if first is not None and part is None and scene.part == scene_of_run(first).part:
        part = Workpiece(first.scene.part.name, first.reference, first.scene.part.sha256)
    if options.proposals == 0 and not scene.setup:
        raise UsageError("there is no set-up candidate: give [[setup]] tables in the scene, or a larger --proposals")
    with pipeline.open_run(session, scene, part, with_plots=scene.plan.curve) as run:
        run.conclude(_plan_setups(session, run.session, run.settled, options, first))
    return run.path


def scene_after(first: Run, options: Mapping[str, object], spell: Spell = str) -> Scene:
    """Return the scene of a plan, which is the first set-up, with options of the set-ups before it.

    Raises:
        UsageError: if an option describes another cell, part or scanner; a scene file does that.
        SceneError: if the scene is not possible.
    """
    tables = option_tables(options, spell=spell)
    names = option_names(tables, spell)
    for key in names:
        if not key.startswith(("plan.", "placement.")):
            raise UsageError(f"{names[key]} changes the cell of {first.folder}; give part and options, or a scene file")
    scene, overrides = scene_of_run(first), load_scene(None, tables, names)
    plan = {"pinned": (), "banned": ()} | {key: getattr(overrides.plan, key) for key in tables.get("plan", {})}
    if "coverage" in plan:
        plan["max_views"] = None
    placement = overrides.placement if "placement" in tables else scene.placement
    scene = scene.model_copy(update={"plan": scene.plan.model_copy(update=plan), "placement": placement})
    return scene if first.scene.table is None else with_table_at(scene, first.scene.table.T_base_table)


def _plan_setups(
    outer: Session[None], session: PlanSession, settled: SettledScene, options: SetupOptions, first: Run | None
) -> Verdict:
    """Plan all set-ups into the open folder."""
    surface, candidates, outcomes = try_candidates(session, settled, options.proposals, first)
    setups = {row: outcome for row, outcome in enumerate(outcomes) if isinstance(outcome, Setup)}
    if not any(len(setup.measured.M.indices) for setup in setups.values()):
        reason = next((outcome for outcome in outcomes if isinstance(outcome, str)), "no candidate measures anything")
        raise UnreachableError(
            f"none of the {len(candidates)} set-up candidates can be planned ({reason}); move the part"
        )
    _require_candidates(options, outcomes)
    with session.stage("select and connect"):
        request = SetupsRequest.of(session, settled.scene, options)
        search = SetupSearch(session, surface, setups, request)
        cover, connected = search.solve()
        alternative = search.fewest_views(cover)
        setups = search.setups
    visible = {row: setups[row].visible(setup.T_object_poses) for row, setup in connected.items()}
    seen = np.logical_or.reduce(list(visible.values()))
    for row, each in enumerate(candidates):
        if each.table is not None and row not in connected:
            session.note(
                f"the set-up '{each.name}' is omitted: {cause_of_omission(setups.get(row, outcomes[row]), seen)}"
            )
    order = sorted(visible, key=lambda row: (candidates[row].run is None, -int(visible[row].sum()), row))
    for number, row in enumerate(order, start=1):
        _write_setup(outer, surface, setups[row], connected[row], session.folder.path / "setups" / str(number))
    used = [(row, visible[row]) for row in order]
    file = _setups_file(session, settled, request, setups, cover, candidates, outcomes, used)
    views_first = None if alternative is None else ViewsFirst(setups=alternative[0], views=alternative[1])
    file = file.model_copy(update={"alternative": views_first})
    if settled.scene.plan.curve:
        with session.stage("coverage over views"):
            file = file.model_copy(update={"curve": search.curve(connected)})
            files.adopt_plots(session)
    session.folder.write_json("setups.json", file.as_json())
    section = _predicted_section(session, settled, surface, setups, {row: connected[row] for row in order})
    session.folder.write_text("report.md", "\n".join([page(file), *section]))
    for number in unconnected_setups(file.common_surface, range(1, len(order) + 1)):
        session.note(
            f"the surface that set-up {number} shares with others does not determine the relative pose of its "
            "scans, and no candidate improves this; only the reference can align them"
        )
    reached = file.coverage
    return judge(
        "the set-ups measure",
        (reached.visible_of_coverable, reached.target) if request.is_evaluated else None,
        (reached.visible, settled.scene.plan.required_visible),
        ("allow more set-ups, or request less", "allow more set-ups, or require less"),
        _regions_without_samples(settled, surface.reference, next(iter(setups.values())).measured.prediction.samples),
    )


def _predicted_section(
    session: PlanSession, settled: SettledScene, surface: PartSurface, setups: Mapping[int, Setup],
    connected: Mapping[int, ConnectedSetup],
) -> list[str]:  # fmt: skip
    """Predict the uncertainty of the characteristics by all set-ups, note unmet demands; return the section."""
    if not settled.scene.has_features:
        return []
    from cell.plan import inspection

    known = {row: setups[row].measured.prediction for row in connected}
    views = [
        inspection.PlannedViews(connected[row].T_object_poses, each.scanner, each.casters)
        for row, each in known.items()
    ]
    with session.stage("predict the uncertainty"):
        return inspection.setups_section(session, settled, surface.reference, views)


def _regions_without_samples(settled: SettledScene, reference: TriangleMesh, samples: SurfaceSamples) -> list[str]:
    """Return a sentence for each region with an area in which no held-out sample lies."""
    sentences = []
    for number, region in enumerate(with_rest(settled.scene.region)):
        area_mm2 = 1e6 * float(reference.areas[reference.region == number].sum())
        if region.is_measured and area_mm2 and not np.any(samples.region == number):
            sentences.append(f"the region '{region.name}' cannot be measured: {no_samples(area_mm2, len(samples))}")
    return sentences


def _require_candidates(options: SetupOptions, outcomes: Sequence[Setup | str]) -> None:
    """Refuse pinned and banned candidates that do not exist, and pinned ones that are not reachable."""
    for setup, number in (*options.pins, *options.bans):
        name, outcome = format_candidate((setup, number)), outcomes[setup] if setup < len(outcomes) else ""
        if setup >= len(outcomes):
            raise UsageError(f"candidate {name}: there are {len(outcomes)} set-up candidates, 0 to {len(outcomes) - 1}")
        if not isinstance(outcome, Setup):
            raise UsageError(f"candidate {name}: set-up {setup} is not possible ({outcome}); name another")
        if number >= len(reachable := outcome.measured.reached.reachable):
            raise UsageError(f"candidate {name}: set-up {setup} has candidates 0 to {len(reachable) - 1}")
        if (setup, number) in options.pins and not reachable[number]:
            raise UsageError(f"candidate {name} is pinned, and the arm does not reach it; pin another")


def cause_of_omission(outcome: Setup | str, seen: Bools) -> str:
    """Explain why a set-up is not used, given the (S,) held-out samples that the others measure."""
    if isinstance(outcome, str):
        return outcome
    more = float((outcome.coverable & ~seen).mean())
    if not more:
        return "it measures nothing that the others do not measure"
    return f"the request is met without it (it can add {percent(more)} of the surface)"


def _write_setup(
    outer: Session[None], surface: PartSurface, setup: Setup, connected: ConnectedSetup, folder: Path
) -> None:
    """Write the run folder of one set-up; copy that of a fixed one with its executions."""
    if isinstance(setup, FixedSetup):
        shutil.copytree(setup.run.folder, folder)
        return
    assert isinstance(setup, PlannedSetup)
    assert connected.planned is not None
    problem, plan = connected.planned
    inner = replace(outer, out=folder)
    with pipeline.open_run(inner, setup.settled.scene, setup.settled.part) as run:
        with run.session.stage("write the plan"):
            files.write_meshes(run.session.folder, surface.reference, surface.planning)
            pipeline.write_features(run.session.folder, run.settled)
            run.session.plots.part_ready(run.path)
        pipeline.compile_cell(run.session, run.settled, surface)
        files.write_measured(run.session.folder, problem)
        annotations = {
            "status": "one of several set-ups planned as one cover; setups.json has the bound on the number of views",
            "common_cover": True,
        }
        pipeline.finish(run.session, run.settled, surface.planning, problem, plan, annotations)


def _setups_file(
    session: PlanSession, settled: SettledScene, request: SetupsRequest, setups: Mapping[int, Setup],
    cover: GroupedCover, candidates: Sequence[SetupCandidate], outcomes: Sequence[Setup | str],
    used: Sequence[tuple[int, Bools]],
) -> SetupsFile:  # fmt: skip
    selected_setups, seen = [], np.zeros_like(used[0][1])
    for number, (row, visible) in enumerate(used, start=1):
        run = open_finished(session.folder.path / "setups" / str(number))
        marginal = float((visible & ~seen).mean())
        seen = seen | visible
        selected_setups.append(
            SelectedSetup(
                folder=f"setups/{number}",
                digest=run.digest,
                candidate=row,
                views=len(run.q),
                visible=float(visible.mean()),
                marginal_coverage=marginal,
            )
        )
    coverable = np.logical_or.reduce([setup.coverable for setup in setups.values()]) | seen
    samples = next(iter(setups.values())).measured.prediction.samples
    return SetupsFile(
        part=settled.part.name,
        seed=session.seed,
        coverage=SetupsCoverage(
            visible=float(seen.mean()),
            coverable=float(coverable.mean()),
            visible_of_coverable=float(seen.sum() / coverable.sum()),
            target=settled.scene.plan.coverage,
            required=settled.scene.plan.required_visible,
        ),
        status=status(cover, len(candidates), request.request.targets),
        setups_bound=cover.group_bound,
        views=sum(each.views for each in selected_setups),
        views_bound=cover.view_bound,
        seconds=None if cover.cost_and_bound is None else cover.cost_and_bound[0],
        seconds_bound=None if cover.cost_and_bound is None else cover.cost_and_bound[1],
        satisfied_share=None if request.needs_one_view else cover.share,
        regions=tuple(_regions(settled.scene, samples, seen, coverable)),
        selected=tuple(selected_setups),
        candidates=tuple(_candidate_setup(*each) for each in zip(candidates, outcomes, strict=True)),
        common_surface=shared_surfaces({number: visible for number, (_, visible) in enumerate(used, start=1)}, samples),
        uncovered=uncovered_surface(session, setups, [row for row, _ in used], seen),
    )


def _regions(scene: Scene, samples: SurfaceSamples, seen: Bools, coverable: Bools) -> Iterator[SetupsRegion]:
    """Yield the coverage of each region that counts."""
    for number, region in enumerate(with_rest(scene.region)):
        is_inside = samples.region == number
        if region.is_measured and np.any(is_inside):
            visible, share = float(seen[is_inside].mean()), float(coverable[is_inside].mean())
            yield SetupsRegion(
                name=region.name,
                target=scene.plan.coverage if region.coverage is None else region.coverage,
                visible=visible,
                coverable=share,
                visible_of_coverable=visible / share if share else 1.0,
            )


def _candidate_setup(candidate: SetupCandidate, outcome: Setup | str) -> CandidateSetup:
    is_possible = isinstance(outcome, Setup)
    return CandidateSetup(
        name=candidate.name,
        placement_mm=candidate.placement.position_mm,
        placement_abc_deg=candidate.placement.abc_deg,
        reachable=int(outcome.measured.reached.reachable.sum()) if isinstance(outcome, Setup) else 0,
        coverable=float(outcome.coverable.mean()) if isinstance(outcome, Setup) else 0.0,
        in_contact=float(outcome.contact.mean()) if isinstance(outcome, Setup) else 0.0,
        cause="" if is_possible else str(outcome),
    )


def uncovered_surface(
    session: PlanSession, setups: Mapping[int, Setup], used: Sequence[int], seen: Bools
) -> UncoveredShares:
    """Return the uncovered held-out samples by cause, the first that applies.

    For samples that no candidate measures, a measuring pose is searched in the used set-ups that can be planned.

    Args:
        session: seed and effort.
        setups: possible set-ups.
        used: rows of the used ones.
        seen: (S,) held-out samples that a view measures.
    """
    samples = setups[used[0]].measured.prediction.samples
    has_candidate = ~seen & np.logical_or.reduce([setup.coverable for setup in setups.values()])
    contact = ~seen & ~has_candidate & np.logical_and.reduce([setups[row].contact for row in used])
    uncovered_rows = np.flatnonzero(~seen & ~has_candidate & ~contact)
    rng = session.rng(Stream.ATTAINABLE_SAMPLES)
    rows = np.sort(rng.permutation(uncovered_rows)[: session.effort.searched_samples])
    measured, visible = np.zeros(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
    for row in used:
        if not isinstance(setup := setups[row], PlannedSetup):
            continue
        free = np.flatnonzero(~setup.contact[rows] & ~measured)
        searched = samples.pick(rows[free])
        targets = RayTargets.of(searched.points, searched.normals, searched.region)
        probe = probe_attainable(targets, setup.evaluator(searched))
        measured[free] |= probe.measured
        visible[free] |= probe.visible
    left = len(uncovered_rows) / len(samples)  # samples stand for equal areas
    out_of_reach, other_poses, out_of_sight = (
        estimated_share(hits, len(uncovered_rows)) for hits in (visible & ~measured, measured, ~visible)
    )
    return UncoveredShares(
        not_selected=float(has_candidate.mean()),
        in_contact=float(contact.mean()),
        out_of_reach=left * out_of_reach.value,
        other_poses=left * other_poses.value,
        out_of_sight=left * out_of_sight.value,
        standard_error=left * max(out_of_reach.standard_error, other_poses.standard_error, out_of_sight.standard_error),
    )
