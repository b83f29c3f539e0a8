"""Cycle time of plans: an earlier version, RoboTSP, and the current ordering with exchanged views.

Each seeded scene (part, placement, fixtures; `benchmarks.seeded_scenes`) is covered once, in full. Two methods order
and connect the same cover, with certified paths and jerk-limited moves, and are compared with measurements of a third:

- before: the order before generalised tours were searched by ruin and recreate and views were exchanged: a Christofides
  tour in task space improved by 2-opt, or-opt and double bridges with 10,000 evaluations (exact for few views), one
  tour inspected in each of 60 rounds. Its numbers are frozen in `BEFORE_S`; they are comparable as long as the cover of
  the scene has the same number of views, which is listed with them;
- RoboTSP: a tour through the scanner's positions, best configurations along it by dynamic programming (Suarez-Ruiz,
  Lembono and Pham 2018, doi:10.1109/ICRA.2018.8460581). Its tour gets 10,000 steps of our own search;
- now: the current ordering after the exchange of views (`planner.tour.equivalent_views`), as `cell plan` does it.

The bounds are on straight moves: for `before` on the views of the cover, for `now` on all remaining alternatives.

SCAN_CELL_SCENES (default 4) is the number of scenes; the full form has 20.
"""

import os
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.seeded_scenes import content
from cell.errors import SceneError
from cell.scene.model import Scene
from cell.study.prepared_part import Bench
from cell.world.collision import MujocoCollisionChecker
from cell.world.occluders import fixed_occluders, make_caster
from planner import cover
from planner.kinematics import reach
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import apply_occluders
from planner.tour import equivalent_views, generalised_tsp
from planner.tour import orderings as order
from planner.tour.tour import Tour, plan_tour
from planner.tour.tour_search import DEFAULT_BUDGET, MotionBudget
from planner.tour.visits import TourProblem, Visits

BEFORE_S = (
    (10, 8.690), (10, 10.254), (27, 22.021), (9, 15.411), (10, 11.494), (9, 7.660), (13, 11.782), (11, 11.627),
    (30, 19.784), (11, 10.996), (11, 12.019), (14, 16.076), (11, 15.921), (8, 9.683), (32, 24.544), (10, 17.490),
    (12, 18.179), (12, 11.952), (7, 8.149), (10, 11.171),
)  # fmt: skip
"""For scenes 0 to 19: views of the cover and cycle time of the earlier order [s]; it dropped no view."""

_SIMPLE = MotionBudget(rounds=60, quick=10, inspections=0, guess_checks=1_000_000, polish=0, guesses=((1.1, 0.35),))
"""Budget of the compared methods: one tour inspected in each of 60 rounds, a lower guess, no polish."""

_FACES, _ROLLS_DEG, _LEAST = 200, (0.0, 45.0, 90.0, 135.0), 40


def run() -> list[dict[str, Any]]:
    """Return a row for each scene and one with the means."""
    rows = [_row(number) for number in range(int(os.environ.get("SCAN_CELL_SCENES", "4")))]
    ratios = {key: [row[key] for row in rows if row[key] != ""] for key in rows[0] if "/" in key}
    mean = {key: float(np.mean(values)) for key, values in ratios.items()}
    worst = {key: float(np.max(values)) for key, values in ratios.items()}
    return [*rows, {"scene": "mean", **mean}, {"scene": "worst", **worst}]


