"""Explain the uncovered surface of a plan: causes, and the smallest single changes that would measure it (`cell why`).

`analyse` is the whole method: each held-out sample that the views do not measure gets a cause (`planner.why.why`);
samples with one cause form a group, connected ones a patch; changes are tried on representatives (`cell.why.changes`);
recommended changes are evaluated on every sample concerned, so no printed share is an estimate. The plan is not
changed; files are written to `why/` in the run folder. Object frame, metres.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError
from cell.files import atomic_folder, file_errors
from cell.runs import ply
from cell.runs.cell import collision_note, read_cell, world_of
from cell.runs.folder import SCHEMA, json_text
from cell.runs.run import Run, open_finished, reading
from cell.runs.schema import (
    EstimatedChange,
    PlanFile,
    PlanView,
    RecommendedChange,
    ScannerKeys,
    UncoveredPatch,
    UncoveredSamples,
    WhyReport,
)
from cell.scene.model import RegionTargets
from cell.session import ProgressReporter, default_effort
from cell.view import pictures, run_pages
from cell.view.palette import MEASURED, REASONS, rgb
from cell.view.run_pages import measured_by_views
from cell.view.surface import Canvas, MeasuredSamples, canvas_of
from cell.why.changes import Changes, ladder_masks
from cell.world.embree import EmbreeRayCaster
from cell.world.prediction import held_out_samples
from cell.world.support_contact import in_contact
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.ports import Progress
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints
from planner.why import what_if, why
from planner.why.what_if import ChangeKind, PlanChange
from planner.why.why import REASON_OF_VERDICT, Diagnosis, Reason


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedChange:
    """A change, and the (S,) samples that it makes measurable among those on which it was evaluated."""

    change: PlanChange
    gained: Bools


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Connected samples of one group, and a change for them; None if none helps or the patch is small."""

    rows: Ints
    change: EvaluatedChange | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Samples with one cause.

    Attributes:
        reason: condition that the closest candidate violates.
        what: occluder or collision object; "" if the cause has none.
        rows: samples.
        patches: the same samples, connected over planning faces, largest first.
        detail: further facts about the closest candidates ("76 to 84 deg from the normal, limit 75").
        changes: recommended changes, best first, evaluated on all rows.
    """

    reason: Reason
    what: str
    rows: Ints
    patches: tuple[Patch, ...]
    detail: str
    changes: tuple[EvaluatedChange, ...] = ()

    @property
    def title(self) -> str:
        """The cause with its object: "sensor occluded by part", "view in collision: housing with post"."""
        if not self.what:
            return self.reason.sentence
        joint = " by " if self.reason <= Reason.SENSOR_SHADED else ": "
        return f"{self.reason.sentence}{joint}{self.what}"


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """The result of `cell why`.

    Attributes:
        canvas: the reference, prepared for colouring.
        surface: its held-out samples with the views that measure them.
        open_rows: (n,) uncovered samples.
        groups: groups by cause, largest area first.
        rest: uncovered samples that no reachable candidate measures.
        overall: changes with the largest gains on `rest`, evaluated on all of it.
        trials: (change, estimated share of the area of `rest`) of every tried change.
        part_name: for titles.
    """

    canvas: Canvas
    surface: MeasuredSamples
    open_rows: Ints
    groups: tuple[Group, ...]
    rest: Ints
    overall: tuple[EvaluatedChange, ...]
    trials: tuple[tuple[PlanChange, float], ...]
    part_name: str

    @property
    def samples(self) -> SurfaceSamples:
        """Held-out samples of the reference."""
        return self.surface.samples

    @property
    def covered(self) -> Bools:
        """(S,) samples measured by the plan."""
        return np.asarray(self.surface.seen.any(axis=1))

    def share(self, rows: Ints) -> float:
        """Return the area of some samples as a fraction of the total."""
        return float(self.samples.areas[rows].sum() / self.samples.areas.sum())


def group_samples(
    samples: SurfaceSamples, rows: Ints, diagnosis: Diagnosis, what: Sequence[str], planning: TriangleMesh,
    keys: ScannerKeys, regions: Sequence[RegionTargets],
) -> list[Group]:  # fmt: skip
    """Group uncovered samples by cause, largest group first.

    Args:
        samples: held-out samples.
        rows: (n,) uncovered samples.
        diagnosis: causes of these samples.
        what: occluder or collision object of each, or "".
        planning: mesh over whose faces patches are connected.
        keys: keys of the scanner, for its limits.
        regions: regions of the part by number.
    """
    members: dict[tuple[int, str], list[int]] = {}
    for i, key in enumerate(zip(diagnosis.reason.tolist(), what, strict=True)):
        members.setdefault(key, []).append(i)
    grouped = []
    for (reason, thing), positions in members.items():
        inside = rows[np.array(positions)]
        pieces = _patches(inside, samples, planning)
        details = (
            _detail(Reason(reason), diagnosis, np.isin(rows, inside), keys),
            _region_shares(samples, inside, regions),
        )
        detail = "; ".join(text for text in details if text)
        grouped.append(Group(Reason(reason), thing, inside, tuple(Patch(piece) for piece in pieces), detail))
    return sorted(grouped, key=lambda group: (-float(samples.areas[group.rows].sum()), group.reason, group.what))


def _patches(rows: Ints, samples: SurfaceSamples, planning: TriangleMesh) -> list[Ints]:
    """Return the samples in patches connected over edges of planning faces, largest first."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    face, of_row = np.unique(samples.planning_face[rows], return_inverse=True)
    corners = planning.faces[face].ravel(), np.arange(0, 3 * len(face) + 1, 3)
    touches = csr_array((np.ones(3 * len(face)), *corners), shape=(len(face), len(planning.vertices)))
    edges = (touches @ touches.T > 1).astype(np.int8)  # faces with two common corners
    label = connected_components(edges, directed=False)[1][of_row]
    pieces = [rows[label == one] for one in np.unique(label)]
    return sorted(pieces, key=lambda piece: (-float(samples.areas[piece].sum()), int(piece[0])))


