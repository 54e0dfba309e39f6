"""The one pipeline: from a problem to a certified model. It knows no scene and no matrix.

forms -> extract -> reduce -> close -> reduce -> bound -> search -> check -> certificate
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbdlft.base.errors import AnalysisError, StructureError, WellPosednessError
from mbdlft.base.samples import SEED
from mbdlft.bound.degree import Bound, degree_bounds, moved, preference
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, condition, eliminate, transpose, with_blocks
from mbdlft.pipeline.certify import (
    certificate,
    error_of_values,
    measure_error,
    values_at_points,
)
from mbdlft.pipeline.extract import Extraction, extract
from mbdlft.pipeline.provenance import provenance
from mbdlft.pipeline.search import CUT_OFF, Budget, Smallest, find_smallest
from mbdlft.problem.problem import Form, Problem, Reference, Stage, TrimRelations
from mbdlft.reduce.reduce import in_scales, reduce_order
from mbdlft.system.model import LFTModel, Trim
from mbdlft.system.points import deltas_at
from mbdlft.system.system import Parameters

_ENOUGH = 1e-11  # error of a form, or times the least: kept up to there
_MOST_LOST = 1e3
_MOST_BY_SEARCH = 10.0  # times the error before a search
_FEW_POINTS = 8  # of those of the check, at which forms are compared
_MOST_SEARCHED = 1000  # channels: one look at more takes minutes
_TAKES_PART = 0.1  # in a direction that nothing determines


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """One form, reduced.

    Attributes
    ----------
    extracted : Extraction
    relations : LFT
        As extracted, reduced.
    closed : LFT
        Solved for the unknown signals, not reduced.
    lft : LFT
        The same, reduced; rows and columns are still divided by their units.
    error : float
        Relative error of its values; 0.0 where no other form is compared with it.
    """

    form: Form
    extracted: Extraction
    relations: LFT
    closed: LFT
    lft: LFT
    error: float = 0.0


def realization(problem: Problem, budget: Budget, stage: Stage) -> LFTModel:
    """The smallest certified model of a problem that a budget of search leads to.

    Raises
    ------
    NotRationalError, StructureError, WellPosednessError, AnalysisError
        As `extract`, `measure_error`; or the relations cannot be solved at nominal.
    """
    trim = Trim((), (), None)
    if problem.trim is not None:
        with stage("trim"):
            trim = _trim(problem, problem.trim)
    with stage("extract"):
        extracted = [_extract(problem, form) for form in problem.forms]
    check = _Check(problem)
    with stage("reduce"):
        candidates = _kept(
            [
                _candidate(problem, form, extraction, check)
                for form, extraction in zip(problem.forms, extracted, strict=True)
            ]
        )
    with stage("bound"):
        degrees = _degree_bounds(problem, candidates)
    bound = {name: one.degree for name, one in degrees.items()}
    lft, order_bound = candidates[0].lft, sum(bound.values())
    if order_bound < lft.order and (forms := problem.more_forms()):
        with stage("more forms"):
            more = [_candidate(problem, form, _extract(problem, form), check) for form in forms]
        candidates = sorted([*candidates, *more], key=lambda one: (one.lft.order, one.error))
        lft = candidates[0].lft
    if budget.work > 0.0 and order_bound < lft.order <= _MOST_SEARCHED:
        with stage("search"):
            smaller, order_bound, is_cut_off = _search(problem, candidates, bound, budget)
            if smaller.order < lft.order and not _loses_digits(smaller, lft, check):
                lft = smaller
        if is_cut_off:
            with stage(CUT_OFF):  # with more time the model may be smaller
                pass
    lft = _in_units(problem, with_blocks(lft, [p.name for p in problem.parameters]))
    with stage("check"):
        error, raw = check.model(lft, trim.lft), candidates[0].extracted.channels
        evidence = certificate(
            lft, raw, degrees, order_bound, problem, check.reference, error, SEED
        )
    return LFTModel(
        name=problem.nouns.name,
        lft=lft,
        states=problem.states,
        inputs=problem.inputs,
        outputs=problem.outputs,
        parameters=Parameters(problem.parameters),
        trim=trim,
        certificate=evidence,
        provenance=provenance(problem.text),
        description=problem.description,
    )


class _Check:
    """The points at which models of a problem are checked, and its reference, once it is needed."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    @cached_property
    def reference(self) -> Reference:
        return self.problem.reference()

    def model(self, lft: LFT, trim: LFT | None) -> float:
        """Largest relative error of a model in its units, and of its trim, at all points."""
        problem = self.problem
        values = values_at_points(lft, problem.parameters, problem.points, problem.nouns)
        return measure_error(problem, values, trim, self.reference)

    def error_of(self, lft: LFT) -> float:
        """Largest relative error of an LFT in divided units, at a few of the points."""
        problem, points = self.problem, self.problem.points
        some = slice(None, None, 1 + len(points) // _FEW_POINTS)
        lft = _in_units(problem, lft)
        try:
            values = evaluate_at(lft, deltas_at(problem.parameters, points[some]))
        except WellPosednessError:
            return float("inf")
        try:
            error = error_of_values(values, self.reference, some)
        except WellPosednessError:  # the LFT can say where
            values_at_points(lft, problem.parameters, points, problem.nouns)
            raise
        return error if np.isfinite(error) else float("inf")


def _extract(problem: Problem, form: Form) -> Extraction:
    try:
        extracted = extract(form.relations, form.maps)
    except (StructureError, WellPosednessError) as error:
        raise type(error)(f"{problem.nouns.owner}: {error}") from None
    lft = transpose(extracted.lft) if form.is_transposed else extracted.lft
    if not form.relations.unknown.numel():  # rows of equations have sizes of their own
        lft = in_scales(lft)
    return extracted._replace(lft=lft)


def _candidate(problem: Problem, form: Form, extracted: Extraction, check: _Check) -> _Candidate:
    """A form reduced; or, where it has lost digits that another way to write it keeps, that one."""
    first = _reduced(problem, form, extracted)
    again = form.again(extracted.order)
    if again is None and len(problem.forms) == 1:
        return first
    first = _with_error(first, check)
    if again is None or first.error <= form.most_error:
        return first
    source = extracted if again.relations is form.relations else _extract(problem, again)
    other = _with_error(_reduced(problem, again, source), check)
    is_better = other.error < first.error
    is_small = other.lft.order <= first.lft.order or first.error > _ENOUGH
    return other if is_better and is_small else first


def _with_error(candidate: _Candidate, check: _Check) -> _Candidate:
    return replace(candidate, error=check.error_of(candidate.lft))


def _reduced(problem: Problem, form: Form, extracted: Extraction) -> _Candidate:
    if form.in_extended_precision:
        closed = _solved(problem, form, extracted.whole())
        return _Candidate(
            form, extracted, extracted.lft, closed, reduce_order(closed, extended=True)
        )
    relations = reduce_order(extracted.lft)
    closed = _solved(problem, form, relations)
    lft = closed if closed is relations else reduce_order(closed)
    if form.closes_unreduced:
        other = reduce_order(_solved(problem, form, extracted.whole()))
        lft = min(other, lft, key=lambda one: one.order)
    return _Candidate(form, extracted, relations, closed, lft)


def _solved(problem: Problem, form: Form, relations: LFT) -> LFT:
    """The relations solved for their unknown signals: the LFT of [A B ; C D], not reduced."""
    n, outputs = form.relations.unknown.numel(), form.relations.output.numel()
    if n == 0:
        return relations
    # the equations come first; there are as many as unknowns
    try:
        solved = eliminate(relations, n)
    except WellPosednessError:
        inner = relations.M22[:n, :n]
        directions = np.abs(np.linalg.svd(inner)[2][-1])
        names = [
            signal.name
            for signal, size in zip(problem.states, directions, strict=False)
            if size > _TAKES_PART
        ]
        raise WellPosednessError(
            f"{problem.nouns.owner}: {problem.singular(condition(inner), names)}"
        ) from None
    rows = [*range(form.relations.derivatives), *range(n, n + outputs)]
    return LFT(solved.M11, solved.M12, solved.M21[rows], solved.M22[rows], solved.blocks)


def _kept(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """The candidates by order, the smallest first, without those that lose digits that others have."""
    most = max(_ENOUGH, _MOST_LOST * min(one.error for one in candidates))
    kept = [one for one in candidates if one.error <= most]
    return sorted(kept, key=lambda one: (one.lft.order, one.error))


def _degree_bounds(problem: Problem, candidates: Sequence[_Candidate]) -> dict[str, Bound]:
    """The most that one of the candidates proves, with each as its twin: errors of reductions differ.

    More than the size of a delta in one of them rests on a wrong rank.
    """
    if problem.proved_degrees is not None:
        _check_proved(problem, candidates[0].lft)
        return {name: Bound(degree, 0) for name, degree in problem.proved_degrees.items()}
    names = [block.name for block in candidates[0].lft.blocks]
    sizes = {name: min(dict(one.lft.blocks)[name] for one in candidates) for name in names}
    twins = [_twin(problem, one) for one in candidates]
    bounds = {name: Bound(0, size) for name, size in sizes.items()}
    for one in candidates:
        by_twin = [degree_bounds(one.lft, twin, SEED) for twin in twins]
        for name, known in bounds.items():
            least = min((bound[name] for bound in by_twin), key=lambda bound: bound.degree)
            clear = least._replace(degree=min(least.degree, sizes[name]))
            bounds[name] = max(known, clear, key=preference)
        if not any(bound.doubtful for bound in bounds.values()):
            break
    return bounds


def _twin(problem: Problem, candidate: _Candidate) -> LFT:
    """The candidate from data that are moved by what may be wrong with them.

    Relations are moved once they are reduced: solving them and the next reduction are the steps that
    make errors large. Where there is nothing to solve they are moved as they were extracted.
    """
    is_solved = candidate.form.relations.unknown.numel() > 0
    data = candidate.relations if is_solved else candidate.extracted.lft
    data = moved(data, SEED, candidate.error)
    return reduce_order(_solved(problem, candidate.form, data))


def _check_proved(problem: Problem, lft: LFT) -> None:
    """A model with fewer repetitions than are proved to be needed is not exact."""
    for name, size in lft.blocks:
        degree = (problem.proved_degrees or {}).get(name, 0)
        if size < degree:
            raise AnalysisError(
                f"{problem.nouns.owner}: the numbers as written need {degree} repetitions of "
                f"{name}, and reduction in double precision kept {size}: two terms differ by no more "
                "than rounding. Make equal what is meant to be equal."
            )


def _search(
    problem: Problem, candidates: Sequence[_Candidate], bound: Mapping[str, int], budget: Budget
) -> Smallest:
    best = candidates[0]
    form = best.form
    if not form.relations.unknown.numel():
        return find_smallest([one.lft for one in candidates], bound, budget)

    def close(relations: LFT) -> LFT:
        return reduce_order(_solved(problem, form, relations))

    forms = [one.relations for one in candidates]
    return find_smallest([best.lft], bound, budget, forms, close, candidates[0].closed)


def _loses_digits(smaller: LFT, lft: LFT, check: _Check) -> bool:
    """Whether the result of a search has a larger error than rounding of the LFT that it began with."""
    return check.error_of(smaller) > max(_ENOUGH, _MOST_BY_SEARCH * check.error_of(lft))


def _in_units(problem: Problem, a: LFT) -> LFT:
    """An LFT of the divided relations as one of the problem."""
    if problem.row_units is None or problem.column_units is None:
        return a
    rows, columns = problem.row_units[:, None], problem.column_units
    return LFT(a.M11, a.M12 * columns, rows * a.M21, rows * a.M22 * columns, a.blocks)


def _trim(problem: Problem, trim: TrimRelations) -> Trim:
    """Numbers at nominal from the nonlinear equations, and the static LFT from the relations."""
    relations, signals, nominal = trim
    extracted = extract(relations)
    lft = reduce_order(eliminate(extracted.lft, relations.unknown.numel()))
    return Trim(signals, nominal, with_blocks(lft, [p.name for p in problem.parameters]))
