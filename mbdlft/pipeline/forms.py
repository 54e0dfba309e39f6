"""The forms of a problem, each extracted, solved and reduced in exact numbers, and rounded once.

Decisions are made for the numbers as they are written. An axis (0, 0.5, 0.8660254) is not parallel to
another one after 30 deg, and terms that nearly cancel cost repetitions. So the numbers of a problem are
compared with simple numbers near them (`near_relations`). If the problem with these in their places has a
smaller order, its certificate says which; the problem is not changed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from math import inf, pi
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, MbdlftError, StructureError, WellPosednessError, naming
from mbdlft.base.parameter import deltas_at
from mbdlft.base.running import without_collection
from mbdlft.exact.modular import Residues, entrywise, inverses, multiplied, pivot_columns, solved
from mbdlft.exact.numbers import (
    BITS,
    LARGEST_ANGLE,
    RESIDUES_ALONE,
    Constant,
    TooFewBitsError,
    ask_for_bits,
    in_enough_bits,
    precision,
    prime_of,
)
from mbdlft.lft.determinant import values_at
from mbdlft.lft.lft import LFT, Block, condition
from mbdlft.lft.sampling import evaluate_at
from mbdlft.lft.sparse import solved_for, value_and_sign, with_zeros
from mbdlft.order.lower_bound import at_random, exact_degrees
from mbdlft.order.reduction import (
    ExactLFT,
    eliminated,
    in_good_coordinates,
    in_scales,
    reduce_exactly,
    transposed,
)
from mbdlft.order.restriction import INDEPENDENT, Step, by_step, with_affine_restricted
from mbdlft.order.sparse_bound import SparseResidues, sparse_degrees, value_at_random
from mbdlft.pipeline.extract import Extraction, SparseExtraction, extract, extract_within
from mbdlft.problem.relations import Form, LinearModel, Problem
from mbdlft.problem.sx.constants import constant, constants_in, double, is_zero
from mbdlft.system.sampled import rates_of

_MOST_EXACT = 4000  # channels after the reduction of words: these take three minutes and 1.5 GB
_MOST_PARAMETERS = 1000  # that a model depends on: some 10 s, with their cube
_MANY = 300  # channels: reduced before and after they are closed, they lose more bits than `BITS`
_MOST_CONDITION = 1e3  # of I - M11 Delta, up to which three digits are lost and zeros are kept
_SEVERAL = 4  # points, at which an entry that is not zero has a value
_TAKES_PART = 0.1  # in a direction that nothing determines


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One form, reduced; rows and columns are still divided by their units."""

    form: Form
    channels: Mapping[str, int]  # of the signal graph before any reduction, by parameter
    exactly: tuple[int, ExactLFT] | None  # bits, and `relations` before any steps
    exact: ExactLFT | SparseResidues  # solved for the unknown signals, reduced
    lft: LFT  # `exact` in doubles


def candidates(problem: Problem, forms: Sequence[Form]) -> list[Candidate]:
    """A candidate of each form, the smallest first; none of a transposed one that would be sparse."""
    with without_collection():
        reduced = [
            in_enough_bits(partial(candidate_of, problem, form), problem.nouns.owner) for form in forms
        ]
    return sorted(filter(None, reduced), key=lambda candidate: candidate.lft.order)


def degrees(candidate: Candidate, seed: int) -> dict[str, int]:
    """Lower bounds of the repetitions by parameter."""
    if isinstance(candidate.exact, SparseResidues):
        return sparse_degrees(candidate.exact, seed)
    return exact_degrees(candidate.exact, seed)


