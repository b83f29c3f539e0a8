"""What `cell calibrate hand-eye` can be asked for, checked."""

from typing import Annotated, Literal, Self

from pydantic import model_validator

from cell.scene.fields import Positive, Table, Units
from cell.scene.options import Option

_POSE_SD = Option(
    "Standard deviation of the flange's pose along and about each axis. Their ratio weights the residuals.",
    metavar="MM,DEG", form="two numbers, mm and deg", examples=("0.03,0.02",), counts=(2,),
)  # fmt: skip


class HandEye(Table):
    """Scans of one target that stays where it is, from several poses of the flange."""

    target: Annotated[Literal["sphere", "plane"], Option("What was scanned.")] = "sphere"
    diameter_mm: Annotated[Positive | None, Option("Of the sphere. Default: found with the rest.")] = None
    points_units: Annotated[Units | None, Option("Unit of the points. Never guessed.")] = None
    poses: Annotated[
        str | None,
        Option(
            "File with a line a scan, in the order of the scans: x, y, z of the flange in base (mm) and KUKA's A, B, C "
            "(deg). Default: the JSON file beside each scan, as cell scan --acquire command leaves it.", metavar="FILE",
        ),
    ] = None  # fmt: skip
    pose_sd_mm: Annotated[Positive, _POSE_SD] = 0.03
    pose_sd_deg: Annotated[Positive, _POSE_SD] = 0.02
    within_mm: Annotated[
        Positive,
        Option("A direction is not determined where two standard deviations are more than this at the target."),
    ] = 0.5

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.points_units is None:
            raise ValueError(".points_units is missing; say what the points are in: mm, cm, m, um or in")
        if self.target == "plane" and self.diameter_mm is not None:
            raise ValueError(".diameter_mm is of a sphere, and the target is a plane; leave it out")
        return self
