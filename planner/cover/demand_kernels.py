"""Compiled loops of the search over covers with demands, with or without a graph that must hold together.

Whole numbers throughout, so that gains are exact and a run is the same everywhere.
"""

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.values import Floats, Ints

Bytes = NDArray[np.uint8]


@compiled
def move(row_start: Ints, row_columns: Ints, row_load: Ints, column_start: Ints, column_rows: Ints, column_load: Ints,
         demand: Ints, weights: Ints, load: Ints, gains: Ints, column: int, sign: int) -> int:  # fmt: skip
    """Add (sign 1) or remove (-1) a column: loads and gains follow; the entries touched.

    A column's gain is the weighted deficit that it would take away: sum of w_i min(load_ij, deficit_i).
    """
    work = 0
    for e in range(column_start[column], column_start[column + 1]):
        row = column_rows[e]
        before = max(demand[row] - load[row], 0)
        load[row] += sign * column_load[e]
        after = max(demand[row] - load[row], 0)
        if before != after:
            for f in range(row_start[row], row_start[row + 1]):
                brings = row_load[f]
                gains[row_columns[f]] += weights[row] * (min(brings, after) - min(brings, before))
            work += row_start[row + 1] - row_start[row]
    return work


@compiled
def label(adjacent: Bytes, chosen: Ints, size: int, without: int, labels: Ints) -> int:
    """Number the parts of the graph of chosen columns that hang together; how many there are.

    Args:
        adjacent: (V, V) 1 where two columns are joined.
        chosen: the columns; the first `size` count.
        size: see there.
        without: position that is left out; -1 for none. Its label is -1.
        labels: receives the part of each position.
    """
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
            at = chosen[stack[depth]]
            for other in range(size):
                if other != without and labels[other] < 0 and adjacent[at, chosen[other]] == 1:
                    labels[other] = parts
                    stack[depth] = other
                    depth += 1
        parts += 1
    return parts


@compiled
def loss_of(column_start: Ints, column_rows: Ints, column_load: Ints, demand: Ints, weights: Ints, load: Ints,
            column: int) -> int:  # fmt: skip
    """The weighted deficit that removing a column would make."""
    loss = 0
    for e in range(column_start[column], column_start[column + 1]):
        row = column_rows[e]
        before = max(demand[row] - load[row], 0)
        loss += weights[row] * (max(demand[row] - load[row] + column_load[e], 0) - before)
    return loss


