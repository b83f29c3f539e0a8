"""The exported program in an independent KRL interpreter: its motions, its signals and their times."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.fixture_types import RunCommand
from tests.support.krl_language import Krl, straight_line
from tests.support.robot_programs import HOME, Robot, prompt_scanner, sweeping_program


@pytest.fixture(scope="module")
def exported(planned: Path, run_cell: RunCommand, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """Return `.src` and `.dat` of the small plan with signals 7 and 8."""
    folder = tmp_path_factory.mktemp("krl")
    signals = ("--trigger-output", "7", "--done-input", "8", "--timer", "3", "--timeout", "2.5", "--speed", "0.2")
    run_cell("export", str(planned), "--name", "PART_07", "--out", "out", *signals, cwd=folder, code=0)
    return (folder / "out" / "PART_07.src").read_bytes(), (folder / "out" / "PART_07.dat").read_bytes()


def _driven(exported: tuple[bytes, bytes], robot: Robot) -> Krl:
    program = Krl(*exported, robot)
    program.run()
    return program


def test_the_program_follows_the_planned_via_points_and_poses(exported: tuple[bytes, bytes], planned: Path) -> None:
    """Every via point to 1e-4 deg; at each scan the tool is within 0.01 mm and 0.001 deg."""
    from cell.robot.arm import kr16_kinematics
    from planner.kinematics.frames import pose_from_kuka_abc

    scanned: list[list[float]] = []
    answer = prompt_scanner(7, 8)

    def scanner(robot: Robot) -> None:
        before = robot.inputs.get(8, False)
        answer(robot)
        if robot.inputs[8] and not before:
            scanned.append(list(robot.axes))

    robot = Robot(list(HOME), scanner)
    program = _driven(exported, robot)
    assert program.name == "PART_07"
    assert {kind for kind, _ in robot.moves} == {"PTP"}
    q = np.array([[goal[f"A{axis}"] for axis in range(1, 7)] for _, goal in robot.moves])
    assert all(goal[f"E{axis}"] == 0 for _, goal in robot.moves for axis in range(1, 7))
    via_q = np.degrees(np.load(planned / "motion.npz")["via_q"])
    np.testing.assert_allclose(q, via_q, atol=1e-9, rtol=0)
    tool = robot.variables["$TOOL"]
    T_flange_tool = pose_from_kuka_abc(
        [tool[axis] / 1000 for axis in "XYZ"], np.radians([tool[angle] for angle in "ABC"])
    )
    assert set(robot.variables["$BASE"].values()) == {0.0}
    views = json.loads((planned / "plan.json").read_text())["views"]
    assert len(scanned) == len(views)
    T = kr16_kinematics().forward(np.radians(scanned)) @ T_flange_tool
    expected = np.array([view["T_base_scanner"] for view in views])
    assert np.linalg.norm(T[:, :3, 3] - expected[:, :3, 3], axis=1).max() < 1e-5
    turned = np.swapaxes(T[:, :3, :3], 1, 2) @ expected[:, :3, :3]
    assert np.degrees(np.linalg.norm(turned - np.eye(3), axis=(1, 2))).max() < 0.001


def test_it_settles_triggers_once_per_view_and_resets_the_trigger(exported: tuple[bytes, bytes]) -> None:
    """Between two motions the order is settle, trigger up, answer, trigger down, without motion during the trigger."""
    robot = Robot(list(HOME), prompt_scanner(7, 8))
    _driven(exported, robot)
    up = False
    for (name, at), (_, before) in zip(robot.events[1:], robot.events[:-1], strict=True):
        if name == "OUT7=True":
            assert not up
            assert at - before > 0.2 - 1e-9
        elif name == "OUT7=False":
            assert at - before > 0.3 - 1e-9
        else:
            assert not up
        up = name == "OUT7=True"
    assert sum(name == "OUT7=True" for name, _ in robot.events) == robot.variables["SC_VIEW"] > 1
    assert robot.variables["VEL_PTP"] == 20
    assert robot.variables["$ADVANCE"] == 0


def test_a_silent_scanner_halts_the_program_and_the_view_is_repeated(exported: tuple[bytes, bytes]) -> None:
    """Time-out: reset the trigger, halt at the view without motion; Start repeats the view and continues."""
    silent, prompt = [True], prompt_scanner(7, 8)
    halts: list[tuple[float, int, bool]] = []

    def operator(robot: Robot) -> None:
        halts.append((robot.now, robot.variables["SC_VIEW"], robot.outputs[7]))
        silent[0] = len(halts) < 2

    robot = Robot(list(HOME), lambda robot: None if silent[0] else prompt(robot), operator)
    _driven(exported, robot)
    assert [(view, trigger) for _, view, trigger in halts] == [(1, False), (1, False)]
    assert halts[1][0] - halts[0][0] == pytest.approx(0.2 + 2.5, abs=0.05)
    between = [name for name, at in robot.events if halts[0][0] < at <= halts[1][0]]
    assert between == ["OUT7=True", "OUT7=False", "HALT"]
    assert robot.axes == HOME


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("off", [0.2, -0.2, 360.0])
def test_an_arm_that_was_jogged_during_a_halt_halts_it_again(
    exported: tuple[bytes, bytes], axis: int, off: float
) -> None:
    """After the first time-out: no trigger and no motion until every axis is back at its stop."""
    silent, prompt, stood = [True], prompt_scanner(7, 8), list[tuple[int, list[float]]]()

    def operator(robot: Robot) -> None:
        stood.append((len(robot.moves), list(robot.axes)))
        assert robot.outputs[7] is False
        if len(stood) == 1:
            robot.axes[axis] += off
        elif len(stood) == 3:
            robot.axes = list(stood[0][1])
            robot.axes[axis] += 0.05  # farther than the repeatability, but within SC_NEAR
            silent[0] = False

    robot = Robot(list(HOME), lambda robot: None if silent[0] else prompt(robot), operator)
    _driven(exported, robot)
    assert len(stood) == 3
    assert len({moves for moves, _ in stood}) == 1
    halts = [k for k, (name, _) in enumerate(robot.events) if name == "HALT"]
    assert [name for name, _ in robot.events[halts[0] : halts[-1] + 2]] == ["HALT"] * 3 + ["OUT7=True"]
    assert robot.events[halts[-1] + 1][1] - robot.events[halts[-1]][1] > 0.4 - 1e-9  # settles again
    assert robot.axes == HOME


def test_an_arm_that_was_jogged_before_the_trigger_halts_it(exported: tuple[bytes, bytes]) -> None:
    """After a halt because of a stuck answer, the arm is checked before the trigger rises."""
    hangs, prompt, stood = [True], prompt_scanner(7, 8), list[list[float]]()

    def operator(robot: Robot) -> None:
        stood.append(list(robot.axes))
        hangs[0] = False
        robot.inputs[8] = False
        robot.axes = [angle + 1.0 for angle in robot.axes] if len(stood) == 1 else list(stood[0])

    def scanner(robot: Robot) -> None:
        if hangs[0]:
            robot.inputs[8] = True
        else:
            prompt(robot)

    robot = Robot(list(HOME), scanner, operator)
    _driven(exported, robot)
    names = [name for name, _ in robot.events]
    assert names.count("HALT") == len(stood) == 2
    assert names[names.index("HALT") : names.index("HALT") + 3] == ["HALT", "HALT", "OUT7=True"]
    assert robot.axes == HOME


def test_a_stuck_answer_is_not_used_for_the_next_view(exported: tuple[bytes, bytes]) -> None:
    """If the done signal stays TRUE, the trigger never rises."""

    class StopHereError(Exception):
        pass

    def operator(robot: Robot) -> None:
        raise StopHereError

    robot = Robot(list(HOME), lambda robot: robot.inputs.__setitem__(8, True), operator)
    with pytest.raises(StopHereError):
        _driven(exported, robot)
    assert not any(name == "OUT7=True" for name, _ in robot.events)
    assert len(robot.moves) >= 2


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("off", [0.2, -0.2, 360.0])
def test_nothing_moves_away_from_home(exported: tuple[bytes, bytes], axis: int, off: float) -> None:
    """Every axis is checked; a full turn off is not home. At home the program continues."""
    start = list(HOME)
    start[axis] += off

    def operator(robot: Robot) -> None:
        assert not robot.moves
        robot.axes = list(HOME)

    robot = Robot(start, prompt_scanner(7, 8), operator)
    _driven(exported, robot)
    assert [name for name, _ in robot.events].count("HALT") == 1
    assert robot.axes == HOME


def _sweeping(
    reverse: bool = False, turn: float = 0.0, speed_percent: int = 100, planned_speed: float = 1.0
) -> tuple[bytes, bytes, Any]:
    """Return the KRL files of `sweeping_program`, and its motion."""
    from cell.export import krl
    from cell.export.options import ExportOptions
    from cell.export.program import ProgramSettings

    program, details = sweeping_program(reverse, turn, planned_speed)
    settings = ProgramSettings(speed_percent, 100, ExportOptions(trigger_output=7, gate_output=9, done_input=8))
    return krl.source(program, settings), krl.data(program, settings), details


@pytest.mark.parametrize("reverse", [False, True])
def test_a_sweep_is_one_line_between_trigger_and_answer(reverse: bool) -> None:
    """Planned start and end within 0.01 mm and 0.001 deg; planned poses on the line; gate; speed."""
    src, dat, (_, paths, kinematics, mount) = _sweeping(reverse)
    robot = Robot(list(HOME), prompt_scanner(7, 8), line=straight_line(kinematics))
    before: list[list[float]] = []
    drive = robot.line
    assert drive is not None
    robot.line = lambda robot, goal: before.append(list(robot.axes)) or drive(robot, goal)
    variables: list[dict[str, float]] = []
    prompt = robot.scanner
    robot.scanner = lambda robot: (
        variables.append(dict(robot.variables)) if robot.outputs.get(9) else None,
        prompt(robot),
    )
    _driven((src, dat), robot)
    assert robot.axes == HOME
    lines = [goal for kind, goal in robot.moves if kind == "LIN"]
    assert len(lines) == len(before) == 2
    for path, goal, start, speed in zip(paths, lines, before, (variables[0], variables[-1]), strict=True):
        np.testing.assert_allclose(start, np.degrees(path.q[0]), atol=1e-9)
        ends = kinematics.forward(np.stack([path.q[0], path.q[-1]])) @ mount
        assert np.linalg.norm(1e-3 * np.array([goal[axis] for axis in "XYZ"]) - ends[1, :3, 3]) < 1e-5
        robot.axes = start
        end = np.radians([drive(robot, goal)])
        assert np.degrees(np.abs(end - path.q[-1])).max() < 2e-4
        T = (kinematics.forward(end) @ mount)[0]
        assert np.degrees(np.linalg.norm(T[:3, :3].T @ ends[1, :3, :3] - np.eye(3))) < 0.001
        # A line between these poses passes every planned pose.
        u = path.u[path.pose >= 0]
        on_line = ends[0, :3, 3] + u[:, None] * (T[:3, 3] - ends[0, :3, 3])
        planned = kinematics.forward(path.q[path.pose >= 0]) @ mount
        assert np.linalg.norm(on_line - planned[:, :3, 3], axis=1).max() < 2e-5
        steady = float(path.profile.cruise)
        assert speed["$VEL.CP"] == pytest.approx(max(path.line.length / steady, 0.001), rel=1e-3)
        ramp = float(path.profile.ramp)
        assert speed["$ACC.CP"] == pytest.approx(max(path.line.length / steady / ramp, 0.001), rel=1e-3)
    gate = [
        (name, at) for name, at in robot.events if name in ("LIN", "OUT9=True", "OUT9=False", "OUT7=True", "OUT7=False")
    ]
    names = [name for name, _ in gate]
    assert names.count("OUT7=True") == 3
    for k, name in enumerate(names):
        if name == "LIN":
            assert names[k - 2 : k + 3] == ["OUT7=True", "OUT9=True", "LIN", "OUT9=False", "OUT7=False"]
    assert robot.variables["SC_VIEW"] == 3


@pytest.mark.parametrize(
    ("percent", "planned", "factor"), [(20, 1.0, 0.2), (1, 1.0, 0.01), (20, 0.5, 0.4), (50, 0.5, 1.0), (100, 0.5, 1.0)]
)
def test_lines_slow_down_with_the_axes_and_never_exceed_the_plan(percent: int, planned: float, factor: float) -> None:
    """`--speed` relative to the plan's scaling; the ramp length v^2 / 2a stays as planned."""
    src, _, (_, paths, _, _) = _sweeping(speed_percent=percent, planned_speed=planned)
    speeds, accelerations = (
        [float(value) for value in re.findall(re.escape(f"${name}=") + r"(\S+)", src.decode())]
        for name in ("VEL.CP", "ACC.CP")
    )
    for path, speed, acceleration in zip(paths, speeds, accelerations, strict=True):
        as_planned = path.line.length / path.profile.cruise
        assert speed == pytest.approx(factor * as_planned, rel=2e-3)
        assert speed**2 / acceleration == pytest.approx(as_planned * path.profile.ramp, rel=1e-2)


