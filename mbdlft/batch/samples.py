"""Samples of a sweep: each part is made when it is needed, so that millions take no memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import physical_points

_OUTSIDE = 1e-9  # part of the width of a range by which rounding of a file may miss it


@dataclass(frozen=True, slots=True)
class GridSamples:
    """All combinations of evenly spaced values, bounds included.

    They are in the order of `grid` for parameters sorted by name.

    Attributes
    ----------
    counts : mapping of names to numbers of values; a parameter that is not named is nominal
    """

    counts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class RandomSamples:
    """Independent uniform values in the ranges, equal to those of `random` for parameters sorted by name.

    Attributes
    ----------
    count : number of samples
    seed : the same seed gives the same samples
    """

    count: int
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class GivenSamples:
    """Physical values (N, n_p) of a user, in the units and the order of the parameters."""

    points: Array = field(repr=False)


Samples = GridSamples | RandomSamples | GivenSamples


def samples_of(
    parameters: Sequence[Parameter], samples: GridSamples | RandomSamples | Mapping[str, ArrayLike]
) -> Samples:
    """Check the samples of a user; arrays (N,) by name are in the units of the parameters."""
    names = [p.name for p in parameters]
    if isinstance(samples, GridSamples):
        counts = samples.counts
        is_given = isinstance(counts, Mapping)
        if is_given:
            check_known("parameter", counts, names, "sweep, grid", AnalysisError)
        if not is_given or not counts or not all(_is_count(count, 1) for count in counts.values()):
            raise AnalysisError(
                "sweep: a grid needs a whole number of values of at least 1 for some parameters, such as "
                f"{ {(names or ['m'])[0]: 3} }, got {counts!r}."
            )
        return samples
    if isinstance(samples, RandomSamples):
        if not (_is_count(samples.count, 1) and _is_count(samples.seed, 0)):
            raise AnalysisError(
                f"sweep: expected at least 1 random sample and a seed of at least 0, got {samples}."
            )
        return samples
    if not isinstance(samples, Mapping):
        raise AnalysisError(
            "sweep: expected GridSamples, RandomSamples or a mapping of names to arrays, got "
            f"{type(samples).__name__}."
        )
    check_known("parameter", samples, names, "sweep, samples", AnalysisError)
    advice = " Widen the range in the scene, or leave it out."
    points = physical_points(parameters, samples, "sweep", AnalysisError, advice, _OUTSIDE, numbered=True)
    if not len(points):
        raise AnalysisError("sweep: there are no samples.")
    return GivenSamples(points)


def _is_count(number: Any, least: int) -> bool:
    is_whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
    return is_whole and number >= least


def count_of(samples: Samples) -> int:
    """Number of samples."""
    if isinstance(samples, GridSamples):
        return prod(samples.counts.values())
    return samples.count if isinstance(samples, RandomSamples) else len(samples.points)


def points_of(samples: Samples, parameters: Sequence[Parameter], start: int, stop: int) -> Array:
    """Physical values (stop - start, n_p) of the samples from `start` to `stop`.

    The values of a sample do not depend on the part in which it is made.
    """
    if isinstance(samples, GivenSamples):
        return np.array(samples.points[start:stop], dtype=float, order="F")
    points = np.empty((stop - start, len(parameters)), order="F")  # as native code reads it
    if isinstance(samples, RandomSamples):
        for k, p in enumerate(parameters):
            # `random` draws one 64-bit number for each value: first all values of the first parameter
            bits = np.random.PCG64(samples.seed)
            bits.advance(k * samples.count + start)
            points[:, k] = np.random.Generator(bits).uniform(p.low, p.high, stop - start)
        return points
    index = np.arange(start, stop)
    for k in reversed(range(len(parameters))):
        p = parameters[k]
        size = samples.counts.get(p.name, 1)
        axis = np.linspace(p.low, p.high, size) if size > 1 else np.array([p.nominal])
        index, position = np.divmod(index, size)
        points[:, k] = axis[position]
    return points


def described(samples: Samples) -> dict[str, Any]:
    """Samples as plain data, from which they can be made again; values are stored beside the data."""
    if isinstance(samples, GridSamples):
        return {"kind": "grid", "counts": {k: int(v) for k, v in samples.counts.items()}}
    if isinstance(samples, RandomSamples):
        return {"kind": "random", "count": int(samples.count), "seed": int(samples.seed)}
    return {"kind": "given", "count": len(samples.points)}


def from_description(data: Mapping[str, Any], points: Path) -> Samples:
    """The samples that `described` has described; given values stay on the disk, in the file `points`."""
    if data["kind"] == "grid":
        return GridSamples(data["counts"])
    if data["kind"] == "random":
        return RandomSamples(data["count"], data["seed"])
    return GivenSamples(np.load(points, mmap_mode="r"))


@arguments_checked
def read_samples(path: str | Path) -> dict[str, Array]:
    """Read samples from a text file with commas: names in the first line, one sample in each other line.

    Parameters
    ----------
    path : file
    """
    file = Path(path)
    try:
        with file.open(encoding="utf-8-sig") as stream:
            names = [name.strip() for name in stream.readline().split(",")]
            table = np.loadtxt(stream, delimiter=",", ndmin=2)
    except OSError as error:
        raise AnalysisError(f"{file}: cannot be read: {error.strerror}.") from None
    except ValueError as error:
        raise AnalysisError(
            f"{file}: expected names in the first line, then one number for each: {error}"
        ) from None
    if len(set(names)) != len(names) or table.shape[1] != len(names):
        raise AnalysisError(
            f"{file}: expected as many different names as columns, got names {names} and "
            f"{table.shape[1]} columns."
        )
    return {name: table[:, k] for k, name in enumerate(names)}
