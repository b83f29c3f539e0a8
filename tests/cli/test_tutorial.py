"""docs/tutorial.md is true: its part can be made, its cell is right, and its commands run one after the other."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from cell.cli import app

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The page's code in one language, block by block."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


COMMANDS = [shlex.split(line)[1:] for block in blocks("sh") for line in block.splitlines()]


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's part and scene."""
    monkeypatch.chdir(tmp_path)
    exec(blocks("python")[0], {})
    (tmp_path / "my_cell.toml").write_text(blocks("toml")[0])
    return tmp_path


def test_the_cell_is_right(workplace: Path, run_cell: Callable[..., Any]) -> None:
    """The first command finds nothing wrong."""
    done = run_cell(*COMMANDS[0], cwd=workplace)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stdout


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_commands_exist(words: list[str]) -> None:
    """Every command takes the options that the page gives it (the slow test runs them)."""
    group = typer.main.get_command(app)
    context = typer.Context(group)
    command = group.get_command(context, words[0])  # type: ignore[attr-defined]
    command.make_context(words[0], words[1:], parent=context)


@pytest.mark.slow
def test_the_commands_run(workplace: Path, run_cell: Callable[..., Any]) -> None:
    """As they stand, in the order of the page; the plan is proven and the edited one scanned."""
    for words in COMMANDS:
        done = run_cell(*words, cwd=workplace)
        assert done.returncode == 0, (words, done.stderr)
        if words[0] == "plan":
            assert "proven fewest" in done.stdout
    assert (workplace / "better" / "export" / "better.src").is_file()
    assert (workplace / "better" / "executions" / "0001" / "mesh.ply").is_file()
