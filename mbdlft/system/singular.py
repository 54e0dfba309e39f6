"""Values of the parameters at which a model is singular; numpy only, as reading an archive is."""

from collections.abc import Sequence

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import Parameter, to_physical
from mbdlft.lft.evaluation import chunks
from mbdlft.lft.lft import LFT


def check_regular_at(lft: LFT, deltas: Array, parameters: Sequence[Parameter], what: str) -> None:
    """Raise a WellPosednessError for the first of the deltas (N, n_p) where a plain LFT is singular.

    It is so exactly, or to working precision: rounding of its entries makes it singular.
    """
    spread = np.repeat(deltas, [block.size for block in lft.blocks], axis=1)
    for part in chunks(len(deltas), lft.order):
        numbers = _conditions(np.eye(lft.order) - lft.M11 * spread[part, None, :])
        singular = np.flatnonzero(~(numbers <= 1.0 / float(np.finfo(float).eps)))
        if len(singular):
            first = int(singular[0])
            physical = [
                float(to_physical(p, d))
                for p, d in zip(parameters, deltas[part][first], strict=True)
            ]
            exactly = np.isinf(numbers[first])
            how = "" if exactly else f" to working precision (condition {numbers[first]:.1e})"
            raise WellPosednessError(
                f"{what}: it is singular{how} at {at_values(parameters, physical)}, and has no value "
                "there. Choose other values, or narrow the ranges and make the model again."
            )


def _conditions(matrices: Array) -> Array:
    """Condition numbers (N,) in the 1-norm with rows and columns of one size; inf if singular."""
    found = np.full(len(matrices), np.inf)
    for axis in (2, 1):
        size = np.max(np.abs(matrices), axis=axis, keepdims=True, initial=0.0)
        matrices = matrices / np.where(size > 0.0, size, 1.0)
    if not matrices.shape[1]:
        return np.ones(len(matrices))
    signs, _ = np.linalg.slogdet(matrices)
    some = np.flatnonzero(signs)
    norms = [
        np.sum(np.abs(m), axis=1).max(axis=1)
        for m in (matrices[some], np.linalg.inv(matrices[some]))
    ]
    found[some] = norms[0] * norms[1]
    return found


def at_values(parameters: Sequence[Parameter], values: Sequence[float] | Array) -> str:
    """Values of all parameters, with their units, for messages."""
    return ", ".join(
        f"{p.name} = {value:.6g} {p.unit}".removesuffix(" 1")
        for p, value in zip(parameters, values, strict=True)
    )
