"""Guarantees: what is proved holds at all that is tried, and what is no proof is not taken for one."""

from dataclasses import replace
from fractions import Fraction
from functools import cache
from math import comb

import control
import numpy as np
import pytest

import mbdlft
from mbdlft.robust import ascent
from mbdlft.robust.ascent import NONE, peak_at
from mbdlft.robust.bisect.boxes import _is_left, largest_singular
from mbdlft.robust.bisect.characteristic import polynomials
from mbdlft.robust.bisect.search import Asked
from mbdlft.robust.evidence import BoxProof, IntervalProof
from mbdlft.robust.mu.coverage import ends_of, extent_of, loop_of, scaled
from mbdlft.robust.mu.intervals import is_negative_at
from mbdlft.robust.mu.mixed import by_multipliers as mixed_bounds
from mbdlft.robust.mu.multipliers import structure_of, upper_bound
from mbdlft.robust.mu.small_delta import small_delta
from mbdlft.robust.realization import realization
from tests.close import BOUND, STABLE, roundoff
from tests.laws.random_loops import KINDS, mixed_system, random_system, reached, state_matrices
from tests.reference import robust_cases
from tests.reference.robust_cases import of_matrices
from tests.seeds import some


def arm_loop(stiff: float = 1.0) -> mbdlft.System:
    arm = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    stiffness, damping, lag = stiff * np.diag([600.0, 300.0]), np.diag([100.0, 40.0]), 0.01
    A, C, D = -np.eye(2) / lag, -damping / lag, stiffness + damping / lag
    return mbdlft.feedback(arm, control.ss(A, np.eye(2) / lag, C, D))


@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(k, marks=pytest.mark.long) for k in range(6, 16))]
)
def test_no_model_inside_a_proved_margin_is_unstable(seed: int) -> None:
    system = random_system(seed)
    found = mbdlft.robust_stability(system, work=3.0, largest=10.0)
    assert 0.0 < found.lower <= reached(system, 40, 10.0, seed), KINDS[seed % len(KINDS)]
    if np.isfinite(found.upper):
        assert found.lower <= found.upper
        assert max(abs(delta) for delta in found.delta.values()) == found.upper
    if np.isfinite(found.frequency):
        (A,) = state_matrices(system, np.array([list(found.delta.values())]))
        poles = np.linalg.eigvals(A)
        assert np.max(poles.real) >= -STABLE * np.max(np.abs(poles))
        assert np.min(np.abs(poles - 1j * found.frequency)) <= 1e-3 * np.max(np.abs(poles))
    assert mbdlft.verify(system, found) == ""


@pytest.mark.parametrize("seed", [0, 1, 2, 5, 7])
def test_no_model_is_unstable_where_some_parameters_stay_in_their_ranges(seed: int) -> None:
    """Skew mu: the ranges of the others grow; random models of the box, the fixed ones at ends, too."""
    system, random = random_system(seed), np.random.default_rng(seed)
    names = system.parameters.names
    fixed = names[::2] if len(names) > 1 else ()
    found = mbdlft.robust_stability(system, fixed=fixed, work=2.0, largest=10.0)
    assert found.lower <= found.upper
    if found.lower == 0.0:
        return
    assert mbdlft.verify(system, found) == ""
    assert mbdlft.verify(system, replace(found, lower=found.upper, upper=found.upper)) or found.gap <= 0.0
    is_fixed = np.array([name in fixed for name in names])
    ends = np.where(is_fixed, 1.0, found.lower)
    deltas = ends * np.clip(random.uniform(-1.5, 1.5, (2000, len(names))), -1.0, 1.0)
    assert np.max(np.linalg.eigvals(state_matrices(system, deltas)).real) < 0.0


def test_a_cart_whose_damping_grows_alone_is_stable_until_it_is_zero() -> None:
    """Twice the range of c, which is half of it, leads to 0: for any mass and spring in their ranges."""
    own = [
        mbdlft.Parameter("k", 2.0, low=1.0, high=3.0),
        mbdlft.Parameter("m", 1.0, low=0.8, high=1.2),
        mbdlft.Parameter("c", 1e-4, percent=50),
    ]
    cart = mbdlft.realize([["0", "1"], ["-k/m", "-c/m"]], own, states=2, inputs=[], outputs=[])
    found = mbdlft.robust_stability(cart, fixed=["m", "k"], work=3.0)
    assert 2.0 * 0.99 <= found.lower <= 2.0 * (1.0 + BOUND)
    assert abs(found.upper - 2.0) <= BOUND
    assert mbdlft.verify(cart, found) == ""
    assert mbdlft.verify(cart, replace(found, lower=2.5, upper=2.5))
    roundoff(found.worst["c"], 0.0, scale=1.0)


