"""Where the cell is described now, as the options of `cell scan` and `cell export` say it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from cell.scene.fields import Table
from cell.scene.options import Option

MISSING = "missing"
"""Accepts files that are gone."""

_CELL = "The cell as it is now"


def _one_by_one(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name.strip() for text in names for name in text.split(","))


class FilesNow(Table):
    """Where the cell is described now, and which changes are accepted."""

    scene: Annotated[
        Path | None,
        Field(strict=False),
        Option(
            "Scene file that describes the cell now. Default: the one that was planned with.", _CELL, metavar="FILE"
        ),
    ] = None
    part: Annotated[
        str | None, Option("Mesh file of the part now. Default: the one that was planned with.", _CELL, metavar="FILE")
    ] = None
    accept_changed_scene: Annotated[
        tuple[str, ...],
        BeforeValidator(_one_by_one),
        Field(strict=False),
        Option("Go on although this differs from the plan: names as the refusal gives them.", _CELL),
    ] = ()
