"""Operations of SX as a table, and functions of SX as formulas, which archives keep, and back."""

import math
import operator
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from fractions import Fraction
from functools import partial
from typing import Any

import casadi as ca

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.formula import ARITHMETIC, Functions, formula_value
from mbdlft.dae.theta.piecewise import ARGUMENT, Piecewise, applied, between
from mbdlft.dae.theta.piecewise import constant as always
from mbdlft.exact.numbers import Constant, constant_of, decimal
from mbdlft.problem.sx.constants import constants_in, double, in_doubles, is_constant, literal
from mbdlft.problem.sx.tapes import Rule, Rules, fold, steps
from mbdlft.system.theta import Table, named_tables

PLAIN = (  # functions of plain numbers
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "exp", "log", "log1p", "expm1"),
)
_OTHERS = ("sqrt", "fabs", "sign", "floor", "ceil", "fmin", "fmax", "atan2", "fmod", "hypot", "copysign")
_COMPARED = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
RATIONAL = {"input", "output", "const", "assign", "add", "sub", "mul", "div", "neg", "sq", "twice", "inv"}
RATIONAL |= {"constpow", "pow"}
FITTED = RATIONAL | {"sqrt", "sin", "cos", "tan"}
FUNCTIONS: Mapping[str, Rule] = {
    **{name: getattr(ca, name) for name in (*PLAIN, *_OTHERS, *_COMPARED)},
    "if_else_zero": lambda a, b: ca.if_else(a, b, 0.0),
    "and": ca.logic_and,
    "or": ca.logic_or,
    "not": ca.logic_not,
}
ARITHMETIC_OF_SX: Mapping[str, Rule] = {
    "assign": lambda a: a,
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": operator.pow,
    "constpow": operator.pow,
    "sq": lambda a: a * a,
    "twice": lambda a: 2 * a,
    "inv": lambda a: 1 / a,
}


def unsupported(operation: str, where: str, *operands: Any) -> Any:
    """The rule of operations that no DAE may have: an error."""
    raise NotRationalError(f"{where}: operation {operation!r} is not supported in a DAE.")


def with_literals(expression: ca.SX) -> ca.SX:
    """An expression with the decimals that its numbers print as, not rounded when they meet others."""
    free = column_of(ca.symvar(expression))
    function = ca.Function("written", [free], [expression])
    (rewritten,) = fold(function, _WITH_LITERALS, ca.vertsplit(free))
    return ca.SX(rewritten[0]) if rewritten else ca.SX(1, 1)


def in_digits(value: float) -> ca.SX:
    """A number with the digits that doubles carry."""
    short = decimal(float(f"{value:.14g}"))
    near = abs(float(short) - value) <= 1e-12 * abs(value) and short.denominator < 10**9
    return ca.SX(literal(short if near else Fraction(repr(float(value)))))


def operations_beyond(expressions: ca.SX, known: Collection[str]) -> list[str]:
    """Names of operations on symbols that are not among the known ones; functions of numbers pass."""
    nonzero: list[Any] = ca.SX(ca.sparsify(expressions)).nonzeros()
    entries = column_of(x for x in nonzero if not is_constant(x))
    function = ca.Function("f", [column_of(ca.symvar(entries))], [entries])
    return sorted({name for name, _, _ in steps(function)} - {*known})


def column_of(scalars: Iterable[ca.SX]) -> ca.SX:
    """A column (n, 1) of scalars; of none, (0, 1)."""
    return ca.vertcat(ca.SX(0, 1), *scalars)


def free_symbols(expression: ca.SX) -> list[ca.SX]:
    """The symbols in an expression that do not stand for constants."""
    return [s for s in ca.symvar(expression) if not is_constant(s)]


def _literal(value: float) -> ca.SX:
    if not math.isfinite(value):
        raise SceneError(f"the number {value} in an equation is not finite.")
    return ca.SX(literal(value))


