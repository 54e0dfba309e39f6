"""The description of a differential-algebraic model 0 = F(xdot, x, v, u, p), and whether its units fit.

Nothing is solved or differentiated here. Values are in the units that are written; nothing is converted.

Equations are followed with the units of quantities in place of numbers. What is added or compared has
one unit: the same exponents of kg, m, s, A and K, and the same factor to SI. A plain number may carry
any unit, so that `0.001*x` is a length in km if x is one in m; and so may a quantity in "1", whose unit
is not given. One in "rad" is dimensionless.
"""

import math
import operator
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import casadi as ca

from mbdlft.base.errors import SceneError, check_known, naming, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Exponents, dimension_name, parse_unit
from mbdlft.dae.text import PLAIN, column_of, free_symbols
from mbdlft.exact.operators import Operators
from mbdlft.problem.sx.constants import is_constant
from mbdlft.problem.sx.tapes import Rules, fold, rules

_SMALL = 1e-6  # of a start: a value of this size beside 1 has few digits where zeros are decided


@dataclass(frozen=True, slots=True, eq=False)
class Variable:
    """An unknown or an input of a DAE.

    Attributes
    ----------
    name : str
        Any text, such as ``J1.flange_a.phi``.
    symbol : SX (1, 1), in `unit`
    unit : str
        As those of parameters; ``"1"`` if it is not given, ``"rad"`` or ``"%"`` if it has none.
    start : float or None
        Value that initialization and trim begin with; of an input: its value at the trim.
    start_of : SX (1, 1), or None
        The same in terms of the parameters, where it depends on them; `start` is its nominal value.
    fixed : bool
        Whether the initial value is `start`, not only near it.
    nominal : float
        Size of its values, a positive number. Where it is 1, and so not given, a start below 1e-6 is.
    minimum, maximum : float
    comment : str
    derivative : SX (1, 1), or None
        The symbol of der(x), in unit/s, if it occurs in the equations.
    """

    name: str
    symbol: ca.SX
    unit: str = "1"
    start: float | None = None
    start_of: ca.SX | None = None
    fixed: bool = False
    nominal: float = 1.0
    minimum: float = -math.inf
    maximum: float = math.inf
    comment: str = ""
    derivative: ca.SX | None = None

    @property
    def size(self) -> float:
        """The nominal size, or, where none is given, that of a start that is far smaller than 1."""
        of_start = abs(self.start or 0.0)
        return of_start if self.nominal == 1.0 and 0.0 < of_start < _SMALL else self.nominal