def accelerations(problem: Problem, candidate: Candidate, lft: LFT) -> dict[str, Any]:
    """Outputs whose rows of [C D] are sums of those of [A B] of rates; momenta; at random residues.

    Rates are derivatives of states, as values of the model show, and states of what is held at rest: the
    entries of their rows for these states are regular. Of what is free they are singular, and sums of
    rates, the momenta, are conserved if their rows are zero: by an input, if its entries are, too. Which
    sums other rows are, inputs that move momenta tell. Motions in which those entries cancel are those
    of a rigid body if no other row but those of positions sees them and their rates. Momenta of inputs
    say which motions they make, and rows whether an output feels these.
    """
    exact, n = candidate.exact, len(problem.states)
    if isinstance(exact, SparseResidues):
        value, prime = value_at_random(exact), exact.prime
    else:
        value, prime = at_random(exact)[exact.order :, exact.order :], exact.M.prime
    values = evaluate_at(lft, deltas_at(problem.parameters, problem.points[:_SEVERAL]))
    pairs = rates_of(values[:, :n, :n], values[:, :n, n:])
    rates, position = [*pairs.values()], np.array([*pairs], dtype=int)
    left, sums, pivots = _without_sums(value, rates, position, prime)
    count = len(position) - len(pivots)
    motions = np.zeros((len(position), count), dtype=np.int64)
    free = np.setdiff1d(np.arange(len(position)), pivots)
    motions[free, range(count)], motions[pivots] = 1, -sums[:, position[free]] % prime
    moving = entrywise(inverses(value[position, rates], prime)[:, None], motions, prime)
    seen = multiplied(value[:, rates], moving, prime).any(axis=1)
    seen = (seen | left[:, position[free]].any(axis=1)) & ~np.isin(np.arange(len(value)), position)
    is_moved = np.asarray(left[rates].any(axis=0))
    leaves, is_blind = ~is_moved[n:] & ~np.any(is_moved[:n]), ~seen[n:]
    momenta, rigid = np.where(leaves, count, 0), np.where(is_blind, count, -count)
    is_rigid = bool(np.any(rigid)) and not np.any(seen[:n])
    ends = len(is_moved)
    if not np.all(leaves):  # some of the inputs, and as many more, which push as the motions go
        value = np.hstack([value, np.zeros((len(value), count), dtype=np.int64)])
        value[rates, ends:] = moving
        left, _, _ = _without_sums(value, rates, np.append(position, np.arange(n, ends)), prime)
    proved = value[n:].any(axis=1) & ~left[n:, :ends].any(axis=1) & (is_rigid or bool(np.any(leaves)))
    proved, unmoved = np.asarray(proved), np.zeros((len(value) - n, len(leaves)), dtype=np.bool_)
    if is_rigid and not np.all(leaves) and not np.any(is_moved[:n]):
        shown = (
            multiplied(value[n:, position], motions, prime),
            multiplied(value[n:, rates], moving, prime),
            left[n:, ends:] * proved[:, None],
        )
        momenta_by = _without_sums(value, rates, position, prime)[0][rates, n:]
        unmoved = _unmoved(shown, momenta_by, count, prime) & ~leaves
    return {
        "accelerations": tuple(np.flatnonzero(proved).tolist()),
        "momenta": tuple(momenta.tolist()) if np.any(momenta) else (),
        "rigid_motions": tuple(rigid.tolist()) if is_rigid else (),
        "unmoved": tuple((i, j) for i, j in np.argwhere(unmoved).tolist()),
    }


def _unmoved(shown: Sequence[Residues], momenta: Residues, count: int, prime: int) -> NDArray[np.bool_]:
    """Which outputs (ny, nu) are shown nothing of the rigid motions of inputs.

    Shown are motions (ny, count), such as places and rates. Momenta are those of the inputs, and of
    inputs that push as the motions go; some depend on others.
    """
    rows = pivot_columns(momenta[:, -count:].T, prime)
    if len(rows) < count:  # a motion that has no momentum
        return np.zeros((len(shown[0]), momenta.shape[1] - count), dtype=np.bool_)
    moved = solved(momenta[rows, -count:], momenta[rows, :-count], prime)
    return np.asarray(~np.any([multiplied(motion, moved, prime) for motion in shown], axis=0))


def _without_sums(
    value: Residues, rates: Sequence[int], some: Residues, prime: int
) -> tuple[Residues, Residues, list[int]]:
    """Rows less the sums of rates that some columns tell; these sums, and their pivots there."""
    of_rates = value[rates]
    among = of_rates[:, some]
    rows, pivots = pivot_columns(among.T, prime), pivot_columns(among, prime)
    sums = solved(of_rates[rows][:, some[pivots]], of_rates[rows], prime)
    return (value - multiplied(value[:, some[pivots]], sums, prime)) % prime, sums, pivots


def reduced_relations(relations: LinearModel) -> LFT:
    """Relations solved for all of their unknown signals, reduced and rounded."""

    def solved() -> LFT:
        n, opened = relations.unknown.numel(), extract(relations).lft
        return in_scales(reduce_exactly(eliminated(opened, n, [*range(n)])).rounded())

    return in_enough_bits(solved, "trim")


