"""State matrices at samples, in coordinates that are similar in size; their poles as modes.

The states are scaled by powers of 2, so nothing is rounded. One rule says everywhere whether a pole is
on the imaginary axis (`spectrum`): where doubles do not tell its side, balls decide it for all matrices
whose entries are as near to those of A as rounding is; if they do not, it is on the axis. A mode is a
real pole or a conjugate pair.

An eigenvalue has an enclosure with its vector, in balls, for all matrices whose entries are as near as
rounding is. With (v, lambda) for A to many digits, and R near to the inverse of the derivative J of

    f(v, lambda) = [(A - lambda) v; u'v - 1],    u the vector of doubles,

an eigenpair is in (v, lambda) + X if -R f + (I - R J) X is in X (Krawczyk; S. M. Rump, Verification
methods, Acta Numerica 19, 2010, section 13). Of eigenvalues that are not simple there is none.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, unknown_name
from mbdlft.base.unit import Signal
from mbdlft.exact.rounding import EPS, eigenvalues_of, eigenvectors_of
from mbdlft.system.model import System
from mbdlft.system.sampled import StateMatrices, matrices_at

ROUNDING = 16.0 * EPS  # times the number of states and the size of A: what rounding may do to A
_BITS, _REFINED, _INFLATED = 192, 4, 3  # of balls; steps to an eigenpair; boxes that are tried around it


def eigenpair(A: Array, pole: complex, u: NDArray[Any]) -> list[Any] | None:
    """v with u'v = 1 and the eigenvalue, n + 1 balls, near to u and that of doubles; None if not proved.

    Entries of A (n, n) that are rounding of its norm may be anything up to their size.
    """
    n = len(A)
    with flint.ctx.workprec(_BITS):
        near = flint.acb_mat(A.astype(complex).tolist())
        all_near = with_rounding(A, EPS * n * float(np.linalg.norm(A)))
        left = flint.acb_mat([np.conj(u).astype(complex).tolist()])
        x = flint.acb_mat([[entry] for entry in [*u.tolist(), pole]])
        try:
            R = _derivative(near, x, left).inv().mid()  # once: it takes the longest
        except ZeroDivisionError:
            return None
        for _ in range(_REFINED):
            x = (x - R * _equation(near, x, left)).mid()
        first = X = -R * _equation(all_near, x, left)
        identity = flint.acb_mat(n + 1, n + 1, np.eye(n + 1).ravel().tolist())
        for _ in range(_INFLATED):
            X = flint.acb_mat(n + 1, 1, [_wider(entry) for entry in X.entries()])
            K = first + (identity - R * _derivative(all_near, x + X, left)) * X
            if X.contains(K):
                return list((x + K).entries())
            X = K
    return None


def with_rounding(a: Array, nothing: float = 0.0) -> Any:
    """A matrix of balls around entries with their rounding; those below `nothing` may be zero."""
    radii = np.where(np.abs(a) <= nothing, 1.0, ROUNDING) * np.abs(a)
    entries = zip(a.astype(complex).ravel().tolist(), radii.ravel().tolist(), strict=True)
    balls = [flint.acb(flint.arb(x.real, r), flint.arb(x.imag, r if x.imag else 0)) for x, r in entries]
    rows, columns = a.shape
    return flint.acb_mat(rows, columns, balls)


def _equation(A: Any, x: Any, left: Any) -> Any:
    """f (n + 1, 1) of an eigenpair x = (v, lambda)."""
    n = A.nrows()
    v, pole = flint.acb_mat(n, 1, x.entries()[:n]), x[n, 0]
    return flint.acb_mat(n + 1, 1, [*(A * v - v * pole).entries(), (left * v)[0, 0] - 1])


def _derivative(A: Any, x: Any, left: Any) -> Any:
    """J (n + 1, n + 1)."""
    n = A.nrows()
    rows = [[A[i, j] - (x[n, 0] if i == j else 0) for j in range(n)] + [-x[i, 0]] for i in range(n)]
    return flint.acb_mat([*rows, [*left.entries(), 0]])


def _wider(ball: Any) -> Any:
    """A ball around zero that is twice as large as what contains another one."""
    size = 2 * abs(ball).upper()
    return flint.acb(flint.arb(0, size), flint.arb(0, size))


Names = str | Sequence[str] | None  # of channels; None: all
Stability = Literal["stable", "marginal", "unstable"]
_ZERO = 1e-5  # of the size of A: how far rounding may move three poles from zero
_CLEAR = 10.0  # times what rounding does to a pole, to first order: then its side is clear


def samples_at(system: System, values: Mapping[str, ArrayLike] | None = None) -> StateMatrices:
    """A (N, nx, nx), B (N, nx, nu), C (N, ny, nx), D (N, ny, nu) at physical values by name.

    The states are scaled by powers of 2, which are those of the nominal A for every sample: so a sample
    has the same digits alone and among others. N is 1 for numbers.
    """
    matrices = [
        matrix if matrix.ndim == 3 else matrix[None] for matrix in matrices_at(system, values or {})
    ]
    scale = balancing(system.A)
    A, B, C, D = matrices
    return StateMatrices(A * (scale / scale[:, None]), B / scale[:, None], C * scale, D)


def chosen(model: str, kind: str, names: Names, signals: Sequence[Signal], what: str) -> list[int]:
    """Numbers of the signals of these names; of all of them without names. An error if there are none."""
    known = [signal.name for signal in signals]
    asked = [names] if isinstance(names, str) else known if names is None else list(names)
    if not asked:
        raise AnalysisError(
            f"model {model!r}: without {kind}s there are no {what}. Choose some in [linearize]."
        )
    for name in asked:
        if name not in known:
            raise AnalysisError(f"model {model!r}: " + unknown_name(kind, str(name), known))
    return [known.index(name) for name in asked]


def transfers_at(
    system: System, values: Mapping[str, ArrayLike] | None, outputs: Names, inputs: Names, what: str
) -> StateMatrices:
    """As `samples_at`, with some of the outputs and inputs; `what` is computed of them."""
    rows = chosen(system.name, "output", outputs, system.outputs, what)
    columns = chosen(system.name, "input", inputs, system.inputs, what)
    A, B, C, D = samples_at(system, values)
    return StateMatrices(A, B[:, :, columns], C[:, rows], D[:, rows][:, :, columns])


class Spectrum(NamedTuple):
    """Poles (n,) of one matrix A, in rad/s.

    A change of A by rounding may bring those `on_axis` onto the imaginary axis: their side is not known.
    It may bring those `at_zero` to zero, as of an integrator; they are on the axis, too.
    """

    poles: NDArray[np.complex128]
    on_axis: NDArray[np.bool_]
    at_zero: NDArray[np.bool_]

    @property
    def stability(self) -> Stability:
        """``"unstable"``: a pole is right of the axis; ``"marginal"``: on it, and none is right."""
        if np.any((self.poles.real > 0.0) & ~self.on_axis):
            return "unstable"
        return "marginal" if np.any(self.on_axis) else "stable"

    @property
    def worst(self) -> complex:
        """The pole farthest right, the real part of those on the axis being zero; -inf without poles."""
        if not len(self.poles):
            return complex(-np.inf)
        cleaned = self.cleaned
        return complex(cleaned[np.argmax(cleaned.real)])

    @property
    def cleaned(self) -> NDArray[np.complex128]:
        """The poles without what rounding has left of real parts on the axis, and of zero."""
        poles = np.where(self.on_axis, 1j * self.poles.imag, self.poles)
        return np.where(self.at_zero, 0.0, poles)


@arguments_checked
def poles(system: System, values: Mapping[str, ArrayLike] | None = None) -> NDArray[np.complex128]:
    """Eigenvalues of A at samples of the parameters.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal

    Returns
    -------
    complex array (N, nx), rad/s
        Of each sample by size; a pair has its positive frequency first. N = 1 for numbers.
    """
    return eigenvalues(samples_at(system, values).A, system.name)


def eigenvalues(A: Array, name: str) -> NDArray[np.complex128]:
    """Sorted eigenvalues (N, n) of matrices A (N, n, n) of a model of this name."""
    try:
        poles = eigenvalues_of(A).astype(complex)
    except np.linalg.LinAlgError:
        raise AnalysisError(
            f"model {name!r}: the eigenvalues of A were not found. Scale the states, or choose other "
            "values of the parameters."
        ) from None
    order = np.lexsort((-poles.imag, poles.real, np.abs(poles)))
    return np.take_along_axis(poles, order, axis=-1)


def spectrum(A: Array) -> Spectrum:
    """Poles of one matrix A (n, n), and which of them rounding does not let tell from the axis.

    They are those of the diagonal blocks of states that depend on each other, in which A is block
    triangular: exactly, as its zeros are. So integrators are exactly at zero.
    """
    import scipy.sparse  # here because it is slow to import
    from scipy.sparse import csgraph

    _, labels = csgraph.connected_components(scipy.sparse.csr_matrix(A != 0.0), connection="strong")
    blocks = [np.flatnonzero(labels == k) for k in range(int(np.max(labels, initial=-1)) + 1)]
    spectra = [_of_block(A[np.ix_(block, block)]) for block in blocks]
    none = np.zeros(0, dtype=bool)
    empty = Spectrum(np.zeros(0, dtype=complex), none, none)
    poles, on_axis, at_zero = (np.concatenate(rows) for rows in zip(empty, *spectra, strict=True))
    order = np.lexsort((-poles.imag, poles.real, np.abs(poles)))
    return Spectrum(poles[order], on_axis[order], at_zero[order])


def _of_block(A: Array) -> Spectrum:
    """The spectrum of a block of states that depend on each other.

    A pole is on the axis if A - j omega I at its frequency omega has a singular value of the size of the
    rounding of A, so that a matrix so near to A has the pole j omega, and if balls do not tell its side
    for all matrices whose entries are as near. Double poles are judged rightly, too.
    """

    poles, U, V = eigenvectors_of(A)
    order = np.lexsort((-poles.imag, poles.real, np.abs(poles)))
    poles, U, V = poles[order], U[:, order], V[:, order]
    norm = float(np.linalg.norm(A))
    rounding = ROUNDING * len(A) * norm
    overlap = np.abs(np.sum(np.conj(U) * V, axis=0))
    unclear = np.abs(poles.real) * overlap <= _CLEAR * rounding
    reversible = bool(np.any(unclear)) and _is_reversible(A)
    for k in np.flatnonzero(unclear):
        if k and poles[k] == np.conj(poles[k - 1]):
            unclear[k] = unclear[k - 1]
            continue
        shifted = A - 1j * poles[k].imag * np.eye(len(A))
        # the least singular value is no larger than |(A - j omega I) v| of a unit vector v
        seen = float(np.linalg.norm(shifted @ V[:, k])) <= rounding
        unclear[k] = seen or np.linalg.svd(shifted, compute_uv=False)[-1] <= rounding
        # poles s and -conj(s) that are different are beside each other, no nearer than `eig` is exact
        apart = np.abs(poles - poles[k]) * overlap[k]
        beside = np.any((apart > ROUNDING * norm) & (apart <= 4.0 * _CLEAR * rounding))
        if unclear[k] and not (reversible and poles[k].imag and not beside):
            pair = eigenpair(A, complex(poles[k]), V[:, k])
            unclear[k] = pair is None or pair[-1].real.contains(0)
    small = unclear & (np.abs(poles) <= _ZERO * norm)
    if np.any(small):
        small &= bool(np.linalg.svd(A, compute_uv=False)[-1] <= rounding)
    return Spectrum(poles, unclear, small)


def _is_reversible(A: Array) -> bool:
    """Whether D A D = -A for signs D: with s, -conj(s) is an eigenvalue; those alone are on the axis.

    That depends on which entries of a block are zero only, so it holds for all matrices that are near:
    balls need not be asked for each pole of a model without damping, which takes long.
    """
    from scipy.sparse import csgraph, csr_matrix  # here because it is slow to import

    order, before = csgraph.breadth_first_order(csr_matrix(A != 0.0), 0, directed=False)
    signs = np.ones(len(A))
    for state in order[1:]:
        signs[state] = -signs[before[state]]
    return not np.any(A[np.equal.outer(signs, signs)])


def without_integrators(system: System, poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Poles (N, nx) without those at zero, in one row.

    As many as the nominal system has at zero are taken for the same at the samples, if they are small.
    """
    nominal = samples_at(system).A[0]
    seen, sizes = spectrum(nominal), np.abs(poles)
    small = _ZERO * float(np.linalg.norm(nominal))
    zero = (sizes <= small) & (np.arange(sizes.shape[1]) < np.sum(seen.at_zero))
    return poles[~zero & (sizes > 0.0)]


