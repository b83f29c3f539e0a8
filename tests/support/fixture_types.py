"""Types of the fixtures that run the command line."""

import subprocess
from collections.abc import Callable
from typing import Any

RunCommand = Callable[..., subprocess.CompletedProcess[str]]
StartCommand = Callable[..., "subprocess.Popen[str]"]
Emulate = Callable[..., Any]
