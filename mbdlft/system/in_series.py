"""A block in series with channels of a model: an actuator at inputs, a sensor or filter at outputs.

    at inputs:   u_i = K(s, delta) u'           at outputs:   y' = K(s, delta) y_i

in the LFT of [A B ; C D]: the deltas of the model and of the block are gathered by name. The states of
the block come after those of the model.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.signal import Signal
from mbdlft.bound.degree import degree_bounds
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, constant, select, stack_diagonal, transpose, with_blocks
from mbdlft.reduce.reduce import reduce_order
from mbdlft.system.model import Certificate, LFTModel, Trim
from mbdlft.system.points import check_exact, sampled_deltas, value_error
from mbdlft.system.system import Parameters

if TYPE_CHECKING:
    from control import StateSpace

_ATTRIBUTES = ("A", "B", "C", "D", "nstates", "dt")


class _Block(NamedTuple):
    """What a block is, whatever it was given as."""

    lft: LFT
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]
    error: float
    raw: dict[str, int]


def series(
    model: LFTModel,
    channels: str | Sequence[str],
    block: "LFTModel | StateSpace",
    *,
    side: str | None = None,
) -> LFTModel:
    """The model with u = K u' at inputs, or y' = K y at outputs, K the block.

    Parameters
    ----------
    model : LFTModel
    channels : str or sequence of str
        Inputs, or outputs, of the model: those that the outputs, or inputs, of the block are connected
        to, in their order.
    block : LFTModel, as of `low_pass`, or a continuous `control.StateSpace`
        Parameters of equal names must be equal, and are the same.
    side : str
        ``"inputs"`` or ``"outputs"``; needed where names are those of both.

    Returns
    -------
    LFTModel
        A block with as many outputs as inputs leaves the names of the signals as they are; the signals of
        another take the place of the first of the channels. States are named ``CHANNEL.STATE`` with the
        first channel. The repetitions are reduced and the lower bounds computed again; the trim is that
        of the model.

    Raises
    ------
    StructureError
        The model or the block is truncated; a channel is unknown, named twice or on both sides; the
        block has another size, is not continuous or not a block; a parameter of it has the name of
        another one of the model.
    """
    check_exact(model, "series")
    names = (channels,) if isinstance(channels, str) else tuple(channels)
    at_inputs = _side(model, names, side)
    found = _as_block(model, block)
    _check_sizes(model, names, found, at_inputs=at_inputs)
    signals = model.inputs if at_inputs else model.outputs
    positions = [[s.name for s in signals].index(name) for name in names]
    own = found.inputs if at_inputs else found.outputs
    square = len(own) == len(names)
    order: list[int] = []  # of the new signals: old ones by position, those of the block after them
    for k in range(len(signals)):
        if k not in positions:
            order.append(k)
        elif square:
            order.append(len(signals) + positions.index(k))
        elif k == positions[0]:
            order += [len(signals) + j for j in range(len(own))]
    entries = (*signals, *((signals[k] for k in positions) if square else own))
    listed = tuple(entries[k] for k in order)
    parameters = _merged(model, found)
    deltas_names = [p.name for p in parameters]

    def connect(a: LFT, b: LFT) -> LFT:
        if not at_inputs:
            a, b = transpose(a), transpose(b)
        joined = _at_inputs(a, len(model.states), b, len(found.states), positions, order)
        return joined if at_inputs else transpose(joined)

    lft = with_blocks(reduce_order(connect(model.lft, found.lft)), deltas_names)
    deltas = sampled_deltas(parameters, model.certificate.seed)
    columns = {name: k for k, name in enumerate(deltas_names)}
    values = [
        evaluate_at(a, deltas[:, [columns[name] for name, _ in a.blocks]])
        for a in (model.lft, found.lft)
    ]
    reference = np.stack(
        [connect(constant(a), constant(b)).M22 for a, b in zip(*values, strict=True)]
    )
    return replace(
        model,
        lft=lft,
        states=(*model.states, *_states(model, names[0], found)),
        inputs=listed if at_inputs else model.inputs,
        outputs=model.outputs if at_inputs else listed,
        parameters=Parameters(parameters),
        trim=_trim(model, deltas_names),
        certificate=_certificate(model, found, lft, value_error(lft, reference, deltas)),
    )


def _side(model: LFTModel, names: Sequence[str], side: str | None) -> bool:
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


def _as_block(model: LFTModel, block: "LFTModel | StateSpace") -> _Block:
    if isinstance(block, LFTModel):
        check_exact(block, "series")
        raw = zip(block.parameters, block.certificate.raw_order, strict=True)
        return _Block(
            block.lft,
            block.states,
            block.inputs,
            block.outputs,
            block.parameters,
            block.certificate.max_relative_error,
            {p.name: size for p, size in raw},
        )
    what = f"model {model.name!r}, series"
    if not all(hasattr(block, name) for name in _ATTRIBUTES):
        raise StructureError(
            f"{what}: block: expected an LFTModel or a control.StateSpace, got "
            f"{type(block).__name__}. control.ss(...) makes one of a transfer function."
        )
    if block.dt not in (None, 0):
        raise StructureError(
            f"{what}: block: expected continuous time (dt = 0), got dt = {block.dt!r}."
        )
    matrices = np.block([[block.A, block.B], [block.C, block.D]])
    return _Block(
        constant(matrices.reshape(block.nstates + block.noutputs, -1)),
        tuple(Signal(f"x{k}", "1") for k in range(block.nstates)),
        tuple(Signal(str(name), "1") for name in block.input_labels),
        tuple(Signal(str(name), "1") for name in block.output_labels),
        (),
        0.0,
        {},
    )


def _check_sizes(model: LFTModel, names: Sequence[str], block: _Block, *, at_inputs: bool) -> None:
    what, connected = ("outputs", block.outputs) if at_inputs else ("inputs", block.inputs)
    if len(connected) != len(names):
        raise StructureError(
            f"model {model.name!r}, series: the block has {len(connected)} {what} for the "
            f"{len(names)} channels {', '.join(names)}."
        )


def _merged(model: LFTModel, block: _Block) -> tuple[Parameter, ...]:
    """Parameters of both, sorted by name."""
    found = {p.name: p for p in model.parameters}
    for p in block.parameters:
        if found.setdefault(p.name, p) != p:
            raise StructureError(
                f"model {model.name!r}, series: the parameter {p.name!r} of the block is not that of the "
                f"model: {p} is not {found[p.name]}. Rename one, or declare it once."
            )
    return tuple(sorted(found.values(), key=lambda p: p.name))


def _states(model: LFTModel, channel: str, block: _Block) -> tuple[Signal, ...]:
    """States of the block, numbered on where another block stands in the same channel."""
    used = {signal.name for signal in model.states}
    prefix, k = channel, 1
    while any(f"{prefix}.{state.name}" in used for state in block.states):
        k += 1
        prefix = f"{channel}.{k}"
    return tuple(Signal(f"{prefix}.{state.name}", state.unit) for state in block.states)


def _at_inputs(
    a: LFT, n: int, b: LFT, nb: int, positions: Sequence[int], order: Sequence[int]
) -> LFT:
    """[xdot ; xbdot ; y] from [x ; xb ; u'], where the inputs at `positions` are the outputs of b."""
    nu, outputs = a.shape[1] - n, a.shape[0] - n
    mb = b.shape[1] - nb
    # columns of what is given: x, xb, then old inputs and inputs of the block in the new order
    old = np.zeros((n + nu, n + nb + len(order)))
    old[:n, :n] = np.eye(n)
    into = np.zeros((nb + mb, n + nb + len(order)))
    into[:nb, n : n + nb] = np.eye(nb)
    for column, entry in enumerate(order):
        if entry < nu:
            old[n + entry, n + nb + column] = 1.0
        else:
            into[nb + entry - nu, n + nb + column] = 1.0
    placed = np.zeros((n + nu, b.shape[0]))
    for k, position in enumerate(positions):
        placed[n + position, nb + k] = 1.0
    block = b @ into  # [xbdot ; outputs of b]
    spread = np.vstack([placed, np.hstack([np.eye(nb), np.zeros((nb, len(positions)))])])
    given = constant(np.vstack([old, np.zeros((nb, old.shape[1]))])) + spread @ block
    result = stack_diagonal(a, np.eye(nb)) @ given if nb else a @ given
    rows = [*range(n), *range(n + outputs, n + outputs + nb), *range(n, n + outputs)]
    return select(result, rows, range(result.shape[1]))


def _trim(model: LFTModel, names: Sequence[str]) -> Trim:
    lft = model.trim.lft
    return model.trim if lft is None else replace(model.trim, lft=with_blocks(lft, names))


def _certificate(model: LFTModel, block: _Block, lft: LFT, error: float) -> Certificate:
    found = model.certificate
    raw = {p.name: size for p, size in zip(model.parameters, found.raw_order, strict=True)}
    bounds = degree_bounds(lft, seed=found.seed)
    lower = tuple(min(bounds[name].degree, size) for name, size in lft.blocks)
    return replace(
        found,
        order=tuple(size for _, size in lft.blocks),
        lower_bound=lower,
        raw_order=tuple(raw.get(name, 0) + block.raw.get(name, 0) for name, _ in lft.blocks),
        max_relative_error=max(found.max_relative_error, block.error) + error,
        exact_bound=False,
        doubtful=tuple(bounds[name].doubtful for name, _ in lft.blocks),
        order_bound=sum(lower),
        condition=0.0,  # that of the product is not known
        sign_changes=0,
    )
