"""Driver errors: every failure of a driver, a wire or a controller is one of these.

    DriverError                     root
    |-- DriverUrlError              the URL is unusable: unknown scheme, unknown option, invalid value
    |-- SetPointError               invalid set-points, found before anything was sent: shape, type, NaN, overflow
    |-- NotConnectedError           used outside connect() .. close()
    |-- RefusedError                the controller (or the client for it) refused a command; nothing moved
    |-- MoveEndedError              a move began and did not end at its last set-point; the arm is at rest
    |   |-- StoppedError            the move was stopped on command
    |   `-- FaultError              the controller latched a fault; only a reset clears it
    |       `-- EmergencyStopError  the emergency stop is or was pressed; release it, then reset
    |-- LinkError                   the wire failed
    |   |-- AnswerTimeoutError      no answer in time; the line itself seems to work
    |   |-- LinkLostError           the line is gone: port vanished, connection closed, heartbeat frozen
    |   `-- ProtocolError           the peer does not speak this protocol, or not in this word order
    |-- ContradictionError          fields of the controller's status contradict each other or are impossible
    |-- OverdueError                an expected event did not happen within its limit
    |-- PathError                   the arm left the path of its move, or an axis its limits; it was stopped
    |-- ArrivalError                the arm is not at the commanded position, or arrived too early
    |-- NotOwnerError               another client owns the arm, or has stopped it
    `-- StateUnknownError           the execution of the last command is unknown; only state() and stop() are allowed

Errors of the serial and Modbus libraries are raised as these, with the original as cause. Every message states the
fact, then a valid value or a remedy.
"""


class DriverError(Exception):
    """Root of all errors that a driver raises."""


class DriverUrlError(DriverError):
    """The driver URL names no installed driver, an unknown option or an invalid value."""


class SetPointError(DriverError):
    """The set-points have a wrong type or shape, or a value is NaN or does not fit an int32."""


class NotConnectedError(DriverError):
    """The driver is used before connect() or after close()."""


class RefusedError(DriverError):
    """A command was refused and nothing moved.

    Attributes:
        result: result code of the controller: a `drivers.contract.Result`, or another controller's own number.
    """

    def __init__(self, message: str, result: int) -> None:
        super().__init__(message)
        self.result = result


class MoveEndedError(DriverError):
    """A move began, but did not end at its last set-point."""


class StoppedError(MoveEndedError):
    """The move was stopped on its path by a command."""


class FaultError(MoveEndedError):
    """The controller latched a fault.

    Attributes:
        code: fault code of the controller: a `drivers.contract.Fault`, or another controller's own number.
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
    """The peer's answer does not follow the protocol."""


class ContradictionError(DriverError):
    """Fields of the controller's status contradict each other or are impossible."""


class OverdueError(DriverError):
    """An expected event did not happen within its time limit."""


class PathError(DriverError):
    """The arm left the path of its move, or an axis its limits; it was stopped."""


class ArrivalError(DriverError):
    """The controller reports the end of a move, but the arm is elsewhere or arrived sooner than possible."""


class NotOwnerError(DriverError):
    """Another client owns the arm."""


class StateUnknownError(DriverError):
    """The execution of the last command is unknown; only state() and stop() are allowed."""
