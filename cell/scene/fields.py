"""The pieces of which the scene's tables are made: a strict, frozen table, and numbers with their limits."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
AxisLimits = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
MaybeEndless = Annotated[float, Field(gt=0, allow_inf_nan=True)]
JerkLimits = tuple[MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless]
Share = Annotated[float, Field(gt=0, le=1)]
Fov = Annotated[float, Field(gt=0, lt=180)]
Grazing = Annotated[float, Field(ge=0, le=90)]
# TOML has lists only: lenient about the container, strict about what is in it.
Four = Annotated[tuple[float, float, float, float], Field(strict=False)]
Triple = Annotated[tuple[float, float, float], Field(strict=False)]
Units = Literal["mm", "cm", "m", "um", "in"]


class Table(BaseModel):
    """A table of the scene file: every key known, strictly typed, finite; frozen."""

    # Built when first used: `--help` needs only the fields.
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


def existing_file(path: str, info: ValidationInfo, kind: str = "a mesh file") -> str:
    """The absolute path of a file that a scene names."""
    folder = Path((info.context or {}).get("folder", Path.cwd()))
    try:
        full = folder / Path(path).expanduser()
        found = full.is_file()
    except (OSError, ValueError, RuntimeError):  # longer than any name, a zero in it, the home of nobody
        raise ValueError(f"is no name that a file can have; give {kind}, relative to the scene file") from None
    if not found:
        raise ValueError(f"is '{path}', and there is no file {full}; give {kind}, relative to the scene file")
    return str(full)
