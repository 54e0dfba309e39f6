"""Fewer repetitions of one delta, by Newton's method on the values.

With M = [A B ; C D], Y = [C Delta (I - A Delta)^-1, I] and W = [Delta (I - A Delta)^-1 B ; I] a change dM
changes the value to first order by Y dM W. The entries of M in the rows and columns of one delta are
the unknowns, all others stay: some directions of that delta are left out, and the unknowns are fitted to
the values until the difference is rounding (Levenberg 1944, Marquardt 1963). As many as the bound allows
are left out first: fewer unknowns are quicker, and have fewer false ends. LFTs between the degree and
what n-D reduction finds can belong to a continuous family: of Theorem 2 (docs/pairs.md), by the lines
where its quotient lives.

The products Y dM W of a row i and a column b have the scalar products

    Re sum over points of (Y^H Y)_ij (conj(W) W^T)_bc,

so the normal equations are sums of Kronecker products, whatever the number of inputs and outputs.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dpotrf, dpotrs

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, Block, consecutive
from mbdlft.order.circles import CircleValues, Complex, Fit, circle_values, fit_of, scaled, unscaled
from mbdlft.order.reduction import balancing
from mbdlft.order.work import UNIT, Work, product

CLOSE = 2  # forms so much larger than the smallest are looked at
_TURNS = 4  # directions that are left out, for each repetition above the bound
_MOST_UNKNOWNS = 3000  # more take seconds a step
_STEPS, _STALLED, _GAIN = 200, 10, 1.2  # at most; so many without this gain are the last
_NOISE = 0.01  # of the entries: starts where nothing vanishes by chance
_DAMPING = 1e-2  # at first, over the difference
_EASED, _RAISED = 0.25, 5.0  # the damping after a step, and after one that gains nothing
_LEAST_DAMPING, _RIDGE = 1e-9, 1e-15
_ROUNDING = 1e-15  # of the values: nothing to gain below
_EXACT = 1e-12  # a difference that is only rounding
_CONVERGES = 1e-6  # a difference from which few steps lead to rounding: they are made in any case
_RAISES = 10
_SLOW, _NEAR_DOUBLE = 6.0, 1e-3  # a gain below is that of two solutions that are one; a difference near
_NEAR_END = 1e-9  # a difference that is polished
_POLISHED, _LEAST_POLISH = 8, 2.0  # times; a smaller gain ends it
_LOSSY = 1e-14  # a difference that other coordinates make smaller
_OF_TRY = 0.15  # units of work, which most tries do not need
_PASSES = 60  # over the normal equations, beside their sums
_LEAST_STEPS = 8  # of a try: one that cannot make as many is not begun


def refit(
    forms: Sequence[LFT],
    source: LFT,
    bound: Mapping[str, int],
    least: int,
    keeps: Callable[[LFT], bool],
    seed: int,
    work: Work,
) -> LFT:
    """The smallest of some LFTs of one value, and of those that have repetitions less.

    Forms not much larger than the smallest are taken in turn; each has its share of the work. The order
    `least` ends it, and `keeps` tells whether an LFT has the value.
    """
    forms = sorted(forms, key=lambda form: form.order)
    close = [form for form in forms if form.order <= forms[0].order + CLOSE]
    if work.is_over:
        return close[0]
    for k, form in enumerate(close):
        of_form = work.part(1.0 / (len(close) - k))
        below = min(other.order for other in close)
        less = partial(
            fewer,
            source=source,
            bound=bound,
            least=least,
            tries=_TURNS,
            seed=seed,
            work=of_form,
            below=below,
        )
        close[k] = _followed(form, less, least, keeps, of_form)
        if close[k].order <= least:
            return close[k]
    return min(close, key=lambda form: form.order)


def _followed(
    a: LFT,
    candidates: Callable[[LFT], Iterator[LFT]],
    least: int,
    keeps: Callable[[LFT], bool],
    work: Work,
) -> LFT:
    """The last of the LFTs that come one from the other, by the first candidate that keeps the value."""
    smaller: LFT | None = a
    while smaller is not None:
        a = smaller
        if a.order <= least or work.is_over:
            break
        smaller = next((candidate for candidate in candidates(a) if keeps(candidate)), None)
    return a


def above_bound(a: LFT, bound: Mapping[str, int]) -> dict[str, int]:
    """How many repetitions of each delta may be left out, if any; one always stays."""
    more = {name: size - max(1, bound[name]) for name, size in a.blocks}
    return {name: count for name, count in more.items() if count > 0}


def fewer(
    a: LFT,
    bound: Mapping[str, int],
    least: int,
    tries: int,
    seed: int,
    work: Work,
    below: int | None = None,
    source: LFT | None = None,
) -> Iterator[LFT]:
    """LFTs with fewer repetitions of one delta, as far as they are found until the work is over.

    A delta that meets its bound is left as it is; those far above it come first. In turn all, half, a
    quarter of the repetitions above the bound are left out, and then one, in directions of chance; none
    below the order `least`, and none of the order `below` or above it. The LFTs are equal to `a` up to
    rounding on circles around delta = 0: they are to be compared with it. The values are those of the
    `source`, which may have more digits.
    """
    random, more, sizes = np.random.default_rng(seed), above_bound(a, bound), dict(a.blocks)
    names = sorted(more, key=lambda name: bound[name] / sizes[name])
    turns = []
    for name in names:
        most = min(more[name], a.order - least)
        halves = (-(-most >> halved) for halved in range(more[name]))  # rounded up
        counts = [count for count in halves if below is None or a.order - count < below]
        if not counts:
            continue
        first = seed % len(counts)  # rounds of a search begin differently
        turns += [(name, count) for count in counts[first:] + counts[:first]]
    for _, (name, count) in itertools.product(range(tries), turns):
        if work.is_over:
            return
        try:
            fitted = _fitted(a, source or a, name, count, random, work)
        except (LinAlgError, np.linalg.LinAlgError):  # a pole at one of the points
            continue
        if fitted is not None:
            yield fitted


def _fitted(
    a: LFT, source: LFT, name: str, count: int, random: np.random.Generator, work: Work
) -> LFT | None:
    """Without directions of a delta, whose rows and columns are the unknowns; None without the values."""
    block, n = a.slices()[name], a.order - count
    span = slice(block.start, block.stop - count)
    signals = int(np.sum(np.any(a.M21, axis=1)) + np.sum(np.any(a.M12, axis=0)))
    size = span.stop - span.start
    unknowns = size * (2 * n - size + signals)
    of_step = (_of_factor(unknowns) + product(_PASSES, unknowns, unknowns)) / UNIT  # of work, at least
    if unknowns > _MOST_UNKNOWNS or _LEAST_STEPS * of_step > max(_OF_TRY, work.most):
        return None
    truth = circle_values(a, source, unknowns, random, work)
    M = scaled(a, truth)
    turn = np.linalg.qr(random.standard_normal((block.stop - block.start,) * 2))[0]
    M[block] = turn.T @ M[block]
    M[:, block] = M[:, block] @ turn
    gone = range(span.stop, block.stop)
    M = np.delete(np.delete(M, gone, axis=0), gone, axis=1)
    kept = tuple(Block(other.name, other.size - count * (other.name == name)) for other in a.blocks)
    unknown = np.zeros(M.shape, dtype=bool)
    unknown[span], unknown[:, span] = True, True
    unknown[n:, n:] = False
    noise = _NOISE * math.sqrt(np.mean(M**2)) * random.standard_normal(M.shape)
    start = fit_of(M + np.where(unknown, noise, 0.0), kept, truth, work)
    fit = _descend(start, kept, span, truth, work)
    return unscaled(fit.M, kept, a, truth) if fit.size < _EXACT else None


def _descend(fit: Fit, kept: tuple[Block, ...], block: slice, truth: CircleValues, work: Work) -> Fit:
    """Newton's method, damped, until nothing is gained."""
    damping, sizes, work = _DAMPING, [fit.size], work.of_try(_OF_TRY)
    for _ in range(_STEPS):
        if (work.is_over and fit.size > _CONVERGES) or fit.size < _EXACT:
            break
        normal, slope = _normal_equations(fit, block, work)
        for _ in range(_RAISES):
            ridge = damping * fit.size + _RIDGE
            try:
                step = _spread(_solved(normal, ridge, slope, work), fit, block)
                after = fit_of(fit.M - step, kept, truth, work)
            except (LinAlgError, np.linalg.LinAlgError):
                damping *= _RAISED
                continue
            if after.size < fit.size:
                break
            damping *= _RAISED
        else:
            break
        if _NEAR_DOUBLE > after.size > fit.size / _SLOW:
            after = _of_twice(fit, after, kept, truth, work)
        fit, damping = after, max(_EASED * damping, _LEAST_DAMPING)
        sizes.append(fit.size)
        if len(sizes) > _STALLED and sizes[-1 - _STALLED] < _GAIN * fit.size:
            break
    if fit.size >= _NEAR_END:
        return fit
    polished = _polished(fit, kept, block, truth, work)
    if polished.size <= _LOSSY:
        return polished
    turned, everything = _balanced(fit, kept, truth, work), slice(0, sum(b.size for b in kept))
    for span in (block, everything):  # with all unknowns a step takes twenty times as long
        turned = _polished(turned, kept, span, truth, work)
        if turned.size <= _LOSSY:
            break
    return min(polished, turned, key=attrgetter("size"))


