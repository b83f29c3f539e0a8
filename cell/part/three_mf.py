"""Triangles of a 3MF file (3MF Core Specification 1.3, Production Extension 1.1): a ZIP archive with models in XML."""

import io
import re
import zipfile
import zlib
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np

from planner.geometry.mesh import concatenate_meshes
from planner.values import Floats, Ints

MAX_MODEL = 500_000_000
"""Largest size of an unpacked file of the archive [bytes]."""

_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"  # objects in several model parts
_MATERIALS = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"  # colours only
_SLICER_VOLUME = re.compile(
    rb"(negative_part|modifier_part|support_blocker|support_enforcer|NegativeVolume|ParameterModifier|SupportBlocker"
    rb"|SupportEnforcer)"
)  # in the settings of Bambu Studio, OrcaSlicer and PrusaSlicer
_BROKEN = (
    *(zipfile.BadZipFile, zlib.error, ElementTree.ParseError, TypeError, ValueError, LookupError),
    *(RuntimeError, EOFError, OSError),
)
_UNITS = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}
_DEEPEST = 16  # components in components
_PLACED_COST = 16  # counted for each placed object in addition to its triangles; a component has more bytes


class ThreeMfError(ValueError):
    """A broken or unsupported file; the message follows the name of the file."""


def triangles(content: bytes) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) [m] and triangles (F, 3) of the build items.

    Raises:
        ThreeMfError: if the file is broken, or has required extensions other than production, support structures or
            volumes that a slicer subtracts.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            package = _Package(archive)
            package.require_solids()
            root = package.root(package.main)
            unit = root.get("unit", "millimeter")
            if unit not in _UNITS:
                raise ThreeMfError(f"has the unit '{unit[:40]}'; known are {', '.join(_UNITS)}")
            items = root.findall(f"{_CORE}build/{_CORE}item")
            if not items:
                raise ThreeMfError("has no build item; export the bodies again")
            surfaces = [surface for item in items for surface in _surfaces(package, package.main, item, _DEEPEST)]
    except ThreeMfError:
        raise
    except _BROKEN as error:
        raise ThreeMfError("cannot be read as 3MF: archive or model is broken; export it again") from error
    vertices, faces, _ = concatenate_meshes(surfaces)
    return vertices * _UNITS[unit], faces


class _Package:
    """The model parts of an archive, each parsed once.

    A kilobyte of nested components can announce any number of triangles. At most as many are placed as the model parts
    have bytes.

    Args:
        archive: open.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._roots: dict[str, ElementTree.Element] = {}
        self._room = 0  # bytes of the parsed parts, without the triangles that are placed
        relations = ElementTree.fromstring(self._read("_rels/.rels"))
        models = [each.get("Target", "") for each in relations if each.get("Type") == _MODEL_TYPE]
        if not models:
            raise ThreeMfError("names no model in its relations; export it again")
        self.main = models[0].lstrip("/")

    def require_solids(self) -> None:
        """Refuse volumes that a slicer subtracts or uses for settings: as meshes they are like any other."""
        for name in self._archive.namelist():
            if name.startswith("Metadata/") and name.endswith(".config"):
                kind = _SLICER_VOLUME.search(self._read(name))
                if kind:
                    raise ThreeMfError(
                        f"has a volume of the kind '{kind[1].decode()}', which a slicer does not print as a body; "
                        "remove it, and export again"
                    )

    def root(self, name: str) -> ElementTree.Element:
        """Return the XML of a model part.

        Raises:
            ThreeMfError: if it is too large, or requires an extension that is not supported.
        """
        if name not in self._roots:
            content = self._read(name)
            self._room += len(content)
            self._roots[name] = root = ElementTree.fromstring(content)
            required = root.get("requiredextensions", "").split()
            text = content.decode("utf-8", "replace") if required else ""
            names = dict(re.findall(r"""xmlns:([\w.-]+)\s*=\s*["']([^"']*)["']""", text))
            for prefix in required:
                if names.get(prefix) not in (_PRODUCTION, _MATERIALS):
                    raise ThreeMfError(
                        f"requires the 3MF extension '{prefix}', which is not supported; export without it"
                    )
        return self._roots[name]

    def _read(self, name: str) -> bytes:
        if self._archive.getinfo(name).file_size > MAX_MODEL:
            raise ThreeMfError(f"has a model of more than {MAX_MODEL / 1e6:.0f} MB; export it as binary STL")
        return self._archive.read(name)

    def place(self, count: int) -> None:
        """Count an object that is placed with a number of triangles or vertices.

        Raises:
            ThreeMfError: if there are more than the model parts have bytes.
        """
        self._room -= count + _PLACED_COST
        if self._room < 0:
            raise ThreeMfError("expands to more triangles than it has bytes; export each body once")

    def object(self, name: str, number: str | None) -> ElementTree.Element:
        """Return an object of a model part."""
        for each in self.root(name).iterfind(f"{_CORE}resources/{_CORE}object"):
            if each.get("id") == number:
                return each
        raise ThreeMfError(f"refers to the missing object {number}; export it again")


def _surfaces(
    package: _Package, model: str, reference: ElementTree.Element, depth: int, T: Floats | None = None
) -> Iterator[tuple[Floats, Ints]]:
    """Yield the surfaces of an item or component, and of the components of its object, at their transforms."""
    if depth == 0:
        raise ThreeMfError(f"has components nested more than {_DEEPEST} deep; export the bodies one by one")
    number = reference.get("objectid")
    model = reference.get(f"{{{_PRODUCTION}}}path", model).lstrip("/")
    T = _transform(reference) if T is None else T @ _transform(reference)
    solid = package.object(model, number)
    if solid.get("type", "model") in ("support", "solidsupport"):
        raise ThreeMfError(f"has a support structure (object {number}); export the part without it")
    mesh = solid.find(f"{_CORE}mesh")
    if mesh is None:
        package.place(0)
    else:
        points = [[each.get(axis) for axis in "xyz"] for each in mesh.iterfind(f"{_CORE}vertices/{_CORE}vertex")]
        corners = [
            [each.get(f"v{k}") for k in (1, 2, 3)] for each in mesh.iterfind(f"{_CORE}triangles/{_CORE}triangle")
        ]
        package.place(max(len(points), len(corners)))
        vertices = _numbers(points)
        faces = _numbers(corners).astype(np.int64)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ThreeMfError(f"has a triangle of object {number} that refers to a missing vertex; export it again")
        mirrored = np.linalg.det(T[:3, :3]) < 0
        yield vertices @ T[:3, :3].T + T[:3, 3], faces[:, :: -1 if mirrored else 1]
    for each in solid.iterfind(f"{_CORE}components/{_CORE}component"):
        yield from _surfaces(package, model, each, depth - 1, T)


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
