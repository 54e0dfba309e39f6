"""Parameters as gains to be tuned: their Delta blocks leave the model and become part of a controller.

    w_k = delta_k I_r z_k,   -1 <= delta_k <= 1

z_k and w_k become outputs and inputs of the plant; closed with the gain delta_k I_r the plant is the
model again. A synthesis tool for structured controllers then tunes delta_k as one gain repeated r times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.parameter import Parameter, to_physical
from mbdlft.base.signal import Signal
from mbdlft.lft.lft import open_blocks
from mbdlft.system.evidence import check_exact, opened_evidence
from mbdlft.system.model import LFTModel
from mbdlft.system.system import Parameters, System

S = TypeVar("S", bound=System)


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

    Raises
    ------
    StructureError
        The model is truncated, a parameter is unknown or named twice, none has the role ``design``, or
        a signal has the name of a new one.
    """
    check_exact(model, "tunable")
    chosen = _chosen(model, names)
    parts = model.lft.slices()
    gains = tuple(
        TunableGain(
            name=name,
            repetitions=parts[name].stop - parts[name].start,
            bounds=(-1.0, 1.0),
            inputs=_names(name, "w", parts[name]),
            outputs=_names(name, "z", parts[name]),
            parameter=next(p for p in model.parameters if p.name == name),
        )
        for name in chosen
    )
    _check_free(model, gains)
    left = tuple(p for p in model.parameters if p.name not in chosen)
    plant = replace(
        model,
        lft=open_blocks(model.lft, chosen),
        inputs=(*model.inputs, *(Signal(name, "1") for gain in gains for name in gain.inputs)),
        outputs=(*model.outputs, *(Signal(name, "1") for gain in gains for name in gain.outputs)),
        parameters=Parameters(left),
        **(opened_evidence(model, chosen) if isinstance(model, LFTModel) else {}),
    )
    return TunablePlant(plant, gains)


def _chosen(model: System, names: Sequence[str] | None) -> list[str]:
    known = [p.name for p in model.parameters]
    if names is None:
        names = [p.name for p in model.parameters if p.role == "design"]
        if not names:
            raise StructureError(
                f"model {model.name!r}: no parameter has the role 'design'. Name the parameters to be "
                f"tuned: {', '.join(known) or 'it has none'}."
            )
    if isinstance(names, str):
        raise StructureError(f"model {model.name!r}: names: expected a list, got {names!r}.")
    for name in names:
        if name not in known:
            raise StructureError(f"model {model.name!r}: " + unknown_name("parameter", name, known))
    if len(set(names)) < len(names):
        raise StructureError(
            f"model {model.name!r}: a parameter is named twice in {', '.join(names)}."
        )
    return list(names)


def _names(name: str, kind: str, part: slice) -> tuple[str, ...]:
    return tuple(f"{name}.{kind}.{k}" for k in range(1, part.stop - part.start + 1))


def _check_free(model: System, gains: Sequence[TunableGain]) -> None:
    used = {signal.name for signal in (*model.inputs, *model.outputs)}
    taken = [n for gain in gains for n in (*gain.inputs, *gain.outputs) if n in used]
    if taken:
        raise StructureError(
            f"model {model.name!r}: it has a signal {taken[0]!r} already. Rename the parameter."
        )
