"""Picture of an exploration's measured surface over the number of views."""

import base64
import tempfile
from pathlib import Path

import numpy as np

from cell.runs.schema import ExploreFile
from cell.view.palette import BLUE

_DPI = 110
_PANEL = (3.8, 4.0)  # inches


def draw(path: Path, file: ExploreFile, size: tuple[float, float] = (7.2, 4.6)) -> None:
    """Draw the picture with reproducible bytes.

    Args:
        path: PNG to write.
        file: of an exploration with at least one batch.
        size: of the picture [inches].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # matplotlib takes a second to import
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    views = np.cumsum([0, *(stage.views for stage in file.batches)])
    areas = [0.0, *(stage.measured_mm2 / 100 for stage in file.batches)]
    axes.plot(views, areas, "o-", color=BLUE, ms=4, lw=1.2, label="surface near a measured point")
    axes.set_ylabel("measured [cm$^2$]")
    axes.set_ylim(0, None)
    axes.set(xlabel="number of views", xlim=(0, max(file.views, 1)))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", fontsize=8, frameon=False)
    figure.savefig(path, dpi=_DPI, metadata={"Software": None})


def data_url(file: ExploreFile) -> str:
    """Return the picture as a data URL, in the size of a page's panel."""
    with tempfile.TemporaryDirectory() as folder:
        draw(path := Path(folder) / "curve.png", file, _PANEL)
        return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
