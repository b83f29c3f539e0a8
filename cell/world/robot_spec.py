"""The robot of a scene as a MuJoCo specification: the built-in KR 16, or an arm from a file.

An arm from a file is normalised to the form of `models/kr16.xml` (`cell.robot.normalise`). Its triangles decide which
pairs of links are checked (`cell.world.self_collision`); neighbours are not. A home that the file does not give is
searched for.
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
from cell.files import read_bytes
from cell.robot import model as robot
from cell.robot import robot_file
from cell.robot.arm import kinematics_of
from cell.robot.normalise import normalise
from cell.robot.refusals import describe_refusal
from cell.robot.robot_file import mesh_files
from cell.world.self_collision import LinkPairs
from cell.world.shapes import quaternion
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from cell.scene.model import Robot

JOINED = "joined_"
"""Prefix of the names of exclusions of joined links."""

_TOOL = "tool of a home"
_TILTS = (0.0, 0.6, 1.2)  # tangents of tilts of the flange, in case straight down is in collision
_HEIGHTS, _SHARES = (0.65, 0.5, 0.35, 0.8, 0.2), (0.5, 0.6, 0.4)  # of the reach: positions of a home


def robot_spec(settings: Robot) -> mujoco.MjSpec:
    """Return the robot of a scene as an editable specification, its base posed as in the scene.

    Raises:
        FileError: if its file or one of its meshes cannot be read.
        SceneError: if the arm cannot be used for planning.
    """
    if settings.model == robot.KR16:
        spec = robot.spec()
    else:
        packages = tuple(sorted((settings.packages or {}).items()))
        down = None if settings.base is None else tuple((-settings.base.T[2, :3]).tolist())
        path = Path(settings.model)
        stamp = modification_times(path, packages)
        spec = load_robot(
            path, settings.base_link, settings.flange_link, packages, settings.velocity_deg_s, down, stamp
        ).copy()
    if settings.base is not None:
        set_base(spec, settings.base.T)
    return spec


def set_base(spec: mujoco.MjSpec, T_base: Floats) -> None:
    """Move the base of a robot to a pose (4, 4) [m] of the cell."""
    base = spec.body("base")
    base.pos, base.quat = T_base[:3, 3], quaternion(T_base[:3, :3])


@lru_cache(maxsize=4)
def load_robot(
    path: Path,
    base_link: str | None = None,
    flange_link: str | None = None,
    packages: tuple[tuple[str, str], ...] = (),
    velocity_deg_s: tuple[float, ...] | None = None,
    down: tuple[float, float, float] | None = None,
    stamp: tuple[int, ...] = (),
) -> mujoco.MjSpec:
    """Read the arm of a file and normalise it. The cached result must not be changed.

    Args:
        path: a URDF or an MJCF; a normalised MJCF is used as it is.
        base_link: its base link; None: the root.
        flange_link: its flange link; None: the one with a usual name.
        packages: names and folders of ROS packages.
        velocity_deg_s: (6,) speeds for axes without one in the file [deg/s].
        down: (3,) direction of the flange at home, base frame; None: down.
        stamp: from `modification_times`: another one reads the file again.
    """
    import mujoco

    if path.suffix == ".xml" and is_normalised(path):
        try:
            return mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise FileError(f"{path} cannot be read as an MJCF: {describe_refusal(error)}") from error
    folders = {name: Path(folder) for name, folder in packages}
    file = robot_file.read_robot(path, base=base_link, flange=flange_link, packages=folders)
    spec = normalise(file, velocity_deg_s)
    for number, sentence in enumerate(file.warnings):
        spec.add_text(name=f"{robot.WARNING_PREFIX}{number}", data=sentence)
    try:
        model = spec.compile()
    except ValueError as error:
        cause = describe_refusal(error)
        raise FileError(f"{path} has shapes that MuJoCo does not accept: {cause}") from error
    links = LinkPairs(model)
    classes = links.classify()
    for one, other in classes.joined:
        del links.pairs[one, other]
        spec.add_exclude(name=f"{JOINED}{one}_{other}", bodyname1=one, bodyname2=other)
    for one, other, distance in classes.separate:
        del links.pairs[one, other]
        spec.add_exclude(name=f"{robot.SEPARATION_PREFIX}{one}_{other}", bodyname1=one, bodyname2=other)
        spec.add_numeric(name=robot.separation_name(model, one, other), data=[distance], size=1)
    for one, other, distance in classes.reduced:
        spec.add_numeric(name=robot.clearance_name(model, one, other), data=[distance], size=1)
    home = file.home
    if home is None:
        reduced = {(one, other): distance for one, other, distance in classes.reduced}
        direction = np.array((0.0, 0.0, -1.0) if down is None else down)
        homes = (find_home(each, reduced, direction) for each in (_with_tool(spec), links))
        home = next((q for q in homes if q is not None), None)
    if home is not None:
        spec.add_key(name="home", qpos=robot.MimicJoints.from_model(model).qpos(home))
    return spec


def modification_times(path: Path, packages: tuple[tuple[str, str], ...] = ()) -> tuple[int, ...]:
    """Return the modification times of a robot's file and its meshes [ns]; unreadable files are left out."""
    files = [path]
    with contextlib.suppress(OSError, UnicodeDecodeError, ElementTree.ParseError, FileError):
        files += mesh_files(path, {name: Path(folder) for name, folder in packages})
    return tuple(file.stat().st_mtime_ns for file in files if file.is_file())


