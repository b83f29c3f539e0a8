"""Compiled inner loops of the search: a choice that changes one column at a time, and what a column is worth to it.

When a column moves, only its own rows are touched. What a column outside would bring is added up when it is asked for,
over its rows or, where fewer, over the open rows, which a bit each says it has: a few dozen candidates are looked at in
a step, while the columns that share a row with the one that moved may be all of them. What a member's leaving would
lose is kept up to date where every row demands 1: each row that one member alone covers knows it by the sum of its
members (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038, keep the scores of all columns).

Scores are whole numbers, their ratios to prices float64 without contraction, so that a run is the same on every
machine. Work is counted in touched entries.

What a search knows of rows and columns stands in a few arrays of many fields, numbers are copied one by one, and Python
calls `steps` alone: each array of the state, each slice assignment and each entry costs every first run compiling.
What is called for each candidate takes arrays: handing over the whole state there makes a step six times as dear.
"""

from typing import Any, NamedTuple

import numpy as np

from planner.compiled import compiled

MOVE_WORK, ROW_WORK, ENTRY_WORK, BIT_WORK = 10, 7, 3, 2
MEMBER_WORK, NEXT_MEMBER_WORK, DRAWN_MEMBER_WORK, CANDIDATE_WORK, DRAWN_CANDIDATE_WORK = 10, 6, 18, 10, 35
"""Charge in quarter units of a move, each of its rows, each entry and bit that is added up; of looking at a member
(after the first `FEW` less) or a candidate in turn, and at one that is drawn: fitted to processor time on files of 200
to 5000 rows (within 15 %)."""

SAMPLE = 50
"""Members of an open row that are looked at where it has more; of a choice of `MANY` members likewise."""

FEW, MANY = 120, 400
"""With more members than the second a sample of them is looked at."""

# typed, since numba would compile a kernel anew for each literal that it is called with
IN: Any = np.int64(1)
OUT: Any = np.int64(-1)
NONE: Any = np.int64(-1)
NEVER: Any = np.int64(0)
TEN: Any = np.int64(10)

DEMAND, UNITS, FIRST_WEIGHT, WEIGHT, OPEN_WEIGHT, LOAD, OWNERS, OPEN_ROW, OPEN_PLACE = range(9)
"""Fields of a row in `State.rows`: load that it demands; units that are missing while it is open; its weight at the
start, its weight, and this where it is open, else 0; what the choice brings; the sum of the choice's columns in it
(where there is one, it is this one). The last two: the rows that are open, and where each row stands among them."""

COST, GROUP, FIXED, LOSS, STAMP, MEMBER, PLACE, BEST_MEMBER, LABEL, SEEN, STACK = range(11)
"""Fields of a column in `State.columns`: its cost; its group; whether it may not leave; weight of the rows that it
alone of the choice covers (where rows demand 1); the move in which it last moved, 0 for never. Then lists: the choice,
in no order, and where each column stands in it (-1: outside); the best choice; three of scratch for the parts of the
graph."""

FIRST, INSIDE = range(2)
"""Fields of a group in `State.groups`: what its first column costs on top; how many of its columns are chosen."""

(MOVES, MEMBERS, OPEN, SPENT, BEST, BEST_MEMBERS, TABU, MISSING, LIMIT, ALLOWED, PARTS, STEPS, PRICED, CHEAPEST, ONCE,
 WORK, FIRST_MEMBERS, NUMBERS) = range(18)  # fmt: skip
"""Numbers of a search: moves made; columns chosen; rows open; cost of the choice; objective and size of the best one;
column that came last; units missing; cost up to which columns enter; units that may be missing; weight of a part of the
graph too many; steps made; whether costs differ; the smallest of them; whether every row demands 1 and every column
brings 1; work done in quarter units; columns that `STACK` names, to be chosen first. Then how many."""


ALL: Any = np.int64(LABEL)
OTHERS: Any = np.int64(SEEN)


class State(NamedTuple):
    """Everything that a search carries from one chunk of steps to the next."""

    row_start: Any  # (S + 1,) the problem's rows
    row_columns: Any  # (nnz,) columns of each row
    column_start: Any  # (V + 1,) the problem's columns
    column_rows: Any  # (nnz,) rows of each column
    column_load: Any  # (nnz,) or (0,) their loads
    bits: Any  # (V, words) the rows of each column as bits; (0, 0) where columns are short or loads differ
    rows: Any  # (fields, S) see above
    columns: Any  # (fields, V)
    groups: Any  # (fields, G)
    adjacent: Any  # (V, V) joined columns; (0, 0) where nothing must hold together
    numbers: Any  # (NUMBERS,)
    random: Any  # (1,) state of the random numbers


