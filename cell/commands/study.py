"""`cell study ...`: one command a study, all with the same options for where it runs and what it leaves."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from cell.study.study import Study

EPILOG = (
    "Examples:\n\n"
    "cell study table5\n\n"
    "cell study all --processes 4 --out tables\n\n"
    "cell study table1 --cluster tcp://scheduler:8786\n\n"
    "Every trial is kept as soon as it is done: a study that was stopped goes on where it was, and one that is asked "
    "for again takes a second. Exit codes: 0 done, 2 usage, 6 files, 70 bug, 130 Ctrl-C."
)

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Vary one thing after the other, in many trials: tables, curves, maps and the sentence that they come to.",
    epilog=EPILOG,
)

Processes = Annotated[
    int | None, typer.Option(metavar="N", help="Local worker processes. Default: one per core.", show_default=False)
]
Cluster = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, for instance tcp://scheduler:8786.")
]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the study. Default: sim_runs/study-<name>.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.")]


def conducted(
    make: "Callable[[], Study]", processes: int | None, cluster: str | None, out: Path | None, as_json: bool
) -> None:
    """Run a study and show what it says."""
    from cell.commands.narrator import Narrator
    from cell.study.study import conduct
    from cell.study.workers import open_workers

    narrator = Narrator(quiet_stdout=as_json)
    with open_workers(os.cpu_count() or 1 if processes is None else processes, cluster) as workers:
        result = conduct(make(), workers, out=out, narrator=narrator)
    if as_json:
        sys.stdout.write(json.dumps(result.summary(), indent=2, allow_nan=False) + "\n")
    else:
        narrator.study_table(result)


def _table(name: str, help_text: str) -> None:
    def command(
        part: Annotated[
            list[str] | None, typer.Option(metavar="NAME", help="Only rows of this part; may be given again.")
        ] = None,
        faces_share: Annotated[
            float, typer.Option(help="Share of the planning faces; below 1 is a reduced study.")
        ] = 1.0,
        processes: Processes = None,
        cluster: Cluster = None,
        out: Out = None,
        as_json: AsJson = False,
    ) -> None:
        from cell.errors import UsageError
        from cell.stand_ins import NAMES
        from cell.study.tables import table_study

        for each in part or []:
            if each not in NAMES:
                raise UsageError(f"--part {each} is not built in; there are {', '.join(NAMES)}")
        if not 0 < faces_share <= 1:
            raise UsageError(f"--faces-share {faces_share:g} must be above 0 and at most 1")
        conducted(
            lambda: table_study(name, faces_share=faces_share, parts=part or []), processes, cluster, out, as_json
        )

    command.__doc__ = help_text
    app.command(name, epilog=EPILOG)(command)


_table("table1", "The paper's Table 1: views and coverage over the decimation of the part.")
_table("table2", "The paper's Table 2: views and coverage over the standoff distance.")
_table("table3", "The paper's Table 3: views and coverage over the scanner's field of view.")
_table("table4", "The paper's Table 4: views and coverage over the angle between rays.")
_table("table5", "The paper's Table 5: reachable viewpoints, views and coverage over the part's position.")
_table("all", "All five tables of the paper: 86 rows, its method and ours side by side.")
