"""What the wrist's build says of bracket and housing beside link_4 and link_5: apart at all angles, or always near."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco

    from cell.world.gap import Shapes

_WRIST_STEP = np.deg2rad(3.0)
_APART = 0.01  # m


def exclude_what_the_wrist_keeps_apart(spec: mujoco.MjSpec, model: mujoco.MjModel, clearance: float) -> None:
    """Switch off the pairs of bracket or housing with link_4 or link_5 that keep apart at all wrist angles.

    Apart means by the clearance [m] or, where that is larger, by `_APART`: what the mount fixes is no collision, and a
    large clearance to the cell must not make every configuration one.
    """
    pieces = [name for name in ("housing", "bracket") if spec.geom(name) is not None]
    apart = [
        (piece, link)
        for piece in pieces
        for link, axes in (("link_5", ("A6",)), ("link_4", ("A5", "A6")))
        if (piece, link) != ("bracket", "link_5")
        and _wrist_keeps_apart(model, piece, link, axes, min(clearance, _APART))
    ]
    for piece, link in apart:
        spec.add_exclude(name=f"apart_{piece}_{link}", bodyname1=piece, bodyname2=link)


def _wrist_keeps_apart(model: mujoco.MjModel, piece: str, link: str, axes: tuple[str, ...], clearance: float) -> bool:
    """Whether a piece of the tool keeps the clearance from a link at every angle of the axes between the two.

    Looked at on a grid of angles. From a node of the grid to any angle half a step away no point of the piece moves
    farther than half a step times its distance from the axis, per axis; no axis is farther than the sum of what is
    between the two anchors and from the last to the point.
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = model.geom(piece).id
    shapes = np.flatnonzero(model.geom_bodyid == model.body(link).id)
    joints = [model.joint(axis) for axis in axes]
    first, nearest = data.xanchor[joints[0].id], data.xanchor[joints[-1].id]
    farthest = float(np.linalg.norm(data.geom_xpos[geom] - nearest) + model.geom_rbound[geom])
    farthest += float(np.linalg.norm(first - nearest))  # 0 where the wrist is spherical
    grids, slack = [], 0.0
    for joint in joints:
        low, high = joint.range if joint.name == "A5" else (0.0, 2 * np.pi)
        angles, step = np.linspace(low, high, int(np.ceil((high - low) / _WRIST_STEP)) + 1, retstep=True)
        grids.append(angles)
        slack += farthest * step / 2
    reach = clearance + slack
    addresses = [int(joint.qposadr[0]) for joint in joints]
    for angles in itertools.product(*grids):
        data.qpos[addresses] = angles
        mujoco.mj_kinematics(model, data)
        if any(mujoco.mj_geomDistance(model, data, geom, shape, reach, None) < reach for shape in shapes):
            return False
    return True


def kept_by_the_wrist(
    model: mujoco.MjModel, shapes: Shapes, clearance: float
) -> dict[tuple[int, int], tuple[float, bool]]:
    """What bracket and housing keep of link_4 and link_5 where the mount holds them nearer than the clearance.

    Looked at on a grid of wrist angles, as `cell.world.robot_spec` looks at two links of an arm from a file: half of
    the smallest distance [m] of two that never touch, half of the largest of two that do; and whether they touch.
    """
    import mujoco

    data, kept = mujoco.MjData(model), {}
    joints = [model.joint(axis) for axis in ("A5", "A6")]
    grids = [np.arange(max(low, -np.pi), min(high, np.pi), 2 * _WRIST_STEP) for low, high in (j.range for j in joints)]
    names = [name for name in ("housing", "bracket") if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0]
    pairs = {
        (model.geom(name).id, int(geom)): [np.inf, 0.0]
        for name in names
        for link in ("link_4", "link_5")
        if (name, link) != ("bracket", "link_5")
        for geom in np.flatnonzero(model.geom_bodyid == model.body(link).id)
    }
    for angles in itertools.product(*grids):
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        for pair, found in pairs.items():
            apart = shapes.distance(data, *pair, 2 * clearance)
            found[:] = min(found[0], apart), max(found[1], apart)
    for (a, b), (lowest, widest) in pairs.items():
        keep = (lowest if lowest > 0 else widest) / 2
        if keep < clearance:
            kept[a, b] = kept[b, a] = keep, lowest <= 0
    return kept
