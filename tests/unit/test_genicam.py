"""GenICam devices: the virtual devices of the package `genicam`, and frames that those do not send.

The virtual device sends a square on a plane, and it states its coordinates in millimetres: A is the column and B the
row of a pixel, C is 0 on the plane, and on the square the distance of its upper left corner from the first pixel. It
has no holes, no confidence, no whole numbers and no trigger: these come from frames of bytes, expanded by harvesters,
and a node map that GenApi makes of XML.
"""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.errors import FileError, UsageError
from cell.robot.arm import kinematics_of
from cell.robot.model import load
from cell.runs.run import read_scan
from cell.scan import execution
from cell.scan.acquisition import Context
from cell.scan.execution import ExecutionPlan, Segment
from cell.scan.genicam import DepthGrid, GenICam, _capture, _FrameError, read_frame
from cell.scanners.laser_area import LaserArea
from drivers.clock import SimulatedClock
from drivers.setpoints import from_rad, to_rad
from tests.support.arms import HOME
from tests.support.fixture_types import RunCommand
from tests.support.runs import RecordingDriver, ball_cell, new_execution

genicam = pytest.importorskip("genicam", reason="the extra genicam is not installed", exc_type=ImportError)
harvesters = pytest.importorskip("harvesters.core", reason="the extra genicam is not installed", exc_type=ImportError)

PRODUCER = Path(genicam.__file__).parent / "viky.cti"
SCANNER = LaserArea(resolution_deg=(3.0, 3.0))


def open_device(
    argument: str, *, timeout_s: float = 5.0, units: str = "mm", notes: list[str] | None = None, cell: Any = None
) -> GenICam:
    """Return the source of a device."""
    options = {"points_frame": "scanner", "points_units": units, "acquire_timeout_s": timeout_s}
    notify = (lambda note: None) if notes is None else notes.append
    run_cell = cell or SimpleNamespace(scanner=SCANNER)
    return GenICam(argument, Context(run_cell, options, 0, Path(), notify))


def square_at(points: np.ndarray, shape: tuple[int, int], size: int) -> np.ndarray:
    """Return the (P, 3) points [mm] of the virtual device with the square where `points` have it."""
    rows, columns = np.indices(shape)
    raised = np.argwhere(points[:, 2].reshape(shape) > 0)
    row, column = raised.min(axis=0)
    on_square = (rows >= row) & (rows < row + size) & (columns >= column) & (columns < column + size)
    C = np.where(on_square, np.float32(np.hypot(row, column)), 0.0)
    return np.stack([columns, rows, C], axis=-1).reshape(-1, 3).astype(np.float64)


def test_twenty_scans_of_a_virtual_device_equal_its_pattern(tmp_path: Path) -> None:
    """Points, poses and grid of each view are those of the device and of the plan."""
    cell, folder = ball_cell(SCANNER), new_execution(tmp_path)
    source = open_device(f"VikyTL_DEV_green?producer={PRODUCER}&Width=120&Height=100&BouncingBallSize=31", cell=cell)
    rng = np.random.default_rng(4)
    ends = to_rad(from_rad(HOME + rng.uniform(-0.1, 0.1, (20, 6))))
    segments = [Segment(end[None], k + 1, 70 + k) for k, end in enumerate(ends)] + [Segment(HOME[None], 0, -1)]
    plan = ExecutionPlan(HOME, tuple(segments), 1.0)
    execution.drive(plan, RecordingDriver(), cell, source, folder, speed=0.5, clock=SimulatedClock())
    T_object_base = np.linalg.inv(cell.scene.T_base_object)
    for k, end in enumerate(ends):
        scan = read_scan(folder.path / "scans" / f"{k + 1:04d}.npz")
        assert (scan.stop, scan.view, scan.frame) == (k + 1, 70 + k, "scanner")
        assert scan.source == "GenICam device Machine Vision Games Ltd. Viky 1 (scanner frame, mm)"
        T = T_object_base @ kinematics_of(load()).forward(end[None])[0]
        np.testing.assert_allclose(scan.T_reported, T, atol=1e-12)
        assert scan.stored["grid_shape"].tolist() == [100, 120]
        assert (scan.stored["pixel"] == np.arange(1, 12_000)).all()  # pixel 0 is at the origin
        local = np.zeros((12_000, 3))
        local[1:] = np.round(1000 * (scan.points @ T[:3, :3] - T[:3, 3] @ T[:3, :3]), 6)
        assert (local[:, 2] > 0).sum() == 31 * 31
        np.testing.assert_allclose(local, square_at(local, (100, 120), 31), atol=2e-6)


