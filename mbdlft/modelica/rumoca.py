"""The tables of the compiler rumoca for a flattened model (`to_dict("flat")`), read into a syntax tree.

Only these tables are read: the flat text that rumoca writes leaves out events. A table or an entry that
is not known here is an error, so nothing is lost. The texts that the compiler has read give the lines of
its spans, numbers as they are written, and annotations.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from mbdlft.base.errors import SceneError
from mbdlft.modelica import tree
from mbdlft.modelica.sources import Sources, copies, first_span, tables_in
from mbdlft.modelica.tree import Expression

_OF_ENTRIES = {"Add": "+", "Sub": "-", "Mul": "*", "Div": "/", "Exp": "^"}
_OPERATORS = {
    **_OF_ENTRIES,
    **{f"{name}Elem": f".{sign}" for name, sign in _OF_ENTRIES.items()},
    **{"Lt": "<", "Le": "<=", "Gt": ">", "Ge": ">=", "Eq": "==", "Neq": "<>", "And": "and", "Or": "or"},
}
_TABLES = (
    "variables equations assert_equations initial_equations algorithms is_partial initial_algorithms "
    "when_chains structured_equations initial_structured_equations initial_assert_equations "
    "parameter_branch_selections enum_literal_ordinals variable_final_flags "
    "top_level_input_components model_description effective_types predefined_types"
)
# types and origins of what is in the tables above; a function is refused where it is called
_ORIGINS = (
    "predefined_string_declaration enumeration_types type_ids_by_def_id functions "
    "enumeration_type_roots record_instances record_types variable_type_names class_type "
    "definite_roots branches optional_edges potential_roots top_level_connectors "
    "oc_break_edge_scalar_count instance_relations"
)
_KNOWN = frozenset((*_TABLES.split(), *_ORIGINS.split()))
_TYPES = ("real", "integer", "boolean", "string")


def model_of_tables(tables: Mapping[str, Any], name: str, sources: Sources) -> tree.FlatModel:
    """The syntax tree of the tables of a model."""
    try:
        return _Reader(tables, name, sources).model()
    except RecursionError:
        advice = "Write parts of it as variables."
        raise SceneError(f"{sources.name}: an expression is nested too deep. {advice}") from None


class _Reader:
    """Reads the tables of one model."""

    def __init__(self, tables: Mapping[str, Any], name: str, sources: Sources) -> None:
        self.tables, self.name, self.sources = tables, name, sources
        self.tops = set(tables.get("top_level_input_components", ()))
        self.entries = tables.get("enum_literal_ordinals", {})
        reals = {
            name: item
            for name, item in tables["variables"].items()
            if isinstance(item["variability"], dict) and self._type(item) == "Real"
        }
        self.copies, self.doubtful = copies(reals, sources)

    def model(self) -> tree.FlatModel:
        strange = [key for key, table in self.tables.items() if table and key not in _KNOWN]
        if strange:
            raise self._unknown(f"the table {strange[0]!r}")
        if self.tables["is_partial"]:
            raise SceneError(f"{self.sources.name}: model {self.name!r} is partial.")
        chains = self.tables["when_chains"]
        refused = [
            *(self._algorithm(a, "the algorithm") for a in self.tables["algorithms"]),
            *(self._refused_event(chain) for chain in chains if not self._held(chain)),
        ]
        checks = (*self.tables["assert_equations"], *self.tables["initial_assert_equations"])
        return tree.FlatModel(
            self.name,
            self.sources.name,
            tuple(self._declaration(item) for item in self.tables["variables"].values()),
            (
                *self._equations("equations", "structured_equations"),
                *(self._check(item) for item in checks),
            ),
            (
                *self._equations("initial_equations", "initial_structured_equations"),
                *(self._statement(s) for a in self.tables["initial_algorithms"] for s in a["statements"]),
            ),
            tuple(refused),
            self.tables["model_description"] or "",
            tuple(self._fixed()),
            {name: self._function(item) for name, item in self.tables["functions"].items()},
            dict(self._records()),
            tuple(self._event(chain) for chain in chains if self._held(chain)),
        )

    def _unknown(self, what: str, span: Any = None) -> SceneError:
        line = self.sources.line(span)
        where = f", line {line}" if line else ""
        return SceneError(
            f"{self.sources.name}{where}: {what} of the compiler is not known here; give flat text of "
            "the model instead."
        )

    # declarations ----------------------------------------------------------------------------

    def _declaration(self, item: Mapping[str, Any]) -> tree.Declaration:
        span = item["source_span"]
        attributes: dict[str, Expression] = {
            key: self._expression(item[key])
            for key in ("start", "min", "max", "nominal")
            if item[key] is not None and not _is_default(item, key)
        }
        if item["fixed"]:
            attributes["fixed"] = tree.Truth(all(item["fixed"]))
        if item["unit"]:
            attributes["unit"] = tree.Text(item["unit"])
        if item["state_select"] != "Default":
            attributes["stateSelect"] = tree.Reference(f"StateSelect.{item['state_select'].lower()}")
        kind = next(iter(item["variability"])) if isinstance(item["variability"], dict) else ""
        side = next(iter(item["causality"])) if isinstance(item["causality"], dict) else ""
        binding = None if item["binding"] is None else self._expression(item["binding"])
        if item["name"] in self.copies:
            binding = tree.Reference(self.copies[item["name"]])
        top = "." not in item["name"]
        return tree.Declaration(
            item["name"],
            self._type(item),
            self.sources.line(span),
            tuple(tree.Number(str(size)) for size in item["dims"]),
            kind.lower(),
            side.lower(),
            final=bool(self.tables["variable_final_flags"].get(item["name"])),
            top=top if side != "Input" else item["name"].partition(".")[0] in self.tops or top,
            attributes=attributes,
            binding=binding,
            annotation=self.sources.annotation(span),
            comment=item["description"] or "",
        )

    def _type(self, item: Mapping[str, Any]) -> str:
        """The type of a variable, also where it is a type that is made of it."""
        effective = self.tables["effective_types"].get(str(item["type_id"]), {})
        canonical = effective.get("canonical_type", item["type_id"])
        for kind in _TYPES:
            if self.tables["predefined_types"][kind] == canonical:
                return kind.capitalize()
        return "enumeration" if item["is_discrete_type"] else "Real"

    # equations -------------------------------------------------------------------------------

    def _equation(self, item: Mapping[str, Any]) -> tree.Statement:
        return self._zero(self._expression(item["residual"]), self.sources.line(item["span"]))

    def _zero(self, residual: Expression, line: int) -> tree.Statement:
        """The equation residual = 0; a choice of equations, of which the compiler makes one residual."""
        match residual:
            case tree.Binary("-", tree.If(), tree.Number("0" | "0.0")):
                residual = residual.left
        if isinstance(residual, tree.If):
            branches = tuple((when, (self._zero(then, line),)) for when, then in residual.branches)
            return tree.Choice(branches, (self._zero(residual.otherwise, line),), line)
        if isinstance(residual, tree.Binary) and residual.operator == "-":
            return tree.Equation(residual.left, residual.right, line)
        return tree.Equation(residual, tree.Number("0"), line)

    def _equations(self, key: str, loops: str) -> Iterator[tree.Statement]:
        """Equations, with a loop where the compiler has not written all runs of it."""
        items, place = self.tables[key], 0
        for family in sorted(self.tables[loops], key=lambda f: int(f["first_equation_index"])):
            if family["interiors_materialized"]:
                continue
            first, indices = family["first_equation_index"], family["domain"]["binders"]
            runs = [range(i["lower"], i["upper"] + 1, i["step"]) for i in indices]
            body = family["template"]["body"]
            span = family["span"]
            if len(body) != family["equations_per_point"] or first < place:
                raise self._unknown("a loop that is written out in part", span)
            yield from (self._equation(item) for item in items[place:first])
            place = first + math.prod(map(len, runs)) * len(body)
            yield from self._loop(indices, [self._equation({"residual": e, "span": span}) for e in body])
        yield from (self._equation(item) for item in items[place:])

    def _loop(
        self, indices: Sequence[Mapping[str, Any]], body: Sequence[tree.Statement]
    ) -> Sequence[tree.Statement]:
        for i in reversed(indices):
            bounds = (tree.Number(str(i[key])) for key in ("lower", "step", "upper"))
            body = (tree.Loop(i["display_name"], tree.Range(*bounds), tuple(body), 0),)
        return body

    def _records(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Records by name, with the names of their fields."""
        kinds = self.tables.get("record_types", {})
        for name, item in self.tables.get("record_instances", {}).items():
            kind = kinds.get(str(item["type_def_id"]))
            if kind is not None and not item["dims"]:
                yield name, tuple(entry["name"] for entry in kind["fields"])

    def _check(self, item: Mapping[str, Any]) -> tree.Check:
        message = self._expression(item["message"])
        return tree.Check(
            self._expression(item["condition"]),
            message.text if isinstance(message, tree.Text) else "",
            self.sources.line(item["span"]),
            "warning" in str(item.get("level")),
        )

    def _algorithm(self, item: Mapping[str, Any], what: str) -> tree.Refused:
        names = tuple(output["name"] for output in item["outputs"])
        return tree.Refused(what, names, self.sources.line(item["span"]))

    # functions -------------------------------------------------------------------------------

    def _function(self, item: Mapping[str, Any]) -> tree.Function:
        line = self.sources.line(item["span"])
        body = tuple(self._statement(statement) for statement in item["body"])
        if item["external"]:
            body = (tree.Refused("the external code", (item["name"],), line),)
        inputs, outputs, local = (
            tuple(map(self._argument, item[key])) for key in ("inputs", "outputs", "locals")
        )
        return tree.Function(item["name"], inputs, outputs, local, body, item["is_constructor"])

    def _argument(self, item: Mapping[str, Any]) -> tree.Declaration:
        sizes = self._subscripts({"subscripts": item["shape_expr"]})
        if not sizes:
            dims = (item["effective_type"] or {}).get("dimensions", ())
            sizes = tuple(tree.Number(str(size)) if size else tree.Range() for size in dims)
        default = None if item["default"] is None else self._expression(item["default"])
        line = self.sources.line(item["span"])
        return tree.Declaration(item["name"], item["type_name"], line, sizes, binding=default)

    def _statement(self, item: Any) -> tree.Statement:
        ((kind, body),) = item.items() if isinstance(item, dict) else ((str(item), {}),)
        line = self.sources.line(body.get("span") or first_span(body))
        match kind:
            case "Assignment":
                return tree.Assign((self._assigned(body["comp"]),), self._expression(body["value"]), line)
            case "FunctionCall" if body["outputs"]:
                call = tree.Call(body["comp"]["name"], self._all(body["args"]))
                return tree.Assign(tuple(map(self._assigned, body["outputs"])), call, line)
            case "If":
                branches = tuple(
                    (self._expression(branch["cond"]), tuple(map(self._statement, branch["stmts"])))
                    for branch in body["cond_blocks"]
                )
                return tree.Choice(branches, tuple(map(self._statement, body["else_block"] or ())), line)
            case "For":
                inner = tuple(map(self._statement, body["equations"]))
                for index in reversed(body["indices"]):
                    inner = (tree.Loop(index["ident"], self._expression(index["range"]), inner, line),)
                return inner[0]
            case "Assert":
                return self._check(body)
            case _:
                return tree.Refused(f"the statement {kind!r}", (), line)

    def _assigned(self, item: Mapping[str, Any] | None) -> tree.Reference | None:
        """What an algorithm sets: a name, with subscripts at its end only."""
        if item is None:
            return None
        *path, last = item["parts"]
        if any(part["subs"] for part in path):
            raise self._unknown("an assignment to a part of an entry", item.get("span"))
        name = ".".join(part["ident"] for part in item["parts"])
        return tree.Reference(name, self._subscripts({"subscripts": last["subs"]}))

    def _held(self, chain: Mapping[str, Any]) -> bool:
        """Whether what an event sets keeps its value in an equilibrium.

        It does not where a clock sets what signals give, and `reinit` sets what changes otherwise, too.
        """
        tables = list(tables_in(chain))
        is_clock = any(table.get("function") == "Sample" for table in tables)
        resets = any("Reinit" in table for table in tables)
        return not resets and (not is_clock or self._is_of_time(chain, {"time", *_set_by(chain)}))

    def _refused_event(self, chain: Mapping[str, Any]) -> tree.Refused:
        line = self.sources.line(first_span(chain))
        return tree.Refused("the event 'when'", tuple(dict.fromkeys(_set_by(chain))), line)

    def _event(self, chain: Mapping[str, Any]) -> tree.Event:
        conditions = (chain["first"], *chain["else_when"])
        return tree.Event(
            tuple(dict.fromkeys(_set_by(chain))),
            self.sources.line(first_span(chain)),
            tuple(self._expression(when["condition"]) for when in conditions),
        )

    def _is_of_time(self, chain: Mapping[str, Any], names: set[str]) -> bool:
        """Whether an event sets what depends on time, parameters and its own values alone."""
        for table in tables_in(chain):
            name = table["VarRef"]["name"]["name"] if "VarRef" in table else "time"
            item = self.tables["variables"].get(name, {})
            constant = isinstance(item.get("variability"), dict) and "Discrete" not in item["variability"]
            if name not in names and not constant:
                return False
        return True

    def _fixed(self) -> Iterable[tree.Fixed]:
        """Parameters whose values the compiler has used."""
        for item in self.tables.get("parameter_branch_selections", ()):
            for path in item["references"]:
                name, line = ".".join(path), self.sources.line(item.get("span"))
                why = f"equations are chosen by the value of {name!r}"
                yield tree.Fixed(name, why, "choose by a signal", line)
        for name, other in self.doubtful.items():
            line = self.sources.line(first_span(self.tables["variables"][name]["binding"]))
            why = f"the compiler does not say whether {other!r} is {name!r} or a number of its own"
            remedy = "give it the value of a parameter of a model of your own: extends M(c = p)"
            yield tree.Fixed(name, why, remedy, line)

    # expressions -----------------------------------------------------------------------------

    def _expression(self, item: Mapping[str, Any]) -> Expression:
        ((kind, body),) = item.items()
        match kind:
            case "Literal":
                return self._literal(body)
            case "VarRef":
                return self._reference(body)
            case "Binary" if body["op"] in _OPERATORS:
                return self._chain(body)
            case "Unary" if body["op"] in ("Minus", "Not", "Plus"):
                operand = self._expression(body["rhs"])
                if body["op"] == "Plus":
                    return operand
                return tree.Unary("-" if body["op"] == "Minus" else "not", operand)
            case "BuiltinCall":
                name = body["function"]
                return tree.Call(name[0].lower() + name[1:], self._all(body["args"]))
            case "FunctionCall":
                return tree.Call(body["name"]["name"], self._all(body["args"]))
            case "If":
                branches = [self._all(branch) for branch in body["branches"]]
                pairs = tuple((when, then) for when, then in branches)
                return tree.If(pairs, self._expression(body["else_branch"]))
            case "ArrayComprehension" if body["filter"] is None:
                made = self._expression(body["expr"])
                for index in reversed(body["indices"]):
                    made = tree.Comprehension(made, index["name"], self._expression(index["range"]))
                return made
            case "FieldAccess":
                return tree.Member(self._expression(body["base"]), body["field"])
            case "Index":
                return tree.Entry(self._expression(body["base"]), self._subscripts(body))
            case "Tuple":
                return tree.Call("", self._all(body["elements"]))
            case "StringConversion":
                return tree.Call("String", ())
            case "Array" if body.get("kind", "Array") != "Array":
                return _joined(body["kind"], self._all(body["elements"]))
            case "Array":
                return tree.Array(self._all(body["elements"]))
            case "Range":
                bounds = (body["start"], body["step"], body["end"])
                return tree.Range(*(None if x is None else self._expression(x) for x in bounds))
            case _:
                raise self._unknown(f"the expression {kind!r}", body.get("span"))

    def _chain(self, body: Mapping[str, Any]) -> Expression:
        """Operators and their sides; long sums nest to the left, and are read in a loop."""
        pending = [body]
        while (left := pending[-1]["lhs"]).keys() == {"Binary"}:
            pending.append(left["Binary"])
        first = self._expression(pending[-1]["lhs"])
        for inner in reversed(pending):
            if inner["op"] not in _OPERATORS:
                raise self._unknown(f"the operator {inner['op']!r}", inner.get("span"))
            first = tree.Binary(_OPERATORS[inner["op"]], first, self._expression(inner["rhs"]))
        return first

    def _all(self, items: Iterable[Mapping[str, Any]]) -> tuple[Expression, ...]:
        return tuple(self._expression(item) for item in items)

    def _literal(self, body: Mapping[str, Any]) -> Expression:
        ((kind, value),) = body["value"].items()
        if kind == "Boolean":
            return tree.Truth(bool(value))
        if kind == "String":
            return tree.Text(value)
        return tree.Number(self.sources.number(body.get("span"), value))

    def _reference(self, body: Mapping[str, Any]) -> Expression:
        name = body["name"]["name"]
        if name in self.entries and name not in self.tables["variables"]:
            return tree.Text(name.rpartition(".")[2].strip("'"))
        return tree.Reference(name, self._subscripts(body))

    def _subscripts(self, body: Mapping[str, Any]) -> tuple[Expression, ...]:
        subscripts: list[Expression] = []
        for item in body["subscripts"]:
            ((kind, inner),) = item.items() if isinstance(item, dict) else ((item, {}),)
            match kind:
                case "Index":
                    subscripts.append(tree.Number(str(inner["value"])))
                case "Expr":
                    subscripts.append(self._expression(inner["expr"]))
                case "Colon":
                    subscripts.append(tree.Range())
                case _:
                    raise self._unknown(f"the subscript {kind!r}", body.get("span"))
        return tuple(subscripts)


