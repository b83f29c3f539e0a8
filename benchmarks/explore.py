"""Next views of a part without a model: the stepwise policy and rivals written from their publications.

Rows are without an arm (the choice of views alone) and, with SCAN_CELL_ARM=1, with the arm of the default cell and
seconds of motion. First view, scanner, voxels and budget are equal. SCAN_CELL_PARTS names built-in parts and meshes of
the folder SCAN_CELL_MESHES (default "mug,petanque,bunny"); SCAN_CELL_SEEDS (default 3) is the number of seeds.
SCAN_CELL_TUNE=1 runs every setting of the rivals with seed 0 instead.
"""

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.exploring import chart as charts
from benchmarks.exploring.lab import Lab, Policy, explored
from benchmarks.exploring.policies import POLICIES, RIVALS
from benchmarks.parts import parts

VIEWS = 15
AFTER = (5, 10, 15)


def run() -> list[dict[str, Any]]:
    """Return one row for each part, policy and seed."""
    names = os.environ.get("SCAN_CELL_PARTS", "mug,petanque,bunny").split(",")
    seeds, arm = int(os.environ.get("SCAN_CELL_SEEDS", "3")), bool(os.environ.get("SCAN_CELL_ARM"))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, words in parts(Path(folder)):
            if name.removesuffix(" (file)") in names:
                lab = Lab.of(words[0], *words[2:], arm=arm)
                rows += list(_rows(name, lab, seeds))
    return rows


def chart(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """Draw coverage over views and, with an arm, over seconds of motion."""
    charts.draw(rows, folder / "explore_rivals.png")


def _rows(part: str, lab: Lab, seeds: int) -> Iterator[dict[str, Any]]:
    ceiling = lab.ceiling()
    for name, policy, seed in _selected_runs(seeds):
        began = process_time()
        known, by_views = explored(lab, policy, seed, VIEWS)
        shares = [round(100 * float(by_views[min(n, len(by_views)) - 1]), 2) for n in AFTER]
        seconds = [] if lab.arm is None else lab.arm.seconds(known.poses).round(2).tolist()
        yield {
            "part": part,
            "policy": name,
            "seed": seed,
            "views": len(known.poses),
            **{f"after {n} %": share for n, share in zip(AFTER, shares, strict=True)},
            "ceiling %": round(100 * ceiling, 2),
            **({"motion s": seconds[-1]} if seconds else {}),
            "cpu s": round(process_time() - began, 1),
            "by views": np.round(100 * by_views, 3).tolist(),
            "seconds": seconds,
        }


def _selected_runs(seeds: int) -> Iterator[tuple[str, Policy, int]]:
    if os.environ.get("SCAN_CELL_TUNE"):
        yield from (
            (f"{name}: {each}", make(each), 0) for name, (make, settings) in RIVALS.items() for each in settings
        )
    else:
        yield from ((name, policy, seed) for name, policy in POLICIES.items() for seed in range(seeds))