def _row(number: int) -> dict[str, Any]:
    bench, reached, M, selection = _covered(number)
    world = bench.world
    checker, candidates = MujocoCollisionChecker(world), bench.candidates
    home_pose = world.kinematics.forward(world.home[None])[0] @ world.T_flange_scanner

    def motion(
        groups: list[Any], views: Any, ordering: order.Ordering, budget: MotionBudget = DEFAULT_BUDGET
    ) -> tuple[Tour, float]:
        begin = perf_counter()
        configurations = [np.concatenate([reached.configurations_of(int(v)) for v in group]) for group in groups]
        poses = world.T_base_object @ candidates.T_object_scanner[views, 0]
        visits = Visits(configurations, world.home, poses, home_pose)
        tour = plan_tour(visits, checker, world.limits, np.random.default_rng(number), budget, ordering=ordering)
        return tour, perf_counter() - begin

    alone = [selection.views[k : k + 1] for k in range(len(selection.views))]
    robotsp, _ = motion(alone, selection.views, task_space, _SIMPLE)
    search = order.order_views(
        TourProblem.straight(
            [reached.configurations_of(int(view)) for view in selection.views], world.home, world.limits
        ),
        world.T_base_object @ candidates.T_object_scanner[selection.views, 0],
        np.random.default_rng(number),
        T_base_home=home_pose,
    )
    begin = perf_counter()
    matrix = equivalent_views.VisibilityIndex(M.matrix(), M.samples.areas, np.asarray(reached.reachable))
    found = equivalent_views.exchange_views(
        matrix, selection.views, reached.configurations_of, world.home, world.limits, np.random.default_rng(number)
    )
    exchange_s = perf_counter() - begin
    now, now_s = motion(list(found.groups), found.views, order.order_views)
    if now.duration > found.duration_before:
        own, own_s = motion(alone, selection.views, order.order_views)
        now, now_s = min(now, own, key=lambda tour: (len(tour.dropped), tour.duration)), now_s + own_s
    views_before, before = BEFORE_S[number] if number < len(BEFORE_S) else ("", 0.0)
    return {
        "scene": f"{number} {bench.scene.part.name}",
        "views": len(selection.views),
        "views before": views_before,
        "before s": before or "",
        "RoboTSP s": robotsp.duration,
        "now s": now.duration,
        "dropped": len(now.dropped),
        "detours": int(now.detour.sum()),
        "now/before": now.duration / before if before else "",
        "now/RoboTSP": now.duration / robotsp.duration,
        "before/its bound": before / search.lower_bound if before else "",
        "now/its bound": now.duration / now.lower_bound,
        "exchange s": exchange_s,
        "now plan s": now_s,
    }


def _covered(number: int) -> tuple[Bench, reach.Reach, Measurability, cover.Cover]:
    """Return the first valid draw of a scene with enough reachable candidates, and its cover."""
    for draw in range(40):
        tables = content(number, draw)
        tables["plan"] = {"rolls_deg": list(_ROLLS_DEG), "faces": _FACES, "collision": "hull"}
        try:
            bench = Bench(Scene.model_validate(tables), samples=1000)
            world = bench.world
        except SceneError:
            continue
        checker = MujocoCollisionChecker(world)
        if not checker.free(world.home[None])[0]:
            continue
        candidates = bench.candidates
        reached = reach.solve_reach(candidates, world.T_base_object, world.T_flange_scanner, world.kinematics, checker)
        if reached.reachable.sum() < _LEAST:
            continue
        M = bench.matrix("aimed", candidates)
        caster = make_caster(fixed_occluders(world))
        M = apply_occluders(M, candidates, bench.scanner, caster, ray_caster=bench.caster)
        selection = cover.solve(
            cover.CoverProblem(M.matrix(), M.samples.areas, reached.reachable), rng=np.random.default_rng(number)
        )
        if len(selection.views) >= 2:
            return bench, reached, M, selection
    raise RuntimeError(f"no draw of scene {number} can be used")


def task_space(
    problem: TourProblem, T_base_scanner: Any, rng: np.random.Generator, **arguments: Any
) -> order.OrderedViews:
    """Order like RoboTSP, with the signature of `planner.tour.orderings.order_views`."""
    positions = np.concatenate((arguments["T_base_home"][None, :3, 3], T_base_scanner[:, :3, 3]))
    lengths = np.linalg.norm(positions[:, None] - positions, axis=2)
    task = generalised_tsp.make_instance(lengths, np.arange(len(positions) + 1))
    tour = generalised_tsp.solve(task, np.arange(1, len(positions)), rng, 10_000, 0).tour
    joint = problem.instance()
    duration, nodes = generalised_tsp.best_nodes(joint, tour[1:])
    views = joint.clusters_of(nodes)[1:]
    return order.OrderedViews(
        order=views - 1,
        choice=nodes[1:] - joint.first[views],
        q=problem.q[nodes[1:]],
        duration=duration,
        baseline_duration=duration,
        lower_bound=0.0,
        status=order.OrderStatus.HEURISTIC if duration < generalised_tsp.BLOCKED else order.OrderStatus.NO_TOUR,
    )