def restricted(
    problem: Problem,
    form: Form,
    steps: Sequence[Step] = (),
    *,
    known: Candidate | None = None,
    then: Callable[[ExactLFT], ExactLFT | None] | None = None,
    prime: int | None = None,
) -> Candidate | None:
    """A candidate with blocks restricted by steps, and what follows; None if that is not possible.

    It needs too many bits, or is singular. The relations of a `known` candidate of the form are not
    extracted again. The prime may be that of an index, in any bits: what follows depends on it.
    """
    make = partial(candidate_of, problem, form, steps, known=known, then=then)
    try:
        with without_collection(), prime_of(prime):
            return in_enough_bits(make, problem.nouns.owner)
    except (AnalysisError, WellPosednessError):
        return None


def _restricted(a: ExactLFT, steps: Sequence[Step], *, of_relations: bool) -> ExactLFT:
    for step in steps:
        if step.of_relations is of_relations:
            a = by_step(a, step) or a
    return a


def candidate_of(
    problem: Problem,
    form: Form,
    steps: Sequence[Step] = (),
    *,
    known: Candidate | None = None,
    then: Callable[[ExactLFT], ExactLFT | None] | None = None,
) -> Candidate | None:
    """A candidate of a form with blocks restricted by steps, in the bits of now; None if it is sparse.

    `then` is what the closed LFT is followed by, if anything; its None is one of the candidate.
    """
    made = _exactly(problem, form, steps, known)
    if isinstance(made, SparseExtraction):
        return None if form.is_transposed else _sparsely(problem, form, made)
    channels, exactly, reduced = made
    exact = then(reduced) if then else reduced
    if exact is None:
        return None
    has_unknowns = form.relations.unknown.numel() > 0
    is_reduced = exact is reduced and not (has_unknowns and set(steps) - {INDEPENDENT})
    most = _MOST_CONDITION if is_reduced else 0.0
    lft = _in_few_bits(exact, some_deltas(problem, exact), most)
    return Candidate(form, channels, exactly, exact, lft)


def residues_of(problem: Problem, form: Form, steps: Sequence[Step], prime: int) -> ExactLFT | None:
    """The closed LFT of a form with blocks restricted by steps, modulo the prime of an index.

    None where that is not possible.
    """
    try:
        with prime_of(prime), precision(RESIDUES_ALONE), without_collection():
            made = _exactly(problem, form, steps, None)
    except (AnalysisError, WellPosednessError):
        return None
    return None if isinstance(made, SparseExtraction) else made[-1]


def _exactly(
    problem: Problem, form: Form, steps: Sequence[Step], known: Candidate | None
) -> tuple[Mapping[str, int], tuple[int, ExactLFT], ExactLFT] | SparseExtraction:
    """Channels before any reduction, bits and relations, and the closed LFT, with steps."""
    if known and known.exactly:
        ask_for_bits(known.exactly[0])  # fewer were not enough
    if known and known.exactly and known.exactly[0] == flint.ctx.prec:
        relations, channels = known.exactly[1], known.channels
    else:
        with naming(problem.nouns.owner, StructureError, WellPosednessError):
            extracted = extract_within(form.relations, form.maps, _MOST_EXACT)
        if isinstance(extracted, SparseExtraction):
            return extracted
        relations, channels = _reduced(problem, form, extracted), extracted.channels
    exactly, n = (flint.ctx.prec, relations), form.relations.unknown.numel()
    relations = _restricted(relations, steps, of_relations=n > 0)
    try:
        closed = closed_exactly(form, relations) if n else relations
    except ZeroDivisionError:
        raise _singular(problem, relations.rounded(), n) from None
    reduced = _restricted(reduce_exactly(closed), steps, of_relations=False) if n else relations
    return channels, exactly, reduced


def _in_few_bits(a: ExactLFT, deltas: Array, most: float) -> LFT:
    """The LFT in good coordinates, which seldom take the bits that it was made in."""
    if flint.ctx.prec > BITS:
        with suppress(TooFewBitsError), precision(BITS):
            return in_good_coordinates(a, deltas, most)
    return in_good_coordinates(a, deltas, most)


