"""The fold over SX tapes: the instructions of a CasADi function, followed in any number system.

A number system is one table of rules (`Rules`): how it makes an element of a constant, and what each
operation makes of elements. Rules are found by the names of CasADi's operations, `casadi.OP_ADD` is
"add". An operation without a rule is refused by name.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca

from mbdlft.base.errors import NotRationalError

_NAMES = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}

Rule = Callable[..., Any]


class Rules(NamedTuple):
    """A number system."""

    constant: Rule  # makes an element of a float
    operations: Mapping[str, Rule]  # by the names of operations, functions of elements
    # what an operation without a rule gives, or raises: it gets the name of the operation, a text
    # that tells its place, too, and the elements
    missing: Rule


def refused(operation: str, where: str, *operands: Any) -> Any:
    """Raise a NotRationalError for an operation without a rule; `Rules.missing` by default."""
    raise NotRationalError(
        f"{where} has no rule in this number system. Write the function with + - * /, integer powers "
        "up to 100, sqrt, sin, cos and tan."
    )


def rules(
    constant: Rule, *, add: Rule, mul: Rule, div: Rule, missing: Rule = refused, **others: Rule
) -> Rules:
    """The table of a number system; rules of -a, a - b, 2a, a^2, 1/a follow where not given."""
    neg: Rule = others.get("neg") or (lambda a: mul(constant(-1.0), a))
    follow: dict[str, Rule] = {
        "assign": lambda a: a,
        "neg": neg,
        "sub": lambda a, b: add(a, neg(b)),
        "twice": lambda a: mul(constant(2.0), a),
        "sq": lambda a: mul(a, a),
        "inv": lambda a: div(constant(1.0), a),
    }
    return Rules(constant, {**follow, "add": add, "mul": mul, "div": div, **others}, missing)


def arithmetic(number: Rule, functions: Mapping[str, Rule]) -> Rules:
    """The table of a number system that has + - * / with floats.

    `number` makes one of a float; `functions` are others, such as "sqrt". Constants stay floats, of
    which results are made before anything is done with floats alone, so that rounding is counted.
    """

    def counted(rule: Rule) -> Rule:
        return lambda *x: rule(*(map(number, x) if all(isinstance(a, float) for a in x) else x))

    operations: dict[str, Rule] = {"neg": operator.neg}
    operations |= {"tan": lambda a: functions["sin"](a) / functions["cos"](a), **functions}
    operations |= {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}
    return rules(float, **{name: counted(rule) for name, rule in operations.items()})


@lru_cache(maxsize=8)  # few are folded more than once, but those again and again
def steps(function: ca.Function) -> tuple[tuple[str, Any, Sequence[Any]], ...]:
    """The instructions of a function of SX: operation, register of the result, registers of operands.

    An "input" has the numbers of an argument and its entry for operands, a "const" its value; the target
    of an "output" are the numbers of a result and its entry.
    """
    instructions = []
    for k in range(function.n_instructions()):
        operation, targets = _NAMES[function.instruction_id(k)], function.instruction_output(k)
        sources: Any = function.instruction_input(k)
        if operation == "const":
            sources = [float(function.instruction_constant(k))]
        instructions.append((operation, targets if operation == "output" else targets[0], sources))
    return tuple(instructions)


def fold(function: ca.Function, table: Rules, *arguments: Any) -> list[list[Any]]:
    """Results of a function of SX in a number system, a list of elements for each.

    Elements stand by columns, those of results without structural zeros; arguments are sequences, or
    arrays whose rows are elements. An operation without a rule raises what the table says, by default a
    NotRationalError.
    """
    work: list[Any] = [None] * function.sz_w()
    results: list[list[Any]] = [[None] * function.nnz_out(k) for k in range(function.n_out())]
    constant, operations = table.constant, table.operations
    for k, (operation, target, sources) in enumerate(steps(function)):
        if operation == "input":
            argument, entry = sources
            work[target] = arguments[argument][entry]
        elif operation == "const":
            work[target] = constant(sources[0])
        elif operation == "output":
            result, entry = target
            results[result][entry] = work[sources[0]]
        elif (rule := operations.get(operation)) is None:
            where = f"OP_{operation.upper()} at instruction {k} of {function.name()!r}"
            work[target] = table.missing(operation, where, *(work[source] for source in sources))
        elif len(sources) == 1:
            work[target] = rule(work[sources[0]])
        else:
            work[target] = rule(work[sources[0]], work[sources[1]])
    return results
