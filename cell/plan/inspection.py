"""Characteristics in a plan: coverage of each feature, features in the run folder, uncertainty, and views for it.

Planning imports this module only for scenes with characteristics: it needs SciPy's optimizers and the page's code.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cell.inspect.artefacts import FEATURES, PREDICTED, QIF_SOURCE
from cell.inspect.features import InspectionPlan
from cell.inspect.inspection import plan_inspection, predict_plan, qif_source, with_feature_regions
from cell.inspect.prediction import PlannedViews
from cell.inspect.results import markdown
from cell.part.workpiece import Workpiece
from cell.plan.candidates import PlanSession
from cell.plan.motion import ConnectedPlan
from cell.plan.selection import Selection, SelectionProblem
from cell.plan.uncertainty import add_views_for_uncertainty
from cell.runs import ply
from cell.runs.folder import RunFolder
from cell.runs.schema import parsed
from cell.scene.model import Scene
from cell.scene.settle import SettledScene
from cell.world.measurability import PartSurface
from planner.geometry.mesh import TriangleMesh

__all__ = [
    "PlannedViews",
    "add_certain_views",
    "setups_section",
    "uncertainty_section",
    "with_feature_regions",
    "write_features",
]


def write_features(folder: RunFolder, scene: Scene, part: Workpiece) -> tuple[str, ...]:
    """Write the features and characteristics of a scene; return doubts about them.

    Raises:
        CellError: if they do not fit the part.
    """
    plan = plan_inspection(scene, part)
    if plan is None:
        return ()
    folder.write_json(FEATURES, plan.as_json())
    if (source := qif_source(scene)) is not None:
        folder.write_bytes(QIF_SOURCE, [source])
    return (*plan.notes, *(f"not supported: {sentence}" for sentence in plan.unsupported))


def add_certain_views(
    session: PlanSession, problem: SelectionProblem, selection: Selection, surface: PartSurface,
    rng: np.random.Generator, fresh: np.random.Generator,
) -> tuple[SelectionProblem, Selection]:  # fmt: skip
    """Add views for the uncertainty of the characteristics, and note those that miss their requirement."""
    plan = _plan_of(session.folder)
    if plan.u_over_t is None or not callable(getattr(problem.prediction.scanner, "sigma", None)):
        return problem, selection
    if not problem.request.allows_swaps:
        session.note("no views are added for the uncertainty of characteristics: another request concerns the views")
        return problem, selection
    problem, selection, notes = add_views_for_uncertainty(problem, selection, surface, plan, rng, fresh)
    for sentence in notes:
        session.note(sentence)
    return problem, selection


def uncertainty_section(
    session: PlanSession, scene: Scene, problem: SelectionProblem, plan: ConnectedPlan, *, is_noted: bool
) -> list[str]:
    """Predict and write the uncertainty of the characteristics, note unmet demands, and return the report's section."""
    known, folder = problem.prediction, session.folder
    reference = ply.mesh((folder.path / "reference.ply").read_bytes())
    views = [PlannedViews(plan.driven.T_object_poses, known.scanner, known.casters)]
    return _section(session, scene, _plan_of(folder), reference, views, is_noted=is_noted)


def setups_section(
    session: PlanSession, settled: SettledScene, reference: TriangleMesh, setups: Sequence[PlannedViews]
) -> list[str]:
    """Predict and write the uncertainty of the characteristics by all set-ups, as `uncertainty_section` does."""
    plan = plan_inspection(settled.scene, settled.part)
    return [] if plan is None else _section(session, settled.scene, plan, reference, setups, is_noted=True)


def _section(
    session: PlanSession, scene: Scene, plan: InspectionPlan, reference: TriangleMesh, setups: Sequence[PlannedViews],
    *, is_noted: bool,
) -> list[str]:  # fmt: skip
    if not all(callable(getattr(each.scanner, "sigma", None)) for each in setups):
        session.note("the uncertainty of characteristics is not predicted: the scanner has no model of its noise")
        return []
    pose_sd = (scene.plan.pose_sd_mm, scene.plan.pose_sd_deg)
    prediction = predict_plan(plan, reference, setups, pose_sd, Path(scene.part.source).stem)
    session.folder.write_json(PREDICTED, prediction.as_json())
    for each in prediction.characteristics if is_noted else ():
        if each.cause:
            session.note(f"{each.name}: {each.cause}")
    return markdown(prediction)


def _plan_of(folder: RunFolder) -> InspectionPlan:
    path = folder.path / FEATURES
    return parsed(InspectionPlan, path.read_bytes(), path)
