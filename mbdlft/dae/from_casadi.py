"""A DAE of a `casadi.DaeBuilder`: states with ode, algebraic variables with alg, outputs with ydef."""

import math
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.dae.description import Dae, Equation, Output, Variable
from mbdlft.dae.operations import column_of, with_literals
from mbdlft.problem.sx.constants import literal


def from_casadi(
    builder: ca.DaeBuilder,
    parameters: Sequence[Parameter] = (),
    units: Mapping[str, str] | None = None,
) -> Dae:
    """The description of a model that a `casadi.DaeBuilder` holds.

    Parameters
    ----------
    builder : casadi.DaeBuilder
        With ode for each state and alg for the algebraic variables; neither events nor quadratures.
    parameters : sequence of Parameter
        Those that stay in the model; their names are names of parameters of the builder. Others that have
        finite `min` and `max` there stay, too; the rest are numbers, their start values.
    units : mapping of names to units, optional
        Instead of those of the builder; a variable without a unit there is dimensionless.

    Raises
    ------
    SceneError
        The builder has what is not supported (events, quadratures, time); a parameter is not one of it;
        as `Dae`.
    """
    own = _Builder(builder, {p.name: p for p in parameters}, dict(units or {}))
    symbols = {part: ca.SX.sym(part, len(getattr(builder, part)())) for part in "xzup"}
    names = {part: list(getattr(builder, part)()) for part in symbols}
    p = ca.SX(symbols["p"].numel(), 1)
    for k, name in enumerate(names["p"]):
        p[k] = symbols["p"][k] if name in own.parameters else literal(own.number(name))
    right = builder.create("model", ["x", "z", "u", "p"], ["ode", "alg", "y"])
    found = right(symbols["x"], symbols["z"], symbols["u"], p)
    ode, alg, y = (ca.SX(part) for part in found)
    rates = [ca.SX.sym(f"der({name})") for name in names["x"]]
    variables = [
        *(own.variable(n, symbols["x"][k], rates[k]) for k, n in enumerate(names["x"])),
        *(own.variable(n, symbols["z"][k]) for k, n in enumerate(names["z"])),
    ]
    ordered = sorted(own.parameters)
    return Dae(
        builder.name(),
        tuple(variables),
        tuple(own.variable(n, symbols["u"][k]) for k, n in enumerate(names["u"])),
        tuple(own.parameters[name] for name in ordered),
        column_of(symbols["p"][names["p"].index(name)] for name in ordered),
        tuple(Output(n, with_literals(y[k]), own.unit(n)) for k, n in enumerate(builder.y())),
        (
            *(
                Equation(f"der({n})", rates[k] - with_literals(ode[k]), unit=None)
                for k, n in enumerate(names["x"])
            ),
            *(Equation(f"alg[{k}]", with_literals(alg[k])) for k in range(alg.numel())),
        ),
    )


class _Builder:
    """What a builder says of its variables."""

    def __init__(
        self, builder: ca.DaeBuilder, given: Mapping[str, Parameter], units: Mapping[str, str]
    ) -> None:
        self.builder, self.units = builder, units
        self.owner = f"model {builder.name()!r}"
        for part, what in (("q", "quadratures"), ("zero", "events")):
            if len(getattr(builder, part)()):
                raise SceneError(f"{self.owner}: has {what}, which are not supported here.")
        if builder.has_t():
            raise SceneError(f"{self.owner}: depends on time. Make an input of what depends on it.")
        names = list(builder.p())
        check_known("parameter", given, names, self.owner)
        self.parameters = dict(given)
        for name in names:
            low, high = float(builder.min(name)), float(builder.max(name))
            if name not in given and math.isfinite(low) and math.isfinite(high):
                nominal = float(builder.nominal(name))
                nominal = nominal if low < nominal < high else self.number(name)
                self.parameters[name] = Parameter(name, nominal, low, high, unit=self.unit(name))

    def unit(self, name: str) -> str:
        return self.units.get(name) or self.builder.unit(name) or "1"

    def _start(self, name: str) -> float:
        """Its start value; CasADi gives a number, or a list of one."""
        return float(np.ravel(self.builder.start(name))[0])

    def number(self, name: str) -> float:
        value = self._start(name)
        if not math.isfinite(value):
            raise SceneError(f"{self.owner}: parameter {name!r} has neither a range nor a value.")
        return value

    def variable(self, name: str, symbol: ca.SX, rate: ca.SX | None = None) -> Variable:
        b = self.builder
        parse_unit(self.unit(name))
        nominal = abs(float(b.nominal(name)))
        return Variable(
            name,
            symbol,
            self.unit(name),
            start=self._start(name),
            nominal=nominal if nominal > 0.0 else 1.0,
            minimum=float(b.min(name)),
            maximum=float(b.max(name)),
            comment=str(b.description(name)),
            derivative=rate,
        )
