"""Coverage over the requested coverage: for the same candidates, more is never less."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.plan import pipeline
from cell.plan.selection import SelectionProblem, select_with_row_generation
from cell.scene.file import scene_from_options
from cell.session import Session, Stream
from cell.world.measurability import PartSurface

TARGETS = (0.6, 0.75, 0.85, 0.9, 0.93, 0.96, 0.98, 0.99, 0.995, 1.0)

_NOISE = 0.001
"""Smallest difference of two shares: the rows of the matrix depend on the target, and the samples are 10,000."""


def _box() -> trimesh.Trimesh:
    return trimesh.creation.box((100.0, 80.0, 60.0))


def _bracket() -> trimesh.Trimesh:
    """Return an L whose legs hide parts of each other."""
    legs = [[[0, 0, 0], [100, 12, 50]], [[0, 12, 0], [12, 100, 50]]]
    return trimesh.util.concatenate([trimesh.creation.box(bounds=leg) for leg in legs])


@pytest.mark.parametrize("part", [_box, _bracket])
def test_more_requested_coverage_never_gives_less(
    part: Callable[[], trimesh.Trimesh], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A coarse matrix, of one sample a face, is the hardest. A coverage of 1 gives the most of all."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    part().export(tmp_path / "part.stl")
    options = {
        "units": "mm", "place": (1100, 400, 100), "candidates": "optimal-scanning-zone", "sensor": "paper",
        "standoff": (220, 280), "faces": 40, "samples": 1, "seed": 5,
    }  # fmt: skip
    scene = scene_from_options(None, options, str(tmp_path / "part.stl"))
    with pipeline.open_run(Session(None, out=tmp_path / "run"), scene, with_plots=False) as run:
        session, settled = run.session, run.settled
        surface, viewpoints = pipeline.sample_part(session, settled)
        cell = pipeline.compile_cell(session, settled, surface)
        candidates = pipeline.find_candidates(session, settled, surface, cell, viewpoints)
        measured = pipeline.measure_candidates(session, settled, surface, cell, candidates)
        problem = pipeline.make_problem(session, settled, cell, measured)
        found = [_selected(session, problem, surface, target) for target in TARGETS]
        run.stopped = "selections only"
    shares, views = (np.array(each) for each in zip(*found, strict=True))
    assert (np.diff(views) >= 0).all(), views
    assert (np.diff(shares) >= -_NOISE).all(), shares
    assert shares[-1] >= shares.max()
    assert shares[-1] >= 0.9995
    assert (shares[:-1] >= TARGETS[:-1]).all()


def _selected(
    session: pipeline.PlanSession, problem: SelectionProblem, surface: PartSurface, target: float
) -> tuple[float, int]:
    """Return the share of the coverable held-out samples that the selected views measure, and their number."""
    plan = problem.request.plan.model_copy(update={"coverage": target})
    request = replace(problem, request=replace(problem.request, plan=plan))
    rng, fresh = session.rng(Stream.SELECTION), session.rng(Stream.FRESH_SAMPLES)
    views = select_with_row_generation(request, surface, rng, fresh)[1].cover.views
    return problem.prediction.share_of_coverable(problem.candidates.T_object_scanner[views]), len(views)
