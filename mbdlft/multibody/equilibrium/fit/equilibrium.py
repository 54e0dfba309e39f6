"""An equilibrium that depends on parameters as rational functions, with a guaranteed bound."""

import itertools
from collections.abc import Sequence, Sized
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, TrimError
from mbdlft.base.expression import parse
from mbdlft.multibody.equilibrium.fit.prove import Proof, prove
from mbdlft.multibody.equilibrium.fit.rational import Rational, physical, smallest_fit, text
from mbdlft.multibody.equilibrium.fit.system import System, follow, start_branch, system

_MARGIN = 0.9  # of the tolerance, for the samples: the error between them may be larger
_FEWEST = {1: 33, 2: 13, 3: 8}  # samples along each parameter, by the number of parameters
_GUARDS = {1: 257, 2: 41, 3: 13}  # points along each parameter where poles are looked for
_AROUND = 2.0**-18  # of half the box: several of the smallest pieces of a proof
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


class _Task(NamedTuple):
    """What is asked for: the arguments of `fit_equilibrium`."""

    nominal: Array
    low: Array
    high: Array
    start: Array
    tolerance: float
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
    task = _Task(nominal, low, high, start, tolerance, most_pieces)
    names = tuple(names or (f"p{k + 1}" for k in range(len(nominal))))
    _check(residual, task, names)
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        return _fit(system(residual, names), task, largest_degree)


def _fit(s: System, task: _Task, largest_degree: int) -> EquilibriumFit:
    nominal, low, high, start, tolerance, most_pieces = task
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
            found = np.max(np.abs([f(points) for f in ready] - roots.T), axis=1)
            goal, trees = np.full(s.unknowns, tolerance), [parse(one) for one in texts]
            probes = nodes(center, half, 2 * count if len(low) < 3 else count + 1)
            proof = prove(s, trees, low, high, goal, found, probes, most_pieces)
            if proof.complete:
                return EquilibriumFit(
                    s.names, tuple(ready), texts, proof.bound, proof.found, proof.pieces
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
    raise TrimError(
        f"equilibrium of {s.name!r}: no rational fit up to degree {largest_degree} is within "
        f"{tolerance:g}; the errors came down to {', '.join(f'{e:.1e}' for e in best)}. Use a larger "
        "tolerance or largest_degree, or a smaller range."
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


def _not_proved(
    s: System, proof: Proof, stuck: Array | None, task: _Task, root: Array
) -> TrimError:
    """What stopped a proof although no error above the tolerance was found."""
    if stuck is not None:
        follow(s, task.nominal, root, stuck[None])  # raises if the branch ends on the way
        return TrimError(
            f"equilibrium of {s.name!r}: nothing can be proved near {s.at(stuck)}: df/dt is singular "
            "there or nearly so (a fold or a bifurcation), or double precision does not carry the "
            f"tolerance {task.tolerance:g}. Use a smaller range or a larger tolerance."
        )
    return TrimError(
        f"equilibrium of {s.name!r}: the bound {task.tolerance:g} is proved on "
        f"{100 * proof.share:.3g} % of the box only, with {task.most_pieces} pieces; no error above "
        f"{', '.join(f'{e:.1e}' for e in proof.found)} was found. Use more pieces, a larger "
        "tolerance or a smaller range."
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
