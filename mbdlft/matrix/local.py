"""Parameters in the units that the forms of a matrix are written in, so that all have about one size."""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.parameter import BilinearMap, Parameter, to_internal


class Local(NamedTuple):
    """internal = start + size q, with a power of two for size; `map` is that of delta to q."""

    start: float
    size: float
    map: BilinearMap


class MatrixForm(NamedTuple):
    """A matrix of expressions in the symbols q (n_p,) of the parameters, and the maps of deltas to q."""

    q: ca.SX
    matrix: ca.SX
    maps: tuple[BilinearMap, ...]


def local_units(parameters: Sequence[Parameter], *, from_nominal: bool) -> list[Local]:
    """Units of parameters; where terms that are large cancel, distances from nominal keep the digits."""
    found = []
    for parameter in parameters:
        m = parameter.map
        start = m.b0 if from_nominal else 0.0
        ends = to_internal(parameter, [parameter.low, parameter.high]) - start
        size = float(2.0 ** np.round(np.log2(np.max(np.abs(ends)))))
        found.append(Local(start, size, BilinearMap((m.b0 - start) / size, m.gain / size, m.a1)))
    return found
