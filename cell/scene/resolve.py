"""What the scene leaves open, settled for one part: standoffs, baseline, range, planning faces. One table of defaults.

The result is in SI units and holds no None; it is written to `scene.resolved.json`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.errors import SceneError
from cell.part.workpiece import Workpiece
from cell.scene.presets import PRESETS
from cell.scene.scene import Scene
from planner.viewpoints.viewpoints import enclosing_radius

# part: planning faces, standoff [mm], baseline [mm]; the faces are the paper's (Tables 1 and 2), changed only with a
# line in CHANGELOG.md.
_DEFAULTS = {
    "mseke": (930, 300.0, 75.0),
    "mug": (748, 100.0, 25.0),
    "robinet": (814, 100.0, 25.0),
    "petanque": (338, 300.0, 75.0),
    "humerus": (276, 30.0, 7.5),
    "st-jean": (746, 300.0, 75.0),
}
_FACES = 1000
_STANDOFF_MM = 300.0
_STANDOFF_RADII = 1.5  # a part of the user's: never nearer than this many radii of its bounding sphere
_BASELINE_SHARE = 0.25
_RANGE_SHARES = (0.5, 1.5)
_LINE_KEYS = ("fan_deg", "sweep_mm", "sweep_deg", "sweep_steps", "line_points")
_LEAST_CLEARANCE_MM = 1.0  # steps between collision checks are as long as the clearance: below, a motion takes millions


@dataclass(frozen=True, slots=True)
class Settings:
    """Settled numbers, SI units.

    Attributes:
        faces: of the planning mesh.
        standoffs: distances from surface to source [m].
        rolls: [rad].
        scanner: keyword arguments of the scanner plug-in (`_mm`, `_deg`), at the resolution of a scan.
        planning_scanner: the same at the planning resolution, for `rays`.
        sphere_radius: of the view sphere [m]; the part's nearest point stays beyond the near limit of the range.
    """

    faces: int
    standoffs: tuple[float, ...]
    rolls: tuple[float, ...]
    scanner: Mapping[str, Any]
    planning_scanner: Mapping[str, Any]
    sphere_radius: float


def resolve(scene: Scene, part: Workpiece) -> Settings:
    """Settle what the scene leaves to the part.

    Raises:
        SceneError: if a standoff is outside the scanner's range, or the clearance too small to plan a motion with.
    """
    if scene.clearance_mm < _LEAST_CLEARANCE_MM:
        raise SceneError(
            f"clearance_mm is {scene.clearance_mm:g}; a motion is checked at steps of the clearance, so it must be at "
            f"least {_LEAST_CLEARANCE_MM:g}"
        )
    if scene.arrival_mm is not None and scene.arrival_mm > scene.clearance_mm / 10:
        raise SceneError(
            f"arrival_mm is {scene.arrival_mm:g}; it must be at most a tenth of clearance_mm, "
            f"{scene.clearance_mm / 10:g}"
        )
    built_in = _DEFAULTS.get(part.name) if scene.part.path is None else None
    radius_mm = 1000 * enclosing_radius(part.reference, part.centre)
    standoffs_mm = _standoffs_mm(scene, built_in, radius_mm)
    near, far = scene.scanner.range_mm or (_RANGE_SHARES[0] * min(standoffs_mm), _RANGE_SHARES[1] * max(standoffs_mm))
    for standoff in standoffs_mm:
        if not near <= standoff <= far:
            raise SceneError(
                f"the standoff of {standoff:g} mm is outside the scanner's range of {near:g} to {far:g} mm; choose a "
                "standoff inside it or change scanner.range_mm"
            )
    baseline_mm = scene.scanner.baseline_mm
    if baseline_mm is None:
        own = built_in is not None and scene.plan.standoffs_mm is None
        baseline_mm = built_in[2] if built_in is not None and own else _BASELINE_SHARE * standoffs_mm[0]
    scanner = {
        "fov_deg": scene.scanner.fov_deg,
        "resolution_deg": scene.scanner.resolution_deg,
        "range_mm": (near, far),
        "baseline_mm": baseline_mm,
        "grazing_max_deg": scene.scanner.grazing_max_deg,
        "sensor_grazing_max_deg": scene.scanner.sensor_grazing_max_deg,
        "sigma_angle_mdeg": scene.scanner.sigma_angle_mdeg,
    }
    for name in ("sensor_fov_deg", "sensor_tilt_deg", "depth_of_field_mm"):  # given only where they limit
        if getattr(scene.scanner, name) is not None:
            scanner[name] = getattr(scene.scanner, name)
    scanner = _of_the_plug_in(scene, scanner)
    planning_step = scene.scanner.planning_resolution_deg
    planned = {"resolution_deg": (planning_step, planning_step)} if "resolution_deg" in scanner else {}
    return Settings(
        faces=_faces(scene, built_in, len(part.reference.faces)),
        standoffs=tuple(standoff / 1000 for standoff in standoffs_mm),
        rolls=tuple(np.deg2rad(_distinct(scene.plan.rolls_deg)).tolist()),
        scanner=scanner,
        planning_scanner={**scanner, **planned},
        sphere_radius=max(*standoffs_mm, radius_mm + near) / 1000,
    )


def _standoffs_mm(scene: Scene, built_in: tuple[int, float, float] | None, radius_mm: float) -> tuple[float, ...]:
    if scene.plan.standoffs_mm is not None:
        return tuple(dict.fromkeys(scene.plan.standoffs_mm))
    if scene.scanner.sensor is not None and scene.scanner.range_mm is not None:
        return (sum(scene.scanner.range_mm) / 2,)  # a real sensor is used in the middle of its range
    if built_in is not None:
        return (built_in[1],)
    wanted = max(_STANDOFF_MM, _STANDOFF_RADII * radius_mm)
    if scene.scanner.range_mm is not None:
        near, far = scene.scanner.range_mm
        wanted = min(max(wanted, near), far)
    return (wanted,)


def _of_the_plug_in(scene: Scene, usual: Mapping[str, Any]) -> dict[str, Any]:
    """What the scanner's class takes: of the usual keys those that it has, and the keys of its own that are given."""
    from cell import scanners

    named = {key: getattr(scene.scanner, key) for key in _LINE_KEYS if getattr(scene.scanner, key) is not None}
    known = scanners.keys(scene.scanner.type)
    offered = {**usual, **named, **(scene.scanner.model_extra or {})}
    return {key: value for key, value in offered.items() if known is None or key in known}


def _distinct(rolls_deg: tuple[float, ...]) -> list[float]:
    """Each roll once; 0 and 360 degrees are the same viewpoint."""
    first = {roll % 360: roll for roll in reversed(rolls_deg)}
    return [roll for roll in rolls_deg if first.pop(roll % 360, None) is not None]


def _faces(scene: Scene, built_in: tuple[int, float, float] | None, reference_faces: int) -> int:
    if scene.plan.percent_kept is not None:
        return max(4, round(reference_faces * scene.plan.percent_kept / 100))
    if scene.plan.faces is not None:
        return scene.plan.faces
    return round(PRESETS[scene.plan.preset].faces_factor * (built_in[0] if built_in is not None else _FACES))
