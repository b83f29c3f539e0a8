"""`cell scan --preset`: the angle between rays of a scan, where it is a preset's to choose.

It is, where the plan has the angle of its own preset; one that the scene's author gave, or a real sensor's, stays.
"""

from collections.abc import Sequence
from typing import Any

from cell.errors import UsageError
from cell.run import reader as run_reader
from cell.run.record import RunRecord, understood
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
    resolved = run_reader.resolved_scene(run)
    with understood(run.folder / "scene.resolved.json"):
        scanner = resolved["scanner"]
        planned, own = str(resolved["plan"].get("preset", DEFAULT)), scanner["type"] == RAY_GRID
        own = own and list(scanner["resolution_deg"]) == _angles(planned)
    angle = float(_angles(preset)[0])
    return angle if own and angle != _angles(planned)[0] else None


def _angles(preset: str) -> list[float]:
    usual: Any = Scanner.model_fields["resolution_deg"].default
    found: Sequence[float] = PRESETS[preset].scanner.get("resolution_deg", usual)
    return [float(angle) for angle in found]
