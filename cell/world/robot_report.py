"""`cell robot`: what was recognised of an arm in a file, what is missing of it, and which of its links touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cell.errors import SceneError
from cell.robot import model as robot
from cell.robot import robot_file
from cell.robot.arm import chain_of
from cell.robot.model import AXES
from cell.robot.normalise import ACCELERATION_TIME, JERK_TIME
from cell.words import listed
from cell.world.robot_spec import JOINED, is_normalised, load_robot, modification_times
from cell.world.self_collision import N_POSES, LinkPairs
from cell.world.shapes import meshes_of
from planner.errors import PlannerError
from planner.geometry.distance import is_closed
from planner.kinematics.fit import POLISH_ABOVE, fit_closed_form

if TYPE_CHECKING:
    import mujoco

    from cell.robot.robot_file import RobotFile


_GUESSED_DEG_S = (90.0,) * 6  # shown nowhere: lets an arm without speeds be looked at


@dataclass(frozen=True, slots=True)
class RobotReport:
    """What is known of an arm.

    Attributes:
        file: that says it.
        base: its base link.
        flange: its flange link.
        joints: names of the six joints in the file.
        family: whose closed form solves it.
        dimensions_mm: the family's lengths.
        signs: 1 or -1 for each axis: angle of the family's chain = sign * axis + offset.
        offsets_deg: these offsets.
        residual_mm: largest miss of the fitted arm at seeded angles.
        polished: whether each solution is polished on the file's own chain.
        limits_deg: lowest and highest angle of each axis.
        velocity_deg_s: of each axis; None where the file says none.
        followers: what is driven along, "joint by A3 x -1".
        shapes: number of collision shapes of each body.
        not_closed: meshes that are not closed.
        excused: pairs of links that touch at every seeded pose, and are not guarded.
        apart: pairs that come near each other and are not guarded: how far apart they are proven to be at all angles
            [mm].
        near: pairs that are guarded by less than a cell's clearance, and by how much [mm].
        home_deg: where motions begin and end; None: none was found.
        home_is: whether it is the file's.
        contacts_at_home: pairs of links that touch there.
        missing: what the file does not say and what stands for it, and what MuJoCo warned of, one sentence each.
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
        """The report as JSON values."""
        return {"schema": 1, **asdict(self)}

    def rows(self) -> list[tuple[str, str]]:
        """The report as a table of two columns."""
        polish = "each solution is polished on the file's own axes" if self.polished else "exact"
        limits = [
            f"{axis} {low:g}..{high:g}, {'no speed' if speed is None else f'{speed:g}/s'}"
            for axis, (low, high), speed in zip(AXES, self.limits_deg, self.velocity_deg_s, strict=True)
        ]
        apart, near = (
            ", ".join(f"{pair} ({mm:.2g} mm)" for pair, mm in each.items()) for each in (self.apart, self.near)
        )
        home = "none found; give robot.home_deg" if self.home_deg is None else f"{listed(self.home_deg)} deg"
        return [
            ("arm", f"{self.base} to {self.flange}: {', '.join(self.joints)}"),
            ("family", f"{self.family}, off by {self.residual_mm:.2g} mm: {polish}"),
            ("dimensions", ", ".join(f"{name} {length:.4g}" for name, length in self.dimensions_mm.items()) + " mm"),
            ("signs, zeros", f"{listed(self.signs)}; {listed(self.offsets_deg)} deg"),
            ("axes", "; ".join(limits) + " (deg)"),
            ("driven along", ", ".join(self.followers) or "nothing"),
            ("shapes", ", ".join(f"{body} {count}" for body, count in self.shapes.items())),
            ("not closed", ", ".join(self.not_closed) or "none: every mesh has an inside"),
            ("not guarded", f"{', '.join(self.excused) or 'none'} (touch at each of {N_POSES} poses), and neighbours"),
            ("proven apart", apart or "none that come near each other"),
            ("guarded by less", near or "none"),
            ("home", f"{home} ({self.home_is})"),
            ("contacts at home", ", ".join(self.contacts_at_home) or "none"),
            *[("missing", sentence) for sentence in self.missing],
        ]


def report(
    path: Path, base: str | None = None, flange: str | None = None, packages: Mapping[str, str] | None = None
) -> tuple[RobotReport, mujoco.MjModel]:
    """Read an arm and look at it.

    Args:
        path: a URDF or an MJCF.
        base: link that is its base; None: the root.
        flange: link that is its flange; None: the one of a usual name.
        packages: folders of ROS packages by name.

    Returns:
        What is known, and the compiled model of the arm.

    Raises:
        FileError: if the file or a mesh cannot be read.
        SceneError: if it is no arm that can be planned with.
    """
    if is_normalised(path):
        raise SceneError(f"{path} is in this program's own form already; cell check says what a scene makes of it")
    folders = packages or {}
    file = robot_file.read_robot(
        path, base=base, flange=flange, packages={name: Path(each) for name, each in folders.items()}
    )
    without = None if np.isfinite(file.velocity).all() else _GUESSED_DEG_S
    named = tuple(sorted(folders.items()))
    model = load_robot(path, base, flange, named, without, stamp=modification_times(path, named)).compile()
    try:
        fitted = fit_closed_form(chain_of(model))
    except PlannerError as error:
        raise SceneError(f"{path}: {error}") from error
    own = LinkPairs(model)
    home = robot.home(model) if model.nkey else None
    if home is not None:
        own.set_configuration(home)
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
        excused=tuple(_excused(model)),
        apart=_told(model, robot.SEPARATION_PREFIX),
        near=_told(model, robot.CLEARANCE_PREFIX),
        home_deg=None if home is None else tuple(np.degrees(home).round(4).tolist()),
        home_is="the file's" if file.home is not None else "found: the flange down at half the reach",
        contacts_at_home=()
        if home is None
        else tuple(f"{one} with {other}" for one, other in own.pairs if own.distance((one, other), 1e-6) <= 0),
        missing=tuple(_missing(file)),
    ), model


def _told(model: mujoco.MjModel, kind: str) -> dict[str, float]:
    """Pairs of which the numerics of a kind speak, and their distance [mm]."""
    numbers = [number for number in range(model.nnumeric) if model.numeric(number).name.startswith(kind)]
    return {
        " with ".join(robot.named_pair(model, each)): round(1000 * float(model.numeric(each).data[0]), 3)
        for each in numbers
    }


def _excused(model: mujoco.MjModel) -> list[str]:
    """Pairs that are joined by something that the chain does not show."""
    found = []
    for number in range(model.nexclude):
        if model.exclude(number).name.startswith(JOINED):
            pair = int(model.exclude_signature[number])
            found.append(f"{model.body(pair >> 16).name} with {model.body(pair & 0xFFFF).name}")
    return found


def _missing(file: RobotFile) -> list[str]:
    """What the file does not say, and what stands for it."""
    slow = [name for name, speed in zip(file.joints, file.velocity, strict=True) if not np.isfinite(speed)]
    return [
        *file.warnings,
        *([f"no speed of {', '.join(slow)}: give robot.velocity_deg_s"] if slow else []),
        f"no accelerations and jerks: a speed is reached in {ACCELERATION_TIME:g} s, an acceleration in "
        f"{JERK_TIME:g} s, unless robot.acceleration_deg_s2 and robot.jerk_deg_s3 say otherwise",
    ]
