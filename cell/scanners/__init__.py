"""Scanner plug-ins by name, from the entry-point group `cell.scanners`; a plug-in is imported only when it is used.

A plug-in is a class that implements `ScannerPlugin`. Its arguments are the keys of the scene's `[scanner]` table.
Another distribution adds one with

    [project.entry-points."cell.scanners"]
    my-scanner = "my_package.my_module:MyScanner"

docs/internals/plug_ins.md shows how to write one.
"""

import inspect
import json
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import TYPE_CHECKING, Any, Protocol

from cell.errors import CellError, SceneError
from planner.ports import Scanner

if TYPE_CHECKING:
    from pydantic import JsonValue

    from planner.values import Floats
    from planner.viewpoints.viewpoints import Viewpoints

GROUP = "cell.scanners"

Values = Mapping[str, Any]
"""Arguments of a scanner's class by name (`_mm`, `_deg`)."""

_MEMBERS = ("source", "sensor", "grid_shape", "ray_directions", "reject", "parameters")


class ScannerPlugin(Scanner, Protocol):
    """A sensor model that can be stored and created again.

    Optional members: `T_view_scanner`, the (K, 4, 4) poses of a sweep about a viewpoint [m], makes each viewpoint a
    column of K poses; `sigma` is the expected standard deviation of a point (`planner.ports.SigmaScanner`).
    """

    def parameters(self) -> "dict[str, JsonValue]":
        """Return the arguments that create this scanner again, as JSON types; `type` may be among them.

        Equal parameters mean equal scanners to the matrix cache. Pictures show `fov_deg` and `range_mm`.
        """


def names() -> tuple[str, ...]:
    """Return the names of all installed scanners, sorted, without importing them."""
    return tuple(sorted({point.name for point in _installed(entry_points, tuple(sys.path))}))


def load(name: str) -> type:
    """Import the class of a scanner.

    Args:
        name: the scene's `scanner.type`, such as "laser-area".

    Raises:
        SceneError: if no or several installed distributions offer the name, or the plug-in cannot be imported.
    """
    point = _entry_point(name)
    try:
        scanner_class = point.load()
    except Exception as error:  # a third-party plug-in may fail in any way at import
        raise SceneError(
            f"scanner type '{name}' of distribution {_distribution(point)} cannot be imported from {point.value}: "
            f"{type(error).__name__}: {error}; repair or uninstall that distribution"
        ) from error
    if not isinstance(scanner_class, type):
        raise SceneError(
            f"scanner type '{name}' of distribution {_distribution(point)} is {point.value}, which is not a "
            "class; a scanner is a class that implements cell.scanners.ScannerPlugin"
        )
    return scanner_class


def keys(name: str) -> tuple[str, ...] | None:
    """Return the keys of a scanner in the scene: the arguments of its class; None if it takes any (`**keys`).

    Raises:
        SceneError: as `load`.
    """
    arguments = inspect.signature(load(name)).parameters.values()
    if any(argument.kind is argument.VAR_KEYWORD for argument in arguments):
        return None
    return tuple(
        argument.name
        for argument in arguments
        if argument.kind in (argument.POSITIONAL_OR_KEYWORD, argument.KEYWORD_ONLY)
    )


