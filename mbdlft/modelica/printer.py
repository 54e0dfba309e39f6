"""Syntax trees as text: expressions for messages, and whole models as flat Modelica."""

import re
from collections.abc import Iterator, Mapping, Sequence

from mbdlft.modelica import tree
from mbdlft.modelica.expression import KEYWORDS
from mbdlft.modelica.tree import Expression

_PLAIN = re.compile(r"[A-Za-z_]\w*")
_LONG = 160  # characters of an equation in a message
_SUBSCRIPTS = re.compile(r"(?:\[\d+(?:,\d+)*\])?")


def flat_text(model: tree.FlatModel) -> str:
    """The text of a flat model that nothing in it is refused of; `flat_model` reads it again."""
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


def _declaration(d: tree.Declaration) -> str:
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


def _block(statements: Sequence[tree.Statement], indent: str) -> Iterator[str]:
    for statement in statements:
        yield from _lines(statement, f"{indent}  ")


def _lines(statement: tree.Statement, indent: str) -> Iterator[str]:
    match statement:
        case tree.Equation(left, right, _):
            yield f"{indent}{write(left)} = {write(right)};"
        case tree.Check(condition, message, _):
            yield f"{indent}assert({write(condition)}, {_text(message)});"
        case tree.Loop(index, values, body, _):
            yield f"{indent}for {index} in {write(values)} loop"
            yield from _block(body, indent)
            yield f"{indent}end for;"
        case tree.Choice(branches, otherwise, _):
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
    return text[1:-1] if isinstance(expression, tree.Binary | tree.Unary | tree.If) else text


def _written(expression: Expression) -> str:
    match expression:
        case tree.Number(text):
            return text
        case tree.Text(text):
            return _text(text)
        case tree.Truth(value):
            return str(value).lower()
        case tree.Reference(name, subscripts):
            return quoted(name) + (f"[{_listed(subscripts)}]" if subscripts else "")
        case tree.Binary():
            first, operations = tree.spine(expression)
            behind = [f" {operator} {_written(right)})" for operator, right in operations]
            return "".join(["(" * len(operations), _written(first), *behind])
        case tree.Unary(operator, operand):
            return f"({operator}{' ' if operator == 'not' else ''}{_written(operand)})"
        case tree.Call(function, arguments):
            return f"{function}({_listed(arguments)})"
        case tree.Array(entries):
            return f"{{{_listed(entries)}}}"
        case tree.Range():
            return ":".join(write(bound) for bound in tree.parts(expression)) or ":"
        case tree.Comprehension(value, index, values):
            return f"{{{write(value)} for {index} in {write(values)}}}"
        case tree.If(branches, otherwise):
            texts = [f"if {write(when)} then {write(then)}" for when, then in branches]
            return f"({' else'.join(texts)} else {write(otherwise)})"


def _listed(expressions: tuple[Expression, ...]) -> str:
    return ", ".join(write(entry) for entry in expressions)
