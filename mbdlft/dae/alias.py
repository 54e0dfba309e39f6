"""Alias elimination: x = y, x = -y and x = number are taken out of the equations.

What is left is a model of fewer variables; each variable that is gone is a factor times one that stayed,
an input, or a number.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple, cast

import casadi as ca

from mbdlft.base.errors import StructureError
from mbdlft.dae.dae import Dae, Equation, Variable
from mbdlft.dae.text import column_of
from mbdlft.exact.numbers import constant_of
from mbdlft.problem.sx.constants import constants_in, is_constant, literal


class Alias(NamedTuple):
    """A variable that is `factor` times another one or an input, or a number (`of` is None)."""

    name: str
    of: str | None
    factor: Fraction

    def __str__(self) -> str:
        if self.of is None:
            return f"{self.name} = {float(self.factor):g}"
        return f"{self.name} = {'-' if self.factor < 0 else ''}{self.of}"


def eliminate_aliases(dae: Dae) -> tuple[Dae, tuple[Alias, ...]]:
    """The model without equations of the form x = y, x = -y, x = number, and what they say.

    Of two variables the one stays that is fixed, has a derivative, has a start value, is an output's.
    What becomes such an equation, as a variable in it is zero, is taken out, too.
    """
    aliases: tuple[Alias, ...] = ()
    relations: dict[Equation, _Relation | None] = {}
    while True:
        classes = _Classes(dae)
        relations = _relations(dae, relations)
        kept = [
            equation
            for equation, relation in relations.items()
            if relation is None or not classes.join(equation, relation)
        ]
        new = classes.aliases()
        if not new:
            return dae, aliases
        gone = {a.name: a for a in new}
        aliases = (*(_through(a, gone) for a in aliases), *new)
        dae = _substituted(dae, kept, gone)


def _through(alias: Alias, gone: Mapping[str, Alias]) -> Alias:
    """An alias of what is itself one now."""
    if alias.of is None or alias.of not in gone:
        return alias
    above = gone[alias.of]
    return Alias(alias.name, above.of, alias.factor * above.factor)


class _Relation(NamedTuple):
    """0 = sum of factor times signal + offset, of one or two signals, by name."""

    terms: tuple[tuple[str, Fraction], ...]
    offset: Fraction


def _relations(dae: Dae, known: Mapping[Equation, _Relation | None]) -> dict[Equation, _Relation | None]:
    """What each equation says if it is that of an alias; those that have not changed are `known`."""
    signals = column_of(v.symbol for v in (*dae.variables, *dae.inputs))
    names = [v.name for v in (*dae.variables, *dae.inputs)]
    fresh = [e for e in dae.equations if e not in known]
    residuals = column_of(e.residual for e in fresh)
    pattern = ca.jacobian_sparsity(residuals, ca.vertcat(signals, dae.xdot, dae.p)).T
    starts, columns = pattern.colind(), pattern.row()
    used = [columns[a:b] for a, b in pairwise(starts)]
    some = [k for k, of in enumerate(used) if len(of) in (1, 2) and max(of) < len(names)]
    residuals = residuals[some]
    slopes = ca.jacobian(residuals, signals).T  # by equations
    offsets = ca.vertsplit(ca.substitute(residuals, signals, ca.SX.zeros(len(names))))
    found: dict[Equation, _Relation | None] = dict.fromkeys(fresh)
    for row, (k, (a, b)) in enumerate(zip(some, pairwise(slopes.colind()), strict=True)):
        entries = {j: slopes.nz[n] for n, j in zip(range(a, b), slopes.row()[a:b], strict=True)}
        terms = [(names[j], entries.get(j, ca.SX(0))) for j in used[k]]
        found[fresh[k]] = _relation(terms, offsets[row])
    return {e: known[e] if e in known else found[e] for e in dae.equations}


def _relation(terms: Sequence[tuple[str, ca.SX]], offset: ca.SX) -> _Relation | None:
    factors, value = [rational(slope) for _, slope in terms], rational(offset)
    if value is None or any(f is None or not f for f in factors):
        return None
    known = [f for f in factors if f is not None]
    if len(known) == 2 and (value or abs(known[0]) != abs(known[1])):
        return None
    return _Relation(tuple((name, f) for (name, _), f in zip(terms, known, strict=True)), value)


def rational(expression: ca.SX) -> Fraction | None:
    """The value of an expression of plain numbers and rational constants, of one operation at most."""
    expression = ca.SX(expression)
    if expression.nnz() == 0:
        return Fraction(0)
    if expression.is_constant():
        value = float(expression)
        return constant_of(value) if abs(value) < float("inf") else None
    if not is_constant(expression):
        return None
    sign = 1
    if expression.op() == ca.OP_NEG:
        sign, expression = -1, expression.dep(0)
    if not expression.is_symbolic():
        return None
    (number,) = constants_in(expression)[1]
    return sign * number.argument if number.kind == "rational" else None


class _Classes:
    """Variables that are factors +-1 of each other, or numbers: a forest with factors."""

    def __init__(self, dae: Dae) -> None:
        self.dae = dae
        self.parent: dict[str, tuple[str | None, Fraction]] = {}
        shown = {y.expression.element_hash() for y in dae.outputs if y.expression.is_symbolic()}
        self.rank = {}  # of two variables, the one of the higher rank stays
        for k, v in enumerate(dae.variables):
            known = (v.fixed, v.derivative is not None, v.start is not None)
            self.rank[v.name] = (*known, v.symbol.element_hash() in shown, -k)
        self.inputs = {v.name for v in dae.inputs}

    def root(self, name: str) -> tuple[str | None, Fraction]:
        """What a signal is a factor of; None for the number 1."""
        factor, at = Fraction(1), cast("str | None", name)
        while at is not None and at in self.parent:
            at, f = self.parent[at]
            factor *= f
        return at, factor

    def join(self, equation: Equation, relation: _Relation) -> bool:
        """Whether the equation is one of aliases, which are known from now on."""
        total: dict[str | None, Fraction] = {None: relation.offset}
        for name, factor in relation.terms:
            root, times = self.root(name)
            total[root] = total.get(root, Fraction(0)) + factor * times
        offset = total.pop(None)
        factors = {name: factor for name, factor in total.items() if name and factor}
        if not factors:
            does = "contradicts" if offset else "says"
            names = ", ".join(name for name, _ in relation.terms)
            raise StructureError(
                f"{self.dae.owner}: equation {equation.place} {does} what others say already of {names}: "
                "the model is singular. Remove one of these equations."
            )
        free = [name for name in factors if name not in self.inputs]
        if not free or (len(factors) == 2 and offset):
            return False
        last = min(free, key=lambda name: self.rank[name])
        if len(factors) == 1:
            self.parent[last] = (None, -offset / factors[last])
            return True
        (other,) = (name for name in factors if name != last)
        self.parent[last] = (other, -factors[other] / factors[last])
        return True

    def aliases(self) -> tuple[Alias, ...]:
        return tuple(
            Alias(v.name, *self.root(v.name)) for v in self.dae.variables if v.name in self.parent
        )


def _substituted(dae: Dae, kept: Sequence[Equation], gone: Mapping[str, Alias]) -> Dae:
    stays = {v.name: v for v in dae.variables if v.name not in gone}
    inputs = {v.name: v for v in dae.inputs}
    old, new = [], []
    for v in (v for v in dae.variables if v.name in gone):
        _, of, factor = gone[v.name]
        times = ca.SX(literal(factor))
        target = ca.SX(1) if of is None else (stays.get(of) or inputs[of]).symbol
        old.append(v.symbol)
        new.append(times if of is None else target if factor == 1 else times * target)
        if of in stays:
            stays[of] = _merged(stays[of], v, factor)
        if v.derivative is not None and of in inputs:
            raise StructureError(
                f"{dae.owner}: {v.name} is the input {of}, and its derivative is needed. Make "
                f"der({of}) an input, and {of} a variable."
            )
        if v.derivative is not None:
            rate = ca.SX(0) if of is None else stays[of].derivative
            assert rate is not None  # as `_merged` has made it
            old.append(v.derivative)
            new.append(rate if of is None or factor == 1 else times * rate)
    expressions = [*(e.residual for e in kept), *(e.residual for e in dae.initial)]
    expressions += [y.expression for y in dae.outputs]
    expressions += [c.expression for c in dae.conditions]
    column, symbols = column_of(expressions), column_of(old)
    changed = {*ca.jacobian_sparsity(column, symbols).row()}
    after = ca.vertsplit(ca.substitute(column, symbols, column_of(new)))
    others = iter(after[len(kept) :])
    return replace(
        dae,
        variables=tuple(stays.values()),
        equations=tuple(replace(e, residual=after[k]) if k in changed else e for k, e in enumerate(kept)),
        initial=tuple(replace(e, residual=next(others)) for e in dae.initial),
        outputs=tuple(replace(y, expression=next(others)) for y in dae.outputs),
        conditions=tuple(replace(c, expression=next(others)) for c in dae.conditions),
    )


def _merged(stays: Variable, gone: Variable, factor: Fraction) -> Variable:
    """The variable that stays, with what is known of its alias."""
    if gone.derivative is not None and stays.derivative is None:
        stays = replace(stays, derivative=ca.SX.sym(f"der({stays.name})"))
    is_held = gone.fixed and not stays.fixed
    if gone.start is not None and (stays.start is None or is_held):
        of = None if gone.start_of is None else literal(factor) * gone.start_of
        start = float(factor) * gone.start
        stays = replace(stays, start=start, start_of=of, fixed=stays.fixed or gone.fixed)
    ends = sorted(float(factor) * end for end in (gone.minimum, gone.maximum))
    return replace(stays, minimum=max(stays.minimum, ends[0]), maximum=min(stays.maximum, ends[1]))
