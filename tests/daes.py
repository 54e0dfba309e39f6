"""Differential-algebraic models for tests: the source's examples, machines, a random generator."""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from benchmarks.cases.mass_chain import chain as chain
from mbdlft.base import Parameter
from mbdlft.dae import Dae, DaeDraft
from mbdlft.problem.sx.constants import in_doubles, root

GRAVITY = 9.81


def dae_of(
    name: str,
    variables: str,
    *equations: str,
    inputs: str = "",
    outputs: str = "",
    parameters: Sequence[Parameter] = (),
    **limits: float,
) -> Dae:
    """Variables and inputs, as `name[unit]=start`, and equations, as `name: left = right`.

    Units, starts, names and right sides of zero may be left out; limits are those of all variables.
    """
    d = DaeDraft(name)
    known = {**vars(ca), "root": lambda x: ca.SX(root(x)), "der": d.der, "number": d.number, "fit": d.fit}
    known |= {p.name: d.parameter(p) for p in parameters}
    for declare, names, more in ((d.variable, variables, limits), (d.input, inputs, {})):
        for own, unit, start in re.findall(r"(\w+)(?:\[(.*?)\])?(?:=(\S+))?", names):
            known[own] = declare(own, unit or "1", start=float(start) if start else None, **more)
    for equation in equations:
        label, text = re.fullmatch(r"(?:(\w+): )?(.*)", equation).groups()  # type: ignore[union-attr]
        left, _, right = text.partition(" = ")
        d.equation(eval(left, known), label, equals=eval(right or "0", known))
    for output in outputs.split():
        d.output(output)
    return d.dae()


def example_1() -> Dae:
    """Casella, Donida, Lovera (2009), section 5.1."""
    d = DaeDraft("example_1")
    p1 = d.parameter(Parameter("p1", 2.0, 1.0, 3.0, unit="s"))
    p2 = d.parameter(Parameter("p2", 4.0, 3.0, 5.0))
    u, x, filtered = d.input("u"), d.variable("G.x"), d.variable("G.y")
    gained, sine, y = d.variable("k1.y"), d.variable("sine.y"), d.variable("y")
    d.equation(p1 * d.der(x) + x, "G", equals=u)
    d.equation(filtered, "G.y", equals=4 * x)
    d.equation(gained, "k1", equals=p2 * filtered)
    d.equation(sine, "sine", equals=ca.sin(gained))
    d.equation(y, "k2", equals=sine / p2)
    d.output("y")
    return d.dae()


def example_2() -> Dae:
    """The same, section 5.2: two inertias and a nonlinear spring, with flanges."""
    d = DaeDraft("example_2")
    tau = d.input("tau", "N m")
    J = {
        "J1": d.parameter(Parameter("p1", 12.5, 10.0, 15.0, unit="kg m^2")),
        "J2": d.parameter(Parameter("p2", 3.0, 2.0, 4.0, unit="kg m^2")),
    }
    flange: dict[str, Any] = {}
    for name, inertia in J.items():
        phi, w = d.variable(f"{name}.phi", "rad"), d.variable(f"{name}.w", "rad/s")
        a = d.variable(f"{name}.a", "rad/s^2")
        for side in "ab":
            flange[name, side] = (
                d.variable(f"{name}.flange_{side}.phi", "rad"),
                d.variable(f"{name}.flange_{side}.tau", "N m"),
            )
            d.equation(flange[name, side][0], equals=phi)
        d.equation(w, equals=d.der(phi))
        d.equation(a, equals=d.der(w))
        d.equation(inertia * a, equals=flange[name, "a"][1] + flange[name, "b"][1])
    (phi_a, tau_a), (phi_b, tau_b) = flange["J1", "b"], flange["J2", "a"]
    linear, alpha = d.variable("spring.tau_l", "N m"), d.variable("spring.alpha")
    spring = d.variable("spring.tau", "N m")
    d.equation(linear, "linear", equals=-100 * (phi_a - phi_b))
    d.equation(alpha, "alpha", equals=(phi_a - phi_b) ** 2 / d.number(0.25))
    d.equation(spring, "spring", equals=linear * (1 + alpha))
    d.equation(tau_a, equals=spring)
    d.equation(tau_b, equals=-spring)
    d.equation(flange["J1", "a"][1], equals=tau)
    d.equation(flange["J2", "b"][1], equals=0)
    d.output("phi", d.variable("sensor.phi", "rad"), "rad")
    d.equation(ca.SX(flange["J2", "b"][0]), equals=_symbol(d, "sensor.phi"))
    return d.dae()


