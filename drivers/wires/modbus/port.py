"""The one door to pymodbus: registers through TCP or RTU, its failures as ours. Imported only when chosen."""

import logging
import select
from typing import Any

from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusIOException

from drivers.errors import AnswerTimeoutError, LinkLostError, ProtocolError

# What goes wrong is raised, and by whom it is caught decides whether it is news: pymodbus shall not print it.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

_EXCEPTIONS = {
    1: "it does not know this function",
    2: "it has no such register",
    3: "it does not take this value",
    4: "it failed",
    5: "it needs longer",
    6: "it is busy",
    10: "the gateway has no path to it",
    11: "the gateway got no answer from it",
}

_RTU_BYTES = 2 * 260  # the longest request and the longest answer
BITS_PER_BYTE = 11


class _PromptSerialClient(ModbusSerialClient):
    """Woken when bytes come, where pymodbus looks every millisecond, and twice more whether others follow.

    The framer waits for what is missing of a telegram. Should pymodbus rename the method, it is slower and as right.
    """

    def _wait_for_data(self) -> int:
        port: Any = self.socket
        try:
            descriptor = port.fileno()
        except (AttributeError, OSError):  # Windows has none
            return int(super()._wait_for_data())
        select.select([descriptor], [], [], self.comm_params.timeout_connect)
        return int(port.in_waiting)


class ModbusPort:
    """One device on one line. Every call is one telegram and its answer; nothing is asked twice.

    Args:
        name: for messages.
        unit: device address.
        client: of pymodbus, with `retries=0`.
        keeps_late_answers: a late answer would come through the same connection, and nothing in it says that it is
            late; so the connection is closed when an answer is missing.
    """

    def __init__(self, name: str, unit: int, client: Any, *, keeps_late_answers: bool) -> None:
        self.name, self._unit, self._client = name, unit, client
        self._keeps_late_answers = keeps_late_answers

    @classmethod
    def tcp(cls, host: str, port: int, unit: int, answer: float) -> "ModbusPort":
        """A device behind TCP, or behind a gateway; `answer` [s] is waited for each telegram."""
        client = ModbusTcpClient(host, port=port, timeout=answer, retries=0)
        return cls(f"{host}:{port}", unit, client, keeps_late_answers=True)

    @classmethod
    def rtu(cls, path: str, baud: int, unit: int, answer: float) -> "ModbusPort":
        """A device on a serial line; the time of the bytes on the wire comes on top of `answer` [s]."""
        patience = answer + _RTU_BYTES * BITS_PER_BYTE / baud
        client = _PromptSerialClient(path, framer=FramerType.RTU, baudrate=baud, timeout=patience, retries=0)
        return cls(path, unit, client, keeps_late_answers=False)

    def open(self) -> None:
        """Take the line.

        Raises:
            LinkLostError: if it cannot be taken.
        """
        try:
            opened = self._client.connect()
        except Exception as error:  # pymodbus lets some of the operating system's through
            raise LinkLostError(f"{self.name} cannot be opened: {error}") from error
        if not opened:
            raise LinkLostError(
                f"{self.name} cannot be opened: nothing listens there, or the port is missing or taken; check address, "
                "plug and rights"
            )

    def close(self) -> None:
        """Give it back; may be called twice."""
        try:
            self._client.close()
        except OSError:
            return  # it is gone already

    def read(self, address: int, count: int) -> list[int]:
        """Read input registers in one FC04.

        Raises:
            AnswerTimeoutError, ProtocolError, LinkLostError.
        """
        response = self._execute(lambda: self._client.read_input_registers(address, count=count, device_id=self._unit))
        registers = getattr(response, "registers", None)
        if response.function_code != 4 or not isinstance(registers, list) or len(registers) != count:
            raise ProtocolError(f"{self.name} answered a reading with another telegram; it may be late")
        return [int(register) for register in registers]

    def write(self, address: int, values: list[int]) -> None:
        """Write holding registers in one FC16.

        Raises:
            AnswerTimeoutError, ProtocolError, LinkLostError.
        """
        response = self._execute(lambda: self._client.write_registers(address, values, device_id=self._unit))
        if response.function_code != 16 or response.address != address or response.count != len(values):
            raise ProtocolError(f"{self.name} answered a writing with another telegram; it may be late")

    def _execute(self, call: Any) -> Any:
        try:
            response = call()
        except ModbusIOException as error:  # no answer, or one for another request
            if self._keeps_late_answers:
                self.close()
            raise AnswerTimeoutError(f"{self.name} brought no answer in time: {error.string}") from error
        except (ConnectionException, OSError) as error:
            self.close()
            raise LinkLostError(f"{self.name} is gone: {error}") from error
        except Exception as error:  # a spoiled telegram can trip the library anywhere
            self.close()
            raise ProtocolError(f"{self.name} brought a broken telegram ({type(error).__name__}: {error})") from error
        if response.isError():
            code = int(getattr(response, "exception_code", 0))
            raise ProtocolError(
                f"the device at {self.name} refused a telegram with exception {code}: "
                f"{_EXCEPTIONS.get(code, 'a code of its own')}"
            )
        return response
