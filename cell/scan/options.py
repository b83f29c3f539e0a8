"""Options of `cell scan`, checked."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, JsonValue, ValidationError, field_validator, model_validator

from cell.errors import UsageError
from cell.runs.current_files import CurrentFiles
from cell.runs.digest import SHORT_DIGEST
from cell.scene.fields import NotNegative, OptionalPath, Positive, SpeedShare, Units
from cell.scene.options import Option
from cell.scene.validation import error_messages
from planner.errors import PlannerError

_ERRORS, REAL_ROBOT, _POINTS = "Errors of the execution", "Real controllers", "Source of the points"
_ACTUAL = "As-built part"
_POSE_ERROR = Option(
    "Error of the executed pose, standard deviation along and about each axis: the scanner deviates from the reported "
    "pose.",
    _ERRORS,
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("0.5mm,0.1deg",),
)
_SETUP_ERROR = Option(
    "Largest placement error of the part in this set-up: a simulated part is displaced by it in a random direction, "
    "and all scans are matched to the model as one body within this range.",
    _ERRORS,
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("5mm,2deg",),
)
RESUME_OPTIONS = frozenset(
    {
        *("driver", "realtime", "confirm_motion", "speed", "reset", "accept_time_scale", "states"),
        *("scene", "part", "accept_changed_scene"),
    }
)
"""Options that apply to one command; a resumed execution keeps its other options."""


class ScanOptions(CurrentFiles):
    """Options of `cell scan`; each option documents the meaning of None."""

    driver: Annotated[str, Option("URL of the controller.", metavar="URL")] = "sim://"
    realtime: Annotated[bool, Option("Run the simulated arm in real time. Default: as fast as possible.")] = False
    view: Annotated[
        int | None, Option("Scan this view only, counted from 1 in visiting order. Default: all of them.")
    ] = None
    resolution_deg: Annotated[Positive | None, Option("Angle between rays. Default: the plan's.")] = None
    range_noise_mm: Annotated[NotNegative, Option("Noise along each ray, standard deviation.", _ERRORS)] = 0.0
    noise: Annotated[
        Literal["none", "model"],
        Option(
            "Model: add noise along each ray by the scanner's own law, from range, triangulation angle and incidence. "
            "Or none.",
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
            "Correct the reported poses by registration of the scans. Default: with a pose error, and for points that "
            "are not simulated.",
            _ERRORS,
            "register",
        ),
    ] = None
    seed: Annotated[int | None, Field(ge=0), Option("Seed of noise and pose error. Default: the plan's.", _ERRORS)] = (
        None
    )
    close_holes: Annotated[bool, Option("Close the holes of the surface; the added faces are marked.")] = False
    actual: Annotated[
        OptionalPath,
        Option(
            "Mesh file of the part as it is built, in the frame of the nominal part: simulated rays hit it, and the "
            "nominal part remains the reference. Default: the nominal part.",
            _ACTUAL,
            metavar="FILE",
        ),
    ] = None
    actual_units: Annotated[
        Units | None, Option("Unit of the as-built mesh, for formats that do not state it.", _ACTUAL)
    ] = None
    acquire: Annotated[
        str,
        Option(
            "Source of the points: simulated; files:DIR, one PLY, PCD, E57, PTX, LAS, LAZ or text file per view, named "
            "by its number; command:CMD, called with view, pose and the file to write; genicam:DEVICE, a 3D camera; or "
            "another installed source.",
            _POINTS,
            metavar="SOURCE",
        ),
    ] = "simulated"
    points_frame: Annotated[
        Literal["scanner", "flange", "base"] | None, Option("Frame of points that are not simulated.", _POINTS)
    ] = None
    points_units: Annotated[Units | None, Option("Unit of points that are not simulated. Never guessed.", _POINTS)] = (
        None
    )
    acquire_wait_s: Annotated[
        NotNegative, Option("Time that the arm waits for a view's file, with --acquire files.", _POINTS)
    ] = 0.0
    acquire_timeout_s: Annotated[
        Positive,
        Option("Longest duration of a call, with --acquire command, of three attempts, or of a frame.", _POINTS),
    ] = 60.0
    speed: Annotated[
        SpeedShare | None,
        Option(
            "Share of the plan's speed. Default: 1 in simulation; on a real controller the share that gives a tenth of "
            "the axis speeds, at most 1.",
            REAL_ROBOT,
            metavar="SHARE",
        ),
    ] = None
    confirm_motion: Annotated[
        str | None,
        Option(
            "Confirms that a real arm may move: digest of the motion, or its first 8 characters. Default: ask.",
            REAL_ROBOT,
            metavar="DIGEST",
        ),
    ] = None
    reset: Annotated[bool, Option("Clear a latched fault of the controller first.", REAL_ROBOT)] = False
    accept_time_scale: Annotated[
        Positive | None,
        Option(
            "Accept a controller that reports a clock N times as fast as real time: an emulator.",
            REAL_ROBOT,
            metavar="N",
        ),
    ] = None
    states: Annotated[
        OptionalPath,
        Option("File to which each state of the controller is appended as a JSON line.", REAL_ROBOT, metavar="FILE"),
    ] = None

    @model_validator(mode="after")
    def _check_errors(self) -> Self:
        errors = self.range_noise_mm or self.pose_error_mm or self.pose_error_deg or self.noise != "none"
        if not self.is_simulated and errors:
            raise ValueError(f".acquire is {self.acquire!r}; noise and pose errors apply to simulated points only")
        if not self.is_simulated and self.actual is not None:
            raise ValueError(f".acquire is {self.acquire!r}: a real scanner measures the real part; omit --actual")
        if self.actual is None and self.actual_units is not None:
            raise ValueError(".actual_units is the unit of --actual, which is missing")
        return self

    @field_validator("actual", "states")
    @classmethod
    def _make_absolute(cls, path: Path | None) -> Path | None:
        return None if path is None else path.expanduser().absolute()

    @field_validator("confirm_motion")
    @classmethod
    def _check_digest(cls, digest: str | None) -> str | None:
        if digest is not None and not re.fullmatch(f"[0-9a-f]{{{SHORT_DIGEST},64}}", digest.lower()):
            raise ValueError(
                f"is {digest!r}; it must be a digest as cell plan prints it, {SHORT_DIGEST} characters or more"
            )
        return None if digest is None else digest.lower()

    @property
    def is_simulated(self) -> bool:
        """Whether the points come from the virtual scanner."""
        return self.acquire == "simulated"

    @property
    def uses_wire(self) -> bool:
        """Whether the driver may move a real arm: every driver except the controller simulated in this process."""
        return not self.driver.lower().startswith("sim:")

    @property
    def registers(self) -> bool:
        """Whether poses are corrected by registration."""
        default = self.pose_error_mm > 0 or self.pose_error_deg > 0 or not self.is_simulated
        return default if self.registration is None else self.registration

    @property
    def search_range(self) -> tuple[float, float] | None:
        """Range in which the part is localised [m, rad]; None if it is at its planned placement."""
        if self.setup_error_mm == 0 == self.setup_error_deg:
            return None
        return self.setup_error_mm / 1000, math.radians(self.setup_error_deg)

    def require_compatible(self, resume: str | None, report: str | None) -> None:
        """Refuse options of a new scan together with an execution to resume or to report.

        Raises:
            UsageError: naming the valid options.
        """
        keys = self.model_fields_set
        if report is not None and resume is not None:
            raise UsageError("--report uses the existing scans, --resume scans the missing views; give one of them")
        if resume is not None and keys - RESUME_OPTIONS:
            raise UsageError(
                "--resume keeps the options of the execution; with it give only --driver, --realtime, --speed, "
                "--confirm-motion, --reset, --accept-time-scale, --states, --scene, --part and --accept-changed-scene"
            )
        if report is not None and keys:
            raise UsageError("--report uses the existing scans; omit the options of a new scan")

    def as_manifest(self) -> dict[str, JsonValue]:
        """Return the options as the manifest stores them, with resolved defaults, for a later report."""
        values = self.model_dump(mode="json", exclude={"registration", "confirm_motion", "states"})
        files = {name: values.pop(name) for name in CurrentFiles.model_fields}
        return {**values, **files, "register": self.registers}

    @classmethod
    def from_manifest(cls, stored: Mapping[str, object]) -> "ScanOptions":
        """Return the options of a manifest.

        Raises:
            PlannerError: if a value is invalid.
        """
        options = {key: value for key, value in stored.items() if key in cls.model_fields and key != "confirm_motion"}
        try:
            return cls.model_validate({**options, "registration": stored.get("register")})
        except ValidationError as error:
            raise PlannerError("; ".join(error_messages(error, cls))) from error

    def resumed(self, now: "ScanOptions") -> "ScanOptions":
        """Return these options with the `RESUME_OPTIONS` of `now`; the driver only if it is given."""
        names = RESUME_OPTIONS if "driver" in now.model_fields_set else RESUME_OPTIONS - {"driver"}
        return self.model_copy(update={name: getattr(now, name) for name in names})
