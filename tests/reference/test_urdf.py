"""Scenes of URDF files against closed forms, and what the report says."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation as Turn

import mbdlft
from mbdlft import Angle, Parameter, SceneError, load_robot
from mbdlft.robot import make as values_of
from mbdlft.robot.robot import RobotJoint, RobotLink, root_of
from tests.close import CLOSED_FORM, exact, roundoff, target
from tests.errors.robots import ROBOT, written
from tests.errors.table import says

PENDULUM = """<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial>
    <origin xyz="0 0 -{L}"/><mass value="{m}"/>
    <inertia ixx="{J}" iyy="{J}" izz="0.02" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="pivot" type="continuous">
    <parent link="base"/><child link="rod"/>
    <origin rpy="0 0 1.57079632679"/><axis xyz="0 1 0"/><dynamics damping="{d}"/>
  </joint>
</robot>"""
SIZES = {"L": 0.7, "m": 2.0, "J": 0.05, "d": 0.03}


def pendulum(folder: Path) -> Path:
    return written(folder, text=PENDULUM.format(**SIZES))


def test_pendulum_equals_its_closed_form(tmp_path: Path) -> None:
    scene, _ = load_robot(
        pendulum(tmp_path),
        parameters=[Angle("theta", 20.0, -60.0, 100.0)],
        values={"pivot.position": "theta"},
        vary={"rod.mass": 30, "rod.center_of_mass.z": 20, "rod.inertia.yy": 10},
    )
    model = mbdlft.to_lft(scene, search=0.0)
    points = mbdlft.random(model.parameters, 50, seed=2)
    m, z, J = (points[f"rod_{name}"] for name in ("mass", "center_of_mass_z", "inertia_yy"))
    theta = np.radians(points["theta"])
    inertia, weight = J + m * z**2, -9.81 * m * z
    A, B, _, _ = mbdlft.matrices_at(model, points)
    target(A[:, 1, 0], -weight * np.cos(theta) / inertia, CLOSED_FORM)
    target(A[:, 1, 1], -SIZES["d"] / inertia, CLOSED_FORM)
    target(B[:, 1, 0], 1 / inertia, CLOSED_FORM)
    target(mbdlft.trim_at(model, points)[:, 0], weight * np.sin(theta), CLOSED_FORM)


def test_scene_and_report_of_the_crane(tmp_path: Path) -> None:
    scene, report = load_robot(written(tmp_path), right_angle=1e-6)
    bodies = {body.name: body for body in scene.bodies}
    joints = {joint.name: joint for joint in scene.joints}
    assert list(bodies) == ["rail", "carriage", "arm", "tip_left", "tip_right"]
    assert [joint.kind for joint in scene.joints] == [
        "fixed", "prismatic", "revolute", "prismatic", "prismatic",
    ]  # fmt: skip
    assert joints["slide"].parent == "rail.slide"
    assert bodies["rail"].ports == {"slide": (0.0, 0.0, 2.0)}
    assert [(r.axis, r.angle) for r in joints["slide"].orientation] == [((0, 0, 1), "90*deg")]
    assert (joints["slide"].axis, joints["slide"].damping) == ((0.0, 2.0, 0.0), 0.5)
    assert joints["swing"].position == 1.0
    assert joints["other"].position == 0.01
    assert report.ignored == (
        "<visual>: 1",
        "<transmission>: 1",
        "Coulomb friction of slide: it is not linear",
        "limits of effort and velocity of 4 joints; the report has them",
    )
    assert report.assumed == (
        "1 angles are multiples of 90 deg, from which the file differs by at most 2.7e-08 rad",
        "links without <inertial> have no mass: rail",
        "links with a mass and no inertia are point masses: tip.left, tip.right",
        "the limits of swing exclude 0: its position is their middle, 1 rad",
        "names that a scene cannot have: tip.left is tip_left, tip.right is tip_right",
        "gravity is 9.81 m/s^2 against the z axis of the ground",
    )
    assert report.limits[0] == mbdlft.JointLimit("slide", "m", -1.0, 3.0, 100.0, 2.0)
    assert str(report).splitlines()[0] == "ignored: <visual>: 1"
    assert mbdlft.scene_from_toml(mbdlft.scene_to_toml(scene)) == scene
    assert mbdlft.to_lft(scene, search=0.0).certificate.max_relative_error < CLOSED_FORM


# the inertia of an inertial frame that is turned ---------------------------------------------

ANGLES = st.tuples(*[st.floats(-4.0, 4.0)] * 3)


@given(ANGLES)
def test_inertia_is_turned_into_the_axes_of_the_link(rpy: tuple[float, float, float]) -> None:
    entries = dict(zip(values_of.ENTRIES, (2.0, 0.3, -0.2, 2.5, 0.1, 1.9), strict=True))
    link = RobotLink("link", 1, inertial=True, rpy=rpy, inertia=entries)
    found = values_of._inertia(link, 0.0, [])
    matrix = np.array([[entries["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
    R = Turn.from_euler("xyz", rpy).as_matrix()  # about fixed axes, as rpy
    turned = np.array([[found["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
    roundoff(turned, R @ matrix @ R.T)


def test_units_of_parameters_are_converted(tmp_path: Path) -> None:
    """A length in mm and a mass in g stand where the file has m and kg."""
    scene, _ = load_robot(
        pendulum(tmp_path),
        parameters=[
            Parameter("drop", 700.0, percent=20, unit="mm"),
            Parameter("m", 2000.0, percent=20, unit="g"),
        ],
        values={"rod.center_of_mass.z": "-drop", "rod.mass": "m"},
    )
    model = mbdlft.to_lft(scene, search=0.0)
    points = mbdlft.random(model.parameters, 20, seed=4)
    m, L = points["m"] / 1000, points["drop"] / 1000
    target(
        mbdlft.matrices_at(model, points).A[:, 1, 0], -9.81 * m * L / (SIZES["J"] + m * L**2), CLOSED_FORM
    )


def test_missing_limits_are_told(tmp_path: Path) -> None:
    limit = '<limit lower="0.5" upper="1.5" effort="20" velocity="1"/>'
    _, report = load_robot(
        written(tmp_path, limit, '<limit effort="20" velocity="1"/>'), values={"swing.position": 3.0}
    )
    assert "joints without limits of position have none: swing" in report.assumed
    assert report.limits[1] == mbdlft.JointLimit("swing", "rad", None, None, 20.0, 1.0)


@pytest.mark.parametrize(
    ("given", "lower", "upper"), [('lower="-0.5"', -0.5, 0.0), ('upper="0.5"', 0.0, 0.5)]
)
def test_a_limit_alone_has_the_other_at_zero(
    tmp_path: Path, given: str, lower: float, upper: float
) -> None:
    limit = '<limit lower="0.5" upper="1.5" effort="20" velocity="1"/>'
    file = written(tmp_path, limit, f'<limit {given} effort="20" velocity="1"/>')
    _, report = load_robot(file)
    assert report.limits[1] == mbdlft.JointLimit("swing", "rad", lower, upper, 20.0, 1.0)


# choices -------------------------------------------------------------------------------------


def test_locked_joints_hold_their_positions(tmp_path: Path) -> None:
    """A slide locked at a value is the file with its origin moved there, and a fixed joint."""
    parameters = [Parameter("s", 0.5, 0.2, 0.8, unit="m"), Angle("a", 60.0, 40.0, 80.0)]
    positions = {"slide.position": "s", "swing.position": "a", "finger.position": 0.02}
    scene, _ = load_robot(
        written(tmp_path), parameters=parameters, values=positions, moving=["finger", "other"]
    )
    moved = ROBOT.replace('name="slide" type="prismatic"', 'name="slide" type="fixed"')
    del positions["slide.position"]
    other, _ = load_robot(
        written(tmp_path, text=moved),
        parameters=parameters,
        values=positions | {"slide.origin.x": "-s"},  # y of the joint is -x of the rail
        moving=["finger", "other"],
    )
    models = [mbdlft.to_lft(each, search=0.0) for each in (scene, other)]
    assert [signal.name for signal in models[0].inputs] == ["finger.force", "other.force"]
    points = mbdlft.random(models[0].parameters, 20, seed=0)
    found = [mbdlft.matrices_at(model, points) for model in models]
    for a, b in zip(*found, strict=True):
        target(a, b, CLOSED_FORM)
    target(*(mbdlft.trim_at(model, points) for model in models), CLOSED_FORM)


def test_locked_finger_is_where_it_is_held(tmp_path: Path) -> None:
    """The arm swings a mass at the end of the finger: the file with its origin there."""
    finger = Parameter("f", 0.05, 0.01, 0.09, unit="m")
    origin = '<origin xyz="0 0 -1"/>'
    down = '<origin xyz="0 0 -1" rpy="0 1.5707963267948966 0"/>'
    along = ROBOT.replace(origin, down, 1)
    text = along.replace('name="finger" type="prismatic"', 'name="finger" type="fixed"')
    positions = {"other.position": 0.03, "swing.position": 0.9}
    locked, _ = load_robot(
        written(tmp_path, text=along),
        parameters=[finger],
        values=positions | {"finger.position": "f"},
        moving=["swing"],
    )
    moved, _ = load_robot(
        written(tmp_path, text=text),
        parameters=[finger],
        values=positions | {"finger.origin.z": "-1 - f"},  # x of the joint is -z of the arm
        moving=["swing"],
    )
    models = [mbdlft.to_lft(each, search=0.0) for each in (locked, moved)]
    points = mbdlft.random(models[0].parameters, 20, seed=0)
    found = [mbdlft.matrices_at(model, points) for model in models]
    for a, b in zip(*found, strict=True):
        target(a, b, CLOSED_FORM)


def test_mimic_joint_follows_a_parameter(tmp_path: Path) -> None:
    file = written(tmp_path)
    grip = Parameter("grip", 0.05, 0.01, 0.09, unit="m")
    scene, _ = load_robot(file, parameters=[grip], values={"finger.position": "grip"})
    (other,) = (joint for joint in scene.joints if joint.name == "other")
    assert other.position == "0.5*(grip) + 0.01"
    (follows,) = scene.couplings
    assert (follows.joint, follows.leader, follows.multiplier) == ("other", "finger", 0.5)
    _, report = load_robot(file, moving=["other", "slide", "swing"])
    assert "<mimic> of other: their leaders do not move" in str(report)
    file.write_text(file.read_text(encoding="utf-8").replace('multiplier="0.5"', 'multiplier="0"'))
    still, report = load_robot(file)
    assert not still.couplings
    assert "<mimic> of other: the multiplier is 0, so they do not move" in str(report)
    wide = Parameter("grip", 0.05, 0.01, 0.19, unit="m")
    with pytest.raises(SceneError, match=r"joint 'finger'.*leave the limits"):
        load_robot(file, parameters=[wide], values={"finger.position": "grip"})


def test_file_in_another_encoding_is_read(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    text = '<?xml version="1.0" encoding="iso-8859-1"?>\n' + PENDULUM.format(**SIZES)
    file.write_bytes(text.replace('"rod"', '"bâton"').encode("iso-8859-1"))
    scene, _ = load_robot(file)
    assert [body.name for body in scene.bodies] == ["base", "bâton"]


def test_link_called_ground_and_a_second_root_joint(tmp_path: Path) -> None:
    text = PENDULUM.format(**SIZES).replace('"base"', '"ground"').replace("pivot", "root_joint")
    scene, report = load_robot(written(tmp_path, text=text))
    assert [body.name for body in scene.bodies] == ["ground_link", "rod"]
    assert [(j.name, j.parent) for j in scene.joints] == [
        ("root_joint_", "ground"),
        ("root_joint", "ground_link"),
    ]
    assert "names that a scene cannot have: ground is ground_link" in report.assumed


def test_free_root_is_held_by_its_weight(tmp_path: Path) -> None:
    file = pendulum(tmp_path)
    values = {"base.mass": 3.0, "base.inertia.xx": 0.1, "base.inertia.yy": 0.1, "base.inertia.zz": 0.1}
    scene, report = load_robot(file, base="free", values=values)
    model = mbdlft.to_lft(scene, search=0.0)
    trim = {s.name: v for s, v in zip(model.trim.signals, model.trim.nominal, strict=True)}
    target(trim["hold_force_z.force"], 9.81 * (3.0 + SIZES["m"]), CLOSED_FORM)
    assert any("hold the free robot" in line for line in report.assumed)
    locked, _ = load_robot(file, base="free", values=values, moving=[])
    assert [joint.kind for joint in locked.joints] == ["free", "fixed"]
    floating, report = load_robot(file, base="free", values=values, gravity=(0, 0, 0))
    assert floating.loads == ()
    assert not any("hold" in line or "gravity" in line for line in report.assumed)
    exact(mbdlft.to_lft(floating, search=0.0).trim.nominal, [0.0])


def test_planar_joint(tmp_path: Path) -> None:
    text = PENDULUM.format(**SIZES).replace("continuous", "planar")
    scene, report = load_robot(written(tmp_path, text=text), values={"pivot.position.x": 0.2})
    assert scene.joints[1].kind == "planar"
    assert scene.joints[1].position == (0.2, 0.0, 0.0)
    assert "damping of pivot: give it in the scene" in report.ignored


def test_unphysical_inertias_are_kept_when_asked(tmp_path: Path) -> None:
    file = written(tmp_path, 'ixx="0.1"', 'ixx="0.3"')
    scene, report = load_robot(file, keep_unphysical=True)
    assert "inertias that no body can have are kept: carriage" in report.assumed
    text = mbdlft.scene_to_toml(scene)
    assert "unchecked = true" in text
    assert mbdlft.scene_from_toml(text) == scene
    with pytest.raises(SceneError, match=r"mass \[kg\] is negative"):
        load_robot(file, keep_unphysical=True, values={"arm.mass": -1.0})


# URDF files that are written in xacro: they are expanded where their name says that they are --------

XACRO = """<robot name="rods" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="L" value="${2 * 0.4}"/>
  <xacro:macro name="rod" params="name parent">
    <link name="${name}"><inertial><origin xyz="0 0 ${-L / 2}"/><mass value="2"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="to_${name}" type="continuous"><parent link="${parent}"/><child link="${name}"/>
      <axis xyz="0 1 0"/></joint>
  </xacro:macro>
  <link name="base"/><xacro:rod name="one" parent="base"/><xacro:rod name="two" parent="one"/>
