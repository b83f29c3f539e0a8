"""`python -m benchmarks paper [TABLE]`: the paper's Tables 1 to 5, its method and ours side by side, 86 rows in all.

Without arguments: Table 2 of the mug with a twentieth of the faces, in a minute.
"""

from typing import Annotated

import typer

from benchmarks.paper.study import table_study
from benchmarks.paper.tables import tables
from cell.cli.options import AsJson, from_fields
from cell.cli.study import run_and_print
from cell.errors import UsageError
from cell.study.options import StudyRun

REDUCED_FACES_SHARE = 0.05

app = typer.Typer(add_completion=False)


@app.command(
    epilog="Examples:\n\n"
    "python -m benchmarks paper table5\n\n"
    "python -m benchmarks paper all --processes 4 --out tables\n\n"
    "python -m benchmarks paper table1 --cluster tcp://scheduler:8786"
)
@from_fields
def paper(
    *,
    table: Annotated[
        str | None, typer.Argument(metavar="[table1|...|table5|all]", help="Default: a reduced Table 2 of the mug.")
    ] = None,
    run: StudyRun,
    part: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only rows of this part; can be given several times.")
    ] = None,
    faces_share: Annotated[float, typer.Option(help="Share of the planning faces; below 1 for a reduced study.")] = 1.0,
    as_json: AsJson = False,
) -> None:
    """Compute the paper's tables."""
    if table is None:
        table, part, faces_share = "table2", part or ["mug"], min(faces_share, REDUCED_FACES_SHARE)
    names, parts = [*tables(), "all"], {row.part for rows in tables().values() for row in rows}
    if table not in names:
        raise UsageError(f"{table} is no table of the paper; choose one of {', '.join(names)}")
    for each in part or []:
        if each not in parts:
            raise UsageError(f"--part {each} is not in the paper's tables; choose one of {', '.join(sorted(parts))}")
    if not 0 < faces_share <= 1:
        raise UsageError(f"--faces-share {faces_share:g} must be above 0 and at most 1")
    run_and_print(lambda: table_study(table, faces_share=faces_share, parts=part or []), run, as_json)
