"""Triangles of a glTF file (.glb, or .gltf with its buffers), with the mesh of each node at the node's transform.

This reader exists because a few hundred bytes of glTF can announce gigabytes: an accessor without data, a picture, one
mesh under thousands of nodes. It reads only geometry, each array is a view into the bytes of the file, and a file gives
at most as many triangles as it has bytes. Section numbers refer to the glTF 2.0 specification (ISO/IEC 12113).
"""

import base64
import json
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from cell.text import decode
from planner.geometry.mesh import concatenate_meshes
from planner.geometry.rigid import rigid_transform
from planner.values import Floats, Ints

Table = Mapping[str, Any]
"""An object of the scene description from an unknown writer: each value is checked before use."""

_JSON, _BIN = 0x4E4F534A, 0x004E4942  # kinds of chunks (4.4.3)
# Component types (3.6.2.2).
_INDICES: Mapping[int, np.dtype[Any]] = {5121: np.dtype("<u1"), 5123: np.dtype("<u2"), 5125: np.dtype("<u4")}
_FLOAT = 5126
_PRIMITIVE_COST = 16  # counted for each placed primitive in addition to its triangles; a node has more bytes
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives (3.7.2.1)


_INSTANCING = "EXT_mesh_gpu_instancing"
_UNIT = 0.01  # largest deviation of the length of a quaternion from 1: numbers may be rounded
_EXTENSIONS = (_INSTANCING, "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "KHR_xmp")
"""Beginnings of the names of extensions that are applied or do not change the surface."""


class GlbError(Exception):
    """A broken or unsupported file; the message follows the name of the file."""


@dataclass(frozen=True, slots=True, eq=False)
class Primitive:
    """A surface of the scene at its place.

    Attributes:
        T: (4, 4) of its node.
        vertices: (V, 3) in the unit of the file.
        faces: (F, 3).
        colour: red, green and blue of its material, linear, 0 to 1; None without colour.
        extensions: its extensions of glTF.
        numbers: returns the integers (N,) of an accessor, which an extension names.
    """

    T: Floats
    vertices: Floats
    faces: Ints
    colour: tuple[float, float, float] | None
    extensions: Table
    numbers: Callable[[Any], Ints]


def triangles(content: bytes, folder: Path | None = None) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) and triangles (F, 3) of a GLB or glTF file, in metres.

    Args:
        content: of the file.
        folder: of a .gltf, for its buffers; None for a GLB.

    Raises:
        GlbError: if it is broken or unsupported.
    """
    return concatenate_meshes((primitive.vertices, primitive.faces) for primitive in primitives(content, folder))[:2]


def primitives(content: bytes, folder: Path | None = None) -> Iterator[Primitive]:
    """Yield the surfaces of a GLB or glTF file; points and lines are ignored.

    Args:
        content: of the file.
        folder: of a .gltf, for its buffers; None for a GLB.

    Raises:
        GlbError: if it is broken or unsupported.
    """
    described, data = _chunks(content) if folder is None else _json_file(content, folder)
    required = described.get("extensionsRequired")
    for name in required if isinstance(required, list) else ():
        if not str(name).startswith(_EXTENSIONS):
            raise GlbError(f"requires the glTF extension {str(name)[:60]}, which is not supported: export without it")
    size = len(content) + sum(len(each) for each in data if each is not content)
    begin = count = 0

    def numbers(accessor: Any) -> Ints:
        return _accessor(described, data, accessor, None, "SCALAR").astype(np.int64).ravel()

    for T, mesh, weights in _placed(described, data):
        for primitive in _list(mesh, "primitives"):
            surface = _primitive(described, data, primitive, weights)
            if surface is None:
                continue
            count += len(surface[1]) + _PRIMITIVE_COST
            if count > size:
                raise GlbError("expands to more triangles than it has bytes: export each body once")
            begin += len(surface[0])
            if begin > 3 * size:
                raise GlbError("expands to more vertices than it can hold: export each body once")
            mirrored = np.linalg.det(T[:3, :3]) < 0  # flips the winding (3.7.4)
            extensions = primitive.get("extensions")
            yield Primitive(
                T,
                surface[0] @ T[:3, :3].T + T[:3, 3],
                surface[1][:, :: -1 if mirrored else 1],
                _colour(described, primitive.get("material")),
                extensions if isinstance(extensions, dict) else {},
                numbers,
            )


def _colour(described: Table, material: Any) -> tuple[float, float, float] | None:
    """Return the base colour of a material (3.9.2), or None."""
    materials = _list(described, "materials")
    rough = (
        materials[_index(material, materials, "material")].get("pbrMetallicRoughness") if material is not None else None
    )
    base = rough.get("baseColorFactor") if isinstance(rough, Mapping) else None
    if base is None:
        return None
    red, green, blue, _ = _numbers(base, 4)
    return float(red), float(green), float(blue)


def _json_file(content: bytes, folder: Path) -> tuple[Table, list[bytes]]:
    """Return the scene description of a .gltf, and its buffers: base64, or files in its folder or below."""
    described = _description(decode(content))
    asset = described.get("asset")
    version = asset.get("version") if isinstance(asset, Mapping) else None
    if version is not None and not str(version).startswith("2"):
        raise GlbError(f"is glTF of version {str(version)[:20]}; supported is version 2: export it again")
    buffers = []
    for buffer in _list(described, "buffers"):
        uri = buffer.get("uri")
        if not isinstance(uri, str):
            raise GlbError("has a buffer without an address: export it again, or as GLB")
        if uri.startswith("data:"):
            try:
                buffers.append(base64.b64decode(uri.partition(",")[2], validate=True))
            except ValueError as error:
                raise GlbError("has a buffer that is not base64: export it again, or as GLB") from error
            continue
        name = PurePosixPath(unquote(uri))
        if name.is_absolute() or ".." in name.parts or ":" in uri:
            raise GlbError(f"has its data at {uri[:60]}, outside its folder: export one file as GLB")
        try:
            buffers.append((folder / name).read_bytes())
        except (OSError, ValueError) as error:
            raise GlbError(f"needs {str(name)[:60]} beside it, which cannot be read: copy it, or export GLB") from error
    return described, buffers


def _chunks(content: bytes) -> tuple[Table, list[bytes]]:
    """Return the scene description and the binary data."""
    if len(content) < 20 or content[:4] != b"glTF":
        raise GlbError("is not a binary glTF file (GLB): export the mesh again")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise GlbError(f"is glTF of version {version}; supported is version 2: export it again")
    if length > len(content):
        raise GlbError(f"is cut short: it announces {length} bytes but has {len(content)}: export or copy it again")
    size, kind = struct.unpack_from("<II", content, 12)
    if kind != _JSON or 20 + size > len(content):
        raise GlbError("does not begin with a scene description: export the mesh again")
    described = _description(content[20 : 20 + size])
    at, data = 20 + size, b""
    if at + 8 <= len(content):
        size, kind = struct.unpack_from("<II", content, at)
        data = content[at + 8 : at + 8 + size] if kind == _BIN else b""
    return described, [data]


def _description(text: str | bytes) -> Table:
    try:
        described = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise GlbError("has a scene description that cannot be read: export the mesh again") from error
    if not isinstance(described, dict):
        raise GlbError("has a scene description that is not an object: export the mesh again")
    return described


def _placed(described: Table, data: list[bytes]) -> Iterator[tuple[Floats, Table, Sequence[float]]]:
    """Yield transform, mesh and morph weights of each node of the scene; without a scene, of all trees of nodes."""
    nodes = _list(described, "nodes")
    scenes = _list(described, "scenes")
    if scenes:
        roots = _list(scenes[_index(described.get("scene", 0), scenes, "scene")], "nodes", numbers=True)
    else:
        below = {child for node in nodes for child in _list(node, "children", numbers=True) if isinstance(child, int)}
        roots = [number for number in range(len(nodes)) if number not in below]
    todo = [(number, np.eye(4)) for number in reversed(roots)]
    seen: set[int] = set()
    while todo:
        number, T_parent = todo.pop()
        node = nodes[_index(number, nodes, "node")]
        visibility = node.get("extensions") or {}
        if isinstance(visibility, dict) and visibility.get("KHR_node_visibility") == {"visible": False}:
            raise GlbError("has a hidden node (KHR_node_visibility): show it or delete it")
        if number in seen:  # nodes form trees (3.5.3); a cycle would never end
            raise GlbError("has a node under two parents: export the mesh again")
        seen.add(number)
        T = T_parent @ _transform(node)
        if node.get("mesh") is not None:
            if node.get("skin") is not None:
                raise GlbError("has a mesh that is deformed by a skeleton (skin), which is not supported: apply it")
            meshes = _list(described, "meshes")
            mesh = meshes[_index(node["mesh"], meshes, "mesh")]
            weights = node.get("weights", mesh.get("weights")) or []
            for T_instance in _instances(described, data, node):
                yield T @ T_instance, mesh, weights
        todo += [(child, T) for child in reversed(_list(node, "children", numbers=True))]


def _instances(described: Table, data: list[bytes], node: Table) -> list[Floats]:
    """Return the transforms (4, 4) of the copies of a node's mesh (EXT_mesh_gpu_instancing); the identity without."""
    extensions = node.get("extensions")
    copies = extensions.get(_INSTANCING) if isinstance(extensions, Mapping) else None
    if copies is None:
        return [np.eye(4)]
    attributes = copies.get("attributes") if isinstance(copies, Mapping) else None
    if not isinstance(attributes, Mapping):
        raise GlbError(f"has {_INSTANCING} without attributes: export each body once")
    read = {
        key: _accessor(described, data, attributes[key.upper()], np.dtype("<f4"), form).astype(np.float64)
        for key, form in (("translation", "VEC3"), ("rotation", "VEC4"), ("scale", "VEC3"))
        if key.upper() in attributes
    }
    if len({len(values) for values in read.values()}) != 1:
        raise GlbError(f"has {_INSTANCING} with columns of different lengths: export each body once")
    count = len(next(iter(read.values())))
    return [_transform({key: values[k].tolist() for key, values in read.items()}) for k in range(count)]


