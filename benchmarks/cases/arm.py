"""The two-link arm in closed form, for floats, arrays or 50-digit numbers.

Kassarian, Sanfedino, Alazard, Chevrier, Montel: Linear Fractional Transformation Modeling of
Multibody Dynamics Around Parameter-Dependent Equilibrium, section VI, table I. The paper does not
say from where theta is measured: here theta1 is from the horizontal, theta2 relative to link 1. The
absolute angles are phi1 = theta1, phi2 = theta1 + theta2, and theta = T^-1 phi, T = [1 0; 1 1]:

    M11 = J1 + m1 (rho1 L1)^2 + (m2 + m3) L1^2      M22 = J2 + (m2 rho2^2 + m3) L2^2
    M12 = L1 L2 (m2 rho2 + m3) cos theta2
    K   = diag(-g (m1 rho1 + m2 + m3) L1 sin phi1, -g (m2 rho2 + m3) L2 sin phi2)
    M_theta = T' M T,  K_theta = T' K T + 0.1 I,  D_theta = 0.1 I
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbdlft

SCENE = Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml"
NAMES = ("m1", "J1", "rho1", "m3", "L2", "theta1", "theta2")
NOMINAL = {"m1": 3.0, "J1": 0.2, "rho1": 0.3, "m3": 5.0, "L2": 1.0}
DAMPING = 0.1


class Arm(NamedTuple):
    """Entries of the mass and stiffness matrices and trim torques; D = 0.1 I."""

    M: tuple[tuple[Any, Any], tuple[Any, Any]]
    K: tuple[tuple[Any, Any], tuple[Any, Any]]
    torques: tuple[Any, Any]


def arm(values: dict[str, Any], number: Any, cos: Any, sin: Any) -> Arm:
    """Closed form at physical values (kg, kg m^2, m, degrees turned into rad by the caller).

    `number` turns the decimal text of a constant into the number type.
    """
    m1, J1, rho1, m3, L2 = (values[name] for name in ("m1", "J1", "rho1", "m3", "L2"))
    theta1, theta2 = values["theta1"], values["theta2"]
    l1, m2, rho2, j2, g, k = (number(text) for text in ("1", "2", "0.5", "0.1", "9.81", "0.1"))
    phi2 = theta1 + theta2
    a11 = J1 + m1 * (rho1 * l1) ** 2 + (m2 + m3) * l1**2
    a22 = j2 + (m2 * rho2**2 + m3) * L2**2
    a12 = l1 * L2 * (m2 * rho2 + m3) * cos(theta2)
    w1 = g * (m1 * rho1 + m2 + m3) * l1
    w2 = g * (m2 * rho2 + m3) * L2
    k1, k2 = -w1 * sin(theta1), -w2 * sin(phi2)
    return Arm(
        M=((a11 + 2 * a12 + a22, a12 + a22), (a12 + a22, a22)),
        K=((k1 + k2 + k, k2), (k2, k2 + k)),
        torques=(w1 * cos(theta1) + w2 * cos(phi2), w2 * cos(phi2)),
    )


def closed_form(values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """A, B stacked as (N, 4, 6), and trim torques (N, 2)."""
    radians = {
        name: np.radians(value) if name.startswith("theta") else np.asarray(value)
        for name, value in values.items()
    }
    count = max(np.size(value) for value in radians.values())
    found = arm(radians, float, np.cos, np.sin)
    M, K = (
        np.stack([np.stack([np.broadcast_to(x, count) for x in row], -1) for row in part], -2)
        for part in (found.M, found.K)
    )
    acceleration = np.linalg.solve(
        M,
        np.concatenate(
            [-K, np.tile(-DAMPING * np.eye(2), (count, 1, 1)), np.tile(np.eye(2), (count, 1, 1))], -1
        ),
    )
    velocity = np.tile(np.hstack([np.zeros((2, 2)), np.eye(2), np.zeros((2, 2))]), (count, 1, 1))
    torques = np.stack([np.broadcast_to(x, count) for x in found.torques], -1)
    return np.concatenate([velocity, acceleration], 1), torques


def state_and_input(model: mbdlft.LFTModel, values: dict[str, np.ndarray]) -> np.ndarray:
    """[A B] (N, 4, 6) of a model."""
    matrices = mbdlft.matrices_at(model, values)
    return np.concatenate([matrices.A, matrices.B], axis=-1)


def full_circle_scene() -> mbdlft.Scene:
    """The arm with both angles over the full circle, by the quarter-angle; nominal as it is."""
    text = SCENE.read_text(encoding="utf-8")
    for nominal, old in (
        (70.0, "nominal = 70.0, low = 45.0, high = 90.0"),
        (90.0, "nominal = 90.0, low = 45.0, high = 135.0"),
    ):
        assert old in text
        wide = 'low = -180.0, high = 180.0, substitution = "quarter-angle"'
        text = text.replace(old, f"nominal = {nominal}, {wide}")
    return mbdlft.scene_from_toml(text)


def worst_response_error(
    model: mbdlft.LFTModel, theta1: np.ndarray, theta2: np.ndarray, omega: np.ndarray
) -> float:
    """Largest error of the frequency response over angles (N,) in deg, relative to its size there."""
    values = {"theta1": theta1, "theta2": theta2}
    actual = mbdlft.frequency_response(model, values, omega)
    state, _ = closed_form({**{name: np.array([x]) for name, x in NOMINAL.items()}, **values})
    worst = 0.0
    for k, w in enumerate(omega):
        loop = 1j * w * np.eye(4) - state[:, :, :4]
        expected = np.linalg.solve(loop, state[:, :, 4:].astype(complex))[:, :2]
        size = np.max(np.abs(expected), axis=(1, 2))
        worst = max(worst, float(np.max(np.max(np.abs(actual[:, k] - expected), axis=(1, 2)) / size)))
    return worst
