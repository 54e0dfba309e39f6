"""Points that satisfy equations, by Newton's method with the smallest step, and singular equations.

A matrix of numbers and parameters is decided in exact arithmetic, one of signals in doubles at points.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.sparse import issparse

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError
from mbdlft.dae.text import column_of, free_symbols
from mbdlft.exact.matrices import is_regular
from mbdlft.exact.modular import Residues, null_space
from mbdlft.problem.sparse import Entries, Matrices, smallest
from mbdlft.problem.sx.constants import in_doubles, modulo_prime
from mbdlft.problem.sx.tapes import BufferedCall, term_sizes

_STEPS, _HALVINGS = 60, 12
_CLOSE = 1e-11  # of the size of the terms of an equation
_HOLDS = 1e-8  # of them: what a solution may miss
_TRIES = 6
_MOST_HALVED = 8  # times, of a way between parameters
_CONTRACTED, _SMALL_STEP = 0.1, 1e-9  # of a second step; steps over the sizes of unknowns
_SOLVED = 1e-6  # of the right side, what a sparse solution may miss
_SEED = 7
_RANK = 1e-12  # of the largest singular value: below it, one is none


class Found(NamedTuple):
    """A point, and by how much each equation misses it relative to the size of its terms."""

    values: Array
    missing: Array

    @property
    def is_solution(self) -> bool:
        """Whether all equations hold to rounding."""
        return bool(np.all(np.isfinite(self.missing)) and np.all(self.missing <= _HOLDS))

    def worst(self, places: Sequence[str]) -> str:
        """The three equations that miss most, and by how much."""
        worst = [k for k in np.argsort(-self.missing)[:3] if self.missing[k] > _HOLDS]
        return ", ".join(f"{places[k]} ({self.missing[k]:.1e})" for k in worst)

    def explained(self, places: Sequence[str], residual: ca.SX, unknown: ca.SX) -> str:
        """The same, and what no start value mends: equations without an unknown."""
        said = self.worst(places)
        if np.any(np.isinf(self.missing)):
            said += "; inf: a value or a slope of it is not finite where it was tried"
        used = {*ca.jacobian_sparsity(residual, unknown).row()}
        empty = [k for k, x in enumerate(self.missing[: len(places)]) if x > _HOLDS and k not in used]
        if empty:
            said += f"; no unknown is left in {', '.join(places[k] for k in empty[:3])}"
        return said


class System:
    """0 = residual(z, q): functions of unknowns z (n,) and given values q, in doubles.

    The first of the given values are signals of the sizes `held` (k,): terms of these count in the sizes
    of equations, too.
    """

    def __init__(self, residual: ca.SX, unknown: ca.SX, knowns: ca.SX, held: Array | None = None) -> None:
        residual = ca.densify(in_doubles(residual))
        jacobian = ca.jacobian(residual, unknown)
        self.held = np.zeros(0) if held is None else held
        beside = ca.jacobian(residual, knowns[: len(self.held)])
        self.count, self.unknowns = residual.numel(), unknown.numel()
        self._rows, self._signals = residual, ca.vertcat(unknown, knowns)
        self._residual, self._jacobian, self._beside = (
            BufferedCall(ca.Function("system", [unknown, knowns], [result]))
            for result in (residual, jacobian, beside)
        )
        self.places, self._places_beside = (Entries(m.sparsity()) for m in (jacobian, beside))

    @cached_property
    def _of_both(self) -> ca.Function:
        """The residual of all signals in one column; few systems have equations that are flat."""
        return ca.Function("system", [self._signals], [self._rows])

    def residual(self, z: Array, q: Array) -> Array:
        return self._residual(z, q)[0].copy()

    def slopes(self, z: Array, q: Array) -> Array:
        """The entries (k,) of the Jacobian (m, n) at `places`."""
        return self._jacobian(z, q)[0].copy()

    def jacobian(self, z: Array, q: Array) -> Array:
        return self.places.dense(self.slopes(z, q))

    def scale(self, slopes: Array, z: Array, q: Array, sizes: Array) -> Array:
        """Sizes (m,) of the terms of each equation, with its slopes there."""
        terms = np.zeros(self.count)
        pairs = [(self.places, slopes, np.maximum(np.abs(z), sizes))]
        if len(self.held):
            held = np.maximum(np.abs(q[: len(self.held)]), self.held)
            pairs.append((self._places_beside, self._beside(z, q)[0], held))
        for places, entries, size in pairs:
            np.maximum.at(terms, places.rows, np.abs(entries) * size[places.columns])
        if not np.all(terms > 0.0):  # flat, as x^3 at zero: of 1e-30 - x^3 a number is left
            with suppress(NotRationalError):  # comparisons have no terms
                own = term_sizes(self._of_both, np.array([[*z, *q]]))[0]
                terms = np.where(terms > 0.0, terms, own)
        return np.asarray(np.where(terms > 0.0, terms, 1.0))

    def step(self, slopes: Array, r: Array, scale: Array, sizes: Array) -> Array:
        """Newton's step (n,) over the sizes of the unknowns; not finite where the equations are not."""
        if not (np.all(np.isfinite(r)) and np.all(np.isfinite(slopes))):
            return np.full(len(sizes), np.nan)
        scaled = slopes * sizes[self.places.columns] / scale[self.places.rows]
        return -_smallest_step(self.places.matrix(scaled), r / scale)


