"""Smaller LFTs of one value, by steps in exact numbers that residues choose.

A block of the relations, or of the closed LFT, is restricted to what it reaches
(`mbdlft.order.restriction`), which changes how often the other deltas are repeated. From each of these,
repetitions of one delta are exchanged for fewer of another (`mbdlft.order.exchange`). Residues alone tell
what steps lead to; what gains is made in balls.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from math import inf
from typing import NamedTuple

from mbdlft.exact.matrices import of_residues
from mbdlft.exact.numbers import RESIDUES_ALONE, index_of, precision
from mbdlft.order.dependent import without_dependent
from mbdlft.order.paths import OF_BALLS, Impossible, Node, Path, exchanged, path_below
from mbdlft.order.reduction import ExactLFT, reduce_exactly
from mbdlft.order.restriction import INDEPENDENT, Step, by_step
from mbdlft.order.work import Work
from mbdlft.pipeline.forms import Candidate, closed_exactly, is_regular_at_points, residues_of, restricted
from mbdlft.problem.relations import Form, Problem

_MOST_STEPS = 2  # one after the other
_MORE = 4  # repetitions than the fewest, from which a second step starts
_OF_BASIS = 0.3  # of the order: what a closed LFT is restricted in, as others lead to larger ones
_OF_REST = 1.3  # times the work in residues: what a step does beside it
_MOST_MADE = 3  # starts, in balls, where those before them are of no use
_MOST_PRIMES, _OF_PRIMES = 32, 0.5  # whose factors are asked for, and units of work for them
_OF_CHANNEL = 1.5e7  # operations of an extraction for each channel before any reduction
_MOST_PATHS = 4  # of exchanges, the last one without zeros: residues do not see where they are real


class Restricted(NamedTuple):
    """The closed LFT of a candidate with blocks restricted by steps, and the relations that it is of.

    Both are residues modulo the prime of an index. There are no relations where the closed LFT is
    restricted itself, or where no more steps follow.
    """

    candidate: Candidate
    steps: tuple[Step, ...]
    lft: ExactLFT
    relations: ExactLFT | None
    prime: int

    @staticmethod
    def plain(candidate: Candidate) -> "Restricted | None":
        """Without any steps; None if the candidate is sparse."""
        if not (isinstance(candidate.exact, ExactLFT) and candidate.exactly):
            return None
        bits, relations = candidate.exactly
        lft = _in_residues(candidate.exact)
        return Restricted(candidate, (), lft, _in_residues(relations), index_of(bits))

    def after(self, step: Step, lft: ExactLFT, relations: ExactLFT | None) -> "Restricted":
        """With a step more."""
        return self._replace(steps=(*self.steps, step), lft=lft, relations=relations)

    def modulo(self, problem: Problem, prime: int) -> "Restricted | None":
        """The same modulo the prime of another index; None if that is not possible."""
        lft = residues_of(problem, self.candidate.form, self.steps, prime)
        return self._replace(lft=lft, relations=None, prime=prime) if lft else None


def restrictions(
    candidate: Candidate, degrees: Mapping[str, int], bound: int, work: Work
) -> list[Restricted]:
    """The candidate, then it with blocks above their degrees restricted, until some work is over.

    No more once one meets a bound; nothing if the candidate is sparse.
    """
    plain = Restricted.plain(candidate)
    if plain is None:
        return []
    with precision(RESIDUES_ALONE):
        known, some, least = {plain.lft.blocks: plain}, [plain], plain.lft.order
        names = [name for name, size in plain.lft.blocks if size > degrees[name]]
        for _ in range(_MOST_STEPS):
            starts, some = [start for start in some if start.lft.order <= least + _MORE], []
            fresh = (new for start in starts for new in _once(candidate.form, start, names, bound, work))
            for new in fresh:
                if known.setdefault(new.lft.blocks, new) is new:
                    some, least = [*some, new], min(least, new.lft.order)
                    if least <= bound:
                        return list(known.values())
    return list(known.values())


def _once(
    form: Form, start: Restricted, names: Sequence[str], bound: int, work: Work
) -> Iterator[Restricted]:
    """One block more restricted: of the relations, and, before any others, of the closed LFT.

    Channels with dependent functions are left out first.
    """
    has_unknowns, both = form.relations.unknown.numel() > 0, (False, True)
    if (small := without_dependent(start.lft, bound)).order < start.lft.order:
        yield start.after(INDEPENDENT, small, None if has_unknowns else small)
    for name, side, is_inside in product(names, both, both) if start.relations else ():
        step = Step(name, side, has_unknowns, is_inside)
        relations = start.relations and _restricted(start.relations, step, work)
        closed = _closed(form, relations) if relations and has_unknowns else relations
        if closed:
            yield start.after(step, closed, relations)
    for name, side in product(names, both) if has_unknowns and not start.steps else ():
        step = Step(name, side, of_relations=False)
        if closed := _restricted(start.lft, step, work, _OF_BASIS * start.lft.order):
            yield start.after(step, closed, None)


def _restricted(a: ExactLFT, step: Step, work: Work, most: float = inf) -> ExactLFT | None:
    if work.is_over or not dict(a.blocks)[step.name]:
        return None
    with work.counting(_OF_REST):
        return by_step(a, step, most)


def _closed(form: Form, relations: ExactLFT) -> ExactLFT | None:
    """None if the relations are singular at nominal."""
    try:
        return reduce_exactly(closed_exactly(form, relations))
    except ZeroDivisionError:
        return None


def _in_residues(a: ExactLFT) -> ExactLFT:
    return ExactLFT(of_residues(a.M.residues, a.M.prime), a.blocks)


def without_dependent_channels(problem: Problem, candidate: Candidate, least: int) -> Candidate | None:
    """The same in channels with independent functions; None if they are, or if that is singular."""
    if (plain := Restricted.plain(candidate)) is None:
        return None
    with precision(RESIDUES_ALONE):
        small = without_dependent(plain.lft, least)
    is_smaller = small.order < candidate.lft.order
    return _made(problem, plain.after(INDEPENDENT, small, None)) if is_smaller else None


def _made(
    problem: Problem, start: Restricted, then: Callable[[ExactLFT], ExactLFT | None] | None = None
) -> Candidate | None:
    """In balls. What leaves out dependent channels may have another determinant: None if it vanishes."""
    candidate, steps = start.candidate, start.steps
    known = candidate if candidate.exactly and start.prime == index_of(candidate.exactly[0]) else None
    small = restricted(problem, candidate.form, steps, known=known, then=then, prime=start.prime)
    is_wrong = small and INDEPENDENT in steps and not is_regular_at_points(problem, small.lft)
    return None if is_wrong else small


def smaller_candidates(
    problem: Problem, starts: Sequence[Restricted], bound: int, work: Work
) -> Iterator[Candidate]:
    """Smaller candidates with blocks restricted and repetitions exchanged, the smallest first.

    The first of the starts is that of the smallest form, without steps, as those of other forms are. Each
    is made when it is asked for: another one matters where those before it are of no use.
    """
    plain, starts = starts[0], sorted(starts, key=lambda start: start.lft.order)
    nodes = [Node(start.lft, is_form=not start.steps and start is not plain) for start in starts]
    for k, start in enumerate(starts[:_MOST_MADE]):
        best = _along_paths(problem, starts[k:], nodes[k:], bound, work)
        if best:
            yield best
        if not start.steps:
            break
        if small := _made(problem, start):
            yield small


def _along_paths(
    problem: Problem, starts: Sequence[Restricted], nodes: Sequence[Node], bound: int, work: Work
) -> Candidate | None:
    """The smallest candidate that exchanges lead to, if it is smaller than the first of the starts."""
    best, least, impossible = None, starts[0].lft.order, set[Impossible]()

    def along(path: Path, exact: ExactLFT) -> ExactLFT | None:
        exact, failed = exchanged(exact, path)
        if failed:
            impossible.add(failed)
        return exact if exact.order < least else None

    for j in range(_MOST_PATHS, 0, -1):
        found = path_below(nodes, least, bound, work, impossible, with_zeros=j > 1)
        if not found.path or (j < _MOST_PATHS and work.is_over):
            break
        start, known = starts[found.first], len(impossible)
        with work.counting(OF_BALLS):
            small = _made(problem, start, partial(along, found.path))
        best, least = (small, small.lft.order) if small else (best, least)
        if least == found.order:
            break
        if small is None and len(impossible) == known:  # it is singular somewhere, or needs more bits
            impossible.add((start.lft.blocks, found.path[0]))
    of_primes = work.limited(_OF_PRIMES)
    for prime, (k, path) in product(range(1, _MOST_PRIMES), found.hopeful[:1]):
        if least <= bound or of_primes.is_over:
            break
        of_primes.add(_OF_CHANNEL * sum(starts[k].candidate.channels.values()))
        other = starts[k].modulo(problem, starts[k].prime + prime)
        with of_primes.counting(), precision(RESIDUES_ALONE):
            is_filled = other and exchanged(other.lft, path)[0].order <= path[-1].at_best
        if other and is_filled:  # or else it takes complex points
            return _made(problem, other, partial(along, path)) or best
    return best
