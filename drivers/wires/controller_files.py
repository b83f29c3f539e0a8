"""Files for a controller: ASCII, lines that end with CR LF. Their templates are files of this package."""

import re
from collections.abc import Mapping
from importlib import resources


def filled_file(name: str, values: Mapping[str, object]) -> bytes:
    """Return a file of this package with a value for each `<NAME>` that has one."""
    text = (resources.files("drivers.wires") / name).read_text(encoding="ascii")
    return encoded(re.sub(r"<(\w+)>", lambda match: str(values.get(match[1], match[0])), text))


def encoded(text: str) -> bytes:
    """Return a text as a file of a controller."""
    return text.replace("\n", "\r\n").encode("ascii")
