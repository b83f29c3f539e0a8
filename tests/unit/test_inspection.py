"""Features, characteristics, alignment, values, uncertainty and verdicts, on a block of 60 x 40 x 30 with a bore."""

import functools
import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from benchmarks.inspection import block_bench, scan_values
from cell.errors import FileError, SceneError
from cell.inspect import pictures
from cell.inspect.alignment import common_element, datum_frame, fit_reference_points, moved
from cell.inspect.evaluation import Evaluation, Measurement, Verdict, verdict_of
from cell.inspect.features import Characteristic, Feature, InspectionPlan, Patch, resolve_features
from cell.inspect.inspection import Inspected, align, inspect_points
from cell.inspect.measured import Association, MeasuredFeature, MeasuredPoints, measure_features
from cell.inspect.prediction import PlannedViews, main_source, predict_features, predicted_measurements
from cell.inspect.qif import read_qif
from cell.inspect.qif_results import qif_results
from cell.inspect.results import as_csv
from cell.metrology.inspect import located, points_of_setups
from cell.metrology.options import InspectOptions
from cell.part.cad import CadModel, SurfaceKind
from cell.part.workpiece import Workpiece, from_trusted_mesh, load
from cell.plan.uncertainty import _causes, _feature_sets, _raise_demand
from cell.scanners.laser_area import LaserArea
from cell.scene.features import FeatureTable
from cell.world.embree import EmbreeRayCaster
from planner.fitting.shapes import Shape, ShapeKind
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.registration.rigid import motion_from_vector, transform_points
from planner.values import Floats
from tests.qif_files import NAMESPACE, bored_block_qif, characteristic
from tests.step_files import bored_block, needs_cascadio

pytestmark = needs_cascadio

ZONE = {"tolerance_mm": 0.5}
ABC = {"datums": ("A", "B", "C")}
LIMITS = {"lower": -0.2, "upper": 0.2}
TABLES = [
    {"name": "top", "faces": (6,), "datum": "A", "characteristic": [{"kind": "form", **ZONE}]},
    {"name": "front", "faces": (3,), "datum": "B",
     "characteristic": [{"kind": "perpendicularity", "datums": ("A",), **ZONE}]},
    {"name": "left", "faces": (1,), "datum": "C"},
    {"name": "right", "faces": (2,), "characteristic": [
        {"kind": "distance", "to": "left", **LIMITS}, {"kind": "profile", **ABC, **ZONE}]},
    {"name": "bottom", "faces": (5,), "characteristic": [{"kind": "parallelism", "datums": ("A",), **ZONE}]},
    {"name": "back", "faces": (4,), "characteristic": [{"kind": "angle", "to": "top", **LIMITS}]},
    {"name": "bore", "faces": (7,), "characteristic": [
        {"kind": "size", **LIMITS}, {"kind": "roundness", **ZONE}, {"kind": "position", **ABC, **ZONE},
        {"kind": "perpendicularity", "datums": ("A",), **ZONE},
        {"kind": "size", "name": "inscribed", "criterion": "inscribed", **LIMITS}]},
    {"name": "slot", "faces": (1, 2), "kind": "width", "characteristic": [{"kind": "size", **LIMITS}]},
]  # fmt: skip


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Workpiece:
    """Return the block."""
    path = tmp_path_factory.mktemp("step") / "block.step"
    path.write_text(bored_block())
    return load(path)


def plan_of(part: Workpiece, tables: list[dict[str, object]] | None = None, **settings: object) -> InspectionPlan:
    """Return the plan of an inspection."""
    features, found = resolve_features(part, [FeatureTable.model_validate(each) for each in tables or TABLES])
    values = {"source": "test", "features": features, "characteristics": found, "unsupported": (), "notes": (),
              "u_over_t": 0.1, "alignment": "none", "rps": (), "edge_mm": 1.0, "reach_mm": 2.0}  # fmt: skip
    return InspectionPlan.model_validate(values | settings)


def only(plan: InspectionPlan, *names: str) -> InspectionPlan:
    """Return a plan with some of its characteristics; each of them takes a tenth of a second."""
    return plan.model_copy(update={"characteristics": tuple(c for c in plan.characteristics if c.name in names)})


@functools.cache
def association_of(part: Workpiece) -> Association:
    """Return the association of points with all features."""
    return Association(part.reference, plan_of(part))


def points_on(part: Workpiece, count: int = 40_000, sigma: float = 0.0, seed: int = 0) -> Floats:
    """Return points (N, 3) on the part's surface with noise along the normals [m]."""
    return _points_on(part, count, sigma, seed).copy()


