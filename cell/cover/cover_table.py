"""What `cell cover` prints for a person."""

from rich.console import Console
from rich.table import Table

from cell.cover.solve_file import CoverOutcome


def print_table(outcome: CoverOutcome) -> None:
    """One table: the problem, the cover, what is proven about it, and the columns."""
    said = outcome.as_json()
    table = Table(show_header=False, title=f"{outcome.path.name}: {said['sentence']}", title_justify="left")
    table.add_row(
        "problem", f"{said['rows']} rows, {said['columns']} columns, {said['entries']} ones ({said['format']})"
    )
    table.add_row("columns", str(said["n_views"]))
    if outcome.result.price is not None:
        table.add_row("cost", f"{said['cost']:.10g}")
    table.add_row("lower bound", f"{said['lower_bound']:.10g}")
    table.add_row("gap", f"{100 * said['gap']:.1f} %")
    if said["uncoverable_rows"]:
        table.add_row("rows without a column", str(len(said["uncoverable_rows"])))
    table.add_row("solver", f"{said['solver']}, {said['seconds']:.2f} s")
    table.add_row("chosen", " ".join(map(str, said["views"])))
    Console().print(table)
