"""Which batches may come next: one function a policy, all with one signature, in `POLICIES`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from cell.explore.options import ExploreOptions
from cell.runs.schema import BELIEVED, MEASURED, SurfaceName


@dataclass(frozen=True, slots=True)
class So:
    """How far an exploration is.

    Attributes:
        stages: executed.
        left: views that may still be taken; None: as many as it wants.
        limited: whether sigma or spacing is limited.
        on: the surface that the last stage was planned on.
    """

    stages: int
    left: int | None
    limited: bool = False
    on: SurfaceName = BELIEVED


@dataclass(frozen=True, slots=True)
class Batch:
    """What the next stage is asked for.

    Attributes:
        views: that measure the most, at most; None: as many as are worth it.
        whole: whether surface that was seen counts as well; otherwise only what is open does.
        rough: whether it is there to plan on, so that limits of sigma and spacing do not hold for it.
        per_second: whether the most per second of standing and moving is wanted; otherwise the most.
        on: the surface that is planned on.
        worth: how many times the least gain each view is asked for.
    """

    views: int | None
    whole: bool = False
    rough: bool = False
    per_second: bool = False
    on: SurfaceName = BELIEVED
    worth: float = 1.0


_FEW, _ROUGH = 1, 6
"""Views that are taken blindly: what follows view by view is better chosen; a rough model that all else rests on wants
more."""

_WORTH: Mapping[SurfaceName, float] = MappingProxyType({BELIEVED: 2.0, MEASURED: 0.6})
"""How many times the least gain a view is asked for on each surface once little is left: the believed one promises more
than comes late, the measured one less; no other plan takes what it leaves."""

_FINE = (3.0, 3.0, 1.5, 1.0)
"""How many times the least gain a view of each fine plan is asked for: what the first ones leave is better planned for
once they are executed."""

Policy = Callable[[ExploreOptions, So], Sequence[Batch]]
"""The batches of which the first is taken that is worth its views; none: the exploration ends."""


def stepwise(options: ExploreOptions, so: So) -> Sequence[Batch]:
    """A first view, then the few with the most expected gain per second, planned anew after each batch.

    The surface that the stage before was planned on comes first, the other one where that is worth no further view.
    """
    if so.stages == 0:
        return (Batch(_within(so, options.ring or _FEW)),)
    surfaces = (MEASURED, BELIEVED) if so.on == MEASURED else (BELIEVED, MEASURED)
    return tuple(Batch(_within(so, options.batch), per_second=True, on=on, worth=_WORTH[on]) for on in surfaces)


def two_stage(options: ExploreOptions, so: So) -> Sequence[Batch]:
    """A ring gives a rough model, a set cover on it the fine views, and a few more those for what stayed open.

    W. R. Scott, "Model-based view planning", Machine Vision and Applications 20 (2009), doi:10.1007/s00138-007-0110-2.
    The fine views measure all of the part anew where sigma or spacing is limited, as rough points need not keep limits.
    The last are planned on the measured surface.
    """
    if so.stages == 0:
        return (Batch(_within(so, options.ring or _ROUGH), rough=True),)
    if so.limited and so.stages == 1:
        return (Batch(so.left, whole=True),)
    last = Batch(so.left, on=MEASURED, worth=_WORTH[MEASURED])
    if so.on == MEASURED:  # a tube goes on where its wall was seen
        return (last,)
    worths = dict.fromkeys(_FINE[so.stages - 1 :])  # one that was worth no view is not asked again
    return (*(Batch(so.left, worth=worth) for worth in worths), last)


POLICIES: Mapping[str, Policy] = MappingProxyType({"stepwise": stepwise, "two-stage": two_stage})


def _within(so: So, wanted: int) -> int:
    return wanted if so.left is None else min(wanted, so.left)
