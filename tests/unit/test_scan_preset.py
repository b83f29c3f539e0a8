"""`cell scan --preset`: whose choice the angle between rays is."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from cell.errors import UsageError
from cell.run.record import RunRecord
from cell.run.scene_json import ResolvedPlan, ScannerKeys
from cell.scan import preset as scan_preset
from cell.scan.preset import resolution_deg


def _run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: SimpleNamespace) -> RunRecord:
    monkeypatch.setattr(scan_preset.run_reader, "resolved_scene", lambda run: scene)
    return RunRecord(tmp_path, {})


def _scene(angle: float, kept: dict[str, str], kind: str = "laser-area") -> SimpleNamespace:
    return SimpleNamespace(
        scanner=ScannerKeys(type=kind, resolution_deg=[angle, angle]), plan=ResolvedPlan.model_validate(kept)
    )


@pytest.mark.parametrize(
    ("scene", "preset", "angle"),
    [
        (_scene(0.25, {"preset": "balanced"}), "fast", 0.5),
        (_scene(0.25, {"preset": "balanced"}), "balanced", None),
        (_scene(0.25, {}), "accurate", 0.125),  # a run of before there were presets
        (_scene(0.5, {"preset": "fast"}), "balanced", 0.25),
        (_scene(0.3, {"preset": "balanced"}), "fast", None),  # the scene's author gave it
        (_scene(0.25, {"preset": "fast"}), "accurate", None),
        (_scene(0.5, {"preset": "fast"}, "laser-line"), "accurate", None),
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
        resolution_deg(_run(tmp_path, monkeypatch, _scene(0.25, {"preset": "balanced"})), "quick")
