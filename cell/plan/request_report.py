"""Requests beyond the fewest views, in words with units: rows for terminal and report, sections for the page."""

from cell.runs.schema import Curve, OpenOf, Overlap, Promise, Report
from cell.words import percent


def rows(report: Report) -> list[tuple[str, str]]:
    """(name, sentence) for each request; none for a plain plan."""
    found: list[tuple[str, str]] = []
    if most := report.most_coverage:
        found.append(
            (
                f"at most {most.max_views} views",
                f"they cover {percent(most.covered)} of the surface's samples; no so many candidates cover more "
                f"than {percent(most.upper_bound)}",
            )
        )
    if several := report.multiplicity:
        fewer = several.samples_with_fewer_candidates
        found.append(
            (
                "views per sample",
                f"{several.views_per_sample}"
                + (f"; {fewer} samples can be measured from fewer, and are from all of these" if fewer else ""),
            )
        )
    if cost := report.cost:
        found.append(
            (
                "time of views and motion",
                f"{cost.seconds:.1f} s (scan and settling at each view, and the motion); no selection takes less than "
                f"{cost.bound_seconds:.1f} s",
            )
        )
    if report.overlap:
        found.append(("overlap", _overlap(report, report.overlap)))
    if report.promise:
        found += _promise(report.promise)
    if report.open_of:
        found.append(("all set-ups together", _together(report.open_of)))
    return found


def _together(found: OpenOf) -> str:
    touched = (
        f"; {percent(found.in_contact)} that was open touches what the part lies on here" if found.in_contact else ""
    )
    return (
        f"{percent(found.together)} of the surface, {percent(found.before)} before this one; this one measures "
        f"{percent(found.share)} of what was open and its reachable candidates can measure{touched}"
    )


def _overlap(report: Report, overlap: Overlap) -> str:
    settings = report.settings
    least = (
        f"{settings.overlap_mm2:g} mm²"
        if settings.overlap_share is None
        else f"{100 * settings.overlap_share:g} % of what the smaller view measures"
    )
    extra, without = overlap.extra_views, overlap.views_without
    price = f"{extra} more than the {without}" if extra else f"no more than the {without}"
    together = (
        "all scans hang together"
        if overlap.connected
        else f"the scans fall into {len(overlap.parts)} parts; the largest, of {overlap.parts[0].views} "
        f"views, covers {percent(overlap.parts[0].covered)} of the surface's samples"
    )
    late = overlap.without_earlier
    order = (
        "in visiting order each view overlaps an earlier one"
        if late == 0
        else f"in visiting order {late} of them overlap no earlier view"
    )
    return f"joined where two share {least}: {together}, {report.n_views} views, {price} without this; {order}"


def _promise(promise: Promise) -> list[tuple[str, str]]:
    sure = percent(1 - promise.alpha)
    return [
        (
            "robust coverage",
            f"{percent(promise.robust_on_features)} of the surface's samples are measured with a probability of "
            f"{sure} or more, of {percent(promise.robust_coverable_on_features)} that can be",
        ),
        (
            f"in {promise.executions} simulated executions",
            f"promised on other samples: {percent(promise.promised)} of the surface; measured in {sure} of the "
            f"executions or more: {percent(promise.achieved)}, of what was promised {percent(promise.kept)}; one "
            f"execution measures {percent(promise.coverage_mean)} on average, {percent(promise.coverage_worst)} "
            "at worst",
        ),
    ]


def page(report: Report) -> list[str]:
    """The report's section on what needs more than a row; no lines for a plain plan."""
    lines: list[str] = []
    if promise := report.promise:
        settings = report.settings
        lines += [
            "## The promise under pose errors",
            "",
            f"Executed poses are taken to be off by {settings.pose_sd_mm:g} mm along and "
            f"{settings.pose_sd_deg:g} deg about each axis of the scanner (one standard deviation, normal, drawn "
            f"anew for every view: independent). Probabilities are from {promise.members} drawn errors, the same "
            f"for every view; a view that measures a sample in all n of them is credited with (n + 1/2) / (n + 1), so "
            f"that a promise of {percent(1 - promise.alpha)} needs at least {promise.views_needed} such "
            f"{'view' if promise.views_needed == 1 else 'views'} of a sample. On average, promised surface was "
            f"measured in {percent(promise.frequency)} of the {promise.executions} executions "
            f"({promise.samples:,} samples that the plan has not seen).",
            "",
        ]
    if report.curve:
        lines += coverage_over_views(report.curve)
    return lines


def coverage_over_views(curve: Curve) -> list[str]:
    """The section of the curve."""
    lines = ["## Coverage over the number of views", "", "| of what can be measured | views | at least |"]
    lines += ["|---|---|---|"]
    lines += [
        f"| {100 * row.of_coverable:g} % | {_or_dash(row.views)} | {_or_dash(row.at_least)} |" for row in curve.fewest
    ]
    return [*lines, "", "![Coverage over the number of views, with its bound](curve.png)", ""]


def _or_dash(number: int | None) -> str:
    return "-" if number is None else str(number)
