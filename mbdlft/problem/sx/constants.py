"""Numbers in CasADi SX that are not rounded: symbols that stand for constants until floats are asked for.

SX folds constants in doubles, where 0.1 0.7 is not 0.07. So a number of a scene enters its expressions as
a symbol, one for each number, unless it is a short binary fraction, with which doubles are exact.
The name of a symbol says which constant it is, so an expression needs nothing beside it: `constants_in`
reads them, and `in_doubles` puts the nearest doubles in their places.

`modulo_prime` evaluates expressions modulo a prime, with random residues for their symbols. An expression
whose residue is not zero is not zero; one whose residue is zero vanishes for all values of the symbols,
but for a chance of about its degree times 1e-18.
"""

import hashlib
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from fractions import Fraction
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.exact.numbers import Constant, Field, constant_of, cosine_of, decimal, in_enough_bits, sine_of
from mbdlft.exact.operators import FUNCTIONS_OF_DOUBLES
from mbdlft.problem.sx.tapes import Rule, Rules, fold, refused, rules, term_sizes

_PREFIX = "constant "
_KINDS = ("rational", "root", "cosine", "sine", "pi", "unit")  # of `Constant`
_PLAIN, _MOST_PLAIN = 64, 2**20  # denominator and size of numbers that stay doubles
_CERTAIN = 1e-6  # of the terms of a value: a larger one is no rounding, no need to look
_SEED = 20270118  # of the residues of what cancels
_SHARED = 4096  # constants that have one symbol each, the last ones asked for; a scene has some hundred


def literal(value: float | Fraction) -> float | ca.SX:
    """A number as it is written, for expressions."""
    if type(value) is float and value.is_integer() and abs(value) < _MOST_PLAIN:
        return value
    exact = value if isinstance(value, Fraction) else decimal(value)
    if _PLAIN % exact.denominator == 0 and abs(exact) < _MOST_PLAIN:
        return float(exact)
    return constant(Constant("rational", exact))


