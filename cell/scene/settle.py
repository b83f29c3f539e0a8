"""Which scanner a scene has: range, baseline and housing of its device, put in where the scene leaves them open.

The device is the one that `scanner.sensor` names, else the built-in part's, else the one that suits the longest side of
a part of the user's (`_BY_SIDE`). A standoff changes no device. `paper` is none: its range and baseline follow the
standoff. Keys that the scene gives go before the device's.

What the scene leaves open, settled for one part: standoffs, rolls, planning faces, the scanner's numbers.

The result is in SI units and holds no None; it is written to `scene.resolved.json`.
"""

from dataclasses import dataclass

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.part.workpiece import Workpiece
from cell.scanners import Values
from cell.scene import sensors
from cell.scene.model import Scene
from cell.scene.sensors import Sensor
from planner.viewpoints.viewpoints import enclosing_radius

SMALL, MEDIUM, LARGE = "generic-area-small", "generic-area-medium", "generic-area-large"

_OF_BUILT_IN = {  # by the standoffs of the paper's objects
    **{"mseke": LARGE, "mug": MEDIUM, "robinet": MEDIUM},
    **{"petanque": LARGE, "humerus": SMALL, "st-jean": LARGE},
}
_BY_SIDE = ((30.0, SMALL), (100.0, MEDIUM))  # longest side up to the middle of the device's range [mm]; else the large


def by_part(scene: Scene, part: Workpiece) -> Scene:
    """The scene settled for its part: `settled` by the part's name and size, placed by its centre."""
    placement = scene.placement.by_centre(part.T_object_centre)
    return settled(scene.model_copy(update={"placement": placement}), part.name, longest_mm(part))


def settled(scene: Scene, part: str, longest_mm: float) -> Scene:
    """The scene with its scanner's range, baseline and housing; one that is settled comes back equal.

    Args:
        scene: a checked scene.
        part: the part's name; what is in no file and has no built-in part's name is the user's too.
        longest_mm: longest side of its bounding box.
    """
    suited = _suited(scene, part, longest_mm)
    device = sensors.load(scene.scanner.sensor or suited)
    range_mm, baseline_mm = _optics(device, scene, suited)
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


def notes(scene: Scene, part: Workpiece) -> list[str]:
    """What a person has to know of the scanner that a scene gets: by which rule, and whose housing it has.

    Args:
        scene: before it is settled.
        part: the part.
    """
    given = scene.scanner
    if (
        given.sensor is None
        and not _built_in(scene, part.name)
        and (given.range_mm is None or given.baseline_mm is None)
    ):
        (small, _), (medium, _) = _BY_SIDE
        longest = longest_mm(part)
        return [
            f"the scanner is {_suited(scene, part.name, longest)}, by the part's longest side of {longest:.4g} mm: to "
            f"{small:g} mm {SMALL}, to {medium:g} mm {MEDIUM}, above {LARGE}; --sensor names another"
        ]
    if given.sensor is None or scene.housing.size_mm is not None:
        return []
    figures = sensors.load(given.sensor).figures
    if figures.housing_mm is not None:
        return []
    body = figures.body_mm
    stated = "its body is not stated" if body is None else f"its body is {' x '.join(f'{s:g}' for s in body)} mm"
    size = " x ".join(f"{side:g}" for side in sensors.load(LARGE).figures.housing_mm or ())
    return [
        f"the housing that collides is that of {LARGE}, {size} mm; {given.sensor}: {stated}; set housing.size_mm and "
        "housing.position_mm to the real one"
    ]


def longest_mm(part: Workpiece) -> float:
    """Longest side of a part's bounding box."""
    return 1000 * float(part.size.max())


def _built_in(scene: Scene, part: str) -> str | None:
    """The built-in part's device; None for a part of the user's."""
    return _OF_BUILT_IN.get(part) if scene.part.path is None else None


def _suited(scene: Scene, part: str, longest_mm: float) -> str:
    """Name of the device for a part where the scene names none."""
    by_side = next((name for side, name in _BY_SIDE if longest_mm <= side), LARGE)
    return _built_in(scene, part) or by_side


