"""Several set-ups of every part: one joint cover, one set-up after the other, and the ceiling of any pose.

The parts of benchmarks/parts.py, each with `cell setups` at its defaults (24 poses offered). *One after the other*
selects the set-up that measures most, then the one that adds most, until the same area is measured; each is covered by
itself for the remaining area. It uses the same candidates, including those to which views were moved, and the same
samples. *Views first* selects the fewest of all poses that some set-up reaches, then the fewest set-ups in which these
poses measure the same area. The *ceiling* is the share that any scanner pose could measure of the part without
supports, regardless of the reach of the arm. SCAN_CELL_PART runs parts of one name only.
"""

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.parts import parts, place
from cell import api
from cell.errors import CellError
from cell.plan import setup_search
from cell.plan import setups as planning
from cell.runs.cell import read_cell
from cell.world.prediction import held_out_samples
from planner import cover
from planner.cover import CoverProblem
from planner.cover.grouped import GroupedCover, GroupLoads, fewest_groups, solve_grouped
from planner.values import Floats
from planner.viewpoints.attainable import N_PROBED_SAMPLES, probe_attainable
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets


def run() -> list[dict[str, Any]]:
    """Return one row for each part."""
    with tempfile.TemporaryDirectory() as scratch:
        only = os.environ.get("SCAN_CELL_PART", "")
        return [_row(name, words, Path(scratch)) for name, words in parts(Path(scratch)) if only in name]


def _row(name: str, words: tuple[str, ...], folder: Path) -> dict[str, Any]:
    options_of_part: dict[str, object] = {"place": place()} | ({"units": words[2]} if len(words) > 1 else {})
    solved: list[tuple[CoverProblem, GroupedCover]] = []
    searches: list[setup_search.SetupSearch] = []

    class RecordedSearch(setup_search.SetupSearch):
        def __init__(self, *known: Any) -> None:
            super().__init__(*known)
            searches.append(self)

    def record(problem: CoverProblem, targets: Floats, *rest: Any, **options: Any) -> GroupedCover:
        found = solve_grouped(problem, targets, *rest, **options)
        solved.append((problem, found))
        return found

    start = time.process_time()
    own = setup_search.SetupSearch
    setup_search.solve_grouped, planning.SetupSearch = record, RecordedSearch  # type: ignore[misc]
    try:
        run = api.setups(words[0], out=folder / name, **options_of_part)
    except CellError as error:
        return {"part": name, "error": str(error)[:100]}
    finally:
        setup_search.solve_grouped, planning.SetupSearch = solve_grouped, own  # type: ignore[misc]
    seconds, file = time.process_time() - start, run.file
    problem, joint = solved[-1]
    poses = [setup.measured.candidates.T_object_scanner[:, 0] for setup in searches[0].setups.values()]
    setups, views = _after_another(problem, joint)
    first_setups, first_views = _views_first(problem, joint, np.concatenate(poses))
    ceiling, error = _ceiling(run.folders[0])
    return {
        "part": name,
        "candidates": len(file.candidates),
        "set-ups": len(file.selected),
        "bound": file.setups_bound,
        "views": file.views,
        "views bound": file.views_bound,
        "one cover": f"{len(joint.views)} / {joint.n_views}",
        "one after the other": f"{setups} / {views}",
        "views first": f"{first_setups} / {first_views}",
        "best single %": round(100 * max(each.coverable for each in file.candidates), 2),
        "visible %": round(100 * file.coverage.visible, 2),
        "ceiling %": round(100 * ceiling, 2),
        "+-": round(100 * error, 2),
        "cpu s": round(seconds, 1),
    }


def _after_another(problem: CoverProblem, joint: GroupedCover) -> tuple[int, int]:
    """Return numbers of set-ups and views, one set-up after the other.

    Each set-up is the one that adds most, and is covered by itself.
    """
    rows, group, areas = GroupLoads(problem, joint.targets), np.asarray(problem.group), np.asarray(problem.areas)
    left, setups, views = rows.demand > 0, 0, 0
    missing = float(areas[left].sum() - rows.target_weight[0])  # area that may remain uncovered
    while float(areas[left].sum()) > missing * (1 + 1e-9) and left.any():
        adds = (rows.loads > 0) @ (areas * left)
        best = int(np.argmax(adds))
        columns = np.flatnonzero((group == best) & np.asarray(problem.allowed))
        part = problem.matrix[:, columns][left]
        share = min(1.0, (float(areas[left].sum()) - missing) / float(adds[best]))
        found = cover.solve(CoverProblem(part, areas[left], coverage=share), rng=np.random.default_rng(0))
        left = left & ~(np.asarray(problem.matrix[:, columns[found.views]].sum(axis=1)).ravel() > 0)
        setups, views = setups + 1, views + len(found.views)
    return setups, views


def _views_first(problem: CoverProblem, joint: GroupedCover, poses: Floats) -> tuple[int, int]:
    """Return numbers of set-ups and views with the (V, 4, 4) poses selected first.

    The poses are selected among all that some set-up reaches.
    """
    _, pose = np.unique(poses.reshape(-1, 16).round(9), axis=0, return_inverse=True)
    some = np.flatnonzero(np.asarray(problem.allowed))
    alone = CoverProblem(problem.matrix[:, some], problem.areas, coverage=float(joint.targets[0]))
    views = some[cover.solve(alone, rng=np.random.default_rng(0)).views]
    again = np.asarray(problem.allowed) & np.isin(pose, pose[views])
    rows = GroupLoads(replace(problem, allowed=again), joint.targets)
    rows.target_weight = joint.loads.target_weight
    return fewest_groups(rows, (), None)[0], len(views)


def _ceiling(folder: Path) -> tuple[float, float]:
    """Return the share of the surface that some scanner pose measures past the part alone, and its standard error."""
    record = api.open_run(folder)
    cell = read_cell(record)
    samples = held_out_samples(cell.reference, cell.planning, record.seed)
    some = samples.pick(np.sort(np.random.default_rng(0).permutation(len(samples))[:N_PROBED_SAMPLES]))
    anywhere = ViewEvaluator(
        cell.scanner, (cell.part_caster,), lambda poses: np.ones(len(poses), dtype=np.bool_), np.eye(4)[None]
    )
    share = float(probe_attainable(RayTargets.of(some.points, some.normals, some.region), anywhere).measured.mean())
    return share, float(np.sqrt(share * (1 - share) / len(some.points)))
