"""The arm against its closed form: matrices, trim, frequency response over all angles, 50 digits."""

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.arm import (
    NAMES,
    SCENE,
    closed_form,
    full_circle_scene,
    state_and_input,
    worst_response_error,
)
from benchmarks.cases.pendulum import DAMPING, GRAVITY, POSITIONS, pendulum
from tests.close import CLOSED_FORM, FREQUENCY_RESPONSE, target


@pytest.fixture(scope="module")
def model() -> mbdlft.LFTModel:
    return mbdlft.to_lft(mbdlft.load_scene(SCENE), search=0.0)


def points(model: mbdlft.LFTModel) -> dict[str, np.ndarray]:
    inside, outer = mbdlft.random(model.parameters, 1000, seed=11), mbdlft.corners(model.parameters)
    assert len(outer["m1"]) == 128
    return {name: np.concatenate([inside[name], outer[name]]) for name in NAMES}


def test_lft_is_the_closed_form_at_1000_points_and_all_corners(model: mbdlft.LFTModel) -> None:
    values = points(model)
    expected, torques = closed_form(values)
    actual = state_and_input(model, values)
    for k in range(len(expected)):
        target(actual[k], expected[k], CLOSED_FORM)
    target(mbdlft.trim_at(model, values), torques, CLOSED_FORM)


def test_order(model: mbdlft.LFTModel) -> None:
    """The order reached and the proved bound: 16 = J1 1, m1 1, rho1 2, m3 2, L2 2, 4, 4."""
    bound = dict(zip((p.name for p in model.parameters), model.certificate.lower_bound, strict=True))
    assert bound == {"J1": 1, "m1": 1, "rho1": 2, "m3": 2, "L2": 2, "theta1": 4, "theta2": 4}
    assert model.order <= 19
    assert model.certificate.raw_order >= model.certificate.order >= model.certificate.lower_bound


def test_frequency_response_over_all_angles() -> None:
    """Figure 5 of the paper: nominal masses, both angles over the full circle, (-180, 180] deg."""
    full = mbdlft.to_lft(full_circle_scene(), search=0.0)
    angles = np.concatenate([np.arange(-150.0, 181.0, 30.0), [-90.1, -89.9, 89.9, 90.1, 179.999]])
    theta1, theta2 = (axis.ravel() for axis in np.meshgrid(angles, angles))
    found = worst_response_error(full, theta1, theta2, np.logspace(-2, 3, 16))
    assert found <= FREQUENCY_RESPONSE, f"relative error {found:.2e}"


def test_python_control_gives_the_same_model(model: mbdlft.LFTModel) -> None:
    system = model.at(m1=3.3, theta1=60.0)
    assert system.input_labels == ["shoulder_torque", "elbow_torque"]
    assert system.output_labels == ["shoulder_angle", "elbow_angle"]
    assert system.state_labels == ["shoulder_angle", "elbow_angle", "shoulder_rate", "elbow_rate"]
    values = {"m1": 3.3, "theta1": 60.0}
    omega = np.array([0.1, 1.0, 10.0])
    ours = mbdlft.frequency_response(model, values, omega)[0]
    theirs = np.moveaxis(system(1j * omega), -1, 0)
    target(ours, theirs, CLOSED_FORM)


# The pendulum against its closed form, at three positions -------------------------------------------


@pytest.mark.parametrize("name", POSITIONS)
def test_exact_minimal_and_of_the_right_sign(name: str) -> None:
    position, cosine = POSITIONS[name]
    model = pendulum(position)
    inside, outer = mbdlft.random(model.parameters, 100), mbdlft.corners(model.parameters)
    values = {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}
    m, L = values["m"], values["L"]
    matrices = mbdlft.matrices_at(model, values)
    stiffness = m * GRAVITY * L * cosine
    target(matrices.A[:, 1, 0], -stiffness / (m * L**2), CLOSED_FORM, scale=GRAVITY)
    target(matrices.A[:, 1, 1], -DAMPING / (m * L**2), CLOSED_FORM)
    target(matrices.B[:, 1, 0], 1 / (m * L**2), CLOSED_FORM)
    # the torque that holds it, and with it the sign of the angle
    sine = {"hanging": 0.0, "horizontal": 1.0, "inverted": 0.0}[name]
    torque = mbdlft.trim_at(model, values)[:, 0]
    target(torque, m * GRAVITY * L * sine, CLOSED_FORM, scale=float(np.max(m * GRAVITY * L)))
    assert np.all(np.sign(np.round(-matrices.A[:, 1, 0], 9)) == np.sign(cosine))
    assert model.certificate.minimal
    assert dict(model.lft.blocks) == {"L": 2, "m": 1}
