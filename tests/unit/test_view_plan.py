"""A coverage below 1 is a promise about the surface: it is kept on samples that the optimiser has not seen."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_array

from cell.plan.request import Request, select
from cell.scene.plan_settings import PlanSettings


def covered(asked: float, share_of_view: list[float]) -> tuple[int, float]:
    """Views and final target where view i measures its own tenth of ten samples and its share of the held-out ones."""
    n = len(share_of_view)
    M = SimpleNamespace(matrix=lambda: csr_array(np.eye(n, dtype=bool)), features=SimpleNamespace(areas=np.ones(n)))
    candidates = SimpleNamespace(T_object_scanner=np.arange(n))
    prediction = SimpleNamespace(share_of_coverable=lambda views: float(np.take(share_of_view, views).sum()))
    selected = select(
        Request(PlanSettings(coverage=asked)), M, SimpleNamespace(reachable=np.ones(n, dtype=bool)), candidates,
        prediction,
        banned=(), rng=np.random.default_rng(0),
    )  # fmt: skip
    return len(selected.cover.views), selected.target


def test_a_plan_that_keeps_its_promise_is_not_touched() -> None:
    """Half of ten equal samples: five views, and the target is what was asked."""
    assert covered(0.5, [0.1] * 10) == (5, 0.5)


def test_the_target_is_raised_until_the_held_out_share_is_there() -> None:
    """Each view measures 0.08 of what is held out: half of it needs seven views, not the five of the matrix."""
    views, target = covered(0.5, [0.08] * 10)
    assert views == 7
    assert 0.5 < target <= 0.7


def test_what_cannot_be_kept_ends_at_everything() -> None:
    """Views that measure almost nothing of the rest: all of them are taken and the target is 1."""
    views, target = covered(0.5, [0.001] * 10)
    assert (views, target) == (10, pytest.approx(1.0))
