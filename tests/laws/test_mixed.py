"""Blocks of all kinds: what is proved holds against brute force, whoever computes it."""

from dataclasses import replace
from functools import cache
from itertools import pairwise, product
from typing import Any

import flint
import numpy as np
import pytest

import mbdlft
from mbdlft.base.array import Array
from mbdlft.exact.matrices import middles_of
from mbdlft.lft.lft import LFT
from mbdlft.robust.bisect.search import Asked, crew_of
from mbdlft.robust.evidence import IntervalProof, Multipliers
from mbdlft.robust.mu import coverage as loops
from mbdlft.robust.mu import mixed, multipliers, singular_value
from mbdlft.robust.mu.coverage import loop_of
from mbdlft.robust.mu.intervals import Channels, channels_matrix, interval_around, matrix_in_balls
from mbdlft.robust.mu.mixed import by_multipliers
from mbdlft.robust.mu.multipliers import best_square, structure_of, upper_bound
from mbdlft.robust.mu.small_delta import delta_near
from tests import kit
from tests.close import BOUND, MU, STABLE, roundoff, target
from tests.laws.random_loops import blocks_system, random_system
from tests.laws.test_margins import arm_loop, random_loop_with_channels
from tests.reference.robust_cases import of_matrices


def smallest_of_scalars(system: mbdlft.System, omegas: Array, count: int) -> float:
    """The margin of one complex scalar or full block over a grid of real deltas: no proof, no search.

    For real deltas of size t, I - M Delta is singular for a full block of norm 1/sigma: the margin on
    a ray of real deltas is where t = 1/sigma. Of a complex repeated scalar, sigma is a spectral radius.
    """
    (other,) = [block for block in system.lft.blocks if block.kind != "real"]
    own = [block for block in system.lft.blocks if block.kind == "real"]
    z = list(range(system.order))[system.lft.slices()[other.name]]
    w = list(range(system.lft.M11.shape[1]))[system.lft.columns()[other.name]]
    zr = [k for b in own for k in range(system.order)[system.lft.slices()[b.name]]]
    wr = [k for b in own for k in range(system.lft.M11.shape[1])[system.lft.columns()[b.name]]]
    best = np.inf
    n = len(system.A)
    random = np.random.default_rng(0)
    rays = [*product([-1.0, 0.0, 1.0], repeat=len(own))]
    rays += [tuple(ray) for ray in random.uniform(-1.0, 1.0, (count, len(own)))]
    sizes = [block.size for block in own]
    for omega in omegas:
        shifted = 1j * omega * np.eye(n) - system.A
        M = system.D_zw + system.C_z @ np.linalg.solve(shifted, system.B_w)
        for ray in rays:
            t = np.geomspace(1e-3, 1.0, 40) * min(best, 100.0)
            d = t[:, None, None] * np.repeat(ray, sizes)
            inner = np.eye(len(zr)) - M[np.ix_(zr, wr)] * d
            N = M[np.ix_(z, w)] + M[np.ix_(z, wr)] * d @ np.linalg.solve(inner, M[np.ix_(zr, w)])
            values = np.linalg.svd(N, compute_uv=False) if other.kind == "full" else np.linalg.eigvals(N)
            best = min([best, *t[np.max(np.abs(values), axis=1) * t >= 1.0]])
    return best


def test_a_margin_of_mixed_blocks_is_that_of_brute_force() -> None:
    """One block that is not real: its smallest norm is a singular value, or a spectral radius."""
    system = blocks_system(0, 5)
    found = mbdlft.robust_stability(system)
    assert found.gap <= 0.01
    assert mbdlft.verify(system, found) == ""
    peak = found.frequency if np.isfinite(found.frequency) else 1e6
    tried = smallest_of_scalars(system, np.array([0.0, 0.5, 0.9, 1.0, 1.1, 2.0, 1e6]) * peak, 20)
    assert found.lower <= tried


def cut_system() -> mbdlft.System:
    """Multipliers of the whole box prove 5 % less than there is: the box has to be cut."""
    return blocks_system(2)


@cache
def cut_bounds() -> mbdlft.Bounds:
    return mbdlft.robust_stability(cut_system())


def test_a_box_is_cut_where_multipliers_do_not_suffice() -> None:
    system, found = cut_system(), cut_bounds()
    assert found.gap <= 0.01
    assert isinstance(found.proof, IntervalProof)
    assert len(found.proof.log) > 2
    assert mbdlft.verify(system, found) == ""


