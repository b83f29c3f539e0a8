"""The limits of sigma and spacing that a scene asks for: Scott's specification of the fine stage.

A rough stage is planned without them, as its points are there to plan on. The model is judged at the end: what of it
the executed views measure at all, and what of that none of them measures within the limits.
"""

import numpy as np

from cell.part import workpiece
from cell.plan.candidates import limited_scanner
from cell.scene.model import Scene
from cell.scene.settle import settle
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import find_measured
from planner.ports import Scanner
from planner.values import Floats

_SAMPLES = 10_000


def asked(scene: Scene) -> bool:
    """Whether the scene limits sigma or spacing."""
    return scene.plan.max_sigma_mm is not None or scene.scanner.max_spacing_mm is not None


def without(scene: Scene) -> Scene:
    """The scene without these limits."""
    plan = scene.plan.model_copy(update={"max_sigma_mm": None})
    return scene.model_copy(update={"plan": plan, "scanner": scene.scanner.model_copy(update={"max_spacing_mm": None})})


def missed(scene: Scene, model: TriangleMesh, poses: Floats) -> float:
    """Share of what views measure of a model that none of them measures within the scene's limits.

    Args:
        scene: its scanner settled.
        model: explored frame [m].
        poses: (V, 4, 4) T_explored_scanner of the executed views [m].
    """
    samples = draw_samples(model, model, _SAMPLES, np.random.default_rng(scene.plan.seed))
    casters = (EmbreeRayCaster(model.vertices, model.faces),)
    at_all, within = (
        find_measured(poses[:, None], samples, _law(each, model), casters) for each in (without(scene), scene)
    )
    total = float(samples.areas[at_all].sum())
    return float(samples.areas[at_all & ~within].sum()) / total if total else 0.0


def _law(scene: Scene, model: TriangleMesh) -> Scanner:
    """The scanner's law with the limits of a scene."""
    part = workpiece.from_arrays("model", model.vertices, model.faces, "m")
    return limited_scanner(scene, settle(scene, part).scanner)