def pole_text(pole: complex) -> str:
    """A pole, or a pair, with its unit."""
    pair = f" +- {abs(pole.imag):.6g}j" if pole.imag else ""
    return f"{pole.real:.6g}{pair} rad/s"


class ModeRow(NamedTuple):
    """A real pole, or a conjugate pair, of one sample.

    Attributes
    ----------
    pole : rad/s; of a pair the one with positive frequency
    natural_frequency : its size, rad/s
    frequency : the same, Hz
    damping : -real part / size [1]; nan for a pole at zero
    time_constant : -1 / real part, s; negative if it grows, infinite on the axis
    on_axis : rounding does not let it be told from a pole on the imaginary axis
    """

    pole: complex
    natural_frequency: float
    frequency: float
    damping: float
    time_constant: float
    on_axis: bool


@dataclass(frozen=True, slots=True, eq=False)
class DampingTable:
    """Poles at N samples with their natural frequencies, damping and time constants, all (N, nx).

    Attributes
    ----------
    name : of the model
    A : array (N, nx, nx), states scaled
    poles : complex array, rad/s
        Sorted as by `poles`; the other arrays are in the same order.
    """

    name: str
    A: Array
    poles: NDArray[np.complex128]

    @property
    def natural_frequency(self) -> Array:
        """Sizes of the poles, rad/s."""
        return np.abs(self.poles)

    @property
    def frequency(self) -> Array:
        """Natural frequencies, Hz."""
        return np.abs(self.poles) / (2.0 * math.pi)

    @property
    def damping(self) -> Array:
        """Damping ratios [1]: -real part / size; nan for poles at zero."""
        with np.errstate(invalid="ignore"):
            return np.asarray(0.0 - self.poles.real / np.abs(self.poles))

    @property
    def time_constant(self) -> Array:
        """Time constants -1 / real part, s: negative if it grows, infinite on the axis."""
        with np.errstate(divide="ignore"):
            return np.where(self.poles.real == 0.0, np.inf, -1.0 / self.poles.real)

    def stability(self, sample: int = 0) -> Stability:
        """``"stable"``, ``"marginal"`` (a pole is on the axis, to rounding) or ``"unstable"``."""
        return spectrum(self.A[self._checked(sample)]).stability

    def rows(self, sample: int = 0) -> tuple[ModeRow, ...]:
        """Real poles and pairs of one sample, slowest first."""
        modes = spectrum(self.A[self._checked(sample)])
        kept = (modes.cleaned.imag >= 0.0) | ~np.isin(modes.cleaned.conj(), modes.cleaned)
        table = replace(self, poles=modes.cleaned[kept])
        columns = table.natural_frequency, table.frequency, table.damping, table.time_constant
        rows = zip(table.poles, *columns, modes.on_axis[kept], strict=True)
        return tuple(ModeRow(*(value.item() for value in row)) for row in rows)

    def __str__(self) -> str:
        head = "pole (rad/s)              natural (rad/s)   (Hz)        damping    time constant (s)"
        more = f", the first of {len(self.poles)} samples" if len(self.poles) > 1 else ""
        lines = [f"{self.name}: poles{more}", head]
        return "\n".join([*lines, *("  ".join(cells(row)) for row in self.rows())])

    def _checked(self, sample: int) -> int:
        if not -len(self.A) <= sample < len(self.A):
            raise AnalysisError(
                f"model {self.name!r}: there is no sample {sample} in a table of {len(self.A)}."
            )
        return sample


