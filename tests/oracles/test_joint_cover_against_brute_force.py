"""The cover over several set-ups against all choices of views."""

from itertools import combinations

import numpy as np
import pytest

from cell.setups import joint
from cell.setups.joint import fewest_setups, joint_cover
from planner.measurability.matrix import Measurability
from planner.surface.sample import SurfaceSamples


def _matrices(rng: np.random.Generator, setups: int, rows: int, columns: int) -> list[Measurability]:
    flat = np.zeros(rows, dtype=np.int32)
    areas = rng.integers(1, 4, rows).astype(float)
    features = SurfaceSamples(np.zeros((rows, 3)), np.tile([0.0, 0, 1], (rows, 1)), areas, flat, flat)
    found = []
    for _ in range(setups):
        entries = (rng.random((rows, columns)) < 0.3) & (rng.random(rows) < 0.6)[:, None]
        indptr = np.concatenate([[0], np.cumsum(entries.sum(axis=1))])
        found.append(Measurability(indptr, np.nonzero(entries)[1].astype(np.int32), features, columns))
    return found


def _best(dense: np.ndarray, group: np.ndarray, areas: np.ndarray, wanted: float) -> tuple[int, int]:
    """Fewest set-ups, then fewest views, of all choices of columns."""
    best = (99, 99)
    for count in range(1, dense.shape[1] + 1):
        for some in combinations(range(dense.shape[1]), count):
            if areas[dense[:, some].any(axis=1)].sum() >= wanted - 1e-9:
                best = min(best, (len(set(group[list(some)])), count))
    return best


@pytest.mark.parametrize("seed", range(12))
def test_fewest_setups_and_then_fewest_views(seed: int) -> None:
    """Both numbers are the best there is, or within what the bounds say; the views reach the target."""
    rng = np.random.default_rng(seed)
    matrices = _matrices(rng, 3, 14, 4)
    usable = [rng.random(4) < 0.9 for _ in matrices]
    target = (1.0, 0.8)[seed % 2]
    found = joint_cover(matrices, usable, target, np.random.default_rng(0))
    allowed = np.concatenate(usable)
    dense = np.column_stack([M.matrix().toarray() for M in matrices])[:, allowed]
    group = np.repeat(np.arange(3), 4)[allowed]
    areas = np.asarray(matrices[0].features.areas)
    wanted = target * areas[dense.any(axis=1)].sum()
    setups, views = _best(dense, group, areas, wanted)
    assert (len(found.views), found.setups_bound) == (setups, setups)
    assert (found.n_views, found.views_bound) == (views, views)
    assert found.enough
    seen = np.zeros(14, dtype=bool)
    for setup, chosen in found.views.items():
        assert usable[setup][chosen].all()
        seen |= matrices[setup].matrix().toarray()[:, chosen].any(axis=1)
    assert areas[seen].sum() == pytest.approx(found.covered_area)
    assert areas[seen].sum() >= wanted - 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_many_choices_are_one_problem(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where only one choice is covered by itself, the number of set-ups stays exact and the bound on views a bound."""
    monkeypatch.setattr(joint, "_EACH", 1)
    rng = np.random.default_rng(100 + seed)
    matrices = _matrices(rng, 4, 14, 3)
    usable = [np.ones(3, dtype=bool)] * 4
    found = joint_cover(matrices, usable, 0.75, np.random.default_rng(0))
    dense = np.column_stack([M.matrix().toarray() for M in matrices])
    areas = np.asarray(matrices[0].features.areas)
    wanted = 0.75 * areas[dense.any(axis=1)].sum()
    setups, views = _best(dense, np.repeat(np.arange(4), 3), areas, wanted)
    assert (len(found.views), found.setups_bound) == (setups, setups)
    assert found.views_bound <= views <= found.n_views
    assert found.covered_area >= wanted - 1e-9


def test_one_set_up_alone_does_what_it_can() -> None:
    """Where more set-ups would be needed than are allowed, the one that can measure most is covered."""
    matrices = _matrices(np.random.default_rng(1), 3, 14, 4)
    usable = [np.ones(4, dtype=bool)] * 3
    found = joint_cover(matrices, usable, 1.0, np.random.default_rng(0), most=1)
    can = [M.features.areas[M.matrix().toarray().any(axis=1)].sum() for M in matrices]
    assert list(found.views) == [int(np.argmax(can))]
    assert not found.enough
    assert found.covered_area == pytest.approx(max(can))


def test_choices_of_set_ups_are_all_that_reach_the_area() -> None:
    """Against all subsets of the fewest."""
    rng = np.random.default_rng(5)
    can, areas = rng.random((7, 60)) < 0.45, rng.random(60)
    wanted = 0.9 * float(areas.sum())
    count, members = fewest_setups(can, areas, wanted, None)
    enough = {
        size: {some for some in combinations(range(7), size) if areas[can[list(some)].any(axis=0)].sum() >= wanted}
        for size in range(1, count + 1)
    }
    assert set(members) == enough[count]
    assert not any(enough[size] for size in range(1, count))
