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
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig

from mbdlft.base.array import Array
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

Complex = NDArray[np.complex128]
Value = TypeVar("Value")
At = Callable[[float], tuple[Complex, Complex]]  # M and its derivative by log omega
_CORNERS = 4  # of real deltas, at random
_MOST = 24  # frequencies of poles


class SmallDelta(NamedTuple):
    """A Delta that makes I - M Delta singular."""

    bound: float  # one over the norm of the blocks that grow; 0, with a `delta` of 0, if none was found
    delta: Complex  # (n_w, n_z)
    residual: float  # smallest over largest singular value of I - M Delta
    omega: float = float("nan")  # where M is taken (rad/s); NaN if M was given as a matrix


class _Place(NamedTuple):
    """A block, and its rows and columns of M."""

    block: Block
    z: slice
    w: slice
    grows: bool

    def put(self, into: Complex, value: Any) -> None:
        eye = np.eye(self.block.size) if self.block.kind != "full" else 1.0
        into[self.w, self.z] = value * eye


def small_delta(
    M: Complex,
    blocks: Sequence[Block],
    enough: float = np.inf,
    grows: Sequence[bool] | NDArray[np.bool_] | None = None,
) -> SmallDelta:
    """The smallest Delta of the blocks that was found to make I - M Delta singular.

    The search ends when its bound is nearly `enough`, such as an upper bound. Blocks that do not grow
    are of size 1.
    """
    places = _places_of(blocks, grows)
    best = SmallDelta(0.0, np.zeros(M.T.shape, dtype=complex), 1.0)
    size = float(np.linalg.norm(M, 2)) if M.size else 0.0
    if size == 0.0:
        return best
    random = np.random.default_rng(0)
    for _ in range(_STARTS):
        if best.bound >= enough * (1.0 - _ENOUGH):
            break
        for unit in (_iterated(M / size, places, random), _random(places, M.shape, random)):
            reached = _enlarged(lambda _: (M, 0.0 * M), places, unit, None)
            if reached.bound > best.bound and reached.bound > _CLEAR * size:
                best = reached
    return best


def delta_near(
    at: At,
    blocks: Sequence[Block],
    grows: Sequence[bool] | NDArray[np.bool_],
    omega: float,
    real: Array | None = None,
    starts: int = 1,
) -> SmallDelta:
    """The same near a frequency, which moves, too; `real` are real deltas of size 1 to begin with."""
    places = _places_of(blocks, grows)
    M = at(omega)[0]
    best = SmallDelta(0.0, np.zeros(M.T.shape, dtype=complex), 1.0, omega)
    size = float(np.linalg.norm(M, 2)) if M.size else 0.0
    if size == 0.0:
        return best
    random = np.random.default_rng(0)
    for _ in range(starts):
        unit = _iterated(M / size, places, random)
        if real is not None:
            of_real = [place for place in places if place.block.kind == "real"]
            for value, place in zip(real, of_real, strict=True):
                place.put(unit, value)
            _turn(M, unit, places)
        reached = _enlarged(at, places, unit, omega)
        if reached.bound > max(best.bound, _CLEAR * size):
            best = reached
    return best


def block_changes(
    M: Complex, blocks: Sequence[Block], grows: NDArray[np.bool_], small: SmallDelta
) -> Array:
    """Derivatives (number of blocks,) of the bound by the logarithm of the size of each block."""
    places, unit = _places_of(blocks, grows), small.delta.copy()
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


def _places_of(blocks: Sequence[Block], grows: Sequence[bool] | NDArray[np.bool_] | None) -> list[_Place]:
    places, z, w = [], 0, 0
    for block, grow in zip(blocks, [True] * len(blocks) if grows is None else grows, strict=True):
        rows, columns = slice(z, z + block.inputs), slice(w, w + block.outputs)
        places.append(_Place(block, rows, columns, bool(grow)))
        z, w = z + block.inputs, w + block.outputs
    return [place for place in places if place.block.inputs and place.block.outputs]


def _random(places: Sequence[_Place], shape: tuple[int, int], random: Any) -> Complex:
    """A Delta of norm 1, real deltas at their ends."""
    delta = np.zeros((shape[1], shape[0]), dtype=complex)
    for place in places:
        block = place.block
        if block.kind == "real":
            place.put(delta, random.choice([-1.0, 1.0]))
        elif block.kind == "complex":
            place.put(delta, np.exp(2j * np.pi * random.uniform()))
        else:
            u, v = (random.standard_normal(2 * n) for n in (block.outputs, block.inputs))
            u, v = (x[::2] + 1j * x[1::2] for x in (u, v))
            place.put(delta, _unit_dyad(u, v))
    return delta


