"""Read files of the schemas scan-cell/run/1 (without a rotary table) and scan-cell/run/2 (with one).

The layout is that of the present schema; only the names below differ. Files are converted when they are read and are
never rewritten, so that hashes and digest remain valid.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, get_args

from numpy.typing import NDArray
from pydantic import BaseModel
from pydantic.fields import FieldInfo

FORMER_SCHEMAS = ("scan-cell/run/1", "scan-cell/run/2")

FORMER_KEYS: Mapping[str, Mapping[str, str]] = {
    "Manifest": {
        "way": "path_digest",
        "resumed": "resumptions",
        "started": "start_time",
        "moving_s": "motion_s",
        "pid_began": "pid_start",
    },
    "Resumption": {"at": "time", "after": "previous_status", "way": "path_digest", "way_deg": "path_deg"},
    "NamedFile": {"what": "role"},
    "Coverage": {
        "target_on_features": "target_on_samples",
        "planned_on_features": "planned_on_samples",
        "coverable_on_features": "coverable_on_samples",
    },
    "Exclusion": {"reason": "cause"},
    "SegmentClearance": {"at_least_mm": "lower_bound_mm"},
    "MaxCoverage": {"covered": "coverage"},
    "OverlapComponent": {"covered": "coverage"},
    "Overlap": {
        "views_without": "views_without_overlap",
        "without_earlier": "views_without_earlier_overlap",
        "parts": "components",
    },
    "RobustSelection": {
        "views_needed": "required_views",
        "robust_on_features": "robust_on_samples",
        "robust_coverable_on_features": "robust_coverable_on_samples",
    },
    "RobustCoverage": {
        "promised": "coverage",
        "achieved": "simulated_coverage",
        "kept": "confirmed_share",
        "frequency": "mean_frequency",
        "coverage_worst": "coverage_min",
    },
    "Cost": {"bound_seconds": "seconds_bound"},
    "FurtherSetup": {"before": "visible_before", "together": "visible_together"},
    "PlanResult": {
        "dropped": "exclusions",
        "most_coverage": "max_coverage",
        "promise": "robust",
        "open_of": "further_setup",
    },
    "Attainable": {"asked": "samples"},
    "RegionResult": {
        "asked": "target",
        "shared": "common_target",
        "from_enough_views": "satisfied_share",
        "reason": "cause",
    },
    "ReportView": {"adds": "marginal_coverage", "clearance_on_the_way_mm": "segment_clearance_mm"},
    "MinimumViews": {"of_coverable": "share_of_coverable", "at_least": "lower_bound"},
    "Curve": {"fewest": "minimum_views"},
    "Report": {"n_features": "n_samples", "of_several": "common_cover"},
    "ResolvedTable": {"turn_deg": "free_range_deg"},
    "ExecutedView": {"stop": "number", "adds": "marginal_coverage"},
    "ExecutedRegistration": {"left_as_reported": "uncorrected_scans"},
    "ExecutedLocalisation": {
        "moved_mm": "displacement_mm",
        "turned_deg": "rotation_deg",
        "worst_point_mm": "max_point_sd_mm",
        "undetermined": "free_motions",
        "off_mm": "error_mm",
        "off_deg": "error_deg",
    },
    "ExecutedSurface": {"reach_mm": "max_point_distance_mm"},
    "SurfaceDeviation": {"largest_mm": "max_mm"},
    "ExecutedDeviation": {"closed": "closed_holes"},
    "ExecutedRegion": {"from_enough_views": "satisfied_share"},
    "ExecutionReport": {
        "doubts": "contradictions",
        "left_out": "unusable_files",
        "place": "localisation",
        "model": "surface",
    },
    "CandidateSetup": {"left_out": "cause"},
    "SelectedSetup": {"offered": "candidate", "adds": "marginal_coverage"},
    "SetupsCoverage": {"asked": "target"},
    "SetupsRegion": {"asked": "target"},
    "UncoveredShares": {"not_asked": "not_selected"},
    "CommonSurface": {"free": "free_motions"},
    "SetupsFile": {
        "views_first": "alternative",
        "kept": "satisfied_share",
        "chosen": "selected",
        "offered": "candidates",
        "shared": "common_surface",
        "open": "uncovered",
    },
    "ScannedSetup": {"adds": "marginal_coverage", "place": "localisation"},
    "UnmeasuredShares": {"to_come": "not_scanned", "lost": "not_measured"},
    "ScannedSetups": {
        "missing": "missing_setups",
        "open": "uncovered",
        "shared": "common_surface",
        "doubts": "contradictions",
    },
    "ExploredCylinder": {"middle_mm": "centre_mm", "given": "user_defined"},
    "ExploredBatch": {
        "planned_on": "planning_surface",
        "expected_mm2": "expected_gain_mm2",
        "too_near_mm2": "below_range_mm2",
        "new_mm2": "realised_gain_mm2",
        "open_mm2": "uncovered_mm2",
        "never_entered_mm3": "unseen_mm3",
    },
    "UncoveredArea": {"reason": "cause"},
    "ExploreFile": {
        "ended": "stop_reason",
        "stages": "batches",
        "open": "uncovered",
        "model_middle_mm": "model_centre_mm",
        "misses_limits": "share_beyond_limits",
    },
    "EstimatedChange": {"gains_estimated": "estimated_gain"},
    "RecommendedChange": {"gains": "gain", "gains_mm2": "gain_mm2"},
    "UncoveredSamples": {"reason": "cause", "what": "object"},
    "WhyReport": {
        "open": "uncovered",
        "not_measurable": "uncoverable",
        "overall": "best_changes",
        "tried": "all_changes",
    },
}
"""Name of the table in `cell.runs.schema`, to former key, to present key."""

FORMER_ARRAYS: Mapping[str, str] = MappingProxyType({"clearance_at_least": "clearance_lower_bound", "stop": "number"})
"""Former to present name of an array of motion.npz or of a scan."""


def with_present_arrays(stored: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays of a former schema by their present names."""
    return {FORMER_ARRAYS.get(name, name): array for name, array in stored.items()}


def nested_table(annotation: Any) -> type[BaseModel] | None:
    """Return the table that an annotation names, alone, optional or in a tuple."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((table for inner in get_args(annotation) if (table := nested_table(inner))), None)


def with_present_keys(content: Any, table: type[BaseModel]) -> Any:
    """Return a JSON value of a former schema with the present keys of a table, without unknown keys."""
    if isinstance(content, list):
        return [with_present_keys(each, table) for each in content]
    if not isinstance(content, dict):
        return content
    names: dict[str, str] = {
        old: new for each in table.__mro__ for old, new in FORMER_KEYS.get(each.__name__, {}).items()
    }
    fields: dict[str, FieldInfo] = {field.alias or name: field for name, field in table.model_fields.items()}
    converted: dict[str, Any] = {}
    for former, value in content.items():
        key = names.get(str(former), str(former))
        if key in fields:
            nested = nested_table(fields[key].annotation)
            converted[key] = with_present_keys(value, nested) if nested else value
        elif table.model_config.get("extra") == "allow":
            converted[key] = value
    return converted
