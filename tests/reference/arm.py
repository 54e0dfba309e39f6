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

from typing import Any, NamedTuple

L1, M2, RHO2, J2, GRAVITY, STIFFNESS, DAMPING = 1.0, 2.0, 0.5, 0.1, 9.81, 0.1, 0.1


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
