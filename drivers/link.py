"""One wire to one controller, as `drivers.client` needs it: the one thing to write for a wire of your own."""

from typing import Protocol

from drivers.commands import Answer, Command
from drivers.contract import Capabilities, RobotState


class Link(Protocol):
    """One wire to one controller. It raises only `LinkError`s, and never repeats a command by itself.

    Attributes:
        deadline: time of the client's clock after which it does not ask again by itself.
    """

    deadline: float

    def open(self) -> Capabilities:
        """Open the wire and make sure that a controller of ours answers."""

    def close(self) -> None:
        """Give the wire back; may be called twice."""

    def take(self, session: int) -> int:
        """Ask for the arm, or keep it; the answer's result. From OK on all that is sent is this session's."""

    def give(self) -> None:
        """Give the session back, if there is one."""

    def send(self, sequence: int, command: Command) -> Answer:
        """Send one command once and wait for the answer that carries its number."""

    def state(self) -> RobotState:
        """Read the state. Reading is harmless, so a link may ask again by itself before it gives up."""

    def time_to_wait(self) -> float:
        """Time [s] after which asking for the state again makes sense."""
