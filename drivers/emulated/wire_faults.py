"""Faults of a wire, drawn from a seed: what a test bench does to telegrams, to the line and to the controller.

A list of faults reads `drop=0.01,delay=0.02:0.3,estop@12.5`: a name, then a probability after `=` or a time [s] since
the bench's start after `@`, then, after a colon, how long [s].

| name | drawn for | what happens |
|---|---|---|
| `drop` | each telegram | it is lost |
| `delay` | each telegram | it comes late, by default 0.3 s |
| `duplicate` | each telegram | it comes twice, the second time 20 ms later |
| `reorder` | each telegram | it comes after the next one of its direction, at the latest 0.5 s later |
| `corrupt` | each telegram | one to four of its bits are flipped |
| `truncate` | each telegram | its end is missing |
| `exception` | each request | it is refused unread: an exception telegram, an ERROR frame |
| `half-open` | each move | the line looks open and is mute, by default for 1.5 s; then the connection is closed |
| `reboot` | each move | the drives brake, the controller is gone, by default for 0.5 s, and starts with sequence 0 |
| `estop` | each move | the emergency stop is pressed, and released after, by default, 0.2 s |

Each telegram in either direction draws for itself. What is drawn for a move begins at a random moment of it. Only the
last three can have a time instead.
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
"""Names of all faults with their default durations [s]; 0: it has none."""


@dataclass(frozen=True, slots=True)
class Chance:
    """A fault that is drawn.

    Attributes:
        probability: for each telegram, request or move.
        seconds: how long, or how late [s].
    """

    probability: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Appointment:
    """A fault at a time.

    Attributes:
        at: time since the bench's start [s].
        name: one of `MOVE_FAULTS`.
        seconds: how long [s].
    """

    at: float
    name: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong.

    Attributes:
        chances: drawn faults by name.
        appointments: those at a time, by time.
    """

    chances: Mapping[str, Chance] = field(default_factory=dict)
    appointments: tuple[Appointment, ...] = ()


def parse(text: str) -> Faults:
    """Read a list of faults.

    Raises:
        DriverError: if it cannot be read, with what could.
    """
    chances: dict[str, Chance] = {}
    appointments = []
    for item in filter(None, (part.strip() for part in text.split(","))):
        mark = "@" if "@" in item else "="
        name, _, rest = item.partition(mark)
        value, colon, seconds = rest.partition(":")
        if name not in NAMES:
            nearest = difflib.get_close_matches(name, NAMES, 1)
            hint = f"did you mean '{nearest[0]}'? " if nearest else ""
            raise DriverError(f"no fault is called '{name}'; {hint}there are: {', '.join(NAMES)}")
        if colon and not NAMES[name]:
            raise DriverError(f"the fault '{item}' has a duration; {name} takes none: {name}=0.01")
        duration = _number(item, seconds, 0.0, 3600.0) if colon else NAMES[name]
        if mark == "@":
            if name not in MOVE_FAULTS:
                raise DriverError(
                    f"the fault '{item}' has a time; only {', '.join(MOVE_FAULTS)} can, all others have a "
                    f"probability: {name}=0.01"
                )
            appointments.append(Appointment(_number(item, value, 0.0, math.inf), name, duration))
        elif name in chances:
            raise DriverError(f"the fault '{name}' has two probabilities; give one")
        else:
            chances[name] = Chance(_number(item, value, 0.0, 1.0), duration)
    return Faults(chances, tuple(sorted(appointments, key=lambda appointment: appointment.at)))


def _number(item: str, text: str, least: float, most: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not least <= number <= most or math.isinf(number):
        raise DriverError(
            f"the fault '{item}' has '{text}' where a number from {least:g} to {most:g} must stand; write it like "
            "drop=0.01, delay=0.02:0.3 or estop@12.5"
        )
    return number


class Injector:
    """Draws faults, always in the same order for the same telegrams and seed.

    Args:
        faults: which.
        rng: from where.
    """

    def __init__(self, faults: Faults, rng: np.random.Generator) -> None:
        self.faults, self._rng = faults, rng
        self._held: dict[str, bytes] = {}

    def hits(self, name: str) -> bool:
        """Whether a fault happens now."""
        chance = self.faults.chances.get(name)
        return chance is not None and bool(self._rng.random() < chance.probability)

    def fraction(self) -> float:
        """A moment of a move, in [0, 1)."""
        return float(self._rng.random())

    def seconds(self, name: str) -> float:
        """How long a drawn fault lasts [s]."""
        return self.faults.chances[name].seconds

    def through(self, direction: str, packet: bytes) -> list[tuple[float, bytes]]:
        """What becomes of a telegram on the wire.

        Args:
            direction: telegrams are put out of order within one direction.
            packet: the telegram.

        Returns:
            (delay [s], telegram) of all that arrives because of it. A held-back telegram is among what the next one
            brings; `late` gives it where none comes.
        """
        held = self._held.pop(direction, None)
        arriving: list[tuple[float, bytes]] = []
        if not self.hits("drop"):
            if self.hits("corrupt"):
                packet = self._corrupted(packet)
            if self.hits("truncate"):
                packet = packet[: int(self._rng.integers(0, max(len(packet), 1)))]
            delay = self.seconds("delay") if self.hits("delay") else 0.0
            arriving.append((delay, packet))
            if self.hits("duplicate"):
                arriving.append((delay + self.seconds("duplicate"), packet))
            if held is None and self.hits("reorder"):
                self._held[direction] = packet
                del arriving[0]
        if held is not None:
            arriving.append((0.0, held))
        return [(delay, data) for delay, data in arriving if data]

    def late(self, direction: str) -> bytes | None:
        """The telegram that is held back, after nothing has followed it for `reorder` seconds."""
        return self._held.pop(direction, None)

    def holds(self, direction: str) -> bool:
        """Whether a telegram is held back."""
        return direction in self._held

    def _corrupted(self, packet: bytes) -> bytes:
        data = bytearray(packet)
        for _ in range(int(self._rng.integers(1, 5)) if data else 0):
            data[int(self._rng.integers(len(data)))] ^= 1 << int(self._rng.integers(8))
        return bytes(data)
