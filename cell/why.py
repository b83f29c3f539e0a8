"""`cell why`: why parts of the surface stay open in a finished plan, and the smallest single change that measures them.

`answer_of` shows the whole on one screen: the held-out samples that the plan's views leave open get a reason each
(`planner.why`), samples of one reason make a group and connected ones a patch, changes are tried on representatives
(`cell.why_changes`), and those that are named are asked about every sample that they are named for. The plan is never
touched; files go to `why/` in the run folder. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell import run_reader, scan_scene, why_files
from cell.embree import EmbreeRayCaster
from cell.errors import FileError, UsageError
from cell.occluders import occluder_triangles
from cell.run_record import RunRecord, open_run, understood
from cell.run_world import world_of
from cell.why_changes import Changes, ladder_masks, one_caster
from planner import coverage, surface, what_if, why
from planner.legs import Indices, Targets
from planner.ports import Floats, Scanner
from planner.quality import Limited
from planner.surface import SurfaceSamples, TriangleMesh
from planner.viewpoints import Viewpoints
from planner.what_if import WhatIf
from planner.why import Diagnosis, Reason

if TYPE_CHECKING:
    from cell.narrator import Narrator, ProgressCallback

_HELD_OUT = 1  # the stream of randomness of the samples that the plan's coverage is predicted on (cell.pipeline)
_REPRESENTATIVES = 700
_FEWEST = 8  # representatives of a group
_AIMS = 64  # points at which new candidates are aimed
_PATCHES = 24  # patches that get a change of their own


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """A change, and what it measures.

    Attributes:
        change: the change.
        gained: (S,) bool samples that it measures of those it was verified on.
    """

    change: WhatIf
    gained: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Connected samples of one group.

    Attributes:
        rows: its samples.
        named: the change for it, or None; only the largest patches are asked.
    """

    rows: Indices
    named: Named | None


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Samples that stay open for one reason.

    Attributes:
        reason: at which the closest candidate fails.
        what: in the way, or in collision with what; "" where the reason has none.
        detail: a figure about the closest candidates ("81 deg at the median, limit 75").
        rows: samples.
        patches: largest first.
        named: changes that would measure it, the one to prefer first; verified on all rows.
    """

    reason: Reason
    what: str
    detail: str
    rows: Indices
    patches: tuple[Patch, ...]
    named: tuple[Named, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """All that `cell why` found.

    Attributes:
        samples: held-out samples of the reference.
        covered: (S,) what the plan measures.
        diagnosis: of the open samples.
        open_rows: (n,) the open samples.
        groups: largest area first.
        rest: the open samples that no reachable candidate measures.
        overall: changes that gain most of `rest`, verified on all of it.
        tried: (change, share of the area of `rest` that it gains, from representatives) of everything that was tried.
        planning: the planning mesh.
        part_name: for titles.
    """

    samples: SurfaceSamples
    covered: NDArray[np.bool_]
    diagnosis: Diagnosis
    open_rows: Indices
    groups: tuple[Group, ...]
    rest: Indices
    overall: tuple[Named, ...]
    tried: tuple[tuple[WhatIf, float], ...]
    planning: TriangleMesh
    part_name: str

    def share(self, rows: NDArray[Any]) -> float:
        """Area of some samples over the area of all."""
        return float(self.samples.areas[rows].sum() / self.samples.areas.sum())


@dataclass(frozen=True, slots=True, eq=False)
class WhyOutcome:
    """What `cell why` leaves.

    Attributes:
        folder: of its files.
        summary: content of why.json.
    """

    folder: Path
    summary: dict[str, Any]


def explain(run_folder: Path, narrator: Narrator, *, samples: int | None = None) -> WhyOutcome:
    """Say why a finished plan leaves parts of the surface open, and write the files.

    Args:
        run_folder: of a finished plan.
        narrator: is told what goes on.
        samples: how many held-out samples; None takes those of the definition.

    Raises:
        CellError: with one sentence and the exit code.
    """
    if samples is not None and samples < 1:
        raise UsageError(f"--samples {samples} is not possible; at least 1 sample is needed")
    run = open_run(run_folder)
    if not run.finished:
        raise FileError(f"{run_folder} has no finished plan: the run {run.ended}; plan again")
    answer = answer_of(run, narrator, coverage.SAMPLES if samples is None else samples)
    with narrator.stage("write"):
        summary = why_files.summary(answer, run)
        folder = why_files.write(run, answer, summary)
    return WhyOutcome(folder, summary)


def answer_of(run: RunRecord, narrator: Narrator, count: int) -> Answer:
    """The whole on one screen."""
    with narrator.stage("read the run"):
        resolved = run_reader.resolved_scene(run)
        scene = scan_scene.load(run)
        candidates = _as_executed(run)
        fails, blockers = _failing(run, len(candidates))
        world = world_of(run, resolved, scene.reference.vertices)
        pieces = occluder_triangles(world)
        scanner, max_sigma = _law(run, resolved, scene.scanner)
        part_caster, occluder_caster = scene.part_caster, one_caster(pieces)
    with narrator.stage("what stays open"):
        rng = np.random.default_rng([int(run.manifest["seed"]), _HELD_OUT])
        samples = surface.sample(scene.reference, scene.planning, count, rng)
        targets = Targets.of(samples.points, samples.normals)
        views = np.stack([view.T_object_scanner for view in run_reader.views(run)])[:, None]
        if candidates.T_object_scanner.shape[1] > 1:
            views = candidates.T_object_scanner[[view.id for view in run_reader.views(run)]]
        covered = coverage.visible(views, samples, scanner, (part_caster, occluder_caster)).covered
        rows = np.flatnonzero(~covered)
    with narrator.stage("reasons") as progress:
        diagnosis = why.diagnose(
            targets, rows, candidates, scanner, part_caster, occluder_caster, fails, progress=progress
        )
        casters = {piece.name: EmbreeRayCaster(piece.vertices, piece.faces) for piece in pieces}
        what = why.names_in_the_way(targets, rows, diagnosis, candidates, scanner, casters)
        K = candidates.T_object_scanner.shape[1]
        of_robot = (diagnosis.reason >= Reason.OUT_OF_REACH) & (diagnosis.reason < Reason.NOT_SELECTED)
        for i in np.flatnonzero(of_robot):
            what[i] = blockers[diagnosis.pose[i] // K]
    with narrator.stage("changes") as progress:
        removable = tuple(f["name"] for f in resolved["fixtures"] if not f["built_in"] or f["name"] == "post")
        changes = Changes(
            world, lambda name: world_of(run, resolved, scene.reference.vertices, without=(name,)), removable,
            candidates, np.flatnonzero(fails == Reason.NOT_SELECTED), scanner, scene.scanner_parameters, max_sigma,
            resolved["plan"]["candidates"] == "targeted", part_caster, occluder_caster,
        )  # fmt: skip
        grouped = _grouped(samples, rows, diagnosis, what, scene.planning)
        groups, overall, tried = _changed(changes, targets, samples, grouped, diagnosis, rows, progress)
        rest = rows[diagnosis.reason != Reason.NOT_SELECTED]
    return Answer(
        samples, covered, diagnosis, rows, groups, rest, overall, tried, scene.planning, scene.part_name
    )  # fmt: skip


def _as_executed(run: RunRecord) -> Viewpoints:
    """The candidates, those of the plan's views at the poses of the rounded joint angles, as coverage takes them."""
    candidates = run_reader.candidates(run)
    T = np.array(candidates.T_object_scanner)
    if T.shape[1] == 1:
        for view in run_reader.views(run):
            T[view.id, 0] = view.T_object_scanner
    return Viewpoints(T, candidates.face, candidates.standoff, candidates.roll)


