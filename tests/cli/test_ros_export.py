"""`cell export --format ros`: a joint trajectory in ROS's field names, and the cell as URDF."""

import json
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import trimesh

from cell import api
from cell.robot.arm import kinematics_of
from cell.runs.run import open_run


def test_the_trajectory_is_the_planned_motion(planned: Path, tmp_path: Path) -> None:
    """Positions, velocities and accelerations of every sample; times in seconds and nanoseconds."""
    outcome = api.export(planned, format="ros", out=tmp_path, name="trial")
    assert str(tmp_path / "trial_trajectory.json") in outcome.files
    content = json.loads((tmp_path / "trial_trajectory.json").read_text())
    motion = open_run(planned).motion
    assert content["joint_names"] == ["A1", "A2", "A3", "A4", "A5", "A6"]
    for field, values in (("positions", motion.q), ("velocities", motion.qd), ("accelerations", motion.qdd)):
        np.testing.assert_array_equal([point[field] for point in content["points"]], values)
    times = [
        point["time_from_start"]["sec"] + point["time_from_start"]["nanosec"] * 1e-9 for point in content["points"]
    ]
    np.testing.assert_allclose(times, motion.t, atol=1e-9)
    expected = [{"view": number, "time_s": t} for number, t in enumerate(motion.via_t[motion.stops].tolist(), start=1)]
    assert content["views"] == expected
    assert all(isinstance(point["time_from_start"]["sec"], int) for point in content["points"])


def test_the_urdf_is_the_cell(planned: Path, tmp_path: Path) -> None:
    """A stranger's reader gives the flange of the kinematics at random joint angles, the limits, and the part."""
    api.export(planned, format="ros", out=tmp_path, name="trial")
    run, path = open_run(planned), tmp_path / "trial.urdf"
    text = path.read_text().replace("<robot ", '<robot xmlns:x="x" ', 1)
    compiler = '<mujoco><compiler strippath="false" fusestatic="false" balanceinertia="true" boundmass="0.1" '
    compiler += f'boundinertia="0.01" discardvisual="true" meshdir="{tmp_path}"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string(text.replace("</robot>", compiler))
    data, kinematics = mujoco.MjData(model), kinematics_of(run.cell_model())
    rng = np.random.default_rng(3)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"A{axis}") for axis in range(1, 7)]
    np.testing.assert_allclose(model.jnt_range[joints].T, [kinematics.limits.lower, kinematics.limits.upper], atol=1e-9)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "link_6")
    own = run.cell_model()
    for _ in range(20):
        q = rng.uniform(kinematics.limits.lower, kinematics.limits.upper)
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mine = mujoco.MjData(own)
        mine.qpos[:6] = q
        mujoco.mj_kinematics(own, mine)
        link = mujoco.mj_name2id(own, mujoco.mjtObj.mjOBJ_BODY, "link_6")
        np.testing.assert_allclose(data.xpos[body], mine.xpos[link], atol=1e-9)
        np.testing.assert_allclose(data.xmat[body], mine.xmat[link], atol=1e-9)
    root = ElementTree.fromstring(path.read_text())
    part = root.find("joint[@name='base_to_planned_part']/origin")
    assert part is not None
    np.testing.assert_allclose(np.fromstring(part.get("xyz", ""), sep=" "), run.T_base_object[:3, 3], atol=1e-12)
    for mesh in {element.get("filename") for element in root.iter("mesh")}:
        assert len(trimesh.load_mesh(tmp_path / str(mesh)).faces)
