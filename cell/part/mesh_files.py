"""From the bytes of a file of geometry to arrays: STL (binary and ASCII), OBJ, PLY, OFF, GLB, STEP.

trimesh parses OBJ, PLY, OFF and binary STL; GLB and ASCII STL are read here, because what they announce has to be held
against what they hold; STEP is read by `cell.part.cad`. One sentence says what is wrong, in our words. Coordinates
stay in the file's numbers. Vertices at exactly the same place become one, because STL repeats a corner in each face and
the others at seams.
"""

import io
import logging
import re
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import FileError
from cell.part import cad, glb
from cell.part.formats import STEP
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats, Ints

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", *STEP)

_STL_HEADER = 84  # 80 bytes of comment and the number of faces
_STL_FACE = 50


def read_bytes(path: Path) -> bytes:
    """The file's content.

    Raises:
        FileError: if it is missing, a folder, empty, not readable, or of a kind that is not supported.
    """
    supported = ", ".join(SUFFIXES)
    try:
        if path.is_dir():
            raise FileError(f"{path} is a folder; give a mesh file ({supported})")
        if not path.exists():
            raise FileError(f"{path} does not exist; give a mesh file ({supported})")
        if path.suffix.lower() not in SUFFIXES:
            kind = f"of the kind '{path.suffix}'" if path.suffix else "without a suffix"
            raise FileError(f"{path} is {kind}, which is not supported; supported are {supported}")
        content = path.read_bytes()
    except PermissionError as error:
        raise FileError(f"{path} may not be read: permission denied; change its rights or copy it") from error
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
    if not content:
        raise FileError(f"{path} is empty (0 bytes); export the mesh again")
    return content


def parse(path: Path, content: bytes) -> tuple[Floats, Ints]:
    """Vertices and triangles of a mesh file, equal vertices merged, vertices that no face uses dropped.

    Args:
        path: for the suffix and the sentences only.
        content: what is in the file.

    Returns:
        (V, 3) coordinates in the file's own numbers and axes (scenes flattened: each node placed by its transform), and
        (F, 3) corner indices.

    Raises:
        FileError: if the content is not a mesh of that kind, has no faces, or a face has a corner that is no number.
    """
    suffix = path.suffix.lower()
    if suffix in STEP:
        solids = cad.read_step(str(path), content)
        return checked(str(path), solids.vertices, solids.faces)
    if suffix == ".glb":
        try:
            return checked(str(path), *glb.triangles(content))
        except glb.BrokenGlbError as error:
            raise FileError(f"{path} {error}") from error
    if suffix == ".stl":
        content, text = _checked_stl(path, content)
        if text:
            return checked(str(path), *_text_stl(path, content))
    elif suffix in (".obj", ".off"):
        content = content.decode("utf-8", errors="replace").encode()  # comments may be in any encoding
    return checked(str(path), *_parse_with_trimesh(path, suffix, content))


