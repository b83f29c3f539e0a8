"""`cell check`: compile a scene and say what stands where, what touches at home, how far it reaches, what is wrong."""

from dataclasses import asdict, dataclass

import numpy as np

from cell import scanners
from cell.checks.doubtful import doubtful
from cell.checks.possible import impossible
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.robot.arm import wrist_of_flange, wrist_places
from cell.robot.model import AXES
from cell.scanners import ScannerPlugin
from cell.scene import devices
from cell.scene.part_regions import areas_of, with_regions
from cell.scene.region_limits import require_attainable
from cell.scene.resolve import Settings, resolve
from cell.scene.scene import Scene
from cell.words import listed
from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from cell.world.model import World, compile_world
from cell.world.shapes import TABLE

Triple = tuple[float, float, float]

_FIDELITY = {"hull": "its convex hull (hull)", "exact": "its triangles (exact)"}

_GRID_DEG = 0.5  # of A2 and A3 in the envelope: the wrist's outline is then exact to 0.1 mm


@dataclass(frozen=True, slots=True)
class Envelope:
    """Where the wrist centre gets within the limits of A2 and A3, and how far the laser source stands from it [mm].

    Attributes:
        wrist_reach_mm: farthest from the A1 axis.
        wrist_lowest_mm: lowest height, base frame.
        wrist_highest_mm: greatest height, base frame.
        wrist_to_source_mm: from wrist centre to laser source, for every joint angle.
    """

    wrist_reach_mm: float
    wrist_lowest_mm: float
    wrist_highest_mm: float
    wrist_to_source_mm: float


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What `cell check` found.

    Attributes:
        problems: what is wrong, one sentence each; empty for a scene that can be planned.
        warnings: what is hardly meant, one sentence each.
        findings: what the part's checks noted.
        part: its name.
        part_size_mm: sides of its bounding box.
        regions_mm2: area of each region that somebody cares for; none of a part without.
        placement_mm: its centre in the base frame.
        home_deg: A1..A6.
        contacts_at_home: pairs nearer than the clearance and their distance [mm], negative in contact, nearest first.
        nearest_at_home: the nearest guarded pair, "" beyond 300 mm.
        nearest_at_home_mm: its distance.
        joint_limits_deg: lowest and highest angle of each axis.
        envelope: how far the arm reaches.
        mount_mm: laser source in the flange frame.
        housing_size_mm: the scanner's box.
        housing_mm: its middle in the flange frame.
        bracket_length_mm: from flange to housing; 0: none.
        baseline_mm: from source to sensor.
        sensor: name of the device that the scanner is, None for a law of its own.
        range_mm: of a point's distance; None: the scanner has none.
        obstacles: names of everything that arm and tool keep clear of.
        clearance_mm: by how much.
        collision: what stands for the part: hull or exact.
        guarded_pairs: pairs of shapes that are looked at.
    """

    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    findings: tuple[str, ...]
    part: str
    part_size_mm: Triple
    regions_mm2: dict[str, float]
    placement_mm: Triple
    home_deg: tuple[float, ...]
    contacts_at_home: tuple[tuple[str, float], ...]
    nearest_at_home: str
    nearest_at_home_mm: float
    joint_limits_deg: dict[str, tuple[float, float]]
    envelope: Envelope
    mount_mm: Triple
    housing_size_mm: Triple
    housing_mm: Triple
    bracket_length_mm: float
    baseline_mm: float
    sensor: str | None
    range_mm: tuple[float, float] | None
    obstacles: tuple[str, ...]
    clearance_mm: float
    collision: str
    guarded_pairs: int

    @property
    def exit_code(self) -> int:
        """0, or 2 where something is wrong with the scene."""
        return 2 if self.problems else 0

    def summary(self) -> dict[str, object]:
        """The result as JSON values."""
        contacts = [{"pair": pair, "distance_mm": distance} for pair, distance in self.contacts_at_home]
        return {"schema": 1, "ok": not self.problems, **asdict(self), "contacts_at_home": contacts}

    def rows(self) -> list[tuple[str, str]]:
        """The result as a table of two columns."""
        contacts = "; ".join(f"{pair} ({distance:.1f} mm)" for pair, distance in self.contacts_at_home)
        nearest = f"{self.nearest_at_home}, {self.nearest_at_home_mm:.1f} mm" if self.nearest_at_home else "none"
        limits = ", ".join(f"{axis} {low:g}..{high:g}" for axis, (low, high) in self.joint_limits_deg.items())
        reach = self.envelope
        bracket = f", bracket {self.bracket_length_mm:g} mm" if self.bracket_length_mm else ", no bracket"
        span = f", range {self.range_mm[0]:g} to {self.range_mm[1]:g} mm" if self.range_mm is not None else ""
        return [
            ("part", f"{self.part}, {_by(self.part_size_mm)} mm"),
            *[(f"region {name}", f"{area:,.1f} mm²") for name, area in self.regions_mm2.items()],
            ("part's centre", f"{listed(self.placement_mm)} mm in base"),
            ("home", f"{listed(self.home_deg)} deg"),
            ("contacts at home", contacts or "none"),
            ("nearest at home", nearest if nearest != "none" else f"nothing within {1000 * DISTANCE_CAP:g} mm"),
            ("joint limits", f"{limits} deg"),
            (
                "reach",
                f"wrist to {reach.wrist_reach_mm:.1f} mm from the A1 axis, z {reach.wrist_lowest_mm:.1f} to "
                f"{reach.wrist_highest_mm:.1f} mm; the source {reach.wrist_to_source_mm:.1f} mm from the wrist",
            ),
            ("scanner", f"{self.sensor or 'of its own'}{span}"),
            ("laser source", f"{listed(self.mount_mm)} mm in flange; baseline {self.baseline_mm:g} mm"),
            ("housing", f"{_by(self.housing_size_mm)} mm, middle at {listed(self.housing_mm)} mm in flange{bracket}"),
            ("keeps clear of", f"{', '.join(self.obstacles)} by {self.clearance_mm:g} mm"),
            ("part in collisions", _FIDELITY[self.collision]),
            ("guarded pairs", f"{self.guarded_pairs} pairs of shapes"),
            *[("warning", warning) for warning in self.warnings],
            *[("note", finding) for finding in self.findings],
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Compiled:
    """A scene made into what is looked at.

    Attributes:
        scene: that was compiled.
        part: its part.
        settings: what it leaves open, settled for the part.
        scanner: the sensor's law.
        world: the model.
    """

    scene: Scene
    part: Workpiece
    settings: Settings
    scanner: ScannerPlugin
    world: World


def compiled(scene: Scene) -> Compiled:
    """Load the part and compile the scene.

    Raises:
        FileError: if the part or a fixture cannot be read.
        SceneError: if there is nothing to compile.
    """
    part = with_regions(workpiece.load(scene.part.source, scene.part.units), scene)
    scene = devices.by_part(scene, part)
    settings = resolve(scene, part)
    scanner = scanners.make(scene.scanner.type, settings.scanner)
    require_attainable(scene, scanner)
    baseline_mm = scanners.baseline_mm(settings.scanner, scanner)
    world = compile_world(scene, part.reference.vertices, part_faces=part.reference.faces, baseline_mm=baseline_mm)
    return Compiled(scene, part, settings, scanner, world)


def check_scene(scene: Scene) -> CheckResult:
    """Load the part, compile the scene and look at it; see `compiled`. What can be compiled but not be is told."""
    return checked(compiled(scene))


def checked(cell: Compiled) -> CheckResult:
    """Look at a compiled scene; what cannot be is in `problems`."""
    scene, part, settings, world = cell.scene, cell.part, cell.settings, cell.world
    baseline_mm = scanners.baseline_mm(settings.scanner, cell.scanner)
    checker = MujocoCollisionChecker(world)
    contacts = tuple((pair, _mm(distance)) for pair, distance in checker.near(world.home))
    distance, nearest = checker.distance(world.home[None])
    envelope = _envelope(world)
    problems = impossible(world)
    if beyond := _beyond_reach(world, envelope, max(settings.standoffs)):
        problems.append(beyond)
    lower, upper = (np.rad2deg(ends).round(6).tolist() for ends in (world.limits.lower, world.limits.upper))
    standing = {"part", "post", TABLE, "pedestal", "floor", *(fixture.name for fixture in scene.fixtures)}
    return CheckResult(
        problems=tuple(problems),
        warnings=tuple(doubtful(world)),
        findings=tuple(finding.sentence for finding in part.findings),
        part=part.name,
        part_size_mm=_triple(part.size),
        regions_mm2=areas_of(part, scene),
        placement_mm=_triple((world.T_base_object @ world.T_object_centre)[:3, 3]),
        home_deg=world.scene.robot.settled_home_deg,
        contacts_at_home=contacts,
        nearest_at_home=nearest[0],
        nearest_at_home_mm=_mm(distance[0]),
        joint_limits_deg={axis: (low, high) for axis, low, high in zip((*AXES, "E1"), lower, upper, strict=False)},
        envelope=envelope,
        mount_mm=_triple(world.T_flange_scanner[:3, 3]),
        housing_size_mm=scene.housing.sides_mm,
        housing_mm=_triple(world.T_flange_housing[:3, 3]),
        bracket_length_mm=_mm(2 * world.model.geom("bracket").size[1]) if "bracket" in world.entities else 0.0,
        baseline_mm=baseline_mm,
        sensor=scene.scanner.sensor,
        range_mm=settings.scanner.get("range_mm"),
        obstacles=tuple(name for name in dict.fromkeys(world.entities) if name in standing),
        clearance_mm=scene.clearance_mm,
        collision=world.collision,
        guarded_pairs=len(world.pairs),
    )


def _envelope(world: World) -> Envelope:
    """The wrist over the whole range of A2 and A3."""
    out, up = wrist_places(world.model, world.scene.robot.T_base, float(np.radians(_GRID_DEG)))
    source = world.T_flange_scanner[:3, 3] - wrist_of_flange(world.model)
    return Envelope(
        _mm(np.abs(out).max(), 1), _mm(up.min(), 1), _mm(up.max(), 1), _mm(float(np.linalg.norm(source)), 1)
    )


def _beyond_reach(world: World, envelope: Envelope, standoff: float) -> str:
    """A sentence where not even the nearest point of the part comes within the standoff; a necessary condition only."""
    T_base_centre = world.T_base_object @ world.T_object_centre
    centre = (np.linalg.inv(world.scene.robot.T_base) @ T_base_centre)[:3, 3]
    radius = float(np.linalg.norm(world.part_hull.vertices - world.T_object_centre[:3, 3], axis=1).max())
    farthest = (envelope.wrist_reach_mm + envelope.wrist_to_source_mm) / 1000 + standoff
    if world.table is not None:  # half a turn may bring it nearer
        farthest += 2 * float(np.linalg.norm(world.table.seen(T_base_centre[:3, 3])[:2]))
    gap = float(np.hypot(centre[0], centre[1])) - radius - farthest
    if gap <= 0:
        return ""
    return (
        f"the part is out of reach: it stands {1000 * gap:.0f} mm beyond what the laser sees from the arm's farthest "
        f"reach; its centre must be within {1000 * (farthest + radius):.0f} mm of the A1 axis"
    )


def _mm(metres: float, digits: int = 3) -> float:
    return round(1000 * float(metres), digits)


def _triple(metres: np.ndarray) -> Triple:
    x, y, z = (_mm(value) + 0.0 for value in metres)  # + 0.0 turns -0 into 0
    return x, y, z


def _by(values: tuple[float, ...]) -> str:
    return " x ".join(f"{value:.4g}" for value in values)
