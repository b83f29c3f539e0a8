"""Options of the command line as tables of the scene: `--place` goes before the scene file's `[placement]`."""

import difflib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import FileError, SceneError, UsageError
from cell.scene import presets

Preset = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"What is settled where neither scene file nor option says anything. {presets.line()}.",
        show_default=False,
    ),
]

_OPTION_OF_KEY = {
    "robot.speed_scaling": "--speed",
    "part.path": "the part",
    "part.name": "the part",
    "part.units": "--units",
    "placement.position_mm": "--place",
    "placement.abc_deg": "--place",
    "scanner.sensor": "--sensor",
    "scanner.baseline_mm": "--baseline",
    "plan.preset": "--preset",
    "plan.faces": "--faces",
    "plan.percent_kept": "--percent",
    "plan.candidates": "--candidates",
    "plan.standoffs_mm": "--standoff",
    "plan.rolls_deg": "--roll",
    "plan.coverage": "--coverage",
    "plan.required_visible": "--require",
    "plan.fill": "--fill",
    "plan.samples_per_face": "--samples",
    "plan.solver": "--solver",
    "plan.collision": "--collision",
    "plan.seed": "--seed",
    "plan.max_views": "--max-views",
    "plan.multiplicity": "--multiplicity",
    "plan.pinned": "--pin",
    "plan.banned": "--ban",
    "plan.cost": "--cost",
    "plan.overlap_mm2": "--overlap",
    "plan.overlap_share": "--overlap",
    "plan.overlap_in_order": "--overlap-in-order",
    "plan.pose_sd_mm": "--pose-sd",
    "plan.pose_sd_deg": "--pose-sd",
    "plan.alpha": "--alpha",
}


@contextmanager
def named_as_options(options: dict[str, dict[str, Any]]) -> Iterator[None]:
    """A scene's error about a key that came from the command line names the option, as its user wrote it."""
    try:
        yield
    except SceneError as error:
        text = str(error)
        for key, option in _OPTION_OF_KEY.items():
            table, name = key.split(".")
            if name in options.get(table, {}):
                text = text.replace(f"  {key} ", f"  {option} ").replace(f"  {key}[", f"  {option} [")
        raise SceneError(text) from error


def placement(text: str) -> dict[str, Any]:
    """`[placement]` of `--place x,y,z[,A,B,C]`.

    Raises:
        UsageError: if these are not three or six numbers.
    """
    values = numbers("--place", text)
    if values is None or len(values) not in (3, 6):
        raise UsageError(f"--place {text} must be x,y,z or x,y,z,A,B,C (mm and deg), for instance --place 1200,500,0")
    table: dict[str, Any] = {"position_mm": values[:3]}
    if len(values) == 6:
        table["abc_deg"] = values[3:]
    return table


def part(name_or_path: str, units: str | None) -> dict[str, Any]:
    """`[part]` of the positional argument: a built-in part by name, else a file.

    Raises:
        UsageError: if units are given for a built-in part, or nothing has this name.
        FileError: if the file is a folder or missing.
    """
    from cell.stand_ins import NAMES

    path = Path(name_or_path)
    if name_or_path in NAMES and not path.is_file():
        if units is not None:
            raise UsageError(f"{name_or_path} is built in and has its own size; leave --units away")
        return {"name": name_or_path}
    if path.is_dir():
        raise FileError(f"{name_or_path} is a folder; give a mesh file in it")
    if not path.exists():
        if path.suffix == "" and os.sep not in name_or_path:
            close = difflib.get_close_matches(name_or_path.lower(), NAMES, n=1)
            hint = f"did you mean {close[0]}? " if close else ""
            raise UsageError(
                f"there is no built-in part and no file {name_or_path}; {hint}Built in are {', '.join(NAMES)}"
            )
        raise FileError(f"there is no file {name_or_path}; give the path of a mesh (STL, OBJ, PLY, OFF or GLB)")
    return {"path": str(path.absolute()), "units": units}


def numbers(option: str, text: str | None) -> list[float] | None:
    """The numbers of an option such as `--standoff 200,300`; None where it is not given.

    Raises:
        UsageError: if a piece is no number.
    """
    if text is None:
        return None
    try:
        return [float(piece) for piece in text.split(",")]
    except ValueError:
        raise UsageError(f"{option} {text} must be numbers separated by commas, without spaces") from None


def views(option: str, texts: list[str] | None) -> list[int] | None:
    """Candidates of an option that may be given several times, each with one number or several; None without any.

    Raises:
        UsageError: if a piece is no candidate's number.
    """
    if not texts:
        return None
    pieces = [piece.strip() for text in texts for piece in text.split(",")]
    if not all(piece.isdecimal() for piece in pieces):
        raise UsageError(
            f"{option} {' '.join(texts)} must name candidates by their numbers, for instance {option} 12,40"
        )
    return [int(piece) for piece in pieces]


def overlap(text: str | None) -> dict[str, float]:
    """Keys of `[plan]` of `--overlap 20%` or `--overlap 500mm2`: the unit is given, never guessed.

    Raises:
        UsageError: if it is neither.
    """
    if text is None:
        return {}
    for ending, key, scale in (("%", "overlap_share", 0.01), ("mm2", "overlap_mm2", 1.0)):
        if text.endswith(ending):
            value = numbers("--overlap", text.removesuffix(ending).strip())
            if value is not None and len(value) == 1:
                return {key: value[0] * scale}
    raise UsageError(
        f"--overlap {text} must be a share of the smaller view or an area, for instance --overlap 20% or "
        "--overlap 500mm2"
    )


def pose_sd(text: str | None) -> dict[str, float]:
    """Keys of `[plan]` of `--pose-sd 0.5mm,0.1deg`; one of the two may be left away.

    Raises:
        UsageError: if a piece has no unit, or one comes twice.
    """
    found: dict[str, float] = {}
    for piece in text.split(",") if text is not None else []:
        for ending, key in (("mm", "pose_sd_mm"), ("deg", "pose_sd_deg")):
            value = numbers("--pose-sd", piece.removesuffix(ending).strip()) if piece.endswith(ending) else None
            if value is not None and key not in found:
                found[key] = value[0]
                break
        else:
            raise UsageError(
                f"--pose-sd {text} must be standard deviations of position and orientation with their units, for "
                "instance --pose-sd 0.5mm,0.1deg"
            )
    return found


def preset(name: str | None) -> dict[str, str]:
    """Keys of `[plan]` of `--preset`; the scene refuses a name that it does not know."""
    return {} if name is None else {"preset": name}