@functools.lru_cache(8)
def _points_on(part: Workpiece, count: int, sigma: float, seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    samples = draw_samples(part.reference, part.reference, count, rng)
    exact = association_of(part).without_facets(samples.points)
    return exact + sigma * rng.standard_normal((count, 1)) * samples.normals


def single_view(points: Floats, sigma: float = 0.0) -> MeasuredPoints:
    """Return points of one view with an exact pose."""
    count = len(points)
    return MeasuredPoints(points, np.full(count, sigma), np.zeros(count, np.int64), np.zeros((1, 3)), np.zeros((1, 2)))


def inspected(part: Workpiece, points: Floats, plan: InspectionPlan | None = None, sigma: float = 0.0) -> Inspected:
    """Return the result of an inspection of points."""
    return inspect_points(
        plan or plan_of(part), part.reference, single_view(points, sigma), part="block", source="points",
        is_simulated=True,
    )  # fmt: skip


def values_of(part: Workpiece, points: Floats, plan: InspectionPlan | None = None) -> dict[str, float]:
    """Return the values of the characteristics by name; the uncertainties would take ten times as long."""
    plan = plan or plan_of(part)
    association = Association(part.reference, plan)
    T, _ = align(plan, association, points)
    features = measure_features(association, single_view(transform_points(T, points)))
    values = Evaluation(plan, features, association.nearest, np.zeros((1, 2))).values()
    return {each.name: value for each, value in zip(plan.characteristics, values, strict=True)}


class TestFeatures:
    def test_shapes_are_those_of_the_faces(self, block: Workpiece) -> None:
        plan = plan_of(block)
        bore, top = plan.feature("bore").patches[0], plan.datum("A").patches[0]
        assert (bore.kind, bore.radius_mm) == ("cylinder", pytest.approx(8))
        assert bore.point_mm == pytest.approx((30, 20, 15), abs=0.01)
        assert top.axis == pytest.approx((0, 0, 1))
        assert [each.kind for each in plan.feature("slot").patches] == ["plane", "plane"]
        assert [each.nominal for each in plan.characteristics if each.kind == "distance"] == [pytest.approx(60)]

    def test_a_mesh_has_no_features(self, block: Workpiece) -> None:
        with pytest.raises(SceneError, match="is a mesh"):
            plan_of(from_trusted_mesh("mesh", block.reference))

    @pytest.mark.parametrize(
        ("table", "message"),
        [
            ({"name": "a", "faces": (99,)}, "names face 99"),
            ({"name": "a", "faces": (6,), "kind": "cylinder"}, "needs the faces of one cylinder"),
            ({"name": "a", "faces": (6,), "characteristic": [{"kind": "size"}]}, "not defined for a plane"),
        ],
    )
    def test_a_feature_that_does_not_fit_its_faces_is_refused(
        self, block: Workpiece, table: dict[str, object], message: str
    ) -> None:
        with pytest.raises(SceneError, match=message):
            plan_of(block, [table])

    @pytest.mark.parametrize(
        "content",
        [
            {"kind": "size", "tolerance_mm": 0.1},
            {"kind": "form", "lower": -0.1},
            {"kind": "position", "datums": (), "tolerance_mm": -1.0},
            {"kind": "perpendicularity", "tolerance_mm": 0.1},
            {"kind": "distance"},
        ],
    )
    def test_contradictions_in_a_characteristic_are_refused(self, content: dict[str, object]) -> None:
        with pytest.raises(ValidationError):
            FeatureTable.model_validate({"name": "a", "faces": (1,), "characteristic": [content]})


class TestQif:
    def read(self, block: Workpiece, folder: Path, text: str) -> tuple[InspectionPlan, list[str]]:
        (folder / "block.qif").write_text(text)
        content = read_qif(folder / "block.qif", block)
        features, found = resolve_features(block, content.features, content.unsupported)
        assert len(found) + sum("(" in each for each in content.unsupported) == content.n_characteristics
        values = plan_of(block).model_dump() | {"features": features, "characteristics": found}
        return InspectionPlan.model_validate(values), content.unsupported

    def test_faces_limits_units_and_datums_are_read(self, block: Workpiece, tmp_path: Path) -> None:
        plan, unsupported = self.read(block, tmp_path, bored_block_qif())
        assert unsupported == []
        by_name = {each.name: each for each in plan.characteristics}
        assert plan.feature(by_name["Diameter 42"].feature).faces == (7,)
        assert plan.datum("A").faces == (6,)
        assert by_name["Flatness 41"].upper == pytest.approx(0.3)
        size = by_name["Diameter 42"]
        assert (size.nominal, size.lower, size.upper) == pytest.approx((16, 15.9, 16.2))
        assert by_name["Position 43"].datums == ("A",)
        assert "bonus" in by_name["Position 43"].note

    @pytest.mark.parametrize(
        ("unit", "value"), [("degree", 0.5), ("radian", 0.008726646), ("", 0.5), ("gon", 0.5 / 0.9)]
    )
    def test_an_angle_has_the_unit_of_its_attribute(
        self, block: Workpiece, tmp_path: Path, unit: str, value: float
    ) -> None:
        attribute = f' angularUnit="{unit}"' if unit else ""
        limits = f"<MaxValue{attribute}>{value}</MaxValue><MinValue{attribute}>{-value}</MinValue>"
        nominal = characteristic("AngleBetween", 53, 34, 1100, '<TargetValue angularUnit="degree">90</TargetValue>')
        text = bored_block_qif(extra=nominal.replace("<Id>1100</Id>", "<Id>1100</Id><Id>1200</Id>") + (
            "---<AngleBetweenCharacteristicDefinition id=\"34\"><Tolerance>" + limits +
            "<DefinedAsLimit>false</DefinedAsLimit></Tolerance></AngleBetweenCharacteristicDefinition>"))  # fmt: skip
        other = "<AngularUnit><SIUnitName>radian</SIUnitName><UnitName>gon</UnitName><UnitConversion><Factor>"
        other += "0.015707963268</Factor></UnitConversion></AngularUnit>"
        plan, unsupported = self.read(block, tmp_path, text.replace("</OtherUnits>", f"{other}</OtherUnits>"))
        assert unsupported == []
        found = next(each for each in plan.characteristics if each.name == "AngleBetween 53")
        assert (found.nominal, found.lower, found.upper) == pytest.approx((90, 89.5, 90.5), abs=1e-6)

    def test_units_of_characteristics_override_those_of_points(self, block: Workpiece, tmp_path: Path) -> None:
        """Points in mm and sizes in inch, by QIF 3 (PrimaryUnits); a unit that a value names counts for it."""
        conversion = "<UnitConversion><Factor>0.0254</Factor></UnitConversion>"
        sizes = f"<PMILinearUnit><SIUnitName>meter</SIUnitName><UnitName>inch</UnitName>{conversion}</PMILinearUnit>"
        text = bored_block_qif().replace("</LinearUnit></PrimaryUnits>", f"</LinearUnit>{sizes}</PrimaryUnits>")
        text = text.replace("<MinValue>15.9", '<MinValue linearUnit="mm_">15.9').replace(
            "<UnitName>mm<", "<UnitName>mm_<"
        )
        plan, unsupported = self.read(block, tmp_path, text)
        assert unsupported == []
        limits = {each.name: (each.lower, each.upper) for each in plan.characteristics}
        assert limits["Diameter 42"] == pytest.approx((15.9, 16.2 * 25.4))
        assert limits["Position 43"][1] == pytest.approx(0.4 * 25.4)
        assert limits["Flatness 41"][1] == pytest.approx(0.3)
        done = inspected(block, points_on(block, 5000, 1e-5), only(plan, "Diameter 42")).result
        root = ElementTree.fromstring(qif_results(text.encode(), done))
        value = next(each for each in root.iter() if each.tag.endswith("}Value"))
        assert (value.get("linearUnit"), float(value.text or 0)) == (None, pytest.approx(16 / 25.4, abs=1e-3))

    def test_the_diameter_of_a_sphere_is_a_size(self, block: Workpiece, tmp_path: Path) -> None:
        """It is that of the bore here, which a file may name so."""
        text = bored_block_qif().replace("DiameterCharacteristic", "SphericalDiameterCharacteristic")
        plan, unsupported = self.read(block, tmp_path, text)
        assert unsupported == []
        assert next(each.kind for each in plan.characteristics if each.name == "Diameter 42") == "size"

    def test_a_model_of_another_size_than_its_sizes(self, block: Workpiece, tmp_path: Path) -> None:
        """A model of twice the part's size is scaled if the diameters of the file are those of the part."""
        words = re.split(r"(?<=<XYZ>)([\d ]+)(?=<)", bored_block_qif())
        words[1::2] = [" ".join(str(2 * int(each)) for each in place.split()) for place in words[1::2]]
        text = "".join(words)
        drawn = '<Cylinder23 id="301"><Cylinder23Core><Diameter>32</Diameter></Cylinder23Core></Cylinder23>'
        plan, unsupported = self.read(block, tmp_path, text.replace('<Cylinder23 id="301"/>', drawn))
        assert (unsupported, len(plan.features)) == ([], 2)
        assert "2 times as large as the part" in read_qif(tmp_path / "block.qif", block).notes[0]
        drawn = drawn.replace("32", "16")
        plan, unsupported = self.read(block, tmp_path, text.replace('<Cylinder23 id="301"/>', drawn))
        assert (len(unsupported), plan.features) == (4, ())
        assert "its model is 2 times as large" in read_qif(tmp_path / "block.qif", block).notes[0]

    def test_a_bore_can_be_cut_elsewhere(self, block: Workpiece, tmp_path: Path) -> None:
        """A face of the file whose corners lie on both halves of the bore is both halves."""
        assert block.cad is not None
        bore = block.cad.faces[6]
        assert bore.kind is SurfaceKind.CYLINDER
        behind = (block.cad.of_triangle == 6) & (block.reference.centres[:, 1] > 0.020)
        of_triangle = np.where(behind, 7, block.cad.of_triangle).astype(np.int32)
        part = replace(block, cad=CadModel((*block.cad.faces, replace(bore, number=8)), of_triangle))
        for corners, faces in (((28, 12), (7, 8)), ((12, 12), (7,)), ((28, 28), (8,))):
            text = bored_block_qif().replace(">38 20 0<", f">30 {corners[0]} 0<")
            plan, unsupported = self.read(part, tmp_path, text.replace(">38 20 30<", f">30 {corners[1]} 30<"))
            assert unsupported == []
            assert plan.feature("cylinder 1300").faces == faces

    def test_features_have_the_faces_of_their_kind(self, block: Workpiece, tmp_path: Path) -> None:
        """A hole can have its bottom; two planes are no plane. A width of a cylinder is named."""
        text = bored_block_qif(extra=characteristic("Width", 57, 32, 1300, "<TargetValue>16</TargetValue>"))
        text = text.replace("<Id>300</Id></EntityInternalIds>", "<Id>300</Id><Id>100</Id></EntityInternalIds>")
        text = text.replace("<Id>100</Id></EntityInternalIds></P", "<Id>100</Id><Id>200</Id></EntityInternalIds></P")
        plan, unsupported = self.read(block, tmp_path, text)
        assert plan.feature("cylinder 1300").faces == (7,)
        assert [each.name for each in plan.characteristics] == ["Diameter 42"]
        assert "Flatness 41 (Flatness): its feature is a plane with faces on 2 surfaces: plane, plane" in unsupported
        assert "Width 57 (Width): Width of a cylinder is not supported" in unsupported
        (tmp_path / "freeform.qif").write_text(text.replace("PlaneFeature", "FreeformFeature"))
        features = read_qif(tmp_path / "freeform.qif", block).features
        assert [each.faces for each in features if each.kind == "surface"] == [(3, 6)]

    def test_the_angle_of_a_cone_is_its_size(self, block: Workpiece, tmp_path: Path) -> None:
        """Its diameter has no place, and is named."""
        assert block.cad is not None
        cone = replace(block.cad.faces[6], kind=SurfaceKind.CONE, radius=None, half_angle=np.radians(59))
        part = replace(block, cad=CadModel((*block.cad.faces[:6], cone), block.cad.of_triangle))
        limits = "<Tolerance><MaxValue>1</MaxValue><MinValue>-1</MinValue></Tolerance>"
        text = bored_block_qif(extra=(
            characteristic("Angle", 58, 38, 1300, "<TargetValue>118</TargetValue>")
            + f'---<AngleCharacteristicDefinition id="38">{limits}</AngleCharacteristicDefinition>'
        )).replace("Cylinder23", "Cone23").replace("CylinderFeature", "ConeFeature")  # fmt: skip
        (tmp_path / "cone.qif").write_text(text)
        content = read_qif(tmp_path / "cone.qif", part)
        angle = next(each for each in resolve_features(part, content.features)[1] if each.name == "Angle 58")
        assert (angle.kind, angle.unit) == ("size", "deg")
        assert (angle.nominal, angle.lower, angle.upper) == pytest.approx((118, 117, 119))
        assert "Diameter 42 (Diameter): Diameter of a cone is not supported" in content.unsupported

    def test_a_known_unit_needs_no_conversion(self, block: Workpiece, tmp_path: Path) -> None:
        text = bored_block_qif()
        plan, unsupported = self.read(
            block, tmp_path, text.replace("<UnitConversion><Factor>0.001</Factor></UnitConversion>", "")
        )
        assert unsupported == []
        assert next(each.upper for each in plan.characteristics if each.name == "Diameter 42") == pytest.approx(16.2)

    @pytest.mark.parametrize(("name", "base", "factor"), [
        ("millimeter", "meter", 1e-3), ("micrometre", "meter", 1e-6), ("inch", "meter", 0.0254),
        ("meter", "meter", 1.0), ("foot", "foot", 1.0), ("ft", "meter", None), ("deg", "meter", None),
    ])  # fmt: skip
    def test_a_unit_without_conversion_is_known_or_refused(
        self, block: Workpiece, tmp_path: Path, name: str, base: str, factor: float | None
    ) -> None:
        """The flatness of 300 in a unit that the file names without a factor."""
        text = bored_block_qif().replace("<UnitConversion><Factor>0.000001</Factor></UnitConversion>", "")
        text = text.replace(
            "<SIUnitName>meter</SIUnitName><UnitName>um<", f"<SIUnitName>{base}</SIUnitName><UnitName>{name}<"
        )
        text = text.replace('linearUnit="um"', f'linearUnit="{name}"')
        if factor is None:
            with pytest.raises(FileError, match=f"its unit '{name}' has no conversion"):
                self.read(block, tmp_path, text)
            return
        plan, _ = self.read(block, tmp_path, text)
        flatness = next(each.upper for each in plan.characteristics if each.name == "Flatness 41")
        assert flatness == pytest.approx(300e3 * factor)

    def test_degrees_without_conversion_are_not_radians(self, block: Workpiece, tmp_path: Path) -> None:
        definition = (
            '---<AngleBetweenCharacteristicDefinition id="34"><Tolerance><MaxValue>0.5</MaxValue><MinValue>-0.5'
            "</MinValue><DefinedAsLimit>false</DefinedAsLimit></Tolerance></AngleBetweenCharacteristicDefinition>"
        )
        nominal = characteristic("AngleBetween", 53, 34, 1100, "<TargetValue>90</TargetValue>")
        text = bored_block_qif(extra=nominal.replace("<Id>1100</Id>", "<Id>1100</Id><Id>1200</Id>") + definition)
        text = text.replace("<UnitConversion><Factor>0.017453292519943</Factor></UnitConversion>", "")
        plan, unsupported = self.read(block, tmp_path, text.replace("<UnitName>degree<", "<UnitName>deg<"))
        assert unsupported == []
        angle = next(each for each in plan.characteristics if each.name == "AngleBetween 53")
        assert (angle.nominal, angle.upper) == pytest.approx((90, 90.5))

    def test_what_is_not_supported_is_named(self, block: Workpiece, tmp_path: Path) -> None:
        extra = characteristic("LineProfile", 51, 31, 1300) + characteristic("Flatness", 52, 31, 1999)
        _, unsupported = self.read(block, tmp_path, bored_block_qif(extra=extra))
        assert any("LineProfile 51" in each and "not supported" in each for each in unsupported)
        assert any("Flatness 52" in each and "1999" in each for each in unsupported)

    def test_faces_of_another_part_are_named(self, block: Workpiece, tmp_path: Path) -> None:
        """Read in inches the corners are 25.4 times as far away, and no face of the part is there."""
        plan, unsupported = self.read(block, tmp_path, bored_block_qif("in"))
        assert plan.characteristics == ()
        assert "its model is 25.4 times as large" in read_qif(tmp_path / "block.qif", block).notes[0]
        assert sum("no face of the part" in each for each in unsupported) >= 3
        (tmp_path / "block.qif").write_text(bored_block_qif().replace(" 40 ", " 50 ").replace(" 20 ", " 30 "))
        assert "the file of another part" in read_qif(tmp_path / "block.qif", block).notes[0]

    @pytest.mark.parametrize("text", ["<a/>", "no xml", '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'])
    def test_other_files_are_refused(self, block: Workpiece, tmp_path: Path, text: str) -> None:
        (tmp_path / "bad.qif").write_text(text)
        with pytest.raises(FileError):
            read_qif(tmp_path / "bad.qif", block)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ('"um">300<', '"um">x3<', "Flatness 41 (Flatness): its value is 'x3'"),
            ('"um">300<', '"um">1e999<', "Flatness 41 (Flatness): its value is '1e999'"),
            ("Value>16<", "Value><", "Diameter 42 (Diameter): its value is ''"),
            ("<DatumLabel>A<", "<DatumLabel>a1<", "datum a1: its label has not one or two capital letters"),
            ('"um">300<', '"um">-300<', "Flatness 41 (Flatness): its tolerance is -0.3 mm, and one above 0 is needed"),
            ("<DatumDefinitionId>10<", "<DatumDefinitionId>77<", "refers to the datum with the id 77, which the file"),
            ("<XYZ>0 0 30</XYZ>", "<XYZ>0 0</XYZ>", "coordinates '0 0', not three"),
            ("<XYZ>0 0 30</XYZ>", "<XYZ>a b c</XYZ>", "its coordinate is 'a'"),
            ("<UnitName>mm</UnitName>", "<UnitName></UnitName>", "the file states no unit of length"),
        ],
    )
    def test_an_item_that_cannot_be_read_is_named(
        self, block: Workpiece, tmp_path: Path, old: str, new: str, message: str
    ) -> None:
        text = bored_block_qif()
        assert old in text
        _, unsupported = self.read(block, tmp_path, text.replace(old, new))
        assert any(message in each for each in unsupported), unsupported

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (">0.001<", ">abc<", "factor of a unit is 'abc'"),
            (">0.017453292519943<", ">0<", "factor of the unit 'degree' is 0"),
            ('id="1200"', 'id="1100"', "has the id 1100 more than once"),
        ],
    )
    def test_a_file_without_units_or_unique_ids_is_refused(
        self, block: Workpiece, tmp_path: Path, old: str, new: str, message: str
    ) -> None:
        (tmp_path / "bad.qif").write_text(bored_block_qif().replace(old, new))
        with pytest.raises(FileError, match=message):
            read_qif(tmp_path / "bad.qif", block)

    def test_results_refer_to_the_characteristics_of_the_file(self, block: Workpiece, tmp_path: Path) -> None:
        plan, _ = self.read(block, tmp_path, bored_block_qif())
        done = inspected(block, points_on(block, sigma=1e-5), plan)
        root = ElementTree.fromstring(qif_results(bored_block_qif().encode(), done.result))
        n = f"{{{NAMESPACE}}}"
        item = root.find(f".//{n}DiameterCharacteristicItem")
        measured = root.find(f".//{n}DiameterCharacteristicMeasurement")
        assert item is not None
        assert measured is not None
        assert item.findtext(f"{n}CharacteristicNominalId") == "42"
        assert measured.findtext(f"{n}CharacteristicItemId") == item.get("id")
        assert float(measured.findtext(f"{n}Value") or 0) == pytest.approx(16, abs=0.01)
        ids = [each.get("id") for each in root.iter() if each.get("id")]
        assert len(ids) == len(set(ids))
        assert int(root.get("idMax") or 0) == max(int(each or 0) for each in ids)

    def test_results_have_units_of_the_file(self, block: Workpiece, tmp_path: Path) -> None:
        """A file in inches without the unit mm, and with degrees that have no factor."""
        plan, _ = self.read(block, tmp_path, bored_block_qif())
        done = inspected(block, points_on(block, 5000, 1e-5), only(plan, "Diameter 42")).result
        size = done.characteristics[0]
        angle = size.model_copy(update={"unit": "deg", "source_id": "43"})
        text = bored_block_qif("in").replace("<UnitConversion><Factor>0.017453292519943</Factor></UnitConversion>", "")
        result = done.model_copy(update={"characteristics": (size, angle)})
        values = [
            each for each in ElementTree.fromstring(qif_results(text.encode(), result)).iter() if "}Value" in each.tag
        ]
        assert all(each.get("linearUnit") is None for each in values)
        expected = [(size.value or 0) / 25.4, size.value]
        assert [float(each.text or 0) for each in values] == pytest.approx(expected, abs=1e-6)

    def test_a_file_with_results_is_refused(self, block: Workpiece, tmp_path: Path) -> None:
        """Results cannot be added to it after the scan, so it is refused before."""
        text = bored_block_qif().replace("</Characteristics>", "</Characteristics><Results/>")
        (tmp_path / "done.qif").write_text(text)
        with pytest.raises(FileError, match=r"done\.qif has results"):
            read_qif(tmp_path / "done.qif", block)

    def test_a_boolean_may_be_a_number(self, block: Workpiece, tmp_path: Path) -> None:
        plan, _ = self.read(block, tmp_path, bored_block_qif().replace(">true<", ">1<"))
        assert next(each.upper for each in plan.characteristics if each.name == "Diameter 42") == pytest.approx(16.2)


