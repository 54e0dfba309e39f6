"""Another range of a parameter, inside the old one: delta is normalized again, exactly.

The old delta is a bilinear function of the new one,

    delta_old = c + g delta / (1 + a delta)

so w = delta_old z is w = c z + w', w' = delta (g z - a w'): as many repetitions, and no new ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.parameter import Parameter, to_delta
from mbdlft.exact.rounding import through
from mbdlft.lft.lft import LFT, as_plain, of_kinds
from mbdlft.system.evidence import renormalized_evidence
from mbdlft.system.model import LFTModel
from mbdlft.system.system import Parameters, System

S = TypeVar("S", bound=System)
_OUTSIDE = 1e-9  # of the width of a range: what rounding may leave a value outside


class Change(NamedTuple):
    """delta_old = c + g delta / (1 + a delta)."""

    c: float
    g: float
    a: float


def with_ranges(model: S, ranges: Mapping[str, Sequence[float]]) -> S:
    """The model with other ranges of parameters inside the old ones: the same at each physical value.

    Parameters
    ----------
    model : System or LFTModel
    ranges : mapping of names to (low, high) or (low, nominal, high), in the units of the parameters
        Without a nominal value the old one stays if it lies inside, and else the middle is taken.

    Returns
    -------
    System, or LFTModel if the model is one
        With as many repetitions, the same bounds of them, and the error checked anew inside the range.

    Raises
    ------
    StructureError
        A name is unknown, or a range reaches beyond the old one: there nothing was checked, and an
        equilibrium may not exist. Build the model again with the wider range.
    SceneError
        The range is not usable.
    """
    changed = {name: _ranged(model, name, ends) for name, ends in ranges.items()}
    parameters = Parameters(changed.get(p.name, p) for p in model.parameters)
    changes = {name: _change(model.parameters[name], p) for name, p in changed.items()}
    lft = renormalized(model.lft, changes)
    fields: dict[str, Any] = {"lft": lft, "parameters": parameters}
    if isinstance(model, LFTModel):
        trim = model.trim
        if trim.lft is not None:
            held = renormalized(trim.lft, changes)
            moved = any(change.c for change in changes.values())
            nominal = tuple(map(float, held.M22[:, 0])) if moved else trim.nominal
            trim = replace(trim, lft=held, nominal=nominal)
        elif trim.signals and any(change.c for change in changes.values()):
            raise StructureError(
                f"model {model.name!r}: the trim at another nominal value is not known, as its LFT was "
                "not stored. Give ranges that have the old nominal values."
            )
        fields |= {"trim": trim, "certificate": renormalized_evidence(model, lft, parameters)}
    return replace(model, **fields)


def renormalized(a: LFT, changes: Mapping[str, Change]) -> LFT:
    """The LFT in other deltas: delta_old = c + g delta / (1 + a delta), by name."""

    def spread(kind: str) -> Any:
        default = Change(0.0, 1.0, 0.0)
        numbers = [getattr(changes.get(block.name, default), kind) for block in a.blocks]
        return np.repeat(numbers, [block.inputs for block in a.blocks])

    if not all(block.kind == "real" for block in a.blocks):
        plain, full = as_plain(a)
        return of_kinds(renormalized(plain, changes), full, a)
    c, g, bend = spread("c"), spread("g"), spread("a")
    shifted = a
    if c.any():
        n = a.order
        base = np.block([[a.M11, a.M12], [a.M21, a.M22]])
        left = np.vstack([a.M11, a.M21]) * c
        right = np.hstack([a.M11, a.M12])
        total, _ = through(base, left, np.eye(n) - a.M11 * c, right, "another nominal value")
        shifted = LFT(total[:n, :n], total[:n, n:], total[n:, :n], total[n:, n:], a.blocks)
    M11 = g[:, None] * shifted.M11 - np.diag(bend)
    return replace(shifted, M11=M11, M12=g[:, None] * shifted.M12)


def _ranged(model: System, name: str, ends: Sequence[float]) -> Parameter:
    where = f"model {model.name!r}, with_range"
    if name not in model.parameters.names:
        raise StructureError(f"{where}: " + unknown_name("parameter", name, model.parameters.names))
    old = model.parameters[name]
    if np.ndim(ends) != 1 or len(ends) not in (2, 3):
        raise StructureError(
            f"{where}: {name}: expected (low, high) or (low, nominal, high), got {ends!r}."
        )
    low, high = float(ends[0]), float(ends[-1])
    slack = _OUTSIDE * (old.high - old.low)
    if low < old.low - slack or high > old.high + slack:
        raise StructureError(
            f"{where}: {name}: [{low:g}, {high:g}] reaches beyond [{old.low:g}, {old.high:g}] "
            f"{old.unit}, and outside of it nothing was checked. Build the model again with the wider "
            "range; the text of its scene or matrix is model.provenance.scene."
        )
    if len(ends) == 3:
        nominal = float(ends[1])
    else:
        nominal = old.nominal if low < old.nominal < high else 0.5 * (low + high)
    return Parameter(
        name,
        nominal,
        max(low, old.low),
        min(high, old.high),
        unit=old.unit,
        role=old.role,
        substitution=old.substitution,
        reference=old.reference,
    )


def _change(old: Parameter, new: Parameter) -> Change:
    """Between the deltas of two ranges of one parameter: both are bilinear in its internal value."""
    low, middle, high = (float(d) for d in to_delta(old, [new.low, new.nominal, new.high]))
    if new.nominal == old.nominal:
        middle = 0.0
    # delta_old - c = g delta / (1 + a delta) at delta = -1 and 1
    left, right = middle - low, high - middle
    return Change(middle, 2.0 * left * right / (left + right), (left - right) / (left + right))
