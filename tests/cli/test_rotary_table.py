"""`cell plan --table` to `cell scan`: files, verification, points in the part's frame, refusals."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.api import edit, locate
from cell.errors import FileError, SceneError
from cell.runs.cell import read_cell, world_of
from cell.runs.current_files import CurrentFiles
from cell.runs.current_scene import require_current_scene
from cell.runs.run import open_run, read_execution
from cell.runs.verification import verify_plan
from cell.scan.emulator import SCHEMA
from cell.scene.file import scene_from_options
from cell.session import LoggedProgress
from cell.study.placement_trial import evaluate_placement
from cell.study.prepared_part import scene_settings
from cell.view.replay import load_playback
from cell.world.model import World
from drivers.setpoints import from_rad
from planner import cover
from planner.kinematics.frames import kuka_abc_from_pose
from planner.path.certified_edge import quantise
from planner.timing.move_time import move_time
from tests.support.fixture_types import Emulate, RunCommand

_SMALLER = ("--faces", "60", "--coverage", "0.9")


def _json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def test_files_hold_the_angle_of_the_table(turned: Path) -> None:
    """via_q is (N, 6) and via_e is (N, 1). Every view has e_deg and its pose of the part. The layout is 2."""
    stored = np.load(turned / "motion.npz")
    assert stored["via_q"].shape[1] == 6
    assert stored["via_e"].shape == (len(stored["via_q"]), 1)
    assert stored["limit_velocity"].shape == (7,)
    plan, manifest = _json(turned / "plan.json"), _json(turned / "manifest.json")
    assert manifest["schema"] == plan["schema"] == "scan-cell/run/3"
    scene = _json(turned / "scene.resolved.json")
    axis = np.array(scene["table"]["T_base_table"])[:3, 3]
    for view in plan["views"]:
        (angle,) = np.radians(view["e_deg"])
        T = np.eye(4)
        T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        T[:3, 3] = axis - T[:3, :3] @ axis
        np.testing.assert_allclose(view["T_base_object"], T @ np.array(scene["T_base_object"]), atol=1e-12)
        seen = np.array(view["T_base_object"]) @ np.array(view["T_object_scanner"])
        np.testing.assert_allclose(view["T_base_scanner"], seen, atol=1e-12)
    assert len({tuple(view["e_deg"]) for view in plan["views"]}) > 1
    assert open_run(turned).reach.q.shape[1] == 7


def test_views_are_taken_between_the_angles_that_were_looked_at(turned: Path) -> None:
    """Some views are at no multiple of 10 deg. Each has the pose of its candidate and one of its joint solutions."""
    plan, found = _json(turned / "plan.json"), open_run(turned).reach
    candidates = np.load(turned / "viewpoints.npz")["T_object_scanner"].reshape(-1, 4, 4)
    for view in plan["views"]:
        np.testing.assert_allclose(view["T_object_scanner"], candidates[view["id"]], atol=2e-5)
        q = np.radians([*view["q_deg"], *view["e_deg"]])
        assert (np.abs(found.configurations_of(view["id"]) - q).max(axis=1) < 1e-9).sum() == 1
    assert any(view["e_deg"][0] % 10 for view in plan["views"])


def test_a_plan_without_a_table_has_nothing_of_it(planned: Path) -> None:
    """A plan without a table has no array and no key of a table, and layout 1."""
    assert not {"via_e", "e", "ed", "edd"} & set(np.load(planned / "motion.npz").files)
    assert "e" not in np.load(planned / "reach.npz").files
    assert "table" not in _json(planned / "scene.resolved.json")
    assert all("e_deg" not in view and "T_base_object" not in view for view in _json(planned / "plan.json")["views"])
    assert _json(planned / "manifest.json")["schema"] == "scan-cell/run/3"


def test_the_slowest_of_seven_axes_sets_the_time(turned: Path) -> None:
    """The duration follows from the limits of all seven axes. The table is at angle 0 at begin and end."""
    motion = open_run(turned).motion
    times = move_time(motion.via_q[:-1], motion.via_q[1:], motion.limits)
    assert motion.duration == pytest.approx(times.sum())
    lower, upper = motion.limits.lower, motion.limits.upper
    assert ((motion.q >= lower - 1e-9) & (motion.q <= upper + 1e-9)).all()
    assert (np.abs(motion.qd) <= motion.limits.velocity + 1e-9).all()
    assert (motion.via_q[[0, -1], 6] == 0).all()


def test_the_plan_is_verified_and_a_changed_table_is_found(turned: Path, tmp_path: Path) -> None:
    """The run folder is verified alone. A changed diameter of the table is an error."""
    assert verify_plan(turned).world.table is not None
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    text = (copy / "scene.resolved.json").read_text(encoding="utf-8")
    (copy / "scene.resolved.json").write_text(text.replace('"diameter_mm": 400.0', '"diameter_mm": 300.0'))
    with pytest.raises(Exception, match=r"scene\.resolved\.json"):
        verify_plan(copy)


def test_an_execution_measures_the_predicted_coverage(turned: Path) -> None:
    """The achieved coverage is the predicted one. Scans store six joint angles and the table's angle."""
    report = _json(turned / "executions" / "0001" / "report.json")
    coverage = report["coverage"]
    assert coverage["visible"] == pytest.approx(coverage["predicted"], abs=1e-6)
    assert report["deviation"]["rms_mm"] < 0.5
    scan = np.load(turned / "executions" / "0001" / "scans" / "0001.npz")
    assert scan["q_reported"].shape == (6,)
    assert scan["e_reported"].shape == (1,)