def test_fixed_parameters_have_their_whole_ranges(monkeypatch: pytest.MonkeyPatch) -> None:
    """xdot = (-1 + f/2 + g/4) x is stable for |f| <= 1 and |g| < 2; no search says where it is not."""
    unit = [mbdlft.Parameter(name, 0.0, low=-1.0, high=1.0) for name in "fg"]
    system = mbdlft.realize([["-1 + f/2 + g/4"]], unit, states=1, inputs=[], outputs=[])
    monkeypatch.setattr(ascent, "smallest_beside", lambda *_: NONE)
    monkeypatch.setattr(ascent, "crossing_on_ray", lambda *_: NONE)
    assert 1.0 <= mbdlft.robust_stability(system, fixed=["f"], work=1.0, largest=10.0).lower <= 2.0


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 400, 10))
def test_no_model_inside_a_proved_margin_of_300_systems_is_unstable(first: int) -> None:
    """Up to 60 states; nine of ten are closed to 2 %."""
    closed = 0
    for seed in range(first, first + 10):
        most = (8, 30, 60)[seed % 3]
        system = random_system(seed, most, 4 if most == 8 else 3)
        found = mbdlft.robust_stability(system, work=10.0, largest=10.0, gap=0.02)
        assert found.lower <= reached(system, 40, 10.0, seed)
        closed += found.lower >= 0.98 * min(found.upper, 10.0)
    mixed = mbdlft.robust_stability(mixed_system(first), gap=0.05)
    assert 0.0 < mixed.lower <= mixed.upper
    assert closed >= 9


@pytest.mark.parametrize("seed", [1, 3, 7])
def test_coefficients_are_those_of_the_determinant(seed: int) -> None:
    """The polynomial in Bernstein form, evaluated by its definition, against the determinant."""
    system, k, random = random_system(seed), 0.3, np.random.default_rng(seed)
    model = realization(system)
    found = polynomials(model, k)
    n = len(system.A)
    for _ in range(5):
        delta, t = random.uniform(-1.0, 1.0, len(model.sizes)), random.uniform(0.1, 0.9)
        value = found.values[0]
        for x in [*(0.5 * (delta + 1.0)), t]:
            degree = len(value) - 1
            basis = [comb(degree, i) * x**i * (1.0 - x) ** (degree - i) for i in range(degree + 1)]
            value = np.tensordot(basis, value, 1)
        w = k * np.repeat(delta, model.sizes)
        loop = np.linalg.det(np.eye(len(w)) - system.D_zw * w)
        (A,) = state_matrices(system, k * delta[None])
        omega = found.scale * t / (1.0 - t)
        expected = (1.0 - t) ** n * loop * np.linalg.det(1j * omega * np.eye(n) - A)
        roundoff(value / expected, 1.0, kappa=1e6)


def test_a_system_without_states_has_a_margin_of_its_loop() -> None:
    """I - 0.5 d is singular at d = 2; as fast as d may be, too."""
    system = robust_cases.static([[0.5]], mbdlft.Block("d", 1))
    for rates in (None, np.inf, 1.0):
        found = mbdlft.robust_stability(system, rates=rates)
        roundoff(found.upper, 2.0, kappa=1e3)
        assert 0.99 * 2.0 <= found.lower <= 2.0
        assert mbdlft.verify(system, found) == ""


def test_a_face_is_enough_only_if_poles_turn_to_it() -> None:
    """The pole -1 + 2 d crosses at d = 1/2; the lower face says nothing of it, the upper one does."""
    d = mbdlft.Parameter("d", 0.0, low=-1.0, high=1.0)
    system = mbdlft.realize([["-1+2*d"]], [d], states=1, inputs=[], outputs=[])
    found = mbdlft.robust_stability(system)
    assert mbdlft.verify(system, found) == ""
    lower, upper, leaf = 3 * 0 + 2, 3 * 0 + 3, 0
    for k, log in ((0.9, (lower, leaf)), (0.9, (upper, leaf)), (0.9, (leaf,))):
        claim = replace(found, lower=k, proof=BoxProof(log))
        assert mbdlft.verify(system, claim)
    for log in ((leaf,), (lower, leaf)):  # without zeros, any model speaks for all
        assert mbdlft.verify(system, replace(found, lower=0.4, proof=BoxProof(log))) == ""


