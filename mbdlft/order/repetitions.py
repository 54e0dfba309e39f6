"""The least repetitions of deltas that are left by what is proved of pairs and triples of them.

What is excluded is a set of linear inequalities of the repetitions above the degrees, and their least sum
is an integer program. The proofs are in `mbdlft.order.lower_bound`.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, combinations_with_replacement
from math import comb
from typing import NamedTuple

import numpy as np

_SMALL_SUM = 8  # sums below it are tried
_MOST_TRIED = 3000  # combinations of one sum, which take some hundredths of a second


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


def least_more(
    names: Sequence[str],
    pairs: Sequence[Pair],
    triples: Sequence[Triple] = (),
    singles: Sequence[Sequence[str]] = (),
) -> dict[str, int]:
    """Repetitions above the degrees that all pairs and triples allow, with the least sum.

    With e >= 0 repetitions more, e_first = 0 implies e_second >= second_more if and only if
    second_more e_first + e_second >= second_more; and a triple says e_first + 2 e_second + 2 e_third >= 2
    where e_first = 0 is excluded by pairs. Of three that cannot be `singles`, one is repeated.
    """
    if not (pairs or singles):
        return dict.fromkeys(names, 0)
    conditions: list[tuple[dict[str, int], int]] = []
    for first, second, first_more, second_more, _ in pairs:
        conditions.append(({first: second_more, second: 1}, second_more))
        conditions.append(({first: 1, second: first_more}, first_more))
    conditions += [({first: 1, second: 2, third: 2}, 2) for first, second, third, _ in triples]
    conditions += [(dict.fromkeys(three, 1), 1) for three in singles]
    return dict.fromkeys(names, 0) | _least_sum(conditions)


def _least_sum(conditions: Sequence[tuple[Mapping[str, int], int]]) -> dict[str, int]:
    """Whole numbers >= 0 with the least sum for which sum factor e >= least > 0 in all conditions.

    Small sums are tried one after the other, as the integer program is slow to import.
    """
    names = sorted({name for factors, _ in conditions for name in factors})
    rows = np.array([[factors.get(name, 0) for name in names] for factors, _ in conditions])
    least = np.array([least for _, least in conditions])
    for total in range(1, _SMALL_SUM):
        if comb(len(names) + total, total) > _MOST_TRIED:
            break
        for more in combinations_with_replacement(range(len(names)), total):
            e = np.bincount(more, minlength=len(names))
            if np.all(rows @ e >= least):
                return dict(zip(names, e.tolist(), strict=True))
    from scipy.optimize import LinearConstraint, milp  # here because it is slow to import

    ones = np.ones(len(names))
    program = milp(ones, constraints=LinearConstraint(rows, lb=least), integrality=ones)
    return {name: round(float(e)) for name, e in zip(names, program.x, strict=True)}


def allows(pair: Pair, more: Mapping[str, int]) -> bool:
    """Whether a pair leaves these repetitions above the degrees possible."""
    first, second = more[pair.first], more[pair.second]
    return (first > 0 or second >= pair.second_more) and (second > 0 or first >= pair.first_more)


def excluding(more: Mapping[str, int], pairs: Sequence[Pair]) -> Iterator[Triple]:
    """Triples that would exclude these repetitions above the degrees, of deltas that are in pairs."""
    beside: dict[tuple[str, bool], list[str]] = {}
    for pair in pairs:
        beside.setdefault((pair.first, pair.is_transposed), []).append(pair.second)
        beside.setdefault((pair.second, pair.is_transposed), []).append(pair.first)
    for (first, is_transposed), others in beside.items():
        for second, third in combinations(others, 2):
            triple = Triple(first, second, third, is_transposed)
            if more[triple.first] <= 1 and more[triple.second] == more[triple.third] == 0:
                yield triple
