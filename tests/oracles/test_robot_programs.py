"""The exported RAPID, URScript and LS programs in independent interpreters: motions, signals, halts.

The slow test runs the programs of many plans in these languages and in KRL, whose own tests are in
`test_krl_program.py`.
"""

import itertools
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cell.errors import UsageError
from cell.export import fanuc, krl, rapid, urscript
from cell.export.options import ExportOptions
from cell.export.program import Program, ProgramSettings, language_of, load_program
from cell.robot.arm import kr16_kinematics
from cell.runs.run import open_finished
from tests.support.fixture_types import RunCommand
from tests.support.krl_language import run_krl, straight_line
from tests.support.robot_languages import run_ls, run_rapid, run_urscript
from tests.support.robot_programs import HOME, Robot, prompt_scanner, sweeping_program

TRIGGER, GATE, ANSWER = 7, 6, 5


@dataclass(frozen=True)
class Language:
    """A language: how it is written and run, its signals, and the digits of its angles [deg]."""

    write: Callable[[str, list[Program], list[ProgramSettings]], dict[str, bytes]]
    run: Callable[[dict[str, bytes], Robot], None]
    trigger: int
    gate: int
    answer: int
    tolerance: float

    def files(self, program: Program, speed_percent: int = 20) -> dict[str, bytes]:
        """Return the files of a program with a time-out of 2.5 s."""
        signals = ExportOptions(trigger_output=TRIGGER, gate_output=GATE, done_input=ANSWER, timeout=2.5)
        return self.write(program.info.name, [program], [ProgramSettings(speed_percent, 100, signals)])

    def written(self, q: np.ndarray) -> np.ndarray:
        """Return axes [deg] of joint angles [rad] in the controller's convention; axis 3 of LS is absolute."""
        q = np.degrees(q).copy()
        if self.run is run_ls:
            q[..., 2] += q[..., 1]
        return q

    @property
    def home(self) -> list[float]:
        """Home in the controller's convention."""
        return [float(angle) for angle in self.written(np.radians(HOME)).round(9)]


LANGUAGES = {
    "rapid": Language(rapid.files, run_rapid, 7, 9, 8, 1e-9),
    "urscript": Language(urscript.files, run_urscript, TRIGGER, GATE, ANSWER, 1e-9),
    "ls": Language(fanuc.files, run_ls, TRIGGER, GATE, ANSWER, 5.0001e-4),
}
KRL = Language(krl.files, run_krl, TRIGGER, GATE, ANSWER, 1e-9)


@pytest.fixture(params=LANGUAGES)
def language(request: pytest.FixtureRequest) -> Language:
    """Return each language."""
    return LANGUAGES[request.param]


@pytest.fixture(scope="module")
def program(planned: Path) -> Program:
    """Return the program of the small plan."""
    return load_program(planned, "PART_07", ExportOptions(), None)


def _axes(robot: Robot) -> np.ndarray:
    return np.array([list(goal.values()) for _, goal in robot.moves])


def test_the_program_drives_the_planned_via_points_and_scans_each_view_once(
    language: Language, program: Program, planned: Path
) -> None:
    """All joint targets to the written digits, in order; the planned time stretched to the share of the speed."""
    robot = Robot(language.home, prompt_scanner(language.trigger, language.answer))
    scanned: list[list[float]] = []
    answer = robot.scanner

    def scanner(robot: Robot) -> None:
        before = robot.inputs.get(language.answer, False)
        answer(robot)
        if robot.inputs[language.answer] and not before:
            scanned.append(list(robot.axes))

    robot.scanner = scanner
    language.run(language.files(program), robot)
    np.testing.assert_allclose(_axes(robot), language.written(program.q), atol=language.tolerance, rtol=0)
    views = np.flatnonzero(program.view > 0)
    np.testing.assert_allclose(scanned, language.written(program.q[views]), atol=language.tolerance, rtol=0)
    assert robot.variables["view"] == len(views) == program.n_views
    moving = open_finished(planned).motion.duration * program.info.speed / 0.2
    assert robot.now == pytest.approx(moving, abs=1.0 + 0.8 * len(views))
    names = [name for name, _ in robot.events]
    assert names.count(f"OUT{language.trigger}=True") == len(views)
    for before, after in itertools.pairwise(names):
        assert before != f"OUT{language.trigger}=True" or after == f"OUT{language.trigger}=False"


