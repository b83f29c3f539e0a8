"""`cell plan` with line sensors: views are sweeps, and the motion drives each sweep as a line at constant speed."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.fixture_types import RunCommand

_OPTIONS = (
    "--units", "mm", "--place", "1100,400,100", "--faces", "24", "--samples", "2",
    "--candidates", "optimal-scanning-zone",
)  # fmt: skip


def test_a_plan_of_sweeps_ends_in_a_correct_run(swept: Path) -> None:
    """A candidate has five poses. plan.json has all of them with joint angles; the middle pose is that of the view."""
    plan = json.loads((swept / "plan.json").read_text())
    candidates = np.load(swept / "viewpoints.npz")["T_object_scanner"]
    assert candidates.shape[1] == 5
    assert plan["views"]
    for view in plan["views"]:
        sweep = np.array(view["sweep"]["T_object_scanner"])
        assert sweep.shape == (5, 4, 4)
        np.testing.assert_allclose(sweep[2], view["T_object_scanner"], atol=1e-12)
        assert view["sweep"]["q_deg"][2] == view["q_deg"]
        # Rounded set-points: each pose has an error of some micrometres.
        np.testing.assert_allclose(sweep, candidates[view["id"]], atol=2e-5)
        relative = np.linalg.inv(sweep[0]) @ sweep
        turn = np.degrees(np.arctan2(relative[:, 0, 2], relative[:, 2, 2]))
        np.testing.assert_allclose(turn, np.arange(5) * 24 / 5, atol=1e-3)
        np.testing.assert_allclose(relative[:, :3, 3], 0, atol=3e-5)
        assert view["sweep"]["angle_deg"] == pytest.approx(24)
        assert 0 < view["sweep"]["speed_deg_s"] <= np.degrees(0.35) + 1e-6
    assert json.loads((swept / "scene.resolved.json").read_text())["scanner"]["sweep_deg"] == 24.0


def test_the_motion_holds_every_sweep_as_a_line_at_constant_speed(swept: Path) -> None:
    """In the stored arrays each sweep has its poses in order, a fixed source, a constant rate and valid limits."""
    import mujoco

    from cell.robot.arm import kinematics_of

    kinematics = kinematics_of(mujoco.MjModel.from_xml_path(str(swept / "cell.xml")))
    resolved = json.loads((swept / "scene.resolved.json").read_text())
    T_base_object, T_flange_scanner = (np.array(resolved[name]) for name in ("T_base_object", "T_flange_scanner"))
    plan, motion = json.loads((swept / "plan.json").read_text()), np.load(swept / "motion.npz")
    rows = np.flatnonzero(motion["pose"] >= 0)
    assert len(rows) == 5 * len(plan["views"])
    T = np.linalg.inv(T_base_object) @ kinematics.forward(motion["via_q"][rows]) @ T_flange_scanner
    for number, view in enumerate(plan["views"]):
        own = slice(5 * number, 5 * number + 5)
        order = motion["pose"][rows[own]]
        assert order.tolist() == (list(range(4, -1, -1)) if view["sweep"]["backwards"] else list(range(5)))
        assert (motion["view"][rows[own]] == view["id"]).all()
        np.testing.assert_allclose(T[own], np.array(view["sweep"]["T_object_scanner"])[order], atol=1e-9)
        # Between the first and the last pose the rate of turn is constant and the source does not move.
        first, last = motion["via_t"][rows[own][[0, -1]]]
        inside = (motion["t"] >= first) & (motion["t"] <= last)
        t, flange = motion["t"][inside], kinematics.forward(motion["q"][inside])
        scanner = flange @ T_flange_scanner
        assert np.ptp(scanner[:, :3, 3], axis=0).max() < 2e-5
        cosine = 0.5 * (np.trace(scanner[:, :3, :3] @ scanner[0, :3, :3].T, axis1=1, axis2=2) - 1)
        rate = np.polyfit(t - t[0], np.degrees(np.arccos(np.clip(cosine, -1, 1))), 1)[0]
        assert rate == pytest.approx(view["sweep"]["speed_deg_s"], rel=1e-3)
        assert (motion["line"][rows[own]] == number).all()
    assert (np.abs(motion["qd"]) <= motion["limit_velocity"] + 1e-9).all()
    assert (np.abs(motion["qdd"]) <= motion["limit_acceleration"] + 1e-9).all()
    limits = np.radians(np.array(resolved["joint_limits_deg"]))
    assert (motion["q"] >= limits[:, 0] - 1e-9).all()
    assert (motion["q"] <= limits[:, 1] + 1e-9).all()


def test_missing_checks_are_reported(swept: Path) -> None:
    """The missing check of occlusion is reported on the terminal, in the report page and in report.json."""
    assert "occlusion by the arm itself is not checked" in (swept.parent / "stderr").read_text()
    assert "driven as a straight line at constant speed on one joint branch" in (swept / "report.md").read_text()
    summary = json.loads((swept.parent / "stdout").read_text())
    assert summary["settings"]["sweep_poses"] == 5
    assert summary["settings"]["sweep_in_motion"] is True
    assert summary["coverage"]["visible_with_arm"] is None


def test_sweeps_are_executed_and_exported(swept: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A view is scanned in a motion there and back, with all lines at the reported poses. KRL export is refused."""
    import shutil

    run = Path(shutil.copytree(swept, tmp_path / "run"))
    process = run_cell("scan", str(run), "--view", "2", "--json", cwd=tmp_path, code=0)
    view = json.loads((run / "plan.json").read_text())["views"][1]
    with np.load(run / "executions" / "0001" / "scans" / "0002.npz") as scan:
        np.testing.assert_allclose(scan["sweep_T_object_scanner"], view["sweep"]["T_object_scanner"], atol=1e-9)
        np.testing.assert_allclose(np.degrees(scan["sweep_q_reported"]), view["sweep"]["q_deg"], atol=1e-9)
        np.testing.assert_allclose(scan["T_object_scanner"], view["T_object_scanner"], atol=1e-9)
        assert scan["grid_shape"].tolist() == [5 * 20 * 160, 1]  # a line every 0.25 deg: 20 in a cell of 4.8 deg
        assert len(scan["codes"]) == 5 * 20 * 160
        assert len(scan["points"]) == len(scan["pixel"]) == (scan["codes"] == 0).sum() > 0
    assert json.loads(process.stdout)["coverage"]["visible"] == pytest.approx(
        json.loads(process.stdout)["coverage"]["predicted"], abs=1e-4
    )
    driven = np.load(run / "executions" / "0001" / "motion.npz")
    np.testing.assert_array_equal(driven["via_q"][0], driven["via_q"][-1])
    assert (driven["pose"] >= 0).sum() == 5
    process = run_cell("export", str(run), "--json", cwd=tmp_path, code=2)
    assert "the sweep of view 1 turns by 24.000 deg, and a LIN of KRL may turn differently" in process.stderr
    assert not (run / "export").exists()
    assert run_cell("export", str(run), "--format", "csv", cwd=tmp_path).returncode == 0


