"""C99 without dependency: physical parameters to A, B, C, D and the trim; and Julia, which calls it.

CasADi's code generator writes the functions of numbers: the value of an LFT, Theta and its slopes, a step
of Newton's method. The texts here put the promises of the header around them: ranges, a status, nothing
written unless it is valid. With Delta from physical values and channels in units s,

    X = (I - M11 Delta)^-1,   value = M22 + M21 Delta (X M12 + X (M12 - (I - M11 Delta) X M12))

where the second term improves the solution once; the condition number |I - M11 Delta| |X| in the 1-norm
says whether the model is singular to working precision.

The script of Julia reads an archive. It compiles and calls the C for nonlinear functions only.
"""

import json
import re
from collections.abc import Sequence
from textwrap import fill, indent
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import matrix_balance

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.base.formula import formula_value
from mbdlft.base.parameter import DIVISORS, Parameter
from mbdlft.dae.text import SYMBOLIC
from mbdlft.export.matlab import table_of
from mbdlft.export.names import (
    check_plain_model,
    filled,
    identifiers,
    listed,
    one_line,
    places_of,
    prefix,
)
from mbdlft.lft.lft import LFT
from mbdlft.system.model import LFTModel, Parameters, System
from mbdlft.system.theta import DeltaThetaModel, Table, ThetaFunction, named_tables


def c_texts(model: System | DeltaThetaModel, stem: str) -> tuple[str, str]:
    """The source and the header of a model; the source includes ``stem.h``."""
    linear = model.linear if isinstance(model, DeltaThetaModel) else model
    check_plain_model(linear, "C")
    if any(letter in '"\\' or not letter.isprintable() for letter in stem):
        raise StructureError(
            f"{stem!r}.c: C cannot include a header of this name. Choose another name of the file."
        )
    names = identifiers(linear.parameters.names, f"model {linear.name!r}: C")
    name = prefix(linear.name)
    shown = {key: f"{name}_p_{text}" for key, text in names.items()}
    trim = linear.trim.lft if isinstance(linear, LFTModel) and linear.trim.signals else None
    functions = [value_function(f"{name}_f_value", linear.parameters, linear.lft)]
    entries: dict[str, Any] = {
        "name": name,
        "stem": stem,
        "model": one_line(linear.name),
        "table": "\n".join(table_of(linear, " *   ", shown)),
        "indices": "".join(f"    {shown[p.name]},\n" for p in linear.parameters),
        "np": len(linear.parameters),
        "nx": len(linear.states),
        "nu": len(linear.inputs),
        "ny": len(linear.outputs),
        "nt": 0 if trim is None else trim.shape[0],
        "size": linear.lft.M22.size + 1,
        "theta": isinstance(model, DeltaThetaModel),
    }
    tables = [
        _table(f"const double {name}_{field}", [getattr(p, field) for p in linear.parameters])
        for field in (("low", "nominal", "high") if linear.parameters else ())
    ]
    if trim is not None:
        functions.append(value_function(f"{name}_f_trim", linear.parameters, trim))
    if isinstance(model, DeltaThetaModel):
        more, theta_tables, theta_entries = _theta(name, model)
        functions, tables, entries = (functions + more, tables + theta_tables, entries | theta_entries)
    work = max(f.sz_w() for f in functions) + 1
    entries |= {
        "work": work,
        "stack": 8 * (work + entries["size"]),
        "arguments": max(f.sz_arg() for f in functions),
        "results": max(f.sz_res() for f in functions),
        "integers": max(f.sz_iw() for f in functions) + 1,
        "generated": _generated(functions, name),
        "tables": "\n".join(tables),
    }
    return filled("model.c", entries), filled("model.h", entries)


