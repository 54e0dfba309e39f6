"""Rational functions of few repetitions that are near to samples, largest error smallest."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq

from mbdlft.base.array import Array

_SWEEPS = 25  # of the weights; later ones change the error by less than a few percent
_INDEPENDENT = 1e-13  # directions of the least squares that count, relative to the largest
_ENOUGH = 1e-2  # of the tolerance: no smaller error is looked for
_HOPELESS = 5.0  # times the tolerance: the weights do not make the largest error that much smaller


@dataclass(frozen=True, slots=True)
class Rational:
    """(sum_a c_a d^a) / (sum_b e_b d^b) of d = p - center, with e_0 = 1.

    Attributes
    ----------
    center : Array (q,)
    numerator_exponents, denominator_exponents : Array (number of terms, q) of int
    numerator, denominator : Array (number of terms,)
    """

    center: Array
    numerator_exponents: Array
    numerator: Array
    denominator_exponents: Array
    denominator: Array

    def __call__(self, p: Array) -> Array:
        """Values (N,) at p (N, q)."""
        above = monomials(p - self.center, self.numerator_exponents) @ self.numerator
        return np.asarray(above / self.below(p))

    def below(self, p: Array) -> Array:
        """Values (N,) of the denominator at p (N, q)."""
        return monomials(p - self.center, self.denominator_exponents) @ self.denominator


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
    """The cheapest fit of a total degree with an error within a tolerance, else the best one.

    A polynomial comes first, then denominators of rising degree: in an LFT one of degree 1 costs no
    more repetitions than the numerator alone, each further degree at least one. Then the highest
    power of one variable after the other is lowered as long as the error stays within the tolerance.

    Parameters
    ----------
    x : Array (N, q)
        Samples of the variables, in [-1, 1].
    t : Array (N,)
    guards : Array (number of guards, q)
        Points at which the denominator must be clear of zero, too.
    degree : total degree of the numerator, and the largest of the denominator
    tolerance : float

    Returns
    -------
    the fit, with center 0
    largest error at the samples
    """
    q = x.shape[1]
    caps = [degree] * q
    best: tuple[Rational, float] | None = None
    for below in _denominators(q, degree):
        fit = _fit(x, t, guards, caps, degree, below, tolerance, tolerance)
        if best is None or fit[1] < best[1]:
            best = fit
        if best[1] <= tolerance:
            break
    assert best is not None
    if best[1] > tolerance:
        return best
    for k in range(q):
        while caps[k] > 0:
            lower = [*caps[:k], caps[k] - 1, *caps[k + 1 :]]
            if _fit(x, t, guards, lower, degree, below, tolerance, tolerance)[1] > tolerance:
                break
            caps = lower
    return _fit(x, t, guards, caps, degree, below, tolerance, _ENOUGH * tolerance)


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


def _denominators(variables: int, degree: int) -> Iterator[int]:
    """Degrees of the denominator to be tried; of one variable it is free up to the numerator's."""
    yield 0
    yield from [degree] if variables == 1 and degree else range(1, degree + 1)


def _terms(exponents: Array, coefficients: Array) -> dict[tuple[int, ...], float]:
    return {
        tuple(int(k) for k in a): float(c) for a, c in zip(exponents, coefficients, strict=True)
    }


def _nested(terms: dict[tuple[int, ...], float], variables: Sequence[str]) -> str:
    """Horner's form in the first variable, of Horner's forms in the others."""
    if not variables:
        return repr(terms[()]) if terms[()] >= 0 else f"({terms[()]!r})"
    result = ""
    for power in range(max(a[0] for a in terms), -1, -1):
        part = {a[1:]: c for a, c in terms.items() if a[0] == power}
        inner = _nested(part, variables[1:]) if part else ""
        product = f"{variables[0]}*{result}" if result else ""
        result = f"({inner} + {product})" if inner and product else inner or product
    return result


def _fit(
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
