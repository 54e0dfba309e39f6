"""The syntax tree of a flat Modelica model: declarations and equations, each with its line.

Flat text and the tables of a compiler are read into the same tree, and one translator reads it. What the
tree has no place for (events, algorithms, functions) is a `Refused`, so that nothing is lost on the way.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

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
    """A variable, parameter or constant, such as ``spring[1].phi`` of the type ``Real``."""

    name: str
    type: str
    line: int
    sizes: tuple[Expression, ...] = ()
    variability: str = ""  # or "parameter", "constant", "discrete"
    causality: str = ""  # or "input", "output"
    final: bool = False
    top: bool = True  # whether it belongs to the model itself and not to a component of it
    attributes: Mapping[str, Expression] = field(
        default_factory=dict
    )  # such as start, fixed, min, max, nominal, unit
    binding: Expression | None = None  # behind the "="
    annotation: Mapping[str, Expression] = field(
        default_factory=dict
    )  # the entries of ``annotation(mbdlft(...))``
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
    """What is read and cannot be translated: what it is, the names it sets, its line."""

    what: str
    names: tuple[str, ...]
    line: int


Statement = Equation | Choice | Loop | Check | Refused


@dataclass(frozen=True, slots=True)
class FlatModel:
    """A model without classes, connectors and components: declarations and equations."""

    name: str
    source: str  # the file that messages begin with
    declarations: tuple[Declaration, ...]
    equations: tuple[Statement, ...]
    initial: tuple[Statement, ...] = ()
    refused: tuple[Refused, ...] = ()  # what cannot be translated
    comment: str = ""
    # names and lines of parameters that cannot stay: a compiler chose equations by their values
    fixed: tuple[tuple[str, int], ...] = ()


def parts(expression: Expression) -> "tuple[Expression, ...]":
    """The expressions that an expression is made of, in the order of its fields."""
    entries: list[Any] = [getattr(expression, name) for name in expression.__slots__]
    while any(isinstance(entry, tuple) for entry in entries):
        entries = [x for entry in entries for x in (entry if isinstance(entry, tuple) else (entry,))]
    return tuple(entry for entry in entries if isinstance(entry, Expression))


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
