"""Structure and controller together: goals on design parameters alone, and the scene that comes of it.

A goal such as a mass budget is an expression of design parameters, D + C Delta (I - A Delta)^-1 B
as an LFT; with z = (I - A Delta)^-1 B and y = C (I - Delta A)^-1, df/ddelta_i = sum over its copies of
y_j z_j. It is one of the structural channels of Perez, thesis, ISAE Toulouse, 2016, section 8.2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError, StructureError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.lft.lft import LFT
from mbdlft.multibody.scene import Scene
from mbdlft.pipeline.models import realize
from mbdlft.synthesis.goals import DESIGN, Goal
from mbdlft.synthesis.loop import Network


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """An expression over its limit: a 1 x 1 LFT, and which of the values each channel has."""

    lft: LFT
    channels: NDArray[np.int64]
    limit: float
    values: int

    def at(self, x: Array) -> tuple[float, Array]:
        """Value and slope (number of values,) at values of the tuner."""
        a, d = self.lft, x[self.channels]
        z = np.linalg.solve(np.eye(len(d)) - a.M11 * d, a.M12)[:, 0]
        y = np.linalg.solve((np.eye(len(d)) - d[:, None] * a.M11).T, a.M21[0])
        slope = np.bincount(self.channels, weights=y * z, minlength=self.values)
        return float(a.M22.item() + a.M21[0] @ (d * z)) / self.limit, slope / self.limit


def budgets(net: Network, goals: Sequence[Goal]) -> dict[int, Budget]:
    """Those of the goals on design parameters, by their place."""
    names = [value.name for value in net.free]
    parameters = tuple(gain.parameter for gain in net.design.values())
    found = {}
    for k, goal in enumerate(goals):
        if goal.kind == DESIGN:
            try:
                made = _realized(goal.expression, parameters)
            except MbdlftError as error:
                known = ", ".join(p.name for p in parameters) or "none"
                raise StructureError(
                    f"goal {goal.name!r}: {error} Design parameters are: {known}."
                ) from None
            channels = np.array(
                [names.index(b.name) for b in made.blocks for _ in range(b.size)], dtype=int
            )
            found[k] = Budget(made, channels, goal.limit, len(names))
    return found


@lru_cache(maxsize=64)  # a tuner at other points asks again
def _realized(expression: str, parameters: tuple[Parameter, ...]) -> LFT:
    return realize([[expression]], parameters, search=0.0, prove=0.0).lft


@arguments_checked
def designed_scene(scene: Scene, values: Mapping[str, float]) -> Scene:
    """The scene with other nominal values of its parameters; ranges move along.

    Parameters
    ----------
    scene : Scene
    values : mapping of names of parameters to numbers, in their units
        Such as `Tuning.values`: of these, the names of the scene's parameters count.

    Returns
    -------
    Scene
    """
    known = [p.name for p in scene.parameters]
    if not set(known) & set(values):
        check_known("parameter", list(values), known, f"scene {scene.name!r}", StructureError)
        raise StructureError(f"scene {scene.name!r}: expected values of parameters, got none.")
    moved = (_moved(p, values[p.name]) if p.name in values else p for p in scene.parameters)
    return scene.model_copy(update={"parameters": tuple(moved)})


def _moved(p: Parameter, value: float) -> Parameter:
    shift = value - p.nominal
    return replace(p, nominal=value, low=p.low + shift, high=p.high + shift)
