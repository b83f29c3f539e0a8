"""Another arm, models/kr16.xml with other ranges, speeds and drives: all commands after a plan use its limits."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cell.errors import DriverFailureError, FileError, UsageError
from cell.export import krl, tables
from cell.export.options import ExportOptions
from cell.export.program import ProgramInfo, ProgramSettings, program_of_motion, status_and_turn
from cell.files import model_file
from cell.robot import model as robot
from cell.robot.arm import kr16_kinematics
from cell.robot.plant import MujocoPlant
from cell.runs.run import open_run
from cell.scan import execution, plants
from cell.scan.emulator import load_arm
from cell.scan.execution import plan_execution
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from tests.support.fixture_types import Emulate, RunCommand

TORQUES = [900, 1500, 450, 70, 75, 25]
LOWER, UPPER = [-95, -155, -130, -300, -125, -300], [95, 35, 154, 345, 128, 345]
CHANGES = {
    '"-185 185"': '"-95 95"', '"-350 350"': '"-300 345"', '"-130 130"': '"-125 128"',
    "156 156 156 330 330 615": "80 70 60 150 160 170", "1100 1700 500 80 80 30": " ".join(map(str, TORQUES)),
}  # fmt: skip


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory, part_file: Path, run_cell: RunCommand) -> Iterator[Path]:
    """Yield the run folder of a plan for that arm, which replaces the robot of this process meanwhile."""
    folder = tmp_path_factory.mktemp("other")
    text = model_file("kr16.xml").read_text(encoding="utf-8")
    for old, new in CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot, "spec", lambda: mujoco.MjSpec.from_string(text))
        run_cell(
            "plan", part_file, "--units", "mm", "--place", "1100,400,100", "--faces", "60", "--samples", "2",
            "--standoff", "250", "--candidates", "optimal-scanning-zone", "--coverage", "0.5", "--out", "run",
            cwd=folder, code=0,
        )  # fmt: skip
        yield folder / "run"


def test_planning_driving_and_export_use_its_limits(other: Path, run_cell: RunCommand) -> None:
    """The simulated controller takes the planned time, and exported programs have the ranges."""
    run_cell("scan", other, "--resolution", "2", cwd=other, code=0)
    planned = json.loads((other / "report.json").read_text())["motion"]["duration_s"]
    moving = json.loads((max((other / "executions").iterdir()) / "manifest.json").read_text())["motion_s"]
    assert moving == pytest.approx(planned, abs=1e-3)
    for kind in ("krl", "csv", "json"):
        assert run_cell("export", other, "--format", kind, cwd=other).returncode == 0
    exported = json.loads((other / "export" / "run.json").read_text())
    assert exported["joint_limits_deg"] == [list(pair) for pair in zip(LOWER, UPPER, strict=True)]
    assert "-95" in (other / "export" / "run.src").read_text()


def test_a_kuka_arm_in_a_rounded_file_is_exported_as_krl(
    tmp_path: Path, part_file: Path, run_cell: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its axes are off by less than rounding; status and turn are those of the exact arm."""
    exact = kr16_kinematics()

    def rounded() -> mujoco.MjSpec:
        spec = mujoco.MjSpec.from_file(str(model_file("kr16.xml")))
        spec.joint("A5").axis = [0, 1, 1.4e-5]
        return spec

    monkeypatch.setattr(robot, "spec", rounded)
    run_cell(
        "plan", part_file, "--units", "mm", "--place", "1100,400,100", "--faces", "60", "--samples", "2", "--standoff",
        "250", "--candidates", "optimal-scanning-zone", "--coverage", "0.3", "--out", "run", cwd=tmp_path, code=0,
    )  # fmt: skip
    for kind in ("krl", "json"):
        run_cell("export", "run", "--format", kind, cwd=tmp_path, code=0)
    points = json.loads((tmp_path / "run" / "export" / "run.json").read_text())["via_points"]
    expected = status_and_turn(np.radians([point["axes_deg"] for point in points]), exact)
    assert [point["status"] for point in points] == expected[0].tolist()
    assert [point["turn"] for point in points] == expected[1].tolist()


