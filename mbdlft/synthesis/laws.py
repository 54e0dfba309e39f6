"""Laws of rigid motion and of active damping: controllers whose free values begin at a design rule.

A rule gives poles in closed form, for a rigid body or for one mode of pole w and damping xi:

    PD from inertia         J s^2 + kv s + kp = J (s^2 + 2 xi w s + w^2)
    positive position       (s^2 + w^2)(s^2 + a1 s + a0) - b w^2 = (s^2 + 2 xi w s + w^2)^2
    acceleration, filtered  (s^2 + w^2)(s^2 + a1 s + a0) + b s^2 = (s^2 + 2 xi w s + w^2)^2
    integral feedback       s (s^2 + w^2) + g (s^2 + z^2) = (s + a)(s^2 + 2 xi b s + b^2)

The last one is of a load whose response to the actuator has the zero z below the pole w, and of an
acceleration, whose zero is 0. Laws are those of Perez, thesis, ISAE Toulouse, 2016, section 7.2; rules
follow from comparing coefficients. The sign of a law is inside: its output is connected as it is.

The load of integral force feedback has to be the one that the *next* body puts on the actuator, the
received one: it is collocated, poles and zeros alternate, and any gain damps. The load that the body of
the actuator puts on the one *before* it, the transmitted one, has an inertia between: there a gain of the
rule makes modes unstable.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.synthesis import pieces

_LEAK = 1e-3  # of the frequency of a mode: what an integrator is moved to the left by


def inertia_pd(
    name: str,
    positions: pieces.Names,
    rates: pieces.Names,
    forces: pieces.Names,
    *,
    inertia: Any,
    frequency: float,
    damping: float,
) -> pieces.TunableSystem:
    """The PD controller u = -kp q - kv qdot of a rigid body, kp = J w^2 and kv = 2 xi w J.

    Parameters
    ----------
    name : str
    positions, rates, forces : name, or sequence of names
        As many of each: angles and torques, or positions and forces.
    inertia : float or symmetric matrix, J (kg m^2, or kg)
        Of all that moves with the positions, with appendages held stiff. Gains between channels are free
        where it is not zero.
    frequency : float, w (rad/s)
    damping : float, xi

    Returns
    -------
    TunableSystem
        Its values ``D[row,column]`` are -kp and, in the columns behind, -kv.
    """
    q, qdot, u = pieces.listed(positions), pieces.listed(rates), pieces.listed(forces)
    pieces.check_positive(name, frequency=frequency, damping=damping)
    J = np.atleast_2d(np.asarray(inertia, dtype=float))
    n = len(q)
    is_fit = len(qdot) == len(u) == n and J.shape == (n, n) and bool(np.all(np.isfinite(J)))
    if not (is_fit and np.array_equal(J, J.T) and np.min(np.linalg.eigvalsh(J)) > 0.0):
        raise StructureError(
            f"{name}: expected as many positions, rates and forces, and a symmetric, positive inertia of "
            f"that size, got {n}, {len(qdot)}, {len(u)} and {inertia!r}."
        )
    gains = -np.hstack([frequency**2 * J, 2.0 * damping * frequency * J])
    initial = {f"D[{i + 1},{j + 1}]": float(gains[i, j]) for i, j in np.argwhere(gains)}
    return _begun(pieces.tunable_gain(name, [*q, *qdot], u, structure=gains != 0.0, initial=initial))


def positive_position_feedback(
    name: str, position: str, force: str, *, mass: float, frequency: float, damping: float
) -> pieces.TunableSystem:
    """The force b/(p^2 + a1 p + a0) times a position, p = s/w: both modes of the loop get the damping.

    Parameters
    ----------
    name : str
    position : str
        Relative, where the force acts, and positive along it.
    force : str
    mass : float, in kg (kg m^2 of an angle)
        Modal, as the force sees it: the response of the mode is 1/(mass (s^2 + w^2)).
    frequency : float, w (rad/s)
    damping : float, xi

    Returns
    -------
    TunableSystem
        Its values are ``a0``, ``a1`` and ``b0``: 1 + 4 xi^2, 4 xi and 4 xi^2 mass w^2.
    """
    pieces.check_positive(name, mass=mass, frequency=frequency, damping=damping)
    square = 4.0 * damping**2
    stiffness = mass * frequency**2
    values = {"a0": 1.0 + square, "a1": 4.0 * damping, "b0": square * stiffness}
    return _transfer(name, position, force, 2, frequency, values, fixed={"b1"})


def acceleration_feedback(
    name: str,
    acceleration: str,
    force: str,
    *,
    mass: float,
    frequency: float,
    damping: float,
    filtered: bool = False,
    leak: float | None = None,
) -> pieces.TunableSystem:
    """The force -kv/(s + leak), or -b/(p^2 + a1 p + a0) with p = s/w, times an acceleration.

    Parameters
    ----------
    name : str
    acceleration, force : names
        Where the sensor is inertial and the force internal, they are not strictly collocated: with a
        heavy or soft body behind, poles and zeros cease to alternate.
    mass, frequency, damping
        As for `positive_position_feedback`.
    filtered : bool
        The second-order filter, which is tuned to one mode and falls beyond it, in place of the integral.
    leak : float, in rad/s, optional
        The pole of the integral to the left of 0, a thousandth of the frequency by default; it is not
        tuned. The damping is exact without it.

    Returns
    -------
    TunableSystem
        Its value is ``b0``, that is -kv/w; or ``a0``, ``a1`` and ``b0``.
    """
    pieces.check_positive(name, mass=mass, frequency=frequency, damping=damping)
    if filtered:
        values = {"a0": 1.0, "a1": 4.0 * damping, "b0": -4.0 * damping**2 * mass}
        return _transfer(name, acceleration, force, 2, frequency, values, fixed={"b1"})
    gain = mass * _integral_gain(name, frequency, 0.0, damping)
    return _integral(
        name, acceleration, force, frequency, gain, _LEAK * frequency if leak is None else leak
    )


def integral_force_feedback(
    name: str,
    load: str,
    actuator: str,
    *,
    frequency: float,
    zero: float,
    damping: float,
    direct: float = 1.0,
    leak: float = 0.0,
) -> pieces.TunableSystem:
    """The actuator's input -g/(s + leak) times the load that it receives, with a damping for one mode.

    Parameters
    ----------
    name : str
    load : str
        The received one: from the body behind the actuator, on the actuator's body. Not the transmitted
        one, from the actuator's body on the one that carries it.
    actuator : str
        A force, an elongation or a voltage.
    frequency, zero : float, w and z (rad/s)
        Of the mode: the pole, and the zero below it, of the response direct (s^2 + z^2)/(s^2 + w^2).
    damping : float, at most (w - z)/(2 z) with no leak
    direct : float
        Of the response at high frequency, with its sign (N per unit of the actuator).
    leak : float, in rad/s
        As for `acceleration_feedback`: needed where the load is zero at rest.

    Returns
    -------
    TunableSystem
        Its value is ``b0``, that is -g/w.
    """
    pieces.check_positive(name, frequency=frequency, damping=damping)
    if not (0.0 <= zero < frequency and direct != 0.0 and np.isfinite(direct)):
        raise StructureError(
            f"{name}: expected a zero from 0 to the frequency {frequency!r}, and a direct gain that is "
            f"not 0, got {zero!r} and {direct!r}."
        )
    gain = _integral_gain(name, frequency, zero, damping) / direct
    return _integral(name, load, actuator, frequency, gain, leak)


def _integral(name: str, u: str, y: str, w: float, gain: float, leak: float) -> pieces.TunableSystem:
    """-gain/(s + leak), with the gain free."""
    if not 0.0 <= leak < w:
        raise StructureError(f"{name}: expected a leak from 0 up to {w!r} rad/s, got {leak!r}.")
    return _transfer(name, u, y, 1, w, {"a0": leak / w, "b0": -gain / w}, fixed={"a0"})


def _integral_gain(name: str, w: float, z: float, xi: float) -> float:
    """g of s (s^2 + w^2) + g (s^2 + z^2) = (s + a)(s^2 + 2 xi b s + b^2), the smallest.

    Coefficients give g = a + 2 xi b, a = 2 xi b z^2/(b^2 - z^2), and
    b^4 - (w^2 + z^2 - 4 xi^2 z^2) b^2 + w^2 z^2 = 0, with a real b up to xi = (w - z)/(2 z).
    """
    if 2.0 * xi * z > w - z:
        raise StructureError(
            f"{name}: no gain gives a damping of {xi!r} to the pole {w!r} rad/s with the zero {z!r} "
            f"rad/s: the largest is {(w - z) / (2.0 * z):.4g}. A stiffer actuator moves the zero away."
        )
    reach = 4.0 * (xi * z) ** 2
    root = np.sqrt(max(((w - z) ** 2 - reach) * ((w + z) ** 2 - reach), 0.0))
    square = 0.5 * (w**2 + z**2 - reach + root)
    b = float(np.sqrt(square))
    return 2.0 * xi * b * float(square / (square - z**2))


def _transfer(
    name: str,
    u: str,
    y: str,
    order: int,
    speed: float,
    values: Mapping[str, float],
    fixed: Collection[str],
) -> pieces.TunableSystem:
    """A strictly proper transfer function that begins at values, some of which are not free."""
    made = pieces.tunable_transfer(name, u, y, order, strictly_proper=True, speed=speed, initial=values)
    return _begun(made, {f"{name}.{label}" for label in fixed})


def _begun(controller: pieces.TunableSystem, fixed: Collection[str] = ()) -> pieces.TunableSystem:
    """A controller whose values are of the size they begin at; some are fixed there."""
    x: Array = np.array([value.initial for value in controller.free])
    held = np.array([value.name in fixed for value in controller.free])
    base = controller.base + np.tensordot(x * held, controller.moves, 1)
    free = tuple(replace(v, scale=abs(v.initial)) for v in controller.free if v.name not in fixed)
    return replace(controller, base=base, moves=controller.moves[~held], free=free)
