"""Errors of SDF and MJCF files: what is wrong, where, and what to try."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from mbdlft import SceneError, load_robot, to_lft
from tests.errors.table import refused, says

NEEDS_MUJOCO = pytest.mark.skipif(find_spec("mujoco") is None, reason="MJCF needs mujoco")
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


MJCF = """<mujoco model="one"><worldbody>
  <body name="a"><joint name="j" axis="0 1 0"/><geom size=".1" pos="0 0 .3"/></body>
</worldbody></mujoco>
"""
FREE = '<body name="f"><joint name="free" type="free" armature="1"/><geom size=".1"/></body>'
TENDONS = (
    '<body name="b"><joint name="k"/><geom size=".1" pos="0 0 .3"/><site name="p"/><site name="q" '
    'pos="1 0 0"/></body></worldbody><tendon><fixed name="t" {}><joint joint="j" coef="1"/><joint joint='
    '"k" coef="{}"/></fixed><spatial name="s"><site site="p"/><site site="q"/></spatial></tendon>'
    '<equality><tendon name="e" tendon1="{}" polycoef="{}"/></equality>'
)


@pytest.fixture
def changed(tmp_path: Path) -> Callable[..., Path]:
    """A file of a text with the first `old` replaced."""

    def write(text: str, old: str = "", new: str = "") -> Path:
        assert old in text
        file = tmp_path / f"robot.{'sdf' if text is SDF else 'xml'}"
        file.write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
        return file

    return write


BOMB = '<!DOCTYPE s [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True)
) + "]>"  # fmt: skip
DEEP = '<sdf version="1.9">{}</sdf>'
BESIDE = SDF.replace('name="two">', 'name="three">').replace(
    "</model>", '</model><model name="c"><link name="d"/></model><model name="two"/>'
)
KEYED = MJCF.replace("</mujoco>", '<keyframe><key name="up" qpos="1"/></keyframe></mujoco>')
test_messages = refused(
    r"""
> load_robot(changed(SDF, {})) => SceneError:
'"1.9"', '"2.0"' => line 1: <sdf>, version: expected 1.3 to 1.12, got '2.0'.
'relative_to="a"', 'relative_to="aa"' => line 4: link 'b': unknown frame 'aa' … 'a'?
'relative_to="a"', 'relative_to="b"' => line 4: the poses of b are relative to each other.
'0 0 1 0 0 0', '0 0 1 0 0' => line 4: link 'b': <pose>: expected 6 finite numbers
'0 0 1 0 0 0', '0 0 1 0 0 inf' => <pose>: expected 6 finite numbers
'>0 0 1 0 0 0', ' rotation_format="quat_xyzw">0 0 1 0 0 0 0'
    => line 4: link 'b': <pose>: the quaternion 0 0 0 0 is no rotation
'0 0 1 0 0 0', "1e308 0 0 0 0 0</pose></link><link name='c'><pose relative_to='b'>1e308 0 0 0 0 0"
    => 'c' is too far away to be computed with.
'name="b"', 'name="j"' => the name 'j' is given twice; first in line 4.
'name="b"', 'name="world"' => line 4: the name 'world' means the world
'"revolute"', '"screw"' => line 5: joint 'j': joints of the type 'screw' are not read.
'"revolute"', '"revolut"' => joint 'j': unknown type 'revolut'. Did you mean 'revolute'?
'<parent>a<', '<parent>c<' => line 5: joint 'j', parent: unknown link 'c'.
'<parent>a<', '<parent>b<' => line 5: joint 'j': its parent and its child are 'b'.
'<parent>a</parent>', '' => joint 'j': <parent> is missing.
'<child>b<', '<child>world<' => joint 'j': <child>: the world is a parent only.
'0 1 0<', '0 0 0<' => line 7: joint 'j': the axis has zero length.
'<axis>', '<axs>' => line 7: not valid XML: mismatched tag.
'<mass>1<', '<mass>nan<' => inertial of link 'a': <mass>: expected a finite number
'<inertial>', '<inertial auto="true">' => line 3: inertial of link 'a': auto = 'true'
'<model name', "<model placement_frame='a' name" => placement_frame is not read
'</model>', '<include><uri>x</uri></include></model>' => line 9 … <include> is not read
'</model>', '<joint name="k" type="prismatic"><parent>b</parent><child>a</child><axis/></joint></model>'
    => line 9: joint 'k' closes a loop; expected a hinge, a ball or a fixed joint