def cosine_sine(angle: float) -> tuple[float | ca.SX, float | ca.SX]:
    """Cosine and sine of an angle (rad)."""
    cosine, sine = cosine_of(angle), sine_of(angle)
    if not cosine.in_radians and cosine.argument % 90 == 0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(cosine.argument // 90) % 4]
    return constant(cosine), constant(sine)


def root(value: float | Fraction) -> float | ca.SX:
    """The square root of a number that is not negative."""
    exact = value if isinstance(value, Fraction) else decimal(value)
    top, bottom = math.isqrt(exact.numerator), math.isqrt(exact.denominator)
    if top * top == exact.numerator and bottom * bottom == exact.denominator:
        return literal(Fraction(top, bottom))
    return constant(Constant("root", exact))


def unit_vector(direction: Sequence[float | Fraction]) -> ca.SX:
    """A direction (3,) with unit length; a zero component is a structural zero."""
    return ca.SX(_unit_vector(tuple(direction)))  # a copy


@lru_cache(maxsize=_SHARED)
def _unit_vector(direction: tuple[float | Fraction, ...]) -> ca.SX:
    exact = [x if isinstance(x, Fraction) else decimal(x) for x in direction]
    largest = max(exact, key=abs)
    # parallel directions have the same numbers
    along = tuple(x / largest for x in exact)
    length = root(sum((x * x for x in along), Fraction(0)))
    sign, components = 1.0 if largest > 0 else -1.0, ca.SX(3, 1)
    exact_length = rational_of(length)
    for k, x in enumerate(along):
        if x and exact_length is None:
            components[k] = sign * constant(Constant("unit", Fraction(k), direction=along))
        elif x and exact_length is not None:
            components[k] = sign * literal(x / exact_length)
    return components


@lru_cache(maxsize=_SHARED)
def constant(value: Constant) -> ca.SX:
    """The symbol of a constant. As equal ones share it, expressions of them stay short."""
    unit = "rad" if value.in_radians else "deg"
    texts = (value.kind, value.argument, unit, *value.direction)
    return ca.SX.sym(_PREFIX + " ".join(map(str, texts)))


@lru_cache(maxsize=_SHARED)
def _constant_named(name: str) -> Constant | None:
    """The constant of a symbol of this name; None if it is another symbol."""
    if not name.startswith(_PREFIX):
        return None
    try:
        kind, argument, unit, *direction = name.removeprefix(_PREFIX).split(" ")
        number = Constant(kind, Fraction(argument), unit == "rad", tuple(map(Fraction, direction)))
    except ValueError:
        return None
    return number if kind in _KINDS else None


def constants_in(expression: ca.SX) -> tuple[ca.SX, tuple[Constant, ...]]:
    """The symbols (n,) of the constants in an expression, and what they are."""
    named = [(s, _constant_named(s.name())) for s in ca.symvar(expression)]
    symbols = [symbol for symbol, number in named if number is not None]
    return ca.vertcat(ca.SX(0, 1), *symbols), tuple(n for _, n in named if n is not None)


def in_doubles(expression: ca.SX) -> ca.SX:
    """An expression with the nearest doubles in place of its constants."""
    symbols, numbers = constants_in(expression)
    if not numbers:
        return expression
    values = ca.SX(ca.DM([double(number) for number in numbers]))
    return ca.SX(ca.substitute(expression, symbols, values))


def shown(expression: ca.SX) -> str:
    """The text of an expression, its constants as decimals."""
    symbols, numbers = constants_in(expression)
    texts = ca.vertcat(*(ca.SX.sym(f"{double(number):.15g}") for number in numbers))
    return str(ca.substitute(expression, symbols, texts) if numbers else expression)


def numbers_of(expression: ca.SX) -> Array:
    """Values of an expression of constants only; shape of the expression."""
    return np.asarray(ca.evalf(in_doubles(ca.SX(expression))).full())


def is_constant(expression: ca.SX) -> bool:
    """Whether an expression depends on nothing but constants."""
    return all(_constant_named(s.name()) is not None for s in ca.symvar(expression))


@lru_cache(maxsize=_SHARED)
def double(value: Constant) -> float:
    """The double next to a constant."""
    argument = float(value.argument)
    if value.kind == "rational":
        return argument
    if value.kind == "root":
        return math.sqrt(argument)
    if value.kind == "pi":
        return math.pi * argument
    if value.kind == "unit":
        direction = [float(x) for x in value.direction]
        return direction[int(argument)] / math.sqrt(sum(x * x for x in direction))
    angle = argument if value.in_radians else math.radians(argument)
    return math.cos(angle) if value.kind == "cosine" else math.sin(angle)


def without_zeros(column: ca.SX) -> ca.SX:
    """A column of constants (n,), with structural zeros for entries that are zero exactly."""
    symbols, numbers = constants_in(column)
    if not numbers:  # entries are numbers
        return ca.sparsify(column)
    function = ca.Function("column", [symbols], [ca.densify(column)])
    point = np.array([[double(number) for number in numbers]])
    values, sizes = numbers_of(column)[:, 0], term_sizes(function, point)[0]
    kept = ca.SX(*column.shape)
    for k, (value, size) in enumerate(zip(values, sizes, strict=True)):
        entry = ca.SX(column[k])
        is_far = not math.isfinite(value) or abs(value) > _CERTAIN * size
        if is_far or not (entry.is_zero() or _vanishes(entry)):
            kept[k] = entry
    return kept


def is_zero(column: ca.SX) -> bool:
    """Whether all entries of a column of constants are zero, exactly."""
    return without_zeros(column).nnz() == 0


def _table(number: Callable[[float], Any]) -> Rules:
    return rules(number, add=operator.add, mul=operator.mul, div=operator.truediv)


def _vanishes(expression: ca.SX) -> bool:
    symbols, numbers = constants_in(expression)
    function = ca.Function("constant", [symbols], [ca.densify(expression)])

    def value() -> Any:
        field = Field(numbers)
        table = _table(lambda value: field.rational(constant_of(value)))
        return fold(function, table, [field.of(number) for number in numbers])[0][0]

    return not in_enough_bits(value, "a constant")


def rational_of(expression: float | ca.SX) -> Fraction | None:
    """The value of an expression of rational constants, or None."""
    symbols, numbers = constants_in(ca.SX(expression))
    if any(number.kind != "rational" for number in numbers) or not is_constant(ca.SX(expression)):
        return None
    function = ca.Function("constant", [symbols], [ca.densify(ca.SX(expression))])
    ((value,),) = fold(function, _table(constant_of), [number.argument for number in numbers])
    return Fraction(value)


def _applied(function: str, value: float | ca.SX) -> float | ca.SX:
    """A function of a constant."""
    if not is_constant(ca.SX(value)):
        raise NotRationalError(f"{function} takes constants only.")
    exact = rational_of(value)
    near = float(numbers_of(ca.SX(value))[0, 0] if exact is None else exact)
    if function == "sqrt":
        if near < 0.0:
            raise SceneError(f"sqrt of the negative number {near:g}.")
        return root(near if exact is None else exact)
    if function in ("sin", "cos"):
        return cosine_sine(near)[function == "sin"]
    return literal(math.atan(near))


FUNCTIONS = {name: partial(_applied, name) for name in ("sqrt", "sin", "cos", "atan")}


def pi_times(factor: Fraction | int) -> ca.SX:
    """A multiple of pi."""
    return constant(Constant("pi", Fraction(factor)))


class ModuloPrime(NamedTuple):
    """Residues of a matrix, as an array of whole numbers of its shape, and their prime."""

    residues: np.ndarray[tuple[int, ...], np.dtype[np.object_]]
    prime: int


def modulo_prime(
    matrix: ca.SX, seed: int, given: Mapping[int, int] = MappingProxyType({}), missing: Rule = refused
) -> ModuloPrime:
    """Residues of a matrix (n, m) of rational expressions; constants count as they are written.

    Symbols have given values, by their hashes, or random ones. `missing` is for other operations.
    """
    constants, numbers = constants_in(matrix)
    known = {s.element_hash() for s in ca.vertsplit(constants)}
    free = [s for s in ca.symvar(matrix) if s.element_hash() not in known]
    field = Field(numbers)
    function = ca.Function("matrix", [ca.vertcat(ca.SX(0, 1), *free), constants], [matrix])
    table = rules(
        lambda value: field.residue(constant_of(value)),
        add=operator.add,
        mul=operator.mul,
        div=operator.truediv,
        missing=missing,
    )
    drawn = np.random.default_rng(seed).integers(1, 2**59, len(free)).tolist()
    drawn = [given.get(s.element_hash(), x) for s, x in zip(free, drawn, strict=True)]
    values = fold(
        function,
        table,
        [field.residue(x) for x in drawn],
        [field.of(number).residue for number in numbers],
    )
    residues = np.zeros(matrix.shape, dtype=object)
    residues[matrix.sparsity().get_triplet()] = [int(x) for x in values[0]]
    return ModuloPrime(residues, field.prime)


def any_function(operation: str, where: str, *operands: Any) -> Any:
    """A residue for the value of a function: the same for the same operands; its own at 0 and 1."""
    numbers = [int(x) for x in operands]
    if operation in FUNCTIONS_OF_DOUBLES and numbers in ([0], [1]):
        with np.errstate(all="ignore"):
            value = float(FUNCTIONS_OF_DOUBLES[operation](np.float64(numbers[0])))
        if value.is_integer():  # as cos(0) and log(1) are
            return 0 * operands[0] + int(value)
    name = f"{operation} {numbers}".encode()
    return 0 * operands[0] + int.from_bytes(hashlib.sha256(name).digest()[:7])


def cancels(column: ca.SX) -> bool:
    """Whether entries are shown to be zero whatever the symbols are, and the values of functions."""
    with suppress(ArithmeticError, ValueError):  # one divided by zero, or one that is not finite
        return not modulo_prime(column, _SEED, missing=any_function).residues.any()
    return False
