"""Random uncertain plants with controllers of a fixed structure: tuned and proved, against own loops.

The loop is stable and below what is proved at the corners and 2,000 random points; no start of another
tuner comes more than 1 % below it there. What is refused is made stable by none of them.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbdlft
from mbdlft import synthesis
from mbdlft.base.errors import AnalysisError
from tests.tuned import FILTER, KINDS, Plant, Structure, controller, loop, random_plant, rivals, structure

STARTS, POINTS = 4, 2000
FEW, DENSE = 200, 400  # points, and frequencies of the grid, where both tuners are compared
ABOVE = 1.01  # times the best of the other tuner
ROUNDED = 1.0 + 1e-9  # of a gain in doubles
SEEN = 0.9995  # of a peak, by the grids of `loop`


def attack(seed: int, folder: Path) -> str:
    """One plant."""
    return compared(seed, STARTS)[0]


class Task(NamedTuple):
    """What `tune` takes, and the same as own plant and structure."""

    systems: list[Any]
    goals: list[synthesis.Goal]
    connections: list[tuple[str, str]]
    kind: str
    plant: Plant
    structure: Structure
    random: np.random.Generator


def task(seed: int) -> Task:
    """One of random plants; its kind of controller comes by turns."""
    random = np.random.default_rng([36, seed])
    kind, order = KINDS[seed % len(KINDS)], int(random.integers(1, 3))
    plant = random_plant(random, kind)
    n, nw, nu, nz, ny = plant.sizes
    counts = zip("wuzy", (nw, nu, nz, ny), strict=True)
    w, u, z, y = ([f"{label}{k}" for k in range(count)] for label, count in counts)
    ranges = [mbdlft.Parameter(f"p{k}", 1.0, low, high) for k, (low, high) in enumerate(plant.ranges)]
    system = mbdlft.realize(plant.texts(), ranges, states=n, inputs=w + u, outputs=z + y, name="plant")
    read, drive = ([f"k{name}" for name in some] for some in (y, u))
    K = {
        "gain": lambda: synthesis.tunable_gain("K", read, drive),
        "PID": lambda: synthesis.tunable_pid("K", read[0], drive[0], filter=FILTER),
        "transfer": lambda: synthesis.tunable_transfer("K", read[0], drive[0], order),
        "states": lambda: synthesis.tunable_state_space("K", read, drive, order),
    }[kind]()
    wired = [*zip(read, y, strict=True), *zip(u, drive, strict=True)]
    of = structure(kind, order, nu, ny)
    return Task([system, K], [synthesis.gain_goal(w, z)], wired, kind, plant, of, random)


def compared(seed: int, starts: int) -> tuple[str, float]:
    """The word for one plant, and how far above the best of so many starts its gain is."""
    systems, goals, wired, kind, plant, of, random = task(seed)
    points = plant.points(random, POINTS)
    some, everywhere = points[:FEW], loop(plant, of.states, points)
    try:
        made = synthesis.tune(systems, goals, wired)
    except AnalysisError as error:
        if "stable" not in str(error):
            raise
        proved, worst = None, np.inf
    else:
        proved, own = made.goals[0].proved, controller(kind, dict(made.values), of)
        worst = everywhere.largest_gain(own)
        assert not np.isfinite(proved) or worst <= ROUNDED * proved, (worst, proved)
        some = np.vstack([some, [list(point.values()) for point in made.points]])
    beside = loop(plant, of.states, some)
    if proved is not None:
        assert beside.largest_gain(own, DENSE) >= SEEN * made.goals[0].tuned
    others = rivals(loop(plant, of.states, np.vstack([some[:9], some[FEW:]])), of, random, starts)[:3]
    best = min((beside.largest_gain(other, DENSE) for _, other in others), default=np.inf)
    assert worst <= ABOVE * best, (worst, best)
    if not np.isfinite(worst):
        return "refused" if proved is None else "unstable", 1.0
    return ("proved" if np.isfinite(proved) else "open"), worst / best
