"""Functions that switch, such as |x| and max: their branches, and which one holds on a whole range.

The argument of a function of parameters is a fraction of polynomials, whose sign on the closed box of the
parameters is decided exactly: |p - 1| is p - 1 for p from 1 to 2. The root of a square is an absolute
value, however the square is written.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, Literal, NamedTuple

import casadi as ca
import flint

from mbdlft.base.errors import NotRationalError
from mbdlft.dae.dae import Dae
from mbdlft.dae.text import ARITHMETIC_OF_SX, FUNCTIONS, column_of, free_symbols, unsupported
from mbdlft.exact.numbers import decimal
from mbdlft.exact.ratio import NotFractionError, Ratio, sign_on, square_root
from mbdlft.problem.sx.constants import constants_in, in_doubles, literal, root
from mbdlft.problem.sx.tapes import Rules, arithmetic, fold, steps

Side = Literal["below", "above", "at", "open"]
_MOST_STEPS = 1000  # of a function of which a fraction is made


class Switch(NamedTuple):
    """What decides, as a function of the operands; the values below and above its zero."""

    argument: Callable[..., ca.SX]
    below: Callable[..., ca.SX]
    above: Callable[..., ca.SX]
    at_zero: tuple[Side, ...] = ()  # those of the two that it has at the zero, too


def _difference(a: ca.SX, b: ca.SX) -> ca.SX:
    return a - b


_BOTH: tuple[Side, ...] = ("below", "above")
SWITCHES: Mapping[str, Switch] = {
    "fabs": Switch(lambda a: a, lambda a: -a, lambda a: a, _BOTH),
    "sign": Switch(lambda a: a, lambda a: ca.SX(-1), lambda a: ca.SX(1)),
    "fmin": Switch(_difference, lambda a, b: a, lambda a, b: b, _BOTH),
    "fmax": Switch(_difference, lambda a, b: b, lambda a, b: a, _BOTH),
    "lt": Switch(_difference, lambda a, b: ca.SX(1), lambda a, b: ca.SX(0), ("above",)),
    "le": Switch(_difference, lambda a, b: ca.SX(1), lambda a, b: ca.SX(0), ("below",)),
    # at the zero, and on both sides of it
    "eq": Switch(_difference, lambda a, b: ca.SX(1), lambda a, b: ca.SX(0)),
    "ne": Switch(_difference, lambda a, b: ca.SX(0), lambda a, b: ca.SX(1)),
}


def ranges_of(dae: Dae) -> dict[int, tuple[Fraction, Fraction]]:
    """The ranges of the parameters that are no angles, by the hashes of their symbols."""
    return {
        dae.p[k].element_hash(): (decimal(p.low), decimal(p.high))
        for k, p in enumerate(dae.parameters)
        if not p.is_angle
    }


def side_on(value: ca.SX, ranges: Mapping[int, tuple[Fraction, Fraction]]) -> Side:
    """Where a function of parameters is on the closed box of their `ranges_of` the DAE.

    "below" and "above" allow zeros; it is "open" where neither is shown.
    """
    free = free_symbols(value)
    if not all(symbol.element_hash() in ranges for symbol in free):
        return "open"
    try:
        sign = sign_on(fraction_of(value, free), [ranges[s.element_hash()] for s in free])
    except NotFractionError:
        return "open"
    return "above" if sign > 0 else "below" if sign < 0 else "open"


_RELATIONS = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}


def text_of_call(name: str, operands: Sequence[ca.SX]) -> str:
    """Such as ``fabs(x)`` and ``x < 2``."""
    texts = [str(in_doubles(operand)) for operand in operands]
    return f" {_RELATIONS[name]} ".join(texts) if name in _RELATIONS else f"{name}({', '.join(texts)})"


def changes_its_branch(place: str, text: str, names: Sequence[str]) -> NotRationalError:
    """The error for a function that switches within the range of parameters."""
    return NotRationalError(
        f"{place}: {text} changes its branch inside of the range of {', '.join(sorted(names))}, or no "
        "enclosure shows that it does not. A model has one branch: narrow the range so that it ends "
        "before the branch does, and make a model of each."
    )


def with_roots_of_squares(dae: Dae) -> Dae:
    """The equations with |r| in place of each root of r^2, of which rounding may take the root."""

    def rooted(value: ca.SX) -> ca.SX:
        r = root_of_square(ca.SX(value))
        return ca.SX(FUNCTIONS["sqrt"](value) if r is None else ca.fabs(r))

    table = Rules(ca.SX, {**FUNCTIONS, **ARITHMETIC_OF_SX, "sqrt": rooted}, unsupported)

    def rewritten(expression: ca.SX) -> ca.SX:
        free = ca.symvar(expression)
        function = ca.Function("roots", [column_of(free)], [ca.densify(expression)])
        if not any(operation == "sqrt" for operation, _, _ in steps(function)):
            return expression
        return ca.SX(fold(function, table, free)[0][0])

    return replace(
        dae,
        equations=tuple(replace(e, residual=rewritten(e.residual)) for e in dae.equations),
        initial=tuple(replace(e, residual=rewritten(e.residual)) for e in dae.initial),
        outputs=tuple(replace(y, expression=rewritten(y.expression)) for y in dae.outputs),
        conditions=tuple(replace(c, expression=rewritten(c.expression)) for c in dae.conditions),
    )


def root_of_square(value: ca.SX) -> ca.SX | None:
    """An r with value = r^2 for all values of its symbols, if there is one that is rational in them."""
    free = free_symbols(value)
    try:
        found = square_root(fraction_of(value, free))
    except NotFractionError:
        return None
    if found is None:
        return None
    number, r = found
    return ca.SX(root(number)) * _expression(r.n, free) / _expression(r.d, free)


def without_parameters(value: ca.SX) -> ca.SX:
    """A function with the same value for all values of its symbols, such as (2 k)/(3 k), without them."""
    free = free_symbols(value)
    symbols, numbers = constants_in(value)
    others = [symbols[k] for k, number in enumerate(numbers) if number.kind != "rational"]
    try:
        fraction = fraction_of(value, [*free, *others]) if free else None
    except NotFractionError:
        return value
    if fraction is not None and not fraction.n:
        return ca.SX(0)
    if fraction is None or any(any(x.degrees()[: len(free)]) for x in (fraction.n, fraction.d)):
        return value
    n, d = (_expression(x, [*free, *others]) for x in (fraction.n, fraction.d))
    return n / d


def fraction_of(value: ca.SX, free: Sequence[ca.SX]) -> Ratio:
    """A function as a fraction of polynomials in `free`; a NotFractionError if it is none."""
    taken = {s.element_hash() for s in free}
    symbols, numbers = constants_in(value)
    places = [k for k in range(len(numbers)) if symbols[k].element_hash() not in taken]
    symbols, numbers = symbols[places], tuple(numbers[k] for k in places)
    function = ca.Function("fraction", [symbols, column_of(free)], [ca.densify(value)])
    if any(number.kind != "rational" for number in numbers) or function.n_instructions() > _MOST_STEPS:
        raise NotFractionError
    context = flint.fmpq_mpoly_ctx.get([f"p{k}" for k in range(len(free))])
    one = Ratio(context.constant(1), context.constant(1))
    arguments = [one.of(number.argument) for number in numbers], [Ratio(x, one.d) for x in context.gens()]
    try:
        ((found,),) = fold(function, arithmetic(one.of, {}), *arguments)
    except NotRationalError:
        raise NotFractionError from None
    return one.of(found)


def _expression(polynomial: Any, symbols: Sequence[ca.SX]) -> ca.SX:
    total = ca.SX(0)
    for exponents, x in polynomial.to_dict().items():
        term = ca.SX(literal(Fraction(int(x.p), int(x.q))))
        for symbol, exponent in zip(symbols, exponents, strict=True):
            term = term * symbol ** int(exponent)
        total = total + term
    return total
