"""`cell plan --candidates grown` as a user meets it."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_grown_candidates_keep_the_run_folder_s_contract(
    part_file: Path, tmp_path: Path, cache: Path, run_cell: Run, small_plan: tuple[str, ...]
) -> None:
    """Cached or not: equal bytes; every array has all candidates; the plan's ids, rolls and poses are theirs."""
    arguments = ("plan", str(part_file), "--units", "mm", *small_plan, "--faces", "60", "--candidates", "grown")
    for name, more in (("a", ()), ("b", ("--no-cache",))):
        done = run_cell(*arguments, *more, "--out", name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    run = tmp_path / "a"
    first, second = (json.loads((tmp_path / name / "manifest.json").read_text()) for name in ("a", "b"))
    assert first["artefacts"] == second["artefacts"]

    with np.load(run / "viewpoints.npz") as views, np.load(run / "reach.npz") as reach:
        T, roll, verdict = views["T_object_scanner"][:, 0], views["roll"], reach["verdict"]
        assert len(T) == len(roll) == len(views["face"]) == len(views["standoff"]) == len(verdict)
    with np.load(run / "measurability.npz") as stored:
        assert stored["shape"][1] == len(T)
    for view in json.loads((run / "plan.json").read_text())["views"]:
        assert verdict[view["id"]] == 0
        np.testing.assert_allclose(view["roll_deg"], np.degrees(roll[view["id"]]), atol=1e-6)
        np.testing.assert_allclose(np.array(view["T_object_scanner"])[:3, 3], T[view["id"], :3, 3], atol=1e-4)


def test_the_former_generator_is_gone(tmp_path: Path, run_cell: Run) -> None:
    """Its name is answered with the one that took its place: one sentence, exit code 2."""
    done = run_cell("plan", "--candidates", "targeted", cwd=tmp_path)
    assert done.returncode == 2
    assert "choose 'grown'" in done.stderr
