"""SDF and MJCF robots against closed forms: loops whose links have different axes, references, sites."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, target

pytestmark = pytest.mark.usefixtures("read_here")

L, M, G = 0.8, 2.0, 9.81
BAR = "<inertial><mass>{m}</mass><inertia><ixx>0</ixx><iyy>0</iyy><izz>0</izz></inertia></inertial>"


def square(kind: str, tilt: float) -> str:
    """Two bars of length L hang, and a beam between their ends; the second joint of the beam closes it.

    The second bar is written with its axes turned by `tilt` about the hinge axis y and by a quarter about
    its length.
    """
    bar, none = BAR.format(m=M), BAR.format(m=0.0)
    hinge = '<joint name="{n}" type="{k}"><parent>{p}</parent><child>{c}</child><axis>{a}</axis></joint>'
    along = '<xyz expressed_in="__model__">0 1 0</xyz>'
    return f"""<sdf version="1.9"><model name="square">
      <link name="left">{none}</link>
      <link name="right"><pose>1 0 0 0 {tilt} 1.5707963267948966</pose>{none}</link>
      <link name="beam"><pose>0.5 0 {-L} 0 0.3 0</pose>{bar}</link>
      <joint name="a" type="revolute"><parent>world</parent><child>left</child><axis>{along}
        <limit><lower>-9</lower><upper>9</upper></limit></axis></joint>
      {
        hinge.format(
            n="b", k="revolute", p="world", c="right", a=along + "<limit><effort>0</effort></limit>"
        )
    }
      <joint name="c" type="revolute"><pose relative_to="left">0 0 {-L} 0 0 0</pose>
        <parent>left</parent><child>beam</child>
        <axis>{along}<limit><effort>0</effort></limit></axis></joint>
      <joint name="d" type="{kind}"><pose relative_to="__model__">1 0 {-L} 0 0 0</pose>
        <parent>beam</parent><child>right</child><axis>{along}</axis></joint>
    </model></sdf>"""


@pytest.mark.parametrize("kind", ["revolute", "ball"])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_swing_is_a_pendulum(tmp_path: Path, kind: str, tilt: float) -> None:
    """A parallelogram carries its beam like a point mass at the end of one bar: omega^2 = g / L."""
    file = tmp_path / "square.sdf"
    file.write_text(square(kind, tilt), encoding="utf-8")
    scene, _ = mbdlft.load_robot(file, vary={"beam.mass": 20.0})
    assert scene.inputs == ("a.torque",)
    model = mbdlft.to_lft(scene, search=0.0)
    A, B, _, _ = mbdlft.matrices_at(model, {"beam_mass": 2.3})
    target(A, [[0.0, 1.0], [-G / L, 0.0]], CLOSED_FORM)
    target(B[1, 0], 1.0 / (2.3 * L**2), CLOSED_FORM)


SWING = """<mujoco><compiler angle="radian"/><worldbody><body name="a" pos="0 0 2">
  <joint name="j" axis="0 1 0" ref="0.5" range="-1 2" damping="0.1"/>
  <inertial pos="0 0 -0.8" mass="2" diaginertia="1e-9 1e-9 1e-9"/>
  <site name="s" pos="0 0 -0.8" euler="0 0 1.5707963267948966"/></body></worldbody>
  <sensor><accelerometer name="acc" site="s"/></sensor>
  <keyframe><key name="up" qpos="0.9"/></keyframe></mujoco>"""


def test_reference_keyframe_and_axes_of_a_site(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    file = tmp_path / "swing.xml"
    file.write_text(SWING, encoding="utf-8")
    scene, report = mbdlft.load_robot(file, keyframe="up")
    (limit,) = report.limits
    target([limit.lower, limit.upper], [-1.5, 1.5], CLOSED_FORM)
    model = mbdlft.to_lft(scene, search=0.0)
    A, _, C, _ = mbdlft.matrices_at(model, {})
    inertia = M * L**2 + 1e-9
    theta = 0.9 - 0.5  # the body hangs where the joint has its reference
    target(A[1], [-M * G * L * np.cos(theta) / inertia, -0.1 / inertia], CLOSED_FORM)
    outputs = [signal.name for signal in model.outputs]
    x, y = outputs.index("acc.x"), outputs.index("acc.y")
    # the x axis of the body is minus the y axis of the site
    target(C[x], 0.0 * C[x], CLOSED_FORM, scale=1.0)
    assert abs(C[y, 1]) > 0.05


FREE = """<mujoco><worldbody><body name="a" pos="0 0 2"><freejoint name="f"/><geom size=".1"/>
  <body name="b"><joint name="ball" type="ball"/><geom size=".1" pos="0 0 .3"/></body></body>
  </worldbody></mujoco>"""


def test_free_body_can_be_clamped_and_a_ball_locked(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    file = tmp_path / "free.xml"
    file.write_text(FREE, encoding="utf-8")
    scene, report = mbdlft.load_robot(file)
    assert [joint.kind for joint in scene.joints] == ["free", "spherical"]
    assert len(scene.loads) == 6
    assert "hold the free robot" in str(report)
    scene, _ = mbdlft.load_robot(file, base="fixed")
    assert [joint.kind for joint in scene.joints] == ["fixed", "spherical"]
    assert not scene.loads
    scene, _ = mbdlft.load_robot(file, moving=[])
    assert [joint.kind for joint in scene.joints] == ["free", "fixed"]


def test_root_of_sdf_is_free_unless_it_is_static(tmp_path: Path) -> None:
    file = tmp_path / "square.sdf"
    text = square("ball", 0.0).replace("<parent>world</parent>", "<parent>post</parent>")
    post = '<link name="post"/>'
    file.write_text(text.replace('<link name="left">', post + '<link name="left">'))
    scene, report = mbdlft.load_robot(file)
    assert scene.joints[0].kind == "free"
    assert scene.loads[0].name == "hold_force_x"
    assert "links without <inertial> have 1 kg and 1 kg m^2, as SDF says: post" in str(report)
    static = file.read_text().replace("<link", "<static>true</static><link", 1)
    file.write_text(static, encoding="utf-8")
    scene, _ = mbdlft.load_robot(file)
    assert {joint.kind for joint in scene.joints} == {"fixed"}


def test_anchor_is_a_label(tmp_path: Path) -> None:
    """A joint that stands higher in its child hangs the child lower."""
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    file = tmp_path / "swing.xml"
    file.write_text(SWING, encoding="utf-8")
    length = mbdlft.Parameter("h", 0.1, 0.0, 0.3, unit="m")
    scene, _ = mbdlft.load_robot(file, parameters=[length], values={"j.anchor.z": "h"})
    model = mbdlft.to_lft(scene, search=0.0)
    A, _, _, _ = mbdlft.matrices_at(model, {"h": 0.2})
    arm, inertia = L + 0.2, M * (L + 0.2) ** 2 + 1e-9
    target(A[1], [-M * G * arm / inertia, -0.1 / inertia], CLOSED_FORM)
