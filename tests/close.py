"""The only place with tolerances: a comparison names the class of its evidence. NaN always fails."""

import numpy as np
from numpy.typing import ArrayLike

EPS = float(np.finfo(float).eps)
_ROUNDOFF = (
    200.0  # times eps, condition and scale; right results stay far below, wrong ones far above
)

# the targets of the project, as promised in the README
CLOSED_FORM = 1e-12
FREQUENCY_RESPONSE = 1e-10
SCENARIO = 1e-11

# a mesh of eight quintic elements against a closed form: its first three frequencies
FINITE_ELEMENTS = 1e-5
# stiff elastic models with all their sizes as parameters
LAMINATE = 1e-5
# matrices of a finite-element mesh after solves with them: what their condition leaves
BALANCE = 1e-8

# how much a guaranteed bound may be above a largest value that is known
BOUND = 0.02


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


def roundoff(
    actual: ArrayLike, expected: ArrayLike, kappa: float = 1.0, scale: float | None = None
) -> None:
    """An algebraic identity in float64; `kappa` is the condition number of the solve involved."""
    found = error(actual, expected, scale)
    assert found <= _ROUNDOFF * EPS * max(kappa, 1.0), f"relative error {found:.2e}"


def target(
    actual: ArrayLike, expected: ArrayLike, bound: float, scale: float | None = None
) -> None:
    """A promised relative error, one of the names above."""
    found = error(actual, expected, scale)
    assert found <= bound, f"relative error {found:.2e}, promised {bound:.0e}"


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
