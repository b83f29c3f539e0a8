"""An emulated KUKA controller with RSI on the loopback interface: it sends telegrams and adds their answers.

As on a real controller it owns the clock, rejects late and wrong answers, holds the last correction, and ends RSI after
`TIMEOUT_CYCLES` late answers in a row, or at the client's word. The emulated person then starts its program again, at
once or a moment after the client's word: the corrections begin at zero where the arm is.
"""

import contextlib
import select
import socket
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from drivers.clock import Clock
from drivers.emulated.faults import Injector
from drivers.emulated.serve import LOOPBACK
from drivers.errors import LinkError
from drivers.setpoints import Floats
from drivers.wires import rsi

UDP_FAULTS: Final = ("drop", "delay", "duplicate", "reorder")
"""Faults of the wire; its checksum drops telegrams with wrong bits."""

_MAX_STEP: Final = 0.02
_RESTART: Final = 0.2  # time from the end of RSI by the client to the start of the program [s]


class RsiController:
    """An emulated controller; call `step` again and again.

    Args:
        q: (6,) axes [rad].
        clock: real time.
        port: of the client on the loopback interface; 0 selects a free one.
        cycle_ms: 4 or 12.
        injector: faults of the wire; None: none.
        lag: cycles by which the reported axes are behind the corrected ones.

    Attributes:
        url: of a driver for it.
        driven: corrected axes [deg], one row for each cycle in which they changed.
        ended: number of ended sessions by cause.
        cycle_ms: 4 or 12.
        late: late and wrong answers of the current session.
        is_stopped: whether the emergency stop is pressed: RSI is ended, and no telegram is sent.
        is_blocked: whether the arm stands still, as behind a brake, while corrections are accepted.
    """

    def __init__(
        self, q: Floats, clock: Clock, port: int = 0, cycle_ms: int = 4, injector: Injector | None = None, lag: int = 0
    ) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((LOOPBACK, 0))
        except OSError as error:
            raise LinkError(f"no UDP port of {LOOPBACK} is available: {error}") from error
        self._socket.setblocking(False)
        self._client = LOOPBACK, port or _free_port()
        self.url = f"rsi://{LOOPBACK}:{self._client[1]}"
        self._clock, self._injector = clock, injector
        self.cycle_ms = cycle_ms
        self.axes = np.degrees(q)
        self.driven: list[Floats] = []
        self._past = deque([self.axes], lag + 1)
        self.ended = {"client": 0, "timeout": 0, "emergency stop": 0}
        self.is_stopped = self.is_blocked = False
        self.late = self._n_silent = 0
        self._base, self._is_attached, self._is_answered = self.axes.copy(), False, True
        self._corrected = self._base
        self._ipoc, self._due, self._n_lost = 1000, clock.now(), 0
        self._losses: tuple[int, Callable[[], bool]] | None = None
        self._later: list[tuple[float, Callable[[], None]]] = []

    def serve(self, until: Callable[[], bool]) -> None:
        """Call `step` until a condition is true."""
        while not until():
            self.step()

    def step(self) -> None:
        """Wait a moment for an answer, and send the telegram that is due."""
        now = self._clock.now()
        due = min([self._due, *(at for at, _ in self._later)])
        ready, _, _ = select.select([self._socket], [], [], min(max(due - now, 0.0), _MAX_STEP))
        if ready:
            with contextlib.suppress(OSError):  # a client that has ended
                data, _ = self._socket.recvfrom(65535)
                self._transmit("answer", data, self._receive)
        now = self._clock.now()
        for action in [action for at, action in self._later if at <= now]:
            action()
        self._later = [item for item in self._later if item[0] > now]
        if now >= self._due:
            self._due = max(self._due + self.cycle_ms / 1000.0, now - self.cycle_ms / 1000.0)
            self._send()

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop; after its release a person starts the program again."""
        self.is_stopped = pressed
        self._end("emergency stop")

    def count_late(self) -> None:
        """Count a late or wrong answer."""
        self.late += 1

    def pause(self, seconds: float) -> None:
        """Send no telegram for some time."""
        self._due += seconds

    def lose_answers(self, count: int, when: Callable[[], bool] = lambda: True) -> None:
        """Lose a number of answers, beginning with the next one at which a condition holds."""
        self._losses = count, when

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self) -> None:
        if self._is_attached and not self._is_answered and not self.is_stopped:
            self.count_late()
            self._n_silent += 1
            if self._n_silent > rsi.TIMEOUT_CYCLES:
                self._end("timeout")
        self._ipoc, self._is_answered = self._ipoc + self.cycle_ms, False
        self._past.append(self.axes)
        if not self.is_stopped:
            self._transmit(
                "request",
                rsi.telegram(rsi.Telegram(self._ipoc, self._past[0], self.late, self._corrected - self._base)),
                self._deliver,
            )

    def _deliver(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # nobody listens yet
            self._socket.sendto(data, self._client)

    def _receive(self, data: bytes) -> None:
        try:
            ipoc, corrections, is_end = rsi.parse_answer(data)
        except (ValueError, KeyError):
            return
        if ipoc != self._ipoc or self._is_answered or self.is_stopped:
            return  # late, or a copy
        if self._losses and self._losses[1]():
            self._n_lost, self._losses = self._losses[0], None
        if self._n_lost:
            self._n_lost -= 1
            return
        if is_end:
            self._end("client")
            self.pause(_RESTART)
            return
        self._is_answered, self._is_attached, self._n_silent = True, True, 0
        axes = self._base + corrections
        if (axes != self._corrected).any():
            self.driven.append(axes)
        self._corrected = axes
        if not self.is_blocked:
            self.axes = axes

    def _end(self, cause: str) -> None:
        if self._is_attached:
            self.ended[cause] += 1
        self._base, self._is_attached, self.late, self._n_silent = self.axes.copy(), False, 0, 0
        self._corrected = self._base

    def _transmit(self, direction: str, data: bytes, arrive: Callable[[bytes], None]) -> None:
        if self._injector is None:
            arrive(data)
            return
        for delay, packet in self._injector.transmit(direction, data):
            if delay:
                self._later.append((self._clock.now() + delay, lambda packet=packet: arrive(packet)))  # type: ignore[misc]
            else:
                arrive(packet)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
