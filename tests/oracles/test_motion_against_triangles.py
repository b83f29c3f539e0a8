"""Reduced forms of `python -m benchmarks motion_recheck`: final motions judged by true triangles in python-fcl."""

import numpy as np
import pytest

from benchmarks.motion_recheck import check_scene
from benchmarks.seeded_scenes import usable
from benchmarks.triangle_cell import TriangleCell

SCENES = [(0, "synchronised", 5), (1, "indexed", 5), (7, "", 5)]
SLOW = [
    pytest.param(number, table, 10, marks=pytest.mark.slow)
    for table, first in (("", 7), ("synchronised", 0), ("indexed", 1))
    for number in (first, 2, 3, 4, 5, 6)
]


@pytest.mark.usefixtures("full_effort")
@pytest.mark.parametrize(("number", "table", "n_views"), [*SCENES, *SLOW])
def test_no_triangles_meet_and_no_limit_is_exceeded(number: int, table: str, n_views: int) -> None:
    """No triangles meet at any millisecond of the motion, and the reported clearance is right within 1 mm.

    With a rotary table the judge turns the triangles of part, post and the part's fixtures by its own rotation. An
    indexed table never moves with the arm, and has no contact at any angle while the arm waits.
    """
    row = check_scene(number, n_views, table=table)
    assert row["moves"] > row["views"] == n_views - row["dropped"] > 0
    assert row["dropped"] == 0 or table
    assert row["checked"] > 1000 * row["motion s"]
    assert row["contacts"] == row["at once"] == 0
    assert row["over limits"] <= 1e-9
    assert row["nearest mm"] >= min(row["lower bound mm"], 50.0) - 1.0  # the judge measures up to 50 mm


def test_the_judge_sees_contact() -> None:
    """Precondition of this file: configurations in contact are found, and free ones are not reported."""
    cell = usable(7)
    q = np.random.default_rng(0).uniform(cell.world.limits.lower, cell.world.limits.upper, (400, 6))
    distance, _ = cell.checker.distance(q)
    judge = TriangleCell(cell.world, cell.part)
    assert judge.contacts(q[distance > 0.002]) == {}
    touching = q[distance < -0.02]
    deep = [bool(judge.contacts(one[None])) for one in touching]
    # Triangles have no inside and the hull is larger than the part, so some contacts of the hull are none of triangles.
    assert np.mean(deep) > 0.9
