"""Step, impulse and initial responses at samples of the parameters, by the matrix exponential.

x(t + h) = exp(A h) x(t) is exact for every step h, of integrators, stiff systems and undamped ones; in
twice the precision where doubles lose slow motions beside fast ones. With a constant input, A is
bordered by B (Van Loan, IEEE Transactions on Automatic Control 1978).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, check_known
from mbdlft.base.parameter import is_finite
from mbdlft.exact import rounding
from mbdlft.exact.rounding import Twofold
from mbdlft.response import modes
from mbdlft.response.momenta import Part, by_momenta, parts_at
from mbdlft.system.model import System
from mbdlft.system.sampled import StateMatrices

_POINTS, _MOST_POINTS = 400, 5000  # of times that are chosen here
_SETTLED = 5.0  # time constants until little is left: 0.7 %
_PERIODS, _IN_A_PERIOD = 12.0, 16.0  # of the slowest oscillation, if it decays later; points
_GROWS = 1e-3  # what grows by less than this until the end does not grow
_EVEN = 1e-9  # of a step: times as evenly spaced as this are so
_LOST, _NEGLIGIBLE = 1e-10, 1e-6  # of the largest of a channel, and of that of its output
_ENTRIES = 2**22  # numbers of all states at all times that are held at once


class TimeResponse(NamedTuple):
    """Responses of N samples.

    Attributes
    ----------
    times : array (T,), s
    values : array (N, T, ny, nu) by inputs, or (N, T, ny) from an initial state
        In the unit of the output over that of the input; an impulse has the unit of the input times s.
    """

    times: Array
    values: Array


@arguments_checked
def step_response(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    times: ArrayLike | None = None,
    *,
    outputs: modes.Names = None,
    inputs: modes.Names = None,
) -> TimeResponse:
    """Outputs after each input goes from 0 to 1 at t = 0: D + C times the integral of exp(A s) B.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    times : array (T,), s, rising, not negative
        By default some 400 until the slowest mode has decayed, or 12 of its periods.
    outputs, inputs : names of channels; all by default

    Raises
    ------
    AnalysisError
        It grows beyond all numbers.
    """
    parts = parts_at(system, values, outputs, inputs, "responses")
    return _by_parts(system, times, *parts, _bordered)


def _bordered(m: StateMatrices) -> tuple[Array, Array, Array]:
    """A, start and readout of states and constant inputs."""
    count, n, inputs = m.B.shape
    below = np.zeros((count, inputs, n + inputs))
    bordered = np.concatenate([np.concatenate([m.A, m.B], axis=2), below], axis=1)
    start = np.concatenate([np.zeros((n, inputs)), np.eye(inputs)])
    start = np.broadcast_to(start, (count, n + inputs, inputs))
    return bordered, start, np.concatenate([m.C, m.D], axis=2)


@arguments_checked
def impulse_response(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    times: ArrayLike | None = None,
    *,
    outputs: modes.Names = None,
    inputs: modes.Names = None,
) -> TimeResponse:
    """Outputs after an impulse of area 1 at each input: C exp(A t) B; that of D at t = 0 is left out.

    `system`, `values`, `times`, `outputs` and `inputs` are those of `step_response`.
    """
    parts = parts_at(system, values, outputs, inputs, "responses")
    return _by_parts(system, times, *parts, lambda m: (m.A, m.B, m.C))


def _by_parts(
    system: System,
    times: ArrayLike | None,
    matrices: StateMatrices,
    parts: Sequence[Part],
    started: Callable[[StateMatrices], tuple[Array, Array, Array]],
) -> TimeResponse:
    """Responses (N, T, ny, nu), each part by matrices in which what it does not move or see is held."""
    t = _times(system, matrices.A, times)
    response = np.empty((len(matrices.A), len(t), *matrices.D.shape[1:]))
    for part in parts:
        moved = _moved(system, *started(part.matrices), t)
        at = np.s_[:, :, part.outputs[:, None], part.inputs]
        response[at] = np.where(part.is_own, moved, response[at])
    return TimeResponse(t, response)


@arguments_checked
def initial_response(
    system: System,
    state: Mapping[str, float],
    values: Mapping[str, ArrayLike] | None = None,
    times: ArrayLike | None = None,
    *,
    outputs: modes.Names = None,
) -> TimeResponse:
    """Outputs from an initial state without inputs: C exp(A t) x(0).

    Parameters
    ----------
    system : System or LFTModel
    state : mapping of names of states to numbers, in their units; the others are zero
    values, times, outputs : as of `step_response`
    """
    names = [signal.name for signal in system.states]
    x = np.zeros(len(names))
    for name, value in state.items():
        check_known("state", [name], names, f"model {system.name!r}", AnalysisError)
        if not is_finite(value):
            raise AnalysisError(
                f"model {system.name!r}: state {name}: expected a finite number, got {value!r}."
            )
        x[names.index(name)] = value
    rows = modes.chosen(system.name, "output", outputs, system.outputs, "responses")
    A, _, C, _ = modes.samples_at(system, values)
    start = np.broadcast_to((x / modes.balancing(system.A))[:, None], (len(A), len(x), 1))
    matrices = StateMatrices(A, start, C[:, rows], np.zeros((len(A), len(rows), 1)))
    parts = by_momenta(system, matrices, rows, None)
    response = _by_parts(system, times, *parts, lambda m: (m.A, m.B, m.C))
    return response._replace(values=response.values[..., 0])


@arguments_checked
def response_times(system: System, values: Mapping[str, ArrayLike] | None = None) -> Array:
    """Times (T,), s, from 0 until the slowest mode of all samples has decayed, or 12 of its periods.

    What grows does so by 5 of its time constants at most.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    """
    return _times(system, modes.samples_at(system, values).A, None)


def _times(system: System, A: Array, times: ArrayLike | None) -> Array:
    """Checked times, or those that suit the poles of A (N, nx, nx)."""
    if times is None:
        poles = modes.without_integrators(system, modes.eigenvalues(A, system.name))
        size, real, turning = np.abs(poles), np.abs(poles.real), np.abs(poles.imag)
        with np.errstate(divide="ignore"):
            periods = np.where(turning > 0.5 * size, 2.0 * np.pi * _PERIODS / turning, np.inf)
            needed = np.minimum(_SETTLED / real, periods)
        end = float(np.max(needed, initial=0.0)) or 1.0
        fastest_growth = float(np.max(poles.real, initial=0.0))
        end = min(end, _SETTLED / fastest_growth) if fastest_growth > _GROWS / end else end
        fastest = float(np.max(turning[real < turning], initial=0.0)) / (2.0 * np.pi)
        count = int(min(_MOST_POINTS, max(_POINTS, end * fastest * _IN_A_PERIOD)))
        return np.linspace(0.0, end, count + 1)
    checked = np.atleast_1d(np.asarray(times))
    rising = (
        checked.dtype.kind in "iuf"
        and checked.ndim == 1
        and len(checked) > 0
        and np.all(np.isfinite(checked))
        and checked[0] >= 0.0
        and np.all(np.diff(checked) > 0.0)
    )
    if not rising:
        raise AnalysisError(
            f"model {system.name!r}: times: expected rising finite times (s), the first not negative, "
            f"got {times!r}."
        )
    return checked.astype(float)


def _moved(system: System, A: Array, start: Array, readout: Array, times: Array) -> Array:
    """readout exp(A t) start at all times, (N, T, ny, m)."""
    if np.iscomplexobj(A) or np.iscomplexobj(readout) or np.iscomplexobj(start):
        raise AnalysisError(
            f"model {system.name!r}: responses in time are those of real matrices, and some are complex."
        )
    with np.errstate(all="ignore"):  # what grows beyond all numbers is an error below
        values = _read(A, start, readout, times, _exponential, _square)
        if _is_lost(A, start, readout, times, values):
            values = _read(A, start, readout, times, rounding.exponential, rounding.square)
    if not np.all(np.isfinite(values)):
        raise AnalysisError(
            f"model {system.name!r}: the response grows beyond the largest number before "
            f"{times[-1]:g} s. Give shorter times."
        )
    return values


def _read(
    A: Array,
    start: Array,
    readout: Array,
    times: Array,
    exponential: Callable[[Array], Twofold],
    square: Callable[[Twofold], Twofold],
) -> Array:
    """`_moved` by one kind of exponential, for as many samples at once as there is room for."""
    values = np.empty((len(A), len(times), readout.shape[1], start.shape[2]))
    each = max(1, _ENTRIES // max(1, len(times) * A.shape[1] * start.shape[2]))
    for k in range(0, len(A), each):
        samples = slice(k, k + each)
        states = _states(A[samples], start[samples], times, exponential, square)
        values[samples] = readout[samples, None] @ states
    return values


def _exponential(matrices: Array) -> Twofold:
    from scipy.linalg import expm  # here because it is slow to import

    return Twofold(expm(matrices), np.zeros_like(matrices))


def _square(matrices: Twofold) -> Twofold:
    return Twofold(matrices.high @ matrices.high, matrices.low)


def _is_lost(A: Array, start: Array, readout: Array, times: Array, values: Array) -> bool:
    """Whether values (N, T, ny, m) in doubles lose digits, where A is largest, halfway and at the end.

    Slow motions do beside fast ones, by the square of the ratio of their frequencies.
    """
    if not values.size or not A.shape[1]:
        return False
    k, at = int(np.argmax(np.max(np.abs(A), axis=(1, 2)))), [len(times) // 2, len(times) - 1]
    expected = readout[k] @ (rounding.exponential(A[k] * times[at, None, None]).high @ start[k])
    sizes = np.max(np.abs(values[k]), axis=0)
    sizes = np.maximum(sizes, _NEGLIGIBLE * np.max(sizes, axis=1, keepdims=True))
    return bool(np.any(np.abs(values[k, at] - expected) > _LOST * sizes))


def _states(
    A: Array,
    start: Array,
    times: Array,
    exponential: Callable[[Array], Twofold],
    square: Callable[[Twofold], Twofold],
) -> Array:
    """exp(A t) start at all times, (N, T, n, m)."""
    states = np.empty((len(A), len(times), *start.shape[1:]))
    states[:, 0] = exponential(A * times[0]).high @ start if times[0] else start
    steps = np.diff(times)
    if not len(steps):
        return states
    even = (times[-1] - times[0]) / len(steps)
    if np.all(np.abs(times - times[0] - even * np.arange(len(times))) <= _EVEN * even):
        # all that is known is moved at once, by as many steps
        power, known = exponential(A * even), 1
        while known < len(times):
            more = min(known, len(times) - known)
            states[:, known : known + more] = power.high[:, None] @ states[:, :more]
            known += more
            power = square(power)
        return states
    some = max(1, _ENTRIES // (16 * max(A.size, 1)))  # with their slices
    for first in range(0, len(steps), some):
        powers = exponential(A * steps[first : first + some, None, None, None]).high
        for k, power_of_step in enumerate(powers, first + 1):
            states[:, k] = power_of_step @ states[:, k - 1]
    return states
