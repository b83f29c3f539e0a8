"""The scene's `[plan]` table: how to plan, what is wished beyond the fewest views, and which wishes go together."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from cell.scene.fields import NotNegative, Positive, Share, Table
from cell.scene.option import Option

_VIEWS, _WISHES = "Views", "Wishes beyond the fewest views (docs/coverage_requests.md)"
_Candidates = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)]
_PIN, _BAN = (
    Option(told, _WISHES, name, metavar="ID[,ID...]", form="candidates by their numbers", examples=("12,40",))
    for name, told in (("pin", "Candidates that the plan must take."), ("ban", "Candidates that it must not take."))
)
_OVERLAP = Option(
    "All scans hang together: views are joined where they share so much of what the smaller one measures, or such an "
    "area.",
    _WISHES,
    metavar="SHARE%|AREAmm2",
    form="a share of the smaller view or an area",
    examples=("20%", "500mm2"),
)
_POSE_SD = Option(
    "Standard deviations of executed poses: samples count only where the plan measures them with probability "
    "1 - alpha.",
    _WISHES,
    metavar="MMmm,DEGdeg",
    form="standard deviations of position and orientation with their units",
    examples=("0.5mm,0.1deg",),
)


class PlanKeys(Table):
    """The keys of the table; None takes the part's default."""

    candidates: Annotated[
        Literal["grown", "optimal-scanning-zone", "view-sphere"],
        Option("Which viewpoints are looked at: one per face and others where these fail; or the paper's.", _VIEWS),
    ] = "grown"
    view_sphere_step_deg: Annotated[
        tuple[Annotated[float, Field(gt=0, le=180)], Annotated[float, Field(gt=0, le=180)]], Field(strict=False)
    ] = (15.0, 15.0)
    standoffs_mm: Annotated[
        Annotated[tuple[Positive, ...], Field(strict=False, min_length=1)] | None,
        Option("Distances from surface to laser source. Default: the middle of the range.", _VIEWS, name="standoff"),
    ] = None
    rolls_deg: Annotated[
        tuple[float, ...],
        Field(strict=False, min_length=1),
        Option("Rolls about the viewing axis.", _VIEWS, name="roll"),
    ] = (0.0, 90.0)
    faces: Annotated[
        int | None,
        Field(ge=4),
        Option("Faces of the planning mesh (one candidate normal each). Default: the part's.", _VIEWS),
    ] = None
    percent_kept: Annotated[
        float | None,
        Field(gt=0, le=100),
        Option("In place of --faces: percentage of the faces that is KEPT.", _VIEWS, "percent", metavar="PERCENT"),
    ] = None
    samples_per_face: Annotated[
        int, Field(ge=1), Option("Surface samples per planning face (fill aimed).", _VIEWS, name="samples")
    ] = 4
    fill: Annotated[Literal["aimed", "rays"], Option("How the measurability matrix is filled.", _VIEWS)] = "aimed"
    solver: Annotated[
        Literal["auto", "greedy", "meta-raps", "local-search", "exact"],
        Option("How the views are chosen; auto proves the fewest where it can.", _VIEWS),
    ] = "auto"
    coverage: Annotated[
        Share, Option("Share of the coverable area that the plan must measure.", _VIEWS, metavar="SHARE")
    ] = 0.99
    required_visible: Annotated[
        float,
        Field(ge=0, le=1),
        Option(
            "Exit with code 3 when the predicted visible coverage of the WHOLE surface is below this share.",
            _VIEWS,
            name="require",
            also="require_total",
            metavar="SHARE",
        ),
    ] = 0.0
    max_sigma_mm: Annotated[
        Positive | None,
        Option("Count a point as measured only if its expected standard deviation is at most this.", _VIEWS),
    ] = None
    collision: Annotated[
        Literal["hull", "exact"],
        Option("What part and mesh fixtures are to arm and scanner: their hulls, or exactly their triangles.", _VIEWS),
    ] = "exact"
    seed: Annotated[int, Field(ge=0, le=2**63 - 1), Option("Seed of every random choice.", _VIEWS)] = 0
    max_views: Annotated[
        int | None, Field(ge=1), Option("The most coverage that at most so many views give.", _WISHES)
    ] = None
    multiplicity: Annotated[
        int, Field(ge=1), Option("Measure each sample from so many views.", _WISHES, also="k_fold")
    ] = 1
    pinned: Annotated[_Candidates, _PIN] = ()
    banned: Annotated[_Candidates, _BAN] = ()
    cost: Annotated[
        Literal["views", "time"],
        Option("What a view costs: 1, or time (scan, settling and an estimated move, in seconds).", _WISHES),
    ] = "views"
    scan_s: NotNegative = 2.0
    settle_s: NotNegative = 0.5
    overlap_mm2: Annotated[Positive | None, _OVERLAP] = None
    overlap_share: Annotated[Share | None, _OVERLAP] = None
    overlap_in_order: Annotated[bool, Option("Each view overlaps an earlier one.", _WISHES)] = False
    pose_sd_mm: Annotated[NotNegative, _POSE_SD] = 0.0
    pose_sd_deg: Annotated[NotNegative, _POSE_SD] = 0.0
    alpha: Annotated[
        float,
        Field(gt=0, lt=1),
        Option("Probability with which such a sample may be missed.", _WISHES, metavar="SHARE"),
    ] = 0.05
    ensemble: Annotated[int, Field(ge=1, le=10_000)] = 32
    curve: Annotated[bool, Option("Also coverage over the number of views, bounded.", _WISHES)] = False


