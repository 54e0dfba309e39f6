"""The certificate: how small the model is, how small it could be, and how far it is from the truth."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError, naming
from mbdlft.base.parameter import Parameter, at_values, deltas_at
from mbdlft.exact.rounding import EPS, MOST_ROUNDINGS, conditioning, largest
from mbdlft.lft.determinant import values_at, vanishes
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import rounding_sizes
from mbdlft.lft.sparse import SparseLFT
from mbdlft.problem.references import frequencies_of, largest_of_rows, rounded_transfers, transfers
from mbdlft.problem.relations import Nouns, Problem, Reference
from mbdlft.system.model import Certificate
from mbdlft.system.regular import PROVED, SAMPLED, Regularity, check_no_zero, physical_boxes, regularity
from mbdlft.system.sampled import in_twofold

Boxes = tuple[tuple[tuple[float, float], ...], ...]  # physical: (low, high) of each parameter

ACCEPTED = 1e-5  # of an error of an entry; larger ones are refused, also if rounding explains them
_LOOKED_AT = 16  # points at which cancellation in the LFT is looked at
_CARRIED = 1e-11  # of an error in doubles: what the reference may have lost is not looked at
_AT_FIRST = 1e-3  # units of work before a theorem is looked for


class Checked(NamedTuple):
    """How far the values of a model are from those of its reference."""

    error: float  # largest relative error of entries of A, B, C, D, and of the trim
    points: int  # where it was measured
    transfer_error: float  # largest error of transfer functions, relative to the row
    # where that was measured (rad/s); empty for a model without states
    frequencies: tuple[float, ...]
    # entries of [A B ; C D] that are nothing but rounding of terms that
    # cancelled: their errors are relative to those
    by_terms: tuple[tuple[int, int], ...]
    # condition and number of changes of sign, as in `Certificate`
    condition: float
    sign_changes: int
    rounding_ratio: float  # largest error in units of 2.2e-16 times the sizes of its terms


def measure_error(problem: Problem, lft: LFT, trim: LFT | None, at: Reference) -> Checked:
    """Largest relative error of the values of a model at all points, and of its trim.

    Where the values in doubles differ by more than `_CARRIED`, or by more than rounding explains, which
    may be what the reference has lost, a few of the points are computed in 50 digits, and the error is
    that to those. An error that rounding does not explain, also where the model is evaluated in twice the
    digits, is a contradiction of two derivations.
    """
    values = values_at_points(lft, problem.parameters, problem.points, problem.nouns)
    errors, count = np.abs(values - at.values), len(values)
    rounding, by_channels = rounding_of(problem, lft, errors, at)
    ratios = errors / rounding
    error, by_terms = error_of_values(values, at.values, at)
    # nominal, where doubles differ most, and a corner
    far, odd = (np.max(x, axis=(1, 2), initial=0.0) for x in (errors / at.scale, ratios))
    some = sorted({0, int(np.argmax(far)), int(np.argmax(odd)), count - 1})
    if (by_terms or error > _CARRIED or np.any(odd > MOST_ROUNDINGS)) and at.in_digits is not None:
        with naming(problem.nouns.owner, WellPosednessError):
            truth = at.in_digits(problem.points[some])
        error, by_terms = error_of_values(values[some], truth, at, in_digits=True)
        ratios, count = np.abs(values[some] - truth) / rounding, len(some)
        # evaluation has lost digits, and other kernels lose others
        if np.any(ratios > MOST_ROUNDINGS) and not isinstance(lft, SparseLFT):
            finer = in_twofold(lft, deltas_at(problem.parameters, problem.points[some]))
            ratios = np.abs(finer - truth) / rounding
    nouns = problem.nouns
    _, i, j = np.unravel_index(np.argmax(ratios), ratios.shape) if ratios.size else (0, 0, 0)
    of_entries = float(np.max(ratios, initial=0.0))
    _check_roundings(nouns, f"entry ({i + 1}, {j + 1}) of [A B ; C D]", of_entries)
    if not error <= ACCEPTED:
        raise AnalysisError(
            f"{nouns.owner}: the model differs from {nouns.truth} by {error:.1e} of the size of an entry "
            f"of its matrices. Rounding explains that: {nouns.badly_scaled}."
        )
    of_omitted = at.omitted()
    _check_roundings(nouns, "what states that are left out would change", of_omitted)
    trim_error, of_trim = (0.0, 0.0) if trim is None else _error_of_trim(problem, trim, at)
    transfer_error, frequencies, of_transfers = _error_of_transfers(
        problem, values[some], some, at, rounding
    )
    by_data, sign_changes = conditioning(at.values, at.sizes(), at.scale, at.least)
    return Checked(
        max(error, trim_error),
        count,
        transfer_error,
        frequencies,
        by_terms,
        max(by_data, by_channels),
        sign_changes,
        max(of_entries, of_omitted, of_trim, of_transfers),
    )


def _check_roundings(nouns: Nouns, what: str, ratio: float) -> None:
    """Raise an AnalysisError where an error is more than rounding."""
    if not ratio <= MOST_ROUNDINGS:
        raise AnalysisError(
            f"{nouns.owner}: {what} differs from {nouns.truth} by {ratio:.1e} times what rounding of all "
            f"numbers may change, at most {MOST_ROUNDINGS:g} was expected. Two derivations contradict "
            f"each other: this is a bug, please report the {nouns.kind}."
        )


def _error_of_trim(problem: Problem, trim: LFT, at: Reference) -> tuple[float, float]:
    """Largest error of a trim relative to its sizes, and in roundings of its terms and of its LFT."""
    at_points = (problem.parameters, problem.points, problem.nouns)
    trimmed = values_at_points(trim, *at_points, what="trim")[:, :, 0]
    errors, scale = np.abs(trimmed - at.trimmed), at.trim_scale
    looked_at = np.any(errors > MOST_ROUNDINGS * EPS * scale, axis=1)
    looked_at[np.linspace(0, len(errors) - 1, _LOOKED_AT).astype(int)] = True
    deltas = deltas_at(problem.parameters, problem.points[looked_at])
    sizes = np.maximum(scale, np.max(rounding_sizes(trim, deltas)[:, :, 0], axis=0))
    # doubles may have lost what is compared with
    if np.any(errors > MOST_ROUNDINGS * EPS * sizes) and at.trim_in_digits:
        truth, scale = at.trim_in_digits()
        errors = np.abs(trimmed - truth)
    ratios = np.max(errors / (EPS * sizes), axis=0, initial=0.0)
    if ratios.size:
        name = problem.trim.signals[int(np.argmax(ratios))].name if problem.trim else ""
        _check_roundings(problem.nouns, f"{name} of the trim", float(np.max(ratios)))
    return largest(errors, scale), float(np.max(ratios, initial=0.0))


def rounding_of(
    problem: Problem, lft: LFT, errors: Array, at: Reference, some: slice = slice(None)
) -> tuple[Array, float]:
    """Rounding (., .) of each entry at some points, and the condition of the LFT by its channels.

    Sizes of terms are those of the data, and of the LFT at a few points and where errors are large.
    """
    sizes = at.sizes()[some]
    looked_at = np.any(errors > MOST_ROUNDINGS * EPS * sizes, axis=(1, 2))
    looked_at[np.linspace(0, len(sizes) - 1, _LOOKED_AT).astype(int)] = True
    deltas = deltas_at(problem.parameters, problem.points[some][looked_at])
    of_lft = np.max(rounding_sizes(lft, deltas), axis=0)
    rounding = EPS * np.maximum(at.scale, np.maximum(np.max(sizes, axis=0), of_lft))
    return rounding, float(np.max(of_lft / at.scale, initial=1.0))


def _error_of_transfers(
    problem: Problem, values: Array, some: Sequence[int], at: Reference, rounding: Array
) -> tuple[float, tuple[float, ...], float]:
    """Largest error of transfer functions at some points, in 50 digits if needed; frequencies; roundings.

    `rounding` (., .) of [A B ; C D] changes them by what the resolvent makes of it (`rounded_transfers`).
    """
    states = len(problem.states)
    if not (states and problem.inputs and problem.outputs):
        return 0.0, (), 0.0
    frequencies = frequencies_of(values[:, :states, :states])
    of_model = transfers(values, states, frequencies)
    truth = at.transfers(some, frequencies)
    if largest_of_rows(of_model, truth) > _CARRIED:
        # half of the points and of the frequencies: each takes as long as all of them in doubles
        values, some, frequencies = values[::2], some[::2], frequencies[::2]
        of_model, truth = of_model[::2, ::2], at.transfers_in_digits(some, frequencies)
    error, ratio = largest_of_rows(of_model, truth), 0.0
    if error > _CARRIED:
        change = rounded_transfers(values, states, frequencies, rounding)
        ratio = float(np.max(np.abs(of_model - truth) / change, initial=0.0))
        _check_roundings(problem.nouns, "a transfer function of the model", ratio)
    return error, tuple(frequencies.tolist()), ratio


def error_of_values(
    values: Array, truth: Array, at: Reference, *, in_digits: bool = False
) -> tuple[float, tuple[tuple[int, int], ...]]:
    """Largest relative error of [A B ; C D] (N, ., .), and entries that are rounding of terms.

    An entry that is far off is taken for rounding if the true values are doubles, as these may have
    lost it; if they are known in 50 digits, only one that is zero.
    """
    differences = values - truth
    error = largest(differences, at.scale)
    if error <= ACCEPTED:
        return error, ()
    coarse = at.if_cancelled()
    is_rounding = ~(np.max(np.abs(differences), axis=0) <= ACCEPTED * at.scale)
    if in_digits:
        is_rounding &= np.max(np.abs(truth), axis=0) == 0.0
    scale = np.where(is_rounding, coarse, at.scale)
    by_terms = np.argwhere(is_rounding & (coarse > at.scale)).tolist()
    return largest(differences, scale), tuple((i, j) for i, j in by_terms)


def values_at_points(
    lft: LFT, parameters: Sequence[Parameter], points: Array, nouns: Nouns, what: str = "model"
) -> Array:
    """Values (N, ., .) at physical points, once det(I - D_zw Delta) was seen to stay away from zero.

    The determinant is 1 at nominal, so a point where it is not positive means that it vanishes
    between them. To some of the points the whole line from nominal is searched.
    """
    deltas = deltas_at(parameters, points)
    values, signs = values_at(lft, deltas)
    singular = (signs <= 0.0) | vanishes(lft, deltas)
    if np.any(singular):
        worst = points[int(np.argmax(singular))]
        raise WellPosednessError(
            f"{nouns.owner}: the {what} is singular between the nominal values and "
            f"{at_values(parameters, worst)}. Narrow the ranges{nouns.narrow}."
        )
    return values


def open_boxes(
    lft: LFT,
    trim: LFT | None,
    loops: Sequence[LFT],
    problem: Problem,
    prove: float,
    of_search: Regularity | None,
) -> Boxes:
    """Physical boxes in which a model, its trim and its closed loops were not proved to be regular.

    `of_search`: what is known of a model that comes from a search.
    """
    looked_at = []
    known = of_search or regularity(lft, min(prove, _AT_FIRST))
    # a theorem about the problem may show more than the LFT itself: the determinant of a reduced LFT
    # divides that of the relations that it comes from. A search may have made another one
    is_open = not (of_search or known.is_proved or known.zero is not None)
    if not is_open or not problem.is_regular():
        known = regularity(lft, prove) if is_open and prove > _AT_FIRST else known
        looked_at.append((lft, known, "the model is singular"))
    if trim is not None:
        looked_at.append((trim, regularity(trim, prove), "no finite efforts hold it"))
    if loops:
        square, every = loops
        looked_at.append((every, _of_loops(square, every, prove), _BRANCHES))
    boxes: Boxes = ()
    for checked, known, problem_is in looked_at:
        names, what = [block.name for block in checked.blocks], f"{problem.nouns.owner}: {problem_is}"
        check_no_zero(known, names, problem.parameters, what, problem.nouns.narrow)
        boxes += physical_boxes(known.open_boxes, names, problem.parameters)
    return boxes


# where constraints depend on each other no linear model exists, also if the reduced LFT is regular: what
# is singular has cancelled in it
_BRANCHES = "the constraints of its loops depend on each other, and branches of its motion meet,"


def _of_loops(square: LFT, every: LFT, prove: float) -> Regularity:
    """Whether constraints are independent: proved by the coordinates that follow, or by all of them."""
    by_followers = regularity(square, prove)
    if by_followers.is_proved:
        return by_followers
    known, names = regularity(every, prove), [block.name for block in every.blocks]
    if known.zero is not None or by_followers.zero is None:
        return known
    named = dict(zip((b.name for b in square.blocks), by_followers.zero, strict=True))
    at = np.array([named.get(name, 0.0) for name in names])
    inside = any(np.all(np.abs(at - center) <= half) for center, half in known.open_boxes)
    return Regularity(known.open_boxes, at if inside else None)


def certificate(
    lft: LFT,
    raw: Mapping[str, int],
    degrees: Mapping[str, int],
    order_bound: int,
    problem: Problem,
    checked: Checked,
    seed: int,
    *,
    boxes: Boxes,
    near: tuple[str, ...] = (),
) -> Certificate:
    """The certificate of a model; `raw` are its channels before reduction, by parameter.

    Where the model is smaller than a bound, nothing is claimed for that parameter, nor for pairs.
    """
    order = dict(lft.blocks)
    wrong = {name for name, size in order.items() if degrees[name] > size}
    lower = {name: 0 if name in wrong else degrees[name] for name in order}
    contradicted = wrong or order_bound > lft.order
    return Certificate(
        order=tuple(order.values()),
        lower_bound=tuple(lower.values()),
        raw_order=tuple(raw.get(name, 0) for name in order),
        max_relative_error=checked.error,
        check_points=checked.points,
        transfer_error=checked.transfer_error,
        frequencies=checked.frequencies,
        by_terms=checked.by_terms,
        near=near,
        condition=checked.condition,
        sign_changes=checked.sign_changes,
        rounding_ratio=checked.rounding_ratio,
        seed=seed,
        exact=problem.fit_error_bound == 0.0,
        fit_error_bound=problem.fit_error_bound,
        exact_bound=True,
        doubtful=tuple(size if name in wrong else 0 for name, size in order.items()),
        order_bound=sum(lower.values()) if contradicted else order_bound,
        well_posed=SAMPLED if boxes else PROVED,
        open_boxes=boxes,
    )
