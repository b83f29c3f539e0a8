"""Commands that the program prints as next steps or remedies: each runs, and has the effect that its name states."""

import json
import re
import shlex
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from subprocess import CompletedProcess

import pytest
import typer

from cell.cli import app
from cell.runs.digest import SHORT_DIGEST
from cell.runs.next_commands import commands_of
from cell.runs.run import open_run
from tests.support.fixture_types import RunCommand
from tests.unit.test_robot_file import urdf, written

FINISHED = (0, 3)
"""Exit codes of plans: 3 states that a target is missed."""


@pytest.fixture(autouse=True)
def _no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.view.loopback.open_browser", lambda address: address.startswith("file:"))


def printed_commands(process: "CompletedProcess[str]") -> list[list[str]]:
    """Return the commands on the lines after `next:` of both outputs, and those of a numbered list."""
    lines = [line for text in (process.stdout, process.stderr) for line in text.splitlines()]
    return [shlex.split(found[1]) for line in lines if (found := re.match(r"(?:  |\d+: )(cell \S.*)$", line))]


def _new_folders(cwd: Path, before: set[Path], file: str) -> list[Path]:
    return [path.parent for path in cwd.rglob(file) if path not in before]


class Follower:
    """Runs printed commands in a folder, and checks the exit code and the effect of each.

    Args:
        run_cell: runs a command.
        cwd: folder of relative paths.
        more: options that make a printed plan small. A printed scan gets a coarse resolution. Nothing else changes.
    """

    def __init__(self, run_cell: RunCommand, cwd: Path, more: Sequence[str] = ()) -> None:
        self._run_cell, self._cwd, self._more = run_cell, cwd, tuple(more)
        self.names: list[str] = []

    def follow(self, process: "CompletedProcess[str]", depth: int = 1) -> None:
        """Run the printed commands of an output, and those that they print, to a depth."""
        commands = printed_commands(process)
        assert commands, process.stdout + process.stderr
        for words in commands:
            after = self._execute(words)
            if depth > 1 and printed_commands(after):
                self.follow(after, depth - 1)

    def _execute(self, words: list[str]) -> "CompletedProcess[str]":
        assert words[0] == "cell"
        name, arguments = words[1], words[2:]
        self.names.append(" ".join(words[1:3]) if name == "study" else name)
        cwd = self._cwd
        before = {*cwd.rglob("plan.json"), *cwd.rglob("setups.json"), *cwd.rglob("cloud.ply"), *cwd.rglob("export/*")}
        shutil.rmtree(cwd / arguments[0] / "why", ignore_errors=True) if name == "why" else None
        more = {"plan": self._more, "scan": ("--resolution", "1")}.get(name, ())
        process = self._run_cell(*words[1:], *more, cwd=cwd)
        allowed = FINISHED if name in ("plan", "edit", "setups", "scan") else (0,)
        if name == "replay" and process.returncode == 2:
            assert "display" in process.stderr, process.stderr
            return process
        assert process.returncode in allowed, (words, process.returncode, process.stderr)
        if name in ("plan", "edit") or (name == "locate" and "--out" in arguments):
            (folder,) = _new_folders(cwd, before, "plan.json")
            open_run(folder)
        if name == "setups":
            assert _new_folders(cwd, before, "setups.json")
        if name == "scan":
            assert _new_folders(cwd, before, "cloud.ply"), process.stdout
        if name == "why" and "--advise" not in arguments:
            assert (cwd / arguments[0] / "why" / "why.json").is_file()
        if name == "export":
            assert [path for path in (cwd / arguments[0] / "export").iterdir() if path not in before or path.is_file()]
        if name == "view":
            pages = [line for line in process.stdout.splitlines() if line.endswith(".html")]
            assert pages
            assert all((cwd / page).is_file() for page in pages)
        return process


SMALL = ("--faces", "40", "--samples", "2", "--standoff", "250", "--candidates", "optimal-scanning-zone")
SMALL += ("--place", "1100,400,100", "--coverage", "0.8", "--sensor", "paper")


@pytest.fixture
def planned_process(
    made_once: Callable[..., Path], run_cell: RunCommand, part_file: Path, tmp_path: Path
) -> "CompletedProcess[str]":
    """Return the process of a plan, with a copy of its folder `run`."""

    def make(folder: Path) -> None:
        process = run_cell("plan", part_file, "--units", "mm", *SMALL, "--out", "run", cwd=folder)
        assert process.returncode in FINISHED, process.stderr
        (folder / "outputs").write_text(json.dumps([process.stdout, process.stderr]))

    folder = made_once("printed", make)
    shutil.copytree(folder / "run", tmp_path / "run")
    return CompletedProcess([], 0, *json.loads((folder / "outputs").read_text()))