def _joined(kind: str, entries: tuple[Expression, ...]) -> Expression:
    """``[a, b]`` or ``[a; b]``, whose entries may be blocks; a row of numbers is an array in an array."""
    if kind == "Horizontal" and all(
        isinstance(x.operand if isinstance(x, tree.Unary) else x, tree.Number) for x in entries
    ):
        return tree.Array((tree.Array(entries),))
    rows = [x.entries[0] for x in entries if isinstance(x, tree.Array) and len(x.entries) == 1]
    if kind == "Vertical" and len(rows) == len(entries):
        return tree.Array(tuple(rows))
    blocks = (tree.Call("matrix", (entry,)) for entry in entries)
    return tree.Call("cat", (tree.Number("1" if kind == "Vertical" else "2"), *blocks))


def _is_default(item: Mapping[str, Any], key: str) -> bool:
    """Whether a start is the one that the compiler gives where the model gives none."""
    if key != "start":
        return False
    if isinstance(item["variability"], dict) and item["binding"] is not None:
        return True  # that of a parameter is its value
    return bool(item[key].get("Literal", {}).get("span", 0) == item["source_span"])


def _set_by(chain: Any) -> Iterator[str]:
    """Names that a `when` sets, anywhere in its table."""
    for table in tables_in(chain):
        if "Reinit" in table:
            yield str(table["Reinit"]["state"])
        if "Assign" in table:
            yield from _target(table["Assign"])


def _target(entry: Any) -> Iterator[str]:
    for key in ("target", "variable", "lhs", "name"):
        target = entry.get(key) if isinstance(entry, dict) else None
        while isinstance(target, dict) and "name" in target:
            target = target["name"]
        if isinstance(target, str):
            yield target
            return
