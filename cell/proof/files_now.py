"""Where the cell is described now, as the options of `cell scan` and `cell export` say it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from cell.scene.option import Option

MISSING = "missing"
"""Accepts files that are gone."""

_CELL = "The cell as it is now"


def _one_by_one(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name.strip() for text in names for name in text.split(","))


SceneNow = Annotated[
    Path | None,
    Field(strict=False),
    Option("Scene file that describes the cell now. Default: the one that was planned with.", _CELL, metavar="FILE"),
]
PartNow = Annotated[
    str | None, Option("Mesh file of the part now. Default: the one that was planned with.", _CELL, metavar="FILE")
]
Accepted = Annotated[
    tuple[str, ...],
    BeforeValidator(_one_by_one),
    Field(strict=False),
    Option("Go on although this differs from the plan: names as the refusal gives them.", _CELL),
]


@dataclass(frozen=True, slots=True)
class FilesNow:
    """Where the cell is described now, and which changes are accepted.

    Attributes:
        scene: scene file in place of the manifest's.
        part: mesh file or built-in part in place of the manifest's.
        accepted: names of differences that are accepted.
    """

    scene: Path | None = None
    part: str | None = None
    accepted: tuple[str, ...] = ()
