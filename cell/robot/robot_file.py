"""An arm from a URDF or MJCF, as MuJoCo reads it: which six joints drive the flange, their limits, what follows along.

A URDF is read with its frames kept (MuJoCo merges links that do not move, so that base and flange vanish), visuals left
out, and mesh paths resolved beside the file or by `packages`. Speeds, which MuJoCo leaves out, and joints that mimic
another are taken from the URDF itself. Base frame of the arm: that of its base link.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, SceneError
from cell.robot.urdf import Unread, prepare, require_range
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco

LARGEST_FILE = 10_000_000
"""Bytes of a robot's description above which it is none."""

_FLANGES = ("tool0", "flange", "ee_link", "tool_flange")  # tool0 first: its z leaves the face by ROS-Industrial's rule
_LONGEST_ARM = 50.0  # m; between joints: beyond it the lengths are millimetres
_MOVES = {"revolute", "continuous"}


@dataclass(frozen=True, slots=True)
class Follower:
    """A joint that is driven along by one of the six: angle = ratio * the axis' + offset.

    Attributes:
        joint: its name.
        axis: index of the axis that it follows, 0 to 5.
        ratio: -.
        offset: [rad].
    """

    joint: str
    axis: int
    ratio: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class RobotFile(Value):
    """What a file says of an arm.

    Attributes:
        path: the file.
        model: compiled from it, frames kept.
        base: name of the body that is the arm's base.
        flange: name of the body or site whose frame is the flange's.
        flange_is_body: which of the two.
        joints: the six joints from base to flange, in order.
        followers: joints that are driven along.
        lower: (6,) smallest joint angles [rad].
        upper: (6,) largest joint angles [rad].
        velocity: (6,) axis speeds [rad/s]; inf where the file says none.
        home: (6,) angles of a key named home [rad]; None: the file has none, or one outside the limits.
        doubts: what is taken for what the file does not say of its axes' ranges, and what MuJoCo warned of when it read
            it, one sentence each.
    """

    path: Path
    model: mujoco.MjModel
    base: str
    flange: str
    flange_is_body: bool
    joints: Annotated[tuple[str, ...], "6"]
    followers: tuple[Follower, ...]
    lower: Annotated[Floats, "6"]
    upper: Annotated[Floats, "6"]
    velocity: Annotated[Floats, "6"]
    home: Annotated[Floats, "6"] | None
    doubts: tuple[str, ...]


def read(
    path: Path, *, base: str | None = None, flange: str | None = None, packages: Mapping[str, Path] | None = None
) -> RobotFile:
    """Read an arm.

    Args:
        path: URDF or MJCF.
        base: link that is the arm's base; None: the root.
        flange: link (or site of an MJCF) that is the flange; None: the one of a usual name.
        packages: folders of ROS packages by name, for `package://NAME/...`.

    Raises:
        FileError: if the file or one of its meshes cannot be read.
        SceneError: if it holds no arm of six hinges in a row, or one without limits.
    """
    import mujoco

    try:
        if path.stat().st_size > LARGEST_FILE:
            raise FileError(f"{path} has {path.stat().st_size / 1e6:.0f} MB; a robot's description has at most 10")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path} cannot be read as a URDF or MJCF: {error}") from error
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise FileError(f"{path} is no XML: {error}; give a URDF or an MJCF") from error
    said = Unread()
    if root.tag == "robot":
        said = prepare(root, path, packages or {})
    elif root.tag != "mujoco":
        raise FileError(
            f"{path} is neither a URDF (<robot>) nor an MJCF (<mujoco>) but <{root.tag}>; expand a xacro first"
        )
    try:
        with what_mujoco_says() as warned:
            if root.tag == "robot":
                model = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode")).compile()
            else:
                model = mujoco.MjSpec.from_file(str(path)).compile()
    except ValueError as error:
        raise FileError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    return _chosen(path, model, base, flange, said, warned)


@contextmanager
def what_mujoco_says() -> Iterator[list[str]]:
    """Catch MuJoCo's warnings, which else go to stderr and to a MUJOCO_LOG.TXT in the working directory."""
    import mujoco

    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield said
        said += [str(each.message) for each in caught]
    finally:
        mujoco.set_mju_user_warning(before)


