"""Report of a plan for people: report.md, and the table of a terminal. It holds no clock time."""

import html
from collections.abc import Iterable

from cell.formatting import comma_list, percent
from cell.runs.schema import (
    Attainable,
    Clearance,
    Curve,
    Overlap,
    RegionResult,
    Report,
    ReportMotion,
    ReportSettings,
    RobustCoverage,
)

LOW_COVERAGE = 0.8
"""Share of the surface below which the largest loss is named."""

_N_DROPPED = 2  # dropped candidates in a terminal
_PART_MODEL = {"hull": "its convex hull", "exact": "its triangles"}

Rows = list[tuple[str, str]]


def markdown(report: Report) -> str:
    """Return report.md; its pictures are files beside it."""
    part, coverage = report.part, report.coverage
    lines = [
        f"# View plan of {html.escape(part.name)} ([view](view.html))\n",
        f"{report.n_views} views measure {percent(coverage.visible)} of the surface, "
        f"{percent(coverage.visible_of_coverable)} of the coverable surface: reachable candidates can measure "
        f"{percent(coverage.coverable)}. {_sentence(report.status)}\n",
        *(f"{_sentence(f'{name}: {text}')}\n" for name, text in _attainable_row(report)),
        "![The cell, the arm at one of the views](cell.png)\n",
        "![The part by the number of views that measure it, and the views](views.png)\n",
        *_facts(report),
        "",
    ]
    if part.findings:
        lines += ["## Findings of the mesh check", "", *(f"- {finding}" for finding in part.findings), ""]
    lines += ["## Reach", "", "| verdict | candidates |", "|---|---|"]
    lines += [f"| {name.replace('_', ' ')} | {count} |" for name, count in report.verdicts]
    if report.blockers:
        lines += ["", "Collisions are with: " + ", ".join(f"{k} ({n})" for k, n in report.blockers.items()) + "."]
    lines += ["", "![Candidates by verdict](reach.png)", "", *_views(report)]
    if report.exclusions:
        lines += ["", "Excluded; the views were selected again without them:", ""]
        lines += [f"- candidate {view.id}: {view.cause}" for view in report.exclusions]
    lines += ["", "![Coverage over number of views](cover.png)", "", *_region_section(report)]
    lines += [*_robust_section(report), *(curve_section(report.curve) if report.curve else []), "## Motion", ""]
    if report.clearance and (tightest := tightest_moment(report.clearance)):
        lines += [f"Smallest clearance: {tightest}; the part is {_PART_MODEL[report.clearance.collision]}.", ""]
    lines += [
        f"In task-space order (Christofides) the same views would take {report.motion.baseline_duration_s:.2f} s.\n",
        *_sweeps(report.settings),
        "![Joint motion](motion.png)\n",
        "## Next steps\n",
        "`cell scan RUN` executes the plan, `cell why RUN` explains the uncovered surface, `cell view RUN` opens the "
        "page of this folder.\n",
        "## Definitions\n",
        "Visible coverage is the share of 100,000 seeded samples of the reference surface, none of them seen by the "
        "optimiser, that at least one view measures: lines of sight of laser and sensor free of part, fixtures, post, "
        "pedestal and floor, in the field of view, in range, incidence limits kept. The lower bound holds for these "
        "candidates and samples.\n",
    ]
    return "\n".join(lines)


def table(report: Report) -> Rows:
    """Return the rows of a terminal."""
    coverage, motion = report.coverage, report.motion
    clearance, bound, fewest = motion.minimum_clearance_mm, motion.jerk_free_bound_s, report.lower_bound
    rows = [
        ("views", f"{report.n_views}. {report.status}"),
        ("lower bound", f"{'1 view' if fewest == 1 else f'{fewest} views'} for these candidates and samples"),
        (
            "visible coverage",
            f"{percent(coverage.visible)} of the surface, {percent(coverage.visible_of_coverable)} of the coverable "
            "surface",
        ),
        *_attainable_row(report),
        *_spacing_row(report),
        *((f"region {each.name}", _region_summary(each)) for each in report.regions or ()),
        *_option_rows(report),
        ("candidates", ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in report.verdicts)),
    ]
    if report.exclusions:
        causes = "; ".join(f"candidate {view.id}: {view.cause}" for view in report.exclusions[:_N_DROPPED])
        more = len(report.exclusions) - _N_DROPPED
        rows.append(("dropped", causes + (f"; and {more} more, see report.md" if more > 0 else "")))
    took = (
        f"{motion.duration_s:.1f} s from home to home through {motion.via_points} points"
        + (f", {motion.duration_s / bound:.3f} x the time-optimal bound without jerk limit" if bound else "")
        + ("" if clearance is None else f"; smallest clearance {clearance:.1f} mm ({motion.between})")
    )
    return [*rows, ("motion", took)]


