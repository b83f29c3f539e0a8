"""Options for the files that describe the cell now (`cell.runs.current_scene`); imported by `--help`."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import BeforeValidator, Field

from cell.scene.fields import OptionalPath, Table
from cell.scene.options import Option

_HELP_GROUP = "The cell as it is now"


def _one_by_one(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name.strip() for text in names for name in text.split(","))


class CurrentFiles(Table):
    """Files that describe the cell now, and the accepted differences."""

    scene: Annotated[
        OptionalPath, Option("Scene file of the current cell. Default: the planned one.", _HELP_GROUP, metavar="FILE")
    ] = None
    part: Annotated[
        str | None, Option("Mesh file of the current part. Default: the planned one.", _HELP_GROUP, metavar="FILE")
    ] = None
    accept_changed_scene: Annotated[
        tuple[str, ...],
        BeforeValidator(_one_by_one),
        Field(strict=False),
        Option("Accepted differences from the plan, by the names in the error message.", _HELP_GROUP),
    ] = ()
