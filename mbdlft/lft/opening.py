"""Blocks taken out of Delta, as signals, and put back; reduction beside blocks that cannot be reduced."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbdlft.lft.block import Block
from mbdlft.lft.lft import LFT


def open_blocks(a: LFT, names: Sequence[str]) -> LFT:
    """The LFT whose last inputs and outputs are w and z of the named blocks, in that order."""
    rows, columns = a.slices(), a.columns()
    z, w = ([k for name in names for k in _range(parts[name])] for parts in (rows, columns))
    kept_z = [k for k in range(a.order) if k not in set(z)]
    kept_w = [k for k in range(a.M11.shape[1]) if k not in set(w)]
    return LFT(
        a.M11[np.ix_(kept_z, kept_w)],
        np.hstack([a.M12[kept_z], a.M11[np.ix_(kept_z, w)]]),
        np.vstack([a.M21[:, kept_w], a.M11[np.ix_(z, kept_w)]]),
        np.block([[a.M22, a.M21[:, w]], [a.M12[z], a.M11[np.ix_(z, w)]]]),
        tuple(block for block in a.blocks if block.name not in names),
    )


def close_blocks(a: LFT, blocks: Sequence[Block]) -> LFT:
    """The LFT whose last inputs and outputs are closed through blocks: undoes `open_blocks`."""
    n_out = a.shape[0] - sum(block.inputs for block in blocks)
    n_in = a.shape[1] - sum(block.outputs for block in blocks)
    every = [*a.blocks, *blocks]
    order = sorted(range(len(every)), key=lambda k: every[k].name)
    z, w = (
        [j for k in order for j in range(ends[k], ends[k + 1])]
        for ends in (
            np.cumsum([0, *(block.inputs for block in every)]).tolist(),
            np.cumsum([0, *(block.outputs for block in every)]).tolist(),
        )
    )
    M11 = np.block([[a.M11, a.M12[:, n_in:]], [a.M21[n_out:], a.M22[n_out:, n_in:]]])
    M12 = np.vstack([a.M12[:, :n_in], a.M22[n_out:, :n_in]])
    M21 = np.hstack([a.M21[:n_out], a.M22[:n_out, n_in:]])
    blocks = tuple(every[k] for k in order)
    return LFT(M11[np.ix_(z, w)], M12[z], M21[:, w], a.M22[:n_out, :n_in], blocks)


def as_plain(a: LFT) -> tuple[LFT, list[Block]]:
    """The same matrices with full blocks opened and complex deltas taken for real ones; the full blocks.

    What never uses that a delta is real, such as the reduction, holds for it.
    """
    full = [block for block in a.blocks if block.kind == "full"]
    inner = open_blocks(a, [block.name for block in full])
    return replace(inner, blocks=tuple(Block(*block) for block in inner.blocks)), full


def of_kinds(plain: LFT, full: Sequence[Block], a: LFT) -> LFT:
    """Undoes `as_plain` for an LFT with other repetitions."""
    known = {block.name: block for block in a.blocks}
    blocks = tuple(known[name].of_size(size) for name, size in plain.blocks)
    return close_blocks(replace(plain, blocks=blocks), full)


def _range(part: slice) -> range:
    return range(part.start, part.stop)