@dataclass(frozen=True, slots=True, eq=False)
class Equation:
    """0 = residual.

    Attributes
    ----------
    name : str
        What messages call it: a name or its text.
    residual : SX (1, 1)
    line : int or None
        Where it stands in the source.
    unit : str or None
        Of the residual, if it is known.
    """

    name: str
    residual: ca.SX
    line: int | None = None
    unit: str | None = None

    @property
    def place(self) -> str:
        """Its name and line, for messages."""
        return repr(self.name) + (f" (line {self.line})" if self.line is not None else "")


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """A named expression of variables, inputs and parameters."""

    name: str
    expression: ca.SX
    unit: str = "1"


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """Where the equations are those of the model.

    Attributes
    ----------
    name : str
        What messages call it: where it is, and its text.
    expression : SX (1, 1)
        A truth, or a number.
    kind : {"mode", "event", "assert"}
        The equations have a constant in the place of a mode, whose definition gives it in the whole range
        of the parameters. A relation that makes an event does not change there. An assert holds.
    value : float or None
        What the expression is; of a relation that makes an event None.
    """

    name: str
    expression: ca.SX
    kind: Literal["mode", "event", "assert"]
    value: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Dae:
    """0 = F(xdot, x, v, u, p),  y = outputs.

    Attributes
    ----------
    name : str
    variables : tuple of Variable
        x and v; those of which a derivative occurs have its symbol.
    inputs : tuple of Variable, without derivatives
    parameters : tuple of Parameter, sorted by name
        Those that stay in the model. The value of one is in its unit; that of an angle is in rad.
    p : SX symbols (n_p,), in the same order
    outputs : tuple of Output
    equations : tuple of Equation
    initial : tuple of Equation
        What holds at the beginning only.
    description : str
    text : str
        What the model was read from.
    units_checked : bool
        Whether it is known that its units fit, as of a text in which every number has its unit.
    fit_error_bound : float
        Guaranteed bound of the error of coefficients that are fits, in their units; 0.0 for none.
    conditions : tuple of Condition
        `trim`, `start_point` and `simulate` refuse what does not meet them.
    """

    name: str
    variables: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    parameters: tuple[Parameter, ...]
    p: ca.SX
    outputs: tuple[Output, ...]
    equations: tuple[Equation, ...]
    initial: tuple[Equation, ...] = ()
    description: str = ""
    text: str = field(default="", repr=False)
    units_checked: bool = False
    fit_error_bound: float = 0.0
    conditions: tuple[Condition, ...] = ()

    def __post_init__(self) -> None:
        names = [v.name for v in (*self.variables, *self.inputs)]
        _check_once(self, "variable", [*names, *(p.name for p in self.parameters)])
        _check_once(self, "output", [y.name for y in self.outputs])
        if [p.name for p in self.parameters] != sorted(p.name for p in self.parameters):
            raise SceneError(f"{self.owner}: parameters are sorted by name.")
        if self.p.numel() != len(self.parameters):
            raise SceneError(f"{self.owner}: p has one symbol for each parameter.")
        for v in (*self.variables, *self.inputs):
            _check_variable(self, v)
        for y in self.outputs:
            _check_unit(self, y.name, y.unit)
        residuals = [e.residual for e in (*self.equations, *self.initial)]
        every = [*residuals, *(y.expression for y in self.outputs)]
        every += [c.expression for c in self.conditions]
        known = {s.element_hash() for s in symbols_of(self)}
        used = {s.element_hash() for s in free_symbols(column_of(every))}
        if all(x.is_scalar() for x in every) and used <= known:
            return
        for e in (*self.equations, *self.initial):
            _check_expression(self, f"equation {e.place}", e.residual, known)
        for y in self.outputs:
            _check_expression(self, f"output {y.name!r}", y.expression, known)
        for condition in self.conditions:
            _check_expression(self, condition.name, condition.expression, known)

    @property
    def owner(self) -> str:
        """Such as "model 'motor'", for messages."""
        return f"model {self.name!r}"

    @property
    def xdot(self) -> ca.SX:
        """Symbols of the derivatives that occur, in the order of the variables."""
        return column_of(v.derivative for v in self.variables if v.derivative is not None)

    def variable(self, name: str) -> Variable:
        """The variable or input of a name."""
        by_name = {v.name: v for v in (*self.variables, *self.inputs)}
        check_known("variable", [name], by_name, self.owner)
        return by_name[name]


def symbols_of(dae: Dae) -> list[ca.SX]:
    """All symbols that may stand in its equations."""
    signals = [v.symbol for v in (*dae.variables, *dae.inputs)]
    return [*signals, *ca.vertsplit(dae.xdot), *ca.vertsplit(dae.p)]


