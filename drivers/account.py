"""What a client knows of the controller that it left: session, boot, last number; and sending so that this stays true.

Nothing is guessed. What cannot be found out is a *doubt*, in words, and while there is one only reading and stopping
are possible.
"""

from collections.abc import Callable

from drivers import status
from drivers.clock import Clock
from drivers.commands import Answer, Command, Result, next_sequence, sentence_of
from drivers.contract import RobotState
from drivers.errors import LinkError, LinkLostError, NotOwnerError, ProtocolError, RefusedError, StateUnknownError
from drivers.link import Link

_TAKE_PAUSE = 0.1  # s between two attempts to take a session


class Account:
    """The account of one client.

    Args:
        link: the wire.
        session: the client's number.
        read: reads the state.

    Attributes:
        session: the client's number.
        owns: whether the session owns the arm, as far as this client knows.
        boot: which run of the controller that was.
        doubt: what is not known, in words; empty where all is.
    """

    def __init__(self, link: Link, session: int, read: Callable[[], RobotState]) -> None:
        self._link, self._read = link, read
        self.session, self.owns, self.boot, self.doubt = session, False, 0, ""
        self._sequence = 0  # the last number used
        self._acknowledged = 0  # the last number whose answer is known

    def agree(self, state: RobotState) -> None:
        """Go on from where the controller is."""
        self.doubt, self.owns, self.boot = "", state.owner == self.session, state.boot
        self._sequence = self._acknowledged = state.ack_sequence

    def number(self) -> int:
        """A new sequence number."""
        self._sequence = next_sequence(self._sequence)
        return self._sequence

    def require_no_doubt(self) -> None:
        """Refuse to go on in doubt.

        Raises:
            StateUnknownError: while there is one.
        """
        if self.doubt:
            raise StateUnknownError(f"{self.doubt}; only reading and stopping are possible, so stop() first")

    def take(self, clock: Clock, say: Callable[[str], None] | None) -> None:
        """Own the arm; a silent owner is waited for, as long as its watchdog may be.

        Args:
            clock: with which to wait.
            say: told what is waited for.

        Raises:
            NotOwnerError: if another client owns the arm and is there.
            RefusedError: if the controller refuses otherwise.
            StateUnknownError: in doubt, and where the controller was restarted since it was connected.
        """
        self.require_no_doubt()
        if self.owns:
            return
        began, said = clock.now(), False
        while (result := self._link.take(self.session)) != Result.OK:
            waited, owner = clock.now() - began, self._link.state().owner
            if result != Result.NOT_OWNER:
                raise RefusedError(f"the controller does not give the arm: {sentence_of(result)}", result)
            if waited > status.TAKE:
                raise NotOwnerError(f"session {owner} owns the arm and its client is there; end that client first")
            if say and waited > status.SAID_AFTER and not said:
                said = True
                say(f"waiting for the client of session {owner}, which owns the arm, to fall silent")
            clock.wait(_TAKE_PAUSE)
        state = self._read()
        if state.boot != self.boot:
            self.doubt = "the controller was restarted"
            self.require_no_doubt()
        self.agree(state)

    def foreign(self, state: RobotState) -> str:
        """Why this is not the controller that this client left; empty if it is."""
        if state.boot != self.boot:
            return "the controller was restarted"
        if self.owns and state.owner != self.session:
            by = f"session {state.owner} owns the arm now" if state.owner else "another client has stopped the arm"
            return f"{by}; session {self.session} of this client has ended"
        if state.ack_sequence not in (self._acknowledged, self._sequence):
            return (
                f"the controller last answered command {state.ack_sequence}, neither {self._acknowledged} nor "
                f"{self._sequence}: it was restarted, or another client talks to it"
            )
        return ""

    def send(self, command: Command) -> int:
        """Send a command under a new number, find out what became of it if no answer comes, and return the number.

        Raises:
            RefusedError: if it was refused.
            NotOwnerError: if the session has ended.
            StateUnknownError: if it cannot be found out.
        """
        sequence = self.number()
        answer = self._answer_to(sequence, command)
        if answer.result == Result.NOT_OWNER:
            self.doubt = f"session {self.session} of this client has ended"
            raise NotOwnerError(f"{answer.sentence}: {self.doubt}, and nothing is sent before a stop")
        self._acknowledged = sequence
        if answer.result != Result.OK:
            raise RefusedError(f"the controller refused command {sequence}: {answer.sentence}", answer.result)
        return sequence

    def _answer_to(self, sequence: int, command: Command) -> Answer:
        failure: LinkError
        for _ in range(2):
            try:
                return self._link.send(sequence, command)
            except LinkLostError as error:
                failure = error
                break
            except LinkError as error:  # no answer, or none that could be read
                failure = error
            try:
                state = self._read()
            except LinkError as error:
                failure = error
                break
            if foreign := self.foreign(state):
                failure = ProtocolError(foreign)
                break
            if state.ack_sequence == sequence:
                return Answer(sequence, state.ack_result)
        raise self.unknown(f"whether command {sequence} was executed is not known", failure) from failure

    def unknown(self, what: str, failure: LinkError) -> StateUnknownError:
        """Note a doubt; the error that tells of it."""
        self.doubt = f"{what} ({failure})"
        return StateUnknownError(f"{self.doubt}; only reading and stopping are possible")
