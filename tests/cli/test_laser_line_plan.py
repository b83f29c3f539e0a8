"""`cell plan` with line sensors: views are sweeps, the files say so, and no motion is promised that is not there."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

_OPTIONS = ("--units", "mm", "--place", "1100,400,100", "--faces", "24", "--samples", "2")


@pytest.fixture(scope="module")
def line_plan(
    tmp_path_factory: pytest.TempPathFactory, part_file: Path, run_cell: Run
) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Run folder of a plan with a turned line sensor, and how the command ended."""
    folder = tmp_path_factory.mktemp("line")
    (folder / "line.toml").write_text(
        '[scanner]\ntype = "laser-line"\nsweep_deg = 24.0\nsweep_steps = 5\n', encoding="utf-8"
    )
    arguments = (str(part_file), *_OPTIONS, "--standoff", "250", "--scene", "line.toml", "--out", "run", "--json")
    return folder / "run", run_cell("plan", *arguments, cwd=folder)


def test_a_plan_of_sweeps_ends_in_a_correct_run(line_plan: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    """Columns of five poses, every pose in plan.json, the first of them where the robot's joint angles take it."""
    run, done = line_plan
    assert done.returncode == 0, done.stderr
    plan = json.loads((run / "plan.json").read_text())
    candidates = np.load(run / "viewpoints.npz")["T_object_scanner"]
    assert candidates.shape[1] == 5
    assert plan["views"]
    for view in plan["views"]:
        sweep = np.array(view["sweep"]["T_object_scanner"])
        assert sweep.shape == (5, 4, 4)
        assert (sweep[0] == np.array(view["T_object_scanner"])).all()
        # Rounded set-points move the sweep as a whole, by micrometres.
        np.testing.assert_allclose(sweep, candidates[view["id"]], atol=2e-5)
        relative = np.linalg.inv(sweep[0]) @ sweep
        turn = np.degrees(np.arctan2(relative[:, 0, 2], relative[:, 2, 2]))
        np.testing.assert_allclose(turn, np.arange(5) * 24 / 5, atol=1e-9)
        np.testing.assert_allclose(relative[:, :3, 3], 0, atol=1e-12)
    assert json.loads((run / "scene.resolved.json").read_text())["scanner"]["sweep_deg"] == 24.0


def test_the_whole_sweep_is_reachable_and_only_its_first_pose_is_in_the_motion(
    line_plan: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """The joint solutions are those of the first poses; a candidate of which a later pose fails is not reachable."""
    from cell.robot.kinematics import Kr16Kinematics

    run, _ = line_plan
    import mujoco

    kinematics = Kr16Kinematics.from_model(mujoco.MjModel.from_xml_path(str(run / "cell.xml")))
    resolved = json.loads((run / "scene.resolved.json").read_text())
    T_base_object, T_flange_scanner = (np.array(resolved[name]) for name in ("T_base_object", "T_flange_scanner"))
    plan = json.loads((run / "plan.json").read_text())
    motion = np.load(run / "motion.npz")
    stops = motion["via_q"][motion["view"] >= 0]
    T = np.linalg.inv(T_base_object) @ kinematics.forward(stops) @ T_flange_scanner
    np.testing.assert_allclose(T, [view["T_object_scanner"] for view in plan["views"]], atol=1e-9)
    limits = np.radians(np.array(resolved["joint_limits_deg"]))
    reachable = np.load(run / "reach.npz")["verdict"] == 0
    poses = T_base_object @ np.load(run / "viewpoints.npz")["T_object_scanner"] @ np.linalg.inv(T_flange_scanner)
    assert 0 < reachable.sum() < len(reachable)
    for sweep in poses[reachable]:
        q = kinematics.inverse(sweep)
        q = np.concatenate([q, q + 2 * np.pi, q - 2 * np.pi], axis=1)
        inside = ((q >= limits[:, 0] - 1e-6) & (q <= limits[:, 1] + 1e-6)).any(axis=1)
        assert inside.all()


def test_what_the_motion_lacks_is_said(line_plan: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    """On the terminal, in the page and in report.json."""
    run, done = line_plan
    assert "the sweep itself is not in the motion yet" in done.stderr
    assert "The sweep itself is not in this motion yet" in (run / "report.md").read_text()
    summary = json.loads(done.stdout)
    assert summary["settings"]["sweep_poses"] == 5
    assert summary["settings"]["sweep_in_motion"] is False
    assert summary["coverage"]["visible_with_arm"] is None


def test_sweeps_are_not_executed(
    line_plan: tuple[Path, subprocess.CompletedProcess[str]], run_cell: Run, tmp_path: Path
) -> None:
    """`cell scan` refuses before it makes a folder; `cell replay` shows the run."""
    run, _ = line_plan
    done = run_cell("scan", str(run), cwd=tmp_path)
    assert done.returncode == 2
    assert "are sweeps, and its motion holds only their first poses" in done.stderr
    assert not (run / "executions").exists()


def test_a_sensor_is_chosen_by_name(run_cell: Run, part_file: Path, tmp_path: Path) -> None:
    """Missing figures end the command; given ones make a plan whose standoff is the middle of the sensor's range."""
    arguments = ("plan", str(part_file), *_OPTIONS, "--sensor", "gocator-2330", "--out", "run", "--json")
    done = run_cell(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "gocator-2330 does not state its baseline; set scanner.baseline_mm" in done.stderr
    assert not (tmp_path / "run").exists()
    done = run_cell(*arguments, "--baseline", "60", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    settings = json.loads(done.stdout)["settings"]
    assert settings["sensor"] == "gocator-2330"
    assert settings["standoffs_mm"] == pytest.approx([138.947368], abs=1e-5)
    assert "its body is not stated; set housing.size_mm" in done.stderr
    resolved = json.loads((tmp_path / "run" / "scene.resolved.json").read_text())
    assert resolved["scanner"]["type"] == "laser-line"
    assert resolved["scanner"]["fan_deg"] == pytest.approx(26.7204, abs=1e-4)


def test_cell_sensors_lists_what_is_known(run_cell: Run, tmp_path: Path) -> None:
    """A table for a person, one object for a program, with the sources and what has to be given."""
    done = run_cell("sensors", cwd=tmp_path)
    assert done.returncode == 0
    assert "gocator-2350" in done.stdout
    listed = json.loads(run_cell("sensors", "--json", cwd=tmp_path).stdout)["sensors"]
    assert {sensor["name"] for sensor in listed} >= {"gocator-2330", "keyence-lj-v7200"}
    for sensor in listed:
        assert set(sensor["source"]) == set(sensor["figures"])
        assert "baseline_mm" in sensor["to_be_given"]
