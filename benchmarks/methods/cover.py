"""`python -m benchmarks cover ...`: view selection compared with HiGHS, CP-SAT and a textbook search at equal time.

    solve       solve a set-cover file of the OR-Library with the product's solvers
    matrices    make the measurability matrices of all parts (the parts of benchmarks/parts.py)
    files       covers of set-cover files and generated instances: cost, excess, bound, processor seconds
    parts       covers of measurability matrices at each coverage
    most        the most coverage with k views
    steady      processor seconds for each second of budget
    large       two large generated matrices, with memory
    chart       excess over the best known against processor time

An instance is a set-cover file, or the name of a generated one (`benchmarks/covers/generators.py`): cyc9,
rail:500x20000:1. Each figure stores its runs in the folder of `--out`, resumes there, and writes FIGURE.json and
FIGURE.md there. Our solver gets counted effort, the rivals processor seconds. Without a subcommand every figure is
computed in a reduced form, in one minute.
"""

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from benchmarks.covers import figures
from benchmarks.covers.chart import draw
from benchmarks.covers.figures import Row, Store
from benchmarks.covers.instances import Task
from benchmarks.covers.solve import CoverOptions, solve_file
from cell.cli.options import AsJson, from_fields, print_json
from cell.cli.terminal import Terminal
from cell.study.study import markdown_table

LARGE = (("uniform:10000x10000:0.05:1", 10.0), ("caps:10000x10000:0.05:7", 10.0), ("uniform:30000x30000:0.01:1", 20.0))
"""Instances and budgets [s]; each is promised to stay below 1 GB."""

