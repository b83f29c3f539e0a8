"""why.json: what a plan leaves open, why, and which single changes would measure it. Fractions are of area."""

from pydantic import Field

from cell.run.json_table import JsonTable, Triple, optional


class Change(JsonTable):
    """A single change of cell, scanner or plan."""

    kind: str = Field(description="what is changed")
    change: str = Field(description="in words")
    setting: str = Field(description='option or key that makes it; "" where it is none')


class TriedChange(Change):
    """A change that was tried."""

    gains_estimated: float = Field(description="share of what no candidate measures, from representatives")


class NamedChange(Change):
    """A change that is named; every sample that it is named for was asked."""

    gains: float = Field(description="share of what it is named for")
    gains_mm2: float = Field(description="the area of that")


class OpenPatch(JsonTable):
    """Connected samples of one group."""

    area_mm2: float = Field(description="that they stand for")
    centre_mm: Triple = Field(description="the sample nearest to the middle of all, object frame")
    change: NamedChange | None = optional()


class OpenSamples(JsonTable):
    """Samples that stay open for one reason."""

    group: int = Field(description="number in why.ply, from 1")
    reason: str = Field(description="at which the closest candidate fails")
    code: int = Field(description="of the reason in why.ply")
    what: str = Field(description='in the way, or in collision with what; "" where the reason has none')
    title: str = Field(description="reason and what, in words")
    detail: str = Field(description="what there is to add about the closest candidates")
    share: float = Field(description="of the surface")
    area_mm2: float = Field(description="that they stand for")
    n_patches: int = Field(description="connected pieces, of which `patches` has the largest")
    changes: tuple[NamedChange, ...] = Field(description="the one to prefer first")
    patches: tuple[OpenPatch, ...] = Field(description="the largest first")


class WhyReport(JsonTable):
    """The file."""

    units: str = "share, visible, open and gains are fractions of area; mm and mm2, object frame"
    part: str = Field(description="name of the part")
    plan: str = Field(description="sha256 of plan.json")
    samples: int = Field(description="held-out samples")
    area_mm2: float = Field(description="of the surface")
    visible: float = Field(description="what the plan measures")
    open: float = Field(description="what it does not")
    groups: tuple[OpenSamples, ...] = Field(description="largest area first")
    not_measurable: float = Field(description="what no reachable candidate measures")
    overall: tuple[NamedChange, ...] = Field(description="changes that gain most of that")
    tried: tuple[TriedChange, ...] = Field(description="all that was tried")
