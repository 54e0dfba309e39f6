"""Errors of URDF files and of what is asked of them: the line, what is wrong, what to try."""

import re

from mbdlft import Angle, Parameter, load_robot
from tests.errors.robots import ROBOT, written
from tests.errors.table import refused

FIXED = '<joint name="weld" type="fixed"><parent link="{}"/><child link="{}"/></joint></robot>'

ROUND = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
# fingers that turn
TURNING = re.sub('("finger"|"other") type="prismatic"', r'\1 type="continuous"', ROBOT)
TURNING = TURNING.replace('izz="0"', 'izz="0.01"').replace('"0" iyy="0"', '"0.01" iyy="0.01"')


def behind(last: str = "") -> str:
    """A robot of three hinges in a row, and the inertia of its last link."""
    hinge = '<joint name="j{}" type="revolute"><parent link="l{}"/><child link="l{}"/>'
    hinge += '<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    links = "".join(f'<link name="l{k}"/>' + hinge.format(k, k, k + 1) for k in range(3))
    return f'<robot name="r">{links}<link name="l3">{last}</link></robot>'


test_messages = refused(
    r"""
load_robot(written(tmp_path, 'name="swing" type="revolute"', 'name="swing" type="floating"'),
    moving=['slide'])
    => moving: the floating joint 'swing' cannot be locked … fixed joint
> (lambda old, new: load_robot(written(tmp_path, old, new)))({}) => SceneError:
"</link>", "</lnk>" => /crane.urdf … line 18: not valid XML: mismatched tag.
ROBOT, "" => line 1: not valid XML: no element found.
"robot", "sdf" => not valid XML
ROBOT, "<svg/>" => line 1: expected a robot … <robot> (URDF), <sdf> … got <svg>.
ROBOT, '<robot name="r"/>' => line 1: the robot has no links.
ROBOT, '<robot xmlns:xacro="http://x"/>'
    => no links. This is a xacro file … xacro robot.urdf.xacro > robot.urdf
'<link name="rail"/>', '<xacro:rail length="2"/>'
    => line 3: got <xacro:rail>. This is a xacro file … Expand it first
'value="4"', 'value="${m}"' => <mass>, value: expected a finite number, got '${m}' … xacro
'value="4"', 'value="nan"' => line 14: inertial of link 'carriage': <mass>, value: expected
'value="4"', 'value="1_0"' => <mass>, value: expected a finite number, got '1_0'
'value="4"', 'value="\u0661"' => <mass>, value: expected a finite number
'value="4"', 'val="4"' => line 14 … <mass>, value: is missing; expected a finite number.
'<mass value="4"/>', "" => line 13: inertial of link 'carriage': <mass> is missing.
'value="4"', 'value="-4"' => crane.urdf: body 'carriage': mass [kg] is negative: -4.
'xyz="0 0 2"', 'xyz="0 2"' => line 7: joint 'slide': <origin>, xyz: expected 3 finite numbers
'xyz="0 2 0"', 'xyz="0 0 0"' => line 8: joint 'slide': the axis has zero length.
'lower="-1"', 'lower="5"' => line 9: joint 'slide': the lower limit 5 is above the upper
'type="prismatic"', 'type="screw"'
    => line 4: joint 'slide': unknown type 'screw'. … Existing: continuous, fixed, floating
'<parent link="rail"/>', "" => line 4: joint 'slide': <parent link=...> is missing.
'<parent link="rail"/>', '<parent link="rial"/>'
    => line 4: joint 'slide', parent: unknown link 'rial'. Did you mean 'rail'?
'name="arm"', 'name=""' => a link has no name.
'name="arm"', 'name="rail"' => link 'rail' is given twice; first in line 3.
'name="swing"', 'name="slide"' => joint 'slide' is given twice; first in line 4.
'<mass value="4"/>', '<mass value="4"/><mass value="5"/>'
    => <mass> of inertial is given twice; first in line 14.
"</robot>", FIXED.format("rail", "arm")
    => link 'arm' has two parents … 'swing' and 'weld' … close a loop … remove one
"</robot>", FIXED.format("arm", "rail")
    => the joints close a loop: … rail -> carriage -> arm -> rail … open the loop
"</robot>", '<link name="alone"/></robot>'
    => there are 2 links without a parent: rail, alone. … one root … fixed joint
'ixx="0.1"', 'ixx="0.3"' => body 'carriage': … (triangle inequality): … keep_unphysical=True
'<mimic joint="finger"', '<mimic joint="fingr"'
    => joint 'other', <mimic>: unknown joint 'fingr'. Did you mean 'finger'?
'<mimic joint="finger"', "<mimic" => <mimic>: the attribute 'joint' is missing.
'<mimic joint="finger"', '<mimic joint="other"'
    => joint 'other', <mimic> … the joints other mimic each other
'<joint name="finger" type="prismatic"', '<joint name="finger" type="fixed"'
    => joint 'other', <mimic>: the joint 'finger' is fixed: it has no position to follow.
> load_robot(written(tmp_path), {}) => SceneError:
base="floating" => base: expected 'fixed' or 'free', got 'floating'.
values={"arm.mas": 1.0} => values: unknown label 'arm.mas'. Did you mean 'arm.mass'? … arm.inertia.xx
values={"am.mass": 1.0} => values, 'am.mass': unknown link or joint 'am'. Did you mean 'arm'?
parameters=[Parameter("L", 1.0, percent=10, unit="m")], values={"arm.mass": "L"}
    => body 'arm', mass = 'L': … kg
values={"arm.mass": "m"} => body 'arm', mass = 'm': unknown name 'm'.
vary={"arm.mass.x": 5} => vary: unknown label 'arm.mass.x'. Did you mean 'arm.mass'?
vary={"swing.position": 5}
    => vary, 'swing.position': expected a mass, an inertia or a length … `parameters`
vary={"arm.center_of_mass.x": 5} => that is not zero, got 0.0
vary={"arm.mass": 5}, values={"arm.mass": 2.0}
    => 'arm.mass' is both in vary and in values; give it in one of them.
moving=["swng"] => moving: unknown joint that can move 'swng'. Did you mean 'swing'?
moving="swing" => moving: expected a list of names of joints, got the text 'swing'.
values={"swing.position": 2.0}
    => joint 'swing', position = 2.0: its values [2 rad = 114.592 deg, … leave the limits of the file
        [0.5 rad = 28.6479 deg, 1.5 rad = 85.9437 deg]
parameters=[Angle("a", 40.0, 20.0, 60.0)], values={"swing.position": "a"}
    => joint 'swing', position = 'a': its values [0.349066 rad = 20 deg
parameters=[Parameter("t", 0.5, 0.3, 1.0)], values={"swing.position": "2*atan(t)"}
    => position = '2*atan(t)': its values [0.582914 rad … 1.5708 rad = 90 deg] leave
parameters=[Parameter("s", 0.0, plus=4.0, unit="m")], values={"slide.position": "0.5 + s"}
    => joint 'slide', position = '0.5 + s': its values [-3.5 m, 4.5 m] leave … [-1 m, 3 m]
> load_robot({}) => SceneError:
tmp_path / "missing.urdf" => missing.urdf: cannot be read: No such file or directory.
# a joint moves what lies behind links without mass
written(tmp_path, text=behind()) => joint 'j0' moves nothing that has a mass or an inertia: l1, l2, l3.
written(tmp_path, text=behind(ROUND)) => accepted
> load_robot(written(tmp_path, '<mass value="0.1"/>', '<mass value="0"/>'), {}) => SceneError:
moving=None
    => line 32: joint 'finger' moves nothing that has a mass or an inertia: tip.left. … 'tip.left.mass'
        … 'finger.actuator_inertia' … `moving`
moving=["slide", "swing"] => accepted
values={"finger.actuator_inertia": 0.2} => accepted
parameters=[Parameter("load", 0.5, percent=50, unit="kg")], values={"tip.left.mass": "load"} => accepted
> load_robot(written(tmp_path, text=TURNING), parameters=[Angle("a", 10.0, 5.0, 20.0)], values={}) =>
    NotRationalError: joint 'other', position =
{"finger.position": "a"}
    => '0.5*(a) + 0.01': an angle parameter can be multiplied by an integer … The joint mimics 'finger';
        give 'other.position' a value or a parameter of its own.
{"finger.position": "a", "other.position": 0.0} => accepted
"""
)
