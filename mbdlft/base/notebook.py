"""What notebooks show of an object: headings and tables, in which every text is text and no markup."""

import html
from collections.abc import Iterable, Sequence


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