def test_its_emulator_has_its_limits_and_its_plan_is_driven_there(
    other: Path, emulate: Emulate, run_cell: RunCommand
) -> None:
    """`cell emulate --run` runs in a process with the built-in arm only. The plan is executed over its wire."""
    limits = load_arm(other, "ideal").limits
    assert (limits.lower / 1e4).tolist() == LOWER
    assert (limits.upper / 1e4).tolist() == UPPER
    assert np.degrees(limits.velocity) == pytest.approx([80, 70, 60, 150, 160, 170])
    url = emulate("modbus", "--run", str(other), "--time-scale", "1000").url
    digest = json.loads((other / "manifest.json").read_text())["digest"]
    word = ("--driver", url, "--accept-time-scale", "1000", "--speed", "1", "--confirm-motion", digest)
    process = run_cell("scan", other, "--resolution", "2", *word, cwd=other, code=0)
    assert "the path watch stops a deviating arm before contact up to" in process.stderr


def test_a_plan_that_exceeds_a_controllers_limits_is_refused_before_anything_moves(other: Path) -> None:
    """The message has the move, the axis, the angle and the range."""
    motion = open_run(other).motion
    axis = int(np.argmax(motion.via_q.max(axis=0) - motion.via_q[0]))
    farthest, narrow = motion.via_q[:, axis].max(), motion.limits.upper.copy()
    narrow[axis] = farthest - np.radians(0.1)
    start = ",".join(f"{angle:.4f}" for angle in np.degrees(motion.via_q[0]))
    driver = open_driver(f"sim://?start={start}", Context(Limits.from_rad(replace(motion.limits, upper=narrow))))
    with driver, pytest.raises(DriverFailureError) as refused:
        execution.require_drivable(plan_execution(motion), driver, 1.0)
    sentence = str(refused.value)
    assert re.match(r"the controller refuses move \d+ \(to view \d+\): via point \d+ has A\d at ", sentence)
    bounds = f"{LOWER[axis]:.4f} to {np.degrees(narrow[axis]):.1f}"
    assert f"A{axis + 1} at {np.degrees(farthest):.4f} deg; it must lie in {bounds}" in sentence
    assert sentence.endswith("nothing was moved")


def test_the_dynamic_arm_needs_drives_and_masses(other: Path) -> None:
    """The torque limits are those of the file. Without drives or masses the message has a remedy."""
    run = open_run(other)
    plant = plants.plants_of_run(run)["mujoco"](robot.home(robot.load()))
    assert isinstance(plant, MujocoPlant)
    assert plant.model.actuator_forcerange[:, 1].tolist() == TORQUES
    bare = robot.spec()
    for body in bare.bodies:
        body.mass, body.explicitinertial = 0.0, False
    for geom in bare.geoms:
        geom.density, geom.mass = 0.0, 0.0
    without = robot.spec()
    without.delete(without.numeric("axis_torque_limit_Nm"))
    for spec, words in ((bare, "mass or inertia"), (without, "no <numeric> named axis_torque_limit_Nm")):
        with pytest.raises(FileError, match=f"{words}.*use the ideal arm: sim://"):
            MujocoPlant(np.zeros(6), spec=spec)


def test_only_an_arm_with_kukas_axes_is_written_in_krl(other: Path) -> None:
    """KRL is refused for another arm. Its tables have neither status nor turn."""

    class Mirrored:
        """The same arm with the opposite sign of A1."""

        limits = robot.limits(robot.load())
        _kuka = kr16_kinematics()

        def forward(self, q: np.ndarray) -> np.ndarray:
            return self._kuka.forward(q * [-1, 1, 1, 1, 1, 1])

        inverse = _kuka.inverse  # not called

    motion, info = (
        open_run(other).motion,
        ProgramInfo("name", "krl", "part", "run", "digest", 1.0, 1.0, "kr16", np.nan, ""),
    )
    program = program_of_motion(motion, Mirrored(), np.eye(4), np.eye(4), info)
    with pytest.raises(UsageError, match=r"only arms with KUKA's axes.*choose another --format"):
        krl.source(program, ProgramSettings(20, 30, ExportOptions()))
    points = json.loads(tables.as_json(program))["via_points"]
    assert [(point["status"], point["turn"]) for point in points] == [(None, None)] * len(motion.via_q)
    assert all(line.endswith(",,") for line in tables.csv(program).decode().splitlines()[1:])
    at = kr16_kinematics().forward(motion.via_q[-1:] * [-1, 1, 1, 1, 1, 1])[0, :3, 3] * 1000
    assert points[-1]["flange_xyz_mm_abc_deg"][:3] == pytest.approx(at, abs=1e-6)
