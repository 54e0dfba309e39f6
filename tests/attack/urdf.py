"""Mutated robots: a scene, or an error of the package."""

from pathlib import Path

import numpy as np

from mbdlft import MbdlftError
from mbdlft.robot import load_robot
from tests.attack.mutations import changed, check_message, damaged

ROBOT = """<?xml version="1.0" encoding="utf-8"?>
<robot name="robot">
  <link name="base"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="3.0"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0 0.1 0" rpy="0 0.1 0"/><mass value="1.0"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.015"/></inertial>
    <visual><geometry><box size="1 2 3"/></geometry></visual></link>
  <link name="finger"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.2" rpy="1.57079632679 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="1.5" effort="10" velocity="2"/>
    <dynamics damping="0.1" friction="0"/></joint>
  <joint name="grip" type="prismatic"><parent link="arm"/><child link="finger"/>
    <origin xyz="0 0.2 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="1" velocity="1"/>
    <mimic joint="shoulder" multiplier="0.1" offset="0"/></joint>
</robot>
"""
ENCODINGS = (
    "utf-8", "latin-1", "utf-16", "utf-16-be", "utf-32", "cp1252", "ascii", "shift_jis", "utf-7", "none"
)  # fmt: skip


def attack(seed: int, folder: Path) -> str:
    """Mutate a robot as text and as bytes, in any encoding, and load it."""
    random = np.random.default_rng(seed)
    text = changed(ROBOT, random) if random.random() < 0.8 else ROBOT
    if random.random() < 0.4:
        declared = ENCODINGS[int(random.integers(len(ENCODINGS)))]
        text = text.replace("utf-8", declared, 1)
    written = ENCODINGS[int(random.integers(len(ENCODINGS) - 1))]
    data = text.encode(written if random.random() < 0.4 else "utf-8", "replace")
    if random.random() < 0.3:
        data = damaged(data, random)
    if random.random() < 0.02:
        data = data.replace(b"<link", b"<link>" * int(random.integers(1, 20000)) + b"<link", 1)
    file = folder / "robot.urdf"
    file.write_bytes(data)
    try:
        load_robot(file)
    except MbdlftError as error:
        check_message(error)
        return "refused"
    return "loaded"
