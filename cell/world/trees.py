"""The true triangles that decide where a hull in the model only finds what to look at; built when asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from planner.surface.mesh import TriangleMesh

if TYPE_CHECKING:
    import mujoco

    from cell.world.triangles import TriangleTree


KIND = {6: 0, 5: 1}
"""`cell.world.triangle_distance.BOX` and `CYLINDER` by MuJoCo's type of a shape."""


class _Trees(Mapping[int, "TriangleTree"]):
    """Trees by geom, each built when it is first asked for: half a second where nothing comes near its hull."""

    def __init__(self, meshes: dict[int, TriangleMesh]) -> None:
        self._meshes = meshes
        self._built: dict[int, TriangleTree] = {}

    def __getitem__(self, geom: int) -> TriangleTree:
        if geom not in self._built:
            from cell.world.triangles import TriangleTree  # its kernels load numba

            self._built[geom] = TriangleTree(self._meshes[geom])
        return self._built[geom]

    def __contains__(self, geom: object) -> bool:
        return geom in self._meshes

    def __iter__(self) -> Iterator[int]:
        return iter(self._meshes)

    def __len__(self) -> int:
        return len(self._meshes)


def trees_of(model: mujoco.MjModel, meshes: Mapping[str, TriangleMesh]) -> Mapping[int, TriangleTree]:
    """True triangles in the frame of their body, by the geom of that name that stands for them in a model."""
    return _Trees({model.geom(name).id: mesh for name, mesh in meshes.items()})
