"""An equilibrium that depends on parameters as rational functions, with a guaranteed bound.

Each unknown is fitted at samples of its branch, with few repetitions in an LFT and a small largest error.
The proof of the bound gives new samples where it fails.
"""

import itertools
from collections.abc import Sequence, Sized
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import lstsq

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, TrimError
from mbdlft.base.expression import parse
from mbdlft.multibody.equilibrium.branches import Proof, System, follow, prove, start_branch, system

__all__ = ["EquilibriumFit", "fit_equilibrium"]

_MARGIN = 0.9  # of the tolerance, for the samples: the error between them may be larger
_FEWEST = {1: 33, 2: 13, 3: 8}  # samples along each parameter, by the number of parameters
_GUARDS = {1: 257, 2: 41, 3: 13}  # points along each parameter where poles are looked for
_AROUND = 2.0**-18  # of half the box: several of the smallest pieces of a proof
_ROUNDS = 5  # of one degree with points that the proof found
_SWEEPS = 25  # of the weights; later ones change the error by less than a few percent
_INDEPENDENT = 1e-13  # directions of the least squares that count, relative to the largest
# times the tolerance: fits that are nearer have smaller boxes around them, in which more can be proved
_NEARER = (1.0, 0.1, 1e-2, 1e-3, 1e-4)
_ADVICE = "Nearer fits were tried, too. Use a smaller range, or a larger tolerance."
_ENOUGH = 1e-2  # of the tolerance: no smaller error is looked for
_HOPELESS = 5.0  # times the tolerance: the weights do not make the largest error that much smaller


@dataclass(frozen=True, slots=True)
class Rational:
    """(sum_a c_a d^a) / (sum_b e_b d^b) of d = p - center, with e_0 = 1."""

    center: Array  # (q,)
    numerator_exponents: Array  # (number of terms, q) of int
    numerator: Array  # (number of terms,)
    denominator_exponents: Array
    denominator: Array

    def __call__(self, p: Array) -> Array:
        """Values (N,) at p (N, q)."""
        above = monomials(p - self.center, self.numerator_exponents) @ self.numerator
        return np.asarray(above / self.below(p))

    def below(self, p: Array) -> Array:
        """Values (N,) of the denominator at p (N, q)."""
        return monomials(p - self.center, self.denominator_exponents) @ self.denominator


@dataclass(frozen=True, slots=True)
class EquilibriumFit:
    """Rational functions fit_i(p) with |fit_i(p) - t_i(p)| <= bound_i on the whole box."""

    names: tuple[str, ...]  # of the q parameters
    functions: tuple[Rational, ...]  # n functions of p - center
    expressions: tuple[str, ...]  # the same as texts; it is for them that the bound is proved
    bound: Array  # (n,) proved bound of the error, in the unit of the unknown
    found: Array  # (n,) largest error at the points that were looked at
    pieces: int  # number of pieces of the box that the proof examined

    def __call__(self, p: Array) -> Array:
        """Values (N, n) at p (N, q)."""
        return np.stack([function(p) for function in self.functions], axis=1)


class _Task(NamedTuple):
    """What is asked for."""

    nominal: Array  # (q,) a value of the parameters, in the units of the residual (SI)
    low: Array  # (q,) the box
    high: Array
    start: Array  # (n,) near to the root at `nominal`; the branch through that root is fitted
    tolerance: float  # largest bound, in the units of the unknowns
    most_pieces: int


def fit_equilibrium(
    residual: ca.Function,
    nominal: Array,
    low: Array,
    high: Array,
    start: Array,
    tolerance: float,
    *,
    names: Sequence[str] | None = None,
    largest_degree: int = 8,
    most_pieces: int = 20_000,
) -> EquilibriumFit:
    """Rational functions near the root t(p) of residual(t, p) = 0, with a proved bound.

    For each unknown the smallest total degree is taken that meets the tolerance. The residual has
    + - * /, integer powers, sqrt, sin, cos and tan of the n unknowns t (tan of half an angle, or m) and
    the q parameters p; it gives up at `largest_degree`, and at `most_pieces` of the box.
    """
    nominal, low, high, start = (
        np.asarray(value, dtype=float).reshape(-1) for value in (nominal, low, high, start)
    )
    task = _Task(nominal, low, high, start, tolerance, most_pieces)
    names = tuple(names or (f"p{k + 1}" for k in range(len(nominal))))
    _check(residual, task, names)
    failed: _UnprovedError | None = None
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        for share in _NEARER:
            try:
                return _fit(system(residual, names), task, share * tolerance, largest_degree)
            except _UnprovedError as error:
                failed = failed or error
            except TrimError:
                if failed is None:
                    raise
                break
    assert failed is not None
    raise failed


