"""Small deltas that make I - M Delta singular: lower bounds of the structured singular value.

Blocks that are fixed have size 1, the others grow: Delta_f and Delta_g/lambda with ||Delta|| <= 1. A
positive number lambda with

    M Delta_g v = lambda (I - M Delta_f) v

is a lower bound; the size of those that grow is 1/lambda, and bounds a margin from above. Starts come
from the power iteration of Young, Doyle (Computation of mu with real and complex uncertainties, CDC 1990)
and at random; from each, lambda is made as large as it becomes while it stays real, by sequential
quadratic programming with exact slopes, for u'(I - M Delta_f) v = 1:

    d lambda = u' [M dDelta_g + lambda M dDelta_f + dM (Delta_g + lambda Delta_f)] v

in real deltas, phases, the vectors of full blocks (of rank one), and, if it is free, the frequency.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig

from mbdlft.base.array import Array
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.lft.block import Block
from mbdlft.robust.ascent import by_damping
from mbdlft.robust.mu.coverage import Loop
from mbdlft.robust.mu.intervals import channels_matrix

_ITERATIONS, _STARTS = 60, 4  # of the power iteration, which often cycles; pairs of starts
_STEPS, _TURNS = 60, 8  # of the ascent; rounds in which phases are turned
_REAL = 1e-7  # imaginary part of an eigenvalue, of its size, that counts as zero
_ENOUGH = 1e-6  # of a bound that need not be improved
_CLEAR = 1e-12  # of the norm of M: an eigenvalue below this is zero
_FAR = 1e12  # of the norm of M: a larger eigenvalue says that fixed blocks alone are enough
_TINY = 1e-300  # in place of a size of 0 that is divided by
_CORNERS = 4  # of real deltas, at random
_MOST = 24  # frequencies of poles

Complex = NDArray[np.complex128]
At = Callable[[float], tuple[Complex, Complex]]  # M and its derivative by log omega
Grows = Sequence[bool] | NDArray[np.bool_]


class SmallDelta(NamedTuple):
    """A Delta that makes I - M Delta singular."""

    bound: float  # one over the norm of the blocks that grow; 0, with a `delta` of 0, if none was found
    delta: Complex  # (n_w, n_z)
    residual: float  # smallest over largest singular value of I - M Delta
    omega: float = float("nan")  # where M is taken (rad/s); NaN if M was given as a matrix


class _Place(NamedTuple):
    """A block, and its rows and columns of M.

    Its variables are a real delta, a phase, or, of a full block a b'/(|a||b|), the parts of a and b.
    """

    block: Block
    z: slice
    w: slice
    grows: bool

    def put(self, into: Complex, value: Any) -> None:
        eye = np.eye(self.block.size) if self.block.kind != "full" else 1.0
        into[self.w, self.z] = value * eye

    def facing(self, w: Complex, z: Complex) -> Any:
        """The value of size 1 of a block that is not real for which w'Delta z is largest."""
        return _phase(np.vdot(z, w)) if self.block.kind == "complex" else _unit_dyad(w, z)

    def random(self, random: Any) -> Any:
        """A value of size 1: an end of a real delta."""
        if self.block.kind == "real":
            return random.choice([-1.0, 1.0])
        if self.block.kind == "complex":
            return np.exp(2j * np.pi * random.uniform())
        u, v = (random.standard_normal(2 * n) for n in (self.block.outputs, self.block.inputs))
        return _unit_dyad(u[::2] + 1j * u[1::2], v[::2] + 1j * v[1::2])

    def variables(self, delta: Complex) -> Array:
        """The variables of a Delta of norm 1."""
        here = delta[self.w, self.z]
        if self.block.kind == "real":
            return np.array([here[0, 0].real])
        if self.block.kind == "complex":
            return np.array([np.angle(here[0, 0])])
        u, _, v = np.linalg.svd(here)
        whole = np.concatenate([u[:, 0], v[0].conj()])
        return np.concatenate([whole.real, whole.imag])

    def vectors(self, x: Array) -> tuple[Complex, Complex]:
        """a and b of the variables."""
        n = self.block.outputs
        both = x[: n + self.block.inputs] + 1j * x[n + self.block.inputs :]
        return both[:n], both[n:]

    def value(self, x: Array) -> Any:
        """The value for the variables."""
        if self.block.kind == "real":
            return float(np.clip(x[0], -1.0, 1.0))
        return np.exp(1j * x[0]) if self.block.kind == "complex" else _unit_dyad(*self.vectors(x))

    def slopes(self, x: Array, delta: Complex, p: Complex, v: Complex) -> Complex:
        """Derivatives of p Delta v by the variables."""
        p, v = p[self.w], v[self.z]
        if self.block.kind == "real":
            return np.array([p @ v])
        value = p @ delta[self.w, self.z] @ v
        if self.block.kind == "complex":
            return np.array([1j * value])
        a, b = self.vectors(x)
        sizes = max(float(np.linalg.norm(a)), _TINY), max(float(np.linalg.norm(b)), _TINY)
        by_a, by_b = p * (b.conj() @ v) / (sizes[0] * sizes[1]), (p @ a) * v / (sizes[0] * sizes[1])
        more_a, more_b = value / sizes[0] ** 2, value / sizes[1] ** 2
        real = [by_a - more_a * a.real, by_b - more_b * b.real]
        return np.concatenate([*real, 1j * by_a - more_a * a.imag, -1j * by_b - more_b * b.imag])


