"""The KRL program that `kvp://` needs on a KUKA controller: it executes the orders that a client writes as variables.

| variable | writer | meaning |
|---|---|---|
| `SC_POINT[n]` | client | via point n, with the session and the number of its move |
| `SC_ORDER` | client | the order: session, number, kind (1 move, 2 reset), number of via points, speed [%] |
| `SC_TAKE` | client | a session that asks for the arm; negative: that gives it back |
| `SC_HALT`, `SC_HALTER` | client | number of a stop, and its session, which is written first |
| `$TIMER[n]` | client | minus the watchdog [ms], as heartbeat |
| `SC_STATE` | program | see below |

`SC_STATE` holds the number of starts, the owner, the last answered order with its result, the last ended move with its
result, the current move, its passed via points, and the latched fault.

The program sets `SC_ORDER.NUMBER`, `SC_TAKE` and `SC_HALT` to 0 when it has read them. It executes an order once, if
it is of the owner and newer than the last one, and a move only if all of its via points are written. Three interrupts
brake a moving arm: a stop, the flag of the timer, which rises when the heartbeat ends, and the emergency stop. `RESUME`
then leaves the motion, if the program runs. The components of `SC_STATE` are written in an order in which a
reading between two of them is consistent.
"""

from typing import Final

from drivers.contract import LAST_SEQUENCE, Fault, Result
from drivers.wires.controller_files import filled_file

NAME: Final = "sc_kvp"
MAX_VIA: Final = 500
MOVE, RESET = 1, 2
TIMER: Final = 10
"""Default number of the watchdog's timer."""
MAX_TIMER: Final = 32
"""Largest number of a timer."""

STATE: Final = ("BOOT", "OWNER", "ACK", "RESULT", "DONE", "ENDING", "RUNNING", "PASSED", "FAULT")
"""Components of `SC_STATE`."""


def files(timer: int = TIMER) -> dict[str, bytes]:
    """Return the files of the program.

    Args:
        timer: number of the watchdog's timer, 1 to `MAX_TIMER`.
    """
    values = {
        "TIMER": timer, "MAX_VIA": MAX_VIA, "RESET": RESET, "LAST": LAST_SEQUENCE, "HALF": LAST_SEQUENCE // 2,
        "COMPONENTS": ",".join(STATE), "ZEROS": ",".join(f"{name} 0" for name in STATE),
        **{f"R_{result.name}": int(result) for result in Result},
        **{f"F_{fault.name}": int(fault) for fault in Fault},
    }  # fmt: skip
    return {name: filled_file(name, values) for name in (f"{NAME}.src", f"{NAME}.dat")}
