"""Failures of a command: one sentence on stderr and an exit code; with `--json` also one JSON object on stdout."""

import codecs
import errno
import io
import json
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import typer

from cell import signals
from cell.errors import CellError, FileError, UsageError
from cell.signals import INTERRUPTED, is_interruption

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
        return _close_stdout()
    except OSError as error:  # of the system: names of more than 255 bytes, permissions, devices
        if (plug_in := _plug_in_of(error)) is not None:
            return _report(*_plug_in_failure(plug_in, error), as_json)
        # A write to an open file has no name; the results of a command are in its folder or at --out.
        name = (
            str(error.filename)[:80]
            if error.filename is not None
            else f"standard output, or a file below {Path.cwd()} or at --out,"
        )
        reason = (error.strerror or "the operating system refuses access").lower()
        return _report(f"{name} cannot be used: {reason}; choose another name or folder", FileError.exit_code, as_json)
    except MemoryError as error:
        owner = f" in {plug_in[0]}" if (plug_in := _plug_in_of(error)) is not None else ""
        return _report(
            f"out of memory{owner}; close other programs, plan with fewer --faces, --samples or --standoff values, or "
            "scan at a coarser --resolution",
            UsageError.exit_code,
            as_json,
        )
    except (Exception, SystemExit) as error:
        if is_interruption(error):
            return _report(_interruption(), INTERRUPTED, as_json)
        # The libraries of the terminal end the process when the reader of stdout has closed it.
        if isinstance(error.__context__, OSError) and error.__context__.errno == errno.EPIPE:
            return _close_stdout()
        if (plug_in := _plug_in_of(error)) is not None:
            return _report(*_plug_in_failure(plug_in, error), as_json)
        if isinstance(error, SystemExit) or os.environ.get("SCAN_CELL_TRACEBACK"):
            raise
        return _report(
            f"this is a bug in scan-cell: {type(error).__name__}: {error}. "
            "Set SCAN_CELL_TRACEBACK=1 to see where, and please report it",
            _BUG,
            as_json,
        )
    code = result if isinstance(result, int) else 0  # typer returns the code of its Exit, also after Ctrl-C
    return _report(_interruption(), INTERRUPTED, as_json) if code == INTERRUPTED else code


def _plug_in_of(error: BaseException) -> tuple[str, int] | None:
    """Return name and exit code of the foreign plug-in whose code raised an error; None if none did."""
    kinds = {"cell.scanners": ("scanner", 2), "cell.drivers": ("driver", 5), "cell.acquisition": ("acquisition", 2)}
    owners = {
        point.module.partition(".")[0]: (f"the {kind} '{point.name}' ({point.value})", code)
        for group, (kind, code) in kinds.items()
        for point in entry_points(group=group)
    }
    frames = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    for module in reversed(frames):
        root = str(module).partition(".")[0]
        if root in ("cell", "planner", "drivers"):
            return None
        if root in owners:
            return owners[root]
    return None


def _plug_in_failure(plug_in: tuple[str, int], error: BaseException) -> tuple[str, int]:
    """Return the sentence about a plug-in that raised an error, and its exit code."""
    name, code = plug_in
    return f"{name} failed with {type(error).__name__}: {error}; repair or uninstall its distribution", code


def _close_stdout() -> int:
    """Discard the rest of stdout, whose reader has ended (`cell ... | head`); the command itself is finished."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


_PLAIN = str.maketrans({"²": "2", "³": "3", "°": " deg", "µ": "u", "…": "..."})


def use_plain_characters() -> None:
    """Replace characters that the console's encoding lacks, in place of an error."""

    def plain(error: UnicodeError) -> tuple[str, int]:
        assert isinstance(error, UnicodeEncodeError)
        text = error.object[error.start : error.end].translate(_PLAIN)
        return text.encode("ascii", errors="replace").decode("ascii"), error.end

    codecs.register_error("cell-plain", plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="cell-plain")


def require_text(words: Sequence[str]) -> None:
    """Refuse arguments and a working directory that are not text, before any work: results contain their names.

    Raises:
        UsageError: with the name, its broken characters replaced.
    """
    for word in (*words, str(Path.cwd())):
        try:
            word.encode()
        except UnicodeEncodeError as error:
            name = word.encode("utf-8", errors="replace").decode()
            raise UsageError(f"the name '{name}' is not valid UTF-8 text; rename it") from error


def _interruption() -> str:
    folder = signals.kept_folder()
    return f"stopped by {signals.last_signal()}; finished results are kept{f' in {folder}' if folder else ''}"


def _report(sentence: str, code: int, as_json: bool, *, is_printed: bool = False) -> int:
    with suppress(OSError):  # a closed terminal must not prevent the end
        if not is_printed:
            sys.stderr.write(f"cell: {sentence}\n")
        if as_json:
            status = "interrupted" if code == INTERRUPTED else "failed"
            sys.stdout.write(json.dumps({"status": status, "exit_code": code, "reason": sentence}, indent=2) + "\n")
    return code