def _failing(run: RunRecord, count: int) -> tuple[NDArray[np.uint8], list[str]]:
    """At what each candidate fails even for a point that it would measure, and what is in its way."""
    reached = run_reader.reached(run)
    fails = np.array([why.OF_VERDICT[verdict] for verdict in why.OF_VERDICT], dtype=np.uint8)[reached.verdict]
    blockers = list(reached.blocker)
    dropped = run_reader.plan_json(run)["dropped"]
    with understood(run.folder / "plan.json"):
        if len(fails) != count:
            raise ValueError(f"reach.npz has {len(fails)} verdicts and viewpoints.npz {count} candidates")
        for view in dropped:
            fails[view["id"]], blockers[view["id"]] = Reason.NO_PATH, str(view["reason"])
    return fails, blockers


def _law(run: RunRecord, resolved: Mapping[str, Any], scanner: Scanner) -> tuple[Scanner, float | None]:
    """The scanner's law with the plan's limit on sigma, and that limit [m]."""
    with understood(run.folder / "scene.resolved.json"):
        limit_mm = resolved["plan"].get("max_sigma_mm")
        if limit_mm is None:
            return scanner, None
        limited = scanner if isinstance(scanner, Limited) else Limited(scanner, limit_mm / 1000)  # type: ignore[arg-type]
        return limited, limit_mm / 1000


