"""Compiled inner loops of the search: a choice that changes one column at a time, its scores kept up to date.

The score of a column is the weighted deficit that it would take away (outside the choice) or leave (inside): when a
column moves, its own score stays and only those of the columns that share a row change whose deficit changes (Gao,
Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038, section 3). In the same loop these columns become free to enter again
(configuration checking). A row that demands 1 has a short way: its score passes to its only column and back.

Scores are whole numbers, their ratios to prices float64 without contraction, so that a run is the same on every
machine. Work is counted in touched entries.
"""

from typing import Any, NamedTuple

import numpy as np

from planner.compiled import compiled

MOVE_WORK, ROW_WORK, ENTRY_WORK, MEMBER_WORK, CANDIDATE_WORK = 320, 5, 1, 3, 5
"""Charge in half units of a move, each of its rows, each entry of the rows that change, each member of the choice and
each candidate looked at: fitted to processor time on files of 200 to 4000 rows (within 20 %)."""

SAMPLE = 50
"""Members of an open row that are looked at where it has more; of the choice likewise."""

MEMBER_SAMPLE = 400
"""Members of the choice that are looked at where it has more."""

# typed, since numba would compile a kernel anew for each literal that it is called with
IN: Any = np.int64(1)
OUT: Any = np.int64(-1)
NONE: Any = np.int64(-1)
NEVER: Any = np.int64(0)
TEN: Any = np.int64(10)

# positions in State.numbers
MOVES, MEMBERS, OPEN, COST, BEST, BEST_MEMBERS, TABU, MISSING, LIMIT, ALLOWED, PARTS, STEPS, PRICED = range(13)
NUMBERS = 13


class State(NamedTuple):
    """Everything that a search carries from one chunk of steps to the next."""

    row_start: Any  # (S + 1,) the problem's rows
    row_columns: Any  # (nnz,) columns of each row
    row_load: Any  # (nnz,) or (0,) their loads
    column_start: Any  # (V + 1,) the problem's columns
    column_rows: Any  # (nnz,) rows of each column
    column_load: Any  # (nnz,) or (0,) their loads
    demand: Any  # (S,) load that each row demands
    units: Any  # (S,) area of each row, of which `MISSING` units are still missing
    costs: Any  # (V,) cost of each column
    group: Any  # (V,) group of each column
    group_costs: Any  # (G,) what its first column costs on top
    group_members: Any  # (G,) columns of the choice in each group
    adjacent: Any  # (V, V) joined columns; (0, 0) where nothing must hold together
    fixed: Any  # (V,) columns that may not leave
    growth: Any  # (S,) what a row's weight gains while it stays open; the weights at the start
    weights: Any  # (S,) weights now
    load: Any  # (S,) what the choice brings to each row
    owner: Any  # (S,) sum of its columns' indices: where there is one, it is this one
    score: Any  # (V,) see the module
    chosen: Any  # (V,) whether a column is in the choice
    free: Any  # (V,) whether a column may enter
    members: Any  # (V,) the choice, in no particular order
    place: Any  # (V,) where each column stands in `members`
    open_rows: Any  # (S,) rows that lack something
    open_place: Any  # (S,) where each row stands in `open_rows`
    stamp: Any  # (V,) move in which each column last moved; 0: never
    best: Any  # (V,) the best choice found
    labels: Any  # (2, V + 1) scratch for the parts of the graph
    numbers: Any  # counters, see above
    random: Any  # (1,) state of the random numbers


@compiled
def rescore(s: State) -> None:
    """Compute the scores of all columns from the weights."""
    s.score[:] = 0
    plain = len(s.row_load) == 0
    for row in range(len(s.demand)):
        lack = s.demand[row] - s.load[row]
        for entry in range(s.row_start[row], s.row_start[row + 1]):
            column = s.row_columns[entry]
            brings = 1 if plain else s.row_load[entry]
            if s.chosen[column]:
                s.score[column] += s.weights[row] * (max(lack + brings, 0) - max(lack, 0))
            else:
                s.score[column] += s.weights[row] * min(brings, max(lack, 0))


