"""Where the meshes of a robot's description lie: beside it, in its package, or where a package is said to be."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from cell.errors import FileError


def mesh_files(path: Path, packages: Mapping[str, Path]) -> list[Path]:
    """The mesh files that a URDF's links collide as, or that an MJCF names, each once, in the file's order.

    Args:
        path: the description, which can be read.
        packages: folders of ROS packages by name.

    Raises:
        FileError: if one is not there.
    """
    root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    if root.tag == "robot":
        names = [mesh.get("filename", "") for collision in root.iter("collision") for mesh in collision.iter("mesh")]
    else:
        compiler = root.find("compiler")
        folder = Path("" if compiler is None else compiler.get("meshdir", ""))
        names = [str(folder / file) for mesh in root.iter("mesh") if (file := mesh.get("file")) is not None]
    return [mesh_file(name, path, packages) for name in dict.fromkeys(names)]


def mesh_file(name: str, path: Path, packages: Mapping[str, Path]) -> Path:
    """Where a mesh of a URDF is.

    Raises:
        FileError: if it is nowhere that was looked.
    """
    plain = name.removeprefix("file://")
    if name.startswith("package://"):
        package, _, inside = name.removeprefix("package://").partition("/")
        tried = [packages[package] / inside] if package in packages else []
        # A description beside its package's folder, or within it.
        tried += [folder / inside for folder in path.resolve().parents if folder.name == package]
        tried += [folder / package / inside for folder in path.resolve().parents]
        hint = f"; say where the package is: --package {package}=DIR"
    else:
        tried, hint = [path.resolve().parent / plain], ""
    for file in tried:
        if file.is_file():
            return file
    raise FileError(f"{path} names the mesh {name}, and there is no {tried[0]}{hint}")