@cache
def springs() -> mbdlft.LFTModel:
    """Two masses on springs: the dampers matter much less than the springs."""
    own = [mbdlft.Parameter(name, 1.0, percent=30) for name in ("k0", "k1", "c0", "c1")]
    rows = "0 1 0 0 0; -k0-k1 -0.3*c0 k1 0 0; 0 0 0 1 0; k1 0 -k1-0.2*c1*k0 -0.2 1; 1 0 0 0 0"
    return kit.plant(rows, own, 4, "u", "y", search=0.0)


def test_parts_are_cut_along_what_matters() -> None:
    """The margin, k1 -> 0, to 5 % in little work: ten times as much was not enough for other cuts."""
    system = springs()
    asked = Asked(system, 0.05, 2.0)
    found = by_multipliers(asked, loop_of(system, range(4)), "robust stability")
    assert found.gap <= 0.05
    assert found.gap >= 0.049  # no more is tried: the first size that cuts may prove needs fewest
    target(found.upper, 1.0 / 0.3, BOUND)
    assert mbdlft.verify(system, found) == ""


def test_a_half_that_is_proved_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cut with one half to do is better than one whose halves have lower bounds, and both are open."""
    system = springs()
    loop = loop_of(system, range(4))
    low, high = loops.ends_of(loop, 3.5)
    part = loops.Part(low, high, ((0.0, np.inf),), np.nan, None, 50.0, 0.02, may_be_cut=True)
    bounds = {"k0": (1.01, 1.01), "k1": (1.05, 0.99), "c0": (1.2, 1.2), "c1": (1.2, 1.2)}

    def bounded(loop: Any, _M: Any, ends: Any, start: Multipliers, _tolerance: float) -> Multipliers:
        axis = int(np.argmax((ends[0] > low) | (ends[1] < high)))
        return start._replace(beta=bounds[loop.blocks[axis].name][int(ends[0][axis] > low[axis])])

    monkeypatch.setattr(mixed, "multipliers_of", bounded)
    monkeypatch.setattr(mixed, "_IDLE", 0.0)
    look = mixed._looked_at(loop, mixed._Node(part), high - low)
    assert loop.blocks[look.axis].name == "k1"
    assert [start.beta for start in look.starts] == [1.05, 0.99]


def test_multipliers_of_several_frequencies_hold_on_wider_intervals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    system = arm_loop()
    loop = loop_of(system, range(len(system.states)))
    part = loops.Part(*loops.ends_of(loop, 1.5), ((0.0, np.inf),), np.nan, None, 50.0, 0.02)
    several = loops.covered(loop, part)
    monkeypatch.setattr(loops, "_beside", lambda omega, *_: (np.array([omega]), 0.0))
    alone = loops.covered(loop, part)
    assert not several.todo
    assert not alone.todo
    assert 2 * len(several.intervals) < len(alone.intervals)


def test_a_search_starts_from_the_next_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a frequency was looked at far away from the last one, the intervals beside it help."""
    system = arm_loop()
    loop, counts, center = loop_of(system, range(len(system.states))), [0, 0], multipliers._center
    part = loops.Part(*loops.ends_of(loop, 1.5), ((0.0, np.inf),), np.nan, None, 50.0, 0.02)
    for which in (0, 1):

        def counted(*given: Any, which: int = which) -> Any:
            counts[which] += 1
            return center(*given)

        monkeypatch.setattr(multipliers, "_center", counted)
        assert not loops.covered(loop, part).todo
        monkeypatch.setattr(loops, "_neighbors", lambda kept, omega: [])
    assert 1.1 * counts[0] < counts[1]


