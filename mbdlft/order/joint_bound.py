"""The lower bound on the order of an LFT by pairs and triples of deltas (`mbdlft.order.lower_bound`).

Each pair says what its two deltas need above their degrees. The least sum of all needs is a small integer
program; only pairs and triples that its solution contradicts are looked at, as work allows.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import inf

from mbdlft.lft.lft import Block
from mbdlft.order.degree import Pair, Triple, excluding, least_more
from mbdlft.order.lower_bound import cannot_be_single, is_affine, is_constant, more_needed
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.work import Work

_FEW = 4  # deltas whose pairs are all looked at before triples


class JointBound:
    """The bound by pairs and triples of deltas of one LFT, each once; residues are enough."""

    def __init__(self, a: ExactLFT, degrees: Mapping[str, int]) -> None:
        self.a, self.degrees = a, degrees
        self._at_degree = {name for name, size in a.blocks if size == degrees[name]}
        self._pairs: dict[tuple[str, str, bool], Pair] = {}
        self._units: dict[tuple[str, str, bool], float] = {}  # that were too few for a look to its end
        self._triples: dict[Triple, bool] = {}
        self._singles: dict[tuple[str, ...], bool] = {}  # triples of which one is repeated

    def pairs(self, first: str, second: str, work: Work) -> list[Pair]:
        """What is proved for two deltas, for H and for its transpose, until the work is over.

        Nothing can be proved of two that both have their degree in the LFT at hand.
        """
        if self._at_degree.issuperset((first, second)):
            return []
        proved = []
        for side in (False, True):
            key = (first, second, side)
            units = work.most
            look = work.of_try(units)  # what is begun is not begun again
            if units > self._units.get(key, 0.0) and not work.is_over:
                more = more_needed(self.a, first, second, self.degrees, look, is_transposed=side)
                self._units[key] = units if look.is_over else inf
                if more[0]:
                    self._pairs[key] = Pair(first, second, *more, side)
            if key in self._pairs:
                proved.append(self._pairs[key])
        return proved

    def of_all(self, work: Work, *, triples: bool = True, best: Sequence[Block] | None = None) -> int:
        """Proved minimum of the order of any LFT of the matrix, by pairs and triples as work allows.

        Nothing is proved of two deltas that both have their degrees in the `best` LFT.
        """
        used = [name for name, n in self.degrees.items() if n]
        above = used if best is None else [name for name, size in best if size > self.degrees[name]]
        of_pairs = [pair for pair in combinations(used, 2) if not set(pair).isdisjoint(above)]
        of_pairs.sort(key=lambda pair: -sum(name in above for name in pair))
        affine = [name for name, n in self.degrees.items() if n == 1 and is_affine(self.a, name)]
        while True:
            # only a pair or a triple that the repetitions contradict can raise the bound
            for most in (0, inf) if triples or len(used) <= _FEW else (0,):
                self._look_at(of_pairs, most, work)
            more = self._more()
            contradicted = excluding(more, self._proved()) if triples else ()
            open_ = [t for t in contradicted if t not in self._triples]
            single = combinations([name for name in affine if not more[name]], 3)
            singles = [names for names in single if names not in self._singles]
            if not (open_ or singles) or work.is_over:
                return self.known
            for names in singles:
                if not work.is_over:
                    self._singles[names] = cannot_be_single(self.a, names, work)
            for triple in open_:
                is_proved = self._is_proved(triple, work)
                if is_proved or not work.is_over:  # it was looked at to the end
                    self._triples[triple] = is_proved

    def _look_at(self, pairs: Sequence[tuple[str, str]], most: float, work: Work) -> None:
        """Look at the pairs that can raise the bound: of the least repetitions more one is 0.

        The other one is `most`, at most: where it is not 0, only a pair that needs two raises the bound.
        """
        more, looked_at, is_new = self._more(), set[tuple[str, str]](), True
        while is_new:
            is_new = False
            for pair in pairs:
                least, other = sorted(more[name] for name in pair)
                if pair in looked_at or least or other > most or work.is_over:
                    continue
                looked_at.add(pair)
                before = self._proved()
                self.pairs(*pair, work)
                if self._proved() != before:
                    more, is_new = self._more(), True

    @property
    def known(self) -> int:
        """The bound by the pairs and triples that were looked at."""
        return sum(self.degrees.values()) + sum(self._more().values())

    def _proved(self) -> list[Pair]:
        return list(self._pairs.values())

    def _more(self) -> dict[str, int]:
        triples = [triple for triple, is_proved in self._triples.items() if is_proved]
        singles = [names for names, is_proved in self._singles.items() if is_proved]
        return least_more(list(self.degrees), self._proved(), triples, singles)

    def _is_proved(self, triple: Triple, work: Work) -> bool:
        first, second, third, is_transposed = triple
        return any(
            is_constant(self.a, names, self.degrees, work, is_transposed=is_transposed)
            for names in ((first, second, third), (first, third, second))
        )
