"""Lower bound on the order of an LFT: deltas that cannot all have their McMillan degree.

Fix all deltas but a and b. What is left is H(a, b) with n_in columns, of McMillan degrees D_a and D_b.
The pairs (u, y) of polynomials with y = H u are a vector bundle G on the product of two projective
lines. From an LFT with D_a and D_b repetitions follows X_ab = H^1(G(-1, -1)) = 0. So if h = dim X > 0
there is none: if a has D_a repetitions, b has at least D_b + h/kappa, where on every line b = const the
pairs are generated in degree kappa of a at most.

One repetition of a more than D_a is a line bundle on a plane a = const. If X_ab has an element that is
constant in c, and X_ac is not zero, it cannot be enough for both b and c to have their degree.

Theorems and proofs: docs/method.md, section "Pairs that cannot both be smallest"; the numbers come from
`mbdlft.order.sections`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np

from mbdlft.base.errors import WellPosednessError
from mbdlft.lft.lft import LFT, check, fix, transpose
from mbdlft.order.exact_pairs import is_constant, more_needed
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.reduction_in_doubles import reduce_order
from mbdlft.order.sections import Degrees, DoubtError, compressed, is_constant_in, obstruction
from mbdlft.order.work import Work, reduction

_FIXINGS, _TRIES = 2, 4  # values of the other deltas that have to agree, and that are tried
_CENTER = 0.6  # of the range of a delta, where these values are taken

Proved = TypeVar("Proved")
Both = tuple[LFT, LFT]  # an LFT, and its source


class Pair(NamedTuple):
    """Two deltas that do not both have their degree.

    `second_more` are the repetitions above its degree that the second needs if the first has none, and
    the other way round. Both are at least 1. `is_transposed` says whether it is proved for H or for its
    transpose.
    """

    first: str
    second: str
    first_more: int
    second_more: int
    is_transposed: bool = False


class Triple(NamedTuple):
    """If the last two deltas have their degree, the first has at least two repetitions above its own."""

    first: str
    second: str
    third: str
    is_transposed: bool = False


Confirmation = Callable[[Pair | Triple], Pair | bool | None]


def joint_bound(
    a: LFT,
    degrees: Degrees,
    work: Work | None = None,
    source: LFT | None = None,
    confirmed: "Confirmation | None" = None,
) -> int:
    """Proved minimum of the order of any exact LFT of the same matrix.

    Parameters
    ----------
    a : LFT
    degrees : mapping of names to McMillan degrees
        As from `exact_degrees` or `degree_bounds`.
    work : Work, optional
        Asked before each pair and triple whether it is over; those that were not looked at do not count.
        By default it never is.
    source : LFT, optional
        What `a` was made of by changes that leave rounding, if it is not `a` itself.
    confirmed : function, optional
        What an exact computation makes of a pair or triple that doubles show, as of `confirmation`.

    Returns
    -------
    int
        At least the sum of the degrees; what is not clear numerically does not count.

    Raises
    ------
    StructureError
        A delta has no degree.
    """
    source, work = a if source is None else source, Work() if work is None else work
    pairs = pair_bounds(a, degrees, work=work, source=source)
    if confirmed is not None:
        found = [confirmed(pair) for pair in pairs]
        pairs = tuple(pair for pair in found if isinstance(pair, Pair))
    names = [block.name for block in a.blocks]
    has = _above(a, degrees)
    random, proved = np.random.default_rng(0), dict[Triple, bool]()
    while True:
        more = least_more(names, pairs, [triple for triple in proved if proved[triple]])
        # only a triple that these repetitions contradict can raise the bound
        new = [triple for triple in _excluding(more, pairs) if triple not in proved]
        if not new:
            return sum(degrees[name] for name in names) + sum(more.values())
        for triple in new:
            proved[triple] = (
                not work.is_over
                and not _excludes(triple, has)
                and _is_proved((a, source), triple, degrees, random, work)
                and (confirmed is None or bool(confirmed(triple)))
            )


def confirmation(a: ExactLFT, degrees: Degrees, work: Work) -> "Confirmation":
    """A function that proves pairs and triples on residues, each once.

    A pair comes back with the numbers that are proved, or as None; a triple as whether it is.
    """

    @cache
    def confirmed(claim: Pair | Triple) -> Pair | bool | None:
        if isinstance(claim, Triple):
            first, second, third, is_transposed = claim
            return any(
                is_constant(a, names, degrees, work, is_transposed=is_transposed)
                for names in ((first, second, third), (first, third, second))
            )
        names, is_transposed = (claim.first, claim.second), claim.is_transposed
        first_more, second_more = more_needed(a, *names, degrees, work, is_transposed=is_transposed)
        if not (first_more and second_more):
            return None
        return claim._replace(first_more=first_more, second_more=second_more)

    return confirmed


def pair_bounds(
    a: LFT,
    degrees: Degrees,
    seed: int = 0,
    work: Work | None = None,
    source: LFT | None = None,
) -> tuple[Pair, ...]:
    """The pairs of deltas of an LFT that are proved not to have both their degree.

    A pair that `a` itself contradicts has a wrong rank, and is left out. A pair may come twice, once for
    `a` and once for its transpose. `source` is that of `joint_bound`.

    Raises
    ------
    StructureError
        A delta has no degree.
    """
    missing = [block.name for block in a.blocks if block.name not in degrees]
    check(not missing, f"the degrees of {missing} are missing, got those of {list(degrees)}")
    random, more = np.random.default_rng(seed), _above(a, degrees)
    work = Work() if work is None else work
    names = [name for name in more if degrees[name]]
    proved = [
        _pair(
            (a, a if source is None else source),
            first,
            second,
            degrees,
            random,
            work,
            is_transposed=is_transposed,
        )
        for first, second in combinations(names, 2)
        for is_transposed in (False, True)
        if not work.is_over
    ]
    return tuple(pair for pair in proved if pair is not None and allows(pair, more))


def least_more(
    names: Sequence[str], pairs: Sequence[Pair], triples: Sequence[Triple] = ()
) -> dict[str, int]:
    """Repetitions above the degrees that all pairs and triples allow, with the least sum.

    With e >= 0 repetitions more, e_first = 0 implies e_second >= second_more if and only if
    second_more e_first + e_second >= second_more; and a triple says e_first + 2 e_second + 2 e_third >= 2
    where e_first = 0 is excluded by pairs.
    """
    if not pairs:
        return dict.fromkeys(names, 0)
    from scipy.optimize import LinearConstraint, milp  # here because it is slow to import

    conditions: list[tuple[dict[str, int], int]] = []
    for first, second, first_more, second_more, _ in pairs:
        conditions.append(({first: second_more, second: 1}, second_more))
        conditions.append(({first: 1, second: first_more}, first_more))
    conditions += [({first: 1, second: 2, third: 2}, 2) for first, second, third, _ in triples]
    rows = np.array([[factors.get(name, 0) for name in names] for factors, _ in conditions])
    least = np.array([least for _, least in conditions])
    ones = np.ones(len(names))
    program = milp(ones, constraints=LinearConstraint(rows, lb=least), integrality=ones)
    return {name: round(float(e)) for name, e in zip(names, program.x, strict=True)}


def _above(a: LFT, degrees: Degrees) -> dict[str, int]:
    """Repetitions that an LFT has above the degrees."""
    return {block.name: block.size - degrees[block.name] for block in a.blocks}


def allows(pair: Pair, more: Mapping[str, int]) -> bool:
    """Whether a pair leaves these repetitions above the degrees possible."""
    first, second = more[pair.first], more[pair.second]
    return (first > 0 or second >= pair.second_more) and (second > 0 or first >= pair.first_more)


def _excludes(triple: Triple, more: Mapping[str, int]) -> bool:
    """Whether these repetitions above the degrees are not possible."""
    return more[triple.first] <= 1 and more[triple.second] == more[triple.third] == 0


def _excluding(more: Mapping[str, int], pairs: Sequence[Pair]) -> Iterator[Triple]:
    """Triples that would exclude these repetitions above the degrees, of deltas that are in pairs."""
    beside: dict[tuple[str, bool], list[str]] = {}
    for pair in pairs:
        beside.setdefault((pair.first, pair.is_transposed), []).append(pair.second)
        beside.setdefault((pair.second, pair.is_transposed), []).append(pair.first)
    for (first, is_transposed), others in beside.items():
        for second, third in combinations(others, 2):
            triple = Triple(first, second, third, is_transposed)
            if _excludes(triple, more):
                yield triple


def _pair(
    both: Both,
    first: str,
    second: str,
    degrees: Degrees,
    random: np.random.Generator,
    work: Work,
    *,
    is_transposed: bool,
) -> Pair | None:
    """What is proved for two deltas at several values of the others; the least of it."""
    at = partial(_more_at, first, second, degrees, random, work)
    more = _at_values(both, (first, second), random, at, work, is_transposed=is_transposed)
    if not more:
        return None
    first_more, second_more = (min(side) for side in zip(*more, strict=True))
    return Pair(first, second, first_more, second_more, is_transposed)


def _at_values(
    both: Both,
    names: Sequence[str],
    random: np.random.Generator,
    at: Callable[[LFT, LFT], Proved | None],
    work: Work,
    *,
    is_transposed: bool,
) -> list[Proved]:
    """What is proved for some deltas at values of the others; nothing if it is not at each of them."""
    a, source = (transpose(item) for item in both) if is_transposed else both
    clear: list[Proved] = []
    for _ in range(_TRIES):
        others = {
            block.name: float(random.uniform(-_CENTER, _CENTER))
            for block in a.blocks
            if block.name not in names
        }
        try:
            work.add(3.0 * reduction(a.order) + reduction(source.order))
            proved = at(reduce_order(fix(a, others)), fix(source, others))
        except (DoubtError, WellPosednessError, np.linalg.LinAlgError):
            continue
        if proved is None:
            return []
        clear.append(proved)
        if len(clear) == _FIXINGS:
            return clear
    return []


def _more_at(
    first: str,
    second: str,
    degrees: Degrees,
    random: np.random.Generator,
    work: Work,
    a: LFT,
    source: LFT,
) -> tuple[int, int] | None:
    """Repetitions above its degree of one delta if the other has none, for an LFT in these two."""
    if a.order == degrees[first] + degrees[second]:
        return None
    H = compressed(a, source, random, work)
    forth = obstruction(H, first, second, degrees, random, work)
    if not forth.dimensions:
        return None
    back = obstruction(H, second, first, degrees, random, work)
    same = forth.dimensions[:1] == back.dimensions[:1]
    if not same or forth.characteristic != back.characteristic:
        raise DoubtError
    return back.more, forth.more


def _is_proved(
    both: Both, triple: Triple, degrees: Degrees, random: np.random.Generator, work: Work
) -> bool:
    """Whether an X of the first and another delta of a triple is constant in the last one."""
    first, second, third, is_transposed = triple
    return any(
        _at_values(
            both,
            names,
            random,
            partial(_constant_at, names, degrees, random, work),
            work,
            is_transposed=is_transposed,
        )
        for names in ((first, second, third), (first, third, second))
    )


def _constant_at(
    names: tuple[str, str, str],
    degrees: Degrees,
    random: np.random.Generator,
    work: Work,
    a: LFT,
    source: LFT,
) -> bool | None:
    """The same for an LFT in these three; None if it is not."""
    H = compressed(a, source, random, work)
    return is_constant_in(H, *names, degrees, random, work) or None