def small_delta(
    M: Complex, blocks: Sequence[Block], enough: float = np.inf, grows: Grows | None = None
) -> SmallDelta:
    """The smallest Delta of the blocks that was found to make I - M Delta singular.

    The search ends when its bound is nearly `enough`, such as an upper bound. Blocks that do not grow
    are of size 1.
    """
    grows = [True] * len(blocks) if grows is None else grows
    return delta_near(lambda _: (M, 0.0 * M), blocks, grows, starts=_STARTS, enough=enough)


def delta_near(
    at: At,
    blocks: Sequence[Block],
    grows: Grows,
    omega: float = float("nan"),
    real: Array | None = None,
    starts: int = 1,
    enough: float = np.inf,
) -> SmallDelta:
    """The same near a frequency, which moves, too; `real` are real deltas of size 1 to begin with."""
    places, M, random = _places_of(blocks, grows), at(omega)[0], np.random.default_rng(0)
    best = SmallDelta(0.0, np.zeros(M.T.shape, dtype=complex), 1.0, omega)
    size = float(np.linalg.norm(M, 2)) if M.size else 0.0
    for _ in range(starts if size else 0):
        if best.bound >= enough * (1.0 - _ENOUGH):
            break
        units = [_iterated(M / size, places, random)]
        if np.isnan(omega):
            units.append(np.zeros_like(best.delta))
            for place in places:
                place.put(units[1], place.random(random))
        if real is not None:
            of_real = [place for place in places if place.block.kind == "real"]
            for value, place in zip(real, of_real, strict=True):
                place.put(units[0], value)
            _turn(M, units[0], places)
        for unit in units:
            reached = _enlarged(at, places, unit, omega)
            best = reached if reached.bound > max(best.bound, _CLEAR * size) else best
    return best


def _places_of(blocks: Sequence[Block], grows: Grows) -> list[_Place]:
    places, z, w = [], 0, 0
    for block, grow in zip(blocks, grows, strict=True):
        rows, columns = slice(z, z + block.inputs), slice(w, w + block.outputs)
        places.append(_Place(block, rows, columns, bool(grow)))
        z, w = z + block.inputs, w + block.outputs
    return [place for place in places if place.block.inputs and place.block.outputs]


