"""An arm from a URDF or MJCF: the six joints from base to flange, their limits, mimic joints, and its mesh files.

MuJoCo compiles the file. A URDF keeps its frames (MuJoCo merges fixed links, so that base and flange would vanish),
loses its visuals, and gets absolute mesh paths: beside the file, in its package, or in a folder of `packages`. Speeds
and mimic joints, which MuJoCo ignores, are read from the URDF itself. The arm's base frame is that of its base link.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from cell import files
from cell.errors import FileError, SceneError
from cell.robot.refusals import describe_refusal
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco

MAX_FILE = 10_000_000
"""Largest size of a robot's description [bytes]."""

# tool0 first: in ROS-Industrial its z leaves the face. The last two: of the MuJoCo Menagerie, and of Fanuc.
_FLANGES = ("tool0", "flange", "ee_link", "tool_flange", "attachment_site", "fanuc_flange")
_VECTORS = {"origin": ("xyz", "rpy"), "axis": ("xyz",), "box": ("size",), "mesh": ("scale",)}
_MAX_LINK = 50.0  # m; a larger distance between joints is in millimetres
_MAX_SHAPE = 10.0  # radius of a shape in lengths of the arm
_MAX_ANGLE = 2 * np.pi + 0.01
_MAX_TILT = np.pi / 4  # between z of the flange and A6
_MAX_TURNS = 5.0  # range of an axis
_MAX_SPEED = 60.0  # rad/s; the fastest small arms reach 15
_MAX_STL_FACES = 200_000  # of MuJoCo's reader


@dataclass(frozen=True, slots=True)
class UrdfExtras:
    """Data of a URDF that MuJoCo ignores.

    Attributes:
        velocity: speed of each joint that has a limit [rad/s].
        mimics: driving joint, ratio, and offset [rad] of each mimic joint.
        soft: ranges that soft limits reduce, as text.
    """

    velocity: dict[str, float] = field(default_factory=dict)
    mimics: dict[str, tuple[str, float, float]] = field(default_factory=dict)
    soft: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class MimicJoint:
    """A joint driven by one of the six: angle = ratio * angle of the axis + offset.

    Attributes:
        joint: its name.
        axis: index of the driving axis, 0 to 5.
        ratio: -.
        offset: [rad].
    """

    joint: str
    axis: int
    ratio: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class RobotFile(Value):
    """An arm as its file describes it.

    Attributes:
        path: the file.
        model: compiled from it, with all frames.
        base: name of the body that is the arm's base.
        flange: name of the body or site whose frame is the flange's.
        flange_is_body: True for a body, False for a site.
        joints: the six joints from base to flange, in order.
        mimic_joints: joints driven by the six.
        lower: (6,) smallest joint angles [rad].
        upper: (6,) largest joint angles [rad].
        velocity: (6,) axis speeds [rad/s]; inf if the file has none.
        home: (6,) angles of a key named home [rad]; None if there is none within the limits.
        warnings: assumed ranges of axes without limits, and MuJoCo's warnings, one sentence each.
    """

    path: Path
    model: mujoco.MjModel
    base: str
    flange: str
    flange_is_body: bool
    joints: Annotated[tuple[str, ...], "6"]
    mimic_joints: tuple[MimicJoint, ...]
    lower: Annotated[Floats, "6"]
    upper: Annotated[Floats, "6"]
    velocity: Annotated[Floats, "6"]
    home: Annotated[Floats, "6"] | None
    warnings: tuple[str, ...]