def solve(
    system: System,
    start: Array,
    knowns: Array,
    sizes: Array,
    second: Callable[[], Array | None] = lambda: None,
) -> Found:
    """A point near `start` (n,) where the equations hold; steps are small relative to `sizes` (n,).

    There may be fewer equations than unknowns. If nothing is found from the start itself, the `second`
    start is tried, then some points around the first, the same each time.
    """
    drawn = np.random.default_rng(_SEED)
    best = _newton(system, start, knowns, sizes)
    other = None if best.is_solution else second()
    if other is not None:
        best = _newton(system, other, knowns, sizes)
    for attempt in range(_TRIES):
        if best.is_solution:
            break
        around = start + sizes * drawn.standard_normal(len(start)) * 0.3 * (1 + attempt)
        point = _newton(system, around, knowns, sizes)
        if np.max(point.missing, initial=0.0) < np.max(best.missing, initial=0.0):
            best = point
    # all digits of what is small, where the equations hold to rounding of its own size, too
    own_sizes = np.where(best.values != 0.0, np.abs(best.values), sizes)
    finer = _newton(system, best.values, knowns, own_sizes) if best.is_solution else best
    return finer if finer.is_solution else best


def follow(
    system: System, start: Array, ends: tuple[Array, Array], sizes: Array, halvings: int = _MOST_HALVED
) -> Found:
    """The solution at the second of two given values on the branch of `start`, the solution at the first.

    The way is halved until Newton's steps contract from the start on (the second is a tenth of the
    first at most, with one Jacobian): so steps seldom leap to another branch.
    Source: P. Deuflhard, Newton methods for nonlinear problems (2004), affine covariant continuation.
    """
    first, last = ends
    with np.errstate(all="ignore"):
        r, slopes = system.residual(start, last), system.slopes(start, last)
        scale = system.scale(slopes, start, last, sizes)
        step = system.step(slopes, r, scale, sizes)
        second = system.step(slopes, system.residual(start + sizes * step, last), scale, sizes)
        contracts = bool(np.linalg.norm(second) <= _CONTRACTED * np.linalg.norm(step))
    if contracts or not halvings or np.linalg.norm(step) <= _SMALL_STEP:
        return solve(system, start, last, sizes)
    middle = 0.5 * (first + last)
    half = follow(system, start, (first, middle), sizes, halvings - 1)
    return follow(system, half.values, (middle, last), sizes, halvings - 1) if half.is_solution else half


def follow_all(system: System, start: Array, first: Array, points: Array, sizes: Array) -> list[Found]:
    """Solutions at given values (N, k) on the branch of `start`, the solution at `first` (k,).

    Each is followed from the nearest one before it, as short ways need few steps. The last of them is
    none if there is one that is none.
    """
    ranges = np.ptp(np.vstack([first, points]), axis=0)
    scaled = np.divide(points - first, ranges, out=np.zeros_like(points), where=ranges > 0.0)
    found: list[Found] = []
    for place, last in zip(scaled, points, strict=True):
        distances = [np.linalg.norm(place), *np.linalg.norm(scaled[: len(found)] - place, axis=1)]
        k = int(np.argmin(distances))
        near, values = (points[k - 1], found[k - 1].values) if k else (first, start)
        found.append(follow(system, values, (near, last), sizes))
        if not found[-1].is_solution:
            break
    return found


def _newton(system: System, start: Array, knowns: Array, sizes: Array) -> Found:
    z, polished = start.copy(), False
    close: Found | None = None  # before the last step, which may be a leap
    for _ in range(_STEPS):
        with np.errstate(all="ignore"):
            r, slopes = system.residual(z, knowns), system.slopes(z, knowns)
        if not (np.all(np.isfinite(r)) and np.all(np.isfinite(slopes))):
            odd = np.zeros(system.count, dtype=bool)
            odd[system.places.rows[~np.isfinite(slopes)]] = True
            return Found(z, np.where(odd | ~np.isfinite(r), np.inf, 0.0))
        scale = system.scale(slopes, z, knowns, sizes)
        if polished:
            break
        polished = bool(np.max(np.abs(r) / scale, initial=0.0) <= _CLOSE)  # one more step
        close = Found(z, np.abs(r) / scale) if polished else None
        step = sizes * system.step(slopes, r, scale, sizes)
        size, length = np.linalg.norm(r / scale), 1.0
        for _ in range(_HALVINGS):
            with np.errstate(all="ignore"):
                after = np.linalg.norm(system.residual(z + length * step, knowns) / scale)
            if after < size * (1.0 - 0.1 * length):
                break
            length *= 0.5
        else:
            if not polished:
                break
        z = z + (1.0 if polished else length) * step
    with np.errstate(all="ignore"):
        r, slopes = system.residual(z, knowns), system.slopes(z, knowns)
    last = Found(z, np.abs(r) / system.scale(slopes, z, knowns, sizes))
    return last if close is None or last.is_solution else close


