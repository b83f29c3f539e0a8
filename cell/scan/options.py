"""What `cell scan` can be asked for, checked."""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, JsonValue, ValidationError, field_validator, model_validator

from cell.acquisition import SIMULATED
from cell.runs.current_files import CurrentFiles
from cell.runs.digest import SHORT_DIGEST
from cell.scene.fields import NotNegative, Positive, Units
from cell.scene.options import Option
from cell.scene.validation import error_messages
from planner.errors import PlannerError

_ERRORS, STEEL = "Errors of the execution", "Real controllers"
_POINTS = "Where points come from"
_POSE_ERROR = Option(
    "Error of the executed pose, one sigma along and about each axis: the scanner stands off what the controller "
    "reports.",
    _ERRORS,
    metavar="MM,DEG",
    form="two numbers, mm and deg",
    examples=("0.5,0.1",),
    counts=(2,),
)
_SETUP_ERROR = Option(
    "How far off its place the part may stand in this set-up: a simulated one does, in a direction drawn by the seed, "
    "and all scans are matched to the model as one body, searched so far.",
    _ERRORS,
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("5mm,2deg",),
)
OF_EACH_TIME = frozenset(
    {
        *("driver", "realtime", "confirm_motion", "speed_percent", "reset", "accept_time_scale"),
        *("scene", "part", "accept_changed_scene"),
    }
)
"""What is said anew where an execution is resumed; all else stays as it was begun."""


class ScanOptions(CurrentFiles):
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
    setup_error_mm: Annotated[NotNegative, _SETUP_ERROR] = 0.0
    setup_error_deg: Annotated[NotNegative, _SETUP_ERROR] = 0.0
    registration: Annotated[
        bool | None,
        Option(
            "Correct the reported poses by matching the scans. Default: with a pose error, and where points are not "
            "simulated.",
            _ERRORS,
            "register",
        ),
    ] = None
    seed: Annotated[int | None, Field(ge=0), Option("Seed of noise and pose error. Default: the plan's.", _ERRORS)] = (
        None
    )
    close_holes: Annotated[bool, Option("Close the holes of the surface; the faces are marked.")] = False
    acquire: Annotated[
        str,
        Option(
            "Where points come from: simulated; files:DIR, one PLY, XYZ or PCD a view, named by its number; "
            "command:CMD, called with view, pose and the file to write; or another installed source.",
            _POINTS,
            metavar="SOURCE",
        ),
    ] = SIMULATED
    points_frame: Annotated[
        Literal["scanner", "flange", "base"] | None, Option("Frame of points that are not simulated.", _POINTS)
    ] = None
    points_units: Annotated[Units | None, Option("Unit of points that are not simulated. Never guessed.", _POINTS)] = (
        None
    )
    acquire_wait_s: Annotated[
        NotNegative, Option("How long the arm stands and waits for a view's file, with --acquire files.", _POINTS)
    ] = 0.0
    acquire_timeout_s: Annotated[
        Positive, Option("How long a call may take, with --acquire command; it is called three times.", _POINTS)
    ] = 60.0
    speed_percent: Annotated[
        float | None,
        Field(gt=0, le=100),
        Option(
            "Of the speed that the plan was timed with. Default: 100 in simulation; 10 % of the axis speeds on a real "
            "controller.",
            STEEL,
        ),
    ] = None
    confirm_motion: Annotated[
        str | None,
        Option(
            "Your word that a real arm may move: the digest of what is driven, or its first 8 characters. Else it is "
            "asked for.",
            STEEL,
            metavar="DIGEST",
        ),
    ] = None
    reset: Annotated[bool, Option("Clear a latched fault of the controller first.", STEEL)] = False
    accept_time_scale: Annotated[
        Positive | None,
        Option(
            "Drive a controller that says that its clock is so many times as fast as real time: an emulator's.",
            STEEL,
            metavar="N",
        ),
    ] = None

    @model_validator(mode="after")
    def _errors_are_simulated(self) -> Self:
        errors = self.range_noise_mm or self.pose_error_mm or self.pose_error_deg or self.noise != "none"
        if self.acquire != SIMULATED and errors:
            raise ValueError(f".acquire is {self.acquire!r}; noise and pose errors are those of simulated points")
        return self

    @field_validator("confirm_motion")
    @classmethod
    def _a_digest(cls, given: str | None) -> str | None:
        if given is not None and not re.fullmatch(f"[0-9a-f]{{{SHORT_DIGEST},64}}", given.lower()):
            raise ValueError(
                f"is {given!r}; it must be a digest as cell plan prints it, {SHORT_DIGEST} characters or more"
            )
        return None if given is None else given.lower()

    @property
    def registers(self) -> bool:
        """Whether poses are corrected by registration."""
        moved = self.pose_error_mm > 0 or self.pose_error_deg > 0 or self.acquire != SIMULATED
        return moved if self.registration is None else self.registration

    @property
    def search(self) -> tuple[float, float] | None:
        """How far the part is looked for about its place [m, rad]; None where it stands there."""
        if self.setup_error_mm == 0 == self.setup_error_deg:
            return None
        return self.setup_error_mm / 1000, math.radians(self.setup_error_deg)

    def kept(self) -> dict[str, JsonValue]:
        """For the manifest: all that a report made later needs, settled."""
        said = self.model_dump(mode="json", exclude={"registration", "confirm_motion"})
        now = {name: said.pop(name) for name in CurrentFiles.model_fields}
        return {**said, **now, "register": self.registers}

    @classmethod
    def begun(cls, kept: Mapping[str, object]) -> "ScanOptions":
        """The options of a manifest.

        Raises:
            PlannerError: in one sentence, if one of them cannot be.
        """
        own = {key: value for key, value in kept.items() if key in cls.model_fields and key != "confirm_motion"}
        try:
            return cls.model_validate({**own, "registration": kept.get("register")})
        except ValidationError as error:
            raise PlannerError("; ".join(error_messages(error, cls))) from error

    def resumed(self, now: "ScanOptions") -> "ScanOptions":
        """These, as an execution goes on with: `OF_EACH_TIME` as they are now, the driver only where it is given."""
        said = OF_EACH_TIME if "driver" in now.model_fields_set else OF_EACH_TIME - {"driver"}
        return self.model_copy(update={name: getattr(now, name) for name in said})