@arguments_checked
def damping_table(system: System, values: Mapping[str, ArrayLike] | None = None) -> DampingTable:
    """Natural frequency |p|, damping -Re p / |p| and time constant -1 / Re p of each pole p.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
        Such as `random`, `corners` or `grid` of mbdlft.base make them. Without values: nominal.
    """
    A = samples_at(system, values).A
    return DampingTable(system.name, A, eigenvalues(A, system.name))


def cells(row: ModeRow) -> tuple[str, str, str, str, str]:
    """A row as texts: pole, natural frequency in rad/s and in Hz, damping, time constant."""
    real, imaginary = row.pole.real, row.pole.imag
    pair = f" +- {imaginary:.6g}j" if imaginary else ""
    growth = "on the axis" if row.on_axis else f"{row.time_constant:.6g}"
    if not row.on_axis and row.time_constant < 0.0:
        growth = f"grows, {-row.time_constant:.6g}"
    damping = f"{row.damping:.4g}" if row.natural_frequency else "-"
    size, hertz = f"{row.natural_frequency:.6g}", f"{row.frequency:.6g}"
    first = f"{real:.6g}{pair}"
    return first.ljust(24), size.ljust(16), hertz.ljust(10), damping.ljust(9), growth


def balancing(A: Array) -> Array:
    """Powers of 2, d (n,), that make rows and columns of diag(d)^-1 A diag(d) similar in size.

    First entries are brought as near to each other as least squares of their logarithms do it: this does
    not depend on the units of the states, however weakly they are coupled. Then rows and columns whose
    sums differ are (Parlett and Reinsch, Numerische Mathematik 13, 1969, section 2; in the 1-norm).
    """
    size = np.abs(A)
    np.fill_diagonal(size, 0.0)
    scale = _leveling(size)
    size *= scale / scale[:, None]
    for _ in range(30):
        moved = False
        for k in range(len(A)):
            column, row = size[:, k].sum(), size[k].sum()
            if not (0.0 < column < np.inf and 0.0 < row < np.inf):
                continue
            factor = 2.0 ** round(0.5 * float(np.log2(row / column)))
            if column * factor + row / factor < 0.95 * (column + row):
                size[:, k] *= factor
                size[k] /= factor
                scale[k] *= factor
                moved = True
        if not moved:
            break
    return scale


def _leveling(size: Array) -> Array:
    """Powers of 2 near t that minimize the sum of (log size_ij + log t_j - log t_i)^2."""
    there = np.isfinite(size) & (size > 0.0)
    logarithms = np.log2(size, out=np.zeros(size.shape), where=there)
    counts = np.diag(np.sum(there, axis=0) + np.sum(there, axis=1)) - there - there.T.astype(float)
    excess = np.sum(logarithms, axis=1) - np.sum(logarithms, axis=0)
    scale: Array = np.exp2(np.round(np.linalg.lstsq(counts, excess)[0]))
    return scale
