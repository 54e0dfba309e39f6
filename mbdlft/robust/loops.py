"""Nonlinear functions as gains that may move in any way: the loop whose robust stability is asked for.

A function with bounds l <= (f(a) - f(b))/(a - b) <= h of its slope is zeta = k(t) omega between any two
motions, with some k(t) in [l, h]; one in the sector [l, h] is that between a motion and zero. What is
proved for all k(t) is true of the function, as long as its argument stays in the range of these bounds.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., sections 7.1 (absolute stability) and 8.2 (regions of
attraction).
"""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from mbdlft.base.errors import AnalysisError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.lft.block import Block
from mbdlft.lft.lft import LFT
from mbdlft.robust.sector import sector_bounds, slope_bounds
from mbdlft.system.network import connect
from mbdlft.system.system import Parameters, System
from mbdlft.system.theta import DeltaThetaModel, ThetaFunction

Kind = Literal["slope", "sector"]
Ranges = Mapping[str, tuple[float, float]]
_WIDER = 1e-9  # of the width or the size of bounds: they are moved apart by this, for rounding


class _Gain(NamedTuple):
    """One gain: its parameter, the function, and the signal of the argument."""

    parameter: Parameter
    zeta: str
    omega: str


def with_sectors(
    model: DeltaThetaModel, ranges: Ranges | None = None, *, of: Kind = "slope"
) -> System:
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
    for name in known:
        if name not in model.omega:
            raise AnalysisError(f"with_sectors: {unknown_name('argument', name, model.omega)}")
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
        own = [_range(f, j, known) for j in range(len(f.signals))]
        for signal, argument, bounds in zip(
            f.signals, f.arguments, _bounds(f, own, of), strict=True
        ):
            name = _identifier(f.name if len(f.signals) == 1 else f"{f.name}_{argument}", taken)
            gains.append(_Gain(_parameter(name, f, bounds), f.name, signal))
    return _closed(model, gains)


def _range(f: ThetaFunction, j: int, known: Ranges) -> tuple[float, float]:
    signal, own = f.signals[j], f.ranges[j]
    low, high = (float(x) for x in known.get(signal, own))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise AnalysisError(
            f"with_sectors: function {f.name!r}: the range [{low:g}, {high:g}] of {signal} is not "
            f"finite. Give one: ranges={{{signal!r}: (low, high)}}."
        )
    if low < own[0] or high > own[1]:
        raise AnalysisError(
            f"with_sectors: function {f.name!r}: the range [{low:g}, {high:g}] of {signal} is not inside "
            f"that of the function, [{own[0]:g}, {own[1]:g}]."
        )
    return low, high


def _bounds(
    f: ThetaFunction, ranges: list[tuple[float, float]], of: Kind
) -> tuple[tuple[float, float], ...]:
    if of == "sector" and len(f.signals) > 1:
        raise AnalysisError(
            f"with_sectors: function {f.name!r} has {len(f.signals)} arguments, and a sector is of one. "
            "Take slopes (of='slope')."
        )
    found: tuple[tuple[float, float], ...]
    if len(f.signals) == 1:
        proved = sector_bounds(f, *ranges[0])
        found = (getattr(proved, of),)
    else:
        found = slope_bounds(f, ranges)
    for name, bounds in zip(f.signals, found, strict=True):
        if not all(map(math.isfinite, bounds)):
            raise AnalysisError(
                f"with_sectors: function {f} has no finite {of} over the range of {name}: it may jump or "
                "be vertical there, or, for a sector, not be 0 at 0. Take a smaller range, or a model "
                "without the jump."
            )
    return found


def _parameter(name: str, f: ThetaFunction, bounds: tuple[float, float]) -> Parameter:
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
