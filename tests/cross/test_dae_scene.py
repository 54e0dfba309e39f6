"""Equations and a scene in one loop."""

import control
import numpy as np

import mbdlft
from mbdlft.base import Parameter
from mbdlft.dae import DaeDraft
from mbdlft.pipeline import linearize_dae
from tests.close import MECHANISM, exact, target


def test_a_motor_of_equations_drives_a_scene() -> None:
    """The scene's joint and the motor's shaft share an uncertain inertia's parameter and a signal."""
    arm = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    shared = arm.parameters["m1"]
    d = DaeDraft("motor")
    m1, R = d.parameter(shared), d.parameter(Parameter("R", 0.5, percent=20, unit="Ohm"))
    v, i, torque = d.input("v", "V"), d.variable("i", "A"), d.variable("torque", "N m")
    d.equation(d.number(0.01) * d.der(i), "winding", equals=v - R * i)
    # a brake resistance in proportion to the mass that is moved
    d.equation(torque, "gear", equals=2 * i * (1 + m1 / d.number(10.0)))
    d.output("torque")
    motor = linearize_dae(d.dae())
    both = mbdlft.connect(
        [arm, motor],
        [["shoulder.torque", "torque"]],
        inputs=["v", "elbow.torque"],
        outputs=["shoulder.angle"],
    )
    exact(both.parameters.names, sorted({*arm.parameters.names, "R"}))
    values = {"m1": 1.1 * shared.nominal, "R": 0.55}
    found = both.at(**values)
    parts = arm.at(m1=values["m1"]), motor.at(**values)
    assert isinstance(found, control.StateSpace)
    for w in (0.5, 5.0):
        expected = parts[0](1j * w)[0, 0] * np.ravel(parts[1](1j * w))[0]
        target(found(1j * w)[0, 0], expected, MECHANISM)
