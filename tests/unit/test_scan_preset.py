"""`cell scan --preset`: whose choice the angle between rays is."""

import pytest

from cell.errors import UsageError
from cell.run.scene_json import ResolvedPlan, ResolvedScene, ScannerKeys
from cell.scan.preset import resolution_deg


def _planned(preset: str, **scanner: object) -> ResolvedScene:
    keys = {"type": "laser-area", **scanner}
    return ResolvedScene.model_construct(plan=ResolvedPlan(preset=preset), scanner=ScannerKeys(**keys))


def _rays(angle: float, preset: str = "balanced") -> ResolvedScene:
    return _planned(preset, resolution_deg=[angle, angle])


@pytest.mark.parametrize(
    ("planned", "preset", "angle"),
    [
        (_rays(0.25), "fast", 0.5),
        (_rays(0.25), "balanced", None),
        (_rays(0.25), "accurate", 0.125),
        (_rays(0.5, "fast"), "balanced", 0.25),
        (_rays(0.3), "fast", None),  # the scene's author gave it
        (_rays(0.25, "fast"), "accurate", None),
        (_planned("fast", type="laser-line", fan_deg=28.0), "accurate", None),
    ],
)
def test_an_angle_that_a_preset_gave_is_a_preset_s_to_change(
    planned: ResolvedScene, preset: str, angle: float | None
) -> None:
    """And no other."""
    assert resolution_deg(planned, preset) == angle


def test_an_unknown_preset_is_refused() -> None:
    """With the names of all."""
    with pytest.raises(UsageError, match="valid are: fast, balanced, accurate"):
        resolution_deg(_rays(0.25), "quick")