def _region_shares(samples: SurfaceSamples, rows: Ints, regions: Sequence[RegionTargets]) -> str:
    """Return the regions of uncovered samples in words, largest share first; "" without regions."""
    if samples.region is None:
        return ""
    share = np.bincount(samples.region[rows], samples.areas[rows], len(regions)) / samples.areas[rows].sum()
    order = [k for k in np.argsort(-share, kind="stable").tolist() if share[k] > 0]
    if len(order) == 1:
        return f"in {regions[order[0]].name}"
    return "in " + ", ".join(f"{regions[k].name} ({100 * share[k]:.0f} %)" for k in order)


_ANGLES: dict[Reason, tuple[Callable[[Diagnosis], Floats], str]] = {
    Reason.GRAZING_SOURCE: (lambda diagnosis: diagnosis.grazing_source, "grazing_max_deg"),
    Reason.GRAZING_SENSOR: (lambda diagnosis: diagnosis.grazing_sensor, "sensor_grazing_max_deg"),
}


def _detail(reason: Reason, diagnosis: Diagnosis, inside: Bools, keys: ScannerKeys) -> str:
    """Return further facts about the closest candidates of some uncovered samples."""
    if reason is Reason.NOT_SELECTED:
        return "not needed for the target"
    if reason in _ANGLES:
        angles, limit = _ANGLES[reason]
        low, high = np.degrees(np.quantile(angles(diagnosis)[inside], (0.1, 0.9)))
        suffix = f", limit {highest:g}" if (highest := keys.number(limit)) is not None else ""
        return f"{low:.0f} to {high:.0f} deg from the normal{suffix}"
    if reason is Reason.OUT_OF_RANGE:
        low, high = 1000 * np.quantile(diagnosis.distance[inside], (0.1, 0.9))
        suffix = f", range {ends[0]:g} to {ends[1]:g}" if (ends := keys.pair("range_mm")) is not None else ""
        return f"{low:.0f} to {high:.0f} mm away{suffix}"
    if reason is Reason.TOO_SPARSE:
        far, steep = diagnosis.distance[inside], diagnosis.grazing_source[inside]
        limit_mm = keys.number("max_spacing_mm")
        limit = "the limit of the region" if limit_mm is None else f"limit {limit_mm:g} mm between points"
        return (
            f"{1000 * np.median(far):.0f} mm away at {np.degrees(np.median(steep)):.0f} deg from the normal (medians), "
            f"{limit}"
        )
    return ""


_REPRESENTATIVES = 700
_MIN_REPRESENTATIVES = 8  # per group
_VIEWS_FROM = 160  # samples for the selection of further views
_AIMS = 64  # targets of new candidates
_PATCHES = 24  # patches with their own change
_N_CHANGES = 3  # recommended changes per group


