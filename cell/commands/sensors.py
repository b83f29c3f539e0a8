"""`cell sensors` as the command line gives it: options in, a table or one JSON object out."""

from cell.commands.options import AsJson, print_json

EPILOG = (
    "Examples:\n\n"
    "cell sensors\n\n"
    "cell plan --sensor generic-area-medium\n\n"
    "cell plan --sensor gocator-2340 --baseline 100"
)


def sensors(
    as_json: AsJson = False,
) -> None:
    """List the scanners that a scene may name, what is known of each, and what you have to give."""
    from cell.runs.folder import SCHEMA
    from cell.scene import sensors as library

    if as_json:
        known = [library.load(name).summary() for name in library.names()]
        print_json({"schema": SCHEMA, "sensors": known})
    else:
        from cell.commands.terminal import Terminal

        terminal = Terminal()
        heading, *rows = library.table_rows()
        terminal.grid(heading, rows)
        terminal.say(
            "mm, deg. distance: from the housing; line: its length at the near and the far end; range: from the laser "
            "source, of a line as depth from its fan's apex; x: times the standoff; you give: keys of scanner that no "
            "source states. cell sensors --json has all figures with their sources."
        )
        terminal.then(("cell", "plan", "--sensor", library.names()[0]))
