"""The wind turbine of docs/trials.md against finite elements of its own, from energies.

Each beam has cubic elements in a frame that moves with its root. Its points are lowered by half of the
integral of the squared slope, which is how weight softens what stands and stiffens what hangs.
"""

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np

import mbdlft
from mbdlft.base.array import Array
from tests.close import MECHANISM, roundoff, target

_AT, _WEIGHT = np.polynomial.legendre.leggauss(6)
Point = tuple[ca.SX, ca.SX]  # (x, z), and the angle about y of the body there


class Energies:
    """Coordinates q, rates v, an input u; the kinetic and potential energy, the power of the input."""

    def __init__(self, count: int) -> None:
        self.q, self.v, self.u = ca.SX.sym("q", count), ca.SX.sym("v", count), ca.SX.sym("u")
        self.T = self.V = self.P = ca.SX(0)

    def rate(self, of: ca.SX) -> ca.SX:
        return ca.jtimes(of, self.q, self.v)

    def point(self, mass: float, place: ca.SX) -> None:
        """A mass at (x, z)."""
        rate = self.rate(place)
        self.T += mass * ca.dot(rate, rate) / 2
        self.V += mass * 9.81 * place[1]

    def linear(self) -> tuple[Array, Array]:
        """Accelerations by q and by u at rest: d/dt dT/dv - dT/dq + dV/dq = dP/dv, and what holds it."""
        a, momentum = ca.SX.sym("a", self.q.numel()), ca.gradient(self.T, self.v)
        rows = ca.jtimes(momentum, self.q, self.v) + ca.jtimes(momentum, self.v, a)
        rows += ca.gradient(self.V - self.T, self.q) - ca.gradient(self.P, self.v)
        slopes = [ca.jacobian(rows, symbol) for symbol in (a, self.q, self.u)]
        M, K, B = (x.full() for x in ca.Function("f", [self.q, self.v, a, self.u], slopes)(0, 0, 0, 0))
        return -np.linalg.solve(M, K), -np.linalg.solve(M, B)


def about_y(angle: ca.SX) -> Callable[[ca.SX, ca.SX], ca.SX]:
    """What takes (x, z) of a body that is turned about y to (x, z) of the scene."""
    c, s = ca.cos(angle), ca.sin(angle)
    return lambda x, z: ca.vertcat(c * x + s * z, c * z - s * x)


def by_hand(p: dict[str, float]) -> tuple[Energies, ca.SX]:
    """Tower, nacelle, one blade up with a mass at its tip, one down; where the top of the tower is."""
    e = Energies(16)
    free = iter(ca.vertsplit(e.q))
    top, turn = beam(e, free, (ca.SX(2, 1), ca.SX(0)), 1, (87.0, 8500 * 0.45, p["E"] * 1.6, 4))
    hub = top + about_y(turn)(-5, 2)
    e.point(p["mn"], top)
    e.T += 2.6e6 * e.rate(turn) ** 2 / 2
    blade = (61.0, 1700 * 0.17, 3e10 * 0.02, 2)
    tip, _ = beam(e, free, (hub, turn), 1, blade)
    e.point(p["mb"], tip)
    beam(e, free, (hub, turn), -1, blade)
    e.P = e.u * e.rate(hub[0])  # of the wind
    return e, top[0]


def beam(
    e: Energies, free: Iterator[ca.SX], root: Point, up: int, data: tuple[float, float, float, int]
) -> Point:
    """A beam that begins at a root and stands up (1) or hangs down (-1); its tip.

    `data` are length, mass of a meter, bending stiffness, and the number of elements.
    """
    length, line, stiffness, elements = data
    h, lowered, before = length / elements, ca.SX(0), [ca.SX(0), ca.SX(0)]

    def place(s: ca.SX, aside: ca.SX) -> ca.SX:
        return root[0] + about_y(root[1])(aside, up * s)

    for k in range(elements):
        ends = [*before, next(free), next(free)]  # displacement and slope, twice
        for x, weight in zip((_AT + 1) / 2, _WEIGHT / 2, strict=True):
            low = lowered + up_to(x, ends, h)
            e.point(line * h * weight, place((k + x) * h - low, across(x, ends, h, 0)))
            e.V += stiffness * across(x, ends, h, 2) ** 2 / 2 * h * weight
        lowered += up_to(1.0, ends, h)
        before = ends[2:]
    return place(length - lowered, before[0]), root[1] + up * before[1]


def across(x: float, ends: list[ca.SX], h: float, order: int) -> ca.SX:
    """Displacement, slope or curvature at the part x of an element (Hermite's cubic functions)."""
    shapes = (
        (1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)),
        ((6 * x**2 - 6 * x) / h, 1 - 4 * x + 3 * x**2, (6 * x - 6 * x**2) / h, 3 * x**2 - 2 * x),
        ((12 * x - 6) / h**2, (6 * x - 4) / h, (6 - 12 * x) / h**2, (6 * x - 2) / h),
    )
    return ca.dot(ca.DM(list(shapes[order])), ca.vertcat(*ends))


def up_to(x: float, ends: list[ca.SX], h: float) -> ca.SX:
    """Half of the integral of the squared slope from the begin of an element to its part x."""
    return sum(
        across(x * (at + 1) / 2, ends, h, 1) ** 2 * weight * x * h / 4
        for at, weight in zip(_AT, _WEIGHT, strict=True)
    )


def test_wind_turbine_against_its_own_elements() -> None:
    model = mbdlft.to_lft(mbdlft.load_scene("docs/trials/wind_turbine.toml"), search=0.0)
    values = {"E": 1.95e11, "mn": 260e3, "mb": 2600.0}
    found = model.at(values)
    e, top = by_hand(values)
    by_position, by_input = e.linear()
    frequencies = np.sort(np.sqrt(-np.linalg.eigvals(by_position).real))
    target(np.sort(np.linalg.eigvals(found.A).imag)[16:], frequencies, MECHANISM)
    row = ca.DM(ca.evalf(ca.substitute(ca.jacobian(top, e.q), e.q, 0))).full()[0]
    outputs = [signal.name for signal in model.outputs]
    for w in (0.3, 1.2, 5.0):
        D = -(w**2) * np.eye(16) - by_position
        x = np.linalg.solve(D, by_input[:, 0])
        response = found.C @ np.linalg.solve(1j * w * np.eye(32) - found.A, found.B)
        # rounding of the stiffnesses, of which the slow motions are small differences
        terms = abs(row) @ abs(np.linalg.inv(D)) @ (abs(D) @ abs(x) + abs(by_input[:, 0]))
        roundoff(response[outputs.index("top.x"), 0], row @ x, terms / abs(row @ x))
