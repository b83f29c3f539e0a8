"""`cell scan --preset`: whose choice the angle between rays is."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from cell.errors import UsageError
from cell.run.record import RunRecord
from cell.scan import preset as scan_preset
from cell.scan.preset import resolution_deg


def _run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: SimpleNamespace) -> RunRecord:
    monkeypatch.setattr(scan_preset, "read_scene", lambda run: scene)
    return RunRecord(tmp_path, {})


def _scene(angle: float, preset: str | None) -> SimpleNamespace:
    return SimpleNamespace(scanner={"type": "laser-area", "resolution_deg": [angle, angle]}, preset=preset)


@pytest.mark.parametrize(
    ("scene", "preset", "angle"),
    [
        (_scene(0.25, "balanced"), "fast", 0.5),
        (_scene(0.25, "balanced"), "balanced", None),
        (_scene(0.25, None), "accurate", 0.125),  # a run of before there were presets
        (_scene(0.5, "fast"), "balanced", 0.25),
        (_scene(0.3, "balanced"), "fast", None),  # the scene's author gave it
        (_scene(0.25, "fast"), "accurate", None),
        (SimpleNamespace(scanner={"type": "laser-line", "fan_deg": 28.0}, preset="fast"), "accurate", None),
    ],
)
def test_an_angle_that_a_preset_gave_is_a_preset_s_to_change(
    scene: SimpleNamespace, preset: str, angle: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no other."""
    assert resolution_deg(_run(tmp_path, monkeypatch, scene), preset) == angle


def test_an_unknown_preset_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the names of all."""
    with pytest.raises(UsageError, match="valid are: fast, balanced, accurate"):
        resolution_deg(_run(tmp_path, monkeypatch, _scene(0.25, "balanced")), "quick")
