"""Make the instances: `python -m benchmarks.open.make_instances [NAME ...]` writes instances/NAME.json and .npz.

Samples, candidates and references follow from seeds. The matrix is computed by check.py from the written poses.
"""

import hashlib
import sys
from typing import Any

import numpy as np

from benchmarks.open import check, tools
from benchmarks.open.tools import HERE, Bench, in_metres, in_millimetres, write_json
from planner.cover import CoverProblem, solve

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
PARTS_OF_B = (
    ("mseke", "area"),
    ("petanque", "area"),
    ("valve-block", "area"),
    ("crankshaft", "line"),
    ("gear", "camera"),
)
"""Parts and sensors of tier B."""
VIEWS_OF_C = {
    "C-mseke": ("B-mseke-area", 0.99, 0),
    "C-petanque": ("B-petanque-area", 0.99, 0),
    "C-valve-block": ("B-valve-block-area", 1.0, 0),
    "C-gear": ("B-gear-camera", 1.0, 0),
    "C-crankshaft": ("B-crankshaft-line", 1.0, 0),
    "C-mseke-60": ("B-mseke-area", 1.0, 60),
    "C-gear-120": ("B-gear-camera", 1.0, 120),
}
"""Source, target and number of random candidates (0: a cover) of tier C."""
PARTS_OF_D = ("mug", "petanque", "housing", "impeller")
ACCELERATION_S = 0.3
HOME = [0.0, -0.6, 0.9, 0.0, 0.8, 0.0]


def make_a(part: str, sensor: str) -> None:
    """Write an instance of tier A."""
    name = f"A-{part}-{sensor}"
    write(name, {"tier": "A", "part": part, "part_sha256": part_hash(part), "sensor": sensor}, LIMITS[sensor])


def make_b(part: str, sensor: str) -> None:
    """Write an instance of tier B: the part on a pedestal before the arm, a post beside it."""
    surface = check.Surface(check.read_stl(HERE / "parts" / f"{part}.stl"))
    size, height = surface.high - surface.low, 500.0
    middle = np.array([900.0, 0.0, height + size[2] / 2])
    shift = middle - (surface.low + surface.high) / 2
    boxes = [
        [[middle[0], 0.0, height / 2], [0.35 * size[0], 0.35 * size[1], height / 2]],
        [[middle[0] + 100.0, -420.0, 500.0], [30.0, 30.0, 500.0]],
    ]
    cell = {"arm": "arm", "T_base_part": np.column_stack([np.eye(3), shift]).tolist(), "boxes": boxes, "home": HOME}
    data = {"tier": "B", "part": part, "part_sha256": part_hash(part), "sensor": sensor}
    write(f"B-{part}-{sensor}", data | cell, LIMITS[sensor])


def make_c(name: str, source: str, target: float, n_random: int = 0) -> None:
    """Write an instance of tier C: all configurations of the views of a cover, or of random candidates, of tier B."""
    instance = check.load(source)
    bench, M = tools.Bench(instance), tools.matrix_of(instance)
    if n_random:
        views = np.sort(np.random.default_rng(2).permutation(M.shape[1])[:n_random])
    else:
        views = solve(CoverProblem(M, np.ones(len(M)), coverage=target), rng=np.random.default_rng(0)).views
    group, q = bench.configurations(in_metres(instance.arrays["poses"][views]))
    keys = ("arm", "home", "T_base_part", "boxes")
    data = {"tier": "C", "name": name, "views_of": source, "acceleration_s": ACCELERATION_S}
    write_json(HERE / "instances" / f"{name}.json", data | {key: instance.data[key] for key in keys})
    np.savez_compressed(HERE / "instances" / f"{name}.npz", configurations=np.round(q, 9), group=group.astype(np.int32))
    sys.stdout.write(f"{name}: {len(views)} views, {len(q)} configurations\n")


def make_d(part: str) -> None:
    """Write an instance of tier D: the first view is level, from +x, at the middle of the range."""
    like = check.load(f"A-{part}-area").data
    data = {key: like[key] for key in ("part", "part_sha256", "sensor", "clearance_mm", "reference")}
    surface = check.Surface(check.read_stl(HERE / "parts" / f"{part}.stl"))
    middle = (surface.low + surface.high) / 2
    at = [surface.high[0] + 300.0, middle[1], middle[2]]
    first = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], at])
    data |= {"tier": "D", "name": f"D-{part}", "budgets": [5, 10, 15], "first": first.tolist()}
    write_json(HERE / "instances" / f"D-{part}.json", data)


def write(name: str, data: dict[str, Any], limit: int) -> None:
    """Write an instance of tier A or B: samples, candidates, matrix, reference."""
    data |= {"name": name, "clearance_mm": CLEARANCE_MM, "targets": TARGETS}
    path = HERE / "instances" / f"{name}.json"
    write_json(path, data)
    instance = check.Instance(name)
    bench = Bench(instance)
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "little")
    points, normals, face = instance.surface.draw(N_SAMPLES, seed)
    points = points.astype(np.float32).astype(np.float64)
    poses = in_millimetres(bench.candidates(seed, limit))
    arrays = {"poses": poses}
    if bench.kinematics is not None:  # poses follow from the configurations
        arrays["configurations"] = np.round(bench.configure(poses), 9)
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
    """Write the named instances or all."""
    wanted = sys.argv[1:]
    for sensor, parts in PARTS_OF_A.items():
        for part in parts:
            if not wanted or f"A-{part}-{sensor}" in wanted:
                make_a(part, sensor)
    for part, sensor in PARTS_OF_B:
        if not wanted or f"B-{part}-{sensor}" in wanted:
            make_b(part, sensor)
    for name, source in VIEWS_OF_C.items():
        if not wanted or name in wanted:
            make_c(name, *source)
    for part in PARTS_OF_D:
        if not wanted or f"D-{part}" in wanted:
            make_d(part)


if __name__ == "__main__":
    main()
