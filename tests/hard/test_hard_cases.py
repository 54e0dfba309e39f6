"""No hard case is silently wrong: the error is that of the condition, or the scene is refused."""

import mpmath as mp
import numpy as np
import pytest

import mbdlft
from benchmarks.cases import hard
from benchmarks.cases.digits import DIGITS
from benchmarks.cases.measure import measure
from mbdlft.order.reduction import ExactLFT, reduce_order
from tests.close import EPS, HARD, HARD_CHAIN, HARD_NUMERIC, conditioned
from tests.extracted import eliminated_in_doubles, exactly


@pytest.mark.long
@pytest.mark.parametrize("case", hard.CASES, ids=lambda case: case.name)
def test_entries_against_50_digits(case: hard.Case) -> None:
    found = measure(case)
    assert found.lft_factor <= HARD, found
    assert found.numeric_factor <= HARD_NUMERIC, found
    # nothing is silently wrong: the certificate has the error, or the condition that explains it
    assert found.unstated <= HARD, found
    assert found.condition <= HARD * found.stated or found.sign_changes, found


@pytest.mark.long
@pytest.mark.parametrize("case", hard.LARGE, ids=lambda case: case.name)
def test_large_cases(case: hard.Case) -> None:
    test_entries_against_50_digits(case)


@pytest.mark.long
@pytest.mark.parametrize("inverted", [False, True])
def test_long_chains_keep_the_digits_of_their_data(inverted: bool) -> None:
    assert measure(hard.long_chain(20, inverted=inverted)).lft_factor <= HARD_CHAIN


@pytest.mark.long
def test_a_chain_that_is_solved_in_double_precision_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: the mass matrix at nominal is solved with as if its condition did not matter."""
    monkeypatch.setattr("mbdlft.pipeline.forms.eliminated", eliminated_in_doubles)
    assert measure(hard.long_chain(20)).lft_factor > HARD_CHAIN


@pytest.mark.parametrize("case", [hard.collinear(1e-12), hard.wide(99.99)], ids=lambda case: case.name)
def test_a_condition_that_is_not_stated_is_seen(case: hard.Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: the certificate takes every problem for well conditioned."""
    monkeypatch.setattr("mbdlft.pipeline.certification.conditioning", lambda *_: (1.0, 0))
    found = measure(case)
    assert found.condition > HARD * found.stated


def test_a_change_of_sign_that_is_not_stated_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: entries that change their sign are not counted."""
    right = mbdlft.pipeline.certification.conditioning
    monkeypatch.setattr("mbdlft.pipeline.certification.conditioning", lambda *p: (right(*p)[0], 0))
    found = measure(hard.bifurcation(1e-9))
    assert found.condition > HARD * found.stated


def test_a_reduction_that_loses_digits_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: a reduction of relations of 1 kg and 1e9 kg with seven digits."""

    def in_few_digits(a: ExactLFT) -> ExactLFT:
        b = reduce_order(a.rounded())
        parts = (x.astype(np.float32).astype(float) for x in (b.M11, b.M12, b.M21, b.M22))
        return exactly(mbdlft.LFT(*parts, b.blocks))

    monkeypatch.setattr("mbdlft.pipeline.certification.ACCEPTED", np.inf)
    monkeypatch.setattr("mbdlft.pipeline.certification.MOST_ROUNDINGS", 1e300)
    monkeypatch.setattr("mbdlft.pipeline.forms.reduce_exactly", in_few_digits)
    assert measure(hard.mass_ratio(1.0, 1e9)).lft_factor > HARD


