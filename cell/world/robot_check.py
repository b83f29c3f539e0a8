"""`cell robot`: properties of an arm in a file, missing ones, and the pairs of links that touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cell.errors import SceneError
from cell.formatting import comma_list
from cell.robot import model as robot
from cell.robot import robot_file
from cell.robot.arm import chain_of
from cell.robot.model import AXES
from cell.robot.normalise import ACCELERATION_TIME, JERK_TIME
from cell.world.robot_spec import JOINED, is_normalised, load_robot, modification_times
from cell.world.self_collision import N_POSES, LinkPairs
from cell.world.shapes import meshes_of
from planner.errors import PlannerError
from planner.geometry.distance import is_closed
from planner.kinematics.fit import POLISH_ABOVE, fit_closed_form

if TYPE_CHECKING:
    import mujoco

    from cell.robot.robot_file import RobotFile


_PLACEHOLDER_DEG_S = (90.0,) * 6  # not reported: an arm without speeds needs some to compile


@dataclass(frozen=True, slots=True)
class RobotReport:
    """Properties of an arm.

    Attributes:
        file: path of the file.
        base: its base link.
        flange: its flange link.
        joints: names of the six joints in the file.
        family: of the closed form that solves the inverse kinematics.
        dimensions_mm: lengths of the family.
        signs: 1 or -1 for each axis: angle of the family's chain = sign * axis + offset.
        offsets_deg: these offsets.
        residual_mm: largest error of the fitted arm at seeded angles.
        polished: whether each solution is refined on the chain of the file.
        limits_deg: lowest and highest angle of each axis.
        velocity_deg_s: of each axis; None: not in the file.
        followers: mimic joints, "joint by A3 x -1".
        shapes: number of collision shapes of each body.
        not_closed: meshes that are not closed.
        excused: pairs of links that touch at every seeded pose, and are not checked.
        apart: pairs that come near each other and are not checked, with their proven distance at all angles [mm].
        near: pairs with a smaller clearance than the cell's, and this clearance [mm].
        home_deg: configuration at which motions begin and end; None: none was found.
        home_is: origin of the home.
        contacts_at_home: pairs of links that touch there.
        missing: assumptions for what the file does not state, and warnings of MuJoCo, one sentence each.
    """

    file: str
    base: str
    flange: str
    joints: tuple[str, ...]
    family: str
    dimensions_mm: dict[str, float]
    signs: tuple[int, ...]
    offsets_deg: tuple[float, ...]
    residual_mm: float
    polished: bool
    limits_deg: tuple[tuple[float, float], ...]
    velocity_deg_s: tuple[float | None, ...]
    followers: tuple[str, ...]
    shapes: dict[str, int]
    not_closed: tuple[str, ...]
    excused: tuple[str, ...]
    apart: dict[str, float]
    near: dict[str, float]
    home_deg: tuple[float, ...] | None
    home_is: str
    contacts_at_home: tuple[str, ...]
    missing: tuple[str, ...]

    def summary(self) -> dict[str, object]:
        """Return the report as JSON values."""
        return {"schema": 1, **asdict(self)}

    def rows(self) -> list[tuple[str, str]]:
        """Return the report as a table of two columns."""
        polish = "each solution is polished on the file's own axes" if self.polished else "exact"
        limits = [
            f"{axis} {low:g}..{high:g}, {'no speed' if speed is None else f'{speed:g}/s'}"
            for axis, (low, high), speed in zip(AXES, self.limits_deg, self.velocity_deg_s, strict=True)
        ]
        apart, near = (
            ", ".join(f"{pair} ({mm:.2g} mm)" for pair, mm in each.items()) for each in (self.apart, self.near)
        )
        home = "none found; give robot.home_deg" if self.home_deg is None else f"{comma_list(self.home_deg)} deg"
        return [
            ("arm", f"{self.base} to {self.flange}: {', '.join(self.joints)}"),
            ("family", f"{self.family}, off by {self.residual_mm:.2g} mm: {polish}"),
            ("dimensions", ", ".join(f"{name} {length:.4g}" for name, length in self.dimensions_mm.items()) + " mm"),
            ("signs, zeros", f"{comma_list(self.signs)}; {comma_list(self.offsets_deg)} deg"),
            ("axes", "; ".join(limits) + " (deg)"),
            ("driven along", ", ".join(self.followers) or "nothing"),
            ("shapes", ", ".join(f"{body} {count}" for body, count in self.shapes.items())),
            ("not closed", ", ".join(self.not_closed) or "none: every mesh has an inside"),
            (
                "allowed collisions",
                f"{', '.join(self.excused) or 'none'} (touch at each of {N_POSES} poses), and neighbours",
            ),
            ("never in collision", apart or "none that come near each other"),
            ("reduced clearance", near or "none"),
            ("home", f"{home} ({self.home_is})"),
            ("contacts at home", ", ".join(self.contacts_at_home) or "none"),
            *[("missing", sentence) for sentence in self.missing],
        ]


def report(
    path: Path, base: str | None = None, flange: str | None = None, packages: Mapping[str, str] | None = None
) -> tuple[RobotReport, mujoco.MjModel]:
    """Read an arm; return its properties and the compiled model.

    Args:
        path: a URDF or an MJCF.
        base: its base link; None: the root.
        flange: its flange link; None: the one with a usual name.
        packages: folders of ROS packages by name.

    Raises:
        FileError: if the file or a mesh cannot be read.
        SceneError: if the arm cannot be used for planning.
    """
    if is_normalised(path):
        raise SceneError(f"{path} is normalised already; cell check reports on it as part of a scene")
    folders = packages or {}
    file = robot_file.read_robot(
        path, base=base, flange=flange, packages={name: Path(each) for name, each in folders.items()}
    )
    velocity = None if np.isfinite(file.velocity).all() else _PLACEHOLDER_DEG_S
    package_folders = tuple(sorted(folders.items()))
    model = load_robot(
        path, base, flange, package_folders, velocity, stamp=modification_times(path, package_folders)
    ).compile()
    try:
        fitted = fit_closed_form(chain_of(model))
    except PlannerError as error:
        raise SceneError(f"{path}: {error}") from error
    links = LinkPairs(model)
    home = robot.home(model) if model.nkey else None
    if home is not None:
        links.set_configuration(home)
    speeds = np.degrees(file.velocity)
    lengths = fitted.form.lengths
    return RobotReport(
        file=str(path),
        base=file.base,
        flange=file.flange,
        joints=file.joints,
        family=fitted.family,
        dimensions_mm={each.name: round(1000 * getattr(lengths, each.name), 3) + 0.0 for each in fields(lengths)},
        signs=tuple(int(sign) for sign in fitted.signs),
        offsets_deg=tuple(float(angle) + 0.0 for angle in np.degrees(fitted.offsets).round(4)),
        residual_mm=1000 * fitted.residual,
        polished=fitted.residual > POLISH_ABOVE,
        limits_deg=tuple((float(low), float(high)) for low, high in np.degrees([file.lower, file.upper]).T.round(3)),
        velocity_deg_s=tuple(round(float(speed), 3) if np.isfinite(speed) else None for speed in speeds),
        followers=tuple(f"{each.joint} by {AXES[each.axis]} x {each.ratio:g}" for each in file.mimic_joints),
        shapes={name: int(model.body(name).geomnum[0]) for name in robot.bodies(model)},
        not_closed=tuple(name for name, mesh in meshes_of(model).items() if not is_closed(mesh)),
        excused=tuple(_joined_pairs(model)),
        apart=_pair_distances(model, robot.SEPARATION_PREFIX),
        near=_pair_distances(model, robot.CLEARANCE_PREFIX),
        home_deg=None if home is None else tuple(np.degrees(home).round(4).tolist()),
        home_is="the file's" if file.home is not None else "found: the flange down at half the reach",
        contacts_at_home=()
        if home is None
        else tuple(f"{one} with {other}" for one, other in links.pairs if links.distance((one, other), 1e-6) <= 0),
        missing=tuple(_missing(file)),
    ), model


def _pair_distances(model: mujoco.MjModel, prefix: str) -> dict[str, float]:
    """Return the pairs with a numeric value of this name prefix, and the value [mm]."""
    numbers = [number for number in range(model.nnumeric) if model.numeric(number).name.startswith(prefix)]
    return {
        " with ".join(robot.named_pair(model, each)): round(1000 * float(model.numeric(each).data[0]), 3)
        for each in numbers
    }


def _joined_pairs(model: mujoco.MjModel) -> list[str]:
    """Return the pairs that are joined by something that the chain does not show."""
    pairs = []
    for number in range(model.nexclude):
        if model.exclude(number).name.startswith(JOINED):
            pair = int(model.exclude_signature[number])
            pairs.append(f"{model.body(pair >> 16).name} with {model.body(pair & 0xFFFF).name}")
    return pairs


def _missing(file: RobotFile) -> list[str]:
    """Describe missing properties of the file, and the assumptions for them."""
    slow = [name for name, speed in zip(file.joints, file.velocity, strict=True) if not np.isfinite(speed)]
    return [
        *file.warnings,
        *([f"no speed of {', '.join(slow)}: give robot.velocity_deg_s"] if slow else []),
        f"no accelerations and jerks: a speed is reached in {ACCELERATION_TIME:g} s, an acceleration in "
        f"{JERK_TIME:g} s, unless robot.acceleration_deg_s2 and robot.jerk_deg_s3 are given",
    ]
