"""Shapes of SDF and MJCF models in pages: they stand where pinocchio and MuJoCo have them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbdlft
from mbdlft.base.errors import SceneError
from mbdlft.robot import load_robot
from mbdlft.robot.robot import between
from mbdlft.show.viewer.data import reach, view_data
from mbdlft.show.viewer.drawing import draw
from mbdlft.show.viewer.looks import robot_looks
from mbdlft.show.viewer.poses import scene_poses
from tests import random_mjcf
from tests.browser import Loaded
from tests.close import CROSS, PAGE, target
from tests.cross.test_viewer_meshes import corners
from tests.laws.test_viewer import interpret
from tests.robot_files import as_sdf, as_urdf, chain, numbers
from tests.seeds import some

pytestmark = pytest.mark.usefixtures("read_here")

mujoco = pytest.importorskip("mujoco", reason="MJCF needs mujoco: pip install -e '.[robots]'")
SOLID = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def standing(file: Path) -> list[tuple[str, dict[str, Any], np.ndarray]]:
    """Names of bodies, shapes and matrices (4, 4) in space of all shapes, at equilibrium."""
    scene, _ = load_robot(file, right_angle=0.0)
    data = view_data(scene, robot=file)
    still = [0.0] * len(data["coordinates"])
    vectors = interpret(data["tape"], [], still).reshape(-1, 3)
    found = []
    for item in data["items"]:
        for shape in item["shapes"]:
            if shape["layer"] == "meshes":
                frame = np.eye(4)
                frame[:3, 3], frame[:3, :3] = vectors[shape["at"][0]], vectors[shape["at"][1:]].T
                place = np.array(shape["geometry"]["place"]).reshape(4, 4)
                found.append((item["name"], shape["geometry"], frame @ place))
    return found


@pytest.mark.parametrize("version", ["1.9", "1.6"])
def test_shapes_of_sdf_stand_where_pinocchio_has_their_links(tmp_path: Path, version: str) -> None:
    """The poses of visuals are relative to their links, or to the frame that they name."""
    links = chain(1)
    model = pin.buildModelFromXML(as_urdf(links))
    reached = model.createData()
    pin.framesForwardKinematics(model, reached, pin.neutral(model))
    offset, rpy = np.array([0.3, -0.2, 0.5]), (0.4, -0.7, 1.9)
    kinds = {"link0": "link2", "link1": "link1", "link2": "link0"}  # and the frames of their poses
    text, file = as_sdf(links, version), tmp_path / "chain.sdf"
    for link, other in kinds.items():
        word = "frame" if version < "1.7" else "relative_to"
        named = f' {word}="{other}"' if other != link else ""
        pose = f"<pose{named}>{numbers(offset)} {numbers(rpy)}</pose>"
        visual = f'<visual name="v">{pose}<geometry><box><size>1 2 3</size></box></geometry></visual>'
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{visual}')
    file.write_text(text, encoding="utf-8")
    found = standing(file)
    assert [name for name, _, _ in found] == list(kinds)
    own = pin.SE3(pin.rpy.rpyToMatrix(*rpy), offset)
    for name, geometry, place in found:
        frame = reached.oMf[model.getFrameId(kinds[name])]
        target(place, (frame * own).homogeneous, CROSS)
        assert geometry["box"] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("seed", some([0, 1], range(4)))
def test_geoms_stand_where_mujoco_has_them(tmp_path: Path, seed: int) -> None:
    """Random trees with boxes, capsules between two points, a mesh, an ellipsoid and a floor."""
    (tmp_path / "solid.obj").write_text(SOLID, encoding="utf-8")
    asset = '<asset><mesh name="solid" file="solid.obj" scale="0.1 0.2 0.3"/></asset><worldbody>'
    floor = '<geom name="floor" type="plane" size="3 0 1" pos="0 0 -2" euler="10 20 30"/>'
    placed = f'pos="{random_mjcf.numbers(np.random.default_rng(seed), 3)}" euler="20 -50 70"'
    extra = (
        f'<geom type="mesh" mesh="solid" {placed}/><geom type="ellipsoid" size=".1 .2 .3" {placed}/>'
        '<geom type="sphere" size=".1" group="3"/><geom type="sphere" size=".1" rgba="1 1 1 0"/>'
        '<geom type="cylinder" size=".1 .2" mass=".1" zaxis="1 2 3"/></body>'
    )
    text = random_mjcf.written(seed).replace("<worldbody>", asset + floor)
    text = text.replace("</body>", extra, 1)
    file = tmp_path / "tree.xml"
    file.write_text(text, encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(file))
    state = mujoco.MjData(model)
    mujoco.mj_kinematics(model, state)
    found = standing(file)
    seen = [k for k in range(model.ngeom) if model.geom_group[k] == 0 and model.geom_rgba[k][3] > 0]
    assert len(found) == len(seen) == model.ngeom - 2
    expected: dict[str, list[int]] = {}
    for k in seen:
        body = int(model.geom_bodyid[k])
        expected.setdefault(model.body(body).name if body else "ground", []).append(k)
    words = {"PLANE": "plane", "BOX": "box", "CAPSULE": "capsule", "ELLIPSOID": "ellipsoid",
             "CYLINDER": "cylinder", "MESH": "triangles"}  # fmt: skip
    for name, geometry, place in found:
        k = expected[name].pop(0)
        target(place[:3, :3], state.geom_xmat[k].reshape(3, 3), CROSS)
        target(place[:3, 3], state.geom_xpos[k], CROSS, 1.0)
        kind = mujoco.mjtGeom(model.geom_type[k]).name.partition("_")[2]
        assert words[kind] in geometry
        if kind == "BOX":
            target(geometry["box"], 2.0 * model.geom_size[k], CROSS)
        if kind == "CAPSULE":
            target(geometry["capsule"], model.geom_size[k][:2] * [1.0, 2.0], CROSS)
    assert not any(expected.values())


def test_a_mesh_of_mjcf_is_that_of_its_file(tmp_path: Path) -> None:
    """MuJoCo moves the points of a mesh to its center of mass; the page has them where the file does."""
    (tmp_path / "solid.obj").write_text(SOLID, encoding="utf-8")
    file = tmp_path / "one.xml"
    file.write_text(
        '<mujoco><asset><mesh name="solid" file="solid.obj" scale="1 2 1"/></asset><worldbody><body>'
        '<joint type="hinge"/><geom type="mesh" mesh="solid" pos="5 0 0" quat="0 0 0 1"/></body>'
        "</worldbody></mujoco>"
    )
    (shape,) = robot_looks(file).shapes["body_1"]
    found = np.unique(np.round(corners(shape), 5), axis=0)
    expected = np.array([[5.0, 0, 0], [4, 0, 0], [5, -4, 0], [5, 0, 3]])
    target(found, expected[np.lexsort(expected.T[::-1])], PAGE)
    target(shape["extent"], [[4.0, -4.0, 0.0], [5.0, 0.0, 3.0]], PAGE)


SHAPES = {
    "<box><size>1 2 3</size></box>": (0.5, 1.0, 1.5),
    "<sphere><radius>0.5</radius></sphere>": (0.5, 0.5, 0.5),
    "<ellipsoid><radii>1 2 3</radii></ellipsoid>": (1, 2, 3),
    "<cylinder><radius>0.5</radius><length>3</length></cylinder>": (0.5, 0.5, 1.5),
    "<capsule><radius>0.5</radius><length>3</length></capsule>": (0.5, 0.5, 2.0),
    "<cone><radius>0.5</radius><length>3</length></cone>": (0.5, 0.5, 1.5),
    "<plane><normal>1 0 0</normal><size>2 4</size></plane>": (0, 2.0, 1.0),
    "<mesh><uri>model://pack/m.obj</uri><scale>2 2 4</scale></mesh>": None,
}


def shapes_file(folder: Path) -> Path:
    """An SDF file with one link for each shape, all moved and turned by a right angle about x."""
    (folder / "m.obj").write_text(SOLID, encoding="utf-8")
    text = '<sdf version="1.10"><model name="shapes">'
    for k, shape in enumerate(SHAPES):
        text += (
            f'<link name="l.{k}"><pose>0 0 {10 * k} 0 0 0</pose><visual name="v">'
            f"<pose degrees='true'>1 2 3 90 0 0</pose><geometry>{shape}</geometry></visual></link>"
            f'<joint name="j{k}" type="prismatic"><parent>world</parent><child>l.{k}</child>'
            "<axis><xyz>1 0 0</xyz></axis></joint>"
        )
    file = folder / "shapes.sdf"
    file.write_text(text + "</model></sdf>", encoding="utf-8")
    return file


def test_shapes_in_the_browser_are_as_large_as_the_file_says(
    load: Callable[..., Loaded], tmp_path: Path
) -> None:
    """Boxes about the drawn triangles; a dot in the name of a link is none in that of its body."""
    package = tmp_path / "pack"
    package.mkdir()
    file = shapes_file(package)
    scene, _ = load_robot(file)
    page = mbdlft.view(scene, robot=file).save(tmp_path / "page.html")
    extents = robot_looks(file).shapes
    loaded = load(page)
    for k, half in enumerate(SHAPES.values()):
        low, high = np.array(loaded.run("(name) => mbdlft.box(name)", f"l_{k}"))
        middle = np.array([1.0, 2.0, 3.0 + 10 * k])
        if half is None:  # y becomes z, and z becomes -y
            middle += np.array([1.0, -6.0, 2.0])
            half = (1.0, 2.0, 6.0)
        around = np.array([half[0], half[2], half[1]])
        target(low, middle - around, PAGE, 1.0)
        target(high, middle + around, PAGE, 1.0)
        place = np.array(extents[f"l_{k}"][0]["place"]).reshape(4, 4)
        if "plane" in extents[f"l_{k}"][0]:
            target(place[:3, 2], [1.0, 0.0, 0.0], CROSS)  # its normal
        own = extents[f"l_{k}"][0].get("extent")
        if own:
            target(own, [low - [0, 0, 10 * k], high - [0, 0, 10 * k]], PAGE, 1.0)
    assert loaded.complaints == []


def test_a_scene_is_as_large_as_its_shapes(tmp_path: Path) -> None:
    """The box of 3 m of a single body, which has no other extent; a floor does not count."""
    file = tmp_path / "one.xml"
    file.write_text(
        '<mujoco><worldbody><geom type="box" size="50 50 1"/><body><joint type="hinge"/>'
        '<geom type="box" size="1 .5 1.5" euler="0 90 0"/></body></worldbody></mujoco>'
    )
    scene, _ = load_robot(file)
    assert reach(draw(scene_poses(scene), np.zeros(0))) == 1.0
    target(view_data(scene, robot=file)["size"], 3.0, CROSS)


def test_fields_of_heights_are_those_that_mujoco_sees(tmp_path: Path) -> None:
    """A ray from above meets the surface where MuJoCo says, or its other diagonal within a cell."""
    file = tmp_path / "field.xml"
    file.write_text(
        '<mujoco><asset><hfield name="h" nrow="3" ncol="4" size="2 1 0.5 0.1" '
        'elevation="0 1 2 3 1 2 3 4 2 3 4 5"/></asset><worldbody><geom type="hfield" hfield="h" '
        'pos="0.3 0 1"/><body><joint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    looks = robot_looks(file)
    assert looks.notes == []
    (shape,) = (shape for shape in looks.shapes["ground"] if "triangles" in shape)
    triangles = corners(shape).reshape(-1, 3, 3)
    assert len(triangles) == 2 * 2 * 3
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for a, b, c in triangles:  # the heights are a plane, so that both diagonals are the same
        inside = 0.2 * a + 0.5 * b + 0.3 * c
        down, met = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
        way = mujoco.mj_ray(model, data, [*inside[:2], 9.0], down, None, 1, -1, met)
        target(9.0 - way, inside[2], PAGE)


@pytest.mark.parametrize("way", [1, -1])
def test_a_polyline_is_a_prism(tmp_path: Path, way: int) -> None:
    """Its ends have the area of the polygon (which is not convex), its walls that of the outline."""
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)][::way]
    points = "".join(f"<point>{x} {y}</point>" for x, y in outline)
    file = tmp_path / "one.sdf"
    file.write_text(
        '<sdf version="1.9"><model name="m"><link name="a"><visual name="v"><geometry><polyline>'
        f"{points}<height>0.5</height></polyline></geometry></visual></link></model></sdf>"
    )
    (shape,) = robot_looks(file).shapes["a"]
    triangles = corners(shape).reshape(-1, 3, 3)
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = np.ptp(triangles[:, :, 2], axis=1) == 0.0
    target(0.5 * np.sum(np.abs(sides[level, 2])), 2 * 3.0, CROSS)
    target(0.5 * np.sum(np.linalg.norm(sides[~level], axis=1)), 8.0 * 0.5, CROSS)
    for a, b, c in triangles[level]:  # no triangle lies across the corner
        assert not np.all((a + b + c)[:2] / 3.0 > 1.0)


def test_what_is_not_shown_is_said(tmp_path: Path) -> None:
    file = tmp_path / "one.sdf"
    shape = "<box><size>1 2 3</size></box>"
    text = (
        '<sdf version="1.9"><model name="m"><link name="a"><visual name="v"><geometry>'
        f"{shape}</geometry></visual></link><joint name='j' type='revolute'><parent>world</parent>"
        "<child>a</child><axis><xyz>0 0 1</xyz></axis></joint></model></sdf>"
    )
    for other, words in (
        ("<heightmap/>", "Shapes <heightmap> are not shown."),
        ("<box/>", "A <box> of link 'a' has no <size> and is not shown."),
        ("<mesh><uri>no.obj</uri></mesh>", "The mesh 'no.obj' is not there."),
        ("<mesh><uri>m.obj</uri><submesh><name>a</name></submesh></mesh>", "a part is asked for"),
    ):
        file.write_text(text.replace(shape, other), encoding="utf-8")
        looks = robot_looks(file)
        assert looks.shapes == {}
        assert words in looks.notes[0]
    file.write_text(text.replace("1 2 3", "1 2"), encoding="utf-8")
    with pytest.raises(SceneError, match=r"one.sdf: line 1: visual of link 'a'.*3 finite numbers"):
        robot_looks(file)
    file.write_text(text, encoding="utf-8")
    scene, _ = load_robot(file)
    bodies = [body.model_copy(update={"name": "b"}) for body in scene.bodies]
    joints = [joint.model_copy(update={"child": "b"}) for joint in scene.joints]
    renamed = mbdlft.Scene(name="renamed", bodies=bodies, joints=joints)
    assert view_data(renamed, robot=file)["notes"] == ["The scene has no body for the shapes of a."]


@pytest.mark.parametrize("seed", range(3))
def test_the_least_turn_between_two_directions(seed: int) -> None:
    a, b = np.random.default_rng(seed).standard_normal((2, 3))
    for other in (b, a, -a, -a + 1e-7 * b, 1e-300 * b, np.array([0.0, 0.0, -1.0])):
        R = between(a, other)
        target(R @ R.T, np.eye(3), CROSS)
        target(np.linalg.det(R), 1.0, CROSS)
        unit = other / np.max(np.abs(other))
        target(R @ a / np.linalg.norm(a), unit / np.linalg.norm(unit), PAGE)
        across = np.cross(a, unit)
        if np.linalg.norm(across) > PAGE:
            target(R @ across, across, PAGE, np.linalg.norm(across))
    with pytest.raises(SceneError, match="a direction has no length"):
        between(a, np.zeros(3))
