"""What the loads at equilibrium and a spinning frame do to a beam.

An axial force N(s), positive where it pulls, does the work of the shortening int (dw/dx)^2/2 dx of a bent
beam, and turns a section with the polar radius of gyration r by phi at the cost of N r^2 (dphi/dx)^2/2:

    K_G = 1/L int N dN'dN ds        (for torsion times (I_y + I_z)/A)

A pull F at the place s1 has N = F for s < s1. The beam itself, with the proper acceleration a_x of its
origin and the spin omega of its frame, all in its own axes, has

    N = -rho A L a_x (1 - s) + rho A L^2 (omega_y^2 + omega_z^2) (1 - s^2)/2

In a frame that spins, a point at L s + u has the acceleration a + omega x (omega x (L s + u))
+ 2 omega x udot + uddot besides that of alpha. The mass is on the axis.

Source: for K_G, Przemieniecki, Theory of Matrix Structural Analysis, sections 15.2 and 15.3; the laws of
`tests/reference/test_loaded_beams.py` compare with exact solutions.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.multibody.body.beam_elements import (
    LINEAR,
    ONE,
    Deformation,
    Polynomial,
    cross_products,
    moments,
    products,
)
from mbdlft.multibody.body.elastic import Term, times
from mbdlft.multibody.spatial import Coordinate

Blocks = Sequence[tuple[str, Deformation, slice]]
DIRECTION = {"axial": 0, "bending_y": 1, "bending_z": 2}

_OUTSIDE = (Fraction(1), Fraction(-1))  # 1 - s: the mass outside of s
_OUTSIDE_BY_ARM = (Fraction(1, 2), Fraction(0), Fraction(-1, 2))  # (1 - s^2)/2: its first moment


def unknown_loads(deformations: Sequence[str]) -> tuple[int, ...]:
    """Loads of force and torque (0 to 5) whose effect on the stiffness is not that of an axial force.

    A load that bends the beam in one plane couples its torsion with its bending in the other one, and a
    torque along it couples the two bendings. In one plane alone nothing is left out.
    """
    has = set(deformations)
    rows: set[int] = set()
    if {"torsion", "bending_y"} <= has:
        rows |= {2, 4}
    if {"torsion", "bending_z"} <= has:
        rows |= {1, 5}
    if {"bending_y", "bending_z"} <= has:
        rows |= {3}
    return tuple(sorted(rows))


def pulled(blocks: Blocks, node: int, force: ca.SX, values: Values, radius: Any, q: ca.SX) -> ca.SX:
    """K_G q (n,) by a pull `force` (N) at a node; `radius` is (I_y + I_z)/A, for torsion."""
    return _stiffened(blocks, force / values["length"], ONE, node, radius, q)


def stiffened_by_motion(
    blocks: Blocks, motion: ca.SX, values: Values, radius: Any, q: ca.SX
) -> ca.SX:
    """K_G q (n,) by the weight of the beam itself, for a motion (3, 3) of its origin."""
    rho, A, L = (values[key] for key in ("density", "area", "length"))
    weight = -(rho * A) * motion[0, 2]
    total = _stiffened(blocks, weight, _OUTSIDE, None, radius, q)
    spin = motion[1, 0] * motion[1, 0] + motion[2, 0] * motion[2, 0]
    return total + _stiffened(blocks, (rho * A * L) * spin, _OUTSIDE_BY_ARM, None, radius, q)


def _stiffened(
    blocks: Blocks, factor: ca.SX, weight: Polynomial, last: int | None, radius: Any, q: ca.SX
) -> ca.SX:
    """The factor times int weight dN'dN ds q (n,), of all deformations that turn the axis or sections."""
    total = ca.SX(q.numel(), 1)
    for name, d, part in blocks:
        if name == "axial":
            continue
        scale = factor * radius if name == "torsion" else factor
        matrix = products(d, "slope", weight, 0, last)
        total[part] = times([Term(scale, matrix)], q[part])
    return total


def spinning(blocks: Blocks, motion: ca.SX, values: Values, at: Coordinate) -> tuple[ca.SX, ca.SX]:
    """Wrench (3, 2) about the origin, and generalized forces (n,), that only a spinning frame needs.

    Without those of the undeformed body in the wrench. Axial deformation and bending only.
    """
    line, L = values["density"] * values["area"] * values["length"], values["length"]
    omega = motion[:, 0]
    across, twice = ca.skew(omega), 2 * ca.skew(omega)
    inward = ca.mtimes(across, across)
    mean = {name: _mean(blocks, ONE, part) for name, part in (("q", at.q), ("v", at.v))}
    first = {name: _mean(blocks, LINEAR, part) for name, part in (("q", at.q), ("v", at.v))}
    force = ca.mtimes(inward, mean["q"]) + ca.mtimes(twice, mean["v"])
    along = ca.vertcat(1, 0, 0)
    torque = ca.cross(along, ca.mtimes(inward, first["q"]) + ca.mtimes(twice, first["v"]))
    torque = L * (torque + ca.cross(first["q"], inward[:, 0]))
    efforts = ca.SX(at.q.numel(), 1)
    for name, d, part in blocks:
        i = DIRECTION[name]
        own = ca.DM(moments(d, "displacement", LINEAR)) * (L * inward[i, 0])
        for other, e, columns in blocks:
            j = DIRECTION[other]
            shared = ca.sparsify(ca.SX(cross_products(d, "displacement", e, "displacement")))
            moved = inward[i, j] * at.q[columns] + twice[i, j] * at.v[columns]
            own = own + ca.mtimes(shared, moved)
        efforts[part] = line * own
    return line * ca.horzcat(force, torque), efforts


def _mean(blocks: Blocks, weight: Polynomial, q: ca.SX) -> ca.SX:
    """Integral (3,) of weight(s) times the displacement."""
    total = ca.SX(3, 1)
    for name, d, part in blocks:
        row = ca.DM(moments(d, "displacement", weight)).T
        total[DIRECTION[name]] = ca.mtimes(ca.SX(row), q[part])
    return total
