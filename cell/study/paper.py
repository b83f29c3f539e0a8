"""The paper's Tables 1 to 5 as printed: 86 rows of parameter, viewpoints, views and coverage.

Table 5 gives the robot's position with respect to the object; docs/frames.md says how that is read. The paper's own
contradictions (docs/internals/paper_tables.md) are kept as they stand.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One row.

    Attributes:
        part: built-in part that stands for the paper's.
        parameter: what the table varies: faces kept [%], standoff [mm], FOV [deg], resolution [deg] or position [mm];
            None for the row of Table 5 without a robot.
        viewpoints: candidates, one per face of the planning mesh; in Table 5 those that the robot reaches.
        views: length of the view plan.
        coverage: of the surface [%].
    """

    part: str
    parameter: float | tuple[float, float, float] | None
    viewpoints: int
    views: int
    coverage: float


TABLES: dict[str, tuple[PaperRow, ...]] = {
    "table1": (  # Decimation: share of the faces that is kept [%].
        PaperRow("mseke", 0.5, 930, 11, 97.91),
        PaperRow("mseke", 1, 1858, 14, 98.05),
        PaperRow("mseke", 2, 3724, 34, 98.01),
        PaperRow("humerus", 0.1, 276, 6, 95.55),
        PaperRow("humerus", 0.5, 1386, 16, 95.43),
        PaperRow("humerus", 1, 2776, 38, 95.46),
        PaperRow("mug", 0.1, 148, 6, 81.68),
        PaperRow("mug", 0.5, 748, 12, 89.19),
        PaperRow("mug", 1, 1498, 118, 52.48),
        PaperRow("robinet", 0.5, 814, 19, 87.6),
        PaperRow("robinet", 1, 1628, 40, 89.14),
        PaperRow("robinet", 2, 3256, 83, 88.33),
        PaperRow("petanque", 0.1, 338, 8, 94.02),
        PaperRow("petanque", 0.5, 1698, 29, 94.9),
        PaperRow("petanque", 1, 3398, 67, 94.36),
        PaperRow("st-jean", 0.1, 746, 10, 86.92),
        PaperRow("st-jean", 0.2, 1496, 25, 89.8),
        PaperRow("st-jean", 0.5, 3746, 69, 89.31),
    ),
    "table2": (  # Standoff distance [mm].
        PaperRow("mseke", 50, 1858, 92, 90.55),
        PaperRow("mseke", 100, 1858, 14, 98.63),
        PaperRow("mseke", 300, 1858, 14, 98.05),
        PaperRow("mseke", 500, 1858, 29, 96.53),
        PaperRow("humerus", 5, 276, 17, 68.05),
        PaperRow("humerus", 10, 276, 10, 92.5),
        PaperRow("humerus", 30, 276, 6, 95.55),
        PaperRow("humerus", 50, 276, 7, 93.97),
        PaperRow("mug", 50, 748, 13, 85.53),
        PaperRow("mug", 100, 748, 12, 89.19),
        PaperRow("mug", 300, 748, 58, 53.07),
        PaperRow("mug", 500, 748, 107, 48.88),
        PaperRow("robinet", 50, 814, 24, 90.55),
        PaperRow("robinet", 100, 814, 19, 92.74),
        PaperRow("robinet", 300, 814, 40, 89.14),
        PaperRow("robinet", 500, 814, 34, 72.71),
        PaperRow("petanque", 100, 338, 9, 76.79),
        PaperRow("petanque", 300, 338, 8, 94.02),
        PaperRow("petanque", 500, 338, 15, 86.98),
        PaperRow("st-jean", 100, 746, 19, 87.13),
        PaperRow("st-jean", 300, 746, 10, 86.92),
        PaperRow("st-jean", 500, 746, 22, 81.57),
    ),
    "table3": (  # Field of view [deg].
        PaperRow("mseke", 10, 1858, 107, 97.19),
        PaperRow("mseke", 30, 1858, 26, 97.57),
        PaperRow("mseke", 60, 1858, 14, 98.05),
        PaperRow("mseke", 90, 1858, 13, 97.83),
        PaperRow("humerus", 10, 276, 32, 70.36),
        PaperRow("humerus", 30, 276, 9, 94.94),
        PaperRow("humerus", 60, 276, 6, 95.55),
        PaperRow("humerus", 90, 276, 6, 94.01),
        PaperRow("mug", 10, 748, 58, 60.43),
        PaperRow("mug", 30, 748, 20, 86.18),
        PaperRow("mug", 60, 748, 12, 89.19),
        PaperRow("mug", 90, 748, 11, 90.9),
        PaperRow("robinet", 10, 814, 66, 84.61),
        PaperRow("robinet", 30, 814, 32, 80.41),
        PaperRow("robinet", 60, 814, 19, 87.6),
        PaperRow("robinet", 90, 814, 17, 84.19),
        PaperRow("petanque", 10, 338, 30, 47.33),
        PaperRow("petanque", 30, 338, 11, 85.03),
        PaperRow("petanque", 60, 338, 8, 94.02),
        PaperRow("petanque", 90, 338, 7, 90.41),
        PaperRow("st-jean", 10, 746, 39, 80.45),
        PaperRow("st-jean", 30, 746, 16, 88.04),
        PaperRow("st-jean", 60, 746, 9, 91.8),
        PaperRow("st-jean", 90, 746, 9, 91.65),
    ),
    "table4": (  # Angle between rays [deg].
        PaperRow("mseke", 0.5, 1858, 8, 98.43),
        PaperRow("mseke", 1, 1858, 14, 98.05),
        PaperRow("humerus", 0.1, 276, 5, 93.16),
        PaperRow("humerus", 0.5, 276, 5, 94.62),
        PaperRow("humerus", 1, 276, 6, 95.55),
        PaperRow("mug", 0.1, 748, 5, 98.38),
        PaperRow("mug", 0.5, 748, 23, 79.91),
        PaperRow("mug", 1, 748, 58, 53.07),
        PaperRow("robinet", 0.5, 814, 12, 94.33),
        PaperRow("robinet", 1, 814, 19, 87.6),
        PaperRow("petanque", 0.5, 338, 5, 94.93),
        PaperRow("petanque", 1, 338, 8, 94.02),
        PaperRow("st-jean", 0.3, 736, 8, 94.02),
        PaperRow("st-jean", 0.5, 736, 9, 91.8),
    ),
    "table5": (  # Position [mm].
        PaperRow("mseke", None, 930, 11, 97.91),
        PaperRow("mseke", (1500, 500, 0), 76, 18, 52.96),
        PaperRow("mseke", (1400, 500, 0), 304, 23, 88.28),
        PaperRow("mseke", (1300, 500, 0), 495, 15, 95.08),
        PaperRow("mseke", (1200, 500, 0), 692, 11, 97.54),
        PaperRow("mseke", (1200, 600, 0), 600, 11, 97.82),
        PaperRow("mseke", (1200, 700, 0), 515, 15, 96.43),
        PaperRow("mseke", (1200, 800, 0), 432, 20, 92.16),
    ),
}
