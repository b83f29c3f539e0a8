"""Validated options of `cell replay`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, field_validator, model_validator

from cell.scene.fields import OptionalPath, Table
from cell.scene.options import Option

_Elevation = Annotated[float, Field(ge=-89, le=89)]
_Pixels = Annotated[int, Field(ge=64, le=4096)]


def _names(texts: Sequence[str]) -> list[str]:
    return [each for text in texts for each in text.split(",")]


class ReplayOptions(Table):
    """Content and form of the replay; the viewer opens without `frames`, `picture` and `web`."""

    execution: Annotated[
        str | None, Option("Replay an execution: its id, or latest. Default: the plan.", metavar="ID")
    ] = None
    view: Annotated[int | None, Option("Begin at this view, counted from 1 in visiting order.")] = None
    tightest: Annotated[bool, Option("Begin at the moment with the smallest distance.")] = False
    rate: Annotated[float, Field(gt=0, le=1000), Option("Speed of the replay relative to the motion.")] = 1.0
    once: Annotated[bool, Option("Close the viewer at the end.")] = False
    web: Annotated[
        bool, Option("Show the run in a browser of this machine (MuJoCo Studio); needs no display for the viewer.")
    ] = False
    frames: Annotated[OptionalPath, Option("Draw PNG frames into a folder; needs no display.", metavar="DIR")] = None
    fps: Annotated[float, Field(gt=0, le=240), Option("Frames for each second of film.")] = 25.0
    picture: Annotated[
        OptionalPath, Option("Draw one picture of the whole tour; needs no display.", metavar="FILE.png")
    ] = None
    camera_deg: Annotated[
        tuple[Annotated[float, Field(ge=-360, le=360)], _Elevation] | None,
        Field(strict=False),
        Option(
            "With --picture: azimuth and elevation of the camera as seen from the part, deg.", metavar="AZ,EL",
            form="azimuth,elevation in degrees", examples=("-60,20",), counts=(2,),
        ),
    ] = None  # fmt: skip
    hide: Annotated[
        tuple[str, ...],
        Field(strict=False),
        Option("With --picture: hide robot, post, a fixture, ...", metavar="NAME", convert=_names),
    ] = ()
    size: Annotated[
        tuple[_Pixels, _Pixels],
        Field(strict=False),
        Option(
            "Size of frames and picture in pixels.", metavar="WxH", form="width x height in pixels",
            examples=("960x720",), counts=(2,), separator="x",
        ),
    ] = (960, 720)  # fmt: skip

    @field_validator("picture")
    @classmethod
    def _require_png(cls, path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() != ".png":
            raise ValueError(f"is {path}; it must end in .png")
        return path

    @model_validator(mode="after")
    def _require_compatible(self) -> Self:
        if self.tightest and self.view is not None:
            raise ValueError(".tightest and view both set the start; give one of them")
        if self.web and (self.picture is not None or self.frames is not None):
            raise ValueError(".web shows the run in a browser; omit frames and picture")
        for key in ("camera_deg", "hide"):
            if self.picture is None and getattr(self, key):
                raise ValueError(f".{key} needs a picture; give a file for one too")
        return self
