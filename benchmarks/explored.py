"""Explorations of parts: true coverage and views beside the plan that knows the model, contacts, seconds.

SCAN_CELL_PARTS names built-in parts and meshes of the folder SCAN_CELL_MESHES (default "mug,petanque"), SCAN_CELL_SEEDS
(default 1) is the number of seeds. Contact is judged by `benchmarks.triangle_cell`, true triangles in
python-fcl at every sample of the motions.
"""

import os
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

from benchmarks.parts import parts
from benchmarks.triangle_cell import TriangleCell
from cell.explore.explore import explore
from cell.explore.options import ExploreOptions
from cell.explore.policies import POLICIES
from cell.narrator import Quiet
from cell.run import reader
from cell.run.cell import world_of
from cell.run.explore_json import ExploreFile
from cell.run.record import open_finished
from cell.scan.options import ScanOptions
from cell.scene.option import read
from cell.scene.options import scene_of

_AFTER = (5, 10, 15)  # views


def run() -> list[dict[str, Any]]:
    """One row for each part, policy and seed."""
    wanted = os.environ.get("SCAN_CELL_PARTS", "mug,petanque").split(",")
    seeds = range(int(os.environ.get("SCAN_CELL_SEEDS", "1")))
    with tempfile.TemporaryDirectory() as folder:
        return [
            _row(name, words, policy, seed)
            for name, words in parts(Path(folder)) if name.removesuffix(" (file)") in wanted
            for policy in POLICIES for seed in seeds
        ]  # fmt: skip


def _row(part: str, words: tuple[str, ...], policy: str, seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        out, began = Path(folder) / "explored", process_time()
        units = {"units": words[2]} if len(words) > 1 else {}
        scene = scene_of(None, {"place": (1200, 500, 0), "seed": seed} | units, words[0])
        options = read(ExploreOptions, {"policy": policy})
        file = explore(scene, options, ScanOptions(), out=out, argv=(), narrator=Quiet())
        seconds, known = process_time() - began, file.truth
        assert known is not None
        checked, contacts = _judged(out, file)
    return {
        "part": part,
        "policy": policy,
        "seed": seed,
        "batches": len(file.stages),
        "views": file.views,
        "visible %": round(100 * known.visible, 2),
        **{f"after {n} %": _share(known.by_views, n) for n in _AFTER},
        "coverable %": round(100 * known.coverable, 2),
        "known views": known.known_model_views,
        "known %": round(100 * known.known_model_visible, 2),
        "fewest": known.fewest,
        "motion s": round(sum(stage.seconds for stage in file.stages), 1),
        "checked": checked,
        "contacts": contacts,
        "nearest mm": round(known.nearest_mm, 1),
        "cpu s": round(seconds, 1),
    }


def _share(by_views: tuple[float, ...], n: int) -> float:
    return round(100 * by_views[min(n, len(by_views)) - 1], 2)


def _judged(out: Path, file: ExploreFile) -> tuple[int, int]:
    """Configurations along all motions, and those in which triangles meet, the true part in its place."""
    truth = open_finished(out / "truth")
    part = reader.mesh(truth, "reference.ply")
    judge, checked, found = TriangleCell(world_of(truth, part), part), 0, 0
    for stage in file.stages:
        q = reader.motion(open_finished(out / stage.folder)).q
        checked += len(q)
        found += sum(judge.contacts(q).values())
    return checked, found
