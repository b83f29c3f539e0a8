"""Set-ups that are offered: the part as it is placed and in its stable poses, each turned about the vertical."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cell.errors import SceneError
from cell.scene.model import Placement, Scene, Setup
from cell.world.model import ON_AXIS, World
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.frames import kuka_abc_from_pose
from planner.values import Floats

TURNS_DEG = (0.0, 90.0, 180.0, 270.0)
"""About the vertical."""

_ALIKE_DEG = 10.0  # poses that lie on nearly the same side are one: of a rounded part there are hundreds
_LEAST = 0.01  # probability of a pose that is worth to be offered


@dataclass(frozen=True, slots=True)
class Offer:
    """One set-up.

    Attributes:
        name: in words.
        placement: of the part's centre.
        given: its table in the scene; None of one that is proposed.
    """

    name: str
    placement: Placement
    given: Setup | None = None

    def scene(self, shared: Scene) -> Scene:
        """The scene of this set-up alone, of that of all."""
        own: dict[str, object] = {
            "placement": self.placement,
            "setup": (),
            "plan": shared.plan.plain().ordered_as(shared.plan),
        }
        if self.given is None:
            return shared.model_copy(update=own)
        own["fixtures"] = (*shared.fixtures, *self.given.fixtures)
        return shared.model_copy(update=own | ({} if self.given.post is None else {"post": self.given.post}))


def given(scene: Scene) -> list[Offer]:
    """The set-ups that the scene gives, in its order."""
    return [
        Offer(each.name, Placement(position_mm=each.position_mm, abc_deg=each.abc_deg), each) for each in scene.setup
    ]


def with_table_kept(scene: Scene, world: World) -> Scene:
    """The scene with its rotary table where that of a compiled cell stands, in whatever pose the part is put on it."""
    if world.table is None:
        return scene
    position_mm = (1000 * world.table.T_base_table[:3, 3]).round(6).tolist()
    return scene.model_copy(update={"table": scene.table.model_copy(update={"position_mm": tuple(position_mm)})})


def proposed(world: World, part: TriangleMesh, most: int) -> list[Offer]:
    """The set-ups that are proposed: the part's lowest point stays at its height, its centre over the same place.

    The pose that the scene gives comes first, then stable poses, the most probable first, each at all turns; at one
    where a rotary table turns the part all round its centre.

    Args:
        world: the cell with the part as the scene places it.
        part: its reference [m], object frame.
        most: how many at most.

    Raises:
        SceneError: if a rotary table is tilted, on which no pose of the part is stable.
    """
    if most and world.table is not None and not world.table.upright:
        raise SceneError(
            "set-ups are proposed where the axis of a rotary table is upright, and this one is tilted; give [[setup]] "
            "tables, with --offer 0, or leave table.abc_deg out"
        )
    placed = (world.T_base_object @ world.T_object_centre)[:3, :3]
    lies = [("as it is placed", placed)]
    for R, probability in _stable(part):
        if all(_apart_deg(R, other) > _ALIKE_DEG for _, other in lies):
            lies.append((f"in a stable pose of probability {probability:.2f}", R))
    found = [
        Offer(f"{name}, turned by {turn:g} deg" if turn else name, _placement(world, _about_z(turn) @ R))
        for name, R in lies
        for turn in (TURNS_DEG[:1] if _turns_all_round(world) else TURNS_DEG)
    ]
    return found[:most]


def _stable(part: TriangleMesh) -> Iterator[tuple[Floats, float]]:
    """Rotations (3, 3) in which the part lies on a plane without falling, and their probabilities, the largest first.

    A body that is dropped at random comes to rest on a face of its convex hull (Goldberg, Mirtich, Zhuang, Craig,
    Carlisle, Canny, "Part pose statistics", IEEE Trans. Robotics and Automation 1999, doi:10.1109/70.795796).
    """
    import trimesh  # half a second of start-up

    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    hull = mesh.convex_hull
    mass = mesh.center_mass if mesh.is_volume else hull.center_mass
    transforms, probabilities = trimesh.poses.compute_stable_poses(hull, center_mass=mass)
    for k in np.argsort(-probabilities.round(9), kind="stable"):
        if probabilities[k] >= _LEAST:
            yield transforms[k][:3, :3], float(probabilities[k])


def _turns_all_round(world: World) -> bool:
    """Whether a rotary table turns the part once round about its own centre."""
    if (table := world.table) is None:
        return False
    off_axis = (world.T_base_object @ world.T_object_centre)[:2, 3] - table.T_base_table[:2, 3]
    return bool(np.linalg.norm(off_axis) <= ON_AXIS and table.upper - table.lower >= 2 * np.pi - 1e-9)


def _apart_deg(one: Floats, other: Floats) -> float:
    """Angle between the directions of the part that point down at two rotations [deg]."""
    return float(np.degrees(np.arccos(np.clip(one[2] @ other[2], -1.0, 1.0))))


def _about_z(angle_deg: float) -> Floats:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _placement(world: World, R: Floats) -> Placement:
    """The part's centre at a rotation, its lowest point as high as in the scene; numbers that can be typed."""
    T = np.array(world.T_base_object @ world.T_object_centre)
    corners = world.part_hull.vertices - world.T_object_centre[:3, 3]
    T[2, 3] = world.post_top(world.T_base_object)[2] - (corners @ R[2]).min()
    T[:3, :3] = R
    position, abc = kuka_abc_from_pose(T)
    return Placement(
        position_mm=tuple(((position * 1000).round(3) + 0.0).tolist()),
        abc_deg=tuple((np.degrees(abc).round(3) + 0.0).tolist()),
    )