def test_a_wrong_digit_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: an angle with a relative error of 1e-12."""
    reading = mbdlft.base.parameter.to_delta
    monkeypatch.setattr(
        "mbdlft.system.sampled.to_delta", lambda p, x: reading(p, np.asarray(x) * (1.0 + 1e-12))
    )
    assert measure(hard.mass_ratio(1e9, 1.0)).lft_factor > HARD


def test_a_mass_matrix_that_double_precision_does_not_carry_is_solved_with() -> None:
    """Links of a micrometer at one of a kilometer: the certificate states the condition of the data."""
    found = measure(hard.sizes(1e-6, 1.0))
    assert found.lft < 1e-14, found
    assert found.stated * EPS > 1.0, found


def test_a_range_to_the_singular_point_is_refused() -> None:
    with pytest.raises(mbdlft.SceneError, match="substitution = 'quarter-angle'"):
        hard.half_angle(hard.NEAR)


@pytest.mark.parametrize("distance", [1e-2, hard.NEAR, 0.0, -hard.NEAR])
def test_the_quarter_angle_passes_the_singular_point_of_the_half_angle(distance: float) -> None:
    found = measure(hard.half_angle(distance, "quarter-angle"))
    assert found.lft_factor <= HARD, found


@pytest.mark.parametrize("distance", [1e-4, 1e-8, 1e-12, -1e-12])
def test_nearly_defective_poles(distance: float) -> None:
    """s^2 + c s + k with c near 2 sqrt(k): the condition of the poles is 1/|y'x|."""
    damping = 2.0 * (1.0 + distance)
    model = mbdlft.to_lft(hard.oscillator(damping), search=0.0)
    A = mbdlft.matrices_at(model, {"m": 1.0}).A
    poles = np.sort_complex(np.linalg.eigvals(A))
    with mp.workdps(DIGITS):
        c = mp.mpf(damping)
        root = mp.sqrt(c * c / 4 - 1)
        exact = [-c / 2 - root, -c / 2 + root]
        kappas = [(1 + abs(s) ** 2) / abs(s**2 - 1) for s in exact]
        expected = np.sort_complex(np.array([complex(s) for s in exact]))
    conditioned(poles, expected, float(max(kappas)) * np.linalg.norm(A))


@pytest.mark.parametrize("mass", [1e-3, 1e-6, 1e-9, 1e-12])
def test_a_pole_that_a_zero_nearly_cancels_stays(mass: float) -> None:
    """A light absorber: at its own frequency the transfer has a zero beside a pole."""
    model = mbdlft.to_lft(hard.absorber(mass), search=0.0)
    assert len(model.states) == 4
    omega = 1.0 + 1e-7
    at = {"m": 1.07}
    response = mbdlft.frequency_response(model, at, [omega])[..., 0, 0].ravel()[0]

    def exact(m: mp.mpf, k: mp.mpf, small: mp.mpf, spring: mp.mpf, w: mp.mpf) -> mp.mpf:
        return (spring - small * w**2) / (
            (k + spring - (m + small) * w**2 + small * w**2) * (spring - small * w**2) - spring**2
        )

    with mp.workdps(DIGITS):
        data = [mp.mpf(value) for value in (1.07, 2.0, mass, mass, omega)]
        value, step = exact(*data), mp.mpf(2) ** -80
        moved = [exact(*(x * (1 + step) if i == k else x for i, x in enumerate(data))) for k in range(5)]
        kappa = float(sum(abs(other / value - 1) for other in moved) / step)
        expected = complex(value)
    conditioned(response, expected, kappa)


@pytest.mark.parametrize("imperfection", [1e-3, 1e-6, 1e-9])
def test_an_equilibrium_close_to_a_bifurcation(imperfection: float) -> None:
    """k (q - e) = m g sin q with k = m g: q - sin q = e, of condition e/(q (1 - cos q)) and more."""
    point = mbdlft.find_equilibrium(hard.sagging(imperfection))
    found = point.positions["pivot.angle"]
    with mp.workdps(DIGITS):
        k, load, e = mp.mpf(-hard.GRAVITY[2]), mp.mpf(-hard.GRAVITY[2]), mp.mpf(imperfection)
        start = mp.cbrt(6 * e)
        q = mp.findroot(lambda t: k * (t - e) - load * mp.sin(t), start)
        kappa = float((abs(k * (q - e)) * 2 + abs(k * e)) / abs(q * (k - load * mp.cos(q))))
        expected = float(q)
    conditioned(found, expected, kappa)
    assert kappa * EPS < 1.0
