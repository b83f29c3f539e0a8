"""`python -m benchmarks cover solve`: formats, table, JSON, limits, exit codes."""

import gzip
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

# Six rows in a ring, each covered by two neighbouring columns; columns 1, 3, 5 cover all, and so do 2, 4, 6.
RING = [(1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 1)]
ROWS = "6 6\n5 1 5 1 5 1\n" + "\n".join(f"2\n{a} {b}" for a, b in RING)
RAIL = "6 6\n" + "\n".join(f"{cost} 2 {j} {(j - 2) % 6 + 1}" for j, cost in enumerate((5, 1, 5, 1, 5, 1), start=1))
FANO = "7 7\n1 2 3\n1 4 5\n1 6 7\n2 4 6\n2 5 7\n3 4 7\n3 5 6\n"


def solved(run_benchmarks: Run, path: Path, *options: str) -> dict[str, object]:
    """Return the JSON of a successful run."""
    process = run_benchmarks("cover", "solve", path.name, "--json", *options, cwd=path.parent)
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    answer: dict[str, object] = json.loads(process.stdout)
    return answer


@pytest.mark.parametrize(("name", "content"), [("rows", ROWS), ("rail", RAIL)])
@pytest.mark.parametrize("packed", [False, True])
def test_both_library_formats_are_recognised_and_solved(
    run_benchmarks: Run, tmp_path: Path, name: str, content: str, packed: bool
) -> None:
    """A plain or gzip file of either format is solved to the proven cheapest cover.

    Columns are numbered as in the file.
    """
    path = tmp_path / "problem"
    path.write_bytes(gzip.compress(content.encode()) if packed else content.encode())
    answer = solved(run_benchmarks, path)
    assert answer["format"] == name
    assert (answer["views"], answer["cost"], answer["lower_bound"]) == ([2, 4, 6], 3.0, 3.0)
    assert answer["status"] == "proven"


def test_steiner_triples_are_covered(run_benchmarks: Run, tmp_path: Path) -> None:
    """The seven lines of the Fano plane are covered by three points, and this is proven."""
    path = tmp_path / "data.7"
    path.write_text(FANO)
    answer = solved(run_benchmarks, path)
    assert answer["format"] == "steiner"
    assert (answer["n_views"], answer["lower_bound"], answer["status"]) == (3, 3, "proven")
    points = set(answer["views"])
    assert all(points & set(map(int, line.split())) for line in FANO.splitlines()[1:])


def test_unicost_ignores_the_costs_and_a_multiplicity_demands_more(run_benchmarks: Run, tmp_path: Path) -> None:
    """With unit costs the ring costs 3.

    With a multiplicity of two all six columns are selected.
    """
    path = tmp_path / "ring"
    path.write_text(ROWS)
    assert solved(run_benchmarks, path, "--unicost")["cost"] == 3
    assert solved(run_benchmarks, path, "--multiplicity", "2")["n_views"] == 6


def test_the_table_says_cover_bound_and_status(run_benchmarks: Run, tmp_path: Path) -> None:
    """The table states the problem, the status and the lower bound."""
    (tmp_path / "ring.txt").write_text(ROWS)
    process = run_benchmarks("cover", "solve", "ring.txt", "--unicost", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    for part in (
        "ring.txt: optimal for the 6 columns (bound 3)",
        "6 rows, 6 columns, 12 ones (rows)",
        "lower bound",
        "0.0 %",
    ):
        assert part in re.sub(r" +\n", "\n", process.stdout)


@pytest.mark.parametrize(
    ("content", "options", "code", "sentence"),
    [
        (None, (), 6, "cannot be read"),
        ("6 6\n1 1", (), 6, "not a set-cover file"),
        ("2 2\n1 x", (), 6, "must hold whole numbers only"),
        ("", (), 6, "ends before the two sizes"),
        ("100000000 100000000 1", (), 6, "as rail: 100000000 columns are 200000000 numbers at least, but 1 follow"),
        ("1 1\n0\n1 1", ("--format", "rows"), 6, "must be above zero"),
        ("1 1\n1\n1 2", ("--format", "rows"), 6, "from 1 to 1"),
        (ROWS, ("--format", "steiner"), 6, "as steiner"),
        (ROWS, ("--format", "mps"), 2, "choose one of rows, rail, steiner"),
        (ROWS, ("--solver", "magic"), 2, "choose one of"),
        (ROWS, ("--coverage", "1.5"), 2, "from 0 to 1"),
        (ROWS, ("--budget", "-1"), 2, "--budget"),
        (ROWS, ("--multiplicity", "0"), 2, "at least once"),
        (ROWS, ("--seed", "-1"), 2, "--seed"),
        ("1 1\n1\n1\n1", (), 2, "choose the format with --format"),
    ],
)
def test_wrong_uses_end_with_one_sentence(
    run_benchmarks: Run, tmp_path: Path, content: str | None, options: tuple[str, ...], code: int, sentence: str
) -> None:
    """The exit code is that of the error, and the message names the fault and the valid values."""
    if content is not None:
        (tmp_path / "file").write_text(content)
    process = run_benchmarks("cover", "solve", "file", *options, cwd=tmp_path)
    assert process.returncode == code, (process.stdout, process.stderr)
    assert process.stderr.startswith("cell: ")
    assert process.stderr.count("\n") == 1
    assert sentence in process.stderr


def hard(path: Path) -> None:
    """Write a random problem that no solver proves within a test."""
    rng = np.random.default_rng(0)
    M = rng.random((200, 900)) < 0.02
    M[:, 0] |= ~M.any(axis=1)
    lines = [f"{row.sum()} " + " ".join(str(j + 1) for j in np.flatnonzero(row)) for row in M]
    path.write_text("200 900\n" + "1 " * 900 + "\n" + "\n".join(lines))


def test_the_same_budget_gives_the_same_answer(run_benchmarks: Run, tmp_path: Path) -> None:
    """Two runs with the same budget of counted work agree in everything but their seconds."""
    hard(tmp_path / "hard")
    first, second = (solved(run_benchmarks, tmp_path / "hard", "--budget", "0.5", "--seed", "4") for _ in range(2))
    assert first.pop("seconds") is not None
    assert second.pop("seconds") is not None
    assert first == second
    assert first["status"] == "bounded"


_INTO_THE_SEARCH = 3.0  # seconds of processor time: imports and reading take two


def _processor_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_ctrl_c_gives_the_best_cover_so_far(tmp_path: Path, run_benchmarks: Run, environment: dict[str, str]) -> None:
    """An interrupted search prints its cover, and the status is interrupted."""
    hard(tmp_path / "hard")
    # One run before compiles the loops, so that the interrupt hits the search.
    solved(run_benchmarks, tmp_path / "hard", "--budget", "0.1")
    command = [sys.executable, "-m", "benchmarks", "cover", "solve", "hard", "--json", "--budget", "300"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 200
        while _processor_seconds(process.pid) < _INTO_THE_SEARCH:
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    answer = json.loads(out)
    assert answer["status"] == "interrupted"
    assert "interrupted" in answer["sentence"]
    rows = [set(map(int, line.split()[1:])) for line in (tmp_path / "hard").read_text().splitlines()[2:]]
    assert all(row & set(answer["views"]) for row in rows)


def test_the_ring_is_what_it_claims() -> None:
    """No two columns of the ring cover it."""
    assert not any(all(set(row) & set(pair) for row in RING) for pair in combinations(range(1, 7), 2))
