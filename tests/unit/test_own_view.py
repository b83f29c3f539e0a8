"""A housing in the field of view of its own scanner is reported; the default housing is outside it."""

import numpy as np
import pytest

from cell.errors import SceneError
from cell.scene.model import Scene
from cell.world.checks import housing_occlusion, require_feasible
from cell.world.model import compile_world

PART = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def share(**housing: object) -> float:
    """Return the occluded share of the built-in scene with these keys of its housing."""
    scene = Scene.model_validate({"housing": housing})
    return housing_occlusion(compile_world(scene, PART, baseline_mm=75.0))


def test_the_default_housing_hides_nothing() -> None:
    """The front face of the default housing is in the plane of source and sensor, so it occludes no ray."""
    assert share() == 0


def test_a_housing_in_the_field_of_view_hides_its_share() -> None:
    """A box whose near face, 60 x 60 mm, is 70 mm ahead hides the share of the tangent square that it fills."""
    hidden = share(position_mm=[0, 0, 100], size_mm=[60, 60, 60])
    half = np.tan(np.radians(30))
    from_source = (30 / 70 / half) ** 2
    assert from_source < hidden < 1  # the sensor loses further rays next to the box
    assert hidden == pytest.approx(from_source, abs=0.35)


def test_a_scene_with_such_a_housing_is_refused() -> None:
    """The message names the change that corrects the scene."""
    world = compile_world(Scene.model_validate({"housing": {"position_mm": [0, 0, 100]}}), PART, baseline_mm=75.0)
    with pytest.raises(SceneError, match=r"own field of view.*housing\.position_mm"):
        require_feasible(world)