class Findings(NamedTuple):
    """Result of the search for changes.

    Attributes:
        groups: the groups with recommended changes, also for their patches.
        rest: samples that no reachable candidate measures.
        overall: changes with the largest gains on `rest`.
        trials: (change, estimated share of the area of `rest`) of every tried change.
    """

    groups: tuple[Group, ...]
    rest: Ints
    overall: tuple[EvaluatedChange, ...]
    trials: tuple[tuple[PlanChange, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """All changes with the representatives that they measure: gains (W, r) bool, place (S,) column or -1."""

    changes: tuple[PlanChange, ...]
    gains: NDArray[np.bool_]
    place: Ints

    def best(self, rows: Ints, reason: Reason, most: int) -> list[int]:
        """Return the best changes for some samples. Only unselected samples need a further view."""
        columns = self.place[rows]
        columns = columns[columns >= 0]
        if not len(columns):
            return []
        apt = [(change.kind is ChangeKind.VIEW) == (reason is Reason.NOT_SELECTED) for change in self.changes]
        return self.choose(self.gains[:, columns].mean(axis=1) * apt, most)

    def choose(self, share: Floats, most: int) -> list[int]:
        kinds, sizes = [change.kind for change in self.changes], [change.change for change in self.changes]
        return what_if.select_changes(share, kinds, sizes, most=most)


def search_changes(
    changes: Changes, targets: RayTargets, samples: SurfaceSamples, groups: Sequence[Group], progress: Progress
) -> Findings:
    """Try every change, and evaluate the best ones on all samples concerned."""
    if not groups:
        return Findings((), np.empty(0, dtype=np.int64), (), ())
    trial = _try(changes, targets, samples, groups, progress)
    # Samples that a reachable candidate measures are no gain of other changes.
    closed = [group for group in groups if group.reason is not Reason.NOT_SELECTED]
    rest = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *(group.rows for group in closed)]))
    in_rest = trial.gains.astype(np.float64) @ _weights(trial.place, closed, samples)
    overall = trial.choose(in_rest, _N_CHANGES)
    largest = sorted((patch.rows for group in groups for patch in group.patches), key=lambda rows: -len(rows))
    with_change = {int(rows[0]) for rows in largest[:_PATCHES]}
    of_group = [trial.best(group.rows, group.reason, _N_CHANGES) for group in groups]
    of_patch = [
        [
            trial.best(patch.rows, group.reason, 1) if int(patch.rows[0]) in with_change else []
            for patch in group.patches
        ]
        for group in groups
    ]
    verify = [(index, rest) for index in overall]
    for group, indices, patches in zip(groups, of_group, of_patch, strict=True):
        verify += [(index, group.rows) for index in indices]
        verify += [
            (index, patch.rows) for indices, patch in zip(patches, group.patches, strict=True) for index in indices
        ]
    verified = _verify(trial, verify, targets, progress)

    def helping(indices: Sequence[int], rows: Ints) -> tuple[EvaluatedChange, ...]:
        return tuple(verified[index] for index in indices if verified[index].gained[rows].any())

    return Findings(
        tuple(
            replace(
                group,
                changes=helping(indices, group.rows),
                patches=tuple(
                    replace(patch, change=next(iter(helping(indices, patch.rows)), None))
                    for patch, indices in zip(group.patches, patches, strict=True)
                ),
            )
            for group, indices, patches in zip(groups, of_group, of_patch, strict=True)
        ),
        rest,
        tuple(verified[index] for index in overall),
        tuple(sorted(zip(trial.changes, in_rest.tolist(), strict=True), key=lambda item: -item[1])),
    )


def _try(
    changes: Changes, targets: RayTargets, samples: SurfaceSamples, groups: Sequence[Group], progress: Progress
) -> _Trial:
    rows = np.sort(np.concatenate([group.rows for group in groups]))
    counts = [max(_MIN_REPRESENTATIVES, round(_REPRESENTATIVES * len(group.rows) / len(rows))) for group in groups]
    spread = [_spread(group.rows, count) for group, count in zip(groups, counts, strict=True)]
    representatives = np.unique(np.concatenate(spread))
    aims = _spread(rows, _AIMS)
    trials: list[PlanChange] = []
    masks: list[NDArray[np.bool_]] = []
    for n_done, ladder in enumerate(changes.ladders((samples.points[aims], samples.normals[aims]))):
        masks.extend(ladder_masks(ladder, targets, representatives))
        trials.extend(ladder)
        progress(min(n_done + 1, 14), 20)
    for group in groups:
        if group.reason is Reason.NOT_SELECTED:
            views = changes.views(targets, _spread(group.rows, _VIEWS_FROM))
            masks.extend(view.measures(targets, representatives) for view in views)
            trials.extend(views)
    place = np.full(len(targets), -1, dtype=np.int64)
    place[representatives] = np.arange(len(representatives))
    return _Trial(tuple(trials), np.array(masks).reshape(len(trials), len(representatives)), place)


