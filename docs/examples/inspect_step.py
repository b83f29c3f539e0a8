"""Plan a STEP part with tolerances, scan an as-built part in simulation, and read the verdicts."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from cell.api import features, inspect, part, plan, scan

SCENE = Path(__file__).with_name("block.toml")  # part, placement and [[feature]] tables
for each in features(scene=SCENE).characteristics:
    print(f"{each.name}, limits {each.lower} to {each.upper} {each.unit}")
run = plan(scene=SCENE, faces=60, candidates="optimal-scanning-zone", effort="low", out="block")

nominal = part(SCENE.with_name("block.step")).reference
mm = 1000 * nominal.vertices
bore = np.hypot(mm[:, 0] - 30, mm[:, 1] - 20) < 8.01
mm[bore, :2] += 0.15 / 16 * (mm[bore, :2] - [30, 20])  # a bore that is 0.15 mm larger than 16 mm
trimesh.Trimesh(mm, nominal.faces).export("as_built.ply")
result = inspect(scan(run, noise="model", actual="as_built.ply", actual_units="mm"))
for row, each in enumerate(result.characteristics):
    print(f"{each.name} {each.value:.3f} +- {each.expanded_uncertainty:.3f} {each.unit}: {each.verdict}")
    low, zone = each.lower or 0, each.upper - (each.lower or 0)
    plt.errorbar((each.value - low) / zone, row, xerr=each.expanded_uncertainty / zone, fmt="o", capsize=4)
plt.yticks(range(row + 1), [f"{each.name}: {each.verdict}" for each in result.characteristics])
plt.axvspan(0, 1, alpha=0.2, label="tolerance zone")
plt.xlabel("value and U as a share of the tolerance")
plt.savefig("example_inspect_step.png", bbox_inches="tight")
