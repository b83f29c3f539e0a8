"""Program as a table (CSV) and as a JSON object: every via point with its view, joint angles and poses.

One row per via point, in driving order. Names contain the units. Frames are base (the robot's foot), flange and TCP
(the scanner frame); A, B, C are KUKA's. Axis angles are exact multiples of 1e-4 deg. Poses are rounded to 1e-6 mm and
1e-6 deg, times to 1e-6 s, because smaller digits are rounding noise.
"""

import json

import numpy as np

from cell.export.program import Program, angles_deg
from cell.runs.folder import SCHEMA
from planner.kinematics.frames import kuka_abc_from_pose
from planner.ports import axis_name
from planner.values import Floats

_DIGITS = 6
_POSE = ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")


def csv(program: Program) -> bytes:
    """Return the content of `<name>.csv`: a header and one line per via point."""
    axes = (f"{axis_name(axis)}_deg" for axis in range(program.q.shape[1]))
    columns = (
        "number", "segment", "kind", "view", "pose", "candidate", "t_s", *axes,
        *(f"tcp_{name}" for name in _POSE), *(f"flange_{name}" for name in _POSE), "status", "turn",
    )  # fmt: skip
    lines = [",".join(columns)]
    for point in _via_points(program):
        cells = [cell for value in point.values() for cell in (value if isinstance(value, list) else [value])]
        lines.append(",".join("" if cell is None else str(cell) for cell in cells))
    return ("\n".join(lines) + "\n").encode()


def as_json(program: Program) -> bytes:
    """Return the content of `<name>.json`."""
    limits = np.degrees(np.stack([program.limits.lower, program.limits.upper], axis=1))
    content = {
        "schema": SCHEMA,
        "units": "lengths in mm, angles in deg (KUKA A, B, C: R = Rz(A) Ry(B) Rx(C)), times in s, as the names say",
        "name": program.info.name,
        "part": program.info.part,
        "run": program.info.run,
        "digest": program.info.digest,
        "speed_fraction": program.info.speed,
        "acceleration_fraction": program.info.acceleration,
        "tool_flange_tcp_xyz_mm_abc_deg": _pose(program.T_flange_tcp),
        "part_in_base_xyz_mm_abc_deg": _pose(program.T_base_object),
        "joint_limits_deg": limits.round(9).tolist(),
        "sweeps": [
            {
                "from_number": sweep.begin + 1,
                "to_number": sweep.end + 1,
                "speed_mm_s": round(sweep.speed * 1000, _DIGITS),
                "rotation_deg_s": round(float(np.degrees(sweep.rate)), _DIGITS),
            }
            for sweep in program.sweeps
        ],
        "via_points": _via_points(program),
    }
    return (json.dumps(content, indent=2, allow_nan=False) + "\n").encode()


def _via_points(program: Program) -> list[dict[str, object]]:
    """Return the fields of each via point in the order of the columns; None for a missing value."""
    return [
        {
            "number": row + 1,
            "segment": int(program.segment[row]) + 1,
            "kind": program.kinds[row].value,
            "view": int(program.view[row]) or None,
            "pose": None if program.pose[row] < 0 else int(program.pose[row]),
            "candidate": None if program.candidate[row] < 0 else int(program.candidate[row]),
            "t_s": round(float(program.t[row]), _DIGITS),
            "axes_deg": angles_deg(program.q[row]),
            "tcp_xyz_mm_abc_deg": _pose(program.T_base_tcp[row]),
            "flange_xyz_mm_abc_deg": _pose(program.T_base_flange[row]),
            "status": None if program.status is None else int(program.status[row]),
            "turn": None if program.turn is None else int(program.turn[row]),
        }
        for row in range(len(program.q))
    ]


def _pose(T: Floats) -> list[float]:
    """Return x, y, z [mm], A, B, C [deg]."""
    position, abc = kuka_abc_from_pose(T)
    values: list[float] = (np.concatenate([position * 1000, np.degrees(abc)]).round(_DIGITS) + 0.0).tolist()
    return values
