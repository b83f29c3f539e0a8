"""`cell scan --preset`: the angle between rays of a scan, where it is a preset's to choose.

It is, where the plan has the angle of its own preset; one that the scene's author gave, or a real sensor's, stays.
"""

from typing import Any

from cell.errors import UsageError
from cell.run import reader as run_reader
from cell.run.record import RunRecord
from cell.scene.presets import PRESETS, RAY_GRID
from cell.scene.scene import Scanner


def resolution_deg(run: RunRecord, preset: str) -> float | None:
    """The angle that a preset scans a run with; None where it keeps the plan's.

    Args:
        run: of a finished plan.
        preset: a name of `PRESETS`.

    Raises:
        UsageError: if there is no such preset.
        FileError: if the run's scene is missing or damaged.
    """
    if preset not in PRESETS:
        raise UsageError(f"--preset is '{preset}'; valid are: {', '.join(PRESETS)}")
    scene = run_reader.resolved_scene(run)
    planned = scene.plan.preset
    own = scene.scanner.type == RAY_GRID and scene.scanner.pair("resolution_deg") == _angles(planned)
    angle = _angles(preset)[0]
    return angle if own and angle != _angles(planned)[0] else None


def _angles(preset: str) -> tuple[float, float]:
    usual: Any = Scanner.model_fields["resolution_deg"].default
    across, along = PRESETS[preset].scanner.get("resolution_deg", usual)
    return float(across), float(along)
