"""Settling a scene: every value that a scene leaves to its part or its scanner is filled in, once.

A settled scene has a scanner with range and baseline, a housing, a placement by the part's centre, and the planning
parameters in SI units. The device that fills open keys is the one that `scanner.sensor` names, else the built-in part's
device, else the one for the part's longest side (`_BY_SIDE`). Keys of the scene take precedence over the device's. The
standoff does not change the device; only range and baseline of the device `paper` follow the standoff.
"""

from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.part.workpiece import Workpiece
from cell.scanners import ScannerPlugin, Values
from cell.scene import sensors
from cell.scene.model import Scene
from cell.scene.sensors import Sensor
from cell.scene.validation import grazing_note
from planner.ports import Scanner
from planner.viewpoints.viewpoints import enclosing_radius

SMALL, MEDIUM, LARGE = "generic-area-small", "generic-area-medium", "generic-area-large"

_DEVICE_OF_BUILT_IN = {  # by the standoffs of the paper's objects
    **{"mseke": LARGE, "mug": MEDIUM, "robinet": MEDIUM},
    **{"petanque": LARGE, "humerus": SMALL, "st-jean": LARGE},
}
_BY_SIDE = ((30.0, SMALL), (100.0, MEDIUM))
"""Largest longest side of a part [mm] for which a device is the default, the middle of its range; above: `LARGE`."""

# Planning faces of the built-in parts are the paper's (Tables 1 and 2); a change needs a line in CHANGELOG.md.
_FACES_OF_BUILT_IN = {"mseke": 930, "mug": 748, "robinet": 814, "petanque": 338, "humerus": 276, "st-jean": 746}
_FACES = 1000
_USUAL_KEYS = (
    *("fov_deg", "resolution_deg", "range_mm", "baseline_mm"),
    *("grazing_max_deg", "sensor_grazing_max_deg", "sigma_angle_mdeg"),
)
_OPTIONAL_KEYS = (
    *("sensor_fov_deg", "sensor_tilt_deg", "depth_of_field_mm", "max_spacing_mm"),
    *("fan_deg", "sweep_mm", "sweep_deg", "sweep_steps", "line_points", "profile_rate_hz"),
)
_MIN_CLEARANCE_MM = 1.0  # collision checks are a clearance apart: a smaller one needs millions of checks a motion
_SPACING_TOLERANCE = 1e-3  # relative


@dataclass(frozen=True, slots=True)
class Settings:
    """Planning parameters of a settled scene, SI units.

    Attributes:
        faces: of the planning mesh.
        standoffs: distances from surface to source [m].
        rolls: about the viewing axis [rad].
        scanner: keyword arguments of the scanner plug-in (`_mm`, `_deg`), at the resolution of a scan.
        planning_scanner: the same at the planning resolution, for `fill = "rays"`.
        sphere_radius: of the view sphere [m]; the part's nearest point is beyond the near limit of the range.
    """

    faces: int
    standoffs: tuple[float, ...]
    rolls: tuple[float, ...]
    scanner: Values
    planning_scanner: Values
    sphere_radius: float


@dataclass(frozen=True, slots=True, eq=False)
class SettledScene:
    """A scene with its part and scanner, nothing left open.

    Attributes:
        scene: with the device's range, baseline and housing, and the placement by the part's centre.
        part: the part, with its regions.
        settings: planning parameters.
        scanner: the sensor model.
        baseline_mm: from source to sensor.
    """

    scene: Scene
    part: Workpiece
    settings: Settings
    scanner: ScannerPlugin
    baseline_mm: float


