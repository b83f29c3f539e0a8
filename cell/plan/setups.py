"""Several set-ups of a part, planned as one cover: fewest set-ups, then fewest views, each with a bound.

Every set-up candidate is reached, grown and measured over one set of samples. The cover over all of them is connected
in every set-up that it uses, and solved again without views that cannot be connected. A coverage below 1 must also hold
on held-out samples: if a cover misses it, fresh samples of the planning faces on which it fails become rows of every
set-up (as `cell.plan.selection` does for one), and if fresh samples show nothing more, the target on the rows is
raised. Each set-up becomes a run folder below `setups/`. A finished plan can be a fixed first set-up: its views stay as
they are, and only the other set-ups are planned.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array, hstack

from cell.errors import SceneError, UnreachableError, UsageError
from cell.formatting import percent
from cell.part.workpiece import Workpiece
from cell.plan import files, pipeline, selection
from cell.plan.candidates import (
    GROWN,
    Cell,
    MeasuredSet,
    PlanSession,
    append_viewpoints,
    generate_viewpoints,
    make_surface,
    measure,
    reach_viewpoints,
    view_evaluator,
    with_grown,
    without_rows,
)
from cell.plan.evaluation import Verdict, estimated_share, judge
from cell.plan.improvement import REFINED_MARGIN, viewpoints_of
from cell.plan.motion import ConnectedPlan, connect_views
from cell.plan.selection import (
    PinnedViewError,
    RegionGroups,
    Request,
    SelectionProblem,
    measure_rows,
    pose_error,
    pose_probabilities,
    select_views,
)
from cell.plan.setup_options import SetupOptions, format_candidate
from cell.plan.shared_surface import connecting_view, shared_surfaces, unconnected_setups
from cell.report.setups_report import page, status
from cell.runs.cell import read_cell, scene_of_run
from cell.runs.run import Run
from cell.runs.schema import (
    ChosenSetup,
    Curve,
    OfferedSetup,
    PlannedOpen,
    SetupsCoverage,
    SetupsFile,
    SetupsRegion,
    ViewsFirst,
)
from cell.scene.file import load_scene, option_names, option_tables
from cell.scene.model import Placement, Scene, with_rest
from cell.scene.model import Setup as SetupTable
from cell.scene.options import Spell
from cell.scene.settle import SettledScene
from cell.session import Session, Stream
from cell.world.checks import find_problems
from cell.world.measurability import PartSurface, surface_samples
from cell.world.model import ON_AXIS, World, compile_settled
from cell.world.occluders import Occluder, fixed_occluders
from cell.world.prediction import Prediction, held_out_samples
from cell.world.support_contact import in_contact
from planner.cover import CoverProblem, CoverStatus
from planner.cover.curve import coverage_curve
from planner.cover.grouped import GroupedCover, fewest_views, solve_grouped
from planner.cover.overlap import OverlapGraph
from planner.cover.robust import DEMAND, loads
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples
from planner.kinematics.frames import kuka_abc_from_pose
from planner.kinematics.reach import pick_reach
from planner.measurability.matrix import Measurability, append_rows
from planner.measurability.pose_ensemble import ProbabilityLayer
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats, Ints
from planner.viewpoints import growth
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.refinement import ViewState, reduce_views
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints

N_PROPOSED = 24
"""Set-up candidates that are proposed if neither the scene nor the user gives any."""

TURNS_DEG = (0.0, 90.0, 180.0, 270.0)
"""Angles about the vertical at which each stable pose is proposed."""

_MIN_ANGLE_DEG = 10.0  # stable poses nearer than this are one: a rounded part has hundreds
_MIN_PROBABILITY = 0.01  # of a stable pose that is proposed
_SAME = 1e-5  # m, and entries of a rotation: set-up candidates that differ by less are one
_MAX_COVERS = 20  # covers tried in all
_MAX_THOROUGH = 3  # searches for fewer views with the full budget
_RAISE_STEP = 0.0005  # share beyond the gap on held-out samples by which a target is raised


@dataclass(frozen=True, slots=True)
class SetupCandidate:
    """A pose of the part that may be used.

    Attributes:
        name: in words.
        placement: of the part's centre.
        table: of the scene; None for a proposed pose.
        run: finished plan of a fixed set-up; None for one that is planned.
    """

    name: str
    placement: Placement
    table: SetupTable | None = None
    run: Run | None = None

    def scene(self, shared: Scene) -> Scene:
        """Return the scene of this set-up alone."""
        own: dict[str, object] = {
            "placement": self.placement,
            "setup": (),
            "plan": shared.plan.without_selection().with_order_of(shared.plan),
        }
        if self.table is not None:
            own["fixtures"] = (*shared.fixtures, *self.table.fixtures)
            own |= {} if self.table.post is None else {"post": self.table.post}
        return shared.model_copy(update=own)


def given_candidates(scene: Scene) -> list[SetupCandidate]:
    """Return the set-ups of the scene in its order."""
    return [
        SetupCandidate(each.name, Placement(position_mm=each.position_mm, abc_deg=each.abc_deg), each)
        for each in scene.setup
    ]


def with_fixed_table(scene: Scene, world: World) -> Scene:
    """Return the scene with its rotary table at its position in a compiled cell, whatever the pose of the part."""
    if world.table is None:
        return scene
    return _with_table_at(scene, world.table.T_base_table)


def _with_table_at(scene: Scene, T_base_table: Floats) -> Scene:
    position_mm = (1000 * T_base_table[:3, 3]).round(6).tolist()
    return scene.model_copy(update={"table": scene.table.model_copy(update={"position_mm": tuple(position_mm)})})


def proposed_candidates(world: World, part: TriangleMesh, limit: int) -> list[SetupCandidate]:
    """Propose set-ups in which the part's lowest point keeps its height, and its centre its position.

    The pose of the scene comes first, then stable poses, the most probable first, each at all turns; at one turn if a
    rotary table turns the part about its centre.

    Args:
        world: the cell with the part as the scene places it.
        part: reference mesh [m], object frame.
        limit: largest number of candidates.

    Raises:
        SceneError: if a rotary table is tilted, on which no pose of the part is stable.
    """
    if limit and world.table is not None and not world.table.upright:
        raise SceneError(
            "set-ups can only be proposed on an upright rotary table, and this one is tilted; give [[setup]] tables "
            "with --proposals 0, or omit table.abc_deg"
        )
    placed = (world.T_base_object @ world.T_object_centre)[:3, :3]
    poses = [("as it is placed", placed)]
    for R, probability in _stable_poses(part):
        if all(_tilt_deg(R, other) > _MIN_ANGLE_DEG for _, other in poses):
            poses.append((f"in a stable pose of probability {probability:.2f}", R))
    found = [
        SetupCandidate(f"{name}, turned by {turn:g} deg" if turn else name, _placement(world, _about_z(turn) @ R))
        for name, R in poses
        for turn in (TURNS_DEG[:1] if _table_turns_part(world) else TURNS_DEG)
    ]
    return found[:limit]


def _stable_poses(part: TriangleMesh) -> Iterator[tuple[Floats, float]]:
    """Yield rotations (3, 3) in which the part rests on a plane, with their probabilities, the largest first.

    A body that is dropped at random comes to rest on a face of its convex hull (Goldberg, Mirtich, Zhuang, Craig,
    Carlisle, Canny, "Part pose statistics", IEEE Trans. Robotics and Automation 1999, doi:10.1109/70.795796).
    """
    import trimesh  # half a second of start-up

    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    hull = mesh.convex_hull
    mass = mesh.center_mass if mesh.is_volume else hull.center_mass
    transforms, probabilities = trimesh.poses.compute_stable_poses(hull, center_mass=mass)
    for k in np.argsort(-probabilities.round(9), kind="stable"):
        if probabilities[k] >= _MIN_PROBABILITY:
            yield transforms[k][:3, :3], float(probabilities[k])


def _table_turns_part(world: World) -> bool:
    """Return whether a rotary table turns the part once round about its own centre."""
    if (table := world.table) is None:
        return False
    off_axis = (world.T_base_object @ world.T_object_centre)[:2, 3] - table.T_base_table[:2, 3]
    return bool(np.linalg.norm(off_axis) <= ON_AXIS and table.upper - table.lower >= 2 * np.pi - 1e-9)


def _tilt_deg(one: Floats, other: Floats) -> float:
    """Return the angle between the part's downward directions at two rotations [deg]."""
    return float(np.degrees(np.arccos(np.clip(one[2] @ other[2], -1.0, 1.0))))


