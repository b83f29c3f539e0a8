"""Stability maps: what they are made of, and that map and program speak of one border."""

import json
from typing import Any

import numpy as np
import pytest

from cell.errors import UsageError
from cell.part import workpiece
from cell.part.workpiece import FARTHEST_SIZES, Kind
from cell.plant.servo import COARSEST_STEP, Settings
from cell.reconstruction.cloud import ScanCloud, merge
from cell.reconstruction.reconstruct import NOISIEST, SPARSEST, reconstruct
from cell.scene import doubts
from cell.scene.scene import Scene
from cell.study.stability import MAPS, broken_promises, sentences, stability_study
from cell.study.stability_body import body
from cell.study.trial import Outcome, Trial
from planner.surface.decimate import decimate
from planner.surface.sample import sample

_NUMBERS = [
    (name, line, border, outward)
    for name, each in MAPS.items()
    for border, outward in zip(each.borders, (-1, 1), strict=True)
    if border is not None
    for line in each.lines
    if line not in each.compared
]


@pytest.mark.parametrize(("name", "line", "border", "outward"), _NUMBERS)
def test_the_program_begins_to_speak_at_the_border_that_the_map_shades(
    name: str, line: str, border: float, outward: int
) -> None:
    """A hair inside it says nothing and is good, a hair beyond it says a sentence."""
    each = MAPS[name]
    hair = max(1e-2 * abs(border), 1e-12)
    inside, beyond = (each.look(line, border + sign * outward * hair, each.sizes[1]) for sign in (-1, 1))
    assert inside.says == ""
    assert inside.success >= each.enough
    assert inside.error is None or inside.error <= each.tolerated
    assert len(beyond.says.split()) > 3


def test_inverse_kinematics_is_held_against_joint_angles_that_are_known() -> None:
    """The map would see a branch that is lost: poses from a longer arm are not found again."""
    from cell.study import stability_robot

    seen = MAPS["ik"].look("arm stretched", 1e-6, 50)
    assert (seen.success, seen.says) == (1.0, "")
    assert seen.more["own joint angles off rad"] < 1e-8
    T = np.tile(np.eye(4), (1, 1, 1))
    T[0, 0, 3] = 9.0
    assert stability_robot._numeric(T[0], 0) > 1.0


def _outcome(name: str, line: str, value: float, success: float, error: float | None, says: str) -> Outcome:
    size = MAPS[name].sizes[1]
    trial = Trial.of("stability", {"map": name, "line": line, "value": value, "size": size})
    return Outcome(trial, {"success": success, "error": error, "says": says, "more": {}}, "", {})


def _rows(said_at_200: str) -> list[dict[str, Any]]:
    study = stability_study(["plant"], quick=True)
    answers = {1.0: (1.0, 0.1, ""), 20.0: (0.0, None, said_at_200)}
    outcomes = []
    for trial in study.trials:
        settings = json.loads(trial.settings)
        outcomes.append(_outcome("plant", settings["line"], settings["value"], *answers[settings["value"]]))
    return study.rows(outcomes)


def test_a_promise_is_broken_where_a_method_fails_in_silence() -> None:
    """And only there; the sentence of the study says so."""
    assert broken_promises(_rows("too long a step")) == []
    assert "silent" not in sentences(_rows("too long a step"))[0]
    silent = _rows("")
    assert [row["value"] for row in broken_promises(silent)] == [20.0, 20.0]
    assert "silent although not good at 20" in sentences(silent)[0]


def test_each_map_is_drawn_and_shaded() -> None:
    """Two panels, the safe region in both."""
    ((stem, figure),) = stability_study(["plant"], quick=True).pictures(_rows("too long a step"))
    assert stem == "stability_plant"
    assert len(figure.axes) == 2
    assert all(len(axes.patches) == 1 for axes in figure.axes)


def test_an_unknown_map_is_named_with_those_that_there_are() -> None:
    """One sentence."""
    with pytest.raises(UsageError, match="there is no stability map teapot; there are ik, limits"):
        stability_study(["teapot"])


def test_a_time_step_that_is_too_long_is_told() -> None:
    """The default says nothing."""
    assert Settings().doubt == ""
    assert "2 ms is longer than 1 ms" in Settings(time_step=2 * COARSEST_STEP).doubt


def test_a_part_far_from_its_origin_is_told() -> None:
    """With both lengths, and not at the border itself."""
    box = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

    def kinds(away: float) -> set[Kind]:
        return {f.kind for f in workpiece.from_mesh("tip", box - 0.5 + [away, 0, 0], faces, "m", "").findings}

    assert Kind.FAR not in kinds(0.999 * FARTHEST_SIZES)
    assert Kind.FAR in kinds(1.001 * FARTHEST_SIZES)


def test_a_grazing_limit_that_no_scan_reaches_is_told() -> None:
    """At the limit itself nothing is said."""
    for limit, said in ((doubts.STEEPEST_GRAZING_DEG, 0), (doubts.STEEPEST_GRAZING_DEG + 1, 1)):
        assert len(doubts.of_scene(Scene.model_validate({"scanner": {"grazing_max_deg": limit}}))) == said


def test_a_coarse_planning_mesh_is_told_and_a_fine_one_is_not() -> None:
    """The finer, the nearer to the part."""
    part = body(4).reference
    off = {}
    for faces in (12, 150, 600):
        planning = decimate(part, faces)
        off[faces] = doubts.off_mesh(sample(part, planning, 2000, np.random.default_rng(0)), planning)
    assert off[12] > off[150] > off[600]
    assert doubts.planning_mesh(off[600], 600) == ""
    assert "of 12 faces is coarse" in doubts.planning_mesh(off[12], 12)
    assert doubts.planning_mesh(doubts.COARSEST_MESH, 99) == ""


def _plane(step: float, sigma: float) -> ScanCloud:
    x, y = np.meshgrid(np.arange(0.0, 0.1, step), np.arange(0.0, 0.1, step))
    z = np.random.default_rng(0).normal(0, 1, x.shape) * sigma
    return ScanCloud(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.array([0.05, 0.05, 1.0]))


def test_sparse_and_noisy_clouds_are_told() -> None:
    """A dense exact plane says nothing, each fault its own sentence."""
    assert reconstruct(merge([_plane(0.001, 0.0)])).doubts == ()
    (sparse,) = reconstruct(merge([_plane(1.2 * SPARSEST * 0.14, 0.0)])).doubts
    assert "apart" in sparse
    (noisy,) = reconstruct(merge([_plane(0.001, 0.001)])).doubts
    assert "scatter" in noisy
    assert NOISIEST < 1