CHARTED = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Budgets of ours in the chart; the rivals tell when they found what."""

app = typer.Typer(add_completion=False, help=__doc__)

_Instances = Annotated[list[str], typer.Argument(help="Files, or names of generated instances.")]
_Seconds = Annotated[float, typer.Option(help="Processor seconds; for ours seconds' worth of work, 0 its default.")]
_Solvers = Annotated[list[str] | None, typer.Option("--solver", help="ours, textbook, HiGHS, CP-SAT. Default: ours.")]
_Seeds = Annotated[int, typer.Option(help="Number of seeds, from 1.")]
_Weighted = Annotated[bool, typer.Option(help="Columns cost what the file says, or 1.")]
_Coverages = Annotated[list[float] | None, typer.Option("--coverage", help="Shares of the coverable area. Default: 1.")]
_Out = Annotated[Path, typer.Option(help="Folder of runs and tables.")]
_OUT = Path("sim_runs/cover")


@app.callback(invoke_without_command=True)
def reduced(context: typer.Context) -> None:
    """Compute a reduced form of every figure on generated instances, in one minute."""
    if context.invoked_subcommand is None:
        files(["cyc6", "rail:100x2000:1", "uniform:200x1000:0.02:1"], 1.0, ["ours", "textbook", "HiGHS"])
        steady(["cyc7", "uniform:500x500:0.05:1"], [1.0, 2.0])
        most(["caps:400x200:0.1:1"], 1.0, ["ours", "HiGHS"], first=2, last=3)
        chart(["cyc7"], 1.0, ["ours", "textbook"])


@app.command(
    epilog="Examples:\n\n"
    "python -m benchmarks cover solve scp41.txt --unicost --budget 10\n\n"
    "python -m benchmarks cover solve rail507.gz --budget 60 --json\n\n"
    "FILE is in the row or the rail format of the OR-Library, or a list of Steiner triples; plain or gzip. Ctrl-C ends "
    "the search with the best cover so far."
)
@from_fields
def solve(
    *,
    file: Annotated[Path, typer.Argument(help="Set-cover file.")],
    options: CoverOptions,
    unicost: Annotated[bool, typer.Option("--unicost/--costs", help="Costs of 1, or the costs in the file.")] = False,
    as_json: AsJson = False,
) -> None:
    """Solve a set-cover file with the solvers that select the views."""
    solved = solve_file(file, options, unicost=unicost)
    if as_json:
        print_json(solved.as_json())
    else:
        Terminal().print_pairs(f"{solved.path.name}: {solved.sentence}", solved.rows())


@app.command()
def matrices(folder: Annotated[Path, typer.Argument(help="Where the files are written.")]) -> None:
    """Make the measurability matrices of all parts, with and without the robot."""
    from benchmarks.covers.visibility import write  # loads MuJoCo and Embree, which only this command needs

    for path in write(folder):
        Console().print(str(path))


@app.command()
def files(
    instances: _Instances, seconds: _Seconds = 10.0, solver: _Solvers = None, seeds: _Seeds = 1,
    weighted: _Weighted = False, out: _Out = _OUT,
) -> None:  # fmt: skip
    """Compute covers of set-cover files and generated instances."""
    rows = _runs(out, _tasks(instances, solver, [seconds], seeds, weighted=weighted))
    lines = figures.covers(rows)
    _show(out, "weighted" if weighted else "files", lines, figures.sums(lines))


@app.command()
def parts(
    instances: _Instances, seconds: _Seconds = 10.0, solver: _Solvers = None, seeds: _Seeds = 1,
    coverage: _Coverages = None, out: _Out = _OUT,
) -> None:  # fmt: skip
    """Compute covers of measurability matrices, full and at shares of the coverable area."""
    rows, sentences = list[Row](), list[str]()
    for share in coverage or [1.0]:
        found = _runs(out, _tasks(instances, solver, [seconds], seeds, coverage=share))
        rows += found
        sentences += [f"coverage {share:g}, {sentence}" for sentence in figures.sums(figures.covers(found))]
    _show(out, "parts", figures.by_part(rows), sentences)


@app.command()
def most(
    instances: _Instances, seconds: _Seconds = 10.0, solver: _Solvers = None, seeds: _Seeds = 1,
    first: Annotated[int, typer.Option(help="Fewest views.")] = 1,
    last: Annotated[int, typer.Option(help="Most views.")] = 15, out: _Out = _OUT,
) -> None:  # fmt: skip
    """Compute the most coverage with k views. Use one call with 60 s for HiGHS and one with 10 s for ours."""
    tasks = [task for k in range(first, last + 1) for task in _tasks(instances, solver, [seconds], seeds, max_views=k)]
    _show(out, "most", figures.most(_runs(out, tasks)), [])


@app.command()
def steady(
    instances: _Instances,
    seconds: Annotated[list[float] | None, typer.Option(help="Budgets. Default: 1, 2, 5.")] = None,
    weighted: _Weighted = False, coverage: _Coverages = None, out: _Out = _OUT,
) -> None:  # fmt: skip
    """Measure processor seconds for each second of budget."""
    budgets = seconds or [1.0, 2.0, 5.0]
    rows = [
        row
        for share in coverage or [1.0]
        for row in _runs(out, _tasks(instances, None, budgets, 1, weighted=weighted, coverage=share))
    ]
    _show(out, "steady", *figures.steady(rows))


@app.command()
def large(solver: _Solvers = None, out: _Out = _OUT) -> None:
    """Solve large generated matrices and measure memory."""
    tasks = [task for name, seconds in LARGE for task in _tasks([name], solver, [seconds], 1)]
    _show(out, "large", figures.large(_runs(out, tasks)), [])


@app.command()
def chart(
    instances: _Instances, seconds: _Seconds = 10.0, solver: _Solvers = None, weighted: _Weighted = False,
    out: _Out = _OUT,
) -> None:  # fmt: skip
    """Draw the mean excess over the best known against processor time."""
    rivals = [name for name in solver or ["ours", "textbook", "HiGHS", "CP-SAT"] if name != "ours"]
    budgets = [budget for budget in CHARTED if budget <= seconds]
    tasks = _tasks(instances, None, budgets, 1, weighted=weighted)
    if rivals:
        tasks += _tasks(instances, rivals, [seconds], 1, weighted=weighted)
    draw(_runs(out, tasks), out / "chart.png")


def _tasks(
    instances: Sequence[str], solvers: Sequence[str] | None, seconds: Sequence[float], seeds: int, **request: Any
) -> list[Task]:
    return [
        Task(instance, solver, budget or None, seed, **request)
        for instance, solver, budget, seed in product(instances, solvers or ["ours"], seconds, range(1, seeds + 1))
    ]


def _runs(out: Path, tasks: Sequence[Task]) -> list[Row]:
    return Store(out).rows(tasks)


def _show(out: Path, name: str, lines: list[Row], sentences: Sequence[str]) -> None:
    text = [f"# {name}", "", *markdown_table(lines), "", *(f"{sentence}\n" for sentence in sentences)]
    (out / f"{name}.json").write_text(
        json.dumps({"rows": lines, "sentences": list(sentences)}, indent=2) + "\n", "utf-8"
    )
    (out / f"{name}.md").write_text("\n".join(text), "utf-8")
    Console(width=220).print("\n".join(text), markup=False)
