"""An equilibrium that depends on parameters as rational functions, with a guaranteed bound."""

import itertools
from collections.abc import Sequence, Sized
from dataclasses import dataclass

import casadi as ca
import numpy as np

from mbdlft.errors import StructureError, TrimError
from mbdlft.expression import parse
from mbdlft.fit import rational
from mbdlft.fit.branch import follow, start_branch
from mbdlft.fit.prove import Proof, prove
from mbdlft.fit.rational import Rational
from mbdlft.fit.system import System, system
from mbdlft.lft.lft import Array

_MARGIN = 0.9  # of the tolerance, for the samples: the error between them may be larger
_FEWEST = {1: 33, 2: 13, 3: 8}  # samples along each parameter, by the number of parameters
_ROUNDS = 5  # of one degree with points that the proof found


@dataclass(frozen=True, slots=True)
class EquilibriumFit:
    """Rational functions fit_i(p) with |fit_i(p) - t_i(p)| <= bound_i on the whole box.

    Attributes
    ----------
    names : names of the parameters, q of them
    functions : n rational functions of p - center
    expressions : the same n functions as texts; it is for them that the bound is proved
    bound : Array (n,)
        Proved bound of the error, in the unit of the unknown.
    found : Array (n,)
        Largest error at the points that were looked at; the largest of all is between the two.
    pieces : int
        Number of pieces of the box that the proof examined.
    """

    names: tuple[str, ...]
    functions: tuple[Rational, ...]
    expressions: tuple[str, ...]
    bound: Array
    found: Array
    pieces: int

    def __call__(self, p: Array) -> Array:
        """Values (N, n) at p (N, q)."""
        return np.stack([function(p) for function in self.functions], axis=1)


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

    For each unknown the smallest total degree is taken that meets the tolerance.

    Parameters
    ----------
    residual : casadi.Function
        (t, p) -> f (n,): + - * /, integer powers, sqrt, sin, cos and tan of the n unknowns t (tan of
        half an angle, or m) and the q parameters p.
    nominal, low, high : Array (q,)
        A value of the parameters, and the box, in the units of the residual (SI).
    start : Array (n,)
        Near to the root at `nominal`; the branch through that root is fitted.
    tolerance : float
        Largest bound, in the units of the unknowns.
    names : sequence of str, optional
        Names of the parameters for expressions and messages; p1, p2, ... by default.
    largest_degree : int
        Total degree at which to give up.
    most_pieces : int
        Number of pieces of the box at which to give up.

    Raises
    ------
    TrimError
        There is no root at `start`; the branch folds or bifurcates in the box; or the tolerance is
        not met with the largest degree or the most pieces.
    StructureError
        Sizes do not fit together, or the box is empty.
    NotRationalError
        The residual has another operation.
    """
    nominal, low, high, start = (
        np.asarray(value, dtype=float).reshape(-1) for value in (nominal, low, high, start)
    )
    names = tuple(names or (f"p{k + 1}" for k in range(len(nominal))))
    _check(residual, nominal, low, high, start, tolerance, names)
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        return _fit(
            system(residual, names),
            nominal,
            low,
            high,
            start,
            tolerance,
            largest_degree,
            most_pieces,
        )


def _fit(
    s: System,
    nominal: Array,
    low: Array,
    high: Array,
    start: Array,
    tolerance: float,
    largest_degree: int,
    most_pieces: int,
) -> EquilibriumFit:
    root = start_branch(s, nominal, start)
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    extra = np.zeros((0, len(low)))
    best = np.full(s.unknowns, np.inf)
    functions: list[Rational | None] = [None] * s.unknowns
    for degree in range(largest_degree + 1):
        for _ in range(_ROUNDS):
            points = np.vstack([nominal, nodes(center, half, degree), extra])
            roots = follow(s, nominal, root, points)
            for i in range(s.unknowns):
                if functions[i] is None:
                    x = (points - center) / half
                    fit, error = rational.smallest_fit(x, roots[:, i], degree, _MARGIN * tolerance)
                    best[i] = min(best[i], error)
                    if error <= _MARGIN * tolerance:
                        functions[i] = rational.physical(fit, center, half)
            ready = [function for function in functions if function is not None]
            if len(ready) < s.unknowns:
                break
            texts = tuple(rational.text(function, s.names) for function in ready)
            found = np.max(np.abs([f(points) for f in ready] - roots.T), axis=1)
            goal = np.full(s.unknowns, tolerance)
            proof = prove(s, [parse(text) for text in texts], low, high, goal, found, most_pieces)
            if proof.complete:
                return EquilibriumFit(
                    s.names, tuple(ready), texts, proof.bound, proof.found, proof.pieces
                )
            if not len(proof.exceptions):
                raise _not_proved(s, proof, nominal, root, tolerance, most_pieces)
            exact = follow(s, nominal, root, proof.exceptions)
            errors = np.max(np.abs([f(proof.exceptions) for f in ready] - exact.T), axis=1)
            extra = np.vstack([extra, proof.exceptions])
            functions = [
                f if e <= _MARGIN * tolerance else None for f, e in zip(ready, errors, strict=True)
            ]
            if None not in functions:
                raise _not_proved(s, proof, nominal, root, tolerance, most_pieces)
    raise TrimError(
        f"equilibrium of {s.name!r}: no rational fit up to degree {largest_degree} is within "
        f"{tolerance:g}; the errors came down to {', '.join(f'{e:.1e}' for e in best)}. Use a larger "
        "tolerance or largest_degree, or a smaller range."
    )


def nodes(center: Array, half: Array, degree: int) -> Array:
    """Samples (N, q): products of Chebyshev nodes with the ends, enough for a total degree."""
    q = len(center)
    count = max(_FEWEST.get(q, 5), (2 if q > 2 else 3) + 2 * degree if q < 4 else degree + 2)
    x = np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray(center + half * np.array(list(itertools.product(x, repeat=q))))


def _not_proved(
    s: System, proof: Proof, nominal: Array, root: Array, tolerance: float, most_pieces: int
) -> TrimError:
    """What stopped a proof although no error above the tolerance was found."""
    if proof.stuck is not None:
        follow(s, nominal, root, proof.stuck[None])  # raises if the branch ends on the way
        return TrimError(
            f"equilibrium of {s.name!r}: nothing can be proved near {s.at(proof.stuck)}: df/dt is "
            "singular there (a fold or a bifurcation), or the tolerance "
            f"{tolerance:g} is too small for double precision. Use a smaller range or a larger "
            "tolerance."
        )
    return TrimError(
        f"equilibrium of {s.name!r}: the bound {tolerance:g} is proved on "
        f"{100 * proof.share:.3g} % of the box only, with {most_pieces} pieces; no error above "
        f"{', '.join(f'{e:.1e}' for e in proof.found)} was found. Use more pieces, a larger "
        "tolerance or a smaller range."
    )


def _check(
    residual: ca.Function,
    nominal: Array,
    low: Array,
    high: Array,
    start: Array,
    tolerance: float,
    names: tuple[str, ...],
) -> None:
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