@compiled
def move(s: State, column: int, sign: int) -> Any:
    """Put a column into the choice (sign 1) or take it out (-1); returns its work in half units."""
    numbers = s.numbers
    numbers[MOVES] += 1
    s.stamp[column] = numbers[MOVES]
    s.chosen[column] = sign > 0
    group = s.group[column]
    if sign > 0:
        s.place[column] = numbers[MEMBERS]
        s.members[numbers[MEMBERS]] = column
        numbers[MEMBERS] += 1
        if s.group_members[group] == 0:
            numbers[COST] += s.group_costs[group]
    else:
        numbers[MEMBERS] -= 1
        last = s.members[numbers[MEMBERS]]
        s.members[s.place[column]] = last
        s.place[last] = s.place[column]
        s.free[column] = False
        if s.group_members[group] == 1:
            numbers[COST] -= s.group_costs[group]
    s.group_members[group] += sign
    numbers[COST] += sign * s.costs[column]
    plain = len(s.row_load) == 0
    begin, end = s.column_start[column], s.column_start[column + 1]
    touched = MOVE_WORK + ROW_WORK * (end - begin)
    for at in range(begin, end):
        row = s.column_rows[at]
        before = s.load[row]
        demand = s.demand[row]
        after = before + sign * (1 if plain else s.column_load[at])
        s.load[row] = after
        s.owner[row] += sign * column
        low = min(before, after)
        if demand == 1:
            if low == 1:
                # the one column that remains, or that was there before, can lose the row, or no longer
                s.score[s.owner[row] if sign < 0 else s.owner[row] - column] -= sign * s.weights[row]
            elif low == 0:
                change = -sign * s.weights[row]
                for entry in range(s.row_start[row], s.row_start[row + 1]):
                    other = s.row_columns[entry]
                    s.score[other] += change
                    s.free[other] = True
                s.score[column] -= change
                touched += ENTRY_WORK * (s.row_start[row + 1] - s.row_start[row])
        elif low < 2 * demand:
            was, lack, weight = demand - before, demand - after, s.weights[row]
            for entry in range(s.row_start[row], s.row_start[row + 1]):
                other = s.row_columns[entry]
                brings = 1 if plain else s.row_load[entry]
                if other == column:
                    continue
                if s.chosen[other]:
                    change = max(lack + brings, 0) - max(lack, 0) - max(was + brings, 0) + max(was, 0)
                else:
                    change = min(brings, max(lack, 0)) - min(brings, max(was, 0))
                if change != 0:
                    s.score[other] += weight * change
                    s.free[other] = True
            touched += 4 * ENTRY_WORK * (s.row_start[row + 1] - s.row_start[row])
        if (before < demand) != (after < demand):
            if sign > 0:
                last = s.open_rows[numbers[OPEN] - 1]
                s.open_rows[s.open_place[row]] = last
                s.open_place[last] = s.open_place[row]
                numbers[OPEN] -= 1
            else:
                s.open_place[row] = numbers[OPEN]
                s.open_rows[numbers[OPEN]] = row
                numbers[OPEN] += 1
            numbers[MISSING] -= sign * s.units[row]
    if sign < 0:
        s.free[column] = False
    return touched


@compiled
def draw(s: State, count: int) -> Any:
    """A random number from 0 to count - 1 (SplitMix64; Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195)."""
    s.random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = s.random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return int(float(z >> np.uint64(11)) / 9007199254740992.0 * count)


@compiled
def label(s: State, without: int, labels: Any) -> int:
    """Number the parts of the choice that hang together, without one position (-1: none); how many there are."""
    size = s.numbers[MEMBERS]
    labels[:size] = -1
    stack = np.empty(size + 1, dtype=np.int64)
    parts = 0
    for first in range(size):
        if first == without or labels[first] >= 0:
            continue
        labels[first] = parts
        stack[0] = first
        depth = 1
        while depth > 0:
            depth -= 1
            at = s.members[stack[depth]]
            for other in range(size):
                if other != without and labels[other] < 0 and s.adjacent[at, s.members[other]] == 1:
                    labels[other] = parts
                    stack[depth] = other
                    depth += 1
        parts += 1
    return parts


