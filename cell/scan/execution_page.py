"""The page of an execution, made from its report.json, and its table for a terminal. It holds no clock value."""

import html

from cell.acquisition import SIMULATED
from cell.runs.schema import ExecutedRegion, ExecutionReport
from cell.words import percent

_COARSE = 0.02  # of the part's diagonal: a surface that reaches farther from its points is called interpolated

_REASONS = {
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
"""Columns of the table of scans by the names of `Rejection`; those that no scan has are left away."""


def markdown(summary: ExecutionReport) -> str:
    """The report page; reads on its own, with its pictures beside it.

    Args:
        summary: the execution's report.json.
    """
    where = html.escape(short(summary.source))
    title = f"# Scan of {html.escape(summary.part.name)}, {where} ([look at it](view.html))"
    lines = [title, "", _opening(summary), ""]
    if summary.doubts:
        lines += [f"**Doubtful.** {html.escape(doubt)}.  " for doubt in summary.doubts] + [""]
    if not summary.complete:
        lines += ["**Not complete.** " + _missing(summary), ""]
    if summary.n_views:
        lines += ["![The part and the scanned views](views.png)", ""]
    lines += [*_table(summary), *_coverage(summary), *_model(summary), *_registration(summary), *_views(summary)]
    lines += [
        "## What the numbers mean",
        "",
        "Visible coverage is the share of 100,000 seeded samples of the reference surface, those on which the plan "
        "predicted it and which its optimiser did not see, that at least one executed pose measures: laser and sensor "
        "legs free, in the field of view, in range, grazing limits kept. Sampled coverage is the share of the same "
        "samples with a scan point within the radius; it depends on the ray grid. Neither is taken from the mesh. The "
        "deviation is over the measured area of the mesh, positive outside the part; what the mesh lacks does not show "
        "in it.",
        "",
    ]
    return "\n".join(lines)


def table(summary: ExecutionReport) -> list[tuple[str, str]]:
    """What a terminal shows of the execution: names and values.

    Args:
        summary: the execution's report.json.
    """
    coverage, deviation, registration = summary.coverage, summary.deviation, summary.registration
    motion, cloud, model = summary.motion, summary.cloud, summary.model
    missing = "" if summary.complete else "  (not complete, see report.md)"
    rows = [
        ("views", f"{summary.n_views} of {summary.n_views_planned}{missing}"),
        ("points", f"{summary.n_points:,}, {short(summary.source)}"),
        ("visible coverage", f"{percent(coverage.visible)} of the surface, predicted {percent(coverage.predicted)}"),
        ("sampled coverage", f"{percent(coverage.sampled)} within {coverage.sampled_radius_mm:.3g} mm of a point"),
    ]
    if coverage.dense is not None:
        near = "measured and with a point within 1.5 x the planned spacing"
        rows.append(("dense coverage", f"{percent(coverage.dense)} {near}"))
    rows += [(f"region {each.name}", _of_region(each)) for each in summary.regions or ()]
    if registration is not None and cloud.rms_to_reference_mm is not None:
        residuals = (
            f"points to reference {cloud.rms_to_reference_as_reported_mm:.4f} mm rms as reported, "
            f"{cloud.rms_to_reference_mm:.4f} mm registered"
        )
        left = left_as_reported(summary)
        rows += [("registration", residuals), *([("", left)] if left else [])]
    surface = (
        str(model.status)
        if deviation is None
        else f"{model.faces:,} faces, deviation {deviation.rms_mm:.3f} mm rms, "
        f"95 % within {deviation.quantile_95_mm:.3f} mm, largest {deviation.largest_mm:.3f} mm"
    )
    took = "" if motion.executed_s is None else f", {motion.executed_s:.1f} s by the controller"
    return [*rows, ("surface", surface), ("motion", f"{motion.planned_s:.1f} s planned{took}")]


def short(source: str) -> str:
    """Where points come from, for a title: "simulated", or "points: files of ..."."""
    return source if source == SIMULATED else f"points: {source}"


def _opening(summary: ExecutionReport) -> str:
    coverage, deviation = summary.coverage, summary.deviation
    text = (
        f"{_number(summary.n_views, 'scan')} gave {summary.n_points:,} points and measured "
        f"{percent(coverage.visible)} of the surface; predicted were {percent(coverage.predicted)}."
    )
    if deviation is not None:
        text += (
            f" The surface made from them deviates from the reference by {deviation.rms_mm:.3f} mm rms; 95 % of it "
            f"by no more than {deviation.quantile_95_mm:.3f} mm."
        )
    else:
        text += f" No surface: {summary.model.status}."
    left = left_as_reported(summary)
    return f"{text} {left[:1].upper()}{left[1:]}." if left else text


def left_as_reported(summary: ExecutionReport) -> str:
    """How many scans registration left at their reported pose, in words; "" where it left none."""
    registration = summary.registration
    if registration is None or not registration.left_as_reported:
        return ""
    count = registration.left_as_reported
    return f"{_number(count, 'scan')} of {summary.n_views} could not be registered and stayed at the reported pose"


def _missing(summary: ExecutionReport) -> str:
    parts, views = [], summary.missing_views
    if views:
        again = (
            f"view {views[0]} again (`cell scan RUN --view {views[0]}`)"
            if len(views) == 1
            else "again (`cell scan RUN`)"
        )
        parts.append(f"No usable scan of view {', '.join(map(str, views))}. Scan {again}.")
    if summary.left_out:
        parts.append("Left out: " + "; ".join(summary.left_out) + ".")
    return " ".join(parts)


def _table(summary: ExecutionReport) -> list[str]:
    settings, motion = summary.settings, summary.motion
    executed = "" if motion.executed_s is None else f"; the controller took {motion.executed_s:.2f} s"
    grid = " x ".join(f"{step:g}" for step in settings.resolution_deg)
    grid = f", {grid} deg" if grid else ""
    view = "" if settings.view is None else f", only view {settings.view} was asked for"
    return [
        "| | |",
        "|---|---|",
        f"| part | {html.escape(summary.part.name)}: {summary.part.faces:,} faces |",
        f"| views | {summary.n_views} of the plan's {summary.n_views_planned}{view} |",
        f"| points | {summary.n_points:,}, {html.escape(summary.source)} |",
        f"| scanner | {settings.scanner}{grid}, {settings.rays_per_scan:,} rays a scan |",
        f"| driver | {settings.driver} |",
        f"| range noise (1 sigma) | {_off(settings.range_noise_mm, 'mm')}"
        + (" and the scanner's own model |" if settings.noise == "model" else " |"),
        f"| pose error (1 sigma an axis) | {_off(settings.pose_error_mm, 'mm')}, "
        f"{_off(settings.pose_error_deg, 'deg')} |",
        f"| motion | {motion.planned_s:.2f} s planned{executed} |",
        f"| seed | {settings.seed} |",
        "",
    ]


def _of_region(region: ExecutedRegion) -> str:
    enough = f", {percent(region.from_enough_views)} from {region.views} views" if region.views > 1 else ""
    return f"{percent(region.visible)} measured{enough}"


def _coverage(summary: ExecutionReport) -> list[str]:
    coverage = summary.coverage
    model = "" if coverage.kind == "simulated" else " (computed by the model from the registered poses)"
    lines = [
        "## Coverage",
        "",
        "| | achieved | predicted |",
        "|---|---|---|",
        f"| visible{model}, of the surface | {percent(coverage.visible)} | {percent(coverage.predicted)} |",
        f"| visible, of what reachable candidates can measure | {percent(coverage.visible_of_coverable)} | |",
        f"| sampled, radius {coverage.sampled_radius_mm:.3g} mm | {percent(coverage.sampled)} | |",
    ]
    if coverage.dense is not None:
        lines.append(f"| dense: a point within 1.5 x the planned spacing | {percent(coverage.dense)} | |")
    lines += [f"| region {html.escape(each.name)} | {_of_region(each)} | |" for each in summary.regions or ()]
    lines.append("")
    if coverage.predicted != coverage.predicted_all_views:
        lines += [
            f"The prediction is for the views that were scanned; for all views of the plan it is "
            f"{percent(coverage.predicted_all_views)}.",
            "",
        ]
    return [*lines, "![Coverage over number of views](cover.png)", ""] if summary.n_views else lines


def _model(summary: ExecutionReport) -> list[str]:
    model, deviation = summary.model, summary.deviation
    lines = ["## Surface", ""]
    if deviation is None or model.reach_mm is None:
        return [*lines, f"None: {model.status}.", ""]
    closed = (
        f"{model.closed_faces:,} faces close holes: they are invented, not measured, marked `closed` in "
        "mesh.ply, and not part of the deviation below. They deviate by "
        f"{deviation.closed.rms_mm:.4f} mm rms, by {deviation.closed.largest_mm:.4f} mm at most."
        if deviation.closed is not None
        else f"Holes stay holes: no surface is farther than {model.reach_mm:.3g} mm from a measured point."
    )
    if model.reach_mm > _COARSE * model.diagonal_mm:
        closed += (
            f" The points are far apart for a part of {model.diagonal_mm:.0f} mm: the surface is interpolated over "
            f"gaps up to {model.reach_mm:.3g} mm; a finer `--resolution` measures more of it."
        )
    return [
        *lines,
        f"{model.faces:,} faces from points {model.spacing_mm:.3g} mm apart, on a grid of "
        f"{model.grid_mm:.3g} mm; {_number(model.holes, 'open edge loop')}, "
        f"{_number(model.outliers, 'outlier')} left out. {closed}",
        "",
        "| deviation from the reference | mm |",
        "|---|---|",
        f"| root mean square | {deviation.rms_mm:.4f} |",
        f"| mean, signed | {deviation.mean_mm:+.4f} |",
        f"| 95 % of the area within | {deviation.quantile_95_mm:.4f} |",
        f"| largest | {deviation.largest_mm:.4f} |",
        "",
        "![Deviation of the surface](deviation.png)",
        "",
    ]


def _registration(summary: ExecutionReport) -> list[str]:
    registration, cloud = summary.registration, summary.cloud
    settings = summary.settings
    disturbed = settings.pose_error_mm or settings.pose_error_deg
    if registration is None:
        if not disturbed:
            return []
        return [
            "## Pose error",
            "",
            f"The scans were not registered; the points are {_mm(cloud.rms_to_reference_mm)} rms from the reference.",
            "",
        ]
    lines = [
        "## Registration",
        "",
        "The reported poses were corrected by matching the scans to each other and to the reference "
        f"({_number(registration.overlapping_pairs, 'overlapping pair')}, "
        f"{_number(registration.iterations, 'step')}).",
        "",
        "| | as reported | registered |",
        "|---|---|---|",
        f"| matched points, rms along the normals | {_mm(registration.rms_before_mm)} | "
        f"{_mm(registration.rms_after_mm)} |",
        f"| all points to the reference, rms | {_mm(cloud.rms_to_reference_as_reported_mm)} | "
        f"{_mm(cloud.rms_to_reference_mm)} |",
        "",
        "| view | position error mm | after | angle error deg | after | how it went |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {view.stop} | {_known(view.pose_error_mm, 3)} | {_known(view.pose_error_after_mm, 3)} | "
        f"{_known(view.pose_error_deg, 4)} | {_known(view.pose_error_after_deg, 4)} | {view.registration} |"
        for view in summary.views
    ]
    return [*lines, ""]


def _views(summary: ExecutionReport) -> list[str]:
    if not summary.views:
        return []
    reasons = [name for name in _REASONS if any((view.rays or {}).get(name) for view in summary.views)]
    names = ["view", "candidate", "adds % of surface", "reported - commanded deg", "points"]
    names += [_REASONS[name] for name in reasons]
    lines = ["## Scans in driving order", "", f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for view in summary.views:
        cells = [str(view.stop), str(view.id), f"{100 * view.adds:.2f}"]
        cells += [f"{view.reported_minus_commanded_deg:.4f}", f"{view.points:,}"]
        lines.append(f"| {' | '.join([*cells, *(format((view.rays or {}).get(name, 0), ',') for name in reasons)])} |")
    if all(view.rays for view in summary.views):
        lines += ["", "Points and the columns behind them add up to the rays of a scan."]
    empty = [str(view.stop) for view in summary.views if not view.points]
    if empty:
        lines += ["", f"View {', '.join(empty)} saw nothing of the part."]
    return [*lines, ""]


def _known(value: float | None, digits: int) -> str:
    return "not known" if value is None else f"{value:.{digits}f}"


def _mm(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f} mm"


def _off(value: float | None, unit: str) -> str:
    return f"{value:g} {unit}" if value else "off"


def _number(count: int, noun: str) -> str:
    return f"{count:,} {noun}" + ("" if count == 1 else "s")
