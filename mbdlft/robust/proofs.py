"""A stored analysis is checked again: no search, no solver, and nothing believed that it says of itself.

From the claim follows what there is to be proved: which matrices, on which line, on which box, between
which signals. The proof is evidence for that and says none of it. Of cuts of a box
(`mbdlft.robust.bisect.boxes`), the coefficients of the polynomial are computed anew, in balls, and the
cuts repeated; of Lyapunov functions on its parts (`mbdlft.robust.bisect.lyapunov`) the functions are.
Of multipliers (`mbdlft.robust.mu.mixed`), each has the structure of Delta, its matrices
are definite, its eigenvalues leave its interval free, and the intervals of each part cover all
frequencies. Of a quadratic form (`mbdlft.robust.moving.variation`), the form is computed anew, in balls,
and is definite. All begin with a proof that the nominal model is stable, or in its region, by Routh's
scheme in balls. Then the worst case is looked at (`mbdlft.robust.reached`).
"""

import math

import numpy as np

from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.running import one_thread
from mbdlft.robust.bisect import lyapunov
from mbdlft.robust.bisect.boxes import replayed
from mbdlft.robust.bisect.characteristic import is_hurwitz, is_stable_at, polynomials
from mbdlft.robust.evidence import (
    DAMPING,
    DISK,
    GAIN,
    PERFORMANCE,
    REAL_PART,
    SENTENCES,
    STABILITY,
    Bounds,
    Claim,
    IntervalProof,
    LyapunovProof,
    MotionProof,
    Proof,
)
from mbdlft.robust.moving.varying import checked, rates_of
from mbdlft.robust.mu.coverage import GAIN as GAIN_BLOCK
from mbdlft.robust.mu.coverage import loop_of
from mbdlft.robust.mu.mixed import wrong_in
from mbdlft.robust.reached import not_reached
from mbdlft.robust.realization import realization, states_that_stay
from mbdlft.robust.worst import disk_transfer
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

_WITH_SIGNALS = (PERFORMANCE, GAIN, DISK)


def verify(system: System, bounds: Bounds) -> str:
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

    Raises
    ------
    AnalysisError, StructureError
        The states that do not count, or the signals of the gain, are not those of this system.
    """
    claim, proof = bounds.claim, bounds.proof
    if proof is None:
        return f"there is no proof{bounds.reason and ': '}{bounds.reason}"
    if not bounds.lower <= bounds.upper:
        return f"its lower bound {bounds.lower:g} is not below its upper bound {bounds.upper:g}"
    wrong = _malformed(system, claim, proof)
    if wrong:
        return wrong
    disk = claim.kind == DISK
    analyzed = disk_transfer(system, list(claim.inputs), list(claim.outputs)) if disk else system
    with one_thread():
        return _unproved(analyzed, claim, proof) or not_reached(analyzed, bounds)


def _malformed(system: System, claim: Claim, proof: Proof) -> str:
    """What makes a claim none, or a proof one of another kind; empty if they fit."""
    if claim.kind not in SENTENCES:
        return f"there is no proof of a {claim.kind}"
    is_signed = claim.kind in (REAL_PART, DAMPING)
    if not (math.isfinite(claim.bound) and (is_signed or claim.bound > 0.0)):
        return f"its bound {claim.bound:g} says nothing"
    if claim.kind == DAMPING and not -1.0 < claim.bound < 1.0:
        return f"no damping of all poles is at least {claim.bound:g}, or it says nothing"
    for names in (claim.inputs, claim.outputs):
        if bool(names) != (claim.kind in _WITH_SIGNALS) or len(set(names)) < len(names):
            return f"a {claim.kind} is not of the signals {', '.join(names) or '(none)'}"
    if claim.fixed and claim.kind != STABILITY:
        return f"a {claim.kind} has no blocks that are fixed"
    moving = bool(rates_of(system, claim.rates, "verify"))
    if moving != isinstance(proof, MotionProof):
        return f"the proof is for {'constant' if moving else 'moving'} parameters"
    if moving and (claim.kind not in (STABILITY, GAIN) or claim.fixed):
        return f"there is no proof of a {claim.kind} for parameters that move"
    return ""


def _unproved(system: System, claim: Claim, proof: Proof) -> str:
    """What is not proved of a claim; empty if all is."""
    inputs = positions_of(list(claim.inputs), [s.name for s in system.inputs], "verify: inputs")
    outputs = positions_of(list(claim.outputs), [s.name for s in system.outputs], "verify: outputs")
    if isinstance(proof, IntervalProof):
        stay = states_that_stay(system, claim.leave_out, outputs)
        loop = loop_of(system, stay, claim.fixed, inputs, outputs)
        if claim.kind in (GAIN, DISK):
            loop = loop._replace(grows=np.array([b.name == GAIN_BLOCK for b in loop.blocks], dtype=bool))
        if claim.kind in (REAL_PART, DAMPING):
            return f"multipliers prove nothing of a {claim.kind}"
        if not is_hurwitz(loop.channels.A):
            return "the nominal model is not proved to be stable"
        return wrong_in(loop, claim.gain if claim.kind in (GAIN, DISK) else claim.size, proof)
    shift, slope = claim.edge
    model = realization(system, inputs, outputs, claim.leave_out)._replace(shift=shift, slope=slope)
    if not is_stable_at(model, np.zeros(len(model.sizes))):
        return "the nominal model is not proved to be stable, or in the region of the poles"
    if isinstance(proof, MotionProof):
        gain = claim.bound if claim.kind == GAIN else 0.0
        rates = rates_of(system, claim.rates, "verify")
        return checked(system, model, rates, claim.size, gain, proof)
    ends = np.array([1.0 if name in claim.fixed else claim.size for name in model.names])
    try:
        if isinstance(proof, LyapunovProof):
            if claim.gain or slope:
                return f"Lyapunov functions prove nothing of a {claim.kind}"
            proves = lyapunov.replayed(model, ends, proof)
        else:
            proves = replayed(model, ends, polynomials(model, ends), proof.log, claim.gain)
    except (WellPosednessError, AnalysisError) as error:
        return str(error)
    return "" if proves else f"the cuts do not prove that {claim}"
