"""Random DAEs cut from explicit systems: their Delta-Theta forms and linear models against these.

The explicit system is differentiated by CasADi; equations are mixed, in any order, with parameters.
"""

from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

import mbdlft
from mbdlft import MbdlftError, Parameter
from mbdlft.base.array import Array
from mbdlft.dae import Dae, DaeDraft, evaluate_form, reduce_index, trim
from mbdlft.problem.sx.constants import in_doubles
from tests.close import SIMULATED

POINTS = 4


class Known(NamedTuple):
    """A DAE, and the function (x, u, p) -> xdot, y and their slopes by x and u."""

    dae: Dae
    explicit: ca.Function
    states: int


def attack(seed: int, folder: Path) -> str:
    """Evaluate both forms at random points; linearize at numbers, with inputs that are found."""
    random = np.random.default_rng(seed + 10**6)
    known = _Draft(seed).made()
    n, said = known.states, "forms"
    structure = reduce_index(known.dae, states=[f"x{k}" for k in range(n)])
    for arrange in ("fewest", "blocks"):
        form = mbdlft.delta_theta(structure, arrange, search=0.0)  # type: ignore[arg-type]
        for _ in range(POINTS):
            x, u, p = random.uniform(-1, 1, n), random.uniform(-1, 1, n), _values(known, random)
            rates, outputs = evaluate_form(form, _named("x", x), _named("u", u), p)
            right = [part.full()[:, 0] for part in known.explicit(x, u, list(p.values()))[:2]]
            found = [*(rates[f"x{k}"] for k in range(n)), outputs["y"]]
            _check(np.array(found), np.concatenate(right), arrange)
    at = np.round(random.uniform(-0.8, 0.8, n), 2)
    free = [f"u{k}" for k in range(n)]
    try:
        model = mbdlft.linearize_dae(trim(structure, _named("x", at), free=free), search=0.0)
    except MbdlftError:
        return f"{said}, no linear model"
    order = [[s.name for s in part] for part in (model.states, model.inputs)]
    rows = [order[0].index(f"x{k}") for k in range(n)]
    columns = [order[1].index(name) for name in free]
    for _ in range(POINTS):
        p = _values(known, random)
        found = mbdlft.matrices_at(model, {name: [value] for name, value in p.items()})
        slopes = known.explicit(at, np.zeros(n), list(p.values()))[2:]  # u enters linearly
        _check(found.A[0][np.ix_(rows, rows)], slopes[0].full(), "A")
        _check(found.B[0][np.ix_(rows, columns)], slopes[1].full(), "B")
        _check(found.C[0][:, rows], slopes[2].full(), "C")
    return f"{said}, linear model"


def _check(found: Array, right: Array, what: str) -> None:
    error = float(np.max(np.abs(found - right)) / (1.0 + np.max(np.abs(right))))
    assert error <= SIMULATED, f"{what} differs by {error:.1e}"


def _named(name: str, values: Array) -> dict[str, float]:
    return {f"{name}{k}": float(value) for k, value in enumerate(values)}


def _values(known: Known, random: np.random.Generator) -> dict[str, float]:
    return {p.name: float(random.uniform(p.low, p.high)) for p in known.dae.parameters}


class _Draft:
    """Each rate is linear in its own input, so that inputs hold any equilibrium."""

    def __init__(self, seed: int) -> None:
        self.r, self.d = np.random.default_rng(seed), DaeDraft(f"equations{seed}")
        self.n = int(self.r.integers(1, 4))
        nominal = self.r.choice([1.0, 0.3, 1e-8, 1e6], int(self.r.integers(1, 4)))
        declared = [Parameter(f"p{k}", v, percent=20.0) for k, v in enumerate(nominal)]
        self.p = [self.d.parameter(p) / self.d.number(p.nominal) for p in declared]
        self.u = [self.d.input(f"u{k}") for k in range(self.n)]
        self.x = [self.d.variable(f"x{k}", start=0.3) for k in range(self.n)]

    def one(self, of: list[ca.SX]) -> ca.SX:
        return of[int(self.r.integers(len(of)))]

    def number(self) -> ca.SX:
        return self.d.number(float(np.round(self.r.uniform(-2, 2), 2)) or 1.0)

    def coefficient(self) -> ca.SX:
        a, b = self.one(self.p), self.one(self.p)
        return self.one([a, 1 / a, a * b, a / (a + b), (1 + a) ** 2, 1 / (b * (1 + a))])

    def table(self, of: ca.SX) -> ca.SX:
        breakpoints = np.sort(self.r.choice(np.arange(-30, 31), 6, replace=False)) / 10.0
        values = np.round(self.r.uniform(-1, 1, 6), 2)
        kind = str(self.r.choice(["linear", "cubic"]))
        return self.d.table(of, breakpoints, values, kind)  # type: ignore[arg-type]

    def nonlinear(self, of: list[ca.SX], depth: int = 0) -> ca.SX:
        a, b = self.one(of), self.one(of)
        if depth < 2 and self.r.random() < 0.3:
            a = self.nonlinear(of, depth + 1)
        smooth = [ca.tan(ca.sin(a) / 3), ca.sqrt(1 + a * a), a * b, a / (2 + ca.cos(b)), a**3 * b]
        more = [ca.exp(-a * a), ca.tanh(a), a / (1 + b * b), ca.atan2(a, 2 + b * b), (a - b) * (a + b)]
        kinks = [a * ca.fabs(a), ca.fmin(ca.fmax(a, -1.25), 0.75), self.table(self.one(self.x))]
        return self.one([*smooth, *more, *kinks, ca.if_else(a > 0.1, a * b, ca.sin(b))])

    def made(self) -> Known:
        d, x, u = self.d, self.x, self.u
        z: list[ca.SX] = []
        defined: list[ca.SX] = []
        for k in range(int(self.r.integers(0, 4))):
            of = [*x, *z]
            defined.append(self.coefficient() * self.nonlinear(of) + self.number() * self.one(of))
            z.append(d.variable(f"z{k}"))
        of = [*x, *z]
        right = [
            sum((self.number() * self.coefficient() * v for v in of), self.coefficient() * u[k])
            + self.coefficient() * self.nonlinear(of)
            for k in range(self.n)
        ]
        rows = [[d.der(v) for v in x], right], [z, defined]
        equations = [
            (a, b) if not k else (a + (m := self.coefficient()) * left[k - 1], b + m * of_[k - 1])
            for left, of_ in rows
            for k, (a, b) in enumerate(zip(left, of_, strict=True))
        ]
        for k in self.r.permutation(len(equations)):
            d.equation(equations[k][0], equals=equations[k][1])
        y = sum((self.number() * v for v in of), ca.SX(0))
        d.output("y", y)
        dae, both = d.dae(), ca.vertcat(*right, y)
        for symbol, expression in zip(z[::-1], defined[::-1], strict=True):
            both = ca.substitute(both, symbol, expression)
        both, X, U = in_doubles(both), ca.vertcat(*x), ca.vertcat(*u)
        f, y = both[: self.n], both[self.n :]
        slopes = ca.jacobian(f, X), ca.jacobian(f, U), ca.jacobian(y, X)
        return Known(dae, ca.Function("explicit", [X, U, dae.p], [f, y, *slopes]), self.n)
