"""What stands in the cell, which the planner does not know, and the upright cylinder about it, which it does.

The explored frame has its origin in the middle of the cylinder and the axes of the base frame, however the part is
turned: it is the object frame of every stage. Metres.
"""

from dataclasses import dataclass

import numpy as np

from cell.part.workpiece import Workpiece
from cell.scene.model import CylinderFixture, Scene
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

WIDER = 1.05
"""How much wider than the simulated part a cylinder is that nobody gives: who clamps a part knows it to so much."""

STAND = "stand"
"""The post of the scene, as a fixture: the post of a stage would follow what is believed of the part."""


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder about the placement.

    Attributes:
        radius: [m].
        height: [m].
        given: whether a person gave it; else it is the simulated part's.
    """

    radius: float
    height: float
    given: bool


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """The part that stands there.

    Attributes:
        mesh: in the explored frame [m].
        T_explored_object: (4, 4) from the part's own frame [m].
    """

    mesh: TriangleMesh
    T_explored_object: Floats

    @classmethod
    def of(cls, scene: Scene, part: Workpiece) -> "Hidden":
        """The part at the scene's placement."""
        T = np.eye(4)
        T[:3, :3] = scene.placement.T[:3, :3]
        T[:3, 3] = -T[:3, :3] @ part.centre
        vertices = part.reference.vertices @ T[:3, :3].T + T[:3, 3]
        return cls(TriangleMesh(vertices, part.reference.faces), T)


def cylinder_about(hidden: Hidden) -> Cylinder:
    """The cylinder of a simulated part, `WIDER`; its bottom is the part's lowest point."""
    vertices = hidden.mesh.vertices
    radius = float(np.hypot(vertices[:, 0], vertices[:, 1]).max())
    return Cylinder(WIDER * radius, 2 * float(np.abs(vertices[:, 2]).max()), given=False)


def with_stand(scene: Scene, cylinder: Cylinder) -> Scene:
    """The scene without its post and with a fixture in its place, under the cylinder's bottom.

    Args:
        scene: whose post, where it has one, reaches from the floor to the part's lowest point.
        cylinder: about the placement.
    """
    if not scene.post.enabled:
        return scene
    x, y, z = scene.placement.position_mm
    bottom, floor = z - 500 * cylinder.height, -scene.robot.pedestal_height_mm
    if bottom <= floor:
        return scene.model_copy(update={"post": scene.post.model_copy(update={"enabled": False})})
    stand = CylinderFixture(
        name=STAND, shape="cylinder", position_mm=(x, y, (bottom + floor) / 2),
        size_mm=(scene.post.diameter_mm, bottom - floor),
    )  # fmt: skip
    post = scene.post.model_copy(update={"enabled": False})
    return scene.model_copy(update={"post": post, "fixtures": (*scene.fixtures, stand)})