def test_after_a_plan(run_cell: RunCommand, planned_process: "CompletedProcess[str]", tmp_path: Path) -> None:
    """A plan is shown, scanned, explained and exported; the best change of `cell why` is made."""
    follower = Follower(run_cell, tmp_path)
    follower.follow(planned_process, depth=2)
    assert {"view", "scan", "why", "export", "edit"} <= set(follower.names)


@pytest.mark.usefixtures("planned_process")
def test_after_edits(run_cell: RunCommand, tmp_path: Path) -> None:
    """A dropped view is repaired, compared and scanned; the edited plan prints its digest."""
    process = run_cell("edit", "run", "--drop", "1", "--out", "less", cwd=tmp_path)
    assert open_run(tmp_path / "less").digest[:SHORT_DIGEST] in process.stdout
    follower = Follower(run_cell, tmp_path)
    follower.follow(process)
    assert {"scan", "edit", "diff"} <= set(follower.names)


@pytest.mark.parametrize("n_views", [1, 2])
def test_after_a_plan_of_a_number_of_views(n_views: int, run_cell: RunCommand, part_file: Path, tmp_path: Path) -> None:
    """Without a requested coverage no repair is proposed, and the only view is not dropped."""
    options = [word for word in SMALL if word not in ("--coverage", "0.8")]
    process = run_cell(
        "plan", part_file, "--units", "mm", *options, "--max-views", n_views, "--out", "run", cwd=tmp_path, code=0
    )
    assert "--repair" not in process.stdout
    page = (tmp_path / "run" / "view.html").read_text()
    assert "--repair" not in page
    follower = Follower(run_cell, tmp_path)
    follower.follow(run_cell("view", "run", cwd=tmp_path, code=0))
    assert ("edit" in follower.names) == (n_views > 1)


def test_after_a_plan_of_another_arm(run_cell: RunCommand, part_file: Path, tmp_path: Path) -> None:
    """The name of the robot's file shows no maker, so that a table is proposed."""
    path = written(tmp_path, urdf())
    (tmp_path / "cell.toml").write_text(f'[robot]\nmodel = "{path}"\n')
    process = run_cell(
        "plan", part_file, "--units", "mm", *SMALL[:-6], "--place", "600,200,100", "--sensor", "paper", "--coverage",
        "0.2", "--scene", "cell.toml", "--out", "run", cwd=tmp_path,
    )  # fmt: skip
    assert process.returncode in FINISHED, process.stderr
    follower = Follower(run_cell, tmp_path)
    follower.follow(process)
    assert ["cell", "export", "run", "--format", "csv"] in printed_commands(process)
    assert "cell export RUN --format csv" in (tmp_path / "run" / "view.html").read_text()


