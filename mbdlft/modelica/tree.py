"""The syntax tree of a flat Modelica model, declarations and equations with their lines; and its text.

Flat text and the tables of a compiler are read into the same tree, and one translator reads it. What the
tree has no place for (events, algorithms, functions) is a `Refused`, so that nothing is lost on the way.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mbdlft.base.arguments import arguments_checked

_KEYWORDS = (
    "algorithm and annotation block break class connect connector constant constrainedby der "
    "discrete each else elseif elsewhen encapsulated end enumeration equation expandable "
    "extends external false final flow for function if import impure in initial inner input "
    "loop model not operator or outer output package parameter partial protected public pure "
    "record redeclare replaceable return stream then true type when while within"
)
KEYWORDS = frozenset(_KEYWORDS.split())
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


@dataclass(frozen=True, slots=True)
class Entry:
    """``base[subscripts]``, where the base is no variable of its own."""

    base: "Expression"
    subscripts: "tuple[Expression, ...]"


@dataclass(frozen=True, slots=True)
class Member:
    """``base.field``, where the base is a record that a function gives."""

    base: "Expression"
    field: str


Expression = (
    Number
    | Text
    | Truth
    | Reference
    | Binary
    | Unary
    | Call
    | If
    | Array
    | Range
    | Comprehension
    | Entry
    | Member
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
    # such as start, fixed, min, max, nominal, unit
    attributes: Mapping[str, Expression] = field(default_factory=dict)
    binding: Expression | None = None  # behind the "="
    # the entries of ``annotation(mbdlft(...))``
    annotation: Mapping[str, Expression] = field(default_factory=dict)
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
    warning: bool = False


@dataclass(frozen=True, slots=True)
class Assign:
    """``(targets) := value`` of an algorithm; a target is None where a result is not taken."""

    targets: tuple[Reference | None, ...]
    value: Expression
    line: int


@dataclass(frozen=True, slots=True)
class Refused:
    """What is read and cannot be translated: what it is, the names it sets, its line."""

    what: str
    names: tuple[str, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Event:
    """``when``: what it sets, its line, and the conditions at which it happens."""

    names: tuple[str, ...]
    line: int
    conditions: tuple[Expression, ...]


Statement = Equation | Choice | Loop | Check | Assign | Refused


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the model: its algorithm, or the fields of the record that it makes."""

    name: str
    inputs: tuple[Declaration, ...]
    outputs: tuple[Declaration, ...]
    local: tuple[Declaration, ...]
    body: "tuple[Statement, ...]"
    makes_record: bool = False


@dataclass(frozen=True, slots=True)
class Fixed:
    """A parameter that keeps the value of the text, as a compiler has used it."""

    name: str
    why: str
    remedy: str
    line: int


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
    fixed: tuple[Fixed, ...] = ()
    functions: Mapping[str, Function] = field(default_factory=dict)
    records: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # fields of records by name
    held: tuple["Event", ...] = ()


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


def replaced(expression: Any, of: Callable[[Expression], Expression | None]) -> Any:
    """An expression in which nodes stand that `of` gives in the place of others; None keeps a node."""
    if isinstance(expression, tuple):
        return tuple(replaced(entry, of) for entry in expression)
    if not isinstance(expression, Expression):
        return expression
    new = of(expression)
    if new is not None:
        return new
    fields = [replaced(getattr(expression, name), of) for name in expression.__slots__]
    return type(expression)(*fields)


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


_PLAIN = re.compile(r"[A-Za-z_]\w*")
_LONG = 160  # characters of an equation in a message
_SUBSCRIPTS = re.compile(r"(?:\[\d+(?:,\d+)*\])?")


@arguments_checked
def flat_text(model: FlatModel) -> str:
    """The text of a flat model that nothing in it is refused of; `flat_model` reads it again.

    Functions of the model are called in it, and not written.
    """
    comment = f" {_text(model.comment)}" if model.comment else ""
    name = _part(model.name)
    lines = [f"model {name}{comment}"]
    lines += [f"  {_declaration(d)};" for d in model.declarations]
    for title, statements in (("initial equation", model.initial), ("equation", model.equations)):
        if statements:
            lines.append(title)
        lines += _block(statements, "")
    lines.append(f"end {name};")
    return "\n".join(lines) + "\n"


