"""Which pairs of bracket and housing with link_4 and link_5 are guarded, and by how much, by the wrist's build."""

from __future__ import annotations

import hashlib
import itertools
from typing import TYPE_CHECKING

import numpy as np

from cell.robot import told
from cell.world.apart import keeps_apart

if TYPE_CHECKING:
    import mujoco

    from cell.world.gap import Shapes

_STEP = np.deg2rad(6.0)
_APART = 0.01  # m
_LOOKS = 20_000  # for a proof, which is made anew for each cell: half a second
_LEAST = 1e-5  # m; a smaller distance is none

_proven: dict[tuple[bytes, tuple[int, int], float], bool] = {}
"""What was proven in this process, by arm, pair and distance: the cells of a study, and of a plan's proof, have one."""


def settle_pairs(
    spec: mujoco.MjSpec, model: mujoco.MjModel, shapes: Shapes, clearance: float, *, by_hand: bool
) -> None:
    """Enter in a specification which of these pairs are not guarded, and which by less than the clearance.

    Not guarded is a pair that is proven to keep apart at all wrist angles, by the clearance [m] or, where that is
    larger, by `_APART`: what the mount fixes is no collision, and a large clearance to the cell must not make every
    configuration one. Of an arm whose pairs are not chosen by hand neither is one that is proven to keep half of the
    smallest distance seen on a grid of wrist angles, nor the bracket with link_5 where they touch at each: its end on
    the flange. Two that are nearer than the clearance at all of them are guarded by half of the largest distance.

    Args:
        spec: arm and tool.
        model: compiled from it.
        shapes: who measures.
        clearance: of the cell [m].
        by_hand: the arm's file says that the bracket, which turns about its own end, is not guarded against link_5.
    """
    bodies = [body.name for body in spec.bodies]
    pieces = [name for name in ("housing", "bracket") if name in bodies]
    if by_hand and "bracket" in pieces:
        _exclude(spec, "bolted", "bracket", "link_5")
    arm = _digest(model)

    def apart(pair: tuple[int, int], least: float) -> bool:
        key = arm, pair, least
        if key not in _proven:
            _proven[key] = keeps_apart(model, shapes, *pair, least, _LOOKS)
        return _proven[key]

    for piece, link in itertools.product(pieces, ("link_5", "link_4")):
        pair, bolted = (model.body(piece).id, model.body(link).id), (piece, link) == ("bracket", "link_5")
        if not model.body(link).geomnum[0] or (by_hand and bolted):
            continue
        if apart(pair, min(clearance, _APART)):
            _exclude(spec, "apart", piece, link)
        elif not by_hand:
            lowest, widest = _seen(model, shapes, pair, 2 * clearance)
            if bolted and widest <= 0:
                _exclude(spec, "bolted", piece, link)
            elif lowest > 2 * _LEAST and apart(pair, lowest / 2):
                _exclude(spec, "apart", piece, link)
            elif widest < 2 * clearance:
                spec.add_numeric(name=told.keeps(model, piece, link), data=[max(widest, 0.0) / 2], size=1)


def _digest(model: mujoco.MjModel) -> bytes:
    """SHA-256 of all that a model holds."""
    import mujoco

    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).digest()


def _exclude(spec: mujoco.MjSpec, why: str, piece: str, link: str) -> None:
    spec.add_exclude(name=f"{why}_{piece}_{link}", bodyname1=piece, bodyname2=link)


def _seen(model: mujoco.MjModel, shapes: Shapes, pair: tuple[int, int], reach: float) -> tuple[float, float]:
    """Smallest and largest distance of two bodies on a grid of wrist angles [m], at most `reach`."""
    import mujoco

    data, lowest, widest = mujoco.MjData(model), reach, -np.inf
    joints = [model.joint(axis) for axis in ("A5", "A6")]
    grids = [np.arange(max(low, -np.pi), min(high, np.pi), _STEP) for low, high in (j.range for j in joints)]
    geoms = [np.flatnonzero(model.geom_bodyid == body).tolist() for body in pair]
    for angles in itertools.product(*grids):
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        apart = min(shapes.distance(data, a, b, reach) for a in geoms[0] for b in geoms[1])
        lowest, widest = min(lowest, apart), max(widest, apart)
    return lowest, widest
