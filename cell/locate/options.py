"""What `cell locate` can be asked for, checked."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cell.scene.fields import Positive, Table, Units
from cell.scene.options import Option

_MEASURED, _FIT = "Measured points (one of them)", "Fit"
_SEARCH = Option(
    "How far off the part may stand and be turned (at most 45 deg), for the best fit.", _FIT, metavar="MM,DEG",
    form="mm and deg", examples=("30,8",), counts=(2,),
)  # fmt: skip


class Locating(Table):
    """Where the part stands: what was measured, and how it is fitted."""

    points: Annotated[
        str | None,
        Option(
            "File of points on the part (PLY, XYZ, TXT or PCD), or a folder with one a view, named by its number: best "
            "fit.", _MEASURED, metavar="FILE|DIR",
        ),
    ] = None  # fmt: skip
    execution: Annotated[
        str | None,
        Option("Scans of an execution of RUN, by its id or latest: best fit. The default.", _MEASURED, metavar="ID"),
    ] = None
    pairs: Annotated[
        str | None,
        Option("File with a point a line: name, x, y, z on the part, x, y, z measured.", _MEASURED, metavar="FILE"),
    ] = None
    three_two_one: Annotated[
        str | None,
        Option(
            "The same with six lines: three points of a plane, two of one across it, one of one across both.",
            _MEASURED, metavar="FILE",
        ),
    ] = None  # fmt: skip
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
            "Views whose points are fitted, all as one body, by their numbers in visiting order. Default: the first "
            "that there is.", _MEASURED, metavar="N[,N...]", form="numbers of views", examples=("1", "1,4"),
        ),
    ] = ()  # fmt: skip
    search_mm: Annotated[Positive, _SEARCH] = 30.0
    search_deg: Annotated[float, Field(gt=0, le=45), _SEARCH] = 8.0
    point_sd_mm: Annotated[
        Positive | None,
        Option("Standard deviation of a measured coordinate. Default: from what pairs leave over.", _FIT),
    ] = None
    within_mm: Annotated[
        Positive, Option("A direction is not determined where two standard deviations are more than this.", _FIT)
    ] = 0.1

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        given = [name for name in ("points", "execution", "pairs", "three_two_one") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f".{given[1]} is given beside {given[0]}; give one of them")
        measured = given and given[0] != "execution"
        for name in ("points_frame", "points_units"):
            if measured and getattr(self, name) is None:
                raise ValueError(f".{name} is missing; frame and unit of measured points are never guessed")
            if not measured and getattr(self, name) is not None:
                raise ValueError(f".{name} is given for an execution, which knows its own; leave it out")
        return self
