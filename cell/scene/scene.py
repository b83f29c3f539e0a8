"""The scene file: what stands in the cell, what the scanner is and how to plan; TOML in, one frozen `Scene` out.

Every key carries its unit (`_mm`, `_deg`); poses are x, y, z and KUKA's A, B, C. A key whose value is None takes the
scanner's default (range, baseline, housing: `cell.scene.devices`), the part's (planning faces) or follows from another
key (the standoff from the range, the housing's place from the baseline). `models/scene.toml` is the built-in scene with
every key explained; `Scene()` equals it.
"""

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, ModelWrapValidatorHandler, ValidationInfo, field_validator, model_validator

from cell.errors import SceneError
from cell.part.formats import units_of, wrong_units
from cell.scene.fields import Fov, Grazing, NotNegative, Positive, Table, Triple, Units, existing_file
from cell.scene.fixtures import Fixture, NamedFixture, Post, Setup
from cell.scene.option import Option
from cell.scene.plan_settings import PlanSettings
from cell.scene.posed import PART, Mount, Placement, pose
from cell.scene.regions import Region, beside_plan, contradiction
from cell.scene.robot import HARDWARE, Robot
from cell.scene.turntable import Turntable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_SHOWN = ("robot", "scanner", "post", "pedestal", "floor")

_REPORT = "Output"


class Scanner(Table):
    """The scanner's law; the keys are those of the plug-in that `type` names, a foreign one's own keys among them."""

    model_config = ConfigDict(extra="allow")  # `_keys_of_its_type` refuses what the plug-in does not know

    type: str = "laser-area"
    sensor: Annotated[
        str | None, Option("A scanner by name, see cell sensors. Default: the part's device.", HARDWARE)
    ] = None
    fov_deg: Annotated[tuple[Fov, Fov], Field(strict=False)] = (60.0, 60.0)
    resolution_deg: Annotated[tuple[Positive, Positive], Field(strict=False)] = (0.25, 0.25)
    planning_resolution_deg: Positive = 1.0
    range_mm: Annotated[tuple[NotNegative, Positive], Field(strict=False)] | None = None
    baseline_mm: Annotated[
        NotNegative | None, Option("From laser source to sensor. Default: the scanner's.", HARDWARE)
    ] = None
    grazing_max_deg: Grazing = 75.0
    sensor_grazing_max_deg: Grazing = 75.0
    sensor_fov_deg: Annotated[tuple[Fov, Fov], Field(strict=False)] | None = None
    sensor_tilt_deg: Annotated[float, Field(gt=-90, lt=90)] | None = None
    depth_of_field_mm: Annotated[tuple[NotNegative, Positive], Field(strict=False)] | None = None
    sigma_angle_mdeg: NotNegative = 1.5
    fan_deg: Fov = 28.0
    sweep_mm: Positive | None = None
    sweep_deg: Fov | None = None
    sweep_steps: Annotated[int, Field(ge=1)] = 8
    line_points: Annotated[int, Field(ge=1)] = 640
    profile_rate_hz: Positive | None = None
    max_spacing_mm: Annotated[
        Positive | None,
        Option("Count a point as measured only if its neighbours in the scan lie at most so far away.", HARDWARE),
    ] = None

    @model_validator(mode="wrap")
    @classmethod
    def _keys_of_its_type(cls, table: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        from cell.scene.scanner_table import validated

        return validated(table, handler, cls.model_fields["type"].default)

    @field_validator("type")
    @classmethod
    def _installed(cls, name: str) -> str:
        from cell import scanners
        from cell.scene.problems import did_you_mean

        known = scanners.names()
        if name not in known:
            raise ValueError(f"is '{name}'; {did_you_mean(name, known)}installed are: {', '.join(known) or 'none'}")
        return name

    @field_validator("range_mm", "depth_of_field_mm")
    @classmethod
    def _ordered(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        if limits is not None and not limits[0] < limits[1]:
            raise ValueError(f"is {list(limits)}; it must be [min, max] with min < max")
        return limits

    @property
    def opening_deg(self) -> tuple[float, float]:
        """Angles across and along a line [deg], for outlines and pictures: the field of view, or the thin fan."""
        from cell import scanners

        known = scanners.keys(self.type) or ()
        return (0.5, self.fan_deg) if "fan_deg" in known and "fov_deg" not in known else self.fov_deg


class Housing(Table):
    """The scanner's body, a box, and the bracket between it and the flange.

    With `position_mm` None the box is centred over the baseline (x) and the viewing axis (y), and its front face lies
    in the plane of the source, so that no ray starts inside it.
    """

    size_mm: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)] | None = None
    position_mm: Triple | None = None
    abc_deg: Triple = (0.0, 0.0, 0.0)
    bracket_diameter_mm: NotNegative | None = None

    @property
    def sides_mm(self) -> Triple:
        """Its size in a settled scene (`cell.scene.devices`)."""
        assert self.size_mm is not None, "the scene is not settled"
        return self.size_mm

    @property
    def bracket_mm(self) -> float:
        """The bracket's diameter in a settled scene."""
        assert self.bracket_diameter_mm is not None, "the scene is not settled"
        return self.bracket_diameter_mm

    def T_scanner_housing(self, baseline_mm: float) -> "NDArray[np.float64]":
        """(4, 4) the middle of the box in the scanner frame [m]."""
        return pose(self.position_mm or (baseline_mm / 2, 0.0, -self.sides_mm[2] / 2), self.abc_deg)