</robot>"""


def file_of(folder: Path, name: str, text: str = XACRO) -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def test_xacro_is_expanded(tmp_path: Path) -> None:
    pytest.importorskip("xacro", reason="xacro files need the package xacro: '.[xacro]'")
    scene, _ = load_robot(file_of(tmp_path, "rods.urdf.xacro"))
    assert [joint.name for joint in scene.joints] == ["root_joint", "to_one", "to_two"]
    assert scene.bodies[1].center_of_mass == (0.0, 0.0, -0.4)  # type: ignore[attr-defined]
    with says(SceneError, "rods.xacro: xacro cannot expand it", "nothing.xacro"):
        text = XACRO.replace("<link", '<xacro:include filename="nothing.xacro"/><link', 1)
        load_robot(file_of(tmp_path, "rods.xacro", text))


@pytest.mark.parametrize(("name", "is_read"), [("below/sizes.yaml", True), ("../sizes.yaml", False)])
def test_xacro_reads_yaml_below_its_folder(tmp_path: Path, name: str, is_read: bool) -> None:
    pytest.importorskip("xacro", reason="xacro files need the package xacro: '.[xacro]'")
    (tmp_path / "robot" / "below").mkdir(parents=True)
    file_of(tmp_path / "robot", name, "L: 0.8")
    text = XACRO.replace("${2 * 0.4}", f"${{xacro.load_yaml('{name}')['L']}}")
    file = file_of(tmp_path / "robot", "rods.urdf.xacro", text)
    if is_read:
        assert load_robot(file)[0].bodies[1].center_of_mass == (0.0, 0.0, -0.4)  # type: ignore[attr-defined]
        return
    with says(SceneError, "rods.urdf.xacro: xacro cannot expand it: load_yaml reads files below", name):
        load_robot(file)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('<link name="${9**9**9}"/>', "did not end as it should"),
        ("<link name=\"${'a'*10**10}\"/>", "xacro cannot expand it"),
    ],
)
def test_xacro_that_asks_for_all_time_and_memory(
    text: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro", reason="xacro files need the package xacro: '.[xacro]'")
    monkeypatch.setattr("mbdlft.robot.load._SECONDS", 1)
    with says(SceneError, "rods.xacro: ", why):
        load_robot(file_of(tmp_path, "rods.xacro", XACRO.replace("<link", f"{text}<link", 1)))


class Counted(str):
    """A name that counts how often it is compared."""

    compared = 0
    __hash__ = str.__hash__

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)


def test_loops_are_looked_for_in_linear_time() -> None:
    """2,000 links in a row, the last one first: each is compared a few times, not with all before it."""
    names = [Counted(f"link{k}") for k in range(2000)]
    links = {name: RobotLink(name, 0, inertial=True) for name in reversed(names)}
    ends = ((Counted(a), Counted(b)) for a, b in pairwise(names))
    joints = [RobotJoint(f"to_{b}", 0, "fixed", a, b) for a, b in ends]
    Counted.compared = 0
    assert root_of(links, joints) == "link0"
    assert Counted.compared < 20 * len(names)


def test_expressions_of_other_files_are_not_evaluated(tmp_path: Path) -> None:
    with says(SceneError, "rods.urdf: line 2: got <xacro:property>. This is a xacro file"):
        load_robot(file_of(tmp_path, "rods.urdf"))
