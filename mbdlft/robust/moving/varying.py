"""Margins and gains for parameters that move: any motion, or with bounded rates.

What is proved rests on a quadratic form (`mbdlft.robust.moving.variation`); what bounds a margin from
above are constant values, or a periodic motion that does not come to rest
(`mbdlft.robust.moving.motion`). The LFT is taken with Delta(t) in the place of Delta.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, isinf
from typing import NamedTuple

import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, check_known
from mbdlft.base.parameter import Parameter, internal_slope
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.bisect.search import INTERRUPTED, Asked, Search, State, last_of, settled
from mbdlft.robust.evidence import Bounds, MotionProof, PolynomialProof, ProofOfMotions
from mbdlft.robust.moving import polynomial, variation
from mbdlft.robust.moving.motion import NONE, Motion, unstable_motion
from mbdlft.robust.moving.polynomial import SHAPES, Shape
from mbdlft.robust.realization import modal, turned
from mbdlft.system.model import System

Rates = float | Mapping[str, float] | None
_OUTSIDE = 1.0 + 1e-12  # a bound of a rate is not below it, however that was rounded
_LEAST = 1e-3  # of the other bound: margins below this are not looked for
_HALVINGS = 10  # of a box around nominal
_MOTIONS = 0.2  # of the work
_FACTOR = 1.25  # of a bound of a gain that is tried after one that was not proved
_SOLUTIONS = 2.0  # of a shape of forms that there should be work for
_MOST = 1e3  # times the gain of constant parameters: larger bounds are not looked for


def rates_of(system: System, rates: Rates, what: str) -> dict[str, float]:
    """Bounds of rates by name, in the units of the parameters per second, without those that are 0.

    Gains in the place of nonlinear functions move in any way, whatever is given.
    """
    names = list(system.parameters.names)
    bounds = {} if rates is None else rates
    bounds = dict(bounds) if isinstance(bounds, Mapping) else dict.fromkeys(names, bounds)
    for name, rate in bounds.items():
        where = f"{what}: rates of model {system.name!r}"
        check_known("parameter", [name], names, where, AnalysisError)
        is_number = isinstance(rate, int | float) and not isinstance(rate, bool)
        if not (is_number and rate >= 0.0):
            raise AnalysisError(
                f"{what}: the rate of {name}: expected a bound in {system.parameters[name].unit} per "
                f"second, 0 for a constant or inf for any motion, got {rate!r}."
            )
    bounds |= {p.name: inf for p in system.parameters if p.role == "nonlinear"}
    return {name: float(bounds[name]) for name in names if bounds.get(name, 0.0)}


def delta_rates(
    system: System, names: Sequence[str], rates: Mapping[str, float], k: float, *, allowed: bool = False
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


class _Question(NamedTuple):
    """What is asked for of parameters that move."""

    asked: Asked
    model: Realization
    rates: Mapping[str, float]  # bounds by name
    constant: Bounds  # for constant parameters

    def polynomial(self, k: float, shape: Shape) -> PolynomialProof | None:
        """A proof by a polynomial V for deltas in [-k, k], None if none is found."""
        rates = delta_rates(self.asked.system, self.model.names, self.rates, k)
        proof = polynomial.solved(self.model, modal(self.model).states, rates, k, shape)
        return proof if proof and not polynomial.wrong_in(self.model, rates, k, proof) else None

    def proof_of(self, k: float, gain: float = 0.0) -> tuple[MotionProof | None, float]:
        """A proof for deltas in [-k, k], None if none is found; and units of work."""
        states, _, channels, time = modal(self.model)
        model, bounds, near, (u, y) = self._near(k, gain)
        form = variation.form_of(near, bounds)
        unknowns = variation.solved(form, variation.sizes_of(form, k, bounds), len(near.A), gain * u * y)
        if unknowns is None:
            return None, variation.cost_of(form)
        P, X, Y = (matrix / y**2 for matrix in unknowns[:3])
        proof = MotionProof(P, X, Y, states, channels, time)
        return None if _wrong(model, bounds, k, gain, proof) else proof, variation.cost_of(form)

    def ball(self, most: float) -> tuple[float, MotionProof | None]:
        """A size up to `most` that a constant form proves, without a search for one; and its proof."""
        states, _, channels, time = modal(self.model)
        _, bounds, near, _ = self._near(_LEAST, 0.0)
        form = variation.form_of(near, bounds)
        P, X, Y, size = variation.around_nominal(form, near.A, near.B, bounds)
        proof, size = MotionProof(P, X, Y, states, channels, time), min(size, most)
        for k in size * 0.5 ** np.arange(_HALVINGS):
            model, bounds, *_ = self._near(k, 0.0)
            if not _wrong(model, bounds, k, 0.0, proof):
                return float(k), proof
        return 0.0, None

    def least(self, gain: float) -> tuple[float, float]:
        """Nearly the least gain that can be proved, of the size of a gain, inf if none; units of work."""
        _, bounds, near, (u, y) = self._near(1.0, gain)
        form = variation.form_of(near, bounds)
        return variation.least_gain(form, variation.sizes_of(form, 1.0, bounds), len(near.A)) / (
            u * y
        ), variation.cost_of(form)

    def _near(self, k: float, gain: float) -> tuple[Realization, Array, Realization, tuple[float, float]]:
        """The model, rates of its deltas, the model near to 1 in size, and powers of two of u and y."""
        states, back, channels, time = modal(self.model)
        model = variation.scaled(self.model if gain else _alone(self.model), channels, time)
        bounds = delta_rates(self.asked.system, model.names, self.rates, k) / time
        near = turned(model, states, back)
        u, y = _powers(near, gain)
        near = near._replace(E=near.E * u, F=near.F * u, G=near.G * y, H=near.H * y, J=near.J * (u * y))
        return model, bounds, near, (u, y)

    def motion(self, most: float) -> Motion:
        """The smallest motion found with |delta| <= most that does not come to rest."""

        def allowed(k: float) -> Array:
            names = self.model.names
            return delta_rates(self.asked.system, names, self.rates, k, allowed=True)

        return unstable_motion(self.model, allowed, most, _MOTIONS * self.asked.work)

    def shapes(self) -> tuple[Shape, ...]:
        """Shapes of polynomials that prove more; none where a region of states is asked for."""
        is_loop = any(p.role == "nonlinear" for p in self.asked.system.parameters)
        return () if is_loop else SHAPES

    def cost(self, shape: Shape | None) -> float:
        """Units of work of one solution."""
        rates = delta_rates(self.asked.system, self.model.names, self.rates, 1.0)
        if shape:
            return polynomial.cost_of(self.model, rates, shape)
        return variation.cost_of(variation.form_of(self.model, rates))

    def too_dear(self) -> str:
        """Why the inequality cannot be solved with the work; empty if it can."""
        bounds = delta_rates(self.asked.system, self.model.names, self.rates, 0.0)
        form = variation.form_of(self.model, bounds)
        signals, cost = form.V.shape[1], variation.cost_of(form)
        if cost <= self.asked.work:
            return ""
        return (
            f"a matrix inequality of {len(self.model.A)} states and {signals} signals in all costs "
            f"{cost:.3g} units of work, more than the {self.asked.work:g} that are given. Give more, or "
            "take parameters that hardly move as constant, or those that move fast as moving in any way"
        )

    def bounds(self, state: State[Motion], *, is_open: bool) -> Bounds:
        """The result; without a motion, the worst case is that of constant values."""
        why = state.reason or self.constant.reason
        bounds = replace(
            self.constant,
            lower=state.lower,
            upper=state.upper,
            proof=state.proof,
            work=self.constant.work + state.used,
            reason=(why or "no more is proved by forms of these kinds") if is_open else "",
            rates=self.rates,
        )
        motion = state.worst
        if np.isinf(motion.size):
            return bounds
        count = len(motion.deltas)
        times = motion.period * (np.arange(count) + 0.5) / count
        extent = np.max(np.abs(motion.deltas), axis=0).tolist()
        return replace(
            bounds,
            motion=np.hstack([times[:, None], motion.deltas]),
            worst={},
            delta=dict(zip(self.model.names, extent, strict=True)),
            frequency=2.0 * np.pi / motion.period,
            sensitivity={},
        )


def _alone(model: Realization) -> Realization:
    """The model without inputs and outputs."""
    n, r = model.B.shape
    none = np.zeros
    return model._replace(E=none((n, 0)), F=none((r, 0)), G=none((0, n)), H=none((0, r)), J=none((0, 0)))


def _powers(model: Realization, gain: float) -> tuple[float, float]:
    """Powers of two for inputs and outputs: with them E is near 1, and the gain, too."""
    largest = float(np.max(np.abs(model.E), initial=0.0))
    if not gain or largest == 0.0:
        return 1.0, 1.0
    u = 2.0 ** -np.round(np.log2(largest))
    return float(u), float(2.0 ** -np.round(np.log2(gain * u)))


def moving_margin(
    asked: Asked, model: Realization, rates: Mapping[str, float], constant: Bounds
) -> Bounds:
    """Bounds of the margin of parameters that move, given those of constant ones."""
    question = _Question(asked, model, rates, constant)
    state = _unless_ended(question, State(NONE, upper=constant.upper), _margins(question))

    def bounds() -> Bounds:
        last = state
        if last.proof is None:
            lower, proof = question.ball(min(last.upper, asked.largest))
            last = last._replace(lower=lower, proof=proof)
        return question.bounds(last, is_open=last.lower < last.upper * (1.0 - asked.gap))

    return settled(bounds)


def _unless_ended(question: _Question, start: State[Motion], search: Search[Motion]) -> State[Motion]:
    """The last state of a search; the first one if constant values were not looked at to the end."""
    if question.constant.reason == INTERRUPTED:
        return start._replace(reason=INTERRUPTED)
    return last_of(question.asked, start, search)


def _margins(question: _Question) -> Search[Motion]:
    asked, state = question.asked, State(NONE, upper=question.constant.upper)
    motion = question.motion(min(state.upper, asked.largest))
    if motion.size < state.upper:
        state = state._replace(worst=motion, upper=motion.size)
    yield state
    reason = question.too_dear()
    if reason:
        return state._replace(reason=reason)
    for shape in (None, *question.shapes()):
        if shape is None or _SOLUTIONS * question.cost(shape) <= state.left(asked):
            state = yield from _with_shape(question, state, shape)
        if state.is_closed(asked):
            break
    return state


def _with_shape(question: _Question, state: State[Motion], shape: Shape | None) -> Search[Motion]:
    """A margin by forms of a shape: a box that is proved, and none that is larger by the gap."""
    asked, most = question.asked, min(state.upper, question.asked.largest)
    # the smallest size that was not proved; of a shape after another one, what is reached
    resisted, state = most if state.lower else inf, state._replace(reason="")
    cost, goal = question.cost(shape), most * (1.0 - asked.gap)
    while state.lower < min(resisted * (1.0 - 0.5 * asked.gap), goal):
        k = min(most * (1.0 - 0.5 * asked.gap), 0.5 * (state.lower + resisted))
        if goal < resisted and abs(k - goal) < 0.5 * asked.gap * goal:
            k = goal  # what is asked for decides
        if cost > state.left(asked):
            return state.spent(asked)
        if k < _LEAST * most:
            return state._replace(reason=f"no form was found for {resisted:.3g} times the box")
        proof = question.polynomial(k, shape) if shape else question.proof_of(k)[0]
        state = state._replace(used=state.used + cost)
        if proof is None:
            resisted = k
        else:
            state = state._replace(lower=k, proof=proof)
        yield state
    return state


def moving_gain(asked: Asked, model: Realization, rates: Mapping[str, float], constant: Bounds) -> Bounds:
    """Bounds of the energy gain of parameters that move in the box, given those of constant ones."""
    question = _Question(asked, model, rates, constant)
    state = _unless_ended(question, State(NONE, constant.lower), _gains(question))
    is_open = isinf(state.lower) or not state.upper * (1.0 - asked.gap) <= state.lower
    return question.bounds(state, is_open=is_open)


def _gains(question: _Question) -> Search[Motion]:
    asked, state = question.asked, State(NONE, question.constant.lower)
    if isinf(state.lower):
        return state
    yield state
    motion = question.motion(1.0)
    if motion.size <= 1.0:
        why = "the system is unstable at a motion"
        return state._replace(worst=motion, lower=inf, reason=why)
    reason = question.too_dear()
    if reason:
        return state._replace(reason=reason)
    proof, cost = question.proof_of(1.0)
    state = state._replace(used=state.used + cost)
    if proof is None:
        why = "for these rates stability of the whole box is not proved"
        return state._replace(reason=why)
    low, factor = state.lower, 1.0 + 0.5 * asked.gap  # no gain below `low` is expected to be proved
    if low > 0.0:
        estimate, cost = question.least(low)
        state = state._replace(used=state.used + cost)
        low = max(low, estimate) if np.isfinite(estimate) else low
    while 0.0 < low < state.upper * (1.0 - asked.gap):
        goal = low * factor if isinf(state.upper) else float(np.sqrt(low * state.upper))
        if not state.left(asked) or goal > _MOST * state.lower:
            reason = state.reason or f"no bound below {goal:.3g} was found with this work"
            return state._replace(reason=reason)
        proof, cost = question.proof_of(1.0, goal)
        state = state._replace(used=state.used + cost)
        if proof is None:
            low, factor = goal, max(factor * factor, _FACTOR)
        else:
            state = state._replace(proof=proof, upper=goal)
        yield state
    return state


def checked(
    system: System,
    model: Realization,
    rates: Mapping[str, float],
    k: float,
    gain: float,
    proof: ProofOfMotions,
) -> str:
    """What is wrong with a proof for deltas in [-k, k] that move; empty if it is one."""
    if isinstance(proof, PolynomialProof):
        rates_of_deltas = delta_rates(system, model.names, rates, k)
        return "it proves no gain" if gain else polynomial.wrong_in(model, rates_of_deltas, k, proof)
    for powers, size in ((proof.channels, len(model.D)), (np.array([proof.time]), 1)):
        if powers.shape != (size,) or not np.all(np.frexp(powers)[0] == 0.5):
            return "its scales are not powers of two for each channel"
    if proof.states.shape != model.A.shape or not np.all(np.isfinite(proof.states)):
        return "its states are not those of the system"
    bounds = delta_rates(system, model.names, rates, k) / proof.time
    return _wrong(variation.scaled(model, proof.channels, proof.time), bounds, k, gain, proof)


def _wrong(model: Realization, bounds: Array, k: float, gain: float, proof: MotionProof) -> str:
    """As `checked`, of a model in the scales of a proof, with bounds of the rates of its deltas."""
    with flint.ctx.workprec(variation.BITS):
        form = variation.form_of(model, bounds)
        if not variation.is_structured(form, proof.P, proof.X, proof.Y):
            return "its matrices are not of the structure of Delta"
        if not variation.is_negative(
            form, variation.sizes_of(form, k, bounds), gain, proof.states, proof.P, proof.X, proof.Y
        ):
            return f"its form is not negative for {k:g} times the box"
    return ""
