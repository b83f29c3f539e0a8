"""Pictures without a display, by MuJoCo's renderer: on Linux on EGL, or on OSMesa where there is no EGL.

Both draw in software where there is no graphics card. `MUJOCO_GL=egl` or `MUJOCO_GL=osmesa` in the environment chooses;
MuJoCo reads it once, when it is imported.
"""

from __future__ import annotations

import ctypes.util
import os
import sys
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.errors import UsageError

if TYPE_CHECKING:
    import mujoco

Image = NDArray[np.uint8]
Decorate = Callable[["mujoco.MjvScene"], None]

PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri (EGL) or libosmesa6 (OSMesa)"
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_MAX_GEOMS = 20_000
_FONT = 20  # height of a caption [pixels]


def backend() -> str | None:
    """What draws without a display, as MUJOCO_GL names it; None where nothing does.

    MUJOCO_GL leaves only the one that it names to be looked at.
    """
    if sys.platform != "linux":
        return "cgl" if sys.platform == "darwin" else "wgl"
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    return next(
        (name for name, lib in _LIBRARIES.items() if asked in ("", name) and ctypes.util.find_library(lib)), None
    )


def require_backend() -> None:
    """Choose what draws; call it before MuJoCo is imported.

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
    os.environ["MUJOCO_GL"] = chosen


class OffScreen:
    """Draws scenes of one model into arrays; a context manager, because it holds a GL context.

    Attributes:
        renderer: of MuJoCo.
        option: what is shown.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], samples: int = 4) -> None:
        """Open the context.

        Args:
            model: what is drawn.
            size: (width, height) [pixels]; the model's off-screen buffer must be as large.
            samples: per pixel, against jagged edges; software rendering takes time in proportion.

        Raises:
            UsageError: if there is neither EGL nor OSMesa, or no driver for it.
        """
        require_backend()
        import mujoco

        model.vis.quality.offsamples = samples
        try:
            self.renderer = mujoco.Renderer(model, size[1], size[0], _MAX_GEOMS)
        except (ImportError, RuntimeError, mujoco.FatalError) as error:
            raise UsageError(
                f"pictures without a display cannot be drawn: {error}; install the packages {PACKAGES}"
            ) from error
        self.option = mujoco.MjvOption()

    def __enter__(self) -> OffScreen:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.renderer.close()

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
        self.renderer.update_scene(data, camera, self.option)
        if decorate is not None:
            decorate(self.renderer.scene)
        picture: Image = self.renderer.render()
        return _captioned(picture, caption) if caption else picture


def _captioned(picture: Image, caption: str) -> Image:
    from PIL import Image as Picture
    from PIL import ImageDraw, ImageFont

    drawn = Picture.fromarray(picture)
    font = ImageFont.load_default(_FONT)
    ImageDraw.Draw(drawn).text((8, 4), caption, "white", font, stroke_width=2, stroke_fill="black")
    return np.asarray(drawn)
