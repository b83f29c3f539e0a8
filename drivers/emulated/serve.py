"""The loop that puts a controller behind a line, with the faults that a test bench asks for.

One thread: bytes come in, are cut into telegrams, answered and sent. Everything that shall happen later (a delayed
telegram, the end of a restart, the release of the emergency stop) waits in a queue ordered by time.
"""

import heapq
import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import Protocol

from drivers.clock import Clock
from drivers.emulated.endpoint import Endpoint
from drivers.emulated.lines import Line
from drivers.emulated.wire_faults import MOVE_FAULTS, Injector

LONGEST_TURN = 0.02
"""Longest time [s] that the loop waits for bytes before it looks at the watchdog and the arm."""


class Station(Protocol):
    """One protocol of the controller's side."""

    endpoint: Endpoint
    silence: float
    """Time [s] after which an unfinished telegram is dropped."""

    def split(self, received: bytes) -> tuple[list[bytes], bytes] | None:
        """Cut a stream into telegrams and the rest; None: it is none of ours, the connection is to be closed."""

    def answer(self, packet: bytes) -> bytes:
        """The answer to a telegram; empty: none."""

    def refuse(self, packet: bytes) -> bytes:
        """An answer that executes nothing."""

    def forget(self) -> None:
        """The controller was restarted."""


class Server:
    """Serves one station on one line; call `turn` again and again.

    Args:
        station: protocol and controller.
        line: where the clients are.
        clock: real time of the wire.
        injector: what goes wrong; None: nothing.
        time_scale: seconds of the controller's clock per second of the wire's.
    """

    def __init__(
        self, station: Station, line: Line, clock: Clock, injector: Injector | None = None, time_scale: float = 1.0
    ) -> None:
        self._station, self._line, self._clock = station, line, clock
        self._injector, self._time_scale = injector, time_scale
        self._rest: dict[int, tuple[float, bytes]] = {}
        self._later: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._mute_until = -math.inf
        self._down = False
        self._moves = station.endpoint.moves
        if injector:
            for appointment in injector.faults.appointments:
                self._at(appointment.at, partial(self._break, appointment.name, appointment.seconds))

    def turn(self) -> None:
        """Wait a moment for bytes, answer them, and do what is due."""
        now = self._clock.now()
        next_due = self._later[0][0] - now if self._later else LONGEST_TURN
        for peer, data in self._line.receive(min(max(next_due, 0.0), LONGEST_TURN)):
            self._take(peer, data)
        while self._later and self._later[0][0] <= self._clock.now():
            heapq.heappop(self._later)[2]()
        self._station.endpoint.tick()

    def serve(self, until: Callable[[], bool]) -> None:
        """Take turns until told otherwise."""
        while not until():
            self.turn()

    def _mute(self) -> bool:
        return self._down or self._clock.now() < self._mute_until

    def _take(self, peer: int, data: bytes) -> None:
        now = self._clock.now()
        since, rest = self._rest.pop(peer, (now, b""))
        if not data or self._mute():
            return
        if now - since > self._station.silence:
            rest = b""
        cut = self._station.split(rest + data)
        if cut is None:
            self._line.end(peer)
            return
        packets, rest = cut
        if rest:
            self._rest[peer] = (now, rest)
        for packet in packets:
            self._pass("request", packet, partial(self._answer, peer))

    def _answer(self, peer: int, packet: bytes) -> None:
        """Answer what arrived at the controller."""
        if self._mute():
            return
        refused = self._injector is not None and self._injector.hits("exception")
        answer = self._station.refuse(packet) if refused else self._spoiled(peer, packet)
        if answer:
            self._pass("answer", answer, partial(self._send, peer))
        self._draw_for_moves()

    def _spoiled(self, peer: int, packet: bytes) -> bytes:
        """The answer to a telegram that may have been cut or changed on its way."""
        cut = self._station.split(packet) if self._injector else ([packet], b"")
        if cut is None:
            self._line.end(peer)
            return b""
        return b"".join(self._station.answer(part) for part in cut[0])

    def _send(self, peer: int, packet: bytes) -> None:
        if not self._mute():
            self._line.send(peer, packet)

    def _pass(self, direction: str, packet: bytes, arrive: Callable[[bytes], None]) -> None:
        """Let a telegram go over the wire, whole or not."""
        if self._injector is None:
            arrive(packet)
            return
        for delay, data in self._injector.through(direction, packet):
            if delay:
                self._in(delay, partial(arrive, data))
            else:
                arrive(data)
        if self._injector.holds(direction):
            self._in(self._injector.seconds("reorder"), partial(self._release, direction, arrive))

    def _release(self, direction: str, arrive: Callable[[bytes], None]) -> None:
        if self._injector and (packet := self._injector.late(direction)) is not None:
            arrive(packet)

    def _draw_for_moves(self) -> None:
        moves, self._moves = self._station.endpoint.moves - self._moves, self._station.endpoint.moves
        if self._injector is None or not moves:
            return
        lasts = self._station.endpoint.controller.time_to_wait() / self._time_scale
        for name in MOVE_FAULTS:
            if self._injector.hits(name):
                seconds = self._injector.seconds(name)
                self._in(self._injector.fraction() * lasts, partial(self._break, name, seconds))

    def _break(self, name: str, seconds: float) -> None:
        """The line, the controller or the cell breaks now, for so many seconds."""
        endpoint = self._station.endpoint
        if name == "half-open":
            self._mute_until = max(self._mute_until, self._clock.now() + seconds)
            self._in(seconds, self._line.drop)
        elif name == "estop":
            endpoint.emergency_stop()
            self._in(seconds, partial(endpoint.emergency_stop, False))
        elif not self._down:
            self._down = True
            endpoint.brake_for_restart()
            self._line.drop()
            self._in(seconds, self._come_back)

    def _come_back(self) -> None:
        """Start again, once the arm stands."""
        endpoint = self._station.endpoint
        if not endpoint.tick().standing:
            self._in(LONGEST_TURN, self._come_back)
            return
        self._rest.clear()
        endpoint.restart()
        self._moves = endpoint.moves
        self._station.forget()
        self._down = False

    def _in(self, seconds: float, action: Callable[[], None]) -> None:
        self._at(self._clock.now() + seconds, action)

    def _at(self, time: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._later, (time, next(self._order), action))
