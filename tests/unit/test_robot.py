import itertools
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import cell
from cell import files
from cell.errors import FileError, SceneError
from cell.files import model_file
from cell.robot import model as robot

# Bounds of the true links' surfaces in their own frames [mm], measured on CAD (models/README.md, step 4).
TRUE_BOUNDS_MM = {
    "base": ((-401.9, -268.0, 0.0), (282.4, 268.0, 396.9)),
    "link_1": ((-270.0, -269.9, -291.0), (393.0, 269.9, 170.9)),
    "link_2": ((-91.0, -276.5, -109.7), (772.6, -77.0, 109.7)),
    "link_3": ((-356.3, -117.0, -172.5), (402.6, 213.0, 115.0)),
    "link_4": ((-268.0, -77.0, -77.0), (63.0, 77.0, 77.0)),
    "link_5": ((-58.7, -94.0, -60.0), (148.3, 106.2, 60.0)),
    "link_6": ((146.0, -38.9, -39.0), (158.0, 38.9, 39.0)),
}
TRUE_LITRES = 70.1 + 25.8 + 13.5 + 16.3 + 3.84 + 1.79 + 0.045

FREE = {
    "zero": (0, 0, 0, 0, 0, 0),
    "upright, forearm level": (0, -90, 90, 0, 0, 0),
    "home": (0, -90, 90, 0, 90, 0),
    "A1 turned": (30, -90, 90, 0, 90, 0),
    "generic": (12, -75, 110, 35, -60, 140),
    "tool sideways": (0, -90, 90, 90, 90, 0),
    "wrist straight": (20, -80, 100, 40, 0, -10),
    "arm stretched": (0, -45, -2.990345, 0, 40, 0),
    "wrist centre over A1": (0, -120, 33.857864, 0, 60, 0),
}
MAY_TOUCH = {
    *(frozenset(pair) for pair in itertools.product(("base", "link_1"), ("link_3", "link_4", "link_5", "link_6"))),
    frozenset(("link_2", "link_5")),
    frozenset(("link_2", "link_6")),
}


@pytest.fixture(scope="module")
def model():
    """Return the compiled robot alone."""
    return robot.load()


@pytest.fixture(scope="module")
def data(model):
    """Return the state of the model."""
    return mujoco.MjData(model)


def touching(model, data, q):
    """Return the pairs of links in contact at q (6,) [rad]."""
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    bodies = model.geom_bodyid[data.contact.geom[: data.ncon]]
    return {frozenset(robot.LINKS[body - 1] for body in pair) for pair in bodies.tolist()}


def geoms_of(model, link):
    """Return the ids of a link's shapes."""
    return np.flatnonzero(model.geom_bodyid == model.body(link).id)


def half_spaces(model, geom):
    """Return the half spaces (n, 4) of a box or polytope in its link's frame [m], a x + b <= 0."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        return ConvexHull(robot.mesh_of(model, geom).vertices).equations
    local = np.column_stack([np.concatenate([np.eye(3), -np.eye(3)]), -np.tile(model.geom_size[geom], 2)])
    rotation = rotation_of(model, geom)
    normals = local[:, :3] @ rotation.T
    return np.column_stack([normals, local[:, 3] - normals @ model.geom_pos[geom]])


def rotation_of(model, geom):
    """Return the rotation (3, 3) from a shape's frame to its link's."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return rotation.reshape(3, 3)


def is_inside(model, geom, points):
    """Return whether points (n, 3) in the link's frame are inside a shape."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        local, size = (points - model.geom_pos[geom]) @ rotation_of(model, geom), model.geom_size[geom]
        return (np.hypot(local[:, 0], local[:, 1]) <= size[0]) & (np.abs(local[:, 2]) <= size[1])
    planes = half_spaces(model, geom)
    return (points @ planes[:, :3].T + planes[:, 3] <= 0).all(axis=1)


def bounds(model, geom):
    """Return the bounds of a shape in its link's frame [m]."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        vertices = robot.mesh_of(model, geom).vertices
        return vertices.min(axis=0), vertices.max(axis=0)
    size = model.geom_size[geom]
    half = size if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX else np.array([size[0], size[0], size[1]])
    extent = np.abs(rotation_of(model, geom)) @ half
    return model.geom_pos[geom] - extent, model.geom_pos[geom] + extent


def test_axes_match_the_data_sheet(model):
    """The joints are A1..A6 with KUKA's ranges and speeds; each axis reaches its speed in 0.5 s."""
    limits = robot.limits(model)
    assert model.nq == 6
    assert [model.joint(index).name for index in range(model.njnt)] == list(robot.AXES)
    np.testing.assert_allclose(np.rad2deg(limits.lower), (-185, -155, -130, -350, -130, -350), rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(limits.upper), (185, 35, 154, 350, 130, 350), rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(limits.velocity), (156, 156, 156, 330, 330, 615), rtol=1e-12)
    np.testing.assert_allclose(limits.velocity / limits.acceleration, 0.5, rtol=1e-12)


