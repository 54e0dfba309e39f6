"""Blocks of parameters: normalized to another range, or opened as gains to be tuned.

Inside the old range of a parameter, delta is normalized again, exactly. The old delta is a bilinear
function of the new one,

    delta_old = c + g delta / (1 + a delta)

so w = delta_old z is w = c z + w', w' = delta (g z - a w'): as many repetitions, and no new ones.

A block that is opened, w_k = delta_k I_r z_k with -1 <= delta_k <= 1, leaves the model: z_k and w_k
become outputs and inputs of a plant, which is the model again once the gain delta_k I_r closes it. A
synthesis tool for structured controllers then tunes delta_k as one gain repeated r times.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import StructureError, check_known
from mbdlft.base.parameter import Parameter, to_delta, to_physical
from mbdlft.base.unit import Signal
from mbdlft.exact.rounding import through
from mbdlft.lft.lft import LFT, as_plain, of_kinds, open_blocks
from mbdlft.system.evidence import check_exact, opened_evidence, renormalized_evidence
from mbdlft.system.model import OUTSIDE, LFTModel, Parameters, System

S = TypeVar("S", bound=System)


class Change(NamedTuple):
    """delta_old = c + g delta / (1 + a delta)."""

    c: float
    g: float
    a: float


def with_ranges(model: S, ranges: Mapping[str, Sequence[float]]) -> S:
    """`System.with_range`, with ranges (low, high) or (low, nominal, high) by name.

    The certificate has the bounds of the old one, and the error checked anew inside the range.
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
        from_w = np.vstack([a.M11, a.M21]) * c
        to_z = np.hstack([a.M11, a.M12])
        total, _ = through(base, from_w, np.eye(n) - a.M11 * c, to_z, "another nominal value")
        shifted = LFT(total[:n, :n], total[:n, n:], total[n:, :n], total[n:, n:], a.blocks)
    M11 = g[:, None] * shifted.M11 - np.diag(bend)
    return replace(shifted, M11=M11, M12=g[:, None] * shifted.M12)


def _ranged(model: System, name: str, ends: Sequence[float]) -> Parameter:
    where = f"model {model.name!r}, with_range"
    check_known("parameter", [name], model.parameters.names, where, StructureError)
    old = model.parameters[name]
    if np.ndim(ends) != 1 or len(ends) not in (2, 3):
        raise StructureError(
            f"{where}: {name}: expected (low, high) or (low, nominal, high), got {ends!r}."
        )
    low, high = float(ends[0]), float(ends[-1])
    slack = OUTSIDE * (old.high - old.low)
    if low < old.low - slack or high > old.high + slack:
        raise StructureError(
            f"{where}: {name}: [{low:g}, {high:g}] reaches beyond [{old.low:g}, {old.high:g}] "
            f"{old.unit}, and outside of it nothing was checked. Build the model again with the wider "
            "range; the text of its scene or matrix is model.provenance.scene."
        )
    nominal = old.nominal if low < old.nominal < high else 0.5 * (low + high)
    nominal = float(ends[1]) if len(ends) == 3 else nominal
    return replace(old, nominal=nominal, low=max(low, old.low), high=min(high, old.high))


def _change(old: Parameter, new: Parameter) -> Change:
    """Between the deltas of two ranges of one parameter: both are bilinear in its internal value."""
    low, middle, high = (float(d) for d in to_delta(old, [new.low, new.nominal, new.high]))
    middle = 0.0 if new.nominal == old.nominal else middle
    # delta_old - c = g delta / (1 + a delta) at delta = -1 and 1
    below, above = middle - low, high - middle
    return Change(middle, 2.0 * below * above / (below + above), (below - above) / (below + above))


@dataclass(frozen=True, slots=True)
class TunableGain:
    """A real gain delta [1], repeated, between `bounds` and zero at nominal.

    Attributes
    ----------
    name : str, that of the parameter
    repetitions : int
    bounds : (-1, 1)
    inputs, outputs : names of the signals of the plant that it closes, w = delta z
    parameter : the map: `physical` of a gain, in the unit of the parameter
    """

    name: str
    repetitions: int
    bounds: tuple[float, float]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameter: Parameter

    def physical(self, gain: float) -> float:
        """Value of the parameter, in its unit, for a gain [1]."""
        return float(to_physical(self.parameter, gain))


@dataclass(frozen=True, slots=True)
class TunablePlant(Generic[S]):
    """A plant and the gains that close it."""

    plant: S
    gains: tuple[TunableGain, ...]


@arguments_checked
def tunable(model: S, names: Sequence[str] | None = None) -> TunablePlant[S]:
    """The plant with parameters taken out as gains to be tuned: w_k = delta_k z_k.

    Parameters
    ----------
    model : System or LFTModel
    names : sequence of str
        Parameters; by default those with the role ``design``.

    Returns
    -------
    TunablePlant
        `plant` has the inputs of the model and then ``NAME.w.1`` ... of each parameter, its outputs and
        then ``NAME.z.1`` ..., and the other parameters. Where the trim depends on what was taken out, the
        plant has no LFT of it: ask the model. Lower bounds of the others stay.
    """
    check_exact(model, "tunable")
    where = f"model {model.name!r}"
    known = model.parameters.names
    if names is None:
        names = [p.name for p in model.parameters if p.role == "design"]
        if not names:
            raise StructureError(
                f"{where}: no parameter has the role 'design'. Name the parameters to be "
                f"tuned: {', '.join(known) or 'it has none'}."
            )
    if isinstance(names, str):
        raise StructureError(f"{where}: names: expected a list, got {names!r}.")
    check_known("parameter", names, known, where, StructureError)
    if len(set(names)) < len(names):
        raise StructureError(f"{where}: a parameter is named twice in {', '.join(names)}.")
    sizes = {block.name: block.size for block in model.lft.blocks}
    gains = tuple(
        TunableGain(
            name=name,
            repetitions=sizes[name],
            bounds=(-1.0, 1.0),
            inputs=tuple(f"{name}.w.{k}" for k in range(1, sizes[name] + 1)),
            outputs=tuple(f"{name}.z.{k}" for k in range(1, sizes[name] + 1)),
            parameter=model.parameters[name],
        )
        for name in names
    )
    used = {signal.name for signal in (*model.inputs, *model.outputs)}
    if taken := [n for gain in gains for n in (*gain.inputs, *gain.outputs) if n in used]:
        raise StructureError(f"{where}: it has a signal {taken[0]!r} already. Rename the parameter.")
    kept = tuple(p for p in model.parameters if p.name not in names)
    plant = replace(
        model,
        lft=open_blocks(model.lft, names),
        inputs=(*model.inputs, *(Signal(name, "1") for gain in gains for name in gain.inputs)),
        outputs=(*model.outputs, *(Signal(name, "1") for gain in gains for name in gain.outputs)),
        parameters=Parameters(kept),
        **(opened_evidence(model, names) if isinstance(model, LFTModel) else {}),
    )
    return TunablePlant(plant, gains)