def value_function(name: str, parameters: Parameters, lft: LFT) -> ca.Function:
    """Physical values -> the value of an LFT, row by row, and a condition number in the 1-norm."""
    values = ca.MX.sym("values", len(parameters))
    value, condition = ca.MX(ca.DM(lft.M22)), ca.MX(0.0)
    if lft.order and lft.M21.any() and lft.M12.any():
        inner, first, last = map(ca.sparsify, map(ca.DM, _balanced(lft)))
        owners = [parameters.names.index(b.name) for b in lft.blocks for _ in range(b.size)]
        spread = ca.diag(_deltas(parameters)(values)[owners])
        loop = ca.DM.eye(lft.order) - inner @ spread
        inverse = ca.solve(loop, ca.DM.eye(lft.order), "qr")
        solution = inverse @ first
        solution += inverse @ (first - loop @ solution)
        value += last @ (spread @ solution)
        condition = ca.mmax(ca.sum1(ca.fabs(loop))) * ca.mmax(ca.sum1(ca.fabs(inverse)))
    return ca.Function(name, [values], [ca.densify(value).T, condition])


def _deltas(parameters: Sequence[Parameter]) -> ca.Function:
    """Physical values -> normalized deltas."""
    values, deltas = ca.SX.sym("values", len(parameters)), ca.SX(len(parameters), 1)
    for k, p in enumerate(parameters):
        internal = values[k]
        if p.is_angle:
            internal = ca.tan((internal * p.factor - p.reference) / DIVISORS[p.substitution])
        distance = internal - p.map.b0
        deltas[k] = distance / (p.map.gain - p.map.a1 * distance)
    return ca.Function("deltas", [values], [deltas])


def _balanced(lft: LFT) -> tuple[Array, Array, Array]:
    """M11, M12, M21 in units of the channels, powers of two, with which couplings are of one size."""
    _, (units, _) = matrix_balance(lft.M11, permute=False, separate=True)
    balanced = (lft.M11 * units / units[:, None], lft.M12 / units[:, None], lft.M21 * units)
    if all(np.all(np.isfinite(matrix)) for matrix in balanced):
        return balanced
    return lft.M11, lft.M12, lft.M21


def _generated(functions: Sequence[ca.Function], name: str) -> str:
    """The text that CasADi generates, without a warning about arguments that are not used."""
    generator = ca.CodeGenerator(f"{name}_c.c", {"casadi_int": "int", "with_header": False})
    for function in functions:
        generator.add(function)
    text: str = generator.dump()
    used = "(void)arg; (void)res; (void)iw; (void)w; "
    text = re.sub(r"(casadi_real\* w, )int mem\) ?\{", rf"\1int mem) {{\n  {used}(void)mem;", text)
    return re.sub(r"(\w+_release\()int mem\) ?\{", r"\1int mem) {\n  (void)mem;", text)


def _table(declaration: str, numbers: Sequence[float]) -> str:
    """The definition of an array of doubles in 17 digits, which are read back as the same doubles."""
    texts = [f"{x:.17g}".replace("inf", "HUGE_VAL") for x in map(float, numbers)]
    texts = [text if set(text) & set(".eH") else f"{text}.0" for text in texts]
    body = indent(fill(", ".join(texts), 100, break_on_hyphens=False), "    ")
    return f"{declaration}[{len(texts)}] = {{\n{body}\n}};"


def _theta(name: str, model: DeltaThetaModel) -> tuple[list[ca.Function], list[str], dict[str, Any]]:
    """Functions, tables and entries of Theta.

    The functions: Theta and its slopes; a step of Newton's method for its values; derivatives and
    outputs. The last two are of the value of the linear part, states, inputs u and zeta.
    """
    places, linear, n = places_of(model, "C"), model.linear, len(model.linear.states)
    count = len(places.zeta)
    omega = ca.MX.sym("omega", len(places.omega))
    by_name = dict(zip(model.omega, ca.vertsplit(omega), strict=True))
    values = ca.vertcat(*(_value(f, [by_name[s] for s in f.signals]) for f in model.functions))
    slopes = ca.densify(ca.jacobian(values, omega))
    theta = ca.Function(f"{name}_f_theta", [omega], [values, slopes.T])
    value = ca.MX.sym("value", *linear.lft.shape[::-1])
    x, u, zeta = (ca.MX.sym(s, k) for s, k in (("x", n), ("u", len(places.u)), ("zeta", count)))
    columns = [*range(n), *(n + k for k in (*places.u, *places.one))]
    signals = ca.vertcat(x, u, *([1.0] if places.one else []))

    def read(rows: Sequence[int]) -> tuple[ca.MX, ca.MX]:
        """What known signals give in rows of [A B ; C D], and the entries that zeta meets there."""
        return value.T[rows, columns] @ signals, value.T[rows, [n + k for k in places.zeta]]

    known, through = read([n + k for k in places.omega])
    at = known + through @ zeta
    values, slopes = theta(at)
    slopes = slopes.T
    terms = ca.fabs(known) + ca.fabs(through) @ ca.fabs(zeta)
    terms = ca.fabs(zeta) + ca.fabs(values) + ca.fabs(slopes) @ terms
    step = ca.solve(ca.DM.eye(count) - slopes @ through, values - zeta, "qr")
    outcome = [a + b @ zeta for a, b in (read([*range(n)]), read([n + k for k in places.y]))]
    functions = [
        theta,
        ca.Function(f"{name}_f_newton", [value, x, u, zeta], [values - zeta, terms, step, at]),
        ca.Function(f"{name}_f_rates", [value, x, u, zeta], outcome),
    ]
    tables = [
        _table(f"const double {name}_initial", [*model.initial, 0.0]),
        _table(f"const double {name}_zeta_at_start", [*model.zeta_at_start, 0.0]),
        _table("static const double range_low", places.low),
        _table("static const double range_high", places.high),
    ]
    entries = {"free": len(places.u), "read": len(places.y), "nz": count, "no": len(places.omega)}
    return functions, tables, {**entries, "functions": listed(model, " *   ")}


