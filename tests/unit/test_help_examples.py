"""Examples of `--help`: each has an existing command and valid options and arguments."""

import shlex
from collections.abc import Iterator

import click
import pytest
import typer

from cell.cli import app


def _commands(command: click.Command) -> Iterator[click.Command]:
    yield command
    for name in getattr(command, "commands", {}):
        yield from _commands(command.commands[name])  # type: ignore[attr-defined]


MAIN = typer.main.get_command(app)
EXAMPLES = sorted({
    line for command in _commands(MAIN) for line in (command.epilog or "").splitlines() if line.startswith("cell ")
})  # fmt: skip


def test_there_are_examples_of_every_command() -> None:
    """Each visible command has at least one example."""
    shown = {line.split()[1] for line in EXAMPLES}
    commands = {name for name, command in MAIN.commands.items() if not command.hidden}  # type: ignore[attr-defined]
    assert commands <= shown, commands - shown


@pytest.mark.parametrize("line", EXAMPLES)
def test_an_example_is_understood(line: str) -> None:
    """The command line parses each example, including the types of values. Nothing is executed."""
    command, words = MAIN, shlex.split(line, comments=True)[1:]
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]  # type: ignore[attr-defined]
    command.make_context("cell", words)
