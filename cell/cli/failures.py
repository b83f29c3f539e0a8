"""Failures of a command: one sentence on stderr and an exit code; with `--json` also one JSON object on stdout."""

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import typer

from cell import signals
from cell.errors import CellError, FileError
from cell.signals import INTERRUPTED

_BUG = 70

_RENAMED = {
    "--k-fold": "--multiplicity",
    "--require-total": "--require",
    "--within": "--tolerance",
    "--most": "--max-setups",
    "--offer": "--proposals",
    "--least-gain": "--min-gain",
    "--open-of": "cell setups --first RUN",
}
"""Options of earlier versions and their present form."""

# typer has its own copy of click and does not export its classes; BadParameter is one of its usage errors.
_TyperUsageError: Any = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")


def report_errors(run: Callable[[], Any], *, as_json: bool) -> int:
    """Run a command, report its failure and return the exit code.

    Args:
        run: the command; it can end with `typer.Exit`.
        as_json: whether stdout must hold exactly one JSON object, also after a failure.
    """
    try:
        result = run()
    except (KeyboardInterrupt, typer.Abort):
        return _report(_interruption(), INTERRUPTED, as_json)
    except _TyperUsageError as error:
        if (old := getattr(error, "option_name", None)) in _RENAMED:
            return _report(f"the option {old} is now {_RENAMED[old]}", int(error.exit_code), as_json)
        error.show()
        if type(error).__name__ == "NoArgsIsHelpError":  # `cell` alone prints the help
            return 0
        return _report(error.format_message(), int(error.exit_code), as_json, is_printed=True)
    except CellError as error:
        return _report(str(error), error.exit_code, as_json)
    except BrokenPipeError:
        # The reader of stdout closed it (`cell ... | head`); the command is finished and its folder complete.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # of the system: names of more than 255 bytes, permissions, devices
        name = f"{str(error.filename)[:80]} " if error.filename is not None else ""
        reason = (error.strerror or "the operating system refuses access").lower()
        return _report(f"{name}cannot be used: {reason}; choose another name or folder", FileError.exit_code, as_json)
    except MemoryError:
        return _report("out of memory; use fewer --faces, --samples or --standoff values", CellError.exit_code, as_json)
    except Exception as error:
        if os.environ.get("SCAN_CELL_TRACEBACK"):
            raise
        return _report(
            f"this is a bug in scan-cell: {type(error).__name__}: {error}. "
            "Set SCAN_CELL_TRACEBACK=1 to see where, and please report it",
            _BUG,
            as_json,
        )
    code = result if isinstance(result, int) else 0  # typer returns the code of its Exit, also after Ctrl-C
    return _report(_interruption(), INTERRUPTED, as_json) if code == INTERRUPTED else code


def _interruption() -> str:
    return f"stopped by {signals.last_signal()}; finished results are kept"


def _report(sentence: str, code: int, as_json: bool, *, is_printed: bool = False) -> int:
    with suppress(OSError):  # a closed terminal must not prevent the end
        if not is_printed:
            sys.stderr.write(f"cell: {sentence}\n")
        if as_json:
            status = "interrupted" if code == INTERRUPTED else "failed"
            sys.stdout.write(json.dumps({"status": status, "exit_code": code, "reason": sentence}, indent=2) + "\n")
    return code
