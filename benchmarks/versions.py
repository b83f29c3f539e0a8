"""The main jobs of this version beside another one: views, bound, coverage, motion, time and memory on every part.

SCAN_CELL_OTHER is a checkout of the other version; without it, only this version runs. SCAN_CELL_JOBS names jobs
(default "plan,scan,table": also "setups,explore"), SCAN_CELL_PARTS names parts of benchmarks/parts.py (default:
all). Both versions run one after the other on each part, in the Python of this process, each once, with a cache of
their own; the same jobs of the part mug before compile their kernels. Each row is printed when it is complete.
`model %` of an exploration is the share of the part's surface within 1 mm of its model. Version 0.2 has no
`cell inspect`.
"""

import os
import sys
import tempfile
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.cell_process import CODE, run_cell
from benchmarks.parts import parts, place
from cell.errors import CellError
from cell.part import workpiece
from cell.scene.file import scene_from_options
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples

_N_SAMPLES = 50_000


def run() -> list[dict[str, Any]]:
    """Return one row for each part, job and version."""
    other, jobs = os.environ.get("SCAN_CELL_OTHER"), os.environ.get("SCAN_CELL_JOBS", "plan,scan,table").split(",")
    wanted = os.environ.get("SCAN_CELL_PARTS")
    versions = ([("other", Path(other))] if other else []) + [("this", CODE)]
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for job, (version, code) in product(jobs, versions):
            _row(job, ("mug",), folder / f"warm_{version}", folder, code)
        for name, arguments in parts(folder):
            if wanted and name.removesuffix(" (file)") not in wanted.split(","):
                continue
            for job in jobs:
                for version, code in versions:
                    out = folder / f"{name.split()[0]}_{version}"
                    row = {"part": name, "job": job, "version": version}
                    rows.append(row | _row(job, arguments, out, folder, code))
                    print(rows[-1], file=sys.stderr, flush=True)  # noqa: T201 -- keeps rows of an interrupted run
    return rows


def _row(job: str, arguments: tuple[str, ...], out: Path, folder: Path, code: Path) -> dict[str, Any]:
    own = Path(f"{out}_{job}")
    words = {
        "plan": ("plan", *arguments, "--place", place(), "--out", str(out)),
        "scan": ("scan", str(out)),
        "table": ("plan", *arguments, "--table", "--place", place(), "--out", str(own)),
        "setups": ("setups", *arguments, "--place", place(), "--out", str(own)),
        "explore": ("explore", *arguments, "--place", place(), "--out", str(own)),
    }[job]
    try:
        values, use = run_cell(folder, *words, code=code, cache=folder / f"cache_{out.name.rpartition('_')[2]}")
    except CellError as error:
        return {"error": str(error)[:100]}
    row = _RESULTS[job](values) | {name: round(value, 1) for name, value in use.items()}
    return row | {"model %": _share_in_model(own / "model.ply", *arguments)} if job == "explore" else row


def _share_in_model(path: Path, part: str, *units: str) -> float:
    """Return the share [%] of a part's surface within 1 mm of the model of an exploration, centred at the part."""
    scene = scene_from_options(None, {"units": units[1]} if units else {}, part)
    reference = workpiece.load(scene.part.source, scene.part.units).reference
    samples = draw_samples(reference, reference, _N_SAMPLES, np.random.default_rng(0))
    model = trimesh.load(path, process=False)
    nearest = ClosestPointQuery(TriangleMesh(model.vertices / 1000.0, model.faces))
    centre = (reference.vertices.min(axis=0) + reference.vertices.max(axis=0)) / 2
    return round(100.0 * float((nearest.closest(samples.points - centre).distance < 1e-3).mean()), 2)


def _planned(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "views": values["n_views"],
        "bound": values["lower_bound"],
        "visible %": round(100 * values["coverage"]["visible"], 2),
        "motion s": round(values["motion"]["duration_s"], 2),
    }


def _scanned(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "views": values["n_views"],
        "visible %": round(100 * values["coverage"]["visible"], 2),
        "deviation um": round(1000 * values["deviation"]["rms_mm"], 1),
    }


def _with_setups(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "views": values["views"],
        "bound": values["views_bound"],
        "set-ups": len(values["selected" if "selected" in values else "chosen"]),
        "visible %": round(100 * values["coverage"]["visible"], 2),
    }


def _explored(values: dict[str, Any]) -> dict[str, Any]:
    return {"views": sum(batch["views"] for batch in values["batches" if "batches" in values else "stages"])}


_RESULTS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "plan": _planned, "scan": _scanned, "table": _planned, "setups": _with_setups, "explore": _explored,
}  # fmt: skip
