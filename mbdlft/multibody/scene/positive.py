"""Masses and moments of inertia that are negative somewhere in the range of the parameters.

Samples miss a disc of a hundredth of the range. Intervals do not: where they cannot show that a quantity
keeps its sign they end near a zero, and points around it show whether it is negative there.
"""

from collections.abc import Mapping

import numpy as np

from mbdlft.base.errors import SceneError
from mbdlft.base.expression import Expression, Name, evaluate, names
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.number.interval import FUNCTIONS, Interval, decimal, find_zero

LABELS = ("mass", "inertia.xx", "inertia.yy", "inertia.zz", "actuator_inertia")
_AROUND, _RADII = 256, (1e-6, 1e-4, 1e-2)  # points, and parts of the range


def check_positive(
    what: str,
    expression: Expression,
    parameters: Mapping[str, Parameter],
    constants: Mapping[str, float],
) -> None:
    """Raise a SceneError if an expression is negative at a point of the range that is found.

    Parameters
    ----------
    what : place and text of the quantity, for the message
    expression : Expression
        Not negative at the samples of the range.
    parameters : plain ones, by name
    constants : values in SI units
    """
    used = sorted(names(expression) & parameters.keys())
    if not used or isinstance(expression, Name):
        return
    factors = {name: parse_unit(parameters[name].unit).factor for name in used}
    intervals = {name: decimal(float(value)) for name, value in constants.items()}

    def value(box: Mapping[str, Interval]) -> Interval:
        known = {**intervals, **{name: item * factors[name] for name, item in box.items()}}
        return Interval.of(evaluate(expression, known, decimal, FUNCTIONS))

    bounds = {name: (parameters[name].low, parameters[name].high) for name in used}
    found = find_zero(value, bounds)
    if found is None:
        return
    low, high = (np.array([ends[k] for ends in bounds.values()]) for k in (0, 1))
    center = np.array(list(found[0].values()))
    random = np.random.default_rng(0)
    for radius in _RADII:
        steps = radius * (high - low) * random.uniform(-1.0, 1.0, (_AROUND, len(used)))
        for point in np.clip(center + steps, low, high):
            at = {name: Interval(float(x), float(x)) for name, x in zip(used, point, strict=True)}
            if value(at).high < 0.0:
                where = ", ".join(
                    f"{name} = {x:.9g} {parameters[name].unit}".removesuffix(" 1")
                    for name, x in zip(used, point, strict=True)
                )
                raise SceneError(
                    f"{what}: is negative in the range, at {where}: {value(at).high:.3g}. Narrow the "
                    "ranges, or correct the expression."
                )
