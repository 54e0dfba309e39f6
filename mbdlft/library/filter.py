"""Band-limited actuators and delays as linear blocks; a parameter is repeated no more than it must be.

Equation (7.10) of the two-port models in `tests/reference/flexible.py` for the band pass.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbdlft.base.description import Expected
from mbdlft.base.errors import SceneError
from mbdlft.base.parameter import Parameter
from mbdlft.library.block import linear_block
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
    if damping is None:
        return _filter(
            name,
            quantities,
            parameters,
            lambda v: [[-v["bandwidth"], v["bandwidth"]], [1.0, 0.0]],
            ["lag"],
        )
    quantities["damping"] = Expected(damping, "1")

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        w, xi = v["bandwidth"], v["damping"]
        return [[0.0, w, 0.0], [-w, -2.0 * w * xi, w], [1.0, 0.0, 0.0]]

    return _filter(name, quantities, parameters, matrix, ["low", "low_rate"])


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
    time: float | str,
    order: int = 2,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "delay",
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
        raise SceneError(
            f"{name}, order: expected a whole number from 1 to {_MOST}, got {order!r}."
        )
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