def _grouped(
    samples: SurfaceSamples, rows: Indices, diagnosis: Diagnosis, what: Sequence[str], planning: TriangleMesh
) -> list[tuple[Reason, str, Indices, list[Indices]]]:
    """(reason, what, samples, their patches) of each group, the largest first."""
    keys: dict[tuple[int, str], list[int]] = {}
    for i, key in enumerate(zip(diagnosis.reason.tolist(), what, strict=True)):
        keys.setdefault(key, []).append(i)
    adjacency = _adjacent_faces(planning)
    found = []
    for (reason, thing), members in keys.items():
        inside = rows[np.array(members)]
        found.append((Reason(reason), thing, inside, _patches(inside, samples, adjacency, len(planning.faces))))
    return sorted(found, key=lambda group: (-float(samples.areas[group[2]].sum()), group[0], group[1]))


def _adjacent_faces(mesh: TriangleMesh) -> Indices:
    """(E, 2) pairs of faces that share an edge."""
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    face = np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    same = (np.diff(edges[order], axis=0) == 0).all(axis=1)
    return np.stack([face[order][:-1][same], face[order][1:][same]], axis=1)


def _patches(rows: Indices, samples: SurfaceSamples, adjacent: Indices, faces: int) -> list[Indices]:
    """The samples in pieces that are connected over planning faces, the largest first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    here = np.zeros(faces, dtype=np.bool_)
    face = samples.planning_face[rows]
    here[face] = True
    both = adjacent[here[adjacent].all(axis=1)]
    graph = coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(faces, faces))
    label = connected_components(graph, directed=False)[1][face]
    pieces = [rows[label == one] for one in np.unique(label)]
    return sorted(pieces, key=lambda piece: (-float(samples.areas[piece].sum()), int(piece[0])))


def _changed(
    changes: Changes, targets: Targets, samples: SurfaceSamples,
    grouped: Sequence[tuple[Reason, str, Indices, list[Indices]]], diagnosis: Diagnosis, rows: Indices,
    progress: ProgressCallback,
) -> tuple[tuple[Group, ...], tuple[Named, ...], tuple[tuple[WhatIf, float], ...]]:  # fmt: skip
    """Try the changes on representatives, name the best for each group and patch, verify them on all their samples."""
    if not len(rows):
        return (), (), ()
    spread = [_spread(inside, _share(len(inside), len(rows))) for _, _, inside, _ in grouped]
    representatives = np.unique(np.concatenate(spread))
    aims = _spread(rows, _AIMS)
    tried: list[WhatIf] = []
    masks: list[NDArray[np.bool_]] = []
    for done, ladder in enumerate(changes.ladders((samples.points[aims], samples.normals[aims]))):
        masks.extend(ladder_masks(ladder, targets, representatives))
        tried.extend(ladder)
        progress(min(done + 1, 15), 20)
    for reason, _, inside, _ in grouped:
        if reason is Reason.NOT_SELECTED:
            further = changes.views(targets, _spread(inside, 20 * _FEWEST))
            masks.extend(step.measures(targets, representatives) for step in further)
            tried.extend(further)
    gains = np.array(masks).reshape(len(tried), len(representatives))
    place = np.full(len(targets), -1, dtype=np.int64)
    place[representatives] = np.arange(len(representatives))
    kinds, sizes = [change.kind for change in tried], [change.change for change in tried]

    def best(asked: Indices, reason: Reason, most: int) -> list[int]:
        """Changes for some samples by their representatives. An unselected view needs no change but being selected."""
        own = place[asked][place[asked] >= 0]
        if not len(own):
            return []
        share = gains[:, own].mean(axis=1) * [
            (kind is what_if.Kind.VIEW) == (reason is Reason.NOT_SELECTED) for kind in kinds
        ]
        return what_if.choose(share, kinds, sizes, most=most)

    largest = sorted((p for g in grouped for p in g[3]), key=lambda piece: -float(samples.areas[piece].sum()))
    asked_patches = {int(piece[0]) for piece in largest[:_PATCHES]}
    of_group = [best(inside, reason, 3) for reason, _, inside, _ in grouped]
    of_patch = [
        [best(piece, group[0], 1) if int(piece[0]) in asked_patches else [] for piece in group[3]] for group in grouped
    ]
    # What a reachable candidate measures already is no gain of another change.
    closed = [group for group in grouped if group[0] is not Reason.NOT_SELECTED]
    rest = np.concatenate([group[2] for group in closed] or [np.empty(0, dtype=np.int64)])
    in_all = gains.astype(np.float64) @ _weights(representatives, closed, samples)
    overall = what_if.choose(in_all, kinds, sizes, most=3)

    verify: dict[int, list[Indices]] = {index: [rest] for index in overall}
    for group, named, patches in zip(grouped, of_group, of_patch, strict=True):
        for index in named:
            verify.setdefault(index, []).append(group[2])
        for piece, chosen in zip(group[3], patches, strict=True):
            for index in chosen:
                verify.setdefault(index, []).append(piece)
    verified: dict[int, Named] = {}
    for done, (index, asked) in enumerate(sorted(verify.items())):
        every = np.unique(np.concatenate(asked))
        gained = np.zeros(len(targets), dtype=np.bool_)
        gained[every] = tried[index].measures(targets, every)
        verified[index] = Named(tried[index], gained)
        progress(15 * len(verify) + 5 * (done + 1), 20 * len(verify))
    limits = changes.parameters
    groups = tuple(
        Group(
            reason, what, _detail(reason, diagnosis, np.isin(rows, inside), limits), inside,
            tuple(
                Patch(piece, verified[chosen[0]] if chosen else None)
                for piece, chosen in zip(pieces, patches, strict=True)
            ),
            tuple(verified[index] for index in named if verified[index].gained[inside].any()),
        )
        for (reason, what, inside, pieces), named, patches in zip(grouped, of_group, of_patch, strict=True)
    )  # fmt: skip
    listed = sorted(zip(tried, in_all.tolist(), strict=True), key=lambda item: -item[1])
    return groups, tuple(verified[index] for index in overall), tuple(listed)


def _share(inside: int, total: int) -> int:
    """How many representatives a group of so many samples gets."""
    return max(_FEWEST, round(_REPRESENTATIVES * inside / total))


def _spread(rows: Indices, count: int) -> Indices:
    """At most so many of the rows, evenly over their order, which is that of a space-filling curve."""
    return rows[np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64)]


def _weights(
    representatives: Indices, grouped: Sequence[tuple[Reason, str, Indices, list[Indices]]], samples: SurfaceSamples
) -> Floats:
    """(r,) share of the open area that each representative stands for."""
    weight = np.zeros(len(representatives))
    total = sum(float(samples.areas[group[2]].sum()) for group in grouped)
    for _, _, inside, _ in grouped:
        own = np.isin(representatives, inside)
        weight[own] = float(samples.areas[inside].sum()) / total / max(int(own.sum()), 1)
    return weight


_OF_ANGLE: dict[Reason, tuple[Callable[[Diagnosis], Floats], str]] = {
    Reason.GRAZING_SOURCE: (lambda found: found.grazing_source, "grazing_max_deg"),
    Reason.GRAZING_SENSOR: (lambda found: found.grazing_sensor, "sensor_grazing_max_deg"),
}


def _detail(reason: Reason, diagnosis: Diagnosis, inside: NDArray[np.bool_], limits: Mapping[str, Any]) -> str:
    """What there is to add about the closest candidates of some open samples."""
    if reason is Reason.NOT_SELECTED:
        return "the plan's target did not need it"
    if reason in _OF_ANGLE:
        angles, limit = _OF_ANGLE[reason]
        low, high = np.degrees(np.quantile(angles(diagnosis)[inside], (0.1, 0.9)))
        given = f", limit {limits[limit]:g}" if limit in limits else ""
        return f"{low:.0f} to {high:.0f} deg from the normal{given}"
    if reason is Reason.OUT_OF_RANGE:
        low, high = 1000 * np.quantile(diagnosis.distance[inside], (0.1, 0.9))
        given = f", range {limits['range_mm'][0]:g} to {limits['range_mm'][1]:g}" if "range_mm" in limits else ""
        return f"{low:.0f} to {high:.0f} mm away{given}"
    return ""