class _UnprovedError(TrimError):
    """Fits whose errors at samples are small enough, of which nothing is proved: nearer ones may be."""


def _fit(s: System, task: _Task, tolerance: float, largest_degree: int) -> EquilibriumFit:
    nominal, low, high, start, _, most_pieces = task
    root = start_branch(s, nominal, start)
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    extra = np.zeros((0, len(low)))
    guards = nodes(half * 0, half / half, _GUARDS.get(len(low), 7))
    best = np.full(s.unknowns, np.inf)
    functions: list[Rational | None] = [None] * s.unknowns
    for degree in range(largest_degree + 1):
        for _ in range(_ROUNDS):
            count = _samples(len(low), degree)
            points = np.vstack([nominal, nodes(center, half, count), extra])
            roots = follow(s, nominal, root, points)
            x = (points - center) / half
            for i in [i for i, function in enumerate(functions) if function is None]:
                fit, error = smallest_fit(x, roots[:, i], guards, degree, _MARGIN * tolerance)
                best[i] = min(best[i], error)
                if error <= _MARGIN * tolerance:
                    functions[i] = physical(fit, center, half)
            ready = [function for function in functions if function is not None]
            if len(ready) < s.unknowns:
                break
            texts = tuple(text(function, s.names) for function in ready)
            sampled = np.max(np.abs([f(points) for f in ready] - roots.T), axis=1)
            goal, trees = (np.full(s.unknowns, tolerance), [parse(expression) for expression in texts])
            probes = nodes(center, half, 2 * count if len(low) < 3 else count + 1)
            proof = prove(s, trees, low, high, goal, sampled, probes, most_pieces)
            if proof.complete:
                return EquilibriumFit(
                    s.names, tuple(ready), texts, proof.bound, proof.sampled, proof.pieces
                )
            poles = [_poles(f, proof.stuck, half) for f in ready]
            if any(len(p) for p in poles):
                guards = np.vstack([guards, *((p - center) / half for p in poles)])
                functions = [None if len(p) else f for p, f in zip(poles, ready, strict=True)]
                continue
            if not len(proof.exceptions):
                raise _not_proved(s, proof, proof.stuck, task, root)
            exact = follow(s, nominal, root, proof.exceptions)
            errors = np.max(np.abs([f(proof.exceptions) for f in ready] - exact.T), axis=1)
            extra = np.vstack([extra, proof.exceptions])
            near = errors <= _MARGIN * tolerance
            functions = [f if is_near else None for f, is_near in zip(ready, near, strict=True)]
            if None not in functions:
                stuck = proof.exceptions[0]
                raise _not_proved(s, proof, stuck, task, root)
    errors_at_samples = ", ".join(f"{e:.1e}" for e in best)
    if np.all(best <= _MARGIN * tolerance):
        raise _UnprovedError(
            f"equilibrium of {s.name!r}: fits have errors of {errors_at_samples} at samples, but poles "
            f"or larger errors between. {_ADVICE}"
        )
    raise TrimError(
        f"equilibrium of {s.name!r}: no rational fit up to degree {largest_degree} is within "
        f"{_MARGIN * tolerance:g} at samples, as a proof of {tolerance:g} needs; the errors came down to "
        f"{errors_at_samples}. Use a larger tolerance, or a smaller range."
    )


def _poles(function: Rational, stuck: Array | None, half: Array) -> Array:
    """Points (N, q) around the one where a proof got stuck at which the denominator is not positive.

    A pole and a zero next to each other, between the samples, are not seen in the errors.
    """
    if stuck is None:
        return np.zeros((0, len(half)))
    signs = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=len(half))))
    around = stuck + signs * half * _AROUND
    return np.asarray(around[function.below(around) <= 0])


def nodes(center: Array, half: Array, count: int) -> Array:
    """Products (count^q, q) of Chebyshev nodes with the ends."""
    x = np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray(center + half * np.array(list(itertools.product(x, repeat=len(center)))))


