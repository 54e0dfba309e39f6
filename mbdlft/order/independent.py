"""Fewer channels where their functions of the deltas are linearly dependent.

With M = [A B ; C D] and Y = C (I - Delta A)^-1, whose columns are functions of the deltas,

    Y = C + Y Delta A,    value = D + Y Delta B.

If c + Y Delta n = 0 for constant vectors c and n, then M + [n ; c] m has the same Y and the same value
for every row m: both equations hold again. With m = -(row k of M) / n_k, row k becomes zero, and channel
k is left out. So in a smallest LFT the functions 1 and Y Delta are independent, and those of its
transpose too. n-D reduction does not see this: delta_1 (delta_2 f) and delta_2 (delta_1 f) are one
function but two words.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, Block, transpose
from mbdlft.order.circles import channels_at, pole_distance
from mbdlft.order.reduction_in_doubles import reduce_order
from mbdlft.order.work import Work, product, reduction, singular_values, solutions

_SEED = 0
_MORE_SAMPLES = 1.5  # times as many as there are functions
_RADIUS = (0.5, 1.5)  # of the circles on which the deltas are sampled, least and largest
_INSIDE = 0.7  # radius over the distance of the nearest pole
_ZERO = 2.0**-38  # of the largest singular value: below it functions are dependent
_NOISE = 2.0**-40  # of a dependence: a smaller part is rounding
_WORST = 1e6  # condition of the part of the dependences that is divided by


def independent(a: LFT, work: Work) -> LFT:
    """The same value in channels with independent functions; `a` itself if they are.

    Numbers decide what is dependent, so the value is to be compared with that of `a`.
    """
    while True:
        smaller = _independent_columns(a, work)
        smaller = transpose(_independent_columns(transpose(smaller), work))
        if smaller.order == a.order:
            return a
        a = smaller


def _independent_columns(a: LFT, work: Work) -> LFT:
    """The same for the functions Y Delta alone."""
    n, outputs = a.order, a.shape[0]
    if not n or not outputs:
        return a
    try:
        dependences = _dependences(_functions(a, work), outputs, work)
    except np.linalg.LinAlgError:  # a pole at one of the samples
        return a
    if dependences is None:
        return a
    pivots, change = dependences
    change = np.vstack([change[outputs:], change[:outputs]])  # first the rows of z, then those of y
    M = np.block([[a.M11, a.M12], [a.M21, a.M22]])
    M -= change @ M[pivots]
    kept = np.setdiff1d(np.arange(n), pivots)
    sizes = [int(np.sum((kept >= part.start) & (kept < part.stop))) for part in a.slices().values()]
    blocks = [Block(block.name, size) for block, size in zip(a.blocks, sizes, strict=True)]
    work.add(reduction(n))
    M11, M12 = M[np.ix_(kept, kept)], M[kept, n:]
    return reduce_order(LFT(M11, M12, M[n:, kept], M[n:, n:], tuple(blocks)))


def _functions(a: LFT, work: Work) -> Array:
    """Values (samples, outputs + channels) of the functions 1 and Y Delta, in real and imaginary parts.

    The deltas run over circles, where their powers are orthogonal.
    """
    n, outputs = a.order, a.shape[0]
    random = np.random.default_rng(_SEED)
    points = int(_MORE_SAMPLES * (n + outputs) / outputs) + outputs
    least, largest = _RADIUS
    loops = [a.M11[part, part] for part in a.slices().values()]
    radii = [max(least, _INSIDE * pole_distance(loop, largest / _INSIDE)) for loop in loops]
    phases = random.uniform(0.0, 2.0 * np.pi, (points, len(a.blocks)))
    deltas = np.repeat(radii * np.exp(1j * phases), [block.size for block in a.blocks], axis=1)
    work.add(solutions(points, n, outputs))
    Y = channels_at(a.M11.T, a.M21.T, deltas).transpose(0, 2, 1)
    values = Y * deltas[:, None, :]
    sizes = np.max(np.abs(values), axis=(0, 2))
    units = np.where(sizes > 0.0, sizes, 1.0)
    ones = np.broadcast_to(np.eye(outputs), (points, outputs, outputs))
    both = np.concatenate([ones, values], axis=2) / units[:, None]
    rows = both.reshape(points * outputs, outputs + n)
    return np.vstack([rows.real, rows.imag])


def _dependences(
    functions: Array, outputs: int, work: Work
) -> tuple[NDArray[np.intp], Array] | None:
    """Channels that depend on the others, and (functions, dependences) that vanish, one in these."""
    rows, columns = functions.shape
    work.add(product(rows, columns, columns) + singular_values(columns, columns))
    sizes = np.linalg.norm(functions, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    triangle = np.asarray(np.linalg.qr(functions / sizes, mode="r"))
    _, values, right = np.linalg.svd(triangle)
    null = right[values <= _ZERO * values[0]].T
    count = null.shape[1]
    if not count:
        return None
    pivots = np.sort(qr(null[outputs:].T, mode="r", pivoting=True)[1][:count])
    part = null[outputs + pivots]
    if np.linalg.cond(part) > _WORST:
        return None
    change = null @ np.linalg.inv(part)
    change[np.abs(change) <= _NOISE] = 0.0
    # again, where they are not zero
    for column, pivot in zip(change.T, outputs + pivots, strict=True):
        others = np.setdiff1d(np.flatnonzero(column), [pivot])
        column[others] = np.linalg.lstsq(triangle[:, others], -triangle[:, pivot])[0]
    return pivots, np.asarray(change / sizes[:, None] * sizes[outputs + pivots])