@compiled
def search(row_start: Ints, row_columns: Ints, row_load: Ints, column_start: Ints, column_rows: Ints,
           column_load: Ints, demand: Ints, units: Ints, growth: Ints, weights: Ints, slack: int, full: bool,
           adjacent: Bytes, fixed: Bytes, chosen: Ints, size: int, load: Ints, gains: Ints, stamps: Ints, best: Ints,
           draws: Floats, state: Ints, work_limit: int) -> tuple[int, int, int]:  # fmt: skip
    """One column leaves, one enters, what stays open gains weight; a selection that meets everything loses a column.

    Ends when a better selection is found (the caller keeps it), when the draws or the work are used up, or when no
    column may leave (0 entries touched then).

    Args:
        row_start: with `row_columns` and `row_load` the rows.
        row_columns: see there.
        row_load: see there.
        column_start: with `column_rows` and `column_load` the columns.
        column_rows: see there.
        column_load: see there.
        demand: (S,).
        units: (S,).
        growth: (S,) what a row's weight gains when it stays open.
        weights: (S,) of the rows; changed in place, like all that follows `fixed`.
        slack: units that may stay open.
        full: whether any row may stay open.
        adjacent: (V, V) joined columns; (0, 0) where no graph has to hold together.
        fixed: (V,) 1 for columns that may not leave.
        chosen: (V + 1,) the selection in the first `size` places.
        size: of the selection.
        load: (S,).
        gains: (V,).
        stamps: (V,) step in which a column last moved.
        best: (V + 1,) receives a better selection.
        draws: random numbers, one for each step.
        state: [step, weight of a part too many, tabu column] between calls.
        work_limit: entries that may be touched.

    Returns:
        The selection's size, the size of the better selection (-1: none), the entries touched.
    """
    V = len(column_start) - 1
    graph = len(adjacent) > 0
    labels = np.zeros(V + 1, dtype=np.int64)
    scratch = np.zeros(V + 1, dtype=np.int64)
    seen = np.zeros(V + 1, dtype=np.int64)
    inside = np.zeros(V, dtype=np.bool_)
    open_rows = np.empty(len(demand), dtype=np.int64)
    for position in range(size):
        inside[chosen[position]] = True
    work, draw = 0, 0
    while draw < len(draws) and work < work_limit:
        state[0] += 1
        step = state[0]
        work += 500  # of a step, whatever it touches
        n_open, missing = 0, 0
        for row in range(len(demand)):
            if load[row] < demand[row]:
                open_rows[n_open] = row
                n_open += 1
                missing += units[row]
        work += len(demand)
        parts = label(adjacent, chosen, size, -1, labels) if graph else 1
        meets = n_open == 0 if full else missing <= slack
        if meets and parts <= 1:
            best[:size] = chosen[:size]
            return size, size, work
        # What leaves: the least weighted loss, parts included; the one that moved longest ago among equals.
        leaving, least, oldest = -1, 2**62, 2**62
        for position in range(size):
            column = chosen[position]
            if fixed[column] == 1:
                continue
            loss = loss_of(column_start, column_rows, column_load, demand, weights, load, column)
            work += column_start[column + 1] - column_start[column]
            if graph:
                loss += state[1] * (label(adjacent, chosen, size, position, scratch) - parts)
                work += size * size
            if column == state[2]:  # what entered last leaves only where nothing else may
                loss = 2**61
            if loss < least or (loss == least and stamps[column] < oldest):
                leaving, least, oldest = position, loss, stamps[column]
        if leaving < 0:
            return size, -1, 0
        left = chosen[leaving]
        work += move(row_start, row_columns, row_load, column_start, column_rows, column_load, demand, weights, load,
                     gains, left, -1)  # fmt: skip
        inside[left] = False
        chosen[leaving] = chosen[size - 1]
        size -= 1
        stamps[left] = step
        # What enters: the largest gain, parts that it joins included; where all must be covered, of a drawn open row.
        n_open = 0
        for row in range(len(demand)):
            if load[row] < demand[row]:
                open_rows[n_open] = row
                n_open += 1
        work += len(demand)
        parts = label(adjacent, chosen, size, -1, labels) if graph else 1
        tells = full or (draws[draw] * 8191.0) % 1.0 < 0.3  # now and then also where any column might do
        drawn = open_rows[int(draws[draw] * n_open)] if n_open > 0 and tells else -1
        draw += 1
        first, last = (row_start[drawn], row_start[drawn + 1]) if drawn >= 0 else (0, V)
        entering, most, oldest = -1, -(2**62), 2**62
        for place in range(first, last):
            column = row_columns[place] if drawn >= 0 else place
            if inside[column] or (column == left and last - first > 1):
                continue
            gain = gains[column]
            if graph:
                joined = 0
                for position in range(size):
                    part = labels[position]
                    if seen[part] != step * (V + 1) + column and adjacent[column, chosen[position]] == 1:
                        seen[part] = step * (V + 1) + column
                        joined += 1
                gain += state[1] * (joined - 1)
                work += size
            if gain > most or (gain == most and stamps[column] < oldest):
                entering, most, oldest = column, gain, stamps[column]
        work += last - first
        if entering < 0:
            entering = left
        work += move(row_start, row_columns, row_load, column_start, column_rows, column_load, demand, weights, load,
                     gains, entering, 1)  # fmt: skip
        inside[entering] = True
        chosen[size] = entering
        size += 1
        stamps[entering] = step
        state[2] = entering
        # What is still open gains weight: all rows where all are required, else one drawn row.
        n_open, missing = 0, 0
        for row in range(len(demand)):
            if load[row] < demand[row]:
                open_rows[n_open] = row
                n_open += 1
                missing += units[row]
        if full or missing > slack:
            chance = int((draws[draw - 1] * 7919.0) % 1.0 * n_open)
            for k in range(n_open):
                if not full and k != chance:
                    continue
                row = open_rows[k]
                deficit = demand[row] - load[row]
                for f in range(row_start[row], row_start[row + 1]):
                    gains[row_columns[f]] += growth[row] * min(row_load[f], deficit)
                weights[row] += growth[row]
                work += row_start[row + 1] - row_start[row]
        if graph and label(adjacent, chosen, size, -1, labels) > 1:
            state[1] += max(state[1] // 20, 1)
        elif graph:
            state[1] = max(state[1] - state[1] // 50, 1)
    return size, -1, work