def test_the_best_of_several_starts_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the first of them is bad: the search is as short as from the best alone."""
    random, counts, center = np.random.default_rng(2), [0], multipliers._center
    structure = structure_of([mbdlft.Block("a", 3), mbdlft.Block("b", 2)])
    M = random.standard_normal((1, 5, 5)) + 0j
    good = upper_bound(M, structure)
    turns = np.diag([3.0, 1.0, 0.3, 1.0, 3.0])
    bad = good._replace(D=turns @ good.D @ turns, G=turns @ good.G @ turns)

    def counted(*given: Any) -> Any:
        counts[-1] += 1
        return center(*given)

    monkeypatch.setattr(multipliers, "_center", counted)
    for starts in ((good,), (bad, good), (bad,)):
        counts.append(0)
        target(upper_bound(M, structure, starts=starts).beta, good.beta, MU)
    assert counts[2] == counts[1] < counts[3]


@pytest.mark.parametrize("seed", range(4))
def test_multipliers_hold_for_all_matrices(seed: int) -> None:
    """The bound is one for each of the matrices, and not below that of one alone."""
    random = np.random.default_rng(seed)
    blocks = [mbdlft.Block("a", 3), mbdlft.Block("b", 1), mbdlft.FullBlock("f", 2, 2)]
    structure = structure_of(blocks)
    M = random.standard_normal((3, 6, 6)) + 1j * random.standard_normal((3, 6, 6))
    found = upper_bound(M, structure)
    alone = [upper_bound(each, structure).beta for each in M]
    for each in M:
        assert best_square(each, found.D, found.G) <= found.beta**2 * (1.0 + STABLE)
    assert found.beta >= max(alone) * (1.0 - MU)


def test_a_start_that_leads_nowhere_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """From multipliers that no step improves, the search begins again without them."""
    structure = structure_of([mbdlft.Block("a", 3), mbdlft.Block("b", 2)])
    random = np.random.default_rng(0)
    M = random.standard_normal((1, 5, 5)) + 0j
    start = upper_bound(M, structure)
    M = M * (0.7 / start.beta) * np.array([[1.0] * 3 + [1e2] * 2] * 3 + [[1e-2] * 3 + [1.0] * 2] * 2)
    calls, center, ahead = iter(range(1000)), multipliers._center, multipliers._ahead
    is_stuck = [True]

    def no_center(*given: Any) -> Any:
        is_stuck[0] = next(calls) < multipliers._CENTERS
        return (given[2], False) if is_stuck[0] else center(*given)

    def no_step(M: Any, beta: float, X: Any, structure: Any) -> Any:
        D, G = multipliers._parts(X, beta)
        return (best_square(M, D, G), D, G) if is_stuck[0] else ahead(M, beta, X, structure)

    monkeypatch.setattr(multipliers, "_center", no_center)
    monkeypatch.setattr(multipliers, "_ahead", no_step)
    found = upper_bound(M, structure, starts=(start,), enough=1.0)
    assert found.beta <= 1.0 + STABLE


def test_second_derivatives_of_pairs_of_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products by pairs of blocks are those of the entries one by one."""
    random = np.random.default_rng(0)
    structure = structure_of([mbdlft.Block("a", 4), mbdlft.Block("b", 2), mbdlft.Block("c", 1)])
    c, uu, vv = (
        random.standard_normal((2, 7, 7)) + 1j * random.standard_normal((2, 7, 7)) for _ in range(3)
    )
    uu, vv = (x + np.conj(np.swapaxes(x, 1, 2)) for x in (uu, vv))
    both = []
    for cost in (0, 10**9):
        monkeypatch.setattr(multipliers, "_PAIR", cost)
        both.append(multipliers._curvature(c, uu, vv, structure))
    roundoff(both[0], both[1])


def wrong_parts(found: mbdlft.Bounds) -> list[mbdlft.Bounds]:
    """Proofs with parts that are missing, of other places, or of other sizes."""
    proof = found.proof
    assert isinstance(proof, IntervalProof)
    log = proof.log
    changes: list[dict[str, Any]] = [
        {"log": (sum(log[::2]), 0)},  # intervals of parts hold for their parts only
        {"log": log[:-2]},
        {"log": (*log, 0, 0)},
        {"log": (log[0], 2, *log[2:])},  # along the complex block
        {"intervals": proof.intervals[::-1]},
    ]
    claims = [replace(found, proof=replace(proof, **change)) for change in changes]
    claims += [replace(found, lower=0.9999 * found.upper), replace(found, kind="robust performance")]
    return [*claims, replace(found, fixed=("e",)), replace(found, fixed=("d0",))]


