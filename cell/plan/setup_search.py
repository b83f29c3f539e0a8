"""Search of the cover over several set-ups: fewest set-ups, then fewest views, each with a bound.

The cover over all candidates is connected in every set-up that it uses, and solved again without views that cannot be
connected. A coverage below 1 must also hold on held-out samples: if a cover misses it, fresh samples of the planning
faces on which it fails become rows of every set-up (as `cell.plan.selection` does for one), and if fresh samples show
nothing more, the target on the rows is raised.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array, hstack

from cell.errors import UnreachableError, UsageError
from cell.plan import pipeline, selection
from cell.plan.candidates import GROWN, PlanSession
from cell.plan.motion import ConnectedPlan, connect_views
from cell.plan.pose_search import draw_evaluated, effort_of, make_table, moved_viewpoints, poses_of
from cell.plan.selection import (
    PinnedViewError,
    RegionGroups,
    Request,
    SelectionProblem,
    pose_error,
    pose_probabilities,
    select_views,
)
from cell.plan.setup_candidates import FixedSetup, PlannedSetup, Setup
from cell.plan.setup_options import SetupOptions, format_candidate
from cell.plan.shared_surface import connecting_view
from cell.runs.schema import Curve
from cell.scene.model import Scene, with_rest
from cell.session import Stream
from cell.world.measurability import PartSurface
from cell.world.support_contact import in_contact
from planner.cover import CoverProblem, CoverStatus
from planner.cover.curve import coverage_curve
from planner.cover.grouped import GroupedCover, fewest_views, solve_grouped
from planner.cover.overlap import OverlapGraph
from planner.cover.robust import DEMAND, loads
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.matrix import Measurability, append_rows
from planner.measurability.pose_ensemble import ProbabilityLayer
from planner.values import Bools, Floats, Ints
from planner.viewpoints.pose_search import Place, SearchPoses, search_poses

REFINED_MARGIN = 0.0005
"""Share of the coverable area beyond the requested coverage: plans without moved views have as much on average."""

_MAX_COVERS = 20  # covers tried in all
_MAX_THOROUGH = 3  # searches for fewer views with the full budget
_RAISE_STEP = 0.0005  # share beyond the gap on held-out samples by which a target is raised


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
                layers[row] = pose_probabilities(plan, setup.measured, rng, lambda n_done, total: None)
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
            cover = self._cover(fast=True)
            # Before a motion is planned in vain; half of the tries are kept for views that cannot be connected.
            if 2 * left >= _MAX_COVERS and self._request_more(cover, self._poses(cover)):
                continue
            if (connected := self._connect(cover)) is None:
                continue
            last = cover, connected
            if not self._request_more(cover, _driven(connected)):
                break
        if last is None:
            raise UnreachableError(
                "no cover could be connected; move the part, or allow more set-up candidates with --proposals"
            )
        return self._with_shared_surface(*self._thorough(*last))

    def _thorough(self, solution: GroupedCover, connected: Connected) -> tuple[GroupedCover, Connected]:
        """Bound a cover with the full budget, and search for fewer views that hold the coverage.

        Fewer views that miss it are searched again with more rows or a higher target.
        """
        refined = self._refined(solution)
        bounded, others, before = None, [refined] if refined else [], (self._M.copy(), self._targets)
        for _ in range(_MAX_THOROUGH):
            thorough = self._cover(fast=False, start=(refined or solution).views)
            for better in sorted((thorough, *others), key=lambda cover: cover.objective):
                holds = (
                    better.objective < solution.objective and (self._deficit(better, self._poses(better)) <= 0).all()
                )
                plans = self._connect(better) if holds else None
                if plans is not None and (self._deficit(better, _driven(plans)) <= 0).all():
                    return better.with_bounds_of(thorough), plans  # of all set-ups and refined views
            bounded, others = bounded or solution.with_bounds_of(thorough), []  # later covers have higher targets
            if thorough.objective >= solution.objective or not self._request_more(thorough, self._poses(thorough)):
                break
        self._M, self._targets = before  # as they were requested
        return bounded or solution, connected

    def fewest_views(self, cover: GroupedCover) -> tuple[int, int] | None:
        """Return numbers of set-ups and views for the fewest views; None unless more set-ups save views.

        With as many set-ups, only views that connect scans make a difference.
        """
        problem = self._request.cover_problem(self._M, self._usable)
        other = fewest_views(problem, cover.targets, self._rng, self._session.effort.cover_work)
        saves = other is not None and other[0] > len(cover.views) and other[1] < cover.n_views
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
        return selection.minimum_views_of(curve)

    def _cover(self, *, fast: bool, start: Mapping[int, Ints] | None = None) -> GroupedCover:
        options = self._request.options
        return solve_grouped(
            self._request.cover_problem(self._M, self._usable), self._targets, self._rng, max_groups=options.max_setups,
            group_cost=options.setup_s, solver=self._request.request.plan.solver, fast=fast, start=start,
            effort_budget=self._session.effort.cover_work,
        )  # fmt: skip

    def _views(self, cover: GroupedCover) -> dict[int, Ints]:
        """Return the selected candidates of each used set-up; a cover numbers the possible set-ups from 0."""
        rows = list(self.setups)
        return {rows[group]: views for group, views in cover.views.items()}

    def _refined(self, cover: GroupedCover) -> GroupedCover | None:
        """Return the cover by fewer views, some of them refined; None if there is none."""
        rows = list(self.setups)
        setups = {row: setup for row, setup in self.setups.items() if isinstance(setup, PlannedSetup)}
        is_movable = all(
            setup.settled.scene.plan.candidates == GROWN and setup.measured.candidates.T_object_scanner.shape[1] == 1
            for setup in setups.values()
        )
        if not (self._request.allows_refinement and self._request.is_evaluated and is_movable):
            return None
        goal = float(cover.loads.target_weight[0])
        setups, self._M, views = search_setups(self._session, self._surface, setups, self._M, self._views(cover), goal)
        self.setups |= setups
        if sum(map(len, views.values())) == cover.n_views:
            return None
        for row, setup in setups.items():
            more = setup.measured.reached.reachable[len(self._usable[row]) :]
            self._usable[row] = np.concatenate([self._usable[row], more])
        return replace(cover, views={rows.index(row): columns for row, columns in views.items()})

    def _with_shared_surface(self, cover: GroupedCover, connected: Connected) -> tuple[GroupedCover, Connected]:
        """Add views until the shared surface fixes the scans of all set-ups relative to each other."""
        rows = list(self.setups)
        limit, seconds = self._request.request.plan.max_views, self._request.seconds
        usable = {
            row: mask if isinstance(self.setups[row], PlannedSetup) else np.zeros_like(mask)
            for row, mask in self._usable.items()
        }
        for _ in range(_MAX_COVERS if limit is None else limit - cover.n_views):
            if (more := connecting_view(self._M, usable, self._views(cover))) is None:
                break
            row, column = more
            larger = cover.with_view(rows.index(row), column, float(seconds[row][column]) if seconds else 0.0)
            plans = self._connect(larger)  # None: the candidate is no longer usable, and another is tried
            if plans is not None:
                cover, connected = larger, plans
        for row, setup in connected.items():
            plan = None if setup.planned is None else setup.planned[1]
            if self._request.request.plan.overlap_in_order and plan is not None and plan.selection.details is None:
                self._session.note(
                    f"the views of set-up candidate {row} are connected through other set-ups alone: they are visited "
                    "in the fastest order"
                )
        return cover, connected

    def _connect(self, cover: GroupedCover) -> Connected | None:
        """Plan the set-ups of a cover; None if a view cannot be connected, or arms hide too much."""
        try:
            connected = {row: self._plan(row, views) for row, views in self._views(cover).items()}
        except PinnedViewError:
            return None  # the candidate is no longer usable
        self._M |= {row: setup.matrix for row, setup in connected.items()}
        sums = sum(
            self._request.loads_of(row, setup.matrix)[:, setup.candidate].sum(axis=1)
            for row, setup in connected.items()
        )
        return connected if cover.is_met_by(np.asarray(sums).ravel()) else None

    def _poses(self, cover: GroupedCover) -> Poses:
        """Return the poses of the candidates of a cover."""
        return {
            row: self.setups[row].measured.candidates.T_object_scanner[views]
            for row, views in self._views(cover).items()
        }

    def _request_more(self, cover: GroupedCover, poses: Poses) -> bool:
        """If views miss the coverage, add rows or raise a target; return whether the next cover can be better."""
        deficit = self._deficit(cover, poses)
        if (deficit <= 0).all():
            return False
        self._rounds += 1
        if self._rounds <= selection.ROUNDS and self._add_rows(poses):
            return True
        if (self._targets[deficit > 0] >= 1).all():
            return False
        self._targets = np.where(deficit > 0, np.minimum(self._targets + deficit + _RAISE_STEP, 1.0), self._targets)
        return True

    def _deficit(self, cover: GroupedCover, poses: Poses) -> Floats:
        """Return the (P,) missing shares of the coverable held-out samples, for targets below 1.

        Coverable by all set-ups; by the used ones if the allowed number of set-ups is too small.
        """
        requested = self._request.request.targets
        if not self._request.is_evaluated:
            return np.zeros(len(requested))
        seen = np.logical_or.reduce([self.setups[row].visible(T) for row, T in poses.items()])
        counted = self.setups if cover.is_feasible else poses
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
        left = fresh.pick(~np.logical_or.reduce(seen))
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
        added = fresh.pick(np.isin(fresh.planning_face, left.planning_face[coverable]))
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
            return ConnectedSetup(np.arange(M.n_viewpoints), M, setup.measured.candidates.T_object_scanner)
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
        return ConnectedSetup(plan.candidate, plan.matrix, plan.driven.T_object_poses, (problem, plan))


def _driven(connected: Connected) -> Poses:
    return {row: setup.T_object_poses for row, setup in connected.items()}


def search_setups(
    session: PlanSession, surface: PartSurface, setups: Mapping[int, PlannedSetup], M: Mapping[int, Measurability],
    views: Mapping[int, Ints], goal: float,
) -> tuple[dict[int, PlannedSetup], dict[int, Measurability], dict[int, Ints]]:  # fmt: skip
    """Search fewer views over all reachable poses of the used set-ups (`planner.viewpoints.pose_search`).

    Args:
        session: of the plan.
        surface: the part.
        setups: possible set-ups.
        M: their matrices, over the same rows.
        views: selected candidates of the used set-ups.
        goal: area of rows that they measure [m^2].

    Returns:
        Set-ups, matrices and views with the moved views as candidates; the input if no view can be spared.
    """
    used, n_views = list(views), sum(map(len, views.values()))
    request = Request(setups[used[0]].settled.scene.plan, effort=session.effort)
    effort, rng = effort_of(request, n_views), session.rng(Stream.POSE_SEARCH)
    known, matrices, left = dict(setups), dict(M), {row: np.array(columns) for row, columns in views.items()}
    if not effort:
        return known, matrices, left
    rows, coverable = M[used[0]].samples, np.logical_or.reduce([setup.coverable for setup in setups.values()])
    reachable = {row: setups[row].measured.reached.reachable for row in used}
    samples, weights = draw_evaluated([(M[row], reachable[row]) for row in used], surface, n_views, rng)
    pools, places, initial = list[SearchPoses](), list[Place](), list[Ints]()
    for place, row in enumerate(used):
        measured, usable = setups[row].measured, np.flatnonzero(reachable[row])
        table = make_table(samples, measured.prediction).without(in_contact(samples, setups[row].supports))
        initial.append(np.searchsorted(usable, views[row]) + sum(map(len, pools)))
        pools.append(poses_of(measured.candidates, usable, place))
        places.append(Place(table, setups[row].are_reachable))
    pool = SearchPoses.join(pools)

    def poses_in(poses: SearchPoses, place: int) -> Floats:
        return np.asarray(poses.T_object_scanner[poses.place == place][:, None])

    def share_of(poses: SearchPoses) -> float:
        seen = np.logical_or.reduce([setups[row].visible(poses_in(poses, place)) for place, row in enumerate(used)])
        return float(seen.sum() / (coverable | seen).sum())

    def area_of(poses: SearchPoses) -> float:
        seen = [setups[row].measures(poses_in(poses, place), rows) for place, row in enumerate(used)]
        return float(rows.areas[np.logical_or.reduce(seen)].sum())

    begin = pool.pick(np.concatenate(initial))
    least = max(min(request.plan.coverage + REFINED_MARGIN, 1.0), share_of(begin))
    goal = min(goal, area_of(begin))

    def shortfall(poses: SearchPoses) -> float:
        missing = least - share_of(poses)
        return missing if missing > 0 else max(missing, (goal - area_of(poses)) / rows.areas.sum())

    best = search_poses(
        np.concatenate(initial), pool, places, weights / weights.sum(), shortfall=shortfall, effort=effort, rng=rng
    ).found[-1]
    if len(best) == n_views:
        return known, matrices, left
    for place, row in enumerate(used):
        poses, candidates = best.pick(best.place == place), setups[row].measured.candidates
        more = moved_viewpoints(poses, candidates.face)
        if len(more):
            known[row] = setups[row].with_viewpoints(session, surface, M[row], more)
            matrices[row] = known[row].measured.M
        left[row] = np.concatenate([poses.origin[~poses.moved], len(candidates) + np.arange(len(more))])
    return known, matrices, {row: columns for row, columns in left.items() if len(columns)}
