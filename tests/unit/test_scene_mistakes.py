"""Thirty-one mistakes in scenes: each is reported with both objects and corrected by its remedy."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.part import workpiece
from cell.scene.model import Scene
from cell.world.checks import find_problems, find_warnings
from cell.world.model import World, compile_world
from cell.world.solids import Solid, minimum_translation

ON_TABLE = [1200.0, 500.0, 0.0]  # the part's middle; it is 100 mm high
NO_POST = {"post": {"enabled": False}}


def box(name: str, size: list[float], at: list[float], **more: object) -> dict[str, Any]:
    """Return a box fixture."""
    return {"name": name, "shape": "box", "size_mm": size, "position_mm": at, **more}


def rod(name: str, size: list[float], at: list[float], **more: object) -> dict[str, Any]:
    """Return a cylinder fixture."""
    return {"name": name, "shape": "cylinder", "size_mm": size, "position_mm": at, **more}


def table(top: float = -50.0, at: tuple[float, float] = (1200.0, 500.0), side: float = 400.0) -> dict[str, Any]:
    """Return a fixture from the floor up to a height [mm]."""
    return box("table", [side, side, top + 600], [*at, (top - 600) / 2])


def cup() -> trimesh.Trimesh:
    """Return a cup of 100 mm with walls of 5 mm."""
    profile = np.array([[0, -50], [50, -50], [50, 50], [45, 50], [45, -45], [0, -45]], dtype=float)
    return trimesh.creation.revolve(profile, sections=48)


def block() -> trimesh.Trimesh:
    """Return a cube of 100 mm."""
    return trimesh.creation.box((100, 100, 100))


def angle() -> trimesh.Trimesh:
    """Return an L of two plates, 200 mm long, on the short one."""
    plates = [[[0, 0, 0], [40, 100, 100]], [[40, 0, 80], [240, 100, 100]]]
    return trimesh.util.concatenate([trimesh.creation.box(bounds=plate) for plate in plates])


Mesh = Callable[[], trimesh.Trimesh]

ERRORS: dict[str, tuple[Mesh, dict[str, Any], tuple[str, ...]]] = {
    "part 29 mm deep in a table": (block, {"fixtures": [table(-21)], **NO_POST}, ("part", "'table', 29.0 mm deep")),
    "part a millimetre in a table": (block, {"fixtures": [table(-49)]}, ("part", "'table', 1.0 mm deep")),
    "cup in a box": (cup, {"fixtures": [box("crate", [300, 300, 300], ON_TABLE)]}, ("part", "'crate', 200.0 mm deep")),
    "rod through a cup's wall": (cup, {"fixtures": [rod("pin", [10, 60], [1248, 500, 40])]}, ("part", "'pin'")),
    "ball in a turned box": (
        lambda: trimesh.creation.icosphere(3, 50),
        {"fixtures": [box("wedge", [200, 200, 200], [1200, 650, 0], abc_deg=[45, 0, 0])]},
        ("part", "'wedge', 41."),
    ),
    "clamp that travels with the part in it": (
        block,
        {"fixtures": [box("clamp", [50, 50, 50], [0, 0, 70], attached_to="object")],
         "placement": {"position_mm": ON_TABLE, "abc_deg": [30, 20, 10]}},
        ("'clamp'", "part, 5.0 mm deep", "fixtures[0].position_mm by (0, 0, 5)"),
    ),
    "mesh fixture in the part": (block, {"mesh": (cup, [1290, 500, 0])}, ("part", "'vice', 10.0 mm deep")),
    "part in the pedestal": (block, {"placement": {"position_mm": [330, 0, -100]}}, ("part", "pedestal, 20.0 mm deep")),
    "post in the pedestal": (block, {"placement": {"position_mm": [310, 0, 300]}}, ("post", "pedestal, 10.0 mm deep")),
    "part in the base": (block, {"placement": {"position_mm": [0, 0, 300]}, **NO_POST}, ("part", "robot's base")),
    "part in a link": (block, {"placement": {"position_mm": [0, 0, 700]}, **NO_POST}, ("part", "robot's link_1")),
    "part in the scanner": (block, {"placement": {"position_mm": [930, 0, 1000]}}, ("part", "housing at home")),
    "part nearer than the clearance": (
        block,
        {"placement": {"position_mm": [930, 0, 985]}},
        ("part", "housing at home", "nearer than the clearance"),
    ),
    "part in the floor": (block, {"placement": {"position_mm": [1200, 500, -560]}}, ("10.0 mm below the floor",)),
    "fixture in a link": (block, {"fixtures": [box("wall", [50, 900, 900], [700, 0, 1300])]}, ("'wall'", "link_")),
    "fixture in the base": (block, {"fixtures": [box("foot", [60, 60, 200], [100, 0, 100])]}, ("'foot'", "base")),
    "fixture between part and arm": (
        block,
        {"placement": {"position_mm": [930, 0, 970]}, "fixtures": [box("lid", [60, 60, 30], [930, 0, 1037])]},
        ("'lid'", "at home"),
    ),
    "fixture of the part between two": (
        block,
        {"fixtures": [box("left", [40, 300, 300], [1140, 500, 0]), box("right", [40, 300, 300], [1272, 500, 0])]},
        ("part", "'left'"),
    ),
    "fixture in the scanner": (block, {"fixtures": [rod("lamp", [40, 900], [930, 60, 1300])]}, ("'lamp'", "at home")),
    "housing before the source": (block, {"housing": {"position_mm": [0, 0, 100]}}, ("housing hides",)),
    "source in the housing": (block, {"housing": {"position_mm": [37.5, 0, -20]}}, ("housing hides", "(0, 0, -10)")),
    "scanner that looks back": (
        block, {"mount": {"position_mm": [0, 0, 120], "abc_deg": [0, 180, 0]}}, ("flange and bracket hide 100 %",),
    ),
    "housing in the flange": (block, {"mount": {"position_mm": [0, 0, 55]}}, ("housing", "link_6", "5.0 mm deep")),
}  # fmt: skip

WARNINGS: dict[str, tuple[Mesh, dict[str, Any], tuple[str, ...]]] = {
    "fixture in a fixture": (
        block, {"fixtures": [table(), box("rail", [50, 400, 50], [1200, 890, -60])]}, ("'rail'", "'table', 10.0 mm"),
    ),
    "mesh fixture in a fixture": (
        block, {"fixtures": [table()], "mesh": (cup, [1100, 500, -6.5])}, ("'vice'", "'table', 6.5 mm deep"),
    ),
    "fixture between part and wall": (
        block,
        {"fixtures": [table(), box("wall", [50, 200, 120], [1315, 500, 10]),
                      box("rail", [50, 60, 40], [1275, 500, -30])]},
        ("'rail'", "'wall', 10.0 mm deep"),
    ),
    "fixture in the floor": (
        block, {"fixtures": [box("pit", [90, 90, 90], [1500, 0, -570])]}, ("'pit'", "15.0 mm below"),
    ),
    "post through a table": (block, {"fixtures": [table()]}, ("post", "'table'", "post.enabled = false")),
    "part in the air": (block, {"fixtures": [table(-62.5)], **NO_POST}, ("part", "12.5 mm above the fixture 'table'")),
    "part in the air of nothing": (block, NO_POST, ("part", "550.0 mm above the floor")),
    "shelf in the air": (block, {"fixtures": [box("shelf", [300, 300, 20], [0, 1500, 410])]}, ("'shelf'", "1000.0 mm")),
    "part over the edge": (
        block,
        {"fixtures": [table(at=(1010, 500), side=300)], **NO_POST},
        ("centre of mass of the part is 40", "'table'"),
    ),
    "an angle that tips": (angle, {"fixtures": [table()], **NO_POST}, ("centre of mass of the part", "'table'")),
    "a fixture in inches": (
        block, {"mesh": (lambda: cup().apply_scale(1 / 25.4), [0, 1500, -598])}, ("'vice'", "100 mm in in"),
    ),
}  # fmt: skip


@pytest.fixture
def world(tmp_path: Path) -> Callable[[Mesh, dict[str, Any]], World]:
    """Return a function that compiles tables of a scene with a part."""

    def compiled(mesh: Mesh, tables: dict[str, Any]) -> World:
        tables = {**tables, "fixtures": list(tables.get("fixtures", []))}
        if vice := tables.pop("mesh", None):
            vice[0]().export(tmp_path / "vice.ply")
            place = {"path": str(tmp_path / "vice.ply"), "units": "mm", "position_mm": vice[1]}
            tables["fixtures"].append({"name": "vice", "shape": "mesh", **place})
        part = mesh()
        part = workpiece.from_arrays("part", part.vertices, part.faces, "mm").reference
        return compile_world(Scene.model_validate(tables), part.vertices, part_faces=part.faces, baseline_mm=75.0)

    return compiled


def followed(tables: dict[str, Any], sentence: str) -> dict[str, Any] | None:
    """Return the tables after the change that a message proposes; None if it has no position."""
    found = re.search(r"move (?:(\w+)|fixtures\[(\d)\])\.position_mm by \(.*?\) mm, to \((.*?)\)", sentence)
    if found is None:
        return {**tables, **NO_POST} if "set post.enabled" in sentence else None
    place = [float(value) for value in found[3].split(", ")]
    if found[2] is None:
        return {**tables, found[1]: {**tables.get(found[1], {}), "position_mm": place}}
    fixtures = [dict(fixture) for fixture in tables.get("fixtures", [])]
    if int(found[2]) == len(fixtures):
        return {**tables, "mesh": (tables["mesh"][0], place)}
    fixtures[int(found[2])]["position_mm"] = place
    return {**tables, "fixtures": fixtures}


def _objects(sentence: str) -> str:
    """Return a message without lengths and remedy."""
    return re.sub(r"-?[\d.]+", "", sentence.split("; ")[0])


@pytest.mark.parametrize("name", ERRORS)
def test_a_problem_is_found_and_its_remedy_removes_it(name: str, world: Callable[..., World]) -> None:
    """The message names both objects, and after the proposed change the problem is gone."""
    mesh, tables, words = ERRORS[name]
    before = find_problems(world(mesh, tables))
    output = [each for each in before if all(word in each for word in words)]
    assert len(output) == 1, before
    cured = followed(tables, output[0])
    if name == "scanner that looks back":
        assert cured is None
        return
    assert cured is not None
    left = find_problems(world(mesh, cured))
    assert {_objects(each) for each in left} <= {_objects(each) for each in before}, left
    assert not [each for each in left if each.split("; ")[0].split(",")[0] == output[0].split("; ")[0].split(",")[0]], (
        left
    )


@pytest.mark.parametrize("name", WARNINGS)
def test_a_warning_is_found_and_its_remedy_removes_it(name: str, world: Callable[..., World]) -> None:
    """A probable mistake is reported as a warning and not as a problem."""
    mesh, tables, words = WARNINGS[name]
    cell = world(mesh, tables)
    assert not find_problems(cell)
    output = [each for each in find_warnings(cell) if all(word in each for word in words)]
    assert len(output) == 1, find_warnings(cell)
    cured = followed(tables, output[0])
    if name in ("a fixture in inches", "an angle that tips"):
        return  # no move helps
    assert cured is not None
    cell = world(mesh, cured)
    assert not find_problems(cell)
    left = find_warnings(cell)
    assert not [each for each in left if all(word.split(",")[0] in each for word in words)], left


@pytest.mark.parametrize(
    "tables",
    [
        {},
        {"fixtures": [table()], **NO_POST},
        {"fixtures": [table(), box("stop", [20, 100, 40], [1260, 500, -30])], **NO_POST},
        {"fixtures": [table(), box("clamp", [50, 50, 50], [0, 0, 75], attached_to="object")], **NO_POST},
        {"fixtures": [rod("stand", [30, 550], [1200, 500, -325])], **NO_POST},
    ],
)
def test_flush_objects_are_neither(tables: dict[str, Any], world: Callable[..., World]) -> None:
    """Objects in contact without overlap give neither a problem nor a warning."""
    cell = world(block, tables)
    assert find_problems(cell) == []
    assert find_warnings(cell) == []


def test_a_cup_over_a_peg_is_valid_although_its_hull_is_not(world: Callable[..., World]) -> None:
    """With true triangles the peg is in the cavity."""
    assert find_problems(world(cup, {"fixtures": [rod("peg", [60, 80], [1200, 500, 5])]})) == []


def test_wrong_units_are_noticed_by_the_size() -> None:
    """A cube of 4 inches read as millimetres, one in metres, and a right one."""
    for side, units, hint in ((4.0, "mm", "102 mm in in"), (0.1, "mm", "100 mm in m"), (100.0, "mm", "")):
        cube = trimesh.creation.box((side, side, side))
        found = [each.sentence for each in workpiece.from_arrays("cube", cube.vertices, cube.faces, units).findings]
        assert bool(found) == bool(hint)
        assert all(hint in sentence for sentence in found)


def test_the_separation_of_a_large_mesh_is_that_of_its_true_triangles() -> None:
    """A ball of 82,000 faces 30 mm deep in a slab is separated 30 mm upward, to 0.1 mm."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    slab = trimesh.creation.box((1.0, 1.0, 0.4))
    sunk = Solid("ball", ball.vertices + np.array([0.02, -0.03, 0.27]), ball.faces)
    assert sunk.coarse is not sunk
    way = minimum_translation(sunk, Solid("slab", slab.vertices, slab.faces))
    np.testing.assert_allclose(way, [0.0, 0.0, 0.03], rtol=0, atol=1.5e-4)
