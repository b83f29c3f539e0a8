"""A pose as a matrix or with a quaternion, as calibrations give it; the scene says poses in mm and KUKA's ABC."""

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

_NEAR = 1e-3
"""How far a rotation may be from one: the rounding of numbers with four decimals. It is made one exactly."""


def require_one_form(
    quaternion: Sequence[float] | None, matrix_mm: Sequence[Sequence[float]] | None, given: Collection[str]
) -> None:
    """Refuse a pose that is said in two ways, or that is none.

    Args:
        quaternion: (w, x, y, z), or None.
        matrix_mm: four rows of four, or None.
        given: keys that the table has.

    Raises:
        ValueError: as pydantic takes it, with the key.
    """
    said = {"quaternion": ("abc_deg",), "matrix_mm": ("position_mm", "abc_deg", "quaternion")}
    for key, value in (("matrix_mm", matrix_mm), ("quaternion", quaternion)):
        if value is not None and (beside := [other for other in said[key] if other in given]):
            raise ValueError(f".{key} is given beside {beside[0]}; say the pose in one way")
    if quaternion is not None and abs(float(np.linalg.norm(quaternion)) - 1) > _NEAR:
        raise ValueError(f".quaternion has the length {np.linalg.norm(quaternion):.4g}; it must be 1 (w, x, y, z)")
    if matrix_mm is None:
        return
    T = np.array(matrix_mm)
    R = T[:3, :3]
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 0:
        raise ValueError(
            ".matrix_mm has another last row than 0, 0, 0, 1; give four rows of a transform, positions in mm"
        )
    if np.abs(R @ R.T - np.eye(3)).max() > _NEAR or np.linalg.det(R) < 0:
        raise ValueError(".matrix_mm holds no rotation (rows at right angles, of length 1, right-handed)")


def of_matrix(matrix_mm: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """(4, 4) [m] of four rows of four whose last column is a position [mm]."""
    given = np.array(matrix_mm, dtype=np.float64)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_matrix(given[:3, :3]).as_matrix(), given[:3, 3] / 1000
    return T


def of_quaternion(position_mm: Sequence[float], quaternion: Sequence[float]) -> NDArray[np.float64]:
    """(4, 4) [m] of a position [mm] and (w, x, y, z)."""
    w, x, y, z = quaternion
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(position_mm) / 1000
    return T
