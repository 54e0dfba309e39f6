"""Loads of a trim times displacements, with a copy of the trim for each displacement that is free.

Displacements q = S(Delta) x of a closed structure follow from those that are free, and parameters
commute, as numbers do: loads T(Delta) q are S(Delta) T(Delta) x. A copy of T for each x and one of S for
each load have fewer channels than a copy of T for each q: three beams that meet have 17 displacements
that loads multiply, and 6 that are free, with 25 channels of T and 3 of S.
"""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import casadi as ca

from mbdlft.exact.matrices import identity, stacked, zeros
from mbdlft.lft.lft import Block
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly
from mbdlft.order.restriction import after, merged, selected
from mbdlft.problem.equations import rows_of
from mbdlft.problem.relations import Lifted, LinearModel


class Moved(NamedTuple):
    """Displacements by some of the signals."""

    lft: ExactLFT  # (n_q, number of sources)
    sources: tuple[int, ...]  # places among the unknown and the known signals


def as_they_are(places: Sequence[int], like: ExactLFT) -> Moved:
    """Displacements that are signals at `places`; the parameters are those of another LFT."""
    blocks = tuple(Block(block.name, 0) for block in like.blocks)
    return Moved(ExactLFT(identity(len(places), like.M.prime), blocks), tuple(places))


def followed(
    model: LinearModel, lifted: Lifted, relations: ExactLFT, places: Sequence[int]
) -> Moved | None:
    """Displacements at `places` by known signals; None if loads or singular equations decide on them.

    The relations have the residuals first among their outputs; unknown, then known signals as inputs.
    """
    unknown, known = model.unknown.numel(), model.known.numel()
    rows, columns = _determining(model, [place for place in places if place < unknown])
    if len(rows) != len(columns) or ca.depends_on(rows_of(model.residual, rows), lifted.loads):
        return None
    n, M, count = relations.order, relations.M, len(columns)
    held = M[[*range(n), *(n + i for i in rows)]][
        :, [*range(n), *(n + j for j in columns), *range(n + unknown, n + unknown + known)]
    ]
    as_known = [zeros(known, n + count, M.prime), identity(known, M.prime)]
    opened = reduce_exactly(ExactLFT(stacked([[held], [stacked([as_known])]]), relations.blocks))
    chosen = [columns.index(p) if p < unknown else count + p - unknown for p in places]
    try:
        moved = reduce_exactly(eliminated(opened, count, chosen))
    except ZeroDivisionError:
        return None
    n = moved.order
    used = [k for k in range(known) if moved.M.residues[:, n + k].any()]
    kept = moved.M[:, [*range(n), *(n + k for k in used)]]
    return Moved(ExactLFT(kept, moved.blocks), tuple(unknown + k for k in used))


def _determining(model: LinearModel, unknown: Sequence[int]) -> tuple[list[int], list[int]]:
    """The rows of the residual that determine some unknown signals, and all that they determine."""
    pattern = ca.jacobian_sparsity(model.residual, model.unknown)
    _, rows, columns, r, c, _, _ = pattern.btf()
    blocks = [(rows[r[k] : r[k + 1]], columns[c[k] : c[k + 1]]) for k in range(len(r) - 1)]
    entries = [*zip(*pattern.get_triplet(), strict=True)]
    needed, count = set(unknown), -1
    while count < len(needed):
        count, needing = len(needed), set[int]()
        for its_rows, its_columns in blocks:
            if needed & {*its_columns}:
                needing |= {*its_rows}
        needed |= {j for i, j in entries if i in needing}
    return sorted(needing), sorted(needed)


def channels_of(trim: ExactLFT, moved: Moved, pairs: Sequence[tuple[int, int]]) -> int:
    """Channels of the copies, before they are reduced."""
    return len(moved.sources) * trim.order + sum(part.order for _, part in _by_load(moved, pairs))


def copied(trim: ExactLFT, moved: Moved, pairs: Sequence[tuple[int, int]]) -> ExactLFT:
    """Loads by the sources, not reduced: of a pair (j, k), output k of the trim times displacement j."""
    copies, outputs = reduce(_beside, [trim for _ in moved.sources]), trim.M.shape[0] - trim.order
    by_load, sources = _by_load(moved, pairs), range(len(moved.sources))
    read = [k * outputs + pairs[places[0]][1] for places, _ in by_load for k in sources]
    followers = reduce(_beside, [part for _, part in by_load])
    loads = after(followers, selected(copies, read, sources))
    found = [place for places, _ in by_load for place in places]
    return selected(loads, [found.index(place) for place in range(len(pairs))], sources)


def _by_load(moved: Moved, pairs: Sequence[tuple[int, int]]) -> list[tuple[list[int], ExactLFT]]:
    """For each load the places of its pairs, and the displacements of these."""
    loads, sources = sorted({load for _, load in pairs}), range(len(moved.sources))
    places = [[place for place, (_, load) in enumerate(pairs) if load == each] for each in loads]
    rows = [[pairs[place][0] for place in own] for own in places]
    parts = [reduce_exactly(selected(moved.lft, chosen, sources)) for chosen in rows]
    return [*zip(places, parts, strict=True)]


def _beside(a: ExactLFT, b: ExactLFT) -> ExactLFT:
    """The LFT of the block diagonal matrix of two values."""
    n, m, prime = a.order, b.order, a.M.prime
    whole = stacked(
        [[a.M, zeros(a.M.shape[0], b.M.shape[1], prime)], [zeros(b.M.shape[0], a.M.shape[1], prime), b.M]]
    )
    rows, columns = (
        [*range(n), *range(first, first + m), *range(n, first), *range(first + m, count)]
        for first, count in zip(a.M.shape, whole.shape, strict=True)
    )
    return merged(whole[rows][:, columns], a.blocks, b.blocks)


def fed(a: ExactLFT, loads: ExactLFT, sources: Sequence[int]) -> ExactLFT:
    """An LFT whose last inputs are loads, by others of its inputs; not reduced."""
    n, m, v = a.order, loads.order, a.M.shape[1] - a.order - (loads.M.shape[0] - loads.order)
    of_input = {source: m + k for k, source in enumerate(sources)}
    wide = stacked([[loads.M, zeros(loads.M.shape[0], 1, a.M.prime)]])
    by_all = wide[:, [*range(m), *(of_input.get(k, m + len(sources)) for k in range(v))]]
    first = a.M[:, [*range(n), *range(n + v, a.M.shape[1]), *range(n, n + v)]]
    twice = after(ExactLFT(first, a.blocks), ExactLFT(by_all, loads.blocks))
    n = twice.order
    M = stacked([[twice.M[:, :n], twice.M[:, n : n + v] + twice.M[:, n + v :]]])
    return ExactLFT(M, twice.blocks)