def test_dimensions_and_home(model):
    """675, 260, 680, -35, 670, 158 mm, and a home that is not singular."""
    arm = robot.dimensions(model)
    np.testing.assert_allclose(
        (arm.d1, arm.a1, arm.a2, arm.a3, arm.d4, arm.d6), (0.675, 0.26, 0.68, -0.035, 0.67, 0.158), rtol=0, atol=1e-15
    )
    np.testing.assert_allclose(np.rad2deg(robot.home(model)), (0, -90, 90, 0, 90, 0), rtol=0, atol=1e-12)


def test_the_model_contains_only_the_robot(model):
    """The model has no actuator or floor, only named convex shapes of group 3, and the estimated total mass."""
    assert (model.nu, model.neq, model.nlight) == (0, 0, 0)
    assert [model.body(index).name for index in range(1, model.nbody)] == list(robot.LINKS)
    assert set(model.geom_group.tolist()) == {3}
    kinds = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH
    assert set(model.geom_type.tolist()) <= set(kinds)
    assert model.mesh_vertnum.max() <= 32
    assert all(
        model.geom(index).name.startswith(model.body(model.geom_bodyid[index]).name) for index in range(model.ngeom)
    )
    np.testing.assert_allclose(model.body_mass.sum(), 235.1, rtol=0, atol=1e-9)


def test_shapes_reach_the_bounds_of_the_true_links(model):
    """The bounds of each link's shapes contain those of its true surface."""
    for link, (lower, upper) in TRUE_BOUNDS_MM.items():
        boxes = np.array([bounds(model, geom) for geom in geoms_of(model, link)]) * 1000
        assert (boxes[:, 0].min(axis=0) <= np.array(lower) + 1e-9).all(), link
        assert (boxes[:, 1].max(axis=0) >= np.array(upper) - 1e-9).all(), link


def test_volume_of_the_shapes(model):
    """The union of the shapes has at most 1.52 of the volume of the true links, 131.4 l."""
    rng = np.random.default_rng(1)
    litres = 0.0
    for link in robot.LINKS:
        geoms = geoms_of(model, link)
        boxes = np.array([bounds(model, geom) for geom in geoms])
        lower, upper = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        points = rng.uniform(lower, upper, (200_000, 3))
        inside = np.any([is_inside(model, geom, points) for geom in geoms], axis=0)
        litres += np.prod(upper - lower) * inside.mean() * 1000
    assert 190.0 < litres < 1.52 * TRUE_LITRES


@pytest.mark.parametrize("name", FREE)
def test_named_poses_are_free(model, data, name):
    """No links are in contact in usual poses."""
    assert touching(model, data, np.deg2rad(FREE[name])) == set()


def test_all_limits_at_once_collide(model, data):
    """At all lower, and at all upper limits, hand and forearm are inside base and column."""
    limits = robot.limits(model)
    for q in (limits.lower, limits.upper):
        assert touching(model, data, q) >= {frozenset(("base", "link_5")), frozenset(("link_1", "link_5"))}


def test_only_the_documented_pairs_ever_touch(model, data):
    """A few percent of random configurations collide, all in pairs that the model's comment lists."""
    limits = robot.limits(model)
    found = [touching(model, data, q) for q in np.random.default_rng(3).uniform(limits.lower, limits.upper, (8000, 6))]
    assert set().union(*found) <= MAY_TOUCH
    assert len(set().union(*found)) >= 6
    assert 0.02 < np.mean([len(pairs) > 0 for pairs in found]) < 0.05


