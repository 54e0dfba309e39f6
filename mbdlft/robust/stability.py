"""Stability: the margin of robust stability, and a check of nominal and sampled values.

The margin is the largest k such that the system has all poles in the open left half-plane, and is well
posed, for all |delta_j| < k. It is bounded from above by deltas with a pole on or beyond the axis, which
are found by following poles, and from below by a proof for the box of size k
(`mbdlft.robust.bisect.boxes`). Both are for every frequency; there is no grid. Where Delta has blocks
that are not real parameters, or the polynomial is too large, multipliers take their place
(`mbdlft.robust.mu.mixed`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.parameter import at_values, deltas_at, to_physical
from mbdlft.base.running import one_thread
from mbdlft.base.samples import check_points
from mbdlft.response.modes import Spectrum, Stability, eigenvalues, pole_text, samples_at, spectrum
from mbdlft.robust import ascent
from mbdlft.robust.bisect import search
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.evidence import STABILITY, Bounds
from mbdlft.robust.moving.varying import Rates, moving_margin, rates_of
from mbdlft.robust.mu.coverage import check_fixed, loop_of
from mbdlft.robust.mu.mixed import by_multipliers, with_ball
from mbdlft.robust.realization import check_parameters, left_out, realization, stable_states
from mbdlft.system.model import System

SAMPLES = 300  # at random: what is unstable in a hundredth of the box is missed once in twenty times
_CORNERS = 128  # tried at most; more are drawn at random
_LOOKED_AT = 30  # samples whose poles farthest right are looked at more closely
_SAMPLES = 3  # from which searches start
_BEYOND, _GAP = 1.02, 0.005  # times the ranges: a proof of more is not asked for; and their gap
_MOST, _WORK = 400, 4e9  # points of all searches, and their operations
_DECLARED = 0.75  # of the work that is left, for Lyapunov functions of the declared box: a decision
_PATH = 40  # points of a search for a pole on the axis


@arguments_checked
def robust_stability(
    system: System,
    *,
    gap: float = search.GAP,
    work: float = search.WORK,
    largest: float = search.LARGEST,
    rates: Rates = None,
    fixed: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    progress: search.Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
) -> Bounds:
    """Bounds of the margin of robust stability, guaranteed for all frequencies and all values.

    With `rates`, for all motions of the parameters that are not faster: then `lower` is proved by a
    quadratic form that falls along each of them, and `upper` is that of constant values, or of a
    periodic motion.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable.
    gap : float
        The part of the margin by which its bounds may differ.
    work : float
        Units of work, each at most about a second of one core. With less, the bounds are farther apart.
        The result depends on it and not on the time that passes.
    largest : float
        Margins above this are not told apart.
    rates : mapping of names to numbers, or number for all, optional
        Bounds of how fast parameters move, in their units per second: 0, the default, for constants; inf
        for any motion.
    fixed : sequence of str
        Parameters and blocks that stay within their declared ranges: the margin is how many times the
        ranges of the others may grow (skew mu).
    leave_out : sequence of str
        States on which nothing else depends, such as positions that no loop measures: their poles do
        not count. ``"cyclic"`` stands for all integrators of this kind.
    progress : function (lower, upper), optional
        Called whenever a bound has changed. If it, or Ctrl-C, raises KeyboardInterrupt, the best bounds
        so far are returned.
    workers : int, optional
        Processes for parts of the box; None: one for each core. The result does not depend on it.
    client : distributed.Client, optional
        A Dask cluster that computes instead of processes of this machine (extra `cluster`).

    Returns
    -------
    Bounds
        `lower` is proved; at `worst`, which is `upper` away, a pole lies on or beyond the axis.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names; there is no
        parameter; the model is too large; a rate is of no parameter, or no bound.
    """
    what = "robust_stability"
    search.check_numbers(what, gap=gap, work=work, largest=largest)
    moving = rates_of(system, rates, what)
    check_parameters(system, what)
    kept = check_fixed(system, fixed)
    if moving and kept:
        raise AnalysisError(f"{what}: expected rates or fixed blocks, got both. Fix none.")
    if set(kept) >= {block.name for block in system.lft.blocks if block.inputs}:
        raise AnalysisError(f"{what}: expected a block that is not fixed.")
    leave_out = left_out(system, leave_out)
    stay = stable_states(system, leave_out, what)
    with one_thread(), search.crew_of(workers, client, what) as crew:
        asked = search.Asked(system, gap, work, progress, leave_out, largest, crew)
        if moving:
            model = realization(system, leave_out=leave_out)
            state = search.at_once(search.State(ascent.NONE), partial(_reached, asked, model))
            constant = search.settled(partial(_margin, asked, model, state))
            return moving_margin(asked, model, moving, constant)
        bounds = None
        if system.lft.is_plain:
            model = realization(system, leave_out=leave_out)
            if not search.is_dear(model, work):
                stays = np.array([name in kept for name in model.names], dtype=bool)
                state = search.last_of(asked, search.State(ascent.NONE), _margins(asked, model, stays))
                bounds = replace(search.settled(partial(_margin, asked, model, state)), fixed=kept)
        bounds = bounds or by_multipliers(asked, loop_of(system, stay, kept), STABILITY)
        return search.settled(lambda: with_ball(loop_of(system, stay, kept), bounds))


def _reached(asked: search.Asked, model: Realization) -> search.State[ascent.Crossing]:
    """The smallest deltas with a pole on the axis that searches find."""
    crossing = ascent.smallest_crossing(model, asked.largest)
    return search.State(crossing, upper=crossing.size)


def _margins(
    asked: search.Asked, model: Realization, fixed: NDArray[np.bool_]
) -> search.Search[ascent.Crossing]:
    """Bounds of the margin of a system with parameters only; `upper` is the size of the best crossing."""
    some = bool(np.any(fixed))
    state = search.State(ascent.NONE) if some else _reached(asked, model)
    if some:
        crossing = ascent.smallest_beside(model, fixed, asked.largest, ascent.NONE)
        state = search.State(crossing, upper=crossing.size)
    yield state

    def tried(state: search.State[ascent.Crossing], k: float) -> search.State[ascent.Crossing]:
        ends = np.where(fixed, 1.0, k)
        state, point = _attempted(asked, model, state, k, ends)
        if point is None:
            return state
        if some:
            crossing = ascent.crossing_on_ray(model, ends * point, asked.largest, fixed)
            crossing = min(state.worst, crossing, key=lambda each: each.size)
            crossing = ascent.smallest_beside(model, fixed, asked.largest, crossing, ends * point)
        else:
            crossing = ascent.improved(model, k * point, state.worst, asked.largest)
        return state._replace(worst=crossing, upper=crossing.size)

    return (yield from search.enlarged(asked, state, tried, search.cost_of(model)))


def _attempted(
    asked: search.Asked, model: Realization, state: search.State[ascent.Crossing], k: float, ends: Array
) -> tuple[search.State[ascent.Crossing], Array | None]:
    """The state after attempts to prove the box of size k; and without a proof, where a search begins."""
    state, polynomials = search.expanded(state, model, k, ends)
    if polynomials is None:
        return state, None
    is_wrong, work = partial(_is_unstable, model, ends), state.share(asked)
    longest, box = _DECLARED * state.left(asked) if k == 1.0 else 0.0, (k, ends, polynomials)
    state, attempt = search.attempted(asked, state, model, box, is_wrong, work, longest=longest)
    if attempt.proof is not None:
        return state._replace(lower=k, proof=attempt.proof), None
    return state, attempt.center if attempt.counterexample is None else attempt.counterexample


def _margin(asked: search.Asked, model: Realization, state: search.State[ascent.Crossing]) -> Bounds:
    is_open, crossing = state.lower < state.upper * (1.0 - asked.gap), state.worst
    worst, reason = (crossing.delta, crossing.frequency), state.reason if is_open else ""
    return search.bounds_at(asked, state, STABILITY, model, worst, crossing.slope, reason)


def _is_unstable(model: Realization, ends: Array, delta: Array) -> bool:
    return ascent.abscissa(model, ends * delta) >= 0.0


@dataclass(frozen=True, slots=True)
class StabilityVerdict:
    """What is known of the stability of a system over the box of its parameters.

    Attributes
    ----------
    name : of the model
    nominal : {"stable", "marginal", "unstable"}
        Marginal: a pole is on the imaginary axis, to rounding, and none is right of it.
    nominal_pole : complex, rad/s
        The one farthest right there.
    counterexample : values of the parameters where it is unstable, in their units; empty: none found
        At nominal if it is unstable there and has parameters.
    worst : values of the parameters, in their units, where a pole was farthest right
    worst_pole : complex, rad/s
        The pole there.
    points : number of points that were tried: nominal, samples, corners, those of searches
    proof : a sentence if stability is proved on the whole box; empty: what was tried proves nothing
    """

    name: str
    nominal: Stability
    nominal_pole: complex
    counterexample: Mapping[str, float]
    worst: Mapping[str, float]
    worst_pole: complex
    points: int
    sentence: str
    proof: str = ""

    def __str__(self) -> str:
        return self.proof or self.sentence


@arguments_checked
def check_stability(
    system: System, samples: int = SAMPLES, seed: int = 0, *, prove: float = 0.0
) -> StabilityVerdict:
    """Look for values of the parameters at which a system is unstable, or for a proof that none are.

    Tried are nominal values, random samples, corners of the box, and what searches with exact gradients
    of the poles reach from the worst of these. That none is found is no proof, and the verdict says so.
    With `prove`, `robust_stability` looks for one.

    Parameters
    ----------
    system : System or LFTModel
        Blocks that are not parameters are zero.
    samples : int
        Number of random samples.
    seed : int
        Of the samples.
    prove : float
        Units of work for a proof, each at most about a second of one core; 0 for none.
    """
    if not isinstance(samples, int | np.integer) or samples < 0:
        raise AnalysisError(
            f"check_stability: expected a number of samples such as 300, got {samples!r}."
        )
    parameters = system.parameters
    physical = check_points(parameters, seed, int(samples), _CORNERS)
    names = parameters.names
    A = samples_at(system, dict(zip(names, physical.T, strict=True))).A
    poles = eigenvalues(A, system.name)
    nominal = spectrum(A[0])
    ranked = np.argsort(-np.max(poles.real, axis=1, initial=-np.inf), kind="stable")[:_LOOKED_AT]
    looked = [(k, spectrum(A[k])) for k in ranked]
    used = len(A)
    best, there = max(
        ((k, seen) for k, seen in [(0, nominal), *looked]), key=lambda pair: _badness(pair[1])
    )
    values = physical[best]
    if parameters and len(system.states) and there.stability != "unstable":
        starts = [
            (delta, complex(poles[k][np.argmax(poles[k].real)]))
            for k, delta in zip(
                ranked[:_SAMPLES], deltas_at(parameters, physical[ranked[:_SAMPLES]]), strict=True
            )
        ]
        values, there, more = _searched(system, starts, (values, there))
        used += more
    verdict = _verdict(system, nominal, values, there, used)
    if not (prove and system.lft.order) or nominal.stability != "stable" or verdict.counterexample:
        return verdict
    return _proved(system, verdict, prove)


def _proved(system: System, verdict: StabilityVerdict, work: float) -> StabilityVerdict:
    """The verdict with a proof, with values that make it unstable, or with how far a proof came."""
    bounds = robust_stability(system, gap=_GAP, work=work, largest=_BEYOND)
    if bounds.lower > 1.0:
        proof = (
            f"stable for all values in the ranges, and up to {bounds.lower:.4g} times these: proved, at "
            "all frequencies"
        )
        return replace(verdict, proof=proof)
    if bounds.upper <= 1.0:
        worst = dict(bounds.worst)
        at = at_values(system.parameters, np.array([worst[name] for name in system.parameters.names]))
        sentence = f"stable at nominal, not in all of the range: a pole is on the axis at {at}"
        return replace(verdict, counterexample=worst, sentence=sentence)
    return replace(
        verdict, sentence=f"{verdict.sentence}; proved up to {bounds.lower:.4g} times the ranges"
    )


def _searched(
    system: System, starts: list[tuple[Array, complex]], best: tuple[Array, Spectrum]
) -> tuple[Array, Spectrum, int]:
    """The worst point of `best` and those that searches reach, and the number of points tried."""
    n, names = len(system.states), system.parameters.names
    points_left, used = int(min(_MOST, max(20.0, _WORK / (30.0 * n**3 + 1.0)))), 0
    model = realization(system, others_are_zero=True, balanced=True)
    place = [names.index(name) for name in model.names]
    crossing = ascent.smallest_crossing(model, 1.0, points_left // _PATH)
    if np.isfinite(crossing.frequency):
        on_axis = np.zeros(len(names))
        on_axis[place] = crossing.delta
        starts = [(on_axis, 1j * crossing.frequency), *starts]
    for delta, pole in starts:
        if points_left <= 0:
            break
        try:
            reached = delta.copy()
            reached[place], _, count = ascent.push_right(model, delta[place], pole, points_left)
            values = _physical(system, reached)
            named = dict(zip(names, values, strict=True))
            seen = spectrum(samples_at(system, named).A[0])
        except WellPosednessError:
            points_left -= 1
            continue
        points_left, used = points_left - count, used + count
        if _badness(seen) > _badness(best[1]):
            best = values, seen
    return *best, used


def _badness(seen: Spectrum) -> tuple[bool, float]:
    """Unstable ones are worse than others; then how far right the pole farthest right is known to be."""
    known = seen.poles.real[~seen.on_axis]
    return seen.stability == "unstable", float(np.max(known, initial=-np.inf))


def _physical(system: System, delta: Array) -> Array:
    """Physical values of deltas, inside the ranges."""
    pairs = zip(system.parameters, delta, strict=True)
    return np.array([float(np.clip(to_physical(p, d), p.low, p.high)) for p, d in pairs])


def _verdict(
    system: System, nominal: Spectrum, values: Array, there: Spectrum, points: int
) -> StabilityVerdict:
    """The verdict, with its sentence."""
    parameters = system.parameters
    named = {p.name: float(v) for p, v in zip(parameters, values, strict=True)}
    unstable = there.stability == "unstable"
    at = at_values(parameters, values)
    if nominal.stability == "unstable":
        sentence = f"unstable at nominal: pole {pole_text(nominal.worst)}"
        if parameters and there.worst != nominal.worst:
            sentence += f"; farthest right of {points} points: {pole_text(there.worst)} at {at}"
    elif unstable:
        sentence = f"{nominal.stability} at nominal, unstable in the range: "
        sentence += f"pole {pole_text(there.worst)} at {at}"
    elif not len(nominal.poles):
        sentence = "stable: it has no states"
    else:
        axis = "; on the axis: " + _listed(nominal) if nominal.stability == "marginal" else ""
        sentence = f"{nominal.stability} at nominal{axis}"
        if parameters:
            sentence += f"; no unstable point among {points} that were tried, "
            sentence += "which proves nothing between them"
    if any(block.kind != "real" for block in system.lft.blocks):
        sentence += "; blocks that are not parameters are zero here"
    counterexample = named if unstable else {}
    return StabilityVerdict(
        system.name,
        nominal.stability,
        nominal.worst,
        counterexample,
        named,
        there.worst,
        points,
        sentence,
    )


def _listed(seen: Spectrum) -> str:
    """Frequencies of the poles on the axis."""
    sizes = sorted({f"{abs(pole.imag):.6g}" for pole in seen.cleaned[seen.on_axis]}, key=float)
    more = f" and {len(sizes) - 6} more" if len(sizes) > 6 else ""
    return ", ".join(sizes[:6]) + more + " rad/s"