@compiled
def price(columns: Any, groups: Any, column: int, inside: int) -> Any:
    """Cost of a column, with that of its group where so many columns of it are chosen."""
    group = columns[GROUP, column]
    return columns[COST, column] + (groups[FIRST, group] if groups[INSIDE, group] == inside else 0)


@compiled
def move(s: State, column: int, sign: int) -> None:
    """Put a column into the choice (sign 1) or take it out (-1)."""
    numbers, rows, columns, groups = s.numbers, s.rows, s.columns, s.groups
    column_start, column_rows, column_load = s.column_start, s.column_rows, s.column_load
    numbers[MOVES] += 1
    columns[STAMP, column] = numbers[MOVES]
    numbers[SPENT] += sign * price(columns, groups, column, NEVER if sign > 0 else IN)
    groups[INSIDE, columns[GROUP, column]] += sign
    if sign > 0:
        columns[PLACE, column] = numbers[MEMBERS]
        columns[MEMBER, numbers[MEMBERS]] = column
        numbers[MEMBERS] += 1
    else:
        numbers[MEMBERS] -= 1
        last = columns[MEMBER, numbers[MEMBERS]]
        columns[MEMBER, columns[PLACE, column]] = last
        columns[PLACE, last] = columns[PLACE, column]
        columns[PLACE, column] = -1
    begin, end = column_start[column], column_start[column + 1]
    once, loads, loss = numbers[ONCE], len(column_load) > 0, 0
    for entry in range(begin, end):
        row = column_rows[entry]
        before, demand, weight = rows[LOAD, row], rows[DEMAND, row], rows[WEIGHT, row]
        after = before + (sign * column_load[entry] if loads else sign)
        rows[LOAD, row] = after
        rows[OWNERS, row] += sign * column
        if once and before + after == 3:  # another member covers the row alone, until now or from now on
            columns[LOSS, rows[OWNERS, row] - (column if sign > 0 else 0)] -= sign * weight
        if (before < demand) == (after < demand):
            continue
        numbers[MISSING] -= sign * rows[UNITS, row]
        loss += weight
        if sign > 0:
            numbers[OPEN] -= 1
            last, place = rows[OPEN_ROW, numbers[OPEN]], rows[OPEN_PLACE, row]
            rows[OPEN_ROW, place], rows[OPEN_PLACE, last] = last, place
            rows[OPEN_WEIGHT, row] = 0
        else:
            rows[OPEN_ROW, numbers[OPEN]], rows[OPEN_PLACE, row] = row, numbers[OPEN]
            numbers[OPEN] += 1
            rows[OPEN_WEIGHT, row] = weight
    columns[LOSS, column] = loss
    numbers[WORK] += MOVE_WORK + ROW_WORK * (end - begin)


@compiled
def brought(rows: Any, row: int, load: Any) -> Any:
    """Weighted deficit of a row that a load would take away."""
    return rows[OPEN_WEIGHT, row] * min(load, rows[DEMAND, row] - rows[LOAD, row])


@compiled
def lost(rows: Any, row: int, load: Any) -> Any:
    """Weighted deficit that a row has when a load leaves it."""
    spare = rows[LOAD, row] - rows[DEMAND, row]
    return rows[WEIGHT, row] * (load - max(spare, 0)) if spare < load else 0