def _check_once(dae: Dae, what: str, names: Sequence[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise SceneError(f"{dae.owner}: {what} {name!r} is declared {count} times.")


def _check_unit(dae: Dae, name: str, unit: str) -> None:
    with naming(f"{dae.owner}, {name!r}", SceneError):
        parse_unit(unit)


def _check_variable(dae: Dae, v: Variable) -> None:
    _check_unit(dae, v.name, v.unit)
    checks = (
        (v.symbol.is_scalar() and v.symbol.is_symbolic(), "expected a symbol of one entry"),
        (v.start is None or math.isfinite(v.start), f"start is {v.start}, expected a finite number"),
        (0.0 < v.nominal < math.inf, f"nominal is {v.nominal}, expected a size > 0"),
        (v.minimum <= v.maximum, f"the range [{v.minimum:g}, {v.maximum:g}] {v.unit} is empty"),
    )
    for holds, message in checks:
        if not holds:
            raise SceneError(f"{dae.owner}, {v.name!r}: {message}.")


def _check_expression(dae: Dae, what: str, expression: ca.SX, known: set[int]) -> None:
    if not expression.is_scalar():
        raise SceneError(
            f"{dae.owner}, {what}: has shape {expression.shape}, expected one entry. Write one equation "
            "for each."
        )
    for symbol in free_symbols(expression):
        if symbol.element_hash() not in known:
            message = unknown_name("symbol", symbol.name(), [s.name() for s in symbols_of(dae)])
            raise SceneError(
                f"{dae.owner}, {what}: {message} A symbol is that of a variable, an input, a parameter "
                "or a derivative of this model."
            )


_SAME = 1e-9  # relative, of factors: products of few powers of ten, 60 and pi, that were rounded


@dataclass(frozen=True, slots=True)
class Measure(Operators):
    """The unit of a value: its exponents of kg, m, s, A, K, and its factor to SI; `OPEN` is any unit."""

    exponents: Exponents | None
    factor: float = 1.0
    text: str = field(default="", compare=False)

    def __str__(self) -> str:
        if self.exponents is None:
            return "any unit"
        name = dimension_name(self.exponents)
        if self.text and (self.factor != 1.0 or name == "1"):
            return self.text
        return name if self.factor == 1.0 else f"{self.factor:.6g} {name}"

    def fits(self, other: "Measure") -> bool:
        """Whether values in both may be added; `OPEN` fits to all."""
        if self.exponents is None or other.exponents is None:
            return True
        return self.exponents == other.exponents and math.isclose(
            self.factor, other.factor, rel_tol=_SAME
        )

    def __add__(self, other: "Measure") -> "Measure":
        if not self.fits(other):
            raise SceneError(f"{self} and {other} are added or compared; units do not fit.")
        return other if self.exponents is None else self

    def __neg__(self) -> "Measure":
        return self

    def __mul__(self, other: "Measure") -> "Measure":
        if self.exponents is None or other.exponents is None:
            return OPEN
        exponents = tuple(a + b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Measure(exponents, self.factor * other.factor)

    def __truediv__(self, other: "Measure") -> "Measure":
        return self * other.power(Fraction(-1))

    def power(self, exponent: Fraction) -> "Measure":
        """The unit of a power of a value."""
        if self.exponents is None:
            return OPEN
        powers = [Fraction(x) * exponent for x in self.exponents]
        whole = tuple(int(x) if x.denominator == 1 else x for x in powers)
        return Measure(whole, self.factor ** float(exponent))

    def root(self) -> "Measure":
        """The unit of a square root of a value."""
        return self.power(Fraction(1, 2))


OPEN = Measure(None)


def measure_of(text: str) -> Measure:
    """That of the text of a unit."""
    unit = parse_unit(text)
    return Measure(unit.dimension, unit.factor, text)


NUMBER, SECOND = measure_of("rad"), measure_of("s")


def open_unit(text: str) -> Measure:
    """That of the text of a unit; of "1" it is open."""
    return OPEN if text == "1" else measure_of(text)


def plain(value: Measure, function: str = "a function") -> Measure:
    """The value of a function such as exp, dimensionless as its argument is."""
    if not value.fits(NUMBER):
        raise SceneError(f"{function} of a value in {value}; it takes plain numbers and angles in rad.")
    return NUMBER


def compared(a: Measure, b: Measure) -> Measure:
    """A condition on two values, which have the same unit."""
    a + b
    return OPEN


def check_units(dae: Dae) -> None:
    """Raise a SceneError that names the equation and both units where units do not fit."""
    measures = {v.symbol.element_hash(): open_unit(v.unit) for v in (*dae.variables, *dae.inputs)}
    for v in dae.variables:
        if v.derivative is not None:
            measures[v.derivative.element_hash()] = open_unit(v.unit) / SECOND
    for p, symbol in zip(dae.parameters, ca.vertsplit(dae.p), strict=True):
        measures[symbol.element_hash()] = NUMBER if p.is_angle else open_unit(p.unit)
    residuals = [(f"equation {e.place}", e.residual, e.unit) for e in (*dae.equations, *dae.initial)]
    residuals += [(f"output {y.name!r}", y.expression, y.unit) for y in dae.outputs]
    for what, expression, unit in residuals:
        try:
            measure = unit_of(expression, measures)
            if unit is not None:
                measure + open_unit(unit)
        except SceneError as error:
            raise SceneError(
                f"{dae.owner}, {what}: {error} A 1 or 2 that has a unit is written d.number(1)."
            ) from None


def unit_of(expression: ca.SX, measures: Mapping[int, Measure]) -> Measure:
    """The unit of an expression of symbols that have some, by their hashes."""
    free = ca.symvar(expression)
    values = [OPEN if is_constant(s) else measures[s.element_hash()] for s in free]
    function = ca.Function("units", [column_of(free)], [ca.densify(expression)])
    measure: Measure = fold(function, _RULES, values)[0][0]
    return measure


_RULES: Rules = rules(
    lambda value: OPEN,
    add=operator.add,
    mul=operator.mul,
    div=operator.truediv,
    neg=operator.neg,
    twice=lambda a: a if any(a.exponents or ()) else OPEN,  # the 2 may carry any unit, too
    inv=lambda a: OPEN,
    sqrt=Measure.root,
    **dict.fromkeys(("fmin", "fmax"), operator.add),
    if_else_zero=lambda condition, a: a,
    **dict.fromkeys(("lt", "le"), compared),
    missing=lambda operation, where, *operands: OPEN,
    **dict.fromkeys(("fabs", "floor", "ceil"), lambda a: a),
    **dict.fromkeys(PLAIN, plain),
)
