"""Tables `[[feature]]` and `[inspection]` of the scene: features of the part, and settings of their inspection."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from cell.scene.fields import NotNegative, Positive, Share, Table, Triple, existing_file
from cell.scene.options import Option

FeatureKind = Literal["plane", "cylinder", "cone", "sphere", "circle", "width", "surface"]
Kind = Literal[
    "size", "form", "roundness", "position", "parallelism", "perpendicularity", "angularity", "profile", "distance",
    "angle", "coaxiality", "runout", "total-runout", "straightness",
]  # fmt: skip
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[^|\r\n]*$")]

LIMITED = ("size", "distance", "angle")
"""Kinds with limits on either side of a nominal value; the others have one tolerance, the width of a zone."""


_RELATED = ("parallelism", "perpendicularity", "angularity", "coaxiality", "runout", "total-runout")
"""Kinds that refer to a datum."""


class CharacteristicTable(Table):
    """A characteristic of a feature with its tolerance.

    Size, distance and angle have a nominal value (None: that of the part) with a lower and an upper deviation, in mm or
    in deg for an angle; the other kinds have the width of a zone. Without a tolerance the value is only measured.
    """

    kind: Kind
    name: Name | None = None
    tolerance_mm: Positive | None = None
    nominal: float | None = None
    lower: float | None = None
    upper: float | None = None
    datums: Annotated[tuple[Name, ...], Field(strict=False, max_length=3)] = ()
    to: Name | None = None
    criterion: Literal["least-squares", "circumscribed", "inscribed"] = "least-squares"
    zone: Literal["planar", "cylindrical"] | None = None
    source_id: str | None = None
    note: str = ""

    @model_validator(mode="after")
    def _consistent(self) -> "CharacteristicTable":
        limits = self.lower is not None or self.upper is not None
        if self.kind in LIMITED and self.tolerance_mm is not None:
            raise ValueError(f".tolerance_mm is a zone, and a {self.kind} has limits; give lower and upper")
        if self.kind not in LIMITED and (limits or self.nominal is not None):
            raise ValueError(f".lower, upper and nominal are not keys of kind '{self.kind}'; give tolerance_mm")
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise ValueError(f".lower is {self.lower:g}; it must be below upper, {self.upper:g}")
        if not self.datums and self.kind in _RELATED:
            raise ValueError(f".datums is missing; {self.kind} refers to a datum")
        if self.kind == "distance" and self.to is None:
            raise ValueError(".to is missing; a distance needs the name of another feature")
        return self


class FeatureTable(Table):
    """A `[[feature]]` of the scene file: CAD faces that form a geometric element, and its characteristics."""

    name: Name
    faces: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(strict=False, min_length=1)]
    kind: FeatureKind | None = None
    datum: Annotated[str, Field(pattern=r"^[A-Z]{1,2}$")] | None = None
    characteristic: Annotated[tuple[CharacteristicTable, ...], Field(strict=False)] = ()


class RpsTable(Table):
    """A point of a reference point system: the part is held there along a direction."""

    point_mm: Triple
    direction: Triple
    weight: Positive = 1.0


class Inspection(Table):
    """`[inspection]`: source of characteristics, alignment, and the required uncertainty."""

    qif: Annotated[
        str | None, Option("QIF 3 file with features and tolerances of the part.", "Inspection", metavar="FILE")
    ] = None
    u_over_t: Annotated[
        Positive | None,
        Option("Largest expanded uncertainty of a characteristic as a share of its tolerance.", "Inspection"),
    ] = 0.1
    share: Share | None = None
    alignment: Literal["best-fit", "rps", "none"] = "best-fit"
    rps: Annotated[tuple[RpsTable, ...], Field(strict=False)] = ()
    edge_mm: NotNegative = 1.0
    reach_mm: Positive = 2.0

    @field_validator("qif")
    @classmethod
    def _found(cls, path: str | None, info: ValidationInfo) -> str | None:
        return None if path is None else existing_file(path, info, "a QIF file")

    @model_validator(mode="after")
    def _has_points(self) -> "Inspection":
        if self.alignment == "rps" and len(self.rps) < 6:
            raise ValueError(f".rps has {len(self.rps)} points; a reference point system needs at least 6")
        return self


def feature_contradiction(features: tuple[FeatureTable, ...]) -> str:
    """Return the first contradiction between features, as a predicate of the key `feature`; "" without one."""
    names = [feature.name for feature in features]
    letters = [feature.datum for feature in features if feature.datum]
    for what, values in (("name", names), ("datum", letters)):
        if twice := next((value for value in values if values.count(value) > 1), ""):
            return f"holds the {what} '{twice}' more than once; every feature needs its own"
    for feature in features:
        for each in feature.characteristic:
            if missing := [letter for datum in each.datums for letter in datum.split("-") if letter not in letters]:
                known = ", ".join(letters) or "none"
                return f"'{feature.name}' refers to the datum {missing[0]}, which no feature has; datums: {known}"
            if each.to is not None and each.to not in names:
                return f"'{feature.name}' has a {each.kind} to '{each.to}', which is no feature"
    return ""