def _about_z(angle_deg: float) -> Floats:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _placement(world: World, R: Floats) -> Placement:
    """Return the placement at a rotation, with the lowest point at its height in the scene, in rounded numbers."""
    T = np.array(world.T_base_object @ world.T_object_centre)
    corners = world.part_hull.vertices - world.T_object_centre[:3, 3]
    T[2, 3] = world.post_top(world.T_base_object)[2] - (corners @ R[2]).min()
    T[:3, :3] = R
    position, abc = kuka_abc_from_pose(T)
    return Placement(
        position_mm=tuple(((position * 1000).round(3) + 0.0).tolist()),
        abc_deg=tuple((np.degrees(abc).round(3) + 0.0).tolist()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """A set-up with its measured candidates.

    Attributes:
        measured: its candidates; rows in contact with a support are empty.
        supports: post, floor, pedestal and fixtures, object frame.
        contact: (S,) whether a support touches each held-out sample.
    """

    measured: MeasuredSet
    supports: Sequence[Occluder]
    contact: Bools

    @property
    def coverable(self) -> Bools:
        """(S,) held-out samples that a reachable candidate measures."""
        return np.asarray(self.measured.prediction.coverable.covered) & ~self.contact

    def visible(self, T_object_poses: Floats) -> Bools:
        """Return (S,) whether (n, K, 4, 4) views [m] measure each held-out sample."""
        return np.asarray(self.measured.prediction.visible(T_object_poses).covered) & ~self.contact

    def measures(self, T_object_poses: Floats, samples: SurfaceSamples) -> Bools:
        """Return (S,) whether (n, K, 4, 4) views [m] measure each of some samples."""
        known = self.measured.prediction
        seen = find_measured(T_object_poses, samples, known.scanner, known.casters)
        return seen & ~in_contact(samples, self.supports)

    def rows_of(self, samples: SurfaceSamples) -> Measurability:
        """Return the matrix of further samples."""
        M = measure_rows(self.measured, self.measured.reached.reachable, samples)
        return without_rows(M, in_contact(samples, self.supports))


@dataclass(frozen=True, slots=True, eq=False)
class FixedSetup(Setup):
    """A set-up with a finished plan; its candidates are the views of the plan.

    Attributes:
        run: the finished plan.
    """

    run: Run

    @property
    def T_object_poses(self) -> Floats:
        """(n, K, 4, 4) views as they are driven [m]."""
        return self.measured.candidates.T_object_scanner


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSetup(Setup):
    """A set-up that can be planned.

    Attributes:
        settled: scene with the part at its placement.
        cell: compiled.
    """

    settled: SettledScene
    cell: Cell

    def with_viewpoints(
        self, session: PlanSession, surface: PartSurface, M: Measurability, viewpoints: Viewpoints
    ) -> "PlannedSetup":
        """Append viewpoints to the candidates; M is the current matrix of the candidates."""
        more, uncached = reach_viewpoints(self.settled, self.cell, viewpoints), replace(session, use_cache=False)
        measured = append_viewpoints(
            uncached, self.settled, surface, replace(self.measured, M=M), more,
            ignored=in_contact(M.samples, self.supports),
        )  # fmt: skip
        return replace(self, measured=measured)

    def evaluator(self, samples: SurfaceSamples) -> ViewEvaluator:
        """Return the evaluator of free poses; samples in contact with a support are not measured."""
        known = self.measured.prediction
        arm = view_evaluator(self.cell, known.scanner, known.casters)
        return _ContactEvaluator(
            arm.scanner, arm.casters, arm.are_reachable, arm.T_view_scanner, contact=in_contact(samples, self.supports)
        )


@dataclass(frozen=True, slots=True, eq=False)
class _ContactEvaluator(ViewEvaluator):
    """Evaluator of free poses for a part with (S,) targets in contact with a support."""

    contact: Bools

    def measured(
        self, views: Floats, targets: RayTargets, rows: Ints, worth: tuple[Floats, float] | None = None
    ) -> Bools:
        """Return (m, n) whether each viewpoint (n, 4, 4) [m] measures each row; see `ViewEvaluator.measured`."""
        return ViewEvaluator.measured(self, views, targets, rows, worth) & ~self.contact[rows, None]


def make_setup(
    session: PlanSession, settled: SettledScene, surface: PartSurface, world: World, candidate: SetupCandidate,
    viewpoints: Viewpoints, scouts: SurfaceSamples,
) -> Setup | str:  # fmt: skip
    """Reach, grow and measure the candidates of a set-up; return the reason if it is not possible.

    Args:
        session: nothing is written to its folder.
        settled: shared scene.
        surface: part and rows that all set-ups share.
        world: the cell, compiled with the part anywhere.
        candidate: pose of the part.
        viewpoints: that all set-ups share.
        scouts: samples for which more viewpoints are grown.
    """
    if candidate.run is not None:
        return _fixed_setup(session, surface, candidate.run)
    scene = candidate.scene(settled.scene)
    settled = replace(settled, scene=scene)
    if scene.table.enabled or (candidate.table is not None and (candidate.table.fixtures or candidate.table.post)):
        try:
            world = compile_settled(settled, surface.reference)
        except SceneError as error:
            return str(error)
    else:
        T_base_object = scene.placement.T @ np.linalg.inv(world.T_object_centre)
        placed = world.scene.model_copy(update={"placement": candidate.placement})
        world = replace(world, scene=placed, T_base_object=T_base_object)
    if problems := find_problems(world):
        return problems[0]
    cell = Cell.of(world)
    with session.stage(candidate.name) as progress:
        casters, supports = cell.casters(surface), fixed_occluders(world)
        found = reach_viewpoints(settled, cell, viewpoints)
        found = with_grown(settled, cell, found, scouts, casters, progress)
        if not found.reached.reachable.any():
            return "the arm reaches no candidate"
        measured = measure(
            session, settled, surface, found, casters, progress, ignored=in_contact(surface.samples, supports),
            may_be_empty=True,
        )  # fmt: skip
        contact = in_contact(measured.prediction.samples, supports)
        return PlannedSetup(measured, supports, contact, settled, cell)


def _fixed_setup(session: PlanSession, surface: PartSurface, run: Run) -> FixedSetup:
    """Measure the views of a finished plan over the shared samples."""
    cell, views = read_cell(run), run.plan.views
    ids = np.array([view.id for view in views])
    poses = np.stack([view.T_object_poses for view in views])
    candidates = replace(pick_viewpoints(run.candidates, ids), T_object_scanner=poses)
    casters = (cell.part_caster, cell.occluder_caster)
    samples = held_out_samples(surface.reference, surface.planning, session.seed, session.effort.held_out_samples)
    prediction = Prediction.of(samples, cell.scanner, casters, poses)
    reached = pick_reach(run.reach, ids)
    seen = find_measured(poses, surface.samples, cell.scanner, casters, each=True)
    M = _matrix_of(seen & ~in_contact(surface.samples, cell.occluders)[:, None], surface.samples)
    measured = MeasuredSet(candidates, reached, M, prediction)
    return FixedSetup(measured, cell.occluders, in_contact(samples, cell.occluders), run)


def _matrix_of(seen: Bools, samples: SurfaceSamples) -> Measurability:
    """Return the matrix of (S, n) measured samples."""
    matrix = csr_array(seen)
    indptr, indices = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32)
    return Measurability(indptr=indptr, indices=indices, samples=samples, n_viewpoints=seen.shape[1])


@dataclass(frozen=True, slots=True, eq=False)
class SetupsRequest:
    """Request for all set-ups together.

    Attributes:
        request: options of the scene, as for one plan.
        options: of `cell setups`.
        seconds: (V,) costs of the candidates of each set-up; empty if views are counted.
        layers: probabilities of each matrix; empty if poses are exact.
        fixed_views: (set-up, candidate) of the views of fixed set-ups.
    """

    request: Request
    options: SetupOptions
    seconds: Mapping[int, Floats] = field(default_factory=dict)
    layers: Mapping[int, ProbabilityLayer] = field(default_factory=dict)
    fixed_views: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, session: PlanSession, scene: Scene, options: SetupOptions) -> "SetupsRequest":
        """Collect the options of a scene.

        Raises:
            UsageError: if set-ups have a cost, and regions have targets of their own.
        """
        regions = RegionGroups.of(with_rest(scene.region), scene.plan)
        if options.setup_s is not None and regions is not None and not regions.is_plain:
            raise UsageError(
                "--setup-seconds cannot be combined with regions that have a coverage, views or weight of their own; "
                "omit one of them"
            )
        return cls(Request(scene.plan, regions=regions, effort=session.effort), options)

    def for_setups(self, session: PlanSession, setups: Mapping[int, Setup]) -> "SetupsRequest":
        """Return the request with costs and probabilities of the candidates of each set-up."""
        plan, seconds, layers = self.request.plan, dict[int, Floats](), dict[int, ProbabilityLayer]()
        fixed_views: list[tuple[int, int]] = []
        for row, setup in setups.items():
            if isinstance(setup, PlannedSetup):
                scene = setup.settled.scene.model_copy(update={"plan": plan})
                request = pipeline.make_problem(
                    session, replace(setup.settled, scene=scene), setup.cell, setup.measured
                ).request
                seconds |= {} if request.costs is None else {row: request.costs}
                layers |= {} if request.layer is None else {row: request.layer}
                continue
            n = setup.measured.M.n_viewpoints  # the time of its views is spent whatever is planned
            fixed_views += [(row, column) for column in range(n)]
            seconds |= {row: np.full(n, selection.MIN_COST)} if plan.cost == "time" else {}
            if not pose_error(plan).is_exact:
                rng = session.rng(Stream.POSE_ERRORS)
                layers[row] = pose_probabilities(plan, setup.measured, rng, lambda done, total: None)
        return replace(self, seconds=seconds, layers=layers, fixed_views=tuple(fixed_views))

    @property
    def pins(self) -> list[tuple[int, int]]:
        """Views that are taken in any case."""
        return [*self.options.pins, *self.fixed_views]

    @property
    def is_evaluated(self) -> bool:
        """Whether the coverage must hold on held-out samples."""
        return self.request.is_evaluated and pose_error(self.request.plan).is_exact

    @property
    def needs_one_view(self) -> bool:
        """Whether one view of a sample is enough: no multiplicity and no confidence is requested."""
        regions = self.request.regions
        needs_several = self.request.plan.multiplicity > 1 or (regions is not None and (regions.views > 1).any())
        return not needs_several and pose_error(self.request.plan).is_exact

    @property
    def allows_refinement(self) -> bool:
        """Whether views may be moved: their number counts, and none is named by the user."""
        is_free = self.request.regions is None and self.request.plan.cost == "views" and self.request.is_probed
        is_named = self.pins or self.options.bans
        return is_free and not is_named and self.request.allows_swaps and pose_error(self.request.plan).is_exact

    def cover_problem(self, M: Mapping[int, Measurability], usable: Mapping[int, Bools]) -> CoverProblem:
        """Return the candidates of all set-ups side by side, each set-up a group, without the coverage.

        Args:
            M: matrix of each set-up, over the same rows.
            usable: for each, (V,) candidates that may be selected.
        """
        request, numbers = self.request, list(M)
        samples = M[numbers[0]].samples
        first = dict(zip(numbers, np.cumsum([0, *(M[row].n_viewpoints for row in numbers[:-1])]), strict=True))
        allowed, demand = np.concatenate([usable[row] for row in numbers]), request.plan.multiplicity
        if self.layers:
            matrix, demand = hstack([self.loads_of(row, M[row]) for row in numbers], format="csc"), DEMAND
            # A row that cannot reach the confidence is not requested.
            matrix.data = matrix.data * (matrix @ allowed.astype(np.int64) >= DEMAND)[matrix.indices]
        else:
            matrix = hstack([M[row].matrix() for row in numbers], format="csc")
        problem = CoverProblem(
            matrix, samples.areas, allowed, max_views=request.plan.max_views, demand=demand,
            costs=np.concatenate([self.seconds[row] for row in numbers]) if self.seconds else None,
            pinned=[int(first[row]) + column for row, column in self.pins],
            group=np.repeat(np.arange(len(numbers)), [M[row].n_viewpoints for row in numbers]),
            overlap=request.overlap,
        )  # fmt: skip
        if request.regions is None:
            return problem
        problem = request.regions.apply(problem, samples)
        return replace(problem, demand=DEMAND) if self.layers else problem

    def shares(self, samples: SurfaceSamples, seen: Bools, coverable: Bools) -> Floats:
        """Return the (P,) seen shares of the coverable held-out samples, of each group of regions."""
        if self.request.regions is None:
            return np.array([seen.sum() / max(coverable.sum(), 1)])  # samples stand for equal areas
        return self.request.regions.shares_of(samples, seen, coverable)

    def loads_of(self, row: int, M: Measurability) -> csr_array:
        """Return the (S, V) contributions of the views of a set-up to each row: 1, or their part of the confidence."""
        if not self.layers:
            return csr_array(M.matrix().astype(np.int64))
        layer = self.layers[row].restricted_to(M)
        return csr_array(loads(layer, self.request.plan.alpha, (len(M.samples), M.n_viewpoints)))


