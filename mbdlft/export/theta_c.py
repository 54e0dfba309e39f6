"""C99 of a Delta-Theta form: parameters, states and inputs to derivatives and outputs, Theta inside."""

from collections.abc import Sequence
from string import Template

import numpy as np

from mbdlft.export.c import c_table, c_texts
from mbdlft.export.formulas import Body, C, Language, bodies_of
from mbdlft.export.names import identifier
from mbdlft.export.theta_c_text import DECLARATION, EVALUATION, SOURCE
from mbdlft.export.theta_parts import listed, places_of
from mbdlft.system.theta import DeltaThetaModel, Table


def theta_c_texts(model: DeltaThetaModel, stem: str) -> tuple[str, str]:
    """The source and the header; the source includes ``stem.h``.

    Raises
    ------
    StructureError
        As `c_texts`; or the model has no functions.
    """
    places = places_of(model, "C")
    source, header = c_texts(model.linear, stem)
    linear = model.linear
    n = len(linear.states)
    height, width = n + len(linear.outputs), n + len(linear.inputs)
    entries = {
        "name": identifier(model.name),
        "np": len(linear.parameters),
        "nx": n,
        "nu": len(places.u),
        "ny": len(places.y),
        "nz": len(places.zeta),
        "no": len(places.omega),
        "height": height,
        "width": width,
        "one": f"value[row * {width} + {n + places.one[0]}]" if places.one else "0.0",
        "functions": listed(model, " *   "),
    }
    tables = [table for f in model.functions for table in f.tables]
    numbers = {
        "range_low": (places.low, "double"),
        "range_high": (places.high, "double"),
        "omega_row": ([n + k for k in places.omega], "size_t"),
        "zeta_column": ([n + k for k in places.zeta], "size_t"),
        "u_column": ([n + k for k in places.u] or [0], "size_t"),
    }
    arrays = [
        c_table(f"static const {kind} {name}", np.array(values))
        for name, (values, kind) in numbers.items()
    ]
    for k, table in enumerate(tables):
        arrays += _points(k, table)
    name = entries["name"]
    start = [
        c_table(f"const double {name}_{key}", np.array([*values, 0.0]))
        for key, values in (("initial", model.initial), ("zeta_at_start", model.zeta_at_start))
    ]
    start += [
        f"static const size_t count_x = {n}, count_u = {len(places.u)}, count_y = {len(places.y)};"
    ]
    behind = Template(SOURCE).substitute(tables="\n".join(arrays), start="\n".join(start))
    behind = behind if tables else "\n".join(["", *arrays, *start, ""])
    header = header.replace(_MARK, Template(DECLARATION).substitute(entries) + _MARK, 1)
    return "\n".join(
        [source, behind, _theta(model), Template(EVALUATION).substitute(entries)]
    ), header


_MARK = "\n#ifdef __cplusplus\n}"


def _points(k: int, table: Table) -> list[str]:
    """Arrays of a table."""
    found = [
        c_table(f"static const double table{k}_b", np.array(table.breakpoints)),
        c_table(f"static const double table{k}_v", np.array(table.values)),
        c_table(f"static const double table{k}_ends", np.array([table.below, table.above])),
    ]
    if table.slopes:
        found.append(c_table(f"static const double table{k}_inner", np.array(table.slopes)))
    return found


def _theta(model: DeltaThetaModel) -> str:
    """The function of all values and slopes."""
    tables = [table for f in model.functions for table in f.tables]

    def look_up(number: int, argument: str, is_slope: bool) -> str:  # noqa: FBT001
        inner = f"table{number}_inner" if tables[number].slopes else "NULL"
        points = f"table{number}_b, table{number}_v, table{number}_ends, {inner}"
        return f"table_value({points}, {len(tables[number].values)}, {argument}, {int(is_slope)})"

    count = len(model.omega)
    lines = ["static void theta(const double *omega, double *zeta, double *slopes)", "{"]
    lines += [
        "    size_t k;",
        f"    for (k = 0; slopes != NULL && k < {len(model.functions) * count}; k++) {{",
    ]
    lines += ["        slopes[k] = 0.0;", "    }"]
    language = Language(C, lambda k: f"omega[{k}]", look_up)
    for row, (own, body) in enumerate(bodies_of(model, language)):
        lines += _block(body, row, count, own)
    return "\n".join([*lines, "}"]) + "\n"


def _block(body: Body, row: int, count: int, own: Sequence[int]) -> list[str]:
    lines = ["    {"]
    lines += [f"        const double {name} = {text};" for name, text in body.statements]
    lines.append(f"        zeta[{row}] = {body.value};")
    lines.append("        if (slopes != NULL) {")
    for j, slope in zip(own, body.slopes, strict=True):
        lines.append(f"            slopes[{row * count + j}] += {slope};")
    return [*lines, "        }", "    }"]