@compiled
def draw(random: Any, count: int) -> Any:
    """A random number from 0 to count - 1 (SplitMix64; Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195)."""
    random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return np.int64(((z >> np.uint64(32)) * np.uint64(count)) >> np.uint64(32))


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
    rows, columns, column_start, numbers, random = s.rows, s.columns, s.column_start, s.numbers, s.random
    best, least, least_cost, stamp = -1, 0.0, 1.0, 0
    priced, once, loads = numbers[PRICED] > 0, numbers[ONCE] > 0, len(s.column_load) > 0
    size = numbers[MEMBERS]
    looked_at = size if size <= MANY else SAMPLE
    if looked_at == size:
        numbers[WORK] += MEMBER_WORK * min(size, FEW) + NEXT_MEMBER_WORK * max(size - FEW, 0)
    else:
        numbers[WORK] += DRAWN_MEMBER_WORK * looked_at
    for k in range(looked_at):
        position = k if looked_at == size else draw(random, size)
        column = columns[MEMBER, position]
        if (column == tabu and size > 1) or (parts > 0 and columns[FIXED, column]):
            continue
        if tenure > 0 and columns[STAMP, column] > 0 and numbers[MOVES] - columns[STAMP, column] < tenure:
            continue
        weighted = columns[LOSS, column]
        if not once:
            weighted = 0
            for entry in range(column_start[column], column_start[column + 1]):
                load = np.int64(s.column_load[entry]) if loads else np.int64(1)
                weighted += lost(rows, s.column_rows[entry], load)
            numbers[WORK] += ENTRY_WORK * (column_start[column + 1] - column_start[column])
        loss, cost = float(weighted), 1.0
        if parts > 0:
            loss += float(numbers[PARTS] * (label(s, position, OTHERS) - parts))
        if priced:
            cost = float(price(columns, s.groups, column, IN))
        difference = loss * least_cost - least * cost
        if best < 0 or difference < 0 or (difference == 0 and columns[STAMP, column] < stamp):
            best, least, least_cost, stamp = column, loss, cost, columns[STAMP, column]
    if best < 0 and size > 0 and not columns[FIXED, columns[MEMBER, 0]]:
        best = columns[MEMBER, 0]
    return best


@compiled
def entering(s: State, row: int, left: int, parts: int, tenure: int, sample: int) -> Any:
    """Column outside with the largest gain for its price, oldest first; -1 where none may enter.

    Args:
        s: the search.
        row: only its columns; -1: any.
        left: column that has just left.
        parts: of the graph, whose labels are in place; 0 where there is none.
        tenure: moves that a column stays out for; 0: none but the one that has just left.
        sample: columns of the row that are drawn where it has more.
    """
    rows, columns, numbers, random = s.rows, s.columns, s.numbers, s.random
    column_start, column_rows, column_load, bits = s.column_start, s.column_rows, s.column_load, s.bits
    first, last = (s.row_start[row], s.row_start[row + 1]) if row >= 0 else (0, columns.shape[1])
    count, size, n_open = last - first, numbers[MEMBERS], numbers[OPEN]
    sampled = row >= 0 and count > sample and parts == 0
    best, most, most_cost, stamp = -1, 0.0, 1.0, 0
    priced, loads, touched = numbers[PRICED] > 0, len(column_load) > 0, 0
    for part in range(parts):
        columns[SEEN, part] = 0  # which column last found each part
    for k in range(sample if sampled else count):
        at = first + (draw(random, count) if sampled else k)
        column: Any = np.int64(s.row_columns[at]) if row >= 0 else at
        if columns[PLACE, column] >= 0 or column == left:
            continue
        if tenure > 0 and columns[STAMP, column] > 0 and numbers[MOVES] - columns[STAMP, column] < tenure:
            continue
        begin, end, weighted = column_start[column], column_start[column + 1], 0
        if len(bits) > 0 and n_open < end - begin:
            for position in range(n_open):
                other = rows[OPEN_ROW, position]
                if (bits[column, other >> 6] >> np.uint64(other & 63)) & np.uint64(1):
                    weighted += rows[WEIGHT, other]
            touched += BIT_WORK * n_open
        else:
            for entry in range(begin, end):
                if loads:
                    weighted += brought(rows, column_rows[entry], np.int64(column_load[entry]))
                else:
                    weighted += rows[OPEN_WEIGHT, column_rows[entry]]
            touched += ENTRY_WORK * (end - begin)
        gain, cost = float(weighted), 1.0
        if parts > 1:
            joined = 0
            for position in range(size):
                part = columns[LABEL, position]
                if columns[SEEN, part] != column + 1 and s.adjacent[column, columns[MEMBER, position]] == 1:
                    columns[SEEN, part] = column + 1
                    joined += 1
            gain += float(numbers[PARTS] * (joined - 1))
        if priced:
            cost = float(price(columns, s.groups, column, NEVER))
        difference = gain * most_cost - most * cost
        if best < 0 or difference > 0 or (difference == 0 and columns[STAMP, column] < stamp):
            best, most, most_cost, stamp = column, gain, cost, columns[STAMP, column]
    looked_at = sample if sampled else count
    looking = DRAWN_CANDIDATE_WORK if sampled else CANDIDATE_WORK * (1 + (size if parts > 1 else 0))
    numbers[WORK] += touched + looking * looked_at
    return best