def _of_twice(fit: Fit, after: Fit, kept: tuple[Block, ...], truth: CircleValues, work: Work) -> Fit:
    """The better of a step and of twice the step, which leads to where two solutions are one.

    Near such a solution Newton's method halves the distance, and a quarter of the difference is left.
    """
    try:
        twice = fit_of(2.0 * after.M - fit.M, kept, truth, work)
    except (LinAlgError, np.linalg.LinAlgError):
        return after
    return min(after, twice, key=attrgetter("size"))


def _balanced(fit: Fit, kept: tuple[Block, ...], truth: CircleValues, work: Work) -> Fit:
    """The fit with each block in coordinates in which it is well-conditioned on the circles.

    There it has all digits as a whole, but small entries of its value lose some: it is for fits that
    have lost more.
    """
    M = fit.M.copy()
    for rows in consecutive(block.size for block in kept):
        into, out = fit.W[:, rows], fit.Y[:, :, rows]
        T = balancing(*(np.mean(x, axis=0).real for x in (into @ _adjoint(into), _adjoint(out) @ out)))
        M[rows] = np.linalg.solve(T, M[rows])
        M[:, rows] = M[:, rows] @ T
    return fit_of(M, kept, truth, work)


def _polished(best: Fit, kept: tuple[Block, ...], block: slice, truth: CircleValues, work: Work) -> Fit:
    """Newton's method on the rows and columns of a block, or of all, with next to no damping."""
    size, ridge = block.stop - block.start, _RIDGE
    if size * (sum(best.M.shape) - size) > _MOST_UNKNOWNS:
        return best
    for _ in range(_POLISHED):
        normal, slope = _normal_equations(best, block, work)
        try:
            step = _solved(normal, ridge * float(np.max(np.diagonal(normal))), slope, work)
            after = fit_of(best.M - _spread(step, best, block), kept, truth, work)
        except (LinAlgError, np.linalg.LinAlgError):
            ridge *= _RAISED
            continue
        if after.size > best.size / _SLOW:
            after = _of_twice(best, after, kept, truth, work)
        is_last = after.size > best.size / _LEAST_POLISH
        best = min(best, after, key=attrgetter("size"))
        if is_last:
            break
    return best


