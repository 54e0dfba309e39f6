"""The one pipeline: from a problem to a certified model. It knows no scene and no matrix.

forms -> extract -> reduce -> close -> reduce -> bound -> search -> check -> certificate
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib.metadata import version
from itertools import chain
from typing import NamedTuple

import numpy as np

from mbdlft.base import running
from mbdlft.base.errors import AnalysisError, StructureError, WellPosednessError
from mbdlft.base.parameter import deltas_at
from mbdlft.base.samples import SEED
from mbdlft.lft.lft import LFT, with_blocks
from mbdlft.lft.sampling import evaluate_at
from mbdlft.lft.sparse import SparseLFT, in_units
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.reduction import ExactLFT, in_scales
from mbdlft.order.work import SEARCH, Budget, Work, late_after
from mbdlft.pipeline import certification
from mbdlft.pipeline.forms import (
    Candidate,
    accelerations,
    candidates,
    degrees,
    near_relations,
    reduced_relations,
    restricted,
)
from mbdlft.pipeline.smaller import (
    Restricted,
    restrictions,
    smaller_candidates,
    without_dependent_channels,
)
from mbdlft.problem.relations import Problem, Reference, Stage, TrimRelations
from mbdlft.system.model import LFTModel, Parameters, Provenance, Trim
from mbdlft.system.regular import PROVE, Regularity, regularity

CUT_OFF = "search was cut off"  # a stage that tells so
DROPPED = "search: a result was dropped"  # one, too: what is there before it stands
_ENOUGH = (1e-11, 30.0)  # error of a result of a search, as of `error_of`, that is used in any case
_MOST_BY_SEARCH = 10.0  # times the error before a search
_MOST_RESTRICTED = 150  # channels, of which a step in exact numbers takes seconds
_OF_RESTRICTIONS, _OF_PROOF, _OF_LEFT = 1.0, 0.3, 0.3  # units of work, at most; part of what is left
_FEW_POINTS = 8  # of those of the check, at which errors are compared
_MOST_SEARCHED = 1000  # channels: one look at more takes minutes


class Smallest(NamedTuple):
    """The smallest LFTs of a value that a search finds, the smallest first, the least order of any, and
    whether seconds ended it early."""

    lfts: Iterable[LFT]
    order_bound: int
    is_cut_off: bool = False


def realization(problem: Problem, budget: Budget, stage: Stage, prove: float = PROVE) -> LFTModel:
    """The smallest certified model that a budget of search leads to; `prove`: work for well-posedness."""
    trim = Trim((), (), None)
    if problem.trim is not None:
        with stage("trim"):
            trim = _trim(problem, problem.trim)
    check = _Check(problem)
    with stage("reduce"):
        reduced = candidates(problem, problem.forms)
    is_sparse = isinstance(reduced[0].lft, SparseLFT)
    if is_sparse:  # its bound takes longer than another form
        reduced = _with_more_forms(problem, reduced, prove, stage)
    with stage("bound"):
        least = degrees(reduced[0], SEED)
    order_bound = sum(least.values())
    if order_bound < reduced[0].lft.order and not is_sparse:
        reduced = _with_more_forms(problem, reduced, prove, stage)
    with stage("near relations"):
        written = next(candidate for candidate in reduced if not candidate.form.is_from_values)
        near = near_relations(problem, written, reduced[0].lft.order)
    plain, result = _in_units(problem, reduced[0].lft), None
    if order_bound < plain.order <= _MOST_SEARCHED:
        with stage("search" if budget.work > 0.0 else "reduce"):
            if budget.work > 0.0:
                result = _smallest(problem, reduced, least, budget)
                order_bound = result.order_bound
            elif small := without_dependent_channels(problem, reduced[0], order_bound):
                result = Smallest(_of_both(small), order_bound)
        if result and result.is_cut_off:
            with stage(CUT_OFF):  # with more time the model may be smaller
                pass

    def model_of(lft: LFT, of_search: Regularity | None) -> LFTModel:
        with stage("prove"):
            loops = tuple(map(reduced_relations, problem.constraints() or ()))
            boxes = certification.open_boxes(lft, trim.lft, loops, problem, prove, of_search)
        with stage("check"):
            checked, raw = check.model(lft, trim.lft), reduced[0].channels
            evidence = certification.certificate(
                lft, raw, least, order_bound, problem, checked, SEED, boxes=boxes, near=near
            )
            if problem.states:
                evidence = replace(evidence, **accelerations(problem, written, lft))
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

    if result is not None:
        for smaller, known in _kept(problem, plain, result, prove, check, trim.lft, stage):
            with suppress(StructureError):  # doubles have lost what is exactly zero: another one has it
                return model_of(smaller, known)
    return model_of(plain, None)


def _kept(
    problem: Problem,
    plain: LFT,
    result: Smallest,
    prove: float,
    check: "_Check",
    trim: LFT | None,
    stage: Stage,
) -> Iterator[tuple[LFT, Regularity]]:
    """The smaller models that a search has found, if they have lost nothing, and what is known of them.

    What is dropped is told with the next one, or at the end.
    """
    dropped = ""
    for smaller in result.lfts:
        if smaller.order >= plain.order:
            break
        smaller = _in_units(problem, smaller)
        known = regularity(smaller, prove)
        lost = _what_is_lost(smaller, known, plain, check, trim)
        if not lost:
            _tell_dropped(dropped, stage)
            yield smaller, known
            lost = "entries that are zero are not zero in doubles"
        dropped = dropped or f"order {smaller.order}: {lost}"
    _tell_dropped(dropped, stage)


def _tell_dropped(dropped: str, stage: Stage) -> None:
    if dropped:
        with stage(f"{DROPPED} ({dropped})"):  # what is there before it stands
            pass


def _with_more_forms(
    problem: Problem, reduced: list[Candidate], prove: float, stage: Stage
) -> list[Candidate]:
    """Candidates of other forms, too, the smallest first."""
    if not (forms := problem.more_forms()):
        return reduced
    with stage("more forms"):
        found = (restricted(problem, form) for form in forms)
        more = [c for c in found if c is not None and not _is_singular(c, prove)]
        return sorted([*reduced, *more], key=lambda candidate: candidate.lft.order)


def _is_singular(candidate: Candidate, prove: float) -> bool:
    """Whether relations that were made from values are singular somewhere in the ranges."""
    return candidate.form.is_from_values and regularity(candidate.lft, prove).zero is not None


class _Check:
    """The points at which models of a problem are checked, and its reference, once it is needed."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._checked: dict[tuple[LFT, LFT | None], certification.Checked] = {}

    @cached_property
    def reference(self) -> Reference:
        return self.problem.reference()

    def model(self, lft: LFT, trim: LFT | None) -> certification.Checked:
        """Largest relative error of a model in its units, and of its trim, at all points."""
        if (lft, trim) not in self._checked:
            self._checked[lft, trim] = certification.measure_error(
                self.problem, lft, trim, self.reference
            )
        return self._checked[lft, trim]

    def error_of(self, lft: LFT) -> tuple[float, float]:
        """Largest error of a model at a few of the points: relative, in roundings."""
        problem, points = self.problem, self.problem.points
        some = slice(None, None, 1 + len(points) // _FEW_POINTS)
        try:
            values = evaluate_at(lft, deltas_at(problem.parameters, points[some]))
        except WellPosednessError:
            return float("inf"), float("inf")
        try:
            at = self.reference
        except WellPosednessError:  # the LFT can say where
            certification.values_at_points(lft, problem.parameters, points, problem.nouns)
            raise
        error, _ = certification.error_of_values(values, at.values[some], at)
        errors = np.abs(values - at.values[some])
        rounding, _ = certification.rounding_of(problem, lft, errors, at, some)
        ratio = float(np.max(errors / rounding, initial=0.0))
        return (error, ratio) if np.isfinite(error + ratio) else (float("inf"), float("inf"))


def _smallest(
    problem: Problem, reduced: list[Candidate], degrees: Mapping[str, int], budget: Budget
) -> Smallest:
    """Blocks restricted, then repetitions exchanged; pairs and triples tell the end.

    Each of the three has the whole work, so that more of it never leads to less. What is made from values
    has chosen its points: other forms lead to others.
    """
    start, others = reduced[0], reduced[1:] if reduced[0].form.is_from_values else []
    exact = start.exact
    if not isinstance(exact, ExactLFT):
        return Smallest((), sum(degrees.values()))
    is_late = late_after(budget.seconds)
    work, of_steps, of_exchanges = (Work(budget.work, is_late, running.tell) for _ in range(3))
    joint, best = JointBound(exact, degrees), start

    def bound(*, triples: bool) -> int:
        # triples come last: what restrictions may take is not theirs
        most = max(_OF_PROOF, _OF_LEFT * (work.left - triples * _OF_RESTRICTIONS))
        return joint.of_all(work.limited(most), triples=triples, best=best.lft.blocks)

    with running.budget(budget.work):
        order_bound = bound(triples=False)
        if order_bound >= start.lft.order:
            return Smallest((), order_bound, work.is_cut_off)
        if start.lft.order > _MOST_RESTRICTED:  # as without a search
            small = without_dependent_channels(problem, start, order_bound)
            if work.left > SEARCH:  # more work than by default
                order_bound = bound(triples=True)
            return Smallest(_of_both(small) if small else (), order_bound, work.is_cut_off)
    with running.budget(budget.work):
        starts = restrictions(start, degrees, order_bound, of_steps.limited(_OF_RESTRICTIONS))
    starts += filter(None, map(Restricted.plain, others))
    found = smaller_candidates(problem, starts, order_bound, of_exchanges)
    with running.budget(budget.work):
        best = next(found, start)
    with running.budget(budget.work):
        if best.lft.order > order_bound:
            order_bound = bound(triples=True)
    smaller = [] if best is start else chain([best], found)
    lfts = (lft for candidate in smaller for lft in _of_both(candidate))
    return Smallest(lfts, order_bound, any(each.is_cut_off for each in (work, of_steps, of_exchanges)))


def _of_both(candidate: Candidate) -> tuple[LFT, LFT]:
    """In good coordinates, and in some that keep zeros, in which other entries may have lost digits."""
    assert isinstance(candidate.exact, ExactLFT)
    return candidate.lft, in_scales(candidate.exact.rounded())


def _loses_digits(smaller: LFT, lft: LFT, check: _Check) -> bool:
    """Whether the result of a search has a larger error than rounding of the LFT that it began with."""
    pairs = zip(check.error_of(smaller), check.error_of(lft), _ENOUGH, strict=True)
    return any(after > max(enough, _MOST_BY_SEARCH * before) for after, before, enough in pairs)


def _what_is_lost(smaller: LFT, known: Regularity, lft: LFT, check: _Check, trim: LFT | None) -> str:
    """What the result of a search has lost of the model that it began with: its regularity, or digits."""
    try:
        check.model(smaller, trim)
    except (WellPosednessError, AnalysisError) as error:
        return str(error)
    # what has values at points can be singular between them
    if known.zero is not None:
        return "it is singular in the ranges"
    return "it has fewer digits" if _loses_digits(smaller, lft, check) else ""


def _in_units(problem: Problem, a: LFT) -> LFT:
    """An LFT of the divided relations as one of the problem, with all of its parameters."""
    if isinstance(a, SparseLFT):
        units = (problem.row_units, problem.column_units)
        by_row, by_column = (np.ones(n) if x is None else x for n, x in zip(a.shape, units, strict=True))
        return in_units(a, [p.name for p in problem.parameters], by_row, by_column)
    a = with_blocks(a, [p.name for p in problem.parameters])
    if problem.row_units is None or problem.column_units is None:
        return a
    rows, columns = problem.row_units[:, None], problem.column_units
    return LFT(a.M11, a.M12 * columns, rows * a.M21, rows * a.M22 * columns, a.blocks)


def _trim(problem: Problem, trim: TrimRelations) -> Trim:
    """Numbers at nominal from the nonlinear equations, and the static LFT from the relations."""
    relations, signals, nominal = trim
    lft = reduced_relations(relations)
    return Trim(signals, nominal, with_blocks(lft, [p.name for p in problem.parameters]))


def provenance(text: str) -> Provenance:
    """Versions, the time, and the TOML text that a model is made from."""
    return Provenance(
        scene=text,
        mbdlft=_version("mbdlft"),
        casadi=_version("casadi"),
        numpy=np.__version__,
        h5py=_version("h5py"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )


@cache
def _version(package: str) -> str:
    return version(package)