_WITH_LITERALS = Rules(_literal, {**FUNCTIONS, **ARITHMETIC_OF_SX}, unsupported)
_SHORT = 12  # characters; longer parts that are used twice get a name
_TABLE = 3  # breakpoints from which on a part is a table, or two where its text is long:
_LONG = 16  # operations and operands; a saturation has five
_BINARY = {"add": ("+", 1), "sub": ("-", 1), "mul": ("*", 2), "div": ("/", 2)}
_CALLS = {name: name for name in (*PLAIN, *_OTHERS)}
_CALLS |= {"fabs": "abs", "fmin": "min", "fmax": "max", "fmod": "mod"}
_CALLS |= {name: f"{name}_" for name in ("and", "or", "not")}
# what formulas are for SX
SYMBOLIC: Functions = {
    **ARITHMETIC,
    **{text: FUNCTIONS[name] for name, text in _CALLS.items()},
    "where": ca.if_else,
}


@arguments_checked
def formula_function(
    name: str, arguments: Sequence[str], text: str, tables: Sequence[Table] = ()
) -> ca.Function:
    """The CasADi function of a formula.

    Parameters
    ----------
    name : str
        Of the function.
    arguments : sequence of str
        Names in the formula; each is a scalar.
    text : str
        As in `mbdlft.base.formula`, such as that of a `ThetaFunction`.
    tables : sequence of Table
        What `table1`, `table2` are in the text.
    """
    symbols = [ca.SX.sym(argument) for argument in arguments]
    lookups = {name: partial(_looked_up, table) for name, table in named_tables(tables).items()}
    value = formula_value(text, dict(zip(arguments, symbols, strict=True)), {**SYMBOLIC, **lookups})
    return ca.Function(name, symbols, [value], list(arguments), ["value"])


def _looked_up(table: Table, argument: ca.SX) -> ca.SX:
    points = [(decimal(x), decimal(y)) for x, y in zip(table.breakpoints, table.values, strict=True)]
    slopes = [(decimal(below), decimal(above)) for below, above in table.slopes]
    ends = decimal(table.below), decimal(table.above)
    return in_doubles(between(ca.SX(argument), points, slopes, ends))


class _Piece:
    """A part of a formula: how it is written, its binding strength, and of what it is a polynomial.

    `of` is the part that it is a piecewise polynomial of, itself if there is none; None of a number.
    """

    __slots__ = ("level", "of", "parts", "piecewise", "size", "write")

    def __init__(self, write: Callable[..., str], level: int, operands: Sequence["_Piece"] = ()) -> None:
        self.write, self.level, self.parts = write, level, tuple(operands)
        self.size: int = 1 + sum(operand.size for operand in self.parts)
        self.of: _Piece | None = self
        self.piecewise: Piecewise = ARGUMENT

    def table(self) -> Table | None:
        if self.of is None or self.of is self:
            return None
        return self.piecewise.table(_TABLE if self.size < _LONG else 2)


def formula_of(
    expression: ca.SX, symbols: Sequence[ca.SX], names: Sequence[str], *, tables: bool = True
) -> tuple[str, tuple[Table, ...]]:
    """The formula of a scalar expression of symbols, and the tables `table1`, `table2` in it.

    Parts that are used twice have names. With `tables`, parts that are lines or cubic polynomials
    between breakpoints, three or more, or two where they are long, are tables.
    """
    constants, numbers = constants_in(expression)
    function = ca.Function("formula", [column_of(symbols), constants], [ca.densify(expression)])
    arguments = [_Piece(lambda name=name: name, 9) for name in names]
    values = [_constant(number) for number in numbers]
    ((root,),) = fold(function, _RULES, arguments, values)
    return _written(root, set(names), tables=tables)


def _written(root: _Piece, taken: set[str], *, tables: bool) -> tuple[str, tuple[Table, ...]]:
    order: list[_Piece] = []
    known: dict[Table, str] = {}
    uses: Counter[int] = Counter()
    seen: set[int] = set()
    pending: list[tuple[_Piece, bool]] = [(root, False)]
    while pending:
        piece, done = pending.pop()
        if done:
            order.append(piece)
        elif id(piece) not in seen:
            seen.add(id(piece))
            pending.append((piece, True))
            table = piece.table() if tables else None
            if table is not None and piece.of is not None:
                name = known.setdefault(table, f"table{len(known) + 1}")
                called = _call(name)(piece.of)
                piece.write, piece.level, piece.parts = called.write, called.level, called.parts
            for operand in piece.parts:
                uses[id(operand)] += 1
                pending.append((operand, False))
    text: dict[int, tuple[str, int]] = {}
    named: list[str] = []
    for piece in order:
        operands = [text[id(operand)] for operand in piece.parts]
        written = piece.write(*operands) if operands else piece.write()
        level = piece.level
        if uses[id(piece)] > 1 and len(written) > _SHORT:
            name = next(n for k in range(len(taken) + 1) if (n := f"t{k + 1}") not in taken)
            taken.add(name)
            named.append(f"{name} = {written}")
            written, level = name, 9
        text[id(piece)] = (written, level)
    return "; ".join([*named, text[id(root)][0]]), tuple(known)