@dataclass(frozen=True, slots=True, eq=False)
class ConnectedSetup:
    """Views of a used set-up.

    Attributes:
        candidate: (n,) candidates in visiting order.
        matrix: measurability of the candidates, as the arm leaves it.
        T_object_poses: (n, K, 4, 4) views as they are driven [m].
        planned: problem and plan; None for a fixed set-up.
    """

    candidate: Ints
    matrix: Measurability
    T_object_poses: Floats
    planned: tuple[SelectionProblem, ConnectedPlan] | None = None


Connected = Mapping[int, ConnectedSetup]
Poses = Mapping[int, Floats]
"""For each used set-up, (n, K, 4, 4) views in the object frame [m]."""


class SetupSearch:
    """Search of the cover over all set-ups.

    Attributes:
        setups: possible set-ups by their rows among the candidates, with all views that became candidates.
    """

    def __init__(
        self, session: PlanSession, surface: PartSurface, setups: Mapping[int, Setup], request: SetupsRequest
    ) -> None:
        """Begin without any cover; nothing is written to the folder of the session until `curve`."""
        self._session, self._surface, self._request = session, surface, request.for_setups(session, setups)
        self.setups = dict(setups)
        self._M = {row: setup.measured.M for row, setup in setups.items()}  # as the arms leave it
        self._usable = {row: np.array(setup.measured.reached.reachable) for row, setup in setups.items()}
        for row, column in request.options.bans:
            self._usable[row][column] = False
        for row, column in self._request.fixed_views:
            self._usable[row][column] = True
        self._targets, self._rounds = request.request.targets, 0
        self._samples = next(iter(setups.values())).measured.prediction.samples
        self._fresh = session.rng(Stream.FRESH_SAMPLES)
        self._rng = session.rng(Stream.SELECTION)

    def solve(self) -> tuple[GroupedCover, Connected]:
        """Return the cover and its connected set-ups; the last cover tried if none holds the coverage.

        Covers are tried by short searches; bounds, and perhaps fewer views, follow from the last one.

        Raises:
            UnreachableError: if none could be connected.
        """
        last = None
        for left in reversed(range(_MAX_COVERS)):
            found = self._cover(fast=True)
            # Before a motion is planned in vain; half of the tries are kept for views that cannot be connected.
            if 2 * left >= _MAX_COVERS and self._request_more(found, self._poses(found)):
                continue
            if (connected := self._connect(found)) is None:
                continue
            last = found, connected
            if not self._request_more(found, _driven(connected)):
                break
        if last is None:
            raise UnreachableError(
                "no cover could be connected; move the part, or allow more set-up candidates with --proposals"
            )
        return self._with_shared_surface(*self._thorough(*last))

    def _thorough(self, found: GroupedCover, connected: Connected) -> tuple[GroupedCover, Connected]:
        """Bound a cover with the full budget, and search for fewer views that hold the coverage.

        Fewer views that miss it are searched again with more rows or a higher target.
        """
        refined = self._refined(found)
        bounded, others, before = None, [refined] if refined else [], (self._M.copy(), self._targets)
        for _ in range(_MAX_THOROUGH):
            thorough = self._cover(fast=False, start=(refined or found).views)
            for better in sorted((thorough, *others), key=lambda cover: cover.objective):
                holds = better.objective < found.objective and (self._deficit(better, self._poses(better)) <= 0).all()
                plans = self._connect(better) if holds else None
                if plans is not None and (self._deficit(better, _driven(plans)) <= 0).all():
                    return better.with_bounds_of(thorough), plans  # of all set-ups and refined views
            bounded, others = bounded or found.with_bounds_of(thorough), []  # later covers have higher targets
            if thorough.objective >= found.objective or not self._request_more(thorough, self._poses(thorough)):
                break
        self._M, self._targets = before  # as they were requested
        return bounded or found, connected

    def fewest_views(self, found: GroupedCover) -> tuple[int, int] | None:
        """Return numbers of set-ups and views for the fewest views; None unless more set-ups save views.

        With as many set-ups, only views that connect scans make a difference.
        """
        problem = self._request.cover_problem(self._M, self._usable)
        other = fewest_views(problem, found.targets, self._rng, self._session.effort.cover_work)
        saves = other is not None and other[0] > len(found.views) and other[1] < found.n_views
        return other if saves else None

    def curve(self, connected: Connected) -> Curve:
        """Write the coverage over the number of views in the set-ups of a cover.

        Shares refer to the surface that these set-ups can measure; pinned and banned views hold as in one plan.
        """
        names = [(row, column) for row, setup in connected.items() for column in range(setup.matrix.n_viewpoints)]
        place = {name: column for column, name in enumerate(names)}
        views = [place[row, int(column)] for row, setup in connected.items() for column in setup.candidate]
        matrix = hstack([setup.matrix.matrix() for setup in connected.values()], format="csc")
        areas = next(iter(connected.values())).matrix.samples.areas
        # Views that were refined after these plans are candidates behind theirs.
        allowed = np.concatenate([self._usable[row][: setup.matrix.n_viewpoints] for row, setup in connected.items()])
        problem = CoverProblem(matrix, areas, allowed, pinned=[place[name] for name in self._request.pins])
        curve = coverage_curve(
            problem, rng=self._session.rng(Stream.COVERAGE_CURVE), known_selections=[views],
            effort_budget=self._session.effort.curve_work,
        )  # fmt: skip
        covered = float(areas[np.asarray(matrix[:, views].sum(axis=1)).ravel() > 0].sum())
        selection.write_curve(
            self._session.folder, self._session.plots, curve, len(views), covered,
            lambda column: format_candidate(names[column]),
        )  # fmt: skip
        return selection.fewest_of(curve)

    def _cover(self, *, fast: bool, start: Mapping[int, Ints] | None = None) -> GroupedCover:
        options = self._request.options
        return solve_grouped(
            self._request.cover_problem(self._M, self._usable), self._targets, self._rng, max_groups=options.max_setups,
            group_cost=options.setup_s, solver=self._request.request.plan.solver, fast=fast, start=start,
            effort_budget=self._session.effort.cover_work,
        )  # fmt: skip

    def _refined(self, found: GroupedCover) -> GroupedCover | None:
        """Return the cover by fewer views, some of them refined; None if there is none."""
        rows = list(self.setups)
        setups = {row: setup for row, setup in self.setups.items() if isinstance(setup, PlannedSetup)}
        is_movable = all(
            setup.settled.scene.plan.candidates == GROWN and setup.measured.candidates.T_object_scanner.shape[1] == 1
            for setup in setups.values()
        )
        if not (self._request.allows_refinement and self._request.is_evaluated and is_movable):
            return None
        selected = {rows[index]: views for index, views in found.views.items()}
        goal = float(found.loads.wanted[0])
        setups, self._M, views = refine_setups(self._session, self._surface, setups, self._M, selected, goal)
        self.setups |= setups
        if sum(map(len, views.values())) == found.n_views:
            return None
        for row, setup in setups.items():
            more = setup.measured.reached.reachable[len(self._usable[row]) :]
            self._usable[row] = np.concatenate([self._usable[row], more])
        return replace(found, views={rows.index(row): columns for row, columns in views.items()})

    def _with_shared_surface(self, found: GroupedCover, connected: Connected) -> tuple[GroupedCover, Connected]:
        """Add views until the shared surface fixes the scans of all set-ups relative to each other."""
        rows = list(self.setups)
        limit, seconds = self._request.request.plan.max_views, self._request.seconds
        usable = {
            row: mask if isinstance(self.setups[row], PlannedSetup) else np.zeros_like(mask)
            for row, mask in self._usable.items()
        }
        for _ in range(_MAX_COVERS if limit is None else limit - found.n_views):
            views = {rows[index]: columns for index, columns in found.views.items()}
            if (more := connecting_view(self._M, usable, views)) is None:
                break
            row, column = more
            larger = found.with_view(rows.index(row), column, float(seconds[row][column]) if seconds else 0.0)
            plans = self._connect(larger)  # None: the candidate is no longer usable, and another is tried
            if plans is not None:
                found, connected = larger, plans
        for row, setup in connected.items():
            if setup.planned is None:
                continue
            problem, plan = setup.planned
            if problem.request.plan.overlap_in_order and plan.selection.details is None:
                self._session.note(
                    f"the views of set-up candidate {row} are connected through other set-ups alone: they are visited "
                    "in the fastest order"
                )
        return found, connected

    def _connect(self, found: GroupedCover) -> Connected | None:
        """Plan the set-ups of a cover; None if a view cannot be connected, or arms hide too much."""
        rows = list(self.setups)
        try:
            connected = {rows[index]: self._plan(rows[index], views) for index, views in found.views.items()}
        except PinnedViewError:
            return None  # the candidate is no longer usable
        self._M |= {row: setup.matrix for row, setup in connected.items()}
        sums = sum(
            self._request.loads_of(row, setup.matrix)[:, setup.candidate].sum(axis=1)
            for row, setup in connected.items()
        )
        return connected if found.is_met_by(np.asarray(sums).ravel()) else None

    def _poses(self, found: GroupedCover) -> Poses:
        """Return the poses of the candidates of a cover."""
        rows = list(self.setups)
        return {
            rows[index]: self.setups[rows[index]].measured.candidates.T_object_scanner[views]
            for index, views in found.views.items()
        }

    def _request_more(self, found: GroupedCover, poses: Poses) -> bool:
        """If views miss the coverage, add rows or raise a target; return whether the next cover can be better."""
        deficit = self._deficit(found, poses)
        if (deficit <= 0).all():
            return False
        self._rounds += 1
        if self._rounds <= selection.ROUNDS and self._add_rows(poses):
            return True
        if (self._targets[deficit > 0] >= 1).all():
            return False
        self._targets = np.where(deficit > 0, np.minimum(self._targets + deficit + _RAISE_STEP, 1.0), self._targets)
        return True

    def _deficit(self, found: GroupedCover, poses: Poses) -> Floats:
        """Return the (P,) missing shares of the coverable held-out samples, for targets below 1.

        Coverable by all set-ups; by the used ones if the allowed number of set-ups is too small.
        """
        requested = self._request.request.targets
        if not self._request.is_evaluated:
            return np.zeros(len(requested))
        seen = np.logical_or.reduce([self.setups[row].visible(T) for row, T in poses.items()])
        counted = self.setups if found.is_feasible else poses
        coverable = np.logical_or.reduce([self.setups[row].coverable for row in counted]) | seen
        shares = self._request.shares(self._samples, seen, coverable)
        return np.where(requested < 1, requested - shares, 0.0)

    def _add_rows(self, poses: Poses) -> bool:
        """Add fresh samples as rows of every set-up; return False if they show no coverable sample without a view.

        Samples cannot be added to rows that are faces.
        """
        if self._request.request.plan.fill != "aimed":
            return False
        fresh = draw_samples(self._surface.reference, self._surface.planning, selection.N_FRESH, self._fresh)
        seen = [self.setups[row].measures(T, fresh) for row, T in poses.items()]
        left = pick_samples(fresh, ~np.logical_or.reduce(seen))
        if not len(left):
            return False
        coverable = np.logical_or.reduce(
            [
                setup.measures(setup.measured.candidates.T_object_scanner[self._usable[row]], left)
                for row, setup in self.setups.items()
            ]
        )
        if not coverable.any():
            return False
        added = pick_samples(fresh, np.isin(fresh.planning_face, left.planning_face[coverable]))
        self._M = {
            row: append_rows(self._M[row], setup.rows_of(added), self._samples) for row, setup in self.setups.items()
        }
        return True

    def _plan(self, row: int, views: Ints) -> ConnectedSetup:
        """Plan the motion through the views of one set-up.

        Raises:
            PinnedViewError: if one of them cannot be connected; it is no longer usable then.
        """
        setup, M, session = self.setups[row], self._M[row], self._session
        if isinstance(setup, FixedSetup):
            return ConnectedSetup(np.arange(M.n_viewpoints), M, setup.T_object_poses)
        assert isinstance(setup, PlannedSetup)
        scene = setup.settled.scene
        options = scene.plan.with_views(views.tolist(), len(setup.measured.reached)).with_order_of(scene.plan)
        settled = replace(setup.settled, scene=scene.model_copy(update={"plan": options}))
        problem = pipeline.make_problem(session, settled, setup.cell, replace(setup.measured, M=M))
        rng = session.rng(Stream.SELECTION)
        try:
            plan = connect_views(
                problem, select_views(problem, rng), selection_rng=rng, motion_rng=session.rng(Stream.MOTION)
            )
        except PinnedViewError as error:
            if (row, error.candidate) in self._request.options.pins:
                name = format_candidate((row, error.candidate))
                raise UnreachableError(
                    f"candidate {name} is pinned and cannot be part of a motion: {error.reason}; pin another"
                ) from error
            self._usable[row][error.candidate] = False
            raise
        cover = replace(plan.cover, lower_bound=1, status=CoverStatus.BOUNDED, solver="joint")
        problem = problem.with_configurations(plan.candidate, plan.tour.q)
        details = plan.selection.details
        if isinstance(details, OverlapGraph) and not details.is_connected:
            details = None  # all may be connected through views of other set-ups
        plan = replace(plan, cover=cover, selection=replace(plan.selection, targets=self._targets, details=details))
        return ConnectedSetup(plan.candidate, plan.matrix, plan.T_object_poses, (problem, plan))