def settle(scene: Scene, part: Workpiece) -> SettledScene:
    """Settle a scene for its part.

    Raises:
        SceneError: if a standoff is outside the scanner's range, the clearance is too small to plan a motion with, the
            scanner cannot be made, or a region demands a spacing that the scanner cannot attain.
    """
    scene = settle_scene(scene, part)
    settings = _settings(scene, part)
    scanner = scanners.make(scene.scanner.type, settings.scanner)
    require_attainable(scene, scanner)
    settings = replace(settings, scanner=scanners.with_own_parameters(settings.scanner, scanner))
    return SettledScene(scene, part, settings, scanner, scanners.baseline_mm(settings.scanner, scanner))


def settle_scene(scene: Scene, part: Workpiece) -> Scene:
    """Fill in the device, and express the placement by the part's centre."""
    placement = scene.placement.by_centre(part.T_object_centre)
    return with_device(scene.model_copy(update={"placement": placement}), part.name, longest_side_mm(part))


def with_device(scene: Scene, part: str, longest_mm: float) -> Scene:
    """Fill in range, baseline and housing of the scanner; a settled scene is returned equal.

    Args:
        scene: a checked scene.
        part: name of the part; without a file and with another name than a built-in part's, it is the user's.
        longest_mm: longest side of its bounding box.
    """
    default = _default_device(scene, part, longest_mm)
    device = sensors.load(scene.scanner.sensor or default)
    range_mm, baseline_mm = _range_and_baseline(device, scene, default)
    known = scanners.keys(scene.scanner.type)
    scanner: dict[str, object] = {}
    if scene.scanner.type == device.type:
        scanner["sensor"] = device.name
    if scene.scanner.range_mm is None:
        scanner["range_mm"] = range_mm
    if scene.scanner.baseline_mm is None and (known is None or "baseline_mm" in known):
        scanner["baseline_mm"] = baseline_mm
    body = (device if device.figures.housing_mm else sensors.load(LARGE)).figures
    housing = {"size_mm": body.housing_mm, "bracket_diameter_mm": body.bracket_mm}
    return scene.model_copy(
        update={
            "scanner": scene.scanner.model_copy(update=scanner),
            "housing": scene.housing.model_copy(
                update={key: value for key, value in housing.items() if getattr(scene.housing, key) is None}
            ),
        }
    )


def _settings(scene: Scene, part: Workpiece) -> Settings:
    """Compute the planning parameters of a settled scene.

    Raises:
        SceneError: as `_require_possible`.
    """
    assert scene.scanner.range_mm is not None, "the scene is not settled"
    near, far = scene.scanner.range_mm
    standoffs_mm = tuple(dict.fromkeys(scene.plan.standoffs_mm or ((near + far) / 2,)))
    _require_possible(scene, standoffs_mm, (near, far))
    scanner = _plugin_values(scene)
    planning_step = scene.scanner.planning_resolution_deg
    coarser = {"resolution_deg": (planning_step, planning_step)} if "resolution_deg" in scanner else {}
    return Settings(
        faces=_planning_faces(scene, part),
        standoffs=tuple(standoff / 1000 for standoff in standoffs_mm),
        rolls=tuple(np.deg2rad(_distinct_rolls(scene.plan.rolls_deg)).tolist()),
        scanner=scanner,
        planning_scanner={**scanner, **coarser},
        sphere_radius=max(*standoffs_mm, 1000 * enclosing_radius(part.reference, part.centre) + near) / 1000,
    )


