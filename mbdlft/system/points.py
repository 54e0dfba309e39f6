"""How far a model that is derived from another is from what it was derived from."""

from collections.abc import Sequence

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import Parameter, to_delta
from mbdlft.base.samples import check_points
from mbdlft.lft.lft import LFT
from mbdlft.lft.triangle import values_at, vanishes

_RANDOM, _MOST_CORNERS = 50, 64
_NEGLIGIBLE = 1e-8  # an entry below this part of its row and column is compared with them


def sampled_deltas(parameters: Sequence[Parameter], seed: int) -> Array:
    """Deltas (N, n_p) [1]: nominal, random points, and all corners, or as many random ones."""
    return deltas_at(parameters, check_points(parameters, seed, _RANDOM, _MOST_CORNERS))


def deltas_at(parameters: Sequence[Parameter], points: Array) -> Array:
    """Deltas (N, n_p) [1] of physical points (N, n_p)."""
    columns = [to_delta(p, points[:, k]) for k, p in enumerate(parameters)]
    return np.stack(columns, axis=1) if columns else points


def check_determinant(a: LFT, deltas: Array, what: str, parameters: Sequence[Parameter]) -> None:
    """Raise a WellPosednessError where I - M11 Delta is seen to be singular on the way to a point."""
    _, signs = values_at(a, deltas)
    singular = (signs <= 0.0) | vanishes(a, deltas)
    if np.any(singular):
        worst = deltas[int(np.argmax(singular))]
        where = ", ".join(f"{p.name}: {d:+.3g}" for p, d in zip(parameters, worst, strict=True))
        raise WellPosednessError(
            f"{what}: singular between the nominal values and the normalized ones {where}. Narrow the "
            "ranges."
        )


def entry_scale(reference: Array, terms: Array) -> Array:
    """What an entry of matrices (N, ., .) is compared with: its largest size over the points.

    An entry that is negligible in its row and column is compared with the smaller of the two, one that is
    negligible beside its own `terms` (., .) with them.
    """
    size = np.max(np.abs(reference), axis=0)
    rows = np.max(size, axis=1, initial=0.0, keepdims=True)
    columns = np.max(size, axis=0, initial=0.0, keepdims=True)
    whole = np.maximum(np.minimum(rows, columns), terms)
    scale = np.where(size > _NEGLIGIBLE * whole, size, whole)
    return np.where(scale > 0, scale, 1.0)


def largest(differences: Array, scale: Array) -> float:
    """Largest size of differences (N, ...), each entry relative to its scale (...)."""
    return float(np.max(np.abs(differences) / scale, initial=0.0))