def _driven(connected: Connected) -> Poses:
    return {row: setup.T_object_poses for row, setup in connected.items()}


def refine_setups(
    session: PlanSession, surface: PartSurface, setups: Mapping[int, PlannedSetup], M: Mapping[int, Measurability],
    views: Mapping[int, Ints], goal: float,
) -> tuple[dict[int, PlannedSetup], dict[int, Measurability], dict[int, Ints]]:  # fmt: skip
    """Move views of several set-ups so that fewer are needed; a view is needed for samples that no other view measures.

    Args:
        session: of the plan.
        surface: the part.
        setups: possible set-ups.
        M: their matrices, over the same rows.
        views: selected candidates of the used set-ups.
        goal: area of rows that they measure [m^2].

    Returns:
        Set-ups, matrices and views with the refined views as candidates; the input if no view can be spared.
    """
    used = list(views)
    setup_of = np.repeat(used, [len(views[row]) for row in used])
    selected = np.concatenate([views[row] for row in used])
    rows = M[used[0]].samples
    coverable_rows = np.logical_or.reduce([np.diff(each.indptr) > 0 for each in M.values()])
    areas = np.where(coverable_rows, rows.areas, 0.0)
    candidates = {row: setups[row].measured.candidates for row in used}
    before = ViewState(
        np.concatenate([candidates[row].T_object_scanner[views[row], 0] for row in used]),
        np.concatenate([candidates[row].standoff[views[row]] for row in used]),
        np.arange(len(selected)),
        np.zeros(len(selected), dtype=np.bool_),
        np.hstack([M[row].matrix().tocsc()[:, views[row]].toarray() for row in used]),
    )
    coverable = np.logical_or.reduce([setup.coverable for setup in setups.values()])

    def share_of(T_object_scanner: Floats, origin: Ints) -> float:
        poses = {row: T_object_scanner[setup_of[origin] == row][:, None] for row in used}
        seen = np.logical_or.reduce([setups[row].visible(T) for row, T in poses.items() if len(T)])
        return float(seen.sum() / (coverable | seen).sum())

    requested = setups[used[0]].settled.scene.plan.coverage
    least = max(min(requested + REFINED_MARGIN, 1.0), share_of(before.T_object_scanner, before.origin))
    evaluators = {row: setups[row].evaluator(rows) for row in used}
    after = reduce_views(
        before, RayTargets.of(rows.points, rows.normals), areas, lambda view: evaluators[int(setup_of[view])],
        goal=min(goal, float(areas[before.measured.any(axis=1)].sum())),
        shortfall=lambda state: least - share_of(state.T_object_scanner, state.origin),
    )  # fmt: skip
    known, matrices, left = dict(setups), dict(M), {row: np.array(columns) for row, columns in views.items()}
    if len(after) == len(before):
        return known, matrices, left
    for row in used:
        own = setup_of[after.origin] == row
        moved = own & after.moved
        kept = selected[after.origin[own & ~after.moved]]
        more = len(candidates[row]) + np.arange(int(moved.sum()))
        if moved.any():
            face = candidates[row].face[selected[after.origin[moved]]]
            known[row] = setups[row].with_viewpoints(session, surface, M[row], viewpoints_of(after, moved, face))
            matrices[row] = known[row].measured.M
        left[row] = np.concatenate([kept, more]).astype(np.int64)
    return known, matrices, {row: columns for row, columns in left.items() if len(columns)}


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
    first = None if options.first is None else Run.open_finished(Path(options.first))
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
    scene, given = scene_of_run(first), load_scene(None, tables, names)
    plan = {"pinned": (), "banned": ()} | {key: getattr(given.plan, key) for key in tables.get("plan", {})}
    if "coverage" in plan:
        plan["max_views"] = None
    placement = given.placement if "placement" in tables else scene.placement
    scene = scene.model_copy(update={"plan": scene.plan.model_copy(update=plan), "placement": placement})
    return scene if first.scene.table is None else _with_table_at(scene, first.scene.table.T_base_table)


