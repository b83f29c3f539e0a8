"""Report of an execution and of the combined scans of several set-ups: page, terminal table, picture of the deviation.

Everything is made from report.json. The pages contain no clock value.
"""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from cell.formatting import percent
from cell.report.setups_report import shared_surface
from cell.runs.schema import ExecutedDeviation, ExecutedRegion, ExecutionReport, ScannedSetups
from planner.geometry.mesh import TriangleMesh
from planner.registration.surface import EDGE_BAND, Deviation

_COARSE = 0.02  # of the part's diagonal: a surface that extends farther from its points is called interpolated

_REJECTIONS = {
    "no_hit": "nothing hit",
    "out_of_fov": "outside the field of view",
    "out_of_range": "too far or near",
    "grazing_source": "laser grazing",
    "grazing_sensor": "sensor grazing",
    "source_blocked": "other thing hit",
    "sensor_blocked": "shadow",
    "out_of_depth": "out of depth of field",
    "out_of_sensor_fov": "outside the sensor's field of view",
    "too_uncertain": "too uncertain",
}
"""Columns of the table of scans by the names of `Rejection`; columns without rays are omitted."""

_UNCOVERED = {
    "not_scanned": "set-ups that are not scanned yet",
    "not_measured": "planned, and not measured from the executed poses",
    "in_contact": "touched by a support in every set-up",
    "not_planned": "in no planned view (setups.json has the causes)",
}
"""Causes of uncovered surface by the names in report.json."""

_DEFINITIONS = (
    "Visible coverage is the share of 100,000 seeded samples of the reference surface that at least one executed pose "
    "measures: both lines of sight, of laser and sensor, are free, the sample is in the field of view, and the "
    "incidence limits are kept. The plan predicted it on the same samples, and its optimiser did not use them. Sampled "
    "coverage is the share of the same samples with a scan point within the radius; it depends on the ray grid. "
    "Neither is computed from the mesh. The deviation is over the measured area of the mesh, positive outside the "
    "part; missing surface does not show in it."
)


def markdown(report: ExecutionReport) -> str:
    """Return the report page of an execution."""
    name, source = html.escape(report.part.name), html.escape(source_title(report.source))
    lines = [f"# Scan of {name}, {source} ([view](view.html))", "", _opening(report), ""]
    if report.contradictions:
        lines += [f"**Doubtful.** {html.escape(doubt)}.  " for doubt in report.contradictions] + [""]
    if not report.complete:
        lines += ["**Not complete.** " + _missing_views(report), ""]
    if report.n_views:
        lines += ["![The part and the scanned views](views.png)", ""]
    lines += [*_settings(report), *_coverage(report), *_surface(report), *_registration(report), *_views(report)]
    return "\n".join([*lines, "## Definitions", "", _DEFINITIONS, ""])


def table(report: ExecutionReport) -> list[tuple[str, str]]:
    """Return the terminal table of an execution as names and values."""
    coverage, registration = report.coverage, report.registration
    motion, cloud = report.motion, report.cloud
    missing = "" if report.complete else "  (not complete, see report.md)"
    rows = [
        ("views", f"{report.n_views} of {report.n_views_planned}{missing}"),
        ("points", f"{report.n_points:,}, {source_title(report.source)}"),
        ("visible coverage", f"{percent(coverage.visible)} of the surface, predicted {percent(coverage.predicted)}"),
        ("sampled coverage", f"{percent(coverage.sampled)} within {coverage.sampled_radius_mm:.3g} mm of a point"),
    ]
    if coverage.dense is not None:
        near = "measured and with a point within 1.5 x the planned spacing"
        rows.append(("dense coverage", f"{percent(coverage.dense)} {near}"))
    rows += [(f"region {each.name}", _region(each)) for each in report.regions or ()]
    if registration is not None and cloud.rms_to_reference_mm is not None:
        residuals = (
            f"points to reference {cloud.rms_to_reference_as_reported_mm:.4f} mm rms as reported, "
            f"{cloud.rms_to_reference_mm:.4f} mm registered"
        )
        sentence = not_registered(report)
        rows += [("registration", residuals), *([("", sentence)] if sentence else [])]
    took = "" if motion.executed_s is None else f", {motion.executed_s:.1f} s by the controller"
    surface = _surface_row(report.surface.status, report.surface.faces, report.deviation)
    return [*rows, ("surface", surface), ("motion", f"{motion.planned_s:.1f} s planned{took}")]