def make(name: str, values: Values) -> ScannerPlugin:
    """Create a scanner, and check that it implements the protocol.

    Args:
        name: the scene's `scanner.type`.
        values: arguments of its class.

    Raises:
        SceneError: if the class refuses the values, has not all members of the protocol, or its parameters are not
            JSON types; the message names the distribution.
    """
    scanner_class = load(name)
    plugin = f"scanner type '{name}' of distribution {_distribution(_entry_point(name))}"
    try:
        scanner = scanner_class(**values)
        missing = [member for member in _MEMBERS if not hasattr(scanner, member)]
        parameters = None if missing else scanner.parameters()
    except CellError:
        raise  # the plug-in's own message about a value
    except Exception as error:  # a third-party plug-in may fail in any way
        raise SceneError(
            f"{plugin} cannot be created with {', '.join(values) or 'no keys'}: {type(error).__name__}: {error}; "
            "repair or uninstall that distribution"
        ) from error
    if missing:
        raise SceneError(
            f"{plugin} has no {', '.join(missing)}; a scanner has {', '.join(_MEMBERS)} (cell.scanners.ScannerPlugin)"
        )
    try:
        if not isinstance(parameters, dict):
            raise TypeError(f"it is a {type(parameters).__name__}")
        json.dumps(parameters, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{plugin} has invalid parameters(): {error}; it must return a dict of JSON types") from error
    result: ScannerPlugin = scanner
    return result


def describe(name: str, scanner: ScannerPlugin) -> "dict[str, JsonValue]":
    """Return type and parameters of a scanner, as in the run folder."""
    return {"type": name, **{key: value for key, value in scanner.parameters().items() if key != "type"}}


def identity(name: str, scanner: ScannerPlugin) -> "dict[str, JsonValue]":
    """Return the scanner's part of the key of a matrix: `describe` and `origin`."""
    return describe(name, scanner) | origin(name)


def origin(name: str) -> "dict[str, JsonValue]":
    """Return distribution with version and class of a third-party scanner, for the keys of caches.

    Empty for a built-in one: its law is that of the program, whose version or format number is in the keys.

    Raises:
        SceneError: if no or several installed distributions offer the name.
    """
    point = _entry_point(name)
    is_built_in = point.dist is not None and point.dist.name == "scan-cell"
    return {} if is_built_in else {"distribution": _distribution(point), "law": point.value}


def with_own_parameters(values: Values, scanner: ScannerPlugin) -> Values:
    """Return the arguments of a scanner, and the parameters that it chose itself, such as the length of its sweep."""
    parameters = scanner.parameters()
    return {**values, **{key: value for key, value in parameters.items() if key not in values and key != "type"}}


def sweep_columns(scanner: Scanner, viewpoints: "Viewpoints") -> "Viewpoints":
    """Return the matrix columns of viewpoints: their sweeps for a scanner that sweeps, else the viewpoints."""
    T_view_scanner = getattr(scanner, "T_view_scanner", None)
    if T_view_scanner is None:
        return viewpoints
    from planner.viewpoints.viewpoints import sweep_viewpoints as sweeps_of

    return sweeps_of(viewpoints, T_view_scanner)


def viewpoints_of_columns(scanner: Scanner, columns: "Viewpoints") -> "tuple[Viewpoints, Floats]":
    """Return the viewpoints of matrix columns, one pose each, and T_scanner_view (4, 4) of the scanner."""
    import numpy as np  # kept out of modules that only list the names of scanners

    from planner.viewpoints.viewpoints import Viewpoints

    T_view_scanner = getattr(scanner, "T_view_scanner", np.eye(4)[None])
    T_scanner_view: Floats = np.linalg.inv(T_view_scanner[len(T_view_scanner) // 2])
    middle = columns.T_object_scanner[:, [columns.T_object_scanner.shape[1] // 2]] @ T_scanner_view
    return Viewpoints(middle, columns.face, columns.standoff, columns.roll), T_scanner_view


def baseline_mm(values: Values, scanner: Scanner) -> float:
    """Return the distance of source and sensor [mm]: the argument, else from the positions of the scanner."""
    if "baseline_mm" in values:
        return float(values["baseline_mm"])
    return float(sum((scanner.sensor - scanner.source) ** 2) ** 0.5 * 1000)


@cache
def _installed(find: Callable[..., EntryPoints], path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of all distributions on the path; cached, because a search takes 10 ms."""
    return tuple(find(group=GROUP))


def _entry_point(name: str) -> EntryPoint:
    """Return the entry point of a name."""
    points = [point for point in _installed(entry_points, tuple(sys.path)) if point.name == name]
    if not points:
        valid = ", ".join(names()) or "none (is scan-cell installed?)"
        raise SceneError(f"scanner type '{name}' is not installed; valid are: {valid}")
    if len({point.value for point in points}) > 1:
        offers = " and ".join(f"{_distribution(point)} ({point.value})" for point in points)
        raise SceneError(f"scanner type '{name}' is offered by {offers}; uninstall all but one")
    return points[0]


def _distribution(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
