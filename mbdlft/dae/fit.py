"""Coefficients that are not rational in the parameters, replaced by fits with a guaranteed bound."""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.expression import evaluate
from mbdlft.base.grammar import parse
from mbdlft.base.parameter import Parameter
from mbdlft.dae.operations import column_of, free_symbols
from mbdlft.multibody.equilibrium.fit import fit_equilibrium
from mbdlft.sx.constants import in_doubles, literal


class CoefficientFit(NamedTuple):
    """A rational fit of a coefficient.

    Attributes
    ----------
    expression : SX
        Rational in the parameters, to be written in place of the coefficient.
    text : str
        The same.
    bound : float
        Proved bound of the error for all values of the parameters, in the unit of the coefficient.
    """

    expression: ca.SX
    text: str
    bound: float


def fit_coefficient(
    coefficient: ca.SX, parameters: Sequence[Parameter], symbols: Sequence[ca.SX], tolerance: float
) -> CoefficientFit:
    """A rational function near a coefficient such as sqrt(p), with a proved bound over the whole range.

    Parameters
    ----------
    coefficient : SX
        + - * /, integer powers, sqrt, sin, cos and tan of symbols of parameters that are no angles.
    parameters, symbols : sequences of Parameter and SX
    tolerance : float
        Largest bound, in the unit of the coefficient.

    Raises
    ------
    SceneError
        The coefficient has another symbol, or is a number.
    NotRationalError
        It depends on an angle, or has an operation that cannot be bounded, such as exp.
    TrimError
        The tolerance is not met.
    """
    expression = ca.SX(coefficient)
    known = {s.element_hash(): p for s, p in zip(symbols, parameters, strict=True)}
    free = free_symbols(expression)
    for s in free:
        if s.element_hash() not in known:
            raise SceneError(f"fit of {expression}: {s.name()!r} is no parameter.")
        if known[s.element_hash()].is_angle:
            raise NotRationalError(
                f"fit of {expression}: {s.name()!r} is an angle, in sin and cos only."
            )
    if not free:
        raise SceneError(f"fit of {expression}: it has no parameters, and is a number.")
    used = [known[s.element_hash()] for s in free]
    nominal, low, high = (
        np.array([getattr(p, end) for p in used]) for end in ("nominal", "low", "high")
    )
    p, t = column_of(free), ca.SX.sym("t")
    value = in_doubles(expression)
    start = ca.Function("value", [p], [value])(nominal).full()[:, 0]
    found = fit_equilibrium(
        ca.Function("coefficient", [t, p], [t - value]),
        nominal,
        low,
        high,
        start,
        tolerance,
        names=[parameter.name for parameter in used],
    )
    (text,) = found.expressions
    values = {parameter.name: s for parameter, s in zip(used, free, strict=True)}
    made = evaluate(parse(text), values, lambda x: ca.SX(literal(x)))
    return CoefficientFit(ca.SX(made), text, float(found.bound[0]))