def _wrapped(piece: tuple[str, int], least: int) -> str:
    return piece[0] if piece[1] >= least else f"({piece[0]})"


def _binary(sign: str, level: int) -> Callable[[_Piece, _Piece], _Piece]:
    gap = " " if level == 1 else ""

    def write(a: tuple[str, int], b: tuple[str, int]) -> str:
        right = level + (sign in "-/")
        return f"{_wrapped(a, level)}{gap}{sign}{gap}{_wrapped(b, right)}"

    return lambda a, b: _Piece(write, level, [a, b])


def _call(name: str) -> Callable[..., _Piece]:
    return lambda *operands: _Piece(
        lambda *texts: f"{name}({', '.join(t for t, _ in texts)})", 9, operands
    )


def _power(a: _Piece, b: _Piece) -> _Piece:
    return _Piece(lambda x, y: f"{_wrapped(x, 5)}**{_wrapped(y, 4)}", 4, [a, b])


def _number(value: float) -> _Piece:
    exact = constant_of(value)
    return _constant(Constant("rational", exact))


def _constant(number: Constant) -> _Piece:
    """A number as a decimal, or as a quotient; others as the double next to them."""
    value = number.argument if number.kind == "rational" else Fraction(double(number))
    if number.kind != "rational":
        text = repr(double(number))
    elif float(value) == value or Fraction(repr(float(value))) == value:
        text = repr(int(value)) if value.denominator == 1 and abs(value) < 10**15 else repr(float(value))
    else:
        text = f"{value.numerator}/{value.denominator}"
    level = 1 if text.startswith("-") else 2 if "/" in text else 9
    piece = _Piece(lambda: text, level)
    piece.of, piece.piecewise = None, always(value)
    return piece


def _refused(operation: str, where: str, *operands: Any) -> Any:
    raise NotRationalError(f"{where}: operation {operation!r} has no formula.")


def _followed(name: str, rule: Callable[..., _Piece]) -> Callable[..., _Piece]:
    """A rule that also knows what becomes of piecewise polynomials of one part."""

    def apply(*operands: _Piece) -> _Piece:
        result = rule(*operands)
        of = {id(operand.of): operand.of for operand in operands if operand.of is not None}
        if len(of) <= 1:
            with suppress(NotRationalError):
                result.piecewise = applied(name, *(operand.piecewise for operand in operands))
                result.of = next(iter(of.values()), None)
        return result

    return apply


_OPERATIONS: Mapping[str, Callable[..., _Piece]] = {
    "assign": lambda a: a,
    "neg": lambda a: _Piece(lambda x: f"-{_wrapped(x, 3)}", 1, [a]),
    "twice": lambda a: _Piece(lambda x: f"2*{_wrapped(x, 3)}", 2, [a]),
    "sq": lambda a: _Piece(lambda x: f"{_wrapped(x, 5)}**2", 4, [a]),
    "inv": lambda a: _Piece(lambda x: f"1/{_wrapped(x, 3)}", 2, [a]),
    "pow": _power,
    "constpow": _power,
    "if_else_zero": lambda a, b: _Piece(lambda x, y: f"where({x[0]}, {y[0]}, 0)", 9, [a, b]),
    **{name: _binary(sign, level) for name, (sign, level) in _BINARY.items()},
    **{name: _call(text) for name, text in _CALLS.items()},
    **{
        name: (
            lambda a, b, sign=sign: _Piece(
                lambda x, y: f"{_wrapped(x, 1)} {sign} {_wrapped(y, 1)}", 0, [a, b]
            )
        )
        for name, sign in _COMPARED.items()
    },
}
_RULES = Rules(_number, {name: _followed(name, rule) for name, rule in _OPERATIONS.items()}, _refused)
