"""A linear block whose quantities are numbers or expressions of parameters, in SI units."""

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
from mbdlft.number.dimension import FUNCTIONS as DIMENSIONS
from mbdlft.number.dimension import Dimension
from mbdlft.pipeline.build import realize
from mbdlft.system.model import LFTModel


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

    Raises
    ------
    SceneError
        A quantity has another unit, is not positive, or is not a number or an expression.
    """
    symbols = {p.name: ca.SX.sym(p.name) for p in parameters}
    in_si = {p.name: p.factor * symbols[p.name] for p in parameters}
    values = {}
    for label, expected in quantities.items():
        where = f"{name}, {label} = {expected.source!r}"
        source = expected.source
        if isinstance(source, bool) or not isinstance(source, int | float | str):
            raise SceneError(f"{where}: expected a number or an expression.")
        try:
            parsed = parse(source)
            values[label] = evaluate(parsed, {**BUILTIN_CONSTANTS, **in_si})
            dimension = evaluate(parsed, _dimensions(parameters), functions=DIMENSIONS)
            _check_dimension(dimension, expected.unit)
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
    own = {p.name: symbols[p.name] for p in used}
    return realize(stacked, used, symbols=own, name=name, search=0.0, **signals)


def _dimensions(parameters: Sequence[Parameter]) -> dict[str, Any]:
    return {
        **BUILTIN_CONSTANTS,
        **{p.name: Dimension(parse_unit(p.unit).dimension) for p in parameters},
    }


def _check_dimension(value: Any, unit: str) -> None:
    wanted = parse_unit(unit).dimension
    if isinstance(value, Dimension) and value.exponents not in (None, wanted):
        raise SceneError(
            f"the unit does not fit: expected {unit}, got {dimension_name(value.exponents)}."
        )


def _lowest(value: Any, parameters: Sequence[Parameter], symbols: Mapping[str, ca.SX]) -> float:
    """Smallest value at nominal and at all corners of the range."""
    used = [p for p in parameters if ca.depends_on(ca.SX(value), symbols[p.name])]
    if not used:
        return float(ca.DM(ca.SX(value)))
    function = ca.Function("value", [symbols[p.name] for p in used], [ca.SX(value)])
    columns = corners(used)
    table = [np.append(columns[p.name], p.nominal) for p in used]
    return min(float(function(*point)) for point in zip(*table, strict=True))
