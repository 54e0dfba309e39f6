"""Sentences on the certificate of a model, for the command line and for reports."""

import math
import sys
from collections.abc import Iterator

import numpy as np

from mbdlft.base.parameter import to_physical
from mbdlft.lft.sampling import evaluate_at, rounding_sizes
from mbdlft.problem.references import rounded_transfers, transfers
from mbdlft.response.frequency import carried_from
from mbdlft.system.evidence import sampled_deltas
from mbdlft.system.model import Certificate, LFTModel, System
from mbdlft.system.sampled import matrices_at

_EPS = sys.float_info.epsilon
_MOST_BOXES = 4  # that are listed
_EARLY = 0.01  # of the slowest pole: from there on, an acceleration should have its digits
_BELOW = {  # what is below it, with a position among the states and without
    True: "frequency responses are -w^2 times the position",
    False: "it has fewer: take -w^2 times a position of the same place",
}
_INSIDE = 0.98  # of the ranges
_SIX_DIGITS, _SOME_DIGITS = 1e-6, 1e-3  # shares of an entry that rounding may change
_EVIDENCE_OF_SCENE = 'format = "mbdlft-scene/'  # in the text of a scene, in provenance
_EVIDENCE_OF_MATRIX = 'format = "mbdlft-matrix/'  # how the text of a matrix begins, in provenance


def order_sentences(model: LFTModel) -> Iterator[str]:
    """Sentences on the order, its lower bound, and how the model differs from an exact one."""
    certificate = model.certificate
    alone = sum(certificate.lower_bound)
    if certificate.exact:
        proof = "minimal: proved" if certificate.minimal else "not proved minimal"
        together = certificate.order_bound - alone
        if certificate.exact_bound:
            proof += f" ({f'the {alone}' if together else 'bound'} in exact arithmetic)"
        split = f" ({alone} one by one, {together} more together)" if together else ""
        yield f"order {model.order}, lower bound {certificate.order_bound}{split}: {proof}"
    else:
        yield f"order {model.order}; the lower bound {alone} is that of exact models"
        if certificate.truncation_error == math.inf:
            yield "not exact: a part of it is truncated, and no bound of the error holds for the whole"
        elif certificate.truncation_error > 0.0:
            yield (
                f"not exact: values differ by at most {_upward(certificate.truncation_error)} of their "
                "typical sizes, on the whole range"
            )
        if certificate.fit_error_bound > 0.0:
            within = f"within {_upward(certificate.fit_error_bound)}"
            if _EVIDENCE_OF_SCENE in model.provenance.scene:
                what = f"positions are fits, {within} rad or m of the equilibrium"
            else:
                what = f"it has fits, {within} of the sizes of quantities, or in units of coefficients"
            yield f"not exact: {what}, on the whole range"
    if any(certificate.doubtful):
        unclear = ", ".join(
            f"{p.name} {count}"
            for p, count in zip(model.parameters, certificate.doubtful, strict=True)
            if count
        )
        yield f"ranks that rounding makes unclear, not counted in the bound: {unclear}"


def largest_error(model: LFTModel) -> str:
    """A sentence on the largest error that was found, and against what."""
    certificate = model.certificate
    # a scene has joints and so a trim; a matrix has none
    truth = "the nonlinear equations, linearized with numbers"
    if model.trim.signals:
        truth = "re-trimming and re-linearizing"
    elif _EVIDENCE_OF_MATRIX in model.provenance.scene[: len(_EVIDENCE_OF_MATRIX) + 40]:
        truth = "the matrix itself"
    return (
        f"maximum relative error {certificate.max_relative_error:.1e} against {truth} at "
        f"{certificate.check_points} points and corners"
        + (", before truncation" if certificate.truncation_error > 0.0 else "")
        + (", at the fitted positions" if certificate.fit_error_bound > 0.0 else "")
    )


def checked_beside(model: LFTModel) -> Iterator[str]:
    """Sentences on transfer functions, on entries without a size of their own, and on near relations."""
    certificate = model.certificate
    if certificate.frequencies:
        low, high = min(certificate.frequencies), max(certificate.frequencies)
        yield (
            f"transfer functions: largest error {certificate.transfer_error:.1e}, relative to their row, "
            f"at {len(certificate.frequencies)} frequencies, {low:.3g} to {high:.3g} rad/s"
        )
    slowest = np.min(np.abs(np.linalg.eigvals(model.A)), initial=np.inf)
    carried = carried_from(model)
    for has_position, below in _BELOW.items():
        late = {name: w for name, (w, has) in carried.items() if has is has_position}
        name = max(late, key=lambda each: late[each], default="")
        if name and late[name] > _EARLY * slowest:
            yield (
                "accelerations: the sum D + C (s I - A)^-1 B has six digits of "
                f"{name} from {late[name]:.2g} rad/s on; below, {below}"
            )
    yield from _small_entries(model)
    yield from _falling_entries(model)
    yield from (f"nearly: {text}" for text in certificate.near)
    if certificate.by_terms:
        named = [_entry(model, i, j) for i, j in certificate.by_terms]
        more = f" and {len(named) - _MOST_BOXES} more" if len(named) > _MOST_BOXES else ""
        yield (
            "entries that are only rounding of terms that cancel, and compared with these: "
            f"{', '.join(named[:_MOST_BOXES])}{more}"
        )


