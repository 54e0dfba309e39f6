"""Parameters that move: what is proved holds along all motions that are tried, and ends where it must."""

from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement, product
from unittest.mock import DEFAULT, Mock

import flint
import numpy as np
import pytest
from scipy.linalg import expm

import mbdlft
from mbdlft.base.parameter import to_delta, to_physical
from mbdlft.robust import ascent, gain
from mbdlft.robust.balls import is_positive
from mbdlft.robust.bisect.bernstein import at_nodes, binomials
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.bisect.search import INTERRUPTED
from mbdlft.robust.evidence import MotionProof, PolynomialProof
from mbdlft.robust.moving import polynomial, variation, varying
from mbdlft.robust.moving.motion import growth, unstable_motion
from mbdlft.robust.moving.varying import delta_rates
from mbdlft.robust.realization import realization
from tests import kit
from tests.close import BOUND, EPS, STABLE, exact, finite_difference, roundoff, target
from tests.laws.random_loops import random_system, reached, state_matrices
from tests.laws.test_margins import random_loop_with_channels
from tests.reference.robust_cases import discrete_pair, unit

WORK = 0.5  # that finds what the default finds


def oscillator(stiffness: str, damping: str = "1") -> mbdlft.System:
    matrix = [["0", "1"], [f"-({stiffness})", f"-({damping})"]]
    return mbdlft.realize(matrix, [unit("d")], states=2, inputs=[], outputs=[])


def test_a_proof_for_a_rate_is_none_for_twice_the_rate() -> None:
    d = mbdlft.Parameter("d", 1.0, 0.9, 1.1)  # rates of its delta are ten times its own
    matrix = [["0", "1"], ["-d", "-0.3"]]
    system = mbdlft.realize(matrix, [d], states=2, inputs=[], outputs=[])
    found = mbdlft.robust_stability(system, rates={"d": 0.02}, gap=0.1, work=WORK)
    assert isinstance(found.proof, MotionProof)
    assert mbdlft.verify(system, found) == ""
    assert "not negative" in mbdlft.verify(system, replace(found, rates={"d": 0.04}))


def test_one_quadratic_form_for_any_motion_is_the_circle_criterion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """x'' + x' + (3 + d) x: |d| below the least of |3 - w^2 + j w|, which is the root of 11/4."""
    higher = mbdlft.robust_stability(oscillator("3+d"), rates=np.inf, gap=0.1)
    assert 1.2 * np.sqrt(2.75) <= higher.lower <= higher.upper
    assert mbdlft.verify(oscillator("3+d"), higher) == ""
    monkeypatch.setattr(varying, "SHAPES", ())
    found = mbdlft.robust_stability(oscillator("3+d"), rates=np.inf, gap=0.005)
    assert 0.99 * np.sqrt(2.75) <= found.lower <= np.sqrt(2.75)


