"""What is changed of a URDF before MuJoCo reads it, and what MuJoCo leaves out of it.

Links that do not move keep their frames, visuals go, mesh paths are resolved. Speeds and joints that mimic another are
taken from the file itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cell.errors import SceneError
from cell.robot.mesh_paths import mesh_file


@dataclass(frozen=True, slots=True)
class Unread:
    """What MuJoCo leaves out of a URDF.

    Attributes:
        velocity: speed of each joint that has one [rad/s].
        mimics: the joint that a joint follows, ratio, and offset [rad].
    """

    velocity: Mapping[str, float] = field(default_factory=dict)
    mimics: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)


def prepare(root: ElementTree.Element, path: Path, packages: Mapping[str, Path]) -> Unread:
    """Frames kept, visuals out, mesh paths absolute; what MuJoCo leaves out is returned."""
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(mesh_file(mesh.get("filename", ""), path, packages)))
    settings = root.find("mujoco")
    if settings is None:
        settings = ElementTree.SubElement(root, "mujoco")
    compiler = settings.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(settings, "compiler")
    read = {"fusestatic": "false", "discardvisual": "true", "strippath": "false", "balanceinertia": "true"}
    compiler.attrib.update(read)
    velocity, mimics = {}, {}
    for joint in root.findall("joint"):
        name, limit, mimic = joint.get("name", ""), joint.find("limit"), joint.find("mimic")
        if limit is not None and _number(limit, "velocity", 0.0) > 0.0:
            velocity[name] = _number(limit, "velocity", 0.0)
        if mimic is not None:
            mimics[name] = (mimic.get("joint", ""), _number(mimic, "multiplier", 1.0), _number(mimic, "offset", 0.0))
        if joint.get("type") == "revolute" and (
            limit is None or limit.get("lower") is None or limit.get("upper") is None
        ):
            raise SceneError(f"{path}: the joint '{name}' has no limits; give it <limit lower upper velocity>")
        if joint.get("type") == "revolute" and limit is not None and mimic is None:
            # MuJoCo takes a range that is empty for none at all, and the joint for one that turns without end.
            require_range(path, name, _number(limit, "lower", np.nan), _number(limit, "upper", np.nan))
    return Unread(velocity, mimics)


def require_range(path: Path, joint: str, lower: float, upper: float) -> None:
    """Refuse a range [rad] that holds no angle.

    Raises:
        SceneError: with the joint's name.
    """
    if not (np.isfinite(lower) and np.isfinite(upper) and lower < upper):
        raise SceneError(
            f"{path}: the joint '{joint}' has the range {lower:g} to {upper:g}, which is none; give it "
            "<limit lower upper velocity>"
        )


def _number(element: ElementTree.Element, key: str, default: float) -> float:
    try:
        return float(element.get(key, default))
    except ValueError:
        return default
