"""Margins and gains for parameters that move: any motion, or with bounded rates.

What is proved rests on a quadratic form (`mbdlft.robust.moving.variation`); what bounds a margin from
above are constant values, or a periodic motion that does not come to rest
(`mbdlft.robust.moving.motion`). The LFT is taken with Delta(t) in the place of Delta.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isinf

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, unknown_name
from mbdlft.base.parameter import Parameter, internal_slope
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.bisect.search import Search
from mbdlft.robust.evidence import Bounds, MotionProof
from mbdlft.robust.moving.motion import NONE, Motion, unstable_motion
from mbdlft.robust.moving.variation import (
    Unknowns,
    cost_of,
    form_of,
    is_negative,
    is_structured,
    least_gain,
    scaled,
    sizes_of,
    solved,
)
from mbdlft.robust.realization import modal, turned
from mbdlft.system.model import System

Rates = float | Mapping[str, float] | None
_OUTSIDE = 1.0 + 1e-12  # a bound of a rate is not below it, however that was rounded
_LEAST = 1e-3  # of the other bound: margins below this are not looked for
_MOTIONS = 0.2  # of the work
_FACTOR = 1.25  # of a bound of a gain that is tried after one that was not proved
_MOST = 1e3  # times the gain of constant parameters: larger bounds are not looked for


def rates_of(system: System, rates: Rates, what: str) -> dict[str, float]:
    """Bounds of rates by name, in the units of the parameters per second, without those that are 0.

    Gains in the place of nonlinear functions move in any way, whatever is given.

    Raises
    ------
    AnalysisError
        A name is unknown, or a bound is negative or no number.
    """
    names = list(system.parameters.names)
    given = {} if rates is None else rates
    given = dict(given) if isinstance(given, Mapping) else dict.fromkeys(names, given)
    for name, rate in given.items():
        if name not in names:
            raise AnalysisError(
                f"{what}: rates of model {system.name!r}: {unknown_name('parameter', name, names)}"
            )
        is_number = isinstance(rate, int | float) and not isinstance(rate, bool)
        if not (is_number and rate >= 0.0):
            raise AnalysisError(
                f"{what}: the rate of {name}: expected a bound in {system.parameters[name].unit} per "
                f"second, 0 for a constant or inf for any motion, got {rate!r}."
            )
    given |= {p.name: inf for p in system.parameters if p.role == "nonlinear"}
    return {name: float(given[name]) for name in names if given.get(name, 0.0)}


def delta_rates(
    system: System,
    names: Sequence[str],
    rates: Mapping[str, float],
    k: float,
    *,
    allowed: bool = False,
) -> Array:
    """Bounds of the rates of deltas (1/s) while |delta| <= k, of those of physical values.

    With `allowed`, rates that are not too fast anywhere in the box.
    """
    known = {p.name: p for p in system.parameters}
    which = 0 if allowed else 1
    return np.array([_ends_of_rate(known[name], rates.get(name, 0.0), k)[which] for name in names])


def _ends_of_rate(p: Parameter, rate: float, k: float) -> tuple[float, float]:
    """The least and the largest rate of a delta on the box that belong to a rate of the value.

    delta = d/(gain - a1 d), d = internal - b0: its slope is (1 + a1 delta)^2/gain.
    """
    if rate == 0.0 or isinf(rate):
        return rate, rate
    m, most = p.map, abs(p.map.a1) * k
    if most >= 1.0:  # the map is singular on the way there
        return 0.0, inf
    ends = [m.b0 + m.gain * d / (1.0 + m.a1 * d) for d in (-k, k)]
    nearest = 0.0 if min(ends) <= 0.0 <= max(ends) else min(ends, key=abs)
    slow = rate * (1.0 - most) ** 2 / abs(m.gain) * internal_slope(p, nearest)
    fast = rate * (1.0 + most) ** 2 / abs(m.gain) * internal_slope(p, max(ends, key=abs))
    return slow / _OUTSIDE, fast * _OUTSIDE


@dataclass(slots=True)
class _MotionSearch(Search):
    """Bounds for parameters that move, of those of constant ones.

    Attributes
    ----------
    model : Realization
    rates : mapping of names to bounds
    constant : Bounds
    signals : names of inputs and outputs of a gain
    motion : Motion
        One that does not come to rest, if it is smaller than constant values that are unstable.

    A search overrides `is_open`, too: whether the gap is larger than what was asked for.
    """

    model: Realization = field(kw_only=True)
    rates: Mapping[str, float] = field(kw_only=True)
    constant: Bounds = field(kw_only=True)
    signals: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    motion: Motion = NONE

    def proof_of(self, k: float, gain: float = 0.0) -> MotionProof | None:
        """A proof for deltas in [-k, k]; None if none is found."""
        states, _, channels, time = modal(self.model)
        model, bounds, near, (u, y) = self._near(k, gain)
        form = form_of(model, bounds)
        self.used += cost_of(form)
        sizes = sizes_of(form, k, bounds)
        found = solved(form_of(near, bounds), sizes, len(model.A), gain * u * y)
        if found is not None:
            found = Unknowns(found.P / y**2, found.X / y**2, found.Y / y**2, found.t)
        if found is None or not is_negative(form, sizes, gain, states, *found[:3]):
            return None
        return MotionProof(
            k, found.P, found.X, found.Y, states, channels, time, gain, *self.signals
        )

    def least(self, gain: float) -> float:
        """Nearly the least gain that can be proved, of the size of a gain; inf if none was found."""
        _, bounds, near, (u, y) = self._near(1.0, gain)
        form = form_of(near, bounds)
        self.used += cost_of(form)
        return least_gain(form, sizes_of(form, 1.0, bounds), len(near.A)) / (u * y)

    def _near(
        self, k: float, gain: float
    ) -> tuple[Realization, Array, Realization, tuple[float, float]]:
        """The model, rates of its deltas, the model near to 1 in size, and powers of two of u and y."""
        states, back, channels, time = modal(self.model)
        model = scaled(self.model if gain else _alone(self.model), channels, time)
        bounds = delta_rates(self.asked.system, model.names, self.rates, k) / time
        near = turned(model, states, back)
        u, y = _powers(near, gain)
        near = near._replace(
            E=near.E * u, F=near.F * u, G=near.G * y, H=near.H * y, J=near.J * (u * y)
        )
        return model, bounds, near, (u, y)

    def looked(self, most: float) -> Motion:
        """The smallest motion found with |delta| <= most that does not come to rest."""

        def allowed(k: float) -> Array:
            names = self.model.names
            return delta_rates(self.asked.system, names, self.rates, k, allowed=True)

        return unstable_motion(self.model, allowed, most, _MOTIONS * self.asked.work)

    def is_carried(self) -> bool:
        """Whether the inequality can be solved with the work; the reason says why not."""
        bounds = delta_rates(self.asked.system, self.model.names, self.rates, 0.0)
        form = form_of(self.model, bounds)
        entries, cost = form.V.shape[1], cost_of(form)
        if cost <= self.asked.work:
            return True
        self.reason = (
            f"a matrix inequality of {len(self.model.A)} states and {entries} signals in all costs "
            f"{cost:.3g} units of work, more than the {self.asked.work:g} that are given. Give more, or "
            "take parameters that hardly move as constant, or those that move fast as moving in any way"
        )
        return False

    @property
    def is_open(self) -> bool:
        raise NotImplementedError

    def answer(self) -> Bounds:
        """The result; without a motion, the worst case is that of constant values."""
        why = self.reason or self.constant.reason
        found = replace(
            self.constant,
            lower=self.lower,
            upper=self.upper,
            proved=self.proof is not None,
            proof=self.proof,
            work=self.constant.work + self.used,
            reason=(why or "no more is proved by a quadratic form of this kind")
            if self.is_open
            else "",
            rates=self.rates,
        )
        if np.isinf(self.motion.size):
            return found
        count = len(self.motion.deltas)
        times = self.motion.period * (np.arange(count) + 0.5) / count
        extent = np.max(np.abs(self.motion.deltas), axis=0).tolist()
        return replace(
            found,
            motion=np.hstack([times[:, None], self.motion.deltas]),
            worst={},
            delta=dict(zip(self.model.names, extent, strict=True)),
            frequency=2.0 * np.pi / self.motion.period,
            sensitivity={},
        )


def _alone(model: Realization) -> Realization:
    """The model without inputs and outputs."""
    return model._replace(
        E=model.E[:, :0], F=model.F[:, :0], G=model.G[:0], H=model.H[:0], J=model.J[:0, :0]
    )


def _powers(model: Realization, gain: float) -> tuple[float, float]:
    """Powers of two for inputs and outputs: with them E is near 1, and the gain, too."""
    largest = float(np.max(np.abs(model.E), initial=0.0))
    if not gain or largest == 0.0:
        return 1.0, 1.0
    u = 2.0 ** -np.round(np.log2(largest))
    return float(u), float(2.0 ** -np.round(np.log2(gain * u)))


@dataclass(slots=True)
class MovingMargin(_MotionSearch):
    """The margin of parameters that move."""

    def search(self) -> None:
        largest, gap = self.asked.largest, self.asked.gap
        self.upper = self.constant.upper
        motion = self.looked(min(self.upper, largest))
        if motion.size < self.upper:
            self.upper, self.motion = motion.size, motion
        self.told()
        most = min(self.upper, largest)
        high = np.inf  # a size that was not proved
        while self.is_carried() and self.lower < min(high, most) * (1.0 - gap):
            k = min(most * (1.0 - 0.5 * gap), 0.5 * (self.lower + high))
            if not self.left:
                self.reason = self.used_up()
                return
            if k < _LEAST * most:
                self.reason = f"no quadratic form was found for {high:.3g} times the box"
                return
            found = self.proof_of(k)
            if found is None:
                high = k
            else:
                self.lower, self.proof = k, found
            self.told()

    @property
    def is_open(self) -> bool:
        return self.lower < self.upper * (1.0 - self.asked.gap)


@dataclass(slots=True)
class MovingGain(_MotionSearch):
    """The energy gain of parameters that move in the box."""

    def search(self) -> None:
        gap, self.lower = self.asked.gap, self.constant.lower
        low, factor = self.lower, 1.0 + 0.5 * gap
        motion = self.looked(1.0) if np.isfinite(low) else NONE
        if motion.size <= 1.0:
            self.reason = "the system is unstable at a motion"
            self.lower, self.motion = inf, motion
            return
        if np.isfinite(low) and self.is_carried() and not self.proof_of(1.0):
            low = inf
            self.reason = "for these rates stability of the whole box is not proved"
        elif np.isfinite(low) and low > 0.0 and self.is_carried():
            estimate = self.least(low)
            low = max(low, estimate) if np.isfinite(estimate) else low
        while 0.0 < low < self.upper * (1.0 - gap) and np.isfinite(low) and self.is_carried():
            goal = low * factor if isinf(self.upper) else float(np.sqrt(low * self.upper))
            if not self.left or goal > _MOST * self.lower:
                self.reason = self.reason or f"no bound below {goal:.3g} was found with this work"
                return
            found = self.proof_of(1.0, goal)
            if found:
                self.proof, self.upper = found, goal * _OUTSIDE
            else:
                low, factor = goal, max(factor * factor, _FACTOR)
            self.told()

    @property
    def is_open(self) -> bool:
        return isinf(self.lower) or not self.upper * (1.0 - self.asked.gap) <= self.lower


def checked(
    system: System, model: Realization, rates: Mapping[str, float], proof: MotionProof
) -> str:
    """What is wrong with a proof for parameters that move; empty if it is one."""
    for part, size in ((proof.channels, len(model.D)), (np.array([proof.time]), 1)):
        if part.shape != (size,) or not np.all(np.frexp(part)[0] == 0.5):
            return "its scales are not powers of two for each channel"
    if proof.states.shape != model.A.shape or not np.all(np.isfinite(proof.states)):
        return "its states are not those of the system"
    scaled_model = scaled(model, proof.channels, proof.time)
    bounds = delta_rates(system, model.names, rates, proof.k) / proof.time
    form = form_of(scaled_model, bounds)
    if not is_structured(form, proof.P, proof.X, proof.Y):
        return "its matrices are not of the structure of Delta"
    matrices = proof.states, proof.P, proof.X, proof.Y
    if not is_negative(form, sizes_of(form, proof.k, bounds), proof.gain, *matrices):
        return f"its form is not negative for {proof.k:g} times the box"
    return ""
