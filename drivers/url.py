"""Driver URLs: `scheme://host/path?option=value&flag`, with every option checked.

An option is taken once, by name, with its type and range; what is left at the end does not exist and is refused with
the nearest name that does.
"""

import difflib
import math
from urllib.parse import parse_qsl, urlsplit

from drivers.errors import DriverUrlError

_YES, _NO = ("", "1", "true", "yes", "on"), ("0", "false", "no", "off")


class DriverUrl:
    """A parsed driver URL whose options are taken one by one.

    Args:
        text: the URL.

    Raises:
        DriverUrlError: if it has no scheme, a fragment, an unusable port, or an option twice.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            parts = urlsplit(text)
            self.host, self.port = parts.hostname, parts.port
            pairs = parse_qsl(parts.query, keep_blank_values=True)
        except ValueError as error:
            raise DriverUrlError(f"driver URL '{text}' cannot be read: {error}") from error
        if not parts.scheme or "://" not in text:
            raise DriverUrlError(f"driver URL '{text}' has no scheme; write one like sim:// or sim://?plant=ideal")
        if parts.fragment:
            raise DriverUrlError(f"driver URL '{text}' has a part after '#'; options stand after '?', joined by '&'")
        self.scheme, self.path = parts.scheme, parts.path
        self._options: dict[str, str] = {}
        for name, value in pairs:
            if name in self._options:
                raise DriverUrlError(f"driver URL '{text}' has the option '{name}' twice; give it once")
            self._options[name] = value
        self._known: list[str] = []

    def word(self, name: str, default: str, valid: tuple[str, ...]) -> str:
        """Take an option that is one of a few words."""
        value = self._take(name)
        if value is None:
            return default
        if value not in valid:
            nearest = difflib.get_close_matches(value, valid, 1)
            hint = f" (did you mean '{nearest[0]}'?)" if nearest else ""
            raise self._wrong(name, value, f"one of: {', '.join(valid)}{hint}")
        return value

    def flag(self, name: str) -> bool:
        """Take a yes-or-no option; its bare name is yes, absent is no."""
        value = self._take(name)
        if value is None:
            return False
        if value.lower() not in _YES + _NO:
            raise self._wrong(name, value, "given alone, or be 1 or 0")
        return value.lower() in _YES

    def number(self, name: str, default: float, *, above: float, at_most: float = math.inf) -> float:
        """Take a number in (above, at_most]."""
        value = self._take(name)
        if value is None:
            return default
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (above < number <= at_most and math.isfinite(number)):
            most = f" and at most {at_most:g}" * (at_most < math.inf)
            raise self._wrong(name, value, f"a number above {above:g}{most}")
        return number

    def whole(self, name: str, default: int, *, at_least: int) -> int:
        """Take a whole number."""
        value = self._take(name)
        if value is None:
            return default
        if not value.isascii() or not value.isdigit() or len(value) > 18 or int(value) < at_least:
            raise self._wrong(name, value, f"a whole number of at least {at_least}")
        return int(value)

    def numbers(self, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """Take as many finite numbers as the default has, joined by commas."""
        value = self._take(name)
        if value is None:
            return default
        try:
            numbers = tuple(float(item) for item in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != len(default) or not all(map(math.isfinite, numbers)):
            raise self._wrong(name, value, f"{len(default)} numbers joined by commas")
        return numbers

    def finish(self) -> None:
        """Refuse what nobody took.

        Raises:
            DriverUrlError: naming the option and the nearest valid one.
        """
        for name in self._options:
            nearest = difflib.get_close_matches(name, self._known, 1)
            hint = f"did you mean '{nearest[0]}'? " if nearest else ""
            valid = ", ".join(self._known) or "none"
            raise DriverUrlError(f"{self.scheme}:// has no option '{name}'; {hint}valid are: {valid}")

    def _take(self, name: str) -> str | None:
        self._known.append(name)
        return self._options.pop(name, None)

    def _wrong(self, name: str, value: str, wanted: str) -> DriverUrlError:
        return DriverUrlError(f"{self.scheme}:// has {name}={value}; it must be {wanted}")
