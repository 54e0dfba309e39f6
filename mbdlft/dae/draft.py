"""DAEs written in Python, by symbols and equations, or in a `casadi.DaeBuilder`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import SceneError, check_known, naming, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.dae.balance import fit_coefficient
from mbdlft.dae.dae import Dae, Equation, Output, Variable
from mbdlft.dae.text import column_of, with_literals
from mbdlft.dae.theta.piecewise import Beyond, Interpolation, table_expression
from mbdlft.exact.numbers import Constant
from mbdlft.problem.sx.constants import constant, literal, shown

T = TypeVar("T")


class DaeDraft:
    """Collects variables, parameters and equations; `dae` makes the description.

    ::

        d = DaeDraft("motor")
        J = d.parameter(Parameter("J", 0.1, percent=20, unit="kg m^2"))
        w = d.variable("w", unit="rad/s")
        tau = d.input("tau", unit="N m")
        d.equation(J * d.der(w) - tau, "momentum")
        d.output("speed", w, unit="rad/s")
        motor = d.dae()

    Parameters
    ----------
    name : str
    description : str

    Notes
    -----
    Numbers in expressions are the decimals that they print as, but what Python computes of numbers
    before a symbol is met is rounded: write ``d.number(0.1) * d.number(0.7) * x``, or ``0.07 * x``.
    """

    def __init__(self, name: str, description: str = "") -> None:
        self.name, self.description = name, description
        self._variables: dict[str, Variable] = {}
        self._inputs: dict[str, Variable] = {}
        self._parameters: dict[str, tuple[Parameter, ca.SX]] = {}
        self._outputs: list[Output] = []
        self._equations: list[Equation] = []
        self._initial: list[Equation] = []
        self._fit_error_bound = 0.0

    def variable(self, name: str, unit: str = "1", **fields: Any) -> ca.SX:
        """The symbol of a new variable; `fields` are others of `Variable`."""
        new = Variable(name, ca.SX.sym(name), unit, **fields)
        return self._declared(self._variables, name, new).symbol

    def input(self, name: str, unit: str = "1", **fields: Any) -> ca.SX:
        """The symbol of a new input."""
        new = Variable(name, ca.SX.sym(name), unit, **fields)
        return self._declared(self._inputs, name, new).symbol

    def parameter(self, parameter: Parameter) -> ca.SX:
        """The symbol of a parameter that stays in the model; that of an angle is in rad."""
        name = parameter.name
        return self._declared(self._parameters, name, (parameter, ca.SX.sym(name)))[1]

    def number(self, value: float) -> ca.SX:
        """A number that is not rounded when it meets others, and that may carry a unit, 1 and 2, too.

        Of ``1.0 * i`` nothing is left but ``i``, in the unit of i; ``d.number(1) * i`` has any unit.
        """
        if abs(value) in (1.0, 2.0):
            size = constant(Constant("rational", Fraction(abs(value))))
            return size if value > 0 else -size
        return ca.SX(literal(value))

    def fit(self, coefficient: ca.SX, tolerance: float) -> ca.SX:
        """A rational fit of a coefficient such as sqrt(p), with a guaranteed bound of its error.

        The models that are made with it are not exact: their certificates have the bound, in the unit
        of the coefficient. Errors as those of `fit_coefficient`.
        """
        parameters = [parameter for parameter, _ in self._parameters.values()]
        symbols = [symbol for _, symbol in self._parameters.values()]
        coefficient_fit = fit_coefficient(coefficient, parameters, symbols, tolerance)
        self._fit_error_bound = max(self._fit_error_bound, coefficient_fit.bound)
        return coefficient_fit.expression

    def table(
        self,
        argument: ca.SX,
        breakpoints: Sequence[float],
        values: Sequence[float],
        interpolation: Interpolation = "linear",
        beyond: Beyond = "lines",
    ) -> ca.SX:
        """A function of a variable or an input that has values at breakpoints.

        Arguments and errors as those of `mbdlft.dae.theta.piecewise.table_expression`.
        """
        argument = ca.SX(argument)
        if _name_of(argument) not in {*self._variables, *self._inputs}:
            raise SceneError(
                f"model {self.name!r}, table of {argument}: the argument is no variable and no input. "
                "Make a variable of it, with an equation."
            )
        return table_expression(argument, breakpoints, values, interpolation, beyond)

    def der(self, variable: ca.SX | str) -> ca.SX:
        """The symbol of the derivative of a variable, in its unit per second."""
        name = variable if isinstance(variable, str) else _name_of(variable)
        known = self._variables.get(name)
        if known is None or not (isinstance(variable, str) or ca.is_equal(known.symbol, variable)):
            if name in self._inputs:
                raise SceneError(
                    f"model {self.name!r}, der: {name!r} is an input. Make its derivative an input, and "
                    f"{name!r} a variable."
                )
            raise SceneError(
                f"model {self.name!r}, der: "
                + unknown_name("variable", name, self._variables)
                + " der is that of one variable; for an expression make a variable of it."
            )
        if known.derivative is not None:
            return known.derivative
        rate = ca.SX.sym(f"der({name})")
        self._variables[name] = replace(known, derivative=rate)
        return rate

    def equation(
        self,
        residual: Any,
        name: str | None = None,
        *,
        equals: Any = 0.0,
        line: int | None = None,
        unit: str | None = None,
    ) -> None:
        """Add the equation residual = equals; without a name it is called by its text."""
        self._equations.append(self._made(residual, name, equals, line, unit))

    def initially(self, residual: Any, name: str | None = None, *, equals: Any = 0.0) -> None:
        """Add an equation that holds at the beginning only."""
        self._initial.append(self._made(residual, name, equals, None, None))

    def output(self, name: str, expression: Any = None, unit: str | None = None) -> None:
        """Add an output: an expression, or the variable of this name."""
        if expression is None:
            check_known("variable", [name], self._variables, f"model {self.name!r}, output")
            expression = self._variables[name].symbol
        if unit is None:
            known = self._variables.get(_name_of(ca.SX(expression)))
            unit = known.unit if known is not None else "1"
        self._outputs.append(Output(name, with_literals(ca.SX(expression)), unit))

    def dae(self) -> Dae:
        """The description."""
        pairs = [self._parameters[name] for name in sorted(self._parameters)]
        return Dae(
            self.name,
            tuple(self._variables.values()),
            tuple(self._inputs.values()),
            tuple(parameter for parameter, _ in pairs),
            column_of(symbol for _, symbol in pairs),
            tuple(self._outputs),
            tuple(self._equations),
            tuple(self._initial),
            self.description,
            fit_error_bound=self._fit_error_bound,
        )

    def _made(
        self, residual: Any, name: str | None, equals: Any, line: int | None, unit: str | None
    ) -> Equation:
        text = f"{shown(ca.SX(residual))} = {shown(ca.SX(equals))}"
        with naming(f"model {self.name!r}, equation {name or text!r}"):
            lhs, right = with_literals(ca.SX(residual)), with_literals(ca.SX(equals))
        return Equation(name or text, lhs - right, line, unit)

    def _declared(self, table: dict[str, T], name: str, entry: T) -> T:
        if name in {*self._variables, *self._inputs, *self._parameters}:
            raise SceneError(f"model {self.name!r}: {name!r} is declared twice.")
        table[name] = entry
        return entry


def _name_of(expression: ca.SX) -> str:
    """The name of a symbol, or the text of an expression."""
    if expression.is_scalar() and expression.is_symbolic():
        return str(expression.name())
    return str(expression)


@arguments_checked
def from_casadi(
    builder: ca.DaeBuilder, parameters: Sequence[Parameter] = (), units: Mapping[str, str] | None = None
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
    """
    owner, d = f"model {builder.name()!r}", DaeDraft(builder.name())
    for member, what in (("q", "quadratures"), ("zero", "events")):
        if len(getattr(builder, member)()):
            raise SceneError(f"{owner}: has {what}, which are not supported here.")
    if builder.has_t():
        raise SceneError(f"{owner}: depends on time. Make an input of what depends on it.")
    chosen = {p.name: p for p in parameters}
    check_known("parameter", chosen, list(builder.p()), owner)

    def unit_of(name: str) -> str:
        return (units or {}).get(name) or builder.unit(name) or "1"

    def start_of(name: str) -> float:  # CasADi gives a number, or a list of one
        return float(np.ravel(builder.start(name))[0])

    def fields(name: str) -> dict[str, Any]:
        return {
            "unit": unit_of(name),
            "start": start_of(name),
            "nominal": abs(float(builder.nominal(name))) or 1.0,
            "minimum": float(builder.min(name)),
            "maximum": float(builder.max(name)),
            "comment": str(builder.description(name)),
        }

    def parameter(name: str) -> ca.SX:
        """The symbol of a parameter that stays, or its number."""
        low, high, start = float(builder.min(name)), float(builder.max(name)), start_of(name)
        ranged = math.isfinite(low) and math.isfinite(high)
        if name not in chosen and not math.isfinite(start) and not ranged:
            raise SceneError(f"{owner}: parameter {name!r} has neither a range nor a value.")
        if name in chosen:
            return d.parameter(chosen[name])
        if not ranged:
            return ca.SX(literal(start))
        nominal = float(builder.nominal(name))
        nominal = nominal if low < nominal < high else start
        return d.parameter(Parameter(name, nominal, low, high, unit=unit_of(name)))

    arguments = [
        column_of(d.variable(name, **fields(name)) for name in builder.x()),
        column_of(d.variable(name, **fields(name)) for name in builder.z()),
        column_of(d.input(name, **fields(name)) for name in builder.u()),
        column_of(parameter(name) for name in builder.p()),
    ]
    ode, alg, y = builder.create("model", ["x", "z", "u", "p"], ["ode", "alg", "y"])(*arguments)
    for k, name in enumerate(builder.x()):
        d.equation(d.der(name), f"der({name})", equals=ode[k])
    for k in range(alg.numel()):
        d.equation(alg[k], f"alg[{k}]")
    for k, name in enumerate(builder.y()):
        d.output(name, y[k], unit_of(name))
    return d.dae()
