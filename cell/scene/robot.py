"""The `[robot]` of a scene: which arm it is, where it stands and how fast it may go."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, ValidationInfo, field_validator

from cell.scene.fields import (
    AxisLimits,
    JerkLimits,
    NotNegative,
    Positive,
    Share,
    Table,
    Triple,
    existing_file,
)
from cell.scene.option import Option
from cell.scene.posed import Posed

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

HARDWARE = "Robot and scanner"
"""Heading of the options of robot and scanner."""


class Base(Posed):
    """Where the robot's base stands in the frame of the cell, whose z is up."""


class Robot(Table):
    """The arm and what it stands on.

    With `base` None the cell's frame is the robot's base. The pedestal stands between the floor, which lies
    `pedestal_height_mm` below the cell's origin, and a base that is upright; under any other there is none.
    """

    model: str = "kr16"
    base_link: str | None = None
    flange_link: str | None = None
    packages: dict[str, str] | None = None
    base: Base | None = None
    home_deg: Annotated[tuple[float, float, float, float, float, float], Field(strict=False)] | None = None
    pedestal_height_mm: NotNegative = 600.0
    pedestal_size_mm: Annotated[tuple[Positive, Positive], Field(strict=False)] = (600.0, 600.0)
    speed_scaling: Annotated[
        Share, Option("Override: share of the axis speeds.", HARDWARE, name="speed", metavar="SHARE")
    ] = 1.0
    acceleration_scaling: Share = 1.0
    velocity_deg_s: Annotated[AxisLimits, Field(strict=False)] | None = None
    acceleration_deg_s2: Annotated[AxisLimits, Field(strict=False)] | None = None
    jerk_deg_s3: Annotated[JerkLimits, Field(strict=False)] | None = None

    @field_validator("model")
    @classmethod
    def _known(cls, model: str, info: ValidationInfo) -> str:
        return model if model == "kr16" else existing_file(model, info, "a URDF or an MJCF, or kr16")

    @field_validator("packages")
    @classmethod
    def _folders(cls, packages: dict[str, str] | None, info: ValidationInfo) -> dict[str, str] | None:
        folder = Path((info.context or {}).get("folder", Path.cwd()))
        return packages and {name: str(folder / Path(path).expanduser()) for name, path in packages.items()}

    @property
    def settled_home_deg(self) -> tuple[float, ...]:
        """The home in a settled scene (`cell.world.model`) [deg]."""
        assert self.home_deg is not None, "the scene is not settled"
        return self.home_deg

    @property
    def T_base(self) -> "NDArray[np.float64]":
        """(4, 4) the robot's base in the cell's frame [m]."""
        return (self.base or Base()).T

    @property
    def pedestal_mm(self) -> tuple[Triple, Triple] | None:
        """Sides and middle of the pedestal in the cell's frame [mm]; None: the robot stands on none."""
        x, y, z = (0.0, 0.0, 0.0) if self.base is None else self.base.position_mm
        height = self.pedestal_height_mm + z
        if height <= 0 or not self.T_base[2, 2] > 1 - 1e-9:
            return None
        return (*self.pedestal_size_mm, height), (x, y, z - height / 2)
