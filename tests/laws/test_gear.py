"""Laws of geared joints and of the solar array drive, against Lagrange's equations written by hand."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import mbdlft
from tests.close import CLOSED_FORM, target

N = mbdlft.Parameter("n", 60.0, low=40.0, high=90.0)
J = mbdlft.Parameter("J", 2e-4, percent=40, unit="kg m^2")
K = mbdlft.Parameter("k", 900.0, percent=30, unit="N m/rad")
HUB, ARRAY, DAMPING, FRICTION = 7.0, 3.0, 0.4, 0.2


def wheel(name: str, inertia: float) -> mbdlft.RigidBody:
    return mbdlft.RigidBody(name=name, mass=2.0, inertia=mbdlft.Inertia(xx=5.0, yy=5.0, zz=inertia))


def spacecraft() -> mbdlft.Scene:
    """A hub on a free axis, and an array that a drive turns about the same axis."""
    drive = mbdlft.array_drive(
        "drive",
        "hub",
        "array",
        (0, 0, 1),
        rotor_inertia="J",
        gear_ratio="n",
        stiffness="k",
        damping=DAMPING,
        friction=FRICTION,
    )
    return mbdlft.Scene(
        name="spacecraft",
        parameters=[N, J, K],
        bodies=[wheel("hub", HUB), wheel("array", ARRAY), drive.body],
        joints=[
            mbdlft.Revolute(name="spin", parent="ground", child="hub", axis=(0, 0, 1)),
            drive.motor,
            drive.shaft,
        ],
        inputs=["spin.torque", "drive.torque"],
        outputs=["spin.angle", "drive.angle", "drive_shaft.angle"],
    )


def lagrange(n: float, J: float, k: float) -> np.ndarray:
    """[A B] with T = Jh h'^2/2 + J (h' + n q')^2/2 + Ja (h' + q' + e')^2/2, angles h, q, e."""
    mass = (
        HUB * np.outer([1, 0, 0], [1, 0, 0])
        + J * np.outer([1, n, 0], [1, n, 0])
        + ARRAY * np.outer([1, 1, 1], [1, 1, 1])
    )
    forces = -np.hstack([np.diag([0, 0, k]), np.diag([0, FRICTION, DAMPING]), -np.eye(3)[:, :2]])
    top = np.hstack([np.zeros((3, 3)), np.eye(3), np.zeros((3, 2))])
    return np.vstack([top, np.linalg.solve(mass, forces)])


def check_drive(model: mbdlft.LFTModel, n: float, J: float, k: float) -> None:
    A, B, _, _ = mbdlft.matrices_at(model, {"n": n, "J": J, "k": k})
    expected = lagrange(n, J, k)
    rows = np.max(np.abs(expected), axis=1, keepdims=True)
    target(np.hstack([A, B]) / rows, expected / rows, CLOSED_FORM)


MODEL = mbdlft.to_lft(spacecraft(), search=0.0)


@settings(max_examples=20, deadline=None)
@given(n=st.floats(40.0, 90.0), J=st.floats(1.2e-4, 2.8e-4), k=st.floats(630.0, 1170.0))
def test_drive_is_that_of_lagrange(n: float, J: float, k: float) -> None:
    check_drive(MODEL, n, J, k)
    assert MODEL.certificate.max_relative_error < CLOSED_FORM


def test_without_a_gear_nothing_changes() -> None:
    """A ratio of 1 is the actuator that turns with the child."""
    one = mbdlft.Revolute(name="a", parent="ground", child="b", axis=(0, 0, 1), actuator_inertia=0.3)
    geared = one.model_copy(update={"gear_ratio": 1.0})
    body = wheel("b", 2.0)
    for joint in (one, geared):
        model = mbdlft.to_lft(mbdlft.Scene(name="s", bodies=[body], joints=[joint]))
        target(model.B_u[1, 0], 1.0 / 2.3, CLOSED_FORM)
    assert mbdlft.assemble(mbdlft.Scene(name="s", bodies=[body], joints=[one])).degrees_of_freedom == 1
    model = mbdlft.to_lft(
        mbdlft.Scene(name="s", bodies=[body], joints=[one.model_copy(update={"gear_ratio": 10.0})])
    )
    target(model.B_u[1, 0], 1.0 / (2.0 + 100.0 * 0.3), CLOSED_FORM)