def _symbol(d: DaeDraft, name: str) -> ca.SX:
    return d._variables[name].symbol


def pendulum(side: float = 0.0) -> Dae:
    """A point mass on a rod in Cartesian coordinates: index 3."""
    length = Parameter("L", 1.5, percent=20, unit="m")
    return dae_of(
        "pendulum",
        f"x[m]={side} y[m]=-1.5 vx[m/s] vy[m/s] F[N]",
        "x: der(x) = vx",
        "y: der(y) = vy",
        "across: m*der(vx) = -x/L*F + f",
        f"down: m*der(vy) = -y/L*F - m*number({GRAVITY})",
        "length: x*x + y*y = L*L",
        inputs="f[N]",
        outputs="x",
        parameters=[length, Parameter("m", 2.0, percent=20, unit="kg")],
    )


def coupled_inertias() -> Dae:
    """Two rigidly coupled inertias: index 3."""
    inertias = [Parameter(f"J{k}", float(k), percent=30, unit="kg m^2") for k in (1, 2)]
    return dae_of(
        "coupled",
        "t[N m] phi1[rad] phi2[rad] w1[rad/s] w2[rad/s]",
        "der(phi1) = w1",
        "der(phi2) = w2",
        "J1*der(w1) = tau - t",
        "J2*der(w2) = t",
        "gear: phi1 = 3*phi2",
        inputs="tau[N m]",
        outputs="w2",
        parameters=inertias,
    )


def servo() -> Dae:
    """A DC motor with a gear, a shaft that twists, friction, a load, and a limited voltage."""
    d = DaeDraft("servo")
    R = d.parameter(Parameter("R", 0.5, percent=20, unit="Ohm"))
    J = d.parameter(Parameter("J", 0.02, percent=50, unit="kg m^2"))
    k = d.parameter(Parameter("k", 40.0, percent=20, unit="N m/rad"))
    demand, v = d.input("demand", "V"), d.variable("v", "V")
    i, tau = d.variable("i", "A"), d.variable("tau", "N m")
    w, wl = d.variable("w", "rad/s"), d.variable("wl", "rad/s")
    twist, friction = d.variable("twist", "rad"), d.variable("friction", "N m")
    K, L, Jm, ratio = d.number(0.05), d.number(0.001), d.number(1e-4), 10
    d.equation(v, "limit", equals=ca.fmin(ca.fmax(demand, -12), 12))
    d.equation(L * d.der(i), "winding", equals=v - R * i - K * w)
    d.equation(Jm * d.der(w), "rotor", equals=K * i - tau / ratio)
    d.equation(d.der(twist), "shaft", equals=w / ratio - wl)
    d.equation(tau, "spring", equals=k * twist)
    d.equation(J * d.der(wl), "load", equals=tau - friction)
    d.equation(friction, "friction", equals=d.number(0.2) * ca.tanh(wl / d.number(0.1)))
    d.output("wl")
    return d.dae()


class Known(NamedTuple):
    """A DAE cut from an explicit system, and that system's A, B, C as functions of the parameters."""

    dae: Dae
    states: tuple[str, ...]
    index: int
    matrices: ca.Function