def _surface_row(status: str, faces: int, deviation: ExecutedDeviation | None) -> str:
    if deviation is None:
        return status
    text = (
        f"{faces:,} faces, deviation {deviation.rms_mm:.3f} mm rms, 95 % within {deviation.quantile_95_mm:.3f} mm, "
        f"largest {deviation.max_mm:.3f} mm"
    )
    return f"{text}; {deviation.edge_note}" if deviation.edge_note else text


def source_title(source: str) -> str:
    """Return the source of the points for a title: "simulated", or "points: files of ..."."""
    return source if source == "simulated" else f"points: {source}"


def _opening(report: ExecutionReport) -> str:
    coverage, deviation = report.coverage, report.deviation
    text = (
        f"{_number(report.n_views, 'scan')} gave {report.n_points:,} points and measured {percent(coverage.visible)} "
        f"of the surface; predicted were {percent(coverage.predicted)}."
    )
    if deviation is not None:
        text += (
            f" The surface made from them deviates from the reference by {deviation.rms_mm:.3f} mm rms; 95 % of it "
            f"by no more than {deviation.quantile_95_mm:.3f} mm"
        )
        text += f" ({deviation.edge_note})." if deviation.edge_note else "."
    else:
        text += f" No surface: {report.surface.status}."
    sentence = not_registered(report)
    return f"{text} {sentence[:1].upper()}{sentence[1:]}." if sentence else text


def not_registered(report: ExecutionReport) -> str:
    """Return a sentence about the scans without a correction; "" if there are none."""
    registration = report.registration
    if registration is None or not registration.uncorrected_scans:
        return ""
    count = registration.uncorrected_scans
    return f"{_number(count, 'scan')} of {report.n_views} could not be registered and stayed at the reported pose"


def _missing_views(report: ExecutionReport) -> str:
    parts, views = [], report.missing_views
    if views:
        command = f"`cell scan RUN --view {views[0]}`" if len(views) == 1 else "`cell scan RUN`"
        parts.append(f"No usable scan of view {', '.join(map(str, views))}. Scan again with {command}.")
    if report.unusable_files:
        parts.append("Unusable: " + "; ".join(report.unusable_files) + ".")
    return " ".join(parts)


def _settings(report: ExecutionReport) -> list[str]:
    settings, motion = report.settings, report.motion
    executed = "" if motion.executed_s is None else f"; the controller took {motion.executed_s:.2f} s"
    grid = " x ".join(f"{step:g}" for step in settings.resolution_deg)
    grid = f", {grid} deg" if grid else ""
    view = "" if settings.view is None else f", only view {settings.view} was requested"
    model = " and the scanner's own model" if settings.noise == "model" else ""
    rows = [
        ("part", f"{html.escape(report.part.name)}: {report.part.faces:,} faces"),
        ("views", f"{report.n_views} of the plan's {report.n_views_planned}{view}"),
        ("points", f"{report.n_points:,}, {html.escape(report.source)}"),
        ("scanner", f"{settings.scanner}{grid}, {settings.rays_per_scan:,} rays a scan"),
        *([("as-built mesh", html.escape(settings.actual))] if settings.actual else []),
        ("driver", settings.driver),
        ("range noise (1 sigma)", f"{_or_off(settings.range_noise_mm, 'mm')}{model}"),
        (
            "pose error (1 sigma an axis)",
            f"{_or_off(settings.pose_error_mm, 'mm')}, {_or_off(settings.pose_error_deg, 'deg')}",
        ),
        ("motion", f"{motion.planned_s:.2f} s planned{executed}"),
        ("seed", settings.seed),
    ]
    return _grid(("", ""), rows)


