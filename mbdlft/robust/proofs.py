"""A stored analysis is checked again: no search, no solver, and nothing believed that it says of itself.

From the claim follows what there is to be proved: which matrices, on which line, on which box, between
which signals. The proof is evidence for that and says none of it. Of cuts of a box
(`mbdlft.robust.bisect.boxes`), the coefficients of the polynomial are computed anew, in balls, and the
cuts repeated; of Lyapunov functions on its parts (`mbdlft.robust.bisect.lyapunov`) the functions are.
Of multipliers (`mbdlft.robust.mu.mixed`), each has the structure of Delta, its matrices
are definite, its eigenvalues leave its interval free, and the intervals of each part cover all
frequencies. Of a quadratic form (`mbdlft.robust.moving.variation`), the form is computed anew, in balls,
and is definite. All begin with a proof that the nominal model is stable, or in its region, by Routh's
scheme in balls.

Then the worst case is looked at: whether the model reaches the bound at its deltas, in balls.
A worst case is computed in doubles, so it is one up to 1e-6 of its size: a model that is said to be on
the border of stability is not stable at the deltas times 1 to 1 + 1e-6, by Routh's scheme; a gain is
there at its frequency; poles are right of a line, or of edges, beside the value, and not beyond it. Where
Delta is not real, I - M(j omega) Delta takes some vector to 1e-6 of its size. A motion is followed in
doubles.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.running import one_thread
from mbdlft.exact.matrices import middles_of
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.robust import evidence
from mbdlft.robust.balls import balls, entries, joined
from mbdlft.robust.bisect import characteristic, lyapunov
from mbdlft.robust.bisect.boxes import replayed
from mbdlft.robust.moving.motion import growth_of
from mbdlft.robust.moving.varying import checked, delta_rates, rates_of
from mbdlft.robust.mu.coverage import GAIN as GAIN_BLOCK
from mbdlft.robust.mu.coverage import loop_of
from mbdlft.robust.mu.mixed import wrong_in
from mbdlft.robust.realization import physical, realization, states_that_stay
from mbdlft.robust.worst import disk_transfer
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

_NEAR = 1e-6  # of a worst case, which is computed in doubles
_ROUNDING = 1e-9  # of the largest pole, and of sizes
_BEYOND = (0.0, 1e-12, 1e-9, _NEAR)  # parts by which deltas are made larger
_BITS = 256
Complex = NDArray[np.complex128]


class _Matrices(NamedTuple):
    """[D C F; B A E; H G J] of a system in blocks of rows and columns: channels, states, signals."""

    channels: Array
    right: Array
    below: Array
    other: Array
    states: int

    def closed(self, delta: Complex) -> tuple[Any, Any]:
        """[A E; G J] at w = delta z in balls, and det(I - D delta); ZeroDivisionError where that is 0."""
        D, right = balls(self.channels.astype(complex)), balls(self.right.astype(complex))
        loop = balls(np.eye(len(self.channels), dtype=complex)) - D * balls(delta)
        w = balls(delta) * loop.solve(right)
        return balls(self.other.astype(complex)) + balls(self.below.astype(complex)) * w, loop.det()

    def polynomial(self, delta: Complex, shift: float = 0.0) -> list[Any] | None:
        """Coefficients of det((s + shift) I - A), lowest first; None: the determinant is not positive."""
        (matrix, determinant), n = self.closed(delta), self.states
        if determinant.real <= 0:
            return None
        if not determinant.real > 0:
            raise ZeroDivisionError
        A = joined([[entries(matrix)[:n, :n]]]) - balls(shift * np.eye(n, dtype=complex))
        return list(A.charpoly().coeffs())


def not_reached(system: System, bounds: evidence.Bounds) -> str:
    """What is wrong with the worst case of bounds; empty if nothing is."""
    if bounds.motion is not None:
        return _not_moving(system, bounds)
    blocks = [block for block in system.lft.blocks if block.inputs and block.outputs]
    if not bounds.delta and blocks:
        is_nothing = bounds.reached == {True: 0.0, False: np.inf}[bounds.is_from_above]
        is_nothing &= not bounds.worst
        return "" if is_nothing else f"no values are said to reach {bounds.reached:g}"
    try:
        delta = _delta_of(system, bounds)
    except ValueError as error:
        return str(error)
    places = [
        positions_of(list(names), [s.name for s in known], "verify")
        for names, known in ((bounds.inputs, system.inputs), (bounds.outputs, system.outputs))
    ]
    stay = states_that_stay(system, bounds.leave_out, places[1])
    matrices = _matrices(system, stay, *places)
    with flint.ctx.workprec(_BITS):
        try:
            wrong = _evaluated(matrices, delta, bounds)
        except ZeroDivisionError:
            wrong = True
    return f"{bounds.reached:g} is not reached at its worst case" if wrong else ""


def _matrices(system: System, stay: Sequence[int], inputs: list[int], outputs: list[int]) -> _Matrices:
    right = np.hstack([system.C_z[:, stay], system.D_zu[:, inputs]])
    below = np.vstack([system.B_w[stay], system.D_yw[outputs]])
    A, E = system.A[np.ix_(stay, stay)], system.B_u[np.ix_(stay, inputs)]
    G, J = system.C_y[np.ix_(outputs, stay)], system.D_yu[np.ix_(outputs, inputs)]
    return _Matrices(system.D_zw, right, below, np.block([[A, E], [G, J]]), len(stay))


def _delta_of(system: System, bounds: evidence.Bounds) -> Complex:
    """Delta (n_w, n_z); a ValueError says what is wrong with its parts, or with `worst`."""
    lft = system.lft
    delta = np.zeros(lft.M11.T.shape, dtype=complex)
    blocks = {block.name: block for block in lft.blocks if block.inputs and block.outputs}
    if set(bounds.delta) != set(blocks):
        raise ValueError("the deltas of its worst case are not those of the blocks")
    largest = 0.0
    for name, value in bounds.delta.items():
        block, number = blocks[name], np.asarray(value)
        shape = (block.outputs, block.inputs) if block.kind == "full" else ()
        if number.shape != shape or (block.kind == "real" and np.iscomplexobj(number)):
            raise ValueError(f"the delta of {name} is none of its block")
        size = float(np.linalg.norm(np.atleast_2d(number), 2))
        grows = bounds.kind in (evidence.STABILITY, evidence.PERFORMANCE) and name not in bounds.fixed
        if not size <= (bounds.upper if grows else 1.0) * (1.0 + _ROUNDING):
            raise ValueError(f"the delta of {name} is outside of the box of its worst case")
        largest = max(largest, size) if grows else largest
        value = number if block.kind == "full" else number * np.eye(block.size)
        delta[lft.columns()[name], lft.slices()[name]] = value
    if bounds.kind == evidence.STABILITY and not largest >= bounds.upper * (1.0 - _NEAR):
        raise ValueError(f"the largest delta of its worst case is {largest:g}, and not {bounds.upper:g}")
    names = [name for name in bounds.delta if name in system.parameters.names]
    expected = physical(system, names, np.array([bounds.delta[n] for n in names])) if names else {}
    if set(expected) != set(bounds.worst):
        raise ValueError("the values of its worst case are not those of the parameters")
    for name, value in expected.items():
        near = _ROUNDING * max(abs(value), np.finfo(float).tiny)
        if bounds.worst[name] != value and not abs(bounds.worst[name] - value) <= near:  # both may be inf
            raise ValueError(f"the value of {name} at its worst case is not that of its delta")
    return delta


def _evaluated(matrices: _Matrices, delta: Complex, bounds: evidence.Bounds) -> bool:
    """Whether the model at the deltas does not reach what is said."""
    n, frequency, reached = matrices.states, bounds.frequency, bounds.reached
    if bounds.kind == evidence.STABILITY:
        return not (
            _is_singular(matrices, delta, frequency)
            if np.any(delta.imag)
            else _is_at(matrices, delta, frequency)
            and any(_is_left(matrices, delta * (1.0 + more), 0.0) is False for more in _BEYOND)
        )
    whole, _ = matrices.closed(delta)
    size = _size(matrices, whole)
    if bounds.kind == evidence.REAL_PART:
        step = _NEAR * abs(reached) + _ROUNDING * size
        return _is_left(matrices, delta, reached - step) is not False or not _is_left(
            matrices, delta, reached + step
        )
    if bounds.kind == evidence.DAMPING:
        if reached >= 1.0:
            return False
        if reached <= 0.0:  # edges right of the axis say nothing of a pair
            return _is_left(matrices, delta, 0.0) is True
        low, high = reached - _NEAR, min(reached + _NEAR, 1.0 - 1e-12)
        return (
            not (low <= 0.0 or _is_left(matrices, delta, 0.0, evidence.slope_of(low)))
            or _is_left(matrices, delta, 0.0, evidence.slope_of(high)) is not False
        )
    gain = {evidence.GAIN: reached}.get(bounds.kind, 1.0 / reached if reached else np.inf)
    if bounds.kind == evidence.PERFORMANCE and _is_left(matrices, delta * (1.0 + _NEAR), 0.0) is False:
        return False
    return not _has_gain(whole, n, frequency, gain, exactly=bounds.kind in (evidence.GAIN, evidence.DISK))


def _size(matrices: _Matrices, whole: Any) -> float:
    """The largest pole at the deltas, or at none: the poles there may all be 0."""
    n = matrices.states
    each = (middles_of(whole)[:n, :n], matrices.other[:n, :n]) if n else ()
    return float(max((np.max(np.abs(eigenvalues_of(A))) for A in each), default=0.0))


def _is_at(matrices: _Matrices, delta: Complex, frequency: float) -> bool:
    """Whether a pole at real deltas is near to a frequency; none is where the loop is ill posed."""
    if not np.isfinite(frequency):
        return True
    polynomial = matrices.polynomial(delta)
    near = characteristic.nearness(frequency, _size(matrices, matrices.closed(delta)[0]))
    return polynomial is None or characteristic.is_root_near(polynomial, 1j * frequency, near)


def _is_left(matrices: _Matrices, delta: Complex, shift: float, slope: float = 0.0) -> bool | None:
    """Whether all poles at real deltas are left of an edge; None if that is not decided.

    They are not where the loop is ill posed, or beyond that.
    """
    if np.any(delta.imag):
        return None
    return characteristic.verdict_of(
        lambda: characteristic.straightened(_real(matrices.polynomial(delta, shift)), slope)
    )


def _real(coefficients: list[Any] | None) -> list[Any] | None:
    return None if coefficients is None else [c.real for c in coefficients]


def _is_singular(matrices: _Matrices, delta: Complex, frequency: float) -> bool:
    """Whether I - M(j omega) delta takes a vector to nearly nothing."""
    m, n = len(matrices.channels), matrices.states
    M = balls(matrices.channels.astype(complex))
    if np.isfinite(frequency) and n:
        whole = matrices.other[:n, :n]
        shifted = balls(1j * frequency * np.eye(n)) - balls(whole.astype(complex))
        B, C = matrices.below[:n].astype(complex), matrices.right[:, :n].astype(complex)
        M = M + balls(C) * shifted.solve(balls(B))
    loop = balls(np.eye(m, dtype=complex)) - M * balls(delta)
    vectors = np.linalg.svd(middles_of(loop))
    image = loop * balls(np.conj(vectors[2][-1:]).T)
    return bool(_norm(image) < float(vectors[1][0]) * _NEAR)


def _has_gain(whole: Any, n: int, frequency: float, gain: float, *, exactly: bool) -> bool:
    """Whether the gain at a frequency is as large as said, and, if so asked, not larger."""
    blocks = entries(whole)
    G = joined([[blocks[n:, n:]]])
    if np.isfinite(frequency) and n:
        shifted = balls(1j * frequency * np.eye(n)) - joined([[blocks[:n, :n]]])
        G = G + joined([[blocks[n:, :n]]]) * shifted.solve(joined([[blocks[:n, n:]]]))
    _, sizes, vectors = np.linalg.svd(middles_of(G))
    at_most = not exactly or gain == 0.0 or sizes[0] <= gain * (1.0 + _NEAR)
    u = np.conj(vectors[:1]).T
    return bool(at_most and _norm(G * balls(u)) >= gain * (1.0 - _NEAR) * float(np.linalg.norm(u)))


def _norm(vector: Any) -> Any:
    """The length of a vector of balls."""
    return sum((abs(x) ** 2 for x in vector.entries()), flint.arb(0)).sqrt()


def _not_moving(system: System, bounds: evidence.Bounds) -> str:
    """What is wrong with a motion that is said not to come to rest."""
    model = realization(system, leave_out=bounds.leave_out)
    motion = np.asarray(bounds.motion, dtype=float)
    rates = delta_rates(system, model.names, bounds.rates, bounds.upper, allowed=True)
    is_one = motion.shape[1:] == (1 + len(model.names),) and motion.size and np.all(np.isfinite(motion))
    if not is_one or list(bounds.delta) != list(model.names) or not 0.0 < bounds.frequency < np.inf:
        return "its motion is not one of its parameters"
    deltas, times = motion[:, 1:], motion[:, 0]
    period = 2.0 * np.pi / bounds.frequency
    steps = period * (np.arange(len(times)) + 0.5) / len(times)
    extents = np.max(np.abs(deltas), axis=0)
    changes = np.max(np.abs(deltas - np.roll(deltas, 1, axis=0)), axis=0) * len(times) / period
    is_right = np.allclose(times, steps, rtol=_ROUNDING) and not bounds.worst
    is_right &= np.allclose(extents, list(bounds.delta.values()), rtol=_ROUNDING, atol=0.0)
    is_right &= abs(float(np.max(extents)) - bounds.upper) <= _ROUNDING * bounds.upper
    is_right &= bool(np.all(changes <= rates * (1.0 + _NEAR) + _ROUNDING))
    if not is_right:
        return f"its motion is not one of {bounds.upper:g} times the ranges with such rates"
    more = partial(growth_of, model, rates, period)
    return "" if more(deltas * (1.0 + _NEAR)) >= 0.0 else "its motion comes to rest"


_WITH_SIGNALS = (evidence.PERFORMANCE, evidence.GAIN, evidence.DISK)


@arguments_checked
def verify(system: System, bounds: evidence.Bounds) -> str:
    """Check an analysis again: the proof of its claim, and that its worst case reaches its other bound.

    Parameters
    ----------
    system : System or LFTModel
        The one that was analyzed.
    bounds : Bounds
        `str(bounds.claim)` says in words what is proved if nothing is wrong.

    Returns
    -------
    str
        What is wrong; empty if the claim is proved.
    """
    claim, proof = bounds.claim, bounds.proof
    if claim.kind == evidence.DAMPING and claim.bound == -1.0 and proof is None:  # no damping is below -1
        return not_reached(system, bounds)
    if proof is None:
        return f"there is no proof{bounds.reason and ': '}{bounds.reason}"
    if not bounds.lower <= bounds.upper:
        return f"its lower bound {bounds.lower:g} is not below its upper bound {bounds.upper:g}"
    wrong = _malformed(system, claim, proof)
    if wrong:
        return wrong
    disk = claim.kind == evidence.DISK
    analyzed = disk_transfer(system, list(claim.inputs), list(claim.outputs)) if disk else system
    with one_thread():
        return _unproved(analyzed, claim, proof) or not_reached(analyzed, bounds)


def _malformed(system: System, claim: evidence.Claim, proof: evidence.Proof) -> str:
    """What makes a claim none, or a proof one of another kind; empty if they fit."""
    if claim.kind not in evidence.SENTENCES:
        return f"there is no proof of a {claim.kind}"
    is_signed = claim.kind in (evidence.REAL_PART, evidence.DAMPING)
    if not (math.isfinite(claim.bound) and (is_signed or claim.bound > 0.0)):
        return f"its bound {claim.bound:g} says nothing"
    if claim.kind == evidence.DAMPING and not -1.0 < claim.bound < 1.0:
        return f"no damping of all poles is at least {claim.bound:g}, or it says nothing"
    for names in (claim.inputs, claim.outputs):
        if bool(names) != (claim.kind in _WITH_SIGNALS) or len(set(names)) < len(names):
            return f"a {claim.kind} is not of the signals {', '.join(names) or '(none)'}"
    if claim.fixed and claim.kind != evidence.STABILITY:
        return f"a {claim.kind} has no blocks that are fixed"
    moving = bool(rates_of(system, claim.rates, "verify"))
    if moving != isinstance(proof, evidence.ProofOfMotions):
        return f"the proof is for {'constant' if moving else 'moving'} parameters"
    if moving and (claim.kind not in (evidence.STABILITY, evidence.GAIN) or claim.fixed):
        return f"there is no proof of a {claim.kind} for parameters that move"
    return ""


def _unproved(system: System, claim: evidence.Claim, proof: evidence.Proof) -> str:
    """What is not proved of a claim; empty if all is."""
    inputs = positions_of(list(claim.inputs), [s.name for s in system.inputs], "verify: inputs")
    outputs = positions_of(list(claim.outputs), [s.name for s in system.outputs], "verify: outputs")
    if isinstance(proof, evidence.IntervalProof):
        if claim.kind in (evidence.REAL_PART, evidence.DAMPING):
            return f"multipliers prove nothing of a {claim.kind}"
        stay = states_that_stay(system, claim.leave_out, outputs)
        if not (system.lft.is_complex or characteristic.is_hurwitz(system.A[np.ix_(stay, stay)])):
            return "the nominal model is not proved to be stable"
        loop = loop_of(system, stay, claim.fixed, inputs, outputs)
        if claim.kind in (evidence.GAIN, evidence.DISK):
            loop = loop._replace(grows=np.array([b.name == GAIN_BLOCK for b in loop.blocks], dtype=bool))
        return wrong_in(
            loop, claim.gain if claim.kind in (evidence.GAIN, evidence.DISK) else claim.size, proof
        )
    shift, slope = claim.edge
    model = realization(system, inputs, outputs, claim.leave_out)._replace(shift=shift, slope=slope)
    if not characteristic.is_stable_at(model, np.zeros(len(model.sizes))):
        return "the nominal model is not proved to be stable, or in the region of the poles"
    if isinstance(proof, evidence.ProofOfMotions):
        gain = claim.bound if claim.kind == evidence.GAIN else 0.0
        rates = rates_of(system, claim.rates, "verify")
        return checked(system, model, rates, claim.size, gain, proof)
    ends = np.array([1.0 if name in claim.fixed else claim.size for name in model.names])
    try:
        if isinstance(proof, evidence.LyapunovProof):
            if slope:
                return f"Lyapunov functions prove nothing of a {claim.kind}"
            proves = lyapunov.replayed(model, ends, proof, claim.gain)
        else:
            proves = replayed(model, ends, characteristic.polynomials(model, ends), proof.log, claim.gain)
    except (WellPosednessError, AnalysisError) as error:
        return str(error)
    return "" if proves else f"the cuts do not prove that {claim}"