def _iterated(M: Complex, places: Sequence[_Place], random: Any) -> Complex:
    """The Delta of norm 1 to which the power iteration leads, or comes near."""
    n_z, n_w = M.shape

    def unit(n: int) -> Complex:
        x = random.standard_normal(n) + 1j * random.standard_normal(n)
        return np.asarray(x / np.linalg.norm(x))

    def normed(x: Complex) -> Complex:
        return np.asarray(x / max(float(np.linalg.norm(x)), _TINY))

    b, w = unit(n_w), unit(n_w)
    q = np.ones(len(places))
    for _ in range(_ITERATIONS):
        a = normed(M @ b)
        z = _aligned(places, q, a, b, w, n_z, to_z=True)
        w = normed(M.conj().T @ z)
        b = _aligned(places, q, a, b, w, n_w, to_z=False)
    delta = np.zeros((n_w, n_z), dtype=complex)
    for k, place in enumerate(places):
        place.put(delta, q[k] if place.block.kind == "real" else place.facing(w[place.w], a[place.z]))
    return delta


def _aligned(
    places: Sequence[_Place], q: Array, a: Complex, b: Complex, w: Complex, size: int, *, to_z: bool
) -> Complex:
    """z from a and w, or b from them; the real deltas q are moved on the way."""
    vector = np.zeros(size, dtype=complex)
    for k, (block, rows, columns, _) in enumerate(places):
        x, y = a[rows], w[columns]
        here = rows if to_z else columns
        source = y if to_z else x
        sizes = max(float(np.linalg.norm(x)), _TINY), max(float(np.linalg.norm(y)), _TINY)
        if block.kind == "real":
            old = float(np.linalg.norm(b[columns])) / sizes[0]
            q[k] = np.clip(np.sign(q[k] or 1.0) * old + float(np.vdot(x, y).real), -1.0, 1.0)
            vector[here] = q[k] * source
        elif block.kind == "complex":
            vector[here] = (_phase(np.vdot(y, x)) if to_z else _phase(np.vdot(x, y))) * source
        else:
            vector[here] = x * sizes[1] / sizes[0] if to_z else y * sizes[0] / sizes[1]
    return vector


def _turn(M: Complex, unit: Complex, places: Sequence[_Place]) -> None:
    """Turn blocks that are not real so that lambda is positive, and large for the real deltas given."""
    for _ in range(_TURNS):
        lam, u, v = _eigen(M, unit, places, nearly_real=False)
        p = u @ M
        for place in places:
            a, z = (1.0 if place.grows else lam) * p[place.w], v[place.z]
            size = float(np.linalg.norm(a) * np.linalg.norm(z))
            if place.block.kind != "real" and np.isfinite(size) and size > 0.0:
                place.put(unit, place.facing(a.conj(), z))


def _phase(number: Any) -> complex:
    return complex(number / abs(number)) if number else 1.0


def _unit_dyad(a: Complex, b: Complex) -> Complex:
    """a b'/(|a||b|)."""
    size = max(float(np.linalg.norm(a)) * float(np.linalg.norm(b)), _TINY)
    return np.asarray(np.outer(a, b.conj()) / size)


class _Near(NamedTuple):
    """Delta by the variables of its places, near a frequency that may move: log omega is the last one."""

    at: At
    places: Sequence[_Place]
    shape: tuple[int, ...]
    ends: NDArray[np.int_]  # of the variables of each place
    omega: float
    moves: bool

    def split(self, x: Array) -> tuple[list[Array], Complex, float]:
        """The variables of each place, their Delta, and the frequency."""
        variables = np.split(x[: self.ends[-1]], self.ends[:-1])
        delta = np.zeros(self.shape, dtype=complex)
        for place, here in zip(self.places, variables, strict=True):
            place.put(delta, place.value(here))
        return variables, delta, self.omega * float(np.exp(x[-1])) if self.moves else self.omega

    def value(self, x: Array) -> tuple[complex, Complex]:
        """lambda, and its derivatives."""
        variables, delta, w = self.split(x)
        M, turned = self.at(w)
        lam, u, v = _eigen(M, delta, self.places)
        weights = [1.0 if place.grows else lam for place in self.places]
        p = u @ M
        slopes = [
            weight * place.slopes(here, delta, p, v)
            for place, here, weight in zip(self.places, variables, weights, strict=True)
        ]
        if self.moves:
            moved = np.zeros(delta.shape[0], dtype=complex)
            for place, weight in zip(self.places, weights, strict=True):
                moved[place.w] = weight * (delta[place.w, place.z] @ v[place.z])
            slopes.append(np.array([u @ turned @ moved]))
        return lam, np.concatenate(slopes)


