"""The errors that a user of the command line meets, each with its exit code.

    CellError                       root
    |-- UsageError          2       a wrong option or an impossible combination
    |-- SceneError          2       the scene file, or a scene that cannot be
    |-- UnreachableError    4       no candidate viewpoint can be reached
    |-- DriverFailureError  5       the robot controller, or the wire to it
    `-- FileError           6       a mesh, a run folder or the disk

Every message is one clear sentence: the fact, what would be valid, and where. Coverage below the requirement (exit
code 3) is a result, not an error. A bug has code 70, Ctrl-C 130.
"""


class CellError(Exception):
    """Root of the errors that end a command with one sentence and an exit code."""

    exit_code = 70


class UsageError(CellError):
    """A wrong option or an impossible combination of options."""

    exit_code = 2


class SceneError(CellError):
    """The scene file is wrong, or describes a cell that cannot be."""

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
