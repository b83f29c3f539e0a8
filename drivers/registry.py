"""Drivers by URL scheme: plug-ins of the entry-point group `cell.drivers`, imported only when chosen.

A plug-in is a class with `from_url(url, context)` that returns a `drivers.contract.Driver`. Another distribution adds
one with

    [project.entry-points."cell.drivers"]
    acme = "acme_robots.driver:AcmeDriver"      # then acme://...
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, cast

from drivers.clock import Clock
from drivers.contract import Driver
from drivers.errors import DriverError, DriverUrlError
from drivers.limits import Limits
from drivers.plant import PlantFactory
from drivers.url import DriverUrl

GROUP = "cell.drivers"

_PARTS = (
    *("connect", "close", "__enter__", "__exit__", "capabilities", "state"),
    *("take", "ready", "move", "stop", "reset"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What the opener injects; a driver takes what concerns it.

    Attributes:
        limits: of the arm: those of the simulated controller, and by which a client refuses moves and judges arrivals.
        clock: time for waiting and for simulated controllers; None: the driver's own choice.
        plants: further plants of the simulated controller by name; "ideal" here replaces the built-in one.
        say: told in a sentence what is waited for, where nothing happens.
    """

    limits: Limits
    clock: Clock | None = None
    plants: Mapping[str, PlantFactory] = field(default_factory=dict)
    say: Callable[[str], None] | None = None


class DriverClass(Protocol):
    """What an entry point of the group names."""

    def from_url(self, url: DriverUrl, context: Context) -> Driver:
        """Make a driver, not yet connected; a class method. Take every option of the URL, then call `url.finish()`."""


def schemes() -> tuple[str, ...]:
    """Schemes of all installed drivers, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def open_driver(url: str, context: Context) -> Driver:
    """Make the driver that a URL names; use it in `with`, which connects.

    Args:
        url: such as "sim://?plant=ideal".
        context: what to inject.

    Raises:
        DriverUrlError: if the scheme or an option does not exist, or the driver's distribution is broken.
    """
    parsed = DriverUrl(url)
    driver = _load(parsed.scheme).from_url(parsed, context)
    missing = [part for part in _PARTS if not hasattr(type(driver), part)]
    if missing:
        raise DriverUrlError(
            f"{parsed.scheme}:// gave a {type(driver).__name__} without {', '.join(missing)}, which "
            "drivers.contract.Driver asks for; repair that driver"
        )
    return driver


def _load(scheme: str) -> DriverClass:
    found = [point for point in entry_points(group=GROUP) if point.name == scheme]
    if not found:
        valid = ", ".join(f"{name}://" for name in schemes()) or "none (is scan-cell installed?)"
        raise DriverUrlError(f"no installed driver has the scheme {scheme}://; valid are: {valid}")
    if len({point.value for point in found}) > 1:
        offers = " and ".join(f"{_distribution(point)} ({point.value})" for point in found)
        raise DriverUrlError(f"{scheme}:// is offered by {offers}; uninstall all but one")
    point = found[0]
    try:
        chosen = point.load()
    except DriverError:
        raise
    except Exception as error:  # a foreign plug-in may fail in any way at import
        raise DriverUrlError(
            f"{scheme}:// of distribution {_distribution(point)} cannot be imported from {point.value}: "
            f"{type(error).__name__}: {error}; repair or uninstall that distribution"
        ) from error
    if not callable(getattr(chosen, "from_url", None)):
        raise DriverUrlError(
            f"{scheme}:// of distribution {_distribution(point)} is {point.value}, which has no "
            "from_url(url, context); a driver is a class that has it and implements drivers.contract.Driver"
        )
    return cast("DriverClass", chosen)


def _distribution(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