def _plan_setups(
    outer: Session[None], session: PlanSession, settled: SettledScene, options: SetupOptions, first: Run | None
) -> Verdict:
    """Plan all set-ups into the open folder."""
    if first is not None and not _is_same_mesh(first.mesh("reference.ply"), settled.part.reference):
        raise UsageError(
            f"{first.folder} is a plan of the part {first.scene.part.name} with another mesh than {settled.part.name}; "
            "give a plan of the same part"
        )
    limit = (0 if settled.scene.setup else N_PROPOSED) if options.proposals is None else options.proposals
    surface, candidates, tried = _try_candidates(session, settled, limit, first)
    setups = {row: found for row, found in enumerate(tried) if isinstance(found, Setup)}
    if not any(len(setup.measured.M.indices) for setup in setups.values()):
        reason = next((found for found in tried if isinstance(found, str)), "no candidate measures anything")
        raise UnreachableError(
            f"none of the {len(candidates)} set-up candidates can be planned ({reason}); move the part"
        )
    _require_candidates(options, tried)
    with session.stage("select and connect"):
        request = SetupsRequest.of(session, settled.scene, options)
        search = SetupSearch(session, surface, setups, request)
        found, connected = search.solve()
        alternative = search.fewest_views(found)
        setups = search.setups
    visible = {row: setups[row].visible(setup.T_object_poses) for row, setup in connected.items()}
    seen = np.logical_or.reduce(list(visible.values()))
    for row, each in enumerate(candidates):
        if each.table is not None and row not in connected:
            session.note(f"the set-up '{each.name}' is omitted: {cause_of_omission(setups.get(row, tried[row]), seen)}")
    order = sorted(visible, key=lambda row: (candidates[row].run is None, -int(visible[row].sum()), row))
    for number, row in enumerate(order, start=1):
        _write_setup(outer, session, surface, setups[row], connected[row], session.folder.path / "setups" / str(number))
    used = [(row, visible[row]) for row in order]
    file = _setups_file(session, settled, request, setups, found, candidates, tried, used)
    views_first = None if alternative is None else ViewsFirst(setups=alternative[0], views=alternative[1])
    file = file.model_copy(update={"views_first": views_first})
    if settled.scene.plan.curve:
        with session.stage("coverage over views"):
            file = file.model_copy(update={"curve": search.curve(connected)})
            files.adopt_plots(session)
    session.folder.write_json("setups.json", file.as_json())
    session.folder.write_text("report.md", page(file))
    for number in unconnected_setups(file.shared, range(1, len(order) + 1)):
        session.note(
            f"the surface that set-up {number} shares with others does not determine the relative pose of its "
            "scans, and no candidate improves this; only the reference can align them"
        )
    reached = file.coverage
    return judge(
        "the set-ups measure",
        (reached.visible_of_coverable, reached.asked) if request.is_evaluated else None,
        (reached.visible, settled.scene.plan.required_visible),
        ("allow more set-ups, or request less", "allow more set-ups, or require less"),
    )


