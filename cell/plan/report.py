"""The plan's report: the page that a person reads, made from the value in report.json. It holds no clock value."""

import html
from collections.abc import Iterable

from cell.plan import region_report, request_report
from cell.plan.attainable import sentence
from cell.plan.clearances import tightest_sentence
from cell.runs.schema import Report, ReportMotion, ReportSettings
from cell.words import listed, percent

_TOLD = 2  # dropped candidates in a terminal
_PART = {"hull": "its convex hull", "exact": "its triangles"}


def markdown(report: Report) -> str:
    """The report page; reads on its own, with its pictures beside it."""
    part, coverage = report.part, report.coverage
    lines = [
        f"# View plan of {html.escape(part.name)} ([look at it](view.html))",
        "",
        f"{report.n_views} views measure {percent(coverage.visible)} of the surface, "
        f"{percent(coverage.visible_of_coverable)} of what the reachable candidates can measure "
        f"({percent(coverage.coverable)}). {_sentence(report.status)}",
        "",
        *(f"{text[0].upper()}{text[1:]}.\n" for _, text in _lost(report)),
        "![The cell, the arm at one of the views](cell.png)",
        "",
        "![The part by the number of views that measure it, and the views](views.png)",
        "",
        *_facts(report),
        "",
    ]
    if part.findings:
        lines += ["## What the mesh check found", "", *(f"- {finding}" for finding in part.findings), ""]
    lines += ["## Reach", "", "| verdict | candidates |", "|---|---|"]
    lines += [f"| {name.replace('_', ' ')} | {count} |" for name, count in report.verdicts]
    if report.blockers:
        lines += ["", "Collisions are with: " + ", ".join(f"{k} ({n})" for k, n in report.blockers.items()) + "."]
    lines += ["", "![Candidates by verdict](reach.png)", "", *_views(report)]
    if report.dropped:
        lines += ["", "Dropped, and the cover solved again without them:", ""]
        lines += [f"- candidate {view.id}: {view.reason}" for view in report.dropped]
    lines += ["", "![Coverage over number of views](cover.png)", "", *region_report.page(report)]
    lines += [*request_report.page(report), "## Motion", ""]
    if report.clearance and (tightest := tightest_sentence(report.clearance)):
        lines += [f"Tightest moment: {tightest}; the part is {_PART[report.clearance.collision]}.", ""]
    lines += [
        f"In task-space order (Christofides) the same views would take {report.motion.baseline_duration_s:.2f} s.",
        "",
        *_of_sweeps(report.settings),
        "![Joint motion](motion.png)",
        "",
        "## What next",
        "",
        "`cell scan RUN` executes the plan, `cell why RUN` says why the rest of the surface stays open, "
        "`cell view RUN` opens the page of this folder.",
        "",
        "## What the numbers mean",
        "",
        "Visible coverage is the share of 100,000 seeded samples of the reference surface, not those that the "
        "optimiser saw, that at least one view measures: laser and sensor legs free of part, fixtures, post, pedestal "
        "and floor, in the field of view, in range, grazing limits kept. The lower bound is over these candidates and "
        "samples.",
        "",
    ]
    return "\n".join(lines)


def table(report: Report) -> list[tuple[str, str]]:
    """What a terminal shows of the plan: names and values."""
    coverage, motion = report.coverage, report.motion
    clearance, bound, fewest = motion.minimum_clearance_mm, motion.jerk_free_bound_s, report.lower_bound
    rows = [
        ("views", f"{report.n_views}  ({report.status})"),
        ("lower bound", f"{'1 view' if fewest == 1 else f'{fewest} views'} for these candidates and samples"),
        (
            "visible coverage",
            f"{percent(coverage.visible)} of the surface, {percent(coverage.visible_of_coverable)} of what "
            "reachable candidates can measure",
        ),
        *_lost(report),
        *spacing_row(report),
        *region_report.rows(report),
        *request_report.rows(report),
        ("candidates", ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in report.verdicts)),
    ]
    if report.dropped:
        told = "; ".join(f"candidate {view.id}: {view.reason}" for view in report.dropped[:_TOLD])
        more = len(report.dropped) - _TOLD
        rows.append(("dropped", told + (f"; and {more} more, see report.md" if more > 0 else "")))
    took = (
        f"{motion.duration_s:.1f} s from home to home through {motion.via_points} points"
        + (f", {motion.duration_s / bound:.3f} x the time-optimal bound without jerk limit" if bound else "")
        + ("" if clearance is None else f"; nearest {clearance:.1f} mm ({motion.between})")
    )
    return [*rows, ("motion", took)]


def _lost(report: Report) -> list[tuple[str, str]]:
    """What any pose would measure; of older runs nothing."""
    if report.attainable is None:
        return []
    return [("of what it can", sentence(report.coverage.visible, report.coverage.coverable, report.attainable))]


def spacing_row(report: Report) -> list[tuple[str, str]]:
    """How far apart the points of a scan lie on what the views measure."""
    if (found := report.spacing) is None:
        return []
    limit = "" if found.limit_mm is None else f", limit {found.limit_mm:g} mm"
    return [
        (
            "spacing of points",
            f"99 % of what is measured has points at most {found.quantile_99_mm:.3g} mm apart, half of it at most "
            f"{found.median_mm:.3g} mm{limit}",
        )
    ]


