"""Smaller LFTs by using that deltas commute.

n-D reduction restricts each delta to a constant subspace. Deltas that commute allow a basis that depends
on the other deltas (`mbdlft.reduce.basis`). The search opens the blocks one by one: what is left,

    [z ; y] = N(deltas that are not opened) [w ; u],

is a matrix like the one at the start, and

    score = sizes of the opened blocks + sum of the degrees of N in the other deltas

is a lower bound of all that can follow. A block that can be opened without a higher score is opened; else
the bases are tried that raise it least, a few models at once. At every step the opened blocks can be
closed again: that is an LFT of equal value, and if it is smaller, it is the result. The search starts
again from there, until nothing smaller is found. In between, Newton's method leaves out repetitions.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.lft.lft import LFT, Block, with_blocks
from mbdlft.reduce.affine import is_affine, is_polynomial, move_affine
from mbdlft.reduce.basis import (
    Choice,
    Exchange,
    affine_form,
    choices,
    choose,
    choose_values,
    close_block,
    exchange,
    is_regular,
    open_block,
    settle,
)
from mbdlft.reduce.exchange import search_exchanges
from mbdlft.reduce.independent import independent
from mbdlft.reduce.lines import Lines, Values, lines_of, total_degree, values_on
from mbdlft.reduce.reduce import reduce_order
from mbdlft.reduce.refit import refit
from mbdlft.reduce.same_value import (
    FITTED,
    SAME,
    Truth,
    is_same,
    part_of_either,
    part_of_largest,
    part_of_row_and_column,
)

_SHIFT = (0.1, 0.3)  # of the range: the search runs around a point where nothing vanishes by chance
_NEAR = 8  # so many channels more than the smallest LFT may turn out to be dependent
_HOPELESS = 8  # a score this much above the smallest LFT is not followed
_TRIED = 4  # steps that are made for each that is followed
_ORDERS = 4  # that are tried in vain after a descent
_LEVELS = (1, 4)  # efforts of the first descents
LARGE = 120  # channels: from there on the bound by pairs waits for the end of a first descent
_ATTEMPTS = 8  # descents from each form, with other random choices
_FAR = 3  # a form this much larger than the smallest is not started from
_QUICK = 0.1  # of the budget: the bound by pairs is asked for again if it took less
_NEWTON = 0.5  # of the budget, kept for repetitions that are left out by Newton's method
_GROWTH = 2  # of the order, that LFTs on the way may have


class Effort(NamedTuple):
    """How much is tried: models followed at once, deltas and bases of each that are looked at."""

    width: int
    deltas: int
    bases: int
    rows: int
    orders: int
    exchanges: int
    order: Literal["scores", "sizes", "chance"] = "scores"  # in which the blocks are opened


EFFORTS = (
    Effort(width=1, deltas=3, bases=3, rows=0, orders=1, exchanges=0),
    Effort(width=1, deltas=100, bases=2, rows=4, orders=1, exchanges=0),
    Effort(width=3, deltas=100, bases=3, rows=20, orders=2, exchanges=0),
    Effort(width=3, deltas=100, bases=3, rows=20, orders=2, exchanges=500),
    Effort(width=4, deltas=100, bases=4, rows=40, orders=4, exchanges=3000),
)

# of one delta only, so quick: small blocks first, or an order of chance
ORDERED = (
    Effort(width=1, deltas=1, bases=3, rows=40, orders=1, exchanges=0, order="sizes"),
    Effort(width=1, deltas=1, bases=3, rows=40, orders=1, exchanges=0, order="chance"),
)


class _State(NamedTuple):
    """Opened blocks in order, what is left, and the score."""

    score: int
    opened: tuple[Block, ...]
    left: LFT


class _Step(NamedTuple):
    """A block to be opened in a basis, and the score that it will have."""

    score: int
    exchanges: tuple[Exchange, ...]
    size: int
    state: _State
    name: str
    choice: Choice | None
    regular: bool = True


class _Problem(NamedTuple):
    """What the steps of a pass share."""

    lines: Lines
    effort: Effort
    seed: int
    most: int
    stop: Callable[[], bool]
    order: tuple[str, ...]  # in which the blocks are opened; empty: as the scores say


class Smallest(NamedTuple):
    """What a search found, and the least order that any LFT of the same value can have."""

    lft: LFT
    order_bound: int


def reduce_commuting(
    starts: Sequence[LFT],
    bound: Mapping[str, int],
    seconds: float,
    joint: Callable[[LFT, Callable[[], bool]], int],
    finish: Callable[[LFT], LFT] | None = None,
    truth: LFT | None = None,
) -> Smallest:
    """The smallest LFT of equal value that is found in a time, at the latest when it meets the bound.

    Parameters
    ----------
    starts : LFTs of one value, with the same blocks but for their sizes
        Different forms lead to different results.
    bound : mapping of names to the lower bounds of the repetitions
    seconds : float
        Budget of processor time of this thread (s), so that a busy machine finds the same; what is
        tried, and in which order, does not depend on it.
    joint : function of an LFT and of a function that says when to stop
        A lower bound on the order that may be better than the sum of `bound`; asked for when a first
        descent has not reached that sum, and for smaller LFTs, where ranks are clearer, if it is quick.
    finish : function of an LFT
        What becomes of the result, if it is not used as it is. That has to keep its values too: solving
        for accelerations makes rounding larger.
    truth : LFT
        What every finished result is compared with; the first form, finished, by default. One that has
        not been reduced shows which entries are only what is left of terms that cancel.

    Returns
    -------
    Smallest
        With the smallest of `starts` itself if nothing smaller was found.
    """
    deadline, for_newton = time.thread_time() + seconds, _NEWTON * seconds
    smallest = min(starts, key=lambda start: start.order)
    forms = [_without_empty(start) for start in starts if start.order <= _FAR * smallest.order]
    forms.sort(key=lambda form: form.order)
    used = {block.name for block in forms[0].blocks}  # the least that the value depends on
    forms = [form for form in forms if {block.name for block in form.blocks} == used]
    search = _Search(
        bound, lambda: time.thread_time() > deadline - for_newton, forms[0], finish, truth
    )
    by_pairs = _ByPairs(search, joint, _QUICK * seconds)

    def keeps(found: LFT) -> bool:
        return _keeps(found, search, fitted=True)

    origin = forms[0]
    apart = [independent(form) for form in forms if not search.stop()]
    for form in (*apart, *_moved(origin, search.stop)):
        if form.order < forms[0].order and _keeps(form, search):
            forms.insert(0, form)
    best, seed = forms[0], 0

    def is_over() -> bool:
        return best.order <= search.target or search.stop()

    # where moving was enough there may be nothing to search for; pairs take long for many deltas
    if best is not origin and best.order <= LARGE and not is_over():
        by_pairs.raise_target(best)
    for attempt in range(_ATTEMPTS):
        efforts = EFFORTS[: _LEVELS[attempt]] if attempt < len(_LEVELS) else EFFORTS
        for form in forms if attempt > 1 else [best]:
            found, level = form, 0
            while level < len(efforts) and not is_over():
                smaller = _pass(found, search, efforts[level], seed)
                level = level if smaller.order < found.order else level + 1
                found, seed = smaller, seed + 1
                best = found if found.order < best.order else best
                if not is_over() and (attempt > 0 or best.order <= LARGE):
                    by_pairs.raise_target(best)
        tried = 0  # since the last success; from the first form and from the best in turn
        while tried < _ORDERS and not is_over():
            form = origin if tried % 2 == 0 else best
            found, seed = _pass(form, search, ORDERED[min(tried, 1)], seed), seed + 1
            tried = 1 if found.order < best.order else tried + 1
            best = found if found.order < best.order else best
        if attempt == 0:
            continue  # the bases first, while they are quick
        others, before = [form for form in forms if form is not best], time.thread_time()
        smaller = refit([best, *others], bound, search.target, keeps, attempt - 1, for_newton)
        for_newton = max(0.0, for_newton - (time.thread_time() - before))
        if smaller.order < best.order:
            best = smaller
            by_pairs.raise_target(best)
    if best.order == smallest.order:
        return Smallest(smallest, search.target)
    names = [block.name for block in smallest.blocks]
    return Smallest(with_blocks(best, names), search.target)


def _moved(a: LFT, stop: Callable[[], bool]) -> Iterator[LFT]:
    """Forms of the same value with the affine deltas moved: inside of other polynomial ones, or not."""
    affine = [name for name, _ in a.blocks if not stop() and is_affine(a, name)]
    if affine:
        others = [name for name, _ in a.blocks if name not in affine and is_polynomial(a, name)]
        for outside in (others, ()):
            try:
                found = move_affine(a, outside, affine, _GROWTH * a.order + 30, stop)
            except WellPosednessError:
                continue
            if found is not None:
                yield found


class _Search:
    """The bounds, the budget, and what every result is checked against, as it is and finished."""

    def __init__(
        self,
        bound: Mapping[str, int],
        stop: Callable[[], bool],
        form: LFT,
        finish: Callable[[LFT], LFT] | None = None,
        truth: LFT | None = None,
    ) -> None:
        self.bound, self.target, self.stop = bound, sum(bound.values()), stop
        self.finish = finish
        self.as_it_is = None if finish is None else Truth(lambda: form, part_of_largest)
        floor = part_of_largest if finish is None else part_of_row_and_column
        if finish is None and truth is not None:
            floor = part_of_either
        self.as_finished = Truth(lambda: self.finished(form) if truth is None else truth, floor)
        # in one that is fitted, entries that are zero are rounding
        rounded = Truth(lambda: form, part_of_either)
        matrix_as_given = finish is None and truth is None  # the second comparison has it
        self.as_fitted = None if matrix_as_given else rounded
        self.as_fitted_and_finished = rounded if matrix_as_given else self.as_finished

    def finished(self, found: LFT) -> LFT:
        """What becomes of a result."""
        return found if self.finish is None else self.finish(found)


class _ByPairs:
    """The bound by pairs, for ever smaller LFTs as long as it is quick."""

    def __init__(
        self, search: _Search, joint: Callable[[LFT, Callable[[], bool]], int], quick: float
    ) -> None:
        self._search, self._joint, self._left = search, joint, quick
        self._order = math.inf

    def raise_target(self, best: LFT) -> None:
        """Ask for the bound if `best` is smaller than the LFT that it was asked for before."""
        if best.order >= self._order or self._left <= 0.0:
            return
        search, start, self._order = self._search, time.thread_time(), best.order
        search.target = max(search.target, self._joint(search.finished(best), search.stop))
        self._left -= time.thread_time() - start


def _pass(a: LFT, search: _Search, effort: Effort, seed: int) -> LFT:
    """The smallest LFT on the way of opening all blocks of `a` once."""
    random = np.random.default_rng(seed)
    shift = random.uniform(*_SHIFT, len(a.blocks)) * random.choice([-1.0, 1.0], len(a.blocks))
    target, best = search.target, a

    def restore(state: _State) -> LFT | None:
        """The state closed, around delta = 0 again, if it is smaller than the best and right."""
        closed = state.left
        for block in reversed(state.opened):
            closed = close_block(closed, block)
        try:
            closed = reduce_order(_around(closed, -shift))
            near = closed.order < best.order + _NEAR
            apart = independent(closed) if near else closed
            for found in dict.fromkeys((apart, closed)):  # once, if they are the same
                if found.order < best.order and _keeps(found, search):
                    return found
            return None
        except (WellPosednessError, np.linalg.LinAlgError):
            return None

    problem = _Problem(
        lines_of({name: 2 * search.bound[name] + 2 for name, _ in a.blocks}, seed, shift),
        effort,
        seed,
        _GROWTH * a.order + 30,
        search.stop,
        _order(a, effort, random),
    )
    start = _around(a, shift)
    states = [_State(total_degree(values_on(start, problem.lines), problem.lines), (), start)]
    for _ in a.blocks:
        steps = sorted(
            (step for state in states for step in _steps(state, problem)),
            key=lambda step: (step.score, not step.regular, len(step.exchanges), step.size),
        )
        # of those with one score the simplest: it has the fewest channels left
        states = sorted(_taken(steps, problem), key=lambda state: (state.score, state.left.order))
        states = states[: effort.width]
        for state in states:
            best = restore(state) or best
        if not states or best.order <= target or search.stop():
            break
        if states[0].score > best.order + _HOPELESS:
            break
    return best


def _order(a: LFT, effort: Effort, random: np.random.Generator) -> tuple[str, ...]:
    """The order in which an effort opens the blocks, empty if the scores decide."""
    blocks = [a.blocks[k] for k in random.permutation(len(a.blocks))]
    if effort.order == "scores":
        return ()
    if effort.order == "sizes":
        blocks.sort(key=lambda block: block.size)
    return tuple(block.name for block in blocks)


def _steps(state: _State, problem: _Problem) -> list[_Step]:
    """Ways to open one more block."""
    effort, lines = problem.effort, problem.lines
    done = sum(block.size for block in state.opened)
    plain = []
    for name, size in state.left.blocks:
        if problem.stop():
            return []
        opened = open_block(state.left, name)
        values = values_on(opened, lines, diagonal=True)
        score = done + size + total_degree(values, lines)
        plain.append((_Step(score, (), size, state, name, None), values))
        if score <= state.score:
            return [plain[-1][0]]
    place = {name: k for k, name in enumerate(problem.order)}
    plain.sort(key=lambda item: (place.get(item[0].name, 0), item[0].size, item[0].score))
    steps = []
    for step, values in plain[: effort.deltas]:
        if problem.stop():
            return [step for step, _ in plain]
        steps += _bases(step, values, done, problem)
    return steps


def _bases(plain: _Step, values: Values, done: int, problem: _Problem) -> list[_Step]:
    """The most promising bases for a block that is opened."""
    effort, lines, floor = problem.effort, problem.lines, plain.state.score
    random = np.random.default_rng([problem.seed, len(plain.state.opened), plain.size])
    tried: list[tuple[_Step, Values]] = [(plain, values)]
    for choice in choices(values, plain.size, effort.rows, effort.orders, random):
        found = choose_values(values, plain.size, choice)
        if found is None:
            continue
        score = done + choice.size + total_degree(found, lines)
        if score >= floor:  # less is a rank that was not seen
            regular = is_regular(values, plain.size, choice)
            changed = plain._replace(score=score, size=choice.size, choice=choice, regular=regular)
            tried.append((changed, found))
    tried.sort(key=lambda item: (item[0].score, not item[0].regular, item[0].size))
    steps = []
    for step, found in tried[: effort.bases]:
        steps.append(step)
        if effort.exchanges and found.circles and step.score > floor:
            rest = done + step.size
            score, exchanges = search_exchanges(
                found,
                step.size,
                lines,
                step.score - rest,
                floor - rest,
                effort.exchanges,
                problem.seed,
            )
            if exchanges:
                steps.append(step._replace(score=rest + score, exchanges=exchanges))
    return steps


def _taken(steps: list[_Step], problem: _Problem) -> Iterator[_State]:
    """States of the best steps, as LFTs, with the scores they really have."""
    seen: dict[object, int] = {}
    tried = 0
    for step in steps:
        opened = (*step.state.opened, Block(step.name, step.size))
        key = (step.score, tuple(sorted(opened)))
        if seen.get(key, 0) >= 2 or tried >= _TRIED * problem.effort.width:
            continue
        tried += 1
        left = open_block(step.state.left, step.name)
        try:
            if step.choice is not None:
                size = dict(step.state.left.blocks)[step.name]
                opened_left = left
                left = settle(choose(left, size, step.choice, problem.most), problem.lines)
                plain = affine_form(opened_left, left, size, step.choice.size, problem.lines)
                left = min(left, plain, key=lambda one: one.order)
            for move in step.exchanges:
                left = settle(exchange(left, step.size, move, problem.most), problem.lines)
            left = reduce_order(left)
            values = values_on(left, problem.lines)
        except (WellPosednessError, np.linalg.LinAlgError):
            continue  # not invertible around delta = 0, or too large on the way
        score = sum(block.size for block in opened) + total_degree(values, problem.lines)
        if score <= step.score:
            seen[key] = seen.get(key, 0) + 1
            yield _State(score, opened, left)


def _without_empty(a: LFT) -> LFT:
    return LFT(a.M11, a.M12, a.M21, a.M22, tuple(block for block in a.blocks if block.size))


def _around(a: LFT, shift: Array) -> LFT:
    """The same value in the distances of the deltas from a point (number of blocks)."""
    center: Array = np.repeat(shift, [block.size for block in a.blocks]).astype(float)
    try:
        solved: Array = np.linalg.solve(
            np.eye(a.order) - a.M11 * center, np.hstack([a.M11, a.M12])
        ).astype(float)
    except np.linalg.LinAlgError:
        raise WellPosednessError("the LFT is singular at the point.") from None
    M11, M12 = solved[:, : a.order], solved[:, a.order :]
    outer = a.M21 * center
    return LFT(M11, M12, a.M21 + outer @ M11, a.M22 + outer @ M12, a.blocks)


def _keeps(candidate: LFT, search: _Search, *, fitted: bool = False) -> bool:
    """Whether a candidate is right as it is, and when it is finished."""
    as_it_is, as_finished, largest = search.as_it_is, search.as_finished, SAME
    if fitted:
        as_it_is, as_finished, largest = search.as_fitted, search.as_fitted_and_finished, FITTED
    if as_it_is is not None and not is_same(candidate, as_it_is):
        return False
    return is_same(search.finished(candidate), as_finished, largest)
