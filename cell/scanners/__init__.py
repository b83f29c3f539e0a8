"""Scanners by name: plug-ins of the entry-point group `cell.scanners`, imported only when chosen.

A plug-in is a class that implements `planner.ports.Scanner` and takes the keys of the scene's `[scanner]` table
(without `type`) as keyword arguments. Another distribution adds one with

    [project.entry-points."cell.scanners"]
    laser-line = "my_package.my_module:LaserLine"
"""

from importlib.metadata import EntryPoint, entry_points

from cell.errors import SceneError

GROUP = "cell.scanners"


def names() -> tuple[str, ...]:
    """Names of all installed scanners, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def load(name: str) -> type:
    """Import the class of one scanner.

    Args:
        name: the scene's `scanner.type`, such as "laser-area".

    Raises:
        SceneError: if no installed distribution offers the name, two do, or the one that does cannot be imported.
    """
    found = [point for point in entry_points(group=GROUP) if point.name == name]
    if not found:
        valid = ", ".join(names()) or "none (is scan-cell installed?)"
        raise SceneError(f"scanner type '{name}' is not installed; valid are: {valid}")
    if len({point.value for point in found}) > 1:
        offers = " and ".join(f"{_distribution(point)} ({point.value})" for point in found)
        raise SceneError(f"scanner type '{name}' is offered by {offers}; uninstall all but one")
    point = found[0]
    try:
        chosen = point.load()
    except Exception as error:  # a foreign plug-in may fail in any way at import
        raise SceneError(
            f"scanner type '{name}' of distribution {_distribution(point)} cannot be imported from {point.value}: "
            f"{type(error).__name__}: {error}; repair or uninstall that distribution"
        ) from error
    if not isinstance(chosen, type):
        raise SceneError(
            f"scanner type '{name}' of distribution {_distribution(point)} is {point.value}, which is no class; "
            "a scanner is a class that implements planner.ports.Scanner"
        )
    return chosen


def _distribution(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
