"""The drivers' errors: every failure of a driver, a wire or a controller is one of these.

    DriverError                     root
    |-- DriverUrlError              the URL cannot be used: no such scheme, an option that does not exist, a bad value
    |-- SetPointError               broken set-points, found before anything was sent: shape, type, NaN, overflow
    |-- NotConnectedError           used outside connect() .. close()
    |-- RefusedError                the controller (or the client, for it) refused a command; nothing moved
    |-- MoveEndedError              a move began and did not end at its last set-point; the arm stands
    |   |-- StoppedError            it was stopped on command
    |   `-- FaultError              the controller latched a fault; only reset helps
    |       `-- EmergencyStopError  the emergency stop is or was pressed; release it, then reset
    |-- LinkError                   the wire
    |   |-- AnswerTimeoutError      no answer in time; the line itself looks alive
    |   |-- LinkLostError           the line is gone: port vanished, connection closed, heartbeat frozen
    |   `-- ProtocolError           what answers does not speak our protocol, or not in our word order
    |-- ContradictionError          fields of the controller's status contradict each other, or cannot be
    |-- OverdueError                what was waited for did not come within its limit
    |-- ArrivalError                the arm stands elsewhere than commanded, or sooner than it can
    |-- NotOwnerError               another client owns the arm, or has stopped it
    `-- StateUnknownError           whether the last command was executed is unknown; only state(), stop() are possible

Third-party errors (of a serial or Modbus library) appear as these, with the original as their cause. Every message is
one sentence: the fact, and what would be valid or what to do.
"""


class DriverError(Exception):
    """Root of everything that a driver raises on purpose."""


class DriverUrlError(DriverError):
    """The driver URL names no installed driver, or an option that the driver does not have."""


class SetPointError(DriverError):
    """Set-points that no controller could execute: wrong type or shape, NaN, beyond int32."""


class NotConnectedError(DriverError):
    """The driver is used before connect() or after close()."""


class RefusedError(DriverError):
    """A command was refused and nothing moved.

    Attributes:
        result: the controller's result code (`drivers.commands.Result`, or a foreign controller's own number).
    """

    def __init__(self, message: str, result: int) -> None:
        super().__init__(message)
        self.result = result


class MoveEndedError(DriverError):
    """A move began, but the arm does not stand at its last set-point."""


class StoppedError(MoveEndedError):
    """The move was stopped on command, on its path."""


class FaultError(MoveEndedError):
    """The controller latched a fault.

    Attributes:
        code: the controller's fault code (`drivers.contract.Fault`, or a foreign controller's own number).
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class EmergencyStopError(FaultError):
    """The emergency stop is or was pressed."""


class LinkError(DriverError):
    """The wire between client and controller failed."""


class AnswerTimeoutError(LinkError):
    """No answer arrived in time."""


class LinkLostError(LinkError):
    """The line is gone."""


class ProtocolError(LinkError):
    """The peer's answer cannot be one of ours."""


class ContradictionError(DriverError):
    """The controller's status cannot be true: its fields contradict each other."""


class OverdueError(DriverError):
    """What was waited for did not come within its limit."""


class ArrivalError(DriverError):
    """A move is said to have ended, and the arm stands elsewhere, or came there sooner than it can."""


class NotOwnerError(DriverError):
    """Another client owns the arm."""


class StateUnknownError(DriverError):
    """Nobody can tell whether the last command was executed; only reading and stopping are possible."""
