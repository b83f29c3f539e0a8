"""The reasons for which a surface point stays open, in the order in which conditions are asked (`planner.why.why`)."""

from enum import IntEnum

from planner.reach.reach import Verdict


class Reason(IntEnum):
    """Where the closest candidate fails; the value is kept in files, in the order in which conditions are asked."""

    MEASURED = 0
    OUT_OF_FOV = 10
    OUT_OF_SENSOR_FOV = 12
    OUT_OF_RANGE = 14
    OUT_OF_DEPTH = 16
    GRAZING_SOURCE = 20
    GRAZING_SENSOR = 22
    TOO_UNCERTAIN = 24
    SOURCE_SHADED_BY_PART = 30
    SENSOR_SHADED_BY_PART = 31
    SOURCE_SHADED = 32
    SENSOR_SHADED = 33
    OUT_OF_REACH = 40
    JOINT_LIMIT = 41
    COLLISION = 42
    NO_PATH = 43
    NOT_SELECTED = 50

    @property
    def sentence(self) -> str:
        """The reason in words, for reports."""
        return _SENTENCES[self]


_SENTENCES = {
    Reason.MEASURED: "measured",
    Reason.OUT_OF_FOV: "outside the field of view",
    Reason.OUT_OF_SENSOR_FOV: "outside the sensor's field of view",
    Reason.OUT_OF_RANGE: "nearer or farther than the range",
    Reason.OUT_OF_DEPTH: "before or behind the depth of field",
    Reason.GRAZING_SOURCE: "laser too grazing",
    Reason.GRAZING_SENSOR: "sensor looks too grazing",
    Reason.TOO_UNCERTAIN: "expected sigma above the limit",
    Reason.SOURCE_SHADED_BY_PART: "laser shaded",
    Reason.SENSOR_SHADED_BY_PART: "sensor shaded",
    Reason.SOURCE_SHADED: "laser shaded",
    Reason.SENSOR_SHADED: "sensor shaded",
    Reason.OUT_OF_REACH: "view out of the arm's reach",
    Reason.JOINT_LIMIT: "view beyond a joint limit",
    Reason.COLLISION: "view in collision",
    Reason.NO_PATH: "no free path to the view",
    Reason.NOT_SELECTED: "reachable view not selected",
}

OF_VERDICT = {
    Verdict.REACHABLE: Reason.NOT_SELECTED,
    Verdict.OUT_OF_REACH: Reason.OUT_OF_REACH,
    Verdict.JOINT_LIMIT: Reason.JOINT_LIMIT,
    Verdict.COLLISION: Reason.COLLISION,
}
"""Where a candidate that measures a point fails by its verdict alone."""
