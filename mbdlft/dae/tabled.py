"""Sums of functions of one argument that are a table together: one function of Theta."""

import casadi as ca

from mbdlft.dae.arguments import Registry
from mbdlft.dae.mixed import ONE_KEY, Mixed, plus, term, times
from mbdlft.dae.piecewise import piecewise_of
from mbdlft.problem.sx.constants import is_constant


def with_tables(registry: Registry, value: Mixed, hint: str, sign: int) -> Mixed:
    """A value with sums of functions of one argument that are a table together as one function.

    What is linear in the argument is in the table, too. The function is `sign` times these terms.
    """
    groups: dict[tuple[int, str], list[int]] = {}
    for k, factor in value.terms.items():
        used = registry.functions[k].arguments
        if len(used) == 1:
            common = "" if is_constant(factor) else str(factor)
            groups.setdefault((used[0], common), []).append(k)
    for (a, common), own in groups.items():
        if len(own) > 1 and common:
            value = _with_factor(registry, value, a, own, hint)
        elif len(own) > 1:
            value = _with_numbers(registry, value, a, own, hint, ca.SX(sign))
    return value


def _with_factor(registry: Registry, value: Mixed, a: int, own: list[int], hint: str) -> Mixed:
    """Functions with one factor of parameters."""
    total = sum((registry.functions[k].expression for k in own), ca.SX(0))
    if not _is_table(total, registry.arguments[a].symbol):
        return value
    made = term(registry.function(total, hint), value.terms[own[0]])
    return plus(_without(value, own), made)


def _with_numbers(
    registry: Registry, value: Mixed, a: int, own: list[int], hint: str, sign: ca.SX
) -> Mixed:
    """Functions with numbers for factors, what is linear in their argument, and a constant."""
    argument = registry.arguments[a]
    total = sum((value.terms[k] * registry.functions[k].expression for k in own), ca.SX(0))
    rest = _without(value, own)
    slope = _slope_by(value, argument.value)
    if slope is not None:
        total = total + slope * argument.symbol
        rest = plus(rest, times(argument.value, -slope))
    if rest.constant is not None and is_constant(rest.constant):
        total = total + rest.constant
        rest = Mixed(rest.linear, None, rest.terms)
    if not _is_table(total, argument.symbol):
        return value
    return plus(rest, term(registry.function(sign * total, hint), sign))


def _without(value: Mixed, own: list[int]) -> Mixed:
    terms = {k: factor for k, factor in value.terms.items() if k not in own}
    return Mixed(value.linear, value.constant, terms)


def _is_table(expression: ca.SX, argument: ca.SX) -> bool:
    found = piecewise_of(expression, argument)
    return found is not None and found.table() is not None


def _slope_by(value: Mixed, argument: Mixed) -> ca.SX | None:
    """How often an argument that is a signal is in the part of a value that is linear with numbers."""
    part, own = value.linear.get(ONE_KEY), argument.linear.get(ONE_KEY)
    is_signal = own is not None and len(argument.linear) == 1 and argument.constant is None
    if part is None or own is None or not is_signal or argument.terms or not own.form.is_symbolic():
        return None
    slope = ca.SX(ca.jacobian(part.form, own.form))
    return ca.densify(slope) if slope.nnz() else None
