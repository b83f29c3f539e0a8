"""Which batch comes next: one function a policy, all with one signature, in `POLICIES`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from cell.explore.options import ExploreOptions


@dataclass(frozen=True, slots=True)
class So:
    """How far an exploration is.

    Attributes:
        stages: executed.
        left: views that may still be taken; None: as many as it wants.
        limited: whether sigma or spacing is limited.
    """

    stages: int
    left: int | None
    limited: bool = False


@dataclass(frozen=True, slots=True)
class Batch:
    """What the next stage is asked for.

    Attributes:
        views: that measure the most, at most; None: as many as are worth it.
        whole: whether surface that was seen counts as well; otherwise only what is open does.
        rough: whether it is there to plan on, so that limits of sigma and spacing do not hold for it.
        per_second: whether the most per second of standing and moving is wanted; otherwise the most.
        measured: whether the surface of all points is planned on where the believed one is worth no further view.
    """

    views: int | None
    whole: bool = False
    rough: bool = False
    per_second: bool = False
    measured: bool = False


_FEW, _ROUGH = 1, 6
"""Views that are taken blindly: what follows view by view is better chosen; a rough model that all else rests on wants
more."""

Policy = Callable[[ExploreOptions, So], Batch | None]


def stepwise(options: ExploreOptions, so: So) -> Batch | None:
    """A first view, then the few with the most expected gain per second, planned anew after each batch."""
    if so.stages == 0:
        return Batch(_within(so, options.ring or _FEW))
    return Batch(_within(so, options.batch), per_second=True, measured=True)


def two_stage(options: ExploreOptions, so: So) -> Batch | None:
    """A ring gives a rough model, one set cover on it the fine views, and one more those for what stayed open.

    W. R. Scott, "Model-based view planning", Machine Vision and Applications 20 (2009), doi:10.1007/s00138-007-0110-2.
    The fine views measure all of the part anew where sigma or spacing is limited, as rough points need not keep limits.
    """
    if so.stages == 0:
        return Batch(_within(so, options.ring or _ROUGH), rough=True)
    return Batch(so.left, whole=so.limited and so.stages == 1) if so.stages <= 2 else None


POLICIES: Mapping[str, Policy] = MappingProxyType({"stepwise": stepwise, "two-stage": two_stage})


def _within(so: So, wanted: int) -> int:
    return wanted if so.left is None else min(wanted, so.left)
