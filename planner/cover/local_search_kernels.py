"""Compiled inner loops of the local search: a cover that changes one column at a time, its scores kept up to date.

The score of a column is the weight of the rows that lack a column and that it would help (outside the cover), or that
would lack one without it (inside): when a column moves, its own score stays and only those of the columns that share
a row change whose satisfaction changes (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038, section 3). A row lacks a
column while fewer than it demands cover it; where once is enough this is the plain set cover of the paper.

All numbers are integers, so that a run is the same on every machine. Work is counted in touched entries.
"""

from typing import Any, NamedTuple

import numpy as np

from planner.compiled import compiled

STEP_WORK = 40
"""Charge of one step beyond the entries that it touches."""

BUMPED_ROWS = 4
"""Partial cover: rows that gain weight in a step."""

FORGET_ABOVE, FORGET_TENTHS = 3, 3
"""Partial cover: when the weights sum to this multiple of their start, so many tenths of their growth are kept."""

# positions in State.numbers
MOVES, MEMBERS, OPEN, COST, BEST_COST, BEST_MEMBERS, TABU, MISSING, GROWN, STEPS = range(10)
NUMBERS = 10


class State(NamedTuple):
    """Everything that a search carries from one chunk of steps to the next.

    Attributes:
        row_start: (S + 1,) the problem's rows.
        row_columns: (nnz,) columns of each row.
        column_start: (V + 1,) the problem's columns.
        column_rows: (nnz,) rows of each column.
        demand: (S,) columns that each row demands.
        units: (S,) area of each row, of which `MISSING` units are still missing.
        costs: (V,) cost of each column.
        areas: (S,) weights at the start.
        weights: (S,) weights now.
        counts: (S,) columns of the cover in each row.
        owner: (S,) sum of their indices: where there is one, it is this one.
        score: (V,) see the module.
        chosen: (V,) whether a column is in the cover.
        members: (V,) the cover, in no particular order.
        place: (V,) where each column stands in `members`.
        open_rows: (S,) rows that lack a column.
        open_place: (S,) where each row stands in `open_rows`.
        stamp: (V,) move in which each column last moved; 0: never.
        row_stamp: (S,) move that last changed the row's count.
        best: (V,) the best cover found.
        numbers: counters, see above.
        random: (1,) state of the random numbers.
    """

    row_start: Any
    row_columns: Any
    column_start: Any
    column_rows: Any
    demand: Any
    units: Any
    costs: Any
    areas: Any
    weights: Any
    counts: Any
    owner: Any
    score: Any
    chosen: Any
    members: Any
    place: Any
    open_rows: Any
    open_place: Any
    stamp: Any
    row_stamp: Any
    best: Any
    numbers: Any
    random: Any


@compiled
def start(s: State, columns: Any) -> None:
    """Compute all scores and add the columns of a cover, unstamped."""
    rescore(s)
    for column in columns:
        add(s, column)
        s.stamp[column] = 0


@compiled
def rescore(s: State) -> None:
    """Compute the scores of all columns from the weights."""
    s.score[:] = 0
    for row in range(len(s.demand)):
        count, demand, weight = s.counts[row], s.demand[row], s.weights[row]
        for entry in range(s.row_start[row], s.row_start[row + 1]):
            column = s.row_columns[entry]
            if count < demand or (count == demand and s.chosen[column]):
                s.score[column] += weight


@compiled
def add(s: State, column: int) -> int:
    """Put a column into the cover; returns the entries touched."""
    numbers = s.numbers
    numbers[MOVES] += 1
    move = numbers[MOVES]
    s.chosen[column] = True
    s.place[column] = numbers[MEMBERS]
    s.members[numbers[MEMBERS]] = column
    numbers[MEMBERS] += 1
    numbers[COST] += s.costs[column]
    s.stamp[column] = move
    begin, end = s.column_start[column], s.column_start[column + 1]
    touched: int = end - begin
    for at in range(begin, end):
        row = s.column_rows[at]
        count, demand = s.counts[row], s.demand[row]
        if count == demand - 1:
            weight = s.weights[row]
            for entry in range(s.row_start[row], s.row_start[row + 1]):
                other = s.row_columns[entry]
                if not s.chosen[other]:
                    s.score[other] -= weight
            touched += s.row_start[row + 1] - s.row_start[row]
            last = s.open_rows[numbers[OPEN] - 1]
            s.open_rows[s.open_place[row]] = last
            s.open_place[last] = s.open_place[row]
            numbers[OPEN] -= 1
            numbers[MISSING] -= s.units[row]
        elif count == demand:
            if demand == 1:
                s.score[s.owner[row]] -= s.weights[row]
            else:
                touched += _change_members(s, row, column, -s.weights[row])
        s.counts[row] = count + 1
        s.owner[row] += column
        s.row_stamp[row] = move
    return touched


