"""What is said of the scans of several set-ups: the page, and the rows of a terminal."""

from cell.runs.schema import ScannedSetups
from cell.setups.report import shared_surface
from cell.words import percent

_WHY = {
    "to_come": "set-ups that are not scanned yet",
    "lost": "planned, and not measured from where the arm and the part really stood",
    "in_contact": "touched by a support in every set-up",
    "not_planned": "no view was planned for it (setups.json says why)",
}


def rows(report: ScannedSetups) -> list[tuple[str, str]]:
    """Names and values for a terminal."""
    found = [
        (
            "measured",
            f"{percent(report.visible)} of the surface by {_number(len(report.setups), 'set-up')}"
            f"{_missing(report)}; planned {percent(report.planned)} by all",
        )
    ]
    for setup in report.setups:
        found.append(
            (f"set-up {setup.number}", f"{setup.views} views, {setup.points:,} points, adds {percent(setup.adds)}")
        )
        if setup.place is not None:
            found.append(("", _stands(setup.place.moved_mm, setup.place.turned_deg, setup.place.undetermined)))
    found += [("open", f"{percent(share)}: {_WHY[name]}") for name, share in dict(report.open).items() if share >= 5e-5]
    off = report.deviation
    surface = (
        report.surface.status
        if off is None
        else f"{report.surface.faces:,} faces, deviation {off.rms_mm:.3f} mm rms, 95 % within "
        f"{off.quantile_95_mm:.3f} mm, largest {off.largest_mm:.3f} mm"
    )
    return [*found, ("surface", surface), *(("doubtful", doubt) for doubt in report.doubts)]


def page(report: ScannedSetups) -> str:
    """report.md."""
    lines = [f"# Scan of {report.part} in several set-ups, {report.source}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows(report)]
    lines += [
        "",
        "## Set-ups",
        "",
        "| | execution | views | points | measures | adds | stood off, mm | deg | not told |",
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    for setup in report.setups:
        place = setup.place
        off = ("", "", "") if place is None else (
            f"{place.moved_mm:.3f}", f"{place.turned_deg:.3f}", "; ".join(place.undetermined)
        )  # fmt: skip
        link = f"[{setup.number}](../setups/{setup.number}/executions/{setup.execution}/report.md)"
        lines.append(
            f"| {link} | {setup.execution} | {setup.views} | {setup.points:,} | {percent(setup.visible)} "
            f"| {percent(setup.adds)} | {' | '.join(off)} |"
        )
    lines += shared_surface(report.shared)
    if report.deviation is not None:
        lines += ["", "![Deviation of the surface](deviation.png)"]
    return "\n".join([*lines, ""])


def _stands(moved_mm: float, turned_deg: float, undetermined: tuple[str, ...]) -> str:
    told = f"the part stood {moved_mm:.2f} mm and {turned_deg:.2f} deg off its place"
    return told + (f"; not determined: {'; '.join(undetermined)}" if undetermined else "")


def _missing(report: ScannedSetups) -> str:
    return f", {_number(len(report.missing), 'more')} to come" if report.missing else ""


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("s" if count != 1 and noun != "more" else "")