def _transform(node: Table) -> Floats:
    """Return the transform (4, 4) of a node: its matrix by columns, or translation x rotation x scale (3.5.2)."""
    if "matrix" in node:
        return _numbers(node["matrix"], 16).reshape(4, 4).T
    quaternion = _numbers(node.get("rotation", [0, 0, 0, 1]), 4)
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > _UNIT:
        raise GlbError("has a rotation that is no unit quaternion, which would distort it: export the mesh again")
    x, y, z, w = quaternion / norm
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    linear = rotation * _numbers(node.get("scale", [1, 1, 1]), 3)
    return rigid_transform(linear, _numbers(node.get("translation", [0, 0, 0]), 3))


def _primitive(
    described: Table, data: list[bytes], primitive: Any, weights: Sequence[float]
) -> tuple[Floats, Ints] | None:
    """Return vertices, moved by morph weights (3.7.2.2), and triangles of a primitive; None for points and lines."""
    if not isinstance(primitive, Mapping):
        raise GlbError("has a primitive that is not an object: export the mesh again")
    mode = primitive.get("mode", _TRIANGLES)
    attributes = primitive.get("attributes")
    if mode not in (_TRIANGLES, _STRIP, _FAN) or not isinstance(attributes, Mapping) or "POSITION" not in attributes:
        return None
    vertices = _accessor(described, data, attributes["POSITION"], np.dtype("<f4"), "VEC3").astype(np.float64)
    targets = _list(primitive, "targets")
    for target, weight in zip(targets, _numbers(weights, len(targets)) if weights else (), strict=False):
        if weight and "POSITION" in target:
            moves = _accessor(described, data, target["POSITION"], np.dtype("<f4"), "VEC3")
            if len(moves) != len(vertices):
                raise GlbError("has a morph target with another number of vertices: export the mesh again")
            vertices = vertices + weight * moves
    if primitive.get("indices") is None:
        corners: Ints = np.arange(len(vertices))
    else:
        corners = _accessor(described, data, primitive["indices"], None, "SCALAR").astype(np.int64).ravel()
    if mode == _TRIANGLES:
        return vertices, corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return vertices, np.zeros((0, 3), np.int64)
    if mode == _FAN:
        return vertices, np.stack([corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])], axis=1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    strip[1::2] = strip[1::2, [1, 0, 2]]  # every second triangle has the opposite winding
    return vertices, strip