def _enlarged(at: At, places: Sequence[_Place], unit: Complex, omega: float) -> SmallDelta:
    """The real positive lambda nearest to what Delta begins with, made large; omega may move."""
    from scipy.optimize import minimize  # here because it is slow to import

    first = [place.variables(unit) for place in places]
    moves = bool(0.0 < omega < np.inf)
    near = _Near(at, places, unit.shape, np.cumsum([len(x) for x in first]), omega, moves)
    start = np.concatenate([*first, np.zeros(int(moves))])

    @lru_cache(maxsize=1)  # objective, constraint and slopes are asked for at the same point
    def value(x: bytes) -> tuple[complex, Complex]:
        return near.value(np.frombuffer(x))

    size = max(abs(value(start.tobytes())[0]), 1e-12 * float(np.linalg.norm(at(omega)[0])))

    def objective(x: Array) -> tuple[float, Array]:
        eigenvalue, slopes = value(x.tobytes())
        return -eigenvalue.real / size, -slopes.real / size

    limits: list[tuple[float | None, float | None]] = []
    for place, x in zip(places, first, strict=True):
        limits += [(-1.0, 1.0) if place.block.kind == "real" else (None, None)] * len(x)
    limits += [(-1.0, 1.0)] * moves
    is_real = {
        "type": "eq",
        "fun": lambda x: value(x.tobytes())[0].imag / size,
        "jac": lambda x: value(x.tobytes())[1].imag / size,
    }
    solution = minimize(
        objective,
        start,
        jac=True,
        bounds=limits,
        constraints=is_real,
        method="SLSQP",
        options={"maxiter": _STEPS, "ftol": 1e-12},
    )
    _, delta, w = near.split(solution.x if np.all(np.isfinite(solution.x)) else start)
    return _verified(at(w)[0], delta, places)._replace(omega=w)


def _sides(M: Complex, delta: Complex, places: Sequence[_Place]) -> tuple[Complex, Complex]:
    """M Delta_g and I - M Delta_f."""
    grown, kept = delta.copy(), delta.copy()
    for place in places:
        (kept if place.grows else grown)[place.w, place.z] = 0.0
    return M @ grown, np.eye(len(M)) - M @ kept


def _eigen(
    M: Complex, delta: Complex, places: Sequence[_Place], *, nearly_real: bool = True
) -> tuple[complex, Complex, Complex]:
    """The lambda nearest to being real and large, u' over u'(I - M Delta_f) v, and v."""
    with_grown, with_fixed = _sides(M, delta, places)
    values, u, v = eig(with_grown, with_fixed, left=True, right=True)
    far = _FAR * max(float(np.linalg.norm(M)), _TINY)
    sizes = np.where(np.isfinite(values) & (np.abs(values) < far), values, 0.0)
    rank = sizes.real - 2.0 * np.abs(sizes.imag) if nearly_real else np.abs(sizes)
    chosen = int(np.argmax(rank))
    w = u[:, chosen].conj()
    scale = w @ with_fixed @ v[:, chosen]
    return complex(sizes[chosen]), w / (scale or _TINY), v[:, chosen]


