"""Compiled loops of `planner.cover.tree`: nodes of the tree, their bounds, and the way down and up.

A node holds what its columns that are in leave open: rows, columns with their rows, how many more may come in. Its
children are written behind it into the same arrays, so that what a node costs falls with what it still holds. One pass
over its entries is a step: the columns' sums of multipliers, the largest of them, the bound, columns that are out by
it, the rows that the largest leave open, a move of the multipliers.
"""

from typing import Any, NamedTuple

import numpy as np

from planner.compiled import compiled

MARGIN = 1e-9
"""Share of what is summed that a bound has to exceed what is allowed by: far above the float error of the sums."""

ROOT_STEPS, FIRST_STEPS, STEPS = 200, 30, 8
"""Steps of the multipliers at the root, in a node that is new, and after a column was taken from it."""

DEFLECTION, SHRINK, SHORTEST, PROGRESS, BEYOND = 0.5, 0.7, 0.1, 1e-4, 0.01
"""Share of the direction before in the next (with 0.3 trees are twice as large, with 0.8 ten times). What is left of a
step's length where the bound did not grow by the share `PROGRESS` of what it lacks; below the third steps end. How far
beyond what is allowed a step aims, as a share of the mean sum of a chosen column."""

COLUMN_WORK, ROW_WORK, STEP_WORK = 8, 6, 50
"""Charge of each column and row in a step, and of the step; an entry is 1."""

GOES_ON, NONE, FOUND, FULL = range(4)
"""How `grow` ended: work is done; no choice leaves as little open as is allowed; a choice does; arrays are full."""

LEVEL, WORK, ALLOWED, CHOSEN = range(4)
"""Numbers of a tree: the node's level (-1 at the end), work done, units that may stay open, how many of `Tree.top` the
choice has that was found: they and what is in."""

ROWS, COLUMNS, LEFT, FIRST_ROW, FIRST_COLUMN, FIRST_ENTRY, VISITS, TAKEN = range(8)
"""Fields of a level: rows and columns of its node, columns that may still come in, where each of the three begins in
its array, how often it was looked at, the column that its child has in."""

UNITS, MULTIPLIER = range(2)
"""Fields of a row: what it counts while it is open; u."""

ID, BEGIN, END = range(3)
"""Fields of a column: its number at the root; where its entries are."""

FIRST: Any = np.int64(0)  # typed, since numba would compile a kernel anew for a literal


class Tree(NamedTuple):
    """Everything that is carried from one call to the next."""

    numbers: Any  # (4,)
    levels: Any  # (fields, levels)
    rows: Any  # (2, R) float64
    columns: Any  # (3, C)
    entries: Any  # (E,) row of the node, from 0
    value: Any  # (columns of the root,) float64: sum of the multipliers
    direction: Any  # (rows of the root,) float64
    count: Any  # (rows of the root,)
    top: Any  # (columns that may come in,) columns of the node with the largest sums, the largest first


@compiled
def summed(t: Tree, level: int) -> int:
    """The columns' sums of multipliers, and the largest of them: how many these are."""
    levels, columns, entries, value, top = t.levels, t.columns, t.entries, t.value, t.top
    r0, c0 = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level]
    u = t.rows[MULTIPLIER, r0 : r0 + levels[ROWS, level]]
    n, n_top, touched = levels[COLUMNS, level], 0, 0
    most = min(levels[LEFT, level], n)
    for c in range(n):
        begin, end, total = columns[BEGIN, c0 + c], columns[END, c0 + c], 0.0
        for row in entries[begin:end]:
            total += u[row]
        touched += end - begin
        value[c] = total
        if n_top == most and total <= value[top[n_top - 1]]:
            continue
        at = n_top if n_top < most else n_top - 1
        n_top = at + 1
        touched += at
        while at > 0 and value[top[at - 1]] < total:
            top[at] = top[at - 1]
            at -= 1
        top[at] = c
        touched -= at
    t.numbers[WORK] += touched + COLUMN_WORK * n + ROW_WORK * levels[ROWS, level] + STEP_WORK
    return n_top


@compiled
def swap_out(t: Tree, level: int, c: int) -> None:
    """A column of a node is out: the last one takes its place."""
    a, columns = t.levels[FIRST_COLUMN, level], t.columns
    t.levels[COLUMNS, level] -= 1
    last = t.levels[COLUMNS, level]
    for field in range(3):
        columns[field, a + c], columns[field, a + last] = columns[field, a + last], columns[field, a + c]
    t.value[c] = t.value[last]


@compiled
def bounded(t: Tree, level: int, steps: int) -> int:
    """Move the multipliers of a node until it holds nothing (`NONE`), a choice is found, or steps are done."""
    levels, columns, entries, count, direction = t.levels, t.columns, t.entries, t.count, t.direction
    units, u, allowed = t.rows[UNITS], t.rows[MULTIPLIER], float(t.numbers[ALLOWED])
    r0, c0 = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level]
    n_rows, left = levels[ROWS, level], levels[LEFT, level]
    best, length = -np.inf, 1.0
    for i in range(n_rows):
        direction[i] = 0.0
        if left == 1:  # exact then
            u[r0 + i] = units[r0 + i]
    for _ in range(steps):
        n_top = summed(t, level)
        total, n = 0.0, levels[COLUMNS, level]
        for i in range(n_rows):
            total += u[r0 + i]
            count[i] = 0
        bound = total
        for k in range(n_top):
            c = t.top[k]
            bound -= t.value[c]
            for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
                count[entries[e]] += 1
        margin = MARGIN * (total + allowed)
        if bound > allowed + margin:
            return NONE
        still = 0.0
        for i in range(n_rows):
            if count[i] == 0:
                still += units[r0 + i]
        if still <= allowed:
            t.numbers[CHOSEN] = n_top
            return FOUND
        if left == 1 or n <= left:
            return NONE
        least = bound + t.value[t.top[n_top - 1]] - allowed - margin
        c = FIRST
        while c < levels[COLUMNS, level]:
            if t.value[c] < least:
                swap_out(t, level, c)
            else:
                c += 1
        if bound > best + PROGRESS * abs(allowed - bound):
            best = bound
        else:
            length *= SHRINK
            if length < SHORTEST:
                break
        norm = 0.0
        for i in range(n_rows):
            d = (1.0 - DEFLECTION) * (1.0 - count[i]) + DEFLECTION * direction[i]
            direction[i] = d
            at, unit = u[r0 + i], units[r0 + i]
            if not ((at <= 0.0 and d < 0.0) or (at >= unit and unit <= allowed and d > 0.0)):
                norm += d * d * unit * unit
        if norm == 0.0:
            break
        step = length * (allowed + BEYOND * total / left - bound) / norm
        for i in range(n_rows):
            unit = units[r0 + i]
            to = max(u[r0 + i] + step * direction[i] * unit * unit, 0.0)
            u[r0 + i] = min(to, unit) if unit <= allowed else to
    return GOES_ON


