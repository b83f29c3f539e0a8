"""Reader of generalised travelling salesman files, compared with distances computed by hand."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import gtsplib

COORDINATES = "NODE_COORD_SECTION\n1 0 0\n2 3 4\n3 0.6 0\n"
SETS = "GTSP_SET_SECTION\n1 1 -1\n2 3\n2 -1\nEOF\n"


def written(tmp_path: Path, kind: str, body: str = COORDINATES, sets: str = SETS, extra: str = "") -> Path:
    """Write a file of three nodes in two sets; the members of the second set are on two lines."""
    path = tmp_path / "2toy3.gtsp"
    path.write_text(
        f"NAME : 2toy3\nTYPE : GTSP\nDIMENSION : 3\nGTSP_SETS : 2\nEDGE_WEIGHT_TYPE : {kind}\n{extra}{body}{sets}"
    )
    return path


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("EUC_2D", [5, 1, 5]),  # 5; 0.6 -> 1; hypot(2.4, 4) = 4.66 -> 5
        ("CEIL_2D", [5, 1, 5]),
        ("MAN_2D", [7, 1, 6]),
        ("MAX_2D", [4, 1, 4]),
        ("ATT", [2, 1, 2]),  # 1.58 -> 2; 0.19 -> 1; 1.48 -> rounds down, so 2
    ],
)
def test_distances_are_rounded_as_tsplib_says(tmp_path: Path, kind: str, expected: list[int]) -> None:
    """Distances of each kind are the integers computed by hand, and symmetric."""
    found = gtsplib.read(written(tmp_path, kind))
    np.testing.assert_array_equal(found.cost[[0, 0, 1], [1, 2, 2]], expected)
    np.testing.assert_array_equal(found.cost, found.cost.T)
    assert [members.tolist() for members in found.sets] == [[0], [2, 1]]


def test_geographical_distances() -> None:
    """Geographical distances are rounded up from 111.3 and 167.0 km.

    The angles are one degree along the equator, and 1 degree 30 minutes, written as 1.30.
    """
    cost = gtsplib._distances(np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 1.30]]), "GEO")
    np.testing.assert_array_equal(cost[0, 1:], [112, 167])


@pytest.mark.parametrize(
    ("layout", "weights"),
    [
        ("FULL_MATRIX", "0 1 2 1 0 3 2 3 0"),
        ("UPPER_ROW", "1 2\n3"),
        ("UPPER_DIAG_ROW", "0 1 2 0 3 0"),
        ("LOWER_ROW", "1 2 3"),
        ("LOWER_DIAG_ROW", "0 1 0 2 3 0"),
    ],
)
def test_every_layout_of_a_matrix_gives_the_same_costs(tmp_path: Path, layout: str, weights: str) -> None:
    """In every layout, the node pairs (1, 2), (1, 3) and (2, 3) cost 1, 2 and 3."""
    body = f"EDGE_WEIGHT_SECTION\n{weights}\n"
    found = gtsplib.read(written(tmp_path, "EXPLICIT", body, extra=f"EDGE_WEIGHT_FORMAT : {layout}\n"))
    np.testing.assert_array_equal(found.cost, [[0, 1, 2], [1, 0, 3], [2, 3, 0]])


def test_sets_that_miss_a_node_are_refused(tmp_path: Path) -> None:
    """Sets without one of the nodes are refused, and the message states the requirement."""
    with pytest.raises(ValueError, match="must hold each of the 3 nodes once"):
        gtsplib.read(written(tmp_path, "EUC_2D", sets="GTSP_SET_SECTION\n1 1 -1\n2 3 -1\n"))


def test_nodes_are_sorted_by_cluster(tmp_path: Path) -> None:
    """The costs of renumbered nodes are those of the nodes in the file."""
    found = gtsplib.read(written(tmp_path, "EUC_2D"))
    cost, first = found.sorted_by_cluster()
    np.testing.assert_array_equal(first, [0, 1, 3])
    np.testing.assert_array_equal(cost[0], [0, 1, 5])
