"""What `cell scan` can be asked for, checked."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, JsonValue, ValidationError

from cell.scene.fields import NotNegative, Positive, Table
from cell.scene.option import Option
from cell.scene.problems import sentences

_ERRORS, STEEL = "Errors of the execution", "Real controllers"
_POSE_ERROR = Option(
    "Error of the executed pose, one sigma along and about each axis: the scanner stands off what the controller "
    "reports.",
    _ERRORS,
    metavar="MM,DEG",
    form="two numbers, mm and deg",
    examples=("0.5,0.1",),
    counts=(2,),
)
OF_EACH_TIME = frozenset({"driver", "realtime", "confirm_motion", "speed_percent", "reset", "accept_time_scale"})
"""What is said anew where an execution is resumed; all else stays as it was begun."""


class ScanOptions(Table):
    """What `cell scan` was asked for; what None means, each option says."""

    driver: Annotated[str, Option("Which controller drives.", metavar="URL")] = "sim://"
    realtime: Annotated[bool, Option("Let the simulated arm take its time. Default: as fast as it goes.")] = False
    view: Annotated[
        int | None, Option("Scan this view only, counted from 1 in visiting order. Default: all of them.")
    ] = None
    resolution_deg: Annotated[Positive | None, Option("Angle between rays. Default: the plan's.")] = None
    range_noise_mm: Annotated[NotNegative, Option("Noise along each ray, one sigma.", _ERRORS)] = 0.0
    noise: Annotated[
        Literal["none", "model"],
        Option(
            "Model: noise along each ray by the scanner's own law as well, from range, triangulation angle and "
            "incidence.",
            _ERRORS,
        ),
    ] = "none"
    pose_error_mm: Annotated[NotNegative, _POSE_ERROR] = 0.0
    pose_error_deg: Annotated[NotNegative, _POSE_ERROR] = 0.0
    registration: Annotated[
        bool | None,
        Option("Correct the reported poses by matching the scans. Default: with a pose error.", _ERRORS, "register"),
    ] = None
    seed: Annotated[int | None, Field(ge=0), Option("Seed of noise and pose error. Default: the plan's.", _ERRORS)] = (
        None
    )
    close_holes: Annotated[bool, Option("Close the holes of the surface; the faces are marked.")] = False
    speed_percent: Annotated[
        float | None,
        Field(gt=0, le=100),
        Option(
            "Of the speed that the plan was timed with. Default: 100 in simulation; 10 % of the axis speeds on a real "
            "controller.",
            STEEL,
        ),
    ] = None
    confirm_motion: Annotated[bool, Option("Your word that a real arm may move. Else it is asked for.", STEEL)] = False
    reset: Annotated[bool, Option("Clear a latched fault of the controller first.", STEEL)] = False
    accept_time_scale: Annotated[
        Positive | None,
        Option(
            "Drive a controller that says that its clock is so many times as fast as real time: an emulator's.",
            STEEL,
            metavar="N",
        ),
    ] = None

    @property
    def registers(self) -> bool:
        """Whether poses are corrected by registration."""
        moved = self.pose_error_mm > 0 or self.pose_error_deg > 0
        return moved if self.registration is None else self.registration

    def kept(self) -> dict[str, JsonValue]:
        """For the manifest: all that a report made later needs, settled."""
        return {**self.model_dump(mode="json", exclude={"registration"}), "register": self.registers}

    @classmethod
    def begun(cls, kept: Mapping[str, object]) -> "ScanOptions":
        """The options of a manifest.

        Raises:
            ValueError: in one sentence, if one of them cannot be.
        """
        own = {key: value for key, value in kept.items() if key in cls.model_fields}
        try:
            return cls.model_validate({**own, "registration": kept.get("register")})
        except ValidationError as error:
            raise ValueError("; ".join(sentences(error, cls))) from error

    def resumed(self, now: "ScanOptions") -> "ScanOptions":
        """These, as an execution goes on with: `OF_EACH_TIME` as they are now, the driver only where it is given."""
        said = OF_EACH_TIME if "driver" in now.model_fields_set else OF_EACH_TIME - {"driver"}
        return self.model_copy(update={name: getattr(now, name) for name in said})
