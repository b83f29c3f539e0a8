"""Seeded mutants: repeatable, each of them valid code that differs from the module in one line."""

import ast
from pathlib import Path

from benchmarks.methods.mutation import ROOT, choose_mutants

MODULE = Path("planner/path/path.py")


def test_mutants_are_repeatable_and_differ_from_the_code_in_one_place() -> None:
    """Equal seeds give equal mutants. Each is valid and differs from the unparsed module in its own statement only."""
    code = ast.unparse(ast.parse((ROOT / MODULE).read_text(encoding="utf-8"))).splitlines()
    mutants = choose_mutants([MODULE], 40, 3)
    assert mutants == choose_mutants([MODULE], 40, 3)
    assert mutants != choose_mutants([MODULE], 40, 4)
    for mutant in mutants:
        compile(mutant.text, str(MODULE), "exec")
        lines = mutant.text.splitlines()
        assert mutant.before != mutant.after
        assert sum(a != b for a, b in zip(code, lines, strict=True)) == 1
