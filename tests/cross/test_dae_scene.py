"""A pendulum in Cartesian coordinates against the scene of the same one, and both kinds in one loop."""

import control
import numpy as np

import mbdlft
from mbdlft.base import Parameter
from mbdlft.dae import DaeDraft, reduce_index
from mbdlft.pipeline import linearize_dae
from tests.close import CLOSED_FORM, MECHANISM, exact, target
from tests.daes import pendulum


def _scene() -> mbdlft.LFTModel:
    """A point mass below a revolute joint about y."""
    L, m = pendulum().parameters
    scene = mbdlft.Scene(
        name="pendulum",
        gravity=(0.0, 0.0, -9.81),
        parameters=(L, m),
        bodies=(
            mbdlft.PointMass(name="bob", mass="m", ports={"top": (0.0, 0.0, "L")}),
            mbdlft.Ground(name="ground"),
        ),
        joints=(
            mbdlft.Revolute(name="pivot", parent="ground", child="bob.top", axis=(0, 1, 0), position=0.0),
        ),
    )
    return mbdlft.to_lft(scene, search=0.0)


def test_cartesian_pendulum_is_that_of_the_scene() -> None:
    own = linearize_dae(pendulum())
    scene = _scene()
    assert [q.name for q in reduce_index(pendulum()).states] == ["x", "vx"]
    assert own.certificate.minimal
    values = {"L": np.array([1.3, 1.5, 1.7]), "m": np.array([1.7, 2.1, 2.3])}
    A, B, C, _ = mbdlft.matrices_at(own, values)
    T = mbdlft.matrices_at(scene, values)
    for w in (0.3, 2.0, 7.0):
        for k in range(3):
            resolvent = 1j * w * np.eye(2)
            # from a force to x: the angle times L, for a torque of L times the force
            first = C[k] @ np.linalg.solve(resolvent - A[k], B[k])
            length = values["L"][k]
            second = T.C[k][:1] @ np.linalg.solve(resolvent - T.A[k], T.B[k]) * length**2
            target(np.abs(first), np.abs(second), MECHANISM)
    poles = mbdlft.poles(own, values)
    target(np.max(poles.imag, axis=1), np.sqrt(9.81 / values["L"]), CLOSED_FORM)


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
