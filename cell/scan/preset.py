"""`cell scan --preset`: the angle between rays of a scan, where it is a preset's to choose.

It is, where the plan has the angle of its own preset; one that the scene's author gave, or a real sensor's, stays.
"""

from typing import Any

from cell.errors import UsageError
from cell.run.scene_json import ResolvedScene
from cell.scene.presets import PRESETS, RAY_GRID
from cell.scene.scene import Scanner


def resolution_deg(planned: ResolvedScene, preset: str) -> float | None:
    """The angle that a preset scans a run with; None where it keeps the plan's.

    Args:
        planned: what the plan used.
        preset: a name of `PRESETS`.

    Raises:
        UsageError: if there is no such preset.
    """
    if preset not in PRESETS:
        raise UsageError(f"--preset is '{preset}'; valid are: {', '.join(PRESETS)}")
    now, angle = _angle(planned.plan.preset), _angle(preset)
    own = planned.scanner.type == RAY_GRID and planned.scanner.pair("resolution_deg") == (now, now)
    return angle if own and angle != now else None


def _angle(preset: str) -> float:
    usual: Any = Scanner.model_fields["resolution_deg"].default
    return float(PRESETS[preset].scanner.get("resolution_deg", usual)[0])
