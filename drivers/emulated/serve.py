"""A controller behind a pseudo-terminal or a TCP socket of the loopback interface, served in one loop with faults.

One thread: it receives bytes, cuts them into telegrams, answers and sends. Later actions (a delayed telegram, the end
of a restart, the release of the emergency stop) wait in a queue ordered by time.
"""

import contextlib
import heapq
import itertools
import math
import os
import select
import socket
import termios
import tty
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

from drivers.clock import Clock
from drivers.emulated.faults import MOVE_FAULTS, Injector
from drivers.emulated.stations import Station
from drivers.errors import LinkError

LOOPBACK = "127.0.0.1"

MAX_STEP = 0.02
"""Longest time [s] that the loop waits for bytes before it checks the watchdog and the arm."""

_CHUNK = 65536


class Line(Protocol):
    """A line to several peers. A peer is a number that is never used again."""

    name: str

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        """Wait up to `seconds` for bytes of any peer; empty bytes: the peer is gone."""

    def send(self, peer: int, data: bytes) -> None:
        """Send bytes to a peer; bytes that it does not accept are lost, as on a wire."""

    def drop_connections(self) -> None:
        """Close all connections, if the line has any."""

    def disconnect(self, peer: int) -> None:
        """Close the connection of one peer."""

    def close(self) -> None:
        """Release the line."""


class PtyLine:
    """A pseudo-terminal: a program sees a serial port without a wire.

    Args:
        link: symbolic link to make for it; an existing link is replaced. None: none.
        baud: speed of the controller's end. A peer with another speed receives and sends garbage.

    Raises:
        LinkError: if `link` exists and is no symbolic link, or the speed does not exist.

    Attributes:
        name: path that a client opens.
    """

    def __init__(self, link: Path | None = None, baud: int = 115200) -> None:
        self._controller, self._peer = os.openpty()
        tty.setraw(self._peer)
        os.set_blocking(self._controller, False)
        self._speed = getattr(termios, f"B{baud}", None)
        if self._speed is None:
            self._close_both()
            raise LinkError(f"a serial line has no speed of {baud} baud; choose one like 9600, 38400, 115200")
        settings = termios.tcgetattr(self._peer)
        settings[4] = settings[5] = self._speed
        termios.tcsetattr(self._peer, termios.TCSANOW, settings)
        self.name, self._link = os.ttyname(self._peer), link
        if link is not None:
            if link.is_symlink():
                link.unlink()
            elif link.exists():
                self._close_both()
                raise LinkError(f"{link} exists and is no link; choose another name")
            link.symlink_to(self.name)
            self.name = str(link)

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        """Wait for bytes."""
        ready, _, _ = select.select([self._controller], [], [], seconds)
        if not ready:
            return []
        try:
            return [(0, self._distorted(os.read(self._controller, _CHUNK)))]
        except BlockingIOError:
            return []

    def send(self, peer: int, data: bytes) -> None:
        """Send bytes to the reader of the terminal."""
        with contextlib.suppress(BlockingIOError):  # no client reads, and the buffer is full
            os.write(self._controller, self._distorted(data))

    def drop_connections(self) -> None:
        """Do nothing: a terminal has no connections."""

    def disconnect(self, peer: int) -> None:
        """Do nothing: a terminal has no connections."""

    def close(self) -> None:
        """Remove the terminal and its link."""
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        self._close_both()

    def _close_both(self) -> None:
        os.close(self._controller)
        os.close(self._peer)

    def _distorted(self, data: bytes) -> bytes:
        """Return bytes as received with another speed, which samples the bits at wrong moments."""
        if termios.tcgetattr(self._peer)[4] == self._speed:
            return data
        return bytes((byte << 1 & 0xFE | byte >> 5 & 1) ^ 0x80 for byte in data)


def listen(port: int, cure: str) -> socket.socket:
    """Return a listening socket of the loopback interface; port 0 selects a free one.

    Raises:
        LinkError: if the port is not available, with what to do then.
    """
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise LinkError(f"port {port} of {LOOPBACK} is not available: {error}; {cure}") from error
    listener.listen()
    return listener


class TcpLine:
    """A listening socket of the loopback interface: no other machine can reach it.

    Args:
        port: 0 selects a free one.

    Raises:
        LinkError: if the port is not available.

    Attributes:
        name: "127.0.0.1:port".
        port: the port in use.
    """

    def __init__(self, port: int = 0) -> None:
        self._listener = listen(port, "--port 0 selects a free one")
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self.name = f"{LOOPBACK}:{self.port}"
        self._peers: dict[int, socket.socket] = {}
        self._last_peer = 0

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        """Wait for bytes; accept new connections meanwhile."""
        sockets = [self._listener, *self._peers.values()]
        ready, _, _ = select.select(sockets, [], [], seconds)
        received = []
        for number, peer in list(self._peers.items()):
            if peer in ready:
                try:
                    data = peer.recv(_CHUNK)
                except BlockingIOError:
                    continue
                except OSError:
                    data = b""
                if not data:
                    self.disconnect(number)
                received.append((number, data))
        if self._listener in ready:
            with contextlib.suppress(OSError):  # closed again before it was accepted
                peer, _ = self._listener.accept()
                peer.setblocking(False)
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._last_peer += 1
                self._peers[self._last_peer] = peer
        return received

    def send(self, peer: int, data: bytes) -> None:
        """Send bytes to a peer that is still connected."""
        connection = self._peers.get(peer)
        if connection is None:
            return
        try:
            connection.sendall(data)
        except OSError:
            self.disconnect(peer)

    def drop_connections(self) -> None:
        """Close all connections."""
        for peer in list(self._peers):
            self.disconnect(peer)

    def disconnect(self, peer: int) -> None:
        """Close the connection of one peer."""
        if (connection := self._peers.pop(peer, None)) is not None:
            connection.close()

    def close(self) -> None:
        """Close all sockets."""
        self.drop_connections()
        self._listener.close()