def _chosen(
    path: Path, model: mujoco.MjModel, base: str | None, flange: str | None, said: Unread, warned: list[str]
) -> RobotFile:
    """The six joints from base to flange, with their limits."""
    import mujoco

    bodies = [model.body(i).name for i in range(model.nbody)]
    sites = [model.site(i).name for i in range(model.nsite)]
    root = base or next((name for i, name in enumerate(bodies) if i and model.body_parentid[i] == 0), "world")
    if root not in bodies:
        raise SceneError(f"{path} has no link '{root}' to be the base; it has {_listed(bodies[1:])}")
    end = flange or next((name for name in _FLANGES if name in bodies or name in sites), None)
    if end is None:
        raise SceneError(
            f"{path} has no link named flange or tool0; say which is the flange (robot.flange_link): "
            f"{_listed(bodies[1:])}"
        )
    if end not in bodies and end not in sites:
        raise SceneError(f"{path} has no link '{end}' to be the flange; it has {_listed(bodies[1:])}")
    body = bodies.index(end) if end in bodies else int(model.site(end).bodyid[0])
    chain: list[int] = []
    while body > 0 and body != bodies.index(root):
        at = int(model.body_jntadr[body])
        chain[:0] = range(at, at + int(model.body_jntnum[body])) if at >= 0 else []
        body = int(model.body_parentid[body])
    if body == 0 and root != "world":
        raise SceneError(f"{path}: the flange '{end}' is not carried by the base '{root}'")
    names = [model.joint(joint).name for joint in chain]
    if len(chain) != 6 or any(model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE for joint in chain):
        raise SceneError(
            f"{path} has {len(chain)} joints from '{root}' to '{end}' ({_listed(names)}); an arm has six, all revolute"
        )
    doubts = [f"{path.name}: MuJoCo warns that {' '.join(text.split())}" for text in warned]
    endless = [joint for joint in chain if not model.jnt_limited[joint]]
    model.jnt_range[endless] = (-2.0 * np.pi, 2.0 * np.pi)
    if endless:
        doubts.append(
            f"{path.name} gives no range of {_listed([model.joint(joint).name for joint in endless])}: -360 to 360 deg "
            "is taken; give the joint a range where a cable or a stop allows less"
        )
    lower, upper = model.jnt_range[chain].T
    for name, low, high in zip(names, lower, upper, strict=True):
        require_range(path, name, low, high)
        if name in said.mimics:
            raise SceneError(
                f"{path}: the joint '{name}' is one of the six and mimics '{said.mimics[name][0]}'; an arm has six "
                "that are driven each for itself"
            )
    anchors = model.body_pos[model.jnt_bodyid[chain]]
    if np.abs(anchors).max() > _LONGEST_ARM:
        raise SceneError(
            f"{path}: joints lie {np.abs(anchors).max():.0f} m apart; a URDF is in metres, this one looks like "
            "millimetres"
        )
    velocity = np.array([said.velocity.get(name, np.inf) for name in names])
    home = _home(model, model.jnt_qposadr[chain])
    if home is not None and not ((home >= lower) & (home <= upper)).all():
        home = None
    return RobotFile(
        path, model, root, end, end in bodies, tuple(names), _followers(path, model, names, said), lower, upper,
        velocity, home, tuple(doubts),
    )  # fmt: skip


def _followers(path: Path, model: mujoco.MjModel, names: list[str], said: Unread) -> tuple[Follower, ...]:
    """What is driven along by the six joints of these names.

    Raises:
        SceneError: if a joint is neither one of them nor turned by one of them.
    """
    import mujoco

    followers = []
    for i in range(model.njnt):
        name = model.joint(i).name
        if name in names:
            continue
        source, ratio, offset = said.mimics.get(name, ("", 0.0, 0.0))
        if source not in names:
            raise SceneError(
                f"{path}: the joint '{name}' is none of the six and follows none of them; fix it or let it mimic one"
            )
        if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_HINGE:
            raise SceneError(
                f"{path}: the joint '{name}' mimics '{source}' and slides; only what turns is driven along, fix it"
            )
        followers.append(Follower(name, names.index(source), ratio, offset))
    return tuple(followers)


def _home(model: mujoco.MjModel, values: NDArray[np.integer]) -> Floats | None:
    """The key named home of an MJCF."""
    keys = [key for key in range(model.nkey) if model.key(key).name == "home"]
    return np.array(model.key_qpos[keys[0]][values]) if keys else None


def _listed(names: list[str]) -> str:
    return ", ".join(names) if names else "none"
