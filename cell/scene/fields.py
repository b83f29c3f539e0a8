"""Base class and number types of the tables of a scene file."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
AxisLimits = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
MaybeEndless = Annotated[float, Field(gt=0, allow_inf_nan=True)]
JerkLimits = tuple[MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless, MaybeEndless]
Share = Annotated[float, Field(gt=0, le=1)]


def _require_share(value: object) -> object:
    if isinstance(value, int | float) and value > 1:
        raise ValueError(f"is {value:g}; it is a share of the speed, at most 1: give {value / 100:g} for {value:g} %")
    return value


SpeedShare = Annotated[float, Field(gt=0, le=1), BeforeValidator(_require_share)]
Fov = Annotated[float, Field(gt=0, lt=180)]
Grazing = Annotated[float, Field(ge=0, le=90)]
# TOML has lists only: the container is lenient, its items are strict.
Four = Annotated[tuple[float, float, float, float], Field(strict=False)]
Triple = Annotated[tuple[float, float, float], Field(strict=False)]
Units = Literal["mm", "cm", "m", "um", "in"]
OptionalPath = Annotated[Path | None, Field(strict=False)]


LARGEST_LENGTH_MM = 1e6
"""Largest length in a scene file: a kilometre."""

_LARGEST = 1e12  # of the other numbers, such as jerks; squares and products of them are finite


class Table(BaseModel):
    """A frozen table of the scene file: known keys only, strict types, finite numbers of a moderate size."""

    # Validators are built at the first use: `--help` needs only the fields.
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @model_validator(mode="after")
    def _no_extreme_number(self) -> Self:
        for key, value in self:
            limit = LARGEST_LENGTH_MM if key.endswith("_mm") else _LARGEST
            if (largest := _largest_number(value)) > limit:
                raise ValueError(f".{key} has the number {largest:g}; it must be between -{limit:g} and {limit:g}")
        return self


def _largest_number(value: Any) -> float:
    """Return the largest magnitude of the finite floating-point numbers in a value; 0 without any."""
    if isinstance(value, float):
        return abs(value) if abs(value) < float("inf") else 0.0  # a jerk without a limit
    return max(map(_largest_number, value), default=0.0) if isinstance(value, tuple) else 0.0


def full_path(path: str, info: ValidationInfo) -> Path:
    """Return the absolute path of a file or folder that a scene names relative to its own folder.

    Raises:
        ValueError: if it is below the home folder of an unknown user.
    """
    folder = Path((info.context or {}).get("folder", Path.cwd()))
    try:
        return folder / Path(path).expanduser()
    except RuntimeError:
        raise ValueError(f"names '{path}', below the home folder of an unknown user; give another path") from None


def existing_file(path: str, info: ValidationInfo, kind: str = "a mesh file") -> str:
    """Return the absolute path of an existing file that a scene names relative to its own folder.

    Raises:
        ValueError: if there is no such file, or the name is not valid.
    """
    try:
        full = full_path(path, info)
        exists = full.is_file()
    except (OSError, ValueError):  # too long, a zero byte, an unknown user
        raise ValueError(f"is no valid file name; give {kind}, relative to the scene file") from None
    if not exists:
        raise ValueError(f"is '{path}', and there is no file {full}; give {kind}, relative to the scene file")
    return str(full)
