"""Values of goals at several points of the box, as smooth pieces with exact slopes.

The largest of many norms is not smooth. Each local peak of the gain of each goal at each point is: a
*piece*, with the frequency at which it is. With left and right singular vectors u and v at a peak,

    d sigma = Re( u' [C (j omega - A)^-1, I] dX [(j omega - A)^-1 B ; I] v ),      dX = L_S dS R_S.

An eigenvalue moves by u' dA v / (u' v). The H2 norm is h^2 = tr(C P C') with the Gramians P and Q of
states and costates, d(h^2) = 2 tr(Q dA P + Q dB B' + P C' dC).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.response.frequency import resolvent
from mbdlft.response.norms import gramians
from mbdlft.response.staircase import Plant
from mbdlft.synthesis.codesign import Budget
from mbdlft.synthesis.goals import DESIGN, H2, HINF, MARGIN, POLES, Goal
from mbdlft.synthesis.loop import Closed, Family, places
from mbdlft.system.sampled import StateMatrices

Complex = NDArray[np.complex128]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
_GRID = 40  # frequencies of the grid that all goals share
_BEYOND = 10.0  # the grid ends this factor beyond the slowest and the fastest pole
_ZOOMS, _INSIDE, _PARABOLAS = 2, 7, 4  # rounds of a search for a peak, each with so many frequencies
_SAME = 0.02  # logarithm of the ratio of frequencies below which two peaks are one
SECOND = 0.98  # of the largest singular value: a second one above it is a piece of its own
_DEPENDENT = 1e8  # product of the norms of both vectors: beyond it modes lose too many digits
_STILL = 1e-12  # of the largest slope: a pole that moves by less is not moved by the values
_NEAR = 0.05  # of the largest real part: poles as far left of it are pieces, too
_FAR = 8.0  # times the decay that poles have to keep: nearer to the axis, they are pieces
STABLE = -1  # the goal of pieces that keep the loop stable


class Piece(NamedTuple):
    """A smooth function of the values that is at most 1 where its goal is reached."""

    goal: int  # STABLE: the loop is stable
    point: int
    frequency: float  # rad/s
    value: float
    slope: Array  # (number of values,)


Place = tuple[int, int, float]  # goal, point, frequency (rad/s)


class Asked(NamedTuple):
    """What an evaluation needs to know beside the loops."""

    goals: Sequence[Goal]
    decay: float  # that poles have to keep (rad/s)
    extra: Array = np.zeros(0)  # more frequencies of the grid (rad/s)
    budgets: Mapping[int, Budget] = {}  # goals on design parameters, by their place


class Look(NamedTuple):
    """Goals at values: the largest soft and hard ones, and pieces near to them."""

    soft: float
    hard: float
    pieces: tuple[Piece, ...]
    abscissa: float  # largest real part of poles that the values move, and of others on the right
    point: int = 0  # where this is

    @property
    def is_stable(self) -> bool:
        return self.abscissa < 0.0


UNSTABLE = Look(np.inf, np.inf, (), np.inf)


class _Poles(NamedTuple):
    """Eigenvalues (m, n) with their slopes (m, n, number of values) and vectors (m, n, n)."""

    poles: Complex
    slopes: Complex
    right: Complex  # as columns
    left: Complex  # as rows; the inverse of the right ones

    @property
    def are_modal(self) -> bool:
        """Whether responses are computed by modes: the vectors are far from dependent."""
        sizes = np.linalg.norm(self.right, axis=(1, 2)) * np.linalg.norm(self.left, axis=(1, 2))
        return bool(np.all(sizes < _DEPENDENT))

    def moved(self) -> Flags:
        size = np.max(np.abs(self.slopes), axis=2, initial=0.0)
        return np.asarray(size > _STILL * np.max(size, initial=0.0))


def _poles(family: Family, closed: Closed) -> _Poles:
    n = family.states
    poles, V = np.linalg.eig(closed.A)
    with np.errstate(all="ignore"):
        try:
            U = np.linalg.inv(V)
        except np.linalg.LinAlgError:  # a multiple pole: its slopes are those of poles beside it
            U = np.linalg.pinv(V)
    left, right = U @ closed.L[:, :n], closed.R[:, :, :n] @ V
    pairs = left[..., None] * np.swapaxes(right, 1, 2)[:, :, None, :]
    moves = family.moves.reshape(len(family.moves), -1)
    slopes = pairs.reshape(*poles.shape, moves.shape[1]) @ moves.T
    return _Poles(poles, slopes, V, U)


def abscissas(family: Family, x: Array, near: float) -> Look:
    """The largest real part of the poles, with those not far left of it as pieces of one goal, 0."""
    closed = family.closed(x)
    if closed is None:
        return UNSTABLE
    found = _poles(family, closed)
    moved, real = found.moved(), found.poles.real
    real = np.where(moved | (real >= 0.0), real, -np.inf)
    top = float(np.max(real, initial=-np.inf))
    if top == -np.inf:  # nothing is moved, and stable
        top = float(np.max(found.poles.real, initial=-1.0))
    chosen = moved & (real > top - max(near, _NEAR * abs(top))) & (found.poles.imag >= 0.0)
    pieces = tuple(
        Piece(0, int(i), float(found.poles[i, k].imag), float(real[i, k]), found.slopes[i, k].real)
        for i, k in np.argwhere(chosen)
    )
    return Look(top, 0.0, pieces, top)


def look(
    family: Family, asked: Asked, x: Array, keep: float | None = 0.8, held: Sequence[Place] = ()
) -> Look:
    """Goals at values, with pieces that are at least a part `keep` of the largest, soft or hard.

    Everything is infinite where a loop is not stable. A part of 1 or more leaves pieces out; None has
    all of them, without slopes of peaks. Gains at the places `held` are pieces, too.
    """
    closed = family.closed(x)
    if closed is None:
        return UNSTABLE
    found = _poles(family, closed)
    real = found.poles.real
    moved = found.moved()
    largest_real = np.max(np.where(moved | (real >= 0.0), real, -np.inf), axis=1, initial=-np.inf)
    worst = int(np.argmax(largest_real))
    abscissa = float(largest_real[worst])
    if abscissa >= 0.0:
        return UNSTABLE._replace(abscissa=abscissa, point=worst)
    values = _peaks(closed, found, asked)
    for k, goal in enumerate(asked.goals):
        if goal.kind == POLES:
            values += _pole_pieces(found, moved, k, goal, keep)
        elif goal.kind == H2:
            values += _h2_pieces(family, closed, k, asked.goals)
        elif goal.kind == DESIGN:
            values.append(Piece(k, 0, 0.0, *asked.budgets[k].at(x)))
    largest = {
        hard: max((p.value for p in values if asked.goals[p.goal].hard == hard), default=-np.inf)
        for hard in (False, True)
    }
    pieces = list(values) if keep is None else []
    if keep is not None and keep < 1.0:
        for p in values:
            hard = asked.goals[p.goal].hard
            if not keep or p.value >= keep * (max(1.0, largest[True]) if hard else largest[False]):
                pieces.append(p)
        peaks = [(p.goal, p.point, p.frequency) for p in pieces if not len(p.slope)]
        pieces = [p for p in pieces if len(p.slope)]
        pieces += _with_slopes(family, closed, asked.goals, [*peaks, *held])
        pieces += _stable_pieces(found, moved, asked.decay)
    return Look(largest[False], largest[True], tuple(pieces), abscissa)


def _stable_pieces(found: _Poles, moved: Flags, decay: float) -> list[Piece]:
    chosen = moved & (found.poles.real > -_FAR * decay) & (found.poles.imag >= 0.0)
    return [
        Piece(
            STABLE,
            int(i),
            float(found.poles[i, k].imag),
            2.0 + float(found.poles[i, k].real) / decay,
            found.slopes[i, k].real / decay,
        )
        for i, k in np.argwhere(chosen)
    ]


def _pole_pieces(found: _Poles, moved: Flags, k: int, goal: Goal, keep: float | None) -> list[Piece]:
    """Ratios of what is asked of a pole and what it has; slopes of those near the largest."""
    at = np.nonzero(moved & (found.poles.imag >= 0.0))
    poles, none = found.poles[at], np.zeros(len(at[0]))
    real, size = poles.real, np.abs(poles)
    ratios = np.array([goal.decay / -real, goal.damping * size / -real, size / goal.speed])
    by_real = np.array([goal.decay / real**2, goal.damping * size / real**2, none])
    by_size = np.array([none, goal.damping / -real, none + 1.0 / goal.speed])
    kind, j = np.nonzero((ratios > 0.0) & (ratios >= (keep or 0.0) * np.max(ratios, initial=0.0)))
    moves = found.slopes[at[0][j], at[1][j]]
    of_size = np.real(np.conj(poles[j, None]) * moves) / size[j, None]
    slopes = by_real[kind, j, None] * moves.real + by_size[kind, j, None] * of_size
    every = zip(at[0][j].tolist(), poles.imag[j].tolist(), ratios[kind, j].tolist(), slopes, strict=True)
    return [Piece(k, point, omega, ratio, slope) for point, omega, ratio, slope in every]


def _h2_pieces(family: Family, closed: Closed, k: int, goals: Sequence[Goal]) -> list[Piece]:
    """The H2 norm at each point; infinite with a direct path."""
    rows, columns = places(goals)[k]
    n, pieces = family.states, []
    for i in range(len(closed.A)):
        plant = Plant(closed.A[i], closed.B[i][:, columns], closed.C[i][rows], closed.D[i][rows, columns])
        P, Q = gramians(plant)
        norm = float(np.sqrt(max(np.trace(plant.C @ P @ plant.C.T), 0.0)))
        if np.any(plant.D) or norm == 0.0:
            value = np.inf if np.any(plant.D) else 0.0
            pieces.append(Piece(k, i, 0.0, value, np.zeros(len(family.moves))))
            continue
        whole = np.zeros((closed.R.shape[2], closed.L.shape[1]))  # of tr(whole dX)
        whole[:n, :n], whole[n:, :n][columns] = P @ Q, plant.B.T @ Q
        whole[:n, n:][:, rows] = P @ plant.C.T
        inner = closed.R[i] @ whole @ closed.L[i]
        slope = np.einsum("xij,ji->x", family.moves, inner) / (norm * goals[k].limit)
        pieces.append(Piece(k, i, 0.0, norm / goals[k].limit, slope))
    return pieces


def _peaks(closed: Closed, found: _Poles, asked: Asked) -> list[Piece]:
    """Local peaks of gains over frequency at each point, without slopes; of all goals at once."""
    omega, pieces = _frequencies(found.poles, asked.extra), list[Piece]()
    every = np.arange(len(omega))
    responses, tops = list[Response](), list[_Tops]()
    for k, (goal, (rows, columns)) in enumerate(zip(asked.goals, places(asked.goals), strict=True)):
        if goal.kind not in (HINF, MARGIN):
            continue
        T = StateMatrices(
            closed.A, closed.B[:, :, columns], closed.C[:, rows], closed.D[:, rows, columns]
        )
        response = _by_modes(found, T) if found.are_modal else _by_solving(T)
        gains, at_infinity = _largest(response(every, omega)), _largest(T.D.astype(complex))
        floor = 0.5 * np.max(np.maximum(np.max(gains, axis=1), at_infinity), initial=0.0)
        points, at = np.nonzero(_rises(gains, at_infinity) & (gains >= floor))
        responses.append(response)
        tops.append(_Tops(k, points, at, gains[points, at]))
        pieces += [
            Piece(k, i, float("inf"), float(at_infinity[i]) / goal.limit, np.zeros(0))
            for i in range(len(omega))
            if at_infinity[i] >= floor
        ]
    if not tops:
        return pieces
    points, at, best = (np.concatenate(parts) for parts in list(zip(*tops, strict=True))[1:])
    cuts = np.cumsum([len(top.points) for top in tops])[:-1]

    def gain(fine: Array) -> Array:
        parts = zip(responses, tops, np.split(fine, cuts), strict=True)
        return np.concatenate([_largest(response(top.points, part)) for response, top, part in parts])

    last = omega.shape[1] - 1
    ends = (
        omega[points, np.maximum(at - 1, 0)],
        omega[points, at],
        omega[points, np.minimum(at + 1, last)],
    )
    middle, best = _climbed(gain, ends, best)
    for top, frequencies, values in zip(tops, np.split(middle, cuts), np.split(best, cuts), strict=True):
        limit = asked.goals[top.goal].limit
        pieces += [
            Piece(
                top.goal, int(top.points[j]), float(frequencies[j]), float(values[j]) / limit, np.zeros(0)
            )
            for j in _apart(top.points, frequencies, values)
        ]
    return pieces


class _Tops(NamedTuple):
    """Places (k,) of the grid where the gain of a goal is largest between its neighbors."""

    goal: int
    points: Index
    at: Index
    gains: Array


def _frequencies(poles: Complex, extra: Array) -> Array:
    """A grid (m, F) that is even, with the frequencies of poles and those beside them."""
    m, n = poles.shape
    sizes, widths = np.abs(poles), np.abs(poles.real)
    if n:
        even = np.geomspace(max(float(np.min(sizes)), 1e-6) / _BEYOND, np.max(sizes) * _BEYOND, _GRID)
    else:
        even = np.ones(1)
    # of a pair of poles one gives its frequencies, the other one those beside: none stands twice
    upper = poles.imag >= 0.0
    imag = np.abs(poles.imag)
    beside = np.where(upper, imag + widths, np.abs(imag - widths))
    more = np.broadcast_to(np.concatenate([even, extra]), (m, len(even) + len(extra)))
    return np.sort(np.hstack([np.zeros((m, 1)), more, np.where(upper, imag, sizes), beside]), axis=1)


def _rises(gains: Array, at_infinity: Array) -> Flags:
    """Where a gain (m, F) is not below that of its neighbors."""
    rises = np.ones(gains.shape, dtype=bool)
    rises[:, 1:] &= gains[:, 1:] >= gains[:, :-1]
    rises[:, :-1] &= gains[:, :-1] >= gains[:, 1:]
    rises[:, -1] &= gains[:, -1] > at_infinity
    return rises


def _apart(points: Index, frequencies: Array, values: Array) -> list[int]:
    """Of peaks of one point with nearly the same frequency the largest, as indices."""
    chosen, seen = list[int](), dict[int, list[float]]()
    sizes, owners = np.log(frequencies + 1e-300).tolist(), points.tolist()
    for j in np.argsort(-values).tolist():
        size, others = sizes[j], seen.setdefault(owners[j], [])
        if not any(abs(size - other) < _SAME for other in others):
            others.append(size)
            chosen.append(j)
    return chosen


def _climbed(
    gain_at: Callable[[Array], Array], ends: tuple[Array, Array, Array], best: Array
) -> tuple[Array, Array]:
    """Frequencies and gains (k,) of peaks between low and high ends, with the best one known between.

    Both sides of the best are divided evenly, twice; then parabolas through three points are followed.
    """
    low, middle, high = ends
    share, line = np.linspace(0.0, 1.0, _INSIDE), np.arange(len(best))
    for _ in range(_ZOOMS if len(best) else 0):
        below, above = low + (middle - low) * share[:, None], middle + (high - middle) * share[1:, None]
        fine = np.vstack([below, above]).T
        values = gain_at(fine)
        top = np.argmax(values, axis=1)
        middle, best = fine[line, top], values[line, top]
        low, high = (fine[line, np.clip(top + k, 0, fine.shape[1] - 1)] for k in (-1, 1))
        sides = [values[line, np.clip(top + k, 0, fine.shape[1] - 1)] for k in (-1, 1)]
    for _ in range(_PARABOLAS if len(best) else 0):
        left, right = middle - low, high - middle
        with np.errstate(all="ignore"):
            rise, fall = (best - sides[0]) / left, (best - sides[1]) / right
            at = middle + 0.5 * (left * fall * -1.0 + right * rise) / (rise + fall)
        at = np.where(np.isfinite(at) & (at > low) & (at < high), at, 0.5 * (low + middle))
        gain = gain_at(at[:, None])[:, 0]
        better, lower = gain > best, at < middle
        low, high = (
            np.where(better, np.where(lower, low, middle), np.where(lower, at, low)),
            np.where(better, np.where(lower, middle, high), np.where(lower, high, at)),
        )
        sides = [
            np.where(better, np.where(lower, sides[0], best), np.where(lower, gain, sides[0])),
            np.where(better, np.where(lower, best, sides[1]), np.where(lower, sides[1], gain)),
        ]
        middle, best = np.where(better, at, middle), np.maximum(best, gain)
    return middle, best


Response = Callable[[Index, Array], Complex]


def _by_modes(found: _Poles, T: StateMatrices) -> Response:
    """Values (k, F, nz, nw) of chosen points (k,) at frequencies (k, F), as sums over modes."""
    (nz, n), nw = T.C.shape[1:], T.B.shape[2]
    before, after = found.left @ T.B, np.swapaxes(T.C @ found.right, 1, 2)
    residues = (after[..., None] * before[:, :, None]).reshape(len(before), n, nz * nw)

    def response(points: Index, omega: Array) -> Complex:
        with np.errstate(all="ignore"):
            modes = 1.0 / (1j * omega[..., None] - found.poles[points, None])
            values = modes @ residues[points]
        return np.asarray(values.reshape(*omega.shape, nz, nw) + T.D[points, None])

    return response


def _by_solving(T: StateMatrices) -> Response:
    """As `_by_modes`, without eigenvectors."""

    def response(points: Index, omega: Array) -> Complex:
        return resolvent(
            StateMatrices(*(matrix[points] for matrix in T)), np.asarray(1j * omega, complex)
        )

    return response


def _largest(values: Complex) -> Array:
    """Largest singular values (..., ) of matrices; infinite where one is not finite."""
    values = values if values.shape[-2] <= values.shape[-1] else np.swapaxes(values, -1, -2)
    if values.shape[-2] <= 2:
        rows = np.sum(values.real**2 + values.imag**2, axis=-1)
        squares = rows[..., 0]
        if values.shape[-2] == 2:
            both = np.abs(np.sum(values[..., 0, :] * np.conj(values[..., 1, :]), axis=-1))
            squares = 0.5 * (squares + rows[..., 1]) + np.hypot(0.5 * (squares - rows[..., 1]), both)
    else:
        whole = values @ np.conj(np.swapaxes(values, -1, -2))
        finite = np.all(np.isfinite(whole), axis=(-2, -1))
        whole[~finite] = 0.0
        squares = np.where(finite, np.linalg.eigvalsh(whole)[..., -1], np.inf)
    return np.asarray(np.sqrt(np.where(np.isfinite(squares), np.maximum(squares, 0.0), np.inf)))


class Responses(NamedTuple):
    """Responses of a goal at k places, u diag(sizes) v*, with what is before and after the values."""

    points: Index
    inverse: Complex  # (j omega - A)^-1 (k, n, n); zero at infinity
    row: Complex  # C (j omega - A)^-1
    column: Complex  # (j omega - A)^-1 B
    u: Complex
    sizes: Array
    v: Complex
    out: Complex  # u* Z L (k, nz, nq)
    into: Complex  # R Y v (k, nv, nw)


def responses_at(closed: Closed, goals: Sequence[Goal], goal: int, at: Sequence[Place]) -> Responses:
    """The responses of a goal at places, all of which are of this goal."""
    points, omega = np.array([i for _, i, _ in at]), np.array([f for *_, f in at])
    rows, columns = places(goals)[goal]
    n = closed.A.shape[1]
    A, L, R = closed.A[points], closed.L[points], closed.R[points]
    B, C = closed.B[points][:, :, columns], closed.C[points][:, rows]
    finite = np.isfinite(omega)[:, None, None]
    shifted = 1j * np.where(finite, omega[:, None, None], 1.0) * np.eye(n) - np.where(finite, A, 0.0)
    inverse = np.where(finite, np.linalg.inv(shifted), 0.0)
    row, column = C @ inverse, inverse @ B
    u, sizes, vh = np.linalg.svd(closed.D[points][:, rows, columns] + C @ column)
    v = np.conj(np.swapaxes(vh, 1, 2))
    out = np.conj(np.swapaxes(u, 1, 2)) @ (row @ L[:, :n] + L[:, n:][:, rows])
    into = (R[:, :, :n] @ column + R[:, :, n:][:, :, columns]) @ v
    return Responses(points, inverse, row, column, u, sizes, v, out, into)


def _with_slopes(
    family: Family, closed: Closed, goals: Sequence[Goal], held: Sequence[Place]
) -> list[Piece]:
    """Gains at places with their slopes; two, where a second singular value is nearly as large."""
    moves, pieces = family.moves.reshape(len(family.moves), -1), list[Piece]()
    for goal in sorted({place[0] for place in held}):
        own = [place for place in held if place[0] == goal]
        at, limit = responses_at(closed, goals, goal, own), goals[goal].limit
        for j in range(min(2, at.sizes.shape[1])):
            large = np.flatnonzero(at.sizes[:, j] > SECOND * at.sizes[:, 0]) if j else np.arange(len(own))
            pairs = at.out[large, j, :, None] * at.into[large, None, :, j]
            slopes = pairs.real.reshape(len(large), moves.shape[1]) @ moves.T / limit
            values = at.sizes[large, j] / limit
            pieces += [
                Piece(*own[k], float(value), slope)
                for k, value, slope in zip(large, values, slopes, strict=True)
            ]
    return pieces