def _try_candidates(
    session: PlanSession, settled: SettledScene, limit: int, first: Run | None
) -> tuple[PartSurface, list[SetupCandidate], list[Setup | str]]:
    """Return the shared surface, the set-up candidates, and each as a set-up or the reason why it is not possible."""
    with session.stage("decimate and sample"):
        reference = settled.part.reference
        planning = decimate(reference, settled.settings.faces)
        viewpoints = generate_viewpoints(settled.scene, settled.settings, settled.part, planning)
        rows = surface_samples(settled.scene, reference, planning, session.rng(Stream.MATRIX_SAMPLES))
        surface = make_surface(reference, planning, rows)
        scouts = draw_samples(reference, planning, growth.N_SCOUTS, session.rng(Stream.SCOUTS))
        given = given_candidates(settled.scene)
        # If none is proposed, the placement of the scene is no set-up candidate.
        scenes = [settled.scene]
        if not limit:
            scenes = [settled.scene.model_copy(update={"placement": each.placement}) for each in given]
        settled, world = first_possible_cell([replace(settled, scene=scene) for scene in scenes], reference)
        settled = replace(settled, scene=with_fixed_table(settled.scene, world))
        fixed = [] if first is None else [_fixed_candidate(first)]
        candidates = _distinct([*fixed, *given, *proposed_candidates(world, reference, limit)])
        has_one_pose = len({candidate.name.split(",")[0] for candidate in candidates}) == 1 < limit
        if settled.scene.setup == () and has_one_pose:
            turned = ", turned," if len(candidates) > 1 else ""
            session.note(f"the part has no other stable pose: the only candidate is the part as it is placed{turned}")
    tried = [make_setup(session, settled, surface, world, each, viewpoints, scouts) for each in candidates]
    return surface, candidates, tried