class TestAlignment:
    NOMINAL = (
        Shape(ShapeKind.PLANE, np.array([0.03, 0.02, 0.03]), np.array([0, 0, 1.0])),
        Shape(ShapeKind.PLANE, np.array([0.03, 0.0, 0.015]), np.array([0, -1.0, 0])),
        Shape(ShapeKind.PLANE, np.array([0.0, 0.02, 0.015]), np.array([-1.0, 0, 0])),
    )

    def test_three_planes_determine_the_motion(self) -> None:
        T = motion_from_vector(np.array([0.003, -0.002, 0.001, 0.02, -0.03, 0.05]), np.zeros(3))
        measured = [moved(shape, np.linalg.inv(T)) for shape in self.NOMINAL]
        assert np.abs(datum_frame(self.NOMINAL, measured, 0.05) - T).max() < 1e-9

    def test_the_first_datum_takes_precedence(self) -> None:
        """The second plane leans by 1 deg; the first remains exactly in place, and the second only in its middle."""
        tilt = motion_from_vector(np.array([0, 0, 0, np.radians(1), 0, 0]), self.NOMINAL[1].point)
        measured = [self.NOMINAL[0], moved(self.NOMINAL[1], tilt), self.NOMINAL[2]]
        T = datum_frame(self.NOMINAL, measured, 0.05)
        assert np.abs(T - np.eye(4)).max() < 1e-9
        other = datum_frame(self.NOMINAL[1::-1], measured[1::-1], 0.05)
        assert np.degrees(np.arccos(other[1, 1])) == pytest.approx(1, abs=1e-6)

    def test_plane_and_two_bores(self) -> None:
        axis = np.array([0, 0, 1.0])
        nominal = [
            self.NOMINAL[0],
            *(Shape(ShapeKind.CYLINDER, np.array([x, 0.02, 0.015]), axis, 0.004) for x in (0.01, 0.05)),
        ]
        T = motion_from_vector(np.array([0.001, 0.002, -0.001, 0.01, 0.02, -0.04]), np.zeros(3))
        measured = [moved(shape, np.linalg.inv(T)) for shape in nominal]
        assert np.abs(datum_frame(nominal, measured, 0.05) - T).max() < 1e-9

    def test_reference_points_are_held_along_their_directions(self) -> None:
        rng = np.random.default_rng(0)
        directions = np.repeat(np.eye(3), (3, 2, 1), axis=0)
        nominal = rng.uniform(0, 0.05, (6, 3))
        T = motion_from_vector(np.array([0.0005, -0.0003, 0.0002, 0.002, -0.001, 0.003]), np.zeros(3))
        back = np.linalg.inv(T)
        measured, normals = transform_points(back, nominal), directions @ back[:3, :3].T
        found, left = fit_reference_points(nominal, directions, np.ones(6), measured, normals)
        assert np.abs(left).max() < 1e-9
        assert np.abs(found - T).max() < 1e-6

    def test_a_cloud_is_located(self, block: Workpiece) -> None:
        """Points 9 mm and 4 deg off the part are moved onto it."""
        points = points_on(block, 10_000)
        T = motion_from_vector(np.array([0.006, -0.004, 0.005, 0.05, -0.03, 0.03]), block.centre)
        options = InspectOptions(search_mm=15, search_deg=6)
        found, words, _ = located(single_view(transform_points(T, points)), block.reference, options)
        assert np.abs(found.points - points).max() < 1e-4
        assert "located" in words

    def test_the_best_fit_ignores_a_larger_bore(self, block: Workpiece) -> None:
        points = points_on(block)
        radial = points[:, :2] - [0.03, 0.02]
        distance = np.linalg.norm(radial, axis=1)
        bore = np.abs(distance - 0.008) < 1e-6
        points[bore, :2] += 0.0002 * radial[bore] / distance[bore, None]
        plan = plan_of(block, alignment="best-fit")
        assert values_of(block, points, plan)["bore: size"] == pytest.approx(16.4, abs=1e-3)
        T, words = align(plan, Association(block.reference, plan), points)
        assert np.abs(T - np.eye(4)).max() < 1e-6
        assert "best fit" in words


