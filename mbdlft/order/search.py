"""The search for a smaller LFT of the same value, and for a better lower bound on its order.

n-D reduction takes a product of deltas as a noncommutative monomial. Deltas commute, and a step uses
it: repetitions of one delta are left out by Newton's method on the values (`mbdlft.order.refit`).
Pairs and triples of deltas (`mbdlft.order.joint_bound`) show how small the order can be: then the search
is over. Every result is compared with the values of what it was made of, entry by entry.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property, partial
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from mbdlft.base import running
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, SceneError, WellPosednessError
from mbdlft.exact.rounding import equilibrate, or_one
from mbdlft.lft.lft import LFT, with_blocks
from mbdlft.lft.sampling import evaluate_at, values_and_sizes
from mbdlft.order.degree import allows
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.refit import above_bound, refit
from mbdlft.order.work import Work, late_after, reduction, singular_values, solutions

SEARCH = 2.0  # units of work; a small part of it is enough where the order meets the bound at once
_FIRST = 0.06  # units of a step of the first round; each round has twice as many as the one before
_IN_VAIN = 0.08  # of the work without a gain ends a search: O8 would miss its bound with 0.07
OF_PAIRS, _OF_TRIPLES = 0.6, 2.0  # units for a first look at all pairs; steps for one at triples, too
_OF_LOOKS = 0.5  # units of work for looks at results, beside the search
_OF_STEP = 0.25  # of the work: steps that may take more are not begun, which seldom gain anything
_DEAR = 1.5  # times the closed order: larger relations wait for four rounds
_FAR = 3  # a form this much larger than the smallest is not started from
_MOST_KEPT = 20  # forms on the way, for where the smallest has too few digits
_POOL = 8  # forms that are kept
_ROUNDS = 16  # with other random choices each
# Of the first round. A refit succeeds from some starts only: gimbal ends at 30 or 31, ur5 at 31 to 33.
_SEED = 1
_POINTS = 64
SAME = 1e-11  # relative difference of values, far above rounding and far below a wrong step
FITTED = 1e-12  # of the finished values of LFTs that are fitted, so that they are not much worse
_CONDITION = 1e7  # of I - M11 Delta on the range
_NEGLIGIBLE = 1e-6  # of the largest entry: a smaller one is compared with that part of it
_CANCELED = 1e-2  # of the terms of an entry: a smaller one is compared with that part of them


class Budget(NamedTuple):
    """What a search may cost: units of work, which decide its result, and at most so many seconds."""

    work: float
    seconds: float | None = None


CUT_OFF = "search was cut off"  # a stage that tells so
IN_PROCESS = "search in this process: its result may depend on the processor"  # one, too
DROPPED = "search: a result was dropped"  # one, too: what is there before it stands
_LOST = (WellPosednessError, LinAlgError, AnalysisError)  # of LFTs that doubles do not carry


class Smallest(NamedTuple):
    """The smallest LFT, the least order of any, whether seconds ended the search early, why a part of it
    failed, and larger LFTs on the way, the smallest first."""

    lft: LFT
    order_bound: int
    is_cut_off: bool = False
    dropped: str = ""
    larger: tuple[LFT, ...] = ()


def budget_of(search: float, seconds: float | None = None) -> Budget:
    """The budget of a search; a SceneError if one of the two is not a size."""
    if not isinstance(search, int | float) or not search >= 0.0:
        raise SceneError(f"search: expected units of work, 0 for no search, got {search!r}.")
    if seconds is not None and (not isinstance(seconds, int | float) or not seconds >= 0.0):
        raise SceneError(f"seconds: expected a time (s), or None for no limit, got {seconds!r}.")
    return Budget(search, seconds)


def find_smallest(
    closed: Sequence[LFT],
    bound: Mapping[str, int],
    budget: Budget,
    relations: Sequence[LFT] = (),
    close: Callable[[LFT], LFT] | None = None,
    truth: LFT | None = None,
    joint: JointBound | None = None,
) -> Smallest:
    """The smallest LFT of the value of some `closed` ones that is found, and the best bound on its order.

    All have the same blocks but for their sizes; `bound` are lower bounds of these by name. In the
    `relations` that the model was closed from, masses and lengths are polynomial, and closing can hide
    that parameters cancel; `close` makes the reduced model of LFTs like them. The model before it was
    reduced, `truth`, shows what is left of terms that cancel. What pairs and triples say is in `joint`. A
    part that meets an LFT that doubles do not carry leaves what was there before it.
    """
    dropped: list[str] = []
    with running.budget(budget.work):
        smallest = min(closed, key=attrgetter("order"))
        work = Work(budget.work, late_after(budget.seconds), running.tell)
        proof = _Proof(bound, smallest, joint)
        if smallest.order <= proof.order_bound or work.is_over:
            return Smallest(smallest, proof.order_bound, work.is_cut_off)
        level = _level_of_closed(smallest, truth, proof)
        sides = [_Side([smallest, *(form for form in closed if form is not smallest)], level)]
        if relations:
            assert close is not None
            opened = _level_of_relations(_comparable(relations)[0], close, truth, proof)
            sides.append(_Side(relations, opened))
        on_the_way = _in_rounds(sides, proof, work, dropped)
        names, why = [block.name for block in smallest.blocks], dropped[0] if dropped else ""
        smaller = [with_blocks(form, names) for form in on_the_way if form.order < smallest.order]
        best, *larger = [*smaller, smallest]
        return Smallest(best, proof.order_bound, work.is_cut_off, why, tuple(larger))


class _Side:
    """Forms of the closed LFT or of the relations, the smallest first, and their checks."""

    def __init__(self, forms: Sequence[LFT], level: "_Level") -> None:
        self.forms, self.level = _comparable(forms), level

    def step(self, proof: "_Proof", work: Work, size: float, seed: int, dropped: list[str]) -> None:
        """A refit of some size."""
        with _keeping(dropped):  # the next round makes other choices
            of_refits, source = work.limited(size), self.level.source
            keeps = partial(self.level.keeps, of_refits)
            smallest = refit(self.forms, source, proof.bound, proof.order_bound, keeps, seed, of_refits)
            by_sizes = {form.blocks: form for form in [smallest, *self.forms][::-1]}
            self.forms = sorted(by_sizes.values(), key=attrgetter("order"))[:_POOL]


def _in_rounds(sides: Sequence[_Side], proof: "_Proof", work: Work, dropped: list[str]) -> list[LFT]:
    """Closed LFTs after rounds of growing size, the smallest first, until one of them meets the bound.

    No step depends on the whole work, so more work goes on where less of it ends.
    """
    closed, *opened = sides
    # on ties the relations first: there deltas are polynomial
    tied = [side for side in opened if side.forms[0].order <= closed.forms[0].order]
    in_order = [*tied, closed, *(side for side in opened if side not in tied)]
    proof.improve(closed.forms[0], work.limited(OF_PAIRS), triples=False)
    best, last_gain, known = closed.forms[0], work.spent, (0, 0)
    on_the_way = list(closed.forms)
    for attempt in range(_ROUNDS):
        size = _FIRST * 2.0**attempt
        if size > max(_FIRST, _OF_STEP * work.most):
            break
        for side in (None, *in_order):
            if best.order <= proof.order_bound or work.is_over:
                return on_the_way
            if side is None:
                of_proof = work.limited(max(OF_PAIRS, _OF_TRIPLES * size))
                proof.improve(best, of_proof, triples=attempt > 2)
            elif side is closed or attempt > 3 or side.forms[0].order <= _DEAR * best.order:
                side.step(proof, work, size, _SEED + attempt, dropped)
            if side in opened and not work.is_over:  # what is cut off goes on with more work
                with _keeping(dropped):
                    _closed_too(side, closed, proof)
            if closed.forms[0].order < best.order:
                best = closed.forms[0]
                others = {id(form): form for form in (*closed.forms[1:], *on_the_way)}
                on_the_way = [best, *sorted(others.values(), key=attrgetter("order"))][:_MOST_KEPT]
            now = proof.order_bound, sum(side.forms[0].order for side in sides)
            if now != known:
                known, last_gain = now, work.spent
            if work.spent - last_gain > _IN_VAIN * work.most:
                return on_the_way
    return on_the_way


def _closed_too(side: _Side, closed: _Side, proof: "_Proof") -> None:
    """The smallest LFT of the relations among the closed ones, unless these have a smaller one."""
    solved = side.level.close(side.forms[0])
    if solved.order < closed.forms[0].order and proof.allows(solved):
        closed.forms.insert(0, solved)
    elif solved.order == closed.forms[0].order:
        closed.forms.insert(1, solved)


@contextmanager
def _keeping(dropped: list[str]) -> Iterator[None]:
    """A part of the search, which ends at an LFT that doubles do not carry: it changes nothing."""
    try:
        yield
    except _LOST as error:
        dropped.append(str(error))


class _Proof:
    """The best lower bound on the order: degrees, and then pairs and triples of deltas."""

    def __init__(self, bound: Mapping[str, int], source: LFT, joint: JointBound | None) -> None:
        self.bound, self.order_bound = bound, joint.known if joint else sum(bound.values())
        self._source = dict(source.blocks)
        self._joint = joint
        self._work_of_looks = Work(_OF_LOOKS)

    def allows(self, candidate: LFT) -> bool:
        """Whether an LFT is not smaller than residues prove: such an LFT is near the value, not equal."""
        if self._joint is None:
            return True
        sizes = dict(candidate.blocks)
        more = {name: sizes.get(name, 0) - least for name, least in self.bound.items()}
        if min(more.values(), default=0) < 0 or candidate.order < self.order_bound:
            return False
        fewer = {name for name in more if sizes.get(name, 0) < self._source[name]}
        for first, second in combinations([name for name in more if self.bound[name]], 2):
            if fewer.isdisjoint((first, second)) or (more[first] and more[second]):
                continue  # no pair excludes that
            pairs = self._joint.pairs(first, second, self._work_of_looks)
            if not all(allows(pair, more) for pair in pairs):
                self.order_bound = max(self.order_bound, self._joint.known)
                return False
        return True

    def improve(self, best: LFT, work: Work, *, triples: bool) -> None:
        """Look at all pairs, and at triples, which take longer; what is known costs nothing.

        Nothing is proved of two that both meet their bound in the best LFT.
        """
        if self._joint is not None:
            bound = self._joint.of_all(work, triples=triples, above=above_bound(best, self.bound))
            self.order_bound = max(self.order_bound, bound)


class Truth:
    """Values at random points and corners of the unit box; not computed before there is a candidate.

    `floor` tells from values what an entry is compared with at least, (rows, columns) or one for all.
    """

    def __init__(self, form: Callable[[], LFT], floor: Callable[[Array], Array | float]) -> None:
        self._form, self._floor = form, floor

    @cached_property
    def values(self) -> tuple[dict[str, Array], Array, Array]:
        """Points (N,) by name, values (N, rows, columns) and sizes of entries (rows, columns).

        What is left of an entry after its terms have cancelled is no size to compare it with.
        """
        form = self._form()
        points = _check_points(len(form.blocks))
        values, terms = values_and_sizes(form, points)
        size = np.max(np.abs(values), axis=0, initial=0.0)
        least = np.maximum(self._floor(values), _CANCELED * np.max(terms, axis=0, initial=0.0))
        fields = {block.name: points[:, k] for k, block in enumerate(form.blocks)}
        return fields, values, np.maximum(size, least)


def is_same(candidate: LFT, truth: Truth, work: Work, largest: float = SAME) -> bool:
    """Whether each entry is the same up to `largest` of its size, and the loop well-conditioned."""
    fields, values, size = truth.values
    n = candidate.order
    work.add(2 * solutions(2 * _POINTS, n, candidate.shape[1], is_complex=False))
    nothing = np.zeros(len(values))
    points = np.array([fields.get(name, nothing) for name, _ in candidate.blocks]).T
    points = points.reshape(len(values), len(candidate.blocks))
    loop = np.zeros((0, n, n))
    if n:
        spread = np.repeat(points, [block.size for block in candidate.blocks], axis=1)
        loop = np.eye(n) - candidate.M11[None] * spread[:, None, :]
        signs, _ = np.linalg.slogdet(loop)
        if np.any(signs <= 0):
            return False
    if not _missed(candidate, points, values, size) <= largest:
        return False
    work.add(singular_values(n, n, 2 * _POINTS) / 3.0)
    return bool(np.max(np.linalg.cond(loop), initial=0.0) <= _CONDITION)


def _missed(candidate: LFT, points: Array, values: Array, size: Array) -> float:
    difference = np.abs(evaluate_at(candidate, points) - values)
    return float(np.max(difference / or_one(size), initial=0.0))


def part_of_row_and_column(values: Array) -> Array:
    """(rows, columns); an entry is no larger than what its row and its column give it."""
    rows, columns = equilibrate(values)
    used = np.max(np.abs(values), initial=0.0) > 0.0
    return np.asarray(_CANCELED * used / np.outer(rows, columns))


def part_of_either(values: Array) -> Array:
    """(rows, columns); at least a part of the largest entry: for rows that are zero but for rounding."""
    largest = float(np.max(np.abs(values), initial=0.0))
    return np.maximum(_NEGLIGIBLE * largest, part_of_row_and_column(values))


def _check_points(count: int) -> Array:
    """Random points and corners of the unit box (N, count)."""
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (2 * _POINTS, count))
    points[_POINTS:] = np.sign(points[_POINTS:])
    return points


class _Check(NamedTuple):
    """What a candidate is compared with, as it is or closed, and the largest relative difference."""

    truth: Truth
    largest: float
    is_closed: bool = True


class _Level(NamedTuple):
    """The relations, or the closed LFTs: what the candidates of a search are compared with.

    Where entries are zero, those of Newton's method are rounding.
    """

    checks: tuple[_Check, ...]
    close: Callable[[LFT], LFT]
    proof: _Proof
    source: LFT

    def keeps(self, work: Work, candidate: LFT) -> bool:
        """Whether a candidate has the value."""
        if not self.proof.allows(candidate):
            return False
        for truth, largest, is_closed in self.checks:
            form = candidate
            if is_closed:
                work.add(reduction(candidate.order))
                form = self.close(candidate)
                if not self.proof.allows(form):
                    return False
            if not is_same(form, truth, work, largest):
                return False
        return True


def _level_of_closed(form: LFT, truth: LFT | None, proof: _Proof) -> _Level:
    """Of the smallest closed LFT, and of the one before reduction."""
    rounded = Truth(lambda: form, part_of_either)
    if truth is None:
        return _Level((_Check(rounded, FITTED),), lambda form: form, proof, form)
    unreduced = Truth(lambda: truth, part_of_either)
    checks = (_Check(rounded, SAME), _Check(unreduced, FITTED))
    return _Level(checks, lambda form: form, proof, truth)


def _level_of_relations(
    form: LFT, close: Callable[[LFT], LFT], truth: LFT | None, proof: _Proof
) -> _Level:
    """Of the smallest LFT of the relations; closing makes rounding larger, so results are closed too."""
    rounded = Truth(lambda: form, part_of_either)
    unreduced = Truth(lambda: close(form) if truth is None else truth, part_of_row_and_column)
    checks = (_Check(rounded, SAME, is_closed=False), _Check(unreduced, FITTED))
    return _Level(checks, close, proof, form)


def _comparable(forms: Sequence[LFT]) -> list[LFT]:
    """Forms without empty blocks, the smallest first, in its deltas; none is far larger."""
    forms = sorted((_without_empty(form) for form in forms), key=attrgetter("order"))
    names = [block.name for block in forms[0].blocks]  # the least that the value depends on
    near = [form for form in forms if form.order <= _FAR * forms[0].order]
    return [form for form in near if [block.name for block in form.blocks] == names]


def _without_empty(a: LFT) -> LFT:
    return LFT(a.M11, a.M12, a.M21, a.M22, tuple(block for block in a.blocks if block.size))