def test_a_dynamic_arm_and_table_measure_from_their_reported_pose(
    turned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """All seven reported axes are near the commanded ones. The stored pose of a scan uses the reported axes."""
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    run_cell("scan", copy, "--resolution", "1", "--driver", "sim://?plant=mujoco", cwd=tmp_path, code=0)
    cell = read_cell(open_run(copy))
    scans = [np.load(path) for path in sorted((copy / "executions" / "0002" / "scans").iterdir())]
    for scan in scans:
        commanded, message = (
            np.concatenate([scan[f"q_{each}"], scan[f"e_{each}"]]) for each in ("commanded", "reported")
        )
        assert 0 < np.degrees(np.abs(message - commanded)).max() < 0.01
        T = (
            np.linalg.inv(cell.scene.T_base_object)
            @ cell.kinematics.forward(message[None])[0]
            @ cell.scene.T_flange_scanner
        )
        np.testing.assert_allclose(scan["T_object_scanner"], T, atol=1e-9)
    assert any((scan["e_reported"] != scan["e_commanded"]).any() for scan in scans)


def test_the_motion_of_one_view_is_stored_as_that_of_a_plan(turned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The stored motion of `--view` has the table's angles and is read with seven axes."""
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    run_cell("scan", copy, "--view", "1", "--resolution", "1", cwd=tmp_path, code=0)
    stored = np.load(copy / "executions" / "0002" / "motion.npz")
    assert (stored["via_q"].shape[1], stored["via_e"].shape[1]) == (6, 1)
    driven = read_execution(open_run(copy), "0002").motion
    assert driven is not None
    np.testing.assert_array_equal(driven.via_q, np.concatenate([stored["via_q"], stored["via_e"]], axis=1))


def test_a_scan_begins_at_the_present_angle_of_the_table(turned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """With the table at 60 deg, an approach path of all seven axes begins there and ends at the first view."""
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    (copy / "executions" / "0001" / "scans" / "0001.npz").unlink()
    home = open_run(copy).motion.via_q[0]
    start = ",".join(f"{angle:.4f}" for angle in [*np.degrees(home[:6]), 60.0])
    run_cell("scan", copy, "--resume", "0001", "--driver", f"sim://?start={start}", cwd=tmp_path, code=0)
    (resumed,) = _json(copy / "executions" / "0001" / "manifest.json")["resumptions"]
    way = np.array(resumed["path_deg"])
    np.testing.assert_allclose(way[0], [*np.degrees(home[:6]), 60.0], atol=1e-4)
    view = _json(copy / "plan.json")["views"][0]
    np.testing.assert_allclose(way[-1], [*view["q_deg"], *view["e_deg"]], atol=1e-4)


@pytest.mark.parametrize("turns", [2, pytest.param(-3, marks=pytest.mark.slow)])
def test_an_endless_table_continues_from_its_present_turn(
    turned: Path, run_cell: RunCommand, tmp_path: Path, turns: int
) -> None:
    """The number of whole turns is reported and added to every angle, but not stored in scans. Results are equal."""
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    start = ",".join(f"{angle:.4f}" for angle in [*np.degrees(open_run(copy).motion.via_q[0, :6]), 360.0 * turns])
    process = run_cell("scan", copy, "--resolution", "1", "--driver", f"sim://?start={start}", cwd=tmp_path, code=0)
    assert f"{turns:+d} whole turns from the plan's angles" in process.stderr
    first, second = (copy / "executions" / name for name in ("0001", "0002"))
    for name in sorted(path.name for path in (first / "scans").iterdir()):
        before, after = np.load(first / "scans" / name), np.load(second / "scans" / name)
        for key in ("e_commanded", "e_reported", "points"):
            np.testing.assert_array_equal(after[key], before[key])
    events = [[json.loads(line) for line in (at / "events.jsonl").read_text().splitlines()] for at in (first, second)]
    assert "whole_turns" not in events[0][0]
    assert events[1][0]["whole_turns"] == turns
    # It keeps its turn and takes no longer than from angle 0.
    assert [each["t_s"] for each in events[1]] == pytest.approx([each["t_s"] for each in events[0]], abs=1e-6)


def test_a_changed_table_of_the_scene_is_found(turned: Path, tmp_path: Path) -> None:
    """Another speed, place or mode of the table, or no table, is reported as a difference."""
    proven = verify_plan(turned)
    for text in (
        "[table]\nvelocity_deg_s = 77",
        "[table]\nposition_mm = [1200, 500, -900]",
        '[table]\nmoves = "indexed"',
        "",
    ):
        (tmp_path / "now.toml").write_text(text)
        with pytest.raises(SceneError, match="the table differs from the plan"):
            require_current_scene(proven, CurrentFiles(scene=tmp_path / "now.toml"), None, wire=False)


def test_replay_turns_the_part(turned: Path) -> None:
    """At each stop the part has its pose of plan.json."""
    playback = load_playback(open_run(turned), None, LoggedProgress())
    for stop, view in zip(playback.timeline.stops, _json(turned / "plan.json")["views"], strict=True):
        playback.pose(stop.begin)
        np.testing.assert_allclose(playback.data.body("object").xpos, np.array(view["T_base_object"])[:3, 3], atol=1e-6)


def test_the_page_puts_the_part_on_a_link_of_its_own(
    turned: Path, run_cell: RunCommand, data_of: Callable[[str], dict[str, Any]], tmp_path: Path
) -> None:
    """The part turns with the last link of the chain, driven by the seventh angle."""
    run_cell("view", turned, "--out", tmp_path / "page.html", cwd=tmp_path, code=0)
    data = data_of((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert data["part_link"] == len(data["arm"]["parent"])
    assert data["arm"]["driver"][-1] == 6
    assert {piece["name"] for piece in data["pieces"] if piece["link"] == data["part_link"]} == {"post"}


def _share(run: Path) -> float:
    return float(_json(run / "report.json")["coverage"]["visible"])


def test_why_explains_all_uncovered_surface(turned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The shares sum to one. The upside-down set-up is tried, and turns of the table are not."""
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    run_cell("why", copy, "--samples", "1500", "--json", cwd=tmp_path, code=0)
    why = _json(copy / "why" / "why.json")
    assert why["visible"] + why["uncovered"] == pytest.approx(1.0, abs=1e-6)
    assert why["visible"] == pytest.approx(_share(copy), abs=0.01)
    turns = [each["change"] for each in why["all_changes"] if each["kind"] == "turn"]
    assert turns == ["a second set-up with the part upside down"]


def test_a_table_never_needs_more_views(planned: Path, turned: Path) -> None:
    """For each coverage possible without a table, the proven smallest number of views is not larger with one."""
    runs = [open_run(folder) for folder in (planned, turned)]
    matrices, usable = [run.measurability for run in runs], [run.reach.reachable for run in runs]
    n = min(len(M.samples) for M in matrices)  # the rows of both: each selection may have added rows of its own
    points = [M.samples.points[:n] for M in matrices]
    np.testing.assert_array_equal(*points)
    areas = next(M.samples.areas for M in matrices if len(M.samples) == n)
    coverable = [float(areas[np.diff(M.indptr[: n + 1]) > 0].sum()) for M in matrices]
    assert coverable[1] >= coverable[0]
    for share in (0.5, 0.8, 0.9, 0.95, 0.99, 1.0):
        fixed, table = (
            cover.solve(
                cover.CoverProblem(M.matrix()[:n], areas, may, coverage=share * coverable[0] / can),
                rng=np.random.default_rng(0), solver="exact",
            )
            for M, may, can in zip(matrices, usable, coverable, strict=True)
        )  # fmt: skip
        assert fixed.status is table.status is cover.CoverStatus.PROVEN
        assert len(table.views) <= len(fixed.views)


def test_a_further_set_up_keeps_the_table(turned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A second, upside-down set-up on the same table increases the coverage, and its motion is verified."""
    further = ("--proposals", "1", "--place", "1100,400,100,0,0,180", "--coverage", "1", "--out", "over")
    run_cell("setups", "--first", turned, *further, cwd=tmp_path, code=0)
    file = _json(tmp_path / "over" / "setups.json")
    assert len(file["selected"]) == 2
    assert file["coverage"]["visible"] > file["selected"][0]["visible"] == pytest.approx(_share(turned), abs=0.001)
    first, second = (tmp_path / "over" / "setups" / number for number in "12")
    tables = [_json(run / "scene.resolved.json")["table"] for run in (first, second)]
    np.testing.assert_allclose(tables[0]["T_base_table"], tables[1]["T_base_table"], atol=1e-8)
    assert verify_plan(second).world.table is not None


def test_views_are_edited_and_the_motion_of_seven_axes_certified_again(
    turned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """A view moved to its own pose in base at its table angle is unchanged. All edited plans are verified."""
    stop, view = next((n, v) for n, v in enumerate(_json(turned / "plan.json")["views"], 1) if v["e_deg"][0])
    T = np.array(view["T_base_scanner"])
    position, abc = kuka_abc_from_pose(T)
    pose = ",".join(repr(float(number)) for number in [*(1000 * position), *np.degrees(abc)])
    angle = f"--table-angle={view['e_deg'][0]}"
    process = run_cell("edit", turned, "--move", f"{stop}:{pose}", angle, "--out", "same", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr
    again = min(
        float(np.abs(np.array(each["T_object_scanner"]) - view["T_object_scanner"]).max())
        for each in _json(tmp_path / "same" / "plan.json")["views"]
    )
    assert again < 1e-4  # set-points are rounded
    assert verify_plan(tmp_path / "same").world.table is not None
    fewer = edit(turned, drop=[1], out=tmp_path / "fewer", use_cache=False)
    assert len(fewer.plan.views) == len(_json(turned / "plan.json")["views"]) - 1
    assert verify_plan(fewer.folder).world.table is not None


def test_a_turned_part_is_located_at_angle_0(turned: Path, tmp_path: Path) -> None:
    """Points in base at a view's table angle, with the view's number, give the placement."""
    run = open_run(turned)
    stop, view = next((n, v) for n, v in enumerate(run.plan.views, 1) if v.e_deg[0])
    moved = np.eye(4)
    moved[:3, 3] = 0.002, -0.001, 0.0
    points = run.reference.vertices @ (T := view.T_base_object @ moved)[:3, :3].T + T[:3, 3]
    np.savetxt(tmp_path / "points.xyz", 1000 * points)
    found = locate(turned, points=str(tmp_path / "points.xyz"), points_frame="base", points_units="mm", view=[stop])
    np.testing.assert_allclose(found.T_base_object, run.T_base_object @ moved, atol=1e-5)
    there = edit(run, T_base_object=found.T_base_object, repair=True, out=tmp_path / "there", use_cache=False)
    tables = [_json(folder / "scene.resolved.json")["table"]["T_base_table"] for folder in (turned, there.folder)]
    np.testing.assert_allclose(*tables, atol=1e-9)  # the part was moved on the table; the table keeps its place


def test_a_part_that_is_located_beside_the_axis_swings_its_post(turned: Path) -> None:
    """On the axis a post turns in place. Off the axis it is checked against the pedestal. The table keeps its place."""
    run = open_run(turned)
    reference, T = run.mesh("reference.ply"), np.array(run.scene.T_base_object)
    planned = world_of(run, reference)
    T[0, 3] += 0.004
    there = world_of(run, reference, T_base_object=T)
    assert [("post", "pedestal") in _checked_pairs(world) for world in (planned, there)] == [False, True]
    np.testing.assert_allclose(there.T_base_object, T, atol=1e-9)
    assert planned.table is not None
    assert there.table is not None
    np.testing.assert_allclose(there.table.T_base_table, planned.table.T_base_table, atol=1e-9)


def _checked_pairs(world: World) -> set[tuple[str, str]]:
    names = [(world.entities[a], world.entities[b]) for a, b in world.pairs]
    return {*names, *((b, a) for a, b in names)}


def test_a_placement_is_evaluated_with_the_table_below_the_part(part_file: Path) -> None:
    """At both placements the table increases the reachable candidates and does not reduce the coverable surface."""
    found = {}
    for on_table in (False, True):
        scene = scene_from_options(None, {"table": on_table, "units": "mm", "faces": 60}, part_file)
        for x in (900.0, 1200.0):
            settings = {
                **scene_settings(scene), "position_mm": [x, 0.0, 200.0], "abc_deg": [0.0, 0.0, 0.0],
                "what": "coverage", "solver": "greedy", "candidates": 60,
            }  # fmt: skip
            found[on_table, x] = evaluate_placement(settings)
    for x in (900.0, 1200.0):
        assert found[True, x]["reachable"] > found[False, x]["reachable"]
        assert found[True, x]["coverable"] >= found[False, x]["coverable"]


def test_an_exported_program_drives_the_table_as_e1(turned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """Every PTP has the seven angles of its via point, and the stop check includes E1. The CSV table has E1 too."""
    via = np.degrees(open_run(turned).motion.via_q).round(4)
    run_cell("export", turned, "--out", tmp_path / "krl", "--name", "TURNED", cwd=tmp_path, code=0)
    text = (tmp_path / "krl" / "TURNED.src").read_text(encoding="ascii")
    number = r"(-?\d+\.\d{4})"
    axes = ",".join(f"{name} {number}" for name in ("A1", "A2", "A3", "A4", "A5", "A6", "E1"))
    driven = re.findall(r"^PTP \{E6AXIS: " + axes + ",E2 0,E3 0,E4 0,E5 0,E6 0", text, flags=re.MULTILINE)
    np.testing.assert_allclose(np.array(driven, dtype=float), via, atol=1e-9)
    assert "ABS($AXIS_ACT.E1-SC_STOP.E1)>SC_NEAR" in text
    run_cell("export", turned, "--out", tmp_path / "csv", "--format", "csv", "--name", "TURNED", cwd=tmp_path)
    header, *rows = (tmp_path / "csv" / "TURNED.csv").read_text(encoding="utf-8").splitlines()
    column = header.split(",").index("E1_deg")
    np.testing.assert_allclose([float(row.split(",")[column]) for row in rows], via[:, 6], atol=1e-9)


@pytest.mark.parametrize("protocol", ["modbus", pytest.param("serial", marks=pytest.mark.slow)])
def test_seven_axes_are_driven_over_a_wire(
    turned: Path, run_cell: RunCommand, emulate: Emulate, tmp_path: Path, protocol: str
) -> None:
    """An emulated controller with the table two turns on gives the same coverage as the simulated one."""
    copy = Path(shutil.copytree(turned, tmp_path / "run"))
    axes = from_rad([*open_run(copy).motion.via_q[0, :6], 4 * np.pi]).tolist()
    stood = {"schema": SCHEMA, "axes": axes, "boot": 1, "ended_in_order": True}
    (tmp_path / "arm.json").write_text(json.dumps(stood))
    before = SimpleNamespace(log=tmp_path / "moves.jsonl")
    emulated = emulate(protocol, "--run", str(copy), "--time-scale", "1000", partner=before)
    digest = _json(copy / "manifest.json")["digest"]
    word = ("--driver", emulated.url, "--accept-time-scale", "1000", "--speed", "1", "--confirm-motion", digest)
    run_cell("scan", copy, "--resolution", "1", *word, cwd=tmp_path, code=0)
    first, second = (_json(copy / "executions" / name / "report.json") for name in ("0001", "0002"))
    assert second["coverage"]["visible"] == pytest.approx(first["coverage"]["visible"], abs=1e-6)
    scan = np.load(copy / "executions" / "0002" / "scans" / "0001.npz")
    np.testing.assert_allclose(
        np.degrees(scan["e_reported"]), _json(copy / "plan.json")["views"][0]["e_deg"], atol=1e-3
    )


def test_plans_that_cannot_have_a_table_refuse_it(run_cell: RunCommand, part_file: Path, tmp_path: Path) -> None:
    """An exploration and a scanner that sweeps are refused with exit code 2."""
    (tmp_path / "line.toml").write_text('[scanner]\ntype = "laser-line"\n')
    part = (part_file, "--units", "mm", "--table")
    for command in (("explore", *part), ("plan", *part, "--scene", "line.toml")):
        process = run_cell(*command, cwd=tmp_path)
        assert process.returncode == 2, (command, process.stderr)
        assert "does not support a rotary table yet" in process.stderr


def test_an_indexed_table_is_planned_verified_and_resumed(
    small_plan: tuple[str, ...], part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """Arm and table never move simultaneously, in the plan and on the approach path. Such a motion is refused."""
    (tmp_path / "indexed.toml").write_text('[table]\nmoves = "indexed"\n')
    scene = ("--scene", "indexed.toml")
    run_cell("plan", part_file, "--units", "mm", *small_plan, *_SMALLER, *scene, "--out", "run", cwd=tmp_path, code=0)
    run = tmp_path / "run"
    via = open_run(run).motion.via_q
    moved = np.diff(via, axis=0) != 0
    assert not (moved[:, :6].any(axis=1) & moved[:, 6]).any()
    assert moved[:, 6].any()
    assert verify_plan(run).motion.limits.table_turn_q is not None
    start = ",".join(f"{angle:.4f}" for angle in [*np.degrees(via[0, :6]), 60.0])
    run_cell("scan", run, "--resolution", "1", cwd=tmp_path, code=0)
    (run / "executions" / "0001" / "scans" / "0001.npz").unlink()
    run_cell("scan", run, "--resume", "0001", "--driver", f"sim://?start={start}", cwd=tmp_path, code=0)
    (resumed,) = _json(run / "executions" / "0001" / "manifest.json")["resumptions"]
    moved = np.abs(np.diff(np.array(resumed["path_deg"]), axis=0)) > 1e-3
    assert not (moved[:, :6].any(axis=1) & moved[:, 6]).any()
    with pytest.raises(FileError, match="the path moves arm and table at once"):
        verify_plan(run).require_path_free(np.stack([via[0], quantise(via[0] + np.radians([1, 0, 0, 0, 0, 0, 1]))]))


def test_a_tilted_axis_is_planned_scanned_and_placed_as_an_upright_one(
    run_cell: RunCommand, part_file: Path, small_plan: tuple[str, ...], tmp_path: Path
) -> None:
    """At each view the part is turned about the tilted axis. The dynamic arm is refused."""
    (tmp_path / "tilted.toml").write_text("[table]\nabc_deg = [0.0, -30.0, 20.0]\n", encoding="utf-8")
    run_cell(
        "plan", part_file, "--units", "mm", *small_plan, *_SMALLER, "--scene", "tilted.toml", "--out", "run",
        cwd=tmp_path, code=0,
    )  # fmt: skip
    scene = _json(tmp_path / "run" / "scene.resolved.json")
    T_base_table, T_base_object = np.array(scene["table"]["T_base_table"]), np.array(scene["T_base_object"])
    np.testing.assert_allclose(np.degrees(np.arccos(T_base_table[2, 2])), 35.531, atol=1e-3)
    turned_by = set()
    for view in _json(tmp_path / "run" / "plan.json")["views"]:
        turn, face = Rotation.from_rotvec(np.radians(view["e_deg"][0]) * T_base_table[:3, 2]), T_base_table[:3, 3]
        at = turn.apply(T_base_object[:3, 3] - face) + face
        np.testing.assert_allclose(np.array(view["T_base_object"])[:3, 3], at, atol=1e-9)
        turned_by.add(view["e_deg"][0])
    assert len(turned_by) > 1
    proven = verify_plan(tmp_path / "run")
    again = world_of(proven.run, proven.world.part_mesh).table
    assert again is not None
    np.testing.assert_allclose(again.T_base_table, T_base_table, atol=1e-9)
    run_cell("scan", "run", "--resolution", "1", cwd=tmp_path, code=0)
    coverage = _json(tmp_path / "run" / "executions" / "0001" / "report.json")["coverage"]
    assert coverage["visible"] == pytest.approx(coverage["predicted"], abs=1e-6)
    refused = run_cell("scan", "run", "--driver", "sim://?plant=mujoco", cwd=tmp_path)
    assert refused.returncode != 0
    assert "with an upright axis only" in refused.stderr
    run_cell("export", "run", "--out", "program", cwd=tmp_path, code=0)
    text = next((tmp_path / "program").glob("*.src")).read_text(encoding="ascii")
    message = re.search(
        r"rotary table: its frame in the base of this program is {X (.*),Y (.*),Z (.*),A (.*),B (.*),C (.*)}", text
    )
    assert message is not None
    x, y, z, *abc = map(float, message.groups())
    np.testing.assert_allclose([x, y, z], 1000 * T_base_table[:3, 3], atol=1e-3)
    np.testing.assert_allclose(abc, [0.0, -30.0, 20.0], atol=1e-4)