def _verify(
    trial: _Trial, requests: Sequence[tuple[int, Ints]], targets: RayTargets, progress: Progress
) -> dict[int, EvaluatedChange]:
    """Evaluate each change on every sample for which it is recommended."""
    rows_of: dict[int, list[Ints]] = {}
    for index, rows in requests:
        rows_of.setdefault(index, []).append(rows)
    verified: dict[int, EvaluatedChange] = {}
    for n_done, (index, pieces) in enumerate(sorted(rows_of.items())):
        every = np.unique(np.concatenate(pieces))
        gained = np.zeros(len(targets), dtype=np.bool_)
        gained[every] = trial.changes[index].measures(targets, every)
        verified[index] = EvaluatedChange(trial.changes[index], gained)
        progress(14 * len(rows_of) + 6 * (n_done + 1), 20 * len(rows_of))
    return verified


def _spread(rows: Ints, count: int) -> Ints:
    """Return at most `count` rows, evenly over their order along a space-filling curve."""
    return rows[np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64)]


def _weights(place: Ints, groups: Sequence[Group], samples: SurfaceSamples) -> Floats:
    """Return (r,) the share of the groups' area that each representative stands for; 0 in other groups."""
    weight = np.zeros(int(place.max()) + 1)
    total = sum(float(samples.areas[group.rows].sum()) for group in groups)
    for group in groups:
        columns = place[group.rows]
        columns = columns[columns >= 0]
        weight[columns] = float(samples.areas[group.rows].sum()) / total / len(columns)
    return weight


@dataclass(frozen=True, slots=True, eq=False)
class WhyOutcome:
    """The files of `cell why`.

    Attributes:
        folder: their folder.
        summary: why.json.
    """

    folder: Path
    summary: WhyReport


def explain(run_folder: Path, reporter: ProgressReporter, *, samples: int | None = None) -> WhyOutcome:
    """Explain the uncovered surface of a finished plan and write the files; `samples` None means the default number."""
    if samples is not None and samples < 1:
        raise UsageError(f"--samples {samples} is not possible; at least 1 sample is needed")
    run = open_finished(run_folder)
    analysis = analyse(run, reporter, default_effort().held_out_samples if samples is None else samples)
    with reporter.stage("write"):
        summary = why_report(analysis, run)
        folder = write_files(run, analysis, summary)
    return WhyOutcome(folder, summary)