@compiled
def leaving(s: State, tabu: int, parts: int, tenure: int) -> Any:
    """Member with the smallest loss for its price, oldest first; the tabu one only where there is no other; -1: none.

    Args:
        s: the search.
        tabu: column that came last, or -1.
        parts: of the graph; 0 where there is none.
        tenure: moves that a column that came stays for; 0: only the tabu one.
    """
    best, least, price, stamp = -1, 0.0, 1.0, 0
    priced = s.numbers[PRICED] > 0
    size = s.numbers[MEMBERS]
    looked_at = size if size <= MEMBER_SAMPLE else MEMBER_SAMPLE // 4
    for k in range(looked_at):
        position = k if looked_at == size else draw(s, size)
        column = s.members[position]
        if s.fixed[column] or (column == tabu and size > 1):
            continue
        if tenure > 0 and s.stamp[column] > 0 and s.numbers[MOVES] - s.stamp[column] < tenure:
            continue
        loss, cost = float(s.score[column]), 1.0
        if parts > 0:
            loss += float(s.numbers[PARTS] * (label(s, position, s.labels[1]) - parts))
        if priced:
            cost = float(s.costs[column])
            if s.group_members[s.group[column]] == 1:
                cost += float(s.group_costs[s.group[column]])
        difference = loss * price - least * cost
        if best < 0 or difference < 0 or (difference == 0 and s.stamp[column] < stamp):
            best, least, price, stamp = column, loss, cost, s.stamp[column]
    if best < 0 and size > 0 and not s.fixed[s.members[0]]:
        best = s.members[0]
    return best


@compiled
def entering(s: State, row: int, left: int, parts: int, tenure: int) -> Any:
    """Column outside with the largest gain for its price, oldest first; -1 where none may enter.

    Args:
        s: the search.
        row: only its columns; -1: any.
        left: column that has just left.
        parts: of the graph, whose labels are in place; 0 where there is none.
        tenure: moves that a column stays out for; 0: configuration checking decides.
    """
    first, last = (s.row_start[row], s.row_start[row + 1]) if row >= 0 else (0, len(s.costs))
    count = last - first
    sampled = row >= 0 and count > SAMPLE + 10 and parts == 0
    best, most, price, stamp = -1, 0.0, 1.0, 0
    priced = s.numbers[PRICED] > 0
    seen = s.labels[1]  # scratch: which column last found each part
    seen[: parts + 1] = 0
    for k in range(SAMPLE if sampled else count):
        at = first + (draw(s, count) if sampled else k)
        column: Any = np.int64(s.row_columns[at]) if row >= 0 else at
        if s.chosen[column] or column == left:
            continue
        if tenure > 0:
            if s.stamp[column] > 0 and s.numbers[MOVES] - s.stamp[column] < tenure:
                continue
        elif not s.free[column] and parts == 0:
            continue
        gain, cost = float(s.score[column]), 1.0
        if parts > 1:
            joined = 0
            for position in range(s.numbers[MEMBERS]):
                part = s.labels[0, position]
                if seen[part] != column + 1 and s.adjacent[column, s.members[position]] == 1:
                    seen[part] = column + 1
                    joined += 1
            gain += float(s.numbers[PARTS] * (joined - 1))
        if priced:
            cost = float(s.costs[column])
            if s.group_members[s.group[column]] == 0:
                cost += float(s.group_costs[s.group[column]])
        difference = gain * price - most * cost
        if best < 0 or difference > 0 or (difference == 0 and s.stamp[column] < stamp):
            best, most, price, stamp = column, gain, cost, s.stamp[column]
    return best


@compiled
def keep_best(s: State, objective: int) -> None:
    """Note the current choice as the best one."""
    numbers = s.numbers
    numbers[BEST], numbers[BEST_MEMBERS] = objective, numbers[MEMBERS]
    s.best[: numbers[MEMBERS]] = s.members[: numbers[MEMBERS]]