def _require_possible(scene: Scene, standoffs_mm: tuple[float, ...], range_mm: tuple[float, float]) -> None:
    """Refuse lengths of a settled scene that contradict each other.

    Raises:
        SceneError: if a standoff is outside the scanner's range, a tolerance too large for the clearance, the clearance
            too small to plan a motion with, or a spacing limited that the fill method does not know.
    """
    if scene.clearance_mm < _MIN_CLEARANCE_MM:
        raise SceneError(
            f"clearance_mm is {scene.clearance_mm:g}; a motion is checked at steps of the clearance, so it must be at "
            f"least {_MIN_CLEARANCE_MM:g}"
        )
    if scene.arrival_mm is not None and scene.arrival_mm > scene.clearance_mm / 10:
        raise SceneError(
            f"arrival_mm is {scene.arrival_mm:g}; it must be at most a tenth of clearance_mm, "
            f"{scene.clearance_mm / 10:g}"
        )
    if scene.path_tolerance_mm is not None and scene.path_tolerance_mm > scene.clearance_mm / 2:
        raise SceneError(
            f"path_tolerance_mm is {scene.path_tolerance_mm:g}; it must be at most half of clearance_mm, "
            f"{scene.clearance_mm / 2:g}, or an arm within it may collide"
        )
    if scene.scanner.max_spacing_mm is not None and scene.plan.fill == "rays":
        raise SceneError(
            "scanner.max_spacing_mm limits the spacing of a scan's rays, and plan.fill = 'rays' casts its own rays; "
            "choose plan.fill = 'aimed'"
        )
    near, far = range_mm
    for standoff in standoffs_mm:
        if not near <= standoff <= far:
            raise SceneError(
                f"the standoff of {standoff:g} mm is outside the scanner's range of {near:g} to {far:g} mm; choose a "
                "standoff inside it, or a scanner with a suitable range (cell sensors; the range of 'paper' follows "
                "the standoff)"
            )


def require_attainable(scene: Scene, scanner: Scanner) -> None:
    """Refuse a region whose largest spacing no surface in the scanner's range attains, at any orientation.

    Raises:
        SceneError: with spacing, range and remedies.
    """
    least = getattr(scanner, "least_spacing_mm", None)
    for region in scene.region:
        if least is None or region.max_spacing_mm is None or region.max_spacing_mm >= least * (1 - _SPACING_TOLERANCE):
            continue
        limit, settings = region.max_spacing_mm, scene.scanner
        has_grid = "resolution_deg" in (scanners.keys(settings.type) or ())
        grid = f" at {max(settings.resolution_deg):g} deg" if has_grid else ""
        near = "" if settings.range_mm is None else f", whose range begins at {settings.range_mm[0]:g} mm,"
        raise SceneError(
            f"the region '{region.name}' requires points at most {limit:g} mm apart, and "
            f"{settings.sensor or settings.type}{near} has at least {least:.3g} mm between points{grid}; "
            f"{_spacing_remedies(scene, limit, least)}"
        )


def notes(scene: Scene, part: Workpiece) -> list[str]:
    """Describe doubtful limits of a scene, and the choice of the scanner where the scene leaves it open.

    Args:
        scene: before it is settled.
        part: the part.
    """
    return [note for note in (grazing_note(scene.scanner.grazing_max_deg), _device_note(scene, part)) if note]


def longest_side_mm(part: Workpiece) -> float:
    """Return the longest side of the part's bounding box."""
    return 1000 * float(part.size.max())


def _device_note(scene: Scene, part: Workpiece) -> str:
    settings = scene.scanner
    is_open = settings.range_mm is None or settings.baseline_mm is None
    if settings.sensor is None and not _built_in_device(scene, part.name) and is_open:
        (small, _), (medium, _) = _BY_SIDE
        longest = longest_side_mm(part)
        return (
            f"the scanner is {_default_device(scene, part.name, longest)}, by the part's longest side of {longest:.4g} "
            f"mm: to {small:g} mm {SMALL}, to {medium:g} mm {MEDIUM}, above {LARGE}; --sensor names another"
        )
    if settings.sensor is None or scene.housing.size_mm is not None:
        return ""
    figures = sensors.load(settings.sensor).figures
    if figures.housing_mm is not None:
        return ""
    body = figures.body_mm
    stated = "its body is not stated" if body is None else f"its body is {' x '.join(f'{s:g}' for s in body)} mm"
    size = " x ".join(f"{side:g}" for side in sensors.load(LARGE).figures.housing_mm or ())
    return (
        f"collisions are checked with the housing of {LARGE}, {size} mm; {settings.sensor}: {stated}; set "
        "housing.size_mm and housing.position_mm to the real one"
    )


