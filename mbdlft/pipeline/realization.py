"""From a matrix that is rational in parameters to a certified LFT model."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, SceneError, StructureError, WellPosednessError
from mbdlft.base.parameter import Parameter
from mbdlft.base.threads import one_thread
from mbdlft.bound.degree import Bound, degree_bounds, moved, preference
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, transpose, with_blocks
from mbdlft.matrix import MatrixProblem, matrix_problem, matrix_to_toml
from mbdlft.matrix.denominator import check_denominators
from mbdlft.matrix.exact_bound import exact_lower_bound
from mbdlft.matrix.fifty_digits import MatrixReference, reference_at
from mbdlft.matrix.local import MatrixForm
from mbdlft.matrix.polynomial import expanded_matrix
from mbdlft.matrix.resolve import Resolved, resolve
from mbdlft.matrix.symbolic import written_matrix
from mbdlft.number.rounding import NOISE, conditioning
from mbdlft.pipeline.build import SEED, Build, Clock, provenance
from mbdlft.pipeline.certify import (
    ACCEPTED,
    NEGLIGIBLE,
    Check,
    certificate,
    check_points,
    deltas_at,
    relative_error,
    values_at_points,
)
from mbdlft.pipeline.extract import Extraction, extract
from mbdlft.pipeline.search import SEARCH, Budget, budget_of, find_smallest
from mbdlft.problem.linearize import LinearModel
from mbdlft.reduce.lines import or_one
from mbdlft.reduce.reduce import in_scales, reduce_order
from mbdlft.system.model import LFTModel, Trim

_LOSSY = 1e-13  # error above which a matrix is written in distances from nominal
_ENOUGH, _MOST_LOST = (
    1e-11,
    1e3,
)  # error of a way to write a matrix, or times the least: kept up to there
_SCALINGS = 10  # of rows and columns; each halves the digits in which they differ
_FEW_POINTS = 8  # of those of the check, for this error


def realize(
    matrix: Any,
    parameters: Sequence[Parameter] = (),
    *,
    search: float = SEARCH,
    exact: bool = False,
    seconds: float | None = None,
    **fields: Any,
) -> LFTModel:
    """The exact LFT of a matrix that is rational in parameters, with certificate.

    Parameters
    ----------
    matrix : rows of numbers or expressions, CasADi SX, or `MatrixProblem`
        An SX matrix has symbols named like the parameters.
    parameters : sequence of `Parameter` and `Angle`
        A name is the value in the unit of its parameter; nothing is converted. An angle stands in sin
        and cos only.
    search : float
        Units of work, each about a second of one core, to look for a smaller model by using that
        parameters commute, and for a better lower bound by pairs and triples of parameters; 0: neither.
    exact : bool
        Whether the lower bound is computed in exact arithmetic; needs python-flint.
    seconds : float, optional
        Upper limit of the time of the search (s). Without one the result depends on the matrix alone.
    fields
        Other fields of `MatrixProblem`: name, description, constants, expressions, states, inputs,
        outputs; for an SX matrix also `symbols`, a mapping of names of parameters to its symbols.

    Returns
    -------
    LFTModel
        Value of its LFT = matrix. Without states it is static; with n states the leading n x n part is
        A, and the matrix is [A B ; C D].

    Raises
    ------
    SceneError
        The matrix is empty or ragged, or a name or an expression is not usable.
    NotRationalError
        An entry is not rational in the parameters; the message names it.
    WellPosednessError
        A denominator vanishes in the range.
    """
    if isinstance(matrix, MatrixProblem):
        if parameters or fields:
            raise SceneError(
                f"matrix {matrix.name!r}: a MatrixProblem has its own parameters and fields; give "
                "search and exact only."
            )
        problem = matrix
    else:
        problem = matrix_problem(matrix, parameters, **fields)
    return build_matrix(problem, search, exact=exact, seconds=seconds).model


def build_matrix(
    problem: MatrixProblem,
    search: float = SEARCH,
    *,
    exact: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
    seconds: float | None = None,
) -> Build:
    """As `realize`, with the seconds of each stage; `progress` is told the name of each as it starts."""
    budget = budget_of(search, seconds)
    with one_thread():
        return _build(problem, budget, exact, Clock(progress))


def _build(problem: MatrixProblem, budget: Budget, exact: bool, clock: Clock) -> Build:  # noqa: FBT001
    parameters = tuple(sorted(problem.parameters, key=lambda p: p.name))
    names = [parameter.name for parameter in parameters]
    with clock.stage("resolve"):
        resolved = resolve(problem)
        check_denominators(problem, resolved)
        target = _target(problem, resolved, parameters)
    with clock.stage("reduce"):
        ways = _ways(problem, resolved, target)
        way, reduced = ways[0], ways[0].reduced
    with clock.stage("bound"):
        degrees = (
            {name: Bound(degree, 0) for name, degree in exact_lower_bound(problem, SEED).items()}
            if exact
            else _degree_bounds(ways)
        )
        bound = {name: found.degree for name, found in degrees.items()}
        _check_bound(problem, bound, reduced)
    order_bound = sum(bound.values())
    if budget.work > 0.0 and reduced.order > order_bound:
        with clock.stage("search"):
            ways_reduced = [way.reduced for way in ways]
            reduced, order_bound, _ = find_smallest(ways_reduced, bound, budget)
    lft = with_blocks(_in_units(reduced, target.sizes), names)
    with clock.stage("check"):
        check = _measure_error(problem, lft, parameters, target)
    states, inputs, outputs = problem.signals()
    model = LFTModel(
        name=problem.name,
        lft=lft,
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        trim=Trim((), (), None),
        certificate=certificate(
            lft, way.extracted.channels, degrees, order_bound, check, SEED, exact_bound=exact
        ),
        provenance=provenance(matrix_to_toml(problem)),
        description=problem.description,
    )
    return Build(model, clock.seconds | {"total": sum(clock.seconds.values())})


class _Sizes(NamedTuple):
    """Powers of two by which rows and columns are divided."""

    rows: Array
    columns: Array


def _sizes(values: Array) -> _Sizes:
    """What parameters change in each row and column at most: values (N, rows, columns); Ruiz 2001."""
    change = np.max(np.abs(values - values[0]), axis=0)
    rows, columns = np.ones(len(change)), np.ones(change.shape[1])
    for _ in range(_SCALINGS):
        left = change / rows[:, None] / columns
        rows *= np.sqrt(or_one(np.max(left, axis=1)))
        columns *= np.sqrt(or_one(np.max(left, axis=0)))
    return _Sizes(*(np.ldexp(1.0, np.rint(np.log2(size)).astype(int)) for size in (rows, columns)))


class _Target(NamedTuple):
    """Values of the matrix at the points of the check, and what errors of entries are relative to.

    Smaller values than `least` are negligible beside what parameters change in the row and the column.
    `factors` divide rows and columns by `sizes`; they are zero where an entry is nothing but rounding of
    the numbers in its text.
    """

    points: Array
    deltas: Array
    reference: MatrixReference
    scale: Array
    least: Array
    sizes: _Sizes
    factors: Array


def _target(problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter]) -> _Target:
    points = check_points(parameters, SEED)
    reference = reference_at(problem, resolved, parameters, points)
    largest, terms = (np.max(np.abs(found), axis=0) for found in reference)
    clear = largest > NOISE * terms
    sizes = _sizes(np.where(clear, reference.values, 0.0))
    units = np.outer(sizes.rows, sizes.columns)
    least = NEGLIGIBLE * units
    scale = or_one(np.where(clear, np.maximum(largest, least), terms))
    deltas, factors = deltas_at(parameters, points), np.where(clear, 1.0 / units, 0.0)
    return _Target(points, deltas, reference, scale, least, sizes, factors)


class _Way(NamedTuple):
    """One way to write a matrix: its LFT as extracted, reduced, and the error of that."""

    extracted: Extraction
    reduced: LFT
    error: float


def _ways(problem: MatrixProblem, resolved: Resolved, target: _Target) -> list[_Way]:
    """The divided matrix as it is written and expanded, from its rows and from its columns, where
    products meet in opposite orders.

    The smallest comes first; one that loses digits that others have is left out.
    """
    found: list[_Way] = []
    for write in (written_matrix, expanded_matrix):
        tried: list[list[_Way]] = []
        for from_nominal in (False, True):
            form = write(problem, resolved, target.factors, from_nominal=from_nominal)
            if form is None:
                break
            tried.append(_both_ways(problem, form, target))
            if all(way.error <= _LOSSY for way in tried[-1]):
                break
        found += [min(ways, key=lambda way: way.error) for ways in zip(*tried, strict=True)]
    most = max(_ENOUGH, _MOST_LOST * min(way.error for way in found))
    kept = [way for way in found if way.error <= most]
    return sorted(kept, key=lambda way: (way.reduced.order, way.error))


def _both_ways(problem: MatrixProblem, form: MatrixForm, target: _Target) -> list[_Way]:
    found = []
    for matrix, turned in ((form.matrix, False), (form.matrix.T, True)):
        known = ca.SX.sym("input", matrix.shape[1])
        nothing = ca.SX(0, 1)
        relations = LinearModel(nothing, matrix @ known, nothing, known, form.q, problem.parameters)
        try:
            extracted = extract(relations, form.maps)
        except (StructureError, WellPosednessError) as error:
            raise type(error)(f"matrix {problem.name!r}: {error}") from None
        lft = in_scales(transpose(extracted.lft) if turned else extracted.lft)
        reduced = reduce_order(lft)
        found.append(_Way(extracted._replace(lft=lft), reduced, _error_at(target, reduced)))
    return found


def _in_units(a: LFT, sizes: _Sizes) -> LFT:
    """An LFT of the divided matrix as one of the matrix."""
    rows = sizes.rows[:, None]
    M12, M22 = a.M12 * sizes.columns, rows * a.M22 * sizes.columns
    return LFT(a.M11, M12, rows * a.M21, M22, a.blocks)


def _error_at(target: _Target, lft: LFT) -> float:
    """Largest relative error of an LFT at a few of the points."""
    step = 1 + len(target.points) // _FEW_POINTS
    try:
        found = evaluate_at(_in_units(lft, target.sizes), target.deltas[::step])
    except WellPosednessError:
        return float("inf")
    error = relative_error(found, target.reference.values[::step], target.scale)
    return error if np.isfinite(error) else float("inf")


def _degree_bounds(ways: Sequence[_Way]) -> dict[str, Bound]:
    """The most that one of the ways proves, with each way as its twin: errors of reductions differ.

    More than the size of a delta in one of the ways rests on a wrong rank.
    """
    sizes = {
        name: min(dict(way.reduced.blocks)[name] for way in ways)
        for name, _ in ways[0].reduced.blocks
    }
    twins = [reduce_order(moved(way.extracted.lft, SEED, way.error)) for way in ways]
    bounds = {name: Bound(0, size) for name, size in sizes.items()}
    for way in ways:
        found = [degree_bounds(way.reduced, twin, SEED) for twin in twins]
        for name, known in bounds.items():
            least = min((one[name] for one in found), key=lambda bound: bound.degree)
            clear = least._replace(degree=min(least.degree, sizes[name]))
            bounds[name] = max(known, clear, key=preference)
        if not any(bound.doubtful for bound in bounds.values()):
            break
    return bounds


def _check_bound(problem: MatrixProblem, bound: Mapping[str, int], lft: LFT) -> None:
    """A model with fewer repetitions than are proved to be needed is not exact."""
    for name, size in lft.blocks:
        if size < bound[name]:
            raise AnalysisError(
                f"matrix {problem.name!r}: the numbers as written need {bound[name]} repetitions of "
                f"{name}, and reduction in double precision kept {size}: two terms differ by no more "
                "than rounding. Make equal what is meant to be equal."
            )


def _measure_error(
    problem: MatrixProblem, lft: LFT, parameters: Sequence[Parameter], target: _Target
) -> Check:
    """Largest relative error against the matrix itself, and its conditioning."""
    owner = f"matrix {problem.name!r}"
    values = values_at_points(lft, parameters, target.points, owner)
    error = relative_error(values, target.reference.values, target.scale)
    if not error <= ACCEPTED:
        raise AnalysisError(
            f"{owner}: the model differs from the matrix by {error:.1e} of the size of an entry. Either "
            "its numbers are so different in size that double precision does not carry them, or this is "
            "a bug: please report the matrix."
        )
    return Check(
        error, len(target.points), *conditioning(*target.reference, target.scale, target.least)
    )
