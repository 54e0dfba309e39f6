"""A stored proof is checked again: no search, no solver, and a margin for all rounding.

Of cuts of a box (`mbdlft.robust.bisect.boxes`), the coefficients of the polynomial are computed anew, in
balls, and the cuts repeated. Of multipliers (`mbdlft.robust.mu.mixed`), each has the structure of Delta,
its matrices are definite, its eigenvalues leave its interval free, and the intervals of each part cover
all frequencies. Of a quadratic form (`mbdlft.robust.moving.variation`), the form is computed anew, in
balls, and is definite. All begin with a proof that the nominal model is stable, by Routh's scheme in
balls.
"""

from dataclasses import replace

import numpy as np

from mbdlft.base.errors import WellPosednessError
from mbdlft.base.running import one_thread
from mbdlft.robust.bisect.boxes import replayed
from mbdlft.robust.bisect.characteristic import is_hurwitz, is_stable_at, polynomials
from mbdlft.robust.evidence import Bounds, BoxProof, IntervalProof, MotionProof, Proof
from mbdlft.robust.moving.varying import checked, rates_of
from mbdlft.robust.mu.coverage import GAIN, loop_of
from mbdlft.robust.mu.mixed import wrong_in
from mbdlft.robust.realization import realization, states_that_stay
from mbdlft.robust.worst import disk_transfer
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System


def verify(system: System, bounds: Bounds) -> str:
    """Check the proof of a bound again.

    Parameters
    ----------
    system : System or LFTModel
        The one that was analyzed.
    bounds : Bounds

    Returns
    -------
    str
        What is wrong; empty if the bound is proved.

    Raises
    ------
    AnalysisError, StructureError
        The states that do not count, or the signals of the gain, are not those of this system.
    """
    proof = bounds.proof
    if proof is None:
        return f"there is no proof{bounds.reason and ': '}{bounds.reason}"
    if bounds.kind == "smallest disk margin":
        system = disk_transfer(system, list(proof.inputs), list(proof.outputs))
        upper = 1.0 / bounds.lower if bounds.lower > 0.0 else np.inf
        bounds = replace(bounds, kind="worst-case gain", upper=upper)
    with one_thread():
        if isinstance(proof, MotionProof):
            return _of_motions(system, bounds, proof)
        if rates_of(system, bounds.rates, "verify"):
            return "the proof is for constant parameters"
        if isinstance(proof, BoxProof):
            if bounds.fixed:
                return "the proof is for blocks that all grow"
            return _of_boxes(system, bounds, proof)
        return _of_intervals(system, bounds, proof)


def _claimed(bounds: Bounds, proof: BoxProof) -> str:
    """What is wrong with what a proof would show, if it is less than what is said."""
    if bounds.kind == "worst-case gain":
        is_enough = proof.k >= 1.0 and proof.gain * bounds.upper >= 1.0
    elif bounds.kind == "largest real part":
        is_enough = proof.k >= 1.0 and proof.slope == 0.0 and proof.shift <= bounds.upper
    elif bounds.kind == "smallest damping":
        damping = proof.slope / float(np.hypot(1.0, proof.slope))
        is_enough = proof.k >= 1.0 and proof.shift == 0.0 and bounds.lower <= damping
    elif proof.shift or proof.slope:
        is_enough = False
    elif bounds.kind == "robust performance":
        is_enough = proof.k >= bounds.lower and proof.gain >= bounds.lower
    else:
        is_enough = bounds.kind == "robust stability" and proof.k >= bounds.lower
    if not is_enough:
        return f"the proof is for {proof.k:g} times the box, and less than what is said"
    return ""


def _signals(system: System, proof: Proof) -> tuple[list[int], list[int]]:
    """Positions of the inputs and outputs of a gain."""
    inputs = positions_of(list(proof.inputs), [s.name for s in system.inputs], "verify: inputs")
    outputs = positions_of(list(proof.outputs), [s.name for s in system.outputs], "verify: outputs")
    return inputs, outputs


def _of_motions(system: System, bounds: Bounds, proof: MotionProof) -> str:
    model = realization(system, *_signals(system, proof), bounds.leave_out)
    rates = rates_of(system, bounds.rates, "verify")
    if bounds.kind == "worst-case gain":
        is_right = proof.k >= 1.0 and 0.0 < proof.gain <= bounds.upper
    else:
        is_right = bounds.kind == "robust stability" and proof.k >= bounds.lower
    if not is_right:
        return f"the proof is for {proof.k:g} times the box, and less than what is said"
    if not is_hurwitz(model.A):
        return "the nominal model is not proved to be stable"
    return checked(system, model, rates, proof)


def _of_boxes(system: System, bounds: Bounds, proof: BoxProof) -> str:
    model = realization(system, *_signals(system, proof), bounds.leave_out)
    wrong = _claimed(bounds, proof)
    if wrong:
        return wrong
    model = model._replace(shift=proof.shift, slope=proof.slope)
    if not is_stable_at(model, np.zeros(len(model.sizes))):
        return "the nominal model is not proved to be stable, or in the region of the poles"
    try:
        coefficients = polynomials(model, proof.k)
    except WellPosednessError as error:
        return str(error)
    if not replayed(model, proof.k, coefficients, proof.log, proof.gain):
        return f"the cuts do not prove anything for {proof.k:g} times the box"
    return ""


def _of_intervals(system: System, bounds: Bounds, proof: IntervalProof) -> str:
    inputs, outputs = _signals(system, proof)
    stay = states_that_stay(system, bounds.leave_out, outputs)
    loop = loop_of(system, stay, proof.fixed, inputs, outputs)
    fixed, names = set(proof.fixed), {block.name for block in loop.blocks}
    if bounds.kind == "worst-case gain":
        is_enough = names - fixed == {GAIN} and bounds.upper * proof.k >= 1.0
    else:
        kinds = "robust performance" if GAIN in names else "robust stability"
        is_enough = bounds.kind == kinds and bounds.lower <= proof.k and fixed == set(bounds.fixed)
    if not is_enough:
        return f"the proof is for {proof.k:g} times the box, and less than what is said"
    if not is_hurwitz(loop.channels.A):
        return "the nominal model is not proved to be stable"
    return wrong_in(loop, proof)
