"""The robot of a scene as a specification that a cell is built around: the built-in KR 16, or an arm from a file.

An arm from a file is brought into the form of `models/kr16.xml` (`cell.robot.normalise`). Which pairs of its links are
guarded, its triangles say (`cell.world.self_collision`); neighbours are not. A home that no file gives is looked for
(`cell.world.robot_spec`).

A home for an arm whose file gives none: the flange down before it at half its reach, nothing near anything.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from cell.errors import FileError
from cell.robot import model as robot
from cell.robot import robot_file
from cell.robot.arm import kinematics_of
from cell.robot.normalise import normalise
from cell.robot.robot_file import mesh_files
from cell.world.self_collision import LinkPairs
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from cell.scene.model import Robot


JOINED = "joined_"
"""What the names of their exclusions begin with."""


def robot_spec(of: Robot) -> mujoco.MjSpec:
    """The robot of a scene, editable: attach it to a cell, then compile; its base stands where the scene says.

    Raises:
        FileError: if its file or one of its meshes cannot be read.
        SceneError: if it is no arm that can be planned with.
    """
    if of.model == robot.KR16:
        spec = robot.spec()
    else:
        packages = tuple(sorted((of.packages or {}).items()))
        down = None if of.base is None else tuple((-of.base.T[2, :3]).tolist())
        path = Path(of.model)
        changed = modification_times(path, packages)
        spec = load_robot(path, of.base_link, of.flange_link, packages, of.velocity_deg_s, down, changed).copy()
    if of.base is not None:
        set_base(spec, of.base.T)
    return spec


def set_base(spec: mujoco.MjSpec, T_base: Floats) -> None:
    """Put the base of a robot at a pose (4, 4) [m] of the cell."""
    import mujoco

    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(T_base[:3, :3]).ravel())
    base = spec.body("base")
    base.pos, base.quat = T_base[:3, 3], quat


@lru_cache(maxsize=4)
def load_robot(
    path: Path,
    base_link: str | None = None,
    flange_link: str | None = None,
    packages: tuple[tuple[str, str], ...] = (),
    velocity_deg_s: tuple[float, ...] | None = None,
    down: tuple[float, float, float] | None = None,
    changed: tuple[int, ...] = (),
) -> mujoco.MjSpec:
    """The arm of a file, in the form of `models/kr16.xml`; never changed by who asks for it.

    Args:
        path: a URDF, an MJCF, or an MJCF of that form already, which is taken as it is.
        base_link: link that is its base; None: the root.
        flange_link: link that is its flange; None: the one of a usual name.
        packages: name and folder of ROS packages.
        velocity_deg_s: (6,) speeds for axes of which the file says none [deg/s].
        down: (3,) where the flange looks at home, base frame; None: down.
        changed: other numbers where the file or one of its meshes may have changed since it was read (`stamp`).
    """
    import mujoco

    if path.suffix == ".xml" and is_normalised(path):
        try:
            return mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise FileError(f"{path} cannot be read as an MJCF: {error}") from error
    folders = {name: Path(folder) for name, folder in packages}
    file = robot_file.read_robot(path, base=base_link, flange=flange_link, packages=folders)
    spec = normalise(file, velocity_deg_s)
    for number, sentence in enumerate(file.warnings):
        spec.add_text(name=f"{robot.WARNING_PREFIX}{number}", data=sentence)
    try:
        model = spec.compile()
    except ValueError as error:
        raise FileError(f"{path} has shapes that MuJoCo does not take: {error}") from error
    own = LinkPairs(model)
    found = own.relations()
    for one, other in found.joined:
        del own.pairs[one, other]
        spec.add_exclude(name=f"{JOINED}{one}_{other}", bodyname1=one, bodyname2=other)
    for one, other, least in found.apart:
        del own.pairs[one, other]
        spec.add_exclude(name=f"{robot.SEPARATION_PREFIX}{one}_{other}", bodyname1=one, bodyname2=other)
        spec.add_numeric(name=robot.separation_name(model, one, other), data=[least], size=1)
    for one, other, keep in found.keeps:
        spec.add_numeric(name=robot.clearance_name(model, one, other), data=[keep], size=1)
    home = file.home
    if home is None:
        keeps = {(one, other): keep for one, other, keep in found.keeps}
        looks = np.array((0.0, 0.0, -1.0) if down is None else down)
        home = next((q for each in (with_tool(spec), own) if (q := find_home(each, keeps, looks)) is not None), None)
    if home is not None:
        spec.add_key(name="home", qpos=robot.MimicJoints.from_model(model).qpos(home))
    return spec


def modification_times(path: Path, packages: tuple[tuple[str, str], ...] = ()) -> tuple[int, ...]:
    """When a robot's file and its meshes were last written [ns]; what cannot be read is left to who reads it."""
    files = [path]
    with contextlib.suppress(OSError, UnicodeDecodeError, ElementTree.ParseError, FileError):
        files += mesh_files(path, {name: Path(folder) for name, folder in packages})
    return tuple(file.stat().st_mtime_ns for file in files if file.is_file())