def by_multipliers(system: mbdlft.System, gap: float = 0.02, work: float = 30.0) -> mbdlft.Bounds:
    """The margin as blocks of all kinds are done."""
    loop = loop_of(system, range(len(system.states)))
    asked = Asked(system, gap, work, largest=10.0)
    return mixed_bounds(asked, loop, "robust stability")


@cache
def with_multipliers(seed: int) -> tuple[mbdlft.System, mbdlft.Bounds]:
    system = random_system(seed, most_parameters=3)
    return system, by_multipliers(system)


@pytest.mark.parametrize("seed", some(range(1), range(2)))
def test_multipliers_prove_no_more_than_there_is(seed: int) -> None:
    system, found = with_multipliers(seed)
    assert 0.0 < found.lower <= reached(system, 40, 10.0, seed)
    assert found.lower <= mbdlft.robust_stability(system, largest=10.0).upper
    assert mbdlft.verify(system, found) == ""
    loop = loop_of(system, range(len(system.states)))
    assert isinstance(found.proof, IntervalProof)
    assert found.proof.log == (len(found.proof.intervals), 0)
    extent = extent_of(loop, *ends_of(loop, found.lower))
    random = np.random.default_rng(seed)
    for interval, multipliers in zip(found.proof.intervals, found.proof.multipliers, strict=True):
        high = min(interval.high, 1e4 * max(interval.at, 1.0))
        for omega in random.uniform(interval.low, high, 4):
            assert is_negative_at(loop.channels, scaled(multipliers, loop.scale), omega, extent)


@pytest.mark.parametrize("seed", some(range(1), range(2)))
def test_blocks_of_all_kinds(seed: int) -> None:
    system = mixed_system(seed)
    found = mbdlft.robust_stability(system, gap=0.02)
    assert 0.0 < found.lower <= found.upper < np.inf
    sizes = [np.linalg.norm(np.atleast_2d(delta), 2) for delta in found.delta.values()]
    assert max(sizes) <= found.upper * (1.0 + STABLE)
    M = system.D_zw.astype(complex)
    if np.isfinite(found.frequency):
        shifted = 1j * found.frequency * np.eye(len(system.A)) - system.A
        M = M + system.C_z @ np.linalg.solve(shifted, system.B_w)
    delta = np.zeros(M.T.shape, dtype=complex)
    for block in system.lft.blocks:
        value, rows = found.delta[block.name], system.lft.columns()[block.name]
        part = value if block.kind == "full" else value * np.eye(block.size)
        delta[rows, system.lft.slices()[block.name]] = part
    singular = np.linalg.svd(np.eye(len(M)) - M @ delta, compute_uv=False)
    assert singular[-1] <= STABLE * singular[0]
    assert mbdlft.verify(system, found) == ""


def ball(count: int, seed: int, radius: float) -> tuple[mbdlft.System, np.ndarray]:
    """A system that is unstable in a ball inside its box, and nowhere else; and the middle of it."""
    middle = np.round(np.random.default_rng(seed).uniform(-0.8, 0.8, count), 3)
    names = [f"d{k}" for k in range(count)]
    terms = [f"({name}-({c}))^2" for name, c in zip(names, middle.tolist(), strict=True)]
    damping = f"-({'+'.join(terms)}-{radius**2!r})"
    own = [mbdlft.Parameter(name, 0.0, low=-1.0, high=1.0) for name in names]
    matrix = [[damping, "1"], ["-1", damping]]
    return mbdlft.realize(matrix, own, states=2, inputs=[], outputs=[], search=0.0), middle


@pytest.mark.parametrize(("count", "seed"), [(2, 0), (4, 2)])
def test_a_small_region_that_is_unstable_is_found(count: int, seed: int) -> None:
    system, middle = ball(count, seed, 1e-3)
    found = mbdlft.robust_stability(system, largest=1.0, work=20.0)
    distance = np.array(list(found.delta.values())) - middle
    assert np.linalg.norm(distance) <= 1e-3 * (1.0 + STABLE)
    assert found.lower <= np.max(np.abs(middle)) <= found.upper + 1e-3


