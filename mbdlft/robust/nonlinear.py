"""Nonlinear functions as gains that move in any way, and the states from which this holds.

A function with bounds l <= (f(a) - f(b))/(a - b) <= h of its slope is zeta = k(t) omega between any two
motions, with some k(t) in [l, h]; one in the sector [l, h] is that between a motion and zero. What is
proved for all k(t) is true of the function, as long as its argument stays in the range of these bounds.

It stays there from a level set of what proves robust stability: V = x'P x falls along all motions, so
V <= c is never left. There |y| <= r for an output y = C x + D w, w = Delta z, if

    r^2 V/c - y'y - (z'X z - w'X w + z'Y w - w'Y z) >= 0

for some X = X' > 0, Y = -Y' of the structure of Delta, where the last part is not negative for
|delta| <= 1.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., sections 7.1 (absolute stability) and 8.2 (regions of
attraction); S-procedure: Boyd et al., Linear Matrix Inequalities in System and Control Theory (1994),
section 2.6.3.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.base.running import one_thread
from mbdlft.lft.block import Block
from mbdlft.lft.lft import LFT
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.evidence import Bounds, MotionProof, ProofOfMotions
from mbdlft.robust.moving.variation import form_of, is_negative, least_level, scaled, sizes_of
from mbdlft.robust.proofs import verify
from mbdlft.robust.realization import realization, turned
from mbdlft.robust.sector import checked_range, sector_bounds, slope_bounds
from mbdlft.system.connection import connect
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import Parameters, System
from mbdlft.system.theta import DeltaThetaModel, ThetaFunction

_OUTSIDE = 1e-6  # of a level: the first part by which it is taken larger than what the solver found
_TRIES = 5  # levels, each with ten times the slack of the last
Kind = Literal["slope", "sector"]
Ranges = Mapping[str, tuple[float, float]]
_WIDER = 1e-9  # of the width or the size of bounds: they are moved apart by this, for rounding


@dataclass(frozen=True, slots=True, eq=False)
class SafeRegion:
    """States x with x'P x <= 1, which no motion without inputs leaves.

    Attributes
    ----------
    states : tuple of str
    P : array (n, n)
    """

    states: tuple[str, ...]
    P: Array

    def value(self, states: Mapping[str, float] | ArrayLike) -> float:
        """x'P x of states by name, the others zero, or of an array (n,): at most 1 in the region."""
        if isinstance(states, Mapping):
            where = positions_of(list(states), list(self.states), "safe region: states")
            x = np.zeros(len(self.states))
            x[where] = list(states.values())
        else:
            x = np.asarray(states, dtype=float)
        return float(x @ self.P @ x)

    @property
    def extents(self) -> dict[str, float]:
        """The largest size of each state in the region."""
        largest = np.sqrt(np.diag(np.linalg.inv(self.P)))
        return dict(zip(self.states, largest.tolist(), strict=True))


@arguments_checked
def safe_region(system: System, bounds: Bounds, ranges: Mapping[str, tuple[float, float]]) -> SafeRegion:
    """States from which outputs stay in their ranges, for all motions of the parameters in the box.

    Parameters
    ----------
    system : System
        Such as that of `with_sectors`, whose outputs omega are the arguments of the functions.
    bounds : Bounds
        Of its `robust_stability`, of 1 or more, with ``rates=inf``: then V does not depend on parameters.
    ranges : mapping of names of outputs to (low, high)
        Zero is inside; of slopes, these are distances from the equilibrium.

    Returns
    -------
    SafeRegion
        For inputs that are zero. It is proved in balls that V <= 1 keeps the outputs in their ranges.

    Raises
    ------
    AnalysisError
        `bounds` are not such; a range does not contain zero; nothing was proved.
    """
    proof = bounds.proof
    if not isinstance(proof, ProofOfMotions) or bounds.kind != "robust stability":
        raise AnalysisError("safe_region: expected the bounds of robust_stability(..., rates=inf).")
    if bounds.lower < 1.0 or not isinstance(proof, MotionProof) or proof.P.shape != proof.states.shape:
        raise AnalysisError(
            f"safe_region: the proof is for {bounds.lower:.4g} times the box"
            + ("." if bounds.lower < 1.0 else ", with parameters in V, or more than squares of states.")
            + " Expected bounds.lower >= 1, with rates=inf for all parameters."
        )
    wrong = verify(system, bounds)
    if wrong:
        raise AnalysisError(f"safe_region: the bounds are not proved: {wrong}")
    names = [s.name for s in system.outputs]
    rows = positions_of(list(ranges), names, "safe_region: ranges")
    for name, (low, high) in ranges.items():
        if not low < 0.0 < high:
            raise AnalysisError(
                f"safe_region: the range [{low:g}, {high:g}] of {name} has no zero inside."
            )
    with one_thread():
        model = scaled(realization(system, (), rows, bounds.leave_out), proof.channels, proof.time)
        levels = [
            _level(model, proof, k, name, min(-low, high))
            for k, (name, (low, high)) in enumerate(ranges.items())
        ]
    L = proof.states
    states = tuple(s.name for s in system.states if s.name not in bounds.leave_out)
    return SafeRegion(states, max(levels) * (L.T @ proof.P @ L))


