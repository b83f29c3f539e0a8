"""Study of the paper's tables: its method (`rays`, Meta-RaPS) and ours (`aimed`, `auto`) side by side, row by row.

Both select from the same viewpoints, one per face of the planning mesh with the paper's single roll. Both plans are
evaluated on the same held-out samples, and scanned with the same fine resolution. Further columns have our result for
the paper's other space of viewpoints, the view sphere (Section 3.4).
"""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from benchmarks.paper.comparison import DENSER
from benchmarks.paper.tables import PaperRow, tables
from benchmarks.paper.trial import row as compute_row
from benchmarks.paper.trial import scene_keys
from cell.scene.model import PlanSettings
from cell.study.study import Row, Study, plan_options
from cell.study.trials import JsonTable, Outcome, Trial
from cell.view.palette import BLUE, GREY, VERMILION

PARAMETER = "parameter"
_COLUMNS = (
    "table", "part", PARAMETER, "viewpoints", "views paper", "views rays", "views ours",
    "visible rays %", "visible ours %",
)  # fmt: skip
TOLERANCE_POINTS = 0.2
"""Differences of visible coverage up to this count as equal [points]."""

_LOG_FROM = 8  # ratio of most to fewest views for a logarithmic axis

_METHODS = ("paper", "paper's method on our parts", "ours")
_COLOURS = (GREY, VERMILION, BLUE)
_VARIED = {
    1: "faces kept by decimation [%]",
    2: "standoff distance [mm]",
    3: "field of view [deg]",
    4: "angle between rays [deg]",
    5: "position of the part before the robot [mm]",
}
_KEYS = {"table2": "standoff_mm", "table3": "fov_deg", "table4": "resolution_deg", "table5": "place_mm"}
"""Setting of a trial that the table varies; Table 1 varies the faces."""
USUAL = {"fov_deg": 60.0, "resolution_deg": 1.0, "place_mm": None}
STANDOFF_MM = {"mseke": 300.0, "humerus": 30.0, "mug": 100.0, "robinet": 100.0, "petanque": 300.0, "st-jean": 300.0}
"""Settings of rows whose table does not vary them."""
_MUG_OF_TABLE_4_MM = 300
"""Standoff of the Mug in Table 4: it has the 58 views and 53.07 % of Table 2 at 300 mm and 1 degree."""


def table_study(table: str, *, faces_share: float = 1.0, parts: Sequence[str] = ()) -> Study:
    """Return the study of one table, or of all.

    Args:
        table: `table1` to `table5`, or `all`.
        faces_share: share of the planning faces; below 1 for a reduced study.
        parts: only rows of these parts; empty: all.
    """
    of_paper = tables()
    requests = [
        (name, paper, Trial.of(compute_row, _settings(name, paper, faces_share)))
        for name in (of_paper if table == "all" else [table])
        for paper in of_paper[name]
        if not parts or paper.part in parts
    ]

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        values = {outcome.trial: outcome.values for outcome in outcomes}
        return [_row(name, paper, values[trial]) for name, paper, trial in requests if trial in values]

    title = "The paper's tables" if table == "all" else f"The paper's Table {table.removeprefix('table')}"
    settings = {
        (name, paper.part, _parameter(paper)): _settings(name, paper, faces_share) for name, paper, _ in requests
    }

    def options(row: Row) -> str:
        return plan_options(scene_keys(settings[f"table{row['table']}", row["part"], row[PARAMETER]]))

    trials = [trial for _, _, trial in requests]
    return Study(table, title, trials, rows, pictures, sentences, _COLUMNS, options)


def _parameter(paper: PaperRow) -> float | str:
    """Return the varied parameter as the rows show it."""
    match paper.parameter:
        case None:
            return "no robot"
        case tuple(position):
            return ",".join(f"{x:g}" for x in position)
        case value:
            return value


def _row(table: str, paper: PaperRow, values: JsonTable) -> Row:
    """Return the row with the printed values, the paper's method and ours."""
    rays, ours = values["rays"], values["ours"]
    return {
        "table": int(table.removeprefix("table")),
        "part": paper.part,
        PARAMETER: _parameter(paper),
        "viewpoints paper": paper.viewpoints,
        "viewpoints": values["viewpoints"],
        "views paper": paper.views,
        "views rays": rays["views"],
        "views ours": ours["views"],
        "bound rays": rays["lower_bound"],
        "bound ours": ours["lower_bound"],
        "coverage paper %": paper.coverage,
        "visible rays %": 100 * rays["visible"],
        "visible ours %": 100 * ours["visible"],
        "sampled rays %": 100 * rays["sampled"],
        "sampled ours %": 100 * ours["sampled"],
        "views ours at visible rays": values["ours_at_their_visible"]["views"],
        "visible ours at visible rays %": 100 * values["ours_at_their_visible"]["visible"],
        "visible ours at views rays %": 100 * values["ours_at_their_views"]["visible"],
        "samples times": max(values[name]["density"] for name in ("ours_at_their_visible", "ours_at_their_views")),
        "viewpoints sphere": values["sphere"]["viewpoints"],
        "views sphere": values["sphere"]["views"],
        "visible sphere %": 100 * values["sphere"]["visible"],
    }


