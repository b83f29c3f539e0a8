"""A command's options made from the fields of models (`cell.scene.options`), and those that several commands share."""

import functools
import inspect
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, get_origin

import typer
from pydantic import BaseModel

from cell.errors import UsageError
from cell.scene.file import BUILT_IN
from cell.scene.model import PART, Scene
from cell.scene.options import OptionSpec, flag, option_specs, parse_options

Part = Annotated[
    str | None,
    typer.Argument(
        help=f"Mesh file (STL, OBJ, PLY, OFF, GLB), STEP file or a built-in part: {', '.join(BUILT_IN)}. Default: the "
        "scene's.",
        show_default=False,
    ),
]
SceneFile = Annotated[
    Path | None, typer.Option(help="Scene file (TOML). Default: the built-in scene.", rich_help_panel=PART)
]
RunFolder = Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")]
RunToMake = Annotated[
    Path | None, typer.Option(help="Run folder to make. Default: sim_runs/<UTC>-<hash>.", rich_help_panel="Output")
]
NoCache = Annotated[
    bool, typer.Option("--no-cache", help="Neither read nor write cached matrices.", rich_help_panel="Output")
]
AsJson = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel="Output"),
]

Wishes = dict[str, object]
"""Texts and switches by the names of their options, only those that were given; `Annotated` with what is offered."""
OfScene = Annotated[Wishes, option_specs(Scene)]
OfPart = Annotated[Wishes, option_specs(Scene, "units")]


def add_moved(app: typer.Typer, name: str, old: str, new: str) -> None:
    """Add a hidden command that names the form which took its place; its exit code is 2."""

    def command() -> None:
        raise UsageError(f"{old} is now {new}, which needs a clone of the repository of scan-cell")

    command.__doc__ = f"Moved: {new}."
    any_words = {"allow_extra_args": True, "ignore_unknown_options": True}
    app.command(name, hidden=True, context_settings=any_words)(command)


def print_json(content: Mapping[str, object]) -> None:
    """What `--json` asks for: one object on stdout."""
    sys.stdout.write(json.dumps(content, indent=2, allow_nan=False) + "\n")


def from_fields(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command one option for each field that its parameters offer.

    A parameter that is a model gets an instance, made of what was given and checked; one that is `Wishes` gets what
    was given. All parameters are keywords (`*`).
    """
    parameters = []
    for parameter in inspect.signature(command).parameters.values():
        offered = _offered(parameter.annotation)
        parameters += [parameter] if offered is None else [_parameter(offer) for offer in offered.values()]

    @functools.wraps(command)
    def run(**given: object) -> None:
        command(**arguments(command, given))

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # typer reads it
    return run


def arguments(command: Callable[..., None], given: Mapping[str, object]) -> dict[str, object]:
    """The arguments of a command, of what was given for its options.

    Raises:
        UsageError: if a text cannot be what its field is.
    """
    found: dict[str, object] = {}
    for parameter in inspect.signature(command).parameters.values():
        offered = _offered(parameter.annotation)
        if offered is None:
            found[parameter.name] = given[parameter.name]
            continue
        asked = {name: given[name] for name in offered if given[name] not in (None, [], ())}
        wishes = {name: ",".join(texts) if isinstance(texts, list | tuple) else texts for name, texts in asked.items()}
        model = parameter.annotation
        found[parameter.name] = wishes if get_origin(model) is Annotated else parse_options(model, wishes, flag)
    return found


def _offered(annotation: Any) -> Mapping[str, OptionSpec] | None:
    """What a parameter of this annotation offers; None for one of typer's own."""
    if get_origin(annotation) is Annotated:
        offered = annotation.__metadata__[0]
        return offered if isinstance(offered, Mapping) else None
    return option_specs(annotation) if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None


def _parameter(offer: OptionSpec) -> inspect.Parameter:
    """One option as typer takes it; None where it is not given."""
    kind, option = offer.kind, offer.option
    flags = [flag(name) for name in (offer.name, option.also) if name]
    if kind.base is bool and next(iter(offer.fields.values())).default is None:
        flags = [f"{flags[0]}/--no-{flags[0].removeprefix('--')}"]
    text: Any = bool if kind.base is bool else list[str] if kind.length < 0 else str
    shown = typer.Option(None, *flags, help=offer.help, metavar=offer.metavar, rich_help_panel=option.panel or None)
    return inspect.Parameter(offer.name, inspect.Parameter.KEYWORD_ONLY, default=shown, annotation=text | None)
