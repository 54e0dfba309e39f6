"""Flat Modelica text, one model of declarations and equations, read into a syntax tree.

OpenModelica, Dymola and rumoca write such texts as flat or Base Modelica. What a flat text does not have
(`connect`, components, `extends`) is an error; what has no place in a linear model (`when`, algorithms)
is read over and becomes a `Refused` with its names and its line.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace

from mbdlft.base.errors import SceneError
from mbdlft.modelica import tree
from mbdlft.modelica.expression import ExpressionParser, Token
from mbdlft.modelica.tree import Expression, write

_TYPES = ("Real", "Integer", "Boolean", "String")
_WARNING = tree.Reference("AssertionLevel.warning")
_PREFIXES = ("flow", "stream", "inner", "outer", "each")
_VARIABILITY = ("parameter", "constant", "discrete")
_ADVICE = (
    "Flat text has declarations of Real, Integer, Boolean and String, and equations. Give a model with "
    "components and connectors as a .mo file, or let another compiler write its flat text."
)
_CLASSES, _SKIPPED = ("model", "class", "block"), ("function", "record", "type")
_SECTIONS = ("public", "protected", "equation", "algorithm", "initial", "end", "annotation")


def flat_model(text: str, source: str = "flat Modelica") -> tree.FlatModel:
    """The syntax tree of a flat Modelica text.

    Parameters
    ----------
    text : str
    source : str
        What messages call the text, such as the name of its file.
    """
    try:
        return _TextParser(text, source).model()
    except RecursionError:
        raise SceneError(f"{source}: an expression or a choice is nested too deep.") from None


def declared_annotation(text: str, source: str, line: int) -> Mapping[str, Expression]:
    """The entries of `annotation(mbdlft(...))` of the declaration whose name a text begins with."""
    parser = _TextParser(text, source, line, statement=True)
    name, subscripts = parser.name()
    return parser.declared(name, "Real", {"line": line}, subscripts).annotation


class _TextParser(ExpressionParser):
    """Reads a model; what is refused is collected in `refused`."""

    def __init__(self, text: str, source: str, first_line: int = 1, *, statement: bool = False) -> None:
        super().__init__(text, source, first_line, statement=statement)
        self.declarations: list[tree.Declaration] = []
        self.refused: list[tree.Refused] = []
        self.equations: list[tree.Statement] = []
        self.initial: list[tree.Statement] = []

    def model(self) -> tree.FlatModel:
        packages = []
        while not self._is_class(_CLASSES):
            if self.is_at("within"):
                self._behind_semicolon()
            elif self.skip("package"):
                packages.append(self.name()[0])
                self.comment()
            elif self._is_class(_SKIPPED):
                self._class()
            else:
                raise self.error("a model, such as 'model motor'")
        self._class_word()
        name, _ = self.name()
        comment = self.comment()
        self._sections()
        self._end(name)
        for package in reversed(packages):
            if self.is_at("annotation"):
                self.annotation()
                self.expect(";")
            self._end(package)
        if self.word.kind:
            raise self.error("the end of the text, behind the one model that it has")
        return tree.FlatModel(
            name,
            self.source,
            tuple(_entries(self.declarations)),
            tuple(self.equations),
            tuple(self.initial),
            tuple(self.refused),
            comment,
        )

    # classes and sections --------------------------------------------------------------------

    def _is_class(self, kinds: tuple[str, ...]) -> bool:
        """Whether a class of these kinds begins here, after words such as ``partial``."""
        place = self.place
        while self.words[place].text in ("partial", "pure", "impure", "final", "encapsulated"):
            place += 1
        return self.words[place].kind == "keyword" and self.words[place].text in kinds

    def _class_word(self) -> None:
        while self.take().text not in (*_CLASSES, *_SKIPPED):
            pass

    def _class(self) -> None:
        """Read over a function, a record or a type: what uses it is an error."""
        self._class_word()
        name, _ = self.name()
        if self.is_at("="):  # type Angle = Real(unit = "rad")
            self._behind_semicolon()
            return
        while self._named_end() != name:
            self.not_at_end(f"'end {name};'")
            self.take()
        self._end(name)

    def _named_end(self) -> str:
        """The name of `end name` at the place, which stays; empty if there is none."""
        first, name = self.place, ""
        if self.skip("end") and self.word.kind == "name":
            name, _ = self.name()
        self.place = first
        return name

    def _behind_semicolon(self) -> None:
        while not self.skip(";"):
            self.not_at_end("';'")
            self.take()

    def _end(self, name: str) -> None:
        end_name = self._named_end()
        self.expect("end")
        if end_name != name:
            raise self.error(f"'end {name};'")
        self.name()
        self.expect(";")

    def _sections(self) -> None:
        while not self.is_at("end"):
            self.not_at_end("'end' of the model")
            if self.is_at("public", "protected"):
                self.take()
            elif self.is_at("initial", "equation", "algorithm"):
                initial = self.skip("initial")
                if self.is_at("algorithm"):
                    self._algorithm("initial algorithm" if initial else "algorithm")
                    continue
                self.expect("equation")
                section = self.initial if initial else self.equations
                while not self._ends_section():
                    section += self._statement()
            elif self.is_at("annotation"):
                self.annotation()
                self.expect(";")
            elif self._is_class(_SKIPPED):
                self._class()
            else:
                self.declaration()

    def _ends_section(self) -> bool:
        self.not_at_end("'end' of the model")
        if self.is_at("initial"):  # may also be the function initial()
            return self.words[self.place + 1].text in ("equation", "algorithm")
        return self.is_at(*_SECTIONS)

    def _algorithm(self, what: str) -> None:
        line = self.expect("algorithm").line
        names: list[str] = []
        while not self._ends_section() or (
            self.is_at("end") and self.words[self.place + 1].text in ("if", "for", "while", "when")
        ):
            word = self.take()
            if word.kind == "name" and self.is_at(":=", "["):
                names.append(word.text)
            if word.text == "end":
                self.take()
        self.refused.append(tree.Refused(f"the {what}", tuple(dict.fromkeys(names)), line))

    # declarations ----------------------------------------------------------------------------

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
            list(self._inside())
        elif self.word.text in _TYPES:
            kind = self.take().text
        else:
            raise SceneError(
                f"{self.source}, line {self.word.line}: {self.word} is no type of flat text. {_ADVICE}"
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
    ) -> tree.Declaration:
        """A declaration behind its name: modification, value, comment, annotation."""
        attributes = self._modification() if self.is_at("(") else {}
        binding: Expression | None = None
        if self.skip("=") or self.skip(":="):
            binding = self.expression()
            if kind == "enumeration" and isinstance(binding, tree.Reference):
                binding = tree.Text(binding.name.rpartition(".")[2])
        if self.is_at("if"):
            raise self.error("no condition: flat text has no conditional declarations")
        return tree.Declaration(
            **{"name": name, "type": kind, **fields},  # type: ignore[arg-type]
            sizes=sizes,
            top="." not in name,
            attributes=attributes,
            binding=binding,
            comment=self.comment(),
            annotation=self.annotation(),
        )

    def _modification(self) -> dict[str, Expression]:
        self.expect("(")
        return dict(self.listed(self._attribute, ")"))

    def _attribute(self) -> tuple[str, Expression]:
        while self.skip("each") or self.skip("final"):
            pass
        if self.word.kind != "name":
            raise self.error("the name of an attribute, such as start")
        name = self.take().text
        if not self.skip("="):
            raise self.error("'=' behind an attribute: " + _ADVICE)
        return name, self.expression()

    def comment(self) -> str:
        return self.string() if self.word.kind == "text" else ""

    def annotation(self) -> dict[str, Expression]:
        """The entries of `mbdlft(...)` of an annotation; all others are for other tools."""
        annotations: dict[str, Expression] = {}
        while self.skip("annotation"):
            for depth, word in self._inside():
                if depth == 1 and word.text == "mbdlft" and self.is_at("("):
                    annotations |= self._modification()
        return annotations

    def _inside(self) -> Iterator[tuple[int, Token]]:
        """The words of a parenthesis, up to and with its end, and how deep each of them is."""
        self.expect("(")
        depth = 1
        while depth:
            self.not_at_end("')'")
            depth += self.is_at("(", "{") - self.is_at(")", "}")
            yield depth, self.take()

    # equations -------------------------------------------------------------------------------

    def _statement(self) -> list[tree.Statement]:
        """One equation, choice or loop; what is refused is collected instead."""
        line = self.word.line
        statement: tree.Statement
        if self.is_at("if"):
            statement = self._choice()
        elif self.is_at("for"):
            statement = self._loop()
        elif self.is_at("when"):
            statement = self._when()
        elif self.is_at("connect"):
            raise SceneError(
                f"{self.source}, line {line}: connect is no equation of flat text. {_ADVICE}"
            )
        else:
            statement = self._equation(line)
        self.comment()
        self.annotation()
        self.expect(";")
        if isinstance(statement, tree.Refused):
            self.refused.append(statement)
            return []
        return [statement]

    def _equation(self, line: int) -> tree.Statement:
        """left = right, an assert, or a call."""
        if self.word.kind == "name" and self.word.text in ("assert", "terminate", "reinit"):
            return self._called(self.take().text, line)
        left = self.expression()
        if not self.is_at("="):
            if isinstance(left, tree.Reference) and not left.subscripts and self.is_at("("):
                return self._called(left.name, line)
            raise self.error("'='")
        self.take()
        return tree.Equation(left, self.expression(), line)

    def _called(self, name: str, line: int) -> tree.Statement:
        def argument() -> Expression:
            if self.word.kind == "name" and self.words[self.place + 1].text == "=":
                self.place += 2  # the name of the argument
            return self.expression()

        self.expect("(")
        arguments = self.listed(argument, ")")
        if name == "assert" and len(arguments) >= 2:
            message = arguments[1].text if isinstance(arguments[1], tree.Text) else ""
            return tree.Check(arguments[0], message, line, _WARNING in arguments[2:])
        names = [a.name for a in arguments[:1] if isinstance(a, tree.Reference)]
        return tree.Refused(f"the call of {name}", tuple(names), line)

    def _block(self, *ends: str) -> tuple[tree.Statement, ...]:
        statements: list[tree.Statement] = []
        while not self.is_at(*ends):
            self.not_at_end(f"'{ends[-1]}'")
            statements += self._statement()
        return tuple(statements)

    def _choice(self) -> tree.Choice:
        line = self.word.line
        branches: list[tuple[Expression, tuple[tree.Statement, ...]]] = []
        while self.is_at("if" if not branches else "elseif"):
            self.take()
            condition = self.expression()
            self.expect("then")
            branches.append((condition, self._block("elseif", "else", "end")))
        otherwise = self._block("end") if self.skip("else") else ()
        self._close("if")
        return tree.Choice(tuple(branches), otherwise, line)

    def _loop(self) -> tree.Loop:
        line = self.expect("for").line
        index = self.take().text
        self.expect("in")
        values = self.expression()
        if self.is_at(","):
            raise self.error("'loop': one index for each loop")
        self.expect("loop")
        body = self._block("end")
        self._close("for")
        return tree.Loop(index, values, body, line)

    def _when(self) -> tree.Refused:
        """Read over a `when`; its names are those that it sets."""
        line = self.expect("when").line
        first = len(self.refused)
        names: list[str] = []
        self.expression()
        self.expect("then")
        while True:
            for statement in self._block("elsewhen", "end"):
                if isinstance(statement, tree.Equation) and isinstance(statement.left, tree.Reference):
                    names.append(statement.left.name)
            if not self.skip("elsewhen"):
                break
            self.expression()
            self.expect("then")
        self._close("when")
        names += [name for inner in self.refused[first:] for name in inner.names]
        del self.refused[first:]
        return tree.Refused("the event 'when'", tuple(dict.fromkeys(names)), line)

    def _close(self, what: str) -> None:
        self.expect("end")
        self.expect(what)


def _entries(declarations: list[tree.Declaration]) -> list[tree.Declaration]:
    """The declarations; where x[1], x[2], ... are declared one by one, each is a scalar of that name.

    A single x[3] is an array of three: where entries are declared one by one, there is x[1], too.
    """
    counts = Counter(d.name for d in declarations)
    return [
        replace(d, name=write(tree.Reference(d.name, d.sizes)), sizes=())
        if counts[d.name] > 1 and d.sizes
        else d
        for d in declarations
    ]