class TestValues:
    def test_a_nominal_part_has_nominal_values(self, block: Workpiece) -> None:
        for each in inspected(block, points_on(block)).result.characteristics:
            assert each.verdict == "pass", each.name
            assert each.value == pytest.approx(each.nominal, abs=2e-4), each.name

    def test_values_follow_as_built_errors(self, block: Workpiece) -> None:
        """The bore is 0.1 larger in diameter and moved by 0.3, the back is tilted, the right is 0.15 farther away."""
        points = points_on(block)
        made, radial = points.copy(), points[:, :2] - [0.03, 0.02]
        distance = np.linalg.norm(radial, axis=1)
        bore = np.abs(distance - 0.008) < 1e-6
        made[bore, :2] += 0.00005 * radial[bore] / distance[bore, None] + [0.0003, 0]
        right, back = points[:, 0] > 0.0599999, points[:, 1] > 0.0399999
        made[right, 0] += 0.00015
        made[back, 1] += np.tan(np.radians(0.25)) * (points[back, 2] - 0.015)
        found = values_of(block, made)
        assert found["bore: size"] == pytest.approx(16.1, abs=1e-3)
        assert found["inscribed"] == pytest.approx(16.1, abs=2e-3)
        assert found["bore: position"] == pytest.approx(0.6, abs=3e-3)
        assert found["right: distance"] == pytest.approx(60.15, abs=1e-3)
        assert found["slot: size"] == pytest.approx(60.15, abs=1e-3)
        assert found["right: profile"] == pytest.approx(0.3, abs=2e-3)
        assert abs(found["back: angle"] - 90) == pytest.approx(0.25, abs=2e-3)

    def test_a_lifted_part_has_the_same_values_by_its_datums(self, block: Workpiece) -> None:
        T = motion_from_vector(np.array([3e-4, -2e-4, 1e-4, 1e-3, -2e-3, 1e-3]), block.centre)
        points = points_on(block)
        here, there = (values_of(block, each) for each in (points, transform_points(T, points)))
        assert there == pytest.approx(here, abs=2e-3)

    @pytest.mark.parametrize("scans", [2, pytest.param(6, marks=pytest.mark.slow)])
    def test_uncertainty_covers_the_errors_of_repeated_scans(self, block: Workpiece, scans: int) -> None:
        sigma, within, total = 2e-5, 0, 0
        for seed in range(scans):
            done = inspected(block, points_on(block, 8000, sigma, seed), sigma=sigma)
            for each in done.result.characteristics:
                assert each.value is not None
                assert each.expanded_uncertainty is not None
                within += abs(each.value - each.nominal) <= 1.2 * each.expanded_uncertainty
                total += 1
        assert within >= 0.9 * total

    def test_missing_points_are_the_cause_of_a_missing_value(self, block: Workpiece) -> None:
        points = points_on(block)
        away = np.linalg.norm(points[:, :2] - [0.03, 0.02], axis=1) > 0.0085
        plan = only(plan_of(block), "bore: size", "top: form")
        found = {each.name: each for each in inspected(block, points[away], plan).result.characteristics}
        assert found["bore: size"].verdict == "not measured"
        assert "no point lies on it" in found["bore: size"].cause
        assert found["top: form"].verdict == "pass"

    def test_points_of_another_surface_are_outliers(self, block: Workpiece) -> None:
        points = points_on(block, sigma=1e-5)
        spray = np.array([0.03, 0.02, 0]) + np.array([[0.0075, 0, z] for z in np.linspace(0.005, 0.025, 40)])
        found = inspected(block, np.concatenate([points, spray]), only(plan_of(block), "bore: size"), sigma=1e-5)
        element = next(each for each in found.result.features if each.feature == "bore")
        assert element.n_outliers >= 40
        assert element.diameter_mm == pytest.approx(16, abs=2e-3)

    @pytest.mark.parametrize(
        ("value", "verdict"),
        [(0.0, "pass"), (0.79, "pass"), (0.95, "undecided"), (1.05, "undecided"), (1.21, "fail"), (-1.21, "fail")],
    )
    def test_verdicts_have_guard_bands(self, value: float, verdict: str) -> None:
        assert verdict_of(value, 0.2, -1.0, 1.0) == verdict
        assert verdict_of(value, 0.2, None, None) is Verdict.NO_TOLERANCE

    def test_a_barrel_is_not_straight(self, block: Workpiece) -> None:
        """A bore whose radius grows by 0.05 at its middle: the lines of its surface have zones of nearly 0.05."""
        tables: list[dict[str, object]] = [
            {"name": "bore", "faces": (7,), "characteristic": [{"kind": "straightness", **ZONE}]}
        ]
        points = points_on(block)
        radial = points[:, :2] - [0.03, 0.02]
        distance = np.linalg.norm(radial, axis=1)
        bore = np.abs(distance - 0.008) < 1e-6
        bulge = 5e-5 * (1 - ((points[bore, 2] - 0.015) / 0.015) ** 2)
        points[bore, :2] += bulge[:, None] * radial[bore] / distance[bore, None]
        found = inspected(block, points, plan_of(block, tables)).result.characteristics[0]
        assert found.value == pytest.approx(0.042, abs=6e-3)  # between means near its ends and its middle
        assert "lines" in found.method

    def test_a_form_of_few_points_has_no_value(self, block: Workpiece) -> None:
        points = points_on(block, 1000)
        plan = only(plan_of(block), "bore: roundness", "bore: size")
        found = {each.name: each for each in inspected(block, points, plan).result.characteristics}
        assert "its form needs 20" in found["bore: roundness"].cause
        assert found["bore: size"].value is not None


