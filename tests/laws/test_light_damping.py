"""Poles beside the axis: damped if the matrix says so; norms against 60 digits where damping is 1e-9."""

import numpy as np
import pytest

import mbdlft
from mbdlft import hinf_norm
from mbdlft.response.modes import eigenpair, samples_at, spectrum
from tests.close import NORM, target
from tests.light import FINITE, free_flyer, peak_of_60_digits


@pytest.mark.parametrize("seed", range(6))
def test_norms_of_free_flyers_against_60_digits(seed: int) -> None:
    """Eight channels each: finite where no pole on the axis is seen, and right to 1e-6."""
    system = free_flyer(seed)
    poles = spectrum(samples_at(system).A[0]).poles
    for (y, u), is_finite in FINITE.items():
        found = hinf_norm(system, outputs=y, inputs=u)
        assert np.isfinite(found.lower[0]) == is_finite, (y, u, found.reason)
        if is_finite:
            expected = peak_of_60_digits(seed, y, u, poles)
            target(found.lower[0], expected, NORM)
            assert found.upper[0] >= expected * (1.0 - 1e-9)


@pytest.mark.parametrize("fastest", [0.0, 1e5])
@pytest.mark.parametrize("seed", range(3))
def test_a_damped_nutation_is_nowhere_on_the_axis(seed: int, fastest: float) -> None:
    """Spectrum, table, verdict: a pair whose damping is below 1e-6, beside a mode of 1e5 rad/s, too."""
    system = free_flyer(seed, fastest)
    seen = spectrum(samples_at(system).A[0])
    nutation = int(np.argmin(np.where(seen.at_zero, np.inf, np.abs(seen.poles))))
    assert 0.0 < -seen.poles[nutation].real < 1e-6 * abs(seen.poles[nutation])
    assert not seen.on_axis[nutation]
    assert np.array_equal(seen.on_axis, seen.at_zero)
    rows = mbdlft.damping_table(system).rows()
    assert [row.on_axis for row in rows if row.natural_frequency > 0.0] == [False] * sum(
        row.natural_frequency > 0.0 for row in rows
    )
    verdict = mbdlft.check_stability(system)
    assert verdict.nominal == "marginal"
    assert "on the axis: 0 rad/s" in verdict.sentence


@pytest.mark.parametrize("n", [2, 5, 9])
def test_an_eigenpair_in_balls_has_that_of_all_matrices_so_near(n: int) -> None:
    """Matrices at the ends of rounding have their eigenvalue in the ball; double ones have no ball."""
    random = np.random.default_rng(n)
    A = random.standard_normal((n, n))
    values, V = np.linalg.eig(A)
    U = np.conj(np.linalg.inv(V)).T
    k = int(np.argmax(values.real))
    pair = eigenpair(A, complex(values[k]), V[:, k], U[:, k])
    assert pair is not None
    ends = A * (1.0 + 15.0 * 2.0**-52 * np.sign(random.standard_normal((n, n))))
    near = eigenpair(ends, complex(values[k]), V[:, k], U[:, k])
    assert near is not None
    assert pair[-1].contains(near[-1].mid())
    assert float(pair[-1].real.rad()) <= 1e-9
    jordan = np.diag(np.ones(n - 1), 1)
    assert eigenpair(jordan, 0j, np.eye(n)[0], np.eye(n)[0]) is None


def undamped(stiffness: np.ndarray) -> np.ndarray:
    nothing, one = np.zeros_like(stiffness), np.eye(len(stiffness))
    return np.block([[nothing, one], [-stiffness, nothing]])


def test_balls_are_asked_only_where_zeros_of_the_matrix_do_not_decide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Undamped chains, three of them equal; a slow saddle beside a fast mode is none on the axis."""
    asked = []

    def counted(*arguments):
        asked.append(arguments)
        return eigenpair(*arguments)

    monkeypatch.setattr("mbdlft.response.modes.eigenpair", counted)
    chain = 2.0 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    alike = np.kron(np.eye(3), chain) + 0.01 * np.kron(np.ones((3, 3)), np.eye(4))
    assert np.all(spectrum(undamped(alike)).on_axis)
    assert not asked
    saddle = spectrum(undamped(np.array([[-1e-4, 1e-3], [1e-3, 1e10]])))
    assert asked
    assert np.array_equal(saddle.on_axis, saddle.poles.imag != 0.0)