def _iterated(M: Complex, places: Sequence[_Place], random: Any) -> Complex:
    """The Delta of norm 1 to which the power iteration leads, or comes near."""
    n_z, n_w = M.shape

    def unit(n: int) -> Complex:
        x = random.standard_normal(n) + 1j * random.standard_normal(n)
        return np.asarray(x / np.linalg.norm(x))

    b, w = unit(n_w), unit(n_w)
    q = np.ones(len(places))
    for _ in range(_ITERATIONS):
        a = _normed(M @ b)
        z = _aligned(places, q, a, b, w, n_z, to_z=True)
        w = _normed(M.conj().T @ z)
        b = _aligned(places, q, a, b, w, n_w, to_z=False)
    delta = np.zeros((n_w, n_z), dtype=complex)
    for k, place in enumerate(places):
        w_block, z_block = w[place.w], a[place.z]
        if place.block.kind == "real":
            place.put(delta, q[k])
        elif place.block.kind == "complex":
            place.put(delta, _phase(np.vdot(z_block, w_block)))
        else:
            place.put(delta, _unit_dyad(w_block, z_block))
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
            if place.block.kind == "real" or not np.isfinite(size) or size == 0.0:
                continue
            if place.block.kind == "complex":
                place.put(unit, np.conj(_phase(a @ z)))
            else:
                place.put(unit, np.outer(a.conj(), z.conj()) / size)


def _phase(number: Any) -> complex:
    return complex(number / abs(number)) if number else 1.0


def _normed(x: Complex) -> Complex:
    return np.asarray(x / max(float(np.linalg.norm(x)), _TINY))


def _unit_dyad(a: Complex, b: Complex) -> Complex:
    """a b'/(|a||b|)."""
    size = max(float(np.linalg.norm(a)) * float(np.linalg.norm(b)), _TINY)
    return np.asarray(np.outer(a, b.conj()) / size)


def _vectors(x: Array, block: Block) -> tuple[Complex, Complex]:
    """The vectors a and b of a full block a b'/(|a||b|)."""
    n = block.outputs
    half = x[: n + block.inputs] + 1j * x[n + block.inputs :]
    return half[:n], half[n:]


def _first(places: Sequence[_Place], unit: Complex) -> list[Array]:
    """The variables of a Delta of norm 1, one array for each part."""
    variables = []
    for place in places:
        here = unit[place.w, place.z]
        if place.block.kind == "real":
            variables.append(np.array([here[0, 0].real]))
        elif place.block.kind == "complex":
            variables.append(np.array([np.angle(here[0, 0])]))
        else:
            u, _, v = np.linalg.svd(here)
            whole = np.concatenate([u[:, 0], v[0].conj()])
            variables.append(np.concatenate([whole.real, whole.imag]))
    return variables


def _delta_of(places: Sequence[_Place], x: Sequence[Array], shape: tuple[int, ...]) -> Complex:
    delta = np.zeros(shape, dtype=complex)
    for place, here in zip(places, x, strict=True):
        if place.block.kind == "real":
            place.put(delta, float(np.clip(here[0], -1.0, 1.0)))
        elif place.block.kind == "complex":
            place.put(delta, np.exp(1j * here[0]))
        else:
            place.put(delta, _unit_dyad(*_vectors(here, place.block)))
    return delta


def _slopes(place: _Place, x: Array, delta: Complex, p: Complex, v: Complex) -> Complex:
    """Derivatives of p Delta v by the variables of a part."""
    if place.block.kind == "real":
        return np.array([p @ v])
    value = p @ delta @ v
    if place.block.kind == "complex":
        return np.array([1j * value])
    a, b = _vectors(x, place.block)
    sizes = max(float(np.linalg.norm(a)), _TINY), max(float(np.linalg.norm(b)), _TINY)
    by_a, by_b = p * (b.conj() @ v) / (sizes[0] * sizes[1]), (p @ a) * v / (sizes[0] * sizes[1])
    more_a, more_b = value / sizes[0] ** 2, value / sizes[1] ** 2
    real = [by_a - more_a * a.real, by_b - more_b * b.real]
    imaginary = [1j * by_a - more_a * a.imag, -1j * by_b - more_b * b.imag]
    return np.concatenate([*real, *imaginary])


def _once(function: Callable[[Array], Value]) -> Callable[[Array], Value]:
    """The function, evaluated once: objective, constraint and slopes are asked for at the same point."""
    last: list[tuple[Array, Value]] = []

    def of(x: Array) -> Value:
        if not last or not np.array_equal(last[0][0], x):
            last[:] = [(x.copy(), function(x))]
        return last[0][1]

    return of


