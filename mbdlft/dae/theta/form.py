"""From the structure of a DAE to linear relations and nonlinear functions: the Delta-Theta form.

The relations are implicit, linear in [unknown ; known], rational in the parameters. Outputs of the
functions are known signals, their arguments are outputs. Units of both follow from those of the signals.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, StructureError
from mbdlft.base.parameter import to_internal
from mbdlft.base.unit import Signal, dimension_name, parse_unit
from mbdlft.dae.dae import open_unit, unit_of
from mbdlft.dae.index import blocks_of
from mbdlft.dae.newton import singular_part, values_of
from mbdlft.dae.structure import Structure
from mbdlft.dae.text import column_of
from mbdlft.dae.theta.arguments import ONE_KEY, Function, Mixed, number
from mbdlft.dae.theta.separation import Arrange, Separated, Separation
from mbdlft.exact.numbers import decimal
from mbdlft.problem.relations import LinearModel
from mbdlft.problem.sx.constants import is_constant
from mbdlft.system.theta import ONE

_NEGLIGIBLE = 1e-6  # of the largest slope of a function: what may be rounding
_DIGITS = 3  # of slopes that are moved from a function into the linear part


@dataclass(frozen=True, eq=False)
class ThetaForm:
    """Linear relations, and the functions that close them.

    unknown = [rates of the states ; others], known = [states ; inputs ; one ; zeta],
    output = [outputs ; omega].
    """

    relations: LinearModel
    functions: tuple[tuple[str, ca.SX, tuple[int, ...]], ...]  # zeta, its expression, its arguments
    arguments: tuple[tuple[str, ca.SX, ca.SX], ...]  # omega, its symbol, its expression of signals
    zeta: tuple[ca.SX, ...]
    one: ca.SX  # the constant input 1, or nothing (0, 1)
    shifted: tuple[str, ...]  # functions from which a linear part was taken


def theta_form(s: Structure, arrange: Arrange, at: Array) -> ThetaForm:
    """Linear relations and functions of a structure.

    `at` are consistent values of [unknowns ; states ; inputs ; p], where linear parts are taken out of
    functions if the relations do not determine the unknowns without them.
    """
    return _Form(s, arrange, at).form()


class _Form:
    def __init__(self, s: Structure, arrange: Arrange, at: Array) -> None:
        self.s, self.arrange, self.at = s, arrange, at
        dae = s.dae
        if ONE in {q.name for q in s.inputs}:
            raise StructureError(
                f"{s.owner}: an input has the name {ONE!r}, which is that of the constant 1. Rename it."
            )
        for c in dae.conditions:
            if c.kind != "assert":
                raise StructureError(
                    f"{s.owner}, {c.name}: these equations are those of one operating point, where it "
                    "does not change; a Delta-Theta form is for all. Write a formula in its place."
                )
        every = ca.vertcat(s.residual, *(y.expression for y in dae.outputs))
        self.separation = Separation(dae, every, arrange)
        self.internal = self.separation.internal
        self.nominal = np.array([float(to_internal(p, p.nominal)) for p in dae.parameters])
        self.one = ca.SX.sym("one")
        self.zetas: dict[int, ca.SX] = {}  # of functions that are used, with what was moved out
        self.symbols: dict[int, ca.SX] = {}
        self.psi: dict[int, ca.SX] = {}
        self.slopes: dict[int, dict[int, ca.SX]] = {}
        self.uses_one = False

    def form(self) -> ThetaForm:
        outputs = column_of(y.expression for y in self.s.dae.outputs)
        equations = self.separation.equations(self.s, self.s.residual, outputs, self.s.symbols)
        count = len(equations.relations)
        mixed = self._merged([*equations.relations, *equations.outputs])
        residual = self._closed(mixed[:count], equations.unknown)
        output = [self._sx(m) for m in mixed[count:]]
        return self._assembled(residual, output, equations)

    def _merged(self, rows: Sequence[Mixed]) -> list[Mixed]:
        """Functions of the same arguments that occur together only, with numbers for factors, as one."""
        registry = self.separation.registry
        uses = Counter(k for m in rows for k in m.terms)
        uses.update(k for a in registry.arguments for k in a.value.terms)
        merged = []
        for m in rows:
            groups: dict[tuple[int, ...], list[int]] = {}
            for k, factor in m.terms.items():
                if uses[k] == 1 and is_constant(factor):
                    of = registry.functions[k].arguments if self.arrange == "fewest" else ()
                    groups.setdefault(of, []).append(k)
            terms = dict(m.terms)
            for together in groups.values():
                if len(together) > 1:
                    total = ca.SX(0)
                    for k in together:
                        total = total + terms.pop(k) * registry.functions[k].expression
                    terms[registry.function(total, registry.functions[together[0]].hint)] = ca.SX(1)
            merged.append(Mixed(m.linear, m.constant, terms))
        return merged

    def _closed(self, rows: Sequence[Mixed], unknown: ca.SX) -> list[ca.SX]:
        """Relations that determine the unknowns; what they need is moved out of functions."""
        for attempt in range(3):
            self.zetas, self.symbols, self.psi = {}, {}, {}
            residual = [self._sx(m) for m in rows]
            singular = self._singular(ca.jacobian(column_of(residual), unknown))
            if singular is None:
                return residual
            # of the singular rows first, then of all
            self._move([rows[i] for i in (range(len(rows)) if attempt else singular)], unknown)
        raise StructureError(
            f"{self.s.owner}: the linear part does not determine the unknowns, also with the slopes "
            "of the nonlinear functions at the initial point. Give start values where the model is "
            "not singular."
        )

    def _singular(self, jacobian: ca.SX) -> tuple[int, ...] | None:
        """Rows that do not determine the unknowns; of a structural block first."""
        pattern = jacobian.sparsity()
        n = pattern.size1()
        if n and ca.sprank(pattern) < n:
            return tuple(range(n))
        for block in blocks_of(pattern):
            matrix = jacobian[list(block.rows), list(block.columns)]
            # residues do not decide all coefficients
            singular = singular_part(matrix, ca.SX(0, 1), self.internal, lambda: [self.nominal])
            if singular is not None:
                return tuple(block.rows[i] for i in singular.rows)
        return None

    def _move(self, rows: Sequence[Mixed], unknown: ca.SX) -> None:
        """Take the slopes at the initial point out of functions of these rows that act on unknowns."""
        registry = self.separation.registry
        pending = [k for m in rows for k in m.terms]
        seen: set[int] = set()
        while pending:
            k = pending.pop()
            if k in seen:
                continue
            seen.add(k)
            function = registry.functions[k]
            for a in function.arguments:
                pending += list(registry.arguments[a].value.terms)
            if k in self.slopes or not any(
                ca.depends_on(self._psi(a), unknown) for a in function.arguments
            ):
                continue
            self.slopes[k] = self._slopes_of(function)

    def _slopes_of(self, function: Function) -> dict[int, ca.SX]:
        registry = self.separation.registry
        symbols = column_of([registry.arguments[a].symbol for a in function.arguments])
        values = np.array([self._value(a) for a in function.arguments])
        slopes = ca.densify(ca.jacobian(function.expression, symbols)).T
        numbers = values_of([slopes], symbols, values)
        least = _NEGLIGIBLE * np.max(np.abs(numbers), initial=0.0)
        return {
            a: number(decimal(float(f"{x:.{_DIGITS}g}")))
            for a, x in zip(function.arguments, numbers, strict=True)
            if np.isfinite(x) and abs(x) > least
        }

    def _value(self, argument: int) -> float:
        """The value of an argument at the initial point."""
        s, registry = self.s, self.separation.registry
        value = registry.arguments[argument].value
        linear = sum((p.coefficient * p.form for p in value.linear.values()), ca.SX(0))
        linear = linear + (value.constant if value.constant is not None else 0)
        point = np.concatenate([self.at[: s.symbols.numel()], self.nominal])
        free = ca.vertcat(s.symbols, self.internal)
        total, *weights = values_of([linear, *value.terms.values()], free, point)
        for k, weight in zip(value.terms, weights, strict=True):
            f = registry.functions[k]
            symbols = column_of([registry.arguments[a].symbol for a in f.arguments])
            at = np.array([self._value(a) for a in f.arguments])
            total += weight * values_of([f.expression], symbols, at)[0]
        return float(total)

    def _sx(self, value: Mixed) -> ca.SX:
        """A value as an expression linear in signals, one and zeta."""
        linear = sum((term.coefficient * term.form for term in value.linear.values()), ca.SX(0))
        if value.constant is not None:
            self.uses_one = True
            linear = linear + value.constant * self.one
        for k, factor in value.terms.items():
            linear = linear + factor * self._zeta(k)
        return ca.SX(linear)

    def _zeta(self, k: int) -> ca.SX:
        if k not in self.zetas:
            self.symbols[k] = ca.SX.sym(f"zeta{k}")
            moved = sum((x * self._psi(a) for a, x in self.slopes.get(k, {}).items()), ca.SX(0))
            self.zetas[k] = self.symbols[k] + moved
            for a in self.separation.registry.functions[k].arguments:
                self._psi(a)
        return self.zetas[k]

    def _psi(self, a: int) -> ca.SX:
        if a not in self.psi:
            self.psi[a] = self._sx(self.separation.registry.arguments[a].value)
        return self.psi[a]

    def _assembled(self, residual: list[ca.SX], output: list[ca.SX], equations: Separated) -> ThetaForm:
        s, registry = self.s, self.separation.registry
        names = self._names()
        used = sorted({a for k in self.symbols for a in registry.functions[k].arguments} & {*self.psi})
        position = {a: j for j, a in enumerate(used)}
        functions = []
        for k in self.symbols:
            f, moved = registry.functions[k], self.slopes.get(k, {})
            moved_terms = sum((x * registry.arguments[a].symbol for a, x in moved.items()), ca.SX(0))
            expression = f.expression - moved_terms if moved else f.expression
            functions.append((names[k], expression, tuple(position[a] for a in f.arguments)))
        arguments = tuple(
            (name, registry.arguments[a].symbol, self.psi[a])
            for name, a in zip(self._argument_names(used), used, strict=True)
        )
        zeta = tuple(self.symbols.values())
        known = ca.vertcat(s.x, s.u, *([self.one] if self.uses_one else []), *zeta)
        relations = LinearModel(
            residual=column_of(residual),
            output=column_of([*output, *(psi for _, _, psi in arguments)]),
            unknown=equations.unknown,
            known=known,
            p=self.internal,
            parameters=s.dae.parameters,
            derivatives=equations.derivatives,
        )
        return ThetaForm(
            relations,
            tuple(functions),
            arguments,
            zeta,
            self.one if self.uses_one else ca.SX(0, 1),
            tuple(names[k] for k in self.symbols if k in self.slopes),
        )

    def _names(self) -> dict[int, str]:
        """Names of zeta: that of the unknown of the equation where a function occurs first."""
        taken = [q.name for q in self.s.inputs]
        for k in self.symbols:
            base = f"theta.{self.separation.registry.functions[k].hint}"
            numbered = (base if n == 1 else f"{base}.{n}" for n in count(1))
            taken.append(next(name for name in numbered if name not in taken))
        return dict(zip(self.symbols, taken[len(self.s.inputs) :], strict=True))

    def _argument_names(self, used: Sequence[int]) -> list[str]:
        """Names of omega that no output has: of the signals that they are, or their numbers."""
        taken = [y.name for y in self.s.dae.outputs]
        for a in used:
            value, name = self.separation.registry.arguments[a].value, f"omega{a + 1}"
            if set(value.linear) == {ONE_KEY} and value.constant is None and not value.terms:
                form = value.linear[ONE_KEY].form
                name = f"omega.{form.name()}" if form.is_symbolic() else name
            while name in taken:
                name += "_"
            taken.append(name)
        return taken[len(self.s.dae.outputs) :]


def signals_of(s: Structure, form: ThetaForm) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    """Inputs and outputs of the relations of a form.

    The unit of a function, or of an argument, is that of its signal, or what follows from units of
    signals and parameters in SI units; "1" where numbers stand that may carry any unit, and for others.
    """
    zeta, omega = _units(s, form)
    inputs = [Signal(q.name, q.unit) for q in s.inputs]
    inputs += [Signal(ONE, "1")] if form.one.numel() else []
    inputs += [Signal(name, unit) for (name, _, _), unit in zip(form.functions, zeta, strict=True)]
    outputs = [Signal(y.name, y.unit) for y in s.dae.outputs]
    outputs += [Signal(name, unit) for (name, _, _), unit in zip(form.arguments, omega, strict=True)]
    return tuple(inputs), tuple(outputs)


def _units(s: Structure, form: ThetaForm) -> tuple[list[str], list[str]]:
    """Units of zeta and of omega."""
    known: dict[int, str] = {q.symbol.element_hash(): q.unit for q in s.quantities}
    known |= {
        rate.element_hash(): "1" if q.unit == "1" else f"{q.unit}/s"
        for q, rate in zip(s.states, s.rates, strict=True)
    }
    symbols = ca.vertsplit(form.relations.p)
    known |= {
        symbol.element_hash(): "1" if p.is_angle else p.unit
        for p, symbol in zip(s.dae.parameters, symbols, strict=True)
    }
    zeta, omega = ["1"] * len(form.functions), ["1"] * len(form.arguments)
    for _ in range(len(zeta) + 1):  # functions of functions
        before = list(zeta)
        known |= {z.element_hash(): unit for z, unit in zip(form.zeta, zeta, strict=True)}
        omega = [_unit(psi, known) for _, _, psi in form.arguments]
        dimensions = {
            symbol.element_hash(): unit
            for (_, symbol, _), unit in zip(form.arguments, omega, strict=True)
        }
        zeta = [_unit(expression, dimensions) for _, expression, _ in form.functions]
        if zeta == before:
            break
    return zeta, omega


def _unit(expression: ca.SX, known: Mapping[int, str]) -> str:
    """The unit of an expression; "1" where nothing follows."""
    if expression.is_symbolic():
        return known.get(expression.element_hash(), "1")
    used = {x.element_hash(): known.get(x.element_hash(), "1") for x in ca.symvar(expression)}
    if any(parse_unit(unit).factor != 1.0 for unit in used.values()):
        return "1"
    try:
        measure = unit_of(expression, {key: open_unit(unit) for key, unit in used.items()})
    except SceneError:  # the slope of a function was moved out of it as a number
        return "1"
    return dimension_name(measure.exponents) if measure.exponents else "1"
