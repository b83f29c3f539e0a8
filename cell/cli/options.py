"""The application of the command line, shared parameters, and options from the fields of models.

`cell.scene.options` describes the options of a model.
"""

import functools
import inspect
import json
import re
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_origin

import typer
from pydantic import BaseModel

from cell.errors import UsageError
from cell.scene.file import BUILT_IN
from cell.scene.model import PART, Scene
from cell.scene.options import OptionSpec, flag, option_specs, parse_options

EXIT_CODES = (
    "Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 5 driver, 6 files or "
    "run folder, 70 bug, 130 Ctrl-C, SIGTERM or SIGHUP."
)

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    epilog=f"Start with: [bold]cell plan --place 1200,500,0[/bold]\n\n{EXIT_CODES}",
)

Command = TypeVar("Command", bound=Callable[..., None])

_MARKUP = re.compile(r"(\\*)(\[[a-z#/@][^[]*?])")  # as in rich.markup, whose import takes longer than `--help`


def plain(text: str) -> str:
    """Return a text whose words in brackets are not taken as markup by the help."""
    return _MARKUP.sub(lambda match: match[1] * 2 + "\\" + match[2], text)


Part = Annotated[
    str | None,
    typer.Argument(
        help=f"Mesh file (STL, OBJ, PLY, OFF, GLB, glTF, 3MF), STEP file or a built-in part: {', '.join(BUILT_IN)}. "
        "Default: the scene's.",
        show_default=False,
    ),
]
SceneFile = Annotated[
    Path | None, typer.Option(help="Scene file (TOML). Default: the built-in scene.", rich_help_panel=PART)
]
RunFolder = Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")]
NewRunFolder = Annotated[
    Path | None, typer.Option(help="Run folder to make. Default: sim_runs/<UTC>-<hash>.", rich_help_panel="Output")
]
NoCache = Annotated[
    bool,
    typer.Option("--no-cache", help="Neither read nor write cached meshes and matrices.", rich_help_panel="Output"),
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel="Output")
]

OptionValues = dict[str, object]
"""Texts and switches of the given options by their names; `Annotated` with the specifications of the options."""
SceneOptions = Annotated[OptionValues, option_specs(Scene)]
PartOptions = Annotated[OptionValues, option_specs(Scene, "units")]


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"scan-cell {version('scan-cell')}")
        raise typer.Exit


@app.callback()
def cell(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Plan, check and time the views that measure a part with a laser scanner on a six-axis robot."""


def command(
    *examples: str, note: str = "", name: str | None = None, group: typer.Typer = app
) -> Callable[[Command], Command]:
    """Register a command with the examples of its help, and make its options from the fields of models.

    Args:
        examples: complete command lines.
        note: paragraph after them.
        name: of the command; None: the name of the function.
        group: of the command.
    """
    epilog = plain("\n\n".join(["Examples:", *examples, *([note] if note else []), EXIT_CODES]))

    def register(function: Command) -> Command:
        group.command(name, epilog=epilog)(from_fields(function))
        return function

    return register


def add_moved(group: typer.Typer, name: str, old: str, new: str) -> None:
    """Add a hidden command that names the form which took its place; its exit code is 2."""

    def moved() -> None:
        raise UsageError(f"{old} is now {new}, which needs a clone of the repository of scan-cell")

    moved.__doc__ = f"Moved: {new}."
    any_words = {"allow_extra_args": True, "ignore_unknown_options": True}
    group.command(name, hidden=True, context_settings=any_words)(moved)


def print_json(content: Mapping[str, object]) -> None:
    """Print one JSON object on stdout."""
    sys.stdout.write(json.dumps(content, indent=2, allow_nan=False) + "\n")


def from_fields(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command one option for each field of the models in its parameters.

    A parameter annotated with a model receives a checked instance made from the given options; one annotated with
    `OptionValues` receives the given options. All arguments are passed by keyword.
    """
    parameters = []
    for parameter in inspect.signature(function).parameters.values():
        specs = _specs(parameter.annotation)
        parameters += [parameter] if specs is None else [_parameter(spec) for spec in specs.values()]

    @functools.wraps(function)
    def run(**option_values: object) -> None:
        function(**arguments(function, option_values))

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # typer reads it
    return run


def arguments(function: Callable[..., None], option_values: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments of a command for the given options.

    Raises:
        UsageError: if a text does not fit its field.
    """
    result: dict[str, object] = {}
    for parameter in inspect.signature(function).parameters.values():
        specs = _specs(parameter.annotation)
        if specs is None:
            result[parameter.name] = option_values[parameter.name]
            continue
        values = {name: option_values[name] for name in specs if option_values[name] not in (None, [], ())}
        texts = {name: ",".join(value) if isinstance(value, list | tuple) else value for name, value in values.items()}
        model = parameter.annotation
        result[parameter.name] = texts if get_origin(model) is Annotated else parse_options(model, texts, flag)
    return result


def _specs(annotation: Any) -> Mapping[str, OptionSpec] | None:
    """Return the options of a parameter by its annotation; None for a parameter of typer's own."""
    if get_origin(annotation) is Annotated:
        specs = annotation.__metadata__[0]
        return specs if isinstance(specs, Mapping) else None
    return option_specs(annotation) if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None


def _parameter(spec: OptionSpec) -> inspect.Parameter:
    """Return an option as typer takes it; None means not given."""
    kind, option = spec.kind, spec.option
    flags = [flag(name) for name in (spec.name, option.also) if name]
    if kind.base is bool and next(iter(spec.fields.values())).default is None:
        flags = [f"{flags[0]}/--no-{flags[0].removeprefix('--')}"]
    text: Any = bool if kind.base is bool else list[str] if kind.length < 0 else str
    default = typer.Option(
        None, *flags, help=plain(spec.help), metavar=spec.metavar, rich_help_panel=option.panel or None
    )
    return inspect.Parameter(spec.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=text | None)
