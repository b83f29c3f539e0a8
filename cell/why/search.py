"""Which change would measure what stays open: tried on representatives, named, and verified on every sample.

Representatives are spread over each group; a change that is named for a group, for a patch or for all together is then
asked about every sample that it is named for, so that no printed share is an estimate. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell.why.answer import Group, Named
from cell.why.changes import Changes, ladder_masks
from planner.geometry.sampling import SurfaceSamples
from planner.ports import Progress
from planner.values import Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.why import what_if
from planner.why.reasons import Reason
from planner.why.what_if import Kind, WhatIf

_REPRESENTATIVES = 700
_FEWEST = 8  # representatives of a group
_VIEWS_FROM = 160  # samples that further views are chosen by
_AIMS = 64  # points at which new candidates are aimed
_PATCHES = 24  # patches that get a change of their own
_NAMED = 3  # changes that are named for a group


class Findings(NamedTuple):
    """What was found.

    Attributes:
        groups: the open ones with the changes that are named for them and for their patches.
        rest: samples that no reachable candidate measures.
        overall: changes that gain most of `rest`.
        tried: (change, share of the area of `rest` that it gains, from representatives) of all that was tried.
    """

    groups: tuple[Group, ...]
    rest: Ints
    overall: tuple[Named, ...]
    tried: tuple[tuple[WhatIf, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Every change with the representatives that it measures: gains (W, r) bool, place (S,) column or -1."""

    changes: tuple[WhatIf, ...]
    gains: NDArray[np.bool_]
    place: Ints

    def best(self, rows: Ints, reason: Reason, most: int) -> list[int]:
        """Changes for some samples. A view that was only not selected needs no change but being selected."""
        own = self.place[rows]
        own = own[own >= 0]
        if not len(own):
            return []
        apt = [(change.kind is Kind.VIEW) == (reason is Reason.NOT_SELECTED) for change in self.changes]
        return self.choose(self.gains[:, own].mean(axis=1) * apt, most)

    def choose(self, share: Floats, most: int) -> list[int]:
        kinds, sizes = [change.kind for change in self.changes], [change.change for change in self.changes]
        return what_if.choose(share, kinds, sizes, most=most)


def search(
    changes: Changes,
    targets: RayTargets,
    samples: SurfaceSamples,
    groups: Sequence[Group],
    progress: Progress,
) -> Findings:
    """Try every change and name the best."""
    if not groups:
        return Findings((), np.empty(0, dtype=np.int64), (), ())
    trial = _try(changes, targets, samples, groups, progress)
    # What a reachable candidate measures already is no gain of another change.
    closed = [group for group in groups if group.reason is not Reason.NOT_SELECTED]
    rest = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *(group.rows for group in closed)]))
    in_rest = trial.gains.astype(np.float64) @ _weights(trial.place, closed, samples)
    overall = trial.choose(in_rest, _NAMED)
    largest = sorted((patch.rows for group in groups for patch in group.patches), key=lambda rows: -len(rows))
    asked = {int(rows[0]) for rows in largest[:_PATCHES]}
    of_group = [trial.best(group.rows, group.reason, _NAMED) for group in groups]
    of_patch = [
        [trial.best(patch.rows, group.reason, 1) if int(patch.rows[0]) in asked else [] for patch in group.patches]
        for group in groups
    ]
    verify = [(index, rest) for index in overall]
    for group, named, patches in zip(groups, of_group, of_patch, strict=True):
        verify += [(index, group.rows) for index in named]
        verify += [(index, patch.rows) for own, patch in zip(patches, group.patches, strict=True) for index in own]
    verified = _verify(trial, verify, targets, progress)

    def helping(chosen: Sequence[int], rows: Ints) -> tuple[Named, ...]:
        return tuple(verified[index] for index in chosen if verified[index].gained[rows].any())

    return Findings(
        tuple(
            replace(
                group,
                named=helping(named, group.rows),
                patches=tuple(
                    replace(patch, named=next(iter(helping(own, patch.rows)), None))
                    for patch, own in zip(group.patches, patches, strict=True)
                ),
            )
            for group, named, patches in zip(groups, of_group, of_patch, strict=True)
        ),
        rest,
        tuple(verified[index] for index in overall),
        tuple(sorted(zip(trial.changes, in_rest.tolist(), strict=True), key=lambda item: -item[1])),
    )


def _try(
    changes: Changes,
    targets: RayTargets,
    samples: SurfaceSamples,
    groups: Sequence[Group],
    progress: Progress,
) -> _Trial:
    rows = np.sort(np.concatenate([group.rows for group in groups]))
    wanted = [max(_FEWEST, round(_REPRESENTATIVES * len(group.rows) / len(rows))) for group in groups]
    spread = [_spread(group.rows, count) for group, count in zip(groups, wanted, strict=True)]
    representatives = np.unique(np.concatenate(spread))
    aims = _spread(rows, _AIMS)
    tried: list[WhatIf] = []
    masks: list[NDArray[np.bool_]] = []
    for done, ladder in enumerate(changes.ladders((samples.points[aims], samples.normals[aims]))):
        masks.extend(ladder_masks(ladder, targets, representatives))
        tried.extend(ladder)
        progress(min(done + 1, 14), 20)
    for group in groups:
        if group.reason is Reason.NOT_SELECTED:
            views = changes.views(targets, _spread(group.rows, _VIEWS_FROM))
            masks.extend(view.measures(targets, representatives) for view in views)
            tried.extend(views)
    place = np.full(len(targets), -1, dtype=np.int64)
    place[representatives] = np.arange(len(representatives))
    return _Trial(tuple(tried), np.array(masks).reshape(len(tried), len(representatives)), place)


def _verify(
    trial: _Trial, asked: Sequence[tuple[int, Ints]], targets: RayTargets, progress: Progress
) -> dict[int, Named]:
    """Each change asked about every sample that it is named for."""
    rows_of: dict[int, list[Ints]] = {}
    for index, rows in asked:
        rows_of.setdefault(index, []).append(rows)
    verified: dict[int, Named] = {}
    for done, (index, pieces) in enumerate(sorted(rows_of.items())):
        every = np.unique(np.concatenate(pieces))
        gained = np.zeros(len(targets), dtype=np.bool_)
        gained[every] = trial.changes[index].measures(targets, every)
        verified[index] = Named(trial.changes[index], gained)
        progress(14 * len(rows_of) + 6 * (done + 1), 20 * len(rows_of))
    return verified


def _spread(rows: Ints, count: int) -> Ints:
    """At most so many of the rows, evenly over their order, which is that of a space-filling curve."""
    return rows[np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64)]


def _weights(place: Ints, groups: Sequence[Group], samples: SurfaceSamples) -> Floats:
    """(r,) share of the groups' area that each representative stands for; 0 for those of other groups."""
    weight = np.zeros(int(place.max()) + 1)
    total = sum(float(samples.areas[group.rows].sum()) for group in groups)
    for group in groups:
        own = place[group.rows]
        own = own[own >= 0]
        weight[own] = float(samples.areas[group.rows].sum()) / total / len(own)
    return weight
