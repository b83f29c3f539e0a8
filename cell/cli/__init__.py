"""The command line: its commands by subject, and how a command ends.

    planning      plan, setups, edit, why, diff
    inspection    check, init, part, robot, sensors, view, live, replay, points, export
    features      features, inspect
    execution     scan, explore, locate, calibrate hand-eye, controller, emulate
    study         place, study ...

Commands import heavy modules inside their functions, so that `--help` answers at once.
"""

import atexit
import gc
import os
import sys
from contextlib import suppress

from cell import signals
from cell.cli import execution, features, inspection, planning, study
from cell.cli.failures import report_errors, require_text, use_plain_characters
from cell.cli.options import add_moved, app

app.add_typer(execution.calibrate_app, name="calibrate")
app.add_typer(study.app, name="study")
add_moved(app, "cover", "cell cover", "python -m benchmarks cover solve FILE")

__all__ = ["app", "execution", "features", "inspection", "main", "planning", "study"]


def main(argv: list[str] | None = None) -> int:
    """Run a command; the entry point of the console script.

    A failure ends with one sentence and its exit code.
    """
    gc.set_threshold(50_000)  # with 700, the imports alone cause collections over all loaded modules: 0.13 s
    atexit.register(gc.freeze)  # without it Python collects once more at exit: 0.25 s
    signals.handle_termination()
    words = sys.argv[1:] if argv is None else argv
    use_plain_characters()

    def run() -> object:
        require_text(words)
        return app(args=words, prog_name="cell", standalone_mode=False)

    code = report_errors(run, as_json="--json" in words)
    if code == signals.INTERRUPTED:
        # The interrupt can hit a ray engine while it starts its threads: leave without an orderly shutdown.
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
