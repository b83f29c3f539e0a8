"""Coverage of an exploration over its views: the true one with the bound, else that of what is believed."""

import base64
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cell.runs.schema import ExploreFile, Truth
from cell.view.palette import BETWEEN, BLUE, ORANGE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DPI = 110
_PANEL = (3.8, 4.0)  # inches
_WIDE = 6.0  # inches, from which the legend has two columns


def draw(path: Path, file: ExploreFile, size: tuple[float, float] = (7.2, 4.6)) -> None:
    """Draw the picture; equal files give equal bytes.

    Args:
        path: PNG to write.
        file: of an exploration with a stage at least.
        size: of the picture [inches].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # matplotlib takes a second to import
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    if file.truth is not None:
        _draw_truth(axes, file.truth)
    else:
        views = np.cumsum([0, *(stage.views for stage in file.stages)])
        areas = [0.0, *(stage.measured_mm2 / 100 for stage in file.stages)]
        axes.plot(views, areas, "o-", color=BLUE, ms=4, lw=1.2, label="surface with a measured point beside it")
        axes.set_ylabel("measured [cm$^2$]")
        axes.set_ylim(0, None)
    axes.set(xlabel="number of views", xlim=(0, max(file.views, 1)))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", fontsize=8, ncols=1 if size[0] < _WIDE else 2, frameon=False)
    figure.savefig(path, dpi=_DPI, metadata={"Software": None})


def data_url(file: ExploreFile) -> str:
    """The picture in the size of a page's panel, for a page that asks for no address."""
    with tempfile.TemporaryDirectory() as folder:
        draw(path := Path(folder) / "curve.png", file, _PANEL)
        return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def _draw_truth(axes: "Axes", known: Truth) -> None:
    n = [point.views for point in known.bound]
    found, most = ([100 * getattr(point, key) for point in known.bound] for key in ("found", "at_most"))
    axes.fill_between(n, found, most, color=BETWEEN, lw=0, label="not excluded by the bound")
    axes.plot(n, most, "-", color=VERMILION, lw=1, label="no so many candidates of the model measure more")
    axes.plot(n, found, "-", color=ORANGE, lw=1, label="best views found, the model being known")
    shares = 100 * np.array([0.0, *known.by_views])
    axes.plot(range(len(shares)), shares, "o-", color=BLUE, ms=4, lw=1.2, label="explored")
    axes.set(ylabel="visible coverage [% of the true surface]", ylim=(0, 103))
