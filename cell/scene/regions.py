"""The scene's `[[region]]` tables: parts of the surface by CAD face, kind, box or colour, and what is asked of each.

A face of the part belongs to the first region that selects it. A region that selects by nothing is the rest.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

from pydantic import Field, ValidationInfo, field_validator, model_validator

from cell.errors import SceneError
from cell.scene.fields import NotNegative, Positive, Share, Table, Units
from cell.scene.plan_settings import PlanSettings

if TYPE_CHECKING:
    from planner.ports import Scanner, SigmaScanner

REST = "the rest"
"""Name of what no region selects."""

_SELECTORS = ("faces", "kind", "diameter_below_mm", "diameter_above_mm", "box_mm", "colour", "painted")
_WISHES = ("coverage", "max_sigma_mm", "max_spacing_mm", "views", "weight")


class RegionWishes(Table):
    """What is asked of a region; None takes what the plan asks."""

    name: Annotated[str, Field(min_length=1, max_length=60, description="of its own")]
    care: Annotated[Literal["yes", "no"], Field(description="no: it only stands in the way")] = "yes"
    coverage: Annotated[
        Share | None, Field(description="share of what is coverable of it; without one it counts with the others")
    ] = None
    max_sigma_mm: Annotated[Positive | None, Field(description="standard deviation of a point at most")] = None
    max_spacing_mm: Annotated[Positive | None, Field(description="distance of neighbouring points at most")] = None
    views: Annotated[int | None, Field(ge=1, description="views that each of its samples is measured from")] = None
    weight: Annotated[Positive, Field(description="of its area beside the others'")] = 1.0

    @property
    def cared(self) -> bool:
        """Whether it counts at all."""
        return self.care == "yes"


class Region(RegionWishes):
    """A region as the scene file describes it; what it selects by must all hold."""

    faces: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(strict=False, min_length=1)] | None = None
    kind: Literal["plane", "cylinder", "cone", "sphere", "torus", "other"] | None = None
    diameter_below_mm: Positive | None = None
    diameter_above_mm: NotNegative | None = None
    box_mm: Annotated[tuple[float, float, float, float, float, float], Field(strict=False)] | None = None
    colour: Annotated[str, Field(pattern=r"^#[0-9A-Fa-f]{6}$")] | None = None
    painted: str | None = None
    painted_units: Units | None = None

    @property
    def selects(self) -> bool:
        """Whether it selects by anything; otherwise it is the rest."""
        return any(getattr(self, key) is not None for key in _SELECTORS)

    @field_validator("name")
    @classmethod
    def _one_line(cls, name: str) -> str:
        if not name.isprintable() or "|" in name or name != name.strip():
            raise ValueError(
                f"is {name!r}; it stands in tables: one line without '|', and no blank at its beginning or end"
            )
        return name

    @field_validator("box_mm")
    @classmethod
    def _low_and_high(cls, box: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if box is not None and not all(low < high for low, high in zip(box[:3], box[3:], strict=True)):
            raise ValueError(f"is {list(box)}; it must be x, y, z of its lowest and then of its highest corner")
        return box

    @field_validator("painted")
    @classmethod
    def _found(cls, painted: str | None, info: ValidationInfo) -> str | None:
        if painted is None:
            return None
        path = Path((info.context or {}).get("folder", Path.cwd())) / Path(painted).expanduser()
        if not path.is_file():
            raise ValueError(f"is '{painted}', and there is no file {path}; give a coloured mesh")
        return str(path)

    @model_validator(mode="after")
    def _possible(self) -> "Region":
        asked = [key for key in _WISHES if key in self.model_fields_set and getattr(self, key) is not None]
        if not self.cared and asked:
            raise ValueError(f".care is 'no', and region.{asked[0]} asks for something; give one of them")
        if self.painted is not None and self.colour is None:
            raise ValueError(".painted needs region.colour, the colour that marks the region in it, as '#rrggbb'")
        if self.painted is not None and self.painted_units is None:
            from cell.part.formats import units_of

            if units_of(self.painted) is None:
                raise ValueError(".painted needs region.painted_units: mm, cm, m, um or in")
        below, above = self.diameter_below_mm, self.diameter_above_mm
        if below is not None and above is not None and not above < below:
            raise ValueError(f".diameter_above_mm is {above:g}, which is not below region.diameter_below_mm, {below:g}")
        return self


def contradiction(regions: Sequence[Region]) -> str:
    """What is wrong with regions together, as what the key `region` is; "" for nothing."""
    names = [region.name for region in regions]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        return f"holds the name '{twice}' more than once; every region needs its own"
    for region in regions[:-1]:
        if not region.selects:
            return f"holds '{region.name}', which selects by nothing and so takes all the rest; put it last"
    if regions and REST in names and regions[-1].selects:
        return f"holds the name '{REST}', which is that of what no region selects; choose another"
    if regions and not any(region.cared for region in regions) and not regions[-1].selects:
        return 'cares for nothing; leave out care = "no" where something has to be measured'
    return ""


def beside_plan(regions: Sequence[Region], plan: PlanSettings) -> str:
    """What regions ask that does not go with the plan's wishes, as what the key `region` is; "" for nothing."""
    if plan.fill == "rays":
        return "needs aimed samples; choose plan.fill = 'aimed'"
    special = {
        "max_views": plan.max_views is not None,
        "overlap": plan.overlap_mm2 is not None or plan.overlap_share is not None,
        "pose_sd": plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0,
    }
    asked = next((key for key, is_asked in special.items() if is_asked), "")
    for region in regions:
        for key in ("coverage", "views", "weight"):
            if asked and key in region.model_fields_set and (asked, key) != ("max_views", "weight"):
                return f"'{region.name}' asks for {key}, and plan.{asked} is another question; ask one of them"
    return ""


def require_no_wishes(regions: Sequence[Region]) -> None:
    """Refuse regions that ask for more than to be cared for, or not: studies know no more.

    Raises:
        SceneError: with the region and the key.
    """
    for region in regions:
        for key in _WISHES:
            if key in region.model_fields_set:
                raise SceneError(
                    f"the region '{region.name}' asks for {key}, and studies know of regions only what they care for; "
                    "leave it out"
                )


def complete(regions: Sequence[Region]) -> tuple[Region, ...]:
    """The regions with the rest, where none of them is that; none where the scene has none."""
    rest = () if not regions or not regions[-1].selects else (Region(name=REST),)
    return (*regions, *rest)


def limited(scanner: "Scanner", max_sigma_mm: float | None, regions: Sequence[RegionWishes]) -> "Scanner":
    """The scanner's law with the limits that a plan sets: its own on sigma, and those of its regions by their numbers.

    Raises:
        SceneError: if the scanner does not know what is limited.
    """
    from planner.measurability.quality import Limited, Limits

    inf = float("inf")
    own = tuple(Limits((each.max_sigma_mm or inf) / 1000, (each.max_spacing_mm or inf) / 1000) for each in regions)
    if all(each == Limits() for each in own):
        own = ()
    if max_sigma_mm is None and not own:
        return scanner
    for region in regions:
        for key, what in (("max_spacing_mm", "spacing"), ("max_sigma_mm", "sigma")):
            if getattr(region, key) is not None and not callable(getattr(scanner, what, None)):
                raise SceneError(
                    f"the region '{region.name}' has {key}, but the scanner {type(scanner).__name__} does not know its "
                    f"{what}; leave the limit out, or choose another scanner"
                )
    return Limited(cast("SigmaScanner", scanner), (max_sigma_mm or inf) / 1000, own)