def _verified(M: Complex, unit: Complex, places: Sequence[_Place]) -> SmallDelta:
    """What a Delta of norm at most 1 proves: by its largest real positive lambda."""
    with_grown, with_fixed = _sides(M, unit, places)
    values = eig(with_grown, with_fixed, right=False)
    far = _FAR * max(float(np.linalg.norm(M)), _TINY)
    values = values[np.isfinite(values) & (np.abs(values) < far)]
    fits = (values.real > 0.0) & (np.abs(values.imag) <= _REAL * np.abs(values))
    bound = float(np.max(values.real[fits], initial=0.0))
    if bound == 0.0:
        return SmallDelta(0.0, np.zeros_like(unit), 1.0)
    delta = unit.copy()
    for place in places:
        if place.grows:
            delta[place.w, place.z] /= bound
    sizes = np.linalg.svd(np.eye(len(M)) - M @ delta, compute_uv=False)
    return SmallDelta(bound, delta, float(sizes[-1] / sizes[0]) if sizes[0] else 0.0)


def nothing(loop: Loop) -> SmallDelta:
    """No delta."""
    shape = len(loop.structure.outputs), len(loop.structure.inputs)
    return SmallDelta(0.0, np.zeros(shape, dtype=complex), 1.0)


def matrix_and_slope(loop: Loop, omega: float) -> tuple[Complex, Complex]:
    """M(j omega) (n_z, n_w) without the zeros that make blocks square, and its slope by log omega."""
    A, B, C, _ = loop.channels
    place = np.ix_(loop.structure.inputs, loop.structure.outputs)
    M = channels_matrix(loop.channels, omega)[place]
    if not len(A) or not 0.0 < omega < np.inf:
        return M, np.zeros_like(M)
    shifted = 1j * omega * np.eye(len(A)) - A
    return M, (-1j * omega * (C @ np.linalg.solve(shifted, np.linalg.solve(shifted, B))))[place]


def best_near(
    loop: Loop, best: SmallDelta, omega: float, real: Array | None = None, starts: int = 1
) -> SmallDelta:
    """The better of what was known and of what is found near a frequency, and near real deltas."""
    if 0.0 < omega < np.inf:
        at = partial(matrix_and_slope, loop)
        reached = delta_near(at, loop.blocks, loop.grows, omega, real, starts)
    else:
        M = matrix_and_slope(loop, omega)[0]
        reached = small_delta(M, loop.blocks, grows=loop.grows)._replace(omega=omega)
    return reached if reached.bound > best.bound else best


def first_reached(loop: Loop) -> SmallDelta:
    """The smallest delta that is found from frequencies of the poles, and from corners."""
    A, best = loop.channels.A, nothing(loop)
    poles = eigenvalues_of(A) if len(A) else np.ones(1)
    for omega in np.unique([*np.abs(poles[by_damping(poles)][:_MOST]), 0.0, np.inf]).tolist():
        best = best_near(loop, best, omega)
    if not best.bound:
        return best
    best = best_near(loop, best, best.omega, starts=3)
    count = sum(block.kind == "real" for block in loop.blocks)
    random = np.random.default_rng(0)
    for corner in np.sign(random.uniform(-1.0, 1.0, (_CORNERS if count else 0, count))):
        best = best_near(loop, best, best.omega, corner)
    return best


def by_name(loop: Loop, delta: Complex) -> dict[str, Any]:
    """Numbers and matrices of the blocks of a Delta (n_w, n_z)."""
    values: dict[str, Any] = {}
    for block, z, w, _ in _places_of(loop.blocks, loop.grows):
        value = delta[w, z]
        if block.kind == "real":
            values[block.name] = float(value[0, 0].real)
        else:
            values[block.name] = complex(value[0, 0]) if block.kind == "complex" else value.copy()
    return values


def changes(loop: Loop, small: SmallDelta) -> Array:
    """Derivatives (number of blocks,) of the bound by the logarithm of the size of each block."""
    M = matrix_and_slope(loop, small.omega)[0]
    places, unit = _places_of(loop.blocks, loop.grows), small.delta.copy()
    for place in places:
        if place.grows:
            unit[place.w, place.z] *= small.bound
    lam, u, v = _eigen(M, unit, places)
    p = u @ M
    return np.array(
        [
            ((1.0 if place.grows else lam) * (p[place.w] @ unit[place.w, place.z] @ v[place.z])).real
            for place in places
        ]
    )
