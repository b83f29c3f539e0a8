"""Groups and patches of open samples: what stays open for one reason, and the connected pieces of it. Object frame."""

from collections.abc import Callable, Sequence

import numpy as np

from cell.runs.schema import ScannerKeys
from cell.scene.model import RegionTargets
from cell.why.answer import Group, Patch
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools, Floats, Ints
from planner.why.reasons import Reason
from planner.why.why import Diagnosis


def grouped(
    samples: SurfaceSamples, rows: Ints, diagnosis: Diagnosis, what: Sequence[str], planning: TriangleMesh,
    keys: ScannerKeys, regions: Sequence[RegionTargets],
) -> list[Group]:  # fmt: skip
    """The open samples by what they stay open for, the largest group first.

    Args:
        samples: held-out samples.
        rows: (n,) the open ones.
        diagnosis: of these.
        what: n things in the way, or "".
        planning: over its faces patches are connected.
        keys: the scanner's, for its limits.
        regions: of the part, by their numbers.
    """
    members: dict[tuple[int, str], list[int]] = {}
    for i, key in enumerate(zip(diagnosis.reason.tolist(), what, strict=True)):
        members.setdefault(key, []).append(i)
    adjacency = _adjacent_faces(planning)
    found = []
    for (reason, thing), own in members.items():
        inside = rows[np.array(own)]
        pieces = _patches(inside, samples, adjacency, len(planning.faces))
        told = _detail(Reason(reason), diagnosis, np.isin(rows, inside), keys), _in_regions(samples, inside, regions)
        detail = "; ".join(text for text in told if text)
        found.append(Group(Reason(reason), thing, inside, tuple(Patch(piece) for piece in pieces), detail))
    return sorted(found, key=lambda group: (-float(samples.areas[group.rows].sum()), group.reason, group.what))


def _adjacent_faces(mesh: TriangleMesh) -> Ints:
    """(E, 2) pairs of faces that share an edge."""
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    face = np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    same = (np.diff(edges[order], axis=0) == 0).all(axis=1)
    return np.stack([face[order][:-1][same], face[order][1:][same]], axis=1)


def _patches(rows: Ints, samples: SurfaceSamples, adjacent: Ints, faces: int) -> list[Ints]:
    """The samples in pieces that are connected over planning faces, the largest first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    here = np.zeros(faces, dtype=np.bool_)
    face = samples.planning_face[rows]
    here[face] = True
    both = adjacent[here[adjacent].all(axis=1)]
    graph = coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(faces, faces))
    label = connected_components(graph, directed=False)[1][face]
    pieces = [rows[label == one] for one in np.unique(label)]
    return sorted(pieces, key=lambda piece: (-float(samples.areas[piece].sum()), int(piece[0])))


def _in_regions(samples: SurfaceSamples, rows: Ints, regions: Sequence[RegionTargets]) -> str:
    """In which regions open samples lie, the one with the largest share first; "" where the part has none."""
    if samples.region is None:
        return ""
    share = np.bincount(samples.region[rows], samples.areas[rows], len(regions)) / samples.areas[rows].sum()
    order = [k for k in np.argsort(-share, kind="stable").tolist() if share[k] > 0]
    if len(order) == 1:
        return f"in {regions[order[0]].name}"
    return "in " + ", ".join(f"{regions[k].name} ({100 * share[k]:.0f} %)" for k in order)


_OF_ANGLE: dict[Reason, tuple[Callable[[Diagnosis], Floats], str]] = {
    Reason.GRAZING_SOURCE: (lambda found: found.grazing_source, "grazing_max_deg"),
    Reason.GRAZING_SENSOR: (lambda found: found.grazing_sensor, "sensor_grazing_max_deg"),
}


def _detail(reason: Reason, diagnosis: Diagnosis, inside: Bools, keys: ScannerKeys) -> str:
    """What there is to add about the closest candidates of some open samples."""
    if reason is Reason.NOT_SELECTED:
        return "the plan's target did not need it"
    if reason in _OF_ANGLE:
        angles, limit = _OF_ANGLE[reason]
        low, high = np.degrees(np.quantile(angles(diagnosis)[inside], (0.1, 0.9)))
        given = f", limit {highest:g}" if (highest := keys.number(limit)) is not None else ""
        return f"{low:.0f} to {high:.0f} deg from the normal{given}"
    if reason is Reason.OUT_OF_RANGE:
        low, high = 1000 * np.quantile(diagnosis.distance[inside], (0.1, 0.9))
        given = f", range {ends[0]:g} to {ends[1]:g}" if (ends := keys.pair("range_mm")) is not None else ""
        return f"{low:.0f} to {high:.0f} mm away{given}"
    if reason is Reason.TOO_SPARSE:
        far, steep = diagnosis.distance[inside], diagnosis.grazing_source[inside]
        limit_mm = keys.number("max_spacing_mm")
        limit = "the limit of the region" if limit_mm is None else f"limit {limit_mm:g} mm between points"
        return (
            f"{1000 * np.median(far):.0f} mm away at {np.degrees(np.median(steep)):.0f} deg from the normal (medians), "
            f"{limit}"
        )
    return ""
