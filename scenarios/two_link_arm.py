"""The two-link arm of two_link_arm.toml, built in Python; then a batch of trims and linearizations.

Run it: python scenarios/two_link_arm.py
"""

import numpy as np

from mbdlft import (
    Angle,
    Constant,
    Fixed,
    Inertia,
    Parameter,
    PointMass,
    Revolute,
    RigidBody,
    Scene,
    frequency_response,
    grid,
    matrices_at,
    to_lft,
    trim_at,
)


def scene() -> Scene:
    """The arm of Kassarian et al. 2023, table I; theta1 is from the horizontal, theta2 from link 1."""
    return Scene(
        name="two_link_arm",
        description="Two-link robotic arm with a load at its tip, scheduled on both joint angles",
        gravity=(0.0, 0.0, -9.81),
        constants={"L1": Constant(value=1.0, unit="m")},
        parameters=[
            Parameter("m1", 3.0, percent=20, unit="kg"),
            Parameter("J1", 0.2, percent=20, unit="kg m^2"),
            Parameter("rho1", 0.3, percent=20),
            Parameter("m3", 5.0, percent=20, unit="kg"),
            Parameter("L2", 1.0, percent=20, unit="m"),
            Angle("theta1", 70.0, 45.0, 90.0),
            Angle("theta2", 90.0, 45.0, 135.0),
        ],
        bodies=[
            RigidBody(
                name="link1",
                mass="m1",
                center_of_mass=(0, "rho1*L1", 0),
                inertia=Inertia(xx="J1"),
                ports={"tip": (0, "L1", 0)},
            ),
            RigidBody(
                name="link2",
                mass=2.0,
                center_of_mass=(0, "0.5*L2", 0),
                inertia=Inertia(xx=0.1),
                ports={"tip": (0, "L2", 0)},
            ),
            PointMass(name="load", mass="m3"),
        ],
        joints=[
            Revolute(
                name="shoulder",
                parent="ground",
                child="link1",
                axis=(1, 0, 0),
                position="theta1",
                stiffness=0.1,
                damping=0.1,
            ),
            Revolute(
                name="elbow",
                parent="link1.tip",
                child="link2",
                axis=(1, 0, 0),
                position="theta2",
                stiffness=0.1,
                damping=0.1,
            ),
            Fixed(name="grip", parent="link2.tip", child="load"),
        ],
        inputs=["shoulder.torque", "elbow.torque"],
        outputs=["shoulder.angle", "elbow.angle"],
    )


def main() -> None:
    """Linearize once, then read the trim and the response off the model on a grid of angles."""
    model = to_lft(scene())
    points = grid(model.parameters, {"theta1": 4, "theta2": 3})
    torques = trim_at(model, points)
    response = frequency_response(model, points, [10.0])
    stable = np.linalg.eigvals(matrices_at(model, points).A).real.max(axis=1) < 0
    print("theta1 (deg)  theta2 (deg)  shoulder (N m)  elbow (N m)  |G11(10j)| (rad/N m)  stable")
    for k in range(len(stable)):
        print(
            f"{points['theta1'][k]:12.1f}  {points['theta2'][k]:12.1f}  {torques[k, 0]:14.4f}  "
            f"{torques[k, 1]:11.4f}  {abs(response[k, 0, 0, 0]):20.6f}  {stable[k]}"
        )


if __name__ == "__main__":
    main()
