"""A small robot to break: a rail on the ground, a carriage that slides on it, an arm, a gripper."""

from pathlib import Path

ROBOT = """<?xml version="1.0"?>
<robot name="crane">
  <link name="rail"/>
  <joint name="slide" type="prismatic">
    <parent link="rail"/>
    <child link="carriage"/>
    <origin xyz="0 0 2" rpy="0 0 1.5707963"/>
    <axis xyz="0 2 0"/>
    <limit lower="-1" upper="3" effort="100" velocity="2"/>
    <dynamics damping="0.5" friction="0.1"/>
  </joint>
  <link name="carriage">
    <inertial>
      <mass value="4"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><box size="1 1 1"/></geometry></visual>
  </link>
  <joint name="swing" type="revolute">
    <parent link="carriage"/>
    <child link="arm"/>
    <axis xyz="1 0 0"/>
    <limit lower="0.5" upper="1.5" effort="20" velocity="1"/>
  </joint>
  <link name="arm">
    <inertial>
      <origin xyz="0 0 -0.5" rpy="0.3 0 0"/>
      <mass value="2"/>
      <inertia ixx="0.2" iyy="0.21" izz="0.02" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="finger" type="prismatic">
    <parent link="arm"/>
    <child link="tip.left"/>
    <origin xyz="0 0 -1"/>
    <limit lower="0" upper="0.1" effort="5" velocity="1"/>
  </joint>
  <joint name="other" type="prismatic">
    <parent link="arm"/>
    <child link="tip.right"/>
    <axis xyz="-1 0 0"/>
    <origin xyz="0 0 -1"/>
    <limit lower="0" upper="0.1" effort="5" velocity="1"/>
    <mimic joint="finger" multiplier="0.5" offset="0.01"/>
  </joint>
  <link name="tip.left">
    <inertial>
      <mass value="0.1"/>
      <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="tip.right">
    <inertial>
      <mass value="0.1"/>
      <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <transmission name="drive"/>
</robot>
"""


def written(folder: Path, old: str = "", new: str = "", text: str = ROBOT) -> Path:
    """A file of the robot with the first `old` replaced."""
    assert old in text
    file = folder / "crane.urdf"
    file.write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
    return file