def test_the_square_is_where_the_picture_of_the_device_has_it() -> None:
    """Coordinates and picture of one frame agree, in a grid of the picture's rows and columns."""
    harvester = harvesters.Harvester()
    harvester.add_file(str(PRODUCER))
    harvester.update()
    camera = harvester.create({"serial_number": "2"})
    try:
        nodes = camera.remote_device.node_map
        nodes.ComponentSelector.value = "Range"
        nodes.ComponentEnable.value, nodes.Width.value, nodes.Height.value = True, 200, 150
        camera.start()
        for _ in range(5):
            with camera.fetch(timeout=5) as frame:
                grid = read_frame(frame.payload.components, nodes)
                picture = np.array(frame.payload.components[0].data).reshape(150, 200, 4)
            assert grid.unit == "mm"
            assert grid.confidence is None
            is_drawn = (picture[..., :3] != 255).any(axis=2)
            assert is_drawn.sum() == 400
            assert ((grid.points[..., 2] > 0) == is_drawn).all()
            assert (grid.points.reshape(-1, 3) == square_at(grid.points.reshape(-1, 3), (150, 200), 20)).all()
        camera.stop()
    finally:
        camera.destroy()
        harvester.reset()


def test_a_scan_command_uses_the_device(planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """`cell scan --acquire genicam:` scans a view; its file keeps grid and pixels."""
    run = Path(shutil.copytree(planned, tmp_path / "run"))
    shutil.rmtree(run / "executions", ignore_errors=True)
    acquire = f"genicam:Viky?producer={PRODUCER}"
    options = ("--points-frame", "scanner", "--points-units", "mm", "--no-register")
    refused = run_cell("scan", run, "--acquire", acquire, *options, cwd=tmp_path, code=2)
    assert "several GenICam devices match --acquire genicam:Viky" in refused.stderr
    assert not (run / "executions").exists()
    acquire = f"genicam:0?producer={PRODUCER}&Width=100&Height=100"
    run_cell("scan", run, "--view", 2, "--acquire", acquire, *options, cwd=tmp_path, code=0)
    scan = read_scan(run / "executions" / "0001" / "scans" / "0002.npz")
    assert scan.stored["grid_shape"].tolist() == [100, 100]
    assert len(scan.points) == len(scan.stored["pixel"]) == 9_999


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("?producer={}", "several GenICam devices match .* found: VikyTL_DEV_red .*VikyTL_DEV_green .*VikyTL_DEV_blue"),
        ("7?producer={}", "no GenICam device matches --acquire genicam:7; .* found: VikyTL_DEV_red"),
        ("0?producer={}&Width=20", "refuses Width=20: .*greater than Min = 100"),
        ("0?producer={}&ComponentSelector=Depth", "must be one of: Intensity, Range"),
        ("0?producer={}&ExposureTime=20", "no feature ExposureTime; own options are producer and min_confidence"),
        ("0?producer={}&min_confidence=high", "min_confidence=high must be a number"),
        ("0?producer=/none.cti", "/none.cti is no file"),
        ("0?producer=/etc/hostname", "genicam:0.* fails: /etc/hostname: "),
        ("0", "GENICAM_GENTL64_PATH names no folder"),
    ],
)
def test_devices_and_settings_that_do_not_exist(argument: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is refused with the choices before the arm moves."""
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    with pytest.raises(UsageError, match=words):
        open_device(argument.format(PRODUCER))


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message has the command that installs it."""
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(UsageError, match=r"pip install 'scan-cell\[genicam\]'"):
        open_device("0")


def test_an_installed_producer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Producers are those of the folders in the environment variable of GenTL."""
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(PRODUCER.parent))
    assert "Viky 1" in open_device("1").source


def test_another_unit_and_a_line_sensor_are_refused() -> None:
    """Inches for millimetres would be a wrong scale, and a line sensor moves."""
    with pytest.raises((UsageError, FileError), match="sends coordinates in mm, and --points-units is in"):
        open_device(f"0?producer={PRODUCER}", units="in").take(SimpleNamespace(stop=1))
    line = SimpleNamespace(scanner=SimpleNamespace(T_view_scanner=np.eye(4)[None]))
    with pytest.raises(UsageError, match="line sensor"):
        open_device(f"0?producer={PRODUCER}", cell=line)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("&ComponentSelector=Range&ComponentEnable=0", "sends RGBa8, and no range"),
        ("&GenDCStreamingMode=On", "GenDC"),
        ("&AcquisitionFrameRate=1", "no complete frame within 0.1 s"),
    ],
)
def test_a_view_without_a_usable_frame_is_missing(settings: str, words: str) -> None:
    """The execution continues, and the note has the cause; the next view is scanned."""
    notes: list[str] = []
    source = open_device(f"0?producer={PRODUCER}{settings}", timeout_s=0.1, notes=notes)
    assert source.take(SimpleNamespace(stop=3)) is None
    assert words in notes[0]
    assert notes[0].startswith("view 3 is missing: ")


def test_a_device_that_is_lost_is_released(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lost device refuses to be flushed: the view is missing, and producers are released all the same."""
    notes: list[str] = []
    source, released = open_device(f"0?producer={PRODUCER}", notes=notes), list[str]()
    reset = harvesters.Harvester.reset

    def fail(words: str) -> Callable[..., None]:
        def call(*arguments: object, **options: object) -> None:
            raise genicam.gentl.IoException(words)

        return call

    def reset_and_fail(harvester: Any) -> None:
        monkeypatch.undo()
        reset(harvester)
        released.append("producer")
        raise genicam.gentl.IoException("cannot be closed")

    monkeypatch.setattr(harvesters.ImageAcquirer, "try_fetch", fail("the cable is out"))
    monkeypatch.setattr(harvesters.ImageAcquirer, "_flush_buffers", fail("cannot be flushed"))
    monkeypatch.setattr(harvesters.Harvester, "reset", reset_and_fail)
    assert source.take(SimpleNamespace(stop=3)) is None
    assert released == ["producer"]
    assert len(notes) == 1
    assert notes[0].startswith("view 3 is missing: the device of --acquire genicam:0 fails: ")
    assert source.take(SimpleNamespace(stop=4)) is not None


def coordinate_nodes(prefix: str, axes: dict[str, tuple[float, float]], missing: float | None) -> str:
    """Return the features of scale, offset and missing data of each axis."""
    entries = "".join(
        f'<EnumEntry Name="Coordinate{axis}"><Value>{k}</Value></EnumEntry>' for k, axis in enumerate(axes)
    )

    def indexed(name: str, values: list[float]) -> str:
        rows = "".join(f'<ValueIndexed Index="{k}">{value!r}</ValueIndexed>' for k, value in enumerate(values))
        end = "<ValueDefault>0</ValueDefault></Float>"
        return f'<Float Name="{prefix}{name}"><pIndex>{prefix}Axis</pIndex>{rows}{end}'

    return f"""
    <Enumeration Name="{prefix}CoordinateSelector">{entries}<pValue>{prefix}Axis</pValue></Enumeration>
    <Integer Name="{prefix}Axis"><Value>0</Value></Integer>
    {indexed("CoordinateScale", [scale for scale, _ in axes.values()])}
    {indexed("CoordinateOffset", [offset for _, offset in axes.values()])}
    <Boolean Name="{prefix}InvalidDataFlag"><Value>{"true" if missing is not None else "false"}</Value></Boolean>
    <Float Name="{prefix}InvalidDataValue"><Value>{missing or 0.0!r}</Value></Float>"""


def nodes_of(mode: str, axes: dict[str, tuple[float, float]], *more: str, missing: float | None = None) -> Any:
    """Return a node map with scale and offset of each axis."""
    nodes = genicam.genapi.NodeMap()
    nodes.load_xml_from_string(f"""<?xml version="1.0" encoding="utf-8"?>
    <RegisterDescription ModelName="M" VendorName="V" StandardNameSpace="None" SchemaMajorVersion="1"
      SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
      ProductGuid="11111111-1111-1111-1111-111111111111" VersionGuid="11111111-1111-1111-1111-111111111112"
      xmlns="http://www.genicam.org/GenApi/Version_1_1">
    <Category Name="Root" NameSpace="Standard"><pFeature>Scan3dOutputMode</pFeature></Category>
    <Enumeration Name="Scan3dOutputMode"><EnumEntry Name="{mode}"><Value>0</Value></EnumEntry><Value>0</Value>
    </Enumeration>
    {coordinate_nodes("Scan3d", axes, missing)}
    {" ".join(more)}
    </RegisterDescription>""")
    return nodes


def component(name: str, values: np.ndarray, size: tuple[int, int]) -> Any:
    """Return a component whose bytes harvesters has expanded."""
    from harvesters.util.pfnc import Dictionary

    data = Dictionary.get_proxy(symbolic=name).expand(np.frombuffer(values.tobytes(), dtype=np.uint8))
    return SimpleNamespace(data_format=name, height=size[0], width=size[1], data=data)


AXES = {"A": (0.5, -3.0), "B": (0.25, 2.0), "C": (0.01, 400.0)}


def test_a_rectified_range_map_of_whole_numbers() -> None:
    """A and B are index times scale plus offset; the flagged value is a hole. The formula is written out for each."""
    raw = np.array([[100, 200, 65535], [0, 7, 9]], dtype="<u2")
    grid = read_frame([component("Coord3D_C16", raw, (2, 3))], nodes_of("RectifiedC", AXES, missing=65535.0))
    for row in range(2):
        for column in range(3):
            expected = [0.5 * column - 3.0, 0.25 * row + 2.0, 0.01 * int(raw[row, column]) + 400.0]
            if raw[row, column] == 65535:
                assert np.isnan(grid.points[row, column, 2])
            else:
                np.testing.assert_allclose(grid.points[row, column], expected, atol=1e-12)


@pytest.mark.parametrize("missing", [-9999.9, 1e300])
def test_the_value_of_missing_data_is_rounded_like_the_data(missing: float) -> None:
    """A device states it as a double and sends floats of 32 bits."""
    with np.errstate(over="ignore"):
        raw = np.array([[[1.0, 2.0, 3.0], [1.0, 2.0, missing]]]).astype("<f4")
    nodes = nodes_of("CalibratedABC_Grid", AXES, missing=missing)
    points = read_frame([component("Coord3D_ABC32f", raw, (1, 2))], nodes).points
    np.testing.assert_allclose(points[0, 0], [-2.5, 2.5, 400.03])
    assert np.isnan(points[0, 1, 2])


@pytest.mark.parametrize(
    ("name", "form"), [("Coord3D_ABC16", "<u2"), ("Coord3D_ABC32f", "<f4"), ("Coord3D_ABC8", "u1")]
)
def test_interleaved_and_planar_coordinates_are_equal(name: str, form: str) -> None:
    """Both orders of the same frame give the scaled coordinates."""
    raw = np.arange(4 * 5 * 3).reshape(4, 5, 3).astype(form)
    nodes = nodes_of("CalibratedABC_Grid", AXES)
    mixed = read_frame([component(name, raw, (4, 5))], nodes).points
    apart = read_frame([component(f"{name}_Planar", np.moveaxis(raw, 2, 0).copy(), (4, 5))], nodes).points
    single = [component(f"Coord3D_{axis}{name[11:]}", raw[..., k].copy(), (4, 5)) for k, axis in enumerate("ABC")]
    np.testing.assert_allclose(mixed, raw * np.array([0.5, 0.25, 0.01]) + np.array([-3.0, 2.0, 400.0]), atol=1e-12)
    assert (mixed == apart).all()
    assert (mixed == read_frame(single, nodes).points).all()


def test_the_scale_of_the_frame_is_used_before_that_of_the_settings() -> None:
    """Chunk data belong to the frame; the settings may have changed since."""
    chunk = coordinate_nodes("ChunkScan3d", {"A": (2.0, 0.0), "B": (3.0, 0.0), "C": (4.0, 5.0)}, 7.0)
    raw = np.array([[[1, 1, 1], [2, 2, 7]]], dtype="<u2")
    points = read_frame([component("Coord3D_ABC16", raw, (1, 2))], nodes_of("CalibratedABC_Grid", AXES, chunk)).points
    assert points[0, 0].tolist() == [2.0, 3.0, 9.0]
    assert np.isnan(points[0, 1, 2])


def test_profiles_with_uniform_rows() -> None:
    """In mode CalibratedAC the B axis has scale and offset only."""
    raw = np.arange(12, dtype="<f4").reshape(2, 3, 2)
    points = read_frame([component("Coord3D_AC32f", raw, (2, 3))], nodes_of("CalibratedAC", AXES)).points
    np.testing.assert_allclose(points[..., 0], 0.5 * raw[..., 0] - 3.0)
    np.testing.assert_allclose(points[..., 1], [[2.0] * 3, [2.25] * 3])
    np.testing.assert_allclose(points[..., 2], 0.01 * raw[..., 1] + 400.0)


@pytest.mark.parametrize(
    ("mode", "parts", "words"),
    [
        ("CalibratedC", [("Coord3D_C16", (2, 3), 6)], "set Scan3dOutputMode=CalibratedABC_Grid"),
        ("DisparityC", [("Coord3D_C16", (2, 3), 6)], "set Scan3dOutputMode=CalibratedABC_Grid"),
        ("UncalibratedC", [("Coord3D_C16", (2, 3), 6)], "calibrated Cartesian ones are needed"),
        ("RectifiedC", [("Coord3D_C16", (2, 3), 5)], "has 5 values instead of 6"),
        ("RectifiedC", [("Coord3D_C16", (2, 3), 6), ("Confidence16", (3, 3), 9)], "differ in size"),
        ("RectifiedC", [("Mono16", (2, 3), 6)], "sends Mono16, and no range"),
    ],
)  # fmt: skip
def test_frames_without_three_coordinates_are_refused(
    mode: str, parts: list[tuple[str, tuple[int, int], int]], words: str
) -> None:
    """No coordinate is guessed."""
    sent = [component(name, np.zeros(count, dtype="<u2"), size) for name, size, count in parts]
    with pytest.raises(_FrameError, match=words):
        read_frame(sent, nodes_of(mode, AXES))


def test_whole_numbers_without_a_scale_are_refused() -> None:
    """Integers are not lengths."""
    raw = component("Coord3D_ABC16", np.zeros(18, dtype="<u2"), (2, 3))
    with pytest.raises(_FrameError, match="without Scan3dCoordinateScale"):
        read_frame([raw], nodes_of("CalibratedABC_Grid", {"A": (1.0, 0.0)}))


@pytest.mark.parametrize(("option", "pixels"), [("", [0, 3, 4]), ("&min_confidence=5", [0, 4])])
def test_holes_are_missing_points_of_the_grid(option: str, pixels: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN, the origin, confidence 0 and a low one leave points out; the others keep their pixels and confidence."""
    points = np.arange(18.0).reshape(2, 3, 3)
    points[0, 1, 2] = np.nan
    points[1, 2] = 0.0
    confidence = np.array([[9.0, 9.0, 0.0], [4.0, 5.0, 9.0]])
    frame: Callable[..., DepthGrid] = lambda camera, timeout: DepthGrid(points, confidence, "mm")  # noqa: E731
    monkeypatch.setattr("cell.scan.genicam._capture", frame)
    acquired = open_device(f"0?producer={PRODUCER}{option}").take(SimpleNamespace(stop=1))
    assert acquired is not None
    assert acquired.arrays["pixel"].tolist() == pixels
    assert acquired.arrays["grid_shape"].tolist() == [2, 3]
    assert acquired.arrays["confidence"].tolist() == confidence.ravel()[pixels].tolist()
    np.testing.assert_array_equal(acquired.points, 0.001 * points.reshape(-1, 3)[pixels])
    assert acquired.details == {"missing": 6 - len(pixels)}


def test_a_device_with_several_data_streams_is_refused() -> None:
    """Its frames come as a list, one of each stream; which one has the points is not guessed."""
    camera = SimpleNamespace(
        remote_device=SimpleNamespace(node_map=nodes_of("RectifiedC", AXES)),
        try_fetch=lambda timeout: [None, None], start=lambda: None, stop=lambda: None,
    )  # fmt: skip
    with pytest.raises(_FrameError, match="several data streams"):
        _capture(camera, 1.0)


def test_a_software_trigger_is_given_for_each_frame() -> None:
    """The device is triggered after its start, again after an incomplete frame, and then stopped."""
    nodes = nodes_of(
        "RectifiedC", AXES,
        '<Enumeration Name="TriggerMode"><EnumEntry Name="On"><Value>1</Value></EnumEntry><Value>1</Value>'
        "</Enumeration>",
        '<Enumeration Name="TriggerSource"><EnumEntry Name="Software"><Value>1</Value></EnumEntry><Value>1</Value>'
        "</Enumeration>",
        '<Integer Name="Fired"><Value>0</Value></Integer>',
        '<Command Name="TriggerSoftware"><pValue>Fired</pValue><CommandValue>1</CommandValue></Command>',
    )  # fmt: skip
    events: list[str] = []

    class Frame:
        payload_type = 10
        payload = SimpleNamespace(components=[component("Coord3D_C16", np.zeros(6, dtype="<u2"), (2, 3))])

        def __enter__(self) -> "Frame":
            return self

        def __exit__(self, *error: object) -> None:
            events.append("queued")

    def try_fetch(timeout: float) -> Frame | None:
        events.append(f"fired {nodes.Fired.value}")
        nodes.Fired.value = 0
        return Frame() if events.count("fired 1") == 2 else None

    camera = SimpleNamespace(
        remote_device=SimpleNamespace(node_map=nodes), try_fetch=try_fetch,
        start=lambda: events.append("started"), stop=lambda: events.append("stopped"),
    )  # fmt: skip
    assert _capture(camera, 5.0).points.shape == (2, 3, 3)
    assert events == ["started", "fired 1", "fired 1", "queued", "stopped"]
