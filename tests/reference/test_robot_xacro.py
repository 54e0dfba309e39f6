"""URDF files that are written in xacro: they are expanded where their name says that they are."""

from pathlib import Path

import pytest

from mbdlft import SceneError, load_robot
from tests.errors.scenes import says

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


def test_expressions_of_other_files_are_not_evaluated(tmp_path: Path) -> None:
    with says(SceneError, "rods.urdf: line 2: got <xacro:property>. This is a xacro file"):
        load_robot(file_of(tmp_path, "rods.urdf"))
