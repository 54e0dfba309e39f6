"""Interconnection by the names of signals: networks, series at some channels, inversion of channels.

network:     input = sum of (signed) outputs of systems and of inputs of the whole
series:      u_i = K(s, delta) u' at inputs, y' = K(s, delta) y_i at outputs
inversion:   inputs and outputs of one place exchange their roles

For the inverted channels i, the others o, and [y_i ; y_o] = G [u_i ; u_o],

    [u_i ; y_o] = [G_ii^-1 , -G_ii^-1 G_io ; G_oi G_ii^-1 , G_oo - G_oi G_ii^-1 G_io] [y_i ; u_o]

is made in the LFT of [A B ; C D], where G_ii is D_ii: no channel of Delta is added. The McMillan degree
in each delta is that of the graph of the map, which an exchange of coordinates does not change, so lower
bounds stay.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import StructureError, WellPosednessError, check_known, unknown_name
from mbdlft.base.unit import Signal
from mbdlft.system.algebra import chain
from mbdlft.system.conversion import as_system, check_once, operand
from mbdlft.system.evidence import Operation, check_exact, composed, linked
from mbdlft.system.model import System
from mbdlft.system.wiring import Wiring, plain_wiring


@arguments_checked
def connect(
    systems: Sequence[Any],
    connections: Sequence[Sequence[str]] | Mapping[str, str | Sequence[str]] | None = None,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    name: str | None = None,
) -> System:
    """Systems wired by the names of their signals.

    Parameters
    ----------
    systems : sequence of System or python-control systems
    connections : sequence of sequences of str, or mapping of str to str or sequence of str, optional
        ``["controller.e", "r", "-plant.y"]`` or ``{"controller.e": ["r", "-plant.y"]}``: an input of
        a system, then the outputs, or inputs of the whole, that add up to it; ``-`` takes one away. A
        signal is called by its name, or, where several systems have it, by ``SYSTEM.NAME``. Not given:
        inputs get the outputs of the same name.
    inputs : sequence of str
        Inputs of the whole: inputs of systems (all of that name), to which they are added, or new names
        that stand in `connections`.
    outputs : sequence of str
        Outputs of the whole: outputs of systems, or inputs of systems, which are what adds up there.
    name : str, optional
        That of the first system by default.

    Returns
    -------
    System, or LFTModel where all systems with parameters are
        The states are those of the systems, in their order.

    Raises
    ------
    WellPosednessError
        A loop is singular at nominal or in the range.
    """
    members = [operand(system, f"connect: systems[{k}]") for k, system in enumerate(systems)]
    if not members:
        raise StructureError("connect: expected one system or more.")
    for asked, what in ((inputs, "inputs"), (outputs, "outputs")):
        if isinstance(asked, str):
            raise StructureError(f"connect, {what}: expected a list of names, got {asked!r}.")
        check_once(list(asked), f"connect, {what}")
    into, out_of = (
        [(system.name, signal) for system in members for signal in getattr(system, side)]
        for side in ("inputs", "outputs")
    )
    wiring = plain_wiring(members, len(inputs), len(outputs))
    pairs = pairs_of(connections)
    _wire(into, out_of, wiring, pairs, list(inputs))
    input_signals = [
        _drive(into, wiring, label, k, are_named=pairs is not None) for k, label in enumerate(inputs)
    ]
    output_signals = []
    for k, label in enumerate(outputs):  # an output of a system, or what adds up at one of its inputs
        at_input = bool(_matches(into, label)) and not _matches(out_of, label)
        entries, what, matrix = (into, "input", wiring.G) if at_input else (out_of, "output", wiring.F)
        j = _one(entries, label, what)
        matrix[k, j] = 1.0
        output_signals.append(Signal(label, entries[j][1].unit))
    if idle := [
        label for k, label in enumerate(_full(into)) if not (wiring.Ky[k].any() or wiring.E[k].any())
    ]:
        raise StructureError(
            f"connect: nothing drives {', '.join(idle)}. Name them in inputs or connections, or leave "
            "them out with system[outputs, inputs]."
        )
    operation = Operation("connect", {"connections": [[a, *b] for a, b in (pairs or [])]})
    like = as_system(members[0], name=name)
    return composed(members, wiring, input_signals, output_signals, operation, like=like)


Entries = Sequence[tuple[str, Signal]]  # signals with the names of their systems, as in the wiring


def _full(entries: Entries) -> list[str]:
    return [f"{owner}.{signal.name}" for owner, signal in entries]


def _matches(entries: Entries, name: str) -> list[int]:
    """Positions of a name, alone or with that of its system."""
    return [k for k, full in enumerate(_full(entries)) if name in (entries[k][1].name, full)]


def _one(entries: Entries, name: str, what: str) -> int:
    """The position of a name that stands for one signal."""
    positions = _matches(entries, name)
    if not positions:
        raise StructureError("connect: " + unknown_name(what, name, _full(entries)))
    if len(positions) > 1:
        several = [_full(entries)[k] for k in positions]
        says = f"Say which: {', '.join(several)}."
        if len(set(several)) < len(several):
            says = "Two systems have one name: as_system(item, name=...) gives another one."
        raise StructureError(f"connect: the {what} {name!r} is not one signal. {says}")
    return positions[0]


def pairs_of(connections: Any) -> list[tuple[str, list[str]]] | None:
    """Each input with what adds up to it."""
    if connections is None:
        return None
    if isinstance(connections, Mapping):
        connections = [
            [key, *([value] if isinstance(value, str) else value)] for key, value in connections.items()
        ]
    pairs = []
    for entry in connections:
        if isinstance(entry, str) or len(entry) < 2 or not all(isinstance(n, str) for n in entry):
            raise StructureError(
                "connect, connections: expected lists of an input and one or more outputs, such as "
                f"['controller.e', 'r', '-plant.y'], got {entry!r}."
            )
        pairs.append((entry[0], list(entry[1:])))
    return pairs


def _wire(
    into: Entries,
    out_of: Entries,
    wiring: Wiring,
    pairs: list[tuple[str, list[str]]] | None,
    new: list[str],
) -> None:
    """Let inputs get what `pairs` say, or else the output of their name, if there is one."""
    if pairs is None:
        names = {signal.name for _, signal in out_of}
        for k, (_, signal) in enumerate(into):
            if signal.name in names:
                wiring.Ky[k, _one(out_of, signal.name, "output")] += 1.0
    for target, sources in pairs or ():
        if not _matches(into, target) and _matches(out_of, target):
            raise StructureError(f"connect: {target!r} is an output. A connection is [input, outputs].")
        k = _one(into, target, "input")
        for source in sources:
            sign, name = (-1.0, source[1:]) if source.startswith("-") else (1.0, source)
            if name in new and not _matches(out_of, name):
                wiring.E[k, new.index(name)] += sign
            else:
                wiring.Ky[k, _one(out_of, name, "output")] += sign


def _drive(into: Entries, wiring: Wiring, name: str, k: int, *, are_named: bool) -> Signal:
    """Let an input of the whole drive the inputs of its name; its signal."""
    if not wiring.E[:, k].any():
        positions = _matches(into, name)
        if not positions:
            advice = " No connection has it either." if are_named else ""
            raise StructureError("connect, inputs: " + unknown_name("input", name, _full(into)) + advice)
        wiring.E[positions, k] += 1.0
    units = {into[int(j)][1].unit for j in wiring.E[:, k].nonzero()[0]}
    return Signal(name, units.pop() if len(units) == 1 else "1")


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
    names = (channels,) if isinstance(channels, str) else channels
    return _at_channels(operand(model, "series: model"), names, blocks[0], side)


def _at_channels(model: System, names: Sequence[str], item: Any, side: str | None) -> System:
    check_exact(model, "series")
    at_inputs = _side(model, names, side)
    block = operand(item, f"model {model.name!r}, series, block")
    check_exact(block, "series")
    what, connected = ("outputs", block.outputs) if at_inputs else ("inputs", block.inputs)
    if len(connected) != len(names):
        raise StructureError(
            f"model {model.name!r}, series: the block has {len(connected)} {what} for the "
            f"{len(names)} channels {', '.join(names)}."
        )
    side = "inputs" if at_inputs else "outputs"
    signals, n = getattr(model, side), len(getattr(block, side))
    positions = [[s.name for s in signals].index(name) for name in names]
    kept = [signals[k] for k in positions] if n == len(names) else None
    used, prefix, k = {signal.name for signal in model.states}, names[0], 1
    while any(f"{prefix}.{state.name}" in used for state in block.states):
        k += 1  # another block stands in the channel
        prefix = f"{names[0]}.{k}"
    states = [state.of(prefix) for state in block.states]
    block = as_system(block, states=states, **{side: kept})  # type: ignore[arg-type]
    nu, ny = len(model.inputs), len(model.outputs)
    order: list[int] = []  # of the signals at that side: those of the model, and from `len` on the block
    for k in range(len(signals)):
        if k not in positions:
            order.append(k)
        elif kept is not None:
            order.append(len(signals) + positions.index(k))
        elif k == positions[0]:
            order += range(len(signals), len(signals) + n)
    operation = Operation("series", {"channels": list(names), "side": side})
    if at_inputs:
        at_block = range(ny, ny + len(names))
        return linked((model, block), (positions, at_block), order, range(ny), operation)
    at_block = range(nu, nu + len(names))
    return linked((model, block), (at_block, positions), range(nu), order, operation)


def _side(model: System, names: Sequence[str], side: str | None) -> bool:
    """Whether the channels are inputs."""
    what = f"model {model.name!r}, series"
    if side is not None:
        check_known("side", [str(side)], ("inputs", "outputs"), what, StructureError)
    if not names or len(set(names)) < len(names):
        raise StructureError(
            f"{what}: channels: expected one or more names, each once, got {list(names)}."
        )
    known = {key: [signal.name for signal in getattr(model, key)] for key in ("inputs", "outputs")}
    sides = [key for key in known if side in (None, key)]
    check_known("channel", names, [n for key in sides for n in known[key]], what, StructureError)
    fits = [key for key in sides if set(names) <= set(known[key])]
    if len(fits) != 1:
        says = (
            "names of inputs and of outputs. Say side = 'inputs' or 'outputs'."
            if fits
            else "inputs and outputs; one block stands on one side."
        )
        raise StructureError(f"{what}: {', '.join(names)} are {says}")
    return fits[0] == "inputs"


S = TypeVar("S", bound=System)


@arguments_checked
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
    WellPosednessError
        What is to be inverted, the feed-through from these inputs to these outputs, is singular at
        nominal or somewhere in the range.
    """
    check_exact(model, "inversion")
    inputs, outputs = list(model.inputs), list(model.outputs)
    wiring = plain_wiring([model], len(inputs), len(outputs))
    wiring.E[:], wiring.F[:] = np.eye(len(inputs)), np.eye(len(outputs))
    for entry, output in _exchanged_signals(model, channels):  # y_i is given and u_i is read
        inputs[entry], outputs[output] = outputs[output], inputs[entry]
        wiring.Ku[entry, entry], wiring.Ky[entry, output], wiring.E[entry, entry] = 0.0, 1.0, -1.0
        wiring.F[output, output], wiring.G[output, entry] = 0.0, 1.0
    operation = Operation(f"inversion of {', '.join(channels)}")
    try:
        return cast(S, composed([model], wiring, inputs, outputs, operation, exchange=True))
    except WellPosednessError as error:
        if "at nominal" not in str(error):
            raise
        raise WellPosednessError(
            f"model {model.name!r}, {operation.name}: the feed-through from its inputs to its outputs is "
            "singular at nominal. A load is exchanged with the acceleration where it acts, and only "
            "where something with mass moves."
        ) from None


