"""Compiled inner loops of the search: a choice that changes one column at a time, its scores kept up to date.

The score of a column is the weighted deficit that it would take away (outside the choice) or leave (inside): when a
column moves, its own score stays and only those of the columns that share a row change whose deficit changes (Gao,
Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038, section 3). In the same loop these columns become free to enter again
(configuration checking). A row that demands 1 has a short way: its score passes to its only column and back.

Scores are whole numbers, their ratios to prices float64 without contraction, so that a run is the same on every
machine. Work is counted in touched entries.

What a search knows of rows and columns stands in a few arrays of many fields, numbers are copied one by one, and Python
calls `steps` alone: each array of the state, each slice assignment and each entry costs every first run compiling.
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

DEMAND, UNITS, GROWTH, WEIGHT, LOAD, OWNER, OPEN_ROW, OPEN_PLACE = range(8)
"""Fields of a row in `State.rows`: load that it demands; units that are missing while it is open; what its weight gains
while it stays open, and has at the start; its weight; what the choice brings; the sum of the choice's columns in it
(where there is one, it is this one). The last two: the rows that are open, and where each row stands among them."""

COST, GROUP, FIXED, SCORE, CHOSEN, FREE, STAMP, MEMBER, PLACE, BEST_MEMBER, LABEL, SEEN, STACK = range(13)
"""Fields of a column in `State.columns`: its cost; its group; whether it may not leave; its score; whether it is in the
choice; whether it may enter; the move in which it last moved, 0 for never. Then lists: the choice, in no order, and
where each column stands in it; the best choice; three of scratch for the parts of the graph."""

FIRST, INSIDE = range(2)
"""Fields of a group in `State.groups`: what its first column costs on top; how many of its columns are chosen."""

(MOVES, MEMBERS, OPEN, SPENT, BEST, BEST_MEMBERS, TABU, MISSING, LIMIT, ALLOWED, PARTS, STEPS, PRICED,
 FIRST_MEMBERS, NUMBERS) = range(15)  # fmt: skip
"""Numbers of a search: moves made; columns chosen; rows open; cost of the choice; objective and size of the best one;
column that came last; units missing; cost up to which columns enter; units that may be missing; weight of a part of the
graph too many; steps made; whether costs differ; columns that `STACK` names, to be chosen first. Then how many."""


ALL: Any = np.int64(LABEL)
OTHERS: Any = np.int64(SEEN)


class State(NamedTuple):
    """Everything that a search carries from one chunk of steps to the next."""

    row_start: Any  # (S + 1,) the problem's rows
    row_columns: Any  # (nnz,) columns of each row
    row_load: Any  # (nnz,) or (0,) their loads
    column_start: Any  # (V + 1,) the problem's columns
    column_rows: Any  # (nnz,) rows of each column
    column_load: Any  # (nnz,) or (0,) their loads
    rows: Any  # (fields, S) see above
    columns: Any  # (fields, V)
    groups: Any  # (fields, G)
    adjacent: Any  # (V, V) joined columns; (0, 0) where nothing must hold together
    numbers: Any  # (NUMBERS,)
    random: Any  # (1,) state of the random numbers


@compiled
def move(s: State, column: int, sign: int) -> Any:
    """Put a column into the choice (sign 1) or take it out (-1); returns its work in half units."""
    numbers = s.numbers
    numbers[MOVES] += 1
    s.columns[STAMP, column] = numbers[MOVES]
    s.columns[CHOSEN, column] = sign > 0
    group = s.columns[GROUP, column]
    if sign > 0:
        s.columns[PLACE, column] = numbers[MEMBERS]
        s.columns[MEMBER, numbers[MEMBERS]] = column
        numbers[MEMBERS] += 1
        if s.groups[INSIDE, group] == 0:
            numbers[SPENT] += s.groups[FIRST, group]
    else:
        numbers[MEMBERS] -= 1
        last = s.columns[MEMBER, numbers[MEMBERS]]
        s.columns[MEMBER, s.columns[PLACE, column]] = last
        s.columns[PLACE, last] = s.columns[PLACE, column]
        s.columns[FREE, column] = False
        if s.groups[INSIDE, group] == 1:
            numbers[SPENT] -= s.groups[FIRST, group]
    s.groups[INSIDE, group] += sign
    numbers[SPENT] += sign * s.columns[COST, column]
    plain = len(s.row_load) == 0
    begin, end = s.column_start[column], s.column_start[column + 1]
    touched = MOVE_WORK + ROW_WORK * (end - begin)
    for at in range(begin, end):
        row = s.column_rows[at]
        before = s.rows[LOAD, row]
        demand = s.rows[DEMAND, row]
        after = before + sign * (1 if plain else s.column_load[at])
        s.rows[LOAD, row] = after
        s.rows[OWNER, row] += sign * column
        low = min(before, after)
        if demand == 1:
            if low == 1:
                # the one column that remains, or that was there before, can lose the row, or no longer
                s.columns[SCORE, s.rows[OWNER, row] if sign < 0 else s.rows[OWNER, row] - column] -= (
                    sign * s.rows[WEIGHT, row]
                )
            elif low == 0:
                change = -sign * s.rows[WEIGHT, row]
                for entry in range(s.row_start[row], s.row_start[row + 1]):
                    other = s.row_columns[entry]
                    s.columns[SCORE, other] += change
                    s.columns[FREE, other] = True
                s.columns[SCORE, column] -= change
                touched += ENTRY_WORK * (s.row_start[row + 1] - s.row_start[row])
        elif low < 2 * demand:
            was, lack, weight = demand - before, demand - after, s.rows[WEIGHT, row]
            for entry in range(s.row_start[row], s.row_start[row + 1]):
                other = s.row_columns[entry]
                brings = 1 if plain else s.row_load[entry]
                if other == column:
                    continue
                if s.columns[CHOSEN, other]:
                    change = max(lack + brings, 0) - max(lack, 0) - max(was + brings, 0) + max(was, 0)
                else:
                    change = min(brings, max(lack, 0)) - min(brings, max(was, 0))
                if change != 0:
                    s.columns[SCORE, other] += weight * change
                    s.columns[FREE, other] = True
            touched += 4 * ENTRY_WORK * (s.row_start[row + 1] - s.row_start[row])
        if (before < demand) != (after < demand):
            if sign > 0:
                last = s.rows[OPEN_ROW, numbers[OPEN] - 1]
                s.rows[OPEN_ROW, s.rows[OPEN_PLACE, row]] = last
                s.rows[OPEN_PLACE, last] = s.rows[OPEN_PLACE, row]
                numbers[OPEN] -= 1
            else:
                s.rows[OPEN_PLACE, row] = numbers[OPEN]
                s.rows[OPEN_ROW, numbers[OPEN]] = row
                numbers[OPEN] += 1
            numbers[MISSING] -= sign * s.rows[UNITS, row]
    if sign < 0:
        s.columns[FREE, column] = False
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
def label(s: State, without: int, field: int) -> int:
    """Number the parts of the choice that hang together, without one position (-1: none), in a field; how many."""
    size, parts = s.numbers[MEMBERS], 0
    for position in range(size):
        s.columns[field, position] = -1
    for first in range(size):
        if first == without or s.columns[field, first] >= 0:
            continue
        s.columns[field, first] = parts
        s.columns[STACK, 0] = first
        depth = 1
        while depth > 0:
            depth -= 1
            at = s.columns[MEMBER, s.columns[STACK, depth]]
            for other in range(size):
                joined = s.adjacent[at, s.columns[MEMBER, other]] == 1
                if other != without and s.columns[field, other] < 0 and joined:
                    s.columns[field, other] = parts
                    s.columns[STACK, depth] = other
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
        column = s.columns[MEMBER, position]
        if s.columns[FIXED, column] or (column == tabu and size > 1):
            continue
        if tenure > 0 and s.columns[STAMP, column] > 0 and s.numbers[MOVES] - s.columns[STAMP, column] < tenure:
            continue
        loss, cost = float(s.columns[SCORE, column]), 1.0
        if parts > 0:
            loss += float(s.numbers[PARTS] * (label(s, position, OTHERS) - parts))
        if priced:
            cost = float(s.columns[COST, column])
            if s.groups[INSIDE, s.columns[GROUP, column]] == 1:
                cost += float(s.groups[FIRST, s.columns[GROUP, column]])
        difference = loss * price - least * cost
        if best < 0 or difference < 0 or (difference == 0 and s.columns[STAMP, column] < stamp):
            best, least, price, stamp = column, loss, cost, s.columns[STAMP, column]
    if best < 0 and size > 0 and not s.columns[FIXED, s.columns[MEMBER, 0]]:
        best = s.columns[MEMBER, 0]
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
    first, last = (s.row_start[row], s.row_start[row + 1]) if row >= 0 else (0, s.columns.shape[1])
    count = last - first
    sampled = row >= 0 and count > SAMPLE + 10 and parts == 0
    best, most, price, stamp = -1, 0.0, 1.0, 0
    priced = s.numbers[PRICED] > 0
    for part in range(parts):
        s.columns[SEEN, part] = 0  # which column last found each part
    for k in range(SAMPLE if sampled else count):
        at = first + (draw(s, count) if sampled else k)
        column: Any = np.int64(s.row_columns[at]) if row >= 0 else at
        if s.columns[CHOSEN, column] or column == left:
            continue
        if tenure > 0:
            if s.columns[STAMP, column] > 0 and s.numbers[MOVES] - s.columns[STAMP, column] < tenure:
                continue
        elif not s.columns[FREE, column] and parts == 0:
            continue
        gain, cost = float(s.columns[SCORE, column]), 1.0
        if parts > 1:
            joined = 0
            for position in range(s.numbers[MEMBERS]):
                part = s.columns[LABEL, position]
                if s.columns[SEEN, part] != column + 1 and s.adjacent[column, s.columns[MEMBER, position]] == 1:
                    s.columns[SEEN, part] = column + 1
                    joined += 1
            gain += float(s.numbers[PARTS] * (joined - 1))
        if priced:
            cost = float(s.columns[COST, column])
            if s.groups[INSIDE, s.columns[GROUP, column]] == 0:
                cost += float(s.groups[FIRST, s.columns[GROUP, column]])
        difference = gain * price - most * cost
        if best < 0 or difference > 0 or (difference == 0 and s.columns[STAMP, column] < stamp):
            best, most, price, stamp = column, gain, cost, s.columns[STAMP, column]
    return best


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
    for position in range(numbers[FIRST_MEMBERS]):
        move(s, s.columns[STACK, position], IN)
        s.columns[STAMP, s.columns[STACK, position]] = 0
    numbers[FIRST_MEMBERS] = 0
    while work < work_limit:
        parts = label(s, NONE, ALL) if graph else 0
        while (numbers[OPEN] == 0 if full else numbers[MISSING] <= numbers[ALLOWED]) and parts <= 1:
            numbers[BEST], numbers[BEST_MEMBERS] = numbers[MISSING] if most else numbers[SPENT], numbers[MEMBERS]
            for position in range(numbers[MEMBERS]):
                s.columns[BEST_MEMBER, position] = s.columns[MEMBER, position]
            if most:
                numbers[ALLOWED] = numbers[MISSING] - 1
            else:
                numbers[LIMIT] = numbers[SPENT] - 1
            if numbers[BEST] <= target:
                return work // 2
            if most:
                break
            out = leaving(s, NONE, parts, NEVER)
            if out < 0:
                return work // 2
            work += MEMBER_WORK * numbers[MEMBERS] + move(s, out, OUT)
            parts = label(s, NONE, ALL) if graph else 0
        numbers[STEPS] += 1
        work += numbers[MEMBERS] ** 2 * (numbers[MEMBERS] + 1) if graph else 0
        tenure = draw(s, tenures) + 2 if tenures > 0 else 0
        out = leaving(s, numbers[TABU], parts, min(tenure // 2, numbers[MEMBERS]))
        if out < 0:
            return -1
        work += MEMBER_WORK * min(numbers[MEMBERS], MEMBER_SAMPLE) + move(s, out, OUT)
        while True:
            parts = label(s, NONE, ALL) if graph else 0
            if (numbers[OPEN] == 0 if full else numbers[MISSING] <= numbers[ALLOWED]) and parts <= 1:
                break
            aimed = full and numbers[OPEN] > 0 and not (graph and draw(s, TEN) < 3)
            row: Any = s.rows[OPEN_ROW, draw(s, numbers[OPEN])] if aimed else np.int64(-1)
            column = entering(s, row, out, parts, tenure)
            looked_at = min(SAMPLE, s.row_start[row + 1] - s.row_start[row]) if row >= 0 else s.columns.shape[1]
            work += CANDIDATE_WORK * looked_at * (1 + (numbers[MEMBERS] if parts > 1 else 0))
            if column < 0:
                break
            more = s.columns[COST, column]
            if s.groups[INSIDE, s.columns[GROUP, column]] == 0:
                more += s.groups[FIRST, s.columns[GROUP, column]]
            if numbers[SPENT] + more > numbers[LIMIT]:
                break
            work += move(s, column, IN)
            numbers[TABU] = column
        if full:
            for position in range(numbers[OPEN]):
                work += grow(s, s.rows[OPEN_ROW, position])
        if graph:
            many = label(s, NONE, ALL) > 1
            weight = numbers[PARTS]
            numbers[PARTS] = weight + weight // 20 + 1 if many else max(weight - weight // 50, 1)
    return work // 2


@compiled
def grow(s: State, row: int) -> Any:
    """An open row gains weight; returns its work in half units."""
    growth, lack = s.rows[GROWTH, row], s.rows[DEMAND, row] - s.rows[LOAD, row]
    plain = len(s.row_load) == 0
    s.rows[WEIGHT, row] += growth
    begin, end = s.row_start[row], s.row_start[row + 1]
    for entry in range(begin, end):
        column = s.row_columns[entry]
        brings = 1 if plain else s.row_load[entry]
        if s.columns[CHOSEN, column]:
            s.columns[SCORE, column] += growth * brings
        else:
            s.columns[SCORE, column] += growth * min(brings, lack)
    return ENTRY_WORK * (end - begin)
