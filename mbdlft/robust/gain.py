"""Worst-case gain and robust performance: bounds for all frequencies and all values of the parameters.

The worst-case gain is the largest H-infinity norm of a transfer over the declared box. It is bounded from
below by the gain at deltas that an ascent with exact slopes finds, and from above by a proof
(`mbdlft.robust.bisect.boxes`). The margin of robust performance is the largest k for which the gain on
the box of size k is at most 1/k: then weights say what is asked for.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.running import one_thread
from mbdlft.robust.ascent import NOTHING, Peak, largest_peak, peak_at, slope_at, smallest_crossing
from mbdlft.robust.bisect import search
from mbdlft.robust.bisect.characteristic import Polynomials, Realization
from mbdlft.robust.evidence import GAIN, PERFORMANCE, Bounds, one_over
from mbdlft.robust.moving.varying import Rates, moving_gain, rates_of
from mbdlft.robust.mu.coverage import GAIN as GAIN_BLOCK
from mbdlft.robust.mu.coverage import Loop, loop_of
from mbdlft.robust.mu.mixed import by_multipliers, with_ball
from mbdlft.robust.realization import (
    check_constant,
    left_out,
    realization,
    stable_states,
    states_that_stay,
)
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

_BISECTIONS = 40  # of the margin that is reached: more than its gap ever needs
_SHARE = 0.5  # of the work that is left, for one level
_ZERO = 1e-300  # a gain that is proved to be smaller is not looked at any more


@arguments_checked
def worst_case_gain(
    system: System,
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    gap: float = search.GAP,
    work: float = search.WORK,
    rates: Rates = None,
    leave_out: Sequence[str] = (),
    progress: search.Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
) -> Bounds:
    """Bounds of the largest H-infinity norm from inputs to outputs over the declared box.

    With `rates`, `upper` is a bound of the root of the energy of the outputs over that of the inputs,
    from rest, for all motions of the parameters in the box that are not faster.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable.
    inputs, outputs : name, number, slice, or list of these, optional
        Signals of the transfer; all, if not given. The gain has the units of these signals.
    gap : float
        The part of the gain by which its bounds may differ.
    work, rates, leave_out, progress, workers, client
        As for `robust_stability`.

    Returns
    -------
    Bounds
        `upper` is proved, and stability with it; `lower` is reached at `worst`. Both are inf if the
        system is unstable at `worst`.
    """
    what = "worst_case_gain"
    search.check_numbers(what, gap=gap, work=work)
    moving = rates_of(system, rates, what)
    chosen = _chosen(system, inputs, outputs, leave_out, what, work)
    with one_thread(), search.crew_of(workers, client, what) as crew:
        asked = search.Asked(system, gap, work, progress, chosen.left_out, crew=crew)
        if not moving and chosen.model is None:
            return _by_multipliers(asked, chosen, GAIN)
        model = chosen.model or realization(system, chosen.inputs, chosen.outputs, chosen.left_out)
        if not (moving and model.names):  # nothing that moves is seen
            state = search.last_of(asked, search.State(NOTHING), _gains(asked, model))
            return with_ball(_loop(asked, chosen, GAIN), _gain_bounds(asked, model, state, chosen.names))
        state = search.at_once(search.State(NOTHING), partial(_reached, model))
        constant = _gain_bounds(asked, model, state, chosen.names)
        return moving_gain(asked, model, moving, constant)


@arguments_checked
def robust_performance(
    system: System,
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    gap: float = search.GAP,
    work: float = search.WORK,
    largest: float = search.LARGEST,
    leave_out: Sequence[str] = (),
    progress: search.Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
) -> Bounds:
    """Bounds of the largest k such that the gain is at most 1/k for all |delta| <= k.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable, with weights at its inputs and outputs: a gain of 1 is what is asked for.
    inputs, outputs : name, number, slice, or list of these, optional
        Signals of the transfer; all, if not given.
    gap, work, largest, leave_out, progress, workers, client
        As for `robust_stability`.

    Returns
    -------
    Bounds
        `lower` is proved: on the box of this size the gain is at most 1/lower. At `worst` it is 1/upper
        or more, or the system is unstable.
    """
    what = "robust_performance"
    check_constant(system, "robust_performance")
    search.check_numbers(what, gap=gap, work=work, largest=largest)
    chosen = _chosen(system, inputs, outputs, leave_out, what, work)
    with one_thread(), search.crew_of(workers, client, what) as crew:
        asked = search.Asked(system, gap, work, progress, chosen.left_out, largest, crew)
        if chosen.model is None:
            return _by_multipliers(asked, chosen, PERFORMANCE)
        state = search.last_of(asked, search.State(NOTHING), _margins_of_performance(asked, chosen.model))
        reason = "" if state.is_closed(asked) else state.reason
        bounds = _with_peak(asked, chosen.model, state, PERFORMANCE, reason, chosen.names)
        return with_ball(_loop(asked, chosen, PERFORMANCE), bounds)


class _Chosen(NamedTuple):
    """Signals of a transfer, and its model; None if multipliers are the way to prove it."""

    inputs: list[int]
    outputs: list[int]
    names: search.Signals
    model: Realization | None
    left_out: tuple[str, ...]


def _chosen(
    system: System, inputs: Any, outputs: Any, leave_out: Sequence[str], what: str, work: float
) -> _Chosen:
    """A transfer that is stable at nominal."""
    names = [s.name for s in system.inputs], [s.name for s in system.outputs]
    j = positions_of(inputs, names[0], f"{what}: inputs of {system.name}")
    i = positions_of(outputs, names[1], f"{what}: outputs of {system.name}")
    if not (i and j):
        raise AnalysisError(
            f"{what}: model {system.name!r}: without inputs or outputs there is no gain. Choose some "
            "when the model is made."
        )
    signals = tuple(names[0][k] for k in j), tuple(names[1][k] for k in i)
    gone = left_out(system, leave_out, i)
    stable_states(system, gone, what, i)
    model = realization(system, j, i, gone) if system.lft.is_plain else None
    if model is not None and system.order and search.is_dear(model, work):
        model = None
    return _Chosen(j, i, signals, model, gone)


def _loop(asked: search.Asked, chosen: _Chosen, kind: str) -> Loop:
    """The loop of a system and of a block that joins inputs and outputs; for a gain it alone grows."""
    stay = states_that_stay(asked.system, asked.leave_out, chosen.outputs)
    loop = loop_of(asked.system, stay, (), chosen.inputs, chosen.outputs)
    grows = np.array([kind != GAIN or block.name == GAIN_BLOCK for block in loop.blocks], dtype=bool)
    return loop._replace(grows=grows)


def _by_multipliers(asked: search.Asked, chosen: _Chosen, kind: str) -> Bounds:
    """Bounds of a gain, or of the margin of performance, of a system with blocks of all kinds."""
    loop, inner = _loop(asked, chosen, kind), None
    if kind == GAIN:
        inner = loop_of(asked.system, states_that_stay(asked.system, asked.leave_out, chosen.outputs))
    return with_ball(loop, by_multipliers(asked, loop, kind, chosen.names, inner))


def _is_above(model: Realization, k: float, gain: float, delta: Array) -> bool:
    return peak_at(model, k * delta).gain * gain >= 1.0


def _gains(asked: search.Asked, model: Realization) -> search.Search[Peak]:
    """Bounds of the largest gain; `lower` is that of the best peak."""
    state = _reached(model)
    if np.isinf(state.lower):
        return state
    yield state
    reason = search.too_large(model)
    if reason:
        return state._replace(reason=reason)
    state, polynomials = search.expanded(state, model, 1.0)
    if polynomials is None:
        return state

    def is_open(state: search.State[Peak]) -> bool:
        return state.upper * (1.0 - asked.gap) > max(state.lower, _ZERO) and np.isfinite(state.lower)

    def level(state: search.State[Peak], steps: float) -> float:
        """As near as asked for, then twice that; below a bound that is proved, parts of the way to it."""
        low = max(state.lower, _ZERO)
        nearest = low * (1.0 + 0.5 * asked.gap)
        if np.isinf(state.upper):
            return nearest * max(1.0, 0.5 * steps)
        return max(nearest, float(low * (state.upper / low) ** (1.0 - 0.5 / np.sqrt(steps))))

    return (
        yield from search.lowered(
            asked, state, is_open, level, partial(_bounded, asked, model, polynomials)
        )
    )


def _reached(model: Realization) -> search.State[Peak]:
    """The largest gain that a search finds."""
    crossing = smallest_crossing(model, 1.0)
    if np.isfinite(crossing.size):
        peak = Peak(np.inf, crossing.frequency, crossing.delta)
        return search.State(peak, np.inf, reason=search.UNSTABLE)
    peak = largest_peak(model, 1.0)
    return search.State(peak, peak.gain)


def _bounded(
    asked: search.Asked,
    model: Realization,
    polynomials: Polynomials,
    state: search.State[Peak],
    goal: float,
) -> search.State[Peak]:
    """The state after an attempt to prove that no gain is above a goal."""
    is_wrong = partial(_is_above, model, 1.0, 1.0 / goal)
    box = 1.0, np.ones(len(model.sizes)), polynomials
    work = _SHARE * state.left(asked)
    state, attempt = search.attempted(asked, state, model, box, is_wrong, work, one_over(goal))
    if attempt.proof is not None:
        return state._replace(proof=attempt.proof, upper=goal)
    if attempt.counterexample is not None:
        peak = largest_peak(model, 1.0, (attempt.counterexample,))
        return state._replace(worst=peak, lower=peak.gain)
    return state


def _gain_bounds(
    asked: search.Asked, model: Realization, state: search.State[Peak], signals: search.Signals
) -> Bounds:
    is_open = not state.upper * (1.0 - asked.gap) <= state.lower or state.lower == 0.0
    reason = state.reason if is_open or np.isinf(state.lower) else ""
    return _with_peak(asked, model, state, GAIN, reason, signals)


def _with_peak(
    asked: search.Asked,
    model: Realization,
    state: search.State[Peak],
    kind: str,
    reason: str,
    signals: search.Signals,
) -> Bounds:
    """The result with the best peak."""
    peak, slope = state.worst, np.zeros(0)
    if len(peak.delta) == len(model.names) and 0.0 < peak.gain < np.inf:
        slope = slope_at(model, peak)
    return search.bounds_at(
        asked, state, kind, model, (peak.delta, peak.frequency), slope, reason, signals
    )


def _margins_of_performance(asked: search.Asked, model: Realization) -> search.Search[Peak]:
    """Bounds of the largest k at which the gain on the box of size k is at most 1/k."""
    state: search.State[Peak] = search.State(NOTHING)
    low, high = 0.0, min(smallest_crossing(model, asked.largest).size, asked.largest)
    for _ in range(_BISECTIONS):
        k = 0.5 * (low + high)
        peak = largest_peak(model, k)
        if peak.gain * k >= 1.0:
            high, state = k, state._replace(worst=peak, upper=k)
        else:
            low = k
        if high - low <= 0.02 * asked.gap * high:
            break
    yield state
    reason = search.too_large(model)
    if reason:
        return state._replace(reason=reason)

    def tried(state: search.State[Peak], k: float) -> search.State[Peak]:
        state, polynomials = search.expanded(state, model, k)
        if polynomials is None:
            return state
        is_wrong, box = partial(_is_above, model, k, k), (k, np.full(len(model.sizes), k), polynomials)
        state, attempt = search.attempted(asked, state, model, box, is_wrong, state.share(asked), k)
        if attempt.proof is not None:
            return state._replace(lower=k, proof=attempt.proof)
        if attempt.counterexample is not None:
            return state._replace(upper=k, worst=peak_at(model, k * attempt.counterexample))
        return state

    return (yield from search.enlarged(asked, state, tried, search.cost_of(model)))
