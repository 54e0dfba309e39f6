"""Linear blocks of actuators: filters, delays, and the imbalance of a wheel that spins steadily.

Their quantities are numbers or expressions of parameters, in SI units. A parameter is repeated no more
than it must be. Equation (7.10) of the two-port models in `tests/reference/flexible.py` is the band pass.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.description import Expected
from mbdlft.base.errors import MbdlftError, SceneError
from mbdlft.base.expression import BUILTIN_CONSTANTS, evaluate, parse
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import corners
from mbdlft.base.unit import dimension_name, parse_unit
from mbdlft.exact.operators import FUNCTIONS_OF_DIMENSIONS as DIMENSIONS
from mbdlft.exact.operators import Dimension
from mbdlft.pipeline.models import realize
from mbdlft.system.model import LFTModel

_MOST = 20


def low_pass(
    bandwidth: float | str,
    damping: float | str | None = None,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "low_pass",
) -> LFTModel:
    """A low pass: w/(s + w), or w^2/(s^2 + 2 xi w s + w^2) with a damping xi; a reaction wheel, a motor.

    Parameters
    ----------
    bandwidth : number or expression, w (rad/s)
    damping : number or expression, xi [1]; without it the block is of first order
    parameters : sequence of Parameter
        Those of the expressions, each with its unit, for example Hz.
    name : str

    Returns
    -------
    LFTModel with one input and one output, for `series`

    Raises
    ------
    SceneError
        A quantity is not positive, or its unit does not fit.
    """
    quantities = {"bandwidth": Expected(bandwidth, "rad/s")}
    if damping is not None:
        quantities["damping"] = Expected(damping, "1")

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        w, xi = v["bandwidth"], v.get("damping")
        if xi is None:
            return [[-w, w], [1.0, 0.0]]
        return [[0.0, w, 0.0], [-w, -2.0 * w * xi, w], [1.0, 0.0, 0.0]]

    states = ["lag"] if damping is None else ["low", "low_rate"]
    return _filter(name, quantities, parameters, matrix, states)


def band_pass(
    low: float | str,
    high: float | str,
    damping: float | str = 0.7,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "band_pass",
) -> LFTModel:
    """s^2/(s^2 + 2 xi w_l s + w_l^2) w_h^2/(s^2 + 2 xi w_h s + w_h^2); a piezo actuator, an amplifier.

    Parameters
    ----------
    low, high : numbers or expressions, w_l and w_h (rad/s)
    damping : number or expression, xi [1] of both
    parameters : sequence of Parameter
    name : str

    Returns
    -------
    LFTModel with one input and one output, for `series`

    Raises
    ------
    SceneError
        A quantity is not positive, or its unit does not fit.
    """
    quantities = {
        "low": Expected(low, "rad/s"),
        "high": Expected(high, "rad/s"),
        "damping": Expected(damping, "1"),
    }

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        a, b, xi = v["low"], v["high"], v["damping"]
        c = -2.0 * xi
        return [
            [0.0, a, 0.0, 0.0, 0.0],
            [-a, a * c, 0.0, 0.0, a],
            [0.0, 0.0, 0.0, b, 0.0],
            [-b, b * c, -b, b * c, b],
            [0.0, 0.0, 1.0, 0.0, 0.0],
        ]

    states = ["high", "high_rate", "low", "low_rate"]
    return _filter(name, quantities, parameters, matrix, states)


def delay(
    time: float | str, order: int = 2, parameters: Sequence[Parameter] = (), *, name: str = "delay"
) -> LFTModel:
    """The Pade approximation [n/n] of exp(-s T): its response has gain 1 and the phase of 2 n + 1 terms.

    With exp(-s T) = (1 - h)/(1 + h), h = tanh(x), x = s T/2, and the continued fraction
    h = 1/(1/x + 1/(3/x + 1/(5/x + ...))) cut after n terms: a ladder whose numbers are integers.

    Parameters
    ----------
    time : number or expression, T (s)
    order : int, n, 1 to 20
    parameters : sequence of Parameter
    name : str

    Returns
    -------
    LFTModel with one input and one output, for `series`

    Raises
    ------
    SceneError
        The time is not positive or the order is not such a number.
    """
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= _MOST:
        raise SceneError(f"{name}, order: expected a whole number from 1 to {_MOST}, got {order!r}.")
    quantities = {"time": Expected(time, "s")}
    return _filter(name, quantities, parameters, lambda v: _ladder(order, 2.0 / v["time"]), order)


def _filter(
    name: str,
    quantities: Mapping[str, Expected],
    parameters: Sequence[Parameter],
    matrix: Callable[[Mapping[str, Any]], list[list[Any]]],
    states: Sequence[str] | int,
) -> LFTModel:
    """A linear block with one input, the command, and one output."""
    ends = {"inputs": ["command"], "outputs": ["output"]}
    return linear_block(name, quantities, parameters, matrix, states=states, **ends)


def _ladder(order: int, rate: Any) -> list[list[Any]]:
    """Rows of [A B ; C D]: currents of inductors (states 1, 3, ...), voltages of capacitors (2, 4, ...).

    The source u drives the ladder through a resistor 1, u = i + v, and the output is i - v = 2 i - u.
    """
    n = order
    odd = [float(k % 2 == 0) for k in range(n)]  # states counted from 1
    even = [1.0 - entry for entry in odd]
    if n % 2:  # the last element carries all that is left of the current
        i, v = [*odd, 0.0], [*(-entry for entry in odd), 1.0]
    else:
        v, i = [*even, 0.0], [*(-entry for entry in even), 1.0]
    rows: list[list[Any]] = []
    for k in range(n):
        total, passed = (v, even) if k % 2 == 0 else (i, odd)
        row = [total[j] - (passed[j] if j < k else 0.0) for j in range(n)] + [total[n]]
        rows.append([(2 * k + 1) * entry * rate if entry else 0.0 for entry in row])
    return [*rows, [2.0 * entry - float(j == n) for j, entry in enumerate(i)]]


def imbalance(
    static: float | str,
    dynamic: float | str,
    speed: float | str,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "imbalance",
) -> LFTModel:
    """Force m r w^2 and torque m r h w^2 of an imbalance on the body that carries the wheel.

    A mass m at the radius r and the height h above the port, at the angle w t from x about the spin axis
    z, pulls with m r w^2 [cos, sin, 0] and turns with m r h w^2 [-sin, cos, 0].

    Parameters
    ----------
    static : number or expression, m r (kg m)
    dynamic : number or expression, m r h (kg m^2)
    speed : number or expression, w (rad/s)
    parameters : sequence of Parameter
    name : str

    Returns
    -------
    LFTModel
        Static; inputs ``NAME.cosine`` and ``NAME.sine`` [1], which are cos w t and sin w t; outputs
        ``force.x``, ``force.y`` (N), ``torque.x``, ``torque.y`` (N m). To be put in series with
        the inputs of two forces and two torques of magnitude 0 at the port of the wheel.

    Raises
    ------
    SceneError
        The speed is not positive, an imbalance is negative, or a unit does not fit.
    """

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        force, torque = (v[key] * (v["speed"] * v["speed"]) for key in ("static", "dynamic"))
        return [[force, 0.0], [0.0, force], [0.0, -torque], [torque, 0.0]]

    quantities = {
        "static": Expected(static, "kg m"),
        "dynamic": Expected(dynamic, "kg m^2"),
        "speed": Expected(speed, "rad/s"),
    }
    signals = {
        "inputs": [f"{name}.cosine", f"{name}.sine"],
        "outputs": ["force.x", "force.y", "torque.x", "torque.y"],
    }
    return linear_block(name, quantities, parameters, matrix, ("static", "dynamic"), **signals)


def linear_block(
    name: str,
    quantities: Mapping[str, Expected],
    parameters: Sequence[Parameter],
    matrix: Callable[[Mapping[str, Any]], Any],
    may_vanish: Sequence[str] = (),
    **signals: Any,
) -> LFTModel:
    """The LFT model of [A B ; C D] = matrix(values), with the values of the quantities in SI units.

    `quantities` must be positive, those that `may_vanish` not negative; `signals` are the states, inputs
    and outputs, as of `realize`.
    """
    symbols = {p.name: ca.SX.sym(p.name) for p in parameters}
    in_si = {p.name: p.factor * symbols[p.name] for p in parameters}
    dimensions = {p.name: Dimension(parse_unit(p.unit).dimension) for p in parameters}
    values = {}
    for label, expected in quantities.items():
        where = f"{name}, {label} = {expected.source!r}"
        source = expected.source
        if isinstance(source, bool) or not isinstance(source, int | float | str):
            raise SceneError(f"{where}: expected a number or an expression.")
        try:
            parsed = parse(source)
            values[label] = evaluate(parsed, {**BUILTIN_CONSTANTS, **in_si})
            dimension = evaluate(parsed, {**BUILTIN_CONSTANTS, **dimensions}, functions=DIMENSIONS)
            known = dimension.exponents if isinstance(dimension, Dimension) else None
            if known not in (None, parse_unit(expected.unit).dimension):
                raise SceneError(
                    f"the unit does not fit: expected {expected.unit}, got {dimension_name(known)}."
                )
        except MbdlftError as error:
            raise type(error)(f"{where}: {error}") from None
        lowest = _lowest(values[label], parameters, symbols)
        if not (lowest > 0.0 or (lowest == 0.0 and label in may_vanish)):
            raise SceneError(
                f"{where}: expected a positive number, got {lowest:g} {expected.unit} in the range."
            )
    used = tuple(
        p
        for p in parameters
        if any(ca.depends_on(ca.SX(value), symbols[p.name]) for value in values.values())
    )
    rows = [[ca.SX(entry) for entry in row] for row in matrix(values)]
    stacked = ca.vertcat(*(ca.horzcat(*row) for row in rows))
    used_symbols = {p.name: symbols[p.name] for p in used}
    return realize(stacked, used, symbols=used_symbols, name=name, search=0.0, **signals)


def _lowest(value: Any, parameters: Sequence[Parameter], symbols: Mapping[str, ca.SX]) -> float:
    """Smallest value at nominal and at all corners of the range."""
    used = [p for p in parameters if ca.depends_on(ca.SX(value), symbols[p.name])]
    if not used:
        return float(ca.DM(ca.SX(value)))
    function = ca.Function("value", [symbols[p.name] for p in used], [ca.SX(value)])
    columns = corners(used)
    table = [np.append(columns[p.name], p.nominal) for p in used]
    return min(float(function(*point)) for point in zip(*table, strict=True))
