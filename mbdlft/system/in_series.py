"""Systems in series: one after the other, or a block at channels of a model (an actuator, a sensor).

at inputs:   u_i = K(s, delta) u'           at outputs:   y' = K(s, delta) y_i
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.system.algebra import chain
from mbdlft.system.conversion import as_system
from mbdlft.system.evidence import Operation, check_exact, composed
from mbdlft.system.system import System
from mbdlft.system.wiring import Wiring, plain_wiring


def series(model: Any, channels: Any, *blocks: Any, side: str | None = None) -> Any:
    """Systems one after the other, y = ... K2 K1 u; or the model with a block at some of its channels.

    ``series(a, b, ...)`` connects all outputs of each system with all inputs of the next, in their order,
    as in python-control: it is ``... * b * a``. ``series(model, "name", block)``, with one or more names,
    gives the model with u = K u' at these inputs, or y' = K y at these outputs, K the block.

    Parameters
    ----------
    model : System, python-control system, number or matrix
    channels : str or sequence of str, or the second system
        Inputs, or outputs, of the model: those that the outputs, or inputs, of the block are connected
        to, in their order.
    blocks : the block, or systems behind the second
        Such as of `low_pass`, or of python-control. Parameters of equal names must be equal, and are the
        same.
    side : str
        ``"inputs"`` or ``"outputs"``; needed where names are those of both.

    Returns
    -------
    System, or LFTModel where all with parameters are
        A block with as many outputs as inputs leaves the names of the signals as they are; the signals of
        another take the place of the first of the channels. States of a block are named ``CHANNEL.STATE``
        with the first channel. The repetitions are reduced and the lower bounds computed again; the trim
        is that of the model.

    Raises
    ------
    StructureError
        The model or the block is truncated; a channel is unknown, named twice or on both sides; the
        block has another size, is not continuous or not a system; a parameter of it has the name of
        another one of the model.
    """
    is_names = isinstance(channels, str) or (
        isinstance(channels, list | tuple) and all(isinstance(name, str) for name in channels)
    )
    if not is_names:
        return chain([model, channels, *blocks])
    if len(blocks) != 1:
        raise StructureError(
            f"series: expected one block for the channels {channels!r}, got {len(blocks)}."
        )
    return _at_channels(
        as_system(model), (channels,) if isinstance(channels, str) else channels, blocks[0], side
    )


def _at_channels(model: System, names: Sequence[str], item: Any, side: str | None) -> System:
    check_exact(model, "series")
    at_inputs = _side(model, names, side)
    try:
        block = as_system(item)
    except StructureError as error:
        raise StructureError(f"model {model.name!r}, series, block: {error}") from None
    check_exact(block, "series")
    what, connected = ("outputs", block.outputs) if at_inputs else ("inputs", block.inputs)
    if len(connected) != len(names):
        raise StructureError(
            f"model {model.name!r}, series: the block has {len(connected)} {what} for the "
            f"{len(names)} channels {', '.join(names)}."
        )
    signals, own = (model.inputs, block.inputs) if at_inputs else (model.outputs, block.outputs)
    positions = [[s.name for s in signals].index(name) for name in names]
    order = _order(len(signals), positions, len(own))
    square = len(own) == len(names)
    entries = (*signals, *((signals[k] for k in positions) if square else own))
    listed = tuple(entries[k] for k in order)
    return composed(
        (model, block),
        _wiring(model, block, positions, order, at_inputs=at_inputs),
        listed if at_inputs else model.inputs,
        model.outputs if at_inputs else listed,
        Operation(
            "series", {"channels": list(names), "side": "inputs" if at_inputs else "outputs"}
        ),
        states=(*model.states, *_states(model, names[0], block)),
    )


def _order(count: int, positions: Sequence[int], own: int) -> list[int]:
    """The new signals: old ones by position, those of the block from `count` on."""
    order: list[int] = []
    for k in range(count):
        if k not in positions:
            order.append(k)
        elif own == len(positions):
            order.append(count + positions.index(k))
        elif k == positions[0]:
            order += range(count, count + own)
    return order


def _wiring(
    model: System, block: System, positions: Sequence[int], order: Sequence[int], *, at_inputs: bool
) -> Wiring:
    nu, ny, n = len(model.inputs), len(model.outputs), len(positions)
    if at_inputs:
        wiring = plain_wiring((model, block), len(order), ny)
        wiring.E[order, range(len(order))] = 1.0
        wiring.Ky[positions, range(ny, ny + n)] = 1.0
        wiring.F[:, :ny] = np.eye(ny)
    else:
        wiring = plain_wiring((model, block), nu, len(order))
        wiring.E[:nu] = np.eye(nu)
        wiring.Ky[range(nu, nu + n), positions] = 1.0
        wiring.F[range(len(order)), order] = 1.0
    return wiring


def _side(model: System, names: Sequence[str], side: str | None) -> bool:
    """Whether the channels are inputs."""
    what = f"model {model.name!r}, series"
    if side not in (None, "inputs", "outputs"):
        raise StructureError(f"{what}: " + unknown_name("side", str(side), ("inputs", "outputs")))
    if not names or len(set(names)) < len(names):
        raise StructureError(
            f"{what}: channels: expected one or more names, each once, got {list(names)}."
        )
    known = {
        "inputs": [signal.name for signal in model.inputs],
        "outputs": [signal.name for signal in model.outputs],
    }
    fits = [key for key in known if side in (None, key) and set(names) <= set(known[key])]
    if not fits:
        searched = [name for key in known if side in (None, key) for name in known[key]]
        missing = [name for name in names if name not in searched]
        if not missing:
            raise StructureError(
                f"{what}: {', '.join(names)} are inputs and outputs; one block stands on one side."
            )
        raise StructureError(f"{what}: " + unknown_name("channel", missing[0], searched))
    if len(fits) > 1:
        raise StructureError(
            f"{what}: {', '.join(names)} are names of inputs and of outputs. Say side = 'inputs' or "
            "'outputs'."
        )
    return fits[0] == "inputs"


def _states(model: System, channel: str, block: System) -> tuple[Signal, ...]:
    """States of the block, numbered on where another block stands in the same channel."""
    used = {signal.name for signal in model.states}
    prefix, k = channel, 1
    while any(f"{prefix}.{state.name}" in used for state in block.states):
        k += 1
        prefix = f"{channel}.{k}"
    return tuple(Signal(f"{prefix}.{state.name}", state.unit) for state in block.states)
