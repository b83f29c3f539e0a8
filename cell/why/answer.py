"""What `cell why` finds: open samples in groups of one reason, their patches, and the changes that would measure them.

Object frame, metres.
"""

from dataclasses import dataclass

import numpy as np

from cell.view.surface import Canvas, Surface
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools, Ints
from planner.why.reasons import Reason
from planner.why.what_if import WhatIf


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """A change, and the (S,) samples that it measures of those it was verified on."""

    change: WhatIf
    gained: Bools


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Connected samples of one group, and the change for them; None where none helps: only the largest are asked."""

    rows: Ints
    named: Named | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Samples that stay open for one reason.

    Attributes:
        reason: at which the closest candidate fails.
        what: in the way, or in collision with what; "" where the reason has none.
        rows: samples.
        patches: the same, connected over planning faces, the largest first.
        detail: what there is to add about the closest candidates ("76 to 84 deg from the normal, limit 75").
        named: changes that would measure it, the one to prefer first; verified on all rows.
    """

    reason: Reason
    what: str
    rows: Ints
    patches: tuple[Patch, ...]
    detail: str
    named: tuple[Named, ...] = ()

    @property
    def title(self) -> str:
        """The reason with what is in the way: "sensor shaded by part", "view in collision: housing with post"."""
        if not self.what:
            return self.reason.sentence
        joint = " by " if self.reason <= Reason.SENSOR_SHADED else ": "
        return f"{self.reason.sentence}{joint}{self.what}"


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """All that `cell why` found.

    Attributes:
        canvas: the reference, ready to be coloured.
        surface: its held-out samples, and what the plan measures of them.
        open_rows: (n,) the open samples.
        groups: largest area first.
        rest: the open samples that no reachable candidate measures.
        overall: changes that gain most of `rest`, verified on all of it.
        tried: (change, share of the area of `rest` that it gains, from representatives) of everything that was tried.
        part_name: for titles.
    """

    canvas: Canvas
    surface: Surface
    open_rows: Ints
    groups: tuple[Group, ...]
    rest: Ints
    overall: tuple[Named, ...]
    tried: tuple[tuple[WhatIf, float], ...]
    part_name: str

    @property
    def samples(self) -> SurfaceSamples:
        """Held-out samples of the reference."""
        return self.surface.samples

    @property
    def covered(self) -> Bools:
        """(S,) what the plan measures."""
        return np.asarray(self.surface.seen.any(axis=1))

    def share(self, rows: Ints) -> float:
        """Area of some samples over the area of all."""
        return float(self.samples.areas[rows].sum() / self.samples.areas.sum())
