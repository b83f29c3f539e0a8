"""Checks of a mesh: findings in sentences, and repairs that need no guess.

The checks use the topology and the unit of the mesh; they are vectorised (750,000 faces in about two seconds). A *body*
is a set of faces that are connected by edges.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from planner.geometry.mesh import cross_rows, face_cross_products, row_norms
from planner.values import Floats, Ints


class Severity(StrEnum):
    """Severity of a finding."""

    NOTE = "note"
    """Repaired, or harmless."""
    WARNING = "warning"
    """The result can be wrong, unless this is intended."""


class Kind(StrEnum):
    """Kind of a finding; the value is its name in reports."""

    ZERO_AREA = "zero_area_faces"
    DUPLICATE = "duplicate_faces"
    MIXED_WINDING = "mixed_winding"
    ONE_SIDED = "one_sided"
    INVERTED = "inverted"
    OPEN = "open"
    NON_MANIFOLD = "non_manifold"
    BODIES = "several_bodies"
    NO_SOLID = "no_solid"
    GAPS = "solids_with_gaps"
    OTHER_FILES = "other_files"
    HIDDEN = "hidden_bodies"
    COARSE = "coarse_triangles"
    UNITS = "units"
    FLAT = "flat"
    FAR = "far_from_origin"


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding about a mesh.

    Attributes:
        kind: kind of the finding.
        sentence: the fact, and the repair or the advice.
        severity: note or warning.
    """

    kind: Kind
    sentence: str
    severity: Severity


def repair(vertices: Floats, faces: Ints) -> tuple[Ints, Ints, tuple[Finding, ...]]:
    """Drop faces without area and duplicates, and make the winding consistent and outward.

    Args:
        vertices: (V, 3), equal ones merged.
        faces: (F, 3).

    Returns:
        The remaining faces (none if no face has an area), their indices in `faces`, and the findings in the order of
        the checks.
    """
    findings: list[Finding] = []
    remaining = np.flatnonzero(~is_collapsed(faces))
    n_collapsed = len(faces) - len(remaining)
    once = _unique_faces(faces[remaining])
    n_twice = len(remaining) - len(once)
    remaining = remaining[once]
    faces = faces[remaining]
    if len(faces):
        faces, more = _orient(vertices, faces)
        findings += more
        # Slivers are dropped last, since three different collinear corners still connect their neighbours.
        sliver = double_areas(vertices, faces) <= 1e-14 * float(np.ptp(vertices, axis=0).max()) ** 2
        faces, remaining, n_collapsed = faces[~sliver], remaining[~sliver], n_collapsed + int(sliver.sum())
    if n_twice:
        sentence = f"{_count(n_twice, 'face was', 'faces were')} duplicated; the copies were dropped"
        findings.insert(0, Finding(Kind.DUPLICATE, sentence, Severity.NOTE))
    if n_collapsed:
        sentence = f"{_count(n_collapsed, 'face has no area and was', 'faces have no area and were')} dropped"
        findings.insert(0, Finding(Kind.ZERO_AREA, sentence, Severity.NOTE))
    return faces, remaining, tuple(findings)


def is_collapsed(faces: Ints) -> NDArray[np.bool_]:
    """Return which faces (F,) have two equal corners."""
    return np.asarray((faces == np.roll(faces, 1, axis=1)).any(axis=1))


