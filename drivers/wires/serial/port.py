"""The one door to pyserial: bytes through a serial port, its failures as ours. Imported only when chosen."""

from typing import Any

import serial

from drivers.errors import LinkLostError

_LOST = (OSError, TypeError, ValueError, AttributeError)
"""What pyserial raises where a port vanishes: SerialException is an OSError, the rest are slips on a closed port."""

try:
    import termios

    _FAILURES: tuple[type[Exception], ...] = (*_LOST, termios.error)
except ImportError:  # Windows
    _FAILURES = _LOST


class SerialPort:
    """One serial port, 8 data bits, no parity, 1 stop bit, taken for this process alone.

    Args:
        path: device, such as /dev/ttyUSB0.
        baud: bits per second.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.name, self._baud = path, baud
        self._port: Any = None

    def open(self) -> None:
        """Take the port.

        Raises:
            LinkLostError: if it cannot be taken.
        """
        try:
            self._port = serial.Serial(self.name, self._baud, timeout=0.0, write_timeout=1.0, exclusive=True)
        except _FAILURES as error:
            raise LinkLostError(
                f"{self.name} cannot be opened for reading and writing: {error}; check the name, the plug, the rights "
                "(on Linux the group dialout), and that no other program has it"
            ) from error

    def close(self) -> None:
        """Give it back; may be called twice."""
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except _FAILURES:
                return  # it is gone already

    def write(self, data: bytes) -> None:
        """Send bytes, and forget what came in before.

        Raises:
            LinkLostError: if the port takes none.
        """
        try:
            self._port.reset_input_buffer()
            self._port.write(data)
        except _FAILURES as error:
            raise LinkLostError(f"{self.name} takes no bytes any more: {error}") from error

    def read(self, seconds: float) -> bytes:
        """Bytes that are there, or come within some seconds; empty: none did.

        Raises:
            LinkLostError: if the port is gone.
        """
        try:
            self._port.timeout = max(seconds, 0.0)
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first
        except _FAILURES as error:
            raise LinkLostError(f"{self.name} gives no bytes any more: {error}") from error