class TestDegenerateFeatures:
    """Points that hardly determine an element: the value remains, and the report says so."""

    def test_a_cone_of_three_degrees_on_short_lines(self) -> None:
        """141 points on three lines of a cone: its angle is known to a degree only."""
        axis, half, turn = np.array([0, 0, 1.0]), np.radians(1.6), np.linspace(0, np.radians(80), 40)
        radius = 0.02 + np.array([[0.0], [0.005]]) * np.tan(half)
        rim = [np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(40, z)])
               for r, z in zip(radius.ravel(), (0.0, 0.005), strict=True)]  # fmt: skip
        quads = np.arange(39)
        faces = np.concatenate([np.column_stack([quads, quads + 1, quads + 41]),
                                np.column_stack([quads, quads + 41, quads + 40])]).astype(np.int32)  # fmt: skip
        mesh = TriangleMesh(np.concatenate(rim), faces)
        shape = Shape(ShapeKind.CONE, np.zeros(3), axis, 0.02 * np.cos(half), half)
        patch = Patch(kind="cone", point_mm=(0, 0, 0), axis=(0, 0, 1), radius_mm=1000 * shape.size,
                      half_angle_deg=np.degrees(half), triangles=tuple(range(len(faces))))  # fmt: skip
        feature = Feature(name="seat", kind="cone", faces=(1,), datum=None, patches=(patch,))
        size = Characteristic(
            id=1, name="angle of the seat", feature="seat", kind="size", unit="deg", nominal=3.2, lower=3.1, upper=3.3,
            datums=(), to=None, criterion="least-squares", zone=None, source_id=None,
        )  # fmt: skip
        plan = InspectionPlan(
            source="test", features=(feature,), characteristics=(size,), unsupported=(), notes=(), u_over_t=0.1,
            alignment="none", rps=(), edge_mm=0.0, reach_mm=2.0,
        )  # fmt: skip
        along, lines = np.tile(np.linspace(0, 0.005, 47), 3), np.repeat(np.radians([1, 40, 79]), 47)
        points = np.column_stack([np.cos(lines), np.sin(lines), along])
        points[:, :2] *= (0.02 + along * np.tan(half))[:, None]
        noise = 5e-6 * np.random.default_rng(0).standard_normal((141, 1))
        done = inspect_points(
            plan, mesh, single_view(points + noise * shape.normals(points), 5e-6), part="seat", source="points",
            is_simulated=False,
        )  # fmt: skip
        found = done.result.characteristics[0]
        assert found.value is not None
        assert found.expanded_uncertainty is not None
        assert abs(found.value - 3.2) < 1.5 * found.expanded_uncertainty
        assert found.expanded_uncertainty > 0.05
        assert found.verdict == "undecided"
        assert "nearly not determined" in "\n".join(done.section())

    def test_a_distance_of_circles_is_that_of_their_axes(self) -> None:
        """Bores of other depth have their middles at other heights, which does not count."""
        turn, count = np.linspace(0, 2 * np.pi, 60, endpoint=False), np.arange(60)
        rings, patches, points = [], [], []
        for number, (x, low, high) in enumerate(((0.0, 0.0, 0.005), (0.03, 0.0, 0.015))):
            circle = np.column_stack([x + 0.005 * np.cos(turn), 0.005 * np.sin(turn)])
            rings += [np.column_stack([circle, np.full(60, z)]) for z in (low, high)]
            points += [np.column_stack([circle, np.full(60, z)]) for z in np.linspace(low, high, 12)]
            own = tuple(range(120 * number, 120 * number + 120))
            patches.append(
                Patch(
                    kind="cylinder",
                    point_mm=(1000 * x, 0, 500 * (low + high)),
                    axis=(0, 0, 1),
                    radius_mm=5,
                    half_angle_deg=0,
                    triangles=own,
                )
            )
        wall = np.concatenate(
            [
                np.column_stack([count, (count + 1) % 60, count + 60]),
                np.column_stack([(count + 1) % 60, (count + 1) % 60 + 60, count + 60]),
            ]
        )
        mesh = TriangleMesh(np.concatenate(rings), np.concatenate([wall, wall + 120]).astype(np.int32))
        features = [
            Feature(name=name, kind="circle", faces=(1,), datum=None, patches=(patch,))
            for name, patch in zip(("one", "two"), patches, strict=True)
        ]
        distance = Characteristic(
            id=1,
            name="distance",
            feature="one",
            kind="distance",
            unit="mm",
            nominal=30,
            lower=29.9,
            upper=30.1,
            datums=(),
            to="two",
            criterion="least-squares",
            zone=None,
            source_id=None,
        )
        plan = InspectionPlan(
            source="test",
            features=tuple(features),
            characteristics=(distance,),
            unsupported=(),
            notes=(),
            u_over_t=None,
            alignment="none",
            rps=(),
            edge_mm=0.0,
            reach_mm=2.0,
        )
        done = inspect_points(
            plan, mesh, single_view(np.concatenate(points)), part="bores", source="points", is_simulated=False
        )
        assert done.result.characteristics[0].value == pytest.approx(30, abs=1e-4)  # fmt: skip

    @pytest.mark.parametrize(("half_deg", "is_weak"), [(10, True), (45, False), (180, False)])
    def test_a_short_arc_of_a_bore(self, block: Workpiece, half_deg: float, is_weak: bool) -> None:
        points = points_on(block, 60_000, 1e-5)
        off = points[:, :2] - [0.03, 0.02]
        other = np.linalg.norm(off, axis=1) > 0.0081
        arc = np.abs(np.degrees(np.arctan2(off[:, 1], off[:, 0]))) < half_deg
        done = inspected(block, points[other | arc], only(plan_of(block), "bore: size"), sigma=1e-5)
        found = done.result.characteristics[0]
        assert ("nearly not determined" in found.note) == is_weak
        assert found.value is not None
        assert found.expanded_uncertainty is not None
        assert abs(found.value - 16) < 1.5 * found.expanded_uncertainty

    @pytest.mark.parametrize("criterion", ["inscribed", "circumscribed"])
    @pytest.mark.parametrize(("kind", "half_deg", "has_value"), [
        ("cylinder", 80, False), ("cylinder", 120, True), ("circle", 80, False), ("circle", 120, True)])  # fmt: skip
    def test_an_extremal_diameter_needs_points_all_around(
        self, block: Workpiece, criterion: str, kind: str, half_deg: float, has_value: bool
    ) -> None:
        """The largest circle inside an arc below a half turn has no limit, and the smallest one around it is smaller.

        Of a circle, points anywhere along the bore have the deviation of their radius.
        """
        size = {"kind": "size", "criterion": criterion, **LIMITS}
        plan = plan_of(block, [{"name": "bore", "faces": (7,), "kind": kind, "characteristic": [size]}])
        points = points_on(block, 60_000, 1e-5)
        off = points[:, :2] - [0.03, 0.02]
        on_bore = np.linalg.norm(off, axis=1) < 0.0081
        arc = np.abs(np.degrees(np.arctan2(off[:, 1], off[:, 0]))) < half_deg
        done = inspected(block, points[on_bore & arc], plan, sigma=1e-5)
        found = done.result.characteristics[0]
        assert ("needs them all around" in found.cause) != has_value
        assert np.abs(done.features["bore"].patches[0].deviations).max() < 3e-5
        if has_value:
            assert found.expanded_uncertainty is not None
            assert 0.005 < found.expanded_uncertainty < 0.03  # about three standard deviations of a cell on each side
            assert found.value == pytest.approx(16, abs=1.5 * found.expanded_uncertainty)
        else:
            assert found.value is None

    @pytest.mark.parametrize("criterion", ["inscribed", "circumscribed"])
    @pytest.mark.parametrize(("kind", "gap"), [("cylinder", 0.1), ("cylinder", 0.02), ("circle", 0.1)])
    def test_an_extremal_cylinder_may_not_tilt_between_its_points(
        self, block: Workpiece, criterion: str, kind: str, gap: float
    ) -> None:
        """Points on one side of the upper part and on the other side of the lower part hold a circle only.

        A cylinder tilts between them, and the inscribed one becomes as large as the tilt may be.
        """
        size = {"kind": "size", "criterion": criterion, **LIMITS}
        plan = plan_of(block, [{"name": "bore", "faces": (7,), "kind": kind, "characteristic": [size]}])
        points = points_on(block, 60_000, 1e-5)
        off, height = points[:, :2] - [0.03, 0.02], points[:, 2] / 0.03 - 0.5
        on_bore = (np.linalg.norm(off, axis=1) < 0.0081) & (np.abs(height) > gap)
        arc = np.abs(np.degrees(np.arctan2(off[:, 1], np.sign(height) * off[:, 0]))) < 80
        found = inspected(block, points[on_bore & arc], plan, sigma=1e-5).result.characteristics[0]
        assert ("needs them all around" in found.cause) == (kind == "cylinder")
        if kind == "cylinder":
            assert found.value is None
            assert found.verdict == "not measured"
        else:
            assert found.value is not None

    def test_a_datum_plane_of_nearly_collinear_points(self, block: Workpiece) -> None:
        """Only what depends on the tilt of the datum about the line of its points is in doubt."""
        points = points_on(block, 60_000, 1e-5)
        line = (points[:, 2] < 0.0299) | (np.abs(points[:, 0] - 0.01) < 0.0003)
        plan = only(plan_of(block), "bore: perpendicularity", "bore: position", "bore: size", "right: distance")
        found = {each.name: each for each in inspected(block, points[line], plan, sigma=1e-5).result.characteristics}
        assert "on top counts" in found["bore: perpendicularity"].note
        assert found["bore: perpendicularity"].verdict != "fail"
        assert "nearly" not in found["bore: size"].note + found["right: distance"].note
        for name in ("bore: perpendicularity", "bore: position"):
            each = found[name]
            assert each.value is not None
            assert each.expanded_uncertainty is not None
            assert each.value <= each.expanded_uncertainty