def _samples(variables: int, degree: int) -> int:
    """Number along each parameter that determines all terms of a total degree, some to spare."""
    enough = {1: 3 + 2 * degree, 2: 3 + 2 * degree, 3: 2 + 2 * degree}.get(variables, 2 + degree)
    return max(_FEWEST.get(variables, 5), enough)


def _not_proved(s: System, proof: Proof, stuck: Array | None, task: _Task, root: Array) -> TrimError:
    """What stopped a proof although no error above the tolerance was found."""
    if stuck is not None:
        follow(s, task.nominal, root, stuck[None])  # raises if the branch ends on the way
        return _UnprovedError(
            f"equilibrium of {s.name!r}: nothing can be proved near {s.at(stuck)}: df/dt is singular "
            "there or nearly so (a fold or a bifurcation), or double precision does not carry the "
            f"tolerance {task.tolerance:g}. {_ADVICE}"
        )
    return _UnprovedError(
        f"equilibrium of {s.name!r}: the bound {task.tolerance:g} is proved on "
        f"{100 * proof.share:.3g} % of the box only, with {task.most_pieces} pieces; no error above "
        f"{', '.join(f'{e:.1e}' for e in proof.sampled)} was found. {_ADVICE}"
    )


def _check(residual: ca.Function, task: _Task, names: tuple[str, ...]) -> None:
    nominal, low, high, start, tolerance, _ = task
    n, q = residual.numel_in(0), residual.numel_in(1)
    what = f"equilibrium of {residual.name()!r}: "
    sizes: dict[str, Sized] = {"nominal": nominal, "low": low, "high": high, "names": names}
    for label, value in sizes.items():
        if len(value) != q:
            raise StructureError(f"{what}{label} has {len(value)} entries, the residual takes {q}.")
    if len(start) != n or residual.numel_out(0) != n:
        raise StructureError(
            f"{what}{n} unknowns, but start has {len(start)} entries and the residual "
            f"{residual.numel_out(0)}. All must be equal."
        )
    if not q or not np.all((low < high) & (low <= nominal) & (nominal <= high)):
        raise StructureError(
            f"{what}expected low <= nominal <= high and low < high for at least one parameter, got "
            f"low {low.tolist()}, nominal {nominal.tolist()}, high {high.tolist()}."
        )
    if not np.all(np.isfinite([*low, *high, *start, tolerance])) or tolerance <= 0:
        raise StructureError(
            f"{what}expected finite numbers and a positive tolerance, got {tolerance!r}, low "
            f"{low.tolist()}, high {high.tolist()}, start {start.tolist()}."
        )


# rational functions --------------------------------------------------------------------------


def monomials(x: Array, exponents: Array) -> Array:
    """x^a (N, number of exponents) at x (N, q)."""
    return np.asarray(np.prod(x[:, None, :] ** exponents[None], axis=2))


def exponents(caps: Sequence[int], degree: int) -> Array:
    """All exponents of at most a total degree, and at most one cap for each variable."""
    every = itertools.product(*(range(min(cap, degree) + 1) for cap in caps))
    kept = [a for a in every if sum(a) <= degree]
    return np.array(kept, dtype=int).reshape(len(kept), len(caps))


def smallest_fit(
    x: Array, t: Array, guards: Array, degree: int, tolerance: float
) -> tuple[Rational, float]:
    """The cheapest fit of a total degree with an error within a tolerance, else the best; and its error.

    A polynomial comes first, then denominators of rising degree: in an LFT one of degree 1 costs no
    more repetitions than the numerator alone, each further degree at least one. Then the highest
    power of one variable after the other is lowered as long as the error stays within the tolerance.

    The samples are t (N,) at x (N, q) in [-1, 1]; the denominator is clear of zero at the `guards` (.,
    q), too. `degree` is the total degree of the numerator and the largest one of the denominator.
    """
    q = x.shape[1]
    caps, fits = [degree] * q, []
    # of one variable the denominator is free up to the degree of the numerator
    for below in {0: 0, degree: 0} if q == 1 else range(degree + 1):
        fits.append(_weighted_fit(x, t, guards, caps, degree, below, tolerance, tolerance))
        if fits[-1][1] <= tolerance:
            break
    best = min(fits, key=lambda fit: fit[1])
    if best[1] > tolerance:
        return best
    for k in range(q):
        while caps[k] > 0:
            lower = [*caps[:k], caps[k] - 1, *caps[k + 1 :]]
            if _weighted_fit(x, t, guards, lower, degree, below, tolerance, tolerance)[1] > tolerance:
                break
            caps = lower
    return _weighted_fit(x, t, guards, caps, degree, below, tolerance, _ENOUGH * tolerance)


