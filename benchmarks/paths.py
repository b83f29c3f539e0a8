"""Collision-free paths on seeded scenes: success of RRT-Connect compared with ompl over the same certified edges.

In each scene two pairs of reachable set-points with a blocked straight move are drawn: any two, and two of the twelve
(more if that is too few) closest to an obstacle. `planner.path.path.connect` searches with its default budget, then, if
it fails, with `_LONG` checks. ompl (RRTConnect, its own tree and sampling, edges certified by
`planner.path.certified_edge` like ours) searches for `_SECONDS` if ours failed, and on every fifth scene for
comparison. ompl is no dependency of the project: `pip install ompl`.

SCAN_CELL_SCENES (default 20) is the number of scenes; with SCAN_CELL_PATHS=FILE finished scenes are stored as lines of
JSON, and an interrupted call continues after them. The full form has 100 scenes.
"""

import json
import os
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.seeded_scenes import SeededCell, usable
from planner.path.certified_edge import certify
from planner.path.path import PathStatus, connect, path_time
from planner.values import Floats

_LONG = 1_000_000  # checks
_SECONDS = 60.0
_PAIRS = 400  # drawn until a straight move is blocked
_COMPARED = 5
_N_DRAWN, _NEAREST = 200, 12
_CASES = ("any", "near something")


def run() -> list[dict[str, Any]]:
    """Return for each case one row over all scenes and one for each scene that the default budget did not solve."""
    count = int(os.environ.get("SCAN_CELL_SCENES", "20"))
    records_file = Path(os.environ["SCAN_CELL_PATHS"]) if "SCAN_CELL_PATHS" in os.environ else None
    records = (
        [json.loads(line) for line in records_file.read_text().splitlines()]
        if records_file and records_file.exists()
        else []
    )
    for number, case in product(range(count), _CASES):
        if any((row["scene"], row["case"]) == (number, case) for row in records):
            continue
        records.append(searched(number, case))
        if records_file:
            with records_file.open("a") as file:
                file.write(json.dumps(records[-1]) + "\n")
    return [
        row for case in _CASES for row in _summary([r for r in records if r["scene"] < count and r["case"] == case])
    ]


def _summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row over all, and those that the default budget did not solve."""
    both = [row for row in rows if row["ompl"] == "found" and row["found"] != "no"]
    either = [row for row in rows if row["ompl"] == "found" or row["found"] != "no"]
    summary = {
        "scene": f"{len(rows)} scenes",
        "case": rows[0]["case"],
        "found": f"{sum(row['found'] == 'default' for row in rows)} at the default budget, "
        f"{sum(row['found'] == 'long' for row in rows)} at {_LONG:,} checks",
        "of those that ompl or ours solve": f"{sum(row['found'] != 'no' for row in rows)} of {len(either)}",
        "checks": int(np.median([row["checks"] for row in rows])),
        "s": float(np.median([row["s"] for row in rows])),
        "via": float(np.mean([row["via"] for row in rows if row["via"]])),
        "path s": float(np.mean([row["path s"] for row in both])) if both else float("nan"),
        "ompl": f"{len(both)} compared",
        "ompl s": float(np.median([row["ompl s"] for row in both])) if both else float("nan"),
        "ompl via": float(np.mean([row["ompl via"] for row in both])) if both else float("nan"),
        "ompl path s": float(np.mean([row["ompl path s"] for row in both])) if both else float("nan"),
    }
    return [summary, *(row for row in rows if row["found"] != "default")]


def searched(number: int, case: str) -> dict[str, Any]:
    """Search for one pair of one scene, with ompl too if ours fails or for comparison."""
    cell = usable(number, least=4)
    q_from, q_to = _blocked_pair(cell, case)
    begin = perf_counter()
    result, found = connect(q_from, q_to, cell.checker, cell.world.limits, _rng(number)), "default"
    if result.status is PathStatus.NO_PATH_FOUND:
        found = "long"
        result = connect(q_from, q_to, cell.checker, cell.world.limits, _rng(number), _LONG)
    seconds = perf_counter() - begin
    if result.via is None:
        found = "no"
    row = {
        "scene": number,
        "case": case,
        "found": found,
        "checks": result.checks,
        "s": seconds,
        "via": 0 if result.via is None else len(result.via),
        "path s": result.duration if result.via is not None else None,
        "ompl": "",
    }
    if found != "default" or number % _COMPARED == 0:
        begin = perf_counter()
        via = by_ompl(cell, q_from, q_to, _SECONDS, number)
        row |= {
            "ompl": "not found" if via is None else "found",
            "ompl s": perf_counter() - begin,
            "ompl via": 0 if via is None else len(via),
            "ompl path s": None if via is None else path_time(via, cell.world.limits),
        }
    return row


def _rng(number: int) -> np.random.Generator:
    return np.random.default_rng([number, 1])


def _blocked_pair(cell: SeededCell, case: str) -> tuple[Floats, Floats]:
    """Return two set-points of different views with a blocked straight move."""
    rng, q = np.random.default_rng(cell.number), cell.reach.q
    view = np.repeat(np.arange(len(cell.reach)), np.diff(cell.reach.offsets))
    order = np.arange(len(q))
    if case == "near something":
        order = rng.choice(len(q), min(len(q), _N_DRAWN), replace=False)
        order = order[np.argsort(cell.checker.distance(q[order])[0])]
    few = len(order) if case == "any" else _NEAREST
    while few <= 2 * len(order):  # more if all moves between the nearest are free
        for _ in range(_PAIRS):
            i, j = order[rng.integers(0, min(few, len(order)), 2)]
            if view[i] != view[j] and not certify(q[i], q[j], cell.checker)[0]:
                return q[i], q[j]
        few *= 2
    raise RuntimeError(f"scene {cell.number} has no blocked move among {_PAIRS}")


def by_ompl(cell: SeededCell, q_from: Floats, q_to: Floats, seconds: float, seed: int) -> Floats | None:
    """Return an (m, 6) path of ompl's RRTConnect and its simplifier over certified edges, or None in the given time."""
    from ompl import base, geometric, util

    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    space, bounds = base.RealVectorStateSpace(6), base.RealVectorBounds(6)
    for axis, (low, high) in enumerate(zip(cell.world.limits.lower, cell.world.limits.upper, strict=True)):
        bounds.setLow(axis, float(low))
        bounds.setHigh(axis, float(high))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)

    def angles(state: Any) -> Floats:
        return np.array([state[axis] for axis in range(6)])

    class Certified(base.MotionValidator):  # type: ignore[misc, unused-ignore] - ompl has no types
        def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802 - ompl's name
            return certify(angles(a), angles(b), cell.checker)[0]

    validator = Certified(information)
    information.setStateValidityChecker(lambda state: bool(cell.checker.free(angles(state)[None])[0]))
    information.setMotionValidator(validator)
    information.setup()
    ends = [space.allocState() for _ in range(2)]
    for state, q in zip(ends, (q_from, q_to), strict=True):
        for axis in range(6):
            state[axis] = float(q[axis])
    problem = base.ProblemDefinition(information)
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    if not planner.solve(seconds) or not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    geometric.PathSimplifier(information).simplify(path, 1.0)
    return np.array([angles(path.getState(k)) for k in range(path.getStateCount())])
