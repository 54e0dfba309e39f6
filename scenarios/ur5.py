"""The scene of ur5.toml, made from the URDF file of the robot, and the effect of the payload on it.

Run it: python scenarios/ur5.py [ur5_robot.urdf]

Without an argument the file of the package example-robot-data is used (pip install -e '.[robots]').
"""

import sys
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from mbdlft import Angle, Parameter, Scene, grid, load_robot, matrices_at, scene_to_toml, to_lft, trim_at

TOML = Path(__file__).with_name("ur5.toml")
HEADER = """\
# The six-axis industrial robot UR5 with a payload in its hand. The payload, from nothing to the 5 kg that
# the robot may carry, and the angles of shoulder and elbow stay in the model, so that one controller can
# be scheduled on the pose and be robust against the payload; the other four joints are at a usual pose.
# Without control the robot falls out of its pose; how fast, and which torques hold it, all three decide.
#
# Made by scenarios/ur5.py from ur5_robot.urdf of the package ur_description by Wim Meeussen, Kelsey
# Hawkins, Mathias Ludtke and Felix Messmer (ROS-Industrial, universal_robot, BSD license), as distributed
# in example-robot-data (BSD 2-Clause license).
"""


def urdf() -> Path:
    """The file in example-robot-data."""
    folder = "cmeel.prefix/share/example-robot-data/robots/ur_description/urdf"
    return Path(str(distribution("example-robot-data").locate_file(folder))) / "ur5_robot.urdf"


def scene(path: Path) -> Scene:
    """The robot with a payload at its tool, scheduled on two joint angles."""
    robot, report = load_robot(
        path,
        parameters=[
            Parameter("payload", 2.5, 0.0, 5.0, unit="kg"),
            Angle("theta2", -60.0, -90.0, -30.0),
            Angle("theta3", 70.0, 30.0, 110.0),
        ],
        values={
            "tool0.mass": "payload",
            "shoulder_lift_joint.position": "theta2",
            "elbow_joint.position": "theta3",
            "wrist_1_joint.position": "-100*deg",
            "wrist_2_joint.position": "90*deg",
        },
    )
    print(report)
    text = "UR5 robot with a payload, scheduled on the angles of shoulder and elbow; from URDF"
    return robot.model_copy(update={"description": text})


def main() -> None:
    """Write the scene; print the torque of the shoulder, and how fast the robot falls."""
    made = scene(Path(sys.argv[1]) if len(sys.argv) > 1 else urdf())
    TOML.write_text(HEADER + scene_to_toml(made), encoding="utf-8")
    model = to_lft(made)
    points = grid(model.parameters, {"payload": 3, "theta2": 3})
    torques, A = trim_at(model, points), matrices_at(model, points).A
    joints = [signal.name.partition(".")[0] for signal in model.inputs]
    k = joints.index("shoulder_lift_joint")
    print("payload (kg)  theta2 (deg)  shoulder torque (N m)  fastest unstable pole (1/s)")
    for n, payload in enumerate(points["payload"]):
        pole = max(0.0, float(np.max(np.linalg.eigvals(A[n]).real)))
        print(f"{payload:12.2f}  {points['theta2'][n]:12.1f}  {torques[n, k]:21.3f}  {pole:27.3f}")


if __name__ == "__main__":
    main()
