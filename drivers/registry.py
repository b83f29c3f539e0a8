"""Drivers by URL: plug-ins of the entry-point group `cell.drivers`, imported only when their scheme is used.

A URL is `scheme://host/path?option=value&flag`. A plug-in is a class with `from_url(url, context)` that returns a
`drivers.contract.Driver`. Another distribution adds one with

    [project.entry-points."cell.drivers"]
    acme = "acme_robots.driver:AcmeDriver"      # then acme://...
"""

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, cast
from urllib.parse import parse_qsl, urlsplit

from drivers.clock import Clock
from drivers.contract import Driver
from drivers.errors import DriverError, DriverUrlError
from drivers.limits import Limits
from drivers.simulated_controller import PlantFactory

GROUP = "cell.drivers"

MAX_PORT = 65535
"""Largest number of a TCP or UDP port."""

_YES, _NO = ("", "1", "true", "yes", "on"), ("0", "false", "no", "off")

_MEMBERS = (
    *("connect", "close", "__enter__", "__exit__", "capabilities", "state"),
    *("take", "require_ready", "move", "stop", "reset"),
)


class DriverUrl:
    """A driver URL. A driver takes each of its options once, by name, with type and range; `finish` refuses the rest.

    Args:
        text: the URL.

    Raises:
        DriverUrlError: if it has no scheme, a fragment, an invalid host or port, or an option twice.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            parts = urlsplit(text)
            self.host, self.port = parts.hostname, parts.port
            pairs = parse_qsl(parts.query, keep_blank_values=True)
            (self.host or "").encode("idna")  # as a connection does, whose error would be no OSError
            if self.port == 0:
                raise ValueError(f"port 0 is none; it must be from 1 to {MAX_PORT}")
        except ValueError as error:
            raise DriverUrlError(f"driver URL '{text}' is invalid: {error}") from error
        if not parts.scheme or "://" not in text:
            raise DriverUrlError(f"driver URL '{text}' has no scheme; write one like sim:// or sim://?plant=ideal")
        if parts.fragment:
            raise DriverUrlError(f"driver URL '{text}' has a part after '#'; options follow '?', joined by '&'")
        self.scheme, self.path = parts.scheme, parts.path
        self._options: dict[str, str] = {}
        for name, value in pairs:
            if name in self._options:
                raise DriverUrlError(f"driver URL '{text}' has the option '{name}' twice; give it once")
            self._options[name] = value
        self._known: list[str] = []

    def choice(self, name: str, default: str, valid: tuple[str, ...]) -> str:
        """Take an option with one of several values."""
        value = self._take(name)
        if value is None:
            return default
        if value not in valid:
            nearest = difflib.get_close_matches(value, valid, 1)
            hint = f" (did you mean '{nearest[0]}'?)" if nearest else ""
            raise self._invalid(name, value, f"one of: {', '.join(valid)}{hint}")
        return value

    def flag(self, name: str) -> bool:
        """Take a yes-or-no option; its bare name is yes, absence is no."""
        value = self._take(name)
        if value is None:
            return False
        if value.lower() not in _YES + _NO:
            raise self._invalid(name, value, "given alone, or be 1 or 0")
        return value.lower() in _YES

    def number(self, name: str, default: float, *, above: float, at_most: float = math.inf) -> float:
        """Take a finite number in (above, at_most]."""
        value = self._take(name)
        if value is None:
            return default
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (above < number <= at_most and math.isfinite(number)):
            upper = f" and at most {at_most:g}" * (at_most < math.inf)
            raise self._invalid(name, value, f"a number above {above:g}{upper}")
        return number

    def integer(self, name: str, default: int, *, at_least: int, at_most: int | None = None) -> int:
        """Take an integer in [at_least, at_most]; None: no bound."""
        value = self._take(name)
        if value is None:
            return default
        number = int(value) if value.isascii() and value.isdigit() and len(value) <= 18 else -1
        if number < at_least or (at_most is not None and number > at_most):
            valid = f"of at least {at_least}" if at_most is None else f"from {at_least} to {at_most}"
            raise self._invalid(name, value, f"a whole number {valid}")
        return number

    def numbers(self, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """Take finite numbers joined by commas, as many as in `default`."""
        value = self._take(name)
        if value is None:
            return default
        try:
            numbers = tuple(float(item) for item in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != len(default) or not all(map(math.isfinite, numbers)):
            raise self._invalid(name, value, f"{len(default)} numbers joined by commas")
        return numbers

    def finish(self) -> None:
        """Refuse options that were not taken.

        Raises:
            DriverUrlError: with the option and the nearest valid name.
        """
        for name in self._options:
            nearest = difflib.get_close_matches(name, self._known, 1)
            hint = f"did you mean '{nearest[0]}'? " if nearest else ""
            valid = ", ".join(self._known) or "none"
            raise DriverUrlError(f"{self.scheme}:// has no option '{name}'; {hint}valid are: {valid}")

    def _take(self, name: str) -> str | None:
        self._known.append(name)
        return self._options.pop(name, None)

    def _invalid(self, name: str, value: str, valid: str) -> DriverUrlError:
        return DriverUrlError(f"{self.scheme}:// has {name}={value}; it must be {valid}")


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """Values that the caller injects into a driver.

    Attributes:
        limits: limits of the arm: of a simulated controller, and for the client's refusals and arrival checks.
        clock: time for waiting and for simulated controllers; None: the driver's own choice.
        plants: further plants of the simulated controller by name; "ideal" replaces the built-in one.
        notify: receives a message about a long wait.
    """

    limits: Limits
    clock: Clock | None = None
    plants: Mapping[str, PlantFactory] = field(default_factory=dict)
    notify: Callable[[str], None] | None = None


class DriverClass(Protocol):
    """Object that an entry point of the group names."""

    def from_url(self, url: DriverUrl, context: Context) -> Driver:
        """Make a driver, not yet connected (class method). Take all options of the URL, then call `url.finish()`."""


def schemes() -> tuple[str, ...]:
    """Return the schemes of all installed drivers, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def open_driver(url: str, context: Context) -> Driver:
    """Make the driver of a URL; use it in `with`, which connects.

    Args:
        url: such as "sim://?plant=ideal".
        context: values to inject.

    Raises:
        DriverUrlError: if the scheme or an option does not exist, or the driver's distribution is broken.
    """
    parsed = DriverUrl(url)
    driver = _load(parsed.scheme).from_url(parsed, context)
    missing = [member for member in _MEMBERS if not hasattr(type(driver), member)]
    if missing:
        raise DriverUrlError(
            f"{parsed.scheme}:// gave a {type(driver).__name__} without {', '.join(missing)}, which "
            "drivers.contract.Driver requires; correct that driver"
        )
    return driver


def _load(scheme: str) -> DriverClass:
    points = [point for point in entry_points(group=GROUP) if point.name == scheme]
    if not points:
        valid = ", ".join(f"{name}://" for name in schemes()) or "none (is scan-cell installed?)"
        raise DriverUrlError(f"no installed driver has the scheme {scheme}://; valid are: {valid}")
    if len({point.value for point in points}) > 1:
        providers = " and ".join(f"{_distribution(point)} ({point.value})" for point in points)
        raise DriverUrlError(f"{scheme}:// is provided by {providers}; uninstall all but one")
    point = points[0]
    try:
        driver = point.load()
    except DriverError:
        raise
    except Exception as error:  # a foreign plug-in may fail in any way at import
        raise DriverUrlError(
            f"{scheme}:// of distribution {_distribution(point)} cannot be imported from {point.value}: "
            f"{type(error).__name__}: {error}; repair or uninstall that distribution"
        ) from error
    if not callable(getattr(driver, "from_url", None)):
        raise DriverUrlError(
            f"{scheme}:// of distribution {_distribution(point)} is {point.value}, which has no "
            "from_url(url, context); a driver is a class with it that implements drivers.contract.Driver"
        )
    return cast("DriverClass", driver)


def _distribution(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
