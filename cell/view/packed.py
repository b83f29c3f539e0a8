"""Arrays as text for the page's script: quantised, thinned to what an eye can tell, in base64. Metres."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

POINTS, MOMENTS = 300_000, 4_000
"""Most points of a cloud and moments of a motion that a page holds."""

NONE = 65535
"""In a layer: no value here."""

Packed = Mapping[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Values on the vertices of a surface, that give it its colours.

    Attributes:
        title: in the list of colourings.
        kind: `views`: bits of the views that measure the vertex, rows of bytes; `length` and `signed`: steps, `NONE`
            where there is none; `named`: which of `named`.
        values: (V,) or (V, width).
        note: what it means.
        low: of steps: value of step 0 [mm].
        step: of steps [mm].
        limits: ends of the colours at first [mm].
        named: names with their colours.
    """

    title: str
    kind: Literal["views", "length", "signed", "named"]
    values: NDArray[np.uint8] | NDArray[np.uint16]
    note: str = ""
    low: float = 0.0
    step: float = 1.0
    limits: tuple[float, float] = (0.0, 1.0)
    named: Sequence[tuple[str, str]] = ()


def stepped(
    values: Floats, title: str, kind: Literal["length", "signed"], limits: tuple[float, float], note: str
) -> Layer:
    """A layer of (V,) lengths [mm]; NaN is none."""
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 1.0)
    step = max(high - low, 1e-9) / (NONE - 1)
    steps = np.full(len(values), NONE, dtype=np.uint16)
    steps[known] = np.rint((values[known] - low) / step).astype(np.uint16)
    return Layer(title, kind, steps, note, low, step, limits)


def packed_mesh(mesh: TriangleMesh) -> Packed:
    """A mesh."""
    return {
        "vertices": packed_points(mesh.vertices),
        "faces": packed(mesh.faces, "u2" if len(mesh.vertices) <= NONE else "u4"),
    }


def packed_points(points: Floats) -> Packed:
    """(P, 3) points in steps of 1/65535 of their extent."""
    if len(points) > POINTS:
        points = points[np.linspace(0, len(points) - 1, POINTS).astype(np.int64)]
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum(high - low, 1e-9) / NONE
    steps = np.rint((points - low) / step)
    return {"low": low.tolist(), "step": step.tolist(), "steps": packed(steps, "u2")}


def packed(values: ArrayLike, kind: Literal["u1", "u2", "u4", "f4"]) -> Packed:
    """An array of small numbers."""
    content = np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    return {"kind": kind, "base64": base64.b64encode(content).decode("ascii")}


def packed_motion(t: Floats, q: Floats, stops: Sequence[float]) -> Packed:
    """Moments at even distances, and those of the stops; the arm moves straight in joint space between them."""
    even = np.linspace(0, len(t) - 1, min(len(t), MOMENTS)).astype(np.int64)
    kept = np.union1d(even, np.searchsorted(t, stops).clip(0, len(t) - 1))
    return {"t": packed(t[kept], "f4"), "q": packed(q[kept], "f4")}