def _attainable_row(report: Report) -> Rows:
    """Return the coverage by any pose; older runs do not know it."""
    if report.attainable is None:
        return []
    return [("attainable", attainable_sentence(report.coverage.visible, report.coverage.coverable, report.attainable))]


def attainable_sentence(visible: float, coverable: float, attainable: Attainable) -> str:
    """Compare visible with attainable coverage; name the largest loss if little is measured."""
    sentence = (
        f"at least {100 * attainable.share:.2f} % of the surface by any pose of this robot (found by search, standard "
        f"error {100 * attainable.standard_error:.2f}); this plan measures {100 * visible:.2f} %"
    )
    if visible >= LOW_COVERAGE:
        return sentence
    losses = (
        (
            attainable.out_of_reach,
            "the search found no reachable pose that sees it (cell place finds another placement, cell why a second "
            "set-up)",
        ),
        (
            attainable.out_of_sight,
            "the search found no pose that sees it past the part and its surroundings within the scanner's limits",
        ),
        (attainable.share - coverable, "no candidate measures it, though other poses would (--candidates grown)"),
        (coverable - visible, "the request did not include it (--coverage, --max-views)"),
    )
    area, cause = max(losses)
    return f"{sentence}; {100 * area:.1f} % of the surface is lost because {cause}"


def _spacing_row(report: Report) -> Rows:
    if (spacing := report.spacing) is None:
        return []
    limit = "" if spacing.limit_mm is None else f", limit {spacing.limit_mm:g} mm"
    text = (
        f"at most {spacing.quantile_99_mm:.3g} mm on 99 % of the measured surface, at most {spacing.median_mm:.3g} mm"
    )
    return [("spacing of points", f"{text} on half of it{limit}")]


def _facts(report: Report) -> list[str]:
    """Return the table at the top of the page."""
    part, settings, motion = report.part, report.settings, report.motion
    return [
        "| | |",
        "|---|---|",
        f"| part | {html.escape(part.name)}: {part.faces:,} faces, {_times(part.extents_mm)} mm, "
        f"{part.area_mm2:,.0f} mm² |",
        f"| planning mesh | {part.planning_faces:,} faces |",
        f"| placement of its centre in base | {comma_list(settings.placement_mm)} mm, "
        f"A B C {comma_list(settings.placement_abc_deg)} deg |",
        *_scanner_rows(settings),
        f"| candidates | {settings.candidates}, {report.verdicts.total:,} |",
        f"| matrix | {settings.fill}, {report.n_samples:,} surface samples |",
        f"| selection | {report.solver}, {report.n_views} views, lower bound {report.lower_bound}, "
        f"gap {percent(report.gap)} |",
        f"| motion | {motion.duration_s:.2f} s home to home, {motion.via_points} points, speed "
        f"{percent(motion.speed_fraction)} |",
        f"| the same stops without jerk limit (time-optimal bound) | {_bound(motion)} |",
        *(f"| {name} | {sentence} |" for name, sentence in (*_spacing_row(report), *_option_rows(report))),
        *_arm_and_sigma(report),
        f"| seed | {settings.seed} |",
    ]