@compiled
def remove(s: State, column: int) -> int:
    """Take a column out of the cover; returns the entries touched."""
    numbers = s.numbers
    numbers[MOVES] += 1
    move = numbers[MOVES]
    s.chosen[column] = False
    numbers[MEMBERS] -= 1
    last_member = s.members[numbers[MEMBERS]]
    s.members[s.place[column]] = last_member
    s.place[last_member] = s.place[column]
    numbers[COST] -= s.costs[column]
    s.stamp[column] = move
    begin, end = s.column_start[column], s.column_start[column + 1]
    touched: int = end - begin
    for at in range(begin, end):
        row = s.column_rows[at]
        count, demand = s.counts[row], s.demand[row]
        s.counts[row] = count - 1
        s.owner[row] -= column
        s.row_stamp[row] = move
        if count == demand:
            weight = s.weights[row]
            for entry in range(s.row_start[row], s.row_start[row + 1]):
                other = s.row_columns[entry]
                if not s.chosen[other] and other != column:
                    s.score[other] += weight
            touched += s.row_start[row + 1] - s.row_start[row]
            s.open_place[row] = numbers[OPEN]
            s.open_rows[numbers[OPEN]] = row
            numbers[OPEN] += 1
            numbers[MISSING] += s.units[row]
        elif count == demand + 1:
            if demand == 1:
                s.score[s.owner[row]] += s.weights[row]
            else:
                touched += _change_members(s, row, column, s.weights[row])
    return touched


@compiled
def _change_members(s: State, row: int, moved: int, change: int) -> int:
    """Change the scores of the cover's columns in a row, except that of the moved one; returns the entries touched."""
    for entry in range(s.row_start[row], s.row_start[row + 1]):
        other = s.row_columns[entry]
        if s.chosen[other] and other != moved:
            s.score[other] += change
    touched: int = s.row_start[row + 1] - s.row_start[row]
    return touched


@compiled
def cheapest(s: State, tabu: int) -> int:
    """Member with the smallest loss for its cost, oldest first; the tabu one only where there is no other."""
    best = s.members[0]
    loss, cost, stamp = s.score[best], s.costs[best], s.stamp[best]
    if best == tabu and s.numbers[MEMBERS] > 1:
        best = s.members[1]
        loss, cost, stamp = s.score[best], s.costs[best], s.stamp[best]
    for position in range(1, s.numbers[MEMBERS]):
        column = s.members[position]
        difference = s.score[column] * cost - loss * s.costs[column]
        if (difference < 0 or (difference == 0 and s.stamp[column] < stamp)) and column != tabu:
            best = column
            loss, cost, stamp = s.score[best], s.costs[best], s.stamp[best]
    found: int = best
    return found


@compiled
def draw(s: State, count: int) -> int:
    """A random number from 0 to count - 1 (SplitMix64; Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195)."""
    s.random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = s.random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return int(float(z >> np.uint64(11)) / 9007199254740992.0 * count)


@compiled
def keep_best(s: State) -> None:
    """Note the current cover as the best one."""
    numbers = s.numbers
    numbers[BEST_COST], numbers[BEST_MEMBERS] = numbers[COST], numbers[MEMBERS]
    s.best[: numbers[MEMBERS]] = s.members[: numbers[MEMBERS]]


@compiled
def _surroundings_changed(s: State, column: int) -> bool:
    """Configuration checking: whether a column that shares a row has moved since this one did."""
    stamp = s.stamp[column]
    if stamp == 0:
        return True
    for at in range(s.column_start[column], s.column_start[column + 1]):
        if s.row_stamp[s.column_rows[at]] > stamp:
            return True
    return False


