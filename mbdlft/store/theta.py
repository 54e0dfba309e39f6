"""Nonlinear functions of a model as items of its group: texts, names and ranges."""

import numpy as np

from mbdlft.base.errors import ArchiveError
from mbdlft.base.formula import parsed
from mbdlft.store.items import Items, floats, integers, texts, words
from mbdlft.system.model import LFTModel
from mbdlft.system.theta import ONE, DeltaThetaModel, ThetaFunction


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
    }


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
    for name, unit, formula, count in zip(names, units, formulas, counts, strict=True):
        part = slice(start, start + count)
        ranges = tuple(zip(low[part].tolist(), high[part].tolist(), strict=True))
        parsed(formula)
        own = (tuple(signals[part]), tuple(arguments[part]))
        found.append(ThetaFunction(name, *own, formula, ranges, unit))
        start += count
    initial = tuple(floats(items, "theta/initial").tolist())
    at_start = tuple(floats(items, "theta/zeta_at_start").tolist())
    has_one = any(signal.name == ONE for signal in linear.inputs)
    return DeltaThetaModel(linear, tuple(found), has_one, initial, at_start)
