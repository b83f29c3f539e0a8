"""Entries of tier D: `python -m benchmarks.open.explorers METHOD [INSTANCE ...]`, unknown parts.

The policies are those of `benchmarks/exploring`: the stepwise policy of `cell explore` and three rivals. A policy knows
a cylinder about the part, its bounding box, and the points of its own scans.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.exploring import ours, rivals
from benchmarks.exploring.boundary import boundary
from benchmarks.exploring.lab import Knowledge, Lab, Policy
from benchmarks.exploring.policies import TUNED
from benchmarks.open import check
from benchmarks.open.baselines import METHODS, store
from benchmarks.open.check import Array, Instance
from benchmarks.open.tools import HERE, in_metres, in_millimetres, scanner_of
from cell import scanners
from cell.explore.options import ExploreOptions
from cell.explore.prepare import prepare_exploration
from cell.part import workpiece
from cell.scan.options import ScanOptions
from cell.scene.file import load_scene, option_tables
from cell.scene.settle import settle
from cell.session import Session
from cell.world.embree import EmbreeRayCaster
from cell.world.prediction import held_out_samples
from planner.geometry.decimation import decimate
from planner.values import Bools, Floats

RESOLUTION_DEG = 0.5  # between rays of a scan

POLICIES: dict[str, tuple[Policy, str]] = {
    "scan-cell-normal": (ours.stepwise, METHODS["scan-cell-normal"][2]),
    "uniform": (
        rivals.uniform(TUNED["uniform"]),
        "Views of a sphere, each the farthest from all before (Gonzalez 1985).",
    ),
    "volumetric": (rivals.volumetric(TUNED["volumetric"]), "Most unknown voxels along rays (Connolly 1985)."),
    "boundary": (
        boundary,
        "Views at the boundary of the measured points (BENBV: Li, Wan, Zhang 2024); unknown voxels as the score.",
    ),
}
"""Policies of `benchmarks/exploring`, and descriptions."""


class BoxLab(Lab):
    """The laboratory of an instance: poses keep its clearance from the bounding box, too."""

    __slots__ = ("instance", "shift")

    def free(self, space: Any) -> Callable[[Floats], Bools]:
        """Return at which of (n, 4, 4) poses the scanner is free."""
        is_free = Lab.free(self, space)

        def both(T: Floats) -> Bools:
            found = is_free(T)
            poses = in_millimetres(T)
            poses[:, :, 3] -= self.shift
            found &= np.array([not self.instance.pose_fault(pose) for pose in poses], dtype=bool)
            return found

        return both


def explored(instance: Instance, policy: Policy) -> list[Array]:
    """Return the poses of a policy."""
    scanner = scanner_of(instance.sensor).parameters() | {"resolution_deg": [RESOLUTION_DEG] * 2}
    path = str(HERE / "parts" / f"{instance.data['part']}.stl")
    tables = option_tables({"place": (1200, 500, 0), "seed": 0, "units": "mm"}, path)
    tables["scanner"] = {**tables.get("scanner", {}), **scanner}
    scene = load_scene(None, tables)
    work = prepare_exploration(Session(None), scene, ExploreOptions(), ScanOptions())
    settings = settle(work.scene, workpiece.load(scene.part.source, scene.part.units)).settings
    assert work.ground_truth is not None
    mesh = work.ground_truth.mesh
    samples = held_out_samples(mesh, decimate(mesh, min(settings.faces, len(mesh.faces))), 0)
    lab = BoxLab(
        work.cylinder, scanners.make(work.scene.scanner.type, settings.scanner), work.frustum, settings, work.unknown,
        mesh, samples, EmbreeRayCaster(mesh.vertices, mesh.faces),
    )  # fmt: skip
    surface = instance.surface
    shift = 1000 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2 - (surface.low + surface.high) / 2
    object.__setattr__(lab, "instance", instance)
    object.__setattr__(lab, "shift", shift)
    first = np.array(instance.data["first"])
    first[:, 3] += shift
    known = lab.observe(Knowledge(lab.unknown), in_metres(first[None])[0])
    next_view = policy(lab, np.random.default_rng([0, 1]))
    while len(known.poses) < max(instance.data["budgets"]) and (T := next_view(known)) is not None:
        known = lab.observe(known, T)
    poses = in_millimetres(np.array(known.poses))
    poses[:, :, 3] -= shift
    poses[0] = instance.data["first"]
    return list(poses)


def main() -> None:
    """Run a method."""
    method, names = sys.argv[1], sys.argv[2:]
    policy, about = POLICIES[method]
    for name in names or sorted(path.stem for path in Path(HERE / "instances").glob("D-*.json")):
        instance, since = check.load(name), process_time()
        poses = explored(instance, policy)
        entry = {"instance": name, "cpu_s": round(process_time() - since, 1)}
        store(method, about, [entry | {"poses": np.array(poses).reshape(-1, 12).tolist()}])
        sys.stdout.write(f"{method} {name}: {check.judge({'poses': poses}, instance)}, {entry['cpu_s']} s\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