def _smallest_step(J: Matrices, r: Array) -> Array:
    """The smallest d (n,) with J d = r (m,), or nearest to that; J has rows and columns of size 1."""
    m, n = J.shape
    if issparse(J):
        small = np.full(n, np.nan)
        with suppress(np.linalg.LinAlgError):
            small = smallest(J, r)
        if np.all(np.isfinite(small)) and np.max(np.abs(J @ small - r)) <= _SOLVED * np.max(np.abs(r)):
            return small
        J = J.toarray()
    step, _, rank, _ = np.linalg.lstsq(J, r, rcond=_RANK)
    if rank < m <= n:  # or rows and columns of very different sizes
        rows = np.linalg.norm(J, axis=1, keepdims=True)
        columns = np.linalg.norm(divided(J, rows), axis=0) if m == n else np.ones(n)
        scaled = divided(divided(J, rows), columns)
        scaled_step, _, rank, _ = np.linalg.lstsq(scaled, divided(r, rows[:, 0]), rcond=_RANK)
        step = scaled_step / columns if rank == m else step
    return np.asarray(step)


def values_of(expressions: Sequence[ca.SX], arguments: ca.SX, point: Array) -> Array:
    """Values (n,) of expressions at a point."""
    stacked = column_of(expressions)
    function = ca.Function("values", [arguments], [ca.densify(in_doubles(stacked))])
    return np.asarray(function(point).full()[:, 0])


_SEED_OF_RANKS = 20230917  # of the residues that stand for parameters
_SMALL = 1e-10  # of the largest singular value of scaled rows: below it, a matrix is taken for singular


class Singular(NamedTuple):
    """Rows that depend on each other, columns that they do not determine; whether that is proved."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    exact: bool


def singular_part(
    matrix: ca.SX, signals: ca.SX, parameters: ca.SX, points: Callable[[], Sequence[Array]]
) -> Singular | None:
    """What is singular in a square matrix (n, n), or None.

    A matrix of numbers and parameters is decided in exact arithmetic, for parameters in general. One of
    signals is looked at in doubles at points, values of [signals ; parameters].
    """
    known = {p.element_hash() for p in ca.vertsplit(parameters)}
    if all(symbol.element_hash() in known for symbol in free_symbols(matrix)):
        try:
            return _by_residues(matrix)
        except NotRationalError:
            pass
    return _by_values(matrix, ca.vertcat(signals, parameters), points())


def _by_residues(matrix: ca.SX) -> Singular | None:
    """Modulo a prime above 2^60, with random residues for the parameters."""
    residues, prime = modulo_prime(matrix, _SEED_OF_RANKS)
    if is_regular(residues.astype(np.int64), prime):
        return None
    right = null_space(residues.astype(np.int64), prime)
    left_null = null_space(residues.T.astype(np.int64), prime)
    return Singular(_used(left_null), _used(right), exact=True)


def _used(space: Residues) -> tuple[int, ...]:
    return tuple(int(k) for k in np.flatnonzero(np.any(space != 0, axis=1)))


def _by_values(matrix: ca.SX, symbols: ca.SX, points: Sequence[Array]) -> Singular | None:
    """The singular part if the matrix is singular at all of the points."""
    function = ca.Function("matrix", [symbols], [ca.densify(in_doubles(matrix))])
    singular = None
    for point in points:
        value = function(point).full()
        scaled = divided(value, np.max(np.abs(value), axis=1, keepdims=True))
        scaled = divided(scaled, np.max(np.abs(scaled), axis=0))
        if not np.all(np.isfinite(scaled)):
            continue
        u, s, vt = np.linalg.svd(scaled)
        null = s <= _SMALL * max(s[0], 1e-300)
        if not np.any(null):
            return None
        singular = Singular(_large(u[:, null]), _large(vt[null].T), exact=False)
    return singular


def divided(matrix: Array, sizes: Array) -> Array:
    """A matrix over the sizes of its rows or columns; those of size zero stay."""
    return np.asarray(matrix / np.where(sizes > 0, sizes, 1.0))


def _large(vectors: Array) -> tuple[int, ...]:
    return tuple(int(k) for k in np.flatnonzero(np.max(np.abs(vectors), axis=1) > 1e-3))
