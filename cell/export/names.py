"""Names of programs: well-formed, and not reserved in the language.

Reserved in KRL are keywords and predefined functions, declarations of KUKA's `$CONFIG.DAT` (a KSS 8; users may have
added more), KUKA's own programs, and definitions of the exported programs themselves. Names that Windows does not allow
for files are reserved in every language. KRL and RAPID ignore case; LS has upper case only.
"""

import re
import tomllib
from functools import cache
from importlib import resources

from cell.errors import UsageError
from cell.export.options import Language

MAX_NAME_LENGTH = 24
"""Most characters of a name in KRL; RAPID has 32, LS 36, and the longest suffix of a name here has 4."""

LANGUAGES = {"krl": "KRL", "rapid": "RAPID", "urscript": "URScript", "ls": "LS"}
"""Names of the languages."""

_RESERVED_PATTERNS = re.compile(r"(com|lpt|x?home|channel_|up|makro|xp)\d+|xhome|def_.*")
"""Patterns: names with a number (devices, positions, signals, KUKA's user programs), and defaults of $CONFIG.DAT."""


_NO_FILE = re.compile(r"aux|con|nul|prn|(com|lpt)\d+")
"""Names that Windows does not allow for files."""


def check_name(name: str, language: Language) -> None:
    """Require a name that a program in the language can have; names of tables follow KRL.

    Raises:
        UsageError: if it is too long, holds other characters, begins with a digit or is reserved.
    """
    title = LANGUAGES.get(language, "KRL")
    if len(name) > MAX_NAME_LENGTH:
        label = name if len(name) <= 2 * MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}..."
        raise UsageError(f"--name {label} has {len(name)} characters; a name in {title} has at most {MAX_NAME_LENGTH}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise UsageError(
            f"--name {name or repr(name)} is not a name in {title}; it must begin with a letter and hold only "
            "letters, digits and _"
        )
    lower = name.lower()
    is_reserved = lower in _reserved_names()[title.lower()]
    if title == "KRL" and (is_reserved or _RESERVED_PATTERNS.fullmatch(lower)):
        raise UsageError(
            f"--name {name} is reserved in KRL, in $CONFIG.DAT or in the exported program; choose another name"
        )
    if title != "KRL" and (is_reserved or _NO_FILE.fullmatch(lower) or re.fullmatch(r"sc[A-Z_].*", name)):
        raise UsageError(f"--name {name} is reserved in {title} or in the exported program; choose another name")


@cache
def _reserved_names() -> dict[str, list[str]]:
    """Return the reserved names of each language."""
    content = (resources.files("cell.export") / "reserved_names.toml").read_text(encoding="utf-8")
    return {language: " ".join(names.values()).split() for language, names in tomllib.loads(content).items()}
