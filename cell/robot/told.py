"""What an arm's model says beside its chain: how pairs of its bodies are guarded, what is hardly meant in its file.

Numerics and texts of the MJCF, so that a run's `robot.xml` and `cell.xml` hold them too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cell.robot.model import bodies

if TYPE_CHECKING:
    import mujoco

_TOOL = ("bracket", "housing")

DOUBT = "doubt_"
"""What texts are called that say what is hardly meant in an arm's file, a sentence each."""

KEEPS, APART = "keeps_", "apart_"
"""What numerics are called that say by how much two bodies are guarded, and how far apart two are proven to be."""


def doubts(spec: mujoco.MjSpec) -> list[str]:
    """What is hardly meant in an arm's file, one sentence each."""
    return [text.data for text in spec.texts if text.name.startswith(DOUBT)]


def kept_near(model: mujoco.MjModel) -> dict[tuple[int, int], float]:
    """Pairs of geoms that are guarded by less than the cell's clearance, and by how much [m]: the numerics `keeps`."""
    found = {}
    for number in range(model.nnumeric):
        if not model.numeric(number).name.startswith(KEEPS):
            continue
        one, other = (model.body(name) for name in pair_of(model, number))
        for a in range(one.geomadr[0], one.geomadr[0] + one.geomnum[0]):
            for b in range(other.geomadr[0], other.geomadr[0] + other.geomnum[0]):
                found[a, b] = found[b, a] = float(model.numeric(number).data[0])
    return found


def keeps(model: mujoco.MjModel, one: str, other: str) -> str:
    """Name of the numeric that says by how much [m] two bodies that are always near each other are guarded."""
    return f"{KEEPS}{_number(model, one)}_{_number(model, other)}"


def apart(model: mujoco.MjModel, one: str, other: str) -> str:
    """Name of the numeric that says how far apart [m] two links that are not guarded are proven to be at all angles."""
    return f"{APART}{_number(model, one)}_{_number(model, other)}"


def pair_of(model: mujoco.MjModel, numeric: int) -> tuple[str, str]:
    """The two bodies that a numeric of `keeps` or `apart` is of."""
    one, other = model.numeric(numeric).name.split("_")[1:]
    named = (*bodies(model), *_TOOL)
    return named[int(one)], named[int(other)]


def _number(model: mujoco.MjModel, body: str) -> int:
    return (*bodies(model), *_TOOL).index(body)