def _small_entries(model: LFTModel) -> Iterator[str]:
    """A sentence on the entry of the transfer functions that rounding changes most, relative to itself.

    At nominal, at frequencies of the certificate and a tenth of the least. An entry that rounding may
    change by all of itself, wherever it is looked at, may be zero, and is left out.
    """
    omega, states = np.array(model.certificate.frequencies), len(model.states)
    if not len(omega):
        return
    omega = np.append(0.1 * np.min(omega), omega)
    A, B, C, D = matrices_at(model, {})
    whole = np.block([[A, B], [C, D]])
    change = rounded_transfers(whole[None], states, omega, _EPS * np.abs(whole))[0]
    size = np.abs(transfers(whole[None], states, omega)[0])
    shares = change / np.where(size > 0.0, size, np.inf)
    shares = np.where(np.min(shares, axis=0) < _SOME_DIGITS, shares, 0.0)
    k, i, j = map(int, np.unravel_index(int(np.argmax(shares)), shares.shape))
    if shares[k, i, j] > _SIX_DIGITS:
        yield (
            f"small entries: rounding may change the response of {model.outputs[i].name} by "
            f"{model.inputs[j].name} by {shares[k, i, j]:.1e} of itself at {omega[k]:.3g} rad/s, where "
            f"it is {size[k, i, j] / np.max(size[k, i]):.1e} of its row"
        )


def _falling_entries(model: LFTModel) -> Iterator[str]:
    """A sentence on the entry of A, B, C, D that rounding of the model changes most, relative to itself.

    Near the points of the check, where an entry that vanishes at a corner does not. One that changes its
    sign, or that rounding may change by all of itself wherever it is looked at, is left out.
    """
    a, parameters = model.lft, model.parameters
    if not (a.is_plain and a.blocks and all(a.shape)):
        return
    deltas = _INSIDE * sampled_deltas(parameters, model.certificate.seed)
    numbers = [parameters.names.index(block.name) for block in a.blocks]
    values = evaluate_at(a, deltas[:, numbers])
    sizes = np.abs(values)
    shares = _EPS * rounding_sizes(a, deltas[:, numbers]) / np.where(sizes > 0.0, sizes, np.inf)
    is_known = shares < _SOME_DIGITS
    has_one_sign = np.any(is_known & (values > 0.0), axis=0) != np.any(is_known & (values < 0.0), axis=0)
    shares = np.where(has_one_sign, shares, 0.0)
    k, i, j = map(int, np.unravel_index(int(np.argmax(shares)), shares.shape))
    if shares[k, i, j] > _SIX_DIGITS:
        place = [
            f"{p.name} = {to_physical(p, x):.4g}" for p, x in zip(parameters, deltas[k], strict=True)
        ]
        yield (
            f"entries that fall: rounding may change {_entry(model, i, j)} by {shares[k, i, j]:.1e} of "
            f"itself at {', '.join(place)}, where it is {sizes[k, i, j] / np.max(sizes[:, i, j]):.1e} of "
            "its largest size; exports have no more digits there"
        )


def _entry(model: LFTModel, i: int, j: int) -> str:
    """The name of an entry of [A B ; C D]."""
    rows = [f"d{s.name}/dt" for s in model.states] + [s.name for s in model.outputs]
    return f"{rows[i]} by {(*model.states, *model.inputs)[j].name}"


def well_posed(model: LFTModel) -> Iterator[str]:
    """Sentences on whether the model is regular at every value in the ranges."""
    certificate = model.certificate
    if certificate.well_posed == "proved":
        yield "well-posed: proved in the whole range"
        return
    points = certificate.check_points
    yield f"well-posed: not proved; it is at {points} points and corners and on lines to some of them"
    boxes = certificate.open_boxes
    for box in boxes[:_MOST_BOXES]:
        sides = [
            f"{p.name} in [{low:.6g}, {high:.6g}] {p.unit}".removesuffix(" 1")
            for p, (low, high) in zip(model.parameters, box, strict=True)
            if (low, high) != (p.low, p.high)
        ]
        yield f"  open: {', '.join(sides) or 'the whole range'}"
    if len(boxes) > _MOST_BOXES:
        yield f"  and {len(boxes) - _MOST_BOXES} more; --prove with more work may close them"


def conditioning(certificate: Certificate) -> str:
    """A sentence on how much the rounding of the data may change the entries of the model."""
    change = certificate.condition * _EPS
    text = f"condition {certificate.condition:.1e}: rounding of numbers alone may change an entry "
    text += f"by {change:.1e} of itself; errors are up to {certificate.rounding_ratio:.2g} times rounding"
    if change > _EPS**0.5:
        text = f"ill-conditioned, {text}"
    if certificate.sign_changes:
        text += (
            f"; {certificate.sign_changes} entries change their sign in the range: near their zeros the "
            "errors are relative to their largest size"
        )
    return text


def _upward(error: float) -> str:
    """A bound as a text of three digits, which is never rounded down."""
    text = f"{error:.2e}"
    return text if float(text) >= error else f"{error + 0.01 * 10.0 ** int(text[-3:]):.2e}"


def certificate_sentences(model: System) -> tuple[str, ...]:
    """What is proved of a model, and what was checked."""
    if not isinstance(model, LFTModel):
        return (
            "The model is stored without evidence: that it equals what it was made of, and that it is "
            "small, is not proved. Proofs of margins and gains are of the model as it is stored.",
        )
    lines = [*order_sentences(model), largest_error(model), *checked_beside(model)]
    lines += well_posed(model)
    if model.certificate.condition > 0.0:
        lines.append(conditioning(model.certificate))
    return tuple(lines)
