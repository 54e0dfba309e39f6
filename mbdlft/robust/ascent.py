"""What is reached on the box: poles that are moved to the axis, and gains that are made large.

With Delta = diag(delta_k I), K = (I - D_zw Delta)^-1 C_z, L = B_w (I - Delta D_zw)^-1:

    A(delta) = A + B_w Delta K,    dA / d delta_k = L_k K_k,

with the columns of L and the rows of K of block k; so an eigenvalue with left vector u and right vector v
moves by u' L_k K_k v / (u' v).

Small deltas with a pole on the axis are found without a grid of frequencies: the smallest box with a
point where the linearized real part reaches 0 has it at the corner s sign(g_k), g the slope of the real
part. Steps towards that corner are repeated from every pole, and what is found is moved along its ray to
where the pole crosses.

A gain is climbed at corners of the box to which its slope points, then within the box. With

    G(j omega, delta) = M22 + M21 Delta (I - M11 Delta)^-1 M12,   M = M(j omega) of all channels,
    d sigma / d delta_k = Re( u' M21 (I - Delta M11)^-1 P_k (I - M11 Delta)^-1 M12 v )

at the frequency of the peak, where u and v are the singular vectors of G.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError, naming
from mbdlft.exact.rounding import eigenvalues_of, eigenvectors_of
from mbdlft.response.norms import peak_of
from mbdlft.response.staircase import Plant
from mbdlft.robust.bisect.characteristic import Realization, is_unstable_at, nearness
from mbdlft.robust.realization import realization
from mbdlft.system.model import System
from mbdlft.system.sampled import deltas_of

Complex = NDArray[np.complex128]
_FIRST, _LARGEST, _SMALLEST = 0.25, 2.0, 1e-3  # half sizes of the box of a step, in delta
_STEPS = 40  # of one search
_TINY = 1e-300  # in place of a size of 0 that is divided by
_FOLLOWED_STEPS, _RANDOM = 12, 6  # steps of a pole to the axis; searches from random deltas
_BISECTIONS = 60  # of a ray: more than a double has bits
_NEAR = 1.0 + 1e-6  # times a crossing: a model there is proved unstable, or singular on the way
_HALVINGS, _BITS = 6, 512  # of a ray in balls: of what is left of it, and of each ball
_GAINED = 1e-3  # of a size: what is less is not looked for in balls
_ENDS = 1e-7  # of a step: below this the search has arrived
Condition = Callable[[float], bool]
Look = Callable[[Array], tuple[float, Callable[[], Array]]]
_GROWTH = 1e-9  # of the level at which the search for a peak ends
_STARTS = 6  # random corners from which a gain is climbed


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
    """What a search makes as large as it can."""

    value: Callable[[Any], Any]  # of poles: real numbers
    slope: Callable[[complex, Complex], Array]  # of a pole and its gradient (n_p,): an array (n_p,)


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


@arguments_checked
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
    """
    if any(np.ndim(value) for value in (values or {}).values()):
        raise AnalysisError(f"model {system.name!r}: pole_gradients takes one number for each parameter.")
    model = realization(system, others_are_zero=True, balanced=True)
    place = [system.parameters.names.index(name) for name in model.names]
    with naming(f"model {system.name!r}", WellPosednessError):
        moving, _, _ = moving_at(model, deltas_of(system, values or {})[0][place])
    gradients = np.zeros((len(moving.poles), len(system.parameters)), dtype=complex)
    gradients[:, place] = moving.gradients
    order = np.lexsort((-moving.poles.imag, moving.poles.real, np.abs(moving.poles)))
    return Moving(moving.poles[order], gradients[order])