def closed_exactly(form: Form, relations: ExactLFT) -> ExactLFT:
    """Relations solved for unknown signals, not reduced; a ZeroDivisionError if they are singular."""
    n = form.relations.unknown.numel()  # the equations come first; there are as many as unknowns
    outputs = range(n, relations.M.shape[0] - relations.order)
    return eliminated(relations, n, [*range(form.relations.derivatives), *outputs])


def _reduced(problem: Problem, form: Form, extracted: Extraction) -> ExactLFT:
    """The relations of a form, reduced."""
    opened = transposed(extracted.lft) if form.is_transposed else extracted.lft
    count = sum(block.size > 0 for block in opened.blocks)
    if count > _MOST_PARAMETERS:
        raise AnalysisError(
            f"{problem.nouns.owner}: depends on {count} parameters; at most {_MOST_PARAMETERS}, as the "
            "time of a model grows with their cube. Give numbers to some, or parameters to sums and "
            "products of them. A sweep takes any number."
        )
    if form.relations.unknown.numel() and opened.order > _MANY and opened.M.known_balls is not None:
        ask_for_bits(2 * BITS)
    relations = reduce_exactly(opened)
    return relations if form.relations.lifted is None else with_affine_restricted(relations)


def some_deltas(problem: Problem, a: ExactLFT) -> Array:
    """Deltas (N, number of blocks) of a few of the points of the check."""
    points = problem.points[sorted({0, len(problem.points) // 2, len(problem.points) - 1})]
    return _deltas_of(problem, a.blocks, points)


def _deltas_of(problem: Problem, blocks: Sequence[Block], points: Array) -> Array:
    names = [parameter.name for parameter in problem.parameters]
    deltas = deltas_at(problem.parameters, points)
    return np.asarray(deltas[:, [names.index(block.name) for block in blocks]])


def is_regular_at_points(problem: Problem, lft: LFT) -> bool:
    """Whether the determinant has one sign at nominal and at all points of the check."""
    deltas = _deltas_of(problem, lft.blocks, problem.points)
    return bool(np.all(values_at(lft, deltas)[1] > 0.0))


def _sparsely(problem: Problem, form: Form, relations: SparseExtraction) -> Candidate:
    """The same as sparse equations, whose unknown signals are signals like others."""
    opened, first = relations.lft, form.relations.derivatives
    lft = solved_for(opened.lft, relations.unknown, first)
    if value_and_sign(lft, np.zeros(len(lft.blocks)))[1] == 0.0:
        raise WellPosednessError(f"{problem.nouns.owner}: {problem.singular(inf, ())}")
    residues = SparseResidues(
        lft, np.append(opened.entries, np.ones(first, dtype=np.int64)), opened.prime
    )
    with naming(problem.nouns.owner, WellPosednessError):
        lft = with_zeros(lft, value_at_random(residues) != 0)
    return Candidate(form, relations.channels, None, residues, lft)


def _singular(problem: Problem, relations: LFT, n: int) -> WellPosednessError:
    inner = relations.M22[:n, :n]
    directions = np.abs(np.linalg.svd(inner)[2][-1])
    names = [
        signal.name
        for signal, size in zip(problem.states, directions, strict=False)
        if size > _TAKES_PART
    ]
    return WellPosednessError(f"{problem.nouns.owner}: {problem.singular(condition(inner), names)}")


_MOST = 400  # channels before reduction: a second look at more takes long
_PART, _PART_OF_AXIS = 1e-9, 1e-5  # of itself, of its length: a number is near another one
_DIGITS, _DIGITS_OF_ANGLE = 6, 4  # a number of so many digits may be another one that was rounded
_SIMPLE, _LARGEST = 12, 144  # largest denominator and numerator of what may be meant
_STEP = 15  # degrees
_MOST_DIGITS = 20


class Signed(NamedTuple):
    """A constant, or its negative."""

    sign: int
    number: Constant

    @property
    def value(self) -> float:
        """The double next to it."""
        return self.sign * double(self.number)

    @property
    def symbol(self) -> ca.SX:
        """Its expression."""
        return self.sign * constant(self.number)

    def __str__(self) -> str:
        kind, argument = self.number.kind, self.number.argument
        unit = " rad" if self.number.in_radians else " deg"
        texts = {
            "rational": f"{argument}" if argument.denominator <= _SIMPLE else f"{self.value!r}",
            "root": f"sqrt({argument})",
            "pi": f"{argument} pi",
            "cosine": f"cos({float(argument):.15g}{unit})",
            "sine": f"sin({float(argument):.15g}{unit})",
            "unit": f"{self.value!r}",
        }
        by_value = texts[kind] == f"{self.value!r}"
        return texts[kind] if by_value or self.sign > 0 else f"-{texts[kind]}"


def near_relations(problem: Problem, smallest: Candidate, least: int) -> tuple[str, ...]:
    """Sentences on numbers that nearly are others, if the order is below the least one with these."""
    relations = smallest.form.relations
    if sum(smallest.channels.values()) > _MOST:
        return ()
    lifted = relations.lifted
    held = lifted.trim.residual if lifted else ca.SX(0, 1)
    symbols, numbers = constants_in(ca.vertcat(relations.residual, relations.output, held))
    meant = neighbors(numbers)
    if not meant:
        return ()
    places = ca.vertcat(*(meant.get(n, Signed(1, n)).symbol for n in numbers))
    residual, output, held = ca.substitute(
        [relations.residual, relations.output, held], [symbols], [places]
    )
    if lifted:
        lifted = lifted._replace(trim=replace(lifted.trim, residual=held))
    relations = replace(relations, residual=residual, output=output, lifted=lifted)
    form = replace(smallest.form, relations=relations)
    try:
        order = candidates(problem, [form])[0].lft.order
    except MbdlftError:  # with these numbers it cannot be solved: they are not meant
        return ()
    if order >= least:
        return ()
    listed = "; ".join(
        f"{Signed(1, number)} is {abs(double(number) - other.value):.1g} from {other}"
        for number, other in meant.items()
        if double(number) != other.value
    )
    return (f"{listed}: written exactly, the order is {order}, not {least}",)


def neighbors(numbers: Sequence[Constant]) -> dict[Constant, Signed]:
    """For numbers that are beside others, which they may be meant to be, these others."""
    meant: dict[Constant, Signed] = {}
    before: list[Signed] = []  # that mean themselves
    has_pi = any(number.kind == "pi" for number in numbers)
    for number in numbers:
        for other in (*_special(number), *(before if number.kind != "rational" else ())):
            if other.number.kind == "pi" and not has_pi:
                continue  # there is nothing that it could be related to
            if _is_near(number, other) and not is_zero(constant(number) - other.symbol):
                meant[number] = other
                break
        else:
            before += [Signed(sign, number) for sign in (1, -1)]
    return meant


def _special(number: Constant) -> Iterator[Signed]:
    """Numbers next to a number that people mean, the simplest first."""
    if number.in_radians and abs(number.argument) > LARGEST_ANGLE:
        return
    if number.in_radians:
        degrees = round(float(number.argument) * 180.0 / pi / _STEP) * _STEP
        yield Signed(1, Constant(number.kind, Fraction(degrees)))
    elif number.kind in ("rational", "unit"):
        value, sign = Fraction(abs(double(number))), 1 if double(number) > 0.0 else -1
        for kind, argument in (
            ("rational", value),
            ("root", value * value),
            ("pi", value / Fraction(pi)),
        ):
            simple = argument.limit_denominator(_SIMPLE)
            if simple.numerator <= _LARGEST and (simple or number.kind == "unit"):
                yield Signed(sign, Constant(kind, simple))


def _is_near(number: Constant, other: Signed) -> bool:
    """Whether a number is another one but for rounding, in doubles or to the digits that it has."""
    distance = abs(double(number) - other.value)
    if number.kind == "rational":
        rounding = _half_of_last_digit(number.argument, _DIGITS)
        return distance <= max(rounding, _PART * abs(double(number)))
    if number.in_radians and not other.number.in_radians:
        angle = float(other.number.argument) * pi / 180.0
        rounding = _half_of_last_digit(number.argument, _DIGITS_OF_ANGLE)
        return abs(float(number.argument) - angle) <= rounding
    return distance <= (_PART_OF_AXIS if number.kind == "unit" else _PART * abs(double(number)))


def _half_of_last_digit(number: Fraction, digits: int) -> float:
    """Half a unit of the last decimal of a number that has at least so many digits; 0.0 otherwise."""
    for decimals in range(_MOST_DIGITS):
        shifted = number * 10**decimals
        if shifted.denominator == 1:
            return 0.5 * 10.0**-decimals if len(str(abs(int(shifted)))) >= digits else 0.0
    return 0.0