def test_no_damaged_proof_of_parts_is_accepted() -> None:
    system, found = cut_system(), cut_bounds()
    for other in wrong_parts(found):
        assert mbdlft.verify(system, other)
    whole = blocks_system(3)
    bounds = mbdlft.robust_stability(whole, gap=0.05)
    assert isinstance(bounds.proof, IntervalProof)
    count, zero = bounds.proof.log
    assert zero == 0
    full = len(whole.lft.blocks)  # the last one, which nothing can cut
    cut = replace(bounds.proof, log=(count, full, 0, 0, 0, 0))
    assert "a block that is not real" in mbdlft.verify(whole, replace(bounds, proof=cut))


@pytest.mark.long
def test_the_number_of_workers_does_not_change_a_bound() -> None:
    system = blocks_system(2)
    one, two = (mbdlft.robust_stability(system, gap=1e-2, workers=workers) for workers in (1, 2))
    assert (one.lower, one.upper, one.work) == (two.lower, two.upper, two.work)
    assert isinstance(one.proof, IntervalProof)
    assert isinstance(two.proof, IntervalProof)
    assert one.proof.log == two.proof.log
    for a, b in zip(one.proof.multipliers, two.proof.multipliers, strict=True):
        assert np.array_equal(a.D, b.D)


def servo() -> mbdlft.System:
    """A mass on a spring with a gain that is uncertain at all frequencies: input and output are left."""
    own = [mbdlft.Parameter("k", 2.0, low=1.0, high=3.0), mbdlft.Parameter("m", 1.0, low=0.8, high=1.3)]
    matrix = [["0", "1", "0"], ["-k/m", "-0.4/m", "1/m"], ["1", "0", "0"]]
    cart = mbdlft.realize(matrix, own, states=2, inputs=["f"], outputs=["x"])
    lft = LFT(
        np.array([[0.0]]), np.array([[1.0]]), np.array([[0.3]]), np.array([[1.0]]),
        (mbdlft.ComplexBlock("e", 1),),
    )  # fmt: skip
    error = mbdlft.System("error", lft, (), cart.inputs, cart.inputs, mbdlft.Parameters(()))
    return mbdlft.series(error, cart)


def worst_of_servo(count: int) -> float:
    """|1 + 0.3 e| at its largest, 1.3, times the worst resonance: (k, m) on a grid."""
    best = 0.0
    for k in np.linspace(1.0, 3.0, count):
        for m in np.linspace(0.8, 1.3, count):
            w2 = max(k / m - 0.5 * (0.4 / m) ** 2, 0.0)
            best = max(best, 1.3 / abs(k - m * w2 + 0.4j * np.sqrt(w2)))
    return best


def test_a_gain_of_mixed_blocks_is_known() -> None:
    """Found in closed form over a grid that has the worst corner."""
    system = servo()
    found = mbdlft.worst_case_gain(system, "f", "x")
    expected = worst_of_servo(21)
    target(found.lower, expected, STABLE)
    assert expected <= found.upper <= 1.011 * expected
    target(found.worst["k"], 1.0, STABLE)
    roundoff(abs(found.delta["e"]), 1.0, kappa=1e8)
    assert mbdlft.verify(system, found) == ""
    assert mbdlft.verify(system, replace(found, upper=0.99 * found.upper))
    performance = mbdlft.robust_performance(0.5 * system, "f", "x")
    assert performance.gap <= 0.01
    assert mbdlft.verify(0.5 * system, performance) == ""
    assert mbdlft.verify(0.5 * system, replace(performance, kind="robust stability"))
    k = performance.upper
    rest = mbdlft.worst_case_gain(0.5 * scaled_box(system, k), "f", "x")
    target(rest.lower * k, 1.0, BOUND)


def scaled_box(system: mbdlft.System, k: float) -> mbdlft.System:
    """The system whose box is k times as large: z is k times as large."""
    lft = system.lft
    rows = k * lft.M11, k * lft.M12
    return replace(system, lft=LFT(*rows, lft.M21, lft.M22, lft.blocks))


def with_gain_block(system: mbdlft.System) -> mbdlft.System:
    """The system with a full block between its outputs and inputs."""
    lft = system.lft
    n, nx = lft.order, len(system.states)
    B, C = lft.M21, lft.M12
    D = np.block([[lft.M11, C[:, nx:]], [B[nx:], lft.M22[nx:, nx:]]])
    blocks = (*lft.blocks, mbdlft.FullBlock("~", len(system.outputs), len(system.inputs)))
    whole = LFT(
        D,
        np.vstack([C[:, :nx], lft.M22[nx:, :nx]]),
        np.hstack([B[:nx], lft.M22[:nx, nx:]]),
        lft.M22[:nx, :nx],
        blocks,
    )
    assert whole.order == n + len(system.outputs)
    return mbdlft.System("closed", whole, system.states, (), (), system.parameters)