def test_a_silent_scanner_halts_the_program_and_a_jogged_arm_halts_it_again(
    language: Language, program: Program
) -> None:
    """Time-out: trigger off, halt; no motion and no trigger until every axis is back; then the view is repeated."""
    silent, prompt = [True], prompt_scanner(language.trigger, language.answer)
    stood: list[tuple[int, list[float]]] = []

    def operator(robot: Robot) -> None:
        stood.append((len(robot.moves), list(robot.axes)))
        assert robot.outputs[language.trigger] is False
        silent[0] = False
        if len(stood) <= 6:  # every axis in turn
            robot.axes = list(stood[0][1])
            robot.axes[len(stood) - 1] += 0.2 if len(stood) % 2 else -0.2
        else:
            robot.axes = list(stood[0][1])
            robot.axes[0] += 0.05  # farther than the repeatability, but near enough

    robot = Robot(language.home, lambda robot: None if silent[0] else prompt(robot), operator)
    language.run(language.files(program), robot)
    assert len(stood) == 7
    assert len({moves for moves, _ in stood}) == 1
    halts = [k for k, (name, _) in enumerate(robot.events) if name == "HALT"]
    between = [name for name, _ in robot.events[halts[0] - 2 : halts[-1] + 2]]
    on, off = f"OUT{language.trigger}=True", f"OUT{language.trigger}=False"
    assert between == [on, off, *["HALT"] * 7, on]
    assert robot.events[halts[0]][1] - robot.events[halts[0] - 2][1] == pytest.approx(2.5, abs=0.05)
    np.testing.assert_allclose(robot.axes, language.home, atol=language.tolerance)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("off", [0.2, -0.2, 360.0])
def test_nothing_moves_away_from_home(language: Language, program: Program, axis: int, off: float) -> None:
    """Every axis is checked before the first motion."""
    start = language.home
    start[axis] += off
    halts = []

    def operator(robot: Robot) -> None:
        assert not robot.moves
        halts.append(robot.now)
        robot.axes = language.home

    language.run(language.files(program), Robot(start, prompt_scanner(language.trigger, language.answer), operator))
    assert len(halts) == 1


def test_a_stuck_answer_is_not_used_for_the_next_view(language: Language, program: Program) -> None:
    """If the answer stays on, the trigger never rises."""

    class StopHereError(Exception):
        pass

    def operator(robot: Robot) -> None:
        raise StopHereError

    robot = Robot(language.home, lambda robot: robot.inputs.__setitem__(language.answer, True), operator)
    with pytest.raises(StopHereError):
        language.run(language.files(program), robot)
    assert not any(name == f"OUT{language.trigger}=True" for name, _ in robot.events)
    assert len(robot.moves) >= 2


def test_a_sweep_is_one_line_between_trigger_and_answer_and_is_repeated(language: Language) -> None:
    """Line with gate; after a time-out a halt, the line back, the same line again; at most the planned speed."""
    program, (_, paths, _, _) = sweeping_program()
    silent, prompt = [True], prompt_scanner(language.trigger, language.answer)

    def operator(robot: Robot) -> None:
        silent[0] = False

    robot = Robot(language.home, lambda robot: None if silent[0] else prompt(robot), operator)
    language.run(language.files(program, speed_percent=50), robot)
    lines = np.array([list(goal.values()) for kind, goal in robot.moves if kind in ("MoveL", "movel", "L")])
    ends = language.written(np.stack([paths[0].q[-1], paths[0].q[0], paths[0].q[-1], paths[1].q[-1]]))
    np.testing.assert_allclose(lines, ends, atol=language.tolerance)
    names = [name for name, _ in robot.events]
    on, gate = f"OUT{language.trigger}=True", f"OUT{language.gate}"
    for k, name in enumerate(names):
        if name == f"{gate}=True":
            assert names[k - 1] == on
            assert names[k + 2] == f"{gate}=False"
    assert names.count(f"{gate}=True") == 3
    assert names.count("HALT") == 1
    planned = [path.line.length / float(path.profile.cruise) / 2 for path in paths]
    for speed, bound in zip(np.array(robot.variables["speeds"])[[0, 3]], planned, strict=True):
        assert speed <= max(bound, 0.001) * (1 + 1e-4)
        assert speed == pytest.approx(max(bound, 0.001), rel=0.03)
    with pytest.raises(UsageError, match=r"turns by 22\.9\d\d deg.*--format csv or json"):
        language.files(sweeping_program(turn=0.4)[0])


