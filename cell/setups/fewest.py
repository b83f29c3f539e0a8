"""How few set-ups do: all choices of 1, 2, ... of them are asked whether all their columns bring what is asked for."""

from itertools import combinations

import numpy as np

from planner.cover import CoverProblem
from planner.values import Bools, Floats, Ints

_LOOKED_AT = 200_000
"""Choices of set-ups that are looked at for the fewest; beyond, the bound is what was shown until then."""

_SLACK = 1e-12  # relative, when an area counts as reached


class Rows:
    """What all columns of each set-up bring to the rows, and what these need.

    Args:
        wish: the columns of all set-ups, those of each a group; see `planner.cover.CoverProblem`.
        targets: (P,) share of what they all can measure of each part of the rows.
    """

    def __init__(self, wish: CoverProblem, targets: Floats) -> None:
        group = np.asarray(wish.group)
        own = np.asarray(wish.allowed)[:, None] & (group[:, None] == np.arange(int(group.max(initial=-1)) + 1))
        self.brought: Ints = np.asarray(wish.matrix @ own.astype(np.int64)).T
        self.need: Ints = np.minimum(self.brought.sum(axis=0), wish.demand)
        self.worth: Floats = np.asarray(wish.areas if wish.weights is None else wish.weights, dtype=np.float64)
        self.part: Ints = (
            np.zeros(len(self.worth), np.int64) if wish.region is None else np.asarray(wish.region, np.int64)
        )
        self.wanted: Floats = targets * self.worth_of(self.need > 0)

    def worth_of(self, which: Bools) -> Floats:
        """(P,) what some (S,) rows come to, of each part."""
        parts = int(self.part.max(initial=0)) + 1
        return np.bincount(self.part[which], self.worth[which], minlength=parts).astype(np.float64)

    def have(self, loads: Ints) -> Bools:
        """(S,) rows that have what they need, of the (S,) loads that are brought to them."""
        return (self.need > 0) & (loads >= self.need)

    def reached(self, setups: tuple[int, ...]) -> Floats:
        """(P,) what all columns of some set-ups measure of each part."""
        return self.worth_of(self.have(self.brought[list(setups)].sum(axis=0)))

    def short(self, reached: Floats) -> float:
        """What is missing of what is wanted; 0 where nothing is."""
        return float(np.maximum(self.wanted * (1 - _SLACK) - reached, 0.0).sum())


def fewest_setups(rows: Rows, must: tuple[int, ...], most: int | None) -> tuple[int, list[tuple[int, ...]], bool]:
    """How many set-ups it takes at least, and all choices of so many that do.

    Args:
        rows: what each set-up can measure, and what is wanted.
        must: set-ups that are used in any case.
        most: set-ups that may be used, no fewer than these; None: any number.

    Returns:
        The number and the choices; where no choice of `most` does, the one that measures most alone. Where the fewest
        is more than can be looked at, a number that none has less than, with the set-ups of a greedy choice. And
        whether no other choice of so many set-ups as these does.
    """
    others = [row for row in range(len(rows.brought)) if row not in must]
    looked, greedy = 0, _greedy(rows, must, most or len(rows.brought))
    for count in range(max(len(must), 1), min(len(rows.brought), len(greedy), most or len(rows.brought)) + 1):
        short = {
            (some := tuple(sorted((*must, *more)))): rows.short(rows.reached(some))
            for more in combinations(others, count - len(must))
        }
        if enough := [some for some, missing in short.items() if missing == 0]:
            return count, enough, True
        if count == most:
            return count, [min(short, key=lambda some: short[some])], True
        looked += len(short)
        if looked > _LOOKED_AT:
            return count + 1, [greedy], False
    return len(greedy), [greedy], False


def _greedy(rows: Rows, must: tuple[int, ...], most: int) -> tuple[int, ...]:
    """Set-ups, each leaving least missing, until nothing is or there are so many."""
    chosen = must
    while not chosen or (rows.short(rows.reached(chosen)) > 0 and len(chosen) < most):
        others = (row for row in range(len(rows.brought)) if row not in chosen)
        chosen += (min(others, key=lambda row: rows.short(rows.reached((*chosen, row)))),)
    return tuple(sorted(chosen))