def _facts(report: Report) -> list[str]:
    """The table at the top of the page."""
    part, settings, motion = report.part, report.settings, report.motion
    return [
        "| | |",
        "|---|---|",
        f"| part | {html.escape(part.name)}: {part.faces:,} faces, {_times(part.extents_mm)} mm, "
        f"{part.area_mm2:,.0f} mm² |",
        f"| planning mesh | {part.planning_faces:,} faces |",
        f"| placement of its centre in base | {listed(settings.placement_mm)} mm, "
        f"A B C {listed(settings.placement_abc_deg)} deg |",
        *_scanner_rows(settings),
        f"| candidates | {settings.candidates}, {report.verdicts.total:,} |",
        f"| matrix | {settings.fill}, {report.n_features:,} surface samples |",
        f"| selection | {report.solver}, {report.n_views} views, lower bound {report.lower_bound}, "
        f"gap {percent(report.gap)} |",
        f"| motion | {motion.duration_s:.2f} s home to home, {motion.via_points} points, speed "
        f"{percent(motion.speed_fraction)} |",
        f"| the same stops without a limit of jerk (time-optimal bound) | {_bound(motion)} |",
        *(f"| {name} | {sentence} |" for name, sentence in (*spacing_row(report), *request_report.rows(report))),
        *_arm_and_sigma(report),
        f"| seed | {settings.seed} |",
    ]


def _views(report: Report) -> list[str]:
    """The section on the views."""
    axes = "A1 .. A6, E1" if any(view.e_deg for view in report.views) else "A1 .. A6"
    lines = [
        "## Views in visiting order",
        "",
        f"| stop | candidate | adds % of surface | source in base x, y, z mm | {axes} deg | roll deg "
        "| clearance on the way mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for stop, view in enumerate(report.views, start=1):
        clearance = view.clearance_on_the_way_mm
        lines.append(
            f"| {stop} | {view.id} | {100 * view.adds:.2f} | {listed(view.source_in_base_mm)} | "
            f"{listed((*view.q_deg, *(view.e_deg or ())))} | {view.roll_deg:g} | "
            f"{'' if clearance is None else f'{clearance:.1f}'} |"
        )
    return lines


def _scanner_rows(settings: ReportSettings) -> list[str]:
    """The scanner's rows of the table; a plug-in's own keys stand as they are named."""
    row = f"| scanner | {settings.sensor or settings.scanner}, standoff {listed(settings.standoffs_mm)} mm"
    if (baseline := settings.number("baseline_mm")) is not None:
        row += f", baseline {baseline:g} mm"
    if span := settings.pair("range_mm"):
        row += f", range {span[0]:g} to {span[1]:g} mm"
    rows = [row + " |"]
    grazing, at_sensor = settings.number("grazing_max_deg"), settings.number("sensor_grazing_max_deg")
    if grazing is None or at_sensor is None:
        return rows
    limits = f"source {grazing:g} deg, sensor {at_sensor:g} deg"
    turn, length = settings.number("sweep_deg"), settings.number("sweep_mm")
    if fov := settings.pair("fov_deg"):
        rows.append(f"| field of view, grazing limits | {_times(fov)} deg, {limits} |")
    elif (fan := settings.number("fan_deg")) is not None:
        sweep = "straight" if turn is None else f"turned by {turn:g} deg"
        sweep += "" if length is None else f", {length:g} mm"
        rows.append(f"| fan, sweep, grazing limits | {fan:g} deg, {sweep} in {settings.sweep_poses} poses, {limits} |")
    return rows


def _of_sweeps(settings: ReportSettings) -> list[str]:
    """What there is to know about views that sweep."""
    if settings.sweep_s is None:
        return []
    return [
        f"Each view is a sweep of {settings.sweep_poses} poses, driven as a straight line at constant speed on one "
        f"joint branch, in {settings.sweep_s[0]:.1f} to {settings.sweep_s[1]:.1f} s. Its singularities, joint "
        "limits and collisions are looked at between its poses too; the arm's own shadow along it is not judged.",
        "",
    ]


def _arm_and_sigma(report: Report) -> list[str]:
    """Rows for what the arm hides and for the precision of the points, where there is something to say."""
    rows, visible, with_arm = [], report.coverage.visible, report.coverage.visible_with_arm
    if with_arm is not None and with_arm < visible:
        rows.append(f"| visible coverage with each view's own arm in the way | {percent(with_arm)} |")
    if sigma := report.sigma:
        rows.append(
            f"| expected standard deviation of a point | median {sigma.median_mm:.4f} mm, 95 % below "
            f"{sigma.quantile_95_mm:.4f} mm, limit {sigma.limit_mm:g} mm |"
        )
    return rows


def _bound(motion: ReportMotion) -> str:
    """The bound without a limit of jerk, and how far the motion is from it."""
    bound = motion.jerk_free_bound_s
    return f"{bound:.2f} s" + (f"; the motion takes {motion.duration_s / bound:.3f} x as long" if bound else "")


def _times(values: Iterable[float]) -> str:
    return " x ".join(f"{value:g}" for value in values)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
