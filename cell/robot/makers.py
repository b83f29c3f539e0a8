"""Programming language of a robot's maker."""

import re
from pathlib import Path
from typing import Literal

MakerLanguage = Literal["krl", "rapid", "urscript", "ls", "inform"]

_MAKERS: tuple[tuple[str, MakerLanguage], ...] = (
    (r"kuka|(?<![a-z])kr_?\d", "krl"),
    (r"abb|(?<![a-z])irb", "rapid"),
    (r"universal|(?<![a-z])ur_?(3|5|7|8|10|12|15|16|18|20|30)", "urscript"),
    (r"fanuc|(?<![a-z])(lr_?mate|crx|[mr]_?\d+i)", "ls"),
    (r"yaskawa|motoman|(?<![a-z])(gp|hc|mh|ar)_?\d", "inform"),
)
"""Patterns of names of robot files, and the language of the maker."""


def maker_language(robot: str) -> MakerLanguage | None:
    """Return the language of the maker of a robot.

    Args:
        robot: name of the robot's file, or "kr16".

    Returns:
        None if the name shows no maker.
    """
    name = Path(robot).stem.lower()
    return next((language for pattern, language in _MAKERS if re.search(pattern, name)), None)
