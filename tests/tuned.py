"""Loops of random plants with controllers of a fixed structure, their gains, and BFGS as a second tuner.

Nothing here is of the package. A plant has rows or entries of [A B] that are multiplied or divided by a
parameter; w drives its states and its measurements, z is a part of the states and u. A controller is a
matrix K = K_0 + sum x_k K_k of [its states ; y] to [their rates ; u], and the closed loop is

    X + (sum of what K sees) K (what it drives),      X = [A 0 B_1 ; 0 0 0 ; C_1 0 0].
"""

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array

KINDS = ("gain", "PID", "transfer", "states")
FILTER = 50.0  # of a derivative, rad/s
GRID, ZOOMS = 60, 2  # frequencies; rounds between neighbors of the largest


class Plant(NamedTuple):
    """[A B_1 B_2 ; C_1 0 D_12 ; C_2 D_21 0] at nominal, and the power of each parameter in each entry."""

    matrix: Array
    powers: Array  # (parameters, rows, columns)
    ranges: Array  # (parameters, 2), around 1
    sizes: tuple[int, int, int, int, int]  # states, w, u, z, y

    def at(self, values: Array) -> Array:
        """The matrices (m, ., .) at values (m, parameters)."""
        return np.asarray(self.matrix * np.prod(values[:, :, None, None] ** self.powers, axis=1))

    def texts(self) -> list[list[str]]:
        """Entries with the parameters p0, p1, ... in them."""

        def text(i: int, j: int) -> str:
            power = {0: "", 1: "*p{}", -1: "/p{}"}
            factors = [power[int(e)].format(k) for k, e in enumerate(self.powers[:, i, j])]
            return repr(float(self.matrix[i, j])) + "".join(factors)

        return [[text(i, j) for j in range(self.matrix.shape[1])] for i in range(len(self.matrix))]

    def points(self, random: np.random.Generator, count: int) -> Array:
        """Nominal, all corners, random points."""
        corners = np.array(list(product(*self.ranges)))
        inside = random.uniform(*self.ranges.T, (count, len(self.ranges)))
        return np.vstack([np.ones((1, len(self.ranges))), corners, inside])


def random_plant(random: np.random.Generator, kind: str) -> Plant:
    """Masses with springs, or anything; some are not stable."""
    nu, ny = (1, 1) if kind in ("PID", "transfer") else random.integers(1, 3, 2)
    if random.random() < 0.5:
        half = int(random.integers(1, 4))
        n, root = 2 * half, random.standard_normal((half, half))
        stiffness = root @ root.T + (0.5 - (random.random() < 0.3)) * np.eye(half)
        A = np.block([[np.zeros((half, half)), np.eye(half)], [-stiffness, -0.05 * np.eye(half)]])
        B = np.vstack([np.zeros((half, nu)), random.standard_normal((half, nu))])
    else:
        n = int(random.integers(2, 6))
        A = random.standard_normal((n, n)) - random.uniform(0.0, 1.5) * np.eye(n)
        B = random.standard_normal((n, nu))
    nz = int(random.integers(1, 3))
    B1, C1, C2 = (random.standard_normal(shape) for shape in ((n, 1), (nz, n), (ny, n)))
    rows = [
        np.hstack([A, B1, np.zeros((n, ny)), B]),
        np.hstack([C1, np.zeros((nz, 1 + ny + nu))]),
        np.hstack([np.zeros((nu, n + 1 + ny)), random.uniform(0.1, 1.0) * np.eye(nu)]),
        np.hstack([C2, np.zeros((ny, 1)), random.uniform(0.01, 0.3) * np.eye(ny), np.zeros((ny, nu))]),
    ]
    matrix = np.round(np.vstack(rows), 4)
    count = int(random.integers(1, 4))
    powers = np.zeros((count, *matrix.shape), dtype=int)
    for k in range(count):
        i = int(random.integers(0, n))
        where = slice(None) if random.random() < 0.4 else int(random.integers(0, n))
        powers[k, i, where] = random.choice([-1, 1])
    width = random.uniform(0.05, 0.4, (count, 1))
    return Plant(
        matrix, powers, np.hstack([1.0 - width, 1.0 + width]), (n, 1 + ny, int(nu), nz + int(nu), int(ny))
    )


class Structure(NamedTuple):
    """K = base + sum of values and moves, and its number of states."""

    states: int
    base: Array
    moves: Array  # (values, states + u, states + y)

    def at(self, x: Array) -> Array:
        """K."""
        return np.asarray(self.base + np.tensordot(x, self.moves, 1))