class TestCommonDatum:
    def test_the_axis_is_the_line_of_least_squares_through_the_ends(self) -> None:
        """The oracle fits two straight lines, x and y over the height."""
        rng, z = np.random.default_rng(3), np.array([0, 0, 1.0])
        nominal = Shape(ShapeKind.CYLINDER, np.array([0.01, 0.02, 0]), z, 0.005)
        tilts = rng.normal(0, 1e-3, (2, 2))
        shapes = [Shape(ShapeKind.CYLINDER, np.append(rng.normal([0.01, 0.02], 1e-4), height),
                        np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0]), 0.005)
                  for height, tilt in zip((0.0, 0.08), tilts, strict=True)]  # fmt: skip
        ends = [np.array([[0.01, 0.02, h], [0.01, 0.02, h + 0.02]]) for h in (0.0, 0.08)]
        found = common_element(nominal, shapes, ends)
        heights = np.array([0, 0.02, 0.08, 0.1])
        places = np.array([
            shape.point + (h - shape.point[2]) / shape.axis[2] * shape.axis
            for shape, pair in zip(shapes, heights.reshape(2, 2), strict=True) for h in pair
        ])  # fmt: skip
        for k in range(2):
            slope, start = np.polyfit(heights, places[:, k], 1)
            assert found.axis[k] / found.axis[2] == pytest.approx(slope, abs=1e-7)
            at = found.point + (0.05 - found.point[2]) / found.axis[2] * found.axis
            assert at[k] == pytest.approx(start + 0.05 * slope, abs=1e-7)

    def test_coplanar_planes_are_one_plane(self) -> None:
        nominal = Shape(ShapeKind.PLANE, np.zeros(3), np.array([0, 0, 1.0]))
        square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
        lower = Shape(ShapeKind.PLANE, np.array([0, 0, -1e-3]), np.array([0, 0, 1.0]))
        upper = Shape(ShapeKind.PLANE, np.array([0, 0, 1e-3]), np.array([0, 0, 1.0]))
        found = common_element(nominal, [lower, upper], [square, square + np.array([4, 0, 0])])
        x, z = np.array([0, 0, 1, 1, 4, 4, 5, 5]), 1e-3 * np.repeat([-1, 1], 4)
        assert -found.axis[0] / found.axis[2] == pytest.approx(np.polyfit(x, z, 1)[0], abs=1e-8)

    def test_a_runout_refers_to_the_common_axis(self, block: Workpiece) -> None:
        """The top leans by 0.1 deg towards the bore, which is both datums; cell means end about 3 inside its edges."""
        tables: list[dict[str, object]] = [
            {"name": "a", "faces": (7,), "datum": "A"},
            {"name": "b", "faces": (7,), "datum": "B"},
            {"name": "top", "faces": (6,), "characteristic": [
                {"kind": "total-runout", "datums": ("A-B",), **ZONE}]},
        ]  # fmt: skip
        plan = plan_of(block, tables)
        assert [each.name for each in plan.features_of(plan.characteristics[0])] == ["top", "a", "b"]
        points = points_on(block)
        top = points[:, 2] > 0.0299
        points[top, 2] += np.tan(np.radians(0.1)) * (points[top, 0] - 0.03)
        found = values_of(block, points, plan)
        assert found["top: total-runout"] == pytest.approx(55 * np.tan(np.radians(0.1)), abs=4e-3)

    def test_features_without_common_axis_or_plane_are_refused(self, block: Workpiece) -> None:
        tables: list[dict[str, object]] = [
            {"name": "top", "faces": (6,), "datum": "A", "characteristic": []},
            {"name": "front", "faces": (3,), "datum": "B"},
            {"name": "bore", "faces": (7,), "characteristic": [{"kind": "position", "datums": ("A-B",), **ZONE}]},
        ]
        with pytest.raises(SceneError, match="neither one axis nor one plane"):
            plan_of(block, tables)

    def test_a_common_datum_of_a_qif_file_is_read(self, block: Workpiece, tmp_path: Path) -> None:
        def simple(number: int) -> str:
            return f"<SimpleDatum><DatumDefinitionId>{number}</DatumDefinitionId></SimpleDatum>"

        parts = "".join(f"<Datum>{simple(9 + k)}<SequenceNumber>{k}</SequenceNumber></Datum>" for k in (1, 2))
        text = bored_block_qif().replace("<SimpleDatum>\n", "<SimpleDatum>")
        assert simple(10) in text
        text = text.replace(simple(10), f'<CompoundDatum n="2">{parts}</CompoundDatum>')
        text = text.replace(
            "</DatumDefinition></DatumDefinitions>",
            '</DatumDefinition><DatumDefinition id="11"><DatumLabel>B</DatumLabel><FeatureNominalIds n="1">'
            "<Id>1200</Id></FeatureNominalIds></DatumDefinition></DatumDefinitions>",
        )
        (tmp_path / "block.qif").write_text(text)
        content = read_qif(tmp_path / "block.qif", block)
        datums = {each.name: each.datums for table in content.features for each in table.characteristic}
        assert datums["Position 43"] == ("A-B",)


