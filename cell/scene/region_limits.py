"""Limits of regions that a scanner cannot keep anywhere, with the device or the resolution that would."""

from math import floor, log10

from cell import scanners
from cell.errors import SceneError
from cell.scene import sensors
from cell.scene.devices import LARGE, MEDIUM, SMALL
from cell.scene.scene import Scene
from planner.ports import Scanner

_ROUNDING = 1e-3  # of a spacing: what is below the limit by no more is taken for it


def require_attainable(scene: Scene, scanner: Scanner) -> None:
    """Refuse a spacing that no surface in the scanner's range has, however it stands.

    Args:
        scene: settled.
        scanner: of the scene.

    Raises:
        SceneError: naming spacing, range, and what helps.
    """
    least = getattr(scanner, "least_spacing_mm", None)
    for region in scene.region:
        if least is None or region.max_spacing_mm is None or region.max_spacing_mm >= least * (1 - _ROUNDING):
            continue
        limit, given = region.max_spacing_mm, scene.scanner
        grid = (
            ""
            if "resolution_deg" not in (scanners.keys(given.type) or ())
            else f" at {max(given.resolution_deg):g} deg"
        )
        near = "" if given.range_mm is None else f", whose range begins at {given.range_mm[0]:g} mm,"
        raise SceneError(
            f"the region '{region.name}' asks for points at most {limit:g} mm apart, and {given.sensor or given.type}"
            f"{near} has them {least:.3g} mm apart at its nearest{grid}; {_what_helps(scene, limit, least)}"
        )


def _what_helps(scene: Scene, limit: float, least: float) -> str:
    """The resolution with which this device keeps a limit, and the device that does with this resolution [mm]."""
    ways = [f"allow {least:.3g} mm"]
    if "resolution_deg" in (scanners.keys(scene.scanner.type) or ()):
        finer = [_down(angle * limit / least) for angle in scene.scanner.resolution_deg]
        ways.append(f"set scanner.resolution_deg = [{finer[0]:g}, {finer[1]:g}]")
    for name in (LARGE, MEDIUM, SMALL):  # the one with the longest range of those that keep it
        own = sensors.load(name)
        if own.type != scene.scanner.type or name == scene.scanner.sensor:
            continue
        keys = {"resolution_deg": scene.scanner.resolution_deg, "fov_deg": scene.scanner.fov_deg, **own.keys}
        there = getattr(scanners.make(own.type, keys), "least_spacing_mm", float("inf"))
        if there <= limit:
            ways.append(
                f"take --sensor {name} ({there:.3g} mm at its nearest, {(own.figures.range_mm or (0.0,))[0]:g} mm)"
            )
            break
    return ", or ".join([", ".join(ways[:-1]), ways[-1]] if len(ways) > 1 else ways)


def _down(angle: float) -> float:
    """An angle rounded down to two digits."""
    step = 10.0 ** (floor(log10(angle)) - 1)
    return floor(angle / step + 1e-9) * step