@pytest.mark.parametrize(
    ("robot", "options"),
    [
        ("irb1200.urdf", ()), ("ur5e.urdf", ()), ("m10ia.xml", ()), ("kr10.urdf", ()),
        ("gp25.urdf", ("--format", "csv")), ("arm.urdf", ("--format", "csv")),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("planned_process")
def test_the_export_of_an_arm_with_a_language(robot: str, options: tuple[str, ...], tmp_path: Path) -> None:
    """The proposed export is in the language of the robot's maker; a table only if there is none."""
    report = open_run(tmp_path / "run").report
    assert commands_of(report, None, robot)[-1] == ("cell", "export", "RUN", *options)


@pytest.mark.slow
def test_after_a_plan_on_a_table_and_of_sweeps(turned: Path, swept: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """Every command for such plans is supported; sweeps that turn are exported as a table."""
    for run in (turned, swept):
        copy = Path(shutil.copytree(run, tmp_path / run.parent.name))
        shutil.rmtree(copy / "executions", ignore_errors=True)
        follower = Follower(run_cell, tmp_path)
        follower.follow(run_cell("view", copy.name, cwd=tmp_path, code=0))
        assert {"scan", "why", "export"} <= set(follower.names)


def test_after_set_ups(made_setups: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """Set-ups are scanned one after the other as proposed."""
    shutil.copytree(made_setups, tmp_path / "made")
    follower = Follower(run_cell, tmp_path)
    text = (made_setups.parent / "stdout").read_text()
    follower.follow(CompletedProcess([], 0, text, ""), depth=3)
    assert follower.names.count("scan") > 1
    assert (tmp_path / "made" / "scanned" / "report.md").is_file()


@pytest.mark.usefixtures("planned_process")
def test_a_further_set_up_is_not_a_new_plan(run_cell: RunCommand, tmp_path: Path) -> None:
    """For a rotated part `cell why` proposes a set-up in addition to the plan; the plan stays the first set-up."""
    process = run_cell("why", "run", "--advise", cwd=tmp_path, code=0)
    commands = printed_commands(process)
    further = [words for words in commands if words[:2] == ["cell", "setups"]]
    assert further
    for words in further:
        assert words[2:6] == ["--first", "run", "--proposals", "1"]
    process = run_cell("why", "run", "--json", cwd=tmp_path, code=0)
    assert not re.search(r'"setting": "--place', process.stdout)
    setups_process = run_cell(*further[0][1:], "--out", "both", cwd=tmp_path)
    assert setups_process.returncode in FINISHED, setups_process.stderr
    first = open_run(tmp_path / "both" / "setups" / "1")
    assert first.digest == open_run(tmp_path / "run").digest


@pytest.mark.slow
def test_after_a_check(run_cell: RunCommand, part_file: Path, tmp_path: Path) -> None:
    """A valid scene is planned; after a problem it is checked again."""
    (tmp_path / "cell.toml").write_text("[placement]\nposition_mm = [1100, 400, 100]\n")
    part = ("--part", part_file, "--units", "mm")
    process = run_cell("check", "cell.toml", *part, cwd=tmp_path, code=0)
    Follower(run_cell, tmp_path, SMALL).follow(process)
    (tmp_path / "cell.toml").write_text("[placement]\nposition_mm = [0, 0, 700]\n")
    process = run_cell("check", "cell.toml", *part, cwd=tmp_path, code=2)
    (words,) = printed_commands(process)
    assert run_cell(*words[1:], cwd=tmp_path).returncode == 2  # the same problem


@pytest.mark.slow
def test_after_a_part_and_the_sensors(run_cell: RunCommand, part_file: Path, tmp_path: Path) -> None:
    """The proposed plans are complete; here they are made small."""
    follower = Follower(run_cell, tmp_path, SMALL)
    follower.follow(run_cell("part", part_file, "--units", "mm", "--out", "looked", cwd=tmp_path, code=0))
    (words,) = printed_commands(run_cell("sensors", cwd=tmp_path, code=0))
    small = [word for word in SMALL if word not in ("--sensor", "paper", "--standoff", "250")]
    assert run_cell(*words[1:], *small, cwd=tmp_path).returncode in FINISHED


def _commands(group: "typer.core.TyperGroup", before: tuple[str, ...] = ()) -> list[tuple[str, str]]:
    """Return (command, example) of each example in the help, hidden commands left out."""
    found = []
    for name, command in group.commands.items():
        if command.hidden:
            continue
        if isinstance(command, typer.core.TyperGroup):
            found += _commands(command, (*before, name))
        else:
            lines = (command.epilog or "").split("\n\n")
            found += [(" ".join((*before, name)), line) for line in lines if line.startswith("cell ")]
    return found


EXAMPLES = _commands(typer.main.get_command(app))  # type: ignore[arg-type]


@pytest.mark.parametrize("example", [example for _, example in EXAMPLES])
def test_examples_of_the_help_are_accepted(example: str) -> None:
    """Every example is a command with existing options and values of the right form."""
    words = shlex.split(example)[1:]
    command: object = typer.main.get_command(app)
    context = typer.Context(command)  # type: ignore[arg-type]
    while isinstance(command, typer.core.TyperGroup):
        command = command.get_command(context, words.pop(0))
    command.make_context("cell", words, parent=context)  # type: ignore[union-attr]


@pytest.mark.slow
@pytest.mark.parametrize(
    "example",
    [
        text
        for name, text in EXAMPLES
        if name in ("plan", "edit", "why", "diff", "export", "view", "check") and "ur5" not in text
    ],
)
def test_examples_of_the_help_run(
    example: str,
    planned: Path,
    executed: Path,
    made_setups: Path,
    part_file: Path,
    run_cell: RunCommand,
    tmp_path: Path,
) -> None:
    """Examples run in a folder with files of the names that they mention, as far as plans and their views exist."""
    for name, source in (("trial", executed), ("other", planned), ("both", made_setups)):
        shutil.copytree(source, tmp_path / "sim_runs" / name)
    shutil.copytree(tmp_path / "sim_runs/trial/executions/0001", tmp_path / "sim_runs/trial/executions/0002")
    shutil.copy(part_file, tmp_path / "part.stl")
    (tmp_path / "my_cell.toml").write_text("[placement]\nposition_mm = [1100, 400, 100]\n")
    words = shlex.split(example)[1:]
    if any(word in example for word in ("--watch", "study-", "explore-", "execution", ":", "--add-candidate")):
        pytest.skip("needs another folder, a person, or views that this plan does not have")
    small = SMALL[:8] if words[0] == "plan" else ()
    process = run_cell(*words, *small, cwd=tmp_path)
    assert process.returncode in FINISHED, process.stderr


def test_next_commands_are_lines_that_can_be_pasted(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A path with spaces is quoted, and a long command is not wrapped."""
    copy = Path(shutil.copytree(planned, tmp_path / ("a folder " + 60 * "x")))
    process = run_cell("view", copy.name, cwd=tmp_path, code=0)
    assert all(copy.name in words for words in printed_commands(process))