def shorter(text: str) -> str:
    """A text for messages: of a long one, its beginning and its end."""
    return text if len(text) <= _LONG else f"{text[: _LONG // 2]} ... {text[-_LONG // 4 :]}"


def quoted(name: str) -> str:
    """A name as Modelica writes it: with quotes around parts that are no plain words."""
    return ".".join(_part(word) for word in name.split("."))


def _part(word: str) -> str:
    """A part of a name, with its subscripts."""
    match = _PLAIN.match(word)
    if match is None or match[0] in KEYWORDS or not _SUBSCRIPTS.fullmatch(word, match.end()):
        return f"'{word}'"
    return word


def _declaration(d: Declaration) -> str:
    words = [
        *(["final"] if d.final else []),
        *(word for word in (d.variability, d.causality) if word),
        "String" if d.type == "enumeration" else d.type,
    ]
    sizes = f"[{_listed(d.sizes)}]" if d.sizes else ""
    text = f"{' '.join(words)}{sizes} {quoted(d.name)}"
    if d.attributes:
        text += f"({_entries(d.attributes)})"
    if d.binding is not None:
        text += f" = {write(d.binding)}"
    if d.comment:
        text += f" {_text(d.comment)}"
    if d.annotation:
        text += f" annotation(mbdlft({_entries(d.annotation)}))"
    return text


def _entries(entries: Mapping[str, Expression]) -> str:
    return ", ".join(f"{key} = {write(value)}" for key, value in entries.items())


def _block(statements: Sequence[Statement], indent: str) -> Iterator[str]:
    for statement in statements:
        yield from _lines(statement, f"{indent}  ")


def _lines(statement: Statement, indent: str) -> Iterator[str]:
    match statement:
        case Equation(left, right, _):
            yield f"{indent}{write(left)} = {write(right)};"
        case Check(condition, message, _):
            yield f"{indent}assert({write(condition)}, {_text(message)});"
        case Loop(index, values, body, _):
            yield f"{indent}for {index} in {write(values)} loop"
            yield from _block(body, indent)
            yield f"{indent}end for;"
        case Choice(branches, otherwise, _):
            for k, (condition, body) in enumerate(branches):
                yield f"{indent}{'else' * (k > 0)}if {write(condition)} then"
                yield from _block(body, indent)
            if otherwise:
                yield f"{indent}else"
            yield from _block(otherwise, indent)
            yield f"{indent}end if;"


def _text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def write(expression: Expression) -> str:
    """The text of an expression, with all parentheses but the outer ones."""
    text = _written(expression)
    return text[1:-1] if isinstance(expression, Binary | Unary | If) else text


def _written(expression: Expression) -> str:
    match expression:
        case Number(text):
            return text
        case Text(text):
            return _text(text)
        case Truth(value):
            return str(value).lower()
        case Reference(name, subscripts):
            return quoted(name) + (f"[{_listed(subscripts)}]" if subscripts else "")
        case Binary():
            first, operations = spine(expression)
            behind = [f" {operator} {_written(right)})" for operator, right in operations]
            return "".join(["(" * len(operations), _written(first), *behind])
        case Unary(operator, operand):
            return f"({operator}{' ' if operator == 'not' else ''}{_written(operand)})"
        case Call(function, arguments):
            return f"{function}({_listed(arguments)})"
        case Array(entries):
            return f"{{{_listed(entries)}}}"
        case Range():
            return ":".join(write(bound) for bound in parts(expression)) or ":"
        case Comprehension(value, index, values):
            return f"{{{write(value)} for {index} in {write(values)}}}"
        case Entry(base, subscripts):
            return f"{_written(base)}[{_listed(subscripts)}]"
        case Member(base, field):
            return f"{_written(base)}.{field}"
        case If(branches, otherwise):
            texts = [f"if {write(when)} then {write(then)}" for when, then in branches]
            return f"({' else'.join(texts)} else {write(otherwise)})"


def _listed(expressions: tuple[Expression, ...]) -> str:
    return ", ".join(write(entry) for entry in expressions)