def _grid(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Return a Markdown table and an empty line."""
    table = [f"| {' | '.join(map(str, row))} |" for row in (head, *rows)]
    return [table[0], "|---" * len(head) + "|", *table[1:], ""]


def _region(region: ExecutedRegion) -> str:
    enough = f", {percent(region.satisfied_share)} from {region.views} views" if region.views > 1 else ""
    return f"{percent(region.visible)} measured{enough}"


def _coverage(report: ExecutionReport) -> list[str]:
    coverage = report.coverage
    model = "" if coverage.kind == "simulated" else " (computed by the model from the registered poses)"
    rows = [
        (f"visible{model}, of the surface", percent(coverage.visible), percent(coverage.predicted)),
        ("visible, of the coverable surface", percent(coverage.visible_of_coverable), ""),
        (f"sampled, radius {coverage.sampled_radius_mm:.3g} mm", percent(coverage.sampled), ""),
    ]
    if coverage.dense is not None:
        rows.append(("dense: a point within 1.5 x the planned spacing", percent(coverage.dense), ""))
    rows += [(f"region {html.escape(each.name)}", _region(each), "") for each in report.regions or ()]
    lines = ["## Coverage", "", *_grid(("", "achieved", "predicted"), rows)]
    if coverage.predicted != coverage.predicted_all_views:
        every = percent(coverage.predicted_all_views)
        lines += [f"The prediction is for the scanned views; for all views of the plan it is {every}.", ""]
    return [*lines, "![Coverage over number of views](cover.png)", ""] if report.n_views else lines


def _surface(report: ExecutionReport) -> list[str]:
    model, deviation = report.surface, report.deviation
    if deviation is None or model.max_point_distance_mm is None:
        return ["## Surface", "", f"None: {model.status}.", ""]
    if deviation.closed_holes is not None:
        holes = (
            f"{model.closed_faces:,} faces close holes: they are not measured, are marked `closed` in mesh.ply, and do "
            f"not count in the deviation below. They deviate by {deviation.closed_holes.rms_mm:.4f} mm rms, by "
            f"{deviation.closed_holes.max_mm:.4f} mm at most."
        )
    else:
        holes = (
            "Holes are not closed: no surface is farther than "
            f"{model.max_point_distance_mm:.3g} mm from a measured point."
        )
    if model.max_point_distance_mm > _COARSE * model.diagonal_mm:
        holes += (
            f" The points are far apart for a part of {model.diagonal_mm:.0f} mm: the surface is interpolated over "
            f"gaps up to {model.max_point_distance_mm:.3g} mm; a finer `--resolution` measures more of it."
        )
    rows = [
        ("root mean square", f"{deviation.rms_mm:.4f}"),
        ("mean, signed", f"{deviation.mean_mm:+.4f}"),
        ("95 % of the area within", f"{deviation.quantile_95_mm:.4f}"),
        ("largest", f"{deviation.max_mm:.4f}"),
    ]
    if (edges := deviation.with_edges) is not None and model.spacing_mm is not None:
        rows += [
            ("root mean square, with edges", f"{edges.rms_mm:.4f}"),
            ("largest, with edges", f"{edges.max_mm:.4f}"),
        ]
        holes += (
            f" A surface from points rounds sharp edges: the numbers leave out {percent(deviation.edge_share)} of the "
            f"area, within {EDGE_BAND * model.spacing_mm:.3g} mm of an edge of more than 30 deg."
        )
    return [
        "## Surface\n",
        f"{model.faces:,} faces from points {model.spacing_mm:.3g} mm apart, on a grid of {model.grid_mm:.3g} mm; "
        f"{_number(model.holes, 'open edge loop')}, {_number(model.outliers, 'outlier')} left out. {holes}\n",
        *_grid(("deviation from the reference", "mm"), rows),
        "![Deviation of the surface](deviation.png)\n",
    ]


def _registration(report: ExecutionReport) -> list[str]:
    registration, cloud, settings = report.registration, report.cloud, report.settings
    reported, corrected = _mm(cloud.rms_to_reference_as_reported_mm), _mm(cloud.rms_to_reference_mm)
    if registration is None:
        if not (settings.pose_error_mm or settings.pose_error_deg):
            return []
        sentence = f"The scans were not registered; the points are {corrected} rms from the reference."
        return ["## Pose error", "", sentence, ""]
    residuals = [
        ("matched points, rms along the normals", _mm(registration.rms_before_mm), _mm(registration.rms_after_mm)),
        ("all points to the reference, rms", reported, corrected),
    ]
    errors = [
        (
            view.number,
            _or_unknown(view.determined_error_mm, 3),
            _or_unknown(view.determined_error_after_mm, 3),
            _or_unknown(view.determined_error_deg, 4),
            _or_unknown(view.determined_error_after_deg, 4),
            _or_unknown(view.undetermined_error_mm, 3),
            _or_unknown(view.undetermined_error_deg, 4),
            view.registration,
        )
        for view in report.views
    ]
    head = ("view", "determined error mm", "after", "determined error deg", "after", "undetermined mm", "deg", "result")
    return [
        "## Registration\n",
        "The reported poses were corrected by registration of the scans to each other and to the reference "
        f"({_number(registration.overlapping_pairs, 'overlapping pair')}, "
        f"{_number(registration.iterations, 'step')}).\n",
        *_grid(("", "as reported", "registered"), residuals),
        *_grid(head, errors),
        "Errors are those of the scan's points about their centre. Registration corrects motions that the surface "
        "determines; along the others the reported pose stays, and the points lie on the surface all the same.\n",
    ]


def _views(report: ExecutionReport) -> list[str]:
    if not report.views:
        return []
    rejections = [name for name in _REJECTIONS if any((view.rays or {}).get(name) for view in report.views)]
    head = ["view", "candidate", "marginal coverage %", "reported - commanded deg", "points"]
    rows = [
        (
            view.number,
            view.id,
            f"{100 * view.marginal_coverage:.2f}",
            f"{view.reported_minus_commanded_deg:.4f}",
            f"{view.points:,}",
            *(f"{(view.rays or {}).get(name, 0):,}" for name in rejections),
        )
        for view in report.views
    ]
    lines = ["## Scans in driving order", "", *_grid([*head, *(_REJECTIONS[name] for name in rejections)], rows)]
    if all(view.rays for view in report.views):
        lines += ["Points and the columns after them add up to the rays of a scan.", ""]
    empty = [str(view.number) for view in report.views if not view.points]
    return [*lines, f"View {', '.join(empty)} has no point of the part.", ""] if empty else lines


def _or_unknown(value: float | None, digits: int) -> str:
    return "not known" if value is None else f"{value:.{digits}f}"


def _mm(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f} mm"


def _or_off(value: float | None, unit: str) -> str:
    return f"{value:g} {unit}" if value else "off"


def _number(count: int, noun: str) -> str:
    return f"{count:,} {noun}" + ("" if count == 1 else "s")


# Combined scans of several set-ups


def combined_rows(report: ScannedSetups) -> list[tuple[str, str]]:
    """Return the terminal table of combined scans as names and values."""
    missing = f", {len(report.missing_setups)} not scanned yet" if report.missing_setups else ""
    covered, count = percent(report.visible), _number(len(report.setups), "set-up")
    rows = [("measured", f"{covered} of the surface by {count}{missing}; planned {percent(report.planned)} by all")]
    for setup in report.setups:
        values = f"{setup.views} views, {setup.points:,} points, marginal coverage {percent(setup.marginal_coverage)}"
        rows.append((f"set-up {setup.number}", values))
        if (place := setup.localisation) is not None:
            sentence = f"the part was displaced by {place.displacement_mm:.2f} mm and {place.rotation_deg:.2f} deg"
            undetermined = f"; not determined: {'; '.join(place.free_motions)}" if place.free_motions else ""
            rows.append(("", sentence + undetermined))
    for name, share in dict(report.uncovered).items():
        if share >= 5e-5:
            rows.append(("uncovered", f"{percent(share)}: {_UNCOVERED[name]}"))
    surface = _surface_row(report.surface.status, report.surface.faces, report.deviation)
    return [*rows, ("surface", surface), *(("doubtful", doubt) for doubt in report.contradictions)]


def combined_markdown(report: ScannedSetups) -> str:
    """Return the report page of combined scans."""
    setups = []
    for setup in report.setups:
        place, displaced = setup.localisation, ("", "", "")
        if place is not None:
            displaced = (f"{place.displacement_mm:.3f}", f"{place.rotation_deg:.3f}", "; ".join(place.free_motions))
        link = f"[{setup.number}](../setups/{setup.number}/executions/{setup.execution}/report.md)"
        shares = percent(setup.visible), percent(setup.marginal_coverage)
        setups.append((link, setup.execution, setup.views, f"{setup.points:,}", *shares, *displaced))
    own = ("execution", "views", "points", "measures", "marginal coverage")
    head = ("", *own, "displaced, mm", "deg", "not determined")
    lines = [f"# Scan of {report.part} in several set-ups, {report.source}", ""]
    lines += [*_grid(("", ""), combined_rows(report)), "## Set-ups", "", *_grid(head, setups)[:-1]]
    lines += shared_surface(report.common_surface)
    if report.deviation is not None:
        lines += ["", "![Deviation of the surface](deviation.png)"]
    return "\n".join([*lines, ""])


# Picture of the deviation

_PIXELS = 560  # along the longer side
_SIDES = ((-60.0, "from the front right"), (120.0, "from the back left"))


def draw_deviation(path: Path, mesh: TriangleMesh, deviation: Deviation, source: str) -> None:
    """Draw a mesh from two sides, coloured by its signed deviation, and the histogram.

    One ray per pixel is cast on the mesh, so that a mesh of half a million faces takes no longer than a small one.

    Args:
        path: PNG to write.
        mesh: object frame [m].
        deviation: of the mesh.
        source: source of the points, for the title.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure

    from cell.view import rays
    from cell.view.palette import SIGNED
    from cell.world.embree import EmbreeRayCaster

    figure = Figure(figsize=(14.0, 4.9), dpi=110)  # fixed axes: a layout of matplotlib draws the figure twice more
    lefts, widths = (0.03, 0.33, 0.74), (0.27, 0.27, 0.25)
    panels = [figure.add_axes((left, 0.11, width, 0.76)) for left, width in zip(lefts, widths, strict=True)]
    limit = max(deviation.quantile_95 * 1000.0, 1e-6) * 1.5
    scale = ScalarMappable(Normalize(-limit, limit), LinearSegmentedColormap.from_list("signed", SIGNED))
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    colours = scale.to_rgba(deviation.at_vertices[mesh.faces].mean(axis=1) * 1000.0)[:, :3]
    for axes, (azimuth, title) in zip(panels, _SIDES, strict=False):
        camera = rays.fit_camera(mesh.vertices, rays.direction(azimuth, 22.0), (_PIXELS, _PIXELS), parallel=True)
        width = 2000 * float(camera.half[0])
        axes.imshow(rays.render_mesh(camera, caster, mesh.normals, colours)[0], extent=(0, width, 0, width))
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("mm", fontsize=8)
        axes.tick_params(labelsize=7)
    bar = figure.add_axes((0.61, 0.17, 0.012, 0.64))
    figure.colorbar(scale, cax=bar, extend="both", label="deviation [mm], positive outside")
    edges = deviation.bin_edges * 1000.0
    middle = (edges[1:] + edges[:-1]) / 2
    panels[2].bar(
        middle, 100.0 * deviation.histogram, width=np.diff(edges), color=scale.to_rgba(middle), ec="#888888", lw=0.3
    )
    panels[2].set(xlabel="deviation [mm]", ylabel="share of the mesh's area [%]")
    numbers = [f"{1000 * each:.3f}" for each in (deviation.rms, deviation.quantile_95, deviation.largest)]
    panels[2].set_title(f"rms {numbers[0]}, 95 % {numbers[1]}, largest {numbers[2]} mm", fontsize=9)
    figure.suptitle(source, fontsize=9, x=0.01, ha="left", parse_math=False)  # a command may contain $
    panels[2].grid(alpha=0.25)
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": "scan-cell"})
