"""Nonlinear functions of a model as items of its group: texts, names and ranges."""

import numpy as np

from mbdlft.archive.items import Items, floats, integers, texts, words
from mbdlft.base.errors import ArchiveError, StructureError
from mbdlft.base.formula import parsed
from mbdlft.system.model import LFTModel
from mbdlft.system.theta import ONE, DeltaThetaModel, Table, ThetaFunction


def items_of_theta(model: DeltaThetaModel) -> Items:
    """The items of the functions; arguments of all of them stand one behind the other."""
    functions = model.functions
    flat = [
        (signal, argument, low, high)
        for f in functions
        for signal, argument, (low, high) in zip(f.signals, f.arguments, f.ranges, strict=True)
    ]
    return {
        "theta/name": texts([f.name for f in functions]),
        "theta/unit": texts([f.unit for f in functions]),
        "theta/text": texts([f.text for f in functions]),
        "theta/count": np.array([len(f.signals) for f in functions], dtype="<i8"),
        "theta/signal": texts([signal for signal, _, _, _ in flat]),
        "theta/argument": texts([argument for _, argument, _, _ in flat]),
        "theta/low": np.array([low for _, _, low, _ in flat], dtype="<f8"),
        "theta/high": np.array([high for _, _, _, high in flat], dtype="<f8"),
        "theta/initial": np.array(model.initial, dtype="<f8"),
        "theta/zeta_at_start": np.array(model.zeta_at_start, dtype="<f8"),
        **_items_of_tables(functions),
    }


def _items_of_tables(functions: tuple[ThetaFunction, ...]) -> Items:
    """Tables of all functions, one behind the other; without any there are no items."""
    tables = [table for f in functions for table in f.tables]
    if not tables:
        return {}
    slopes = [pair for table in tables for pair in table.slopes]
    return {
        "theta/tables": np.array([len(f.tables) for f in functions], dtype="<i8"),
        "theta/table/count": np.array([len(t.values) for t in tables], dtype="<i8"),
        "theta/table/pairs": np.array([len(t.slopes) for t in tables], dtype="<i8"),
        "theta/table/breakpoint": np.array([x for t in tables for x in t.breakpoints], dtype="<f8"),
        "theta/table/value": np.array([x for t in tables for x in t.values], dtype="<f8"),
        "theta/table/below": np.array([t.below for t in tables], dtype="<f8"),
        "theta/table/above": np.array([t.above for t in tables], dtype="<f8"),
        "theta/table/slope": np.array(slopes, dtype="<f8").reshape(-1, 2),
    }


def _tables_of_items(items: Items, functions: int) -> list[tuple[Table, ...]]:
    """The tables of each function.

    Raises
    ------
    ArchiveError
        Counts do not agree, or numbers are those of no table.
    """
    if "theta/tables" not in items:
        return [()] * functions
    breakpoints, values, below, above = (
        floats(items, f"theta/table/{key}").tolist()
        for key in ("breakpoint", "value", "below", "above")
    )
    counts, pairs, owned = (
        integers(items, f"theta/{key}") for key in ("table/count", "table/pairs", "tables")
    )
    slopes = [(float(a), float(b)) for a, b in floats(items, "theta/table/slope")]
    for key, numbers, total in (
        ("tables", owned, len(counts)),
        ("table/count", counts, len(breakpoints)),
        ("table/pairs", pairs, len(slopes)),
    ):
        if any(n < 0 for n in numbers) or sum(numbers) != total:
            raise ArchiveError(f"theta/{key}: expected {total} together.")
    found, point, pair = [], 0, 0
    for k, (n, m) in enumerate(zip(counts, pairs, strict=True)):
        at, of = (tuple(x[point : point + n]) for x in (breakpoints, values))
        try:
            found.append(Table(at, of, below[k], above[k], tuple(slopes[pair : pair + m])))
        except StructureError as error:
            raise ArchiveError(f"theta/table: number {k + 1}: {error}") from None
        point, pair = point + n, pair + m
    behind = np.cumsum(owned).tolist()
    return [tuple(found[b - n : b]) for n, b in zip(owned, behind, strict=True)]


def theta_of_items(items: Items, linear: LFTModel) -> DeltaThetaModel:
    """The model with its functions.

    Raises
    ------
    ArchiveError
        Counts do not agree, a name stands twice, a range is empty.
    SceneError, StructureError
        A text is no formula, a signal is not one of the model.
    """
    names, units, formulas = (words(items, f"theta/{key}") for key in ("name", "unit", "text"))
    signals, arguments = words(items, "theta/signal"), words(items, "theta/argument")
    low, high = floats(items, "theta/low"), floats(items, "theta/high")
    counts = integers(items, "theta/count")
    if any(count < 1 for count in counts) or sum(counts) != len(signals):
        raise ArchiveError(f"theta/count: expected {len(signals)} together, as many as arguments.")
    if len(set(names)) != len(names):
        raise ArchiveError("theta/name: a name stands twice.")
    if not np.all(low < high):
        raise ArchiveError("theta/low: expected less than theta/high.")
    found, start = [], 0
    tables = _tables_of_items(items, len(names))
    rows = zip(names, units, formulas, counts, tables, strict=True)
    for name, unit, formula, count, own_tables in rows:
        part = slice(start, start + count)
        ranges = tuple(zip(low[part].tolist(), high[part].tolist(), strict=True))
        parsed(formula)
        own = (tuple(signals[part]), tuple(arguments[part]))
        found.append(ThetaFunction(name, *own, formula, ranges, unit, own_tables))
        start += count
    initial = tuple(floats(items, "theta/initial").tolist())
    at_start = tuple(floats(items, "theta/zeta_at_start").tolist())
    has_one = any(signal.name == ONE for signal in linear.inputs)
    return DeltaThetaModel(linear, tuple(found), has_one, initial, at_start)
