"""Built-in parts: seconds to build and to load each, and whether the shipped mesh equals the built one."""

from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.part_models.build import PART_MODELS, build
from cell.files import model_file
from cell.part import builtin


def run() -> list[dict[str, Any]]:
    """Return one row for each part."""
    rows = []
    for name in PART_MODELS:
        start = perf_counter()
        built = build(name)
        built_at = perf_counter()
        loaded = builtin.load(name)
        rows.append({
            "part": name,
            "faces": len(loaded.faces),
            "build s": round(built_at - start, 2),
            "load s": round(perf_counter() - built_at, 3),
            "file kB": model_file(f"parts/{name}.npz").stat().st_size // 1000,
            "equal": np.array_equal(built.vertices, loaded.vertices) and np.array_equal(built.faces, loaded.faces),
        })  # fmt: skip
    return rows
