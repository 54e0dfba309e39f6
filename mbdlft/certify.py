"""The certificate: how small the model is, how small it could be, and how far it is from the truth.

The truth is the nonlinear equations, trimmed and linearized again with numbers at every check point.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from mbdlft.analyze.sample import corners, random
from mbdlft.equations import Equations, equation_function, load_value, physical_symbols
from mbdlft.errors import WellPosednessError
from mbdlft.lft.lft import LFT, Array, evaluate_at
from mbdlft.parameter import Parameter, to_delta
from mbdlft.trim import evaluate_many, trim_efforts

_RANDOM_POINTS, _MOST_CORNERS = 100, 128
_NEGLIGIBLE = 1e-8  # an entry below this part of its row's size is compared with the row
_LINES = 32  # points to which the line from nominal is searched for singularities
_REAL = 1e-6  # an eigenvalue with a smaller relative imaginary part may be a double real one


def check_points(parameters: Sequence[Parameter], seed: int) -> Array:
    """Physical points (N, n_p): nominal, random, and all corners, or 128 random corners."""
    if not parameters:
        return np.zeros((1, 0))
    inside = random(parameters, _RANDOM_POINTS, seed)
    if 2 ** len(parameters) <= _MOST_CORNERS:
        outer = corners(parameters)
    else:
        sides = np.random.default_rng(seed).integers(0, 2, (_MOST_CORNERS, len(parameters)))
        outer = {p.name: np.where(sides[:, k], p.high, p.low) for k, p in enumerate(parameters)}
    columns = [np.concatenate([[p.nominal], inside[p.name], outer[p.name]]) for p in parameters]
    return np.stack(columns, axis=1)


def reference_matrices(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> tuple[Array, Array, Array]:
    """The nonlinear equations, trimmed and linearized at points (N, n_p).

    Returns
    -------
    [A B ; C D] (N, ., .)
    trimmed efforts (N, n_u)
    sizes of the efforts (N, n_u): what the components of the load contribute, without cancellation

    Raises
    ------
    WellPosednessError
        The accelerations cannot be solved for at one of the points.
    """
    e = equations
    efforts, _ = trim_efforts(e, points)
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    unknown, x, u = ca.vertcat(e.xdot, e.z), e.x, e.u
    values = equation_function(e)(e.xdot, x, e.z, u, load_value(e, p), p, cosine, sine)
    stacked = ca.vertcat(values[0], values[1][list(outputs)])
    slopes = ca.jacobian(stacked, ca.vertcat(unknown, x, u))
    load = ca.SX.sym("load", e.load.numel())
    loaded, _ = equation_function(e)(e.xdot, x, e.z, u, load, p, cosine, sine)
    share = ca.mtimes(ca.fabs(ca.jacobian(loaded, load)), ca.fabs(load_value(e, p)))
    zero = ca.SX(unknown.numel() + x.numel(), 1)
    at_trim = ca.Function(
        "slopes", [ca.vertcat(unknown, x), u, symbols], [ca.densify(slopes), ca.densify(share)]
    )
    effort = ca.SX.sym("effort", u.numel())
    function = ca.Function("reference", [symbols, effort], at_trim.call([zero, effort, symbols]))
    jacobian, shares = evaluate_many(function, points, efforts)
    n, nx = e.residual.numel(), x.numel()
    known = [*range(n, n + nx), *(n + nx + k for k in inputs)]
    try:
        solved = -np.linalg.solve(jacobian[:, :n, :n], jacobian[:, :n, known])
    except np.linalg.LinAlgError:
        raise WellPosednessError(
            f"scene {e.name!r}: the mass matrix is singular at a point of the parameter range. Keep "
            "masses and inertias away from zero."
        ) from None
    read = jacobian[:, n:, known] + jacobian[:, n:, :n] @ solved
    by_effort = np.abs(np.linalg.pinv(jacobian[:, :n, n + nx :]))
    return np.concatenate([solved[:, :nx], read], axis=1), efforts, (by_effort @ shares)[:, :, 0]


def relative_error(values: Array, reference: Array) -> float:
    """Largest error of an entry, relative to the largest size of that entry over the points (N, ., .)."""
    size = np.max(np.abs(reference), axis=0)
    row = np.max(size, axis=-1, keepdims=True)
    scale = np.where(size > _NEGLIGIBLE * row, size, row)
    scale = np.where(scale > 0, scale, 1.0)
    return float(np.max(np.abs(values - reference) / scale, initial=0.0))


def check_well_posed(lft: LFT, parameters: Sequence[Parameter], points: Array, name: str) -> Array:
    """Deltas (N, n_p) of the points, once det(I - D_zw Delta) was seen to stay away from zero.

    The determinant is 1 at nominal, so a point where it is not positive means that it vanishes
    between them. To some of the points the whole line from nominal is searched.

    Raises
    ------
    WellPosednessError
        The determinant vanishes at one of the points or on the way there.
    """
    deltas = np.stack(
        [to_delta(p, points[:, k]) for k, p in enumerate(parameters)] or [np.zeros(0)], axis=1
    ).reshape(len(points), len(parameters))
    spread = np.repeat(deltas, [block.size for block in lft.blocks], axis=1)
    signs, _ = np.linalg.slogdet(np.eye(lft.order) - lft.M11[None] * spread[:, None, :])
    singular = signs <= 0
    # an eigenvalue of D_zw Delta that is real and >= 1: det vanishes on the line from nominal, even
    # where it does not change its sign
    lines = np.unique(np.linspace(0, len(points) - 1, _LINES).astype(int))
    eigenvalues = np.linalg.eigvals(lft.M11[None] * spread[lines, None, :])
    real = np.abs(eigenvalues.imag) <= _REAL * np.abs(eigenvalues)
    singular[lines] |= np.any(real & (eigenvalues.real >= 1.0), axis=1)
    if np.any(singular):
        worst = points[int(np.argmax(singular))]
        where = ", ".join(
            f"{p.name} = {value:g} {p.unit}" for p, value in zip(parameters, worst, strict=True)
        )
        raise WellPosednessError(
            f"scene {name!r}: the model is singular between the nominal values and {where}. Narrow "
            "the ranges, or keep masses and inertias away from zero."
        )
    return deltas


def measure_error(
    equations: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    model: LFT,
    trim: LFT,
    seed: int,
) -> tuple[float, int]:
    """Largest relative error of the model and its trim, and the number of points it was taken over.

    Raises
    ------
    WellPosednessError
        The model is singular somewhere in the range.
    """
    points = check_points(equations.parameters, seed)
    deltas = check_well_posed(model, equations.parameters, points, equations.name)
    reference, efforts, sizes = reference_matrices(equations, inputs, outputs, points)
    error = relative_error(evaluate_at(model, deltas), reference)
    trim_difference = np.max(
        np.abs(evaluate_at(trim, deltas)[:, :, 0] - efforts), axis=0, initial=0.0
    )
    trim_size = np.max(sizes, axis=0, initial=0.0)
    trim_error = float(
        np.max(trim_difference / np.where(trim_size > 0, trim_size, 1.0), initial=0.0)
    )
    return max(error, trim_error), len(points)
