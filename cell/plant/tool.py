"""What the flange carries, as masses: the scanner's housing and its bracket.

Data sheets give a sensor's mass more often than a scene does, so the mass follows from the shapes that collide, each of
one density. Laser line sensors weigh 0.7 to 1.4 kg per litre of their housing (LJ-V7200 0.55 kg in 42 x 230 x 77 mm,
Gocator 2350 1.3 kg in 49 x 75 x 272 mm, Gocator 2330 0.74 kg in 49 x 75 x 142 mm); the bracket is an aluminium bar.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.errors import SceneError
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco

DENSITY = {"housing": 1300.0, "bracket": 2700.0}
"""Mean densities [kg/m^3]."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece(Value):
    """A rigid body on the flange.

    Attributes:
        name: for messages.
        mass: [kg].
        inertia: (3,) principal moments about the centre of mass [kg m^2].
        position: (3,) centre of mass, flange frame [m].
        quaternion: (4,) principal axes, flange frame: w, x, y, z.
        reach: distance of its farthest point from the centre of mass [m].
    """

    name: str
    mass: float
    inertia: Annotated[Floats, "3"]
    position: Annotated[Floats, "3"]
    quaternion: Annotated[Floats, "4"]
    reach: float


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """All that the flange carries; nothing is possible.

    Attributes:
        pieces: its bodies.
    """

    pieces: tuple[Piece, ...] = ()

    @property
    def reach(self) -> float:
        """Distance of its farthest point from the flange's middle [m], an upper bound."""
        return max((float(np.linalg.norm(piece.position)) + piece.reach for piece in self.pieces), default=0.0)


def of_model(model: mujoco.MjModel) -> Tool:
    """The tool of a compiled cell, such as a run's `cell.xml`.

    Args:
        model: with a box `housing` and, where there is a bracket, a cylinder `bracket`, on bodies in the flange frame.

    Raises:
        SceneError: if it has no housing.
    """
    names = {model.geom(i).name: i for i in range(model.ngeom)}
    if "housing" not in names:
        raise SceneError("the cell's model has no shape named housing; the plant takes the scanner's mass from it")
    return Tool(tuple(_piece(model, name, names[name]) for name in DENSITY if name in names))


def _piece(model: mujoco.MjModel, name: str, geom: int) -> Piece:
    import mujoco

    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        size = 2.0 * model.geom_size[geom]
        mass = DENSITY[name] * float(size.prod())
        inertia = mass / 12.0 * ((size**2).sum() - size**2)
        reach = float(np.linalg.norm(size)) / 2.0
    elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = (float(x) for x in model.geom_size[geom][:2])
        mass = DENSITY[name] * np.pi * radius**2 * 2.0 * half
        across = mass * (3.0 * radius**2 + 4.0 * half**2) / 12.0
        inertia = np.array([across, across, mass * radius**2 / 2.0])
        reach = float(np.hypot(radius, half))
    else:
        raise SceneError(f"the shape {name} of the cell's model is neither box nor cylinder; its mass is not known")
    return Piece(name, float(mass), inertia, model.geom_pos[geom], model.geom_quat[geom], reach)
