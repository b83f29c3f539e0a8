"""Every failure of a command becomes one sentence on stderr and its exit code (and one JSON object with `--json`)."""

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import typer

from cell.errors import CellError, FileError
from cell.signals import INTERRUPTED, told

_BUG = 70

# typer carries its own copy of click, whose classes it does not export; BadParameter is one of its errors of usage.
_UsageMistake: Any = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")


def guarded(run: Callable[[], Any], *, as_json: bool) -> int:
    """Run a command.

    Args:
        run: the command; it may end with `typer.Exit`.
        as_json: whether stdout is to hold exactly one object: then a failure is one too.

    Returns:
        The exit code.
    """
    try:
        result = run()
    except (KeyboardInterrupt, typer.Abort):
        return _say(_stopped(), INTERRUPTED, as_json)
    except _UsageMistake as error:
        error.show()
        if type(error).__name__ == "NoArgsIsHelpError":  # `cell` alone: the help is the answer
            return 0
        return _say(error.format_message(), int(error.exit_code), as_json, said=True)
    except CellError as error:
        return _say(str(error), error.exit_code, as_json)
    except BrokenPipeError:
        # The reader of stdout went away (`cell ... | head`); the work is done and the folder complete.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # of the machine and its files: names of more than 255 bytes, rights, devices
        named = f"{str(error.filename)[:80]} " if error.filename is not None else ""
        reason = (error.strerror or "the system refuses it").lower()
        return _say(f"{named}cannot be used: {reason}; give another name or place", FileError.exit_code, as_json)
    except MemoryError:
        return _say("out of memory; use fewer --faces, --samples or --standoff values", CellError.exit_code, as_json)
    except Exception as error:
        if os.environ.get("SCAN_CELL_TRACEBACK"):
            raise
        return _say(
            f"this is a bug in scan-cell: {type(error).__name__}: {error}. "
            "Set SCAN_CELL_TRACEBACK=1 to see where, and please report it",
            _BUG,
            as_json,
        )
    code = result if isinstance(result, int) else 0  # typer hands the code of its Exit back
    return _say(_stopped(), INTERRUPTED, as_json) if code == INTERRUPTED else code  # and takes Ctrl-C for such an exit


def _stopped() -> str:
    return f"stopped by {told()}; what was finished is kept"


def _say(sentence: str, code: int, as_json: bool, *, said: bool = False) -> int:
    with suppress(OSError):  # a terminal that was closed cannot be told, and that must not hold up the end
        if not said:
            sys.stderr.write(f"cell: {sentence}\n")
        if as_json:
            status = "interrupted" if code == INTERRUPTED else "failed"
            sys.stdout.write(json.dumps({"status": status, "exit_code": code, "reason": sentence}, indent=2) + "\n")
    return code
