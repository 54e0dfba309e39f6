"""Trim: the efforts that hold the equilibrium, 0 = residual(0, 0, 0, u, p), linear in u."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from mbdlft.equations import Equations, equation_function, load_value, physical_symbols
from mbdlft.errors import TrimError, unknown_name
from mbdlft.lft.lft import Array
from mbdlft.signal import Signal

_RESIDUAL = 1e-9


@dataclass(frozen=True, slots=True)
class TrimPoint:
    """Efforts that hold the equilibrium at one value of the parameters.

    Attributes
    ----------
    parameters : physical value by name, in its unit
    signals : names and units of the efforts
    values : one number for each effort
    residual : float
        Largest residual of the equations relative to the largest effort.
    """

    parameters: Mapping[str, float]
    signals: tuple[Signal, ...]
    values: tuple[float, ...]
    residual: float


def solve_trim(equations: Equations, values: Mapping[str, float] | None = None) -> TrimPoint:
    """Trim at physical values by name, in their units; the others are nominal.

    Raises
    ------
    TrimError
        A name is unknown, a value is outside its range, or no efforts hold the equilibrium.
    """
    given = dict(values or {})
    known = {parameter.name: parameter for parameter in equations.parameters}
    for name, value in given.items():
        if name not in known:
            raise TrimError("trim: " + unknown_name("parameter", name, known))
        parameter = known[name]
        if not parameter.low <= value <= parameter.high:
            raise TrimError(
                f"trim: {name} = {value:g} is outside its range [{parameter.low:g}, "
                f"{parameter.high:g}] {parameter.unit}."
            )
    point = {name: float(given.get(name, known[name].nominal)) for name in known}
    efforts, residual = trim_efforts(equations, np.array([list(point.values())]))
    return TrimPoint(
        point, equations.u_signals, tuple(float(u) for u in efforts[0]), float(residual[0])
    )


def trim_efforts(equations: Equations, points: Array) -> tuple[Array, Array]:
    """Efforts (N, n_u) and relative residuals (N,) at physical points (N, n_p).

    Raises
    ------
    TrimError
        At one of the points no efforts hold the equilibrium.
    """
    e = equations
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z)]
    u = ca.SX.sym("u", e.u.numel())
    residual, _ = equation_function(e)(*none, u, load_value(e, p), p, cosine, sine)
    relations = ca.Function(
        "trim",
        [symbols],
        [
            ca.densify(ca.substitute(residual, u, ca.SX.zeros(u.numel()))),
            ca.densify(ca.jacobian(residual, u)),
        ],
    )
    offset, matrix = evaluate_many(relations, points)
    rows = np.flatnonzero(matrix.any(axis=(0, 2)))
    names = ", ".join(signal.name for signal in e.u_signals)
    if len(rows) != u.numel():
        raise TrimError(
            f"scene {e.name!r}: the efforts {names} act in {len(rows)} equations of equilibrium; "
            f"there must be {u.numel()}."
        )
    try:
        efforts = -np.asarray(np.linalg.solve(matrix[:, rows], offset[:, rows]), dtype=float)
    except np.linalg.LinAlgError:
        raise TrimError(f"scene {e.name!r}: the efforts {names} are redundant.") from None
    residual_size = np.max(np.abs(matrix @ efforts + offset), axis=(1, 2))
    scale = np.max(np.abs(offset), axis=(1, 2))
    relative = residual_size / np.where(scale > 0, scale, 1.0)
    if not np.all(relative <= _RESIDUAL):
        raise TrimError(
            f"scene {e.name!r}: the efforts {names} cannot hold the equilibrium: relative residual "
            f"{np.max(relative):.1e}."
        )
    return efforts[:, :, 0], relative


def evaluate_many(function: ca.Function, points: Array, *others: Array) -> list[Array]:
    """Values of a function of column vectors at many points, each (N, rows, columns)."""
    count = len(points)
    arguments = [np.ascontiguousarray(part.T) for part in (points, *others)]
    if points.shape[1] == 0:  # an argument without rows cannot tell how many points there are
        each = [function.call([column[:, k] for column in arguments]) for k in range(count)]
        return [np.stack([values[k].full() for values in each]) for k in range(function.n_out())]
    found = []
    for k, value in enumerate(function.call(arguments)):
        rows, columns = function.size_out(k)
        found.append(value.full().reshape(rows, count, columns).transpose(1, 0, 2))
    return found