def _is_same_mesh(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two meshes have the same faces and, up to the rounding of a file, the same vertices."""
    return np.array_equal(one.faces, other.faces) and np.allclose(one.vertices, other.vertices, rtol=0, atol=_SAME)


def _fixed_candidate(run: Run) -> SetupCandidate:
    placement = Placement.at(run.scene.T_base_object @ run.scene.T_object_centre)
    return SetupCandidate(f"as in the plan {run.folder}", placement, run=run)


def first_possible_cell(settled: Sequence[SettledScene], reference: TriangleMesh) -> tuple[SettledScene, World]:
    """Return the first scene that can be compiled, with its cell.

    Raises:
        SceneError: of the last scene, if none can be compiled.
    """
    for each in settled[:-1]:
        with suppress(SceneError):  # the set-up will be left out, with the reason
            return each, compile_settled(each, reference)
    return settled[-1], compile_settled(settled[-1], reference)


def _distinct(candidates: list[SetupCandidate]) -> list[SetupCandidate]:
    """Remove proposed candidates with the pose of an earlier one among the same fixtures."""
    kept: list[SetupCandidate] = []
    for candidate in candidates:
        is_known = (
            np.abs(candidate.placement.T - other.placement.T).max() < _SAME
            and not (other.table and other.table.fixtures)
            for other in kept
        )
        if candidate.table is not None or not any(is_known):
            kept.append(candidate)
    return kept


def _require_candidates(options: SetupOptions, tried: Sequence[Setup | str]) -> None:
    """Refuse pinned and banned candidates that do not exist, and pinned ones that are not reachable."""
    for setup, number in (*options.pins, *options.bans):
        name, found = format_candidate((setup, number)), tried[setup] if setup < len(tried) else ""
        if setup >= len(tried):
            raise UsageError(f"candidate {name}: there are {len(tried)} set-up candidates, 0 to {len(tried) - 1}")
        if not isinstance(found, Setup):
            raise UsageError(f"candidate {name}: set-up {setup} is not possible ({found}); name another")
        if number >= len(reachable := found.measured.reached.reachable):
            raise UsageError(f"candidate {name}: set-up {setup} has candidates 0 to {len(reachable) - 1}")
        if (setup, number) in options.pins and not reachable[number]:
            raise UsageError(f"candidate {name} is pinned, and the arm does not reach it; pin another")


def cause_of_omission(found: Setup | str, seen: Bools) -> str:
    """Explain why a set-up is not used, given the (S,) held-out samples that the others measure."""
    if isinstance(found, str):
        return found
    more = float((found.coverable & ~seen).mean())
    if not more:
        return "it measures nothing that the others do not measure"
    return f"the request is met without it (it can add {percent(more)} of the surface)"


def _write_setup(
    outer: Session[None], session: PlanSession, surface: PartSurface, setup: Setup, connected: ConnectedSetup,
    folder: Path,
) -> None:  # fmt: skip
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
            run.session.plots.part_ready(run.path)
        pipeline.compile_cell(run.session, run.settled, surface)
        files.write_measured(run.session.folder, problem)
        annotations = {
            "status": "one of several set-ups planned as one cover; setups.json has the bound on the number of views",
            "of_several": True,
        }
        pipeline.finish(run.session, run.settled, surface.planning, problem, plan, annotations)


def _setups_file(
    session: PlanSession, settled: SettledScene, request: SetupsRequest, setups: Mapping[int, Setup],
    found: GroupedCover, candidates: Sequence[SetupCandidate], tried: Sequence[Setup | str],
    used: Sequence[tuple[int, Bools]],
) -> SetupsFile:  # fmt: skip
    chosen, seen = [], np.zeros_like(used[0][1])
    for number, (row, visible) in enumerate(used, start=1):
        run = Run.open_finished(session.folder.path / "setups" / str(number))
        marginal = float((visible & ~seen).mean())
        seen = seen | visible
        chosen.append(
            ChosenSetup(
                folder=f"setups/{number}",
                digest=run.digest,
                offered=row,
                views=len(run.q),
                visible=float(visible.mean()),
                adds=marginal,
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
            asked=settled.scene.plan.coverage,
            required=settled.scene.plan.required_visible,
        ),
        status=status(found, len(candidates), request.request.targets),
        setups_bound=found.group_bound,
        views=sum(each.views for each in chosen),
        views_bound=found.view_bound,
        seconds=None if found.cost_and_bound is None else found.cost_and_bound[0],
        seconds_bound=None if found.cost_and_bound is None else found.cost_and_bound[1],
        kept=None if request.needs_one_view else found.share,
        regions=tuple(_regions(settled.scene, samples, seen, coverable)),
        chosen=tuple(chosen),
        offered=tuple(_offered_setup(*each) for each in zip(candidates, tried, strict=True)),
        shared=shared_surfaces({number: visible for number, (_, visible) in enumerate(used, start=1)}, samples),
        open=uncovered_surface(session, setups, [row for row, _ in used], seen),
    )


def _regions(scene: Scene, samples: SurfaceSamples, seen: Bools, coverable: Bools) -> Iterator[SetupsRegion]:
    """Yield the coverage of each region that counts."""
    for number, wishes in enumerate(with_rest(scene.region)):
        own = samples.region == number
        if wishes.is_measured and np.any(own):
            visible, share = float(seen[own].mean()), float(coverable[own].mean())
            yield SetupsRegion(
                name=wishes.name,
                asked=scene.plan.coverage if wishes.coverage is None else wishes.coverage,
                visible=visible,
                coverable=share,
                visible_of_coverable=visible / share if share else 1.0,
            )


def _offered_setup(candidate: SetupCandidate, found: Setup | str) -> OfferedSetup:
    is_possible = isinstance(found, Setup)
    return OfferedSetup(
        name=candidate.name,
        placement_mm=candidate.placement.position_mm,
        placement_abc_deg=candidate.placement.abc_deg,
        reachable=int(found.measured.reached.reachable.sum()) if isinstance(found, Setup) else 0,
        coverable=float(found.coverable.mean()) if isinstance(found, Setup) else 0.0,
        in_contact=float(found.contact.mean()) if isinstance(found, Setup) else 0.0,
        left_out="" if is_possible else str(found),
    )


def uncovered_surface(
    session: PlanSession, setups: Mapping[int, Setup], used: Sequence[int], seen: Bools
) -> PlannedOpen:
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
    rest = np.flatnonzero(~seen & ~has_candidate & ~contact)
    rng = session.rng(Stream.ATTAINABLE_SAMPLES)
    some = np.sort(rng.permutation(rest)[: session.effort.searched_samples])
    measured, visible = np.zeros(len(some), dtype=np.bool_), np.zeros(len(some), dtype=np.bool_)
    for row in used:
        if not isinstance(setup := setups[row], PlannedSetup):
            continue
        free = np.flatnonzero(~setup.contact[some] & ~measured)
        searched = pick_samples(samples, some[free])
        targets = RayTargets.of(searched.points, searched.normals, searched.region)
        found = probe_attainable(targets, setup.evaluator(searched))
        measured[free] |= found.measured
        visible[free] |= found.visible
    left = len(rest) / len(samples)  # samples stand for equal areas
    out_of_reach, other_poses, out_of_sight = (
        estimated_share(hits, len(rest)) for hits in (visible & ~measured, measured, ~visible)
    )
    return PlannedOpen(
        not_asked=float(has_candidate.mean()),
        in_contact=float(contact.mean()),
        out_of_reach=left * out_of_reach.value,
        other_poses=left * other_poses.value,
        out_of_sight=left * out_of_sight.value,
        standard_error=left * max(out_of_reach.standard_error, other_poses.standard_error, out_of_sight.standard_error),
    )
