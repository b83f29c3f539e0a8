"""Pictures without a display: a MuJoCo renderer on EGL, else on OSMesa.

Which of the two can be loaded is found out with `ctypes` before PyOpenGL is imported, because PyOpenGL binds one
platform for the life of the process. `MUJOCO_GL=egl` or `MUJOCO_GL=osmesa` in the environment chooses.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError

if TYPE_CHECKING:
    import mujoco

Image = NDArray[np.uint8]
Decorate = Callable[["mujoco.MjvScene"], None]

PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri (EGL) or libosmesa6 (OSMesa)"
_MAX_GEOMS = 20_000
_EGL_PLATFORM_DEVICE = 0x313F


def backend() -> str | None:
    """The library that can draw without a display: "egl", "osmesa" or None.

    MUJOCO_GL leaves only the one that it names to be looked at.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in ("", "egl") and _has_egl():
        return "egl"
    if wanted in ("", "osmesa") and _has_osmesa():
        return "osmesa"
    return None


def require_backend() -> str:
    """The library that draws; call it before MuJoCo is imported, whose import fails for a MUJOCO_GL that is not there.

    Raises:
        UsageError: if there is neither EGL nor OSMesa.
    """
    chosen = backend()
    if chosen is None:
        only = os.environ.get("MUJOCO_GL", "").strip()
        named = f" (MUJOCO_GL={only} leaves no other to be tried)" if only else ""
        raise UsageError(
            f"pictures without a display need EGL or OSMesa, and neither can be loaded{named}; install the packages "
            f"{PACKAGES}, or replay on a display without --frames and --picture"
        )
    return chosen


class OffScreen:
    """Draws scenes of one model into arrays; a context manager, because it holds a GL context."""

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], samples: int = 4) -> None:
        """Open the context.

        Args:
            model: what is drawn.
            size: (width, height) [pixels]; the model's off-screen buffer must be as large.
            samples: per pixel, against jagged edges; software rendering takes time in proportion.

        Raises:
            UsageError: if there is neither EGL nor OSMesa.
        """
        chosen = require_backend()
        import mujoco

        if chosen == "egl":
            from mujoco.egl import GLContext
        else:
            from mujoco.osmesa import GLContext
        self._size = size
        self._model = model
        model.vis.quality.offsamples = samples
        try:
            self._gl: Any = GLContext(*size)
            self._gl.make_current()
            with _named(chosen):
                self._context = mujoco.MjrContext(model, int(mujoco.mjtFontScale.mjFONTSCALE_150))
        except (ImportError, RuntimeError, mujoco.FatalError) as error:
            raise UsageError(
                f"pictures without a display cannot be drawn with {chosen}: {error}; install the packages {PACKAGES}"
            ) from error
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._context)
        self._rectangle = mujoco.MjrRect(0, 0, *size)
        self.scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self.option = mujoco.MjvOption()

    def __enter__(self) -> OffScreen:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.free()
        self._gl.free()

    def picture(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, decorate: Decorate | None = None, caption: str = ""
    ) -> Image:
        """(height, width, 3) uint8 picture.

        Args:
            data: state whose kinematics and lights are up to date.
            camera: from where.
            decorate: appends to the scene.
            caption: a line at the top left.
        """
        import mujoco

        self._update(data, camera, decorate)
        self._gl.make_current()
        mujoco.mjr_render(self._rectangle, self.scene, self._context)
        if caption:
            font, place = mujoco.mjtFont.mjFONT_NORMAL, mujoco.mjtGridPos.mjGRID_TOPLEFT
            mujoco.mjr_overlay(font, place, self._rectangle, caption, "", self._context)
        return self._pixels()

    def segmentation(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> NDArray[np.int32]:
        """(height, width) number of the geom that each pixel shows, -1 where it shows none; nothing is decorated."""
        import mujoco

        self._update(data, camera, None)
        kept = self.scene.flags.copy()
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = True
        self.scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        self._gl.make_current()
        mujoco.mjr_render(self._rectangle, self.scene, self._context)
        self.scene.flags[:] = kept
        shown = np.full(self.scene.ngeom + 1, -1, dtype=np.int32)
        for geom in self.scene.geoms[: self.scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                shown[geom.segid + 1] = geom.objid
        codes: NDArray[np.int32] = self._pixels().astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], dtype=np.int32)
        return shown[codes]

    def _update(self, data: mujoco.MjData, camera: mujoco.MjvCamera, decorate: Decorate | None) -> None:
        import mujoco

        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(self._model, data, self.option, None, camera, everything, self.scene)
        if decorate is not None:
            decorate(self.scene)

    def _pixels(self) -> Image:
        import mujoco

        width, height = self._size
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rectangle, self._context)
        return np.ascontiguousarray(pixels[::-1])  # GL counts rows from below


@contextmanager
def _named(chosen: str) -> Iterator[None]:
    """Tell MuJoCo's own loader of GL functions, which reads MUJOCO_GL, and leave the environment as it was."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = chosen
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before


def _has_egl() -> bool:
    """Whether EGL is there *with* a driver: libegl1 alone loads, but opens no display."""
    name = ctypes.util.find_library("EGL")
    if name is None:
        return False
    try:
        egl = ctypes.CDLL(name)
        address = egl.eglGetProcAddress
        address.restype, address.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
        pointers = [address(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")]
    except (OSError, AttributeError):
        return False
    if not all(pointers):
        return False
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(pointers[0])
    open_display = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(pointers[1])
    devices, count = (ctypes.c_void_p * 16)(), ctypes.c_int()
    if not query(16, devices, ctypes.byref(count)):
        return False
    egl.eglInitialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    displays = (open_display(_EGL_PLATFORM_DEVICE, device, None) for device in devices[: count.value])
    # The displays stay initialised: EGL counts no users, and the renderer opens the same one next.
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


def _has_osmesa() -> bool:
    name = ctypes.util.find_library("OSMesa")
    if name is None:
        return False
    try:
        return hasattr(ctypes.CDLL(name), "OSMesaCreateContextExt")
    except OSError:
        return False
