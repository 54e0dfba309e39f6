"""Errors of SDF and MJCF files: what is wrong, where, and what to try."""

from pathlib import Path

import pytest

from mbdlft import SceneError, load_robot
from tests.errors.table import says

pytestmark = pytest.mark.usefixtures("read_here")

SDF = """<sdf version="1.9">
<model name="two">
  <link name="a"><inertial><mass>1</mass></inertial></link>
  <link name="b"><pose relative_to="a">0 0 1 0 0 0</pose></link>
  <joint name="j" type="revolute">
    <parent>a</parent><child>b</child>
    <axis><xyz>0 1 0</xyz><dynamics><damping>0.1</damping></dynamics></axis>
  </joint>
</model></sdf>
"""


@pytest.mark.parametrize(
    ("old", "new", "texts"),
    [
        ('"1.9"', '"2.0"', ["line 1: <sdf>, version: expected 1.3 to 1.12, got '2.0'."]),
        ('relative_to="a"', 'relative_to="aa"', ["line 4: link 'b': unknown frame 'aa'", "'a'?"]),
        ('relative_to="a"', 'relative_to="b"', ["line 4: the poses of b are relative to each other."]),
        ("0 0 1 0 0 0", "0 0 1 0 0", ["line 4: link 'b': <pose>: expected 6 finite numbers"]),
        ("0 0 1 0 0 0", "0 0 1 0 0 inf", ["<pose>: expected 6 finite numbers"]),
        (">0 0 1 0 0 0", ' rotation_format="quat_xyzw">0 0 1 0 0 0 0',
         ["line 4: link 'b': <pose>: the quaternion 0 0 0 0 is no rotation"]),
        ("0 0 1 0 0 0",
         "1e308 0 0 0 0 0</pose></link><link name='c'><pose relative_to='b'>1e308 0 0 0 0 0",
         ["'c' is too far away to be computed with."]),
        ('name="b"', 'name="j"', ["the name 'j' is given twice; first in line 4."]),
        ('name="b"', 'name="world"', ["line 4: the name 'world' means the world"]),
        ('"revolute"', '"screw"', ["line 5: joint 'j': joints of the type 'screw' are not read."]),
        ('"revolute"', '"revolut"', ["joint 'j': unknown type 'revolut'. Did you mean 'revolute'?"]),
        ("<parent>a<", "<parent>c<", ["line 5: joint 'j', parent: unknown link 'c'."]),
        ("<parent>a</parent>", "", ["joint 'j': <parent> is missing."]),
        ("<child>b<", "<child>world<", ["joint 'j': <child>: the world is a parent only."]),
        ("0 1 0<", "0 0 0<", ["line 7: joint 'j': the axis has zero length."]),
        ("<axis>", "<axs>", ["line 7: not valid XML: mismatched tag."]),
        ("<mass>1<", "<mass>nan<", ["inertial of link 'a': <mass>: expected a finite number"]),
        ("<inertial>", '<inertial auto="true">', ["line 3: inertial of link 'a': auto = 'true'"]),
        ("<model name", "<model placement_frame='a' name", ["placement_frame is not read"]),
        ("</model>", "<include><uri>x</uri></include></model>", ["line 9", "<include> is not read"]),
        (
            "</model>",
            '<joint name="k" type="prismatic"><parent>b</parent><child>a</child><axis/></joint></model>',
            ["line 9: joint 'k' closes a loop; expected a hinge, a ball or a fixed joint"],
        ),
        (
            "</model>",
            '</model><model name="c"><link name="d"/></model><model name="two"/>',
            ["has no links"],
        ),
        ("0 1 0</xyz>", '0 1 0</xyz><mimic/>', ["<mimic>: the attribute 'joint' is missing."]),
    ],
)  # fmt: skip
def test_sdf(tmp_path: Path, old: str, new: str, texts: list[str]) -> None:
    assert old in SDF
    file = tmp_path / "two.sdf"
    file.write_text(SDF.replace(old, new, 1), encoding="utf-8")
    options = {"model": "two"} if new.endswith('name="two"/>') else {}
    if options:
        file.write_text(file.read_text().replace('name="two">', 'name="three">', 1), encoding="utf-8")
    with says(SceneError, *texts):
        load_robot(file, **options)


