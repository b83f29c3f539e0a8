"""`cell sensors` as the command line gives it: options in, a table or one JSON object out."""

import json
import sys

from cell.commands.options import AsJson

EPILOG = "Examples:\n\ncell sensors\n\ncell plan --sensor gocator-2340 --baseline 100"


def sensors(
    as_json: AsJson = False,
) -> None:
    """List the real sensors that a scene may name, what is known of each, and what you have to give."""
    from cell.run.folder import SCHEMA
    from cell.scene import sensors as library

    if as_json:
        known = [library.load(name).summary() for name in library.names()]
        sys.stdout.write(json.dumps({"schema": SCHEMA, "sensors": known}, indent=2, allow_nan=False) + "\n")
    else:
        from cell.commands.terminal import Terminal

        library.print_table()
        Terminal().then(("cell", "plan", "--sensor", library.names()[0], "--baseline", 100))
