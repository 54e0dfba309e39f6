"""Tables as expressions: exact polynomials between breakpoints, which Delta-Theta forms find again."""

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Literal

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.exact.numbers import decimal
from mbdlft.problem.sx.constants import literal

Interpolation = Literal["linear", "cubic"]
Beyond = Literal["lines", "constant"]


def table_expression(
    argument: ca.SX,
    breakpoints: Sequence[float],
    values: Sequence[float],
    interpolation: Interpolation = "linear",
    beyond: Beyond = "lines",
) -> ca.SX:
    """A function that has values at breakpoints.

    Parameters
    ----------
    argument : SX
        A symbol.
    breakpoints, values : sequences of float (n,)
        Decimals, which are exact.
    interpolation : {"linear", "cubic"}
        Lines; or cubic polynomials whose slopes at the breakpoints keep the function monotone where the
        values are (Fritsch, Butland, SIAM J. Sci. Stat. Comput. 5, 1984).
    beyond : {"lines", "constant"}
        What stands before the first and behind the last breakpoint: lines with the slopes there, or the
        last values.

    Raises
    ------
    SceneError
        The points are no table.
    """
    b, v = np.asarray(breakpoints, dtype=float), np.asarray(values, dtype=float)
    if b.ndim != 1 or b.shape != v.shape or len(b) < 2 or not np.all(np.isfinite([b, v])):
        raise SceneError(
            f"table of {argument}: expected as many finite values as breakpoints, two or more; got "
            f"{b.shape} and {v.shape}."
        )
    if not np.all(np.diff(b) > 0):
        where = int(np.argmin(np.diff(b) > 0))
        raise SceneError(
            f"table of {argument}: breakpoints do not increase: {b[where]:g}, {b[where + 1]:g}."
        )
    if interpolation not in ("linear", "cubic") or beyond not in ("lines", "constant"):
        raise SceneError(
            f"table of {argument}: interpolation is 'linear' or 'cubic', and beyond is 'lines' or "
            f"'constant'; got {interpolation!r}, {beyond!r}."
        )
    exact = [(decimal(float(x)), decimal(float(y))) for x, y in zip(b, v, strict=True)]
    slopes = _monotone(b, v) if interpolation == "cubic" else None
    pieces = _pieces(exact, slopes)
    chord = pieces[-1][1] if slopes is None else slopes[-1]
    ends = (Fraction(0), Fraction(0)) if beyond == "constant" else (pieces[0][1], chord)
    every = [(exact[0][1], ends[0]), *pieces, (exact[-1][1], ends[1])]
    origins = [exact[0][0], *(x for x, _ in exact)]
    cuts = [literal(x) for x, _ in exact]
    return joined(
        argument, cuts, [_local(argument, o, p) for o, p in zip(origins, every, strict=True)]
    )


def _monotone(b: Array, v: Array) -> list[Fraction]:
    from scipy.interpolate import PchipInterpolator

    return [decimal(float(x)) for x in PchipInterpolator(b, v).derivative()(b)]


def _pieces(
    points: Sequence[tuple[Fraction, Fraction]], slopes: Sequence[Fraction] | None
) -> list[tuple[Fraction, ...]]:
    """Coefficients of each piece, in powers of the distance from its left end."""
    found: list[tuple[Fraction, ...]] = []
    for k, ((a, low), (b, high)) in enumerate(pairwise(points)):
        h = b - a
        chord = (high - low) / h
        if slopes is None:
            found.append((low, chord))
        else:
            left, right = slopes[k], slopes[k + 1]
            found.append(
                (low, left, (3 * chord - 2 * left - right) / h, (left + right - 2 * chord) / h**2)
            )
    return found


def _local(argument: ca.SX, origin: Fraction, coefficients: Sequence[Fraction]) -> ca.SX:
    distance, found = argument - literal(origin), ca.SX(0)
    for c in reversed(coefficients):
        found = found * distance + literal(c)
    return ca.SX(found)


def joined(argument: ca.SX, cuts: Sequence[float | ca.SX], parts: Sequence[ca.SX]) -> ca.SX:
    """The part between each two cuts, found by halves."""
    if not cuts:
        return parts[0]
    k = len(cuts) // 2
    left = joined(argument, cuts[:k], parts[: k + 1])
    right = joined(argument, cuts[k + 1 :], parts[k + 1 :])
    return ca.SX(ca.if_else(argument < cuts[k], left, right))
