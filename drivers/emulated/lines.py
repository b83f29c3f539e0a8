"""Where an emulated controller listens: on a pseudo-terminal, or on a TCP socket that only this machine reaches."""

import contextlib
import os
import select
import socket
import termios
import tty
from pathlib import Path
from typing import Protocol

from drivers.errors import LinkError

LOOPBACK = "127.0.0.1"

_CHUNK = 65536


class Line(Protocol):
    """Where bytes come in from peers and go out to them. A peer is a number that is never used again."""

    name: str

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        """Wait up to `seconds` for bytes; empty bytes: the peer is gone."""

    def send(self, peer: int, data: bytes) -> None:
        """Give bytes to a peer; what it does not take in is lost, as on a wire."""

    def drop(self) -> None:
        """End all connections, where the line has such a thing."""

    def end(self, peer: int) -> None:
        """End one."""

    def close(self) -> None:
        """Give everything back."""


class PtyLine:
    """A pseudo-terminal: what a serial port is to a program, without the wire.

    Args:
        link: symbolic link to put to it, replaced if it is one; None: none.
        baud: speed of the controller's end. A peer that has set another one hears and says rubbish.

    Raises:
        LinkError: if `link` exists and is no symbolic link.

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
            raise LinkError(f"a serial line of {baud} baud does not exist; choose one like 9600, 38400, 115200")
        settings = termios.tcgetattr(self._peer)
        settings[4] = settings[5] = self._speed
        termios.tcsetattr(self._peer, termios.TCSANOW, settings)
        self.name, self._link = os.ttyname(self._peer), link
        if link is not None:
            if link.is_symlink():
                link.unlink()
            elif link.exists():
                self._close_both()
                raise LinkError(f"{link} exists and is no link; choose a name that is free")
            link.symlink_to(self.name)
            self.name = str(link)

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        """Wait for bytes."""
        ready, _, _ = select.select([self._controller], [], [], seconds)
        if not ready:
            return []
        try:
            return [(0, self._garbled(os.read(self._controller, _CHUNK)))]
        except BlockingIOError:
            return []

    def send(self, peer: int, data: bytes) -> None:
        """Give bytes to whoever reads."""
        with contextlib.suppress(BlockingIOError):  # nobody reads, and the buffer is full
            os.write(self._controller, self._garbled(data))

    def drop(self) -> None:
        """A terminal has no connections."""

    def end(self, peer: int) -> None:
        """A terminal has no connections."""

    def close(self) -> None:
        """Take the terminal and its link away."""
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        self._close_both()

    def _close_both(self) -> None:
        os.close(self._controller)
        os.close(self._peer)

    def _garbled(self, data: bytes) -> bytes:
        """At another speed the bits are sampled at wrong moments."""
        if termios.tcgetattr(self._peer)[4] == self._speed:
            return data
        return bytes((byte << 1 & 0xFE | byte >> 5 & 1) ^ 0x80 for byte in data)


class TcpLine:
    """A listening socket of the loopback interface: no other machine reaches it.

    Args:
        port: 0 takes a free one.

    Raises:
        LinkError: if the port cannot be taken.

    Attributes:
        name: "127.0.0.1:port".
        port: the port that was taken.
    """

    def __init__(self, port: int = 0) -> None:
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            self._listener.close()
            raise LinkError(f"port {port} of {LOOPBACK} cannot be taken: {error}; --port 0 takes a free one") from error
        self._listener.listen()
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self.name = f"{LOOPBACK}:{self.port}"
        self._peers: dict[int, socket.socket] = {}
        self._next = 0

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        """Wait for bytes; takes new connections on the way."""
        sockets = [self._listener, *self._peers.values()]
        ready, _, _ = select.select(sockets, [], [], seconds)
        found = []
        for number, peer in list(self._peers.items()):
            if peer in ready:
                try:
                    data = peer.recv(_CHUNK)
                except BlockingIOError:
                    continue
                except OSError:
                    data = b""
                if not data:
                    self.end(number)
                found.append((number, data))
        if self._listener in ready:
            with contextlib.suppress(OSError):  # gone again before it was taken
                peer, _ = self._listener.accept()
                peer.setblocking(False)
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._next += 1
                self._peers[self._next] = peer
        return found

    def send(self, peer: int, data: bytes) -> None:
        """Give bytes to a peer that is still there."""
        connection = self._peers.get(peer)
        if connection is None:
            return
        try:
            connection.sendall(data)
        except OSError:
            self.end(peer)

    def drop(self) -> None:
        """Close all connections."""
        for peer in list(self._peers):
            self.end(peer)

    def end(self, peer: int) -> None:
        """Close one."""
        if (connection := self._peers.pop(peer, None)) is not None:
            connection.close()

    def close(self) -> None:
        """Close everything."""
        self.drop()
        self._listener.close()
