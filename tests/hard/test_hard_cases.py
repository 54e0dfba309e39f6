"""No hard case is silently wrong: the error is that of the condition, or the scene is refused."""

from itertools import pairwise, product

import mpmath as mp
import numpy as np
import pytest

import mbdlft
from benchmarks.cases import hard
from benchmarks.cases.digits import DIGITS
from benchmarks.cases.measure import measure
from benchmarks.scaling import SHAPES, expected, families, figure, slope, table
from benchmarks.scaling import measure as measured
from mbdlft import (
    AnalysisError,
    Inertia,
    Parameter,
    RigidBody,
    frequency_response,
    hinf_norm,
    poles,
    response_frequencies,
    step_response,
)
from mbdlft.exact.numbers import BITS, precision
from mbdlft.matrix import MatrixProblem
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.order import lower_bound
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.work import Work
from mbdlft.pipeline import forms
from mbdlft.pipeline.forms import candidates
from tests.close import (
    CLOSED_FORM,
    EPS,
    HARD,
    HARD_CHAIN,
    HARD_NUMERIC,
    PEAK,
    RESPONSE,
    conditioned,
    poles_by_qr,
    target,
)
from tests.errors.scenes import cart
from tests.extracted import eliminated_in_doubles
from tests.oscillators import plain
from tests.seeds import some

QUICK = 0, 1, 10, 13, 14  # planted bugs die of these


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=case.name, marks=[] if k in QUICK else pytest.mark.long)
        for k, case in enumerate((*hard.CASES, *hard.LARGE))
    ],
)
def test_entries_against_50_digits(case: hard.Case) -> None:
    found = measure(case)
    assert found.lft_factor <= HARD, found
    assert found.numeric_factor <= HARD_NUMERIC, found
    # nothing is silently wrong: the certificate has the error, or the condition that explains it
    assert found.unstated <= HARD, found
    assert found.condition <= HARD * found.stated or found.sign_changes, found


@pytest.mark.long
@pytest.mark.parametrize("inverted", [False, True])
def test_long_chains_keep_the_digits_of_their_data(inverted: bool) -> None:
    assert measure(hard.long_chain(20, inverted=inverted)).lft_factor <= HARD_CHAIN


