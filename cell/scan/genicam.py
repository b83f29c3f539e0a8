"""`--acquire genicam:DEVICE?FEATURE=VALUE&...`: points of a 3D camera with a GenTL producer, by the package harvesters.

The names of features, output modes and pixel formats are those of GenICam (SFNC 2.7, PFNC 2.4). The device is opened
for each view: a failure costs one view, and other programs can use the device in between. A frame is started after the
arm is at rest.
"""

import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.part.workpiece import UNITS
from cell.scan.acquisition import Acquired, Context, View, frame_and_unit
from planner.values import Floats

PRODUCERS = "GENICAM_GENTL64_PATH"
"""Environment variable of GenTL: folders of producers (`.cti`)."""

_COORDINATES = re.compile(r"Coord3D_([ABC]+)(8|16|32f)(_Planar)?")
_CONFIDENCE = re.compile(r"Confidence(1|8|16|32f)")
_GRID_MODES = ("RectifiedC", "CalibratedAC")  # an axis without data is uniform: index x scale + offset
_DISTANCE_UNITS = {"Millimeter": "mm", "Inch": "in"}
_IDENTITIES = ("id_", "serial_number", "user_defined_name", "model")
_GENDC = 11  # payload type of GenTL 1.6
_OPTIONS = ("producer", "min_confidence")


