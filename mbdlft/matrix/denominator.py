"""Denominators of a matrix problem over the whole range of its parameters."""

from collections.abc import Iterator, Mapping

import numpy as np

from mbdlft.errors import WellPosednessError
from mbdlft.expression import Expression, denominators, evaluate, write
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.matrix.resolve import Resolved, cosine_name, entry_place, sine_name
from mbdlft.parameter import Parameter
from mbdlft.scene.interval import Interval, find_zero
from mbdlft.unit import parse_unit


def check_denominators(problem: MatrixProblem, resolved: Resolved) -> None:
    """Show by interval arithmetic that no denominator vanishes in the range.

    What intervals cannot decide is left to the check of the model at points of the range.

    Raises
    ------
    WellPosednessError
        A denominator vanishes in the range, or comes as close to zero as rounding allows to tell.
    """
    parameters = {p.name: p for p in problem.parameters}
    constants = problem.constant_values()
    for place, divisor in _divisors(problem, resolved):
        used = sorted(resolved.parameters_of(divisor) & parameters.keys())
        shared = _needed(resolved, divisor)

        def value(
            box: Mapping[str, Interval],
            shared: Mapping[str, Expression] = shared,
            divisor: Expression = divisor,
        ) -> Interval | float:
            known: dict[str, Interval | float] = dict(constants)
            for name, interval in box.items():
                known |= _interval_values(parameters[name], interval)
            for name, expression in shared.items():
                known[name] = evaluate(expression, known)
            found: Interval | float = evaluate(divisor, known)
            return found

        found = find_zero(
            value, {name: (parameters[name].low, parameters[name].high) for name in used}
        )
        if found is not None and found[1]:
            near = ", ".join(
                f"{name} = {at:g} {parameters[name].unit}".removesuffix(" 1")
                for name, at in found[0].items()
            )
            raise WellPosednessError(
                f"{place}: the denominator {write(divisor)} vanishes in the range"
                f"{f', near {near}' if near else ''}. Narrow the range, or write the entry without "
                "the division."
            )


def _divisors(problem: MatrixProblem, resolved: Resolved) -> Iterator[tuple[str, Expression]]:
    seen: set[Expression] = set()
    places = [
        (f"matrix {problem.name!r}, expression {name!r}", expression)
        for name, expression in resolved.shared.items()
    ]
    places += [
        (entry_place(problem, i, j), entry)
        for i, row in enumerate(resolved.entries)
        for j, entry in enumerate(row)
    ]
    for place, expression in places:
        for divisor in denominators(expression):
            if divisor not in seen:
                seen.add(divisor)
                yield place, divisor


def _needed(resolved: Resolved, expression: Expression) -> dict[str, Expression]:
    """The shared expressions that an expression uses, in order."""
    used = set(resolved.names_of(expression))
    return {name: shared for name, shared in resolved.shared.items() if name in used}


def _interval_values(parameter: Parameter, value: Interval) -> dict[str, Interval]:
    """A parameter over an interval; an angle by its cosine and sine."""
    if not parameter.is_angle:
        return {parameter.name: value}
    factor = parse_unit(parameter.unit).factor
    low, high = value.low * factor, value.high * factor
    return {
        cosine_name(parameter.name): _cosine(low, high),
        sine_name(parameter.name): _cosine(low - np.pi / 2, high - np.pi / 2),
    }


def _cosine(low: float, high: float) -> Interval:
    """All cosines of the angles between low and high (rad)."""
    ends = (float(np.cos(low)), float(np.cos(high)))
    turns = np.floor(high / np.pi)  # the last multiple of pi below high
    inside = [k for k in (turns, turns - 1) if k * np.pi >= low]
    tops = [1.0 if k % 2 == 0 else -1.0 for k in inside]
    return (
        Interval(min(*ends, *tops), max(*ends, *tops)) if tops else Interval(min(ends), max(ends))
    )