def _exchanged_signals(model: System, channels: Sequence[str]) -> list[tuple[int, int]]:
    """Positions of the inputs and outputs to be exchanged."""
    where = f"model {model.name!r}"
    if isinstance(channels, str):
        raise StructureError(f"{where}: channels: expected a list of names, got {channels!r}.")
    if not channels:
        raise StructureError(f"{where}: channels: name at least one.")
    known = {_channel(signal) for signal in model.inputs} | {s.name for s in model.inputs}
    check_known("channel", map(str, channels), known, where, StructureError)
    chosen: list[tuple[int, int]] = []
    for name in channels:
        whole = name.partition(".")[0]
        inputs, outputs = (
            [k for k, signal in enumerate(signals) if _channel(signal) == whole]
            for signals in (model.inputs, model.outputs)
        )
        if len(inputs) != len(outputs):
            raise StructureError(
                f"{where}: channel {whole!r} has {len(inputs)} inputs and {len(outputs)} "
                "outputs; only as many of the one as of the other can be exchanged. Choose the signals "
                "of the model so that each input has its output."
            )
        pairs = list(zip(inputs, outputs, strict=True))
        chosen += [p for p in pairs if name in (whole, model.inputs[p[0]].name)]
    if len(set(chosen)) < len(chosen):
        raise StructureError(f"{where}: a channel is named twice in {', '.join(channels)}.")
    return chosen


def _channel(signal: Signal) -> str:
    return signal.name.partition(".")[0]