def structure(kind: str, order: int, nu: int, ny: int) -> Structure:
    """Of what is free, each entry."""
    order = {"gain": 0, "PID": 2}.get(kind, order)
    base, free = np.zeros((order + nu, order + ny)), np.ones((order + nu, order + ny))
    if kind == "transfer":  # a companion
        base[: order - 1, 1:order], base[order - 1, order] = np.eye(order - 1), 1.0
        free[: order - 1], free[order - 1, order] = 0.0, 0.0
    if kind == "PID":  # y is kp e + ki x_1 + kd N (e - x_2)
        base = np.array([[0.0, 0.0, 1.0], [0.0, -FILTER, FILTER], [0.0, 0.0, 0.0]])
        moves = np.zeros((3, 3, 3))
        moves[0, 2, 2] = moves[1, 2, 0] = 1.0
        moves[2, 2] = 0.0, -FILTER, FILTER
        return Structure(2, base, moves)
    places = np.argwhere(free)
    moves = np.zeros((len(places), *free.shape))
    moves[np.arange(len(places)), places[:, 0], places[:, 1]] = 1.0
    return Structure(order, base, moves)


class Loop(NamedTuple):
    """Open loops (m, ., .) around K at some points: X + L K R, of states and channels."""

    states: int
    X: Array
    L: Array
    R: Array

    def closed(self, K: Array) -> Array:
        """[A B ; C D] at each point."""
        return np.asarray(self.X + self.L @ K @ self.R)

    def abscissa(self, K: Array) -> float:
        """The largest real part of all poles at all points."""
        return float(np.max(np.linalg.eigvals(self.closed(K)[:, : self.states, : self.states]).real))

    def largest_gain(self, K: Array, grid: int = GRID) -> float:
        """Of all points and frequencies; infinite where a loop is not stable."""
        return float(np.max(self.gains(K, grid)[0])) if self.abscissa(K) < 0.0 else np.inf

    def gains(self, K: Array, grid: int = GRID) -> tuple[Array, Array]:
        """The largest gain (m,) over frequency, and where; of loops that are stable."""
        T, n = self.closed(K), self.states
        poles, V = np.linalg.eig(T[:, :n, :n])
        C, B = T[:, n:, :n] @ V, np.linalg.solve(V, T[:, :n, n:].astype(complex))

        def at(omega: Array) -> Array:
            modes = 1.0 / (1j * omega[..., None] - poles[:, None])
            values = (C[:, None] * modes[:, :, None]) @ B[:, None] + T[:, None, n:, n:]
            squares = values @ np.conj(np.swapaxes(values, -1, -2))
            return np.asarray(np.sqrt(np.linalg.eigvalsh(squares)[..., -1]))

        sizes = np.abs(poles)
        even = np.geomspace(1e-2 * np.min(sizes), 1e2 * np.max(sizes), grid)
        of_poles = [np.abs(poles.imag), sizes, np.abs(poles.imag) + np.abs(poles.real)]
        every = np.hstack([np.zeros((len(T), 1)), np.tile(even, (len(T), 1)), *of_poles])
        line, omega = np.arange(len(T)), np.sort(every, axis=1)
        best = top = np.zeros(len(T))
        for _ in range(1 + ZOOMS):
            values = at(omega)
            k = np.argmax(values, axis=1)
            best, top = values[line, k], omega[line, k]
            # a pair of poles gives the same frequencies twice
            before = np.max(np.where(omega < top[:, None], omega, omega[:, :1]), axis=1)
            after = np.min(np.where(omega > top[:, None], omega, omega[:, -1:]), axis=1)
            omega = np.linspace(before, after, 17).T
        direct = np.linalg.norm(T[:, n:, n:], 2, (-2, -1))
        return np.maximum(best, direct), np.where(direct > best, np.inf, top)


def loop(plant: Plant, states: int, values: Array) -> Loop:
    """Of a controller with some states, at values (m, parameters) of the plant."""
    n, nw, nu, nz, ny = plant.sizes
    P = plant.at(values)
    m, N = len(P), n + states
    X, L = np.zeros((m, N + nz, N + nw)), np.zeros((m, N + nz, states + nu))
    R = np.zeros((m, states + ny, N + nw))
    X[:, :n, :n], X[:, :n, N:] = P[:, :n, :n], P[:, :n, n : n + nw]
    X[:, N:, :n], X[:, N:, N:] = P[:, n : n + nz, :n], P[:, n : n + nz, n : n + nw]
    L[:, n:N, :states] = R[:, :states, n:N] = np.eye(states)
    L[:, :n, states:], L[:, N:, states:] = P[:, :n, n + nw :], P[:, n : n + nz, n + nw :]
    R[:, states:, :n], R[:, states:, N:] = P[:, n + nz :, :n], P[:, n + nz :, n : n + nw]
    return Loop(N, X, L, R)