def moving_at(model: Realization, delta: Array) -> tuple[Moving, Complex, Complex]:
    """Poles and gradients at deltas; left and right vectors (nx, nx), as columns."""
    plant = at_delta(model, delta)
    if plant is None:
        raise WellPosednessError("it is singular at one of the points of the search.")
    if not len(model.A):
        none = np.zeros((0, 0), dtype=complex)
        return Moving(none.ravel(), np.zeros((0, len(delta)), dtype=complex)), none, none
    poles, U, V = eigenvectors_of(plant.A)
    with np.errstate(all="ignore"):
        slopes = model.slopes(delta, np.conj(U.T), V.T) / np.sum(np.conj(U) * V, axis=0)[:, None]
    return Moving(poles, slopes), U, V


def push_right(
    model: Realization, delta: Array, pole: complex, most: int, aim: Aim = RIGHT
) -> tuple[Array, complex, int]:
    """Move a pole to the right, or to where another aim is larger, as far as a search finds.

    In a box around the point, cut by the range, the first-order change of the aim is largest at a
    corner, which is the sign of the gradient; the box doubles after a step to the right, and shrinks to a
    quarter after another one. A mode is known again by its shape. At most so many points are evaluated;
    returned are delta (number of deltas,), the pole there, and the points that were evaluated.
    """
    here, U, _ = moving_at(model, delta)
    k = int(np.argmin(np.abs(here.poles - pole)))
    pole, shape = complex(here.poles[k]), U[:, k]
    gradient = aim.slope(pole, here.gradients[k])
    half, used = _FIRST, 1
    while used < min(most, _STEPS) and half >= _SMALLEST and np.all(np.isfinite(gradient)):
        step = np.clip(delta + half * np.sign(gradient), -1.0, 1.0) - delta
        if not np.any(step):
            break
        used += 1
        try:
            there, U, V = moving_at(model, delta + step)
        except WellPosednessError:
            half /= 4.0
            continue
        k = int(np.argmax(np.abs(np.conj(shape) @ V)))  # the mode that has this shape there
        if aim.value(there.poles[k]) > aim.value(pole):
            delta, pole, shape = delta + step, complex(there.poles[k]), U[:, k]
            gradient = aim.slope(pole, there.gradients[k])
            half = min(2.0 * half, _LARGEST)
        else:
            half /= 4.0
    return delta, pole, used


class Crossing(NamedTuple):
    """Deltas with a pole on or beyond the axis."""

    size: float  # largest |delta|
    delta: Array  # (number of deltas,)
    frequency: float  # of the pole (rad/s)
    slope: Array  # of its real part by the deltas (number of deltas,)


NONE = Crossing(np.inf, np.zeros(0), np.nan, np.zeros(0))


def state_matrices(model: Realization, deltas: Array) -> Array | None:
    """A (..., n, n) at deltas; None if one is singular, or beyond such a point: det(I - Delta D) <= 0."""
    w = model.spread(deltas)[..., None]
    loop = np.eye(len(model.D)) - w * model.D
    if np.any(np.linalg.slogdet(loop)[0] <= 0.0):
        return None
    return np.asarray(model.A + model.B @ np.linalg.solve(loop, w * model.C))


def abscissa(model: Realization, delta: Array) -> float:
    """The largest real part of the poles; infinite where the model is singular, or beyond."""
    A = state_matrices(model, delta)
    return np.inf if A is None else float(np.max(eigenvalues_of(A).real, initial=-np.inf))


def smallest_crossing(model: Realization, largest: float, most: float = np.inf) -> Crossing:
    """The best of the crossings with |delta| <= largest that searches from all poles lead to.

    At most so many searches are begun.
    """
    q, best = len(model.sizes), NONE
    if not q:
        return best
    poles = eigenvalues_of(model.A)
    upper = [complex(poles[i]) for i in by_damping(poles) if poles[i].imag >= 0.0]
    random = np.random.default_rng(0)
    for count, pole in enumerate((*upper, *[None] * _RANDOM)):
        if count >= most:
            break
        delta = np.zeros(q)
        if pole is None:
            delta = 0.7 * min(best.size, largest) * random.uniform(-1.0, 1.0, q)
        best = _searched(model, delta, largest, best, pole)
    return best