def is_normalised(path: Path) -> bool:
    """Return whether a file is an MJCF in the form of `models/kr16.xml`: only that form has these limits."""
    try:
        return b"axis_velocity_limit_deg_s" in read_bytes(path)
    except OSError:
        return False


def find_home(links: LinkPairs, reduced: Mapping[tuple[str, str], float], down: Floats) -> Floats | None:
    """Search joint angles (6,) [rad] with the flange down, in front of the arm at half its reach; None: none is free.

    If the scanner would touch the arm, the flange is tilted ahead. Among several solutions the one with the highest
    elbow is chosen, then the one with the smallest angles.

    Args:
        links: the arm.
        reduced: pairs with a reduced clearance [m].
        down: (3,) direction of the flange, base frame.
    """
    kinematics = kinematics_of(links.model)
    limits = kinematics.limits
    reach = float(np.linalg.norm(kinematics.forward(links.q[:2000])[:, :3, 3], axis=1).max())
    level = down * (1.0, 1.0, 0.0)
    ahead = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(level) < 0.5 else level / np.linalg.norm(level)
    for tilt, share, height in itertools.product(_TILTS, _SHARES, _HEIGHTS):
        direction = down + tilt * ahead
        position = reach * (share * ahead + np.array([0.0, 0.0, height]))
        q = kinematics.inverse(_poses_along(direction / np.linalg.norm(direction), position)).reshape(-1, 6)
        q = q[((q >= limits.lower) & (q <= limits.upper)).all(axis=1)]  # False for NaN
        free = [angles for angles in q if links.is_free(angles, reduced)]
        if free:
            return min(
                free, key=lambda angles: (-round(links.elbow_height(angles, -down), 6), float(np.abs(angles).sum()))
            )
    return None


def _with_tool(spec: mujoco.MjSpec) -> LinkPairs:
    """Return the arm with the largest built-in scanner on its flange."""
    import mujoco

    copy = spec.copy()
    flange = spec.copy().compile().site(robot.FLANGE)
    tool = copy.body("link_6").add_body(name=_TOOL, pos=flange.pos, quat=flange.quat)
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.039, 0.03, 0.0], pos=[0.0, 0.0, 0.03])
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08, 0.04, 0.03], pos=[0.0375, 0.0, 0.09])
    for link in ("link_5", "link_6"):
        copy.add_exclude(name=f"{_TOOL}_{link}", bodyname1=_TOOL, bodyname2=link)
    return LinkPairs(copy.compile())


def _poses_along(z: Floats, origin: Floats) -> Floats:
    """Return four poses (4, 4, 4) at an origin [m] with axis z, a quarter turn apart."""
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    poses = np.tile(np.eye(4), (4, 1, 1))
    for turn in range(4):
        poses[turn, :3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        x = np.cross(z, x)
    poses[:, :3, 3] = origin
    return poses