def rows_lost(rows: Sequence[Row]) -> list[Row]:
    """Return the rows in which ours needs more views for equal coverage, or measures less with equal views.

    Coverages are compared with `TOLERANCE_POINTS`.
    """
    return [
        row
        for row in rows
        if row["views ours at visible rays"] > row["views rays"]
        or min(row["visible ours at visible rays %"], row["visible ours at views rays %"])
        < row["visible rays %"] - TOLERANCE_POINTS
    ]


def sentences(rows: Sequence[Row]) -> list[str]:
    """Summarise the rows."""
    fewer = [row["views ours at visible rays"] / row["views rays"] for row in rows]
    more = [row["visible ours at views rays %"] - row["visible rays %"] for row in rows]
    worse_rows = rows_lost(rows)
    summaries = [
        "The scanner is `paper`: its range (0.5 to 1.5 times) and its baseline (a quarter) follow the standoff.",
        f"At the visible coverage of the paper's method (rays, Meta-RaPS) ours needs {np.mean(fewer):.2f} times "
        f"as many views on average ({min(fewer):.2f} to {max(fewer):.2f}); with its number of views ours measures "
        f"{np.mean(more):+.2f} points on average ({min(more):+.2f} to {max(more):+.2f}).",
    ]
    summaries.append(
        f"In all {len(rows)} rows ours needs no more views for its coverage and measures no less with its number of "
        f"views (to {TOLERANCE_POINTS:g} points)."
        if not worse_rows
        else f"In {len(worse_rows)} of {len(rows)} rows ours is worse: "
        + "; ".join(f"Table {row['table']}, {row['part']}, {row[PARAMETER]}" for row in worse_rows)
        + "."
    )
    denser = sum(row["samples times"] > 1 for row in rows)
    if denser:
        summaries.append(
            f"In {denser} rows ours covers all its samples and the paper's method measures more; there these two "
            f"comparisons use {DENSER} times as many samples."
        )
    return summaries


def pictures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Draw views and coverage over each table's parameter: paper, the paper's method, ours."""
    for table in dict.fromkeys(row["table"] for row in rows):
        yield f"table{table}", _picture([row for row in rows if row["table"] == table])


def _picture(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(12.0, 6.4), dpi=110, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    x = np.arange(len(rows))
    for axes, columns, unit in (
        (above, ("views paper", "views rays", "views ours"), "views"),
        (below, ("coverage paper %", "visible rays %", "visible ours %"), "coverage [%]"),
    ):
        for offset, column, name, colour in zip((-0.27, 0.0, 0.27), columns, _METHODS, _COLOURS, strict=True):
            axes.bar(x + offset, [row[column] for row in rows], 0.25, label=name, color=colour)
        axes.set_ylabel(unit)
        axes.grid(axis="y", alpha=0.3)
    counts = [row[c] for row in rows for c in ("views paper", "views rays", "views ours")]
    if max(counts) > _LOG_FROM * min(counts):
        above.set_yscale("log")
        above.yaxis.set_major_formatter(ScalarFormatter())
    above.legend(ncols=3, loc="upper left")
    above.set_ylim(top=(2.2 if max(counts) > _LOG_FROM * min(counts) else 1.2) * max(counts))
    bounds = [row["bound ours"] for row in rows]
    above.plot(x + 0.27, bounds, linestyle="none", marker="_", color="#111111", markersize=10)
    least = min(row[c] for row in rows for c in ("coverage paper %", "visible rays %", "visible ours %"))
    below.set_ylim(max(0.0, least - 5), 100)
    below.set_xticks(x, [f"{row['part']}\n{row[PARAMETER]}" for row in rows], fontsize=6.5)
    below.set_xlim(-0.6, len(rows) - 0.4)
    figure.suptitle(f"Table {rows[0]['table']}: {_VARIED[rows[0]['table']]} (bars), lower bound for ours (strokes)")
    return figure


def _settings(table: str, row: PaperRow, faces_share: float) -> dict[str, object]:
    settings: dict[str, object] = {
        "part": row.part,
        "faces": max(8, round(faces_share * (930 if table == "table5" else row.viewpoints))),
        # A reduced study has fewer candidates, but the same number of samples of the surface.
        "samples_per_face": round(PlanSettings().samples_per_face / faces_share),
    }
    key = _KEYS.get(table)
    if key and row.parameter != USUAL.get(key, STANDOFF_MM.get(row.part)):  # equal rows are one trial
        settings[key] = row.parameter
    if (table, row.part) == ("table4", "mug"):
        settings["standoff_mm"] = _MUG_OF_TABLE_4_MM
    return settings