def physical(fit: Rational, center: Array, half: Array) -> Rational:
    """A fit in x = (p - center)/half as one in p - center."""
    above = half ** fit.numerator_exponents.astype(float)
    below = half ** fit.denominator_exponents.astype(float)
    return Rational(
        center,
        fit.numerator_exponents,
        fit.numerator / np.prod(above, axis=1),
        fit.denominator_exponents,
        fit.denominator / np.prod(below, axis=1),
    )


def text(fit: Rational, names: Sequence[str]) -> str:
    """Expression in the grammar of `mbdlft.base.expression`, nested so that names stand few times."""
    variables = [
        name if value == 0 else f"({name} {'-' if value > 0 else '+'} {abs(float(value))!r})"
        for name, value in zip(names, fit.center, strict=True)
    ]
    above = _nested(_terms(fit.numerator_exponents, fit.numerator), variables)
    if len(fit.denominator) == 1:
        return above
    return f"{above}/{_nested(_terms(fit.denominator_exponents, fit.denominator), variables)}"


def _terms(exponents: Array, coefficients: Array) -> dict[tuple[int, ...], float]:
    return {tuple(int(k) for k in a): float(c) for a, c in zip(exponents, coefficients, strict=True)}


def _nested(terms: dict[tuple[int, ...], float], variables: Sequence[str]) -> str:
    """Horner's form in the first variable, of Horner's forms in the others."""
    if not variables:
        return repr(terms[()]) if terms[()] >= 0 else f"({terms[()]!r})"
    result = ""
    for power in range(max(a[0] for a in terms), -1, -1):
        coefficients = {a[1:]: c for a, c in terms.items() if a[0] == power}
        inner = _nested(coefficients, variables[1:]) if coefficients else ""
        product = f"{variables[0]}*{result}" if result else ""
        result = f"({inner} + {product})" if inner and product else inner or product
    return result


def _weighted_fit(
    x: Array,
    t: Array,
    guards: Array,
    caps: Sequence[int],
    degree: int,
    below: int,
    tolerance: float,
    goal: float,
) -> tuple[Rational, float]:
    """Least squares of N - t D with weights 1/D of the last sweep, and larger where the error is.

    It ends when the largest error is at most the goal, or will not come down to the tolerance.

    Source: Sanathanan, Koerner 1963 (division by the last D); Lawson 1961 (weights for the
    smallest largest error).
    """
    powers, under = exponents(caps, degree), exponents(caps, below)
    under = under[np.argsort(under.sum(axis=1), kind="stable")]
    V, W = monomials(x, powers), monomials(x, under)
    matrix = np.hstack([V, -t[:, None] * W[:, 1:]])
    between = monomials(guards, under)
    weight, last = np.ones(len(t)), np.ones(len(t))
    unit, zero = np.array([1.0]), np.zeros(x.shape[1])
    best = Rational(zero, powers, np.zeros(len(powers)), under[:1], unit), float("inf")
    for sweep in range(_SWEEPS):
        scale = np.sqrt(weight) / last
        solution = lstsq(matrix * scale[:, None], t * scale, _INDEPENDENT, lapack_driver="gelsy")[0]
        c, e = solution[: len(powers)], np.concatenate([unit, solution[len(powers) :]])
        D = W @ e
        if min(D.min(), float((between @ e).min(initial=1.0))) <= 0:
            # a pole: the weights of the next sweep hold the denominator up there
            last = np.maximum(np.abs(D), 0.1)
            continue
        errors = np.abs(V @ c / D - t)
        worst = float(errors.max())
        if worst < best[1]:
            best = Rational(zero, powers, c, under, e), worst
        if worst <= goal or (sweep > 2 and best[1] > _HOPELESS * tolerance):
            break
        last = D
        weight = weight * (errors / worst + 1e-3)
        weight /= weight.mean()
    return best
