"""The `[table]` of a scene: a rotary table that turns the part (docs/table.md)."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from cell.scene.fields import Positive, Table, Triple
from cell.scene.option import Option
from cell.scene.posed import PART


class Turntable(Table):
    """The rotary table on which the post stands: it turns part, post and the part's fixtures about its z.

    `position_mm` is the middle of its face, `abc_deg` the turn of its frame, 0 where the axis is upright. Without a
    position the axis goes through the part's centre, the face `post_mm` below what of the part is lowest along it; else
    the post is as long as the part stands above the face. A table of the scene file is there unless it says `enabled =
    false`. Without limits it is endless, and used half a turn to either side of 0, where motions begin and end. It
    moves together with the arm, or is indexed: it turns only while the arm stands still, clear of all that it turns at
    any angle.
    """

    enabled: Annotated[
        bool, Option("Turn the part on the scene's rotary table, or on the default one.", PART, name="table")
    ] = False
    position_mm: Triple | None = None
    abc_deg: Triple = (0.0, 0.0, 0.0)
    diameter_mm: Positive = 400.0
    height_mm: Positive = 250.0
    post_mm: Positive = 300.0
    swing_mm: Positive = 1000.0
    limits_deg: Annotated[tuple[float, float], Field(strict=False)] | None = None
    velocity_deg_s: Positive = 120.0
    acceleration_deg_s2: Positive = 240.0
    jerk_deg_s3: Positive = 2400.0
    moves: Literal["synchronised", "indexed"] = "synchronised"
    angles: Annotated[int, Field(ge=1, le=360)] = 36

    @model_validator(mode="before")
    @classmethod
    def _there(cls, table: Any) -> Any:
        return {"enabled": True, **table} if isinstance(table, dict) and table else table

    @field_validator("limits_deg")
    @classmethod
    def _about_home(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        if limits is not None and not limits[0] <= 0.0 <= limits[1]:
            raise ValueError(
                f"is {list(limits)}; it must be [min, max] with 0, where motions begin and end, in between"
            )
        return limits
