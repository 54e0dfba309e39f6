"""The variables of a model: their symbols, those of their derivatives, and numbers at nominal values."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.dae.description import Variable
from mbdlft.dae.operations import column_of
from mbdlft.modelica import values as v
from mbdlft.modelica.evaluate import Evaluator
from mbdlft.modelica.parameters import Parameters, declared_unit, nominal_values
from mbdlft.modelica.tree import Declaration, Truth
from mbdlft.modelica.values import Value
from mbdlft.problem.sx.constants import in_doubles


class Variables:
    """Variables by name, and the values of all names of a model.

    Parameters
    ----------
    parameters : Parameters
    place : function
        Where a declaration stands, for messages.

    Attributes
    ----------
    values : dict of names to values: parameters, variables, arrays, ``time``
    by_name : dict of names to `Variable`, one for each entry of an array
    rates : dict of names to symbols of derivatives that occur
    evaluator : Evaluator
    """

    def __init__(self, parameters: Parameters, place: Callable[[Declaration], str]) -> None:
        self.parameters, self.place = parameters, place
        self.time = ca.SX.sym("time")
        self.values: dict[str, Value] = {**parameters.values, "time": self.time}
        self.by_name: dict[str, Variable] = {}
        self.rates: dict[str, ca.SX] = {}
        self.evaluator = Evaluator(self.values.get, self.derivative)

    def declare(self, d: Declaration) -> None:
        """Symbols and variables of a declaration, of each entry of an array."""
        if d.name in self.values:
            raise SceneError(f"{self.place(d)}: it is declared twice.")
        try:
            sizes = [self.evaluator.size(size) for size in d.sizes]
            unit = declared_unit(d.name, d, self.parameters.notes)
            self.values[d.name] = self._symbols(d, unit, sizes, ())
        except SceneError as error:
            raise SceneError(f"{self.place(d)}: {error}") from None

    def all(self) -> tuple[Variable, ...]:
        """All variables, with the derivatives that occur."""
        return tuple(replace(x, derivative=self.rates.get(x.name)) for x in self.by_name.values())

    def of(self, expression: ca.SX) -> list[Variable]:
        """The variables in an expression."""
        found = [(s, self.by_name.get(s.name())) for s in ca.symvar(expression)]
        return [x for symbol, x in found if x is not None and ca.is_equal(x.symbol, symbol)]

    def derivative(self, value: Value) -> Value:
        """der of an expression: the sum over its variables of its slopes times their derivatives."""
        if isinstance(value, Fraction):
            return value * 0
        expression = v.to_sx(value)
        if ca.depends_on(expression, self.time):
            raise SceneError("der of a function of time is not supported.")
        found: Value = Fraction(0)
        for x in self.of(expression):
            rate = self.rates.setdefault(x.name, ca.SX.sym(f"der({x.name})"))
            slope = ca.jacobian(expression, x.symbol)
            found = v.binary("+", found, rate if slope.is_one() else slope * rate)
        return found

    def at_nominal(self, value: Value) -> float:
        """The number that a value has at nominal values of the parameters, and at time 0.

        Raises
        ------
        SceneError
            It depends on variables.
        """
        found = v.number_of(value)
        if found is not None:
            return float(found)
        expression = in_doubles(v.to_sx(value))
        for x in self.of(expression):
            raise SceneError(f"it depends on the variable {x.name}.")
        nominal = nominal_values(self.parameters) | {"time": Fraction(0)}
        symbols = ca.symvar(expression)
        function = ca.Function("nominal", [column_of(symbols)], [expression])
        return float(function([float(nominal[symbol.name()]) for symbol in symbols]))

    def _symbols(
        self, d: Declaration, unit: str, sizes: Sequence[int], entry: tuple[int, ...]
    ) -> Value:
        if sizes:
            entries = range(1, sizes[0] + 1)
            return tuple(self._symbols(d, unit, sizes[1:], (*entry, k)) for k in entries)
        name = d.name + (f"[{','.join(map(str, entry))}]" if entry else "")
        if name in self.by_name:
            raise SceneError(f"{name!r} is declared twice.")
        low, high = self._number(d, "min", entry), self._number(d, "max", entry)
        self.by_name[name] = Variable(
            name,
            ca.SX.sym(name),
            unit,
            start=self._number(d, "start", entry),
            fixed=d.attributes.get("fixed") == Truth(value=True),
            nominal=abs(self._number(d, "nominal", entry) or 1.0),
            minimum=-math.inf if low is None else low,
            maximum=math.inf if high is None else high,
            comment=d.comment,
        )
        return self.by_name[name].symbol

    def _number(self, d: Declaration, key: str, entry: tuple[int, ...]) -> float | None:
        """The number that an attribute has, of one entry of an array."""
        if key not in d.attributes:
            return None
        value = self.evaluator.value(d.attributes[key])
        for k in entry:
            value = value[k - 1] if isinstance(value, tuple) and k <= len(value) else value
        try:
            return self.at_nominal(value)
        except SceneError as error:
            raise SceneError(f"{key}: {error}") from None


def names_in(value: Value) -> Iterator[str]:
    """Names of the symbols of a variable or an array of variables."""
    if isinstance(value, tuple):
        for entry in value:
            yield from names_in(entry)
    else:
        yield str(value.name())
