"""Keywords of `cell.api` with their types, for editors and type checkers.

A keyword is an option of the command line by its name: `max_views=8` for `--max-views 8`. The tables of options
(`cell.scene.options`) define names, limits and defaults. A test compares names and types with these tables.

Lengths are in millimetres, angles in degrees and durations in seconds, as on the command line.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, TypedDict

File = str | Path
Units = Literal["mm", "cm", "m", "um", "in"]
Frame = Literal["scanner", "flange", "base"]

WithUnits = str | Mapping[str, float]
"""Text such as "0.5mm,0.1deg" or "20%", or a value by unit such as {"mm": 0.5, "deg": 0.1}."""

Numbers = float | Sequence[float]
Integers = int | Sequence[int]
Names = str | Sequence[str]


class _SceneKeywords(TypedDict, total=False):
    units: Units | None
    place: Sequence[float]
    place_origin: Sequence[float] | None
    table: bool
    sensor: str | None
    baseline: float | None
    max_spacing: float | None
    speed: float
    candidates: Literal["grown", "optimal-scanning-zone", "view-sphere"]
    standoff: Numbers | None
    roll: Numbers
    faces: int | None
    percent: float | None
    samples: int
    fill: Literal["aimed", "rays"]
    solver: Literal["auto", "greedy", "meta-raps", "local-search", "exact"]
    effort: str
    coverage: float
    require: float
    max_sigma: float | None
    collision: Literal["hull", "exact"]
    seed: int
    max_views: int | None
    multiplicity: int
    cost: Literal["views", "time"]
    overlap: WithUnits | None
    overlap_in_order: bool
    pose_sd: WithUnits
    alpha: float
    curve: bool
    qif: File | None
    u_over_t: float | None
    camera: Sequence[float] | None
    hide: Names


class PlanKeywords(_SceneKeywords, total=False):
    """Options of `cell plan`."""

    pin: Integers
    ban: Integers


class SetupsKeywords(_SceneKeywords, total=False):
    """Options of `cell setups`."""

    max_setups: int | None
    proposals: int | None
    first: File | None
    pin: Names
    ban: Names
    setup_seconds: float | None


class EditKeywords(TypedDict, total=False):
    """Options of `cell edit`; a pose is x, y, z, A, B, C of the scanner in base [mm, deg]."""

    drop: Integers
    dropped_range: WithUnits
    move: Mapping[int, Sequence[float]]
    turn: Mapping[int, float]
    add_candidate: Integers
    add_pose: Sequence[Sequence[float]]
    table_angle: float
    repair: bool
    order: Sequence[int]
    keep_order: bool


class _EveryScanKeywords(TypedDict, total=False):
    driver: str
    realtime: bool
    resolution: float | None
    range_noise: float
    noise: Literal["none", "model"]
    pose_error: WithUnits
    acquire: str
    points_frame: Frame | None
    points_units: Units | None
    acquire_wait_s: float
    acquire_timeout_s: float
    confirm_motion: str | None
    reset: bool
    accept_time_scale: float | None


class _CurrentFilesKeywords(TypedDict, total=False):
    scene: File | None
    part: File | None
    accept_changed_scene: Names


class ScanKeywords(_EveryScanKeywords, _CurrentFilesKeywords, total=False):
    """Options of `cell scan`."""

    view: int | None
    setup_error: WithUnits
    actual: File | None
    actual_units: Units | None
    register: bool | None
    seed: int | None
    close_holes: bool
    speed: float | None
    states: File | None


class ExploreKeywords(PlanKeywords, _EveryScanKeywords, total=False):
    """Options of `cell explore`."""

    policy: Literal["stepwise", "two-stage"]
    cylinder: Sequence[float] | None
    voxel: float | None
    ring: int | None
    batch: int
    min_gain: float
    max_seconds: float | None


class LocateKeywords(TypedDict, total=False):
    """Options of `cell locate`."""

    points: File | None
    execution: str | None
    pairs: File | None
    three_two_one: File | None
    points_frame: Frame | None
    points_units: Units | None
    view: Integers
    search: WithUnits
    point_sd: float | None
    tolerance: float


class FeaturesKeywords(TypedDict, total=False):
    """Options of `cell features`."""

    units: Units | None
    qif: File | None


class InspectKeywords(FeaturesKeywords, total=False):
    """Options of `cell inspect`."""

    points_units: Units | None
    search: WithUnits
    point_sd: float | None


class HandEyeKeywords(TypedDict, total=False):
    """Options of `cell calibrate hand-eye`."""

    target: Literal["sphere", "plane"]
    diameter: float | None
    points_units: Units | None
    poses: File | None
    pose_sd: WithUnits
    tolerance: float


class ExportKeywords(_CurrentFilesKeywords, total=False):
    """Options of `cell export`."""

    format: Literal["krl", "rapid", "urscript", "ls", "csv", "json", "ros"] | None
    out: File | None
    name: str | None
    speed: float | None
    acceleration: float | None
    trigger_output: int
    gate_output: int
    done_input: int
    timer: int
    settle: float
    timeout: float


class ReplayKeywords(TypedDict, total=False):
    """Options of `cell replay`."""

    execution: str | None
    view: int | None
    tightest: bool
    rate: float
    once: bool
    web: bool
    frames: File | None
    fps: float
    picture: File | None
    camera: Sequence[float] | None
    hide: Names
    size: Sequence[int]


class StudyKeywords(TypedDict, total=False):
    """Scene, workers and folder of a study."""

    scene: File | None
    units: Units | None
    processes: int | None
    cluster: str | None
    cluster_security: File | None
    out: File | None


class PlaceKeywords(StudyKeywords, total=False):
    """Options of `cell place`; a range is one value or (from, to)."""

    x: Numbers
    y: Numbers
    z: Numbers
    yaw: Numbers
    seed: int
    table: bool
