"""What a page knows of the dynamics: the loads of the equilibrium as a tape, and modes at samples."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError, WellPosednessError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import corners, random
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.problem.equations import Equations, physical_symbols
from mbdlft.problem.linearization import linearized
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.problem.trim import relations_at_rest, trim_efforts, trim_rows
from mbdlft.response.modes import balancing, spectrum
from mbdlft.show.viewer.tape import tape_of

_MOST_CORNERS = 6  # parameters of which all corners are samples
_RANDOM = 24
_MOST_NUMBERS = 120_000  # of all modes together
_MOST_MODES = 40
_OWN = 1e-3  # of a shape at zero: what others do not have
_DIGITS = 5


def chosen_point(parameters: Sequence[Parameter], values: Mapping[str, float]) -> Array:
    """Physical values (n_p,): those by name, in their units, and nominal ones.

    Raises
    ------
    TrimError
        A name is unknown, or a value is outside its range.
    """
    known = {parameter.name: parameter for parameter in parameters}
    for name, value in values.items():
        if name not in known:
            raise TrimError("view: " + unknown_name("parameter", name, known))
        if not known[name].low <= value <= known[name].high:
            raise TrimError(
                f"view: {name} = {value:g} is outside its range [{known[name].low:g}, "
                f"{known[name].high:g}] {known[name].unit}."
            )
    return np.array([float(values.get(p.name, p.nominal)) for p in parameters])


def trim_data(equations: Equations) -> dict[str, Any]:
    """The loads at equilibrium: 0 = offset + slopes unknown, and what is given, as a tape of p.

    The result of the tape is [offset ; slopes by columns ; given]; `rows` of the first two determine
    the `unknown` entries of u.
    """
    e = equations
    symbols = physical_symbols(e.parameters)
    offset, slopes, given = relations_at_rest(e, symbols)
    rows = list(trim_rows(e))
    chosen = ca.vertcat(offset[rows], ca.vec(slopes[rows, :]), given)
    function = ca.Function("trim", [symbols[0]], [ca.densify(in_doubles(ca.densify(chosen)))])
    return {
        "tape": tape_of(function).as_data(),
        "unknown": list(e.unknown),
        "efforts": [{"name": s.name, "unit": s.unit} for s in e.u_signals],
    }


def mode_data(scene: Scene, equations: Equations, chosen: Array) -> list[dict[str, Any]]:
    """Modes at samples of the parameters: the chosen values, nominal, ends and corners of the ranges.

    Returns
    -------
    list of {"point", "modes"}
        `point` are the physical values; each mode has the eigenvalue `real`, `imag` (rad/s) and the
        displacements `shape`: real and imaginary parts by coordinate.

    Raises
    ------
    TrimError, WellPosednessError
        There is no equilibrium, or no linear model, at one of the samples.
    """
    e = equations
    n = e.degrees_of_freedom
    states = list(e.states)
    moving = [k for k, state in enumerate(states) if state < n]
    points = _samples(e.parameters, chosen)
    most = max(1, _MOST_NUMBERS // max(1, 2 * len(moving) * min(len(moving), _MOST_MODES)))
    points = points[:most]
    efforts, _ = trim_efforts(e, points)
    inputs, outputs = choose_signals(scene, e)
    matrices = linearized(e, inputs, outputs, points, efforts)
    A = matrices[:, : len(states), : len(states)]
    return [
        {"point": point.tolist(), "modes": _modes(scene.name, matrix, moving)}
        for point, matrix in zip(points, A, strict=True)
    ]


def _samples(parameters: tuple[Parameter, ...], chosen: Array) -> Array:
    """Points (N, n_p), the chosen one first, then nominal, the ends of each range, corners, others."""
    nominal = np.array([p.nominal for p in parameters])
    points = [chosen, nominal]
    for k, p in enumerate(parameters):
        for end in (p.low, p.high):
            points.append(nominal.copy())
            points[-1][k] = end
    if parameters:
        if len(parameters) <= _MOST_CORNERS:
            found = corners(parameters)
            points += list(np.stack([found[p.name] for p in parameters], axis=1))
        inside = random(parameters, _RANDOM, 0)
        points += list(np.stack([inside[p.name] for p in parameters], axis=1))
    unique = {tuple(point): point for point in points}
    return np.array(list(unique.values())).reshape(len(unique), len(parameters))


def _modes(name: str, A: Array, moving: Sequence[int]) -> list[dict[str, Any]]:
    """Modes of one matrix (nx, nx), slowest first; one of each pair, with displacements only.

    What rounding has left of real parts on the axis, and of zero, is zero. Of the poles at zero there are
    as many as have shapes of their own: a body that moves freely has a double pole for each.
    """
    import scipy.linalg  # here because it is slow to import

    with np.errstate(all="ignore"):
        scale = balancing(A)
        scaled = A * (scale / scale[:, None])
    if not np.isfinite(scaled).all():
        raise WellPosednessError(
            f"scene {name!r}: an entry of the linear model is not finite at a sample, so there are no "
            "modes. Masses, lengths or stiffnesses are of very different size."
        )
    seen = spectrum(scaled)
    values, vectors = scipy.linalg.eig(scaled, check_finite=False)
    shapes = (scale[:, None] * vectors)[list(moving)]
    left = list(range(len(values)))
    nearest = []
    for pole in seen.poles:
        nearest.append(min(left, key=lambda k: abs(values[k] - pole)))
        left.remove(nearest[-1])
    found = _still([shapes[:, k] for k, zero in zip(nearest, seen.at_zero, strict=True) if zero])
    for pole, k, zero in zip(seen.cleaned, nearest, seen.at_zero, strict=True):
        shape = shapes[:, k]
        if zero or pole.imag < 0.0 or not np.any(shape):
            continue
        found.append(_mode(complex(pole), shape))
    return found[:_MOST_MODES]


def _still(shapes: Sequence[Array]) -> list[dict[str, Any]]:
    """Modes at zero, each shape once."""
    kept: list[Array] = []
    basis = np.zeros((len(shapes[0]) if shapes else 0, 0))
    for shape in (np.real(shape) for shape in shapes):
        size = float(np.linalg.norm(shape))
        rest = shape - basis @ (basis.T @ shape)
        if size > 0.0 and np.linalg.norm(rest) > _OWN * size:
            kept.append(shape)
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return [_mode(0j, shape) for shape in kept]


def _mode(pole: complex, shape: Array) -> dict[str, Any]:
    """One mode, its largest displacement real and one."""
    shape = shape / shape[int(np.argmax(np.abs(shape)))]
    parts = [_short(np.real(shape)), _short(np.imag(shape))]
    return {"real": pole.real, "imag": pole.imag, "shape": parts}


def _short(numbers: Array) -> list[float]:
    return [float(f"{number:.{_DIGITS}g}") for number in numbers]