def read_robot(
    path: Path, *, base: str | None = None, flange: str | None = None, packages: Mapping[str, Path] | None = None
) -> RobotFile:
    """Read an arm.

    Args:
        path: URDF or MJCF.
        base: name of the base link; None: the root.
        flange: name of the flange's link (or site of an MJCF); None: the first usual name.
        packages: folders of ROS packages by name, for `package://NAME/...`.

    Raises:
        FileError: if the file or one of its meshes cannot be read.
        SceneError: if it has no serial arm of six hinges with limits.
    """
    import mujoco

    trees = _parse_all(path)
    for file, tree in trees.items():
        _require_numbers(tree, file)
    root = trees[path]
    extras, assets = UrdfExtras(), dict[str, bytes]()
    if root.tag == "robot":
        extras = _prepare_urdf(root, path, packages or {}, assets)
    elif root.tag != "mujoco":
        raise FileError(
            f"{path} is neither a URDF (<robot>) nor an MJCF (<mujoco>) but <{root.tag}>; expand a xacro first"
        )
    try:
        with capture_mujoco_warnings() as messages:
            if root.tag == "robot":
                text = ElementTree.tostring(root, encoding="unicode")
                model = mujoco.MjSpec.from_string(text, assets=assets).compile()
            else:
                spec = mujoco.MjSpec.from_file(str(path))
                _require_only_kinematics(spec.compiler)
                for kind, elements in (("body", spec.bodies), ("joint", spec.joints)):
                    names = {element.name for element in elements}
                    for number, element in enumerate(elements):
                        own = f"{kind} {number}"
                        element.name = element.name or (own if own not in names else f"{own} without name")
                model = spec.compile()
                extras.mimics.update(_equalities(model))
    except ValueError as error:
        cause = describe_refusal(error, has_lines=root.tag == "mujoco")  # a URDF was written anew without comments
        raise FileError(f"{path} cannot be read as an arm: {cause}") from error
    return _select_arm(path, model, base, flange, extras, messages)


def _parse_all(path: Path) -> dict[Path, ElementTree.Element]:
    """Return the roots of a description and of the files that an MJCF includes, by their paths."""
    trees = {path: _parse(path)}
    known, queue = {path.resolve()}, [path]
    for file in queue:
        for element in trees[file].iter("include"):
            included = [(folder / element.get("file", "")).resolve() for folder in (path.parent, file.parent)]
            found = next((each for each in included if each.is_file()), None)  # MuJoCo reports a missing one
            if found is not None and found not in known:
                trees[found] = _parse(found)
                known.add(found)
                queue.append(found)
    return trees


def _parse(path: Path) -> ElementTree.Element:
    """Return the root of an XML file in its declared encoding, with tags without namespaces."""
    with files.file_errors(f"{path} cannot be read as a URDF or MJCF"):
        if path.stat().st_size > MAX_FILE:
            raise FileError(
                f"{path} has {path.stat().st_size / 1e6:.0f} MB; a robot's description may have at most 10 MB"
            )
        content = files.read_bytes(path)
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FileError(f"{path} is not XML: {error}; give a URDF or an MJCF") from error
    for parent in [*root.iter()]:
        for child in [*parent]:
            if "xacro" in child.tag and child.tag.rpartition("}")[2] in ("property", "arg", "macro"):
                parent.remove(child)  # alone they have no effect
    for element in root.iter():
        namespace, _, element.tag = element.tag.rpartition("}")
        values = [(key, value[:60]) for key, value in element.items() if "${" in value or "$(" in value]
        xacro = [f"expression '{value}' ({key} of <{element.tag}>)" for key, value in values]
        xacro += [f"element <{element.tag}>"] if "xacro" in namespace else []
        if xacro:
            raise FileError(f"{path} has the xacro {xacro[0]}; expand it first: xacro {path.name} > robot.urdf")
    return root


def _require_numbers(root: ElementTree.Element, path: Path) -> None:
    """Refuse numbers that MuJoCo ignores: NaN, and a reversed range, after which a joint is endless.

    Raises:
        SceneError: with the element.
    """
    for element in root.iter():
        where = f"{path}: <{element.tag}>" + (f" '{element.get('name')}'" if element.get("name") else "")
        for key, value in element.attrib.items():
            if element.tag != "limit" and key != "name" and "nan" in value.lower().split():
                raise SceneError(f"{where} has NaN in '{key}'; give a number")
        low, high = _range_of(element)
        if element.tag == "joint" and low > high:
            raise SceneError(f"{where} has the reversed range {low:g} to {high:g}; correct it")


