"""Explorations of parts: true coverage and views compared with the plan on the known model, contacts, reasons, seconds.

SCAN_CELL_PARTS names built-in parts and meshes of the folder SCAN_CELL_MESHES (default "mug,petanque"; "all": all of
them), SCAN_CELL_SEEDS (default 1) is the number of seeds, SCAN_CELL_POLICIES names policies (default both).
`benchmarks.triangle_cell` counts contacts: true triangles in python-fcl at every sample of the motions.
SCAN_CELL_REASONS=1 checks the stated reasons as well (`benchmarks.exploring.reasons`). Each row is printed when it is
complete; `--charts` draws coverage over views with the bound for the true model (`benchmarks.exploring.evaluation`).
"""

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.exploring import evaluation, reasons
from benchmarks.exploring.chart import draw_evaluations
from benchmarks.parts import parts
from benchmarks.triangle_cell import TriangleCell
from cell.explore.explore import FINAL_STAGE, explore
from cell.explore.options import ExploreOptions
from cell.explore.policy import POLICIES
from cell.explore.prepare import prepare_exploration
from cell.runs.cell import world_of
from cell.runs.run import open_finished
from cell.runs.schema import ExploreFile
from cell.scan.options import ScanOptions
from cell.scene.file import scene_from_options
from cell.scene.options import parse_options
from cell.session import LoggedProgress, Session
from planner.ports import Progress

_AFTER = (5, 10, 15)  # views
_LIMIT = {"stepwise": 1.35, "two-stage": 1.8}
"""Views for each of the fewest that may be taken, and two more."""


def run() -> list[dict[str, Any]]:
    """Return one row for each part, policy and seed."""
    names = os.environ.get("SCAN_CELL_PARTS", "mug,petanque").split(",")
    policies = os.environ.get("SCAN_CELL_POLICIES", ",".join(POLICIES)).split(",")
    seeds, rows = range(int(os.environ.get("SCAN_CELL_SEEDS", "1"))), list[dict[str, Any]]()
    with tempfile.TemporaryDirectory() as folder:
        for name, words in parts(Path(folder)):
            if names == ["all"] or name.removesuffix(" (file)") in names:
                for policy, seed in product(policies, seeds):
                    rows.append(_row(name, words, policy, seed))
                    print(rows[-1], file=sys.stderr, flush=True)  # noqa: T201 -- keeps rows of an interrupted run
    return rows


def chart(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """Draw coverage over the number of views, with the bound of the plan on the known model."""
    draw_evaluations(rows, folder / "explored.png")


def _row(part: str, words: tuple[str, ...], policy: str, seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        out, clock = Path(folder) / "explored", _Clock()
        units = {"units": words[2]} if len(words) > 1 else {}
        scene = scene_from_options(None, {"place": (1200, 500, 0), "seed": seed} | units, words[0])
        options = parse_options(ExploreOptions, {"policy": policy})
        file = explore(Session(None, clock, out), scene, options, ScanOptions())
        work = prepare_exploration(Session(None, out=out), scene, options, ScanOptions())
        known_model = Path(folder) / "known"
        evaluation.plan_known_model(work, known_model)
        known = evaluation.evaluate(work, file, known_model)
        checked, contacts = _count_contacts(out, file, known_model)
        causes = reasons.check_causes(work, file, known_model) if os.environ.get("SCAN_CELL_REASONS") else {}
    limit = _LIMIT[policy] * known.fewest + 2
    return {
        "part": part,
        "policy": policy,
        "seed": seed,
        "batches": len(file.batches),
        "views": file.views,
        "limit": round(limit, 1),
        "fewest": known.fewest,
        "visible %": round(100 * known.visible, 2),
        "known %": round(100 * known.known_model_visible, 2),
        "behind": round(100 * (known.known_model_visible - known.visible), 2),
        "known views": known.known_model_views,
        "coverable %": round(100 * known.coverable, 2),
        **{f"after {n} %": _share(known.by_views, n) for n in _AFTER},
        "motion s": round(sum(stage.seconds for stage in file.batches), 1),
        "checked": checked,
        "contacts": contacts,
        "nearest mm": round(known.nearest_mm, 1),
        "step s": round(clock.exploring / len(file.batches), 2),
        **_count_causes(causes),
        "by views": list(known.by_views),
        "bound": [(point.views, point.found, point.at_most) for point in known.bound],
    }


class _Clock(LoggedProgress):
    """Measure processor seconds until the model is made at the end of an exploration."""

    def __init__(self) -> None:
        super().__init__()
        self._began, self.exploring = process_time(), 0.0

    @contextmanager
    def stage(self, name: str, *, time_left: bool = False) -> Iterator[Progress]:
        if name == FINAL_STAGE:
            self.exploring = process_time() - self._began
        with super().stage(name, time_left=time_left) as progress:
            yield progress


def _count_causes(causes: dict[str, tuple[float, float]]) -> dict[str, Any]:
    """Return the share of the open area with a true reason, and total and true area of each reason [mm2]."""
    if not causes:
        return {}
    areas = np.array(list(causes.values()))
    return {
        "reasons true %": round(100 * float(areas[:, 1].sum() / areas[:, 0].sum()), 1),
        "reasons": [f"{name}: {true:.0f} of {area:.0f}" for name, (area, true) in causes.items()],
    }


def _share(by_views: tuple[float, ...], n: int) -> float:
    return round(100 * by_views[min(n, len(by_views)) - 1], 2)


def _count_contacts(out: Path, file: ExploreFile, known_model: Path) -> tuple[int, int]:
    """Return the number of configurations along all motions, and the number in contact with the true part in place."""
    known = open_finished(known_model)
    part = known.mesh("reference.ply")
    judge, checked, found = TriangleCell(world_of(known, part), part), 0, 0
    for stage in file.batches:
        q = open_finished(out / stage.folder).motion.q
        checked += len(q)
        found += sum(judge.contacts(q).values())
    return checked, found