def random_dae(seed: int) -> Known:
    """An explicit system with an equilibrium at zero, hidden in a DAE of index seed modulo 4."""
    return _Random(seed).made()


class _Random:
    def __init__(self, seed: int) -> None:
        self.r, self.index = np.random.default_rng(seed), seed % 4
        self.d = DaeDraft(f"random{seed}")
        self.n = int(self.r.integers(1, 5))
        count = int(self.r.integers(1, 4))
        self.p = [
            self.d.parameter(
                Parameter(f"p{k}", float(self.r.integers(1, 5)), percent=float(self.r.integers(5, 30)))
            )
            for k in range(count)
        ]
        self.u = self.d.input("u")
        self.x = [self.d.variable(f"x{k}") for k in range(self.n)]

    def number(self) -> ca.SX:
        return self.d.number(round(float(self.r.uniform(-2, 2)), 2) or 1.0)

    def coefficient(self) -> ca.SX:
        p, q = (self.p[int(k)] for k in self.r.integers(len(self.p), size=2))
        return [p, 1 / p, p * q, p / q + 1][int(self.r.integers(4))]

    def nonlinear(self, of: list[ca.SX]) -> ca.SX:
        a, b = (of[int(k)] for k in self.r.integers(len(of), size=2))
        functions = [ca.sin(a) * b, a * a * b, ca.tanh(a), ca.exp(a) - 1, a * b, a**3]
        return [*functions, ca.sqrt(1 + a * a) - 1][int(self.r.integers(7))]

    def right_side(self) -> ca.SX:
        terms = [self.number() * x * (self.coefficient() if self.r.random() < 0.5 else 1) for x in self.x]
        factor = self.coefficient() if self.r.random() < 0.5 else 1
        return sum(terms, self.number() * self.u) + factor * self.nonlinear(self.x)

    def made(self) -> Known:
        d, x = self.d, self.x
        f = [self.right_side() for _ in x]
        y = x[0] + self.number() * x[-1]
        states = [f"x{k}" for k in range(self.n)]
        left = [d.der(v) for v in x]
        if self.index == 1:
            left = [d.variable(f"z{k}") for k in range(self.n)]
            for k in range(self.n):
                d.equation(left[k], f"z{k}", equals=d.der(x[k]))
        mixed = [self.number() if k and self.index < 2 else 0 for k in range(self.n)]
        for k in range(self.n):
            more = (mixed[k] * left[k - 1], mixed[k] * f[k - 1]) if k else (0, 0)
            d.equation(left[k] + more[0], f"e{k}", equals=f[k] + more[1])
        if self.index > 1:
            states += self.constrained()
        d.output("y", y)
        dae = d.dae()
        X, right, out = ca.vertcat(*x), in_doubles(ca.vertcat(*f)), in_doubles(y)
        slopes = [ca.jacobian(right, X), ca.jacobian(right, self.u), ca.jacobian(out, X)]
        at = [ca.substitute(s, ca.vertcat(X, self.u), ca.SX.zeros(self.n + 1)) for s in slopes]
        symbols = ca.vertcat(*self.p)
        return Known(dae, tuple(states), self.index, ca.Function("known", [symbols], at))

    def constrained(self) -> list[str]:
        """A variable that follows from others, and the force that makes it do so."""
        d, w, force = self.d, self.d.variable("w"), self.d.variable("force")
        acting = self.coefficient() * force + self.nonlinear(self.x)
        if self.index == 2:
            d.equation(d.der(w), "moved", equals=acting)
            d.equation(w, "constraint", equals=self.number() * self.x[0] + self.nonlinear(self.x))
            return []
        v, position = d.variable("v"), d.variable("position")
        d.equation(d.der(position), "position", equals=self.x[0])
        d.equation(d.der(w), "rate", equals=v)
        d.equation(d.der(v), "moved", equals=acting)
        d.equation(w, "constraint", equals=self.number() * position + self.nonlinear([position]))
        return ["position"]
