"""The cover over all set-ups, connected: tried, and tried again without what cannot be connected and with more samples.

A coverage below 1 is kept on the held-out samples: where a cover misses it, fresh samples on the planning faces that it
fails on become rows of every set-up (as `cell.plan.denser_samples` does for one), and where fresh samples show nothing
more the target on the rows is raised.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.sparse import hstack

from cell.errors import UnreachableError
from cell.plan import curve as curves
from cell.plan import denser_samples, steps
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import PinnedOutError
from cell.plan.problem import Problem as PlanProblem
from cell.plan.steps import PlanSession
from cell.plan.view_plan import choose_and_connect, first_choice
from cell.runs.schema import Curve
from cell.session import Stream
from cell.setups.measured import Setup
from cell.setups.moved import movable, with_fewer
from cell.setups.options import named
from cell.setups.shared import joining
from cell.setups.wishes import Asked
from cell.world.measurability import PartSurface
from planner.cover import CoverProblem, CoverStatus
from planner.cover.curve import coverage_curve
from planner.cover.grouped import GroupedCover, fewest_views, solve_grouped
from planner.cover.overlap import OverlapGraph
from planner.geometry.sampling import draw_samples, pick_samples
from planner.measurability.matrix import append_rows
from planner.values import Floats, Ints

_TRIES = 20  # covers in all
_AGAIN = 3  # times that fewer views are searched for with all work
_STEP = 0.0005  # beyond the gap that the held-out samples show, as `cell.plan.request` raises a target

Connected = Mapping[int, tuple[PlanProblem, ConnectedPlan]]
Poses = Mapping[int, Floats]
"""Of each set-up that is used, (n, K, 4, 4) views in the object frame [m]."""


class Search:
    """What is known while covers are tried.

    Args:
        session: of the open run.
        surface: the part.
        setups: the possible ones, by their rows among those offered.
        asked: of all of them together.
    """

    def __init__(self, session: PlanSession, surface: PartSurface, setups: Mapping[int, Setup], asked: Asked) -> None:
        self._session, self._surface, self._asked = session, surface, asked.about(session, setups)
        self._setups = dict(setups)
        self._M = {row: setup.measured.M for row, setup in setups.items()}  # as the arms leave it
        self._usable = {row: np.array(setup.measured.reached.reachable) for row, setup in setups.items()}
        for row, column in asked.own.bans:
            self._usable[row][column] = False
        self._targets, self._rounds = asked.request.asked, 0
        self._spread = next(iter(setups.values())).prediction.samples
        self._fresh = session.rng(Stream.FRESH_SAMPLES)
        self._chooses = session.rng(Stream.SELECTION)

    def result(self) -> tuple[GroupedCover, Connected]:
        """The cover, and the plan of each set-up that it uses; the last one tried where none keeps the coverage.

        Covers are tried by short searches; bounds, and perhaps fewer views, are from the last one on.

        Raises:
            UnreachableError: if none could be connected.
        """
        last = None
        for left in reversed(range(_TRIES)):
            found = self._cover(brief=True)
            # Before a motion is planned for nothing; half of the tries are left for views that cannot be connected.
            if 2 * left >= _TRIES and self._asks_more(found, self._chosen(found)):
                continue
            if (connected := self._connected(found)) is None:
                continue
            last = found, connected
            if not self._asks_more(found, _driven(connected)):
                break
        if last is None:
            raise UnreachableError("no cover could be connected; move the part, or allow other set-ups with --offer")
        return self._held_together(*self._thorough(*last))

    def _thorough(self, found: GroupedCover, connected: Connected) -> tuple[GroupedCover, Connected]:
        """A cover with its bound, by all work that there is; of fewer views where some keep the coverage.

        Fewer that miss it are searched for again, with more samples or a higher target.
        """
        moved = self._moved(found)
        bounded, others, before = None, [moved] if moved else [], (self._M.copy(), self._targets)
        for _ in range(_AGAIN):
            thorough = self._cover(brief=False, start=(moved or found).views)
            for better in sorted((thorough, *others), key=lambda one: one.objective):
                keeps = better.objective < found.objective and (self._lacks(better, self._chosen(better)) <= 0).all()
                plans = self._connected(better) if keeps else None
                if plans is not None and (self._lacks(better, _driven(plans)) <= 0).all():
                    return better.with_bounds_of(thorough), plans  # which knows all set-ups, and moved views too
            bounded, others = bounded or found.with_bounds_of(thorough), []  # later ones are asked for more
            if thorough.objective >= found.objective or not self._asks_more(thorough, self._chosen(thorough)):
                break
        self._M, self._targets = before  # as they were asked for
        return bounded or found, connected

    def views_first(self, found: GroupedCover) -> tuple[int, int] | None:
        """Set-ups and views where fewest views come first and no motion is planned; None but for fewer in more set-ups.

        In as many, the views that hold scans together may alone make the difference.
        """
        told = fewest_views(self._asked.problem(self._M, self._usable), found.targets, self._chooses)
        return told if told is not None and told[0] > len(found.views) and told[1] < found.n_views else None

    def curve(self, connected: Connected) -> Curve:
        """Coverage over the number of views in the set-ups of a cover, written to the folder.

        What they can measure is all of it; pinned views stay and banned ones are left out, as in the curve of a plan.
        """
        names = [(row, column) for row, (_, plan) in connected.items() for column in range(plan.matrix.n_viewpoints)]
        place = {name: column for column, name in enumerate(names)}
        views = [place[row, int(column)] for row, (_, plan) in connected.items() for column in plan.candidate]
        matrix = hstack([plan.matrix.matrix() for _, plan in connected.values()], format="csc")
        areas = next(iter(connected.values()))[1].matrix.samples.areas
        # Views that were moved after these plans are candidates behind theirs.
        allowed = np.concatenate(
            [self._usable[row][: plan.matrix.n_viewpoints] for row, (_, plan) in connected.items()]
        )
        wish = CoverProblem(matrix, areas, allowed, pinned=[place[name] for name in self._asked.own.pins])
        curve = coverage_curve(
            wish,
            rng=self._session.rng(Stream.COVERAGE_CURVE),
            known_selections=[views],
            effort_budget=self._session.effort.curve_work,
        )
        covered = float(areas[np.asarray(matrix[:, views].sum(axis=1)).ravel() > 0].sum())
        curves.write(self._session.folder, self._session.plots, curve, len(views), covered, lambda k: named(names[k]))
        return curves.fewest_of(curve)

    @property
    def setups(self) -> Mapping[int, Setup]:
        """The set-ups with what has become a candidate since."""
        return self._setups

    def _cover(self, *, brief: bool, start: Mapping[int, Ints] | None = None) -> GroupedCover:
        own, plan = self._asked.own, self._asked.request.plan
        return solve_grouped(
            self._asked.problem(self._M, self._usable), self._targets, self._chooses, max_groups=own.most,
            group_cost=own.setup_s, solver=plan.solver, fast=brief, start=start,
        )  # fmt: skip

    def _moved(self, found: GroupedCover) -> GroupedCover | None:
        """The cover by fewer views, of which some were moved and are candidates from here on; None where none can."""
        rows = list(self._setups)
        if not (self._asked.plain and self._asked.promises and movable(self._setups)):
            return None
        chosen = {rows[index]: views for index, views in found.views.items()}
        self._setups, self._M, views = with_fewer(
            self._session, self._surface, self._setups, self._M, chosen, float(found.loads.wanted[0])
        )
        if sum(map(len, views.values())) == found.n_views:
            return None
        for row, setup in self._setups.items():
            more = setup.measured.reached.reachable[len(self._usable[row]) :]
            self._usable[row] = np.concatenate([self._usable[row], more])
        return replace(found, views={rows.index(row): columns for row, columns in views.items()})

    def _held_together(self, found: GroupedCover, connected: Connected) -> tuple[GroupedCover, Connected]:
        """With the views without which what set-ups share would leave their scans free to move against each other."""
        rows = list(self._setups)
        most, seconds = self._asked.request.plan.max_views, self._asked.seconds
        for _ in range(_TRIES if most is None else most - found.n_views):
            views = {rows[index]: columns for index, columns in found.views.items()}
            if (more := joining(self._M, self._usable, views)) is None:
                break
            row, column = more
            index = rows.index(row)
            held = found.with_view(index, column, float(seconds[row][column]) if seconds else 0.0)
            plans = self._connected(held)  # None: the candidate is usable no more, and another is tried
            if plans is not None:
                found, connected = held, plans
        for row, (problem, plan) in connected.items():
            if problem.request.plan.overlap_in_order and plan.selected.answer is None:
                self._session.note(
                    f"the views of set-up {row} of those offered hang together through other set-ups alone: they are "
                    "visited in the fastest order"
                )
        return found, connected

    def _connected(self, found: GroupedCover) -> Connected | None:
        """The plans of a cover's set-ups; None where a view cannot be connected, or arms leave less than was asked."""
        rows = list(self._setups)
        try:
            plans = {rows[index]: self._plan(rows[index], views.tolist()) for index, views in found.views.items()}
        except PinnedOutError:
            return None  # its candidate is usable no more
        self._M |= {row: plan.matrix for row, (_, plan) in plans.items()}
        brought = sum(
            self._asked.brought(row, plan.matrix)[:, plan.candidate].sum(axis=1) for row, (_, plan) in plans.items()
        )
        return plans if found.is_met_by(np.asarray(brought).ravel()) else None

    def _chosen(self, found: GroupedCover) -> Poses:
        """The poses of a cover's views as its candidates have them."""
        rows = list(self._setups)
        return {
            rows[index]: self._setups[rows[index]].measured.candidates.T_object_scanner[views]
            for index, views in found.views.items()
        }

    def _asks_more(self, found: GroupedCover, poses: Poses) -> bool:
        """Whether views miss the coverage and more could be asked: samples were added, or a target raised."""
        lacks = self._lacks(found, poses)
        if (lacks <= 0).all():
            return False
        self._rounds += 1
        if self._rounds <= denser_samples.ROUNDS and self._add_rows(poses):
            return True
        if (self._targets[lacks > 0] >= 1).all():
            return False
        self._targets = np.where(lacks > 0, np.minimum(self._targets + lacks + _STEP, 1.0), self._targets)
        return True

    def _lacks(self, found: GroupedCover, poses: Poses) -> Floats:
        """(P,) share of what can be measured of the held-out samples by which a coverage below 1 is missed.

        What can be measured by all set-ups; by those that are used where so many as are allowed are too few.
        """
        asked = self._asked.request.asked
        if not self._asked.promises:
            return np.zeros(len(asked))
        seen = np.logical_or.reduce([self._setups[row].visible(T) for row, T in poses.items()])
        used = self._setups if found.is_feasible else poses
        can = np.logical_or.reduce([self._setups[row].coverable for row in used]) | seen
        shares = self._asked.shares(next(iter(self._setups.values())).prediction.samples, seen, can)
        return np.where(asked < 1, asked - shares, 0.0)

    def _add_rows(self, poses: Poses) -> bool:
        """Whether fresh samples showed what a candidate measures and no view: rows of every set-up then.

        Where faces are rows, samples cannot be added to them.
        """
        if self._asked.request.plan.fill != "aimed":
            return False
        fresh = draw_samples(self._surface.reference, self._surface.planning, denser_samples.FRESH, self._fresh)
        seen = [self._setups[row].measures(T, fresh) for row, T in poses.items()]
        left = pick_samples(fresh, ~np.logical_or.reduce(seen))
        if not len(left):
            return False
        can = np.logical_or.reduce(
            [
                setup.measures(setup.measured.candidates.T_object_scanner[self._usable[row]], left)
                for row, setup in self._setups.items()
            ]
        )
        if not can.any():
            return False
        faces = left.planning_face[can]
        added = pick_samples(fresh, np.isin(fresh.planning_face, faces))
        self._M = {
            row: append_rows(self._M[row], setup.rows_of(added), self._spread) for row, setup in self._setups.items()
        }
        return True

    def _plan(self, row: int, views: list[int]) -> tuple[PlanProblem, ConnectedPlan]:
        """The views of one set-up with the motion through them.

        Raises:
            PinnedOutError: if one of them cannot be connected, which is usable no more then.
        """
        setup = self._setups[row]
        scene = setup.job.scene
        given = scene.plan.of_views(views, len(setup.measured.reached)).ordered_as(scene.plan)
        asked = replace(setup.job, scene=scene.model_copy(update={"plan": given}))
        measured = replace(setup.measured, M=self._M[row])
        problem = steps.ask(self._session, asked, setup.cell, measured, setup.prediction)
        chooses = self._session.rng(Stream.SELECTION)
        try:
            chosen = choose_and_connect(
                problem,
                first_choice(problem, chooses),
                selection_rng=chooses,
                motion_rng=self._session.rng(Stream.MOTION),
            )
        except PinnedOutError as error:
            if (row, error.candidate) in self._asked.own.pins:
                name = named((row, error.candidate))
                raise UnreachableError(
                    f"candidate {name} is pinned and cannot be part of a motion: {error.reason}; pin another"
                ) from error
            self._usable[row][error.candidate] = False
            raise
        cover = replace(chosen.cover, lower_bound=1, status=CoverStatus.BOUNDED, solver="joint")
        problem = problem.taking(chosen.candidate, chosen.tour.q)
        how = chosen.selected.answer
        if isinstance(how, OverlapGraph) and not how.is_connected:
            how = None  # through views of other set-ups all may hang together; it is not told of these alone
        return problem, replace(
            chosen, cover=cover, selected=replace(chosen.selected, targets=self._targets, answer=how)
        )


def _driven(connected: Connected) -> Poses:
    """The poses as they are driven."""
    return {row: plan.T_object_poses for row, (_, plan) in connected.items()}
