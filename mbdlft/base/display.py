"""What `help()` and notebooks show of an object: signatures in words, headings and tables."""

import html
import inspect
import types
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin


class Words:
    """An annotation that `help()` shows as it is."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def readable(annotation: Any) -> str:
    """The types of an annotation, in words: "(float, float, float)", "list of Body", "float | str"."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return readable(parts[0])
    if origin in (Union, types.UnionType):
        return " | ".join(dict.fromkeys(readable(kind) for kind in parts))
    if origin is Literal:
        return " | ".join(repr(kind) for kind in parts)
    if origin is tuple and len(parts) == 2 and parts[1] is ...:
        return f"list of {_inside(parts[0])}"
    if origin is tuple:
        return f"({', '.join(readable(kind) for kind in parts)})"
    if isinstance(origin, type) and len(parts) == 2:
        return f"dict of {_inside(parts[0])} to {_inside(parts[1])}"
    if annotation is type(None):
        return "None"
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def _inside(annotation: Any) -> str:
    """The types of an annotation inside another one."""
    text = readable(annotation)
    return f"({text})" if get_origin(annotation) in (Union, types.UnionType) else text


class ReadableSignature:
    """The `__signature__` of a record, made when it is asked for."""

    def __get__(self, record: Any, kind: Any) -> inspect.Signature:
        parameters = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.is_required() else field.get_default(),
                annotation=Words(readable(field.annotation)),
            )
            for name, field in kind.model_fields.items()
        ]
        return inspect.Signature(parameters)


def heading(text: str, more: str = "") -> str:
    """A heading, and a line below it."""
    below = f"<div>{html.escape(more)}</div>" if more else ""
    return f"<div><b>{html.escape(text)}</b></div>{below}"


def table(names: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; numbers have six digits. Without rows: nothing."""
    lines = ["".join(f"<td>{html.escape(_cell(cell))}</td>" for cell in row) for row in rows]
    if not lines:
        return ""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
