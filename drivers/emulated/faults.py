"""Faults of a wire, drawn from a seed: disturbances of telegrams, of the line and of the controller.

A list of faults reads `drop=0.01,delay=0.02:0.3,estop@12.5`: a name, then a probability after `=` or a time [s] since
the start after `@`, then, after a colon, the duration [s].

| name | drawn for | effect |
|---|---|---|
| `drop` | each telegram | it is lost |
| `delay` | each telegram | it is late, by default by 0.3 s |
| `duplicate` | each telegram | it arrives twice, the second time 20 ms later |
| `reorder` | each telegram | it arrives after the next one of its direction, at the latest 0.5 s later |
| `corrupt` | each telegram | one to four of its bits are flipped |
| `truncate` | each telegram | its end is missing |
| `exception` | each request | it is refused unread: an exception telegram, an ERROR frame |
| `half-open` | each move | the line seems open but is mute, by default for 1.5 s; then the connection is closed |
| `reboot` | each move | the drives brake, the controller is gone, by default for 0.5 s, and restarts with sequence 0 |
| `estop` | each move | the emergency stop is pressed, and released after, by default, 0.2 s |

Every telegram of either direction has its own draw. A fault drawn for a move begins at a random moment of it. Only the
last three faults can be scheduled at a time.
"""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drivers.errors import DriverError

WIRE_FAULTS: Final = {"drop": 0.0, "delay": 0.3, "duplicate": 0.02, "reorder": 0.5, "corrupt": 0.0, "truncate": 0.0}
MOVE_FAULTS: Final = {"half-open": 1.5, "reboot": 0.5, "estop": 0.2}
NAMES: Final = {**WIRE_FAULTS, "exception": 0.0, **MOVE_FAULTS}
"""Names of all faults with their default durations [s]; 0: no duration."""


@dataclass(frozen=True, slots=True)
class RandomFault:
    """A randomly drawn fault.

    Attributes:
        probability: for each telegram, request or move.
        seconds: duration or delay [s].
    """

    probability: float
    seconds: float


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault at a fixed time.

    Attributes:
        at: time since the start [s].
        name: one of `MOVE_FAULTS`.
        seconds: duration [s].
    """

    at: float
    name: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Faults:
    """All faults of a wire.

    Attributes:
        random: randomly drawn faults by name.
        scheduled: scheduled faults in order of time.
    """

    random: Mapping[str, RandomFault] = field(default_factory=dict)
    scheduled: tuple[ScheduledFault, ...] = ()


def parse_faults(text: str) -> Faults:
    """Parse a list of faults.

    Raises:
        DriverError: if it is invalid, with the valid form.
    """
    random: dict[str, RandomFault] = {}
    scheduled = []
    for item in filter(None, (part.strip() for part in text.split(","))):
        mark = "@" if "@" in item else "="
        name, _, rest = item.partition(mark)
        value, colon, seconds = rest.partition(":")
        if name not in NAMES:
            nearest = difflib.get_close_matches(name, NAMES, 1)
            hint = f"did you mean '{nearest[0]}'? " if nearest else ""
            raise DriverError(f"there is no fault '{name}'; {hint}valid are: {', '.join(NAMES)}")
        if colon and not NAMES[name]:
            raise DriverError(f"the fault '{item}' has a duration; {name} takes none: {name}=0.01")
        duration = _number(item, seconds, 0.0, 3600.0) if colon else NAMES[name]
        if mark == "@":
            if name not in MOVE_FAULTS:
                raise DriverError(
                    f"the fault '{item}' has a time; only {', '.join(MOVE_FAULTS)} can, all others have a "
                    f"probability: {name}=0.01"
                )
            scheduled.append(ScheduledFault(_number(item, value, 0.0, math.inf), name, duration))
        elif name in random:
            raise DriverError(f"the fault '{name}' has two probabilities; give one")
        else:
            random[name] = RandomFault(_number(item, value, 0.0, 1.0), duration)
    return Faults(random, tuple(sorted(scheduled, key=lambda fault: fault.at)))


def _number(item: str, text: str, lowest: float, highest: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not lowest <= number <= highest or math.isinf(number):
        raise DriverError(
            f"the fault '{item}' has '{text}' instead of a number from {lowest:g} to {highest:g}; write it like "
            "drop=0.01, delay=0.02:0.3 or estop@12.5"
        )
    return number


class Injector:
    """Draws faults, always in the same order for the same telegrams and seed."""

    def __init__(self, faults: Faults, rng: np.random.Generator) -> None:
        self.faults, self._rng = faults, rng
        self._held: dict[str, bytes] = {}

    def occurs(self, name: str) -> bool:
        """Draw whether a fault occurs now."""
        fault = self.faults.random.get(name)
        return fault is not None and bool(self._rng.random() < fault.probability)

    def fraction(self) -> float:
        """Draw a moment of a move, in [0, 1)."""
        return float(self._rng.random())

    def seconds(self, name: str) -> float:
        """Return the duration of a random fault [s]."""
        return self.faults.random[name].seconds

    def transmit(self, direction: str, packet: bytes) -> list[tuple[float, bytes]]:
        """Send a telegram through the disturbed wire; return (delay [s], telegram) of everything that arrives.

        Telegrams are reordered within one direction. A telegram held back arrives with the next one; `release` returns
        it if none follows.
        """
        delayed_packet = self._held.pop(direction, None)
        arriving: list[tuple[float, bytes]] = []
        if not self.occurs("drop"):
            if self.occurs("corrupt"):
                packet = self._corrupted(packet)
            if self.occurs("truncate"):
                packet = packet[: int(self._rng.integers(0, max(len(packet), 1)))]
            delay = self.seconds("delay") if self.occurs("delay") else 0.0
            arriving.append((delay, packet))
            if self.occurs("duplicate"):
                arriving.append((delay + self.seconds("duplicate"), packet))
            if delayed_packet is None and self.occurs("reorder"):
                self._held[direction] = packet
                del arriving[0]
        if delayed_packet is not None:
            arriving.append((0.0, delayed_packet))
        return [(delay, data) for delay, data in arriving if data]

    def release(self, direction: str) -> bytes | None:
        """Return the telegram held back, after nothing has followed it for `reorder` seconds."""
        return self._held.pop(direction, None)

    def is_holding(self, direction: str) -> bool:
        """Return whether a telegram is held back."""
        return direction in self._held

    def _corrupted(self, packet: bytes) -> bytes:
        data = bytearray(packet)
        for _ in range(int(self._rng.integers(1, 5)) if data else 0):
            data[int(self._rng.integers(len(data)))] ^= 1 << int(self._rng.integers(8))
        return bytes(data)