def _range_of(joint: ElementTree.Element) -> tuple[float, float]:
    """Return the `range` of an MJCF joint; zeros if it has none."""
    try:
        low, high = map(float, joint.get("range", "0 0").split())
    except ValueError:  # of the syntax, which MuJoCo reports
        return 0.0, 0.0
    return low, high


MIN_MASS, MIN_INERTIA = 1e-6, 1e-9
"""Mass [kg] and inertia [kg m^2] of links without them: MuJoCo requires both, kinematics uses neither."""


def _require_only_kinematics(compiler: Any) -> None:
    """Let MuJoCo accept links without mass or inertia."""
    compiler.boundmass = max(compiler.boundmass, MIN_MASS)
    compiler.boundinertia = max(compiler.boundinertia, MIN_INERTIA)
    compiler.balanceinertia = True


@contextlib.contextmanager
def capture_mujoco_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which otherwise go to stderr and to MUJOCO_LOG.TXT in the working directory."""
    import mujoco

    messages: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield messages
        messages += [str(each.message) for each in caught]
    finally:
        mujoco.set_mju_user_warning(before)


def _select_arm(
    path: Path, model: mujoco.MjModel, base: str | None, flange: str | None, extras: UrdfExtras, messages: list[str]
) -> RobotFile:
    """Select the six joints from base to flange, with their limits."""
    import mujoco

    bodies = [model.body(i).name for i in range(model.nbody)]
    sites = [name for i in range(model.nsite) if (name := model.site(i).name)]
    usual = [name for name in _FLANGES if name in bodies or name in sites]
    end = flange or min(usual, key=lambda name: _flange_tilt(model, name) > _MAX_TILT, default=None)  # else the first
    if end is None:
        raise SceneError(
            f"{path} has no link named flange or tool0; name the flange's link (robot.flange_link): "
            f"{_name_list(bodies[1:] + sites)}"
        )
    if end not in bodies and end not in sites:
        raise SceneError(f"{path} has no link '{end}' for the flange; it has {_name_list(bodies[1:] + sites)}")
    body = bodies.index(end) if end in bodies else int(model.site(end).bodyid[0])
    top = int(model.body_rootid[body])
    root = base or bodies[0 if model.body_jntnum[top] else top]
    if root not in bodies:
        raise SceneError(f"{path} has no link '{root}' for the base; it has {_name_list(bodies[1:])}")
    chain: list[int] = []
    while body > 0 and body != bodies.index(root):
        at = int(model.body_jntadr[body])
        chain[:0] = range(at, at + int(model.body_jntnum[body])) if at >= 0 else []
        body = int(model.body_parentid[body])
    if body == 0 and root != "world":
        raise SceneError(f"{path}: the flange '{end}' is not connected to the base '{root}'")
    names = [model.joint(joint).name for joint in chain]
    slides = [model.joint(each).name for each in chain if model.jnt_type[each] != mujoco.mjtJoint.mjJNT_HINGE]
    if len(chain) != 6 or slides:
        raise SceneError(
            f"{path} has {len(chain)} joints from '{root}' to '{end}' ({_name_list(names)}); an arm must have six "
            f"revolute joints{f'; make {_name_list(slides)} fixed' if slides else ''}"
        )
    file_warnings = [f"{path.name}: MuJoCo warns that {' '.join(text.split())}" for text in messages]
    endless = [joint for joint in chain if not model.jnt_limited[joint]]
    model.jnt_range[endless] = (-2.0 * np.pi, 2.0 * np.pi)
    if endless:
        file_warnings.append(
            f"{path.name} gives no range of {_name_list([model.joint(joint).name for joint in endless])}: -360 to 360 "
            "deg is assumed; add a range if a cable or a stop allows less"
        )
    lower, upper = model.jnt_range[chain].T
    for name, low, high in zip(names, lower, upper, strict=True):
        _require_range(path, name, low, high)
        if name in extras.mimics:
            raise SceneError(
                f"{path}: the joint '{name}' is one of the six and mimics '{extras.mimics[name][0]}'; an arm needs six "
                "independent joints"
            )
    own = model.body_rootid == top
    places = np.concatenate([model.body_pos[own], model.site_pos[own[model.site_bodyid]]])  # fixed joints, too
    if (away := np.abs(places).max()) > _MAX_LINK:
        raise SceneError(
            f"{path}: joints are {away:.3g} m apart; a URDF is in metres, this one seems to be in millimetres"
        )
    velocity = np.array([extras.velocity.get(name, np.inf) for name in names])
    _require_plausible(path, model, chain, velocity)
    if extras.soft:
        file_warnings.append(f"{path.name} has soft limits, which are used: {', '.join(extras.soft)}")
    if _flange_tilt(model, end) > _MAX_TILT:
        file_warnings.append(
            f"{path.name}: z of the link '{end}' is across A6, but z of the flange must point out of its face (in "
            "ROS x of 'flange' and 'ee_link' does): name another link as robot.flange_link, or turn the scanner by "
            "mount.abc_deg"
        )
    home = _home(model, model.jnt_qposadr[chain])
    if home is not None and not ((home >= lower) & (home <= upper)).all():
        home = None
    return RobotFile(
        path, model, root, end, end in bodies, tuple(names), _mimic_joints(path, model, names, extras), lower, upper,
        velocity, home, tuple(file_warnings),
    )  # fmt: skip


def _flange_tilt(model: mujoco.MjModel, end: str) -> float:
    """Return the angle between z of a link or site and the axis that carries it, 0 to 90 deg [rad]; 0 without one."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, end) >= 0
    carrier = int(model.body_weldid[model.body(end).id if is_body else model.site(end).bodyid[0]])
    if not model.body_jntnum[carrier]:
        return 0.0
    z = (data.body(end) if is_body else data.site(end)).xmat.reshape(3, 3)[:, 2]
    axis = data.xaxis[model.body_jntadr[carrier] + model.body_jntnum[carrier] - 1]
    return float(np.arccos(min(1.0, abs(z @ axis))))


