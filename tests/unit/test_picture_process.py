"""The process that draws plots in parallel to the command."""

from pathlib import Path

import numpy as np
import pytest

from cell.report import figures
from cell.report.plots import plot_process  # import before the fixture that disables the process for other tests

COVER = {"marginal_area": np.array([0.5, 0.3]), "coverable": 0.9, "total": 1.0, "lower_bound": 1}


@pytest.mark.usefixtures("drawn_pictures")
def test_pictures_drawn_at_a_time_are_those_drawn_alone(tmp_path: Path) -> None:
    """All requested plots exist when `finish` returns, with the same bytes as plots drawn in this process."""
    shares = (0.5, 0.7, 0.9)
    with plot_process() as drawing:
        for share in shares:
            drawing.send("cover_curve", tmp_path / f"{share}.png", **COVER | {"coverable": share})
        files = drawing.finish()
    assert files == [tmp_path / f"{share}.png" for share in shares]
    for share in shares:
        figures.cover_curve(tmp_path / "alone.png", **COVER | {"coverable": share})
        assert (tmp_path / f"{share}.png").read_bytes() == (tmp_path / "alone.png").read_bytes()


def test_a_failed_picture_is_reported(tmp_path: Path) -> None:
    """A plot with an invalid path raises an error with the message of the process; the other plot is drawn."""
    with plot_process() as drawing:
        drawing.send("cover_curve", tmp_path / "missing" / "cover.png", **COVER)
        drawing.send("cover_curve", tmp_path / "cover.png", **COVER)
        with pytest.raises(RuntimeError, match=r"(?s)plots were not drawn: .*missing"):
            drawing.finish()
    assert (tmp_path / "cover.png").exists()


def test_the_process_has_the_module_path_of_its_parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module on a path that only the parent has is found, as plug-ins in the folder of a script are."""
    (tmp_path / "matplotlib.py").write_text("raise ImportError('the module of the parent')\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with plot_process() as drawing:
        drawing.send("cover_curve", tmp_path / "cover.png", **COVER)
        with pytest.raises(RuntimeError, match="the module of the parent"):
            drawing.finish()


def test_a_process_with_many_messages_is_not_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More messages and larger plots than pipes hold: the error is reported all the same."""
    (tmp_path / "matplotlib.py").write_text("import sys\nsys.stderr.write(100_000 * 'much ')\nraise ImportError('end')")
    monkeypatch.syspath_prepend(str(tmp_path))
    with plot_process() as drawing:
        drawing.send("cover_curve", tmp_path / "cover.png", **COVER | {"marginal_area": np.zeros(100_000)})
        with pytest.raises(RuntimeError, match="end"):
            drawing.finish()
