"""Make the instances: `python -m benchmarks.open.make_instances [NAME ...]` writes instances/NAME.json and .npz.

Samples, candidates and references follow from seeds. The matrix is computed by check.py from the written poses.
"""

import hashlib
import sys
from typing import Any

import numpy as np

from benchmarks.open import check
from benchmarks.open.tools import HERE, Bench, in_millimetres, write_json

TARGETS = [0.95, 0.99, 1.0]
CLEARANCE_MM = 20.0
N_SAMPLES, N_REFERENCE = 3000, 400_000
PARTS_OF_A = {
    "area": (
        "mseke",
        "mug",
        "robinet",
        "petanque",
        "humerus",
        "st-jean",
        "bracket",
        "valve-block",
        "housing",
        "impeller",
    ),
    "line": ("mug", "humerus", "gear", "bracket", "crankshaft"),
    "camera": ("st-jean", "gear", "crankshaft", "heat-sink", "knot"),
}
"""Parts of tier A by sensor."""
LIMITS = {"area": 600, "line": 350, "camera": 500}
"""Number of candidates before growth."""


def make_a(part: str, sensor: str) -> None:
    """Write an instance of tier A."""
    name = f"A-{part}-{sensor}"
    write(name, {"tier": "A", "part": part, "part_sha256": part_hash(part), "sensor": sensor}, LIMITS[sensor])


def write(name: str, data: dict[str, Any], limit: int, **more: Any) -> None:
    """Write an instance of tier A or B: samples, candidates, matrix, reference."""
    data |= {"name": name, "clearance_mm": CLEARANCE_MM, "targets": TARGETS}
    path = HERE / "instances" / f"{name}.json"
    write_json(path, data)
    instance = check.Instance(name)
    bench = Bench(instance)
    bench.reach = more.pop("reach", None)
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "little")
    points, normals, face = instance.surface.draw(N_SAMPLES, seed)
    points = points.astype(np.float32).astype(np.float64)
    poses = in_millimetres(bench.candidates(seed, limit))
    arrays = {"poses": poses}
    if "configure" in more:  # tier B: poses follow from the configurations
        arrays["configurations"] = more["configure"](poses)
        arrays["poses"] = poses = np.array([instance.pose_of(q) for q in arrays["configurations"]])
    matrix = instance.measured_by(poses, points, normals, each=True).T
    arrays["matrix"] = np.packbits(matrix, axis=1)
    np.savez_compressed(
        path.with_suffix(".npz"), points=points.astype(np.float32), face=face.astype(np.int32), **arrays
    )
    fresh, normals, _ = instance.surface.draw(N_REFERENCE, seed + 1)
    data["coverable_rows"] = int(matrix.any(axis=1).sum())
    data["reference"] = round(float(instance.measured_by(poses, fresh, normals).mean()), 6)
    write_json(path, data)
    size = path.with_suffix(".npz").stat().st_size // 1024
    sys.stdout.write(
        f"{name}: {len(poses)} poses, {data['coverable_rows']} of {N_SAMPLES} rows, reference {data['reference']:.4f}, "
        f"density {matrix.mean():.3f}, {size} kB\n"
    )
    sys.stdout.flush()


def part_hash(part: str) -> str:
    """Return the hash of a part's file."""
    return hashlib.sha256((HERE / "parts" / f"{part}.stl").read_bytes()).hexdigest()


def main() -> None:
    """Write the named instances of tier A, or all."""
    wanted = sys.argv[1:]
    for sensor, parts in PARTS_OF_A.items():
        for part in parts:
            if not wanted or f"A-{part}-{sensor}" in wanted:
                make_a(part, sensor)


if __name__ == "__main__":
    main()
