"""Judge the run folder that the main job left: finished, complete, and true by kinematics written for this check."""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np

run = Path(sys.argv[1])
manifest = json.loads((run / "manifest.json").read_text())
assert (manifest["status"], manifest["exit_code"]) == ("finished", 0), manifest
for name in manifest["artefacts"]:
    assert (run / name).stat().st_size > 0, name
plan = json.loads((run / "plan.json").read_text())
assert plan["lower_bound"] <= len(plan["views"])
assert plan["coverage"]["visible_of_coverable"] > 0.98
model = mujoco.MjModel.from_xml_path(str(run / "cell.xml"))
data = mujoco.MjData(model)
for view in plan["views"]:
    data.qpos[:] = np.radians(view["q_deg"])
    mujoco.mj_kinematics(model, data)
    site = data.site("flange")
    T = np.array(view["T_base_flange"])
    assert np.abs(site.xpos - T[:3, 3]).max() < 1e-9
    assert np.abs(site.xmat.reshape(3, 3) - T[:3, :3]).max() < 1e-9
print(f"{run}: {len(plan['views'])} views, visible {plan['coverage']['visible']:.4f}, seconds {manifest['seconds']}")  # noqa: T201
