"""Make the 14 parts: `python -m benchmarks.open.make_parts` writes parts/NAME.stl (binary, mm) and parts/sha256.json.

Six are the built-in parts of the project with fewer faces, eight are made of implicit shapes here. All come from code
alone. The STL files are the definition of the parts: marching cubes and decimation of other versions may differ.
"""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.part_models import mesher
from benchmarks.part_models.build import PART_MODELS
from benchmarks.part_models.fields import (
    Field,
    box,
    capsule,
    cylinder,
    displaced,
    ellipsoid,
    revolve,
    ripples,
    rotation,
    torus,
    tube,
    union,
    without,
)
from cell.part import workpiece
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh

FOLDER = Path(__file__).parent / "parts"
N_FACES = 4000


def bracket() -> Field:
    """Return an angle bracket with two ribs and six holes."""
    body = union(
        4,
        box((0, 0, 6), (60, 45, 6), 1.5),
        box((-54, 0, 50), (6, 45, 50), 1.5),
        *(box((-25, y, 25), (30, 4, 22), 1, rotation(1, -40)) for y in (-30, 30)),
    )
    holes = [cylinder((x, y, -5), (x, y, 20), 7) for x in (10, 42) for y in (-20, 20)]
    holes += [cylinder((-70, y, 78), (-40, y, 78), 9) for y in (-20, 20)]
    return without(1, body, *holes)


def valve_block() -> Field:
    """Return a block with crossing bores, counterbores and a boss."""
    body = union(3, box((0, 0, 0), (55, 40, 35), 3), cylinder((0, 0, 30), (0, 0, 52), 22, 1.5))
    bores = [
        cylinder((0, 0, -10), (0, 0, 60), 13),
        cylinder((-60, 0, 0), (60, 0, 0), 9),
        cylinder((38, 0, 0), (60, 0, 0), 17),
        *(cylinder((x, -45, 8), (x, 45, 8), 7) for x in (-30, 30)),
        *(cylinder((x, y, 20), (x, y, 40), 5) for x in (-44, 44) for y in (-29, 29)),
    ]
    return without(1, body, *bores)


def impeller() -> Field:
    """Return a disc with nine curved blades and a hub."""
    blades = []
    for turn in 2 * np.pi * np.arange(9) / 9:
        points = [
            (r * np.cos(turn + 0.9 * r / 75), r * np.sin(turn + 0.9 * r / 75), 8)
            for r in (18.0, 34.0, 50.0, 62.0, 72.0)
        ]
        blades += [
            union(0, *(tube([(x, y, z) for x, y, _ in points], [3.0, 2.8, 2.6, 2.4, 2.2]) for z in (8, 13, 18, 23, 28)))
        ]
    hub = revolve(2, (0, 8, 20, 45), (24, 22, 17, 12))
    return without(
        0.5, union(2, cylinder((0, 0, 0), (0, 0, 7), 76, 1.5), hub, *blades), cylinder((0, 0, -5), (0, 0, 60), 7)
    )


def gear() -> Field:
    """Return a gear with 18 teeth, four windows and a hub."""

    def teeth(p: np.ndarray) -> np.ndarray:
        return (5 * np.clip(1.6 * np.cos(18 * np.arctan2(p[1], p[0])), -1, 1)).astype(np.float32)

    ring = displaced(cylinder((0, 0, -12), (0, 0, 12), 70), lambda p: teeth(p) * (np.hypot(p[0], p[1]) > 50))
    windows = [
        cylinder((38 * np.cos(a), 38 * np.sin(a), -20), (38 * np.cos(a), 38 * np.sin(a), 20), 13)
        for a in np.arange(4) * np.pi / 2 + 0.4
    ]
    return without(
        1, union(3, ring, cylinder((0, 0, -22), (0, 0, 22), 20, 1)), *windows, cylinder((0, 0, -30), (0, 0, 30), 10)
    )


def housing() -> Field:
    """Return an open box with bosses, a wall inside and a window."""
    shell = without(2, box((0, 0, 0), (70, 50, 32), 5), box((0, 0, 10), (64, 44, 36), 4))
    bosses = [cylinder((x, y, -28), (x, y, 24), 8, 1) for x in (-52, 52) for y in (-32, 32)]
    body = union(2, shell, *bosses, box((8, 0, -12), (3, 45, 16), 1))
    holes = [cylinder((x, y, 0), (x, y, 40), 3.5) for x in (-52, 52) for y in (-32, 32)]
    return without(1, body, *holes, box((-80, 0, 2), (30, 18, 10), 2), cylinder((40, -60, 0), (40, -30, 0), 10))


