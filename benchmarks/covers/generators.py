"""Set-cover instances by their published construction, and random ones like the hard ones of the literature.

cyc9                    hypercube cycles (Grossman and Wool 1997, doi:10.1016/S0377-2217(96)00161-0)
clr12                   two-colourings (same source)
rail:500x20000:1        crew duties: rows are trips, a column is a chain of trips (seed 1)
uniform:1000x1000:0.05:1    each entry exists with this probability; an empty row gets one
caps:1000x1000:0.05:1   points on a sphere, covered by caps of this share of it
"""

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

_Ints = NDArray[np.int64]

_TRIPS = 12  # largest number in a duty, as in the rail files
_STATIONS, _LAYOVER = 12, 0.08  # longest wait for the next trip, as a share of the day
_BLOCK = 500  # rows that are drawn together


def cyc(n: int) -> tuple[Any, _Ints]:
    """Return the problem of the fewest edges of the n-cube on all its cycles of length four: scpcyc06 to scpcyc11.

    A row is a cycle, ordered by its lowest vertex, then by the larger and by the smaller of the bits that it flips. A
    column is an edge, ordered by its upper vertex, then by its lower one.

    Returns:
        (n (n - 1) 2^(n - 3), n 2^(n - 1)) csr_array of bool, and the costs, which are 1.
    """
    vertices = np.arange(2**n)
    edges = np.array([(v, v ^ 1 << bit) for v in vertices for bit in range(n) if v >> bit & 1])
    edges = edges[np.lexsort((edges[:, 1], edges[:, 0]))]
    number = {(int(upper), int(lower)): k for k, (upper, lower) in enumerate(edges)}
    rows = [
        sorted(number[pair] for pair in ((v | a, v), (v | b, v), (v | a | b, v | a), (v | a | b, v | b)))
        for v in vertices.tolist()
        for b in (1 << bit for bit in range(n))
        for a in (1 << bit for bit in range(n))
        if a < b and not v & (a | b)
    ]
    return _matrix(rows, len(edges)), np.ones(len(edges), dtype=np.int64)


def clr(n: int) -> tuple[Any, _Ints]:
    """Return the problem of the fewest 4-subsets of n points, one of a single colour in each two-colouring.

    A column is a subset in lexicographic order. Row r - 1 is the colouring in which the points of the ones of r, the
    last point being the lowest bit, have one colour; rows as in scpclr10 to scpclr13.

    Returns:
        (2^(n - 1) - 1, n choose 4) csr_array of bool, and the costs, which are 1.
    """
    subsets = np.array([sum(1 << n - 1 - point for point in subset) for subset in combinations(range(n), 4)])
    colourings = np.arange(1, 2 ** (n - 1))[:, None]
    shared = subsets & colourings
    return sp.csr_array((shared == 0) | (shared == subsets)), np.ones(len(subsets), dtype=np.int64)


def rail(n_trips: int, n_duties: int, rng: np.random.Generator) -> tuple[Any, _Ints]:
    """Return trips between stations during a day; a duty continues with a trip that leaves soon from its station.

    A duty that ends where it began costs 1, another 2, the two costs of the rail files; all duties differ.

    Returns:
        (n_trips, n_duties or fewer) csr_array of bool, and the costs.
    """
    leaves = np.sort(rng.uniform(0, 1, n_trips))
    arrives = leaves + rng.uniform(0.01, 0.05, n_trips)
    origin = rng.integers(0, _STATIONS, n_trips)
    target = (origin + rng.integers(1, _STATIONS, n_trips)) % _STATIONS
    after = [
        np.flatnonzero((origin == target[k]) & (leaves > arrives[k]) & (leaves < arrives[k] + _LAYOVER))
        for k in range(n_trips)
    ]
    duties = {(trip,): None for trip in range(n_trips)}
    for _ in range(4 * n_duties):
        if len(duties) >= n_duties:
            break
        duty = [int(rng.integers(n_trips))]
        while len(duty) < _TRIPS and len(after[duty[-1]]) and rng.random() < 0.88:
            duty.append(int(rng.choice(after[duty[-1]])))
        duties[tuple(duty)] = None
    costs = np.array([1 if origin[duty[0]] == target[duty[-1]] else 2 for duty in duties])
    return _matrix(list(duties), n_trips).T.tocsr(), costs


def uniform(n_rows: int, n_columns: int, density: float, rng: np.random.Generator) -> tuple[Any, _Ints]:
    """Return a matrix in which each entry exists with a probability; an empty row gets a random one."""
    counts = np.maximum(rng.binomial(n_columns, density, n_rows), 1)
    rows = [np.sort(rng.choice(n_columns, count, replace=False, shuffle=False)) for count in counts]
    return _matrix(rows, n_columns), np.ones(n_columns, dtype=np.int64)


def caps(n_rows: int, n_columns: int, density: float, rng: np.random.Generator) -> tuple[Any, _Ints]:
    """Return random points on a sphere; a column covers the points in a cap of the given share of the sphere."""
    points, centres = (_directions(count, rng) for count in (n_rows, n_columns))
    blocks = [
        sp.csr_array(points[at : at + _BLOCK] @ centres.T > 1.0 - 2.0 * density) for at in range(0, n_rows, _BLOCK)
    ]
    return sp.vstack(blocks, format="csr"), np.ones(n_columns, dtype=np.int64)


def generate(name: str) -> tuple[Any, _Ints] | None:
    """Return the instance of a name, see the docstring of this module; None for another name."""
    kind, *words = name.split(":")
    if kind[:3] in _BY_SIZE and kind[3:].isdecimal() and not words:
        return _BY_SIZE[kind[:3]](int(kind[3:]))
    if kind not in ("rail", "uniform", "caps"):
        return None
    sizes = [int(number) for number in words[0].split("x")]
    seed = np.random.default_rng(int(words[-1]))
    if kind == "rail":
        return rail(sizes[0], sizes[1], seed)
    return (uniform if kind == "uniform" else caps)(sizes[0], sizes[1], float(words[1]), seed)


_BY_SIZE: dict[str, Callable[[int], tuple[Any, _Ints]]] = {"cyc": cyc, "clr": clr}


def _directions(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _matrix(rows: Any, n_columns: int) -> Any:
    """Return the (len(rows), n_columns) csr_array of bool with the given columns of each row."""
    start = np.concatenate(([0], np.cumsum([len(row) for row in rows])))
    members = np.concatenate([np.asarray(row, dtype=np.int64) for row in rows])
    return sp.csr_array((np.ones(len(members), bool), members, start), shape=(len(rows), n_columns))
