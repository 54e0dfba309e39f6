"""The syntax tree of a flat Modelica model: declarations and equations, each with its line.

Flat text and the tables of a compiler are read into the same tree, and one translator reads it. What the
tree has no place for (events, algorithms, functions) is a `Refused`, so that nothing is lost on the way.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

RELATIONS = ("<", "<=", ">", ">=", "==", "<>")


@dataclass(frozen=True, slots=True)
class Number:
    """A number as it is written, such as ``2.50e-3``."""

    text: str


@dataclass(frozen=True, slots=True)
class Text:
    """A string, or the name of an entry of an enumeration."""

    text: str


@dataclass(frozen=True, slots=True)
class Truth:
    """``true`` or ``false``."""

    value: bool


@dataclass(frozen=True, slots=True)
class Reference:
    """A variable such as ``motor.phi``, and the subscripts behind the last part of its name.

    `name` holds the subscripts of the parts before the last one, such as ``spring[1].phi``.
    """

    name: str
    subscripts: "tuple[Expression, ...]" = ()


@dataclass(frozen=True, slots=True)
class Binary:
    """left (operator) right: arithmetic, also of elements (``.*``), a relation, ``and`` or ``or``."""

    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True, slots=True)
class Unary:
    """``-operand`` or ``not operand``."""

    operator: str
    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Call:
    """A function of arguments; ``der`` is one of them."""

    function: str
    arguments: "tuple[Expression, ...]"


@dataclass(frozen=True, slots=True)
class If:
    """``if condition then value elseif ... else otherwise``."""

    branches: "tuple[tuple[Expression, Expression], ...]"
    otherwise: "Expression"


@dataclass(frozen=True, slots=True)
class Array:
    """``{a, b, c}``; a matrix ``[a, b; c, d]`` is an array of arrays."""

    entries: "tuple[Expression, ...]"


@dataclass(frozen=True, slots=True)
class Range:
    """``first : step : last``; without any of them, all entries."""

    first: "Expression | None" = None
    step: "Expression | None" = None
    last: "Expression | None" = None


@dataclass(frozen=True, slots=True)
class Comprehension:
    """``{value for index in range}``."""

    value: "Expression"
    index: str
    values: "Expression"


Expression = (
    Number | Text | Truth | Reference | Binary | Unary | Call | If | Array | Range | Comprehension
)


@dataclass(frozen=True, slots=True)
class Declaration:
    """A variable, parameter or constant.

    Attributes
    ----------
    name, type, sizes, line
        Such as ``spring[1].phi``, ``Real``, the sizes of an array, the line of the declaration.
    variability : "", "parameter", "constant" or "discrete"
    causality : "", "input" or "output"
    final : bool
    top : bool
        Whether it belongs to the model itself and not to a component of it.
    attributes : mapping
        ``start``, ``fixed``, ``min``, ``max``, ``nominal``, ``unit`` and others, as expressions.
    binding : the expression behind ``=``, or None
    annotation : mapping
        The entries of ``annotation(mbdlft(...))``, as expressions.
    comment : str
    """

    name: str
    type: str
    line: int
    sizes: tuple[Expression, ...] = ()
    variability: str = ""
    causality: str = ""
    final: bool = False
    top: bool = True
    attributes: Mapping[str, Expression] = field(default_factory=lambda: MappingProxyType({}))
    binding: Expression | None = None
    annotation: Mapping[str, Expression] = field(default_factory=lambda: MappingProxyType({}))
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Equation:
    """left = right."""

    left: Expression
    right: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Choice:
    """``if condition then equations elseif ... else equations end if``."""

    branches: "tuple[tuple[Expression, tuple[Statement, ...]], ...]"
    otherwise: "tuple[Statement, ...]"
    line: int


@dataclass(frozen=True, slots=True)
class Loop:
    """``for index in values loop equations end for``."""

    index: str
    values: Expression
    body: "tuple[Statement, ...]"
    line: int


@dataclass(frozen=True, slots=True)
class Check:
    """``assert(condition, message)``: no equation, but a claim on the values."""

    condition: Expression
    message: str
    line: int


@dataclass(frozen=True, slots=True)
class Refused:
    """Something that is read and cannot be translated: what it is, the names it sets, its line."""

    what: str
    names: tuple[str, ...]
    line: int


Statement = Equation | Choice | Loop | Check | Refused


@dataclass(frozen=True, slots=True)
class FlatModel:
    """A model without classes, connectors and components: declarations and equations.

    Attributes
    ----------
    name, source : str
        Its name, and the file that messages begin with.
    declarations, equations, initial, comment
    refused : tuple of Refused
        What cannot be translated.
    fixed : tuple of names and lines
        Parameters by whose values a compiler has chosen among equations: they cannot stay.
    """

    name: str
    source: str
    declarations: tuple[Declaration, ...]
    equations: tuple[Statement, ...]
    initial: tuple[Statement, ...] = ()
    refused: tuple[Refused, ...] = ()
    comment: str = ""
    fixed: tuple[tuple[str, int], ...] = ()


def parts(expression: Expression) -> "tuple[Expression, ...]":
    """The expressions that an expression is made of."""
    match expression:
        case Binary(_, left, right):
            return left, right
        case Unary(_, operand):
            return (operand,)
        case Call(_, arguments):
            return arguments
        case Array(entries):
            return entries
        case Reference(_, subscripts):
            return subscripts
        case If(branches, otherwise):
            return *(child for branch in branches for child in branch), otherwise
        case Range(first, step, last):
            return tuple(child for child in (first, step, last) if child is not None)
        case Comprehension(value, _, values):
            return value, values
        case _:
            return ()


def walk(expression: Expression) -> Iterator[Expression]:
    """All nodes of an expression, from the top down."""
    pending = [expression]
    while pending:
        node = pending.pop()
        yield node
        pending += reversed(parts(node))


def references(expression: Expression) -> Iterator[Reference]:
    """The variables of an expression."""
    return (node for node in walk(expression) if isinstance(node, Reference))


def spine(expression: Binary) -> tuple[Expression, list[tuple[str, Expression]]]:
    """The first operand of a chain of operators, and the operators with their right operands.

    Long sums are trees that nest to the left; a loop over the chain needs no recursion.
    """
    operations: list[tuple[str, Expression]] = []
    first: Expression = expression
    while isinstance(first, Binary):
        operations.append((first.operator, first.right))
        first = first.left
    return first, operations[::-1]
