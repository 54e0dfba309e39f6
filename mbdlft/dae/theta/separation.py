"""Separation of a DAE: what is linear in signals, rational in parameters, and what becomes Theta.

An operation that is not linear in the signals makes a function of arguments: "as the blocks are", these
are the signals of its equation; with the "fewest" inputs, variables are replaced by what defines them,
and arguments are combinations of signals. Parameters in a function are separated: what depends on them
becomes an argument of its own.

Source: Casella, Donida, Lovera (2009), sections 3.4 and 6.2.
"""

import math
from functools import partial
from typing import Literal, NamedTuple

import casadi as ca

from mbdlft.base.errors import NotRationalError
from mbdlft.dae import branches
from mbdlft.dae.alias import rational
from mbdlft.dae.dae import Dae
from mbdlft.dae.structure import Structure
from mbdlft.dae.text import ARITHMETIC_OF_SX, FUNCTIONS, column_of, free_symbols
from mbdlft.dae.theta import arguments as args
from mbdlft.dae.theta.arguments import NOTHING, ONE_KEY, Mixed, coefficient, number, plus, term, times
from mbdlft.exact.numbers import constant_of
from mbdlft.problem.equations import cosines_sines
from mbdlft.problem.sx import constants
from mbdlft.problem.sx.constants import FUNCTIONS as EXACT_FUNCTIONS
from mbdlft.problem.sx.tapes import fold, rules

Arrange = Literal["fewest", "blocks"]
_PRODUCTS, _NOT_LINEAR = ("mul", "div"), ("mul", "div", "pow", "constpow")
SWITCHING = ("fabs", "sign", "floor", "ceil", "fmin", "fmax", "lt", "le", "eq", "ne")
_OPERATIONS = {**ARITHMETIC_OF_SX, **FUNCTIONS}