@compiled
def branching(t: Tree, level: int) -> int:
    """The column to be put in: of the row that must not stay open and has the fewest, that of the largest sum.

    Where all rows may stay open, the one of the largest sum; -1 where such a row has none. Sums are made anew: by those
    before the last move trees on measurability matrices are twice as large.
    """
    levels, columns, entries, count, value = t.levels, t.columns, t.entries, t.count, t.value
    r0, c0, n = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level], levels[COLUMNS, level]
    units, u = t.rows[UNITS], t.rows[MULTIPLIER]
    row = -1
    for i in range(levels[ROWS, level]):
        count[i] = 0
    for c in range(n):
        for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
            count[entries[e]] += 1
    for i in range(levels[ROWS, level]):
        if units[r0 + i] > t.numbers[ALLOWED] and (
            row < 0 or count[i] < count[row] or (count[i] == count[row] and u[r0 + i] > u[r0 + row])
        ):
            row = i
    if row >= 0 and count[row] == 0:
        return -1
    summed(t, level)
    best = -1
    for c in range(n):
        if best >= 0 and value[c] <= value[best]:
            continue
        inside = row < 0
        for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
            inside = inside or entries[e] == row
        if inside:
            best = c
    return best


@compiled
def descend(t: Tree, level: int, c: int) -> bool:
    """Write the node in which a column is in behind the one that it leaves for good; False where no room is left."""
    levels, columns, entries, place = t.levels, t.columns, t.entries, t.count
    r0, c0, n_rows = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level], levels[ROWS, level]
    r1, c1, e1 = levels[FIRST_ROW, level + 1], levels[FIRST_COLUMN, level + 1], levels[FIRST_ENTRY, level + 1]
    size = 0
    for q in range(levels[COLUMNS, level]):
        size += columns[END, c0 + q] - columns[BEGIN, c0 + q]
    room = min(t.rows.shape[1] - r1 - n_rows, columns.shape[1] - c1 - levels[COLUMNS, level], len(entries) - e1 - size)
    if room < 0:
        return False
    levels[TAKEN, level] = columns[ID, c0 + c]
    for i in range(n_rows):
        place[i] = 0
    for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
        place[entries[e]] = -1
    fresh = 0
    for i in range(n_rows):
        if place[i] == 0:
            place[i] = fresh
            for field in range(2):
                t.rows[field, r1 + fresh] = t.rows[field, r0 + i]
            fresh += 1
    swap_out(t, level, c)
    n, at = 0, e1
    for q in range(c0, c0 + levels[COLUMNS, level]):
        begin = at
        for e in range(columns[BEGIN, q], columns[END, q]):
            row = place[entries[e]]
            if row >= 0:
                entries[at] = row
                at += 1
        if at > begin:
            columns[ID, c1 + n], columns[BEGIN, c1 + n], columns[END, c1 + n] = columns[ID, q], begin, at
            n += 1
    t.numbers[WORK] += 2 * size
    levels[ROWS, level + 1], levels[COLUMNS, level + 1] = fresh, n
    levels[LEFT, level + 1], levels[VISITS, level + 1] = levels[LEFT, level] - 1, 0
    below = level + 2
    levels[FIRST_ROW, below], levels[FIRST_COLUMN, below], levels[FIRST_ENTRY, below] = r1 + fresh, c1 + n, at
    return True


@compiled
def grow(t: Tree, work_limit: int) -> int:
    """Go on with a tree, depth first, until the work is done or it ends."""
    numbers, levels = t.numbers, t.levels
    numbers[WORK] = 0
    while numbers[LEVEL] >= 0:
        if numbers[WORK] > work_limit:
            return GOES_ON
        level = numbers[LEVEL]
        still, r0 = 0.0, levels[FIRST_ROW, level]
        for i in range(levels[ROWS, level]):
            still += t.rows[UNITS, r0 + i]
        if still <= float(numbers[ALLOWED]):
            numbers[CHOSEN] = 0
            return FOUND
        ended, c = NONE, -1
        if levels[LEFT, level] > 0 and levels[COLUMNS, level] > 0:
            visits = levels[VISITS, level]
            ended = bounded(t, level, STEPS if visits else FIRST_STEPS if level else ROOT_STEPS)
        if ended == FOUND:
            return FOUND
        if ended == GOES_ON and levels[COLUMNS, level] > 0:
            c = branching(t, level)
        if c < 0:
            numbers[LEVEL] -= 1
            continue
        if not descend(t, level, c):
            return FULL
        levels[VISITS, level] = 1
        numbers[LEVEL] += 1
    return NONE
