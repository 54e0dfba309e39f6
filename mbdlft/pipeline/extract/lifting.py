"""Relations with lifted loads as an LFT: trim loads times displacements are few small LFTs.

The loads of an equilibrium that the trim solves for are t(p) = T(Delta) 1, rational in the parameters. A
displacement x is multiplied with them in a signal T(Delta) x. T is reduced before it is put into the
relations, once for each displacement, or for each that is free (`copies.py`). What it does not depend on
leaves it: that needs parameters that commute, as numbers do, where the reduction of the whole knows
products in their order only. The loads of a frame of one material do not depend on its modulus, though
each deflection does. For two and three elements in each of the three beams of a portal the order is 84
and 121 so. It was 110 and 1,193, as each displacement had all deflections of the frame, and 1,500
channels were the most for exact numbers.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca

from mbdlft.base.parameter import BilinearMap
from mbdlft.lft.lft import Block, consecutive
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly, transposed
from mbdlft.order.restriction import with_affine_restricted
from mbdlft.pipeline.extract.copies import Moved, as_they_are, channels_of, copied, fed, followed
from mbdlft.pipeline.extract.graph import Extraction, SparseExtraction, extract_graph
from mbdlft.problem.relations import Lifted, LinearModel
from mbdlft.problem.scales import in_own_units


def extract(model: LinearModel, maps: Sequence[BilinearMap] | None = None) -> Extraction:
    """As `extract_graph`, with the lifted loads of the relations, and channels closed."""
    made = extract_within(model, maps, math.inf)
    assert isinstance(made, Extraction)
    return made


def extract_within(
    model: LinearModel, maps: Sequence[BilinearMap] | None, most: float
) -> Extraction | SparseExtraction:
    """As `extract`; sparse if there are more than `most` channels after the reduction of words."""
    if model.lifted is None:
        reduced = extract_graph(model, maps)
        return reduced.closed() if reduced.order <= most else reduced.sparse()
    made = [_with_lifted(model, model.lifted, maps, most)]
    # units of their own take no channel of copies whose loads have each parameter once, as those of
    # mechanisms: a delta robot has 9, and would have 15; loop 19 of the attack has 19, and would have 45
    if made[0].is_repeated and (own := in_own_units(model)) is not model and own.lifted:
        made.append(_with_lifted(own, own.lifted, maps, most))
    some = [form.extraction for form in made if form.extraction]
    fewest = min(some, key=lambda extraction: extraction.lft.order, default=None)
    return fewest or extract_graph(_inlined(model, model.lifted), maps).sparse()


class _Lifted(NamedTuple):
    """The LFT with lifted loads, if it has few enough channels, and whether loads repeat a parameter."""

    extraction: Extraction | None
    is_repeated: bool = True  # not known


def _with_lifted(
    model: LinearModel, lifted: Lifted, maps: Sequence[BilinearMap] | None, most: float
) -> _Lifted:
    m, trim = model, lifted.trim
    reduced = extract_graph(  # together, as the numbers of both decide on the prime of their residues
        replace(
            m,
            residual=ca.vertcat(m.residual, trim.residual),
            output=ca.vertcat(m.output, trim.output),
            unknown=ca.vertcat(m.unknown, trim.unknown),
            known=ca.vertcat(m.known, lifted.loads, trim.known),
            lifted=None,
        ),
        maps,
    )
    if reduced.order > most:
        return _Lifted(None)
    every = reduced.closed()
    M, blocks = every.lft.M, every.lft.blocks
    z, r, held, y, loads = _places(every.lft.order, m.residual, trim.residual, m.output, trim.output)
    w, u, efforts, x, lifts, constant = _places(
        every.lft.order, m.unknown, trim.unknown, m.known, lifted.loads, trim.known
    )
    relations = ExactLFT(M[[*z, *r, *y]][:, [*w, *u, *x, *lifts]], blocks)
    inside = ExactLFT(M[[*z, *held, *loads]][:, [*w, *efforts, *constant]], blocks)
    held_by = _loads(inside, len(held))
    is_repeated = any(block.size > 1 for block in held_by.blocks)
    # what outputs do not see goes first: it is more than what inputs do not reach. Parameters that loads
    # share with masses are affine without the loads
    relations = with_affine_restricted(transposed(reduce_exactly(transposed(relations))))
    opened = ExactLFT(M[[*z, *r]][:, [*w, *u, *x, *lifts]], blocks)
    moved, pairs = _moved(model, lifted, opened, held_by)
    if relations.order + channels_of(held_by, moved, pairs) > most:
        return _Lifted(None, is_repeated)
    by_sources = reduce_exactly(copied(held_by, moved, pairs))
    return _Lifted(Extraction(fed(relations, by_sources, moved.sources), every.channels), is_repeated)


def _moved(
    model: LinearModel, lifted: Lifted, relations: ExactLFT, trim: ExactLFT
) -> tuple[Moved, list[tuple[int, int]]]:
    """The displacements of loads by signals that few copies of the trim are for; pairs of both.

    Copies for displacements that follow from others without any parameter fall together by themselves.
    """
    places = _displaced(model, lifted)
    some = sorted(set(places))
    pairs = [(some.index(place), load) for place, load in zip(places, lifted.outputs, strict=True)]
    by_themselves = as_they_are(some, relations)
    by_free = followed(model, lifted, relations, some)
    if by_free is None or not by_free.lft.order:
        return by_themselves, pairs
    fewer = channels_of(trim, by_free, pairs) < channels_of(trim, by_themselves, pairs)
    return by_free if fewer else by_themselves, pairs


def _displaced(model: LinearModel, lifted: Lifted) -> list[int]:
    """The place among the signals of the displacement of each load."""
    signals = ca.vertcat(model.unknown, model.known)
    return list(ca.jacobian_sparsity(lifted.displacements, signals).T.row())


def _inlined(model: LinearModel, lifted: Lifted) -> LinearModel:
    """The relations with loads as unknown signals T x: a copy of the trim for each displacement."""
    trim, places, signals = lifted.trim, _displaced(model, lifted), ca.vertcat(model.unknown, model.known)
    residuals, unknown, loads = [], [], {}
    for place in sorted(set(places)):
        copy = ca.SX.sym(f"held{place}", trim.unknown.numel())
        residual, loads[place] = ca.substitute(
            [trim.residual, trim.output], [trim.unknown, trim.known], [copy, signals[place]]
        )
        residuals.append(residual)
        unknown.append(copy)
    pairs = zip(places, lifted.outputs, strict=True)
    values = ca.vertcat(*(loads[place][k] for place, k in pairs))
    residual, output = ca.substitute([model.residual, model.output], [lifted.loads], [values])
    return replace(
        model,
        residual=ca.vertcat(residual, *residuals),
        output=output,
        unknown=ca.vertcat(model.unknown, *unknown),
        lifted=None,
    )


def _places(channels: int, *signals: ca.SX) -> list[range]:
    """Places of channels, and of signals behind them."""
    counts = [channels, *(signal.numel() for signal in signals)]
    return [range(span.start, span.stop) for span in consecutive(counts)]


def _loads(trim: ExactLFT, held: int) -> ExactLFT:
    """The loads (n_l, 1) of relations of the trim, without the parameters that they do not depend on."""
    opened = reduce_exactly(trim)
    outputs = range(held, opened.M.shape[0] - opened.order)
    loads = reduce_exactly(eliminated(opened, held, [*outputs]))
    degrees = exact_degrees(loads)
    if all(degrees[block.name] for block in loads.blocks if block.size):
        return loads
    n, channels = loads.order, range(loads.order)
    pairs = zip(loads.blocks, loads.parts, strict=True)
    kept = [k for block, span in pairs if degrees[block.name] for k in channels[span]]
    M = loads.M[[*kept, *range(n, loads.M.shape[0])]][:, [*kept, *range(n, loads.M.shape[1])]]
    blocks = tuple(Block(b.name, b.size if degrees[b.name] else 0) for b in loads.blocks)
    return reduce_exactly(ExactLFT(M, blocks))