@compiled
def _entering(s: State, row: int) -> int:
    """Column of an open row with the largest gain for its cost, oldest first; -1 where none may enter."""
    best = -1
    gain, cost, stamp = 0, 1, 0
    for entry in range(s.row_start[row], s.row_start[row + 1]):
        column = s.row_columns[entry]
        if s.chosen[column]:
            continue
        difference = s.score[column] * cost - gain * s.costs[column]
        better = best < 0 or difference > 0 or (difference == 0 and s.stamp[column] < stamp)
        if better and _surroundings_changed(s, column):
            best = column
            gain, cost, stamp = s.score[best], s.costs[best], s.stamp[best]
    return best


@compiled
def full_steps(s: State, work_limit: int, target: int) -> int:
    """Steps of the search for a full cover, until the work is done or a cover costs no more than the target.

    Returns:
        Work done.
    """
    numbers = s.numbers
    work = 0
    while work < work_limit:
        while numbers[OPEN] == 0:
            keep_best(s)
            if numbers[BEST_COST] <= target or numbers[MEMBERS] == 0:
                return work
            work += numbers[MEMBERS] + remove(s, cheapest(s, -1))
        numbers[STEPS] += 1
        work += STEP_WORK
        if numbers[MEMBERS] > 0:
            work += numbers[MEMBERS] + remove(s, cheapest(s, numbers[TABU]))
        while numbers[OPEN] > 0:
            row = s.open_rows[draw(s, numbers[OPEN])]
            column = _entering(s, row)
            work += 2 * (s.row_start[row + 1] - s.row_start[row])
            if column < 0 or numbers[COST] + s.costs[column] >= numbers[BEST_COST]:
                break
            work += add(s, column)
            numbers[TABU] = column
        for position in range(numbers[OPEN]):
            row = s.open_rows[position]
            s.weights[row] += 1
            for entry in range(s.row_start[row], s.row_start[row + 1]):
                s.score[s.row_columns[entry]] += 1
            work += s.row_start[row + 1] - s.row_start[row]
    return work


@compiled
def _best_outside(s: State, left: int) -> int:
    """Column outside the cover with the largest gain for its cost, oldest first, and not the one that just left."""
    best = -1
    gain, cost, stamp = 0, 1, 0
    for column in range(len(s.costs)):
        if s.chosen[column] or column == left:
            continue
        difference = s.score[column] * cost - gain * s.costs[column]
        if best < 0 or difference > 0 or (difference == 0 and s.stamp[column] < stamp):
            best = column
            gain, cost, stamp = s.score[best], s.costs[best], s.stamp[best]
    return best


@compiled
def partial_steps(s: State, work_limit: int, target: int) -> int:
    """Steps of the search for a partial cover; like `full_steps`."""
    numbers = s.numbers
    n_columns = len(s.costs)
    start_sum = s.areas.sum()
    work = 0
    while work < work_limit:
        while numbers[MISSING] <= 0:
            keep_best(s)
            if numbers[BEST_COST] <= target or numbers[MEMBERS] == 0:
                return work
            work += numbers[MEMBERS] + remove(s, cheapest(s, -1))
        numbers[STEPS] += 1
        work += STEP_WORK
        left = -1
        if numbers[MEMBERS] > 0:
            left = cheapest(s, numbers[TABU])
            work += numbers[MEMBERS] + remove(s, left)
        while numbers[MISSING] > 0:
            column = _best_outside(s, left)
            work += n_columns
            if column < 0 or numbers[COST] + s.costs[column] >= numbers[BEST_COST]:
                break
            work += add(s, column)
            numbers[TABU] = column
        if numbers[MISSING] > 0:
            for _ in range(min(BUMPED_ROWS, numbers[OPEN])):
                row = s.open_rows[draw(s, numbers[OPEN])]
                s.weights[row] += s.areas[row]
                numbers[GROWN] += s.areas[row]
                for entry in range(s.row_start[row], s.row_start[row + 1]):
                    s.score[s.row_columns[entry]] += s.areas[row]
                work += s.row_start[row + 1] - s.row_start[row]
            if numbers[GROWN] > (FORGET_ABOVE - 1) * start_sum:
                s.weights[:] = s.areas + (s.weights - s.areas) * FORGET_TENTHS // 10
                numbers[GROWN] = (s.weights - s.areas).sum()
                rescore(s)
                work += len(s.row_columns)
    return work
