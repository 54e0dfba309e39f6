"""The ways to write a problem, each extracted, solved and reduced in exact numbers, and rounded once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, WellPosednessError
from mbdlft.base.threads import without_collection
from mbdlft.exact.matrices import TooFewBitsError
from mbdlft.exact.numbers import BITS, MOST_BITS, precision
from mbdlft.lft.lft import LFT, condition
from mbdlft.order.balanced import in_good_coordinates
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly, transposed
from mbdlft.order.reduction_in_doubles import Closing, in_scales, reduce_order
from mbdlft.pipeline.extract import extract
from mbdlft.problem.linearize import LinearModel
from mbdlft.problem.problem import Form, Problem
from mbdlft.system.points import deltas_at

_MOST_EXACT = 1500  # channels after the reduction of words: exact numbers take gigabytes for more
_MOST_CONDITION = 1e3  # of I - M11 Delta, up to which three digits are lost and zeros are kept
_TAKES_PART = 0.1  # in a direction that nothing determines


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One form, reduced; rows and columns are still divided by their units.

    Attributes
    ----------
    channels : of the signal graph before any reduction, by parameter
    relations : LFT
        As extracted, reduced.
    closed : LFT
        Solved for the unknown signals, not reduced.
    exact : ExactLFT, or None
        The same, reduced. None for what is too large for exact numbers: it is reduced in doubles.
    lft : LFT
        The last in doubles.
    """

    form: Form
    channels: Mapping[str, int]
    relations: LFT
    closed: LFT
    exact: ExactLFT | None
    lft: LFT


def candidates(problem: Problem, forms: Sequence[Form]) -> list[Candidate]:
    """A candidate of each form, the smallest first.

    Raises
    ------
    NotRationalError, StructureError, WellPosednessError
        As `extract`; or the relations cannot be solved at nominal.
    """
    with without_collection():
        found = [_in_enough_bits(problem, form) for form in forms]
    return sorted(found, key=lambda one: one.lft.order)


def reduced_relations(relations: LinearModel) -> LFT:
    """Relations solved for all of their unknown signals, reduced and rounded."""
    n, bits = relations.unknown.numel(), BITS
    while True:
        try:
            with precision(bits):
                opened = reduce_exactly(extract(relations).lft)
                return in_scales(reduce_exactly(eliminated(opened, n, [*range(n)])).rounded())
        except TooFewBitsError:
            bits = _more(bits, "trim")


def _in_enough_bits(problem: Problem, form: Form) -> Candidate:
    bits = BITS
    while True:
        try:
            with precision(bits):
                return _candidate(problem, form)
        except TooFewBitsError:
            bits = _more(bits, problem.nouns.owner)


def _more(bits: int, owner: str) -> int:
    if bits >= MOST_BITS:
        raise AnalysisError(
            f"{owner}: numbers that are not zero cannot be told from zero in {bits} bits. Terms cancel "
            "nearly, such as an axis that is nearly parallel to another one: make equal what is meant to "
            "be equal."
        )
    return 2 * bits


def _candidate(problem: Problem, form: Form) -> Candidate:
    try:
        extracted = extract(form.relations, form.maps)
    except (StructureError, WellPosednessError) as error:
        raise type(error)(f"{problem.nouns.owner}: {error}") from None
    opened = transposed(extracted.lft) if form.is_transposed else extracted.lft
    if opened.order > _MOST_EXACT:
        return _in_doubles(problem, form, extracted.channels, in_scales(opened.rounded()))
    relations = reduce_exactly(opened)
    n = form.relations.unknown.numel()
    if not n:
        lft = in_scales(relations.rounded())
        best = in_good_coordinates(relations, _some_deltas(problem, relations), _MOST_CONDITION)
        return Candidate(form, extracted.channels, lft, lft, relations, best)
    # the equations come first; there are as many as unknowns
    outputs = range(n, n + form.relations.output.numel())
    try:
        closed = eliminated(relations, n, [*range(form.relations.derivatives), *outputs])
    except ZeroDivisionError:
        raise _singular(problem, relations.rounded(), n) from None
    exact = reduce_exactly(closed)
    return Candidate(
        form,
        extracted.channels,
        in_scales(relations.rounded()),
        in_scales(closed.rounded()),
        exact,
        in_good_coordinates(exact, _some_deltas(problem, exact), _MOST_CONDITION),
    )


def _some_deltas(problem: Problem, a: ExactLFT) -> Array:
    """Deltas (N, number of blocks) of a few of the points of the check."""
    names = [parameter.name for parameter in problem.parameters]
    points = problem.points[sorted({0, len(problem.points) // 2, len(problem.points) - 1})]
    deltas = deltas_at(problem.parameters, points)
    return np.asarray(deltas[:, [names.index(block.name) for block in a.blocks]])


def _in_doubles(
    problem: Problem, form: Form, channels: Mapping[str, int], opened: LFT
) -> Candidate:
    """The same, reduced with ranks that are decided by the rounding error of doubles."""
    relations = reduce_order(opened)
    n = form.relations.unknown.numel()
    if not n:
        return Candidate(form, channels, relations, relations, None, relations)
    try:
        closed = closing(form.relations).solved(relations)
    except WellPosednessError:
        raise _singular(problem, relations, n) from None
    return Candidate(form, channels, relations, closed, None, reduce_order(closed))


def closing(relations: LinearModel) -> Closing:
    """How relations are closed."""
    return Closing(relations.unknown.numel(), relations.derivatives, relations.output.numel())


def _singular(problem: Problem, relations: LFT, n: int) -> WellPosednessError:
    inner = relations.M22[:n, :n]
    directions = np.abs(np.linalg.svd(inner)[2][-1])
    names = [
        signal.name
        for signal, size in zip(problem.states, directions, strict=False)
        if size > _TAKES_PART
    ]
    return WellPosednessError(f"{problem.nouns.owner}: {problem.singular(condition(inner), names)}")
