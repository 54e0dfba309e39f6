"""Mutated SDF and MJCF files: a scene, or an error of the package."""

from pathlib import Path

import numpy as np

from mbdlft import MbdlftError
from mbdlft.robot import load_robot
from tests.attack.mutations import changed, check_message, damaged

SDF = """<?xml version="1.0"?>
<sdf version="1.9"><world name="w"><gravity>0 0 -9.8</gravity>
<model name="robot" canonical_link="base"><pose>0 0 1 0 0 0</pose>
  <frame name="tool" attached_to="arm"><pose degrees="true">0 0 1 90 0 0</pose></frame>
  <link name="base"><inertial><pose>0 0 0.1 0 0.2 0</pose><mass>3</mass>
    <inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link>
  <link name="arm"><pose relative_to="shoulder">0 0 0 0 0.1 0</pose><gravity>0</gravity>
    <inertial><mass>1</mass></inertial>
    <sensor name="imu" type="imu"><pose>0 0 1 1 0 0</pose></sensor></link>
  <link name="rod"><pose relative_to="arm" rotation_format="quat_xyzw">0 0 1 0 0 0.6 0.8</pose></link>
  <joint name="shoulder" type="revolute"><pose relative_to="base">0 0.2 0 0 0 0</pose>
    <parent>base</parent><child>arm</child><axis><xyz expressed_in="__model__">0 1 0</xyz>
    <limit><lower>-1</lower><upper>inf</upper><effort>0</effort></limit>
    <dynamics><damping>0.1</damping><spring_stiffness>2</spring_stiffness></dynamics></axis></joint>
  <joint name="slide" type="prismatic"><parent>arm</parent><child>rod</child>
    <axis><xyz>1 0 0</xyz><mimic joint="shoulder"><multiplier>2</multiplier></mimic></axis></joint>
  <model name="sub"><link name="a"/><link name="b"><pose>1 0 0 0 0 0</pose></link>
    <joint name="j" type="ball"><parent>a</parent><child>b</child></joint></model>
  <joint name="weld" type="fixed"><parent>rod</parent><child>sub::a</child></joint>
  <joint name="loop" type="ball"><parent>base</parent><child>sub::b</child></joint>
</model></world></sdf>
"""
MJCF = """<mujoco model="robot"><compiler angle="radian" autolimits="true"/>
<option gravity="0 0 -9.81"/><default><joint damping="0.1" armature="0.01"/></default>
<worldbody><body name="base" pos="0 0 1" quat="1 0 0.1 0"><freejoint name="free"/>
  <geom type="box" size="0.1 0.2 0.1" mass="2"/><site name="s" pos="0 0 0.1"/>
  <body name="arm" pos="0 0.3 0"><joint name="j" axis="0 1 0" range="-1 1" stiffness="2"/>
    <joint name="k" type="slide" axis="1 0 0" ref="0.1"/><geom size="0.1" pos="0 0 0.3"/>
    <body name="ball" pos="0 0 0.5"><joint name="b" type="ball"/><geom size="0.1" pos="0 0 0.2"/></body>
  </body></body>
  <body name="other" pos="1 0 1"><joint name="o" axis="1 0 0"/><geom size="0.1" pos="0 0 0.3"/></body>
</worldbody>
<equality><joint joint1="k" joint2="j" polycoef="0 0.5 0 0 0"/></equality>
<tendon><fixed name="t"><joint joint="j" coef="1"/><joint joint="o" coef="2"/></fixed></tendon>
<actuator><position joint="j" kp="10" kv="1"/><motor site="s" gear="0 0 1 0 0 0.1"/>
  <motor tendon="t"/></actuator>
<sensor><gyro site="s"/><jointvel joint="j"/><tendonpos tendon="t"/></sensor>
<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.1 0.2 1 0 0 0 0.3"/></keyframe></mujoco>
"""


def attack(seed: int, folder: Path) -> str:
    """Mutate a robot as text and as bytes, and load it."""
    random = np.random.default_rng(seed)
    base, ending = (SDF, "sdf") if random.random() < 0.6 else (MJCF, "xml")
    data = (changed(base, random) if random.random() < 0.9 else base).encode("utf-8", "replace")
    if random.random() < 0.2:
        data = damaged(data, random)
    file = folder / f"robot.{ending}"
    file.write_bytes(data)
    try:
        load_robot(file)
    except MbdlftError as error:
        check_message(error)
        return "refused"
    return "loaded"