def test_a_proof_of_a_gain_is_checked() -> None:
    loop = random_loop_with_channels()
    found = mbdlft.worst_case_gain(loop)
    assert mbdlft.verify(loop, found) == ""
    assert mbdlft.verify(loop, replace(found, upper=0.99 * found.upper))
    assert mbdlft.verify(loop, replace(found, lower=0.9 * found.lower, upper=0.99 * found.lower))
    assert "is not reached" in mbdlft.verify(loop, replace(found, lower=1.0001 * found.lower))


def random_loop_with_channels() -> mbdlft.LFTModel:
    """A mass on a spring, with two inputs and outputs."""
    own = [mbdlft.Parameter("k", 2.0, low=1.0, high=3.0), mbdlft.Parameter("m", 1.0, low=0.8, high=1.3)]
    matrix = [["0", "1", "0", "0"], ["-k/m", "-0.4/m", "1/m", "k"], ["1", "0", "0", "0"]]
    matrix.append(["0", "m", "0", "0.1"])
    return mbdlft.realize(matrix, own, states=2, inputs=["f", "g"], outputs=["x", "v"])


@pytest.mark.parametrize("seed", range(6))
def test_a_peak_is_above_all_other_frequencies(seed: int) -> None:
    """With direct feedthrough, against a fine grid."""
    random = np.random.default_rng(seed)
    n = 4
    A = random.standard_normal((n, n))
    A = A - (float(np.max(np.linalg.eigvals(A).real)) + 0.5) * np.eye(n)
    B, C, D = (random.standard_normal(shape) for shape in ((n, 2), (2, n), (2, 2)))
    fixed = mbdlft.state_space(A, B, C, 2.0 * D)
    found = peak_at(realization(fixed, [0, 1], [0, 1]), np.zeros(0))
    omega = np.concatenate([[0.0], np.geomspace(1e-2, 1e2, 3000), [1e6]])
    shifted = 1j * omega[:, None, None] * np.eye(n) - A
    sizes = np.linalg.svd(C @ np.linalg.solve(shifted, np.array([B] * len(omega))) + 2.0 * D)[1]
    assert np.max(sizes) <= found.gain * (1.0 + STABLE)
    assert found.gain <= np.max(sizes) * (1.0 + BOUND)


@pytest.mark.parametrize("seed", range(4))
def test_a_small_delta_makes_the_loop_singular(seed: int) -> None:
    """Real deltas and a complex matrix: most eigenvalues of M Delta are not real."""
    random = np.random.default_rng(seed)
    M = random.standard_normal((6, 6)) + 1j * random.standard_normal((6, 6))
    blocks = (mbdlft.Block("a", 1), mbdlft.Block("b", 2), mbdlft.Block("c", 3))
    found = small_delta(M, blocks)
    assert found.bound > 0.0
    assert not np.any(found.delta.imag)
    sizes = np.linalg.svd(np.eye(6) - M @ found.delta, compute_uv=False)
    assert sizes[-1] <= STABLE * sizes[0]
    of_qr = 21.0 * len(M)  # what its algorithm leaves in an eigenvalue (`close.poles_by_qr`)
    roundoff(np.linalg.norm(found.delta, 2) * found.bound, 1.0, of_qr)
    assert found.bound <= upper_bound(M, structure_of(blocks)).beta


def test_a_gain_of_an_unstable_range_is_infinite() -> None:
    loop = arm_loop(0.2)
    found = mbdlft.worst_case_gain(loop)
    assert found.lower == found.upper == np.inf
    assert not found.proved
    A = mbdlft.matrices_at(loop, found.worst).A
    assert np.max(np.linalg.eigvals(A).real) >= -STABLE


def test_robust_performance_is_between_its_bounds() -> None:
    loop = 0.2 * random_loop_with_channels()
    found = mbdlft.robust_performance(loop, gap=0.05)
    assert found.gap <= 0.05
    model = realization(loop, [0, 1], [0, 1])
    worst = np.array([found.delta[name] for name in model.names])
    assert peak_at(model, worst).gain * found.upper >= 1.0 - STABLE
    random = np.random.default_rng(0)
    for delta in random.uniform(-found.lower, found.lower, (40, len(worst))):
        assert peak_at(model, delta).gain * found.lower <= 1.0
    assert mbdlft.verify(loop, found) == ""


