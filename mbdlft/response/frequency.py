"""Frequency responses G(s) = C (s I - A)^-1 B + D at many s and many samples, and frequencies for them.

A sample is brought to Schur form once, A = Q T Q', and each s costs two substitutions with the triangle
s I - T: the second one removes the residual of the first (Higham, Accuracy and Stability of Numerical
Algorithms, 2nd ed. 2002, section 12.1: with it each row is as accurate as by elimination). Samples at
which the second one changes much, as where eigenvectors give no triangle, are solved by elimination.

Responses are computed at frequencies that are evenly spaced on a logarithmic axis, and at more of them
around each pole.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.base.reach import in_reach
from mbdlft.exact.rounding import EPS
from mbdlft.response import modes
from mbdlft.response.momenta import Part, by_momenta, parts_at
from mbdlft.response.positions import Place, from_positions, with_positions
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import StateMatrices

Complex = NDArray[np.complex128]
_ENTRIES = 2**15  # of the states at all frequencies, held at once: they stay near a core
_AT_REST = 100.0 * EPS  # of terms: what is left of them is nothing
_SIX_DIGITS = 1e-6
_LOOKED_AT = np.array([0.1, 0.3, 1.0])  # of a frequency; errors of accelerations are as its square
_NEAR = 4.0 * EPS  # of s: an eigenvalue as near as this is s
_CHANGE = 1e-8  # of the states: what the second substitution may change; the square of it is left
POINTS = 200  # evenly spaced in the logarithm
_DECADE = 10.0  # beyond the slowest and the fastest pole
_NEAREST = 1e-4  # of its frequency: no response is computed nearer to a pole without damping
_UNDAMPED = 1e-7  # damping below this is none
# distances from the frequency of a pole, in half widths of its peak: a peak lies at most an eighth of
# one from the nearest, and is 0.07 dB higher at most
_CENTER = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_BEYOND = 6  # more to either side, farther and farther apart, until the evenly spaced are as near
_INFINITE = 3.0  # a response that grows by more than this when a hundred times nearer is unbounded


def resolvent(matrices: StateMatrices, s: Complex) -> Complex:
    """C (s I - A)^-1 B + D, (N, F, ny, nu), of N samples at s (N, F), in the unit of A.

    Not finite where s is an eigenvalue of A, exactly or but for its last digits.
    """
    A, _, _, D = matrices
    values = np.empty((*s.shape, *D.shape[1:]), dtype=complex)
    if not (A.shape[1] and values.size):
        values[:] = D[:, None]
        return values
    with np.errstate(all="ignore"):  # what comes of a pole is told by what is not finite
        for piece in _pieces(s.shape, A.shape[1] * max(D.shape[1:])):
            some = StateMatrices(*(matrix[piece[0]] for matrix in matrices))
            of_piece = values[piece]
            lost = ~_by_triangles(some, s[piece], of_piece)
            for k in np.flatnonzero(lost):
                of_piece[k] = _by_elimination(StateMatrices(*(m[k] for m in some)), s[piece][k])
    return values


def _pieces(shape: tuple[int, ...], each: int) -> Iterator[tuple[slice, slice]]:
    """Slices of samples and of frequencies whose states fit into a cache."""
    samples, frequencies = shape
    most = max(1, min(frequencies, _ENTRIES // each))
    rows = max(1, _ENTRIES // (each * most))
    for k in range(0, samples, rows):
        for j in range(0, frequencies, most):
            yield slice(k, k + rows), slice(j, j + most)


def _by_triangles(matrices: StateMatrices, s: Complex, values: Complex) -> NDArray[np.bool_]:
    """Write the values (N, F, ny, nu), and say of which samples (N,) they are right."""
    A, B, C, D = matrices
    try:
        Q, _ = np.linalg.qr(np.linalg.eig(A)[1].astype(complex))
    except np.linalg.LinAlgError:
        return np.zeros(len(A), dtype=bool)
    Qh = np.conj(np.swapaxes(Q, 1, 2))
    T = Qh @ A @ Q
    shifted = s[:, None] - np.diagonal(T, axis1=1, axis2=2)[:, :, None]
    shifted[np.abs(shifted) <= _NEAR * np.abs(s[:, None])] = 0.0
    inverse = (1.0 / shifted)[..., None]
    X = _times(Q, _substituted(T, inverse, (Qh @ B)[:, :, None]))
    residual = _times(A, X)
    residual -= s[:, None, :, None] * X
    residual += B[:, :, None]
    change = _substituted(T, inverse, _times(Qh, residual))
    sizes = [np.max(np.abs(x.view(float)), axis=1) for x in (change, X)]
    good = ~np.any(sizes[0] > _CHANGE * sizes[1], axis=(1, 2))  # nan, where s is a pole, may stay
    both = _times(C, X)
    both += _times(C @ Q, change)
    np.add(np.swapaxes(both, 1, 2), D[:, None], out=values)
    return np.asarray(good)


def _substituted(T: Complex, inverse: Complex, right: NDArray[Any]) -> Complex:
    """Solution X (N, n, F, nu) of (s I - T) X = right, from the last row up.

    T (N, n, n) is an upper triangle, `inverse` (N, n, F, 1) is 1/(s - T_kk).
    """
    samples, n, frequencies, _ = inverse.shape
    X = np.empty((samples, n, frequencies, right.shape[-1]), dtype=complex)
    for k in range(n - 1, -1, -1):
        row = right[:, k]
        if k < n - 1:
            row = row + _times(T[:, k : k + 1, k + 1 :], X[:, k + 1 :])[:, 0]
        np.multiply(row, inverse[:, k], out=X[:, k])
    return X


def _times(matrix: NDArray[Any], X: Complex) -> Complex:
    """Products of matrices (N, m, n) and X (N, n, F, nu)."""
    product: Complex = matrix @ X.reshape(*X.shape[:2], -1)
    return product.reshape(*product.shape[:2], *X.shape[2:])


def _by_elimination(matrices: StateMatrices, s: Complex) -> Complex:
    """Values (F, ny, nu) of one sample at each s (F,)."""
    A, B, C, D = matrices
    shifted = s[:, None, None] * np.eye(len(A)) - A
    try:
        solved = np.linalg.solve(shifted, np.broadcast_to(B, (len(s), *B.shape)))
    except np.linalg.LinAlgError:  # at one of them
        if len(s) == 1:
            return np.full((1, *D.shape), np.nan, dtype=complex)
        return np.concatenate([_by_elimination(matrices, s[k : k + 1]) for k in range(len(s))])
    values: Complex = np.asarray(C @ solved + D, dtype=complex)
    return values


@arguments_checked
def frequency_response(
    model: System, values: Mapping[str, ArrayLike], omega: ArrayLike
) -> NDArray[np.complex128]:
    """G(j omega) = C (j omega I - A)^-1 B + D at samples of the parameters.

    Parameters
    ----------
    model : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    omega : array (F,), or (N, F) with a row for each sample; rad/s

    Returns
    -------
    complex array (N, F, ny, nu)
        Unit of entry (i, j): unit of output i over unit of input j. N = 1 for numbers. An acceleration
        (of a state, or in the certificate) is -omega^2 times its position far below the modes, where
        the sum of D and the rest has lost its digits.

    Raises
    ------
    AnalysisError
        j omega is an eigenvalue of A at one of the samples (at most but for the last digits), or `omega`
        has what is not a finite number, or another number of rows.
    """
    frequencies = np.asarray(omega)
    if frequencies.dtype.kind not in "iuf" or not np.all(np.isfinite(frequencies)):
        raise AnalysisError(
            f"model {model.name!r}: omega: expected finite frequencies (rad/s), got {omega!r}."
        )
    matrices = modes.samples_at(model, values)
    count = len(matrices.A)
    frequencies = np.atleast_1d(frequencies)
    if frequencies.ndim > 2 or (frequencies.ndim == 2 and len(frequencies) not in (1, count)):
        raise AnalysisError(
            f"model {model.name!r}: omega: expected frequencies (F,), or a row (N, F) for each of "
            f"{count} samples, got shape {frequencies.shape}."
        )
    rows = np.broadcast_to(frequencies, (count, frequencies.shape[-1]))
    response = _responses(_placed(model, matrices), matrices, rows)
    poles = ~np.isfinite(response).all(axis=(2, 3))
    if np.any(poles):
        raise AnalysisError(
            f"model {model.name!r}: omega = {rows[poles][0]:g} rad/s is a pole at one of the samples, "
            "where the response is infinite. Leave this frequency out or add damping."
        )
    return response


_Placed = tuple[Part, StateMatrices, Mapping[int, Place]]  # with positions


def _placed(system: System, matrices: StateMatrices) -> list[_Placed]:
    known = system.certificate if isinstance(system, LFTModel) else None
    proved, *others = (known.accelerations, known.driven, known.beside) if known else ((), (), ())
    _, parts = by_momenta(system, matrices, range(len(system.outputs)), range(len(system.inputs)))
    return [
        (part, *with_positions(part.matrices, proved if part.leaves_momenta else (), *others))
        for part in parts
    ]


def _responses(placed: Sequence[_Placed], matrices: StateMatrices, omega: Array) -> Complex:
    """Responses (N, F, ny, nu) at omega (N, F), rad/s: of parts; from the slowest mode on, of all.

    An entry is D where no entries of A lead from the input to the output: rounding mixes what is apart.
    """
    count, ny, nu = matrices.D.shape
    response = np.empty((*omega.shape, ny, nu), dtype=complex)
    until = placed[0][0].until if placed else np.full(count, np.inf)  # none without inputs or outputs
    is_beyond = np.all(np.abs(omega) >= until[:, None], axis=0)
    pieces = [(*part[:2], part.is_own, some, places, ~is_beyond) for part, some, places in placed]
    if np.any(is_beyond):
        everywhere = np.arange(ny), np.arange(nu), np.ones((ny, nu), dtype=bool)
        pieces.append((*everywhere, *with_positions(matrices), is_beyond))
    for y, u, is_own, some, places, columns in pieces:
        if np.any(columns):
            values = resolvent(some, 1j * omega[:, columns].astype(float))
            values = from_positions(values, some.D, omega[:, columns], places)
            at = np.ix_(np.arange(count), np.flatnonzero(columns), y, u)
            response[at] = np.where(is_own, values, response[at])
    A, B, C, _ = (np.any(matrix != 0.0, axis=0) for matrix in matrices)
    led = np.array([in_reach(A, column) for column in B.T], dtype=bool).reshape(nu, len(A))
    return np.where(C @ led.T, response, matrices.D[:, None])


def carried_from(system: System) -> dict[str, tuple[float, bool]]:
    """Frequencies (rad/s) from which D + C (s I - A)^-1 B has six digits of an acceleration, by output.

    Also whether a position has them below. At nominal. Outputs are accelerations, of states or of other
    places, if at rest nothing is left of their terms D and C (-A)^-1 B. Far below its modes a structure
    that is held has the acceleration s^2 C A^-2 (-A)^-1 B, and the terms are rounded by 2.2e-16. Where
    there is a position, what the sum has lost is also measured: entries of A may have lost more.
    """
    matrices = modes.samples_at(system)
    placed, late = _placed(system, matrices), dict[int, tuple[float, bool]]()
    for part, _, places in placed:
        A, B, C, D = (matrix[0] for matrix in part.matrices)
        try:
            at_rest = np.linalg.solve(A, B)
            moved = np.linalg.solve(A, np.linalg.solve(A, at_rest))
        except np.linalg.LinAlgError:  # nothing holds it
            continue
        for i in np.flatnonzero(np.any(D != 0.0, axis=1)).tolist():
            terms, x = np.abs(C[i]) @ np.abs(at_rest) + np.abs(D[i]), np.abs(C[i] @ moved)
            some = part.is_own[i] & (x > _AT_REST * (np.abs(C[i]) @ np.abs(moved)))
            is_zero = ~part.is_own[i] | (np.abs(D[i] - C[i] @ at_rest) <= _AT_REST * terms)
            if np.any(some) and (i in places or np.all(is_zero)):
                omega = float(np.sqrt(np.max(EPS * terms[some] / x[some]) / _SIX_DIGITS))
                output = int(part.outputs[i])
                late[output] = max(late.get(output, (0.0, True)), (omega, i in places))
    if not late:
        return {}
    omega = (np.array([w for w, _ in late.values()])[:, None] * _LOOKED_AT).reshape(1, -1)
    response = _responses(placed, matrices, omega)[0]
    apart = np.abs(resolvent(matrices, 1j * omega)[0] - response)
    size = np.where(response != 0.0, np.abs(response), np.inf)
    shares = np.max(apart / size, axis=2, initial=0.0)
    shares = shares.reshape(len(late), len(_LOOKED_AT), len(system.outputs)) * _LOOKED_AT[:, None] ** 2
    more = np.sqrt(np.maximum(np.max(shares, axis=1) / _SIX_DIGITS, 1.0))
    return {
        system.outputs[i].name: (w * float(more[k, i]), has)
        for k, (i, (w, has)) in enumerate(late.items())
    }


def singular_values(response: NDArray[np.complex128]) -> Array:
    """Singular values (..., min(ny, nu)) of a `response` (..., ny, nu), largest first; its unit."""
    return np.asarray(np.linalg.svd(response, compute_uv=False), dtype=float)


def gain_unit(system: System) -> str:
    """Unit of the gain, or ``mixed units`` if the outputs or the inputs have several units."""
    pairs = {(y.unit, u.unit) for y in system.outputs for u in system.inputs}
    if len(pairs) != 1:
        return "mixed units"
    over, under = (f"({unit})" if " " in unit or "/" in unit else unit for unit in pairs.pop())
    return f"{over}/{under}"


def peaks(values: Array) -> Array:
    """Rows (N, F) with -inf where no peak is; all of them stay if there is none, as of integrators."""
    higher = (values[:, 1:-1] >= values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:])
    at_peaks = np.full(values.shape, -np.inf)
    at_peaks[:, 1:-1] = np.where(higher, values[:, 1:-1], -np.inf)
    return at_peaks if np.any(np.isfinite(at_peaks)) else values


@arguments_checked
def response_frequencies(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    low: float | None = None,
    high: float | None = None,
    points: int = POINTS,
) -> Array:
    """Frequencies for each sample: evenly spaced ones, and those around its own poles.

    Peaks of lightly damped modes are right to 0.1 dB at them. To a pole whose damping is below 1e-7 there
    is none nearer than a ten-thousandth of its frequency.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    low, high : float, rad/s
        By default a decade below the slowest and above the fastest pole of all samples; poles at zero
        are left out.
    points : int
        Number of evenly spaced ones, on a logarithmic axis.

    Returns
    -------
    array (N, F), rad/s
        Rows rise, and some numbers stand twice where a pole has none to add; for `frequency_response`.
    """
    A = modes.samples_at(system, values).A
    poles = modes.eigenvalues(A, system.name)
    first, last = frequency_range(system, poles, low, high)
    if not isinstance(points, int | np.integer) or points < 2:
        raise AnalysisError(
            f"model {system.name!r}: expected at least 2 points of frequency, got {points!r}."
        )
    even = np.geomspace(first, last, int(points))
    if np.isrealobj(A):  # one of each pair is enough
        poles = np.where(poles.imag > 0.0, poles, 0.0)
    pairs = int(np.max(np.sum(poles != 0.0, axis=1), initial=0))
    poles = np.take_along_axis(poles, np.argsort(poles == 0.0, axis=1, kind="stable"), axis=1)
    return np.stack([_around(even, row) for row in poles[:, :pairs]])


def frequency_range(
    system: System, poles: NDArray[np.complex128], low: float | None, high: float | None
) -> tuple[float, float]:
    """Lowest and highest frequency, rad/s; those that are not given by the poles (N, nx)."""
    sizes = np.abs(modes.without_integrators(system, poles))
    first = float(np.min(sizes)) / _DECADE if low is None and len(sizes) else low
    last = float(np.max(sizes)) * _DECADE if high is None and len(sizes) else high
    if first is None:
        first = 0.1 if last is None else last / _DECADE**2
    if last is None:
        last = first * _DECADE**2
    for label, value in (("low", first), ("high", last)):
        if isinstance(value, bool) or not np.isreal(value) or not 0.0 < value < np.inf:
            raise AnalysisError(
                f"model {system.name!r}: frequencies: expected a positive finite {label} end (rad/s), "
                f"got {value!r}."
            )
    if not first < last:
        raise AnalysisError(
            f"model {system.name!r}: frequencies: expected low < high, got {first:g} and {last:g} rad/s."
        )
    return float(first), float(last)


@arguments_checked
def unbounded_frequencies(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    outputs: modes.Names = None,
    inputs: modes.Names = None,
) -> tuple[Array, ...]:
    """Frequencies at which a response is infinite: those of poles on the axis that the channels see.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    outputs, inputs : names of channels; all by default

    Returns
    -------
    tuple of N arrays, rad/s, each rising; 0 for integrators
    """
    matrices, parts = parts_at(system, values, outputs, inputs, "responses")
    frequencies = []
    for k, A in enumerate(matrices.A):
        seen = modes.spectrum(A)
        largest = float(np.max(np.abs(seen.poles), initial=0.0))
        sizes = np.unique(np.abs(seen.cleaned.imag[seen.on_axis]))
        unit = np.where(sizes > 0.0, sizes, largest or 1.0)
        apart = np.array([1e-2, 1e-4]) * _NEAREST
        omega = sizes[:, None] + unit[:, None] * np.where(sizes[:, None] > 0.0, apart, 100.0 * apart)
        gains = np.zeros(omega.size)
        for part in parts:
            some = StateMatrices(*(matrix[k, None] for matrix in part.matrices))
            sizes_of = np.abs(resolvent(some, 1j * omega.reshape(1, -1))[0][:, part.is_own])
            gains = np.maximum(gains, np.max(sizes_of, axis=1))
        gains = gains.reshape(-1, 2)
        kept = sizes[gains[:, 1] > _INFINITE * gains[:, 0]]
        # poles of one frequency that rounding has moved apart are one
        gaps = np.diff(kept, prepend=-np.inf) > _NEAREST * kept
        frequencies.append(kept[gaps])
    return tuple(frequencies)


def _around(even: Array, poles: NDArray[np.complex128]) -> Array:
    """Rising frequencies of one sample: `even` ones (P,), and clusters at its poles (nx,)."""
    first, last = even[0], even[-1]
    apart = np.log(last / first) / (len(even) - 1)
    center, half = np.abs(poles.imag)[:, None], np.abs(poles.real)[:, None]
    undamped = half < _UNDAMPED * center
    width = np.where(undamped, _NEAREST * center, half)
    ratio = np.maximum(apart * center / np.where(width > 0.0, width, 1.0), 2.0)
    beyond = ratio ** (np.arange(1, _BEYOND + 1) / _BEYOND)
    steps = np.concatenate([np.tile(_CENTER, (len(poles), 1)), beyond], axis=1)
    added = np.concatenate([center + width * steps, center - width * steps], axis=1)
    added = np.where((center > 0.0) & (added > first) & (added < last), added, first)
    return _off_axis(np.sort(np.concatenate([even, added.ravel()])), center[undamped])


def _off_axis(omega: Array, centers: Array) -> Array:
    """Rising frequencies, those that are too near to poles on the axis moved as far as is allowed."""
    for center in np.unique(centers[centers > 0.0]):
        near = np.abs(omega - center) < _NEAREST * center
        omega = np.where(near, center * (1.0 + np.where(omega < center, -1.0, 1.0) * _NEAREST), omega)
    return np.sort(omega)
