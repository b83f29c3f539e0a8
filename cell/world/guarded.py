"""Which pairs of shapes of a compiled cell are guarded, and how closely a motion has to be looked at for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco


def pairs(model: mujoco.MjModel) -> NDArray[np.int32]:
    """(P, 2) the pairs that `mj_collision` looks at: classes meet, not one rigid piece, not excluded."""
    excluded = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
    found = []
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            meet = model.geom_contype[a] & model.geom_conaffinity[b] | model.geom_contype[b] & model.geom_conaffinity[a]
            bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            rigid = model.body_weldid[bodies[0]] == model.body_weldid[bodies[1]]
            if meet and not rigid and bodies not in excluded and bodies[::-1] not in excluded:
                found.append((a, b))
    return np.array(found, dtype=np.int32).reshape(-1, 2)


def finer(model: mujoco.MjModel, clearance: float, near: Mapping[tuple[int, int], float]) -> float:
    """How many times closer than by the clearance [m] a motion is looked at (`planner.path.certified_edge`).

    There a pair of which one stands may come nearer by less than half the clearance between two looks, one of which
    both move by less than the whole: neither may be more than the pair keeps.
    """
    most = 1.0
    for pair, keep in near.items():
        both = (model.body_weldid[model.geom_bodyid[list(pair)]] > 0).all()
        if keep > 0:  # two that are never apart are never free
            most = max(most, clearance * (1.0 if both else 0.5) / keep)
    return most
