"""docs/tutorial.md: the part can be made, the cell is valid, and the commands run in order."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from cell.cli import app
from tests.support.fixture_types import RunCommand

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Return the code blocks of the page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


COMMANDS = [shlex.split(line)[1:] for block in blocks("sh") for line in block.splitlines()]


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the part and the scene of the page."""
    monkeypatch.chdir(tmp_path)
    exec(blocks("python")[0], {})
    (tmp_path / "my_cell.toml").write_text(blocks("toml")[0])
    return tmp_path


def test_the_cell_is_right(workplace: Path, run_cell: RunCommand) -> None:
    """The first command reports no problem."""
    process = run_cell(*COMMANDS[0], cwd=workplace, code=0)
    assert "warning" not in process.stdout


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_commands_exist(words: list[str]) -> None:
    """Every command accepts its options in the page (the slow test runs the commands)."""
    group = typer.main.get_command(app)
    context = typer.Context(group)
    command = group.get_command(context, words[0])  # type: ignore[attr-defined]
    command.make_context(words[0], words[1:], parent=context)


@pytest.mark.slow
def test_the_commands_run(workplace: Path, run_cell: RunCommand, full_effort: None) -> None:
    """All commands run unchanged in the order of the page. The plan is proven, and the edited plan is scanned."""
    for words in COMMANDS:
        process = run_cell(*words, cwd=workplace)
        assert process.returncode == 0, (words, process.stderr)
        if words[0] == "plan":
            assert "Optimal for the" in process.stdout, process.stdout
    assert (workplace / "better" / "export" / "better.src").is_file()
    assert (workplace / "better" / "executions" / "0001" / "mesh.ply").is_file()
