"""Whether a system is stable: at nominal, and at what was tried of the box of its parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.parameter import to_physical
from mbdlft.base.samples import check_points
from mbdlft.response.samples import samples_at
from mbdlft.response.spectrum import Spectrum, Stability, eigenvalues, pole_text, spectrum
from mbdlft.robust.margin import robust_stability
from mbdlft.robust.migration import push_right
from mbdlft.robust.pole_migration import smallest_crossing
from mbdlft.robust.realization import realization
from mbdlft.system.points import deltas_at
from mbdlft.system.singular import at_values
from mbdlft.system.system import System

SAMPLES = 300
_CORNERS = 128  # tried at most; more are drawn at random
_LOOKED_AT = 30  # samples whose poles farthest right are looked at more closely
_SAMPLES = 3  # from which searches start
_BEYOND, _GAP = 1.02, 0.005  # times the ranges: a proof of more is not asked for; and their gap
_MOST, _WORK = 400, 4e9  # points of all searches, and their operations
_PATH = 40  # points of a search for a pole on the axis


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

    @property
    def is_counterexample_found(self) -> bool:
        """Whether it is unstable somewhere, at nominal or elsewhere."""
        return self.nominal == "unstable" or bool(self.counterexample)

    def __str__(self) -> str:
        return self.proof or self.sentence


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

    Returns
    -------
    StabilityVerdict

    Raises
    ------
    AnalysisError
        `samples` is not a number of points, or eigenvalues were not found.
    WellPosednessError
        The model is singular at one of the points.
    """
    if not isinstance(samples, int | np.integer) or samples < 0:
        raise AnalysisError(
            f"check_stability: expected a number of samples such as 300, got {samples!r}."
        )
    parameters = system.parameters
    physical = check_points(parameters, seed, int(samples), _CORNERS)
    names = parameters.names
    A = samples_at(system, dict(zip(names, physical.T, strict=True))).A
    found = eigenvalues(A, system.name)
    nominal = spectrum(A[0])
    ranked = np.argsort(-np.max(found.real, axis=1, initial=-np.inf), kind="stable")[:_LOOKED_AT]
    looked = [(k, spectrum(A[k])) for k in ranked]
    used = len(A)
    best, there = max(
        ((k, seen) for k, seen in [(0, nominal), *looked]), key=lambda pair: _badness(pair[1])
    )
    values = physical[best]
    if parameters and len(system.states) and there.stability != "unstable":
        starts = [
            (delta, complex(found[k][np.argmax(found[k].real)]))
            for k, delta in zip(
                ranked[:_SAMPLES], deltas_at(parameters, physical[ranked[:_SAMPLES]]), strict=True
            )
        ]
        values, there, more = _searched(system, starts, (values, there))
        used += more
    verdict = _verdict(system, nominal, values, there, used)
    if not (prove and parameters) or nominal.stability != "stable" or verdict.counterexample:
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
        at = at_values(
            system.parameters, np.array([worst[name] for name in system.parameters.names])
        )
        sentence = f"stable at nominal, not in all of the range: a pole is on the axis at {at}"
        return replace(verdict, counterexample=worst, sentence=sentence)
    return replace(
        verdict,
        sentence=f"{verdict.sentence}; proved up to {bounds.lower:.4g} times the ranges",
    )


def _searched(
    system: System, starts: list[tuple[Array, complex]], best: tuple[Array, Spectrum]
) -> tuple[Array, Spectrum, int]:
    """The worst point of `best` and those that searches reach, and the number of points tried."""
    n, names = len(system.states), system.parameters.names
    left, used = int(min(_MOST, max(20.0, _WORK / (30.0 * n**3 + 1.0)))), 0
    model = realization(system, others_are_zero=True, balanced=True)
    place = [names.index(name) for name in model.names]
    crossing = smallest_crossing(model, 1.0, left // _PATH)
    if np.isfinite(crossing.frequency):
        on_axis = np.zeros(len(names))
        on_axis[place] = crossing.delta
        starts = [(on_axis, 1j * crossing.frequency), *starts]
    for delta, pole in starts:
        if left <= 0:
            break
        try:
            reached = delta.copy()
            reached[place], _, count = push_right(model, delta[place], pole, left)
            values = _physical(system, reached)
            named = dict(zip(names, values, strict=True))
            seen = spectrum(samples_at(system, named).A[0])
        except WellPosednessError:
            left -= 1
            continue
        left, used = left - count, used + count
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