@compiled
def met(numbers: Any, full: bool, parts: int) -> Any:
    """Whether the choice has what is asked for, and hangs together."""
    return (numbers[OPEN] == 0 if full else numbers[MISSING] <= numbers[ALLOWED]) and parts <= 1


@compiled
def keep(numbers: Any, columns: Any, most: bool) -> None:
    """The choice is the best one; the next has to be better."""
    numbers[BEST], numbers[BEST_MEMBERS] = numbers[MISSING] if most else numbers[SPENT], numbers[MEMBERS]
    for position in range(numbers[MEMBERS]):
        columns[BEST_MEMBER, position] = columns[MEMBER, position]
    if most:
        numbers[ALLOWED] = numbers[MISSING] - 1
    else:
        numbers[LIMIT] = numbers[SPENT] - 1


@compiled
def steps(s: State, full: bool, most: bool, target: int, tenures: int, work_limit: int) -> Any:
    """Steps of the search, until the work is done or the objective is at most the target.

    Args:
        s: the search.
        full: every row must be satisfied: open rows gain weight.
        most: the number of columns is given, and open units count.
        target: objective at which the search ends.
        tenures: longest time that a moved column is kept from moving back; 0: it may at once.
        work_limit: work that may be done.

    Returns:
        Work done; -1 where no column may leave.
    """
    numbers = s.numbers
    graph = len(s.adjacent) > 0
    looked_at: Any = np.int64(SAMPLE if full else s.columns.shape[1])
    numbers[WORK] = 0
    for position in range(numbers[FIRST_MEMBERS]):
        move(s, s.columns[STACK, position], IN)
        s.columns[STAMP, s.columns[STACK, position]] = 0
    numbers[FIRST_MEMBERS] = 0
    while numbers[WORK] < 4 * work_limit:
        parts = label(s, NONE, ALL) if graph else 0
        while met(numbers, full, parts):
            keep(numbers, s.columns, most)
            if numbers[BEST] <= target:
                return numbers[WORK] // 4
            if most:
                break
            out = leaving(s, NONE, parts, NEVER)
            if out < 0:
                return numbers[WORK] // 4
            move(s, out, OUT)
            parts = label(s, NONE, ALL) if graph else 0
        numbers[STEPS] += 1
        numbers[WORK] += 2 * numbers[MEMBERS] ** 2 * (numbers[MEMBERS] + 1) if graph else 0
        tenure = draw(s.random, tenures) + 2 if tenures > 0 else 0
        out = leaving(s, numbers[TABU], parts, min(tenure // 2, numbers[MEMBERS]))
        if out < 0:
            return -1
        move(s, out, OUT)
        while True:
            parts = label(s, NONE, ALL) if graph else 0
            if met(numbers, full, parts) or numbers[SPENT] + numbers[CHEAPEST] > numbers[LIMIT]:
                break
            aimed = numbers[OPEN] > 0 and not (graph and draw(s.random, TEN) < 3)
            row: Any = s.rows[OPEN_ROW, draw(s.random, numbers[OPEN])] if aimed else np.int64(-1)
            column = entering(s, row, out, parts, tenure, looked_at)
            if column < 0 and aimed and not full:
                column = entering(s, NONE, out, parts, tenure, looked_at)
            if column < 0:
                break
            if numbers[SPENT] + price(s.columns, s.groups, column, NEVER) > numbers[LIMIT]:
                break
            move(s, column, IN)
            numbers[TABU] = column
        if full:
            for position in range(numbers[OPEN]):
                s.rows[WEIGHT, s.rows[OPEN_ROW, position]] += 1
                s.rows[OPEN_WEIGHT, s.rows[OPEN_ROW, position]] += 1
            numbers[WORK] += ENTRY_WORK * numbers[OPEN]
        if graph:
            many = label(s, NONE, ALL) > 1
            weight = numbers[PARTS]
            numbers[PARTS] = weight + weight // 20 + 1 if many else max(weight - weight // 50, 1)
    return numbers[WORK] // 4