def test_a_sensor_is_chosen_by_name(run_cell: RunCommand, part_file: Path, tmp_path: Path) -> None:
    """Missing figures end the command. With them, the standoff is the middle of the sensor's range."""
    arguments = ("plan", str(part_file), *_OPTIONS, "--sensor", "gocator-2330", "--out", "run", "--json")
    process = run_cell(*arguments, cwd=tmp_path, code=2)
    assert "gocator-2330 does not state its baseline; set scanner.baseline_mm" in process.stderr
    assert not (tmp_path / "run").exists()
    process = run_cell(*arguments, "--baseline", "60", "--faces", "12", "--coverage", "0.3", cwd=tmp_path, code=0)
    settings = json.loads(process.stdout)["settings"]
    assert settings["sensor"] == "gocator-2330"
    assert settings["standoffs_mm"] == pytest.approx([138.947368], abs=1e-5)
    assert "its body is not stated; set housing.size_mm" in process.stderr
    resolved = json.loads((tmp_path / "run" / "scene.resolved.json").read_text())
    assert resolved["scanner"]["type"] == "laser-line"
    assert resolved["scanner"]["fan_deg"] == pytest.approx(26.7204, abs=1e-4)


def test_cell_sensors_lists_the_library(run_cell: RunCommand, tmp_path: Path) -> None:
    """The output is a table, or one JSON object with the sources and the figures that the user must give."""
    process = run_cell("sensors", cwd=tmp_path, code=0)
    assert "gocator-2350" in process.stdout
    listed = json.loads(run_cell("sensors", "--json", cwd=tmp_path).stdout)["sensors"]
    assert {sensor["name"] for sensor in listed} >= {"gocator-2330", "keyence-lj-v7200", "generic-area-small", "paper"}
    for sensor in listed:
        assert set(sensor["source"]) == set(sensor["figures"])
        assert ("baseline_mm" in sensor["to_be_given"]) == (sensor["type"] == "laser-line")


def test_a_resolution_is_none_of_a_line_sensor_s_options(swept: Path, run_cell: RunCommand) -> None:
    """The error is one sentence about the option."""
    process = run_cell("scan", "run", "--resolution", "1", cwd=swept.parent, code=2)
    assert process.stderr.startswith(
        "cell: --resolution is the angle between rays, and the scanner laser-line has none"
    )
    assert not (swept / "executions").exists()


def test_sweeps_can_be_edited(swept: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """An edit without changes gives equal bytes. After drop, turn and order each view has the sweep of its pose."""
    before = json.loads((swept / "plan.json").read_text())["views"]
    assert run_cell("edit", swept, "--out", "same", "--json", cwd=tmp_path).returncode == 0
    assert (tmp_path / "same" / "motion.npz").read_bytes() == (swept / "motion.npz").read_bytes()
    assert json.loads((tmp_path / "same" / "plan.json").read_text())["views"] == before
    order = [*range(len(before), 1, -1)]
    options = ("--drop", "1", "--turn", "2:180", "--order", ",".join(map(str, order)), "--out", "edited", "--json")
    process = run_cell("edit", swept, *options, cwd=tmp_path)
    assert (process.returncode, "less than the requested 70 %" in process.stderr) == (3, True), process.stderr
    after = json.loads((tmp_path / "edited" / "plan.json").read_text())["views"]
    assert [view["id"] for view in after][:-1] == [before[number - 1]["id"] for number in order[:-1]]
    candidates = np.load(tmp_path / "edited" / "viewpoints.npz")["T_object_scanner"]
    for view in after:
        np.testing.assert_allclose(view["sweep"]["T_object_scanner"], candidates[view["id"]], atol=2e-5)
    turned = np.array(before[1]["T_object_scanner"]) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    np.testing.assert_allclose(after[-1]["T_object_scanner"], turned, atol=2e-5)
