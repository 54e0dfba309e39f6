"""How poles move with the parameters: exact gradients, and a search for the values that push one right.

With Delta = diag(delta_k I), K = (I - D_zw Delta)^-1 C_z, L = B_w (I - Delta D_zw)^-1:

    A(delta) = A + B_w Delta K,    dA / d delta_k = L_k K_k,

with the columns of L and the rows of K of block k; so an eigenvalue with left vector u and right vector v
moves by u' L_k K_k v / (u' v).
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.robust.characteristic import Realization
from mbdlft.robust.realization import realization
from mbdlft.system.system import System, deltas_of

Complex = NDArray[np.complex128]
_FIRST, _LARGEST, _SMALLEST = (
    0.25,
    2.0,
    1e-3,
)  # half sizes of the box of a step, in delta
_STEPS = 40  # of one search
_TINY = 1e-300


class Moving(NamedTuple):
    """Poles at one point, and how they move.

    Attributes
    ----------
    poles : complex array (nx,), rad/s
    gradients : complex array (nx, n_p), rad/s
        Derivatives by the normalized parameters delta, each of which goes from -1 to 1.
    """

    poles: Complex
    gradients: Complex


class Aim(NamedTuple):
    """What a search makes as large as it can: a function of a pole, and its slope by the deltas.

    Attributes
    ----------
    value : function of poles, to real numbers
    slope : function of a pole and its gradient (n_p,), to an array (n_p,)
    """

    value: Callable[[Any], Any]
    slope: Callable[[complex, Complex], Array]


def _undamping(pole: Any) -> Any:
    """Minus the damping ratio; 0 of a pole at 0."""
    return np.real(pole) / np.maximum(np.abs(pole), _TINY)


def _undamping_slope(pole: complex, gradient: Complex) -> Array:
    size = max(abs(pole), _TINY)
    turned = np.real(np.conj(pole) * gradient) / size
    return np.asarray((gradient.real - pole.real * turned / size) / size)


RIGHT = Aim(np.real, lambda _, gradient: gradient.real)
UNDAMPED = Aim(_undamping, _undamping_slope)


def by_damping(poles: NDArray[Any]) -> NDArray[np.int64]:
    """The order of poles, those of least damping first."""
    return np.argsort(-UNDAMPED.value(poles), kind="stable")


def pole_gradients(system: System, values: Mapping[str, float] | None = None) -> Moving:
    """Poles at one point, and their derivatives by the normalized parameters.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values; the others are nominal

    Returns
    -------
    Moving
        `gradients` is infinite, or very large, at a multiple pole: it has no derivative.

    Raises
    ------
    StructureError
        As `matrices_at`.
    AnalysisError
        An array is given for a parameter.
    WellPosednessError
        The model is singular at the point.
    """
    if any(np.ndim(value) for value in (values or {}).values()):
        raise AnalysisError(
            f"model {system.name!r}: pole_gradients takes one number for each parameter."
        )
    model = realization(system, others_are_zero=True, balanced=True)
    place = [system.parameters.names.index(name) for name in model.names]
    try:
        found, _, _ = moving_at(model, deltas_of(system, values or {})[0][place])
    except WellPosednessError as error:
        raise WellPosednessError(f"model {system.name!r}: {error}") from None
    gradients = np.zeros((len(found.poles), len(system.parameters)), dtype=complex)
    gradients[:, place] = found.gradients
    order = np.lexsort((-found.poles.imag, found.poles.real, np.abs(found.poles)))
    return Moving(found.poles[order], gradients[order])


def moving_at(model: Realization, delta: Array) -> tuple[Moving, Complex, Complex]:
    """Poles and gradients at deltas; left and right vectors (nx, nx), as columns.

    Raises
    ------
    WellPosednessError
        The model is singular there.
    """
    import scipy.linalg  # here because it is slow to import

    n = len(model.A)
    try:
        K, L = model.into(delta)[:, :n], model.out_of(delta)[:n]
    except np.linalg.LinAlgError:
        raise WellPosednessError("it is singular at one of the points of the search.") from None
    if not n:
        none = np.zeros((0, 0), dtype=complex)
        return Moving(none.ravel(), np.zeros((0, len(delta)), dtype=complex)), none, none
    A = model.A + (model.B * model.spread(delta)) @ K
    found, left, right = scipy.linalg.eig(A, left=True, check_finite=False)
    with np.errstate(all="ignore"):
        terms = (
            (np.conj(left.T) @ L) * (K @ right).T / np.sum(np.conj(left) * right, axis=0)[:, None]
        )
    return Moving(found, model.by_parameter(terms)), left, right


def push_right(
    model: Realization, delta: Array, pole: complex, most: int, aim: Aim = RIGHT
) -> tuple[Array, complex, int]:
    """Move a pole to the right, or to where another aim is larger, as far as a search finds.

    In a box around the point, cut by the range, the first-order change of the aim is largest at a
    corner, which is the sign of the gradient; the box doubles after a step to the right, and shrinks to a
    quarter after another one. A mode is known again by its shape.

    Parameters
    ----------
    model : Realization
    delta : array (number of deltas,) [1], where to start
    pole : the pole to follow, nearly one at the start
    most : points that may be evaluated
    aim : Aim

    Returns
    -------
    delta, pole there, points that were evaluated
    """
    here, left, _ = moving_at(model, delta)
    k = int(np.argmin(np.abs(here.poles - pole)))
    pole, shape = complex(here.poles[k]), left[:, k]
    gradient = aim.slope(pole, here.gradients[k])
    half, used = _FIRST, 1
    while used < min(most, _STEPS) and half >= _SMALLEST and np.all(np.isfinite(gradient)):
        step = np.clip(delta + half * np.sign(gradient), -1.0, 1.0) - delta
        if not np.any(step):
            break
        used += 1
        try:
            there, left, right = moving_at(model, delta + step)
        except WellPosednessError:
            half /= 4.0
            continue
        k = int(np.argmax(np.abs(np.conj(shape) @ right)))  # the mode that has this shape there
        if aim.value(there.poles[k]) > aim.value(pole):
            delta, pole, shape = delta + step, complex(there.poles[k]), left[:, k]
            gradient = aim.slope(pole, there.gradients[k])
            half = min(2.0 * half, _LARGEST)
        else:
            half /= 4.0
    return delta, pole, used
