"""The ways of this package: an LFT and the equations, by numpy and as native code."""

from typing import Any

import numpy as np

import mbdlft
from benchmarks.speed.robots import Array, Method, Samples
from benchmarks.speed.systems import System
from mbdlft.batch.native import compiled
from mbdlft.batch.rows import source_of


def by_lft(system: System) -> Method:
    """One model for all values of the parameters, evaluated: A, B, C, D (N, ., .) each."""
    model = mbdlft.to_lft(system.scene, search=0.0)

    def method(samples: Samples) -> Any:
        return mbdlft.matrices_at(model, samples)

    return method


def whole(found: Any) -> Array:
    """[A B ; C D] of what a method gives: that, or the four."""
    if isinstance(found, np.ndarray):
        return found
    top, bottom = (np.concatenate(pair, axis=2) for pair in (found[:2], found[2:]))
    return np.concatenate([top, bottom], axis=1)


def by_equations(system: System) -> Method:
    """The nonlinear equations, trimmed and linearized with numbers at each sample, as a sweep does."""
    source = source_of(system.scene)
    names = [p.name for p in source.parameters]

    def method(samples: Samples) -> Array:
        points = np.stack([samples[name] for name in names], axis=-1)
        parts = [
            source.rows(points[start : start + source.chunk])[0]
            for start in range(0, len(points), source.chunk)
        ]
        return np.concatenate(parts)

    return method


def by_compiled_equations(system: System) -> Method:
    """The same as native code, in one thread."""
    return _compiled(system.scene)


def by_compiled_lft(system: System) -> Method:
    """The values of the model as native code, in one thread."""
    return _compiled(mbdlft.to_lft(system.scene, search=0.0))


def _compiled(given: mbdlft.Scene | mbdlft.LFTModel) -> Method:
    found = compiled(source_of(given), threads=1)
    if found.reason:
        raise TooLongError(found.reason)
    names = [p.name for p in found.parameters]

    def method(samples: Samples) -> Array:
        return found.rows(np.stack([samples[name] for name in names]).T)[0]

    return method


class TooLongError(Exception):
    """There is no native code."""