class TestSeveralSetups:
    def test_the_registration_of_set_ups_is_a_term_of_the_uncertainty(self, block: Workpiece) -> None:
        """Half of the block is measured in another set-up, whose place is uncertain by 0.01 along x."""
        points = points_on(block, sigma=2e-6)
        first = points[:, 0] > 0.03
        sd, plan = 1e-5, plan_of(block)
        # A motion of the whole part changes none of these values.
        plan = only(plan, *(
            each.name for each in plan.characteristics
            if each.datums or (each.kind in ("size", "distance", "angle") and each.name != "inscribed")
        ))  # fmt: skip

        def uncertainties(placements: tuple[tuple[float, float], tuple[float, float]]) -> dict[str, float]:
            both = points_of_setups([single_view(points[own], 2e-6) for own in (first, ~first)], placements)
            done = inspect_points(plan, block.reference, both, part="b", source="p", is_simulated=True)
            return {each.name: each.expanded_uncertainty or 0.0 for each in done.result.characteristics}

        exact, uncertain = uncertainties(((0, 0), (0, 0))), uncertainties(((sd, 0), (sd, 0)))
        assert uncertain["right: distance"] == pytest.approx(2000 * sd * np.sqrt(2), rel=0.02)
        assert uncertain["right: distance"] > 20 * exact["right: distance"]
        one = points_of_setups([single_view(points, 2e-6)], [(sd, 1e-4)])
        alone = inspect_points(plan, block.reference, one, part="b", source="p", is_simulated=True)
        for each in alone.result.characteristics:
            assert each.expanded_uncertainty == pytest.approx(exact[each.name], rel=0.1, abs=1e-4), each.name


class TestResults:
    def test_characteristics_of_a_scene_have_a_qif_document(self, block: Workpiece) -> None:
        """Every reference in it has its target, and its numbers of items are right."""
        written = dict[str, bytes]()
        done = inspected(block, points_on(block, 8000, 1e-5))
        done.write(written.__setitem__, None)
        root = ElementTree.fromstring(written["results.qif"])
        n = f"{{{NAMESPACE}}}"
        ids = [each.get("id") for each in root.iter() if each.get("id")]
        assert len(ids) == len(set(ids))
        assert int(root.get("idMax") or 0) == max(int(each or 0) for each in ids)
        referring = [each.text for each in root.iter() if each.tag.endswith("Id") and each.tag != f"{n}QPId"]
        assert referring
        assert set(referring) <= set(ids)
        for each in root.iter():
            if each.get("n"):
                assert int(each.get("n") or 0) == len(each), each.tag
        values = [float(each.findtext(f"{n}Value") or "nan") for each in root.iter() if "Measurement" in each.tag
                  and each.tag.endswith("CharacteristicMeasurement")]  # fmt: skip
        expected = [each.value for each in done.result.characteristics if each.value is not None]
        assert values == pytest.approx(expected, abs=1e-6)
        assert all(each.source_id is None for each in done.result.characteristics)

    def test_the_table_has_one_row_for_each_characteristic(self, block: Workpiece) -> None:
        done = inspected(block, points_on(block, 5000, 1e-5))
        lines = as_csv(done.result).splitlines()
        assert len(lines) == 1 + len(done.plan.characteristics)
        assert all(line.endswith(",yes") for line in lines[1:])
        tables = [{"name": "bore", "faces": (7,), "characteristic": [{"kind": "size", "lower": -0.127, "upper": 0.2}]}]
        small = plan_of(block, tables).model_copy()
        size = small.characteristics[0].model_copy(update={"nominal": 11.1252, "lower": 11.1252 - 0.127})
        small = small.model_copy(update={"characteristics": (size,)})
        assert ",11.1252,10.9982," in as_csv(inspected(block, points_on(block, 5000, 1e-5), small).result)
        assert "Simulated points" in "\n".join(done.section())

    def test_a_single_limit_is_no_tolerance(self, block: Workpiece) -> None:
        """U / T of a diameter with only a largest value is not U divided by the diameter."""
        done = inspected(block, points_on(block, 5000, 1e-5), only(plan_of(block), "bore: size")).result
        (size,) = done.characteristics
        assert size.u_over_t == pytest.approx((size.expanded_uncertainty or 0) / 0.4)
        for name in ("lower", "upper"):
            assert size.model_copy(update={name: None}).u_over_t is None

    @pytest.mark.usefixtures("drawn_pictures")
    def test_names_are_no_formulas(self, block: Workpiece, tmp_path: Path) -> None:
        """Dollar signs in names and causes are characters of the report."""
        done = inspected(block, points_on(block, 5000, 1e-5), only(plan_of(block), "bore: size")).result
        (size,) = done.characteristics
        odd = size.model_copy(update={"name": "a$b_$", "cause": "no $x^$"})
        result = done.model_copy(update={"part": "block$1_$", "characteristics": (odd,)})
        Image.new("RGB", (8, 8)).save(tmp_path / "features.png")
        pictures.report_pdf(tmp_path / "report.pdf", tmp_path / "features.png", result)
        assert (tmp_path / "report.pdf").stat().st_size > 1000

    def test_the_page_and_the_files_are_equal_in_every_run(self, block: Workpiece) -> None:
        points = points_on(block, 5000, 1e-5)
        first, second = dict[str, bytes](), dict[str, bytes]()
        for files in (first, second):
            write: Callable[[str, bytes], None] = files.__setitem__
            inspected(block, points).write(write, None)
        assert sorted(first) == [
            "characteristics.csv", "feature_points.csv", "features.html", "features.json", "results.qif",
        ]  # fmt: skip
        assert first == second
        assert b"bore: position" in first["features.html"]


class TestVerdictRates:
    """Verdicts of measured values whose true value is near a limit; U is twice the standard deviation."""

    N_SCANS, SIGMA = 60, 5e-5

    def test_rates_beside_limits(self, block: Workpiece) -> None:
        """Half a U beside a limit 84 % of the scans are undecided (normal distribution); at 3 U all verdicts are right.

        The 120 values are two independent characteristics of 60 scans: a share of 84 % is known to 3.3 points.
        """
        tables = [
            {"name": "left", "faces": (1,)},
            {"name": "right", "faces": (2,), "characteristic": [{"kind": "distance", "to": "left", **LIMITS}]},
            {"name": "bore", "faces": (7,), "characteristic": [{"kind": "size", **LIMITS}]},
        ]
        plan, true = plan_of(block, tables), np.array([60.0, 16.0])
        scans = [points_on(block, 4000, self.SIGMA, seed) for seed in range(self.N_SCANS)]
        rows = [inspected(block, points, plan, self.SIGMA).result.characteristics for points in scans]
        error = np.array([[each.value for each in row] for row in rows]) - true
        uncertainty = np.array([[each.expanded_uncertainty for each in row] for row in rows])
        assert np.abs(error).max() < 0.1

        def share(distance: float, verdict: Verdict) -> float:
            """Return the share of a verdict, with a true value a number of U below the upper limit."""
            limits = distance * uncertainty.mean(axis=0)
            found = [
                verdict_of(value, u, -np.inf, limit)
                for row, us in zip(error, uncertainty, strict=True)
                for value, u, limit in zip(row, us, limits, strict=True)
            ]
            return float(np.mean([each is verdict for each in found]))

        assert 0.74 < share(0.5, Verdict.UNDECIDED) < 0.94
        assert 0.74 < share(-0.5, Verdict.UNDECIDED) < 0.94
        assert share(3.0, Verdict.PASS) == 1.0
        assert share(-3.0, Verdict.FAIL) == 1.0


FINE = LaserArea(fov_deg=(30.0, 30.0), resolution_deg=(0.25, 0.25))


def views_of_block() -> Floats:
    """Return views (n, 4, 4) of the block from above, from the sides and from below."""
    found = []
    middle = np.array([0.03, 0.02, 0.015])
    for at in ((0.1, 0, 1), (1, 0, 0.4), (-1, 0, 0.4), (0, 1, 0.4), (0, -1, 0.4), (0.1, 0.1, -1)):
        position = middle + 0.2 * np.array(at) / np.linalg.norm(at)
        z = (middle - position) / np.linalg.norm(middle - position)
        x = np.cross([0.0, 1.0, 0.1], z)
        x /= np.linalg.norm(x)
        T = np.eye(4)
        T[:3] = np.column_stack([x, np.cross(z, x), z, position])
        found.append(T)
    return np.array(found)