def _mimic_joints(path: Path, model: mujoco.MjModel, names: list[str], extras: UrdfExtras) -> tuple[MimicJoint, ...]:
    """Return the joints driven by the six joints of these names; every other joint is an error."""
    import mujoco

    mimic_joints = []
    for i in range(model.njnt):
        name = model.joint(i).name
        if name in names:
            continue
        source, ratio, offset = extras.mimics.get(name, ("", 0.0, 0.0))
        if source not in names:
            raise SceneError(
                f"{path}: the joint '{name}' is none of the six and mimics none; make it fixed or let it mimic one"
            )
        if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_HINGE:
            raise SceneError(
                f"{path}: the joint '{name}' mimics '{source}' and slides; only a revolute joint may, make it fixed"
            )
        mimic_joints.append(MimicJoint(name, names.index(source), ratio, offset))
    return tuple(mimic_joints)


def _equalities(model: mujoco.MjModel) -> dict[str, tuple[str, float, float]]:
    """Return driving joint, ratio, and offset [rad] of joints that an MJCF couples linearly to another joint."""
    import mujoco

    coupled = {}
    for i in np.flatnonzero(model.eq_active0).tolist():
        one, other = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        offset, ratio, *curved = model.eq_data[i][:5].tolist()
        if model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT and other >= 0 and not any(curved):
            offset += model.qpos0[model.jnt_qposadr[one]] - ratio * model.qpos0[model.jnt_qposadr[other]]
            coupled[model.joint(one).name] = model.joint(other).name, ratio, offset
    return coupled


def _home(model: mujoco.MjModel, values: NDArray[np.integer]) -> Floats | None:
    """Return the angles of the key named home in an MJCF."""
    keys = [key for key in range(model.nkey) if model.key(key).name == "home"]
    return np.array(model.key_qpos[keys[0]][values]) if keys else None


def _name_list(names: list[str]) -> str:
    return ", ".join(names) if names else "none"


