"""Errors that end a command, each with its exit code.

    CellError                       root
    |-- UsageError          2       a wrong option or an impossible combination
    |-- SceneError          2       a wrong scene file, or an impossible scene
    |-- UnreachableError    4       no candidate viewpoint is reachable
    |-- DriverFailureError  5       the robot controller, or the wire to it
    `-- FileError           6       a mesh, a run folder or the disk

Each message is one sentence: what is wrong, and what is valid. Coverage below the requirement (exit code 3) is a
result, not an error. A bug has code 70, Ctrl-C 130.
"""

from collections.abc import Iterator
from contextlib import contextmanager


class CellError(Exception):
    """Root of the errors that end a command with one sentence and an exit code."""

    exit_code = 70


class UsageError(CellError):
    """A wrong option or an impossible combination of options."""

    exit_code = 2


class SceneError(CellError):
    """A wrong scene file, or one that describes an impossible cell."""

    exit_code = 2


class UnreachableError(CellError):
    """The robot reaches no candidate viewpoint."""

    exit_code = 4


class DriverFailureError(CellError):
    """The driver failed; the message is the driver's own sentence."""

    exit_code = 5


class FileError(CellError):
    """A mesh or a run folder cannot be read or written."""

    exit_code = 6


@contextmanager
def errors_as(kind: type[CellError], *others: type[Exception]) -> Iterator[None]:
    """Convert other errors of the block to a `CellError` with the same message."""
    try:
        yield
    except others as error:
        raise kind(str(error)) from error