@pytest.mark.parametrize("rates", [{"k": np.inf, "m": 0.1}, {"k": 100.0, "m": 0.1}])
def test_a_box_around_nominal_is_proved_without_work_or_after_an_interrupt(
    rates: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """x'' = -(k x + 1.4 x')/m: 4.48 to 4.52 for any motion, and at least 1.9 by its norm."""
    own = [mbdlft.Parameter("k", 2.0, low=1.6, high=2.4), mbdlft.Parameter("m", 1.0, low=0.9, high=1.1)]
    matrix = [["0", "1"], ["-k/m", "-1.4/m"]]
    cart = mbdlft.realize(matrix, own, states=2, inputs=[], outputs=[])
    found = mbdlft.robust_stability(cart, rates=rates, work=0.01)
    assert 0.7 <= found.lower <= 4.5
    assert mbdlft.verify(cart, found) == ""
    for module, name in ((varying, "unstable_motion"), (ascent, "smallest_crossing")):
        with monkeypatch.context() as at:
            at.setattr(module, name, Mock(side_effect=KeyboardInterrupt))
            again = mbdlft.robust_stability(cart, rates=rates)
        assert (again.lower, again.reason) == (found.lower, INTERRUPTED)
        assert mbdlft.verify(cart, again) == ""
    too_late = Mock(wraps=variation.around_nominal, side_effect=[KeyboardInterrupt, DEFAULT])
    monkeypatch.setattr(variation, "around_nominal", too_late)
    assert mbdlft.robust_stability(cart, rates=rates, work=0.01).lower == found.lower


def test_an_interrupted_gain_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    matrix = [["0", "1", "0"], ["-(3+d)", "-1", "1"], ["1", "0", "0"]]
    system = mbdlft.realize(matrix, [unit("d")], states=2, inputs=["u"], outputs=["y"])
    monkeypatch.setattr(gain, "_reached", Mock(side_effect=KeyboardInterrupt))
    found = mbdlft.worst_case_gain(system, rates=1.0)
    assert (found.lower, found.upper, found.reason) == (0.0, np.inf, INTERRUPTED)


@cache
def slow(rate: float) -> tuple[mbdlft.System, mbdlft.Bounds]:
    """A light oscillator whose stiffness moves slowly, and its margin."""
    system = oscillator("1+d", "0.02")
    return system, mbdlft.robust_stability(system, rates=rate, gap=0.1, work=4.0)


@pytest.mark.parametrize(
    "rate", [0.04, *(pytest.param(rate, marks=pytest.mark.long) for rate in (0.02, 0.06))]
)
def test_a_slow_stiffness_is_proved_where_a_quadratic_form_cannot(rate: float) -> None:
    """x'' + 2 c x' + (1 + d) x: to first order a form of degree 4 proves 1 - rate/(4 sqrt(2) c)."""
    system, found = slow(rate)
    assert 0.9 * found.upper <= found.lower
    assert found.upper <= 1.05 * (1.0 - rate / (0.04 * np.pi) + 0.9 * rate)
    assert isinstance(found.proof, PolynomialProof)
    assert mbdlft.verify(system, found) == ""


def test_no_damaged_polynomial_is_accepted() -> None:
    system, found = slow(0.04)
    proof, model = found.proof, realization(system)
    assert isinstance(proof, PolynomialProof)
    assert mbdlft.verify(system, found) == ""
    other = np.where(np.arange(len(proof.V))[:, None] == 1, 1.1, 1.0) * proof.V
    for values in (
        {"V": other},
        {"V": -proof.V},
        {"V": 0.0 * proof.V},
        {"V": np.nan * proof.V},
        {"G": np.inf * proof.G},
        {"states": np.nan * proof.states},
        {"V": proof.V[:-1]},
        {"G": -proof.G},
        {"G": proof.G[:-1]},
        {"G": proof.G[:, :-1, :-1]},
        {"states": 0.0 * proof.states},
        {"states": np.eye(3)},
        {"degree": 0},
        {"degree": -1},
        {"degree": proof.degree + 1},
        {"degree": 10**9},
        {"orders": proof.orders + 1},
        {"orders": -proof.orders},
        {"orders": np.tile(proof.orders, 2)},
    ):
        assert mbdlft.verify(system, replace(found, proof=replace(proof, **values))), values
    assert mbdlft.verify(system, replace(found, rates={"d": 0.08}))
    assert mbdlft.verify(system, replace(found, rates={"d": np.inf}))
    assert mbdlft.verify(oscillator("1+1.6*d", "0.02"), found)
    assert mbdlft.verify(oscillator("1+d", "0.01"), found)
    assert mbdlft.verify(oscillator("1+d", "-0.02"), found)
    rates = {"d": 0.04}
    assert varying.checked(system, model, rates, found.lower, 0.0, proof) == ""
    assert varying.checked(system, model, rates, found.lower, 1e-6, proof)  # proves no gain


def test_a_polynomial_of_constants_proves_no_motion() -> None:
    still, any_motion = np.zeros(1), np.full(1, np.inf)
    model = realization(oscillator("1+d", "0.02"))
    proof = polynomial.solved(model, np.eye(2), still, 0.9, polynomial.Shape(2, 2))
    assert proof is not None
    assert polynomial.wrong_in(model, still, 0.9, proof) == ""
    assert polynomial.wrong_in(model, any_motion, 0.9, proof)


def test_a_polynomial_is_for_models_that_are_well_posed() -> None:
    """d V' = -2 x^2 of V = x^2, and xdot = -x/(1 - 0.6 d), also where it is beyond 5/3."""
    system = mbdlft.realize([["-1/(1-0.6*d)"]], [unit("d")], states=1, inputs=[], outputs=[])
    model, still = realization(system), np.zeros(1)
    for k, is_right in ((1.5, True), (2.0, False)):
        proof = polynomial.solved(model, np.eye(1), still, k, polynomial.Shape(1, 0))
        assert proof is not None
        assert (polynomial.wrong_in(model, still, k, proof) == "") == is_right


def test_a_region_needs_a_quadratic_form() -> None:
    signals = {"inputs": ["u"], "outputs": ["y"]}
    system = mbdlft.realize([["-1+d/2", "1"], ["1", "0"]], [unit("d")], states=1, **signals)
    found = mbdlft.robust_stability(system, rates=np.inf, gap=0.1)
    assert isinstance(found.proof, MotionProof)
    assert mbdlft.safe_region(system, found, {"y": (-1.0, 1.0)})
    matrix = [["0", "1", "0"], ["-3-2*d", "-1", "1"], ["1", "0", "0"]]  # the circle criterion proves 0.83
    system = mbdlft.realize(matrix, [unit("d")], states=2, **signals)
    found = mbdlft.robust_stability(system, rates=np.inf, gap=0.1)
    assert found.lower > 1.0
    assert mbdlft.verify(system, found) == ""
    with pytest.raises(mbdlft.AnalysisError, match="more than squares"):
        mbdlft.safe_region(system, found, {"y": (-1.0, 1.0)})


@pytest.mark.parametrize(("degree", "orders"), [(1, (2, 1)), (2, (0, 3)), (3, (1, 0))])
def test_a_polynomial_falls_as_it_does_along_motions(degree: int, orders: tuple[int, int]) -> None:
    """By differences of V, of a rational model in other states, at all ends of the rates."""
    random, k, n, sizes = np.random.default_rng(degree), 0.4, 3, (2, 1)
    A, B, C = (random.standard_normal(shape) for shape in ((n, n), (n, 3), (3, n)))
    D, none = 0.3 * random.standard_normal((3, 3)), np.zeros((3, 0))
    model = Realization(("p", "q"), sizes, A, B, C, D, none, none, none.T, none.T, none[:0])
    L, rates = random.standard_normal((n, n)), np.array([1.0, 0.5])
    powers = np.array(
        [np.bincount(c, minlength=n) for c in combinations_with_replacement(range(n), degree)]
    )
    V = random.standard_normal((*np.add(orders, 1), len(powers)))
    N, d = polynomial._polynomials(model, L, k)
    speeds = polynomial._speeds(rates, np.array(orders), k)
    falls = polynomial._falls(N.astype(float), d.astype(float), speeds, V, degree)
    scale = binomials(falls.shape[1:3])[..., None]

    def value(coefficients: np.ndarray, deltas: np.ndarray, y: np.ndarray) -> float:
        nodes = [np.array([0.5 + 0.5 * delta / k]) for delta in deltas]
        return float(at_nodes(coefficients, nodes).reshape(-1) @ np.prod(y**powers, axis=1))

    moving = [r * (m > 0) for r, m in zip(rates, orders, strict=True)]
    ends = list(product(*[(-r, r) if r else (0.0,) for r in moving]))
    assert len(ends) == len(falls)
    for deltas, y, (fall, ends_of) in product(
        random.uniform(-k, k, (2, 2)), random.standard_normal((2, n)), zip(falls, ends, strict=True)
    ):
        rises, h = L @ closed_at(model, deltas) @ np.linalg.solve(L, y), EPS ** (1.0 / 3.0)
        sides = [value(V, deltas + s * h * np.array(ends_of), y + s * h * rises) for s in (1.0, -1.0)]
        Delta = np.diag(np.repeat(deltas, sizes))
        expected = np.linalg.det(np.eye(3) - D @ Delta) * (sides[0] - sides[1]) / (2.0 * h)
        finite_difference(value(fall / scale, deltas, y), expected, float(np.sum(np.abs(V))))


def closed_at(model: Realization, deltas: np.ndarray) -> np.ndarray:
    """A + B Delta (I - D Delta)^-1 C."""
    Delta = np.diag(np.repeat(deltas, model.sizes))
    return model.A + model.B @ Delta @ np.linalg.solve(np.eye(len(Delta)) - model.D @ Delta, model.C)


def test_a_known_limit_of_switching_is_found() -> None:
    """x'' + x' + (2 + k) x, 0 <= k(t) <= 6.98513: Margaliot, Langholz, Automatica 39 (2003)."""
    half = 6.98513 / 2.0
    model = realization(oscillator(f"{2.0 + half}+{half}*d"))
    found = unstable_motion(model, lambda _: np.array([np.inf]), 1.2)
    assert 1.0 - 1e-4 <= found.size <= 1.0 + BOUND


@pytest.mark.parametrize("damping", [0.005, pytest.param(0.02, marks=pytest.mark.long)])
def test_parametric_resonance_of_a_square_wave(damping: float) -> None:
    """x'' + 2 c x' + (1 + d) x: d grows the mode by 2/pi of it a half turn, to first order: pi c."""
    model = realization(oscillator("1+d", str(2.0 * damping)))
    found = unstable_motion(model, lambda _: np.array([np.inf]), 1.0)
    assert abs(found.size / (np.pi * damping) - 1.0) <= BOUND
    assert abs(found.period / np.pi - 1.0) <= BOUND


@pytest.mark.parametrize("rate", [0.005, pytest.param(0.05, marks=pytest.mark.long)])
def test_a_slow_stiffness_grows_a_mode_where_it_is_soft(rate: float) -> None:
    """x'' + 2 c x' + (1 + d) x around the stiffness k: triangles of half a turn give rate/(2 pi k)."""
    damping = 0.01
    model = realization(oscillator("1+d", str(2.0 * damping)))
    k = rate / (2.0 * np.pi * damping)
    size = 1.0 - k + rate * np.pi / (4.0 * np.sqrt(k))
    found = unstable_motion(model, lambda _: np.array([rate]), 1.0, 1.0)
    assert abs(found.size / size - 1.0) <= BOUND
    steepest = np.max(np.abs(np.diff(found.deltas[:, 0]))) * len(found.deltas) / found.period
    roundoff(max(steepest, rate), rate, kappa=1e3)


def monodromy(system: mbdlft.System, times: np.ndarray, deltas: np.ndarray) -> float:
    """Largest |eigenvalue| after deltas (points, q) for times (points,), by the definition."""
    Phi = np.eye(len(system.A))
    for step in expm(state_matrices(system, deltas) * times[:, None, None]):
        Phi = step @ Phi
    return float(np.max(np.abs(np.linalg.eigvals(Phi))))


def test_nothing_grows_inside_a_proved_margin() -> None:
    """Any motion of the first delta, bounded rate of the second, others constant; random periods."""
    seed = 3
    system = random_system(seed, 4, 3)
    names, random = system.parameters.names, np.random.default_rng(seed)
    speed = 0.5 * float(np.max(np.abs(np.linalg.eigvals(system.A))))
    rates = dict(zip(names, [np.inf, speed], strict=False))
    found = mbdlft.robust_stability(system, rates=rates, largest=10.0, gap=0.05, work=WORK)
    assert found.rates == rates
    assert 0.0 < found.lower <= min(found.upper, reached(system, 10, 10.0, seed))
    assert mbdlft.verify(system, found) == ""
    k, count = found.lower, 64
    turn = 2.0 * np.pi * np.arange(count) / count
    for _ in range(20):
        period = 10.0 ** random.uniform(-0.7, 1.0) / speed
        deltas = np.empty((count, len(names)))
        deltas[:] = k * np.sign(random.uniform(-1.0, 1.0, len(names)))
        deltas[:, 0] = k * np.sign(np.sin(turn + random.uniform(0.0, 6.0)))
        if len(names) > 1:
            size = min(k, speed * period / (2.0 * np.pi))
            deltas[:, 1] = size * np.sin(turn + random.uniform(0.0, 6.0))
        assert monodromy(system, np.full(count, period / count), deltas) < 1.0


@pytest.mark.parametrize("rate_of_m", [np.inf, 2.0])
def test_a_motion_that_is_said_to_be_unstable_is(rate_of_m: float) -> None:
    """Steps of k; steps of m, or lines, that are cut into short steps here."""
    loop, fine = random_loop_with_channels(), 20 if np.isfinite(rate_of_m) else 1
    found = mbdlft.robust_stability(loop, rates={"k": np.inf, "m": rate_of_m}, gap=0.2, work=0.3)
    assert found.motion is not None
    times, deltas = found.motion[:, 0], found.motion[:, 1:]
    roundoff(np.max(np.abs(deltas)), found.upper)
    step = times[1] - times[0]
    period = 2.0 * np.pi / found.frequency
    roundoff(step * len(deltas), period, kappa=100.0)
    many = np.repeat(deltas, fine, axis=0)
    if np.isfinite(rate_of_m):
        at = (np.arange(len(many)) + 0.5) * step / fine
        many[:, 1] = np.interp(at, times, deltas[:, 1], period=period)
        masses = to_physical(loop.parameters["m"], many[:, 1])
        speeds = np.abs(np.diff(np.append(masses, masses[0]))) / (step / fine)
        assert np.max(speeds) <= rate_of_m * (1.0 + STABLE)
        assert np.max(speeds) > 0.1 * rate_of_m
    grown = monodromy(loop, np.full(len(many), step / fine), many)
    assert abs(grown - 1.0) <= 50.0 * STABLE
    assert found.worst == {}
    motion = np.column_stack([times, 0.9 * deltas])  # a tenth smaller, it comes to rest
    smaller = {name: 0.9 * delta for name, delta in found.delta.items()}
    other = replace(found, motion=motion, upper=0.9 * found.upper, delta=smaller)
    assert mbdlft.verify(loop, found) == ""
    assert "comes to rest" in mbdlft.verify(loop, other)


def test_no_signal_is_amplified_by_more_than_the_gain() -> None:
    """The energy after switching parameters and random inputs, by exact steps."""
    own = [mbdlft.Parameter("k", 2.0, low=1.6, high=2.4), mbdlft.Parameter("m", 1.0, low=0.9, high=1.1)]
    matrix = [["0", "1", "0"], ["-k/m", "-1.4/m", "1/m"], ["1", "0", "0"]]
    loop = mbdlft.realize(matrix, own, states=2, inputs=["f"], outputs=["x"])
    rates = {"k": np.inf, "m": 0.1}
    found = mbdlft.worst_case_gain(loop, rates=rates, gap=0.05, work=WORK)
    assert mbdlft.worst_case_gain(loop).lower <= found.upper < np.inf
    assert mbdlft.verify(loop, found) == ""
    random, h = np.random.default_rng(0), 0.05
    for _ in range(5):
        mass, x, spent, got = random.uniform(0.9, 1.1), np.zeros(2), 0.0, 0.0
        inputs = random.standard_normal(40).repeat(20)
        steps = {
            k: expm(h * np.array([[0, 1, 0], [-k / mass, -1.4 / mass, 1 / mass], [0, 0, 0]]))
            for k in (1.6, 2.4)
        }
        for k, u in zip(random.choice([1.6, 2.4], 40).repeat(20), inputs, strict=True):
            x = (steps[k] @ np.append(x, u))[:2]
            spent, got = spent + u * u * h, got + x[0] ** 2 * h
        assert got <= found.upper**2 * spent
    still = mbdlft.worst_case_gain(loop, gap=0.01)
    assert found.upper >= still.lower


def test_a_gain_over_rates_that_make_it_unstable_is_infinite() -> None:
    loop = random_loop_with_channels()
    found = mbdlft.worst_case_gain(loop, rates=np.inf, work=WORK)
    assert found.lower == found.upper == np.inf
    assert found.motion is not None
    assert "unstable at a motion" in found.reason
    slower = mbdlft.worst_case_gain(loop, rates={"k": 1.0}, work=2.0)
    assert not slower.proved
    assert "not proved" in slower.reason


def damaged(found: mbdlft.Bounds) -> list[mbdlft.Bounds]:
    """Bounds that say more than they prove, or prove nothing."""
    proof = found.proof
    assert isinstance(proof, MotionProof)
    more = found.upper * 1.01
    skew, full = proof.Y.copy(), proof.X.copy()
    skew[0, 0] = 1e-9
    full[0, 1] *= 1.0 + 1e-12
    scales = proof.channels * (1.0 + 2.0**-52)
    return [
        replace(found, lower=more),
        replace(found, lower=more, upper=max(more, found.upper)),
        replace(found, rates={"d": 100.0}),
        replace(found, proof=replace(proof, P=-proof.P)),
        replace(found, proof=replace(proof, P=proof.P[:-1, :-1])),
        replace(found, proof=replace(proof, X=0.0 * proof.X)),
        replace(found, proof=replace(proof, X=full)),
        replace(found, proof=replace(proof, Y=skew)),
        replace(found, proof=replace(proof, channels=scales)),
        replace(found, proof=replace(proof, states=0.0 * proof.states)),
        replace(found, proof=replace(proof, time=-proof.time)),
        replace(found, kind="worst-case gain"),
        replace(found, kind="robust performance"),
    ]


def test_no_damaged_proof_is_accepted() -> None:
    pair = discrete_pair()
    found = mbdlft.robust_stability(pair, rates=0.1, gap=0.1, work=WORK)
    assert mbdlft.verify(pair, found) == ""
    for other in damaged(found):
        assert mbdlft.verify(pair, other)
    constant = mbdlft.robust_stability(pair, gap=0.1, work=WORK)
    assert mbdlft.verify(pair, constant) == ""
    assert "constant" in mbdlft.verify(pair, replace(constant, rates={"d": 0.1}))
    other = oscillator("3+d", "-1")  # the nominal is unstable: P at 0 is not positive
    assert mbdlft.verify(other, replace(found, lower=1e-9))


def test_a_matrix_of_balls_is_positive_only_if_all_in_it_are() -> None:
    def matrix(radius: float) -> flint.arb_mat:
        off = flint.arb(0.9, radius)
        return flint.arb_mat([[flint.arb(1), off], [off, flint.arb(1)]])

    assert is_positive(matrix(0.02))
    assert not is_positive(matrix(0.11))
    assert not is_positive(-matrix(0.0))


@pytest.mark.parametrize("n", [3, 4, 6])
def test_no_indefinite_matrix_is_positive_where_only_rounding_hides_it(n: int) -> None:
    """B B' - 2^-140, B with a column less than rows: the pivot that decides is far below rounding."""
    for seed in range(30):
        B = np.random.default_rng(seed).integers(-9, 10, (n, n - 1))
        with flint.ctx.workprec(192):
            shift = flint.arb(2) ** -140
            rows = [
                [flint.arb(int(x)) - shift * int(i == j) for j, x in enumerate(row)]
                for i, row in enumerate(B @ B.T)
            ]
            assert not is_positive(flint.arb_mat(rows))


def test_bounds_of_rates_are_those_of_the_map() -> None:
    """By differences, of a bilinear map and of an angle."""
    own = (
        mbdlft.Parameter("a", 1.0, low=0.5, high=4.0),
        mbdlft.Angle("t", 20.0, low=-60.0, high=80.0, unit="deg"),
    )
    system = mbdlft.realize(
        [["-a", "t"], ["0", "-1"]], [own[0], unit("t")], states=2, inputs=[], outputs=[]
    )
    named = replace_parameters(system, own)
    for k in (0.5, 1.0):
        found = delta_rates(named, ["a", "t"], {"a": 2.0, "t": 3.0}, k)
        for p, bound, rate in zip(own, found, (2.0, 3.0), strict=True):
            values = np.linspace(p.low, p.high, 4001)
            deltas = to_delta(p, values)
            steep = rate * np.diff(deltas) / np.diff(values)
            inside = steep[np.maximum(np.abs(deltas[1:]), np.abs(deltas[:-1])) <= k]
            assert np.max(inside) <= bound
            given = {"a": 2.0, "t": 3.0}
            assert 0.0 < delta_rates(named, [p.name], given, k, allowed=True)[0] <= np.min(inside)
            if p.name == "a":
                target(np.max(inside), bound, BOUND)


def replace_parameters(system: mbdlft.System, own: tuple[mbdlft.Parameter, ...]) -> mbdlft.System:
    return mbdlft.System(system.name, system.lft, system.states, (), (), mbdlft.Parameters(own))


def test_what_grows_beyond_all_numbers_for_a_while_may_fall() -> None:
    """xdot = (10^4 d - 1) x + u grows over a period if the mean of d is above 10^-4, and only then."""
    d = mbdlft.Parameter("d", 0.0, low=-1.0, high=1.0)
    system = mbdlft.realize([["-1+10000*d", "1"], ["1", "0"]], [d], states=1, inputs=["u"], outputs=["y"])
    found = mbdlft.worst_case_gain(system, rates=np.inf)
    assert np.isinf(found.lower)
    assert not found.proved
    model, none = realization(system), np.array([np.inf])
    wave = 0.5 * np.sin(2.0 * np.pi * (np.arange(32) + 0.5) / 32)[:, None]
    for mean in (0.0, 2e-4):
        roundoff(growth(model, none, 3.0, wave + mean, 1), 3.0 * (1e4 * mean - 1.0), kappa=1e6)
    assert growth(model, none, 1e4, wave, 1) == -np.inf
    assert unstable_motion(model, lambda _: none, 1.0, 1.0).size >= 1e-4 * (1.0 - BOUND)


def test_no_motion_is_unstable_by_rounding_alone() -> None:
    """Near a pole of the map of its range nothing falls in a period: a margin of 0 was said."""
    lag = kit.plant("-c 1; 1 0", [mbdlft.Parameter("c", 1.0, 0.5, 2.0)], "x", "u", "y", search=0.0)
    moving, constant = (mbdlft.robust_stability(lag, rates=rates) for rates in (0.01, None))
    exact([moving.lower, moving.upper], [constant.lower, constant.upper])
    assert mbdlft.verify(lag, moving) == ""


@pytest.mark.parametrize("text", ["-1 1; 1 0", "0", "-1 1; 0 0"])
def test_a_gain_that_sees_nothing_move_is_that_of_constants(text: str) -> None:
    """There was no motion of no deltas, and a form without signals: two tracebacks."""
    a, n = mbdlft.Parameter("a", 1.0, 0.5, 1.5), text.count(";")
    model = kit.plant(text, [a], [f"x{k}" for k in range(n)], "u", "y", search=0.0)
    moving, constant = (mbdlft.worst_case_gain(model, rates=rates) for rates in (1.0, None))
    exact([moving.lower, moving.upper], [constant.lower, constant.upper])


def test_an_integrator_has_no_turn() -> None:
    """A pole of 1e9 that a range brings to infinity leaves one of exactly zero at its other end."""
    c = mbdlft.Parameter("c", 1.0, 0.5, 2.0)
    lag = kit.plant("-1e9*c 1; 1e12 0", [c], "x", "u", "y", search=0.0)
    assert 2.9 < mbdlft.robust_stability(lag, rates=1.0).lower <= 3.0