def _built_in_device(scene: Scene, part: str) -> str | None:
    """Return the device of a built-in part; None for a part of the user's."""
    return _DEVICE_OF_BUILT_IN.get(part) if scene.part.path is None else None


def _default_device(scene: Scene, part: str, longest_mm: float) -> str:
    """Return the device of a scene that names none."""
    by_side = next((name for side, name in _BY_SIDE if longest_mm <= side), LARGE)
    return _built_in_device(scene, part) or by_side


def _range_and_baseline(device: Sensor, scene: Scene, default: str) -> tuple[tuple[float, float] | None, float | None]:
    """Return range and baseline of a device [mm]; None: not stated, the scene must have it."""
    figures = device.figures
    if not device.follows_standoff:
        return figures.range_mm, figures.baseline_mm
    standoffs = scene.plan.standoffs_mm or (sum(sensors.load(default).figures.range_mm or ()) / 2,)
    near, far = figures.range_shares or (0.0, 0.0)
    return (near * min(standoffs), far * max(standoffs)), (figures.baseline_share or 0.0) * standoffs[0]


def _plugin_values(scene: Scene) -> Values:
    """Return the arguments of the scanner's class: common keys that it has, and given keys of its own."""
    known, table = scanners.keys(scene.scanner.type), scene.scanner
    common = {key: getattr(table, key) for key in (*_USUAL_KEYS, *_OPTIONAL_KEYS)}
    values = {key: value for key, value in common.items() if value is not None or key in _USUAL_KEYS}
    values |= table.model_extra or {}
    return {key: value for key, value in values.items() if known is None or key in known}


def _distinct_rolls(rolls_deg: tuple[float, ...]) -> list[float]:
    """Return each roll once; 0 and 360 degrees are the same viewpoint."""
    first = {roll % 360: roll for roll in reversed(rolls_deg)}
    return [roll for roll in rolls_deg if first.pop(roll % 360, None) is not None]


def _planning_faces(scene: Scene, part: Workpiece) -> int:
    if scene.plan.percent_kept is not None:
        return max(4, round(len(part.reference.faces) * scene.plan.percent_kept / 100))
    if scene.plan.faces is not None:
        return scene.plan.faces
    return _FACES if scene.part.path is not None else _FACES_OF_BUILT_IN.get(part.name, _FACES)


def _spacing_remedies(scene: Scene, limit: float, least: float) -> str:
    """Name the resolution with which this device attains a spacing [mm], and the device that attains it at this one."""
    remedies = [f"allow {least:.3g} mm"]
    if "resolution_deg" in (scanners.keys(scene.scanner.type) or ()):
        finer = [_rounded_down(angle * limit / least) for angle in scene.scanner.resolution_deg]
        remedies.append(f"set scanner.resolution_deg = [{finer[0]:g}, {finer[1]:g}]")
    for name in (LARGE, MEDIUM, SMALL):  # the first that attains it has the longest range
        device = sensors.load(name)
        if device.type != scene.scanner.type or name == scene.scanner.sensor:
            continue
        keys = {"resolution_deg": scene.scanner.resolution_deg, "fov_deg": scene.scanner.fov_deg, **device.keys}
        spacing = getattr(scanners.make(device.type, keys), "least_spacing_mm", float("inf"))
        if spacing <= limit:
            nearest = (device.figures.range_mm or (0.0,))[0]
            remedies.append(f"use --sensor {name} ({spacing:.3g} mm at its nearest, {nearest:g} mm)")
            break
    return ", or ".join([", ".join(remedies[:-1]), remedies[-1]] if len(remedies) > 1 else remedies)


def _rounded_down(angle: float) -> float:
    """Round an angle down to two digits."""
    step = 10.0 ** (floor(log10(angle)) - 1)
    return floor(angle / step + 1e-9) * step
