"""Help of all commands, shell completion, and `cell init`."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from cell.cli import app
from cell.scene.file import load_scene
from cell.scene.model import Scene
from tests.support.fixture_types import RunCommand


def commands(group: Any, *names: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield all visible commands below a group with their words."""
    yield names, group
    for name, command in getattr(group, "commands", {}).items():
        if not command.hidden:
            yield from commands(command, *names, name)


COMMANDS = dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_help_shows_every_word_in_brackets(words: tuple[str, ...], tmp_path: Path, run_cell: RunCommand) -> None:
    """Words such as [[region]] and [step] are text, not markup."""
    command = COMMANDS[words]
    sources = [command.help or "", command.epilog or ""]
    sources += [text for each in command.params for text in (getattr(each, "help", "") or "", each.metavar or "")]
    expected = {
        word
        for source in sources
        for word in re.findall(r"\[[^\s\]]*\]+", source.replace("\\[", "["))
        if word not in ("[bold]", "[/bold]")
    }
    page = "".join(run_cell(*words, "--help", cwd=tmp_path, code=0).stdout.replace("│", "").split())
    assert [word for word in expected if word not in page] == []


def test_words_in_brackets_are_tested() -> None:
    """The commands have such words."""
    sources = " ".join((command.epilog or "").replace("\\[", "[") for command in COMMANDS.values())
    assert "[[region]]" in sources
    assert "scan-cell[step]" in sources


def test_completion_can_be_installed(tmp_path: Path, run_cell: RunCommand) -> None:
    """The help names the option."""
    assert "--install-completion" in run_cell("--help", cwd=tmp_path, code=0).stdout


def test_init_writes_every_key_with_its_default(tmp_path: Path, part_file: Path, run_cell: RunCommand) -> None:
    """The scene equals the built-in one, and has its comments; a part replaces the built-in one."""
    run_cell("init", "cell.toml", cwd=tmp_path, code=0)
    assert load_scene(tmp_path / "cell.toml") == Scene()
    text = (tmp_path / "cell.toml").read_text()
    assert all(f"[{table}]" in text for table in ("robot", "scanner", "mount", "housing", "part", "placement", "plan"))
    refused = run_cell("init", "cell.toml", cwd=tmp_path, code=6)
    assert "cell.toml exists; choose another name" in refused.stderr
    run_cell("init", "own/part.toml", "--part", part_file, "--units", "mm", cwd=tmp_path, code=0)
    part = load_scene(tmp_path / "own" / "part.toml").part
    assert (Path(part.path), part.units) == (part_file, "mm")
    assert tomllib.loads((tmp_path / "own" / "part.toml").read_text())["part"]["path"] == str(part_file)
    run_cell("init", "mug.toml", "--part", "mug", cwd=tmp_path, code=0)
    assert load_scene(tmp_path / "mug.toml").part.name == "mug"
    assert "no file none.stl" in run_cell("init", "x.toml", "--part", "none.stl", cwd=tmp_path, code=6).stderr
