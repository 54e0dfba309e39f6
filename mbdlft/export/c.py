"""C99 without dependency: physical parameters to A, B, C, D and the trim, for embedded gain schedules."""

import math
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance

from mbdlft.base.errors import StructureError
from mbdlft.base.parameter import DIVISORS, Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.export.c_text import (
    DELTAS,
    HEADER,
    LOOP,
    MATRICES,
    NO_DELTAS,
    SOURCE,
    TABLES,
    TRIM,
    TRIM_DECLARATION,
)
from mbdlft.export.matlab import table_of
from mbdlft.export.names import check_plain_model, identifier, identifiers, one_line
from mbdlft.lft.lft import LFT
from mbdlft.system.model import LFTModel, System

_NUMBERS_IN_A_LINE = 4


def c_texts(model: System, stem: str) -> tuple[str, str]:
    """The source and the header of a model; the source includes ``stem.h``.

    Raises
    ------
    StructureError
        The model has complex or full blocks or complex entries, two names become the same, or the name
        of the file cannot be included.
    """
    check_plain_model(model, "C")
    if any(letter in '"\\' or not letter.isprintable() for letter in stem):
        raise StructureError(
            f"{stem!r}.c: C cannot include a header of this name. Choose another name of the file."
        )
    names = identifiers(model.parameters.names, f"model {model.name!r}: C")
    name = identifier(model.name)
    shown = {key: f"{name}_p_{text}" for key, text in names.items()}
    trim = model.trim.lft if isinstance(model, LFTModel) and model.trim.signals else None
    entries = {
        "name": name,
        "stem": stem,
        "model": one_line(model.name),
        "table": "\n".join(table_of(model, " *   ", shown)),
        "guard": f"MBDLFT_{name}_H",
        "np": len(model.parameters),
        "nx": len(model.states),
        "nu": len(model.inputs),
        "ny": len(model.outputs),
        "nt": 0 if trim is None else trim.shape[0],
        "indices": "".join(f"    {shown[p.name]},\n" for p in model.parameters),
        "stack": max(_stack(lft) for lft in (model.lft, trim) if lft is not None),
    }
    header = Template(HEADER).substitute(
        entries,
        trim="" if trim is None else Template(TRIM_DECLARATION).substitute(entries),
        tables=Template(TABLES).substitute(entries) if model.parameters else "",
    )
    closes = any(_used(lft) for lft in (model.lft, trim) if lft is not None)
    parts = [Template(SOURCE).substitute(entries)]
    if model.parameters:
        parts.append(_parameter_tables(model.parameters, name))
    template = DELTAS if model.parameters else NO_DELTAS
    parts.append(Template(template).substitute(entries))
    parts += [LOOP] if closes else []
    parts.append(_value(model.lft, "matrices_of"))
    parts += [] if trim is None else [_value(trim, "trim_of")]
    parts.append(Template(MATRICES).substitute(entries))
    parts += [] if trim is None else [Template(TRIM).substitute(entries)]
    return "\n".join(parts), header


def _used(lft: LFT) -> bool:
    """Whether the value depends on a delta."""
    return bool(lft.order and lft.M21.any() and lft.M12.any())


def _stack(lft: LFT) -> int:
    """Bytes of arrays that one call needs."""
    numbers = lft.M22.size + len(lft.blocks)
    if _used(lft):
        numbers += lft.order * (lft.order + 6)
    return 8 * numbers


def _parameter_tables(parameters: tuple[Parameter, ...], name: str) -> str:
    """The public ranges, and the constants of the maps."""
    lines = []
    for field in ("low", "nominal", "high"):
        numbers = np.array([getattr(p, field) for p in parameters])
        lines.append(c_table(f"const double {name}_{field}", numbers))
    maps = {
        "divisor": [DIVISORS[p.substitution] if p.is_angle else 0.0 for p in parameters],
        "factor": [parse_unit(p.unit).factor if p.is_angle else 1.0 for p in parameters],
        "reference": [p.reference for p in parameters],
        "b0": [p.map.b0 for p in parameters],
        "gain": [p.map.gain for p in parameters],
        "a1": [p.map.a1 for p in parameters],
    }
    lines.append("\n/* internal = value, or tan((value * factor - reference) / divisor);")
    lines.append("   internal = b0 + gain delta / (1 + a1 delta) */")
    lines += [c_table(f"static const double {key}", np.array(v)) for key, v in maps.items()]
    return "\n".join(lines) + "\n"