class _FrameError(ValueError):
    """A frame without usable points; the message states the cause."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthGrid:
    """Organised points of one frame.

    Attributes:
        points: (rows, columns, 3) in the unit of the device, its anchor frame; NaN for a missing point.
        confidence: (rows, columns) of the points; None: the device sends none.
        unit: of the points, a key of `UNITS`; None: the device does not state it.
    """

    points: Floats
    confidence: Floats | None
    unit: str | None


class GenICam:
    """Source of the points of a GenICam device.

    Attributes:
        source: device, frame and unit.
    """

    def __init__(self, argument: str, context: Context) -> None:
        """Open and set the device once; raise UsageError if it, a feature, frame or unit is invalid."""
        device, _, query = argument.partition("?")
        settings = parse_qsl(query, keep_blank_values=True)
        self._device = device
        self._features = [(name, value) for name, value in settings if name not in _OPTIONS]
        keys = dict(settings)
        self._producer = keys.get("producer")
        try:
            self._min_confidence = float(keys.get("min_confidence", 0))
        except ValueError:
            raise UsageError(f"min_confidence={keys['min_confidence']} must be a number") from None
        if getattr(context.cell.scanner, "T_view_scanner", None) is not None:
            raise UsageError("--acquire genicam takes one frame at rest; the plan moves a line sensor: use files:DIR")
        self._frame, self._unit = frame_and_unit(context)
        self._timeout, self._notify = float(context.options["acquire_timeout_s"]), context.notify
        with self._opened() as (camera, name):
            self._require_unit(_distance_unit(camera.remote_device.node_map))
        self.source = f"GenICam device {name} ({self._frame} frame, {self._unit})"

    def take(self, view: View) -> Acquired | None:
        """Return the points of one frame; None if the device is lost or delivers none in time.

        Raises:
            FileError: if the device states another unit.
        """
        try:
            with self._opened() as (camera, _):
                grid = _capture(camera, self._timeout)
        except (UsageError, _FrameError) as error:
            self._notify(f"view {view.stop} is missing: {error}; cell scan --resume scans it")
            return None
        try:
            self._require_unit(grid.unit)
        except UsageError as error:
            raise FileError(f"{error}; nothing of view {view.stop} was kept") from error
        # Zeros are holes of devices without a flag for them: no camera measures its own origin.
        valid = np.isfinite(grid.points).all(axis=2) & grid.points.any(axis=2)
        if grid.confidence is not None:
            valid &= (grid.confidence > 0) & (grid.confidence >= self._min_confidence)
        arrays: dict[str, NDArray[Any]] = {
            "pixel": np.flatnonzero(valid).astype(np.int32),
            "grid_shape": np.array(valid.shape, dtype=np.int64),
        }
        if grid.confidence is not None:
            arrays["confidence"] = grid.confidence[valid].astype(np.float32)
        return Acquired(grid.points[valid] * UNITS[self._unit], self._frame, arrays, {"missing": int((~valid).sum())})

    def _require_unit(self, stated: str | None) -> None:
        if stated not in (None, self._unit):
            raise UsageError(f"the device sends coordinates in {stated}, and --points-units is {self._unit}")

    @contextmanager
    def _opened(self) -> Iterator[tuple[Any, str]]:
        """Yield the set device as an image acquirer, and its name."""
        harvester, errors = _package()
        failures: _Errors = (*errors, OSError)
        camera = None
        try:
            for path in _producers(self._producer):
                harvester.add_file(str(path), check_validity=True)
            harvester.update()
            info, name = _select(harvester.device_info_list, self._device, errors)
            camera = harvester.create(info)
            _set(camera.remote_device.node_map, self._features, errors)
            yield camera, name
        except failures as error:
            raise UsageError(f"the device of --acquire genicam:{self._device} fails: {_reason(error)}") from error
        finally:
            if camera is not None:
                with suppress(*failures):  # a lost device cannot be flushed; the cause is already raised
                    camera.destroy()
            with suppress(*failures):
                harvester.reset()


_Errors = tuple[type[Exception], ...]


def _package() -> tuple[Any, _Errors]:
    """Return a new Harvester and the base classes of its errors."""
    try:
        from genicam import genapi, gentl
        from harvesters.core import Harvester
    except ImportError as error:
        raise UsageError("--acquire genicam needs the package harvesters: pip install 'scan-cell[genicam]'") from error
    return Harvester(), (genapi.GenericException, gentl.GenericException)


def _producers(producer: str | None) -> list[Path]:
    """Return the files of the given GenTL producer, or of all that are installed."""
    if producer is not None:
        paths = [Path(producer).expanduser()]
    else:
        folders = [Path(each) for each in os.environ.get(PRODUCERS, "").split(os.pathsep) if each]
        paths = sorted(path for folder in folders for path in folder.glob("*.cti"))
    if not paths or not all(path.is_file() for path in paths):
        where = f"{producer} is no file" if producer is not None else f"{PRODUCERS} names no folder with a .cti file"
        raise UsageError(
            f"{where}; install the GenTL producer of the scanner's maker, or give it: --acquire "
            "'genicam:DEVICE?producer=/opt/maker/producer.cti'"
        )
    return paths


def _select(devices: Sequence[Any], identity: str, errors: _Errors) -> tuple[Any, str]:
    """Return the only device, or the only one with an identity, and its name for messages."""

    def identities(device: Any) -> dict[str, str]:
        identity = {}
        for key in ("vendor", *_IDENTITIES):
            with suppress(*errors):  # optional in GenTL
                identity[key] = str(getattr(device, key))
        return identity

    known = [identities(device) for device in devices]
    names = [" ".join(each.get(key, "") for key in ("vendor", "model", "serial_number")).strip() for each in known]
    matches = [k for k, each in enumerate(known) if not identity or identity in [each.get(key) for key in _IDENTITIES]]
    if len(matches) == 1:
        return devices[matches[0]], names[matches[0]]
    device_list = (
        "; ".join(f"{each.get('id_', '?')} ({name})" for each, name in zip(known, names, strict=True)) or "none"
    )
    count = "several GenICam devices match" if matches else "no GenICam device matches"
    keys = "id, serial number, user-defined name or model"
    raise UsageError(f"{count} --acquire genicam:{identity}; give the {keys} of one; found: {device_list}")


def _set(nodes: Any, features: Sequence[tuple[str, str]], errors: _Errors) -> None:
    """Select the components with points and confidence, then set the given features in order."""
    if _value(nodes, "GenDCStreamingMode") == "On":
        nodes.GenDCStreamingMode.value = "Off"
    if nodes.has_node("ComponentSelector"):
        for component in ("Confidence", "Range"):
            if component in nodes.ComponentSelector.symbolics:
                nodes.ComponentSelector.value = component
                with suppress(*errors):  # a device without a choice
                    nodes.ComponentEnable.value = True
    for name, value in features:
        if not nodes.has_node(name):
            raise UsageError(f"the device has no feature {name}; own options are {' and '.join(_OPTIONS)}")
        try:
            getattr(nodes, name).from_string(value)
        except errors as error:
            choices = getattr(getattr(nodes, name), "symbolics", ())
            hint = f"; it must be one of: {', '.join(choices)}" if choices else ""
            raise UsageError(f"the device refuses {name}={value}: {_reason(error)}{hint}") from error


def _reason(error: Exception) -> str:
    """Return the sentence of an error of GenICam without its place in the source."""
    return re.sub(r"\.? *: \w+ thrown in .*", "", " ".join(str(error).split())) or type(error).__name__


def _value(nodes: Any, name: str) -> Any:
    """Return the value of a feature; None if the device does not have it, or not at this time."""
    from genicam.genapi import AccessException

    with suppress(AccessException):
        return getattr(nodes, name).value if nodes.has_node(name) else None
    return None


def _distance_unit(nodes: Any) -> str | None:
    """Return the unit of the coordinates as a key of `UNITS`; None if the device does not state it."""
    stated = _of_frame(nodes, "DistanceUnit")
    return None if stated is None else _DISTANCE_UNITS.get(stated, f"the unit '{stated}'")


def _of_frame(nodes: Any, name: str) -> Any:
    """Return a value of 3D scanning from the chunk data of the last frame, else from the settings."""
    value = _value(nodes, f"ChunkScan3d{name}")
    return _value(nodes, f"Scan3d{name}") if value is None else value


def _capture(camera: Any, timeout_s: float) -> DepthGrid:
    """Start, trigger and read one frame."""
    nodes = camera.remote_device.node_map
    is_triggered = _value(nodes, "TriggerMode") == "On" and _value(nodes, "TriggerSource") == "Software"
    camera.start()
    try:
        until = time.monotonic() + timeout_s
        while (left := until - time.monotonic()) > 0:
            if is_triggered:
                nodes.TriggerSoftware.execute()
            frame = camera.try_fetch(timeout=left)  # None also for an incomplete frame
            if isinstance(frame, list):
                raise _FrameError("the device has several data streams; give a device with one")
            if frame is None:
                continue
            with frame:
                if frame.payload_type == _GENDC:
                    raise _FrameError("the device sends GenDC containers, which are not read; switch GenDC off")
                return read_frame([part for part in frame.payload.components if part is not None], nodes)
    finally:
        camera.stop()
    raise _FrameError(f"no complete frame within {timeout_s:g} s; check trigger and exposure")


def read_frame(parts: Sequence[Any], nodes: Any) -> DepthGrid:
    """Return the points of a frame.

    Args:
        parts: components with `data_format`, `width`, `height` and `data`, one or several for the coordinates.
        nodes: node map of the device.

    Raises:
        _FrameError: if the frame has no Cartesian coordinates of all three axes.
    """
    planes: dict[str, tuple[Floats, bool]] = {}  # of an axis: values, and whether they are whole numbers
    confidence = None
    for part in parts:
        name, size = str(part.data_format), (int(part.height), int(part.width))
        if match := _COORDINATES.fullmatch(name):
            axes, planar = match[1], match[3] is not None
            shape = (len(axes), *size) if planar else (*size, len(axes))
            values = _reshaped(part, shape)
            for k, axis in enumerate(axes):
                planes[axis] = (values[k] if planar else values[..., k], match[2] != "32f")
        elif _CONFIDENCE.fullmatch(name):
            confidence = _reshaped(part, size)
    formats = ", ".join(str(part.data_format) for part in parts) or "nothing"
    if "C" not in planes:
        raise _FrameError(f"the device sends {formats}, and no range; enable its component Range")
    mode, system = _of_frame(nodes, "OutputMode"), _of_frame(nodes, "CoordinateSystem")
    if system not in (None, "Cartesian") or str(mode).startswith("Uncalibrated"):
        raise _FrameError(f"the device sends {mode} in {system} coordinates; calibrated Cartesian ones are needed")
    shape = planes["C"][0].shape
    if any(values.shape != shape for values, _ in planes.values()) or (
        confidence is not None and confidence.shape != shape
    ):
        raise _FrameError(f"the components {formats} of the device differ in size")
    points = np.empty((*shape, 3))
    for k, axis in enumerate("ABC"):
        scale, offset, missing = _coordinate(nodes, axis)
        if axis in planes:
            raw, is_whole = planes[axis]
            if is_whole and scale is None:
                raise _FrameError(f"the device sends {formats} without Scan3dCoordinateScale")
            scale, offset = 1.0 if scale is None else scale, 0.0 if offset is None else offset
            if not is_whole and missing is not None:
                with np.errstate(over="ignore"):
                    missing = float(np.float32(missing))  # GenICam states a double
            points[..., k] = np.where(raw == missing, np.nan, raw * scale + offset)
        elif mode in _GRID_MODES and scale is not None and offset is not None:
            points[..., k] = np.indices(shape)[1 - k] * scale + offset
        else:
            raise _FrameError(f"the device sends {formats} in mode {mode}; set Scan3dOutputMode=CalibratedABC_Grid")
    return DepthGrid(points, confidence, _distance_unit(nodes))


def _reshaped(part: Any, shape: tuple[int, ...]) -> Floats:
    """Return a copy of the data of a component in another shape."""
    data = np.array(part.data, dtype=np.float64)
    if data.size != int(np.prod(shape)):
        raise _FrameError(f"a component {part.data_format} has {data.size} values instead of {int(np.prod(shape))}")
    return data.reshape(shape)


def _coordinate(nodes: Any, axis: str) -> tuple[float | None, float | None, float | None]:
    """Return scale, offset and value of missing data of an axis, each None if the device does not state it."""
    for prefix in ("ChunkScan3d", "Scan3d"):
        selector = f"{prefix}CoordinateSelector"
        if _value(nodes, selector) is not None and f"Coordinate{axis}" in getattr(nodes, selector).symbolics:
            getattr(nodes, selector).value = f"Coordinate{axis}"
            scale, offset = _value(nodes, f"{prefix}CoordinateScale"), _value(nodes, f"{prefix}CoordinateOffset")
            if scale is not None:
                flagged = _value(nodes, f"{prefix}InvalidDataFlag")
                return scale, offset, _value(nodes, f"{prefix}InvalidDataValue") if flagged else None
    return None, None, None