MJCF = """<mujoco model="one"><worldbody>
  <body name="a"><joint name="j" axis="0 1 0"/><geom size=".1" pos="0 0 .3"/></body>
</worldbody></mujoco>
"""
FREE = '<body name="f"><joint name="free" type="free" armature="1"/><geom size=".1"/></body>'


@pytest.mark.parametrize(
    ("old", "new", "texts"),
    [
        ("</mujoco>", "<equality><joint joint1='j' polycoef='0 1 2 0 0'/></equality></mujoco>",
         ["equality 'equality_0' of joint 'j': expected a linear coupling of two joints"]),
        ("</worldbody>", FREE + "</worldbody>", ["the free joint 'free' has an armature, 1:"]),
        ('axis="0 1 0"/>', 'axis="0 1 0" stiffness="1 2"/>', ["joint 'j' has a nonlinear spring."]),
        ('size=".1"', 'size="nan"', ["mujoco cannot compile it"]),
        ('<body name="a">', '<body name="a"><joint name="j"/>', ["mujoco cannot compile it", "repeated"]),
        ('<body name="a">', '<body name="a" quat="1e200 0 0 0">',
         ["the quaternion 0 0 0 0 is no rotation"]),
        ("<worldbody>", '<include file="a.xml"/><worldbody>', ["cannot compile it", "a.xml"]),
        ("<worldbody>", '<worldbody><replicate count="100000"><geom size="1"/></replicate>',
         ["line 1: <replicate> asks for 100000 copies, expected at most 10000."]),
    ],
)  # fmt: skip
def test_mjcf(tmp_path: Path, old: str, new: str, texts: list[str]) -> None:
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    assert old in MJCF
    file = tmp_path / "one.xml"
    file.write_text(MJCF.replace(old, new, 1), encoding="utf-8")
    with says(SceneError, *texts):
        load_robot(file)


def test_options_of_other_formats(tmp_path: Path) -> None:
    file = tmp_path / "two.sdf"
    file.write_text(SDF, encoding="utf-8")
    with says(SceneError, "keyframe = 'home': only an MJCF file has this, got <sdf>."):
        load_robot(file, keyframe="home")
    with says(SceneError, "model: unknown model 'too'. Did you mean 'two'?"):
        load_robot(file, model="too")
    with says(SceneError, "base: expected 'fixed' or 'free', got 'loose'."):
        load_robot(file, base="loose")  # type: ignore[arg-type]


def test_unknown_keyframe(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    file = tmp_path / "one.xml"
    text = MJCF.replace("</mujoco>", '<keyframe><key name="up" qpos="1"/></keyframe></mujoco>')
    file.write_text(text, encoding="utf-8")
    assert load_robot(file, keyframe="up")[0].joints[0].position == 1.0  # type: ignore[attr-defined]
    with says(SceneError, "keyframe: unknown keyframe 'pu'. Did you mean 'up'?"):
        load_robot(file, keyframe="pu")


def test_base_that_moves_on_its_own_joint(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    file = tmp_path / "one.xml"
    file.write_text(MJCF, encoding="utf-8")
    with says(SceneError, "base: nothing is clamped on the ground or free: the root moves on j."):
        load_robot(file, base="free")


BOMB = '<!DOCTYPE s [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True)
) + "]>"  # fmt: skip


@pytest.mark.parametrize("text", [SDF.replace("<model", "<x>&j;</x><model", 1), MJCF])
def test_entities_do_not_grow(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bomb.xml"
    file.write_text(BOMB + text.replace("0 1 0", "&j;"), encoding="utf-8")
    with says(SceneError, "bomb.xml: line "):
        load_robot(file)


@pytest.mark.parametrize(
    "text",
    [
        '<model name="m">' * 3000 + "</model>" * 3000,
        '<model name="m"><link name="l0"/>'
        + "".join(f'<link name="l{k}"><pose relative_to="l{k + 1}"/></link>' for k in range(1, 3000))
        + '<link name="l3000"/></model>',
    ],
)
def test_deep_sdf(tmp_path: Path, text: str) -> None:
    file = tmp_path / "deep.sdf"
    file.write_text(f'<sdf version="1.9">{text}</sdf>', encoding="utf-8")
    with says(SceneError, "deep.sdf: ", "hundreds of times"):
        load_robot(file)
