"""Linear equations of a mechanism from its energies, by CasADi; nothing of this package is used.

    d/dt dT/dv - dT/dq + dV/dq + dR/dv = G(q)' lambda + dP/dv

T is the kinetic and V the potential energy, R half of the power that dampers take, P the power of the
inputs u, and G the slopes of constraints c(q) = 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

SX = ca.SX


@dataclass
class Energies:
    """Coordinates by the names that the scene gives them, with their place at rest, and energies."""

    names: Sequence[str]
    inputs: Sequence[str]  # names; empty for an effort that holds and is no input of the scene
    rest: Sequence[float]
    given: Mapping[int, float]  # inputs whose value at rest is known

    def __post_init__(self) -> None:
        self.q, self.v = SX.sym("q", len(self.names)), SX.sym("v", len(self.names))
        self.u = SX.sym("u", len(self.inputs))
        self.T = self.V = self.R = self.P = SX(0)
        self.gaps = SX(0, 1)
        self.speeds = np.zeros(len(self.names))

    def rate(self, of: Any) -> Any:
        return ca.jtimes(of, self.q, self.v)

    def at_rest(self, of: Any) -> float:
        return float(ca.evalf(ca.substitute(of, self.q, ca.DM(self.rest))))

    def point(self, mass: Any, place: Any, g: float = 0.0) -> None:
        """A mass at a place of two or three components, of which the last one is up."""
        rate = self.rate(place)
        self.T += mass * ca.dot(rate, rate) / 2
        self.V += mass * g * place[-1]

    def body(self, mass: Any, inertia: Any, center: Any, place: Any, R: Any, g: float = 0.0) -> None:
        """A rigid body whose frame is at `place` with axes R, and its moments in these."""
        self.point(mass, place + R @ SX(center), g)
        turn = spin(R, self)
        self.T += turn.T @ SX(inertia) @ turn / 2

    def linear(self, states: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Accelerations of the coordinates `states` by coordinates, rates and named inputs."""
        n, count = len(self.names), self.gaps.numel()
        a, load = SX.sym("a", n), SX.sym("lambda", count)
        momentum = ca.gradient(self.T, self.v)
        rows = ca.jtimes(momentum, self.q, self.v) + ca.jtimes(momentum, self.v, a)
        rows += ca.gradient(self.V - self.T, self.q) + ca.gradient(self.R, self.v)
        slopes = ca.jacobian(self.gaps, self.q)
        rows -= ca.gradient(self.P, self.v) + slopes.T @ load
        point = [self.rest, self.speeds, np.zeros(n)]
        arguments = [self.q, self.v, a, self.u, load]
        efforts, loads = self._at_rest(rows, arguments, point, load)
        parts = [ca.jacobian(rows, symbol) for symbol in (a, self.q, self.v, self.u)]
        found = ca.Function("f", arguments, [*parts, slopes])(*point, efforts, loads)
        M, K, C, B, G = (np.array(part) for part in found)
        # with the accelerations that follow: G a = 0; displacements and rates follow alike
        own = [self.names.index(name) for name in states]
        moved = np.zeros((n, len(own)))
        moved[own, range(len(own))] = 1.0
        if count:
            others = [k for k in range(n) if k not in own]
            moved[others] = -np.linalg.solve(G[:, others], G[:, own])
            M = moved.T @ M @ moved
            K, C, B = moved.T @ K @ moved, moved.T @ C @ moved, moved.T @ B
            own = list(range(len(own)))
        used = [k for k, name in enumerate(self.inputs) if name]
        return (
            -np.linalg.solve(M, K)[np.ix_(own, own)],
            -np.linalg.solve(M, C)[np.ix_(own, own)],
            -np.linalg.solve(M, B)[np.ix_(own, used)],
        )

    def _at_rest(self, rows: Any, arguments: Any, point: Any, load: Any) -> tuple[Any, Any]:
        """Inputs that hold the equilibrium, and loads of the constraints."""
        efforts = np.array([self.given.get(k, 0.0) for k in range(self.u.numel())])
        unknown = [k for k in range(self.u.numel()) if k not in self.given]
        wanted = ca.vertcat(self.u[unknown], load) if unknown else load
        f = ca.Function("f", arguments, [rows, ca.jacobian(rows, wanted), self.gaps])
        left, slope, gaps = (np.array(x) for x in f(*point, efforts, np.zeros(load.numel())))
        solved = np.linalg.lstsq(slope, -left[:, 0], rcond=None)[0]
        missed = np.max(np.abs(slope @ solved + left[:, 0]), initial=np.max(np.abs(gaps), initial=0))
        if missed > 1e-9 * max(1.0, np.max(np.abs(left))):
            raise ValueError(f"no equilibrium: {missed}")
        efforts[unknown] = solved[: len(unknown)]
        return efforts, solved[len(unknown) :]


def turned(axis: Sequence[float], angle: Any) -> Any:
    """Rotation (3, 3) about a unit vector."""
    K = ca.skew(ca.DM(list(axis)))
    return SX.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)


def tilted(small: Any) -> Any:
    """Rotation (3, 3) by a small vector, right to second order: all that linear equations need."""
    K = ca.skew(small)
    return SX.eye(3) + K + K @ K / 2


def spin(R: Any, e: Energies) -> Any:
    """Angular velocity (3,) of a frame R, in its axes."""
    W = R.T @ ca.reshape(e.rate(ca.vec(R)), 3, 3)
    return ca.vertcat(W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]) / 2


def about_y(angle: Any) -> Any:
    """What takes (x, z) of a body that is turned about y to (x, z) of the scene."""
    c, s = ca.cos(angle), ca.sin(angle)
    return lambda x, z: ca.vertcat(c * x + s * z, c * z - s * x)
