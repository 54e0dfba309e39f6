"""Inversion of channels: inputs and outputs of one place exchange their roles.

For the channels i, the others o, and [y_i ; y_o] = G [u_i ; u_o],

    [u_i ; y_o] = [G_ii^-1 , -G_ii^-1 G_io ; G_oi G_ii^-1 , G_oo - G_oi G_ii^-1 G_io] [y_i ; u_o]

made in the LFT of [A B ; C D], where G_ii is D_ii: no channel of Delta is added. The McMillan degree in
each delta is that of the graph of the map, which an exchange of coordinates does not change, so lower
bounds stay.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, WellPosednessError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, eliminate, select, stack_columns
from mbdlft.system.model import LFTModel
from mbdlft.system.points import check_determinant, check_exact, sampled_deltas, value_error

Positions = NDArray[np.int64]


def invert_channels(model: LFTModel, channels: Sequence[str]) -> LFTModel:
    """The model with the inputs and outputs of some channels exchanged: u_i = G_ii^-1 (y_i - G_io u_o).

    Parameters
    ----------
    model : LFTModel
    channels : sequence of str
        Each is the part of signal names before the first dot, such as the port ``tip`` of a `two_port`;
        or it is an input such as ``tip.torque.z``. The k-th input of a channel is exchanged with
        its k-th output: a load with the acceleration where it acts.

    Returns
    -------
    LFTModel
        With as many repetitions as `model`, the same lower bounds, and the same states. Inverted twice it
        is the model again. Its `max_relative_error` is that of the model times the condition of what was
        inverted, and the error of the inversion itself.

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
    n = len(model.states)
    rows = np.array([n + output for _, output in pairs])
    columns = np.array([n + given for given, _ in pairs])
    what = f"model {model.name!r}, inversion of {', '.join(channels)}"
    lft = _exchanged(model.lft, rows, columns, what)
    deltas = sampled_deltas(model.parameters, model.certificate.seed)
    check_determinant(lft, deltas, what, model.parameters)
    values = evaluate_at(model.lft, deltas)
    condition = _condition(values[:, rows[:, None], columns])
    error = value_error(lft, _exchanged_values(values, rows, columns), deltas)
    found = model.certificate
    inputs, outputs = list(model.inputs), list(model.outputs)
    for given, output in pairs:
        inputs[given], outputs[output] = outputs[output], inputs[given]
    return replace(
        model,
        lft=lft,
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        certificate=replace(
            found,
            max_relative_error=condition * found.max_relative_error + error,
            condition=0.0,  # that of the exchanged entries is not known
            sign_changes=0,
        ),
    )


def _pairs(model: LFTModel, channels: Sequence[str]) -> list[tuple[int, int]]:
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


def _exchanged(a: LFT, rows: Positions, columns: Positions, what: str) -> LFT:
    """The LFT with the outputs `rows` as inputs at `columns`, and these inputs in their place."""
    k = len(rows)
    kept, others = _others(a.shape[0], rows), _others(a.shape[1], columns)
    ordered = select(a, np.concatenate([rows, kept]), np.concatenate([columns, others]))
    # 0 = G_ii u_i + G_io u_o - y_i is solved for u_i, and y_o is read
    given = np.zeros((a.shape[0], k))
    given[:k] = -np.eye(k)
    try:
        solved = eliminate(stack_columns(ordered, given), k)
    except WellPosednessError:
        raise WellPosednessError(
            f"{what}: the feed-through from its inputs to its outputs is singular at nominal. A load is "
            "exchanged with the acceleration where it acts, and only where something with mass moves."
        ) from None
    return select(
        solved,
        np.argsort(np.concatenate([rows, kept])),
        np.argsort(np.concatenate([others, columns])),
    )


def _exchanged_values(values: Array, rows: Positions, columns: Positions) -> Array:
    """The same of matrices (N, ., .), in numbers."""
    kept, others = _others(values.shape[1], rows), _others(values.shape[2], columns)
    inner = np.linalg.inv(values[:, rows[:, None], columns])
    found = np.empty_like(values)
    to_others = inner @ values[:, rows[:, None], others]
    from_kept = values[:, kept[:, None], columns]
    found[:, rows[:, None], columns] = inner
    found[:, rows[:, None], others] = -to_others
    found[:, kept[:, None], columns] = from_kept @ inner
    found[:, kept[:, None], others] = values[:, kept[:, None], others] - from_kept @ to_others
    return found


def _condition(values: Array) -> float:
    """Largest condition number of matrices (N, k, k), once rows and columns have one size."""
    size = np.max(np.abs(values), axis=0)
    row = np.sqrt(np.max(size, axis=1, keepdims=True))
    scaled = values / np.where(row > 0, row, 1.0) / np.where(row > 0, row, 1.0).T
    return float(np.max(np.linalg.cond(scaled)))


def _others(count: int, positions: Positions) -> Positions:
    return np.setdiff1d(np.arange(count), positions)