def analyse(run: Run, reporter: ProgressReporter, count: int) -> Analysis:
    """Find causes and changes for the uncovered samples of a run."""
    with reporter.stage("read the run"):
        cell, plan = read_cell(run), run.plan
        candidates = _with_executed_poses(run.candidates, plan.views)
        fails, blockers = _failures(run, plan, len(candidates))
        world = world_of(run, cell.reference)
        for sentence in collision_note(cell.scene):
            reporter.note(sentence)
    with reporter.stage("uncovered surface"):
        samples = held_out_samples(cell.reference, cell.planning, run.seed, count)
        targets = RayTargets.of(samples.points, samples.normals, samples.region)
        views = candidates.T_object_scanner[[view.id for view in plan.views]]
        surface = measured_by_views(cell, samples, list(views))
        rows = np.flatnonzero(~surface.seen.any(axis=1))
    with reporter.stage("causes") as progress:
        diagnosis = why.diagnose(targets, rows, candidates, cell.scanner, cell.casters, fails, progress=progress)
        casters = {piece.name: EmbreeRayCaster(piece.vertices, piece.faces) for piece in cell.occluders}
        what = why.occluders_of(targets, rows, diagnosis, candidates, cell.scanner, casters)
        K = candidates.T_object_scanner.shape[1]
        of_robot = (diagnosis.reason >= Reason.OUT_OF_REACH) & (diagnosis.reason < Reason.NOT_SELECTED)
        for i in np.flatnonzero(of_robot):
            what[i] = blockers[diagnosis.pose[i] // K]
        reason, uncovered = diagnosis.reason.copy(), samples.pick(rows)
        for piece in cell.occluders:  # a candidate inside a support sees the surface that it touches
            for i in np.flatnonzero(of_robot & in_contact(uncovered, [piece])):
                reason[i], what[i] = Reason.SOURCE_SHADED, piece.name
        diagnosis = replace(diagnosis, reason=reason)
    with reporter.stage("changes") as progress:
        changes = Changes(
            world, lambda name: world_of(run, cell.reference, without=(name,)), cell, candidates,
            np.flatnonzero(fails == Reason.NOT_SELECTED),
        )  # fmt: skip
        groups = group_samples(
            samples, rows, diagnosis, what, cell.planning, cell.scanner_keys, cell.scene.regions or ()
        )
        findings = search_changes(changes, targets, samples, groups, progress)
    return Analysis(canvas_of(cell.reference, samples), surface, rows, *findings, cell.scene.part.name)


def _with_executed_poses(candidates: Viewpoints, views: Sequence[PlanView]) -> Viewpoints:
    """Return the candidates, with the poses of the rounded set-points for the views of the plan, as in coverage."""
    T = np.array(candidates.T_object_scanner)
    if T.shape[1] == 1:
        for view in views:
            T[view.id, 0] = view.T_object_scanner
    return Viewpoints(T, candidates.face, candidates.standoff, candidates.roll)


def _failures(run: Run, plan: PlanFile, count: int) -> tuple[NDArray[np.uint8], list[str]]:
    """Return the cause for which each candidate fails on any point, and the object in its way."""
    reached = run.reach
    fails, blockers = REASON_OF_VERDICT[reached.verdict], list(reached.blocker)
    with reading(run.folder / "plan.json"):
        if len(fails) != count:
            raise ValueError(f"reach.npz has {len(fails)} verdicts and viewpoints.npz {count} candidates")
        for view in plan.exclusions:
            fails[view.id], blockers[view.id] = Reason.NO_PATH, view.cause
    return fails, blockers


FOLDER = "why"
NO_CHANGE = "no tried change helps"
_CHANGES = 2  # changes per row of the table
_ROWS = 12  # rows of the table; the rest is one line


def why_report(analysis: Analysis, run: Run) -> WhyReport:
    """Return the content of why.json."""
    return WhyReport(
        part=analysis.part_name,
        plan=run.plan_sha256,
        samples=len(analysis.samples),
        area_mm2=round(float(analysis.samples.areas.sum()) * 1e6, 3),
        visible=analysis.share(np.flatnonzero(analysis.covered)),
        uncovered=analysis.share(analysis.open_rows),
        groups=tuple(_group_table(analysis, code, group) for code, group in enumerate(analysis.groups, 1)),
        uncoverable=analysis.share(analysis.rest),
        best_changes=tuple(
            _named_change(analysis, recommendation, analysis.rest) for recommendation in analysis.overall
        ),
        all_changes=tuple(
            EstimatedChange(
                kind=change.kind.name.lower(),
                change=change.sentence,
                setting=change.setting,
                estimated_gain=round(share, 4),
            )
            for change, share in analysis.trials
        ),
    )


def write_files(run: Run, analysis: Analysis, report: WhyReport) -> Path:
    """Write the files and return their folder."""
    target = run.folder / FOLDER
    with file_errors(f"{target} cannot be written", "the run folder must be writable"), atomic_folder(target) as part:
        (part / "why.json").write_text(json_text({"schema": SCHEMA, **report.as_json()}), encoding="utf-8")
        (part / "why.ply").write_bytes(samples_ply(analysis))
        reasons = [(group.rows, group.title) for group in analysis.groups]
        title = f"Uncovered surface of {analysis.part_name}"
        pictures.draw_reasons(part / "why.png", analysis.canvas, reasons, title)
        (part / run_pages.PAGE_FILE).write_text(
            run_pages.why_page(run, analysis.canvas, analysis.surface, reasons), encoding="utf-8"
        )
    return target


TABLE_COLUMNS = ("cause", "share of the surface", "position (mm, part)", "change")


def table_rows(report: WhyReport) -> list[tuple[str, str, str, str]]:
    """Return the rows of the table: cause, share and area, position, change."""
    rows = []
    for group in report.groups[:_ROWS]:
        reason = group.title + (f"\n({group.detail})" if group.detail else "")
        x, y, z = (round(value) for value in group.patches[0].centre_mm)
        where = f"near ({x}, {y}, {z})" + (f"\n{group.n_patches} places" * (group.n_patches > 1))
        rows.append((reason, _area(group.share, group.area_mm2), where, _lines(group.changes[:_CHANGES])))
    small_groups = report.groups[_ROWS:]
    if small_groups:
        share, area = sum(group.share for group in small_groups), sum(group.area_mm2 for group in small_groups)
        rows.append((f"{len(small_groups)} smaller groups", _area(share, area), "", "see why.json"))
    if report.uncoverable and len(report.groups) > 1:
        area = report.uncoverable * report.area_mm2
        helps = _lines(report.best_changes)
        rows.append(("total without a reachable candidate", _area(report.uncoverable, area), "", helps))
    return rows


def _area(share: float, area_mm2: float) -> str:
    return f"{100 * share:.2f} %\n{area_mm2:,.0f} mm²"


def _lines(changes: Sequence[RecommendedChange]) -> str:
    """Return one line for each change."""
    lines = (f"{_percent(c.gain)}: {c.change}" + (f" ({c.setting})" if c.setting else "") for c in changes)
    return "\n".join(lines) or NO_CHANGE


def _percent(share: float) -> str:
    if share >= 1:
        return "all"
    if share >= 0.995:  # not rounded up to all
        return f"{np.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.1f} %"


def _group_table(analysis: Analysis, code: int, group: Group) -> UncoveredSamples:
    return UncoveredSamples(
        group=code,
        cause=group.reason.name.lower(),
        code=int(group.reason),
        object=group.what,
        title=group.title,
        detail=group.detail,
        share=analysis.share(group.rows),
        area_mm2=_area_mm2(analysis, group.rows),
        n_patches=len(group.patches),
        changes=tuple(_named_change(analysis, recommendation, group.rows) for recommendation in group.changes),
        patches=tuple(_patch(analysis, patch) for patch in group.patches[:20]),
    )


def _patch(analysis: Analysis, patch: Patch) -> UncoveredPatch:
    points = analysis.samples.points[patch.rows] * 1000
    nearest = np.linalg.norm(points - analysis.samples.points[patch.rows].mean(axis=0) * 1000, axis=1).argmin()
    return UncoveredPatch(
        area_mm2=_area_mm2(analysis, patch.rows),
        centre_mm=tuple(points[nearest].round(2).tolist()),
        change=None if patch.change is None else _named_change(analysis, patch.change, patch.rows),
    )


def _named_change(analysis: Analysis, recommendation: EvaluatedChange, rows: Ints) -> RecommendedChange:
    """Return a change with its exact gain on some rows."""
    areas = analysis.samples.areas[rows]
    return RecommendedChange(
        kind=recommendation.change.kind.name.lower(),
        change=recommendation.change.sentence,
        setting=recommendation.change.setting,
        gain=float(areas[recommendation.gained[rows]].sum() / areas.sum()),
        gain_mm2=_area_mm2(analysis, rows[recommendation.gained[rows]]),
    )


def _area_mm2(analysis: Analysis, rows: Ints) -> float:
    return round(float(analysis.samples.areas[rows].sum()) * 1e6, 3)


def samples_ply(analysis: Analysis) -> bytes:
    """Return the held-out samples as a PLY: mm, object frame, coloured by group.

    Properties: `reason` (a `planner.why.why.Reason`, 0 measured), `group` (from 1, 0 measured), `gained` (1 if the
    first recommended change of its group measures the point).
    """
    n = len(analysis.samples)
    number = pictures.group_numbers(n, [group.rows for group in analysis.groups])
    colours = np.array([(255 * rgb(colour)).round() for colour in (MEASURED, *REASONS)], dtype=np.uint8)[number]
    reason, at, gained = np.zeros(n, np.uint8), np.zeros(n, "<u2"), np.zeros(n, np.uint8)
    for code, group in enumerate(analysis.groups, 1):
        at[group.rows], reason[group.rows] = code, group.reason
        if group.changes:
            gained[group.rows] = group.changes[0].gained[group.rows]
    more = {"red": colours[:, 0], "green": colours[:, 1], "blue": colours[:, 2]}
    more |= {"reason": reason, "group": at, "gained": gained}
    legend = [f"group {code}: {group.title}" for code, group in enumerate(analysis.groups, 1)]
    element = ply.point_rows(analysis.samples.points, more)
    return b"".join(ply.file_pieces(["object frame, millimetres", *legend], {"vertex": element}))
