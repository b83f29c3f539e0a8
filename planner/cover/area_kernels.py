"""Compiled loops of the search for the most area with a given number of columns: tabu search over swaps.

Whole numbers throughout (units of `planner.cover.canonical`), so that gains are exact and a run is the same everywhere.
"""

import numpy as np

from planner.compiled import compiled
from planner.values import Ints


@compiled
def add(column_start: Ints, column_rows: Ints, row_start: Ints, row_columns: Ints, units: Ints, counts: Ints,
        gains: Ints, column: int) -> int:  # fmt: skip
    """Take a column into the selection: counts of its rows rise, gains of the other columns fall; the units it adds."""
    added = 0
    for e in range(column_start[column], column_start[column + 1]):
        row = column_rows[e]
        counts[row] += 1
        if counts[row] == 1:
            added += units[row]
            for f in range(row_start[row], row_start[row + 1]):
                gains[row_columns[f]] -= units[row]
    return added


@compiled
def remove(column_start: Ints, column_rows: Ints, row_start: Ints, row_columns: Ints, units: Ints, counts: Ints,
           gains: Ints, column: int) -> int:  # fmt: skip
    """Take a column out of the selection; the units that are lost."""
    lost = 0
    for e in range(column_start[column], column_start[column + 1]):
        row = column_rows[e]
        counts[row] -= 1
        if counts[row] == 0:
            lost += units[row]
            for f in range(row_start[row], row_start[row + 1]):
                gains[row_columns[f]] += units[row]
    return lost


@compiled
def swap_search(column_start: Ints, column_rows: Ints, row_start: Ints, row_columns: Ints, units: Ints, chosen: Ints,
                counts: Ints, gains: Ints, tabu_until: Ints, best: Ints, tenures: Ints, area: int, best_area: int,
                step: int, last_step: int, work_limit: int) -> tuple[int, int, int, int]:  # fmt: skip
    """Always make the best swap that is not tabu, also where it loses area; keep the best selection.

    What left may not return, and what entered may not leave, for some steps (Glover 1989, doi:10.1287/ijoc.1.3.190),
    unless the swap beats the best selection.

    Args:
        column_start: with `column_rows` the rows of each column.
        column_rows: see there.
        row_start: with `row_columns` the columns of each row.
        row_columns: see there.
        units: (S,) of each row.
        chosen: (k,) the selection; changed in place, like all that follows.
        counts: (S,) columns of the selection that cover each row.
        gains: (V,) units that each column would add.
        tabu_until: (V,) step until which a column may not move.
        best: (k,) receives the best selection.
        tenures: steps that moved columns stay tabu, used in turn.
        area: units that the selection covers.
        best_area: units of the best one so far.
        step: number of the first step.
        last_step: number at which the search ends.
        work_limit: entries that may be touched.

    Returns:
        The area, the best area, the next step's number and the entries touched.
    """
    V = len(column_start) - 1
    inside = np.zeros(V, dtype=np.bool_)
    for column in chosen:
        inside[column] = True
    shared = np.zeros(V, dtype=np.int64)
    work = 0
    while step < last_step and work < work_limit:
        top, leaving, entering = np.int64(-(2**62)), -1, -1
        for position in range(len(chosen)):
            out = chosen[position]
            shared[:] = 0
            loss = 0
            for e in range(column_start[out], column_start[out + 1]):
                row = column_rows[e]
                if counts[row] == 1:
                    loss += units[row]
                    for f in range(row_start[row], row_start[row + 1]):
                        shared[row_columns[f]] += units[row]
                    work += row_start[row + 1] - row_start[row]
            work += V
            for column in range(V):
                if inside[column]:
                    continue
                delta = gains[column] + shared[column] - loss
                tabu = tabu_until[column] > step or tabu_until[out] > step
                if delta > top and (not tabu or area + delta > best_area):
                    top, leaving, entering = delta, position, column
        if leaving < 0:  # everything is tabu
            step += 1
            work += V
            continue
        out = chosen[leaving]
        area -= remove(column_start, column_rows, row_start, row_columns, units, counts, gains, out)
        area += add(column_start, column_rows, row_start, row_columns, units, counts, gains, entering)
        chosen[leaving] = entering
        inside[out], inside[entering] = False, True
        tenure = tenures[step % len(tenures)]
        tabu_until[out] = step + 1 + tenure
        tabu_until[entering] = step + 1 + tenure // 2
        step += 1
        if area > best_area:
            best_area = area
            best[:] = chosen
    return area, best_area, step, work