def _orient(vertices: Floats, faces: Ints) -> tuple[Ints, list[Finding]]:
    """Make the winding consistent and outward, and report findings about the edges."""
    edge, other, against, uses = adjacent_faces(faces)
    findings: list[Finding] = []
    flip, one_sided = _orienting_flips(len(faces), edge, other, against)
    body, n_bodies = label_bodies(len(faces), edge, other)
    # A body keeps the winding of the larger part of its area.
    areas = double_areas(vertices, faces)
    flipped = np.bincount(body, weights=areas * flip, minlength=n_bodies)
    total = np.bincount(body, weights=areas, minlength=n_bodies)
    flip ^= (flipped > total / 2)[body]
    if flip.any():
        sentence = f"{_count(int(flip.sum()), 'face was', 'faces were')} of opposite winding and flipped"
        findings.append(Finding(Kind.MIXED_WINDING, sentence, Severity.NOTE))
        faces = np.where(flip[:, None], faces[:, ::-1], faces)
    if one_sided:
        sentence = "the surface has only one side (like a Moebius strip), so inside and outside are arbitrary on it"
        findings.append(Finding(Kind.ONE_SIDED, sentence, Severity.WARNING))

    open_edges = int((uses == 1).sum())
    crowded_edges = round(float((1 / uses[uses > 2]).sum()))  # an edge of n faces occurs n times
    rim_of = np.zeros(n_bodies, bool)
    rim_of[body[(uses != 2).reshape(3, len(faces)).any(axis=0)]] = True
    volume = _body_volumes(vertices, faces, body, n_bodies)
    inverted = _find_inverted(vertices, faces, body, volume, closed=~rim_of)
    if inverted.any():
        n = int(inverted.sum())
        what = "the surface was" if n_bodies == 1 else _count(n, "body was", "bodies were")
        findings.append(Finding(Kind.INVERTED, f"{what} inside out (negative volume) and flipped", Severity.NOTE))
        faces = np.where(inverted[body][:, None], faces[:, ::-1], faces)
    if open_edges:
        sentence = (
            f"the surface is open ({_count(open_edges, 'border edge', 'border edges')}): "
            "the winding of its faces defines the outside"
        )
        findings.append(Finding(Kind.OPEN, sentence, Severity.WARNING))
        box = float(np.prod(np.ptp(vertices[faces.ravel()], axis=0)))
        if float(volume[rim_of].sum()) < -0.1 * box:
            sentence = "the open surface seems to be inside out; if most views miss it, flip its faces and try again"
            findings.append(Finding(Kind.INVERTED, sentence, Severity.WARNING))
    if crowded_edges:
        count = _count(crowded_edges, "edge belongs", "edges belong")
        sentence = f"{count} to more than two faces; bodies touch or intersect there"
        findings.append(Finding(Kind.NON_MANIFOLD, sentence, Severity.WARNING))
    if n_bodies > 1:
        sentence = f"the mesh consists of {n_bodies} separate bodies; all of them are scanned as one part"
        findings.append(Finding(Kind.BODIES, sentence, Severity.NOTE))
    return faces, findings


def _edge_keys(faces: Ints) -> Ints:
    """Return a number (3 F,) for the edge of each side, ordered by side (first-second, ...), then by face."""
    start, end = faces.T.ravel(), np.roll(faces, -1, axis=1).T.ravel()
    keys: Ints = np.minimum(start, end)
    keys *= int(faces.max()) + 1
    keys += np.maximum(start, end, out=end)  # `end` is a copy, `start` can be a view
    return keys


def adjacent_faces(faces: Ints) -> tuple[Ints, Ints, NDArray[np.bool_], Ints]:
    """Return the pairs of faces that share an edge with no third face.

    Returns:
        The two faces (P,) and (P,), whether they traverse the edge in the same direction (P,), which means opposite
        winding, and the number of faces at the edge of each side (3 F,), in the order of `_edge_keys`.
    """
    keys = _edge_keys(faces)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1]))
    count = np.diff(np.append(first, len(keys)))
    uses = np.full(len(keys), 2)
    if (count != 2).any():
        uses[order] = np.repeat(count, count)
    pair = first[count == 2]
    one, two = order[pair], order[pair + 1]
    start = faces.T.ravel()
    return one % len(faces), two % len(faces), start[one] == start[two], uses