def heat_sink() -> Field:
    """Return a plate with nine fins and a round foot."""
    fins = [box((x, 0, 24), (2.4, 42, 22), 1) for x in np.linspace(-52, 52, 9)]
    return union(1.5, box((0, 0, 0), (58, 45, 6), 1.5), *fins, cylinder((0, 0, -22), (0, 0, 0), 24, 2))


def crankshaft() -> Field:
    """Return a shaft with three throws."""
    parts = [cylinder((-110, 0, 0), (-70, 0, 0), 13, 1), cylinder((70, 0, 0), (110, 0, 0), 13, 1)]
    for k, x in enumerate((-46.0, 0.0, 46.0)):
        c, s = 24 * np.cos(2 * np.pi * k / 3), 24 * np.sin(2 * np.pi * k / 3)
        parts.append(cylinder((x - 14, c, s), (x + 14, c, s), 11, 0.5))
        for side in (-14, 14):
            parts.append(capsule((x + side, c, s), (x + side, -0.9 * c, -0.9 * s), 15, 21))
    parts += [cylinder((x - 10, 0, 0), (x + 10, 0, 0), 13, 0.5) for x in (-70, -23, 23, 70)]
    return union(2, *parts)


def knot() -> Field:
    """Return a trefoil knot on a foot, with ripples."""
    t = np.linspace(0, 2 * np.pi, 73)
    x, y, z = np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)
    rope = tube([(22 * a, 22 * b, 22 * c) for a, b, c in zip(x, y, z, strict=True)], [11.0] * len(t))
    foot = union(4, ellipsoid((0, 0, -34), (40, 40, 10)), torus((0, 0, -30), 2, 40, 8))
    return displaced(union(4, rope, foot), ripples(np.random.default_rng(3), 0.6, 18.0))


SHAPES: dict[str, tuple[Callable[[], Field], tuple[float, float, float], tuple[float, float, float]]] = {
    "bracket": (bracket, (-66, -50, -6), (66, 50, 106)),
    "valve-block": (valve_block, (-60, -46, -41), (60, 46, 58)),
    "impeller": (impeller, (-82, -82, -5), (82, 82, 50)),
    "gear": (gear, (-80, -80, -27), (80, 80, 27)),
    "housing": (housing, (-76, -56, -38), (76, 56, 38)),
    "heat-sink": (heat_sink, (-64, -50, -28), (64, 50, 52)),
    "crankshaft": (crankshaft, (-116, -52, -52), (116, 52, 52)),
    "knot": (knot, (-88, -92, -52), (88, 92, 40)),
}
"""Shape and box [mm] of the parts that are made here."""


def make(name: str) -> np.ndarray:
    """Return the triangles (F, 3, 3) of a part, float32 [mm]."""
    if name in PART_MODELS:
        reference = workpiece.load(name).reference
        mesh = decimate(reference, N_FACES)
        return (1000 * mesh.vertices[mesh.faces]).astype(np.float32)
    shape, low, high = SHAPES[name]
    fine = mesher.mesh_of(shape(), low, high, 1.0)
    mesh = decimate(TriangleMesh(fine.vertices / 1000, fine.faces), N_FACES)
    return (1000 * mesh.vertices[mesh.faces]).astype(np.float32)


def stl(triangles: np.ndarray) -> bytes:
    """Return a binary STL file of triangles (F, 3, 3)."""
    record = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = triangles
    return b"scan-cell open benchmark, CC0".ljust(80) + len(triangles).to_bytes(4, "little") + record.tobytes()


def main() -> None:
    """Write all parts."""
    hashes = {}
    for name in (*PART_MODELS, *SHAPES):
        data = stl(make(name))
        (FOLDER / f"{name}.stl").write_bytes(data)
        hashes[name] = hashlib.sha256(data).hexdigest()
    (FOLDER / "sha256.json").write_text(json.dumps(hashes, indent=1) + "\n")


if __name__ == "__main__":
    main()
