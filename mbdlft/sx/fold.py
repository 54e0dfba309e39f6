"""The walk of an SX tape in any number system: arrays of floats, or Taylor models."""

import operator
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.errors import NotRationalError
from mbdlft.number import taylor
from mbdlft.number.taylor import Taylor


def evaluate_tape(
    function: ca.Function, number: Callable[[float], Any], *arguments: Sequence[Any]
) -> list[list[Any]]:
    """Entries of each output, by columns; arguments are sequences of entries of one number system.

    `number` makes a constant one of that number system.

    Raises
    ------
    NotRationalError
        An operation is not one of + - * /, integer powers, sqrt, sin, cos and tan.
    """
    work: list[Any] = [0.0] * function.sz_w()
    outputs: list[list[Any]] = [
        [number(0.0)] * function.numel_out(k) for k in range(function.n_out())
    ]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        sources, targets = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[targets[0]] = arguments[sources[0]][sources[1]]
        elif operation == ca.OP_CONST:
            work[targets[0]] = float(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            value = work[sources[0]]
            outputs[targets[0]][targets[1]] = number(value) if isinstance(value, float) else value
        elif operation in _RULES:
            operands = [work[source] for source in sources]
            if all(isinstance(operand, float) for operand in operands):
                operands[0] = number(operands[0])  # so that rounding is counted
            work[targets[0]] = _RULES[operation](*operands)
        else:
            raise NotRationalError(
                f"instruction {k} of {function.name()!r} is operation {operation} of CasADi, which "
                "has no guaranteed enclosure here. Write the equilibrium with + - * /, integer "
                "powers, sqrt, sin, cos and tan."
            )
    return outputs


def _sqrt(a: Any) -> Any:
    return taylor.sqrt(a) if isinstance(a, Taylor) else np.sqrt(a)


def _sin(a: Any) -> Any:
    return taylor.sine_and_cosine(a)[0] if isinstance(a, Taylor) else np.sin(a)


def _cos(a: Any) -> Any:
    return taylor.sine_and_cosine(a)[1] if isinstance(a, Taylor) else np.cos(a)


def _tan(a: Any) -> Any:
    if not isinstance(a, Taylor):
        return np.tan(a)
    sine, cosine = taylor.sine_and_cosine(a)
    return sine / cosine


def _power(a: Any, exponent: Any) -> Any:
    if not isinstance(exponent, float) or exponent != int(exponent):
        raise NotRationalError(
            f"a power with the exponent {exponent!r}: only integer exponents are supported. "
            "Write sqrt for a square root."
        )
    result: Any = 1.0
    for k in range(abs(int(exponent))):
        result = a if k == 0 else result * a
    return 1.0 / result if exponent < 0 else result


_RULES: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_TWICE: lambda a: 2.0 * a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_SQRT: _sqrt,
    ca.OP_SIN: _sin,
    ca.OP_COS: _cos,
    ca.OP_TAN: _tan,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
}