class Server:
    """Server of one station on one line; call `step` again and again.

    Args:
        station: protocol and controller.
        line: the line to the clients.
        clock: real time of the wire.
        injector: faults; None: none.
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
        self._is_down = False
        self._moves = station.endpoint.moves
        if injector:
            for fault in injector.faults.scheduled:
                self._at(fault.at, partial(self._trigger, fault.name, fault.seconds))

    def step(self) -> None:
        """Wait a moment for bytes, answer them, and execute due actions."""
        now = self._clock.now()
        next_due = self._later[0][0] - now if self._later else MAX_STEP
        for peer, data in self._line.receive(min(max(next_due, 0.0), MAX_STEP)):
            self._receive(peer, data)
        while self._later and self._later[0][0] <= self._clock.now():
            heapq.heappop(self._later)[2]()
        self._station.endpoint.tick()

    def serve(self, until: Callable[[], bool]) -> None:
        """Call `step` until a condition is true."""
        while not until():
            self.step()

    def _is_mute(self) -> bool:
        return self._is_down or self._clock.now() < self._mute_until

    def _receive(self, peer: int, data: bytes) -> None:
        now = self._clock.now()
        since, rest = self._rest.pop(peer, (now, b""))
        if not data or self._is_mute():
            return
        if now - since > self._station.silence:
            rest = b""
        cut = self._station.split(rest + data)
        if cut is None:
            self._line.disconnect(peer)
            return
        packets, rest = cut
        if rest:
            self._rest[peer] = (now, rest)
        for packet in packets:
            self._transmit("request", packet, partial(self._answer, peer))

    def _answer(self, peer: int, packet: bytes) -> None:
        """Answer a telegram that has reached the controller."""
        if self._is_mute():
            return
        is_refused = self._injector is not None and self._injector.occurs("exception")
        answer = self._station.refuse(packet) if is_refused else self._answer_damaged(peer, packet)
        if answer:
            self._transmit("answer", answer, partial(self._send, peer))
        self._draw_for_moves()

    def _answer_damaged(self, peer: int, packet: bytes) -> bytes:
        """Return the answer to a telegram that may have been cut or changed on its way."""
        cut = self._station.split(packet) if self._injector else ([packet], b"")
        if cut is None:
            self._line.disconnect(peer)
            return b""
        return b"".join(self._station.answer(part) for part in cut[0])

    def _send(self, peer: int, packet: bytes) -> None:
        if not self._is_mute():
            self._line.send(peer, packet)

    def _transmit(self, direction: str, packet: bytes, arrive: Callable[[bytes], None]) -> None:
        """Send a telegram over the wire, with faults."""
        if self._injector is None:
            arrive(packet)
            return
        for delay, data in self._injector.transmit(direction, packet):
            if delay:
                self._in(delay, partial(arrive, data))
            else:
                arrive(data)
        if self._injector.is_holding(direction):
            self._in(self._injector.seconds("reorder"), partial(self._release, direction, arrive))

    def _release(self, direction: str, arrive: Callable[[bytes], None]) -> None:
        if self._injector and (packet := self._injector.release(direction)) is not None:
            arrive(packet)

    def _draw_for_moves(self) -> None:
        moves, self._moves = self._station.endpoint.moves - self._moves, self._station.endpoint.moves
        if self._injector is None or not moves:
            return
        duration = self._station.endpoint.time_to_wait() / self._time_scale
        for name in MOVE_FAULTS:
            if self._injector.occurs(name):
                seconds = self._injector.seconds(name)
                self._in(self._injector.fraction() * duration, partial(self._trigger, name, seconds))

    def _trigger(self, name: str, seconds: float) -> None:
        """Begin a fault of the line, the controller or the cell that lasts this long [s]."""
        endpoint = self._station.endpoint
        if name == "half-open":
            self._mute_until = max(self._mute_until, self._clock.now() + seconds)
            self._in(seconds, self._line.drop_connections)
        elif name == "estop":
            endpoint.emergency_stop()
            self._in(seconds, partial(endpoint.emergency_stop, False))
        elif not self._is_down:
            self._is_down = True
            endpoint.brake_for_restart()
            self._line.drop_connections()
            self._in(seconds, self._restart)

    def _restart(self) -> None:
        """Restart the controller once the arm is at rest."""
        endpoint = self._station.endpoint
        if not endpoint.tick().at_rest:
            self._in(MAX_STEP, self._restart)
            return
        self._rest.clear()
        endpoint.restart()
        self._moves = endpoint.moves
        self._station.restart()
        self._is_down = False

    def _in(self, seconds: float, action: Callable[[], None]) -> None:
        self._at(self._clock.now() + seconds, action)

    def _at(self, time: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._later, (time, next(self._order), action))
