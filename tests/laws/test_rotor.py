"""A geared rotor that is carried around, against Lagrange's equations with the velocities by hand.

The frame turns with W about z, a gimbal tilts the body by g about x, and a geared joint on an axis e
of the body turns an arm by q. In the axes of the body and of the arm the angular velocities are

    w_B = [g' ; W sin g ; W cos g],     w_C = R(e, q)' w_B + e q',     rotor: e.w_B + n q'

The rotor has no mass: T = 1/2 w_B.I_B w_B + 1/2 w_C.I_C w_C + 1/2 J (e.w_B + n q')^2.
"""

import casadi as ca
import numpy as np

import mbdlft
from mbdlft import Angle, Inertia, Parameter, Revolute, RigidBody, Scene, Spin
from tests.close import CLOSED_FORM, target

AXIS = np.array([0.0, 0.6, 0.8])
BODY, ARM = (2.0, 3.0, 2.5), (0.4, 0.7, 0.9)
TURN = 0.6  # rad, of the arm


def scene() -> Scene:
    def body(name: str, moments: tuple[float, ...]) -> RigidBody:
        inertia = Inertia(**dict(zip(("xx", "yy", "zz"), moments, strict=True)))
        return RigidBody(name=name, mass=1.0, inertia=inertia)

    return Scene(
        name="rotor",
        spin=Spin(axis=(0, 0, 1), rate="W"),
        parameters=[
            Parameter("W", 2.0, low=0.5, high=4.0, unit="rad/s"),
            Parameter("n", -20.0, low=-30.0, high=-10.0),
            Parameter("J", 0.01, percent=40, unit="kg m^2"),
            Angle("g", 20.0, low=-40.0, high=60.0),
        ],
        bodies=[body("body", BODY), body("arm", ARM)],
        joints=[
            Revolute(name="gimbal", parent="ground", child="body", axis=(1, 0, 0), position="g"),
            Revolute(
                name="gear",
                parent="body",
                child="arm",
                axis=tuple(AXIS),
                position=TURN,
                actuator_inertia="J",
                gear_ratio="n",
            ),
        ],
    )


def lagrange() -> ca.Function:
    """M, D, K (2, 2) of the displacements and the efforts (2,), of (W, n, J, g)."""
    W, n, J, g0 = p = [ca.SX.sym(name) for name in ("W", "n", "J", "g")]
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    g, turn = g0 + q[0], TURN + q[1]
    body = ca.vertcat(v[0], W * ca.sin(g), W * ca.cos(g))
    across = ca.skew(ca.DM(AXIS))
    turned = ca.SX.eye(3) + ca.sin(turn) * across + (1 - ca.cos(turn)) * across @ across
    arm = turned.T @ body + AXIS * v[1]
    rotor = ca.dot(AXIS, body) + n * v[1]
    energy = (ca.dot(body, ca.DM(BODY) * body) + ca.dot(arm, ca.DM(ARM) * arm) + J * rotor**2) / 2
    momentum, force = ca.gradient(energy, v), ca.gradient(energy, q)
    cross = ca.jacobian(momentum, q)
    parts = [ca.jacobian(momentum, v), cross - cross.T, -ca.jacobian(force, q), -force]
    at_rest = [ca.substitute(part, ca.vertcat(q, v), ca.DM.zeros(4)) for part in parts]
    return ca.Function("lagrange", p, at_rest)


def test_rotor_that_is_carried_around_is_that_of_lagrange() -> None:
    model = mbdlft.to_lft(scene(), search=0.0)
    inside, outer = mbdlft.random(model.parameters, 50), mbdlft.corners(model.parameters)
    values = {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}
    A, B, _, _ = mbdlft.matrices_at(model, values)
    trim = mbdlft.trim_at(model, values)
    by_hand = lagrange()
    for k in range(len(A)):
        W, n, J, g = (float(values[name][k]) for name in ("W", "n", "J", "g"))
        M, D, K, effort = (np.array(part) for part in by_hand(W, n, J, np.radians(g)))
        expected = np.linalg.solve(M, np.hstack([-K, -D, np.eye(2)]))
        target(np.hstack([A[k], B[k]])[2:], expected, CLOSED_FORM)
        target(trim[k], effort.ravel(), CLOSED_FORM)
