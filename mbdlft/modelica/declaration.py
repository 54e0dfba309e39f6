"""Declarations of flat Modelica text: prefixes, types, sizes, attributes, values, annotations."""

from collections.abc import Mapping
from types import MappingProxyType

from mbdlft.base.errors import SceneError
from mbdlft.modelica.expression import ExpressionParser
from mbdlft.modelica.tree import Declaration, Expression, Reference, Text

TYPES = ("Real", "Integer", "Boolean", "String")
_PREFIXES = ("flow", "stream", "inner", "outer", "each")
_VARIABILITY = ("parameter", "constant", "discrete")
ADVICE = (
    "Flat text has declarations of Real, Integer, Boolean and String, and equations. Give a model with "
    "components and connectors as a .mo file, or let another compiler write its flat text."
)


def declared_annotation(text: str, source: str, line: int) -> Mapping[str, Expression]:
    """The entries of `annotation(mbdlft(...))` of the declaration whose name a text begins with."""
    parser = DeclarationParser(text, source, line, statement=True)
    name, subscripts = parser.name()
    return parser.declared(name, "Real", {"line": line}, subscripts).annotation


class DeclarationParser(ExpressionParser):
    """Reads declarations into `declarations`."""

    def __init__(
        self, text: str, source: str, first_line: int = 1, *, statement: bool = False
    ) -> None:
        super().__init__(text, source, first_line, statement=statement)
        self.declarations: list[Declaration] = []

    def not_at_end(self, expected: str) -> None:
        """Raise a SceneError if the text is at its end."""
        if not self.word.kind:
            raise self.error(expected)

    def declaration(self) -> None:
        """One declaration, of one or several variables."""
        fields: dict[str, object] = {"line": self.word.line}
        while self.word.kind == "keyword":
            word = self.take().text
            if word in _VARIABILITY:
                fields["variability"] = word
            elif word in ("input", "output"):
                fields["causality"] = word
            elif word == "final":
                fields["final"] = True
            elif word == "enumeration":
                break
            elif word not in _PREFIXES:
                self.place -= 1
                raise self.error("a declaration, 'equation' or 'end'")
        if self.words[self.place - 1].text == "enumeration":
            kind = "enumeration"
            self._parenthesis()
        else:
            found = self.word
            kind = self.take().text
            if kind not in TYPES:
                raise SceneError(
                    f"{self.source}, line {found.line}: {found} is no type of flat text. {ADVICE}"
                )
        sizes = self._subscripts() if self.is_at("[") else ()
        while True:
            name, subscripts = self.name()
            self.declarations.append(self.declared(name, kind, fields, (*subscripts, *sizes)))
            if not self.skip(","):
                break
        self.expect(";")

    def declared(
        self, name: str, kind: str, fields: Mapping[str, object], sizes: tuple[Expression, ...]
    ) -> Declaration:
        """A declaration behind its name: modification, value, comment, annotation."""
        attributes: dict[str, Expression] = {}
        binding: Expression | None = None
        if self.is_at("("):
            attributes = self._modification()
        if self.skip("=") or self.skip(":="):
            binding = self.expression()
            if kind == "enumeration" and isinstance(binding, Reference):
                binding = Text(binding.name.rpartition(".")[2])
        if self.is_at("if"):
            raise self.error("no condition: flat text has no conditional declarations")
        comment = self.comment()
        annotation = self.annotation()
        return Declaration(
            **{"name": name, "type": kind, **fields},  # type: ignore[arg-type]
            sizes=sizes,
            top="." not in name,
            attributes=MappingProxyType(attributes),
            binding=binding,
            comment=comment,
            annotation=MappingProxyType(annotation),
        )

    def _modification(self) -> dict[str, Expression]:
        """The entries of a parenthesis of attributes."""
        found: dict[str, Expression] = {}
        self.expect("(")
        while not self.is_at(")"):
            while self.skip("each") or self.skip("final"):
                pass
            word = self.take()
            if word.kind != "name":
                self.place -= 1
                raise self.error("the name of an attribute, such as start")
            if not self.is_at("="):
                raise self.error("'=' behind an attribute: " + ADVICE)
            self.take()
            found[word.text] = self.expression()
            if not self.skip(","):
                break
        self.expect(")")
        return found

    def comment(self) -> str:
        """The text at the place, or nothing."""
        return self.string() if self.word.kind == "text" else ""

    def annotation(self) -> dict[str, Expression]:
        """The entries of `mbdlft(...)` of an annotation; all others are for other tools."""
        found: dict[str, Expression] = {}
        while self.is_at("annotation"):
            self.take()
            last = self._behind_parenthesis()
            depth = 0
            while self.place < last:
                depth += self.is_at("(", "{") - self.is_at(")", "}")
                word = self.take()
                if depth == 1 and word.text == "mbdlft" and self.is_at("("):
                    found |= self._modification()
        return found

    def _behind_parenthesis(self) -> int:
        """The place behind the parenthesis that begins here; the place stays."""
        first = self.place
        self._parenthesis()
        last, self.place = self.place, first
        return last

    def _parenthesis(self) -> None:
        """Read over a parenthesis and all that is in it."""
        self.expect("(")
        depth = 1
        while depth:
            self.not_at_end("')'")
            depth += self.is_at("(") - self.is_at(")")
            self.take()