def test_several_set_ups_are_one_program_that_halts_before_each(language: Language, program: Program) -> None:
    """The operator places the part at each halt."""
    from dataclasses import replace

    settings = ProgramSettings(20, 30, ExportOptions(trigger_output=TRIGGER, gate_output=GATE, done_input=ANSWER))
    both = [replace(program, info=replace(program.info, name=f"BOTH_{number}")) for number in (1, 2)]
    halts: list[int] = []
    robot = Robot(
        language.home,
        prompt_scanner(language.trigger, language.answer),
        lambda robot: halts.append(len(robot.moves)),
    )
    language.run(language.write("BOTH", both, [settings, settings]), robot)
    assert halts == [0, len(program.q)]
    assert len(robot.moves) == 2 * len(program.q)


def test_axis_3_of_fanuc_counts_against_the_horizontal(program: Program) -> None:
    """Opposite axes 2 and 3, as in the usual robot files, subtract axis 2; other angles are refused."""
    from dataclasses import replace

    opposite = replace(program, cos_axes_2_3=-1.0)
    robot = Robot([0.0, -90.0, 180.0, 0.0, 90.0, 0.0], prompt_scanner(TRIGGER, ANSWER))
    LANGUAGES["ls"].run(LANGUAGES["ls"].files(opposite), robot)
    q = np.degrees(program.q)
    np.testing.assert_allclose(_axes(robot)[:, 2], q[:, 2] - q[:, 1], atol=5.0001e-4)
    with pytest.raises(UsageError, match="axes 2 and 3 of this arm are not parallel"):
        LANGUAGES["ls"].files(replace(program, cos_axes_2_3=0.5))


def rapid_faults(files: dict[str, bytes]) -> list[object]:
    """Return the complaints of the package rapidchecker about the only `.mod`."""
    from rapidchecker.check import check_format

    (content,) = files.values()
    return list(check_format(content.decode().replace("\r\n", "\n")))