def test_skew_mu_is_the_worst_case_gain() -> None:
    """With a block between outputs and inputs that alone grows, at the frequency of the worst case."""
    system = random_loop_with_channels()
    gain = mbdlft.worst_case_gain(system, gap=1e-4)
    closed = with_gain_block(system)
    names = [block.name for block in system.lft.blocks]
    skew = mbdlft.structured_singular_value(closed, gain.frequency, fixed=names)
    target(skew.lower[0], gain.lower, MU)
    assert skew.lower[0] <= skew.upper[0]
    target(skew.upper[0], gain.lower, MU)
    gap = 1e-3
    margin = mbdlft.robust_stability(closed, fixed=names, gap=gap)
    assert margin.fixed == tuple(names)
    target(1.0 / margin.upper, gain.lower, MU)
    assert gain.lower <= 1.0 / margin.lower <= gain.lower * (1.0 + 2.0 * gap)
    assert mbdlft.verify(closed, margin) == ""
    assert mbdlft.verify(closed, replace(margin, fixed=()))


def test_skew_mu_of_numbers() -> None:
    """M = [a b; c d], |p| <= 1: one over the other is |d + c p b/(1 - a p)| at the best phase of p."""
    a, b, c, d = 0.4, 0.7, -0.5, 0.9
    M = [[a, b], [c, d]]
    system = of_matrices(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.array(M),
        mbdlft.ComplexBlock("p", 1), mbdlft.ComplexBlock("q", 1),
    )  # fmt: skip
    found = mbdlft.structured_singular_value(system, 0.0, fixed=["p"])
    turns = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 100001))
    sizes = np.abs(d + c * turns * b / (1.0 - a * turns))
    expected = float(np.max(sizes))
    target([found.lower[0], found.upper[0]], [expected] * 2, STABLE)
    large = mbdlft.structured_singular_value(
        of_matrices(
            np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), 3.0 * np.array(M),
            mbdlft.ComplexBlock("p", 1), mbdlft.ComplexBlock("q", 1),
        ),
        0.0,
        fixed=["p"],
    )  # fmt: skip
    assert large.upper[0] == np.inf  # 3 a p = 1 inside the fixed block


@pytest.mark.parametrize("seed", range(8))
def test_a_matrix_beside_a_pole_is_in_its_balls(seed: int) -> None:
    """Against 400 bits: nine digits of a double are lost beside a pole, and are in the balls."""
    random, n, m = np.random.default_rng(seed), 6, 3
    A = random.standard_normal((n, n))
    pole = max(np.linalg.eigvals(A), key=lambda p: (p.imag, p.real))
    A = A - (pole.real + 10.0 ** -random.uniform(4.0, 9.0)) * np.eye(n)
    system = Channels(A, *(random.standard_normal(shape) for shape in ((n, m), (m, n), (m, m))))
    both = []
    for bits in (128, 400):
        with flint.ctx.workprec(bits):
            both.append(matrix_in_balls(system, float(pole.imag)))
    assert both[0].contains(both[1])
    assert max(float(x.rad()) for x in both[0].entries()) <= 1e-20 * float(
        np.max(np.abs(middles_of(both[1])))
    )