def is_normalised(path: Path) -> bool:
    """Whether a file is an MJCF in the form of `models/kr16.xml`: with the limits that only that form has."""
    try:
        return "axis_velocity_limit_deg_s" in path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


_TOOL = "tool of a home"
_TILTS = (0.0, 0.6, 1.2)  # of the way ahead for one down, where looking straight down is not free
_HEIGHTS, _SHARES = (0.65, 0.5, 0.35, 0.8, 0.2), (0.5, 0.6, 0.4)  # of the reach: where a home is looked for


def find_home(own: LinkPairs, keeps: Mapping[tuple[str, str], float], down: Floats) -> Floats | None:
    """(6,) joint angles at which the flange looks down before the arm at half its reach [rad]; None: none was found.

    Where the scanner would touch the arm then, it looks down and ahead.

    Of the solutions the one whose elbow is highest, then the one that turns least.

    Args:
        own: the arm.
        keeps: pairs that are nearer by their build, and what they keep [m].
        down: (3,) where the flange is to look, base frame.
    """
    kinematics = kinematics_of(own.model)
    limits = kinematics.limits
    reach = float(np.linalg.norm(kinematics.forward(own.q[:2000])[:, :3, 3], axis=1).max())
    level = down * (1.0, 1.0, 0.0)
    ahead = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(level) < 0.5 else level / np.linalg.norm(level)
    for tilt, share, height in itertools.product(_TILTS, _SHARES, _HEIGHTS):
        looks = down + tilt * ahead
        poses = _looking(looks / np.linalg.norm(looks), reach * (share * ahead + np.array([0.0, 0.0, height])))
        q = kinematics.inverse(poses).reshape(-1, 6)
        q = q[((q >= limits.lower) & (q <= limits.upper)).all(axis=1)]  # NaN is neither
        free = [angles for angles in q if own.apart(angles, keeps)]
        if free:
            return min(free, key=lambda angles: (-round(own.elbow(angles, -down), 6), float(np.abs(angles).sum())))
    return None


def with_tool(spec: mujoco.MjSpec) -> LinkPairs:
    """The arm with the largest built-in scanner on its flange."""
    import mujoco

    copy = spec.copy()
    flange = spec.copy().compile().site(robot.FLANGE)
    tool = copy.body("link_6").add_body(name=_TOOL, pos=flange.pos, quat=flange.quat)
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.039, 0.03, 0.0], pos=[0.0, 0.0, 0.03])
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08, 0.04, 0.03], pos=[0.0375, 0.0, 0.09])
    for link in ("link_5", "link_6"):
        copy.add_exclude(name=f"{_TOOL}_{link}", bodyname1=_TOOL, bodyname2=link)
    return LinkPairs(copy.compile())


def _looking(z: Floats, origin: Floats) -> Floats:
    """(4, 4, 4) poses at an origin [m] that look along z, turned about it by quarter turns."""
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    poses = np.tile(np.eye(4), (4, 1, 1))
    for turn in range(4):
        poses[turn, :3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        x = np.cross(z, x)
    poses[:, :3, 3] = origin
    return poses