_OF_THE_CHOICE = ("max_views", "multiplicity", "cost", "overlap_mm2", "overlap_share", "overlap_in_order", "pose_sd_mm",
                  "pose_sd_deg", "curve", "solver")  # fmt: skip
"""Wishes that the choice of views answers."""


_OF_THE_ORDER = ("overlap_mm2", "overlap_share", "overlap_in_order")


class PlanSettings(PlanKeys):
    """How to plan: the keys, and that they go together."""

    def plain(self) -> Self:
        """Without the wishes that the choice of views answers: it is made elsewhere."""
        return self.model_copy(update={key: PlanKeys.model_fields[key].default for key in _OF_THE_CHOICE})

    def of_views(self, views: Sequence[int], candidates: int) -> Self:
        """What a plan of these views is asked, and of no others of so many candidates."""
        others = tuple(sorted(set(range(candidates)).difference(views)))
        return self.plain().model_copy(update={"coverage": 1.0, "pinned": tuple(views), "banned": others})

    def ordered_as(self, other: Self) -> Self:
        """With the overlap of other settings where the order of visits is to keep it."""
        if not other.overlap_in_order:
            return self
        return self.model_copy(update={key: getattr(other, key) for key in _OF_THE_ORDER})

    @field_validator("percent_kept")
    @classmethod
    def _one_size(cls, percent: float | None, info: ValidationInfo) -> float | None:
        if percent is not None and info.data.get("faces") is not None:
            raise ValueError("and plan.faces both set the size of the planning mesh; give one of them")
        return percent

    @model_validator(mode="after")
    def _one_question(self) -> Self:
        if problem := _contradiction(self):
            raise ValueError(f".{problem}")
        return self


def _contradiction(plan: PlanSettings) -> str:
    """The first contradiction among the wishes as what a key is ("and plan.x ..."), with the key first; "" for none."""
    overlap = "overlap_mm2" if plan.overlap_mm2 is not None else "overlap_share"
    overlaps = plan.overlap_mm2 is not None or plan.overlap_share is not None
    errs = plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0
    if plan.overlap_mm2 is not None and plan.overlap_share is not None:
        return "overlap_mm2 and plan.overlap_share both say what an overlap is; give one of them"
    if both := sorted(set(plan.pinned) & set(plan.banned)):
        return f"pinned and plan.banned both name candidate {both[0]}; take it out of one of them"
    special = {
        "max_views": plan.max_views is not None,
        "multiplicity": plan.multiplicity > 1,
        overlap: overlaps,
        "pose_sd_mm" if plan.pose_sd_mm > 0 else "pose_sd_deg": errs,
        "cost": plan.cost == "time",
    }
    asked = [key for key, is_asked in special.items() if is_asked]
    if len(asked) > 1 and asked != ["multiplicity", "cost"]:
        return f"{asked[0]} and plan.{asked[1]} are different questions to the selection; ask one of them"
    if plan.max_views is not None and plan.coverage < 1 and "coverage" in plan.model_fields_set:
        return "max_views and plan.coverage both set how long the plan is; give one of them"
    if plan.max_views is not None and len(plan.pinned) > plan.max_views:
        return f"max_views is {plan.max_views} and {len(plan.pinned)} views are pinned; allow more or pin fewer"
    if asked and asked[0] not in ("multiplicity", "cost") and plan.solver != "auto":
        return f"solver is '{plan.solver}', and plan.{asked[0]} has a search of its own; leave the solver 'auto'"
    if plan.overlap_in_order and not overlaps:
        return "overlap_in_order needs an overlap; give plan.overlap_mm2 or plan.overlap_share"
    if errs and plan.fill == "rays":
        return "pose_sd_mm and pose_sd_deg need aimed samples; choose plan.fill = 'aimed'"
    return ""