def _solved(normal: Array, ridge: float, slope: Array, work: Work) -> Array:
    """(normal + ridge I)^-1 slope; a LinAlgError if that is not positive."""
    work.add(_of_factor(len(normal)))
    factor = normal.copy().T  # in the order of LAPACK, which overwrites it
    factor[np.diag_indices_from(factor)] += ridge
    factor, failed = dpotrf(factor, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise LinAlgError
    return np.asarray(dpotrs(factor, slope, lower=1)[0])


def _of_factor(unknowns: int) -> float:
    """Operations of a triangular factor: a third of a product, at half of its speed."""
    return product(unknowns, unknowns, unknowns) / 1.5


def _normal_equations(fit: Fit, block: slice, work: Work) -> tuple[Array, Array]:
    """J^T J and J^T r for the rows `block` of M, all columns, then its columns, all other rows.

    A triangular factor reads the upper part of J^T J only: the block below the diagonal stays zero.
    """
    Y, W = fit.Y, fit.W
    others = np.delete(np.arange(Y.shape[2]), block)
    rows, columns = (Y[:, :, block], W), (Y[:, :, others], W[:, block])
    upper, last = _products(rows, columns), _products(columns, columns)
    blocks = [[_products(rows, rows), upper], [np.zeros(upper.T.shape), last]]
    slopes = [
        np.sum(_adjoint(y) @ fit.difference @ _adjoint(w), axis=0).real.ravel()
        for y, w in (rows, columns)
    ]
    points, unknowns = len(Y), sum(y.shape[2] * w.shape[1] for y, w in (rows, columns))
    work.add(product(2 * points + _PASSES, unknowns, unknowns))
    scale = 1.0 / fit.difference.size
    return np.block(blocks) * scale, np.concatenate(slopes) * scale


def _products(first: tuple[Complex, Complex], second: tuple[Complex, Complex]) -> Array:
    """Re sum of (Y1^H Y2)_ij (conj(W1) W2^T)_bc, as a matrix of (i, b) by (j, c)."""
    left = _adjoint(first[0]) @ second[0]
    right = np.conj(first[1]) @ np.swapaxes(second[1], 1, 2)
    (_, i, j), (_, b, c) = left.shape, right.shape
    real_left = np.concatenate([left.real, -left.imag]).reshape(-1, i * j)
    real_right = np.concatenate([right.real, right.imag]).reshape(-1, b * c)
    return np.asarray((real_left.T @ real_right).reshape(i, j, b, c).swapaxes(1, 2).reshape(i * b, j * c))


def _adjoint(values: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(np.conj(np.swapaxes(values, 1, 2)))


def _spread(step: Array, fit: Fit, block: slice) -> Array:
    """A step of the unknowns, as a change of M."""
    change = np.zeros_like(fit.M)
    count = block.stop - block.start
    change[block] = step[: count * fit.M.shape[1]].reshape(count, -1)
    others = np.delete(np.arange(len(fit.M)), block)
    change[others, block] = step[count * fit.M.shape[1] :].reshape(len(others), count)
    return change