def _prepare_urdf(
    root: ElementTree.Element, path: Path, packages: Mapping[str, Path], assets: dict[str, bytes]
) -> UrdfExtras:
    """Keep frames, remove visuals, resolve meshes, in place; return the data that MuJoCo ignores.

    Args:
        root: the description.
        path: of its file.
        packages: folders of ROS packages by name.
        assets: receives meshes of formats that MuJoCo does not read, as OBJ by file name.
    """
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for number, collision in enumerate(link.findall("collision"), 1):
            collision.set("name", f"shape {number} of {link.get('name')}")  # for messages; a repeated name is a warning
        for inertial in link.findall("inertial"):  # kinematics uses neither mass nor inertia, and files have wrong ones
            inertial.clear()
            ElementTree.SubElement(inertial, "mass", value="1")
            ElementTree.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    _require_vectors(root, path)
    _require_tree(root, path)
    for mesh in root.iter("mesh"):
        file = _mesh_file(mesh.get("filename", ""), path, packages)
        if converted := _as_obj(file):
            name = f"{file.stem}_{len(assets)}.obj"
            assets[name] = converted
            mesh.set("filename", name)
        else:
            mesh.set("filename", str(file))
    compiler = _child(_child(root, "mujoco"), "compiler")
    options = {"fusestatic": "false", "discardvisual": "true", "strippath": "false", "balanceinertia": "true"}
    compiler.attrib.update(options | {"boundmass": str(MIN_MASS), "boundinertia": str(MIN_INERTIA)})
    return _read_joints(root, path)


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Return the first child with a tag, added if there is none."""
    child = element.find(tag)
    return ElementTree.SubElement(element, tag) if child is None else child


def _require_vectors(root: ElementTree.Element, path: Path) -> None:
    """Refuse vectors that are no numbers, and angles in degrees.

    Raises:
        SceneError: with the element.
    """
    for element in root.iter():
        for key in _VECTORS.get(element.tag, ()):
            numbers = [_to_number(word, key, element, path) for word in element.get(key, "").split()]
            if key == "rpy" and max(map(abs, numbers), default=0) > _MAX_ANGLE:
                raise SceneError(
                    f"{path}: rpy of <{element.tag}> is '{element.get(key)}', more than a turn; angles are in radians, "
                    "these seem to be in degrees"
                )


def _read_joints(root: ElementTree.Element, path: Path) -> UrdfExtras:
    """Return speeds, mimic joints and soft limits of a URDF; reduce the limits to the soft ones, in place.

    Raises:
        SceneError: if a revolute joint has no range, or a number is none.
    """
    extras = UrdfExtras()
    for joint in root.findall("joint"):
        name, limit, mimic = joint.get("name", ""), joint.find("limit"), joint.find("mimic")
        if limit is not None and (speed := _number(limit, "velocity", 0.0, path)) > 0.0:
            extras.velocity[name] = speed
        if mimic is not None:
            ratio, offset = _number(mimic, "multiplier", 1.0, path), _number(mimic, "offset", 0.0, path)
            extras.mimics[name] = (mimic.get("joint", ""), ratio, offset)
            continue
        if joint.get("type") != "revolute":
            continue
        if limit is None or limit.get("lower") is None or limit.get("upper") is None:
            raise SceneError(f"{path}: the joint '{name}' has no limits; add <limit lower upper velocity>")
        # MuJoCo treats an empty range as none, and the joint as endless.
        lower, upper = _number(limit, "lower", 0.0, path), _number(limit, "upper", 0.0, path)
        _require_range(path, name, lower, upper)
        soft = joint.find("safety_controller")
        if soft is not None and soft.get("soft_lower_limit") and soft.get("soft_upper_limit"):
            low = max(lower, _number(soft, "soft_lower_limit", lower, path))
            high = min(upper, _number(soft, "soft_upper_limit", upper, path))
            _require_range(path, name, low, high, "<safety_controller soft_lower_limit soft_upper_limit>")
            if (low, high) != (lower, upper):
                limit.attrib.update(lower=str(low), upper=str(high))
                extras.soft.append(f"{name} {np.degrees(low):.6g} to {np.degrees(high):.6g} deg")
    return extras


_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")


def _require_tree(root: ElementTree.Element, path: Path) -> None:
    """Refuse a URDF whose links and joints are no tree with unique names.

    Raises:
        SceneError: with the name.
    """
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    for kind, names in (("link", links), ("joint", [joint.get("name", "") for joint in joints])):
        repeated = next((name for name in names if names.count(name) > 1 or not name), None)
        if repeated is not None:
            problem = f"two {kind}s named '{repeated}'" if repeated else f"a {kind} without a name"
            raise SceneError(f"{path} has {problem}; give each {kind} its own name")
    parents: dict[str, tuple[str, str]] = {}  # of each child: joint and parent
    for joint in joints:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in _JOINT_TYPES:
            known = ", ".join(_JOINT_TYPES)
            raise SceneError(f"{path}: the joint '{name}' has the type '{kind}'; supported are {known}")
        ends = [
            (element.get("link", "") if (element := joint.find(end)) is not None else "") for end in ("parent", "child")
        ]
        for end, link in zip(("parent", "child"), ends, strict=True):
            if link not in links:
                raise SceneError(f"{path}: the joint '{name}' has the {end} '{link}', which is none of the links")
        if ends[1] in parents:
            raise SceneError(
                f"{path}: the link '{ends[1]}' is the child of two joints, '{parents[ends[1]][0]}' and '{name}'; links "
                "must form a tree"
            )
        parents[ends[1]] = name, ends[0]
    without_cycle: set[str] = set()
    for link in links:
        chain = {link: None}
        while link in parents and link not in without_cycle:
            link = parents[link][1]
            if link in chain:
                names = [*chain, link]
                cycle = _name_list(names[names.index(link) :])
                raise SceneError(f"{path}: the links {cycle} form a cycle; links must form one tree")
            chain[link] = None
        without_cycle.update(chain)
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise SceneError(
            f"{path} has {len(roots)} links without a parent ({_name_list(roots)}); links must form one tree: connect "
            "them by fixed joints"
        )


def _as_obj(file: Path) -> bytes | None:
    """Return a mesh as OBJ with triangles; None if MuJoCo reads the file: binary STL of at most 200,000 faces.

    Raises:
        FileError: if the format is not supported, or the mesh is broken.
    """
    from cell.part import formats, mesh_files  # with its readers only for an arm from a file

    suffix = file.suffix.lower()
    if suffix in (".stp", ".step") or suffix not in formats.SUFFIXES:
        raise FileError(
            f"{file} is a robot's mesh of the kind '{file.suffix}', which is not supported; convert it to binary STL"
        )
    content = mesh_files.read_bytes(file)
    vertices, faces = mesh_files.parse(file, content)
    if suffix == ".stl" and len(content) == 84 + 50 * len(faces) and len(faces) <= _MAX_STL_FACES:
        return None
    rows = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    rows += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(rows) + "\n").encode()


def _require_range(
    path: Path, joint: str, lower: float, upper: float, where: str = "<limit lower upper velocity>"
) -> None:
    """Raise SceneError if a range [rad], which is given in `where`, is empty."""
    if not (np.isfinite(lower) and np.isfinite(upper) and lower < upper):
        raise SceneError(f"{path}: the joint '{joint}' has the empty range {lower:g} to {upper:g}; correct its {where}")


def _number(element: ElementTree.Element, key: str, default: float, path: Path) -> float:
    """Return a number of an element.

    Raises:
        SceneError: if it is none.
    """
    return _to_number(element.get(key, str(default)), key, element, path)


def _to_number(text: str, key: str, element: ElementTree.Element, path: Path) -> float:
    with contextlib.suppress(ValueError):
        if np.isfinite(number := float(text)) or element.tag in ("limit", "safety_controller"):
            return number
    hint = "; write a decimal point" if "," in text else ""
    raise SceneError(f"{path}: {key} of <{element.tag}> is '{text[:40]}', which is not a number{hint}")


def _require_plausible(path: Path, model: mujoco.MjModel, chain: list[int], velocity: Floats) -> None:
    """Refuse numbers that no arm has: degrees in place of radians, and shapes in millimetres.

    Raises:
        SceneError: with the number and the probable cause.
    """
    span = np.ptp(model.jnt_range[chain], axis=1)
    if (span > _MAX_TURNS * 2 * np.pi).sum() >= 3:
        joint = int(np.argmax(span))
        low, high = model.jnt_range[chain[joint]]
        raise SceneError(
            f"{path}: the joint '{model.joint(chain[joint]).name}' has the range {low:g} to {high:g} rad, "
            f"{span[joint] / (2 * np.pi):.0f} turns; limits are in radians, these seem to be in degrees"
        )
    if (finite := velocity[np.isfinite(velocity)]).size and (finite > _MAX_SPEED).any():
        raise SceneError(
            f"{path}: an axis has the speed {finite.max():g} rad/s; speeds are in rad/s, these seem to be in deg/s"
        )
    links = np.linalg.norm(model.body_pos[model.jnt_bodyid[chain]], axis=1)
    length = float(links.sum())
    solid = [geom for geom in range(model.ngeom) if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    sizes, away = model.geom_rbound, np.linalg.norm(model.geom_pos, axis=1)
    largest = max(solid, key=lambda geom: float(sizes[geom] + away[geom]), default=None)
    if largest is not None and sizes[largest] + away[largest] > _MAX_SHAPE * length > 0:
        body = model.body(model.geom_bodyid[largest]).name
        raise SceneError(
            f"{path}: a shape of the link '{body}' is {2 * sizes[largest]:.3g} m wide, {away[largest]:.3g} m from its "
            f"frame, but the links of the arm are {length:.3g} m long in all; an origin is in metres, and a mesh in "
            'millimetres needs scale="0.001 0.001 0.001"'
        )


def mesh_files(path: Path, packages: Mapping[str, Path]) -> list[Path]:
    """Return the collision meshes of a URDF, or included files and all meshes of an MJCF, each once, in order.

    Args:
        path: the description, which can be read.
        packages: folders of ROS packages by name.

    Raises:
        FileError: if a mesh is missing.
    """
    import mujoco

    (_, root), *included = _parse_all(path).items()
    if root.tag == "robot":
        names = [mesh.get("filename", "") for collision in root.iter("collision") for mesh in collision.iter("mesh")]
    else:
        try:
            with capture_mujoco_warnings():
                spec = mujoco.MjSpec.from_file(str(path))  # a mesh's folder can be named in five ways
        except ValueError as error:
            raise FileError(f"{path} cannot be read as an arm: {describe_refusal(error)}") from error
        stated = [Path(mesh.file) for mesh in spec.meshes if mesh.file]
        names = [str(Path(spec.meshdir) / (file.name if spec.strippath else file)) for file in stated]
    return [*(file for file, _ in included), *(_mesh_file(name, path, packages) for name in dict.fromkeys(names))]


def _mesh_file(name: str, path: Path, packages: Mapping[str, Path]) -> Path:
    """Return the path of a mesh that a description names; raise FileError if it does not exist."""
    if not name.strip():
        raise FileError(f"{path} has a <mesh> without a file name; name its file")
    plain = name.removeprefix("file://")
    if name.startswith("package://"):
        package, _, inside = name.removeprefix("package://").partition("/")
        paths = [packages[package] / inside] if package in packages else []
        # The description lies beside its package's folder, or in it.
        paths += [folder / inside for folder in path.resolve().parents if folder.name == package]
        paths += [folder / package / inside for folder in path.resolve().parents]
        hint = f"; name the folder of the package: --package {package}=DIR"
    else:
        paths = [path.resolve().parent / plain]
        folder = paths[0].parent
        others = (
            [each.name for each in folder.iterdir() if each.name.lower() == paths[0].name.lower() and each.is_file()]
            if folder.is_dir()
            else []
        )
        hint = (
            f"; there is {others[0]}: names are case-sensitive"
            if others
            else "; copy the file there, or correct the name"
        )
        hint = "; write / between folders" if "\\" in name else hint
    for file in paths:
        if file.is_file():
            return file
    raise FileError(f"{path} names the mesh {name}, but {paths[0]} does not exist{hint}")
