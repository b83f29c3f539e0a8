"""Scanners by name: plug-ins of the entry-point group `cell.scanners`, imported only when chosen.

A plug-in is a class that implements `ScannerPlugin`. The arguments of the class are its keys in the scene's `[scanner]`
table. Another distribution adds one with

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
"""Arguments of a scanner's class by name (`_mm`, `_deg`): what they are, only the class knows."""

_MEMBERS = ("source", "sensor", "grid_shape", "ray_directions", "reject", "parameters")


class ScannerPlugin(Scanner, Protocol):
    """A scanner that can be written down.

    It may have more: `T_view_scanner`, the (K, 4, 4) poses of a sweep about a viewpoint [m], makes each viewpoint a
    column of K poses; `sigma`, the expected standard deviation of a point (`planner.ports.SigmaScanner`).
    """

    def parameters(self) -> "dict[str, JsonValue]":
        """What defines this scanner, JSON types: calling the class with them makes it again (`type` aside).

        The matrix cache takes equal parameters for equal scanners. `fov_deg` and `range_mm` are drawn in pictures.
        """
        ...


def names() -> tuple[str, ...]:
    """Names of all installed scanners, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in _installed(entry_points, tuple(sys.path))}))


def load(name: str) -> type:
    """Import the class of one scanner.

    Args:
        name: the scene's `scanner.type`, such as "laser-area".

    Raises:
        SceneError: if no installed distribution offers the name, two do, or the one that does cannot be imported.
    """
    point = _offered(name)
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
            "a scanner is a class that implements cell.scanners.ScannerPlugin"
        )
    return chosen


def keys(name: str) -> tuple[str, ...] | None:
    """Keys of a scanner in the scene: the arguments of its class; None where it takes any (`**keys`).

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
    """Make a scanner and look at whether it is one.

    Args:
        name: the scene's `scanner.type`.
        values: of its keys.

    Raises:
        SceneError: if the class refuses the values, lacks a member of the protocol, or its parameters cannot be
            written down; the message names the distribution.
    """
    kind = load(name)
    whose = f"scanner type '{name}' of distribution {_distribution(_offered(name))}"
    try:
        scanner = kind(**values)
        missing = [member for member in _MEMBERS if not hasattr(scanner, member)]
        parameters = None if missing else scanner.parameters()
    except CellError:
        raise  # the plug-in's own sentence about a value
    except Exception as error:  # a foreign plug-in may fail in any way
        raise SceneError(
            f"{whose} cannot be made of {', '.join(values) or 'no keys'}: {type(error).__name__}: {error}; repair or "
            "uninstall that distribution"
        ) from error
    if missing:
        raise SceneError(
            f"{whose} lacks {', '.join(missing)}; a scanner has {', '.join(_MEMBERS)} (cell.scanners.ScannerPlugin)"
        )
    try:
        if not isinstance(parameters, dict):
            raise TypeError(f"it is a {type(parameters).__name__}")
        json.dumps(parameters, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"{whose} has parameters() that cannot be written down: {error}; it must return a dict of JSON types"
        ) from error
    made: ScannerPlugin = scanner
    return made


def describe(name: str, scanner: ScannerPlugin) -> "dict[str, JsonValue]":
    """What defines a scanner, its type included, as the run folder keeps it."""
    return {"type": name, **{key: value for key, value in scanner.parameters().items() if key != "type"}}


def identity(name: str, scanner: ScannerPlugin) -> "dict[str, JsonValue]":
    """What a matrix depends on: `described`, and of another distribution's scanner also which version it is of."""
    point = _offered(name)
    own = point.dist is not None and point.dist.name == "scan-cell"  # its matrices have a format number of their own
    return describe(name, scanner) | ({} if own else {"distribution": _distribution(point), "law": point.value})


def with_own_parameters(values: Values, scanner: ScannerPlugin) -> Values:
    """The keys that a scanner was made of, and those that it has settled itself, such as the length of its sweep."""
    own = scanner.parameters()
    return {**values, **{key: value for key, value in own.items() if key not in values and key != "type"}}


def sweep_columns(scanner: Scanner, viewpoints: "Viewpoints") -> "Viewpoints":
    """The columns that a scanner makes of viewpoints: of one that sweeps its sweeps, otherwise the viewpoints."""
    T_view_scanner = getattr(scanner, "T_view_scanner", None)
    if T_view_scanner is None:
        return viewpoints
    from planner.viewpoints.viewpoints import sweep_viewpoints as sweeps_of

    return sweeps_of(viewpoints, T_view_scanner)


def viewpoints_of_columns(scanner: Scanner, columns: "Viewpoints") -> "tuple[Viewpoints, Floats]":
    """The viewpoints of which a scanner made columns, one pose each, and (4, 4) its T_scanner_view."""
    import numpy as np  # like `swept`: what only names scanners starts without

    from planner.viewpoints.viewpoints import Viewpoints

    T_view_scanner = getattr(scanner, "T_view_scanner", np.eye(4)[None])
    T_scanner_view: Floats = np.linalg.inv(T_view_scanner[len(T_view_scanner) // 2])
    middle = columns.T_object_scanner[:, [columns.T_object_scanner.shape[1] // 2]] @ T_scanner_view
    return Viewpoints(middle, columns.face, columns.standoff, columns.roll), T_scanner_view


def baseline_mm(values: Values, scanner: Scanner) -> float:
    """Distance of source and sensor [mm]: the key, or what a scanner without that key says by its positions."""
    if "baseline_mm" in values:
        return float(values["baseline_mm"])
    return float(sum((scanner.sensor - scanner.source) ** 2) ** 0.5 * 1000)


@cache
def _installed(find: Callable[..., EntryPoints], path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """The scanners of all distributions on the path: looked for once, because it takes 10 ms."""
    return tuple(find(group=GROUP))


def _offered(name: str) -> EntryPoint:
    """The one entry point of a name."""
    found = [point for point in _installed(entry_points, tuple(sys.path)) if point.name == name]
    if not found:
        valid = ", ".join(names()) or "none (is scan-cell installed?)"
        raise SceneError(f"scanner type '{name}' is not installed; valid are: {valid}")
    if len({point.value for point in found}) > 1:
        offers = " and ".join(f"{_distribution(point)} ({point.value})" for point in found)
        raise SceneError(f"scanner type '{name}' is offered by {offers}; uninstall all but one")
    return found[0]


def _distribution(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
