"""Which scanner a scene has: range, baseline and housing of its device, put in where the scene leaves them open.

The device is the one that `scanner.sensor` names, else the built-in part's, else the one that suits the longest side of
a part of the user's (`_BY_SIDE`). A standoff changes no device. `paper` is none: its range and baseline follow the
standoff. Keys that the scene gives go before the device's.
"""

from cell import scanners
from cell.part.workpiece import Workpiece
from cell.scene import sensors
from cell.scene.scene import Scene
from cell.scene.sensors import Sensor

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
