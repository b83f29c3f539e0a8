"""Geometry files as arrays: STL (binary and ASCII), OBJ, PLY, OFF, GLB, glTF, 3MF, STEP; coloured meshes.

The readers of this package check counts and indices against the content, because a mesh library that skips what it does
not know returns another part. Coordinates are not scaled. Vertices at the same position are merged, because STL
repeats a corner in each face, and the other formats repeat it at seams.
"""

import io
import re
import struct
import warnings
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cell import files
from cell.errors import FileError
from cell.part import cad, glb, three_mf
from cell.part.formats import STEP, SUFFIXES, UNITS
from cell.part.polygon_files import read_obj, read_off, read_ply
from cell.part.polygons import PolygonError, PolygonMesh, distance_problem, triangulate
from cell.text import decode, lines_of, parse_numbers
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats, Ints

_POLYGON_READERS: Mapping[str, Callable[[bytes], PolygonMesh]] = {".obj": read_obj, ".off": read_off, ".ply": read_ply}

_OTHER_CONTENT = {
    b"version https://git-lfs": ("is a pointer of Git LFS, not the file itself; run git lfs pull",),
    b"<!doctype html": ("is a web page, not a mesh; download the file itself",),
    b"<html": ("is a web page, not a mesh; download the file itself",),
    b"\x1f\x8b": ("is compressed (gzip); unpack it first",),
    b"pk\x03\x04": ("is a ZIP archive; unpack it first", ".3mf"),
    b"gltf\x02": ("is a binary glTF file; name it .glb", ".glb"),
}
"""Sentence for the first bytes of other files, and the suffixes that may have them."""

_ROUNDING = 1.1e-9
"""Distance of equal vertices as a share of the largest coordinate: CAD programs write rounding errors, such as 1e-17
for zero, which differ between the corners at one vertex."""

_STL_HEADER = 84  # 80 bytes of comment and the number of faces
_STL_FACE = 50
_STL_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_END = re.compile(r"end[ \t]*solid[^\r\n]*[\s\0\x1a]*\Z")
_STL_FACET_END = re.compile(r"end[ \t]*facet")
_LINE_END = re.compile(r"[\r\n]")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)


def read_bytes(path: Path) -> bytes:
    """Read a geometry file.

    Raises:
        FileError: if it is missing, a folder, empty, not readable, or of an unsupported format.
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
        content = files.read_bytes(path)
    except PermissionError as error:
        raise FileError(f"{path} cannot be read: permission denied; change its permissions or copy it") from error
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
    if not content:
        raise FileError(f"{path} is empty (0 bytes); export the mesh again")
    for begin, what in _OTHER_CONTENT.items():
        if content[:40].lower().startswith(begin) and path.suffix.lower() not in what[1:]:
            raise FileError(f"{path} {what[0]}")
    return content


def parse(path: Path, content: bytes) -> tuple[Floats, Ints]:
    """Return vertices and triangles of a mesh file, with equal vertices merged and unused ones dropped.

    Args:
        path: for the suffix, the messages, and the files beside a .gltf.
        content: of the file.

    Returns:
        Coordinates (V, 3) in the units and axes of the file, with the nodes of a scene at their transforms, and corner
        indices (F, 3).

    Raises:
        FileError: if the content is not a mesh of this format, has no faces, or a used coordinate is not finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of transforms; `check_mesh` finds what is not finite
        return check_mesh(str(path), *_read(path, content))