def improved(model: Realization, delta: Array, best: Crossing, largest: float) -> Crossing:
    """The best crossing that is near to given deltas."""
    return _searched(model, delta, largest, _better(best, model, delta, largest), None)


def _searched(
    model: Realization, delta: Array, largest: float, best: Crossing, pole: complex | None
) -> Crossing:
    """The best crossing to which following a pole leads; without one, steps to singular models, too."""
    if pole is None:
        for point in _towards_singular(model, delta, largest):
            best = _better(best, model, point, largest)
        pole = _rightmost(model, delta)
    for point in _path(model, delta, pole, largest):
        best = _better(best, model, point, largest)
    return best


def _better(best: Crossing, model: Realization, delta: Array, largest: float) -> Crossing:
    """The smaller of a crossing and of that on a ray."""
    return min(best, crossing_on_ray(model, delta, largest, below=best.size), key=lambda each: each.size)


def crossing_on_ray(
    model: Realization,
    delta: Array,
    largest: float,
    fixed: NDArray[np.bool_] | None = None,
    below: float = np.inf,
) -> Crossing:
    """Where from 0 to delta a pole first is on or beyond the axis, if below a size; else `NONE`.

    Deltas that are fixed stay. Where computed poles are nothing but rounding, balls say where one is.
    """
    kept = np.zeros(len(delta), dtype=bool) if fixed is None else fixed

    def at(t: float) -> Array:
        return np.where(kept, delta, t * delta)

    def is_beyond(t: float) -> bool:
        return abscissa(model, at(t)) >= 0.0

    def is_unstable(t: float) -> bool:
        return is_unstable_at(model, at(t), _BITS)

    size = float(np.max(np.abs(delta), initial=0.0, where=~kept))
    if np.any(kept) and is_beyond(0.0):
        return Crossing(0.0, at(0.0), np.nan, np.zeros(len(delta)))
    if size == 0.0 or size > largest * (1.0 + 1e-12) or not is_beyond(1.0):
        return NONE
    grid = np.linspace(0.0, 1.0, 9).tolist()  # an earlier crossing is found, if it is long
    first = next(i for i, t in enumerate(grid) if i and (t == 1.0 or is_beyond(t)))
    high = bisected(is_beyond, grid[first - 1], grid[first], _BISECTIONS, below / size)
    if not high * size < below:
        return NONE
    if not is_unstable(high * _NEAR):
        most = min(1.0, below * (1.0 - _GAINED) / size)
        if not high < most or not is_unstable(most):
            return NONE
        high = bisected(is_unstable, high, most, _HALVINGS)
    slope, frequency = np.zeros(len(delta)), np.inf
    with suppress(np.linalg.LinAlgError, WellPosednessError):
        if state_matrices(model, at(high * _NEAR)) is not None:  # else singular
            poles, gradients = moving_at(model, at(high))[0]
            i = int(np.argmax(poles.real))
            omega, real = float(abs(poles[i].imag)), gradients[i].real
            slope = real if np.all(np.isfinite(real)) else slope
            is_near = poles[i].real <= nearness(omega, float(np.max(np.abs(poles))))
            frequency = omega if is_near else np.inf  # it came through infinity
    return Crossing(high * size, at(high), frequency, slope)