def damaged(found: mbdlft.Bounds) -> list[mbdlft.Bounds]:
    """Bounds with proofs that are not proofs, or that say more than they prove."""
    proof = found.proof
    more = replace(found, lower=found.upper * 1.001, upper=found.upper * 1.001)
    if isinstance(proof, BoxProof):
        logs = [proof.log[:-1], (*proof.log, 0), (3 * 99 + 1, *proof.log), ()]
        return [more, *(replace(found, proof=replace(proof, log=log)) for log in logs)]
    assert isinstance(proof, IntervalProof)
    count, *rest = proof.log
    kept = [k for k, interval in enumerate(proof.intervals) if interval.low > 0.0]
    holes = tuple(tuple(part[k] for k in kept) for part in (proof.intervals, proof.multipliers))
    whole = proof.intervals[0]._replace(high=np.inf)
    full = tuple(m._replace(D=m.D + 1e-18) for m in proof.multipliers)
    small = tuple(m._replace(D=m.D[:-1, :-1], G=m.G[:-1, :-1]) for m in proof.multipliers)
    larger = tuple(m._replace(beta=1.05) for m in proof.multipliers)
    named = ("log", "intervals", "multipliers")
    wrong = [
        dict(zip(named, ((len(kept), *rest), *holes), strict=True)),
        {"log": (1, 0), "intervals": (whole,), "multipliers": proof.multipliers[:1]},
        {"multipliers": full},
        {"multipliers": small},
        {"multipliers": larger},
        {"log": (*proof.log, 0)},
        {"log": (*proof.log, 0, 0)},
        {"log": (count, 1)},
        {"log": (count, 1, 0, 0)},
        {"log": (count, 99, 0, 0, 0, 0)},
    ]
    claims = [more, replace(found, lower=0.999 * found.upper), replace(found, fixed=("d0",))]
    return [*claims, *(replace(found, proof=replace(proof, **change)) for change in wrong)]


def test_no_damaged_proof_is_accepted() -> None:
    carts, (loop, multipliers) = robust_cases.two_carts(), with_multipliers(0)
    boxes = mbdlft.robust_stability(carts, gap=1e-5)
    for system, found in ((carts, boxes), (loop, multipliers)):
        assert mbdlft.verify(system, found) == ""
        for other in damaged(found):
            assert mbdlft.verify(system, other)
    assert mbdlft.verify(carts, replace(boxes, proof=None))
    # the same claims of another system
    lighter = carts.with_range(k=(0.9, 1.2))
    assert mbdlft.verify(lighter, boxes)


def test_no_value_is_left_of_a_direction_where_only_rounding_says_so() -> None:
    """Against rational numbers, at distances of a unit in the last place."""
    random, shown, hidden = np.random.default_rng(0), 0, 0
    for _ in range(2000):
        direction = complex(np.exp(2j * np.pi * random.uniform()))
        radius = float(random.choice([0.0, 10.0 ** random.uniform(-17.0, -1.0)]))
        size = 2.0 ** random.integers(-30, 30)
        off = radius * (1.0 + 1e-12) + random.normal() * 1e-15
        value = size * direction * complex(1.0, off)
        x, y, u, v = (Fraction(part) for part in (value.real, value.imag, direction.real, direction.imag))
        is_left = u * y - v * x > Fraction(radius * size) * (1 + Fraction(1, 2**51))
        told = _is_left(np.array([value]), direction, np.array([radius * size]))
        assert is_left or not told
        shown, hidden = shown + told, hidden + (is_left and not told)
    assert shown > 200
    assert 0 < hidden < 1000


def test_bounds_of_singular_values_are_above_them() -> None:
    """Against the squares of 200 bits: det(Q Q' - s^2 I) of 2 rows is positive beyond the largest one."""
    random = np.random.default_rng(0)
    Q = random.standard_normal((300, 2, 3)) + 1j * random.standard_normal((300, 2, 3))
    Q[::3, 1] = Q[::3, 0] * (1.0 + 1e-9)
    for matrix, bound in zip(Q, largest_singular(Q), strict=True):
        rows = [[_exact(x) for x in row] for row in matrix.tolist()]
        (a, b), (_, d) = (
            [sum((_times(x, y) for x, y in zip(p, q, strict=True)), start=_ZERO) for q in rows]
            for p in rows
        )
        s = Fraction(float(bound)) ** 2
        assert (a[0] - s) * (d[0] - s) - b[0] ** 2 - b[1] ** 2 >= 0
        assert s >= a[0]
        assert bound <= np.linalg.norm(matrix, 2) * (1.0 + 1e-11)


