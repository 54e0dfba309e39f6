"""Samples of the parameters: physical values by name, each an array of one length."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, MbdlftError, check_known
from mbdlft.base.parameter import Parameter

SEED = 0  # of the points at which models are checked
_MOST = 2**22  # points of a grid: 32 MB for each parameter


@arguments_checked
def random(parameters: Sequence[Parameter], count: int, seed: int = 0) -> dict[str, Array]:
    """Make random samples: independent uniform physical values in the ranges.

    Parameters
    ----------
    parameters : sequence of Parameter
    count : int
        Number of points N.
    seed : int
        The same seed gives the same points.

    Returns
    -------
    dict of names to arrays (N,), in the units of the parameters
    """
    if not isinstance(count, int | np.integer) or count < 0:
        raise AnalysisError(f"random: expected a number of points such as 1000, got {count!r}.")
    generator = np.random.default_rng(seed)
    return {p.name: generator.uniform(p.low, p.high, count) for p in parameters}


@arguments_checked
def corners(parameters: Sequence[Parameter]) -> dict[str, Array]:
    """Make the samples at all 2^n combinations of the bounds of n parameters.

    Returns
    -------
    dict of names to arrays (2^n,), in the units of the parameters

    Raises
    ------
    AnalysisError
        There are more than 2^22 combinations.
    """
    return grid(parameters, {p.name: 2 for p in parameters})


@arguments_checked
def grid(parameters: Sequence[Parameter], counts: Mapping[str, int]) -> dict[str, Array]:
    """Make samples of all combinations of evenly spaced values, bounds included.

    Parameters
    ----------
    parameters : sequence of Parameter
    counts : mapping of names to numbers of values; a parameter that is not named is nominal

    Returns
    -------
    dict of names to arrays (N,), in the units of the parameters; N is the product of the counts

    Raises
    ------
    AnalysisError
        A name is unknown, a count is not a whole number of at least 1, or there are more than
        2^22 points.
    """
    check_known("parameter", counts, [p.name for p in parameters], "grid", AnalysisError)
    if any(not isinstance(n, int | np.integer) or n < 1 for n in counts.values()):
        raise AnalysisError(f"grid: counts must be whole numbers of at least 1, got {dict(counts)}.")
    size = float(np.prod([float(count) for count in counts.values()]))
    if size > _MOST:
        raise AnalysisError(f"grid: {size:.3g} points are more than {_MOST}; use random points.")
    axes = [
        np.linspace(p.low, p.high, counts[p.name]) if counts.get(p.name, 1) > 1 else [p.nominal]
        for p in parameters
    ]
    points = np.array(list(product(*axes))).reshape(int(size), len(parameters))
    return {p.name: points[:, k] for k, p in enumerate(parameters)}


def physical_points(
    parameters: Sequence[Parameter],
    values: Mapping[str, ArrayLike],
    where: str,
    error: type[MbdlftError],
    advice: str = "",
    slack: float = 0.0,
    *,
    numbered: bool = False,
) -> Array:
    """Physical values (N, n_p) of numbers and arrays (N,) by name in their ranges; others are nominal.

    A value may miss its range by `slack` of the width; messages say which sample it is if `numbered`.
    """
    if not isinstance(values, Mapping):
        example = f"{{'{(parameters[0].name if parameters else 'm')}': 1.0}}"
        raise error(f"{where}: expected values by name, such as {example}, got {values!r}.")
    check_known("parameter", map(str, values), [p.name for p in parameters], where, error)
    columns = {name: np.atleast_1d(np.asarray(column, dtype=float)) for name, column in values.items()}
    lengths = {len(column) for column in columns.values()} - {1}
    if len(lengths) > 1 or any(column.ndim != 1 for column in columns.values()):
        raise error(
            f"{where}: values of parameters must be numbers or arrays of one length, got shapes "
            f"{sorted({column.shape for column in columns.values()})}."
        )
    points = np.empty((max(lengths, default=1), len(parameters)))
    for k, p in enumerate(parameters):
        points[:, k] = columns.get(p.name, p.nominal)
        room = slack * (p.high - p.low)
        outside = ~((points[:, k] >= p.low - room) & (points[:, k] <= p.high + room))
        if np.any(outside):
            row = int(np.argmax(outside))
            at = f"{where}: sample {row}" if numbered else where
            raise error(
                f"{at}: {p.name} = {points[row, k]:g} is outside its range [{p.low:g}, {p.high:g}] "
                f"{p.unit}.{'' if np.isnan(points[row, k]) else advice}"
            )
    return points


def check_points(
    parameters: Sequence[Parameter], seed: int, inside: int = 100, most_corners: int = 128
) -> Array:
    """Physical points (N, n_p): nominal, some inside, and all corners, or as many random ones."""
    if not parameters:
        return np.zeros((1, 0))
    drawn = random(parameters, inside, seed)
    if 2 ** len(parameters) <= most_corners:
        outer = corners(parameters)
    else:
        sides = np.random.default_rng(seed).integers(0, 2, (most_corners, len(parameters)))
        outer = {p.name: np.where(sides[:, k], p.high, p.low) for k, p in enumerate(parameters)}
    columns = [np.concatenate([[p.nominal], drawn[p.name], outer[p.name]]) for p in parameters]
    return np.stack(columns, axis=1)
