"""Measuring tools of a page in Chromium, on a box with known values."""

import base64
import io
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.runs.run import open_run
from cell.scene.model import Region
from cell.view.packed import Layer, quantised_layer
from cell.view.page import PageContents, PageScene, PageSurface, PageView, render_page
from cell.view.pieces import cell_of_run
from cell.view.study_page import study_page
from planner.geometry.mesh import TriangleMesh

SIZE_MM = (60.0, 40.0, 20.0)
_LATER = "const later = (ms) => new Promise((done) => setTimeout(done, ms));"


@pytest.fixture(scope="module")
def page(planned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page of a box: the deviation is x in mm / 100, one view measures x > 0, a class holds z > 0."""
    box = trimesh.creation.box(np.array(SIZE_MM) / 1000).subdivide_to_size(0.004)
    mesh = TriangleMesh(box.vertices, box.faces.astype(np.int32))
    x, z = 10.0 * mesh.vertices[:, 0], mesh.vertices[:, 2]
    layers = [
        quantised_layer(x, "Deviation", "signed", (-0.3, 0.3), ""),
        Layer("Number of views", "views", (x > 0).astype(np.uint8)[:, None]),
        Layer("Half", "named", (z > 0).astype(np.uint8), named=[("below", "#0072b2"), ("above", "#e69f00")]),
    ]
    run = open_run(planned)
    cell = cell_of_run(run, run.scene)
    away = np.eye(4)
    away[2, 3] = 0.3
    view = PageView("1", cell.T_base_object @ away, 0.5, [("view", "1")])
    motion = (np.linspace(0, 1, 50), cell.arm.home + np.linspace(0, 0.3, 50)[:, None] * np.eye(6)[0])
    path = tmp_path_factory.mktemp("tools") / "box.html"
    scene = PageScene("box", cell, [PageSurface("part", mesh, layers)], opens_on="Deviation")
    side = {"name": "side (form)", "colour": "#0072b2", "rows": [("value", "0.03 mm")], "place": [0.03, 0, 0],
            "points": [[30.0, 5.0, 0.0, 0.02], [30.0, -5.0, 0.0, -0.01]]}  # fmt: skip
    path.write_text(render_page(scene, PageContents([view], motion, characteristics=[side])), encoding="utf-8")
    return path


def _run(browser: Any, page: Path, script: str, fragment: str = "") -> Any:
    browser.open(page.as_uri() + fragment)
    value = browser.run(f"(async () => {{ {_LATER} await later(600); {script} }})()")
    assert browser.faults() == []
    assert [address for address in browser.requests() if not address.startswith(page.as_uri())] == []
    return value


def test_a_click_on_a_characteristic_shows_value_and_points(browser: Any, page: Path) -> None:
    """Points of its feature are drawn at their places, above the element red, below blue."""
    before, text, places, colours = _run(
        browser,
        page,
        """
        const before = featurePoints.children.length;
        document.querySelector("#features button").click();
        const drawn = featurePoints.children[0].geometry;
        return [before, byId("feature").textContent, [...drawn.attributes.position.array],
                [...drawn.attributes.color.array]];
        """,
    )
    assert before == 0
    assert "0.03 mm" in text
    assert places == pytest.approx([0.03, 0.005, 0, 0.03, -0.005, 0], abs=1e-6)
    assert colours[0] > colours[2] + 0.2
    assert colours[5] > colours[3] + 0.1


def test_a_probe_shows_value_place_normal_and_views(browser: Any, page: Path) -> None:
    """A flag on the face x = 30 mm has a deviation of 0.3 mm; its place is kept in the address."""
    text, table, link = _run(
        browser,
        page,
        """
        flagAt(new THREE.Vector3(0.031, 0.004, 0.003));
        return [byId("flag-list").textContent, flagTable(), location.hash];
        """,
    )
    assert "deviation: 0.300 mm" in text
    assert "30.00, 4.00, 3.00 mm" in text
    header, row = table.strip().split("\r\n")
    values = dict(zip(header.replace('"', "").split(","), row.replace('"', "").split(","), strict=True))
    assert (values["x_mm"], values["normal_x"], values["value"], values["views"]) == (
        "30.0000", "1.00000", "0.300 mm", "1",
    )  # fmt: skip
    assert link == "#flags=30.000,4.000,3.000"
    browser.open("about:blank")  # else only the fragment changes
    again = _run(browser, page, "return byId('flag-list').textContent", link)
    assert again == text


def test_a_pointer_shows_and_clicks_measure(browser: Any, page: Path) -> None:
    """Hovering shows the value; two clicks with the tool give a distance."""
    found = _run(
        browser,
        page,
        """
        const rect = canvas.getBoundingClientRect(), send = (type, place) => {
          const [x, y] = onScreen(inScene(new THREE.Vector3(...place)));
          const at = { clientX: rect.left + x, clientY: rect.top + y, pointerId: 1, button: 0, bubbles: true };
          canvas.dispatchEvent(new PointerEvent(type, at));
        };
        standardView("iso"); await later(500);
        const eye = inObject(camera.position), side = (k) => Math.sign(eye.getComponent(k));
        const [a, b] = [[0.01, 0.005, side(2) * 0.01], [-0.01, 0.005, side(2) * 0.01]];
        send("pointermove", a); await later(400);
        const hover = byId("hover").textContent;
        startTool("distance");
        moved = 0; send("pointerup", a); moved = 0; send("pointerup", b);
        return [hover, byId("tool").textContent];
        """,
    )
    assert "deviation: 0.10" in found[0]
    distance = float(found[1].split()[1])
    assert distance == pytest.approx(20.0, abs=0.2)


def test_angle_diameter_and_region(browser: Any, page: Path) -> None:
    """Values of known places; the text of a region is valid in a scene."""
    angle, diameter, region, line = _run(
        browser,
        page,
        """
        const at = (...mm) => new THREE.Vector3(...mm).multiplyScalar(0.001);
        return [
          TOOLS.angle.say([at(10, 0, 0), at(0, 0, 0), at(0, 7, 0)]),
          TOOLS.diameter.say([at(15, 2, 3), at(5, 12, 3), at(-5, 2, 3)]),
          TOOLS.region.say([at(10, -2, 3), at(-4, 5, 6)]),
          TOOLS.diameter.say([at(0, 0, 0), at(1, 0, 0), at(2, 0, 0)]),
        ];
        """,
    )
    assert angle == "angle 90.000 deg"
    assert diameter == "diameter 20.000 mm, centre 5.00, 2.00, 3.00 mm"
    assert line == "the three places are on a line"
    (table,) = tomllib.loads(region)["region"]
    assert Region.model_validate(table).box_mm == (-4, -2, 3, 10, 5, 6)


def test_a_section_cuts_at_its_plane(browser: Any, page: Path) -> None:
    """All points of the cut lie on the plane, its length is the outline of the box; Escape removes it."""
    points, clipped, after = _run(
        browser,
        page,
        """
        startTool("section");
        const place = cut.geometry.attributes.position, points = [];
        const point = (k) => inObject(new THREE.Vector3().fromBufferAttribute(place, k)).toArray();
        for (let k = 0; k < place.count; k++) points.push(point(k));
        const clipped = surfaces[0].material.clippingPlanes.length;
        document.dispatchEvent(new KeyboardEvent("keydown", { key: "Escape", bubbles: true }));
        return [points, clipped, [cut.visible, surfaces[0].material.clippingPlanes]];
        """,
    )
    points = 1000 * np.array(points)
    assert clipped == 1
    assert np.abs(points[:, 0]).max() < 1e-3
    lengths = np.linalg.norm(points[1::2] - points[::2], axis=1)
    assert lengths.sum() == pytest.approx(2 * (SIZE_MM[1] + SIZE_MM[2]), rel=1e-3)
    assert after == [False, None]


def test_colours_match_the_legend_and_histogram_the_area(browser: Any, page: Path) -> None:
    """Classes have one colour per face; the tolerance is green; the areas of the histogram are those of the box."""
    faces, green, counts = _run(
        browser,
        page,
        """
        const colour = byId("colour"), pick = (title) => {
          colour.selectedIndex = [...colour.options].findIndex((each) => each.text === title);
          colour.onchange();
        };
        pick("Half");
        const array = [...surfaces[0].colours.array], faces = new Set();
        const face = (i) => array.slice(i, i + 9).map((each) => each.toFixed(3)).join();
        for (let i = 0; i < array.length; i += 9) faces.add(face(i));
        pick("Deviation"); tolerance = 0.05; paint();
        const layer = choice.layer;
        const isGreen = (value) => fieldColour(layer, value).join() === palette.cloud[0].join();
        return [faces.size, isGreen(0.04) && !isGreen(0.06), [...areasOfField(surfaces[0], layer, 3)]];
        """,
    )
    assert faces == 2
    assert green
    ends, side = SIZE_MM[1] * SIZE_MM[2], 2 * SIZE_MM[0] * (SIZE_MM[1] + SIZE_MM[2]) / 3
    assert np.array(counts) / sum(counts) == pytest.approx(
        np.array([side + ends, side, side + ends]) / (3 * side + 2 * ends), abs=0.04
    )


def test_meshes_are_saved_as_glb(browser: Any, page: Path) -> None:
    """An independent reader finds the box with its area, y up in the file."""
    content = _run(
        browser,
        page,
        """
        for (const [name, entry] of shown) entry.visible = name === "part";
        const bytes = new Uint8Array(await glb().arrayBuffer());
        let text = ""; for (const byte of bytes) text += String.fromCharCode(byte);
        return btoa(text);
        """,
    )
    scene = trimesh.load(io.BytesIO(base64.b64decode(content)), file_type="glb")
    (mesh,) = scene.geometry.values()
    x, y, z = np.array(SIZE_MM) / 1000
    assert mesh.area == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-4)


def test_keys_step_through_the_views_and_stop_the_motion(browser: Any, page: Path) -> None:
    """An arrow selects the view, stops the playback there and shows the axes."""
    playing, selected, moment, axis, folded = _run(
        browser,
        page,
        """
        play(true);
        const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
        press("ArrowRight"); press("p");
        const folded = document.body.classList.contains("folded");
        return [playing, byId("selected").textContent, now, byId("axes").textContent, folded];
        """,
    )
    assert (playing, selected, moment, folded) == (False, "view1", 0.5, True)
    assert axis.startswith("A1")


@pytest.mark.slow
@pytest.mark.parametrize("chromium", [("--window-size=800,600",), ("--window-size=1280,900",)], indirect=True)
def test_nothing_overlaps(chromium: Any, page: Path) -> None:
    """Panel, player and the scanner's picture do not cover each other; the part fills half of the free height."""
    boxes, height, free = _run(
        chromium,
        page,
        """
        select(0); await later(600);
        const boxes = [byId("player"), byId("inset"), document.querySelector("aside")].map((each) => {
          const box = each.getBoundingClientRect();
          return [box.left, box.top, box.right, box.bottom];
        });
        lookAt(data.camera.part, data.camera.part_distance); await later(300);
        const ys = [];
        for (const x of [-0.03, 0.03]) for (const y of [-0.02, 0.02]) for (const z of [-0.01, 0.01]) {
          ys.push(onScreen(inScene(new THREE.Vector3(x, y, z))));
        }
        const span = (k) => Math.max(...ys.map((each) => each[k])) - Math.min(...ys.map((each) => each[k]));
        return [boxes, Math.max(span(0), span(1)), Math.min(canvas.clientHeight, canvas.clientWidth - 330)];
        """,
    )
    for i, a in enumerate(boxes):
        for b in boxes[i + 1 :]:
            assert min(a[2], b[2]) <= max(a[0], b[0]) or min(a[3], b[3]) <= max(a[1], b[1]), (a, b)
    assert height > 0.5 * free


def test_the_map_and_the_table_of_a_study(chromium: Any, tmp_path: Path) -> None:
    """A mark selects its row and its command; a heading sorts; views have one step of colour each."""
    rows = [
        {"x mm": x, "y mm": y, "coverable %": 91.0 + 0.001 * x, "views": 5 + (x > 0)} for x in (0, 80) for y in (1, 2)
    ]
    study = {
        "name": "placement", "sentences": ["A study."], "rows": rows, "failed": [], "pictures": [], "best": 1,
        "commands": [f"cell plan --place {row['x mm']},{row['y mm']},0" for row in rows],
    }  # fmt: skip
    (tmp_path / "study.json").write_text(json.dumps(study))
    page = tmp_path / "view.html"
    page.write_text(study_page(tmp_path), encoding="utf-8")
    found = _run(  # the driver of Firefox runs scripts in the page, which allows only its own
        chromium,
        page,
        """
        const marks = () => [...document.querySelectorAll("#map [data-row]")];
        const order = () => [...document.querySelectorAll("tbody tr")].map((line) => line.dataset.row).join("");
        const colours = new Set(marks().map((mark) => mark.getAttribute("fill"))).size;
        const first = byId("command").textContent;
        marks()[3].onclick(); const second = byId("command").textContent;
        heads[0].click(); heads[0].click(); const down = order();
        byId("colour").value = "views"; byId("colour").onchange();
        return [first, second, down, document.querySelectorAll("#map .bar").length, limits("coverable %"), colours];
        """,
    )
    assert found[:4] == ["cell plan --place 0,2,0", "cell plan --place 80,2,0", "2301", 2]
    assert found[4] == pytest.approx([90.54, 91.54])
    assert found[5] == 2
