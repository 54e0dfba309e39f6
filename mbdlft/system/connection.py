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
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from mbdlft.base.errors import StructureError, WellPosednessError, unknown_name
from mbdlft.base.unit import Signal
from mbdlft.system.algebra import chain
from mbdlft.system.conversion import as_system, check_once
from mbdlft.system.evidence import Operation, check_exact, composed, linked
from mbdlft.system.model import System
from mbdlft.system.wiring import Wiring, plain_wiring


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
    StructureError
        A name is unknown, stands for several signals or stands twice, or an input is not connected.
    WellPosednessError
        A loop is singular at nominal or in the range.
    """
    members = [as_system(system) for system in systems]
    if not members:
        raise StructureError("connect: expected one system or more.")
    for asked, what in ((inputs, "inputs"), (outputs, "outputs")):
        if isinstance(asked, str):
            raise StructureError(f"connect, {what}: expected a list of names, got {asked!r}.")
        check_once(list(asked), f"connect, {what}")
    table = _Table.of(members)
    wiring = plain_wiring(members, len(inputs), len(outputs))
    asked_for = _pairs(connections)
    if asked_for is None:
        _by_name(table, wiring)
    else:
        _as_asked(table, wiring, asked_for, list(inputs))
    input_signals = [_drive(table, wiring, name, k, asked_for) for k, name in enumerate(inputs)]
    output_signals = [_read(table, wiring, name, k) for k, name in enumerate(outputs)]
    _check_driven(table, wiring)
    operation = Operation("connect", {"connections": [[a, *b] for a, b in (asked_for or [])]})
    like = as_system(members[0], name=name)
    return composed(members, wiring, input_signals, output_signals, operation, like=like)


class _Table(NamedTuple):
    """Inputs and outputs of all systems: system, signal; their positions are those in the wiring."""

    inputs: list[tuple[str, Signal]]
    outputs: list[tuple[str, Signal]]

    @classmethod
    def of(cls, systems: Sequence[System]) -> "_Table":
        return cls(
            [(system.name, signal) for system in systems for signal in system.inputs],
            [(system.name, signal) for system in systems for signal in system.outputs],
        )


def _matches(entries: Sequence[tuple[str, Signal]], name: str) -> list[int]:
    """Positions of a name, alone or with that of its system."""
    return [
        k for k, (owner, signal) in enumerate(entries) if name in (signal.name, f"{owner}.{signal.name}")
    ]


def _one(entries: Sequence[tuple[str, Signal]], name: str, what: str) -> int:
    """The position of a name that stands for one signal."""
    positions = _matches(entries, name)
    if not positions:
        every = [f"{owner}.{signal.name}" for owner, signal in entries]
        raise StructureError("connect: " + unknown_name(what, name, every))
    if len(positions) > 1:
        several = [f"{entries[k][0]}.{entries[k][1].name}" for k in positions]
        says = f"Say which: {', '.join(several)}."
        if len(set(several)) < len(several):
            says = "Two systems have one name: as_system(item, name=...) gives another one."
        raise StructureError(f"connect: the {what} {name!r} is not one signal. {says}")
    return positions[0]


def _pairs(connections: Any) -> list[tuple[str, list[str]]] | None:
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


def _by_name(table: _Table, wiring: Wiring) -> None:
    """Each input gets the output of its name, if there is one."""
    for k, (_, signal) in enumerate(table.inputs):
        if any(output.name == signal.name for _, output in table.outputs):
            wiring.Ky[k, _one(table.outputs, signal.name, "output")] += 1.0


def _as_asked(
    table: _Table, wiring: Wiring, pairs: Sequence[tuple[str, list[str]]], inputs: list[str]
) -> None:
    for target, sources in pairs:
        k = _one(table.inputs, target, "input")
        for source in sources:
            sign, name = (-1.0, source[1:]) if source.startswith("-") else (1.0, source)
            if name in inputs and not _matches(table.outputs, name):
                wiring.E[k, inputs.index(name)] += sign
            else:
                wiring.Ky[k, _one(table.outputs, name, "output")] += sign


def _drive(table: _Table, wiring: Wiring, name: str, k: int, pairs: Sequence[Any] | None) -> Signal:
    """Let an input of the whole drive the inputs of its name; its signal."""
    positions = _matches(table.inputs, name)
    named = wiring.E[:, k].any()
    if not positions and not named:
        every = [f"{owner}.{signal.name}" for owner, signal in table.inputs]
        advice = "" if pairs is None else " No connection has it either."
        raise StructureError("connect, inputs: " + unknown_name("input", name, every) + advice)
    if not named:
        wiring.E[positions, k] += 1.0
    driven = [int(j) for j in wiring.E[:, k].nonzero()[0]]
    units = {table.inputs[j][1].unit for j in driven}
    return Signal(name, units.pop() if len(units) == 1 else "1")


def _read(table: _Table, wiring: Wiring, name: str, k: int) -> Signal:
    """Let an output of the whole be an output of a system, or one of its inputs; its signal."""
    if _matches(table.outputs, name) or not _matches(table.inputs, name):
        j = _one(table.outputs, name, "output")
        wiring.F[k, j] = 1.0
        return Signal(name, table.outputs[j][1].unit)
    j = _one(table.inputs, name, "input")
    wiring.G[k, j] = 1.0
    return Signal(name, table.inputs[j][1].unit)


def _check_driven(table: _Table, wiring: Wiring) -> None:
    idle = [
        f"{owner}.{signal.name}"
        for k, (owner, signal) in enumerate(table.inputs)
        if not (wiring.Ky[k].any() or wiring.E[k].any())
    ]
    if idle:
        raise StructureError(
            f"connect: nothing drives {', '.join(idle)}. Name them in inputs or connections, or leave "
            "them out with system[outputs, inputs]."
        )


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
    side = "inputs" if at_inputs else "outputs"
    signals, n = getattr(model, side), len(getattr(block, side))
    positions = [[s.name for s in signals].index(name) for name in names]
    kept = [signals[k] for k in positions] if n == len(names) else None
    block = as_system(block, states=_states(model, names[0], block), **{side: kept})  # type: ignore[arg-type]
    nu, ny = len(model.inputs), len(model.outputs)
    order: list[
        int
    ] = []  # of the signals at the side of the block: those of the model, then of the block
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
    pairs = _exchanged_signals(model, channels)
    inputs, outputs = list(model.inputs), list(model.outputs)
    for entry, output in pairs:
        inputs[entry], outputs[output] = outputs[output], inputs[entry]
    operation = Operation(f"inversion of {', '.join(channels)}")
    try:
        made = composed([model], _exchanged(model, pairs), inputs, outputs, operation, exchange=True)
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
    for entry, output in pairs:
        wiring.Ku[entry, entry], wiring.Ky[entry, output], wiring.E[entry, entry] = 0.0, 1.0, -1.0
        wiring.F[output, output], wiring.G[output, entry] = 0.0, 1.0
    return wiring


def _exchanged_signals(model: System, channels: Sequence[str]) -> list[tuple[int, int]]:
    """Positions of the inputs and outputs to be exchanged."""
    if isinstance(channels, str):
        raise StructureError(
            f"model {model.name!r}: channels: expected a list of names, got {channels!r}."
        )
    if not channels:
        raise StructureError(f"model {model.name!r}: channels: name at least one.")
    known = {_channel(signal) for signal in model.inputs} | {s.name for s in model.inputs}
    chosen: list[tuple[int, int]] = []
    for name in channels:
        if name not in known:
            raise StructureError(f"model {model.name!r}: " + unknown_name("channel", str(name), known))
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
        chosen += [p for p in pairs if name in (whole, model.inputs[p[0]].name)]
    if len(set(chosen)) < len(chosen):
        raise StructureError(f"model {model.name!r}: a channel is named twice in {', '.join(channels)}.")
    return chosen


def _channel(signal: Signal) -> str:
    return signal.name.partition(".")[0]