def _accessor(described: Table, data: list[bytes], number: Any, kind: np.dtype[Any] | None, form: str) -> NDArray[Any]:
    """Return the array of an accessor, a view into the bytes of the file, which must contain all of it.

    Args:
        described: the scene description.
        data: the buffers.
        number: of the accessor.
        kind: of its entries; None: unsigned integers.
        form: SCALAR, VEC3 or VEC4.
    """
    accessors, views = _list(described, "accessors"), _list(described, "bufferViews")
    accessor = accessors[_index(number, accessors, "accessor")]
    if accessor.get("bufferView") is None or "sparse" in accessor:
        raise GlbError(f"has a sparse accessor, or one without data{_compression(described)}: export without them")
    view = views[_index(accessor["bufferView"], views, "buffer view")]
    if isinstance(view.get("extensions"), dict) and view["extensions"]:
        raise GlbError(f"has data of another form{_compression(described)}: export without compression")
    component = accessor.get("componentType")
    stored: np.dtype[Any] | None = kind
    if kind is None and isinstance(component, int):
        stored = _INDICES.get(component)
    if stored is None or accessor.get("type") != form or (kind is not None and component != _FLOAT):
        raise GlbError("has vertices or indices of a kind that is not supported: export them as plain numbers")
    buffer = data[_index(view.get("buffer"), data, "buffer")]
    length = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[form]
    width = length * stored.itemsize
    begin, room = _integer(view.get("byteOffset", 0)), _integer(view.get("byteLength"))
    stride = _integer(view.get("byteStride", 0)) or width
    offset, count = _integer(accessor.get("byteOffset", 0)), _integer(accessor.get("count"))
    if count and (offset + (count - 1) * stride + width > room or begin + room > len(buffer) or stride < width):
        raise GlbError("announces more data than it has: it is broken or cut short, export the mesh again")
    if not count:
        return np.zeros((0, length))
    return np.ndarray((count, length), stored, buffer, begin + offset, (stride, stored.itemsize))


def _compression(described: Table) -> str:
    """Return the extensions that the file uses, in parentheses; "" without."""
    used = described.get("extensionsUsed")
    return f" ({', '.join(str(each)[:60] for each in used)})" if isinstance(used, list) and used else ""


def _list(table: Table, key: str, *, numbers: bool = False) -> list[Any]:
    """Return a list of tables, or of numbers of nodes; [] if it is missing."""
    entries = table.get(key, [])
    if not isinstance(entries, list) or not all(numbers or isinstance(entry, dict) for entry in entries):
        raise GlbError(f"has '{key}' that is not a list: export the mesh again")
    return entries


def _index(number: Any, among: list[Any], what: str) -> int:
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(among):
        raise GlbError(f"refers to a missing {what}: export the mesh again")
    return number


def _integer(number: Any) -> int:
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 2**40:
        raise GlbError("has a length that is not an integer: export the mesh again")
    return number


def _numbers(values: Any, count: int) -> Floats:
    try:
        numbers = np.array(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise GlbError("has a transform that is not a list of numbers: export the mesh again") from error
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise GlbError(f"has a transform without {count} finite numbers: export the mesh again")
    return numbers
