"""Python processes of the package's own, beside the process of the user."""

import sys


def python_command(code: str) -> list[str]:
    """Return the command of a process that runs code with the module path of this process.

    Modules, such as plug-ins, may be on a path that only this process has. Those of the working directory are not
    imported unless this process imports them.
    """
    path = [folder for folder in sys.path if isinstance(folder, str)]  # the import system ignores others
    return [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {path!r}; {code}"]
