"""Child process of `cell.part.cad`: triangulate a STEP file with Open CASCADE, which can crash on broken files.

It is run by its path and imports only cascadio.
"""

import sys
from pathlib import Path


def main(source: str, target: str, deviation_mm: str, turn_rad: str, by_face: str) -> None:
    """Write the GLB of a STEP file: one primitive per body with descriptions of its faces, or one per face."""
    # cascadio would import trimesh, only to register itself there: three quarters of the time of this process.
    sys.modules["trimesh"] = None  # type: ignore[assignment]
    import cascadio

    content: bytes = cascadio.load(
        Path(source).read_bytes(), file_type="step", tol_linear=float(deviation_mm), tol_angular=float(turn_rad),
        use_parallel=False, include_brep=not int(by_face), merge_primitives=not int(by_face),
    )  # fmt: skip
    Path(target).write_bytes(content)


if __name__ == "__main__":
    main(*sys.argv[1:])