'0 1 0</xyz>', '0 1 0</xyz><mimic/>' => <mimic>: the attribute 'joint' is missing.
> load_robot(changed(SDF), {}) => SceneError:
keyframe="home" => keyframe = 'home': only an MJCF file has this, got <sdf>.
model="too" => model: unknown model 'too'. Did you mean 'two'?
base="loose" => base: expected 'fixed' or 'free', got 'loose'.
> load_robot(changed({})) => SceneError: robot.xml: …
BOMB + SDF.replace("<model", "<x>&j;</x><model", 1).replace("0 1 0", "&j;") => line
BOMB + MJCF.replace("0 1 0", "&j;") => line
DEEP.format('<model name="m">' * 3000 + "</model>" * 3000) => hundreds of times
DEEP.format('<model name="m"><link name="l0"/>' + "".join(f'<link name="l{k}"><pose
    relative_to="l{k + 1}"/></link>' for k in range(1, 3000)) + '<link name="l3000"/></model>')
    => hundreds of times
"""
)
test_messages_of_mjcf = NEEDS_MUJOCO(
    refused(
        r"""
> to_lft(load_robot(changed(MJCF, {}))[0]) => SceneError:
'</worldbody>', TENDONS.format("", 1, "t", "1 0 0 0 0")
    => coupling 'e': the declared positions … make 0 rad … the offset is 1.
> load_robot(changed(MJCF, {})) => SceneError:
'</mujoco>', "<equality><joint joint1='j' polycoef='0 1 2 0 0'/></equality></mujoco>"
    => equality 'equality_0' of joint 'j': expected a linear coupling of two joints
'</worldbody>', TENDONS.format("", 1, "t", "0 1 2 0 0")
    => equality 'e' of tendon 't': expected a linear
'</worldbody>', TENDONS.format("", 0, "t", "0 1 0 0 0")
    => equality 'e' of tendon 't': expected two or more joints, got j.
'</worldbody>', TENDONS.format("", 1, "s", "0 1 0 0 0")
    => equality 'e' of tendon 's': expected fixed tendons, got one along a path
'</worldbody>', TENDONS.format('stiffness="2" springlength="0 1"', 1, "t", "0 0 0 0 0")
    => tendon 't': its length 0 is the end of its range of slack lengths [0, 1], where its stiffness jumps
'</worldbody>', TENDONS.format('stiffness="2 1"', 1, "t", "0 0 0 0 0")
    => tendon 't' has a nonlinear spring.
'</worldbody>', FREE + '</worldbody>' => the free joint 'free' has an armature, 1:
'axis="0 1 0"/>', 'axis="0 1 0" stiffness="1 2"/>' => joint 'j' has a nonlinear spring.
'</worldbody>', '</worldbody><actuator><position joint="j" gear="1e308"/></actuator>'
    => actuator 'actuator_0': with its gear of 1e+308 it adds what is not finite.
'size=".1"', 'size="nan"' => mujoco cannot compile it
'<body name="a">', '<body name="a"><joint name="j"/>' => mujoco cannot compile it … repeated
'<body name="a">', '<body name="a" quat="1e200 0 0 0">' => the quaternion 0 0 0 0 is no rotation
'<worldbody>', '<include file="a.xml"/><worldbody>' => cannot compile it … a.xml
'<worldbody>', '<worldbody><replicate count="100000"><geom size="1"/></replicate>'
    => line 1: <replicate> asks for 100000 copies, expected at most 10000.
> load_robot({}) => SceneError:
changed(KEYED), keyframe="pu" => keyframe: unknown keyframe 'pu'. Did you mean 'up'?
changed(MJCF), base="free" => base: nothing is clamped on the ground or free: the root moves on j.
"""
    )
)


def test_the_named_model_has_no_links(changed: Callable[..., Path]) -> None:
    with says(SceneError, "has no links"):
        load_robot(changed(BESIDE), model="two")


@NEEDS_MUJOCO
def test_keyframe(changed: Callable[..., Path]) -> None:
    assert load_robot(changed(KEYED), keyframe="up")[0].joints[0].position == 1.0  # type: ignore[attr-defined]
