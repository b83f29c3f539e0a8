"""The scene of a further set-up: that of the run it goes on from with the part in another pose, or a file's own."""

from collections.abc import Mapping
from pathlib import Path

from cell.errors import UsageError
from cell.runs.cell import scene_of_run
from cell.runs.run import Run
from cell.scene.file import option_names, option_tables, scene_from_options
from cell.scene.model import Scene
from cell.scene.options import Spell

_SAMPLES = ("seed", "faces", "percent_kept", "samples_per_face", "fill")
"""Of `[plan]`, what says which samples there are: those of the run."""

_FREE = ("placement.position_mm", "placement.abc_deg", "plan.coverage", "plan.required_visible")
"""Keys that may differ from the run's where no scene file describes another cell."""


def scene_beside(
    run: Run, path: Path | None, wishes: Mapping[str, object], part: object = None, spell: Spell = str
) -> Scene:
    """The scene of a set-up that goes on from a run.

    Args:
        run: a finished plan.
        path: scene file with the cell of this set-up; None takes the run's cell.
        wishes: by the names of `cell.scene.options.option_specs(Scene)`.
        part: must be None: the part is the run's.
        spell: how the user writes the name of a wish.

    Raises:
        UsageError: if a wish is about what set-ups share, or no other pose is wished.
        SceneError: if the scene is not possible.
    """
    if part is not None:
        raise UsageError(f"{part} beside {spell('open_of')}: the part is that of {run.folder}; leave it out")
    asked = option_tables(wishes, spell=spell)
    names = option_names(asked, spell)
    given = [f"{table}.{key}" for table, keys in asked.items() for key in keys]
    if run.has("report.json") and run.report.settings.fill != "aimed":
        raise UsageError(
            f"{run.folder} was planned with {spell('fill')} rays, whose rows are faces of the planning mesh; plan it "
            f"with {spell('fill')} aimed to go on from it"
        )
    for key in given:
        shared = key.startswith("part.") or key.removeprefix("plan.") in _SAMPLES
        if shared or (path is None and key not in _FREE):
            why = "is that of the run" if shared else "is the run's; give a scene file for another cell"
            raise UsageError(f"{names.get(key, key)} beside {spell('open_of')} {why}: leave it out")
    then = scene_of_run(run)
    if then.region:
        raise UsageError(f"{run.folder} has regions, which further set-ups do not know yet; plan it without them")
    if path is not None:
        scene = scene_from_options(path, wishes, spell=spell)
        own = {key: getattr(then.plan, key) for key in _SAMPLES}
        return scene.model_copy(update={"plan": scene.plan.model_copy(update=own)})
    if "placement" not in asked:
        raise UsageError(
            f"{spell('open_of')} needs another pose of the part: give {spell('place')} x,y,z,A,B,C (cell why RUN "
            "--advise says what poses would add), or a scene file"
        )
    checked = scene_from_options(None, wishes, spell=spell)
    own = asked.get("plan", {})
    plan = {key: getattr(checked.plan, key) for key in own} | {"pinned": (), "banned": ()}
    if "coverage" in own:
        plan["max_views"] = None
    placement = {key: getattr(checked.placement, key) for key in asked["placement"]}
    return then.model_copy(
        update={
            "placement": then.placement.model_copy(update=placement),
            "plan": then.plan.model_copy(update=plan),
        }
    )
