"""A load on an elastic hinge sags to an angle that is not a rational function of mass and stiffness.

Run it: python scenarios/sagging_arm.py
"""

from mbdlft import (
    Parameter,
    PointMass,
    Revolute,
    Scene,
    at_equilibrium,
    eigenvalues_at,
    find_equilibrium,
    fit_positions,
    to_lft,
)


def scene() -> Scene:
    """The scene; its equilibrium is k (theta - 1) + m g L sin(theta) = 0, without load theta = 1 rad."""
    return Scene(
        name="sagging_arm",
        description="Load on an elastic hinge that sags",
        gravity=(0.0, 0.0, -9.81),
        parameters=[
            Parameter("m", 2.0, percent=30, unit="kg"),
            Parameter("k", 20.0, percent=20, unit="N m/rad", role="design"),
        ],
        bodies=[PointMass(name="load", mass="m", ports={"hook": (0, 0, 0.8)})],
        joints=[
            Revolute(
                name="hinge",
                parent="ground",
                child="load.hook",
                axis=(1, 0, 0),
                position=1.0,
                stiffness="k",
                damping=0.1,
                preload=0.0,
            )
        ],
    )


def main() -> None:
    """Print the angle for some loads, then the bound of a fit for all loads, and the model's order."""
    arm = scene()
    for mass in (1.4, 2.0, 2.6):
        point = find_equilibrium(arm, {"m": mass})
        decay = -eigenvalues_at(arm, point)[0].real
        print(f"m = {mass} kg: {point.positions['hinge.angle']:.4f} rad, decays with {decay:.3f} rad/s")
    there = at_equilibrium(arm, find_equilibrium(arm))
    hinge = there.joints[0]
    assert isinstance(hinge, Revolute)
    print(f"the spring's torque at nominal: {hinge.preload}")
    fitted = fit_positions(arm, ["hinge"], tolerance=1e-4)
    model = to_lft(fitted)
    bound = model.certificate.fit_error_bound
    print(f"fit for all m and k: within {bound:.1e} rad, order {model.order}")


if __name__ == "__main__":
    main()
