"""Looks of robots: meshes of public files stand where pinocchio has them, and are as large."""

import base64
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.cases.robots import robots
from mbdlft.base.errors import SceneError
from mbdlft.robot import load_robot
from mbdlft.show.viewer.data import view_data
from mbdlft.show.viewer.looks import robot_looks, thinned
from tests.close import CROSS, MESH, WRITTEN_ANGLE, target
from tests.laws.test_viewer import interpret

BALL = """<robot name="b">
<link name="a"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
{visual}</link><link name="root"/>
<joint name="j" type="revolute"><parent link="root"/><child link="a"/><axis xyz="0 0 1"/>
<limit effort="1" velocity="1" lower="-1" upper="1"/></joint></robot>"""


def corners(geometry: dict[str, object]) -> np.ndarray:
    """Corners (n, 3) of the triangles of a mesh, in the frame of its link."""
    flat = np.frombuffer(base64.b64decode(str(geometry["triangles"])), dtype="<f4")
    place = np.array(geometry["place"]).reshape(4, 4)
    return flat.reshape(-1, 3).astype(float) @ place[:3, :3].T + place[:3, 3]


def installed(file: str) -> Path:
    try:
        for package in ("example-robot-data", "trimesh"):
            distribution(package)
    except PackageNotFoundError:
        pytest.skip("no robots are installed: pip install -e '.[robots,viewer]'")
    return robots() / file


@pytest.mark.parametrize(
    "file",
    [
        "ur_description/urdf/ur5_robot.urdf",
        pytest.param("kinova_description/robots/kinova.urdf", marks=pytest.mark.long),
    ],
)
def test_meshes_stand_where_pinocchio_has_them(file: str) -> None:
    path = installed(file)
    scene, _ = load_robot(path)
    data = view_data(scene, robot=path)
    assert data["notes"] == []
    still = [0.0] * len(data["coordinates"])
    vectors = interpret(data["tape"], [], still).reshape(-1, 3)
    positions = interpret(data["positions"], [], still)
    model = pin.buildModelFromUrdf(str(path))
    folders = [str(robots().parents[1])]
    visual = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.VISUAL, package_dirs=folders)
    q = pin.neutral(model)
    for one, position in zip(data["coordinates"], positions, strict=True):
        joint = model.joints[model.getJointId(one["owner"])]
        if joint.nq == 1:
            q[joint.idx_q] = position
        else:  # a joint without limits is a point of the circle in pinocchio
            q[joint.idx_q : joint.idx_q + 2] = np.cos(position), np.sin(position)
    geometry, reached = pin.GeometryData(visual), model.createData()
    pin.updateGeometryPlacements(model, reached, visual, geometry, q)
    drawn: dict[str, list[dict[str, Any]]] = {}
    for item in data["items"]:
        own = [shape for shape in item["shapes"] if shape["layer"] == "meshes"]
        if own:
            drawn[item["name"]] = own
    assert len(drawn) >= 7
    for thing, placed in zip(visual.geometryObjects, geometry.oMg, strict=True):
        shape = drawn[model.frames[thing.parentFrame].name].pop(0)
        given = shape["geometry"]
        r, *axes = vectors[shape["at"]]
        place = np.array(given["place"]).reshape(4, 4)
        turned = np.array(axes).T @ place[:3, :3]
        target(turned, placed.rotation, WRITTEN_ANGLE)
        target(r + np.array(axes).T @ place[:3, 3], placed.translation, WRITTEN_ANGLE, 1.0)
        box = thing.geometry
        box.computeLocalAABB()
        ours = (corners(given) - place[:3, 3]) @ place[:3, :3]
        size = float(np.max(box.aabb_local.max_ - box.aabb_local.min_))
        target(ours.min(axis=0), box.aabb_local.min_, MESH, size)
        target(ours.max(axis=0), box.aabb_local.max_, MESH, size)
    assert not any(drawn.values())


def written(folder: Path, visual: str) -> Path:
    file = folder / "robot.urdf"
    file.write_text(BALL.format(visual=f"<visual>{visual}</visual>"), encoding="utf-8")
    return file


def test_primitives_and_their_places(tmp_path: Path) -> None:
    origin = '<origin xyz="1 2 3" rpy="0.1 -0.2 0.3"/>'
    for text, found in (
        ('<box size="1 2 3"/>', {"box": [1.0, 2.0, 3.0]}),
        ('<sphere radius="0.5"/>', {"sphere": 0.5}),
        ('<cylinder radius="0.5" length="2"/>', {"cylinder": [0.5, 2.0]}),
        ('<capsule radius="0.5" length="2"/>', {"capsule": [0.5, 2.0]}),
    ):
        file = written(tmp_path, f"{origin}<geometry>{text}</geometry>")
        (shape,) = robot_looks(file).shapes["a"]
        place = np.array(shape.pop("place")).reshape(4, 4)
        assert shape.pop("extent")
        assert shape == found
        target(place[:3, :3], pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), CROSS)
        target(place[:, 3], [1.0, 2.0, 3.0, 1.0], CROSS)
    unknown = robot_looks(written(tmp_path, '<geometry><cloud radius="1"/></geometry>'))
    assert unknown == ({}, ["Shapes <cloud> are not shown."])


def test_scaled_meshes_and_those_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    (tmp_path / "bad.stl").write_text("nothing", encoding="utf-8")
    file = written(tmp_path, '<geometry><mesh filename="m.obj" scale="2 3 4"/></geometry>')
    (shape,) = robot_looks(file).shapes["a"]
    target(corners(shape).max(axis=0), [2.0, 3.0, 0.0], CROSS)
    for name, words in (("no.stl", "is not there"), ("bad.stl", "mesh 'bad.stl'")):
        found = robot_looks(written(tmp_path, f'<geometry><mesh filename="{name}"/></geometry>'))
        assert found.shapes == {}
        assert words in found.notes[0]
    package = tmp_path / "pack" / "urdf"
    package.mkdir(parents=True)
    (tmp_path / "pack" / "m.obj").write_text((tmp_path / "m.obj").read_text(), encoding="utf-8")
    file = written(package, '<geometry><mesh filename="package://pack/m.obj"/></geometry>')
    assert list(robot_looks(file).shapes) == ["a"]


def test_wrong_numbers_name_the_line(tmp_path: Path) -> None:
    file = written(tmp_path, '<geometry><box size="1 2"/></geometry>')
    with pytest.raises(SceneError, match=r"robot.urdf: line 4: visual of link 'a'.*3 finite numbers"):
        robot_looks(file)


def test_thinned_meshes_keep_their_size() -> None:
    """A ball of 20 000 triangles: as many as there is room for, on the same ball."""
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 101), np.linspace(0.0, np.pi, 101))
    points = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[:-1, 1:], points[1:, 1:]
    halves = [np.stack(three, -2).reshape(-1, 3, 3) for three in ((a, b, c), (b, d, c))]
    ball = np.concatenate(halves)
    target(thinned(ball, 30_000), ball, CROSS)
    for most in (5000, 1000, 60):
        found = thinned(ball, most)
        assert 0.2 * most < len(found) <= most
        radii = np.linalg.norm(found.reshape(-1, 3), axis=1)
        assert radii.max() <= 1.0 + CROSS
        assert radii.min() > 0.7