@functools.cache
def predicted_features(part: Workpiece, count: int) -> dict[str, MeasuredFeature]:
    """Return the features as the first views will measure them."""
    caster = EmbreeRayCaster(part.reference.vertices, part.reference.faces)
    views = PlannedViews(views_of_block()[:count, None], FINE, [caster])
    return predict_features(association_of(part), [views])


class TestPrediction:
    def predict(
        self, block: Workpiece, count: int = 6, pose: float = 0.0, **settings: object
    ) -> dict[str, tuple[float | None, str]]:
        features, sd = predicted_features(block, count), np.tile([pose, 0.0], (count, 1))
        found = predicted_measurements(plan_of(block, **settings), association_of(block), features, sd)
        return {each.characteristic.name: (each.expanded_uncertainty, each.cause) for each in found}

    def test_pose_errors_and_fewer_views_raise_the_uncertainty(self, block: Workpiece) -> None:
        exact, moved_poses = self.predict(block), self.predict(block, pose=2e-5)
        size, worse = exact["right: distance"][0], moved_poses["right: distance"][0]
        assert size is not None
        assert worse is not None
        assert worse > 5 * size
        assert worse == pytest.approx(2e-2 * 2 * np.sqrt(2), rel=0.15)  # two faces, each by about one view

    def test_the_main_source_of_the_variance_is_named(self, block: Workpiece) -> None:
        """Pose errors of 20 um move planes by much more than the noise of thousands of points."""
        exact, moved_poses = (self.predict(block, pose=pose, u_over_t=1e-9) for pose in (0.0, 2e-5))
        for name in ("right: distance", "slot: size"):
            assert "pose errors" not in exact[name][1]
            assert moved_poses[name][1].endswith("of the variance is from pose errors")
        assert "pose errors" not in moved_poses["top: form"][1]  # each view measures all of it

    @pytest.mark.parametrize("scans", [45, pytest.param(60, marks=pytest.mark.slow)])
    def test_predicted_uncertainty_is_that_of_repeated_scans(self, scans: int) -> None:
        """Quantiles of 60 scans with noise and pose errors are known to about 12 %, of 45 to about 14 %."""
        bench = block_bench()
        coarse = LaserArea(fov_deg=(30.0, 30.0), resolution_deg=(0.7, 0.7))
        bench = replace(bench, scanner=coarse)
        values, stated = scan_values(bench, scans, n_stated=1)
        for k, each in enumerate(bench.predict()):
            if each.characteristic.name == "bore: form":  # too few points for a quantile of its largest cells
                continue
            error = np.abs(values[:, k] - each.characteristic.nominal)
            assert each.expanded_uncertainty is not None
            assert stated[0, k] == pytest.approx(each.expanded_uncertainty, rel=0.25), each.characteristic.name
            assert np.quantile(error, 0.95) == pytest.approx(each.expanded_uncertainty, rel=0.35)

    @pytest.mark.parametrize(("name", "words"), [
        ("right: distance", "is from left"), ("bore: position", "mostly A (top)"),
        ("right: profile", "mostly C (left)"),
    ])  # fmt: skip
    def test_contributions_are_the_variances_without_the_other_features(
        self, block: Workpiece, name: str, words: str
    ) -> None:
        """The noise of one feature at a time gives its share; that of the datums A, B, C is ten times as large."""
        plan, points = plan_of(block), points_on(block, 20_000)
        association = Association(block.reference, plan)
        c = next(each for each in plan.characteristics if each.name == name)
        features = plan.features_of(c)

        def evaluated(names: list[str]) -> Evaluation:
            measured, sigma = single_view(points), np.zeros(len(points))
            rows = association.rows(points)
            for each in names:
                sigma[np.concatenate(rows[each])] = 1e-4 if plan.feature(each).datum else 1e-5
            found = measure_features(association, replace(measured, sigma=sigma))
            return Evaluation(plan, found, association.nearest, np.zeros((1, 2)))

        every = [each.name for each in features]
        shares = evaluated(every).measure(c).contributions
        variances = {each: (evaluated([each]).measure(c).expanded_uncertainty or 0.0) ** 2 for each in every}
        largest = max(variances, key=variances.__getitem__)
        assert max(shares, key=shares.__getitem__) == largest
        if name == "right: distance":  # others are quantiles of a largest deviation
            assert shares == pytest.approx({each: one / sum(variances.values()) for each, one in variances.items()})
        assert main_source(plan, c, shares).endswith(words)
        assert "of the variance from points is from" in main_source(plan, c, shares)

    def test_views_are_demanded_for_what_makes_a_value_uncertain(self, block: Workpiece) -> None:
        """A datum of which too little is measured, then the datum that has most of the variance."""
        plan, views = plan_of(block), views_of_block()
        association = Association(block.reference, plan)
        caster = EmbreeRayCaster(block.reference.vertices, block.reference.faces)
        scanner = LaserArea(fov_deg=(30.0, 30.0), resolution_deg=(0.5, 0.5))

        def raised(views: Floats, name: str, shares: dict[str, float]) -> set[str]:
            features = predict_features(association, [PlannedViews(views[:, None], scanner, [caster])])
            c = next(each for each in plan.characteristics if each.name == name)
            predicted = Measurement(c, 1.0, 1.0, Verdict.UNDECIDED, "", contributions=shares)
            demand = np.ones(len(block.reference.faces), dtype=np.int64)
            _raise_demand(demand, plan, predicted, features, association, 1.8)
            return {
                each.name for each in plan.features
                if all((demand[own.triangles] > 1).all() for own in association.surfaces[each.name])
            }  # fmt: skip

        shares = {"right": 0.05, "top": 0.85, "front": 0.05, "left": 0.05}
        assert raised(views, "right: profile", shares) == {"top"}
        assert raised(views[[0, 1, 3, 4, 5]], "right: profile", shares) == {"left"}

    def test_triangles_of_the_same_features_have_one_number(self, block: Workpiece) -> None:
        """A width shares its faces with two planes; the halves of its surface are separate."""
        association = Association(block.reference, plan_of(block))
        number = _feature_sets(association)
        names = [
            {name for name, surfaces in association.surfaces.items() if any(k in own.triangles for own in surfaces)}
            for k in range(len(number))
        ]
        assert {"left", "slot"} in names
        for one, other in itertools.combinations(range(len(number)), 2):
            assert (number[one] == number[other]) == (names[one] == names[other])

    def test_a_requirement_that_is_not_met_is_noted_with_the_views(self, block: Workpiece) -> None:
        """Three views are demanded of a datum, and one of the others; then one of all."""
        plan, association = plan_of(block), Association(block.reference, plan_of(block))
        c = next(each for each in plan.characteristics if each.name == "right: profile")
        predicted = [Measurement(c, 1.0, 1.0, Verdict.UNDECIDED, "", contributions={"top": 0.9, "right": 0.1})]
        demand = np.ones(len(block.reference.faces), dtype=np.int64)
        begin = "right: profile: the requirement is not met with"
        assert next(_causes(plan, predicted, [1.5], association, demand)).startswith(f"{begin} 1 view of each sample")
        demand[association.surfaces["top"][0].triangles] = 3
        assert next(_causes(plan, predicted, [1.5], association, demand)).startswith(f"{begin} 3 views of each sample")
        demand[association.surfaces["bottom"][0].triangles] = 5  # no feature of the characteristic
        assert next(_causes(plan, predicted, [1.5], association, demand)).startswith(f"{begin} 3 views of each sample")
        assert list(_causes(plan, predicted, [1.0], association, demand)) == []
        assert "mostly A (top)" in next(_causes(plan, predicted, [5.2], association, demand))

    def test_a_feature_that_no_view_measures_is_named(self, block: Workpiece) -> None:
        _, cause = self.predict(block, 5)["bottom: parallelism"]
        assert "no view of the plan measures it" in cause

    def test_predicted_points_are_those_of_a_scan(self, block: Workpiece) -> None:
        from cell.world import virtual_scan

        predicted, views = predicted_features(block, 6), views_of_block()
        caster = EmbreeRayCaster(block.reference.vertices, block.reference.faces)
        scans = [virtual_scan.scan(FINE, T, caster, block.reference).points for T in views]
        measured = measure_features(association_of(block), single_view(np.concatenate(scans)))
        for name in ("top", "front", "right", "bore"):
            count = predicted[name].patches[0].n_points
            assert count == pytest.approx(measured[name].patches[0].n_points, rel=0.1), name
