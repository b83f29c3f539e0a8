"""Names of the files of an inspection in a run folder."""

FEATURES, RESULTS, PREDICTED, TABLE, POINTS, QIF_SOURCE, QIF_RESULTS, PAGE = (
    "features.json", "features.json", "uncertainty.json", "characteristics.csv", "feature_points.csv",
    "characteristics.qif", "results.qif", "features.html",
)  # fmt: skip
