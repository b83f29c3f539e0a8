"""The reasons for which a surface point stays open, in the order in which conditions are asked (`planner.why.why`)."""

from planner.kinematics.reach import Verdict
from planner.worded import Worded


class Reason(Worded):
    """Where the closest candidate fails; the value is kept in files, in the order in which conditions are asked."""

    MEASURED = 0, "measured"
    OUT_OF_FOV = 10, "outside the field of view"
    OUT_OF_SENSOR_FOV = 12, "outside the sensor's field of view"
    OUT_OF_RANGE = 14, "nearer or farther than the range"
    OUT_OF_DEPTH = 16, "before or behind the depth of field"
    GRAZING_SOURCE = 20, "laser too grazing"
    GRAZING_SENSOR = 22, "sensor looks too grazing"
    TOO_SPARSE = 23, "points too far apart"
    TOO_UNCERTAIN = 24, "expected sigma above the limit"
    SOURCE_SHADED_BY_PART = 30, "laser shaded"
    SENSOR_SHADED_BY_PART = 31, "sensor shaded"
    SOURCE_SHADED = 32, "laser shaded"
    SENSOR_SHADED = 33, "sensor shaded"
    OUT_OF_REACH = 40, "view out of the arm's reach"
    JOINT_LIMIT = 41, "view beyond a joint limit"
    COLLISION = 42, "view in collision"
    NO_PATH = 43, "no free path to the view"
    NOT_SELECTED = 50, "reachable view not selected"


REASON_OF_VERDICT = {
    Verdict.REACHABLE: Reason.NOT_SELECTED,
    Verdict.OUT_OF_REACH: Reason.OUT_OF_REACH,
    Verdict.JOINT_LIMIT: Reason.JOINT_LIMIT,
    Verdict.COLLISION: Reason.COLLISION,
}
"""Where a candidate that measures a point fails by its verdict alone."""
