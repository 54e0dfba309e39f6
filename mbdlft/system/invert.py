"""Inversion of channels: inputs and outputs of one place exchange their roles.

For the channels i, the others o, and [y_i ; y_o] = G [u_i ; u_o],

    [u_i ; y_o] = [G_ii^-1 , -G_ii^-1 G_io ; G_oi G_ii^-1 , G_oo - G_oi G_ii^-1 G_io] [y_i ; u_o]

made in the LFT of [A B ; C D], where G_ii is D_ii: no channel of Delta is added. The McMillan degree in
each delta is that of the graph of the map, which an exchange of coordinates does not change, so lower
bounds stay.
"""

from collections.abc import Sequence
from typing import TypeVar, cast

import numpy as np

from mbdlft.base.errors import StructureError, WellPosednessError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.system.evidence import Operation, check_exact, composed
from mbdlft.system.system import System
from mbdlft.system.wiring import Wiring, plain_wiring

S = TypeVar("S", bound=System)


def invert_channels(model: S, channels: Sequence[str]) -> S:
    """The model with the inputs and outputs of some channels exchanged: u_i = G_ii^-1 (y_i - G_io u_o).

    Parameters
    ----------
    model : System or LFTModel
    channels : sequence of str
        Each is the part of signal names before the first dot, such as the port ``tip`` of a `two_port`;
        or it is an input such as ``tip.torque.z``. The k-th input of a channel is exchanged with
        its k-th output: a load with the acceleration where it acts.

    Returns
    -------
    System, or LFTModel if the model is one
        With as many repetitions as `model`, the same lower bounds, and the same states. Inverted twice it
        is the model again. Its `max_relative_error` is what that of the model makes of the inverse, and
        the error of the inversion itself.

    Raises
    ------
    StructureError
        A channel is unknown or named twice, or has not as many inputs as outputs; or the model is
        truncated.
    WellPosednessError
        What is to be inverted, the feed-through from these inputs to these outputs, is singular at
        nominal or somewhere in the range.
    """
    check_exact(model, "inversion")
    pairs = _pairs(model, channels)
    inputs, outputs = list(model.inputs), list(model.outputs)
    for given, output in pairs:
        inputs[given], outputs[output] = outputs[output], inputs[given]
    operation = Operation(f"inversion of {', '.join(channels)}")
    try:
        made = composed(
            [model], _exchanged(model, pairs), inputs, outputs, operation, exchange=True
        )
    except WellPosednessError as error:
        if "at nominal" not in str(error):
            raise
        raise WellPosednessError(
            f"model {model.name!r}, {operation.name}: the feed-through from its inputs to its outputs is "
            "singular at nominal. A load is exchanged with the acceleration where it acts, and only "
            "where something with mass moves."
        ) from None
    return cast(S, made)


def _exchanged(model: System, pairs: Sequence[tuple[int, int]]) -> Wiring:
    """Wiring of one part in which y_i is given and u_i is read."""
    wiring = plain_wiring([model], len(model.inputs), len(model.outputs))
    wiring.E[:], wiring.F[:] = np.eye(len(model.inputs)), np.eye(len(model.outputs))
    for given, output in pairs:
        wiring.Ku[given, given], wiring.Ky[given, output], wiring.E[given, given] = 0.0, 1.0, -1.0
        wiring.F[output, output], wiring.G[output, given] = 0.0, 1.0
    return wiring


def _pairs(model: System, channels: Sequence[str]) -> list[tuple[int, int]]:
    """Positions of the inputs and outputs to be exchanged."""
    if isinstance(channels, str):
        raise StructureError(
            f"model {model.name!r}: channels: expected a list of names, got {channels!r}."
        )
    if not channels:
        raise StructureError(f"model {model.name!r}: channels: name at least one.")
    known = {_channel(signal) for signal in model.inputs} | {s.name for s in model.inputs}
    found: list[tuple[int, int]] = []
    for name in channels:
        if name not in known:
            raise StructureError(
                f"model {model.name!r}: " + unknown_name("channel", str(name), known)
            )
        whole = name.partition(".")[0]
        inputs, outputs = (
            [k for k, signal in enumerate(signals) if _channel(signal) == whole]
            for signals in (model.inputs, model.outputs)
        )
        if len(inputs) != len(outputs):
            raise StructureError(
                f"model {model.name!r}: channel {whole!r} has {len(inputs)} inputs and {len(outputs)} "
                "outputs; only as many of the one as of the other can be exchanged. Choose the signals "
                "of the model so that each input has its output."
            )
        pairs = list(zip(inputs, outputs, strict=True))
        found += [p for p in pairs if name in (whole, model.inputs[p[0]].name)]
    if len(set(found)) < len(found):
        raise StructureError(
            f"model {model.name!r}: a channel is named twice in {', '.join(channels)}."
        )
    return found


def _channel(signal: Signal) -> str:
    return signal.name.partition(".")[0]
