"""Arrays as text for the page's script: quantised, reduced to the visible resolution, in base64. Metres."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

MAX_POINTS, MAX_MOMENTS = 300_000, 4_000
"""Largest numbers of points of a cloud and of moments of a motion in a page."""

NO_VALUE = 65535
"""Code of a missing value in a layer."""

Packed = Mapping[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Values on the vertices of a surface that define its colours.

    Attributes:
        title: in the list of layers.
        kind: `views`: bits of the views that measure the vertex, as rows of bytes; `length` and `signed`: quantised
            lengths, `NO_VALUE` if missing; `named`: index into `named`.
        values: (V,) or (V, width).
        note: explanation.
        low: length of the code 0 [mm].
        step: length per code [mm].
        limits: initial limits of the colour scale [mm].
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


def quantised_layer(
    values: Floats, title: str, kind: Literal["length", "signed"], limits: tuple[float, float], note: str
) -> Layer:
    """Return a layer of (V,) lengths [mm]; NaN is a missing value."""
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 1.0)
    step = max(high - low, 1e-9) / (NO_VALUE - 1)
    steps = np.full(len(values), NO_VALUE, dtype=np.uint16)
    steps[known] = np.rint((values[known] - low) / step).astype(np.uint16)
    return Layer(title, kind, steps, note, low, step, limits)


def pack_mesh(mesh: TriangleMesh) -> Packed:
    """Return a packed mesh."""
    return {
        "vertices": pack_points(mesh.vertices),
        "faces": pack_array(mesh.faces, "u2" if len(mesh.vertices) <= NO_VALUE else "u4"),
    }


def pack_points(points: Floats) -> Packed:
    """Return packed (P, 3) points in steps of 1/65535 of their extent."""
    if len(points) > MAX_POINTS:
        points = points[np.linspace(0, len(points) - 1, MAX_POINTS).astype(np.int64)]
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum(high - low, 1e-9) / NO_VALUE
    steps = np.rint((points - low) / step)
    return {"low": low.tolist(), "step": step.tolist(), "steps": pack_array(steps, "u2")}


def pack_array(values: ArrayLike, kind: Literal["u1", "u2", "u4", "f4"]) -> Packed:
    """Return a packed array of a small number type."""
    content = np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    return {"kind": kind, "base64": base64.b64encode(content).decode("ascii")}


def pack_motion(t: Floats, q: Floats, stops: Sequence[float]) -> Packed:
    """Return a packed motion at even moments and at the stops; between them the joint motion is linear."""
    even = np.linspace(0, len(t) - 1, min(len(t), MAX_MOMENTS)).astype(np.int64)
    rows = np.union1d(even, np.searchsorted(t, stops).clip(0, len(t) - 1))
    return {"t": pack_array(t[rows], "f4"), "q": pack_array(q[rows], "f4")}
