"""The command that plans as a row of a study says."""

import json
import shlex
from collections.abc import Mapping

from cell.scene.model import Scene
from cell.scene.options import flag, option_specs


def options(asked: Mapping[str, Mapping[str, object]]) -> str:
    """Words of `cell plan` for keys of a scene; what only a scene file can say stands behind them as a comment."""
    words: list[str] = []
    only_in_a_file: list[str] = []
    known = {key: offer for offer in option_specs(Scene).values() for key in offer.fields}
    for table, keys in asked.items():
        for key, value in keys.items():
            if (table, key) == ("part", "name"):
                words.insert(0, str(value))
            elif f"{table}.{key}" in known:
                several = value if isinstance(value, list | tuple) else [value]
                text = ",".join(f"{each:g}" if isinstance(each, float) else str(each) for each in several)
                words.append(f"{flag(known[f'{table}.{key}'].name)}={text}")
            else:
                only_in_a_file.append(f"{key} = {json.dumps(value)} under [{table}]")
    remark = f"  # with {', '.join(only_in_a_file)} in the scene file" if only_in_a_file else ""
    return shlex.join(words) + remark
