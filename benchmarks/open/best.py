"""Best known solutions and bounds over candidates: `python -m benchmarks.open.best prove|collect [INSTANCE ...]`.

`prove` bounds the covers of each instance by the planner and, where that leaves a large gap, by HiGHS on the plain
integer programme; `prove INSTANCE SECONDS` gives the planner's branch and bound that effort at each target with a gap.
best/proofs.json holds the bounds. `collect` writes the best entry of all result files that check.py accepts to
results/best-known.json.
"""

import json
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array, eye_array, hstack

from benchmarks.open import check
from benchmarks.open.baselines import DATE, store
from benchmarks.open.tools import HERE, matrix_of, write_json
from planner.cover import EFFORT_PER_SECOND, CoverProblem, solve

EFFORT_S, MILP_S = 5.0, 60.0
EXACT = f"planner.cover, {EFFORT_S:g} s or more; HiGHS, {MILP_S:g} s, on large gaps; tier C: vertex sets and HiGHS."
PROOFS = HERE / "best" / "proofs.json"


def prove(name: str, exact_s: float = 0.0) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return bounds for each target of an instance, and the entries of the best covers found on the way.

    Args:
        name: the instance.
        exact_s: effort of branch and bound, in seconds, at each target with a gap.
    """
    instance = check.load(name)
    M, bounds, entries = matrix_of(instance), {}, []
    for target in instance.data["targets"]:
        since = process_time()
        problem = CoverProblem(M, np.ones(len(M)), coverage=target)
        found = solve(problem, rng=np.random.default_rng(0), effort_budget=int(EFFORT_S * EFFORT_PER_SECOND))
        columns, bound, method = found.views, found.lower_bound, "planner.cover"
        if exact_s and bound < len(columns):
            effort, rng = int(exact_s * EFFORT_PER_SECOND), np.random.default_rng(0)
            found = solve(problem, rng=rng, solver="exact", start=columns, effort_budget=effort)
            columns, bound = found.views, max(bound, found.lower_bound)
            method = f"planner.cover, branch and bound, effort of {exact_s:g} s"
        if bound < 0.8 * len(columns) and target == 0.99:
            other, other_bound = integer_programme(M, target * instance.data["coverable_rows"])
            columns = other if other is not None and len(other) < len(columns) else columns
            bound, method = max((bound, method), (other_bound, "HiGHS"))
        seconds = round(process_time() - since, 1)
        bounds[str(target)] = {"bound": bound, "method": method, "date": DATE, "cpu_s": seconds}
        entries.append(
            {"instance": name, "target": target, "track": "cover", "cpu_s": seconds, "columns": columns.tolist()}
        )
        sys.stdout.write(f"{name} {target}: {len(columns)}, bound {bound} by {method}, {seconds} s\n")
        sys.stdout.flush()
    return bounds, entries


def integer_programme(M: np.ndarray, required: float) -> tuple[np.ndarray | None, int]:
    """Solve the cover as an integer programme by HiGHS; return columns, if any, and the lower bound."""
    rows, columns = M.shape
    matrix = hstack([csr_array(M.astype(float)), -eye_array(rows)])
    enough = np.concatenate([np.zeros(columns), np.ones(rows)])
    cost = np.concatenate([np.ones(columns), np.zeros(rows)])
    found = milp(
        cost, integrality=cost, bounds=Bounds(0, 1),
        constraints=[LinearConstraint(matrix, lb=0), LinearConstraint(enough, lb=np.ceil(required - 1e-6))],
        options={"time_limit": MILP_S},
    )  # fmt: skip
    selected = None if found.x is None else np.flatnonzero(found.x[:columns] > 0.5)
    bound = 1 if found.mip_dual_bound is None else int(np.ceil(found.mip_dual_bound - 1e-4))
    return selected, bound


def collect() -> None:
    """Write the best valid entries of all result files to results/best-known.json."""
    best: dict[tuple[Any, ...], tuple[float, dict[str, Any]]] = {}
    for path in sorted((HERE / "results").glob("*.json")):
        entries = json.loads(path.read_text())["entries"]
        for entry, row in zip(entries, check.judge_file(path), strict=True):
            if "fault" in row:
                sys.stdout.write(f"{path.name}: {row}\n")
                continue
            key = tuple(entry.get(key) for key in ("instance", "target", "track"))
            value = -row["value"] if str(key[0]).startswith("D-") else row["value"]
            if key not in best or value < best[key][0] - 1e-12:
                best[key] = value, {**entry, "from": entry.get("from", path.stem)}
    store("best-known", "The best of all result files; `from` names the method.", [entry for _, entry in best.values()])


def main() -> None:
    """Run a step."""
    step, names, exact_s = sys.argv[1], sys.argv[2:], 0.0
    if step == "collect":
        collect()
        return
    if len(names) == 2 and names[1].isdigit():
        names, exact_s = names[:1], float(names[1])
    known: dict[str, Any] = json.loads(PROOFS.read_text()) if PROOFS.exists() else {}
    names = names or [p.stem for p in sorted(Path(HERE / "instances").glob("[AB]-*.json")) if p.stem not in known]
    for name in names:
        bounds, entries = prove(name, exact_s)
        earlier = known.get(name, {})
        known[name] = {t: max((e, earlier.get(t, e)), key=lambda entry: entry["bound"]) for t, e in bounds.items()}
        store("exact", EXACT, entries)
        write_json(PROOFS, dict(sorted(known.items())))


if __name__ == "__main__":
    main()