@compiled
def steps(s: State, full: bool, most: bool, target: int, tenures: int, work_limit: int) -> int:
    """Steps of the search, until the work is done or the objective is at most the target.

    Args:
        s: the search.
        full: every row must be satisfied: row weights and configuration checking.
        most: the number of columns is given, and open units count.
        target: objective at which the search ends.
        tenures: longest time that a moved column is kept from moving back; 0: configuration checking.
        work_limit: work that may be done.

    Returns:
        Work done; -1 where no column may leave.
    """
    numbers = s.numbers
    graph = len(s.adjacent) > 0
    work = 0  # in half units
    work_limit *= 2
    while work < work_limit:
        parts = label(s, NONE, s.labels[0]) if graph else 0
        while (numbers[OPEN] == 0 if full else numbers[MISSING] <= numbers[ALLOWED]) and parts <= 1:
            if most:
                keep_best(s, numbers[MISSING])
                numbers[ALLOWED] = numbers[MISSING] - 1
            else:
                keep_best(s, numbers[COST])
                numbers[LIMIT] = numbers[COST] - 1
            if numbers[BEST] <= target:
                return work // 2
            if most:
                break
            out = leaving(s, NONE, parts, NEVER)
            if out < 0:
                return work // 2
            work += MEMBER_WORK * numbers[MEMBERS] + move(s, out, OUT)
            parts = label(s, NONE, s.labels[0]) if graph else 0
        numbers[STEPS] += 1
        work += numbers[MEMBERS] ** 2 * (numbers[MEMBERS] + 1) if graph else 0
        tenure = draw(s, tenures) + 2 if tenures > 0 else 0
        out = leaving(s, numbers[TABU], parts, min(tenure // 2, numbers[MEMBERS]))
        if out < 0:
            return -1
        work += MEMBER_WORK * min(numbers[MEMBERS], MEMBER_SAMPLE) + move(s, out, OUT)
        while True:
            parts = label(s, NONE, s.labels[0]) if graph else 0
            if (numbers[OPEN] == 0 if full else numbers[MISSING] <= numbers[ALLOWED]) and parts <= 1:
                break
            aimed = full and numbers[OPEN] > 0 and not (graph and draw(s, TEN) < 3)
            row: Any = s.open_rows[draw(s, numbers[OPEN])] if aimed else np.int64(-1)
            column = entering(s, row, out, parts, tenure)
            looked_at = min(SAMPLE, s.row_start[row + 1] - s.row_start[row]) if row >= 0 else len(s.costs)
            work += CANDIDATE_WORK * looked_at * (1 + (numbers[MEMBERS] if parts > 1 else 0))
            if column < 0:
                break
            more = s.costs[column]
            if s.group_members[s.group[column]] == 0:
                more += s.group_costs[s.group[column]]
            if numbers[COST] + more > numbers[LIMIT]:
                break
            work += move(s, column, IN)
            numbers[TABU] = column
        if full:
            for position in range(numbers[OPEN]):
                work += grow(s, s.open_rows[position])
        if graph:
            many = label(s, NONE, s.labels[0]) > 1
            weight = numbers[PARTS]
            numbers[PARTS] = weight + weight // 20 + 1 if many else max(weight - weight // 50, 1)
    return work // 2


@compiled
def grow(s: State, row: int) -> Any:
    """An open row gains weight; returns its work in half units."""
    growth, lack = s.growth[row], s.demand[row] - s.load[row]
    plain = len(s.row_load) == 0
    s.weights[row] += growth
    begin, end = s.row_start[row], s.row_start[row + 1]
    for entry in range(begin, end):
        column = s.row_columns[entry]
        brings = 1 if plain else s.row_load[entry]
        if s.chosen[column]:
            s.score[column] += growth * brings
        else:
            s.score[column] += growth * min(brings, lack)
    return ENTRY_WORK * (end - begin)
