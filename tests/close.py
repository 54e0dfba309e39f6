"""The only place with tolerances: a comparison names the class of its evidence. NaN always fails.

What the project promises stands in `benchmarks/targets.py`, and is had from here."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.targets import BALANCE as BALANCE
from benchmarks.targets import CLOSED_FORM as CLOSED_FORM
from benchmarks.targets import EPS as EPS
from benchmarks.targets import FREQUENCY_RESPONSE as FREQUENCY_RESPONSE
from benchmarks.targets import HARD as HARD
from benchmarks.targets import HARD_NUMERIC as HARD_NUMERIC
from benchmarks.targets import PINOCCHIO as PINOCCHIO
from benchmarks.targets import SCENARIO as SCENARIO

_ROUNDOFF = 200.0  # times eps, condition and scale; right results stay far below, wrong ones far above
# between a promise of rounding and what is measured: no kernel, compiler or build of numpy is near it
ROOM = 10.0


class Method(float):
    """A promise of what a method, mesh, table or other tool leaves, which no kernel changes."""

    def __rmul__(self, factor: float) -> "Method":
        return Method(factor * float(self))


EVALUATION = 1e-14
ONE_ROUNDING = ROOM * EPS  # times the number of roundings of half a unit, with room
MESH = Method(4e-2)  # extents of meshes that were thinned
PAGE = Method(1e-6)  # positions in a picture, and loads beside it
NOTHING = 1e-13  # of the largest entry: what is left of zeros
EXPORT = 1e-13  # values of files for other tools against `matrices_at`
ENCLOSURE = Method(5e-2)  # bounds of slopes over a range, beside the true extremes
MUJOCO = Method(1e-5)  # by finite differences
MECHANISM = 1e-9
CROSS = 1e-9  # against another tool
WRITTEN_ANGLE = Method(1e-9)  # of files: -1.570796327 is read as -90 deg, and by another tool as it is
# entries of M^-1 K of finite elements fall by many orders from the diagonal, and so do their digits
ELASTIC = 1e-5

# results of the literature on elastic systems
SPACECRAFT_TABLE = Method(2e-5)
ARM_TABLE = Method(1e-4)
LENGTH_TABLE = Method(1e-3)
MAST_TABLE = Method(3e-3)
KEPT = Method(1e-8)  # of a quantity that a motion of ten seconds keeps
SIMULATED = Method(1e-7)  # two simulations of the same equations
CORES = 1e-12  # values with the kernels of other processors
ATTACKED = 1e-11  # values of what is drawn by chance, of each entry
ACCELERATION = 1e-7  # of beams on a hub, of the largest of a row, against 50 digits
SAME_MESH = 1e-8
CHAIN = 1e-7
STABLE = 1e-6  # of the largest frequency: real parts of undamped poles that are rounding

# a mesh of eight quintic elements against a closed form: its first three frequencies
FINITE_ELEMENTS = Method(1e-5)
# stiff elastic models with all their sizes as parameters
LAMINATE = Method(1e-5)

# modes in place of elements: transfers around the first frequencies
TRUNCATED = Method(1e-9)
# beams against exact frequencies: four of a thick one, three of one that carries a load
THICK_BEAM = Method(2e-3)
LOADED_BEAM = Method(5e-3)
BENCHMARK = Method(5e-3)  # frequencies that NAFEMS publishes

# how much a guaranteed bound may be above a largest value that is known
BOUND = Method(0.02)
MU = Method(1e-6)  # structured singular values
FITTED = Method(1e-5)  # stiffnesses at positions that are fitted to 1e-7
REDUCED = Method(2e-2)  # loops with a controller of fewer states
FIT_BOUND = Method(0.2)


def exact(actual: ArrayLike, expected: ArrayLike) -> None:
    """Equal bits: names, structure, sizes, stored arrays."""
    a, b = np.asarray(actual), np.asarray(expected)
    assert a.shape == b.shape, f"shape {a.shape}, expected {b.shape}"
    assert np.array_equal(a, b), f"{actual!r} is not {expected!r}"


def error(actual: ArrayLike, expected: ArrayLike, scale: float | None = None) -> float:
    """Largest absolute difference over `scale`, by default the largest size of `expected`."""
    a, b = np.asarray(actual), np.asarray(expected)
    assert a.shape == b.shape, f"shape {a.shape}, expected {b.shape}"
    if not a.size:
        return 0.0
    size = float(np.max(np.abs(b))) if scale is None else scale
    difference = float(np.max(np.abs(a - b)))
    return difference / size if size > 0 else difference


def _kept(found: float, bound: float, promised: str) -> None:
    """An error is within a promise of rounding, with room for other kernels."""
    assert found <= bound, f"relative error {found:.2e}, {promised}"
    room = f"relative error {found:.2e} is within a factor of {ROOM:g} of {bound:.1e}"
    assert ROOM * found <= bound, f"{room}: another kernel may break the promise"


def roundoff(
    actual: ArrayLike, expected: ArrayLike, kappa: float = 1.0, scale: float | None = None
) -> None:
    """An algebraic identity in float64; `kappa` is the condition number of the solve involved."""
    _kept(error(actual, expected, scale), _ROUNDOFF * EPS * max(kappa, 1.0), f"condition {kappa:.1e}")


def target(actual: ArrayLike, expected: ArrayLike, bound: float, scale: float | None = None) -> None:
    """A promised relative error, one of the names above; promises of rounding keep their room."""
    found = error(actual, expected, scale)
    if isinstance(bound, Method):
        assert found <= bound, f"relative error {found:.2e}, promised {bound:.0e}"
    else:
        _kept(found, bound, f"promised {bound:.0e}")


def published(actual: float, printed: str) -> None:
    """A printed number: half a unit of its last digit."""
    mantissa = printed.lower().partition("e")[0]
    exponent = int(printed.lower().partition("e")[2] or 0)
    half = 0.5 * 10.0 ** (exponent - len(mantissa.partition(".")[2]))
    assert abs(actual - float(printed)) <= half * (1 + 1e-9), f"{actual} is not {printed}"


def finite_difference(actual: ArrayLike, expected: ArrayLike, scale: float | None = None) -> None:
    """Against a central difference with a step of eps^(1/3): accurate to eps^(2/3)."""
    found = error(actual, expected, scale)
    assert found <= 1e3 * EPS ** (2.0 / 3.0), f"relative error {found:.2e}"


# long chains, as `HARD`: solved with at nominal in exact numbers; in doubles it is 0.3
HARD_CHAIN = 0.1


def conditioned(actual: ArrayLike, expected: ArrayLike, kappa: float, factor: float = HARD) -> None:
    """A number whose relative condition is `kappa`: error within a small factor of kappa eps."""
    _kept(error(actual, expected), factor * EPS * kappa, f"condition {kappa:.1e}")


def poles_by_qr(A: ArrayLike, left: ArrayLike, right: ArrayLike) -> NDArray[np.float64]:
    """Absolute errors that the QR algorithm leaves in each eigenvalue of A (n, n), in balanced units.

    It finds eigenvalues of A + E, off by |y'E x|/|y'x| <= |E| |x| |y|/|y'x| with the columns x of `right`
    and y of `left`. |E| <= 21 n eps |A| (Frobenius): an entry is in 3 reflections from each side of some
    2 n double steps, and in n from each side before them: in 14 n, each with three roundings of half a
    unit. The last half a unit is of what is rounded to compare.
    """
    matrix, y, x = np.asarray(A), np.asarray(left), np.asarray(right)
    lengths = np.linalg.norm(x, axis=0) * np.linalg.norm(y, axis=0)
    condition = lengths / np.abs(np.sum(y.conj() * x, axis=0))
    return np.asarray((21.0 * len(matrix) + 0.5) * EPS * np.linalg.norm(matrix) * condition)


# zeros: eigenvalues of a pencil that is left after several rank decisions
ZEROS = 1e-8
# what figures and tables of responses promise: peaks within 0.1 dB; bounds of norms this far apart
PEAK = Method(10.0**0.005 - 1.0)
NORM = Method(1e-6)
# norms and responses over time of systems whose poles are well apart
RESPONSE = 1e-9