class Separation:
    """Follows equations; collects arguments and functions. `expressions` are all that will be followed.

    `internal` (n_p,) are the symbols of parameters; of angles, those of their internal values.
    """

    def __init__(self, dae: Dae, expressions: ca.SX, arrange: Arrange) -> None:
        self.owner, self.arrange = dae.owner, arrange
        angles = [k for k, p in enumerate(dae.parameters) if p.is_angle]
        self.internal = ca.SX(dae.p)
        for k in angles:
            self.internal[k] = ca.SX.sym(f"tan({dae.parameters[k].name})")
        self.ranges = branches.ranges_of(dae)
        cosine, sine = cosines_sines(dae.parameters, self.internal)
        self.angles = {dae.p[k].element_hash(): (cosine[k], sine[k]) for k in angles}
        p = ca.vertcat(self.internal, *(dae.p[k] for k in angles))
        self.registry = args.Registry(ca.vertcat(expressions, cosine, sine), p)
        self.coefficients = {s.element_hash() for s in ca.vertsplit(p)}
        self.values: dict[int, Mixed] = {}  # of replaced unknowns, by the hash of their symbol
        self.place = self.hint = ""
        self._rules = rules(
            self._number,
            add=plus,
            neg=lambda a: times(a, ca.SX(-1)),
            twice=lambda a: times(a, ca.SX(2)),
            missing=self._refused,
            **{name: partial(self.apply, name) for name in (*FUNCTIONS, *_NOT_LINEAR)},
        )

    def follow(self, expression: ca.SX, place: str, hint: str) -> Mixed:
        """The value of an expression; `place` is for messages, `hint` names its functions."""
        self.place, self.hint = place, hint
        free = ca.symvar(expression)
        function = ca.Function("equation", [column_of(free)], [ca.densify(expression)])
        elements = [self._element(s) for s in free]
        mixed: Mixed = fold(function, self._rules, elements)[0][0]
        self._check_angles(mixed)
        return mixed

    def equations(self, s: Structure, residuals: ca.SX, outputs: ca.SX, signals: ca.SX) -> "Separated":
        """Equations and outputs of a structure, whose [unknowns ; states ; inputs] are `signals` in them.

        An unknown is replaced by what its equation says of it if that has no parameters, except with
        the arrangement "blocks".
        """
        rows, kept = [], []
        for block in s.blocks:
            name = s.unknowns[block.columns[0]].name
            unknowns = [signals[j] for j in block.columns]
            places = [f"equation {s.equations[i][0]}" for i in block.rows]
            if self.arrange == "fewest" and len(unknowns) == 1:
                value = self._solved(residuals[block.rows[0]], unknowns[0], places[0], name)
                if value is not None:
                    self.values[unknowns[0].element_hash()] = value
                    continue
            for i, place in zip(block.rows, places, strict=True):
                row = self.follow(residuals[i], place, name)
                rows.append(args.with_tables(self.registry, row, name, -1))
            kept += unknowns
        free = {x.element_hash() for x in kept}
        position = {x.element_hash(): k for k, x in enumerate(ca.vertsplit(s.symbols))}
        rates = []
        for q, symbol in zip(s.states, s.rates, strict=True):
            rate = signals[position[symbol.element_hash()]]
            if rate.element_hash() not in free:
                value = self.follow(rate, f"state {q.name!r}", q.name)
                rate = ca.SX.sym(f"rate of {q.name}")
                rows.append(plus(times(value, ca.SX(-1)), args.signal(rate)))
            rates.append(rate)
        taken = {rate.element_hash() for rate in rates}
        others = [x for x in kept if x.element_hash() not in taken]
        values = [
            self.follow(outputs[k], f"output {y.name!r}", y.name) for k, y in enumerate(s.dae.outputs)
        ]
        return Separated(rows, values, column_of([*rates, *others]), len(rates))

    def _solved(self, residual: ca.SX, unknown: ca.SX, place: str, name: str) -> Mixed | None:
        """The unknown by its equation, if its factor is a number and the value has no parameters."""
        slope = ca.SX(ca.jacobian(residual, unknown))
        if not constants.is_constant(slope) or rational(slope) == 0:
            return None
        number = self.follow(slope, place, name).constant  # of a function of numbers, too
        assert number is not None
        value = self.follow(ca.substitute(residual, unknown, ca.SX(0)), place, name)
        if not value.is_plain:
            return None
        return args.with_tables(self.registry, times(value, -1 / number), name, 1)

    def _element(self, symbol: ca.SX) -> Mixed:
        key = symbol.element_hash()
        if constants.is_constant(symbol) or key in self.coefficients:
            return coefficient(symbol)
        return self.values.get(key) or args.signal(symbol)

    def _number(self, value: float) -> Mixed:
        self._check_finite(value)
        return coefficient(number(constant_of(value)))

    def _check_finite(self, value: float) -> None:
        if not math.isfinite(value):
            raise NotRationalError(
                f"{self.owner}, {self.place}: a value or slope is {value} at this equilibrium, as that "
                "of a root at zero is: there is no linear model. Linearize beside it."
            )

    def _refused(self, operation: str, where: str, *operands: Mixed) -> Mixed:
        raise NotRationalError(f"{self.owner}, {self.place}: operation {operation!r} is not supported.")

    def apply(self, operation: str, *operands: Mixed) -> Mixed:
        match operation:
            case "mul":
                for a, b in (operands, operands[::-1]):
                    if b.is_coefficient:
                        return NOTHING if b.constant is None else times(a, b.constant)
            case "if_else_zero" if operands[0].is_coefficient:
                condition = operands[0].constant
                if condition is None:
                    return NOTHING
                if constants.is_constant(condition):
                    return operands[1] if constants.numbers_of(condition)[0, 0] else NOTHING
            case "div" if operands[1].is_coefficient:
                if operands[1].constant is None:
                    raise NotRationalError(f"{self.owner}, {self.place}: divides by zero.")
                return times(operands[0], 1 / operands[1].constant)
        if all(m.is_coefficient for m in operands):
            return self._of_coefficients(operation, *operands)
        return self._function(operation, *operands)

    def _of_coefficients(self, operation: str, *operands: Mixed) -> Mixed:
        """A function of parameters and numbers."""
        values = [
            ca.SX(0) if m.constant is None else branches.without_parameters(m.constant) for m in operands
        ]
        if all(map(constants.is_constant, values)):
            if operation in EXACT_FUNCTIONS:
                return coefficient(ca.SX(EXACT_FUNCTIONS[operation](values[0])))
            near = float(constants.numbers_of(_OPERATIONS[operation](*values))[0, 0])
            self._check_finite(near)
            return coefficient(ca.SX(constants.literal(near)))
        if operation in ("sin", "cos") and values[0].is_symbolic():
            pair = self.angles.get(values[0].element_hash())
            if pair is not None:
                return coefficient(pair[operation == "sin"])
        if (branch := self._one_branch(operation, *values)) is not None:
            return coefficient(branch)
        text = branches.text_of_call(operation, values)
        names = sorted({s.name() for value in values for s in free_symbols(value)})
        if operation in SWITCHING:
            raise branches.changes_its_branch(f"{self.owner}, {self.place}", text, names)
        raise NotRationalError(
            f"{self.owner}, {self.place}: {text} is not rational in the parameters "
            f"{', '.join(names)}. Either declare the value of {text} as a parameter of its own, with "
            "which the others are rational, which is exact; or replace it by a rational fit with a "
            "guaranteed bound (fit=1e-6 when it is linearized, fit = 1e-6 in [trim] of a table)."
        )

    def _one_branch(self, operation: str, *values: ca.SX) -> ca.SX | None:
        """What a function that has no jumps is in the whole range, if it is one rational function there.

        Comparisons may be slopes of one that has a kink at the end of the range.
        """
        if operation == "sqrt":
            square = branches.root_of_square(values[0])
            return None if square is None else self._one_branch("fabs", square)
        switch = branches.SWITCHES.get(operation)
        if switch is None or len(switch.at_zero) < 2:
            return None
        side = branches.side_on(switch.argument(*values), self.ranges)
        return None if side == "open" else (switch.above if side == "above" else switch.below)(*values)

    def _check_angles(self, value: Mixed) -> None:
        coefficients = [term.coefficient for term in value.linear.values()]
        coefficients += [value.constant] if value.constant is not None else []
        bare = [
            s.name()
            for term in [*coefficients, *value.terms.values()]
            for s in ca.symvar(term)
            if s.element_hash() in self.angles
        ]
        if bare:
            raise NotRationalError(
                f"{self.owner}, {self.place}: the angle {bare[0]!r} stands outside of sin and cos. An "
                "angle is a parameter in sin and cos only."
            )

    def _function(self, operation: str, *operands: Mixed) -> Mixed:
        """A nonlinear operation: its factor, and the number of its function."""
        factor, arguments = ca.SX(1), list(operands)
        if operation in _PRODUCTS:
            for k in (0, 1):
                hoisted, arguments[k] = _hoisted(arguments[k])
                factor = factor / hoisted if k and operation == "div" else factor * hoisted
        expressions = []
        for k, argument in enumerate(arguments):
            expression, ratio = self._expression(argument)
            if operation in _PRODUCTS and ratio is not None:
                factor = factor / ratio if k and operation == "div" else factor * ratio
            elif ratio is not None:
                expression = ratio * expression
            expressions.append(expression)
        made = _OPERATIONS[operation](*expressions)
        return term(self.registry.function(self._reduced(made), self.hint), factor)

    def _expression(self, value: Mixed) -> tuple[ca.SX, ca.SX | None]:
        """A value as an expression of arguments; the factor is that of one that is nothing else."""
        registry = self.registry
        inside = {k: c for k, c in value.terms.items() if constants.is_constant(c)}
        expression = ca.SX(0)
        for k, c in inside.items():
            expression = expression + c * registry.functions[k].expression
        linear = dict(value.linear)
        if self.arrange == "blocks" and ONE_KEY in linear:
            expression = expression + self._of_signals(linear.pop(ONE_KEY).form)
        constant = value.constant
        if constant is not None and constants.is_constant(constant):
            expression, constant = expression + constant, None
        outside = {k: c for k, c in value.terms.items() if k not in inside}
        remainder = Mixed(linear, constant, outside)
        if not (remainder.linear or remainder.terms or remainder.constant is not None):
            return expression, None
        symbol, ratio = registry.argument(remainder)
        if expression.is_zero():
            return symbol, None if ratio == 1 else number(ratio)
        return expression + (symbol if ratio == 1 else number(ratio) * symbol), None

    def _of_signals(self, form: ca.SX) -> ca.SX:
        """A linear form with arguments in place of its signals."""
        signals = free_symbols(form)
        symbols = [self.registry.argument(args.signal(s))[0] for s in signals]
        return ca.SX(ca.substitute(form, column_of(signals), column_of(symbols)))

    def _reduced(self, expression: ca.SX) -> ca.SX:
        """The expression in as few of its arguments as are independent."""
        registry = self.registry
        symbols = {a.symbol.element_hash(): a for a in registry.arguments}
        used = [symbols[s.element_hash()] for s in ca.symvar(expression) if s.element_hash() in symbols]
        rows = args.independent(used)
        if rows is None:
            return expression
        old = column_of([a.symbol for a in used])
        new = [
            sum((number(f) * a.symbol for f, a in zip(row, used, strict=True) if f), ca.SX(0))
            for row in rows
        ]
        return ca.SX(ca.substitute(expression, old, column_of(new)))


class Separated(NamedTuple):
    """Values of relations 0 = ... and of outputs; unknown = [rates of the states ; others]."""

    relations: list[Mixed]
    outputs: list[Mixed]
    unknown: ca.SX
    derivatives: int


def _hoisted(value: Mixed) -> tuple[ca.SX, Mixed]:
    """A common coefficient, and what it is a factor of."""
    if value.constant is None and len(value.linear) == 1 and not value.terms:
        ((key, term),) = value.linear.items()
        if key != ONE_KEY:
            return term.coefficient, Mixed({ONE_KEY: term._replace(coefficient=ca.SX(1))}, None, {})
    factors = {str(factor): factor for factor in value.terms.values()}
    if value.constant is None and not value.linear and len(factors) == 1:
        (factor,) = factors.values()
        return factor, Mixed({}, None, dict.fromkeys(value.terms, ca.SX(1)))
    return ca.SX(1), value