def smallest_beside(
    model: Realization,
    fixed: NDArray[np.bool_],
    largest: float,
    best: Crossing,
    start: Array | None = None,
) -> Crossing:
    """The best of a crossing and of those to which pushing poles leads, where fixed deltas stay below 1.

    Poles are pushed from a start, or all from 0, in boxes that end before the crossing that is known.
    """
    if start is not None:
        starts = [(start, _rightmost(model, start))]
    else:
        poles = eigenvalues_of(model.A)
        starts = [(np.zeros(len(fixed)), complex(p)) for p in poles[by_damping(poles)] if p.imag >= 0.0]
    for delta, pole in starts:
        for _ in range(_STEPS):
            ends = np.where(fixed, 1.0, min(best.size * (1.0 - 1e-3), largest))
            if not np.all(ends > 0.0):
                return best
            rows = model.spread(ends)[:, None]
            unit = model._replace(C=model.C * rows, D=model.D * rows, F=model.F * rows)
            with suppress(WellPosednessError):
                inside = np.clip(delta / ends, -1.0, 1.0)
                delta = ends * push_right(unit, inside, pole, _STEPS)[0]
            crossing = crossing_on_ray(model, delta, largest, fixed)
            if not crossing.size < best.size:
                break
            best, delta, pole = crossing, crossing.delta, 1j * crossing.frequency
    return best


def _rightmost(model: Realization, delta: Array) -> complex:
    A = state_matrices(model, delta)
    poles = np.zeros(1) if A is None or not len(A) else eigenvalues_of(A)
    return complex(poles[np.argmax(poles.real)])


def bisected(condition: Condition, low: float, high: float, halvings: int, most: float = np.inf) -> float:
    """A number where a condition holds, near one where it does not, or above `most`: not at `low`."""
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        if low < middle < high and low < most:  # else the search has ended
            low, high = (low, middle) if condition(middle) else (middle, high)
    return high


def _towards_singular(model: Realization, delta: Array, largest: float) -> Iterator[Array]:
    """Deltas of steps towards det(I - Delta D) = 0.

    The determinant f is 1 at delta = 0; the smallest box with a zero of its linearization is a corner.
    """
    for _ in range(_FOLLOWED_STEPS if np.any(model.D) else 0):
        loop = np.eye(len(model.D)) - model.spread(delta)[:, None] * model.D
        if np.linalg.slogdet(loop)[0] <= 0.0:
            yield delta
            delta = 0.5 * delta
            continue
        slope = model.by_parameter(np.diagonal(np.linalg.solve(loop.T, model.D.T)))  # of -log f
        steepness = float(np.sum(np.abs(slope)))
        if steepness == 0.0:
            return
        size = min(1.02 * (float(slope @ delta) + 1.0) / steepness, largest)
        target = size * np.sign(slope)
        yield target
        delta = delta + 0.5 * (target - delta)


def _path(model: Realization, delta: Array, pole: complex, largest: float) -> Iterator[Array]:
    """Deltas to which a pole is followed: corners, and points on the way to them."""
    signs = np.zeros(len(delta))
    for step in range(_FOLLOWED_STEPS):
        try:
            (poles, moves), _, _ = moving_at(model, delta)
        except (np.linalg.LinAlgError, WellPosednessError):
            return
        if not len(poles) or not np.all(np.isfinite(moves)):
            return
        nearest = int(np.argmin(np.abs(poles - pole)))
        if step > 2 and np.max(poles.real) > 0.5 * poles[nearest].real:
            nearest = int(np.argmax(poles.real))
        pole, slope = complex(poles[nearest]), moves[nearest].real
        steepness = float(np.sum(np.abs(slope)))
        size = min((float(slope @ delta) - pole.real) / steepness, largest) if steepness else 0.0
        if size <= 0.0:
            return
        blend = 1.0 if np.array_equal(np.sign(slope), signs) or step < 3 else 0.5
        signs = np.sign(slope)
        new = delta + blend * (size * signs - delta)
        moved, delta = float(np.max(np.abs(new - delta))), new
        yield delta
        yield min(1.02 * size, largest) * signs
        if moved <= _ENDS * size:
            return


