"""From a matrix that is rational in parameters to a certified LFT model."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.build import SEARCH, SEED, Build, Clock, check_search, provenance
from mbdlft.certify import (
    ACCEPTED,
    Check,
    certificate,
    check_points,
    conditioning_of,
    entry_scale,
    relative_error,
    values_at_points,
)
from mbdlft.errors import AnalysisError, SceneError, WellPosednessError
from mbdlft.exact import exact_lower_bound
from mbdlft.extract import Extraction, extract
from mbdlft.lft.bound import Bound, degree_bounds, moved
from mbdlft.lft.commute import reduce_commuting
from mbdlft.lft.joint import joint_bound
from mbdlft.lft.lft import LFT, Array, transpose, with_blocks
from mbdlft.lft.model import LFTModel, Trim
from mbdlft.lft.reduce import reduce_order
from mbdlft.lft.threads import one_thread
from mbdlft.linearize import LinearModel
from mbdlft.matrix import MatrixProblem, matrix_problem, matrix_to_toml
from mbdlft.matrix.denominator import check_denominators
from mbdlft.matrix.polynomial import expanded_matrix
from mbdlft.matrix.resolve import Resolved, cosine_name, matrix_values, resolve, sine_name
from mbdlft.matrix.symbolic import internal_matrix
from mbdlft.parameter import Parameter, to_internal
from mbdlft.trim import term_sizes
from mbdlft.unit import parse_unit


def realize(
    matrix: Any,
    parameters: Sequence[Parameter] = (),
    *,
    search: float = SEARCH,
    exact: bool = False,
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
        Seconds to look for a smaller model by using that parameters commute, and for a better lower
        bound by pairs and triples of parameters; 0: neither.
    exact : bool
        Whether the lower bound is computed in exact arithmetic; needs python-flint.
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
    return build_matrix(problem, search, exact=exact).model


def build_matrix(
    problem: MatrixProblem,
    search: float = SEARCH,
    *,
    exact: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> Build:
    """As `realize`, with the seconds of each stage; `progress` is told the name of each as it starts."""
    check_search(search)
    with one_thread():
        return _build(problem, search, exact, Clock(progress))


def _build(problem: MatrixProblem, search: float, exact: bool, clock: Clock) -> Build:  # noqa: FBT001
    parameters = tuple(sorted(problem.parameters, key=lambda p: p.name))
    names = [parameter.name for parameter in parameters]
    with clock.stage("resolve"):
        resolved = resolve(problem)
        check_denominators(problem, resolved)
    with clock.stage("extract"):
        ways = _extract(problem, resolved)
    with clock.stage("reduce"):
        forms = [reduce_order(way.lft) for way in ways]
        channels, reduced = min(
            ((way.channels, form) for way, form in zip(ways, forms, strict=True)),
            key=lambda pair: pair[1].order,
        )
    with clock.stage("bound"):
        degrees = (
            {name: Bound(degree, 0) for name, degree in exact_lower_bound(problem, SEED).items()}
            if exact
            else degree_bounds(reduced, moved(reduced, SEED), SEED)
        )
        bound = {name: found.degree for name, found in degrees.items()}
        _check_bound(problem, bound, reduced)
    order_bound = sum(bound.values())
    if search > 0.0 and reduced.order > order_bound:
        with clock.stage("search"):
            reduced, order_bound = reduce_commuting(
                forms, bound, search, lambda found, stop: joint_bound(found, bound, stop)
            )
    lft = with_blocks(reduced, names)
    with clock.stage("check"):
        check = _measure_error(problem, resolved, lft, parameters)
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
            lft, channels, degrees, order_bound, check, SEED, exact_bound=exact
        ),
        provenance=provenance(matrix_to_toml(problem)),
        description=problem.description,
    )
    return Build(model, clock.seconds | {"total": sum(clock.seconds.values())})


def _extract(problem: MatrixProblem, resolved: Resolved) -> list[Extraction]:
    """LFTs of the matrix, as it is written and expanded; from its rows and from its columns, where
    products meet in opposite orders."""
    p, matrix = internal_matrix(problem, resolved)
    expanded = expanded_matrix(problem, resolved, p)
    found = []
    for form in (matrix, expanded) if expanded is not None else (matrix,):
        found += _both_ways(problem, form, p)
    return found


def _both_ways(problem: MatrixProblem, matrix: ca.SX, p: ca.SX) -> list[Extraction]:
    found = []
    for M in (matrix, matrix.T):
        known = ca.SX.sym("input", M.shape[1])
        nothing = ca.SX(0, 1)
        relations = LinearModel(nothing, M @ known, nothing, known, p, problem.parameters)
        try:
            found.append(extract(relations))
        except WellPosednessError as error:
            raise WellPosednessError(f"matrix {problem.name!r}: {error}") from None
    return [found[0], found[1]._replace(lft=transpose(found[1].lft))]


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
    problem: MatrixProblem, resolved: Resolved, lft: LFT, parameters: Sequence[Parameter]
) -> Check:
    """Largest relative error against the matrix itself, and its conditioning."""
    owner = f"matrix {problem.name!r}"
    points = check_points(parameters, SEED)
    values = values_at_points(lft, parameters, points, owner)
    reference = matrix_at(problem, resolved, parameters, points)
    p, matrix = internal_matrix(problem, resolved)
    tape = ca.Function("matrix", [p], [ca.densify(ca.vec(matrix.T))])
    columns = {q.name: to_internal(q, points[:, k]) for k, q in enumerate(parameters)}
    internal = np.stack([columns[q.name] for q in problem.parameters] or [np.zeros(0)], axis=1)
    terms = term_sizes(tape, internal.reshape(len(points), -1)).reshape(-1, *problem.shape)
    scales = len(problem.states), 0.0, np.max(terms, axis=0)
    error = relative_error(values, reference, entry_scale(reference, *scales))
    if not error <= ACCEPTED:
        raise AnalysisError(
            f"{owner}: the model differs from the matrix by {error:.1e} of the size of an entry. Either "
            "its numbers are so different in size that double precision does not carry them, or this is "
            "a bug: please report the matrix."
        )
    return Check(error, len(points), *conditioning_of(reference, terms, *scales))


def matrix_at(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array
) -> Array:
    """Values (N, rows, columns) of the matrix at physical points (N, n_p), without any LFT.

    Raises
    ------
    WellPosednessError
        A value is not finite.
    """
    values: dict[str, Any] = dict(problem.constant_values())
    for k, p in enumerate(parameters):
        if p.is_angle:
            angle = points[:, k] * parse_unit(p.unit).factor
            values[cosine_name(p.name)], values[sine_name(p.name)] = np.cos(angle), np.sin(angle)
        else:
            values[p.name] = points[:, k]
    with np.errstate(all="ignore"):  # what is not finite has its own message
        rows = matrix_values(problem, resolved, values)
    entries = [[np.broadcast_to(entry, (len(points),)) for entry in row] for row in rows]
    found = np.moveaxis(np.array(entries, dtype=float), 2, 0)
    if not np.all(np.isfinite(found)):
        k, i, j = np.argwhere(~np.isfinite(found))[0]
        raise WellPosednessError(
            f"matrix {problem.name!r}, entry ({i}, {j}): is not finite at "
            f"{', '.join(f'{p.name} = {x:g}' for p, x in zip(parameters, points[k], strict=True))}."
        )
    return found