def test_excluded_pairs_stay_apart(model, data):
    """Excluded links that are no neighbours keep 10 mm distance on a dense grid of their axes."""
    signatures = [(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature]
    apart = [(a, b) for a, b in (sorted(pair) for pair in signatures) if b - a > 1]
    assert len(signatures) == 11
    assert len(apart) == 5
    limits = robot.limits(model)
    for a, b in apart:
        axes = list(range(a - 1, b - 1))  # body 1 is the base, body 2 turns about axis 0: only axes in between count
        count = 81 if len(axes) == 2 else 21
        grids = [np.linspace(limits.lower[axis], limits.upper[axis], count) for axis in axes]
        pairs = list(itertools.product(np.flatnonzero(model.geom_bodyid == a), np.flatnonzero(model.geom_bodyid == b)))
        nearest = np.inf
        for angles in itertools.product(*grids):
            data.qpos[:] = 0.0
            data.qpos[axes] = angles
            mujoco.mj_kinematics(model, data)
            nearest = min(nearest, *(mujoco.mj_geomDistance(model, data, i, j, 0.2, None) for i, j in pairs))
        assert nearest > 0.010, (robot.LINKS[a - 1], robot.LINKS[b - 1], nearest)


def test_each_exclusion_has_its_reason():
    """A comment precedes each exclusion of links that are no neighbours, and those of the neighbours."""
    tree = ElementTree.parse(
        model_file("kr16.xml"), ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    )
    contact = list(tree.getroot().find("contact"))
    for before, element in itertools.pairwise(contact):
        if element.tag == "exclude" and element.get("name").startswith("apart_"):
            assert before.tag is ElementTree.Comment
    assert contact[0].tag is ElementTree.Comment


def test_the_file_is_found_in_an_installed_package_and_in_a_tree(tmp_path, monkeypatch):
    """cell/models has priority over models beside cell, and the error of a missing file names both."""
    package = tmp_path / "cell"
    package.mkdir()
    monkeypatch.setattr(files.resources, "files", lambda name: package)
    with pytest.raises(FileError, match=r"neither .* nor .* exists; install scan-cell again"):
        model_file("kr16.xml")
    for folder in (tmp_path / "models", package / "models"):
        folder.mkdir()
        (folder / "kr16.xml").write_text("<mujoco/>", encoding="utf-8")
        assert model_file("kr16.xml") == folder / "kr16.xml"
    (package / "models" / "kr16.xml").write_text("no xml", encoding="utf-8")
    with pytest.raises(FileError, match="cannot be read as an MJCF"):
        robot.load()


def test_there_is_one_model_file():
    """The file is models/kr16.xml or its installed copy, with the same bytes."""
    assert model_file("kr16.xml").name == "kr16.xml"
    assert model_file("kr16.xml").parent.parent in (Path(cell.__file__).parent, Path(cell.__file__).parent.parent)


def changed_model(change):
    """Return the robot's model after a change of its specification."""
    spec = robot.spec()
    change(spec)
    return spec.compile()


@pytest.mark.parametrize(
    "change",
    [
        lambda spec: setattr(spec.body("link_5"), "pos", [0.02, 0, 0.01]),
        lambda spec: setattr(spec.body("link_3"), "pos", [0.68, 0.01, 0]),
        lambda spec: setattr(spec.body("link_3"), "pos", [0.68, 0, 0.01]),
        lambda spec: setattr(spec.joint("A1"), "axis", [0, 0, 1]),
        lambda spec: setattr(spec.body("base"), "pos", [0.1, 0, 0]),
        lambda spec: setattr(spec.site("flange"), "pos", [0.158, 0, 0.001]),
        lambda spec: setattr(spec.site("flange").alt, "xyaxes", [1, 0, 0, 0, 1, 0]),
    ],
)
def test_another_arm_has_no_dimensions_of_a_kr_16(change):
    """Arms with other signs, offsets or zeros have no dimensions of a KR 16, also if its file is rounded."""
    assert robot.dimensions(changed_model(change)) is None
    assert robot.dimensions(changed_model(change), robot.ROUNDED) is None


def test_a_kuka_arm_in_a_rounded_file_keeps_its_dimensions():
    """Angles with five decimals are not exact enough for the closed form, but the axes are KUKA's."""
    model = changed_model(lambda spec: setattr(spec.joint("A5"), "axis", [0, 1, 1.4e-5]))
    assert robot.dimensions(model) is None
    assert robot.dimensions(model, robot.ROUNDED) == robot.dimensions(robot.load())


def test_any_point_of_an_axis_names_it():
    """A file may put the origins of A2, A3 and A5 beside the plane of the arm, on their axes."""

    def move(spec):
        for name, aside in (("link_2", 0.1), ("link_3", -0.05), ("link_4", -0.05), ("link_5", 0.03), ("link_6", -0.03)):
            spec.body(name).pos[1] += aside

    model = changed_model(move)
    assert model.body("link_2").pos[1] == 0.1
    assert robot.dimensions(model) == robot.dimensions(robot.load())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda spec: setattr(spec.site("flange"), "name", "tool"), "no site named flange"),
        (lambda spec: setattr(spec.joint("A6"), "name", "wrist"), "no joint named A6"),
        (lambda spec: setattr(spec.joint("A3"), "type", mujoco.mjtJoint.mjJNT_SLIDE), "not a hinge"),
    ],
)
def test_a_model_without_six_hinges_and_a_flange_is_refused(change, words):
    """The message names the missing element."""
    with pytest.raises(SceneError, match=words):
        robot.dimensions(changed_model(change))


def test_missing_limits_are_named():
    """The message names the missing range, numeric or key, and the place to add it."""

    def without_range(spec):
        spec.joint("A4").limited = mujoco.mjtLimited.mjLIMITED_FALSE

    with pytest.raises(SceneError, match="a joint of the robot model has no range"):
        robot.limits(changed_model(without_range))
    with pytest.raises(SceneError, match="named axis_velocity_limit_deg_s with six values"):
        robot.limits(changed_model(lambda spec: spec.delete(spec.numeric("axis_velocity_limit_deg_s"))))
    with pytest.raises(SceneError, match="no key named home"):
        robot.home(changed_model(lambda spec: spec.delete(spec.key("home"))))