def climb(look: Look, k: float, start: Array) -> None:
    """Look at points of the box |delta| <= k where a function is larger and larger, from a start.

    `look` gives its value at deltas (number of deltas,), of the size of 1, and a function for its slope
    there. It keeps what is the best; an infinite value ends the ascent.
    """
    from scipy.optimize import minimize  # here because it is slow to import

    here, (value, slope) = start, look(start)
    for _ in range(_STEPS):  # corners to which the slope points
        if not np.isfinite(value):
            return
        corner = k * np.sign(slope())
        if np.array_equal(corner, here):
            return
        there, its_slope = look(corner)
        if there <= value:
            break
        here, value, slope = corner, there, its_slope
    if not np.isfinite(value):
        return

    def objective(delta: Array) -> tuple[float, Array]:
        value, its_slope = look(delta)
        if not np.isfinite(value):
            return -1e30, np.zeros(len(delta))
        return -value, -its_slope()

    box, options = [(-k, k)] * len(start), {"maxiter": _STEPS}
    minimize(objective, here, jac=True, bounds=box, method="L-BFGS-B", options=options)


class Peak(NamedTuple):
    """A largest gain over frequency; infinite where a pole is not stable."""

    gain: float
    frequency: float  # rad/s
    delta: Array  # (number of deltas,)


NOTHING = Peak(0.0, np.nan, np.zeros(0))


def at_delta(model: Realization, delta: Array) -> Plant | None:
    """A, B, C, D from u to y at some deltas; None where the model is singular."""
    n = len(model.A)
    try:
        right = model.into(delta)
    except np.linalg.LinAlgError:
        return None
    whole = np.block([[model.A, model.E], [model.G, model.J]])
    whole = whole + (np.vstack([model.B, model.H]) * model.spread(delta)) @ right
    return Plant(whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:])


def peak_at(model: Realization, delta: Array) -> Peak:
    """The peak over all frequencies at some deltas."""
    matrices = at_delta(model, delta)
    if matrices is None:
        return Peak(np.inf, np.nan, delta)
    poles = eigenvalues_of(matrices.A)
    if np.max(poles.real, initial=-1.0) >= 0.0:
        return Peak(np.inf, float(abs(poles[np.argmax(poles.real)].imag)), delta)
    gain, _, frequency, _ = peak_of(matrices, _GROWTH)
    return Peak(gain, frequency, delta)


def slope_at(model: Realization, peak: Peak) -> Array:
    """Derivatives of the gain at the frequency of a peak by the deltas."""
    plant = at_delta(model, peak.delta)
    assert plant is not None, "a peak is that of a model"
    A, B, C, D = plant
    row: NDArray[Any] = 0.0 * C  # at infinity
    column: NDArray[Any] = 0.0 * B
    if np.isfinite(peak.frequency):
        inverse = np.linalg.inv(1j * peak.frequency * np.eye(len(A)) - A)
        row, column = C @ inverse, inverse @ B
    u, _, v = np.linalg.svd(D + C @ column)
    left = u[:, 0].conj() @ np.hstack([row, np.eye(len(C))])
    right = np.vstack([column, np.eye(B.shape[1])]) @ v[0].conj()
    return np.asarray(model.slopes(peak.delta, left[None], right[None])[0].real)


def largest_peak(model: Realization, k: float, more: tuple[Array, ...] = ()) -> Peak:
    """The largest peak found on the box |delta| <= k: from its middle, corners, and other starts."""
    q = len(model.sizes)
    random = np.random.default_rng(0)
    best = peak_at(model, np.zeros(q))

    def look(delta: Array) -> tuple[float, Callable[[], Array]]:
        nonlocal best
        peak = peak_at(model, delta)
        best = peak if peak.gain > best.gain else best
        gain = float(np.log(peak.gain)) if peak.gain > 0.0 else -1e30
        return gain, lambda: slope_at(model, peak) / max(peak.gain, 1e-30)

    corners = [k * np.sign(random.uniform(-1.0, 1.0, q)) for _ in range(_STARTS)]
    for start in (np.zeros(q), *more, *corners) if q else ():
        climb(look, k, start)
        if not np.isfinite(best.gain):
            break
    return best
