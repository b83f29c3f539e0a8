"""`cell live`: serve the page of a scene or a plan until the command is interrupted."""

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from cell.files import file_errors, unused_path
from cell.live.server import LiveServer
from cell.live.states import States, scene_of
from cell.runs.run import open_finished
from cell.scene.model import Scene
from cell.session import ProgressReporter


def serve(
    scene: Scene | None,
    run: Path | None,
    out: Path | None,
    reporter: ProgressReporter,
    on_ready: Callable[[str], None],
    *,
    is_planning: bool,
) -> None:
    """Serve a scene, or the scene and the plan of a run.

    Args:
        scene: validated; None takes that of the run.
        run: folder of a finished plan; None without one.
        out: folder of scene files and plans; None chooses one below sim_runs/.
        reporter: shows the progress of loading.
        on_ready: receives the address.
        is_planning: whether each new state is planned.

    Raises:
        CellError: if the scene cannot be loaded, or the folder cannot be made.
    """
    if scene is None:
        assert run is not None, "a scene or a run is needed"
        scene = scene_of(open_finished(run))
    folder = out or unused_path(Path("sim_runs") / f"live-{datetime.now(UTC):%Y%m%dT%H%M%SZ}")
    with file_errors(f"{folder} cannot be made", "choose another --out"):
        folder.mkdir(parents=True)
    server = LiveServer(States(scene, folder, run), reporter, is_planning=is_planning)
    asyncio.run(server.run(lambda address: on_ready(address.url)))