def krl_faults(files: dict[str, bytes], folder: Path) -> list[str]:
    """Return the counts of complaints of the package krllint that are not 0."""
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    linted = subprocess.run([sys.executable, "-m", "krllint", str(folder)], capture_output=True, text=True, check=False)
    counts = re.findall(r"^(\d+) (?:violated|possible|found|fatal) \w+", linted.stdout, re.MULTILINE)
    assert len(counts) == 5, linted.stdout
    return [count for count in counts if count != "0"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("sweeps", [False, True])
def test_programs_pass_independent_checkers(program: Program, tmp_path: Path, sweeps: bool) -> None:
    """The packages rapidchecker (RAPID) and krllint (KRL) have no complaint."""
    written = sweeping_program()[0] if sweeps else program
    assert rapid_faults(LANGUAGES["rapid"].files(written)) == []
    assert krl_faults(KRL.files(written), tmp_path) == []


def _end_pose(goal: dict[str, float]) -> np.ndarray:
    """Return the position [mm] and the rotation (3, 3) of an E6POS."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("ZYX", [goal[angle] for angle in "ABC"], degrees=True).as_matrix()
    return np.concatenate([[goal[axis] for axis in "XYZ"], turn.ravel()])


def require_planned_targets(language: Language, program: Program) -> None:
    """Run a program and compare every target with the plan.

    Joint targets are equal to the last written digit. The end of a line is a pose in KRL, whose last digits are
    1e-3 mm and 1e-4 deg; its axes may differ by `AT_STOP_DEG`, at which the program would halt.
    """
    kinematics = kr16_kinematics()
    robot = Robot(language.home, prompt_scanner(language.trigger, language.answer), line=straight_line(kinematics))
    language.run(language.files(program), robot)
    passed = {row for sweep in program.sweeps for row in range(sweep.begin + 1, sweep.end)}
    rows = [row for row in range(len(program.q)) if row not in passed]  # a line is one motion
    assert len(robot.moves) == len(rows)
    planned = language.written(program.q)
    poses = kinematics.forward(program.q) @ program.T_flange_tcp
    ends = {sweep.end for sweep in program.sweeps}
    for row, (kind, goal) in zip(rows, robot.moves, strict=True):
        assert (kind in ("LIN", "MoveL", "movel", "L")) == (row in ends)
        if kind == "LIN":
            expected = np.concatenate([1000 * poses[row, :3, 3], poses[row, :3, :3].ravel()])
            np.testing.assert_allclose(_end_pose(goal)[:3], expected[:3], atol=0.5001e-3)
            np.testing.assert_allclose(_end_pose(goal)[3:], expected[3:], atol=3 * np.radians(0.5e-4))
        else:
            axes = [goal[f"A{axis}"] for axis in range(1, 7)]
            np.testing.assert_allclose(axes, planned[row], atol=language.tolerance, rtol=0)
    np.testing.assert_allclose(robot.axes, language.home, atol=language.tolerance)
    assert robot.variables["SC_VIEW" if language is KRL else "view"] == program.n_views


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("number", range(20))
def test_programs_of_seeded_plans(number: int, part_file: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """All four languages drive the plan at its via points, and the checkers have no complaint."""
    x, y = np.random.default_rng(number).uniform([900, -500], [1200, 500]).round()
    run_cell(
        "plan", part_file, "--units", "mm", "--place", f"{x},{y},100", "--faces", 60, "--samples", 2, "--standoff", 250,
        "--candidates", "optimal-scanning-zone", "--coverage", 0.9, "--seed", number, "--out", "run",
        cwd=tmp_path, code=0,
    )  # fmt: skip
    program = load_program(tmp_path / "run", "PART", ExportOptions(), None)
    assert (program.q == np.load(tmp_path / "run" / "motion.npz")["via_q"]).all()
    for language in (*LANGUAGES.values(), KRL):
        require_planned_targets(language, program)
    assert rapid_faults(LANGUAGES["rapid"].files(program)) == []
    assert krl_faults(KRL.files(program), tmp_path / "krl") == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("seed", range(5))
def test_programs_of_seeded_sweeps(seed: int, tmp_path: Path) -> None:
    """Check programs with two sweeps each."""
    program, (motion, *_) = sweeping_program(seed=seed)
    assert (program.q == motion.via_q).all()
    for language in (*LANGUAGES.values(), KRL):
        require_planned_targets(language, program)
    assert rapid_faults(LANGUAGES["rapid"].files(program)) == []
    assert krl_faults(KRL.files(program), tmp_path) == []


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        ("kr16", "krl"), ("kuka_kr10r1420.urdf", "krl"), ("abb_irb2400_12_155.urdf", "rapid"), ("IRB1200.xml", "rapid"),
        ("ur5e.urdf", "urscript"), ("my_UR10.urdf", "urscript"), ("fanuc_m10ia.urdf", "ls"), ("LRMate200id.xml", "ls"),
    ],
)  # fmt: skip
def test_the_maker_selects_the_language(robot: str, expected: str) -> None:
    """The name of the robot's file shows the maker."""
    assert language_of(robot) == expected


@pytest.mark.parametrize(("robot", "sentence"), [("gp25.urdf", "pulses per degree"), ("arm.urdf", "shows no maker")])
def test_a_robot_without_a_language_is_refused(robot: str, sentence: str) -> None:
    """The message names a format that works."""
    with pytest.raises(UsageError, match=sentence):
        language_of(robot)