def _value(f: ThetaFunction, arguments: Sequence[ca.MX]) -> ca.MX:
    """A function of Theta; a table stays one."""
    tables = {key: _looked_up(table) for key, table in named_tables(f.tables).items()}
    known = dict(zip(f.arguments, arguments, strict=True))
    return ca.MX(formula_value(f.text, known, {**SYMBOLIC, **tables}))


def _looked_up(table: Table) -> Any:
    """A table as a function of MX: the piece of an argument is found by bisection."""
    b, v = np.array(table.breakpoints), np.array(table.values)
    h, rise = np.diff(b), np.diff(v)
    start, end = np.array(table.slopes).T if table.slopes else (rise / h, rise / h)

    def value(a: ca.MX) -> ca.MX:
        k = ca.low(ca.MX(ca.DM(b)), a)
        H, R, S, E, B, V = (ca.MX(ca.DM(column))[k] for column in (h, rise, start, end, b[:-1], v[:-1]))
        t = (a - B) / H
        inside = V + t * R
        if table.slopes:
            inside += t * (1 - t) * ((1 - t) * (H * S - R) - t * (H * E - R))
        inside = ca.if_else(a < b[0], v[0] + table.below * (a - b[0]), inside)
        return ca.if_else(a > b[-1], v[-1] + table.above * (a - b[-1]), inside)

    return value


def julia_text(model: System | DeltaThetaModel, stem: str, archive: str) -> str:
    """The script of a model; `archive` is the path of its archive from the folder of the script."""
    linear = model.linear if isinstance(model, DeltaThetaModel) else model
    check_plain_model(linear, "the Julia script")
    shown = {name: _literal(name) for name in linear.parameters.names}
    entries = {
        "stem": one_line(stem),
        "table": "\n".join(table_of(linear, "#     ", shown)),
        "archive": _literal(archive),
        "model": _literal(linear.name),
        "theta": isinstance(model, DeltaThetaModel),
    }
    if isinstance(model, DeltaThetaModel):
        places, parameters = places_of(model, "the Julia script"), linear.parameters
        entries |= {
            "name": prefix(model.name),
            "source": _literal(f"{stem}.c"),
            "functions": listed(model, "#     "),
            "initial": _vector(model.initial),
            "start": _vector(model.zeta_at_start),
            "names": ", ".join(map(_literal, parameters.names)),
            "nz": len(places.zeta),
            "no": len(places.omega),
            "nx": len(linear.states),
            "ny": len(places.y),
        }
        for key in ("low", "nominal", "high"):
            entries[key] = _vector([getattr(p, key) for p in parameters])
    return filled("model.jl", entries)


def _vector(values: Sequence[float]) -> str:
    return f"Float64[{', '.join(repr(float(x)) for x in values)}]"


def _literal(text: str) -> str:
    """A string of Julia; a dollar sign begins an expression there."""
    return json.dumps(text, ensure_ascii=False).replace("$", "\\$")
