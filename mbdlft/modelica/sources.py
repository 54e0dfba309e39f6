"""Texts that a compiler has read, by the spans of its tables, and what is said in these only."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import accumulate, permutations
from operator import and_, eq
from pathlib import Path
from typing import Any

from mbdlft.base.errors import SceneError
from mbdlft.modelica.text import declared_annotation
from mbdlft.modelica.tree import Expression

_ANNOTATION = b"mbdlft"
_PASSED_OVER = re.compile(rb'"(?:[^"\\]|\\.)*"|/\*.*?\*/|//[^\n]*', re.DOTALL)  # texts and comments
_TOKEN = re.compile(rb"'(?:[^'\\]|\\.)*'|[\w.]+|\[[^\]]*\]|[^\w\s]")
_PART = re.compile(r"((?:'(?:[^'\\]|\\.)*'|[^.'\[])+)(\[[^\]]*\])?\.?")  # of a name; its subscripts
_CLASSES = frozenset(b"extends constrainedby model type class block record connector".split())


class Sources:
    """Texts of files, the most likely ones first, by the numbers that a compiler gives them.

    The compiler does not say which file has which number: a file has a number if at the spans of all
    names of this number in the table of variables it has these names; where it declares none, if before
    the spans of all numbers that modifications give there is ``name =``.
    """

    def __init__(self, files: Iterable[Path], variables: Mapping[str, Any]) -> None:
        self._texts: dict[int, bytes] = {}
        self._plain: dict[int, bytes] = {}  # with blanks in the place of comments
        names: dict[int, list[tuple[int, int, bytes]]] = {}
        given: dict[int, list[tuple[int, bytes]]] = {}
        for item in variables.values():
            for component in item["component_ref"]["parts"][-1:] if item["component_ref"] else ():
                name, span = component["ident"].encode(), component["span"]  # of the type and the name
                names.setdefault(span["source"], []).append((span["start"], span["end"], name))
                number = (item["binding"] or {}).get("Literal", {}).get("span")
                if item["binding_from_modification"] and number:
                    given.setdefault(number["source"], []).append((number["start"], name))
        self.name = ""
        for file in files:
            self.name = self.name or file.name
            if names.keys() | given.keys() <= self._texts.keys():
                break
            text = file.read_bytes()
            for source in (names | given).keys() - self._texts.keys():
                declared = (text[a:b].endswith(name) for a, b, name in names.get(source, ()))
                before = (_before(text, a, name) for a, name in given.get(source, ()))
                if all(declared if source in names else before):
                    self._texts[source] = text

    def _text(self, span: Any) -> bytes | None:
        return self._texts.get(span["source"]) if isinstance(span, dict) else None

    def line(self, span: Any) -> int:
        """The line where a span begins; 0 if it is not known."""
        text = self._text(span)
        return 0 if text is None else text[: span["start"]].count(b"\n") + 1

    def elements(self, span: Any) -> tuple[str, ...] | None:
        """The elements in whose modifications a text stands: a, b of ``A a(b(c=3))``; None: not known."""
        text = self._text(span)
        if text is None:
            return None
        if span["source"] not in self._plain:
            self._plain[span["source"]] = _PASSED_OVER.sub(lambda m: b" " * len(m[0]), text)
        before = self._plain[span["source"]][: span["start"]].rpartition(b";")[2]
        tokens = [token for token in _TOKEN.findall(before) if not token.startswith(b"[")]
        names, depth = [], 0
        for k in reversed(range(len(tokens))):
            depth = max(depth + (tokens[k] == b")") - (tokens[k] == b"("), -1)
            if depth == -1:
                depth = 0
                head = tokens[: k - 2] if tokens[k - 2 : k - 1] == [b"="] else tokens[:k]  # c = R(3)
                if head and not _CLASSES & {*head[-2:-1]}:
                    names.append(head[-1].decode("utf-8", "replace"))
        return tuple(reversed(names))

    def number(self, span: Any, value: float) -> str:
        """A number as it is written at a span; the digits that its double prints as, otherwise."""
        text = self._text(span)
        if text is not None:
            written = text[span["start"] : span["end"]].decode("utf-8", "replace").strip()
            with suppress(ValueError):
                if written[:1].isdigit() and float(written) == value:
                    return written
        if not math.isfinite(value):
            raise SceneError(f"{self.name}: the number {value} is not finite.")
        return repr(value)

    def annotation(self, span: Any) -> Mapping[str, Expression]:
        """The entries of `annotation(mbdlft(...))` of the declaration that ends a span with its name."""
        text = self._text(span)
        if text is None or _ANNOTATION not in text[span["end"] :]:
            return {}
        first = text[span["start"] : span["end"]].rfind(b" ") + 1 + span["start"]
        return declared_annotation(text[first:].decode("utf-8", "replace"), self.name, self.line(span))


def _before(text: bytes, place: int, name: bytes) -> bool:
    """Whether ``name =`` stands before a place."""
    rest = text[:place].rstrip()
    return rest.endswith(b"=") and rest[:-1].rstrip().endswith(name)


def copies(
    items: Mapping[str, Mapping[str, Any]], sources: Sources
) -> tuple[dict[str, str], dict[str, str]]:
    """Parameters whose value is a copy of the text that another one has, and this one; those in doubt.

    Of ``A a(c=3)``, where A has ``B b(c=c)``, the compiler says that a.b.c is 3, with the place of the
    text of a.c. The text belongs to the elements that it names, and what else has it is a copy of these.
    """
    groups: dict[str, list[str]] = {}
    for name, item in items.items():
        text = repr(item["binding"])
        if item["binding_from_modification"] and "'VarRef'" not in text:
            groups.setdefault(text, []).append(name)
    of: dict[str, str] = {}
    doubtful: dict[str, str] = {}  # and one that may be their copy
    for group in groups.values():
        if len(group) == 1:
            continue
        elements = sources.elements(first_span(items[group[0]]["binding"]))
        paths = {name: _PART.findall(name) for name in group}
        # of the elements, by the parameters that these give a value to
        owners: dict[str, list[tuple[str, str]]] = {}
        for name, (*path, _) in paths.items():
            own = len(path) - len(elements or ())
            if elements is not None and own >= 0 and tuple(x for x, _ in path[own:]) == elements:
                owners[name] = path[:own]
        for x, y in permutations(owners if elements else (), 2):  # an owner in another one of its class
            if len(owners[x]) < len(owners[y]) and owners[y][: len(owners[x])] == owners[x]:
                doubtful.setdefault(x, y)
        for name in (x for x in group if x not in owners):
            near = [x for x, owner in owners.items() if owner == paths[name][: len(owner)]]
            same = [sum(accumulate(map(eq, paths[x], paths[name]), and_)) for x in near]
            found = [x for x, n in zip(near, same, strict=True) if n == max(same)] or list(owners)
            if len(found) == 1:
                of[name] = found[0]
            else:
                for x in found or group:
                    doubtful.setdefault(x, name)
    return of, doubtful


def tables_in(item: Any) -> Iterator[Mapping[str, Any]]:
    """All tables that a table or a list has in it, each before those in it."""
    if isinstance(item, dict):
        yield item
    entries = item.values() if isinstance(item, dict) else item if isinstance(item, list) else ()
    for entry in entries:
        yield from tables_in(entry)


def first_span(item: Any) -> Any:
    """The first span in a table, or None."""
    spans = (table.get("span") for table in tables_in(item))
    return next((span for span in spans if isinstance(span, dict)), None)
