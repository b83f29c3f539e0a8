"""Mutation analysis: the share of small seeded faults in product code that given tests detect.

`python -m benchmarks mutation planner/path --tests "tests/unit/test_path.py tests/oracles"` copies the project to a
temporary folder and runs the tests there for each mutant, up to the first failure. A mutant differs from the code in
one operator or constant (DeMillo, Lipton, Sayward 1978, "Hints on test data selection"). Equal seeds give equal
mutants, so two versions of tests can be compared. Some mutants are equivalent to the code, and no test detects those.
"""

import ast
import json
import os
import random
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer

ROOT = Path(__file__).parents[2]
_COPIED = ("benchmarks", "cell", "docs", "drivers", "models", "planner", "tests", "pyproject.toml", "README.md")
_LIBRARIES = ("matplotlib.figure", "mujoco", "numba", "scipy.optimize", "scipy.spatial", "trimesh")
_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
_SIGNS: dict[type[ast.AST], type[ast.AST]] = {ast.Not: ast.UAdd, ast.USub: ast.UAdd, ast.Invert: ast.UAdd}


@dataclass(frozen=True)
class Mutant:
    """One change of one file: path relative to the project, line, the code before and after, and the new text."""

    path: Path
    line: int
    before: str
    after: str
    text: str


def choose_mutants(paths: list[Path], count: int, seed: int, root: Path = ROOT) -> list[Mutant]:
    """Return seeded mutants of modules; annotations, messages and assertions are not changed."""
    trees = {path: ast.parse((root / path).read_text(encoding="utf-8")) for path in paths}
    pool = [(path, *change) for path, tree in trees.items() for change in _changes(tree)]
    mutants = []
    for path, node, field, index, changed in random.Random(seed).sample(pool, min(count, len(pool))):
        before, original = ast.unparse(node), getattr(node, field)
        setattr(node, field, changed if index is None else [*original[:index], changed, *original[index + 1 :]])
        line = getattr(node, "lineno", 0)
        mutants.append(Mutant(path, line, before, ast.unparse(node), ast.unparse(trees[path]) + "\n"))
        setattr(node, field, original)
    return mutants


def _changes(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, Any]]:
    """Yield node, field, index in a list, and new value of each change below a node."""
    if isinstance(node, ast.Assert | ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    if isinstance(node, ast.Compare):
        for index, operator in enumerate(node.ops):
            yield node, "ops", index, _OPERATORS[type(operator)]()
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in _OPERATORS:
        yield node, "op", None, _OPERATORS[type(node.op)]()
    elif isinstance(node, ast.UnaryOp) and type(node.op) in _SIGNS:
        yield node, "op", None, _SIGNS[type(node.op)]()
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        yield node, "value", None, not node.value if isinstance(node.value, bool) else node.value + 1
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns", "decorator_list"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _changes(child)


def run_tests(folder: Path, tests: list[str], limit_s: int) -> tuple[int, float]:
    """Run tests in a folder up to the first failure; return the exit code and the processor time [s].

    The tests run in a fork of this process, in which the large libraries are imported already.
    """
    for library in _LIBRARIES:
        import_module(library)
    child = os.fork()
    if not child:
        os.chdir(folder)
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 5))
        os.environ |= {"PYTHONPATH": str(folder), "CI": "1", "NUMBA_CACHE_DIR": str(folder / "numba")}
        for name in [name for name in sys.modules if name.partition(".")[0] in ("benchmarks", "cell", "planner")]:
            del sys.modules[name]
        sys.path[:] = [str(folder), *(path for path in sys.path if Path(path or ".").resolve() != ROOT)]
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        os._exit(int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests])))
    _, status, usage = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime


app = typer.Typer(add_completion=False)


@app.command()
def main(
    sources: Annotated[list[Path], typer.Argument(help="modules or folders that are mutated")],
    tests: Annotated[str, typer.Option(help="tests, separated by spaces; quick ones first")],
    count: Annotated[int, typer.Option(help="number of mutants")] = 30,
    seed: Annotated[int, typer.Option(help="seed of the choice of mutants")] = 1,
    limit: Annotated[int, typer.Option(help="processor time of a mutant [s]; more counts as killed")] = 300,
    survivors: Annotated[Path | None, typer.Option(help="only the mutants that survive in this file of --save")] = None,
    save: Annotated[Path | None, typer.Option(help="write a line of JSON per mutant")] = None,
) -> None:
    """Print each mutant and the share that the tests detect."""
    files = sorted(path for source in sources for path in (source.rglob("*.py") if source.is_dir() else [source]))
    mutants = choose_mutants([path.resolve().relative_to(ROOT) for path in files], count, seed)
    if survivors is not None:
        lines = map(json.loads, survivors.read_text(encoding="utf-8").splitlines())
        names = {(line["path"], line["line"], line["before"], line["after"]) for line in lines if not line["killed"]}
        mutants = [each for each in mutants if (str(each.path), each.line, each.before, each.after) in names]
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base)
        for name in _COPIED:
            (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, folder / name)
        code, cpu_s = run_tests(folder, tests.split(), 3600)
        if code:
            raise typer.BadParameter(f"the tests fail without a mutant (exit code {code})")
        typer.echo(f"{len(mutants)} mutants of {len(files)} files; the tests take {cpu_s:.0f} s of processor time")
        killed = 0
        for number, mutant in enumerate(mutants):
            file = folder / mutant.path
            original, status = file.read_text(encoding="utf-8"), file.stat()
            file.write_text(mutant.text, encoding="utf-8")
            os.utime(file, (10**9 + number, 10**9 + number))  # bytecode and kernels of each mutant are compiled anew
            code, cpu_s = run_tests(folder, tests.split(), limit)
            file.write_text(original, encoding="utf-8")
            os.utime(file, (status.st_atime, status.st_mtime))
            killed += code != 0
            fields = {"path": str(mutant.path), "line": mutant.line, "before": mutant.before, "after": mutant.after}
            typer.echo(f"{'killed  ' if code else 'SURVIVED'} {cpu_s:4.0f} s {' '.join(map(str, fields.values()))}")
            if save is not None:
                with save.open("a", encoding="utf-8") as lines_of_json:
                    lines_of_json.write(json.dumps(fields | {"killed": code != 0, "code": code}) + "\n")
    typer.echo(f"{killed} of {len(mutants)} mutants killed: {100 * killed / max(len(mutants), 1):.0f} %")


if __name__ == "__main__":
    app()
