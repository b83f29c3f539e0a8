"""Triangles of a 3MF file (3MF Core Specification 1.3): a ZIP archive with a model in XML."""

import io
import zipfile
import zlib
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np

from planner.geometry.mesh import concatenate_meshes
from planner.values import Floats, Ints

MAX_MODEL = 500_000_000
"""Largest size of the unpacked model [bytes]."""

_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_UNITS = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}
_DEEPEST = 16  # components in components


class ThreeMfError(ValueError):
    """A broken or unsupported file; the message follows the name of the file."""


def triangles(content: bytes) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) [m] and triangles (F, 3) of the build items.

    Raises:
        ThreeMfError: if the file is broken or has required extensions.
    """
    try:
        root = ElementTree.fromstring(_model(content))
        if required := root.get("requiredextensions", "").split():
            raise ThreeMfError(f"requires the 3MF extension '{required[0]}', which is not supported; export without it")
        unit = root.get("unit", "millimeter")
        if unit not in _UNITS:
            raise ThreeMfError(f"has the unit '{unit[:40]}'; known are {', '.join(_UNITS)}")
        objects = {each.get("id"): each for each in root.iterfind(f"{_CORE}resources/{_CORE}object")}
        items = root.findall(f"{_CORE}build/{_CORE}item")
        if not items:
            raise ThreeMfError("has no build item; export the bodies again")
        found = [
            surface
            for item in items
            for surface in _surfaces(objects, item.get("objectid"), _transform(item), _DEEPEST)
        ]
    except (zipfile.BadZipFile, zlib.error, ElementTree.ParseError, KeyError, TypeError, NotImplementedError) as error:
        raise ThreeMfError("cannot be read as 3MF: archive or model is broken; export it again") from error
    vertices, faces, _ = concatenate_meshes(found)
    return vertices * _UNITS[unit], faces


def _model(content: bytes) -> bytes:
    """Return the XML of the model that the archive names first."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        relations = ElementTree.fromstring(archive.read("_rels/.rels"))
        name = next(each.get("Target", "") for each in relations if each.get("Type") == _MODEL_TYPE).lstrip("/")
        if archive.getinfo(name).file_size > MAX_MODEL:
            raise ThreeMfError(f"has a model of more than {MAX_MODEL / 1e6:.0f} MB; export it as binary STL")
        return archive.read(name)


def _surfaces(
    objects: dict[str | None, ElementTree.Element], number: str | None, T: Floats, depth: int
) -> Iterator[tuple[Floats, Ints]]:
    """Yield the surfaces of an object and of its components at their transforms."""
    if depth == 0:
        raise ThreeMfError(f"has components nested more than {_DEEPEST} deep; export the bodies one by one")
    if number not in objects:
        raise ThreeMfError(f"refers to the missing object {number}; export it again")
    mesh = objects[number].find(f"{_CORE}mesh")
    if mesh is not None:
        points = [[each.get(axis) for axis in "xyz"] for each in mesh.iterfind(f"{_CORE}vertices/{_CORE}vertex")]
        corners = [
            [each.get(f"v{k}") for k in (1, 2, 3)] for each in mesh.iterfind(f"{_CORE}triangles/{_CORE}triangle")
        ]
        vertices = _numbers(points)
        faces = _numbers(corners).astype(np.int64)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ThreeMfError(f"has a triangle of object {number} that refers to a missing vertex; export it again")
        mirrored = np.linalg.det(T[:3, :3]) < 0
        yield vertices @ T[:3, :3].T + T[:3, 3], faces[:, :: -1 if mirrored else 1]
    for each in objects[number].iterfind(f"{_CORE}components/{_CORE}component"):
        yield from _surfaces(objects, each.get("objectid"), T @ _transform(each), depth - 1)


def _numbers(rows: list[list[str | None]]) -> Floats:
    try:
        return np.array(rows, dtype=np.str_).reshape(-1, 3).astype(np.float64)
    except ValueError as error:
        raise ThreeMfError("has a coordinate or an index that is not a number; export it again") from error


def _transform(element: ElementTree.Element) -> Floats:
    """Return the transform (4, 4) of an item or component, 12 numbers by rows (3.3)."""
    T = np.eye(4)
    words = element.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()
    try:
        numbers = np.array(words, dtype=np.float64).reshape(4, 3)
    except ValueError as error:
        raise ThreeMfError("has a transform that is not 12 numbers; export it again") from error
    T[:3, :3], T[:3, 3] = numbers[:3].T, numbers[3]
    return T