_ZERO = np.array([Fraction(0), Fraction(0)])


def _exact(x: complex) -> tuple[Fraction, Fraction]:
    return Fraction(x.real), Fraction(x.imag)


def _times(x: tuple[Fraction, Fraction], y: tuple[Fraction, Fraction]) -> np.ndarray:
    """Real and imaginary part of x times the conjugate of y."""
    return np.array([x[0] * y[0] + x[1] * y[1], x[1] * y[0] - x[0] * y[1]])


def test_the_best_bounds_so_far_are_returned_at_an_interrupt() -> None:
    seen = []

    def stop(lower: float, upper: float) -> None:
        seen.append((lower, upper))
        if np.isfinite(upper):
            raise KeyboardInterrupt

    system = robust_cases.two_carts()
    found = mbdlft.robust_stability(system, gap=1e-5, progress=stop)
    assert seen[-1] == (0.0, found.upper)
    assert 0.0 < found.lower < found.upper  # what a norm proves at once
    assert mbdlft.verify(system, found) == ""
    assert found.reason == "it was interrupted"


def test_more_work_never_makes_a_bound_worse() -> None:
    system = random_system(7)
    less, more = (mbdlft.robust_stability(system, work=work, gap=1e-3).lower for work in (0.01, 0.02))
    assert 0.0 < less < more


def test_states_on_which_nothing_depends_can_be_left_out() -> None:
    own = [mbdlft.Parameter("k", 2.0, low=1.0, high=3.0)]
    matrix = [["0", "1", "0"], ["-k", "-1", "0"], ["1", "0", "0"]]
    drifting = mbdlft.realize(matrix, own, states=3, inputs=[], outputs=[])
    found = mbdlft.robust_stability(drifting, leave_out="cyclic")
    assert found.leave_out == (drifting.states[2].name,)
    inner = mbdlft.realize([row[:2] for row in matrix[:2]], own, states=2, inputs=[], outputs=[])
    other = mbdlft.robust_stability(inner)
    roundoff([found.lower, found.upper], [other.lower, other.upper])
    roundoff(found.upper, 2.0, kappa=1e3)  # k = 0
    assert mbdlft.verify(drifting, found) == ""


# Laws of analyses of systems that are small, empty, or badly scaled; all were found by chance -------


def test_a_second_face_may_have_no_zeros_left() -> None:
    """Both faces were found before the first was taken; on the first no zero was left to say so."""
    A = np.array([[-1.0, -6, -4, 1], [5, -9, 1, -6], [-1, 3, -7, 0], [0, -2, 5, -5]]) / 4.0
    B = np.array([[0, -1, -2, -1, 1, 0, 2], [2, 1, -1, 1, 1, 0, 1], [1, 1, -1, 0, 0, 1, -1]])
    B = 0.41802266 * np.vstack([B, [[0, 0, 1, 0, -2, 0, -1]]])
    C = [[0, 0, -1, 0], [0, -1, -1, -1], [0, -1, 2, -1], [-1, 1, -1, 0]]
    C = np.array([*C, [2, 0, 0, 0], [-1, 2, 0, -1], [0, 1, -1, 1.0]])
    blocks = mbdlft.Block("d0", 3), mbdlft.Block("d1", 2), mbdlft.Block("d2", 2)
    system = of_matrices(A, B, C, np.zeros((7, 7)), *blocks)
    found = mbdlft.robust_stability(system)
    assert isinstance(found.proof, BoxProof)
    assert found.proof.log == (6, 9, 0)  # d1 and d2 are largest, then nothing is cut
    assert mbdlft.verify(system, found) == ""
    wrong = replace(found, proof=replace(found.proof, log=(5, 9, 0)))
    assert mbdlft.verify(system, wrong)


K = mbdlft.Parameter("k", 2.0, low=1.0, high=3.0)


def test_a_gain_that_is_zero_is_proved_with_little_work() -> None:
    """One over a bound of zero is not tried for ever."""
    matrix = [["0", "1", "0"], ["-k", "-1", "1"], ["0", "0", "0"]]
    system = mbdlft.realize(matrix, [K], states=2, inputs=["force"], outputs=["nothing"], search=0.0)
    found = mbdlft.worst_case_gain(system)
    assert found.lower == 0.0
    assert found.upper < 1e-299
    assert found.work < 0.1
    assert found.reason == ""
    assert mbdlft.verify(system, found) == ""