def parse_metres(path: Path, content: bytes, units: str) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) [m] and triangles (F, 3) of a mesh file, as `parse` in the axes of the file.

    Args:
        path: for the suffix, the messages, and the files beside a .gltf.
        content: of the file.
        units: of the file, a key of `UNITS`; "m" for 3MF, and for a STEP file that states its unit.

    Raises:
        UsageError: if both a STEP file and the caller state a unit, or neither does.
        FileError: as `parse`.
    """
    if path.suffix.lower() in STEP:
        solids = cad.read_step(str(path), content, units)
        return check_mesh(str(path), solids.vertices, solids.faces)
    vertices, faces = parse(path, content)
    return vertices * UNITS[units], faces


def _read(path: Path, content: bytes) -> tuple[Floats, Ints]:
    """Return vertices and triangles of a mesh file as they are."""
    suffix = path.suffix.lower()
    if suffix in STEP:
        solids = cad.read_step(str(path), content)
        return solids.vertices, solids.faces
    try:
        if suffix in (".glb", ".gltf"):
            return glb.triangles(content, path.parent if suffix == ".gltf" else None)
        if suffix == ".3mf":
            return three_mf.triangles(content)
        if suffix == ".stl":
            return _parse_stl(path, content)
        mesh = _POLYGON_READERS[suffix](content)
        return mesh.vertices, triangulate(mesh)[0]
    except (glb.GlbError, three_mf.ThreeMfError, PolygonError) as error:
        raise FileError(f"{path} {error}") from error
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path} has the byte order mark of {error.encoding} but other bytes; export it again"
        ) from error


def check_mesh(source: str, vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Check a mesh, merge equal vertices and drop unused ones.

    Args:
        source: its name in messages.
        vertices: (V, 3) coordinates.
        faces: (F, 3) corner indices.

    Raises:
        FileError: if it has no faces, or a face has a missing, a non-finite or a too distant corner.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise FileError(f"{source} is broken: its vertices do not have three coordinates; export the mesh again")
    if not len(faces):
        raise FileError(f"{source} holds no faces; it must be a triangle mesh, not points, lines or text")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise FileError(f"{source} is broken: its faces do not have three corners; export the mesh again, as triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise FileError(
            f"{source} is broken: a face refers to vertex {int(wrong)} (counted from 0), but there are "
            f"{len(vertices)}; export the mesh again"
        )
    vertices, faces = _merge_vertices(vertices, faces)
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise FileError(
            f"{source} has {int(bad.sum())} vertices whose coordinates are not numbers (NaN or infinity); "
            "repair or export the mesh again"
        )
    if problem := distance_problem(vertices):
        raise FileError(f"{source} {problem}")
    return vertices, faces


def _parse_stl(path: Path, content: bytes) -> tuple[Floats, Ints]:
    """Return corners and triangles of a binary or ASCII STL.

    The size distinguishes the formats: many binary files also begin with "solid".
    """
    announced = struct.unpack_from("<I", content, 80)[0] if len(content) >= _STL_HEADER else None
    if announced and len(content) >= _STL_HEADER + announced * _STL_FACE:
        trailer = content[_STL_HEADER + announced * _STL_FACE :]
        if len(trailer) >= _STL_FACE and trailer.strip(b"\0"):
            raise FileError(
                f"{path} announces {announced} faces but has {len(trailer)} bytes behind them, the size of "
                f"{len(trailer) // _STL_FACE} more; export all bodies again, in one file"
            )
        rows = np.frombuffer(content, _STL_ROW, announced, _STL_HEADER)
        return rows["corners"].reshape(-1, 3).astype(np.float64), np.arange(3 * announced).reshape(-1, 3)
    is_text = b"\0" not in content.strip(b"\0") or content.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    text = decode(content) if is_text else ""
    if text.lstrip("\ufeff \t\r\n\0")[:5].lower() == "solid" and re.search("facet|endsolid", text, re.IGNORECASE):
        return _parse_ascii_stl(path, text)
    if all(byte in b"\t\n\r\f" or 32 <= byte < 127 or byte > 159 for byte in content[:512]):
        raise FileError(f"{path} is a text file, not an STL mesh; give a mesh ({', '.join(SUFFIXES)})")
    if announced is None or announced or len(content) > _STL_HEADER:
        size = (
            f"{announced} faces ({_STL_HEADER + announced * _STL_FACE} bytes)"
            if announced is not None
            else "a longer header"
        )
        raise FileError(
            f"{path} is cut short or no STL: it announces {size} but has {len(content)} bytes; "
            "export or copy the mesh again"
        )
    raise FileError(f"{path} holds no faces; export the mesh again")


def _parse_ascii_stl(path: Path, text: str) -> tuple[Floats, Ints]:
    """Return corners and triangles of an ASCII STL; its normals are ignored."""
    text = text.lower()
    has_end = _STL_END.search(text) is not None
    text = _without_names(text)
    words = [row.split(None, 3) for row in text.split("vertex")[1:]]
    rows = [" ".join(each[:3]) for each in words]
    numbers = parse_numbers(" ".join(rows), 3 * len(rows))
    if numbers is None or any(len(each) > 3 and each[3][0] in "+-.,0123456789" for each in words):
        for number, line in enumerate(lines_of(text), start=1):
            keyword, row = [*line.split(None, 1), "", ""][:2]
            if keyword == "vertex" and not (len(row.split()) == 3 and all(map(_NUMBER.fullmatch, row.split()))):
                hint = "write decimal points and no commas" if "," in row else "it needs three numbers"
                raise FileError(f"{path} has a vertex that cannot be read, line {number}: {row.strip()[:60]}; {hint}")
        raise FileError(f"{path} has a vertex without three numbers; export the mesh again")
    facets = _STL_FACET_END.split(text)
    if text.count("facet") != 2 * (len(facets) - 1):
        raise FileError(f"{path} is cut short: its last facet is not complete; export or copy the mesh again")
    for number, facet in enumerate(facets[:-1] if len(rows) != 3 * (len(facets) - 1) else (), start=1):
        if (n_corners := facet.count("vertex")) != 3:
            raise FileError(f"{path} has a facet with {n_corners} corners (facet {number}); an STL facet has three")
    if len(rows) % 3:
        raise FileError(f"{path} has a vertex outside its facets; export the mesh again")
    if not has_end:
        raise FileError(f"{path} does not end with 'endsolid'; it is cut short, export or copy the mesh again")
    return numbers.reshape(-1, 3), np.arange(len(rows)).reshape(-1, 3)


def _without_names(text: str) -> str:
    """Remove the rest of each line with `solid` or `endsolid`: a name can be any text."""
    pieces, begin = [], 0
    while (at := text.find("solid", begin)) >= 0:
        pieces.append(text[begin:at])
        end = _LINE_END.search(text, at)
        begin = end.start() if end else len(text)
    return "".join([*pieces, text[begin:]])


def _merge_vertices(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Merge vertices at equal positions, in the order of first use; drop unused ones."""
    has_face = np.zeros(len(vertices), np.bool_)
    has_face[faces] = True
    places = vertices + 0.0  # minus zero becomes zero
    size = np.abs(vertices[has_face])
    step = _ROUNDING * size.max(initial=0.0, where=np.isfinite(size)) or 1.0
    bits = np.ascontiguousarray(np.rint(places / step) + 0.0).view(np.uint64)
    with np.errstate(over="ignore"):
        key = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        for column in (1, 2):
            key = ((key ^ (key >> np.uint64(29))) + bits[:, column]) * np.uint64(0xBF58476D1CE4E5B9)
    order = np.argsort(key)
    begins = np.append(True, np.diff(key[order]) != 0)
    one, which = order[begins], np.empty(len(key), np.int64)
    which[order] = np.cumsum(begins) - 1
    if not (bits[one][which] == bits).all():  # hash collision: once in 10^7 files of a million faces
        _, one, which = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    corner = np.take(which.ravel(), faces.ravel())
    first_use = np.full(len(one), len(corner))
    first_use[corner[::-1]] = np.arange(len(corner) - 1, -1, -1)  # the last assignment, which is the first use, remains
    is_used = np.zeros(len(corner) + 1, np.bool_)
    is_used[first_use] = True
    rank = corner[np.flatnonzero(is_used[:-1])]  # positions in the order of first use
    position = np.empty(len(one), np.int64)
    position[rank] = np.arange(len(rank))
    return places[one[rank]], np.take(position, corner).reshape(-1, 3)


