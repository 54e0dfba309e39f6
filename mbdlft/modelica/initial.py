"""What initialization gives: parameters with `fixed = false`, and values that events hold.

Their equations and assignments become their values; those of a tuple, one for each result.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from mbdlft.modelica import tree
from mbdlft.modelica.tree import Expression, write

RESULTS = "results"  # the tuple of all results of a call


def initialized(model: tree.FlatModel) -> tree.FlatModel:
    """A model whose parameters with `fixed = false`, and what is discrete, have values of their own.

    Initial equations that give none of these stay as they are; so does a parameter that none gives.
    """
    model = replace(model, declarations=tuple(_set_by_events(model)))
    declared = {d.name: d for d in model.declarations}
    given: dict[str, Expression] = {}
    others: list[tree.Statement] = []
    pairs = [(statement, dict(_given(statement, declared))) for statement in model.initial]
    while True:
        implicit = {
            name
            for name, d in declared.items()
            if d.variability == "parameter" and not d.sizes and d.binding is None
            if d.attributes.get("fixed") == tree.Truth(value=False)
        } - {name.partition("[")[0] for _, values in pairs for name in values}
        later = [
            (statement, values)
            for statement, values in pairs
            if not any(r.name in implicit for x in values.values() for r in tree.references(x))
        ]
        if len(later) == len(pairs):
            break
        others += [statement for statement, values in pairs if (statement, values) not in later]
        pairs = later
    for statement, values in pairs:
        if values and not values.keys() & given.keys():
            given |= values
        else:
            others.append(statement)
    given = _whole(given)
    starts = {
        name: d.attributes["start"]
        for name, d in declared.items()
        if d.attributes.get("fixed") == tree.Truth(value=True) and "start" in d.attributes
        if d.variability not in ("parameter", "constant")
    }

    def start(node: Expression) -> Expression | None:
        if node == tree.Reference("time"):
            return tree.Number("0")
        return starts.get(node.name) if isinstance(node, tree.Reference) else None

    def with_value(d: tree.Declaration) -> tree.Declaration:
        if d.name not in given:
            return d
        value = tree.replaced(given[d.name], start)
        attributes = {key: x for key, x in d.attributes.items() if key not in ("fixed", "start")}
        if d.variability == "parameter":
            return replace(d, binding=value, attributes=attributes)
        return replace(d, attributes={**attributes, "start": value})

    return replace(model, declarations=tuple(map(with_value, model.declarations)), initial=tuple(others))


def _set_by_events(model: tree.FlatModel) -> Iterator[tree.Declaration]:
    """Declarations; what an event sets is discrete."""
    names = {name for event in model.held for name in event.names}
    for d in model.declarations:
        yield replace(d, variability="discrete") if d.name in names and not d.variability else d


def is_discrete(d: tree.Declaration) -> bool:
    """Whether events alone change a variable."""
    constant = d.variability in ("parameter", "constant")
    return not constant and (d.variability == "discrete" or d.type != "Real")


def _given(
    statement: tree.Statement, declared: Mapping[str, tree.Declaration]
) -> Iterator[tuple[str, Expression]]:
    """Names, and the values that a statement gives to them, if it gives values to nothing else."""

    def is_open(target: Expression | None) -> bool:
        if not isinstance(target, tree.Reference) or target.name not in declared:
            return False
        if not all(isinstance(subscript, tree.Number) for subscript in target.subscripts):
            return False
        d = declared[target.name]
        loose = d.attributes.get("fixed") == tree.Truth(value=False)
        return is_discrete(d) or (d.variability == "parameter" and loose and d.binding is None)

    match statement:
        case tree.Equation(tree.Call("", targets), value) | tree.Assign(targets, value):
            if all(map(is_open, targets)):
                whole = tree.Call(RESULTS, (value,)) if len(targets) > 1 else None
                for k, target in enumerate(targets):
                    entry = whole and tree.Entry(whole, (tree.Number(str(k + 1)),))
                    yield write(target), entry or value  # type: ignore[arg-type]
        case tree.Equation(tree.Call("pre", (target,)), value) if is_open(target):
            yield write(target), value
        case tree.Equation(left, right) if is_open(left):
            yield write(left), right
        case tree.Equation(left, right) if is_open(right):
            yield write(right), left
        case tree.Loop(index, tree.Range(tree.Number(first), tree.Number("1"), tree.Number(last)), body):
            for k in range(int(first), int(last) + 1):
                at = tree.Number(str(k))
                for inner in body:
                    if isinstance(inner, tree.Equation):
                        put = _put(index, at)
                        left, right = (tree.replaced(side, put) for side in (inner.left, inner.right))
                        yield from _given(tree.Equation(left, right, inner.line), declared)
        case tree.Choice(branches, otherwise):
            made = [dict(_of_block(body, declared)) for body in (*(b for _, b in branches), otherwise)]
            if all(block.keys() == made[0].keys() for block in made):
                for name in made[0]:
                    chosen = tuple(
                        (when, block[name]) for (when, _), block in zip(branches, made, strict=False)
                    )
                    yield name, tree.If(chosen, made[-1][name])


def _put(index: str, value: Expression) -> Callable[[Expression], Expression | None]:
    return lambda node: value if node == tree.Reference(index) else None


def _whole(given: Mapping[str, Expression]) -> dict[str, Expression]:
    """Values by name; those of the entries of a vector become one array."""
    values = {name: value for name, value in given.items() if not name.endswith("]")}
    entries = [name for name in given if name.endswith("]")]
    for whole in dict.fromkeys(name.rpartition("[")[0] for name in entries):
        count = sum(name.rpartition("[")[0] == whole for name in entries)
        names = [f"{whole}[{k + 1}]" for k in range(count)]
        if all(name in given for name in names):
            values[whole] = tree.Array(tuple(given[name] for name in names))
    return values


def _of_block(
    body: tuple[tree.Statement, ...], declared: Mapping[str, tree.Declaration]
) -> Iterator[tuple[str, Expression]]:
    for statement in body:
        yield from _given(statement, declared)