def _views(report: Report) -> list[str]:
    axes = "A1 .. A6, E1" if any(view.e_deg for view in report.views) else "A1 .. A6"
    lines = [
        "## Views in visiting order\n",
        f"| stop | candidate | marginal coverage % of surface | source in base x, y, z mm | {axes} deg | roll deg "
        "| clearance on the way mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for stop, view in enumerate(report.views, start=1):
        clearance = view.segment_clearance_mm
        lines.append(
            f"| {stop} | {view.id} | {100 * view.marginal_coverage:.2f} | {comma_list(view.source_in_base_mm)} | "
            f"{comma_list((*view.q_deg, *(view.e_deg or ())))} | {view.roll_deg:g} | "
            f"{'' if clearance is None else f'{clearance:.1f}'} |"
        )
    return lines


def _scanner_rows(settings: ReportSettings) -> list[str]:
    """Return the rows of the scanner; keys of a plug-in keep their names."""
    row = f"| scanner | {settings.sensor or settings.scanner}, standoff {comma_list(settings.standoffs_mm)} mm"
    if (baseline := settings.number("baseline_mm")) is not None:
        row += f", baseline {baseline:g} mm"
    if span := settings.pair("range_mm"):
        row += f", range {span[0]:g} to {span[1]:g} mm"
    rows = [row + " |"]
    at_source, at_sensor = settings.number("grazing_max_deg"), settings.number("sensor_grazing_max_deg")
    if at_source is None or at_sensor is None:
        return rows
    limits = f"source {at_source:g} deg, sensor {at_sensor:g} deg"
    turn, length = settings.number("sweep_deg"), settings.number("sweep_mm")
    if fov := settings.pair("fov_deg"):
        rows.append(f"| field of view, incidence limits | {_times(fov)} deg, {limits} |")
    elif (fan := settings.number("fan_deg")) is not None:
        sweep = "straight" if turn is None else f"turned by {turn:g} deg"
        sweep += "" if length is None else f", {length:g} mm"
        rows.append(
            f"| fan, sweep, incidence limits | {fan:g} deg, {sweep} in {settings.sweep_poses} poses, {limits} |"
        )
    return rows


def _sweeps(settings: ReportSettings) -> list[str]:
    if settings.sweep_s is None:
        return []
    return [
        f"Each view is a sweep of {settings.sweep_poses} poses, driven as a straight line at constant speed on one "
        f"joint branch, in {settings.sweep_s[0]:.1f} to {settings.sweep_s[1]:.1f} s. Singularities, joint limits and "
        "collisions are checked between its poses as well; occlusion by the arm is not evaluated along it.\n",
    ]


def _arm_and_sigma(report: Report) -> list[str]:
    rows, visible, with_arm = [], report.coverage.visible, report.coverage.visible_with_arm
    if with_arm is not None and with_arm < visible:
        rows.append(f"| visible coverage with each view's own arm as an occluder | {percent(with_arm)} |")
    if sigma := report.sigma:
        rows.append(
            f"| expected standard deviation of a point | median {sigma.median_mm:.4f} mm, 95 % below "
            f"{sigma.quantile_95_mm:.4f} mm, limit {sigma.limit_mm:g} mm |"
        )
    return rows


def _bound(motion: ReportMotion) -> str:
    bound = motion.jerk_free_bound_s
    return f"{bound:.2f} s" + (f"; the motion takes {motion.duration_s / bound:.3f} x as long" if bound else "")


def tightest_moment(clearance: Clearance) -> str:
    """Describe the moment of smallest clearance; "" if there is none."""
    tightest = clearance.tightest
    if tightest is None:
        return ""
    return (
        f"{tightest.distance_mm:.1f} mm, {tightest.between}, {tightest.time_s:.2f} s after the start, on segment "
        f"{tightest.segment + 1} of {len(clearance.segments)}"
    )


def _option_rows(report: Report) -> Rows:
    """Return a row for each result of an option beyond the fewest views."""
    rows: Rows = []
    if most := report.max_coverage:
        text = (
            f"they cover {percent(most.coverage)} of the surface's samples; no selection of {most.max_views} views "
            f"covers more than {percent(most.upper_bound)}"
        )
        rows.append((f"at most {most.max_views} views", text))
    if several := report.multiplicity:
        fewer = several.samples_with_fewer_candidates
        text = f"; {fewer} samples have fewer candidates, and are measured from all of them" if fewer else ""
        rows.append(("views per sample", f"{several.views_per_sample}{text}"))
    if cost := report.cost:
        text = f"{cost.seconds:.1f} s (scan and settling at each view, and the motion); no selection takes less than "
        rows.append(("time of views and motion", f"{text}{cost.seconds_bound:.1f} s"))
    if report.overlap:
        rows.append(("overlap", _overlap(report, report.overlap)))
    if report.robust:
        rows += _robust_rows(report.robust)
    if before := report.further_setup:  # of a plan for the surface that earlier plans left uncovered
        contact = f"; {percent(before.in_contact)} that was uncovered is in contact here" if before.in_contact else ""
        text = (
            f"{percent(before.visible_together)} of the surface, {percent(before.visible_before)} before this one; "
            f"this one measures {percent(before.share)} of the uncovered surface that its candidates can measure"
        )
        rows.append(("all set-ups", text + contact))
    return rows


def _overlap(report: Report, overlap: Overlap) -> str:
    settings = report.settings
    least = (
        f"{settings.overlap_mm2:g} mm²"
        if settings.overlap_share is None
        else f"{100 * settings.overlap_share:g} % of the samples of the smaller view"
    )
    extra, without = overlap.extra_views, overlap.views_without_overlap
    price = f"{extra} more than the {without}" if extra else f"no more than the {without}"
    connected = (
        "all scans are connected"
        if overlap.connected
        else f"the scans form {len(overlap.components)} components; the largest, of "
        f"{overlap.components[0].views} views, covers "
        f"{percent(overlap.components[0].coverage)} of the surface's samples"
    )
    late = overlap.views_without_earlier_overlap
    order = (
        "in visiting order each view overlaps an earlier one"
        if late == 0
        else f"in visiting order {late} of them overlap no earlier view"
    )
    return f"connected by an overlap of {least}: {connected}, {report.n_views} views, {price} without overlap; {order}"


def _robust_rows(robust: RobustCoverage) -> Rows:
    confidence = percent(1 - robust.alpha)
    return [
        (
            "robust coverage",
            f"{percent(robust.robust_on_samples)} of the surface's samples are measured with a probability of "
            f"{confidence} or more, of {percent(robust.robust_coverable_on_samples)} that candidates allow",
        ),
        (
            f"in {robust.executions} simulated executions",
            f"expected on other samples: {percent(robust.coverage)} of the surface; measured in {confidence} of the "
            f"executions or more: {percent(robust.simulated_coverage)}, {percent(robust.confirmed_share)} of the "
            f"expected surface; one execution measures {percent(robust.coverage_mean)} on average, "
            f"{percent(robust.coverage_min)} at worst",
        ),
    ]


def _robust_section(report: Report) -> list[str]:
    if not (robust := report.robust):
        return []
    settings = report.settings
    return [
        "## Coverage under pose errors\n",
        f"Executed poses are assumed to be off by {settings.pose_sd_mm:g} mm along and {settings.pose_sd_deg:g} deg "
        f"about each axis of the scanner (one standard deviation, normal, independent for every view). Probabilities "
        f"are from {robust.members} drawn errors, the same for every view; a view that measures a sample in all n of "
        f"them is credited with (n + 1/2) / (n + 1), so that a confidence of {percent(1 - robust.alpha)} needs at "
        f"least {robust.required_views} such {'view' if robust.required_views == 1 else 'views'} of a sample. On "
        f"average, the expected surface was measured in {percent(robust.mean_frequency)} of the "
        f"{robust.executions} executions ({robust.samples:,} samples that the plan has not seen).\n",
    ]


def curve_section(curve: Curve) -> list[str]:
    """Return the section on the coverage over the number of views."""
    lines = ["## Coverage over the number of views", "", "| of the coverable surface | views | at least |"]
    lines += ["|---|---|---|"]
    lines += [
        f"| {100 * row.share_of_coverable:g} % | {_or_dash(row.views)} | {_or_dash(row.lower_bound)} |"
        for row in curve.minimum_views
    ]
    return [*lines, "", "![Coverage over the number of views, with its bound](curve.png)", ""]


def _or_dash(number: int | None) -> str:
    return "-" if number is None else str(number)


def _region_section(report: Report) -> list[str]:
    if not report.regions:
        return []
    counted = sum(each.area_mm2 for each in report.regions) / report.part.area_mm2
    lines = [
        "## Regions\n",
        f"Shares of the surface in this report refer to the {percent(counted)} of the part's surface that the regions "
        "include.\n",
        "| region | mm² | requested of coverable | coverable | measured | of coverable | limits |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in report.regions:
        views = f", from {each.views} views" if each.views > 1 else ""
        lines.append(
            f"| {html.escape(each.name)} | {each.area_mm2:,.0f} | {percent(each.target)}{views} | "
            f"{percent(each.coverable)} | {percent(each.visible)}{_from_several(each)} | "
            f"{percent(each.visible_of_coverable)} | {_limits(each) or 'none'} |"
        )
    reasons = [f"- {html.escape(each.name)}: {html.escape(each.cause)}." for each in report.regions if each.cause]
    return [*lines, "", *reasons, *([""] if reasons else [])]


def _region_summary(region: RegionResult) -> str:
    limits = _limits(region)
    return (
        f"{percent(region.visible)} of {region.area_mm2:,.0f} mm² measured{_from_several(region)}, "
        f"{percent(region.visible_of_coverable)} of its coverable surface"
        + (f"; {limits}" if limits else "")
        + (f"; {region.cause}" if region.cause else "")
    )


def _from_several(region: RegionResult) -> str:
    return f", {percent(region.satisfied_share)} from {region.views} views" if region.views > 1 else ""


def _limits(region: RegionResult) -> str:
    limits = [] if region.max_spacing_mm is None else [f"points at most {region.max_spacing_mm:g} mm apart"]
    limits += [] if region.max_sigma_mm is None else [f"sigma at most {region.max_sigma_mm:g} mm"]
    return ", ".join(limits)


def _times(values: Iterable[float]) -> str:
    return " x ".join(f"{value:g}" for value in values)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