def _level(model: Realization, proof: MotionProof, row: int, name: str, most: float) -> float:
    """A number with |y| <= r where this times x'P x is at most 1; an error if none was proved."""
    y = model._replace(
        G=model.G[row : row + 1] / most,
        H=model.H[row : row + 1] / most,
        E=model.E[:, :0],
        F=model.F[:, :0],
        J=model.J[row : row + 1, :0],
    )
    rates = np.full(len(model.sizes), np.inf)
    back = np.asarray(np.linalg.inv(proof.states))
    near = form_of(turned(y, proof.states, back), rates)
    form = form_of(y, rates)
    sizes = sizes_of(form, 1.0, rates)
    solution = least_level(near, sizes, proof.P)
    least, X, Y = solution or (np.inf, proof.X, proof.Y)
    size = max(1.0, float(np.linalg.norm(sizes[:, None] * near.R)) ** 2)
    definite = float(np.min(np.linalg.eigvalsh(proof.P))) / size
    for attempt in range(_TRIES if np.isfinite(least) else 0):
        slack = _OUTSIDE * 10.0**attempt
        level = least * (1.0 + slack)
        falling = form._replace(W=-0.5 * level * form.V)
        wider = X + 0.1 * slack * least * definite * np.eye(len(X))
        if is_negative(falling, sizes, 1.0, proof.states, proof.P, wider, Y):
            return float(level)
    raise AnalysisError(
        f"safe_region: no level of V was proved to keep {name} in its range. Take functions of "
        "signals that depend less on parameters."
    )


class _Gain(NamedTuple):
    """One gain: its parameter, the function, and the signal of the argument."""

    parameter: Parameter
    zeta: str
    omega: str


@arguments_checked
def with_sectors(model: DeltaThetaModel, ranges: Ranges | None = None, *, of: Kind = "slope") -> System:
    """The system with gains in the place of nonlinear functions, which move in any way within bounds.

    Parameters
    ----------
    model : DeltaThetaModel
    ranges : mapping of names of `model.omega` to (low, high)
        Where the bounds are proved, and what is said of the system is true; the ranges of the functions
        by default.
    of : {"slope", "sector"}
        Slopes: the states, inputs and outputs of the system are the differences of two motions of the
        model with the same parameters, so an equilibrium may depend on them. Sectors: they are those of
        the model, and functions have one argument and are 0 at 0.

    Returns
    -------
    System
        Its parameters are those of the model, and for each function and argument one of the role
        "nonlinear", which `robust_stability` and `worst_case_gain` take as moving in any way; its outputs
        are those of the model, then its omega.

    Raises
    ------
    AnalysisError
        A range is unknown, or not finite; a function has no finite bounds there, or no sector.
    WellPosednessError
        The loop through the gains is singular.
    """
    known = dict(ranges or {})
    check_known("argument", known, model.omega, "with_sectors", AnalysisError)
    if of not in ("slope", "sector"):
        raise AnalysisError(f"with_sectors: of: expected 'slope' or 'sector', got {of!r}.")
    if of == "sector" and model.has_one:
        raise AnalysisError(
            f"with_sectors: model {model.name!r} has a constant input, and no equilibrium at zero, which "
            "sectors are around. Take slopes (of='slope'), which hold around each equilibrium."
        )
    taken = {*model.linear.parameters.names}
    gains: list[_Gain] = []
    for f in model.functions:
        what, ends = f"with_sectors: function {f.name!r}", []
        for j, signal in enumerate(f.signals):
            advice = f"Give one: ranges={{{signal!r}: (low, high)}}."
            ends.append(checked_range(f, j, known.get(signal, f.ranges[j]), what, advice))
        for signal, argument, bounds in zip(f.signals, f.arguments, _bounds(f, ends, of), strict=True):
            name = _identifier(f.name if len(f.signals) == 1 else f"{f.name}_{argument}", taken)
            gains.append(_Gain(_parameter(name, bounds), f.name, signal))
    return _closed(model, gains)