def _orienting_flips(n_faces: int, one: Ints, two: Ints, against: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], bool]:
    """Return the faces to flip so that neighbours agree, and whether that is impossible for some body.

    Each face has two nodes, as it is and flipped; neighbours connect the nodes that agree. The component of a node then
    gives the winding of each face of the body. A component with both nodes of a face means a one-sided surface.
    """
    if not against.any():
        return np.zeros(n_faces, bool), False
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    shift = np.where(against, n_faces, 0)
    rows = np.concatenate([one, one + n_faces])
    columns = np.concatenate([two + shift, two + n_faces - shift])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n_faces, 2 * n_faces))
    label = connected_components(graph, directed=False)[1]
    as_is, flipped = label[:n_faces], label[n_faces:]
    return as_is > flipped, bool((as_is == flipped).any())


def label_bodies(n_faces: int, one: Ints, two: Ints) -> tuple[Ints, int]:
    """Return the body of each face (F,), and the number of bodies."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(one), np.int8), (one, two)), shape=(n_faces, n_faces))
    count, label = connected_components(graph, directed=False)
    return label.astype(np.int64), int(count)


def _body_volumes(vertices: Floats, faces: Ints, body: Ints, n_bodies: int) -> Floats:
    """Return the signed volumes (n_bodies,); an open body is closed towards the mean of its vertices."""
    a, b, c = (np.take(vertices, corner, axis=0) for corner in faces.T)
    counts = 3 * np.bincount(body, minlength=n_bodies)
    sums = [np.bincount(body, weights=axis, minlength=n_bodies) for axis in (a + b + c).T]
    middle = (np.stack(sums, axis=1) / counts[:, None])[body]
    for corners in (a, b, c):
        corners -= middle
    six = np.einsum("fj,fj->f", a, cross_rows(b, c))
    return np.bincount(body, weights=six, minlength=n_bodies) / 6


def _find_inverted(
    vertices: Floats, faces: Ints, body: Ints, volume: Floats, closed: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the closed bodies to flip (n_bodies,).

    A single body of negative volume is inside out. A body inside another can bound a void, so it is treated as the
    outermost body around it.
    """
    inverted = closed & (volume < 0)
    if not inverted.any() or closed.sum() == 1:
        return inverted
    result = inverted.copy()
    members = np.split(np.argsort(body, kind="stable"), np.cumsum(np.bincount(body))[:-1])
    low = np.array([vertices[faces[f].ravel()].min(axis=0) for f in members])
    high = np.array([vertices[faces[f].ravel()].max(axis=0) for f in members])
    for inner in np.flatnonzero(closed).tolist():
        around = np.flatnonzero(closed & (low < low[inner]).all(axis=1) & (high > high[inner]).all(axis=1)).tolist()
        point = vertices[faces[members[inner]][0, 0]]
        holders = [outer for outer in around if encloses(vertices[faces[members[outer]]], point)]
        if holders:
            result[inner] = inverted[max(holders, key=lambda outer: float(np.prod(high[outer] - low[outer])))]
    return result


def encloses(triangles: Floats, point: Floats) -> bool:
    """Return whether a closed surface encloses a point, by its solid angles (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("fj,fj->f", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("fj,fj->f", one, other) for one, other in ((a, b), (b, c), (c, a)))
    spread = la * lb * lc + ab * lc + bc * la + ca * lb
    return bool(abs(2 * np.arctan2(volume, spread).sum()) > 2 * np.pi)


def _unique_faces(faces: Ints) -> Ints:
    """Return the indices of the faces whose three corners no earlier face has."""
    if not len(faces):
        return np.arange(0)
    code = np.random.default_rng(0).integers(1 << 62, size=int(faces.max()) + 1)
    sums = np.sort(code[faces].sum(axis=1))  # equal faces have equal sums: without equal sums there are no duplicates
    if (sums[1:] != sums[:-1]).all():
        return np.arange(len(faces))
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T[::-1])
    same = (corners[order][1:] == corners[order][:-1]).all(axis=1)
    keep = np.ones(len(faces), bool)
    keep[order[1:][same]] = False  # lexsort is stable, so the first of equal faces remains
    return np.flatnonzero(keep)


def double_areas(vertices: Floats, faces: Ints) -> Floats:
    """Return twice the area of each face (F,)."""
    doubled: Floats = row_norms(face_cross_products(vertices, faces))
    return doubled


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"
