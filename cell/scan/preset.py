"""`cell scan --preset`: the angle between rays of a scan, where it is a preset's to choose.

It is, where the plan has the angle of its own preset; one that the scene's author gave, or a real sensor's, stays.
"""

from collections.abc import Sequence
from typing import Any

from cell.errors import UsageError
from cell.run.cell import read_scene
from cell.run.record import RunRecord
from cell.scene.presets import DEFAULT, PRESETS, RAY_GRID
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
    scene = read_scene(run)
    planned = scene.preset or DEFAULT
    own = scene.scanner["type"] == RAY_GRID and list(scene.scanner["resolution_deg"]) == _angles(planned)
    angle = float(_angles(preset)[0])
    return angle if own and angle != _angles(planned)[0] else None


def _angles(preset: str) -> list[float]:
    usual: Any = Scanner.model_fields["resolution_deg"].default
    found: Sequence[float] = PRESETS[preset].scanner.get("resolution_deg", usual)
    return [float(angle) for angle in found]