def test_a_sweep_that_turns_is_refused() -> None:
    """The message names the angle; a turn from the rounding of set-points alone is accepted."""
    from cell.errors import UsageError

    with pytest.raises(UsageError, match=r"the sweep of view 3 turns by 22\.9\d\d deg.*--format csv or json"):
        _sweeping(turn=0.4)
    with pytest.raises(UsageError, match=r"turns by 0\.0\d\d deg"):
        _sweeping(turn=np.radians(0.02))


def test_an_arm_jogged_at_the_end_of_a_line_does_not_return() -> None:
    """The LIN to the beginning waits until the arm is at the end of the line; the next trigger, at its beginning."""
    src, dat, (_, paths, kinematics, _) = _sweeping()
    silent, prompt, stood = [True], prompt_scanner(7, 8), list[tuple[int, list[float]]]()

    def operator(robot: Robot) -> None:
        stood.append((len(robot.moves), list(robot.axes)))
        assert (robot.outputs[7], robot.outputs[9]) == (False, False)
        robot.axes = [angle - 0.3 for angle in robot.axes] if len(stood) == 1 else list(stood[0][1])
        silent[0] = len(stood) < 2

    robot = Robot(
        list(HOME), lambda robot: None if silent[0] else prompt(robot), operator, line=straight_line(kinematics)
    )
    _driven((src, dat), robot)
    assert len(stood) == 2
    assert stood[0][0] == stood[1][0]
    np.testing.assert_allclose(stood[0][1], np.degrees(paths[0].q[-1]), atol=1e-3)
    assert [kind for kind, _ in robot.moves].count("LIN") == 4
    assert robot.axes == HOME


def test_a_sweep_without_an_answer_is_repeated() -> None:
    """Time-out after the line: halt, LIN back to its beginning, the same line again, then continue."""
    src, dat, (_, paths, kinematics, _) = _sweeping(False)
    silent, prompt = [True], prompt_scanner(7, 8)

    def operator(robot: Robot) -> None:
        silent[0] = False

    robot = Robot(
        list(HOME), lambda robot: None if silent[0] else prompt(robot), operator, line=straight_line(kinematics)
    )
    _driven((src, dat), robot)
    lines = [goal for kind, goal in robot.moves if kind == "LIN"]
    assert len(lines) == 4
    assert lines[0] == lines[2] != lines[1]
    begin = kinematics.forward(paths[0].q[:1])[0]
    tool = robot.variables["$TOOL"]
    at = begin[:3, :3] @ (np.array([tool[axis] for axis in "XYZ"]) / 1000) + begin[:3, 3]
    assert np.linalg.norm(np.array([lines[1][axis] for axis in "XYZ"]) / 1000 - at) < 1e-5
    assert [name for name, _ in robot.events].count("HALT") == 1
    assert robot.axes == HOME
