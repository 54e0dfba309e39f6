"""The number of modes that a body keeps, from a count, a highest frequency or a least effective mass."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.elastic.reduction import Candidates, Modes, Reduced

_FIRST = 20  # modes computed at first; the number is doubled until there are enough
_BELOW = {"frequency": np.inf, "effective_mass": 1.0}
_EXPECTED = {
    "frequency": "a positive number (rad/s)",
    "effective_mass": "a fraction of the rigid mass between 0 and 1",
}
_MOST = 640  # most modes of a large structure that are computed for an effective mass
NO_MASS = 1e-9  # a smaller mass, of the largest, is none: a bar has no inertia about its own axis


@dataclass(frozen=True, slots=True)
class Limit:
    """One of: number of modes, highest frequency (rad/s), smallest fraction of the rigid mass."""

    modes: int | None
    frequency: float | None
    effective_mass: float | None

    def __post_init__(self) -> None:
        limits = {
            name: value
            for name in ("modes", "frequency", "effective_mass")
            if (value := getattr(self, name)) is not None
        }
        if len(limits) != 1:
            raise StructureError(
                "expected one of modes (a number), frequency (rad/s) and effective_mass (a "
                f"fraction), got {' and '.join(limits) or 'none'}."
            )
        (name, value), *_ = limits.items()
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if name == "modes" and not (whole and value >= 0):
            raise StructureError(f"modes: expected a whole number, 0 or more, got {value!r}.")
        if name != "modes" and not 0.0 < float(value) < _BELOW[name]:
            raise StructureError(f"{name}: expected {_EXPECTED[name]}, got {value!r}.")


def chosen(candidates: Candidates, limit: Limit, rigid: Array) -> tuple[int, Reduced]:
    """The number of modes that `limit` asks for, and the reduced matrices with these modes.

    `rigid` (r,) is the rigid mass of each direction, about the origin.
    """
    if limit.effective_mass is not None:
        return _by_mass(candidates, limit.effective_mass, rigid)
    if limit.modes is not None:
        modes = candidates.modes(limit.modes)
        if len(modes) < limit.modes:
            raise StructureError(
                f"modes: {limit.modes} are asked for and there are {len(modes)}; ask for fewer, or "
                "refine the mesh."
            )
        count = limit.modes
    else:
        top = float(limit.frequency or 0.0)
        modes = _until(candidates, lambda modes: bool(modes.frequencies[-1] > top))
        count = int(np.sum(modes.frequencies <= top))
    reduced = candidates.reduce(first(modes, count))
    if not len(reduced.mass):
        lowest = f", the first is at {modes.frequencies[0]:g} rad/s" if len(modes) else ""
        raise StructureError(f"no mode is kept{lowest}: ask for at least one.")
    return count, reduced


def first(modes: Modes, count: int) -> Modes:
    """The first `count` modes."""
    return Modes(modes.frequencies[:count], modes.shapes[:, :count], complete=False)


def _with_first(reduced: Reduced, modes: int, count: int) -> Reduced:
    """Reduced matrices with the first `count` of their `modes` modes, and all motions of the ports."""
    keep = [*range(count), *range(modes, len(reduced.mass))]
    both = np.ix_(keep, keep)
    return Reduced(
        reduced.mass[both], reduced.stiffness[both], reduced.coupling[keep], reduced.ports[:, keep]
    )


def effective(reduced: Reduced) -> Array:
    """Effective mass (r,) of all modes in each direction: the diagonal of P M^-1 P'."""
    scale = 1.0 / np.sqrt(np.diag(reduced.mass))
    coupling = scale[:, None] * reduced.coupling
    solved = np.linalg.solve(reduced.mass * np.outer(scale, scale), coupling)
    return np.asarray(np.einsum("qr,qr->r", coupling, solved))


def _until(candidates: Candidates, enough: Callable[[Modes], bool]) -> Modes:
    """Modes that are `enough`, or all modes; their number is doubled as long as they are not enough."""
    count = _FIRST
    while True:
        modes = candidates.modes(count)
        if modes.complete or not len(modes) or enough(modes):
            return modes
        count *= 2


def _by_mass(candidates: Candidates, fraction: float, rigid: Array) -> tuple[int, Reduced]:
    """The fewest modes whose effective mass is this fraction of `rigid` (r,), and their matrices."""
    has_mass = rigid > NO_MASS * np.max(rigid)

    def enough(reduced: Reduced) -> bool:
        if not len(reduced.mass):
            return False
        return bool(np.all(effective(reduced)[has_mass] >= fraction * rigid[has_mass]))

    modes = _until(candidates, lambda modes: len(modes) >= _MOST or enough(candidates.reduce(modes)))
    total = candidates.reduce(modes)

    def with_first(count: int) -> Reduced:
        if candidates.corrects:
            return candidates.reduce(first(modes, count))
        return _with_first(total, len(modes), count)

    if not enough(total):
        reached = np.min(effective(total)[has_mass] / rigid[has_mass])
        raise StructureError(
            f"effective_mass: {fraction:g} is asked for; {len(modes)} modes have {reached:.4g} of "
            "the rigid mass in the direction that has least. What moves with the parent is in no "
            "mode; ask for less, or refine the mesh."
        )
    low, high = -1, len(modes)  # bisection: the effective mass never falls with the number of modes
    while high - low > 1:
        middle = (low + high) // 2
        if enough(with_first(middle)):
            high = middle
        else:
            low = middle
    return high, with_first(high)