def _enlarged(at: At, places: Sequence[_Place], unit: Complex, omega: float | None) -> SmallDelta:
    """The real positive lambda nearest to what Delta begins with, made large; omega may move."""
    first = _first(places, unit)
    ends = np.cumsum([len(x) for x in first])
    moves = omega is not None and bool(0.0 < omega < np.inf)
    middle = float("nan") if omega is None else omega
    start = np.concatenate([*first, np.zeros(int(moves))])

    def split(x: Array) -> tuple[list[Array], float]:
        w = middle * float(np.exp(x[-1])) if moves else middle
        return np.split(x[: ends[-1]], ends[:-1]), w

    @_once
    def value(x: Array) -> tuple[complex, Complex]:
        """lambda, and its derivatives."""
        variables, w = split(x)
        delta, (M, turned) = _delta_of(places, variables, unit.shape), at(w)
        lam, u, v = _eigen(M, delta, places)
        weights = [1.0 if place.grows else lam for place in places]
        p = u @ M
        slopes = [
            weight * _slopes(place, here, delta[place.w, place.z], p[place.w], v[place.z])
            for place, here, weight in zip(places, variables, weights, strict=True)
        ]
        if moves:
            moved = np.zeros(delta.shape[0], dtype=complex)
            for place, weight in zip(places, weights, strict=True):
                moved[place.w] = weight * (delta[place.w, place.z] @ v[place.z])
            slopes.append(np.array([u @ turned @ moved]))
        return lam, np.concatenate(slopes)

    size = max(abs(value(start)[0]), 1e-12 * float(np.linalg.norm(at(middle)[0])))

    def objective(x: Array) -> tuple[float, Array]:
        eigenvalue, slopes = value(x)
        return -eigenvalue.real / size, -slopes.real / size

    limits: list[tuple[float | None, float | None]] = []
    for place, x in zip(places, first, strict=True):
        limits += [(-1.0, 1.0) if place.block.kind == "real" else (None, None)] * len(x)
    limits += [(-1.0, 1.0)] * moves
    from scipy.optimize import minimize  # here because it is slow to import

    solution = minimize(
        objective,
        start,
        jac=True,
        bounds=limits,
        constraints={
            "type": "eq",
            "fun": lambda x: value(x)[0].imag / size,
            "jac": lambda x: value(x)[1].imag / size,
        },
        method="SLSQP",
        options={"maxiter": _STEPS, "ftol": 1e-12},
    )
    variables, w = split(solution.x if np.all(np.isfinite(solution.x)) else start)
    return _verified(at(w)[0], _delta_of(places, variables, unit.shape), places)._replace(omega=w)


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
    M = channels_matrix(loop.channels, omega)
    if not len(A) or not 0.0 < omega < np.inf:
        return M[place], np.zeros_like(M[place])
    shifted = 1j * omega * np.eye(len(A)) - A
    slope = -1j * omega * (C @ np.linalg.solve(shifted, np.linalg.solve(shifted, B)))
    return M[place], slope[place]


def best_near(
    loop: Loop, best: SmallDelta, omega: float, real: Array | None = None, starts: int = 1
) -> SmallDelta:
    """The better of what was known and of what is found near a frequency, and near real deltas."""

    def at(w: float) -> tuple[Complex, Complex]:
        return matrix_and_slope(loop, w)

    if 0.0 < omega < np.inf:
        reached = delta_near(at, loop.blocks, loop.grows, omega, real, starts)
    else:
        reached = small_delta(at(omega)[0], loop.blocks, np.inf, loop.grows)._replace(omega=omega)
    return reached if reached.bound > best.bound else best


def first_reached(loop: Loop) -> SmallDelta:
    """The smallest delta that is found from frequencies of the poles, and from corners."""
    best = nothing(loop)
    for omega in _places(loop.channels.A):
        best = best_near(loop, best, omega)
    if not best.bound:
        return best
    best = best_near(loop, best, best.omega, starts=3)
    count = sum(block.kind == "real" for block in loop.blocks)
    random = np.random.default_rng(0)
    for corner in np.sign(random.uniform(-1.0, 1.0, (_CORNERS if count else 0, count))):
        best = best_near(loop, best, best.omega, corner)
    return best


def _places(A: Array) -> list[float]:
    poles = np.linalg.eigvals(A) if len(A) else np.ones(1)
    return [float(w) for w in np.unique([*np.abs(poles[by_damping(poles)][:_MOST]), 0.0, np.inf])]


def by_name(loop: Loop, delta: Complex) -> dict[str, Any]:
    """Numbers and matrices of the blocks of a Delta (n_w, n_z)."""
    values: dict[str, Any] = {}
    z = w = 0
    for block in loop.blocks:
        value = delta[w : w + block.outputs, z : z + block.inputs]
        z, w = z + block.inputs, w + block.outputs
        if block.kind == "real":
            values[block.name] = float(value[0, 0].real)
        else:
            values[block.name] = complex(value[0, 0]) if block.kind == "complex" else value.copy()
    return values


def changes(loop: Loop, small: SmallDelta) -> Array:
    """How much the bound changes, to first order, as blocks grow by the same part (number of blocks,)."""
    M = matrix_and_slope(loop, small.omega)[0]
    return block_changes(M, loop.blocks, loop.grows, small)