def test_bands_hold_between_their_frequencies() -> None:
    """1/(s^2 + 0.1 s + 1) and a complex delta: mu is the gain, whose peak is narrow."""
    A, B, C = np.array([[0.0, 1.0], [-1.0, -0.1]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    bands = mbdlft.mu_bands(
        of_matrices(A, B, C, np.zeros((1, 1)), mbdlft.ComplexBlock("d", 1)), 0.1, 10.0
    )
    omega = np.geomspace(0.1, 10.0, 3000)
    gain = 1.0 / np.abs(1.0 - omega**2 + 0.1j * omega)
    k = np.clip(np.searchsorted(bands.edges, omega) - 1, 0, len(bands.upper) - 1)
    assert np.all(gain <= bands.upper[k] * (1.0 + BOUND))
    assert np.all(bands.upper <= 10.7)


def test_a_band_starts_from_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes fewer Newton steps than bands that all begin anew, by an eighth."""
    counts, step = [0], multipliers._newton_step

    def counted(*given: Any) -> Any:
        counts[-1] += 1
        return step(*given)

    def anew(*given: Any, starts: Any = (), **options: Any) -> Any:
        return upper_bound(*given, starts=starts if "enough" in options else (), **options)

    monkeypatch.setattr(multipliers, "_newton_step", counted)
    mbdlft.mu_bands(springs(), 0.5, 2.0)
    counts.append(0)
    monkeypatch.setattr(singular_value, "upper_bound", anew)
    mbdlft.mu_bands(springs(), 0.5, 2.0)
    assert 0 < counts[0] < 0.95 * counts[1], counts


def test_sizes_of_a_gain_and_pieces_of_a_large_block() -> None:
    """|delta| < 2 where M = 1/2; a block of 40 has 1,600 multipliers, and its pieces at most 250."""
    unit = of_matrices(*np.array([[[-1.0]], [[1.0]], [[0.0]], [[0.5]]]), mbdlft.Block("d", 1))
    size, _ = loops.largest_size(loop_of(unit, [0]), np.array([[0.5 + 0j]]), 10.0, None, 1e-3)
    assert 2.0 * (1.0 - 1e-2) <= size <= 2.0 * (1.0 + BOUND)
    pieces = loops._pieces([mbdlft.Block("d", 40)])
    assert sum(piece.size for piece in pieces) == 40
    assert len(structure_of(pieces).rows) <= 250


@pytest.mark.parametrize("end", [1.7, 2.0, 2.3])
def test_no_interval_goes_over_an_eigenvalue_on_the_axis(end: float) -> None:
    """1/(s^2 + 0.2 s + 1): |M| < beta beyond a frequency, to the last digit, and below no frequency."""
    A, B, C = np.array([[0.0, 1.0], [-1.0, -0.2]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    system, one = Channels(A, B, C, np.zeros((1, 1))), np.ones((1, 1), dtype=complex)
    # |M|^-2 = (1 - w^2)^2 + 0.04 w^2 is 1/beta^2 at w
    beta = float(abs(channels_matrix(system, end)[0, 0]))
    above = interval_around(system, Multipliers(beta, one, 0.0 * one), 3.0)
    assert above is not None
    assert end * (1.0 - 1e-15) <= above.low <= end * (1.0 + 1e-7)
    assert above.high == np.inf
    assert interval_around(system, Multipliers(beta, one, 0.0 * one), 1.0) is None
    assert interval_around(system, Multipliers(beta, -one, 0.0 * one), 1.0) is None


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_slopes_of_a_small_delta_are_those_of_differences(seed: int) -> None:
    """The frequency at which a delta is smallest: no frequency beside it has a smaller one."""
    system = blocks_system(seed, 5)
    loop = loop_of(system, range(len(system.states)))

    def at(omega: float) -> tuple[Array, Array]:
        place = np.ix_(loop.structure.inputs, loop.structure.outputs)
        h = 1e-6
        M, high, low = (channels_matrix(loop.channels, omega * s) for s in (1.0, 1 + h, 1 - h))
        return M[place], ((high - low) / (2.0 * h))[place]

    poles = np.linalg.eigvals(system.A)
    start = float(np.abs(poles[np.argmax(poles.real)])) or 1.0
    # the iteration that it begins with ends elsewhere in other arithmetic: several of them
    free = delta_near(at, loop.blocks, loop.grows, start, starts=4)
    kept = delta_near(lambda w: (at(start)[0], 0.0 * at(start)[1]), loop.blocks, loop.grows, start)
    assert free.bound >= kept.bound * (1.0 - STABLE)
    sizes = np.linalg.svd(np.eye(len(free.delta.T)) - at(free.omega)[0] @ free.delta)[1]
    assert sizes[-1] <= STABLE * sizes[0]


def test_a_mixed_box_that_is_unstable_has_no_gain() -> None:
    system = servo()
    wide = scaled_box(system, 4.0)
    found = mbdlft.worst_case_gain(wide, "f", "x")
    assert found.lower == found.upper == np.inf
    assert not found.proved
    assert "unstable at the worst case" in found.reason


@pytest.mark.parametrize("stop_at", [2, pytest.param(3, marks=pytest.mark.long)])
def test_interrupted_bounds_are_the_best_so_far(stop_at: int) -> None:
    """At any time: bounds are those that were told last, and what is said to be proved is."""
    system, seen = cut_system(), []

    def stop(lower: float, upper: float) -> None:
        seen.append((lower, upper))
        if len(seen) == stop_at:
            raise KeyboardInterrupt

    found = mbdlft.robust_stability(system, gap=1e-3, progress=stop)
    assert (found.lower, found.upper) == seen[-1]
    assert found.reason == "it was interrupted"
    assert found.proved == (found.lower > 0.0)
    assert (mbdlft.verify(system, found) == "") == found.proved
    assert all(a[0] <= b[0] and a[1] >= b[1] for a, b in pairwise(seen))


def test_ctrl_c_within_a_gain_and_poles() -> None:
    loop = random_loop_with_channels()

    def stop(lower: float, upper: float) -> None:
        raise KeyboardInterrupt

    for function in (mbdlft.worst_case_gain, lambda *a, **k: mbdlft.worst_case(a[0], "damping", **k)):
        found = function(loop, gap=1e-6, progress=stop)
        assert found.reason == "it was interrupted"
        assert not found.proved
        assert found.worst


def test_many_repetitions_have_multipliers_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces prove less than the whole, and something."""
    system = random_system(3, 5, 2)
    stay = range(len(system.states))
    asked = Asked(system, 0.05, 20.0, largest=10.0)
    found = []
    for most in (250, 1):
        monkeypatch.setattr(loops, "_MOST_ENTRIES", most)
        loop = loop_of(system, stay)
        found.append(by_multipliers(asked, loop, "robust stability"))
        assert mbdlft.verify(system, found[-1]) == ""
    whole, pieces = found
    assert len(loop.structure.rows) == system.order
    assert 0.0 < pieces.lower <= whole.upper
    assert whole.gap <= 0.05


def test_crews_are_checked() -> None:
    for workers in (0, -1, True, 1.5, "a"):
        with pytest.raises(mbdlft.AnalysisError, match="expected at least 1 worker"):
            mbdlft.robust_stability(cut_system(), workers=workers)
    with crew_of(None, None, "test") as crew:
        assert crew(divmod, [(7, 2), (9, 4)]) == [(3, 1), (2, 1)]


def singular_size(system: mbdlft.System, seed: int) -> float:
    """The smallest size of random Deltas of all kinds with a pole beyond the axis: no margin is above."""
    random, best, lft = np.random.default_rng(seed), np.inf, system.lft
    for _ in range(300):
        delta = np.zeros(lft.M11.T.shape, dtype=complex)
        for block in lft.blocks:
            rows, columns = lft.columns()[block.name], lft.slices()[block.name]
            if block.kind == "full":
                u, v = (random.standard_normal((n, 2)) @ [1.0, 1j] for n in (block.outputs, block.inputs))
                value = np.outer(u, v.conj()) / (np.linalg.norm(u) * np.linalg.norm(v))
            else:
                turn = np.exp(2j * np.pi * random.uniform())
                value = np.eye(block.size) * (
                    random.choice([-1.0, 1.0]) if block.kind == "real" else turn
                )
            delta[rows, columns] = value
        for size in np.geomspace(1e-3, 1.0, 40) * min(best, 100.0):
            loop = np.eye(len(lft.M11)) - size * lft.M11 @ delta
            A = system.A + system.B_w @ (size * delta) @ np.linalg.solve(loop, system.C_z)
            if np.max(np.linalg.eigvals(A).real) > 0.0:
                best = min(best, float(size))
                break
    return best


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 400, 20))
def test_no_mixed_model_inside_a_proved_margin_is_unstable(first: int) -> None:
    """300 systems with mixed blocks, up to 30 states; nineteen of twenty are closed to 2 %."""
    closed = 0
    for seed in range(first, first + 20):
        system = blocks_system(seed, (8, 8, 30)[seed % 3])
        found = mbdlft.robust_stability(system, gap=0.02, largest=100.0)
        assert found.lower <= singular_size(system, seed)
        assert found.lower <= found.upper
        assert not found.proved or mbdlft.verify(system, found) == ""
        closed += found.lower >= 0.98 * min(found.upper, 100.0)
    assert closed >= 19
