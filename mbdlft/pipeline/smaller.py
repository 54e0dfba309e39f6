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
from mbdlft.exact.numbers import RESIDUES_ALONE, precision
from mbdlft.order.dependent import without_dependent
from mbdlft.order.paths import Impossible, Node, Path, exchanged, path_below
from mbdlft.order.reduction import ExactLFT, reduce_exactly
from mbdlft.order.restriction import INDEPENDENT, Step, by_step
from mbdlft.order.work import Work, reduction
from mbdlft.pipeline.forms import Candidate, closed_exactly, is_regular_at_points, restricted
from mbdlft.problem.relations import Form, Problem

_MOST_STEPS = 2  # one after the other
_MORE = 4  # repetitions than the fewest, from which a second step starts
_OF_BASIS = 0.3  # of the order: what a closed LFT is restricted in, as others lead to larger ones
_OF_RESULT = 15.0  # times the work of a reduction in doubles
_MOST_MADE = 3  # starts, in balls, where those before them are of no use
_MOST_PATHS = 4  # of exchanges, the last one without zeros: residues do not see where they are real


class Restricted(NamedTuple):
    """The closed LFT with blocks restricted by steps, in residues, and the relations that it is of.

    There are none where the closed LFT is restricted itself.
    """

    steps: tuple[Step, ...]
    lft: ExactLFT
    relations: ExactLFT | None


def restrictions(
    candidate: Candidate, degrees: Mapping[str, int], bound: int, work: Work
) -> list[Restricted]:
    """The candidate, then it with blocks above their degrees restricted, until some work is over.

    No more once one meets a bound; nothing if the candidate is sparse.
    """
    if not (isinstance(candidate.exact, ExactLFT) and candidate.exactly):
        return []
    with precision(RESIDUES_ALONE):
        plain = Restricted((), _in_residues(candidate.exact), _in_residues(candidate.exactly[1]))
        known, some, least = {plain.lft.blocks: plain}, [plain], plain.lft.order
        names = [name for name, size in plain.lft.blocks if size > degrees[name]]
        for _ in range(_MOST_STEPS):
            starts, some = [start for start in some if start.lft.order <= least + _MORE], []
            for new in (new for start in starts for new in _once(candidate.form, start, names, work)):
                if known.setdefault(new.lft.blocks, new) is new:
                    some, least = [*some, new], min(least, new.lft.order)
                    if least <= bound:
                        return list(known.values())
    return list(known.values())


def _once(form: Form, start: Restricted, names: Sequence[str], work: Work) -> Iterator[Restricted]:
    """One block more restricted: of the relations, and, before any others, of the closed LFT.

    Channels with dependent functions are left out first.
    """
    has_unknowns, both = form.relations.unknown.numel() > 0, (False, True)
    if (small := without_dependent(start.lft)).order < start.lft.order:
        yield Restricted((*start.steps, INDEPENDENT), small, None if has_unknowns else small)
    for name, side, is_inside in product(names, both, both) if start.relations else ():
        step = Step(name, side, has_unknowns, is_inside)
        relations = start.relations and _restricted(start.relations, step, work)
        closed = _closed(form, relations) if relations and has_unknowns else relations
        if closed:
            yield Restricted((*start.steps, step), closed, relations)
    for name, side in product(names, both) if has_unknowns and not start.steps else ():
        step = Step(name, side, of_relations=False)
        if closed := _restricted(start.lft, step, work, _OF_BASIS * start.lft.order):
            yield Restricted((step,), closed, None)


def _restricted(a: ExactLFT, step: Step, work: Work, most: float = inf) -> ExactLFT | None:
    if work.is_over or not dict(a.blocks)[step.name]:
        return None
    result = by_step(a, step, most)
    work.add((_OF_RESULT if result else 1.0) * reduction(a.order))
    return result


def _closed(form: Form, relations: ExactLFT) -> ExactLFT | None:
    """None if the relations are singular at nominal."""
    try:
        return reduce_exactly(closed_exactly(form, relations))
    except ZeroDivisionError:
        return None


def _in_residues(a: ExactLFT) -> ExactLFT:
    return ExactLFT(of_residues(a.M.residues, a.M.prime), a.blocks)


def without_dependent_channels(problem: Problem, candidate: Candidate) -> Candidate | None:
    """The same in channels with independent functions; None if they are, or if that is singular."""
    if not isinstance(candidate.exact, ExactLFT):
        return None
    with precision(RESIDUES_ALONE):
        small = without_dependent(_in_residues(candidate.exact))
    return _made(problem, candidate, (INDEPENDENT,)) if small.order < candidate.lft.order else None


def _made(
    problem: Problem,
    candidate: Candidate,
    steps: Sequence[Step],
    then: Callable[[ExactLFT], ExactLFT | None] | None = None,
) -> Candidate | None:
    """In balls. What leaves out dependent channels may have another determinant: None if it vanishes."""
    small = restricted(problem, candidate.form, steps, known=candidate, then=then)
    is_wrong = small and INDEPENDENT in steps and not is_regular_at_points(problem, small.lft)
    return None if is_wrong else small


def smaller_candidates(
    problem: Problem, candidate: Candidate, starts: Sequence[Restricted], bound: int, work: Work
) -> Iterator[Candidate]:
    """Smaller candidates with blocks restricted and repetitions exchanged, the smallest first.

    Each is made when it is asked for: another one matters where those before it are of no use.
    """
    starts = sorted(starts, key=lambda start: start.lft.order)
    nodes, impossible = [Node(start.lft) for start in starts], set[Impossible | None]()

    def along(path: Path, least: int, exact: ExactLFT) -> ExactLFT | None:
        exact, failed = exchanged(exact, path)
        impossible.add(failed)
        return exact if exact.order < least else None

    for k, start in enumerate(starts[:_MOST_MADE]):
        best, least = None, start.lft.order
        for j in range(_MOST_PATHS, 0, -1):
            first, path, wanted = path_below(nodes[k:], least, bound, work, impossible, with_zeros=j > 1)
            if not path:
                break
            steps, then = starts[k + first].steps, partial(along, path, least)
            best = _made(problem, candidate, steps, then) or best
            least = best.lft.order if best else least
            if least == wanted:
                break
        if best:
            yield best
        if not start.steps:
            break
        if small := _made(problem, candidate, start.steps):
            yield small
