"""The texts that a compiler has read: lines of its spans, numbers as they are written, annotations."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mbdlft.base.errors import SceneError
from mbdlft.modelica.declaration import declared_annotation
from mbdlft.modelica.tree import Expression

_ANNOTATION = b"mbdlft"
_NOTHING: Mapping[str, Expression] = MappingProxyType({})


class Sources:
    """Texts of files by the numbers that a compiler gives them.

    The compiler does not say which file has which number: a file has a number if at the spans of all
    names of this number it has these names.

    Parameters
    ----------
    files : files that may have been read, the most likely one first
    variables : the table of variables
    """

    def __init__(self, files: Iterable[Path], variables: Mapping[str, Any]) -> None:
        self._texts: dict[int, bytes] = {}
        names: dict[int, list[tuple[int, int, bytes]]] = {}
        for item in variables.values():
            for part in item["component_ref"]["parts"][-1:] if item["component_ref"] else ():
                span = part["span"]  # of the type and the name
                place = (span["start"], span["end"], part["ident"].encode())
                names.setdefault(span["source"], []).append(place)
        self.name = ""
        for file in files:
            self.name = self.name or file.name
            if names.keys() <= self._texts.keys():
                break
            text = file.read_bytes()
            for source, places in names.items():
                if source not in self._texts and all(
                    text[a:b].endswith(name) for a, b, name in places
                ):
                    self._texts[source] = text

    def line(self, span: Any) -> int:
        """The line where a span begins; 0 if it is not known."""
        text = self._texts.get(span["source"]) if isinstance(span, dict) else None
        return 0 if text is None else text[: span["start"]].count(b"\n") + 1

    def number(self, span: Any, value: float) -> str:
        """A number as it is written at a span; the digits that its double prints as, otherwise."""
        text = self._texts.get(span["source"]) if isinstance(span, dict) else None
        if text is not None:
            written = text[span["start"] : span["end"]].decode("utf-8", "replace").strip()
            try:
                if written[:1].isdigit() and float(written) == value:
                    return written
            except ValueError:
                pass
        if not math.isfinite(value):
            raise SceneError(f"{self.name}: the number {value} is not finite.")
        return repr(value)

    def annotation(self, span: Any) -> Mapping[str, Expression]:
        """The entries of `annotation(mbdlft(...))` of the declaration that ends a span with its name."""
        text = self._texts.get(span["source"]) if isinstance(span, dict) else None
        if text is None or _ANNOTATION not in text[span["end"] :]:
            return _NOTHING
        first = text[span["start"] : span["end"]].rfind(b" ") + 1 + span["start"]
        return declared_annotation(
            text[first:].decode("utf-8", "replace"), self.name, self.line(span)
        )
