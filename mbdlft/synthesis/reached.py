"""What values of controllers reach: at the points they were tuned on, in the box, and proved on it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.parameter import to_physical
from mbdlft.robust.bisect.search import INTERRUPTED
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.worst import worst_case
from mbdlft.synthesis.bound import full_order_bound
from mbdlft.synthesis.goals import DESIGN, H2, HINF, MARGIN, POLES, Goal
from mbdlft.synthesis.loop import Network, closed_loop, screened
from mbdlft.synthesis.pieces import TunableSystem, tunable_gain
from mbdlft.synthesis.tuning import Tuner
from mbdlft.system.model import System

_REACHED = 1.0 + 1e-3  # what is said to be reached: hard goals are constraints of a search
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Reached:
    """What a goal came to; values are at most 1 where it is reached.

    Attributes
    ----------
    goal : Goal
    tuned : float, the largest at the points that it was tuned on
    worst : float, the largest that was found in the box
    proved : float
        Not passed for all values of the parameters and all frequencies; inf without a proof.
    least : float
        No controller of any order, with these measurements, has a smaller value at the nominal point;
        0.0 if not known.
    loop : System
        From the weighted inputs to the weighted outputs of the goal.
    bounds : tuple of Bounds
        With the proofs; `verify(loop, bounds)` checks one.
    """

    goal: Goal
    tuned: float
    worst: float
    proved: float
    least: float
    loop: System
    bounds: tuple[Bounds, ...]

    @property
    def found(self) -> str:
        """What searches came to: all that an archive says, as proofs are checked when they are read."""
        kind = "hard" if self.goal.hard else "soft"
        return f"{self.goal.name} ({kind}): tuned {self.tuned:.4g}, worst found {self.worst:.4g}"

    @property
    def is_reached(self) -> bool:
        """Whether the worst value that was found is at most 1, or it is soft and finite."""
        return self.worst <= _REACHED if self.goal.hard else np.isfinite(self.worst)

    @property
    def missing(self) -> str:
        """What is not reached, or, of a hard goal, not proved to be below 1; else empty."""
        about = f"{'hard ' * self.goal.hard}goal {self.goal.name!r}"
        if not np.isfinite(self.worst):
            place = self.bounds[0].worst if self.bounds else {}
            point = ", ".join(f"{name} {value:.6g}" for name, value in (place or {}).items())
            return f"{about}: the loop is unstable{point and ' at '}{point}"
        if not self.is_reached:
            return f"{about}: not reached, {self.worst:.6g} > 1"
        if not (self.goal.hard and self.bounds) or self.proved <= 1.0:
            return ""
        ends = f"proved {self.proved:.4g}" if np.isfinite(self.proved) else "no proof"
        return f"{about}: reached {self.worst:.4g}, {ends}: it is not proved below 1"

    def __str__(self) -> str:
        text = self.found
        if np.isfinite(self.proved):
            text += f", proved <= {self.proved:.4g} for all values and frequencies"
        elif self.bounds:
            text += f", not proved: {self.bounds[0].reason}"
        return text + (f"; no controller below {self.least:.4g}" if self.least else "")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tuning:
    """Controllers, and what is known of their loops.

    Attributes
    ----------
    controllers : tuple of System
    values : mapping of names of free values to numbers; design parameters in their units
    goals : tuple of Reached
    points : tuple of mappings of names to values
        Of the parameters, where the loop was tuned: the nominal point, and worst ones.
    loop : System
        Closed, from the inputs of all goals to their outputs, without weights.
    """

    controllers: tuple[System, ...]
    values: Mapping[str, float]
    goals: tuple[Reached, ...]
    points: tuple[Mapping[str, float], ...]
    loop: System

    @property
    def soft(self) -> float:
        """The largest value of a soft goal that was found in the box; 0 if there is none."""
        return max((r.worst for r in self.goals if not r.goal.hard), default=0.0)

    @property
    def hard(self) -> float:
        """The same of hard goals, which are reached where it is at most 1."""
        return max((r.worst for r in self.goals if r.goal.hard), default=0.0)

    @property
    def missing(self) -> tuple[str, ...]:
        """What hard goals lack, reached or proved, and goals whose loops are unstable; else empty."""
        return tuple(sentence for reached in self.goals if (sentence := reached.missing))

    def __repr__(self) -> str:
        return "\n".join((*map(str, self.goals), *self.missing))


def as_tuning(
    net: Network,
    goals: Sequence[Goal],
    x: Array,
    points: Array,
    least: Sequence[float],
    how: Mapping[str, Any] | None,
    say: Progress = lambda text: None,
) -> Tuning:
    """What values reach: at points, in the box, and proved on it if it is said `how`, until Ctrl-C."""
    reached = []
    for goal, bound in zip(goals, least, strict=True):
        try:
            if how is not None:
                say(f"proof of {goal.name}")
            reached.append(_reached(net, goal, x, points, bound, how))
        except KeyboardInterrupt:
            if how is None:
                raise
            how = None
            reached.append(_reached(net, goal, x, points, bound, how))
        if any(b.reason == INTERRUPTED for b in reached[-1].bounds):
            how = None
    values = _values(net, x)
    controllers = tuple(c.with_values({v.name: values[v.name] for v in c.free}) for c in net.controllers)
    has_channels = net.inputs and net.outputs  # goals of poles name none
    whole = Goal(HINF, "loop", net.inputs, net.outputs) if has_channels else None
    loop = closed_loop(net, whole, x, net.system.name)
    physical = tuple(_physical(net, point) for point in points)
    return Tuning(controllers, values, tuple(reached), physical, loop)


def _values(net: Network, x: Array) -> dict[str, float]:
    return {
        value.name: net.design[value.name].physical(number) if value.name in net.design else float(number)
        for value, number in zip(net.free, x, strict=True)
    }


def _physical(net: Network, point: Array) -> dict[str, float]:
    return {p.name: float(to_physical(p, d)) for p, d in zip(net.system.parameters, point, strict=True)}


def _reached(
    net: Network, goal: Goal, x: Array, points: Array, least: float, how: Mapping[str, Any] | None
) -> Reached:
    """A goal at values: at the points, in the box, and proved."""
    loop = closed_loop(
        net, None if goal.kind in (POLES, DESIGN) else goal, x, f"{net.system.name}: {goal.name}"
    )
    (tuned_to, _), (found, _) = (
        Tuner(net, [goal], some).worst(x)[0] for some in (points, screened(np.ones(points.shape[1]), 0))
    )
    worst, proved = max(tuned_to, found), np.inf
    if goal.kind == DESIGN:  # nothing else than the values is in it
        return Reached(goal, worst, worst, worst, least, loop, ())
    bounds = () if how is None else tuple(_bounds(loop, goal, how))
    if bounds:
        claimed, attained = zip(*(_ratios(goal, b) for b in bounds), strict=True)
        worst = max(worst, *attained)
        proved = max(claimed) if np.isinf(goal.speed) else np.inf
    return Reached(goal, tuned_to, worst, proved, least, loop, bounds)


def as_matrices(systems: Sequence[Any]) -> list[Any]:
    """Systems with matrices in place of controllers with free values."""
    return [tunable_gain(s.name, *s.channels) if isinstance(s, TunableSystem) else s for s in systems]


def least_values(
    net: Network, goals: Sequence[Goal], with_matrices: Callable[[], Network]
) -> list[float]:
    """What no controllers with the same measurements pass at nominal; 0 where that is not known."""
    if net.design:
        return [0.0] * len(goals)
    opened = with_matrices()
    return [full_order_bound(opened, [g]) if g.kind in (HINF, MARGIN) else 0.0 for g in goals]


def _bounds(loop: System, goal: Goal, how: Mapping[str, Any]) -> list[Bounds]:
    if goal.kind in (HINF, MARGIN):
        return [worst_case_gain(loop, **how)]
    if goal.kind == H2:
        return [worst_case(loop, "H2 norm", **how)]
    asked = {"real part": goal.decay, "damping": goal.damping}
    return [worst_case(loop, what, **how) for what, number in asked.items() if number]


def _ratios(goal: Goal, bounds: Bounds) -> tuple[float, float]:
    """The value that is proved, and that which is reached."""
    if goal.kind in (HINF, MARGIN, H2):
        ends = bounds.upper / goal.limit, bounds.lower / goal.limit
    elif bounds.is_from_above:
        ends = _over(goal.decay, -bounds.upper), _over(goal.decay, -bounds.lower)
    else:
        ends = _over(goal.damping, bounds.lower), _over(goal.damping, bounds.upper)
    return (ends[0] if bounds.proved else np.inf), ends[1]


def _over(wanted: float, has: float) -> float:
    return wanted / has if has > 0.0 else np.inf
