"""Settled planning parameters: defaults of the part, as in the documentation."""

import numpy as np
import pytest
import trimesh

from cell.errors import SceneError
from cell.part.workpiece import Workpiece, from_mesh
from cell.scene.model import Scene
from cell.scene.settle import settle

TABLE = {
    "mseke": (930, 300.0, 75.0),
    "mug": (748, 100.0, 25.0),
    "robinet": (814, 100.0, 25.0),
    "petanque": (338, 300.0, 75.0),
    "humerus": (276, 30.0, 7.5),
    "st-jean": (746, 300.0, 75.0),
}


def ball(radius_mm: float, name: str = "ball") -> Workpiece:
    """Return a sphere as a part."""
    body = trimesh.creation.icosphere(3, radius_mm)
    return from_mesh(name, body.vertices, body.faces, "mm", "0")


def own(**tables: dict) -> Scene:
    """Return a scene with a part from a file that is not read."""
    scene = Scene.model_validate(tables)
    return scene.model_copy(update={"part": scene.part.model_copy(update={"path": "ball.stl", "units": "mm"})})


@pytest.mark.parametrize("name", TABLE)
def test_built_in_parts_have_the_documented_defaults(name: str) -> None:
    """Each built-in part has the documented number of faces, standoff, baseline and range."""
    faces, standoff, baseline = TABLE[name]
    settings = settle(Scene.model_validate({"part": {"name": name}}), ball(30, name)).settings
    assert settings.faces == faces
    assert settings.standoffs == (standoff / 1000,)
    assert settings.scanner["baseline_mm"] == baseline
    assert settings.scanner["range_mm"] == (0.5 * standoff, 1.5 * standoff)


def test_a_standoff_is_the_middle_of_the_range() -> None:
    """The default standoff is the middle of the range of the device or of the scene."""
    assert settle(own(), ball(400)).settings.standoffs == (0.3,)
    assert settle(own(scanner={"range_mm": [100, 450]}), ball(400)).settings.standoffs == (0.275,)


def test_equal_rolls_and_standoffs_count_once() -> None:
    """Rolls of 0 and 360 degrees and repeated standoffs give one viewpoint."""
    settings = settle(own(plan={"rolls_deg": [0, 90, 360, 0], "standoffs_mm": [300, 300, 250]}), ball(60)).settings
    np.testing.assert_allclose(settings.rolls, np.radians([0, 90]))
    assert settings.standoffs == (0.3, 0.25)


@pytest.mark.parametrize("clearance", [0, 0.5])
def test_a_clearance_too_small_to_plan_with_is_refused(clearance: float) -> None:
    """A clearance below 1 mm is refused, because checks are one clearance apart and a motion would need millions."""
    with pytest.raises(SceneError, match="at least 1"):
        settle(own(clearance_mm=clearance), ball(50))


def test_the_percentage_is_of_the_faces_that_are_kept() -> None:
    """10 percent of 1280 faces are 128."""
    assert settle(own(plan={"percent_kept": 10.0}), ball(50)).settings.faces == 128


@pytest.mark.parametrize(("clearance", "arrival"), [(10.0, 1.0), (5.0, 0.5), (20.0, 1.5)])
def test_an_arrival_is_at_most_a_tenth_of_the_clearance(clearance: float, arrival: float) -> None:
    """A larger one is refused, with the largest valid value."""
    settle(own(clearance_mm=clearance, arrival_mm=arrival), ball(50))
    with pytest.raises(SceneError, match=rf"at most a tenth of clearance_mm, {clearance / 10:g}"):
        settle(own(clearance_mm=clearance, arrival_mm=1.001 * clearance / 10), ball(50))