def _optics(device: Sensor, scene: Scene, suited: str) -> tuple[tuple[float, float] | None, float | None]:
    """Range and baseline [mm] of a device; None: not stated, so that the scene gives it."""
    own = device.figures
    if not device.follows_standoff:
        return own.range_mm, own.baseline_mm
    standoffs = scene.plan.standoffs_mm or (sum(sensors.load(suited).figures.range_mm or ()) / 2,)
    near, far = own.range_shares or (0.0, 0.0)
    return (near * min(standoffs), far * max(standoffs)), (own.baseline_share or 0.0) * standoffs[0]


# Planning faces of the built-in parts: the paper's (Tables 1 and 2), changed only with a line in CHANGELOG.md.
_FACES_OF = {"mseke": 930, "mug": 748, "robinet": 814, "petanque": 338, "humerus": 276, "st-jean": 746}
_FACES = 1000
_USUAL = (
    *("fov_deg", "resolution_deg", "range_mm", "baseline_mm"),
    *("grazing_max_deg", "sensor_grazing_max_deg", "sigma_angle_mdeg"),
)
_LIMITS = ("sensor_fov_deg", "sensor_tilt_deg", "depth_of_field_mm", "max_spacing_mm")  # only where they limit
_LINE_KEYS = ("fan_deg", "sweep_mm", "sweep_deg", "sweep_steps", "line_points", "profile_rate_hz")
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
    scanner: Values
    planning_scanner: Values
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
    scene = by_part(scene, part)
    radius_mm = 1000 * enclosing_radius(part.reference, part.centre)
    if scene.scanner.max_spacing_mm is not None and scene.plan.fill == "rays":
        raise SceneError(
            "scanner.max_spacing_mm is of a scan's rays, and plan.fill = 'rays' has its own; choose plan.fill = 'aimed'"
        )
    assert scene.scanner.range_mm is not None
    near, far = scene.scanner.range_mm
    standoffs_mm = tuple(dict.fromkeys(scene.plan.standoffs_mm or ((near + far) / 2,)))
    for standoff in standoffs_mm:
        if not near <= standoff <= far:
            raise SceneError(
                f"the standoff of {standoff:g} mm is outside the scanner's range of {near:g} to {far:g} mm; choose a "
                "standoff inside it, or a scanner whose range holds it (cell sensors; that of 'paper' follows it)"
            )
    scanner = _of_the_plug_in(scene)
    planning_step = scene.scanner.planning_resolution_deg
    planned = {"resolution_deg": (planning_step, planning_step)} if "resolution_deg" in scanner else {}
    return Settings(
        faces=_faces(scene, part),
        standoffs=tuple(standoff / 1000 for standoff in standoffs_mm),
        rolls=tuple(np.deg2rad(_distinct(scene.plan.rolls_deg)).tolist()),
        scanner=scanner,
        planning_scanner={**scanner, **planned},
        sphere_radius=max(*standoffs_mm, radius_mm + near) / 1000,
    )


def _of_the_plug_in(scene: Scene) -> Values:
    """What the scanner's class takes: of the known keys those that it has, and the keys of its own that are given."""
    known, said = scanners.keys(scene.scanner.type), scene.scanner
    named = {key: getattr(said, key) for key in (*_USUAL, *_LIMITS, *_LINE_KEYS)}
    offered = {key: value for key, value in named.items() if value is not None or key in _USUAL}
    offered |= said.model_extra or {}
    return {key: value for key, value in offered.items() if known is None or key in known}


def _distinct(rolls_deg: tuple[float, ...]) -> list[float]:
    """Each roll once; 0 and 360 degrees are the same viewpoint."""
    first = {roll % 360: roll for roll in reversed(rolls_deg)}
    return [roll for roll in rolls_deg if first.pop(roll % 360, None) is not None]


def _faces(scene: Scene, part: Workpiece) -> int:
    if scene.plan.percent_kept is not None:
        return max(4, round(len(part.reference.faces) * scene.plan.percent_kept / 100))
    if scene.plan.faces is not None:
        return scene.plan.faces
    return _FACES if scene.part.path is not None else _FACES_OF.get(part.name, _FACES)
