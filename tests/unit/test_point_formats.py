"""Point files as programs write them: the points, or a sentence with the cause and its line."""

import struct
from pathlib import Path

import numpy as np
import pytest

from cell.errors import FileError
from cell.metrology.point_files import missing_file, read
from planner.values import Floats

POINTS = np.array([[0.25 + 5 * i, 0.5 + 5 * j, 12.5 + 0.125 * (i % 3)] for i in range(8) for j in range(5)])


def rows(separator: str = " ", *, comma: bool = False, before: str = "", after: str = "", form: str = "{:.3f}") -> str:
    """Return the points as lines; `{k}` in `before` is their number."""
    lines = []
    for k, point in enumerate(POINTS):
        words = [form.format(value) for value in point]
        words = [word.replace(".", ",") for word in words] if comma else words
        lines.append(before.format(k=k) + separator.join(words) + after)
    return "\n".join(lines) + "\n"


def read_text(folder: Path, content: str | bytes, name: str = "points.xyz") -> Floats:
    """Return the points of a file with this content."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read(path)


READABLE = {
    "blanks": rows(),
    "commas": rows(","),
    "comma and blank": rows(", "),
    "semicolons": rows(";"),
    "tabs": rows("\t"),
    "last separator": rows(",", after=","),
    "decimal commas, semicolons": rows(";", comma=True),
    "decimal commas, tabs": rows("\t", comma=True),
    "decimal commas, blanks": rows(" ", comma=True),
    "header": "X Y Z\n" + rows(),
    "header with units": '"x [mm]";"y [mm]";"z [mm]"\n' + rows(";"),
    "header in a comment": "//X Y Z Intensity\n" + rows(after=" 17"),
    "number of points": f"{len(POINTS)}\n" + rows(),
    "header and number": f"//X;Y;Z\n{len(POINTS)}\n" + rows(";"),
    "number of each point": "# id x y z\n" + rows(before="{k} "),
    "name of each point": "name,x,y,z\n" + rows(",", before="P{k},"),
    "comments": "% exported\n# Größe\n" + rows(),
    "quotes": '"' + rows('","', after='"').replace("\n", '\n"').rstrip('"'),
    "missing values": rows() + "-nan(ind) -nan(ind) -nan(ind)\n1.#QNAN 1.#QNAN 1.#QNAN\nnan nan nan\n",
    "intensity": rows(after=" 0.5"),
}


@pytest.mark.parametrize("case", READABLE)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_tables_are_read_in_every_form(tmp_path: Path, case: str, encoding: str) -> None:
    """Separators, headers, counts and encodings do not change the points."""
    assert read_text(tmp_path, READABLE[case].encode(encoding)) == pytest.approx(POINTS)


AMBIGUOUS = {
    "thousands": ("1,000.250 1,000.500 1,012.500\n", "'1,000.250', line 1: write decimal points"),
    "thousands or decimals": ("1,000 2,000 3,500\n", "decimal or a thousands separator"),
    "commas for both": ("0,250,0,500,12,500\n0,250,5,500,12,625\n", "six integers in line 1"),
    "numbers first": (rows(before="{k} "), "the first counts the points"),
    "names first": (rows(before="P{k} "), "'P0' where a number or the names x, y and z are expected, line 1"),
    "cut short": (rows() + "12.25 3\n", f"2 numbers in line {len(POINTS) + 1}"),
    "fewer than announced": (f"{len(POINTS) + 1}\n" + rows(), "announces 41 points but has 40"),
    "integers first": (rows(before="7{k} "), "the first has only integers"),
    "binary": (b"LASF\0\1\2\3".decode(), "not a text file"),
    "header only": ("x y z\n", "has no points"),
    "two columns": ("1 2\n3 4\n", "x, y and z are needed"),
    "Fortran": ("1.0D+01 2.0D+01 3.0D+01\n", "'1.0D[+]01'.*line 1"),
    "a word": (rows() + "1 2 three\n", f"'three' where a number is expected, line {len(POINTS) + 1}"),
    "empty": ("", "is empty"),
}


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_can_be_read_in_two_ways_is_refused(tmp_path: Path, case: str) -> None:
    """The sentence names the word, the line and the cause."""
    content, sentence = AMBIGUOUS[case]
    with pytest.raises(FileError, match=sentence):
        read_text(tmp_path, content)


def ply(form: str, properties: list[str], body: bytes, before: str = "", comment: bytes = b"") -> bytes:
    """Return a PLY file of vertices."""
    head = f"{before}element vertex {len(POINTS)}\n" + "".join(f"property {each}\n" for each in properties)
    return f"ply\nformat {form} 1.0\n".encode() + comment + head.encode() + b"end_header\n" + body


XYZ = ["float x", "float y", "float z"]
LITTLE, BIG = "binary_little_endian", "binary_big_endian"
PLY = {
    "camera first": ply("ascii", XYZ, b"1.5\n" + rows().encode(), "element camera 1\nproperty float f\n"),
    "camera first, binary": ply(
        LITTLE,
        XYZ,
        struct.pack("<f", 1.5) + POINTS.astype("<f4").tobytes(),
        "element camera 1\nproperty float f\n",
    ),
    "lists": ply(
        LITTLE,
        [*XYZ, "list uchar int view"],
        b"".join(struct.pack(f"<3fB{k % 3}i", *point, k % 3, *range(k % 3)) for k, point in enumerate(POINTS)),
    ),
    "big endian": ply(BIG, [each.replace("float", "double") for each in XYZ], POINTS.astype(">f8").tobytes()),
    "upper case": ply("ascii", [each.upper().replace("FLOAT", "float") for each in XYZ], rows().encode()),
    "Latin-1 comment": ply("ascii", XYZ, rows().encode(), comment="comment Prüfstück\n".encode("latin-1")),
    "comment end_header": ply("ascii", XYZ, rows().encode(), comment=b"comment the end_header is binary\n"),
    "mark in the body": ply("ascii", XYZ, b"\xef\xbb\xbf" + rows().encode()),
    "mark": b"\xef\xbb\xbf" + ply("ascii", XYZ, rows().encode()),
}


@pytest.mark.parametrize("case", PLY)
def test_ply_points_in_every_form(tmp_path: Path, case: str) -> None:
    """Other elements, lists, comments and marks do not change the points."""
    assert read_text(tmp_path, PLY[case], "points.ply") == pytest.approx(POINTS)


def pcd(
    fields: str, sizes: str, types: str, counts: str, kind: str, body: bytes, comment: bytes = b"# .PCD v.7\n"
) -> bytes:
    """Return a PCD file."""
    header = (
        f"VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {len(POINTS)}\nHEIGHT 1\n"
    )
    return comment + f"{header}POINTS {len(POINTS)}\nDATA {kind}\n".encode() + body


def lzf(data: bytes) -> bytes:
    """Compress with LZF: references of eight bytes to what stands 12 bytes before, where equal, else literals."""
    out, at = b"", 0
    while at < len(data):
        if at >= 12 and data[at : at + 8] == data[at - 12 : at - 4] and at + 8 <= len(data):
            out += bytes([(6 << 5) | 0, 11])
            at += 8
        else:
            out += bytes([0, data[at]])
            at += 1
    return struct.pack("<II", len(out), len(data)) + out


PADDED = b"".join(struct.pack("<3f4xf12x", *point, 7) for point in POINTS)
COLUMNS = POINTS.T.astype("<f4").tobytes()
PCD = {
    "padding": pcd("x y z _ intensity _", "4 4 4 1 4 1", "F F F U F U", "1 1 1 4 1 12", "binary", PADDED),
    "empty fields": pcd("x y z _ r _", "4 4 4 1 2 1", "F F F U U U", "1 1 1 0 1 0", "binary",
                        b"".join(struct.pack("<3fH", *point, 1) for point in POINTS)),
    "padding, text": pcd("x y z _ i", "4 4 4 1 4", "F F F U F", "1 1 1 4 1", "ascii",
                         rows(after=" 0 0 0 0 7").encode()),
    "packed": pcd("x y z", "4 4 4", "F F F", "1 1 1", "binary_compressed", lzf(COLUMNS)),
    "comment with DATA": pcd("x y z", "4 4 4", "f f f", "1 1 1", "ascii", rows().encode(),
                             "# RAW DATA ü\n".encode("latin-1")),
}  # fmt: skip


def test_pcd_counts_are_compared(tmp_path: Path) -> None:
    """More points than announced, and a grid of another size, are refused; CSV is a text."""
    for kind, body in (("ascii", rows().encode()), ("binary", POINTS.astype("<f4").tobytes())):
        content = pcd("x y z", "4 4 4", "F F F", "1 1 1", kind, body + body)
        with pytest.raises(FileError, match=r"announces 40|behind its 40 points"):
            read_text(tmp_path, content, "points.pcd")
        with pytest.raises(FileError, match="announces 40 points but WIDTH 40 and HEIGHT 2"):
            read_text(tmp_path, content.replace(b"HEIGHT 1", b"HEIGHT 2"), "points.pcd")
    assert read_text(tmp_path, rows(","), "points.csv") == pytest.approx(POINTS)


@pytest.mark.parametrize("case", PCD)
def test_pcd_points_in_every_form(tmp_path: Path, case: str) -> None:
    """Padding, empty fields, packed data and comments are read."""
    assert read_text(tmp_path, PCD[case], "points.pcd") == pytest.approx(POINTS)


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
def test_a_pcd_without_points(tmp_path: Path, kind: str) -> None:
    """An empty scan is read."""
    body = bytes(8) if kind == "binary_compressed" else b""
    content = pcd("x y z", "4 4 4", "F F F", "1 1 1", kind, body).replace(b"WIDTH 40", b"WIDTH 0")
    assert read_text(tmp_path, content.replace(b"POINTS 40", b"POINTS 0"), "points.pcd").shape == (0, 3)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (pcd("x y z", "4 4 4", "F F F", "1 1 1", "binary_compressed", struct.pack("<II4x", 4, 9)), "unpacked bytes"),
        (pcd("x y z", "4 4 4", "F F F", "1 1 1", "binary_compressed", struct.pack("<II", 3, 480) + b"\xff" * 3),
         "cannot be unpacked"),
        (pcd("x y z", "4 4 4", "F F F", "1 1 1", "binary", b"short"), "ends before its 40 points"),
        (pcd("a b c", "4 4 4", "F F F", "1 1 1", "ascii", rows().encode()), "no x, y and z"),
        (pcd("x y z", "4 4", "F F F", "1 1 1", "ascii", rows().encode()), "of equal length"),
        (pcd("x y z", "1 4 4", "F F F", "1 1 1", "binary", bytes(9 * len(POINTS))), "without valid FIELDS"),
        (pcd("x y z", "4 4 4", "F F F", "1 1 2", "binary", bytes(16 * len(POINTS))), r"its fields are x, y, z \(2\)"),
        (pcd("x y z", "4 4 4", "F F F", "1 1 0", "ascii", rows().encode()), r"its fields are x, y, z \(0\)"),
        (pcd("x y z", "4 4 4", "F F F", "1 1 1", "ascii", b"\xff\xfe1\n" * len(POINTS)), "without 3 numbers"),
        (b"nothing", "no DATA line"),
    ],
)  # fmt: skip
def test_a_pcd_that_cannot_be_read_is_refused(tmp_path: Path, content: bytes, sentence: str) -> None:
    """The sentence names the cause."""
    with pytest.raises(FileError, match=sentence):
        read_text(tmp_path, content, "points.pcd")


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\n", "header has no end"),
        (ply(LITTLE, XYZ, b"12"), "ends before its 40 rows of 'vertex'"),
        (ply("middle_endian", XYZ, b""), "not PLY, line 2: format middle_endian"),
        (ply("ascii", ["half x"], b""), "not PLY, line 4: property half x"),
        (ply("ascii", XYZ[:2], b"1 2\n" * len(POINTS)), "no property z"),
        (ply("ascii", XYZ, rows(after=" 7").encode()), "40 numbers more than its header announces"),
        (ply(LITTLE, XYZ, POINTS.astype("<f4").tobytes() + b"more"), "4 bytes more than its header announces"),
        (ply("ascii", XYZ, rows(comma=True).encode()), "line 8; write decimal points"),
        (b"ply\nelement vertex 0\nend_header\n", "no format line"),
    ],
)
def test_a_ply_that_cannot_be_read_is_refused(tmp_path: Path, content: bytes, sentence: str) -> None:
    """The sentence names the cause and the line."""
    with pytest.raises(FileError, match=sentence):
        read_text(tmp_path, content, "points.ply")


def test_other_formats_are_named(tmp_path: Path) -> None:
    """The sentence lists the formats that are read."""
    with pytest.raises(FileError, match=r"'\.stl'; points are read from \.ply, \.pcd, \.xyz"):
        read_text(tmp_path, b"solid", "a.stl")


def test_a_file_of_a_view_in_another_format_is_named(tmp_path: Path) -> None:
    """The sentence has the file and the formats, in place of "no file"."""
    (tmp_path / "scan_0003.e57").write_bytes(b"ASTM-E57")
    assert "scan_0003.e57 of view 3 is '.e57'; points are read from .ply" in missing_file(tmp_path, 3)
    assert "has no file of view 4; name it by that number, such as 0004.ply" in missing_file(tmp_path, 4)
