"""Fits compared with least-squares reference pairs in the form of NIST: `python -m benchmarks nist_fits FOLDER`.

A pair is a file of points (`NAME.ds`) and the reference fit (`NAME.fit`); the name starts with the kind of shape. A row
has the largest differences from the references of each kind, and the pairs that the fit reports as not unique. The
limit is 1e-7 for lengths in the unit of the file and for angles in radians.
"""

import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from planner.fitting.least_squares import Fit, fit
from planner.fitting.shapes import ShapeKind
from planner.values import Floats

KINDS = {"lin": ShapeKind.LINE, "pla": ShapeKind.PLANE, "cir": ShapeKind.CIRCLE, "sph": ShapeKind.SPHERE,
         "cyl": ShapeKind.CYLINDER, "con": ShapeKind.CONE}  # fmt: skip
LIMIT = 1e-7

app = typer.Typer(add_completion=False)


@app.command()
def main(folder: Annotated[Path, typer.Argument(help="folder of the pairs")]) -> None:
    """Compare fits with the pairs of a folder; exit code 1 if a difference exceeds the limit."""
    rows = [compare(path) for path in sorted(folder.glob("*.ds"))]
    for prefix, kind in KINDS.items():
        own = [row for row in rows if row["pair"].startswith(prefix)]
        unique = [row for row in own if not row["doubts"]]
        worst = {
            key: max((row[key] for row in unique), default=0.0) for key in ("position", "direction", "size", "angle")
        }
        text = ", ".join(f"{key} {value:.1e}" for key, value in worst.items())
        typer.echo(f"{kind:9s} {len(own)} pairs: {text}; {sum(row['seconds'] for row in own):.2f} s")
        for row in own:
            if row["doubts"]:
                typer.echo(f"  {row['pair']}: not unique: {'; '.join(row['doubts'])}")
            elif max(row[key] for key in worst) > LIMIT:
                typer.echo(f"  {row['pair']}: beyond the limit: {row}")
    failed = [
        row
        for row in rows
        if not row["doubts"] and max(row[k] for k in ("position", "direction", "size", "angle")) > LIMIT
    ]
    raise typer.Exit(1 if failed or not rows else 0)


def compare(path: Path) -> dict[str, Any]:
    """Return the differences between our fit of the points of a pair and its reference."""
    kind = KINDS[path.stem[:3]]
    points = np.loadtxt(path, skiprows=1, ndmin=2)
    reference = np.loadtxt(path.with_suffix(".fit"))
    start = time.perf_counter()
    found = fit(kind, points)
    seconds = time.perf_counter() - start
    return {"pair": path.stem, "doubts": found.doubts, "seconds": seconds, "condition": found.condition,
            **differences(found, reference)}  # fmt: skip


def differences(found: Fit, reference: Floats) -> dict[str, float]:
    """Return the differences of position, direction, size and angle [unit of the file, rad]."""
    shape, point = found.shape, reference[:3]
    off = point - shape.point
    if shape.kind is ShapeKind.SPHERE:
        return {"position": _length(off), "direction": 0.0, "size": abs(2 * shape.size - reference[3]), "angle": 0.0}
    along = float(off @ shape.axis)
    across = off - along * shape.axis
    position = {ShapeKind.PLANE: abs(along), ShapeKind.CIRCLE: _length(off)}.get(shape.kind, _length(across))
    size = angle = 0.0
    if shape.kind in (ShapeKind.CIRCLE, ShapeKind.CYLINDER):
        size = abs(2 * shape.size - reference[6])
    if shape.kind is ShapeKind.CONE:
        size = abs(shape.size + along * np.sin(shape.half_angle) - reference[6])
        angle = abs(2 * shape.half_angle - np.radians(reference[7]))
    return {
        "position": position,
        "direction": _length(np.cross(shape.axis, reference[3:6])),
        "size": size,
        "angle": angle,
    }


def _length(vector: Floats) -> float:
    return float(np.linalg.norm(vector))