@pytest.mark.long
def test_a_chain_that_is_solved_in_double_precision_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: the mass matrix at nominal is solved with as if its condition did not matter."""
    monkeypatch.setattr("mbdlft.pipeline.forms.eliminated", eliminated_in_doubles)
    assert measure(hard.long_chain(20)).lft_factor > HARD_CHAIN


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


# Poles, responses and norms of hard cases against 50 digits: near poles, little damping, bad scales.

DIGITS_OF_RESPONSES = 50


def two_modes(damping: float, apart: float, scale: float) -> tuple[np.ndarray, ...]:
    """Masses 1 and 1 between springs 1, apart and 1, states in units that differ by `scale`."""
    k = np.array([[1.0 + apart, -apart], [-apart, 1.0 + apart]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-k, -2.0 * damping * k]])
    units = np.array([1.0, scale, 1.0 / scale, 1.0])
    B, C = np.array([[0.0], [0.0], [1.0], [0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]])
    return A * units[:, None] / units, B * units[:, None], C / units


@pytest.mark.parametrize("damping", [1e-2, 1e-4])
@pytest.mark.parametrize("apart", [0.5, 1e-6])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_poles_have_the_digits_of_their_condition(damping: float, apart: float, scale: float) -> None:
    """In units of masses and springs, whatever those of the states."""
    A, B, C = two_modes(damping, apart, scale)
    even = two_modes(damping, apart, 1.0)[0]
    found = poles(plain(A, B, C))[0]
    with mp.workdps(DIGITS_OF_RESPONSES):
        expected = mp.eig(mp.matrix(A.tolist()), left=False, right=False)
        sizes, left, right = mp.eig(mp.matrix(even.tolist()), left=True, right=True)
        left, right = (np.array(x.tolist(), dtype=complex) for x in (left.H, right))
        errors, sizes = poles_by_qr(even, left, right), np.array(sizes, dtype=complex)
        for value in map(complex, expected):
            nearest = found[np.argmin(np.abs(found - value))]
            target(nearest, value, float(errors[np.argmin(np.abs(sizes - value))]) / abs(value))


@pytest.mark.parametrize("damping", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_peaks_of_near_modes_in_50_digits(damping: float, scale: float) -> None:
    """Two modes a hundredth apart: the highest value at the chosen frequencies is the peak."""
    A, B, C = two_modes(damping, 0.01, scale)
    system = plain(A, B, C)
    omega = response_frequencies(system)
    found = np.abs(frequency_response(system, {}, omega))[0, :, 0, 0]
    k = int(np.argmax(found))
    with mp.workdps(DIGITS_OF_RESPONSES):

        def gain(w: mp.mpf) -> mp.mpf:
            shifted = mp.mpc(0, 1) * w * mp.eye(4) - mp.matrix(A.tolist())
            return abs((mp.matrix(C.tolist()) * mp.lu_solve(shifted, mp.matrix(B.tolist())))[0])

        target(found[k], float(gain(mp.mpf(omega[0, k]))), RESPONSE)
        low, high = mp.mpf(omega[0, k - 1]), mp.mpf(omega[0, k + 1])
        for _ in range(60):  # the gain has one peak between neighbors: golden section
            span = (high - low) * (mp.sqrt(5) - 1) / 2
            if gain(high - span) > gain(low + span):
                high = low + span
            else:
                low = high - span
        peak = gain((low + high) / 2)
        target(found[k], float(peak), PEAK)
        norm = hinf_norm(system)
        assert norm.lower[0] <= float(peak) * (1.0 + RESPONSE)
        assert norm.upper[0] >= float(peak) * (1.0 - RESPONSE)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_steps_of_badly_scaled_systems_in_50_digits(scale: float) -> None:
    A, B, C = two_modes(1e-4, 0.5, scale)
    times = np.array([0.0, 0.5, 7.0, 100.0])
    found = step_response(plain(A, B, C), {}, times).values[0, :, 0, 0]
    with mp.workdps(DIGITS_OF_RESPONSES):
        matrix = mp.matrix(A.tolist())
        settled = mp.lu_solve(matrix, mp.matrix(B.tolist()))
        expected = [
            float((mp.matrix(C.tolist()) * (mp.expm(matrix * t) - mp.eye(4)) * settled)[0])
            for t in map(float, times)
        ]
    target(found, expected, RESPONSE)


def test_poles_of_scaled_integrators_are_exactly_zero() -> None:
    A = np.zeros((3, 3))
    A[0, 1], A[1, 2], A[2, 2] = 1e6, 1e-6, -1e3
    found = poles(plain(A, [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]]))[0]
    target(np.sort(found.real), [-1e3, 0.0, 0.0], CLOSED_FORM)


# Hundreds of parameters in one body or one entry: a model in seconds, or a reason why there is none.


def numbered(count: int, unit: str = "1") -> list[Parameter]:
    return [Parameter(f"p{k}", 1.0, percent=10, unit=unit) for k in range(count)]


def products(parameters: list[Parameter]) -> str:
    """p0 p1 + p1 p2 + ..."""
    return " + ".join(f"{p.name}*{q.name}" for p, q in pairwise(parameters))


def test_more_than_may_be_that_the_model_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """And those that it does not depend on are not counted."""
    assert forms._MOST_PARAMETERS == 1000
    monkeypatch.setattr(forms, "_MOST_PARAMETERS", 100)
    many = numbered(110, "kg")
    with pytest.raises(AnalysisError, match=r"'cart_on_rail': depends on 110 parameters; at most 100"):
        mbdlft.to_lft(cart(" + ".join(p.name for p in many), many))
    with pytest.raises(AnalysisError, match="depends on 110 parameters"):
        mbdlft.realize([[" + ".join(p.name for p in numbered(110))]], numbered(110))
    many = numbered(110, "m")
    ports = {f"port{k}": (p.name, 0, 0) for k, p in enumerate(many)}
    body = RigidBody(name="b", mass=2.0, inertia=Inertia(xx=1, yy=1, zz=1), ports=ports)
    scene = cart("1", many).model_copy(update={"bodies": (body,)})
    joint = scene.joints[0].model_copy(update={"child": "b"})
    model = mbdlft.to_lft(scene.model_copy(update={"joints": (joint,)}), search=0.0)
    assert (model.order, len(model.parameters)) == (0, 110)


def test_products_of_forty_with_a_search() -> None:
    """The box of monomials has 2^40 coefficients, and there are 9,880 triples."""
    many = numbered(40)
    model = mbdlft.realize([[products(many)]], many)
    assert model.certificate.order_bound == 40
    values = {p.name: 1.0 + 0.1 * (-1) ** k for k, p in enumerate(many)}
    expected = sum(values[p.name] * values[q.name] for p, q in pairwise(many))
    target(model.at(**values).D, np.array([[expected]]), CLOSED_FORM)


def test_looks_at_pairs_and_triples_are_counted() -> None:
    many = numbered(40)
    with precision(BITS):
        problem = problem_of_matrix(
            MatrixProblem(name="products", matrix=[[products(many)]], parameters=many)
        )
        (candidate,) = candidates(problem, problem.forms[:1])
        bound = JointBound(candidate.exact, exact_degrees(candidate.exact))
        before, work = lower_bound._reduced.cache_info().misses, Work(0.05)
        bound.of_all(work)
        assert work.is_over
        assert lower_bound._reduced.cache_info().misses - before < 0.1 * 1.5e10 / 5e6


# The scaling benchmark at its smallest: verified rows, and exponents of what is known.


@pytest.mark.parametrize(
    ("shape", "few"), some([*product(SHAPES, [True]), ("star", False)], product(SHAPES, [False]))
)
def test_rows_are_verified(shape: str, few: bool, tmp_path) -> None:  # type: ignore[no-untyped-def]
    rows = [measured(shape, count, few) for count in (3, 4)]
    assert len(families(rows)) == 1
    assert all(row["bound"] <= row["order"] <= row["raw"] for row in rows)
    assert all(row["parameters"] == (5 if few else 3 * row["bodies"]) for row in rows)
    assert table(rows).count("\n") > len(rows)
    if shape == "star" and few:
        figure(tmp_path / "figure.png", rows)


def test_slope_of_a_power() -> None:
    counts = [10, 20, 40]
    conditioned(slope(counts, [3.0 * n**2.5 for n in counts]), 2.5, 10.0)


def test_what_the_next_member_takes() -> None:
    family = [{"bodies": n, "seconds": 0.01 * n**3} for n in (10, 20)]
    conditioned(expected(family, 40), 640.0, 10.0)
    assert expected(family[:1], 40) == 0.0


def test_a_wrong_model_is_not_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: nothing is accurate enough."""
    monkeypatch.setattr("benchmarks.scaling._ACCEPTED", 0.0)
    with pytest.raises(SystemExit, match="error"):
        measured("star", 3, True)