def _bounds(
    f: ThetaFunction, ranges: list[tuple[float, float]], of: Kind
) -> tuple[tuple[float, float], ...]:
    if of == "sector" and len(f.signals) > 1:
        raise AnalysisError(
            f"with_sectors: function {f.name!r} has {len(f.signals)} arguments, and a sector is of one. "
            "Take slopes (of='slope')."
        )
    of_arguments: tuple[tuple[float, float], ...]
    if len(f.signals) == 1:
        proved = sector_bounds(f, *ranges[0])
        of_arguments = (getattr(proved, of),)
    else:
        of_arguments = slope_bounds(f, ranges)
    for name, bounds in zip(f.signals, of_arguments, strict=True):
        if not all(map(math.isfinite, bounds)):
            raise AnalysisError(
                f"with_sectors: function {f} has no finite {of} over the range of {name}: it may jump or "
                "be vertical there, or, for a sector, not be 0 at 0. Take a smaller range, or a model "
                "without the jump."
            )
    return of_arguments


def _parameter(name: str, bounds: tuple[float, float]) -> Parameter:
    low, high = bounds
    more = _WIDER * max(high - low, abs(low), abs(high)) or _WIDER
    low, high = low - more, high + more
    return Parameter(name, 0.5 * (low + high), low, high, role="nonlinear")


def _identifier(name: str, taken: set[str]) -> str:
    plain = "".join(c if c.isalnum() else "_" for c in name).strip("_")
    while plain in taken:
        plain += "_"
    taken.add(plain)
    return plain


def _closed(model: DeltaThetaModel, gains: list[_Gain]) -> System:
    """The linear part with the gains between omega and zeta."""
    linear = model.linear
    inputs = {s.name: s for s in linear.inputs}
    outputs = {s.name: s for s in linear.outputs}
    gains = sorted(gains, key=lambda gain: gain.parameter.name)
    zeta, omega = list(model.zeta), list(model.omega)
    read, act = np.zeros((len(gains), len(omega))), np.zeros((len(zeta), len(gains)))
    middle = np.zeros((len(zeta), len(omega)))
    for k, (parameter, to, of) in enumerate(gains):
        read[k, omega.index(of)] = 1.0
        act[zeta.index(to), k] = parameter.map.gain
        middle[zeta.index(to), omega.index(of)] = parameter.map.b0
    inner = np.diag([-gain.parameter.map.a1 for gain in gains])
    blocks = tuple(Block(gain.parameter.name, 1) for gain in gains)
    between = System(
        "gains",
        LFT(inner, read, act, middle, blocks),
        (),
        tuple(outputs[name] for name in omega),
        tuple(inputs[name] for name in zeta),
        Parameters(gain.parameter for gain in gains),
    )
    u = [s.name for s in model.inputs]
    plain: Any = linear[[s.name for s in linear.outputs], [*u, *zeta]]
    y = [s.name for s in model.outputs]
    return connect([plain, between], inputs=u, outputs=[*y, *omega], name=linear.name)