def _sides(lft: LFT) -> tuple[NDArray[Any], ...]:
    """Inner, first and last matrix, and the places of rows and columns of the result in the value.

    Only rows and columns that depend on a delta are there, from the thinner side: the right one, or the
    left one transposed. Channels get units, powers of two, with which their couplings are of one size.
    """
    rows, columns = np.flatnonzero(lft.M21.any(axis=1)), np.flatnonzero(lft.M12.any(axis=0))
    inner, first, last = lft.M11, lft.M12[:, columns], lft.M21[rows]
    _, (units, _) = matrix_balance(inner, permute=False, separate=True)
    balanced = inner * units / units[:, None], first / units[:, None], last * units
    if all(np.all(np.isfinite(matrix)) for matrix in balanced):
        inner, first, last = balanced
    rows = rows * lft.shape[1]
    if len(rows) < len(columns):
        return inner.T, last.T, first.T, columns, rows
    return inner, first, last, rows, columns


def _value(lft: LFT, function: str) -> str:
    """A function from deltas to the value of an LFT, row by row; a status if it is singular."""
    begin = function.partition("_")[0]
    size, n = lft.M22.size, lft.order
    tables, body = [], ["    (void)value;\n"]
    if size:
        tables = [c_table(f"static const double {begin}_M22", lft.M22)]
        body = ["    size_t k;\n", f"    for (k = 0; k < {size}; k++) {{\n"]
        body += [f"        value[k] = {begin}_M22[k];\n", "    }\n"]
    if not _used(lft):
        body += ["    (void)delta;\n", "    return 0;\n"]
    else:
        inner, first, last, rows, columns = _sides(lft)
        block = np.repeat(np.arange(len(lft.blocks)), [b.size for b in lft.blocks])
        for name, numbers in (("inner", inner), ("first", first), ("last", last)):
            tables.append(c_table(f"static const double {begin}_{name}", numbers))
        for name, numbers in (("block", block), ("row", rows), ("column", columns)):
            tables.append(c_table(f"static const size_t {begin}_{name}", numbers))
        m = len(columns)
        body.insert(0, f"    double d[{n}], work[{n * (n + 4)}];\n    size_t pivot[{n}];\n")
        body.append(
            f"    for (k = 0; k < {n}; k++) {{\n        d[k] = delta[{begin}_block[k]];\n    }}\n"
            f"    return close_loop({n}, {len(rows)}, {m}, {begin}_inner, {begin}_first, {begin}_last,\n"
            f"        {begin}_row, {begin}_column, d, work, pivot, value);\n"
        )
    start = f"static int {function}(const double *delta, double *value)\n{{\n"
    return "\n".join(tables) + f"\n\n{start}{''.join(body)}}}\n"


def c_table(declaration: str, numbers: NDArray[Any]) -> str:
    """The definition of an array, doubles in 17 digits."""
    whole = np.asarray(numbers).dtype.kind == "i"
    texts = [str(int(x)) if whole else _number(float(x)) for x in np.ravel(numbers)]
    lines = [
        ", ".join(texts[k : k + _NUMBERS_IN_A_LINE])
        for k in range(0, len(texts), _NUMBERS_IN_A_LINE)
    ]
    body = ",\n    ".join(lines)
    return f"{declaration}[{len(texts)}] = {{\n    {body}\n}};"


def _number(x: float) -> str:
    """A double in 17 digits, which are read back as the same double."""
    if math.isinf(x):
        return "HUGE_VAL" if x > 0 else "-HUGE_VAL"
    text = f"{x:.17g}"
    return text if "." in text or "e" in text else f"{text}.0"
