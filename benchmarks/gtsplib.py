"""Reader of generalised travelling salesman files: TSPLIB 95 with a GTSP_SET_SECTION.

Distances follow Reinelt, TSPLIB 95 (Heidelberg, 1995): EUC_2D, CEIL_2D, MAN_2D, MAX_2D, GEO, ATT and EXPLICIT matrices.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.values import Floats, Ints

_PI = 3.141592  # value of TSPLIB, on which its distances depend


@dataclass(frozen=True, slots=True, eq=False)
class Gtsp:
    """A file.

    Attributes:
        name: name in the file.
        cost: (N, N) integer costs.
        sets: node numbers from 0, cluster by cluster.
    """

    name: str
    cost: Floats
    sets: list[Ints]

    def sorted_by_cluster(self) -> tuple[Floats, Ints]:
        """Return the costs with nodes numbered cluster by cluster, and (m + 1,) first node of each cluster."""
        nodes = np.concatenate(self.sets)
        return np.ascontiguousarray(self.cost[np.ix_(nodes, nodes)]), np.cumsum([0, *map(len, self.sets)])


def read(path: Path) -> Gtsp:
    """Read a file.

    Raises:
        ValueError: if the file is invalid; it names the file and the fault.
    """
    header, sections = _split(path.read_text(encoding="ascii"))
    n = int(header["DIMENSION"])
    kind = header["EDGE_WEIGHT_TYPE"]
    if kind == "EXPLICIT":
        weights = np.array(sections["EDGE_WEIGHT_SECTION"], dtype=float)
        cost = _matrix(weights, n, header.get("EDGE_WEIGHT_FORMAT", "FULL_MATRIX"))
    else:
        rows = np.array(sections["NODE_COORD_SECTION"], dtype=float).reshape(n, 3)
        cost = _distances(rows[np.argsort(rows[:, 0], kind="stable"), 1:], kind)
    np.fill_diagonal(cost, 0.0)
    sets: list[list[int]] = [[]]
    numbers = [int(word) for word in sections["GTSP_SET_SECTION"]]
    is_name = True  # the number that follows is the name of a set
    for number in numbers:
        if is_name:
            is_name = False
        elif number == -1:
            sets.append([])
            is_name = True
        else:
            sets[-1].append(number - 1)
    found = [np.array(members, dtype=np.int64) for members in sets if members]
    if not np.array_equal(np.sort(np.concatenate(found)), np.arange(n)):
        raise ValueError(f"{path}: the sets must hold each of the {n} nodes once")
    if "GTSP_SETS" in header and int(header["GTSP_SETS"]) != len(found):
        raise ValueError(f"{path}: {len(found)} sets where GTSP_SETS says {header['GTSP_SETS']}")
    return Gtsp(header.get("NAME", path.stem), cost, found)


def _split(text: str) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Return keywords with their values, and sections with their words."""
    header: dict[str, str] = {}
    sections: dict[str, list[str]] = {}
    words: list[str] | None = None
    for line in text.splitlines():
        stripped = line.strip()
        if not stripped or stripped == "EOF":
            continue
        if stripped.split(":")[0].strip().endswith("_SECTION"):
            words = sections.setdefault(stripped.split(":")[0].strip(), [])
        elif ":" in stripped and stripped[0].isalpha():
            key, value = stripped.split(":", 1)
            header[key.strip()] = value.strip()
            words = None
        elif words is not None:
            words += stripped.split()
    return header, sections


def _distances(xy: Floats, kind: str) -> Floats:
    """Return integer distances between coordinates (N, 2)."""
    delta = np.abs(xy[:, None] - xy[None])
    if kind == "EUC_2D":
        return np.floor(np.hypot(delta[..., 0], delta[..., 1]) + 0.5)
    if kind == "CEIL_2D":
        return np.ceil(np.hypot(delta[..., 0], delta[..., 1]))
    if kind == "MAN_2D":
        return np.floor(delta.sum(axis=2) + 0.5)
    if kind == "MAX_2D":
        return np.floor(delta + 0.5).max(axis=2)
    if kind == "ATT":
        r = np.sqrt((delta**2).sum(axis=2) / 10.0)
        t = np.floor(r + 0.5)
        return np.where(t < r, t + 1.0, t)
    if kind == "GEO":
        degrees = np.trunc(xy)
        latitude, longitude = (_PI * (degrees + 5.0 * (xy - degrees) / 3.0) / 180.0).T
        q1 = np.cos(longitude[:, None] - longitude)
        q2, q3 = np.cos(latitude[:, None] - latitude), np.cos(latitude[:, None] + latitude)
        return np.floor(6378.388 * np.arccos(np.clip(0.5 * ((1 + q1) * q2 - (1 - q1) * q3), -1.0, 1.0)) + 1.0)
    raise ValueError(f"EDGE_WEIGHT_TYPE {kind} is not known")


def _matrix(weights: Floats, n: int, layout: str) -> Floats:
    """Return a symmetric matrix from one of the layouts of EXPLICIT weights."""
    cost = np.zeros((n, n))
    if layout == "FULL_MATRIX":
        return weights.reshape(n, n).copy()
    if layout in ("UPPER_ROW", "UPPER_DIAG_ROW"):
        rows, columns = np.triu_indices(n, 1 if layout == "UPPER_ROW" else 0)
    elif layout in ("LOWER_ROW", "LOWER_DIAG_ROW"):
        rows, columns = np.tril_indices(n, -1 if layout == "LOWER_ROW" else 0)
    else:
        raise ValueError(f"EDGE_WEIGHT_FORMAT {layout} is not known")
    cost[rows, columns] = weights
    return np.maximum(cost, cost.T)