def largest_real_part(loop: Loop, of: Structure, x: Array) -> tuple[float, Array]:
    """The abscissa, and its slope."""
    T, n = loop.closed(of.at(x)), loop.states
    poles, V = np.linalg.eig(T[:, :n, :n])
    i, k = np.unravel_index(np.argmax(poles.real), poles.shape)
    try:
        left = np.linalg.inv(V[i])[k]
    except np.linalg.LinAlgError:
        return float(poles[i, k].real), np.zeros(len(x))
    slope = [(left @ loop.L[i, :n] @ move @ loop.R[i, :, :n] @ V[i][:, k]).real for move in of.moves]
    return float(poles[i, k].real), np.array(slope)


def largest_gain(loop: Loop, of: Structure, x: Array) -> tuple[float, Array]:
    """Of all points and frequencies, and its slope; infinite where a loop is not stable."""
    K, n = of.at(x), loop.states
    if not loop.abscissa(K) < 0.0:
        return np.inf, np.zeros(len(x))
    gains, omega = loop.gains(K)
    i = int(np.argmax(gains))
    T = loop.closed(K)[i]
    if np.isinf(omega[i]):
        row, column = np.zeros((len(T) - n, n)), np.zeros((n, T.shape[1] - n))
    else:
        inverse = np.linalg.inv(1j * omega[i] * np.eye(n) - T[:n, :n])
        row, column = T[n:, :n] @ inverse, inverse @ T[:n, n:]
    u, _, vh = np.linalg.svd(T[n:, n:] + T[n:, :n] @ column)
    left = u[:, 0].conj() @ np.hstack([row, np.eye(len(row))])
    right = np.vstack([column, np.eye(column.shape[1])]) @ vh[0].conj()
    slope = [(left @ loop.L[i] @ move @ loop.R[i] @ right).real for move in of.moves]
    return float(gains[i]), np.array(slope)


def bfgs(function: Callable[[Array], tuple[float, Array]], x: Array, steps: int, enough: float) -> Array:
    """BFGS with a bisection for weak Wolfe steps, until a value is below enough or nothing descends."""
    value, slope = function(x)
    H = np.eye(len(x))
    for _ in range(steps):
        d = -H @ slope
        if not slope @ d < 0.0 or value <= enough:
            break
        low, high, length, taken = 0.0, np.inf, 1.0 if np.any(np.eye(len(x)) != H) else 0.1, None
        for _ in range(30):
            new, new_slope = function(x + length * d)
            if not new < value + 1e-4 * length * (slope @ d):
                high = length
            else:
                taken = length, new, new_slope
                if new_slope @ d > 0.9 * (slope @ d):
                    break
                low = length
            length = 0.5 * (low + high) if np.isfinite(high) else 2.0 * length
        if taken is None:
            break
        s, y = taken[0] * d, taken[2] - slope
        if (sy := float(s @ y)) > 0.0:
            V = np.eye(len(x)) - np.outer(s, y) / sy
            H = V @ H @ V.T + np.outer(s, s) / sy
        is_last = value - taken[1] < 1e-8 * abs(value)
        x, value, slope = x + s, taken[1], taken[2]
        if is_last:
            break
    return x


def rivals(
    loop: Loop, of: Structure, random: np.random.Generator, starts: int
) -> list[tuple[float, Array]]:
    """Largest gains and K of starts that became stable, the best first."""
    found = list[tuple[float, Array]]()
    for _ in range(starts):
        x = random.standard_normal(len(of.moves)) * 10.0 ** random.uniform(-1.0, 1.0)
        x = bfgs(lambda x: largest_real_part(loop, of, x), x, 100, -1e-6)
        if largest_real_part(loop, of, x)[0] < 0.0:
            x = bfgs(lambda x: largest_gain(loop, of, x), x, 300, 0.0)
            found.append((largest_gain(loop, of, x)[0], of.at(x)))
    return sorted(found, key=lambda pair: pair[0])


def controller(kind: str, values: dict[str, float], of: Structure) -> Array:
    """K of the values of a tuned controller, by the names that the docs give them."""
    if kind == "PID":
        return of.at(np.array([values[f"K.{name}"] for name in ("kp", "ki", "kd")]))
    n, K = of.states, of.base.copy()
    if kind == "transfer":
        a, b = (np.array([values[f"K.{label}{k}"] for k in range(n)]) for label in "ab")
        K[n - 1, :n], K[n, :n], K[n, n] = -a, b - values[f"K.b{n}"] * a, values[f"K.b{n}"]
        return K
    for label, rows, columns in (("A", 0, 0), ("B", 0, n), ("C", n, 0), ("D", n, n)):
        shape: Any = (n if label in "AB" else len(K) - n, n if label in "AC" else K.shape[1] - n)
        for i, j in np.ndindex(shape):
            K[rows + i, columns + j] = values[f"K.{label}[{i + 1},{j + 1}]"]
    return K