COLOUR_TOLERANCE = 32
"""Tolerance of red, green and blue in steps of 255: colours are blended at borders, and rounded."""


def read_coloured(path: Path, units: str) -> tuple[TriangleMesh, Floats]:
    """Read a coloured mesh: STEP, PLY, OBJ, OFF or GLB.

    Args:
        path: of the file.
        units: of the file, as of `parse_metres`.

    Returns:
        The mesh [m], and red, green and blue of its triangles (F, 3), 0 to 255: the mean of vertex colours; NaN for a
        CAD face without colour.

    Raises:
        UsageError: if both a STEP file and the caller state a unit, or neither does.
        FileError: if it cannot be read, or has no colours.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        mesh, colours = _read_coloured(path, units)
    if problem := distance_problem(mesh.vertices / UNITS[units]):
        raise FileError(f"{path} {problem}")
    return mesh, colours


def _read_coloured(path: Path, units: str) -> tuple[TriangleMesh, Floats]:
    content, suffix, metres = read_bytes(path), path.suffix.lower(), UNITS[units]
    if suffix in STEP:
        vertices, faces, of_face = cad.read_coloured_step(str(path), content, units)
        if np.isnan(of_face).all():
            raise FileError(f"{path} has no colours; colour its faces, or select them by their numbers")
        return TriangleMesh(vertices, faces.astype(np.int32)), of_face
    if suffix not in (*_POLYGON_READERS, ".glb"):
        raise FileError(f"{path} is '{suffix}'; colours are read from STEP, PLY, OBJ, OFF and GLB")
    try:
        if suffix in _POLYGON_READERS:
            polygons = _POLYGON_READERS[suffix](content)
            faces, owner = triangulate(polygons)
            mesh = TriangleMesh(polygons.vertices * metres, faces.astype(np.int32))
            colours = None if polygons.colours is None else polygons.colours[owner]
        else:
            mesh, colours = _read_textured(content, suffix, metres)
    except (PolygonError, PlannerError) as error:
        raise FileError(f"{path} {error}") from error
    except Exception as error:  # trimesh's parsers raise any exception for broken bytes
        raise FileError(f"{path} cannot be read as a coloured mesh; export it again") from error
    if colours is None:
        raise FileError(f"{path} has no colours; paint it, and export it as PLY with colours")
    return mesh, colours


def _read_textured(content: bytes, suffix: str, metres: float) -> tuple[TriangleMesh, Floats | None]:
    import trimesh  # half a second, only for materials and textures

    with warnings.catch_warnings(action="ignore"):
        loaded: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], process=False)
        if isinstance(loaded, trimesh.Scene):
            loaded = loaded.to_mesh()
        visual = loaded.visual
        visual = visual.to_color() if visual.kind == "texture" else visual
        known = visual.kind in ("vertex", "face")
        colours = np.array(visual.face_colors, np.float64)[:, :3] if known else None
    return TriangleMesh(np.array(loaded.vertices) * metres, np.array(loaded.faces, np.int32)), colours


def is_colour(colours: Floats, colour: str) -> Bools:
    """Return which colours (F, 3) are `#rrggbb`, within `COLOUR_TOLERANCE`."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return np.asarray((np.abs(colours - rgb) <= COLOUR_TOLERANCE).all(axis=1))