class Part(Table):
    """The part: a built-in one by `name`, or a file and its units, where the file does not say them itself."""

    name: Literal["mseke", "mug", "robinet", "petanque", "humerus", "st-jean"] = "mseke"
    path: str | None = None
    units: Annotated[
        Units | None,
        Field(validate_default=True),
        Option("Unit of the mesh file. Never guessed.", PART),
    ] = None

    @field_validator("path")
    @classmethod
    def _found(cls, path: str | None, info: ValidationInfo) -> str | None:
        return None if path is None else existing_file(path, info)

    @field_validator("units")
    @classmethod
    def _given_for_a_file(cls, units: str | None, info: ValidationInfo) -> str | None:
        path = info.data.get("path", "given, but wrong")
        if path is not None and (why := wrong_units(path, units)):
            raise ValueError(f"is given for {path}, which {why}")
        if path is not None and units is None:
            if (own := units_of(path)) is not None:
                return own
            raise ValueError("is missing; say what the file's numbers are in: mm, cm, m, um or in")
        if path is None and units is not None:
            raise ValueError("is given for a built-in part, which has its own size; leave it out, or give part.path")
        return units

    @property
    def source(self) -> str:
        """What to load: the file's path, or the built-in part's name."""
        return self.path if self.path is not None else self.name


class Picture(Table):
    """How the report shows the cell (cell.png); nothing that is planned depends on it."""

    camera_deg: Annotated[
        tuple[float, float] | None,
        Field(strict=False),
        Option(
            "Camera of the report's picture of the cell: azimuth and elevation as seen from the part, deg. Default: "
            "beside part and arm.", _REPORT, metavar="AZ,EL", form="azimuth,elevation (deg)",
            examples=("-60,20",), counts=(2,),
        ),
    ] = None  # fmt: skip
    hide: Annotated[
        tuple[str, ...],
        Field(strict=False),
        Option(
            "What that picture leaves out: fixtures, robot, scanner, post, pedestal or floor.", _REPORT,
            metavar="NAME[,NAME...]", made=lambda texts: [each for text in texts for each in text.split(",")],
        ),
    ] = ()  # fmt: skip


class Scene(Table):
    """A whole scene; `Scene()` is the built-in one."""

    clearance_mm: NotNegative = 10.0
    arrival_mm: Positive | None = None
    robot: Robot = Field(default_factory=Robot)
    scanner: Scanner = Field(default_factory=Scanner)
    mount: Mount = Field(default_factory=Mount)
    housing: Housing = Field(default_factory=Housing)
    part: Part = Field(default_factory=Part)
    placement: Placement = Field(default_factory=Placement)
    post: Post = Field(default_factory=Post)
    table: Turntable = Field(default_factory=Turntable)
    fixtures: Annotated[tuple[Fixture, ...], Field(strict=False)] = ()
    plan: PlanSettings = Field(default_factory=PlanSettings)
    region: Annotated[tuple[Region, ...], Field(strict=False)] = ()
    setup: Annotated[tuple[Setup, ...], Field(strict=False)] = ()
    picture: Picture = Field(default_factory=Picture)

    def require_fixed_part(self, what: str) -> None:
        """Refuse a rotary table where it is not known yet.

        Raises:
            SceneError: naming what does not know it.
        """
        if self.table.enabled:
            raise SceneError(f"{what} cannot have a rotary table yet; leave --table and [table] out")

    @field_validator("fixtures")
    @classmethod
    def _distinct(cls, fixtures: tuple[NamedFixture, ...]) -> tuple[NamedFixture, ...]:
        names = [fixture.name for fixture in fixtures]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"hold the name '{twice[0]}' more than once; every fixture needs its own name")
        return fixtures

    @field_validator("region")
    @classmethod
    def _go_together(cls, regions: tuple[Region, ...], info: ValidationInfo) -> tuple[Region, ...]:
        plan = info.data.get("plan")
        if problem := contradiction(regions) or (plan and regions and beside_plan(regions, plan)):
            raise ValueError(problem)
        return regions

    @field_validator("setup")
    @classmethod
    def _differ(cls, setups: tuple[Setup, ...], info: ValidationInfo) -> tuple[Setup, ...]:
        shared = [fixture.name for fixture in info.data.get("fixtures", ())]
        for number, setup in enumerate(setups):
            names = [*shared, *(fixture.name for fixture in setup.fixtures)]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"'{setup.name}' has the fixture '{twice[0]}' more than once; each needs its own name")
            for other in setups[:number]:
                if other.name == setup.name:
                    raise ValueError(f" has the name '{setup.name}' more than once; each set-up needs its own")
                if other.model_copy(update={"name": setup.name}) == setup:
                    raise ValueError(f"s '{other.name}' and '{setup.name}' are equal; leave one of them out")
        return setups

    @field_validator("picture")
    @classmethod
    def _hides_what_is_there(cls, picture: Picture, info: ValidationInfo) -> Picture:
        known = [*_SHOWN, *(fixture.name for fixture in info.data.get("fixtures", ()))]
        for name in picture.hide:
            if name not in known:
                raise ValueError(f".hide names '{name}', which is nothing of this cell; it has: {', '.join(known)}")
        return picture
