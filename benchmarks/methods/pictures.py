"""`python -m benchmarks pictures`: draw the pictures of docs/images again, each with its commit.

Without names it draws the pictures that take less than a minute each: the default plan, the tightest moment, the
built-in parts, the examples. The others are charts of benchmarks and studies, which take minutes to an hour each; they
are drawn if they are named.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from benchmarks import stand_in_picture
from benchmarks.fidelity import deep_bucket
from benchmarks.methods.stability import MAPS
from cell.errors import CellError, UsageError

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
EXAMPLES = ("plan_part", "inspect_step", "rotary_table", "explore_part", "own_scanner")

Maker = Callable[[Path], None]
"""Leaves its pictures, called as in docs/images, in a folder."""


def _python(folder: Path, *words: object) -> None:
    """Run a command of this clone in a folder."""
    _run(folder, "-m", *words)


def _run(folder: Path, *words: object) -> None:
    """Run Python in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *map(str, words)]
    process = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    if process.returncode:
        raise CellError(f"{' '.join(map(str, words))} ended with code {process.returncode}")


def _default_plan(folder: Path) -> None:
    _python(folder, "cell", "plan", "--place", "1200,500,0", "--out", "run")
    _python(folder, "cell", "why", "run")
    _python(folder, "cell", "scan", "run", "--pose-error", "0.5mm,0.1deg", "--range-noise", "0.03")
    for source in ("run/cell.png", "run/views.png", "run/why/why.png", "run/executions/0001/deviation.png"):
        shutil.copy(folder / source, folder)
    if browser := shutil.which("chromium"):
        _page(folder, browser)


def _page(folder: Path, browser: str) -> None:
    """Draw the page of the plan in a browser, with the third view selected."""
    page = (folder / "run" / "view.html").read_text(encoding="utf-8")
    (folder / "run" / "page.html").write_text(
        page + '<script>onload = () => document.querySelectorAll("#numbers button")[2].click()</script>',
        encoding="utf-8",
    )
    flags = "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --window-size=1280,800"
    subprocess.run(
        [browser, *flags.split(), f"--user-data-dir={folder / 'browser'}", "--virtual-time-budget=20000",
         f"--screenshot={folder / 'page.png'}", (folder / "run" / "page.html").as_uri()],
        check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def _tightest(folder: Path) -> None:
    deep_bucket().export(folder / "bucket.stl")
    words = "--units mm --sensor paper --standoff 100 --place 1200,0,-200 --faces 100 --max-views 3 --out bucket"
    _python(folder, "cell", "plan", "bucket.stl", *words.split())
    _python(folder, "cell", "replay", "bucket", "--tightest", "--picture", "tightest.png")


def _example(name: str) -> Maker:
    return lambda folder: _run(folder, ROOT / "docs" / "examples" / f"{name}.py")


def _benchmark(name: str) -> Maker:
    return lambda folder: _python(folder, "benchmarks", name, "--charts", ".")


def _study(words: str, source: str, picture: str) -> Maker:
    """Run a study in its folder; `source` is the name of the picture in the study."""

    def make(folder: Path) -> None:
        _python(folder, *words.split(), "--out", "study")
        shutil.copy(folder / "study" / source, folder / picture)

    return make


QUICK: Mapping[tuple[str, ...], Maker] = {
    ("cell.png", "views.png", "why.png", "deviation.png", "page.png"): _default_plan,
    ("tightest.png",): _tightest,
    ("built_in_parts.png",): lambda folder: stand_in_picture.draw(folder / "built_in_parts.png"),
    **{(f"example_{name}.png",): _example(name) for name in EXAMPLES},
}
_TABLES = [f"table{n}" for n in range(1, 6)]
LONG: Mapping[tuple[str, ...], Maker] = {
    ("collision_fidelity.png",): _benchmark("fidelity"),
    ("coverage_requests.png",): _benchmark("coverage_requests"),
    ("edge_resolution.png",): _benchmark("edge_resolution"),
    ("explore_rivals.png",): _benchmark("explore"),
    ("fill_speed_accuracy.png",): _benchmark("fill"),
    ("mug_resolution.png",): _benchmark("mug"),
    ("ordering_budget.png",): _benchmark("gtsp"),
    ("pose_search.png",): _benchmark("pose_search"),
    ("coverage_over_views.png",): _benchmark("coverage_over_views"),
    ("default_job.png",): _benchmark("default_job"),
    ("direction_table.png",): _benchmark("direction_table"),
    ("plant_stability.png",): _benchmark("plant"),
    ("reconstruction.png",): _benchmark("reconstruction"),
    ("sigma_model.png",): _benchmark("sigma"),
    ("singularities.png",): _benchmark("singularities"),
    ("placement.png",): _study(
        "cell study placement mug --x 900:1600:100 --y 0:900:100", "map_z0_yaw0.png", "placement.png"
    ),
    ("cover_rivals.png",): _study("benchmarks cover chart", "chart.png", "cover_rivals.png"),
    ("speed_fronts.png",): _study("benchmarks speed", "speed_fronts.png", "speed_fronts.png"),
    **{(each := f"paper_{name}.png",): _study(f"benchmarks paper {name}", f"{name}.png", each) for name in _TABLES},
    **{(each := f"stability_{name}.png",): _study(f"benchmarks stability {name}", each, each) for name in MAPS},
}  # fmt: skip
GROUPS = {picture: names for names in (*QUICK, *LONG) for picture in names}

app = typer.Typer(add_completion=False)


@app.command()
def pictures(
    names: Annotated[list[str] | None, typer.Argument(metavar="[FILE.png ...]", help=", ".join(GROUPS))] = None,
    into: Annotated[Path, typer.Option(metavar="DIR", help="Where they go.")] = IMAGES,
) -> None:
    """Draw pictures of the documentation again; without names those that take seconds."""
    if unknown := sorted(set(names or []) - set(GROUPS)):
        raise UsageError(f"no picture is called {', '.join(unknown)}; there are {', '.join(GROUPS)}")
    groups = dict.fromkeys(GROUPS[name] for name in names) if names else QUICK
    for group in groups:
        with TemporaryDirectory() as folder:
            {**QUICK, **LONG}[group](Path(folder))
            for picture in _requested(group, names):
                if (Path(folder) / picture).is_file():
                    _keep(Path(folder) / picture, into)
                else:
                    typer.echo(f"{picture} was not drawn: there is no chromium")


def _requested(group: Sequence[str], names: Sequence[str] | None) -> list[str]:
    return [picture for picture in group if not names or picture in names]


@cache  # read before the first picture is written, which changes the tree
def _commit() -> str:
    words = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    return subprocess.run(words, capture_output=True, text=True).stdout.strip() or "unknown"


def _keep(picture: Path, folder: Path) -> None:
    """Write a picture with its commit as a comment."""
    commit = _commit()
    info = PngInfo()
    info.add_text("Comment", f"scan-cell {commit}")
    folder.mkdir(parents=True, exist_ok=True)
    with Image.open(picture) as image:
        # Without a palette of 256 colours, which gave the legend colours of other objects.
        image.convert("RGB").save(folder / picture.name, pnginfo=info, optimize=True)
    typer.echo(f"{folder / picture.name}: {commit}")