def checked(source: str, vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """A mesh that can be worked with: equal vertices merged, vertices that no face uses dropped.

    Args:
        source: what the sentences call it.
        vertices: (V, 3) coordinates.
        faces: (F, 3) corner indices.

    Raises:
        FileError: if it has no faces, or a face has a corner that is missing or no number.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise FileError(f"{source} is broken: its vertices have no three coordinates; export the mesh again")
    if not len(faces):
        raise FileError(f"{source} holds no faces; it must be a triangle mesh, not points, lines or text")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileError(
            f"{source} is broken: a face refers to vertex {int(faces.max())} (counted from 0), but there are "
            f"{len(vertices)}; export the mesh again"
        )
    vertices, faces = _merge(vertices, faces)
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise FileError(
            f"{source} has {int(bad.sum())} vertices whose coordinates are not numbers (NaN or infinity); "
            "repair or export the mesh again"
        )
    return vertices, faces


def _parse_with_trimesh(path: Path, suffix: str, content: bytes) -> tuple[Floats, Ints]:
    import trimesh  # half a second of start-up that only a mesh file needs

    trimesh.util.log.setLevel(logging.CRITICAL)  # what it logs of broken files, tracebacks among it, is said here
    try:
        with warnings.catch_warnings(action="ignore"):
            loaded: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], process=False)
        if isinstance(loaded, trimesh.Scene):
            parts = [part for part in loaded.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
            loaded = trimesh.util.concatenate(parts) if parts else None
        if not isinstance(loaded, trimesh.Trimesh):
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        return np.array(loaded.vertices, np.float64), np.array(loaded.faces, np.int64)
    except Exception as error:  # a parser meets broken bytes with any exception there is; each is the same to the user
        raise FileError(
            f"{path} cannot be read as {suffix[1:].upper()}; it is broken or cut short, export it again"
        ) from error


def _checked_stl(path: Path, content: bytes) -> tuple[bytes, bool]:
    """The content of a complete STL file, and whether it is text.

    "solid" at the start does not tell the two apart (many binary writers put it there); the size does.
    """
    announced = struct.unpack_from("<I", content, 80)[0] if len(content) >= _STL_HEADER else None
    if announced is not None and len(content) >= _STL_HEADER + announced * _STL_FACE and announced:
        return content[: _STL_HEADER + announced * _STL_FACE], False
    if content.lstrip()[:5].lower() == b"solid" and b"facet" in content.lower():
        text = content.lower()
        if text.count(b"vertex") != 3 * text.count(b"endfacet"):
            raise FileError(f"{path} is cut short: its last facet is not complete; export or copy the mesh again")
        return content, True
    if all(byte in b"\t\n\r\f" or 32 <= byte < 127 or byte > 159 for byte in content[:512]):
        raise FileError(f"{path} is a text file, not an STL mesh; give a mesh ({', '.join(SUFFIXES)})")
    if announced is None or announced:
        size = f"{announced} faces ({_STL_HEADER + announced * _STL_FACE} bytes)" if announced else "a longer header"
        raise FileError(
            f"{path} is cut short or no STL: it announces {size} but has {len(content)} bytes; "
            "export or copy the mesh again"
        )
    raise FileError(f"{path} holds no faces; export the mesh again")


def _text_stl(path: Path, content: bytes) -> tuple[Floats, Ints]:
    """Corners and triangles of an ASCII STL; its normals are not looked at."""
    corners = re.findall(rb"\bvertex\s+(\S+\s+\S+\s+\S+)", content, re.IGNORECASE)
    with warnings.catch_warnings(action="ignore"):  # it reads up to the first word that is no number, and says so
        try:
            numbers = np.fromstring(b" ".join(corners).decode("ascii", errors="replace"), sep=" ")
        except ValueError:
            numbers = np.zeros(0)
    if len(numbers) != 3 * len(corners):
        raise FileError(f"{path} has a vertex that is no three numbers; it is broken, export it again")
    if len(numbers) % 9:
        raise FileError(f"{path} is cut short: its last facet is not complete; export or copy the mesh again")
    return numbers.reshape(-1, 3), np.arange(len(numbers) // 3).reshape(-1, 3)


def _merge(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """One vertex for each place (bit-exact), in the order of first use; unused ones dropped."""
    places = vertices + 0.0  # minus zero becomes zero
    bits = np.ascontiguousarray(places).view(np.uint64)
    with np.errstate(over="ignore"):
        key = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        for column in (1, 2):
            key = ((key ^ (key >> np.uint64(29))) + bits[:, column]) * np.uint64(0xBF58476D1CE4E5B9)
    order = np.argsort(key)
    begins = np.append(True, np.diff(key[order]) != 0)
    one, which = order[begins], np.empty(len(key), np.int64)
    which[order] = np.cumsum(begins) - 1
    if not (bits[one][which] == bits).all():  # two places with one hash: once in 10^7 files of a million faces
        _, one, which = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    corner = np.take(which.ravel(), faces.ravel())
    first_use = np.full(len(one), len(corner))
    first_use[corner[::-1]] = np.arange(len(corner) - 1, -1, -1)  # of a place that is named again the last counts
    named = np.zeros(len(corner) + 1, np.bool_)
    named[first_use] = True
    rank = corner[np.flatnonzero(named[:-1])]  # places in the order of first use
    position = np.empty(len(one), np.int64)
    position[rank] = np.arange(len(rank))
    return places[one[rank]], np.take(position, corner).reshape(-1, 3)


COLOUR_TOLERANCE = 32
"""Steps of 255 by which each of red, green and blue may be off: paint is blended at its borders, and rounded."""


def read_coloured(path: Path, metres: float) -> tuple[TriangleMesh, Floats]:
    """A coloured mesh.

    Args:
        path: of the file.
        metres: in one of its units.

    Returns:
        The mesh [m], and (F, 3) red, green and blue of its triangles, 0 to 255: of colours at its vertices the mean of
        three; NaN where a CAD face has none.

    Raises:
        FileError: if it cannot be read, or has no colours.
    """
    content, suffix = read_bytes(path), path.suffix.lower()
    if suffix in STEP:
        vertices, faces, of_face = cad.read_coloured_step(str(path), content)
        if np.isnan(of_face).all():
            raise FileError(f"{path} has no colours; colour its faces, or select them by their numbers")
        return TriangleMesh(vertices * metres, faces.astype(np.int32)), of_face
    import trimesh  # half a second of start-up that only a painted mesh needs

    try:
        with warnings.catch_warnings(action="ignore"):
            loaded: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], process=False)
            if isinstance(loaded, trimesh.Scene):
                loaded = loaded.to_mesh()
            visual = loaded.visual
            visual = visual.to_color() if visual.kind == "texture" else visual
            known = visual.kind in ("vertex", "face")
            colours = np.array(visual.face_colors, np.float64)[:, :3] if known else None
        mesh = TriangleMesh(np.array(loaded.vertices) * metres, np.array(loaded.faces, np.int32))
    except Exception as error:  # a parser meets broken bytes with any exception there is; each is the same to the user
        raise FileError(f"{path} cannot be read as a coloured mesh; export it again") from error
    if colours is None:
        raise FileError(f"{path} has no colours; paint it, and export it as PLY with colours")
    return mesh, colours


def is_colour(colours: Floats, colour: str) -> Bools:
    """(F,) which of (F, 3) colours are `#rrggbb`, to `TOLERANCE`."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return np.asarray((np.abs(colours - wanted) <= COLOUR_TOLERANCE).all(axis=1))
