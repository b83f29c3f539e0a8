"""Page of `cell live`: the page of a scene or of a plan with the script that moves objects."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cell import scanners
from cell.live.live_cell import LiveCell, LiveReach
from cell.runs.run import Run
from cell.runs.schema import ScannerKeys
from cell.view.packed import Layer, pack_array, pack_points
from cell.view.page import PageContents, PageScene, PageSurface, render_page, resource_text
from cell.view.palette import GREEN, OPEN
from cell.view.pieces import cell_of_world
from cell.view.run_pages import part_surface, run_contents
from cell.view.surface import measure_samples
from cell.world.occluders import fixed_occluders, make_caster
from planner.values import Floats

LAYER = "Coverable here"
"""Title of the layer that changes while something is dragged."""

_N_BLOCKERS = 3  # that the page lists
_POLICY = "default-src 'none';"


def live_page(
    cell: LiveCell, T_base_centre: Floats, reach: LiveReach, state: Mapping[str, Any], run: Run | None
) -> str:
    """Return the HTML text.

    Args:
        cell: compiled.
        T_base_centre: (4, 4) pose of the part's centre [m].
        reach: at this pose.
        state: of the server.
        run: finished plan of the state; None without one.
    """
    world, canvas = cell.at(T_base_centre), cell.data.canvas
    rows = canvas.vertex_samples()
    legend = [("not coverable here", OPEN), ("coverable by a reachable candidate", GREEN)]
    note = "without the candidates that a plan grows for the rest"
    layer = Layer(LAYER, "named", reach.coverable[rows].astype(np.uint8), note, named=legend)
    part, contents = PageSurface("part", canvas.mesh, [layer]), PageContents()
    if run is not None:
        casters = cell.data.surface.caster, make_caster(fixed_occluders(world))
        poses = np.stack([view.T_object_poses for view in run.plan.views])
        part = part_surface(canvas, measure_samples(canvas.samples, poses, cell.scanner, casters), [layer])
        contents = _with_folder(run_contents(run), run)
    keys = ScannerKeys(**scanners.describe(cell.settled.scene.scanner.type, cell.settled.scanner))
    scene = PageScene(f"Live cell with {cell.settled.part.name}", cell_of_world(world, keys), [part])
    live = {
        "state": state,
        "reach": reach_json(reach),
        "layer": LAYER,
        "candidates": pack_points(cell.data.candidates.T_object_scanner[:, 0, :3, 3]),
        "vertex_samples": pack_array(rows, "u4"),
        "candidate_of_view": [] if run is None else run.candidate.tolist(),
    }
    text = render_page(scene, contents).replace(_POLICY, f"{_POLICY} connect-src 'self';", 1)
    data = json.dumps(live, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    script = f'<script type="application/json" id="page-live">{data}</script>\n<script>\n{resource_text("live.js")}'
    return text.replace("</style>", f"{resource_text('live.css')}</style>", 1).replace(
        "</body>", f"{script}</script>\n</body>"
    )


def _with_folder(contents: PageContents, run: Run) -> PageContents:
    """Return the contents with the folder of the run in its commands."""
    folder = shlex.quote(str(run.folder))
    views = [replace(view, commands=[text.replace("RUN", folder) for text in view.commands]) for view in contents.views]
    following = [text.replace("RUN", folder) for text in contents.next_commands]
    return replace(contents, views=views, next_commands=following)


def reach_json(reach: LiveReach) -> dict[str, object]:
    """Return a reach as a message."""
    return {
        "reachable": reach.n_reachable,
        "candidates": len(reach.verdict),
        "share": round(reach.share, 6),
        "verdict": pack_array(reach.verdict, "u1"),
        "coverable": pack_array(reach.coverable, "u1"),
        "blockers": [list(each) for each in list(reach.blockers.items())[:_N_BLOCKERS]],
        "contacts": list(reach.contacts),
        "problems": list(reach.problems),
    }
