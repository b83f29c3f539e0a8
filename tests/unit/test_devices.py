"""Selection of the device of a scene: by name, by the built-in part, or by the size of the user's part."""

from typing import Any

import pytest
import trimesh

from cell.errors import SceneError
from cell.part.workpiece import Workpiece, from_mesh
from cell.scene.model import Scene
from cell.scene.settle import notes, settle, settle_scene, with_device

SMALL, MEDIUM, LARGE = (f"generic-area-{size}" for size in ("small", "medium", "large"))
HARDWARE = {
    SMALL: ((15.0, 45.0), 7.5, (16.0, 8.0, 6.0)),
    MEDIUM: ((50.0, 150.0), 25.0, (53.3, 26.7, 20.0)),
    LARGE: ((150.0, 450.0), 75.0, (160.0, 80.0, 60.0)),
}


def _box(longest_mm: float, name: str = "box") -> Workpiece:
    body = trimesh.creation.box((longest_mm, longest_mm / 2, longest_mm / 3))
    return from_mesh(name, body.vertices, body.faces, "mm", "0")


def _scene(*, mine: bool = True, **tables: dict[str, Any]) -> Scene:
    """Return a scene with a user's file, which does not exist, or with the built-in part of the tables."""
    scene = Scene.model_validate(tables)
    return scene.model_copy(update={"part": scene.part.model_copy(update={"path": "box.stl"})}) if mine else scene


def _hardware(scene: Scene) -> tuple[object, ...]:
    return scene.scanner.range_mm, scene.scanner.baseline_mm, scene.housing.size_mm


@pytest.mark.parametrize(
    ("longest_mm", "device"),
    [(5.0, SMALL), (30.0, SMALL), (30.1, MEDIUM), (100.0, MEDIUM), (100.1, LARGE), (5000.0, LARGE)],
)
def test_a_users_part_has_the_device_of_its_longest_side(longest_mm: float, device: str) -> None:
    """The limits are 30 and 100 mm, inclusive. The note contains device, side and rule."""
    part = _box(longest_mm)
    scene = settle_scene(_scene(), part)
    assert scene.scanner.sensor == device
    assert _hardware(scene) == HARDWARE[device]
    (note,) = notes(_scene(), part)
    assert note.startswith(f"the scanner is {device}, by the part's longest side of {longest_mm:.4g} mm: to 30 mm")


@pytest.mark.parametrize(
    ("name", "device"),
    [*((name, LARGE) for name in ("mseke", "petanque", "st-jean")), ("mug", MEDIUM), ("robinet", MEDIUM),
     ("humerus", SMALL)],
)  # fmt: skip
def test_a_built_in_part_has_its_own_device(name: str, device: str) -> None:
    """A built-in part has its own device, independent of its size and without a note."""
    scene = settle_scene(_scene(mine=False, part={"name": name}), _box(1.0, name))
    assert scene.scanner.sensor == device
    assert not notes(_scene(mine=False, part={"name": name}), _box(1.0, name))


def test_a_mesh_in_memory_is_a_users_part() -> None:
    """A part with another name than the built-in part of the scene is treated as a user's part."""
    assert settle_scene(_scene(mine=False), _box(20.0)).scanner.sensor == SMALL
    assert notes(_scene(mine=False), _box(20.0))


def test_a_named_device_is_used_and_keys_of_the_scene_take_precedence() -> None:
    """A named device is used without a note, and each key of the scene replaces its value."""
    scene_with_names = _scene(scanner={"sensor": MEDIUM, "baseline_mm": 30.0}, housing={"bracket_diameter_mm": 0.0})
    scene = settle_scene(scene_with_names, _box(500.0))
    assert _hardware(scene) == (HARDWARE[MEDIUM][0], 30.0, HARDWARE[MEDIUM][2])
    assert scene.housing.bracket_diameter_mm == 0.0
    assert not notes(scene_with_names, _box(500.0))


@pytest.mark.parametrize("scanner", [{}, {"sensor": "paper"}, {"sensor": "gocator-2340", "baseline_mm": 100.0}])
def test_settling_is_idempotent(scanner: dict[str, Any]) -> None:
    """Settling again changes nothing, not even for another part."""
    scene = settle_scene(_scene(scanner=scanner), _box(60.0))
    assert with_device(scene, "another", 5.0) == scene


def test_a_standoff_does_not_change_the_device() -> None:
    """A standoff outside the device's range is refused. With `paper`, range and baseline follow the standoffs."""
    part = _box(200.0)
    near = settle(_scene(plan={"standoffs_mm": [200.0]}), part).settings
    assert (near.scanner["range_mm"], near.scanner["baseline_mm"]) == HARDWARE[LARGE][:2]
    with pytest.raises(SceneError, match=r"500 mm is outside the scanner's range of 150 to 450 mm.*paper"):
        settle(_scene(plan={"standoffs_mm": [500.0]}), part)
    paper = settle(_scene(plan={"standoffs_mm": [500.0, 200.0]}, scanner={"sensor": "paper"}), part).settings
    assert (paper.scanner["range_mm"], paper.scanner["baseline_mm"]) == ((100.0, 750.0), 125.0)


def test_the_papers_scanner_has_the_standoff_of_the_device() -> None:
    """Without a standoff in the scene, `paper` uses the standoff of the part's device."""
    paper = settle(_scene(mine=False, part={"name": "mug"}, scanner={"sensor": "paper"}), _box(60.0, "mug")).settings
    assert paper.standoffs == (0.1,)
    assert (paper.scanner["range_mm"], paper.scanner["baseline_mm"]) == HARDWARE[MEDIUM][:2]


def test_a_sensor_without_a_stated_body_has_a_note() -> None:
    """A sensor without a stated body has the housing of the large device and a note."""
    scanner = {"sensor": "gocator-2340", "baseline_mm": 100.0}
    assert _hardware(settle_scene(_scene(scanner=scanner), _box(60.0)))[2] == HARDWARE[LARGE][2]
    (note,) = notes(_scene(scanner=scanner), _box(60.0))
    assert "its body is not stated" in note
    assert not notes(_scene(scanner=scanner, housing={"size_mm": [49, 75, 197]}), _box(60.0))
