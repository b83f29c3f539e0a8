"""Options of `cell locate` and `cell calibrate hand-eye`, checked."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cell.scene.fields import NotNegative, Positive, Table, Units
from cell.scene.options import Option

_MEASURED, _FIT = "Measured points (one of them)", "Fit"
_SEARCH = Option(
    "Largest deviation of the part from its planned placement (at most 45 deg), for the best fit.",
    _FIT,
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("30mm,8deg",),
)
_INSPECT_SEARCH = Option(
    "Largest deviation of the points from the frame of the part. Default: they are in it.",
    _FIT,
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("30mm,8deg",),
)
_POSE_SD = Option(
    "Standard deviation of the flange's pose along and about each axis. Their ratio weights the residuals.",
    metavar="LENGTHmm,ANGLEdeg",
    form="a length and an angle with their units",
    examples=("0.03mm,0.02deg",),
)


class LocateOptions(Table):
    """Measured points and settings of their fit."""

    points: Annotated[
        str | None,
        Option(
            "File of points on the part (PLY, PCD, E57, PTX, LAS, LAZ or text), or a folder with one file a view, "
            "named by its number: best fit.",
            _MEASURED,
            metavar="FILE|DIR",
        ),
    ] = None
    execution: Annotated[
        str | None,
        Option("Scans of an execution of RUN, by its id or latest: best fit. The default.", _MEASURED, metavar="ID"),
    ] = None
    pairs: Annotated[
        str | None,
        Option("File with one point a line: name, x, y, z on the part, x, y, z measured.", _MEASURED, metavar="FILE"),
    ] = None
    three_two_one: Annotated[
        str | None,
        Option(
            "The same with six lines: three points of a plane, two of one across it, one of one across both.",
            _MEASURED,
            metavar="FILE",
        ),
    ] = None
    points_frame: Annotated[
        Literal["scanner", "flange", "base"] | None,
        Option("Frame of measured points; scanner and flange are those of the view.", _MEASURED),
    ] = None
    points_units: Annotated[
        Units | None, Option("Unit of measured points, and of the points on the part. Never guessed.", _MEASURED)
    ] = None
    view: Annotated[
        tuple[Annotated[int, Field(ge=1)], ...],
        Field(strict=False),
        Option(
            "Views of the fitted points, all as one body, by their numbers in visiting order. Default: the first view "
            "with a scan.",
            _MEASURED,
            metavar="N[,N...]",
            form="numbers of views",
            examples=("1", "1,4"),
        ),
    ] = ()
    search_mm: Annotated[Positive, _SEARCH] = 30.0
    search_deg: Annotated[float, Field(gt=0, le=45), _SEARCH] = 8.0
    point_sd_mm: Annotated[
        Positive | None,
        Option("Standard deviation of a measured coordinate. Default: from the residuals of the pairs.", _FIT),
    ] = None
    tolerance_mm: Annotated[
        Positive, Option("A direction is not determined where two standard deviations are more than this.", _FIT)
    ] = 0.1

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        sources = [
            name for name in ("points", "execution", "pairs", "three_two_one") if getattr(self, name) is not None
        ]
        if len(sources) > 1:
            raise ValueError(f".{sources[1]} is given together with {sources[0]}; give one of them")
        measured = sources and sources[0] != "execution"
        for name in ("points_frame", "points_units"):
            if measured and getattr(self, name) is None:
                raise ValueError(f".{name} is missing; frame and unit of measured points are never guessed")
            if not measured and getattr(self, name) is not None:
                raise ValueError(f".{name} is given for an execution, which records its own; omit it")
        return self


class InspectOptions(Table):
    """Points of `cell inspect` from a file."""

    points_units: Annotated[
        Units | None,
        Option("Unit of the points or the mesh, unless the file states it (3MF, STEP).", _MEASURED),
    ] = None
    search_mm: Annotated[NotNegative, _INSPECT_SEARCH] = 0.0
    search_deg: Annotated[float, Field(ge=0, le=45), _INSPECT_SEARCH] = 0.0
    point_sd_mm: Annotated[
        Positive | None,
        Option("Standard deviation of a point along the normal. Default: from the scatter of the points.", _FIT),
    ] = None


class HandEyeOptions(Table):
    """Scans of one stationary target from several poses of the flange."""

    target: Annotated[Literal["sphere", "plane"], Option("Type of the target.")] = "sphere"
    diameter_mm: Annotated[Positive | None, Option("Of the sphere. Default: estimated with the mount.")] = None
    points_units: Annotated[Units | None, Option("Unit of the points. Never guessed.")] = None
    poses: Annotated[
        str | None,
        Option(
            "File with one line a scan, in the order of the scans: x, y, z of the flange in base (mm) and KUKA's A, B, "
            "C (deg). Default: the JSON file next to each scan, as cell scan --acquire command writes it.",
            metavar="FILE",
        ),
    ] = None
    pose_sd_mm: Annotated[Positive, _POSE_SD] = 0.03
    pose_sd_deg: Annotated[Positive, _POSE_SD] = 0.02
    tolerance_mm: Annotated[
        Positive,
        Option("A direction is not determined where two standard deviations are more than this at the target."),
    ] = 0.5

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if self.points_units is None:
            raise ValueError(".points_units is missing; give the unit of the points: mm, cm, m, um or in")
        if self.target == "plane" and self.diameter_mm is not None:
            raise ValueError(".diameter_mm is for a sphere, and the target is a plane; omit it")
        return self
