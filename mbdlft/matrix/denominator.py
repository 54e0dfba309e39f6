"""Denominators of a matrix problem over the whole range of its parameters, and sizes of its entries."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from mbdlft.base.errors import SceneError, WellPosednessError
from mbdlft.base.expression import Expression, denominators, evaluate, write
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal, find_zero
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.matrix.resolve import Resolved, cosine_name, entry_place, matrix_values, sine_name

_LEAST, _MOST = 1e-150, 1e150  # their squares are floats


def check_denominators(problem: MatrixProblem, resolved: Resolved) -> None:
    """Show by interval arithmetic that no denominator vanishes in the range.

    What intervals cannot decide is left to the check of the model at points of the range.

    Raises
    ------
    SceneError
        A denominator is so small, or an entry so large, that the square of such a number is none.
    WellPosednessError
        A denominator vanishes in the range, or comes as close to zero as rounding allows to tell.
    """
    parameters = {p.name: p for p in problem.parameters}
    numbers = problem.constant_values()
    constants = {name: decimal(value) for name, value in numbers.items()}
    corners = [
        {name: Interval(at, at) for name, at in zip(parameters, point, strict=True)}
        for point in zip(*((p.nominal, p.low, p.high) for p in problem.parameters), strict=True)
    ]
    for p in problem.parameters:
        _check_size(f"matrix {problem.name!r}: parameter {p.name!r}", (p.low, p.high), _LEAST)
    for place, divisor in _divisors(problem, resolved):
        used = sorted(resolved.parameters_of(divisor) & parameters.keys())
        shared = _needed(resolved, divisor)

        def value(
            box: Mapping[str, Interval],
            shared: Mapping[str, Expression] = shared,
            divisor: Expression = divisor,
        ) -> Interval:
            known = constants | _parts(parameters, box)
            for name, expression in shared.items():
                known[name] = evaluate(expression, known, decimal, FUNCTIONS)
            found: Interval = evaluate(divisor, known, decimal, FUNCTIONS)
            return found

        _check_size(f"{place}: the denominator {write(divisor)}", map(value, corners), _LEAST)
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
    rows = [
        matrix_values(problem, resolved, {**numbers, **_parts(parameters, box)})
        for box in corners or [{}]
    ]
    for i, j in np.ndindex(problem.shape):
        _check_size(entry_place(problem, i, j), (row[i][j] for row in rows))


def _check_size(what: str, values: Iterable[Interval | float], least: float = 0.0) -> None:
    """Raise a SceneError if the largest of some values is not zero, and below the least or too large.

    What may be zero at a point, or has a pole there, is left to the other checks.
    """
    found = [Interval.of(value) for value in values]
    size = max((value.largest for value in found if value.smallest), default=0.0)
    if size and not least <= size <= _MOST:
        expected = f"least {least:g}" if size < least else f"most {_MOST:g}"
        raise SceneError(
            f"{what} has the size {size:.3g}. Expected at {expected}: the square of a number has to be "
            "one in double precision, too. Choose other units."
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


def _parts(parameters: Mapping[str, Parameter], box: Mapping[str, Interval]) -> dict[str, Interval]:
    """Parameters over intervals; an angle by its cosine and sine."""
    found = {}
    for name, item in box.items():
        if parameters[name].is_angle:
            angle = item * parse_unit(parameters[name].unit).factor
            found[cosine_name(name)] = FUNCTIONS["cos"](angle)
            found[sine_name(name)] = FUNCTIONS["sin"](angle)
        else:
            found[name] = item
    return found
