"""`cell scan --preset`: whose choice the angle between rays is."""

import json
from pathlib import Path
from typing import Any

import pytest

from cell.errors import FileError, UsageError
from cell.run.record import RunRecord
from cell.scan import preset as scan_preset
from cell.scan.preset import resolution_deg


def _run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, resolved: dict[str, Any]) -> RunRecord:
    monkeypatch.setattr(scan_preset.run_reader, "resolved_scene", lambda run: json.loads(json.dumps(resolved)))
    return RunRecord(tmp_path, {})


def _resolved(angle: float, preset: str | None, kind: str = "laser-area") -> dict[str, Any]:
    return {
        "scanner": {"type": kind, "resolution_deg": [angle, angle]},
        "plan": {} if preset is None else {"preset": preset},
    }


@pytest.mark.parametrize(
    ("resolved", "preset", "angle"),
    [
        (_resolved(0.25, "balanced"), "fast", 0.5),
        (_resolved(0.25, "balanced"), "balanced", None),
        (_resolved(0.25, None), "accurate", 0.125),  # a run of before there were presets
        (_resolved(0.5, "fast"), "balanced", 0.25),
        (_resolved(0.3, "balanced"), "fast", None),  # the scene's author gave it
        (_resolved(0.25, "fast"), "accurate", None),
        ({"scanner": {"type": "laser-line", "fan_deg": 28.0}, "plan": {"preset": "fast"}}, "accurate", None),
    ],
)
def test_an_angle_that_a_preset_gave_is_a_preset_s_to_change(
    resolved: dict[str, Any], preset: str, angle: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no other."""
    assert resolution_deg(_run(tmp_path, monkeypatch, resolved), preset) == angle


def test_an_unknown_preset_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the names of all."""
    with pytest.raises(UsageError, match="valid are: fast, balanced, accurate"):
        resolution_deg(_run(tmp_path, monkeypatch, _resolved(0.25, "balanced")), "quick")


def test_a_damaged_scene_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names the file."""
    with pytest.raises(FileError, match=r"scene\.resolved\.json"):
        resolution_deg(_run(tmp_path, monkeypatch, {"plan": {}}), "fast")
