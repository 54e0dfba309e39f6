"""Lyapunov functions on boxes: damped modes that cross are proved, what is not stable never is."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter, System, realize, robust_stability, verify
from mbdlft.base.array import Array
from mbdlft.robust.bisect import bernstein, boxes, lyapunov, search
from mbdlft.robust.bisect.characteristic import (
    Realization,
    is_unstable_at,
    polynomials,
    state_polynomials,
)
from mbdlft.robust.bisect.lyapunov import Attempt, _at_nodes, _is_positive, _Subbox, replayed, searched
from mbdlft.robust.bisect.search import Asked, State, by_itself, enlarged
from mbdlft.robust.evidence import LyapunovProof
from mbdlft.robust.realization import realization
from mbdlft.robust.stability import _is_unstable
from tests import kit
from tests.close import CLOSED_FORM, target

DAMPING = 1e-3


CROSSING = [Parameter(name, 1.0, low=0.6, high=1.4) for name in "ab"]


def crossing(damping: float = DAMPING) -> System:
    """Two oscillators whose frequencies cross as a and b move; each is damped by so much."""
    rows = f"0 0 1 0; 0 0 0 1; -a 0 -{damping!r} 0; 0 -b 0 -{damping!r}"
    return kit.plant(rows, CROSSING, 4, name="crossing")


def attempt(
    system: System, k: float, work: float = 1.0
) -> tuple[Realization, Array, LyapunovProof | None]:
    """A search for a proof of a size of the box."""
    model = realization(system)
    ends: Array = np.full(len(model.sizes), k)
    proof = searched(model, ends, work, partial(_is_unstable, model, ends)).proof
    assert proof is None or isinstance(proof, LyapunovProof)
    return model, ends, proof


def test_modes_that_cross_are_proved_whatever_their_damping() -> None:
    """Stable for a, b > 0: the margin is 2.5. Ten times less damped, the proof is as short."""
    logs = [attempt(crossing(damping), 1.5)[2] for damping in (1e-2, DAMPING)]
    assert all(proof is not None and len(proof.log) < 20 for proof in logs)


def test_a_proof_is_stored_and_proved_again(tmp_path: Path) -> None:
    system, (_, _, proof) = crossing(), attempt(crossing(), 1.5)
    bounds = replace(robust_stability(system, gap=0.5, work=0.05), lower=1.5, proof=proof)
    mbdlft.save_analysis(tmp_path / "a.h5", system, bounds)
    again, stored = mbdlft.load_analysis(tmp_path / "a.h5")
    assert isinstance(stored.proof, LyapunovProof)
    assert verify(again, stored) == ""
    assert verify(again, replace(stored, lower=2.4))


def test_lyapunov_functions_prove_what_the_polynomial_does_not() -> None:
    """Double modes, as of symmetric mechanisms: the square of a polynomial comes near to 0 everywhere."""
    twice = kit.plant("0 1 0 0; -a*b -0.01 0 0; 0 0 0 1; 0 0 -a*b -0.01", CROSSING, 4)
    bounds = robust_stability(twice, gap=0.3, work=4.0)
    assert 0.7 * 2.5 <= bounds.lower <= bounds.upper <= 2.5 * (1.0 + 1e-6)
    assert isinstance(bounds.proof, LyapunovProof)


def sizes_tried(upper: float, proved: float = 1.1) -> list[float]:
    """Sizes at which a proof is tried, if those up to one are proved."""
    sizes = list[float]()

    def tried(state: State[None], k: float) -> State[None]:
        sizes.append(k)
        return state._replace(lower=k) if k <= proved else state

    list(enlarged(Asked(crossing(), 0.1, 1.0), State(None, upper=upper), tried))
    return sizes


def test_the_declared_box_is_tried_soon() -> None:
    assert sizes_tried(1.5)[:2] == [1.5 * 0.95, 1.0]
    assert sizes_tried(np.inf).index(1.0) <= 5
    assert max(size for size in sizes_tried(1.5) if size <= 1.1) > 1.08


@pytest.mark.parametrize("proved", ["by functions", "by dear functions", "by cuts", "late", "never"])
def test_long_cuts_of_a_large_box_wait_for_the_declared_box(
    proved: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """2.4 times the box is tried soon, then 1 in all ways; if that is proved, 2.4 with what was left.

    If cuts of 2.0 have failed with as much work, it is not.
    """
    tried = list[tuple[str, float, float]]()
    still, open_box = np.zeros(2), boxes.Box(np.zeros(2), np.ones(2), ())

    def is_proved(way: str, k: float, work: float) -> bool:
        is_late = ("functions", 1.0) in [each[:2] for each in tried]
        tried.append((way, round(k, 1), work))
        late = "late" if is_late and way == "cuts" else f"by {way}"
        return k == 1.0 and proved.replace("dear ", "") == late

    def cuts(_: Realization, ends: Array, __: object, work: float, *___: object) -> boxes.Outcome:
        log = (0,) if is_proved("cuts", ends[0], work) else None
        return boxes.Outcome(log, None, open_box, 0.1, 1.0)

    def functions(_: Realization, ends: Array, work: float, *__: object) -> Attempt:
        proof = LyapunovProof((0,), np.zeros((1, 2), dtype=int), np.eye(4)[None])
        found = proof if is_proved("functions", ends[0], work) else None
        used = 5.0 if found and "dear" in proved else 0.1
        return Attempt(found, None, still, used, is_hopeless=ends[0] != 1.0)

    monkeypatch.setattr(search, "prove", cuts)
    monkeypatch.setattr(search, "searched", functions)
    robust_stability(crossing(), gap=0.1, work=10.0)
    first, declared = [("cuts", 2.4), ("functions", 2.4)], [("cuts", 1.0), ("functions", 1.0)]
    between, large = [("functions", 2.0), ("cuts", 2.0)], [("cuts", 2.4)]
    orders = {
        "by functions": [*first, *declared, *between],
        "by dear functions": [*first, *declared, *between, *large],
        "by cuts": [*first, *declared[:1], *large],
        "late": [*first, *declared, *declared[:1], *large],
        "never": [*first, *declared, *declared[:1]],
    }
    sizes = [each[:2] for each in tried]
    if proved != "by cuts":
        assert tried[3][2] > 7.0 > 4.0 > tried[2][2]  # of the declared box functions may take most
    assert sizes[: len(orders[proved])] == orders[proved]
    assert sizes.count(("cuts", 2.4)) == 1 + (proved not in ("by functions", "never"))
    assert sizes.count(("functions", 2.0)) <= 1
    assert all(each[2] == 0.5 * tried[1][2] for each in tried[2:] if each[:2] == ("cuts", 2.4))


def test_boxes_that_wait_for_work_are_proved_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some use up their share, and go on: the proof is that of one go, and no more work is done."""
    model, ends, unfinished = realization(crossing(0.1)), np.full(2, 1.5), 0
    whole, is_wrong = polynomials(model, ends), partial(_is_unstable, model, ends)

    def crew(function: Any, tasks: Any) -> Any:
        nonlocal unfinished
        found = by_itself(function, tasks)
        unfinished += sum(rest is not None for _, rest in found)
        return found

    logs = []
    for first, work in ((1.0, 1.0), (0.03, 0.16)):
        monkeypatch.setattr(boxes, "_FIRST", first)
        outcome = boxes.prove(model, ends, whole, work, is_wrong, 0.0, crew)
        assert outcome.log is not None
        assert outcome.work <= work
        logs.append(outcome.log)
    assert unfinished
    assert logs[0] == logs[1]


def test_real_parts_of_modes_that_cross_are_bounded() -> None:
    """All are -d/2, whatever a and b: what is proved on the line is a proof there, and not left of it."""
    system = crossing(0.1)
    bounds = mbdlft.worst_case(system, "real part", gap=0.1, work=1.0)
    assert -0.05 <= bounds.upper < -0.044
    model, ends = realization(system)._replace(shift=-0.045), np.ones(2)
    proof = searched(model, ends, 1.0, partial(_is_unstable, model, ends)).proof
    assert isinstance(proof, LyapunovProof)
    other = replace(bounds, upper=-0.045, proof=proof)
    assert verify(system, other) == ""
    assert verify(system, replace(other, upper=-0.05))
    assert verify(system, replace(other, kind="smallest damping", lower=0.02, upper=0.5))


def test_no_other_proof_is_taken() -> None:
    """Parts that are missing, coordinates that are none, and a box on which it is not stable."""
    model, ends, proof = attempt(crossing(), 1.5)
    assert proof is not None
    assert replayed(model, ends, proof)
    states = proof.states.copy()
    states[0, :, 0] = 0.0
    forged = (
        replace(proof, log=proof.log[:-1], states=proof.states[:-1], degrees=proof.degrees[:-1]),
        replace(proof, log=(0,), states=proof.states[:1], degrees=proof.degrees[:1] // 2),
        replace(proof, log=(*proof.log, 0)),
        replace(proof, states=states),
        replace(proof, states=proof.states * np.nan),
        replace(proof, degrees=0 * proof.degrees),
        replace(proof, degrees=proof.degrees + 9),
        replace(proof, degrees=proof.degrees[:, :1]),
        replace(proof, log=(4, *proof.log[1:])),
    )
    assert not any(replayed(model, ends, other) for other in forged)
    assert not replayed(model, 2.0 * ends, proof)


@pytest.mark.parametrize("cached", [1, 200, 2**20])
@pytest.mark.parametrize("shapes", [((3,), (2,)), ((1, 4), (3, 2)), ((2, 3, 3), (4, 1, 2))])
def test_products_have_the_values_of_their_factors(
    shapes: tuple[tuple[int, ...], tuple[int, ...]], cached: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """P N at a point is P there times N there, in however many pieces it is computed."""
    monkeypatch.setattr(bernstein, "_CACHED", cached)
    random, q, n = np.random.default_rng(3), len(shapes[0]), 3
    P, N = (random.standard_normal((*shape, n, n)) for shape in shapes)
    point = [np.array([t]) for t in random.uniform(0.0, 1.0, q)]

    def value(terms: Array) -> Array:
        values = np.concatenate([terms.reshape(*terms.shape[:q], -1), np.ones((*terms.shape[:q], 1))], -1)
        return _at_nodes(_Subbox(values, values, 0, np.zeros(q), np.ones(q), n), point)[0].reshape(n, n)

    target(value(bernstein.product(P, N)), value(P) @ value(N), CLOSED_FORM)


def test_an_unstable_point_is_found_and_not_proved() -> None:
    d = Parameter("d", 0.0, low=-1.0, high=1.0)
    system = realize([["-1+2*d"]], [d], states=1, inputs=[], outputs=[])
    model = realization(system)
    for k, is_proved in ((0.49, True), (0.5, False), (0.51, False), (0.9, False)):
        assert (attempt(system, k)[2] is not None) == is_proved
    assert is_unstable_at(model, [0.5])
    assert not is_unstable_at(model, [0.49])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_determinant_that_few_bits_do_not_tell_from_zero(sign: float) -> None:
    """det(I - D) = 29 e, e = +- 2^-200, of a model whose pole is -1 whatever delta is."""
    e, none = sign * 2.0**-200, np.zeros((0, 0))
    D = np.eye(3) - np.array([[1.0, 7.0, 2.0], [-1.0, 3.0, 5.0], [e, 10.0, 7.0]])
    A, B, C = -np.eye(1), np.zeros((1, 3)), np.zeros((3, 1))
    model = Realization(("d",), (3,), A, B, C, D, none[:1], none[:3], none, none, none)
    model = model._replace(E=np.zeros((1, 0)), F=np.zeros((3, 0)), G=np.zeros((0, 1)), H=np.zeros((0, 3)))
    assert is_unstable_at(model, [1.0]) == (sign < 0.0)
    assert not is_unstable_at(model, [1.0], most_bits=128)


def test_the_declared_box_is_tried_when_a_larger_one_was_too_much() -> None:
    """Nothing is proved of 4 times the box: its own size is next, and sizes in between after it."""
    tried: list[float] = []

    def prove(state: State[None], k: float) -> State[None]:
        tried.append(k)
        used = state.used + 1.0
        return state._replace(lower=k, used=used) if k <= 1.0 else state._replace(used=used)

    asked = Asked(crossing(0.1), 0.1, 3.5)
    list(enlarged(asked, State(None, upper=4.4), prove, resisted=4.0))
    assert tried[0] == 1.0
    assert all(1.0 < k < 4.0 for k in tried[1:])


def test_what_coefficients_hide_is_seen_on_pieces() -> None:
    """Of a + T_8 they reach -143; it is positive for a > 1 only, in any coordinates."""
    line = bernstein.interpolated(
        np.cos(8.0 * np.arccos(np.linspace(-1.0, 1.0, 9)))[:, None, None], [np.linspace(0.0, 1.0, 9)]
    )
    assert np.min(line) < -140.0
    L = np.random.default_rng(0).standard_normal((3, 3))
    rises = np.linspace(0.0, 0.05, 9)[:, None, None]  # to 1 at t = 0.2, behind the first minimum
    for size, is_positive in ((1.01, True), (0.99, False), (0.99 + rises, False)):
        S = L @ ((size + line) * np.eye(3)) @ L.T
        assert bernstein.pieces_positive(S, 1) == (False, 1)
        assert bernstein.pieces_positive(S, 64)[0] == is_positive
    assert bernstein.pieces_positive(-S, 64) == (False, 1)


@pytest.mark.parametrize("axis", [0, 1])
def test_halves_have_the_values_of_the_whole(axis: int) -> None:
    S = np.random.default_rng(1).standard_normal((4, 6, 2, 2))
    nodes = [np.array([0.2, 0.7]), np.array([0.0, 0.4, 1.0])]
    for start, half in zip((0.0, 0.5), bernstein._halves(S, axis, 0.0), strict=True):
        inside = [start + 0.5 * t if k == axis else t for k, t in enumerate(nodes)]
        target(bernstein.at_nodes(half, nodes), bernstein.at_nodes(S, inside), CLOSED_FORM)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_what_is_singular_in_a_half_is_not_positive_however_that_is_rounded(n: int) -> None:
    """B B' + (t - 1/2)^2 with n - 1 columns: the value at 1/2 is singular, and no coefficient before."""
    random = np.random.default_rng(n)
    for _ in range(100):
        B = random.standard_normal((n, n - 1))
        S = B @ B.T + random.uniform(0.1, 9.0) * np.array([0.25, -0.25, 0.25])[:, None, None] * np.eye(n)
        assert not bernstein.pieces_positive(S, 64)[0]


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_pole_at_zero_is_not_stable_however_products_are_rounded(n: int) -> None:
    """-B B' with n - 1 columns of integers is singular: no P has S > 0, whatever is computed of it."""
    random, none = np.random.default_rng(n), np.zeros((1, 0))
    for _ in range(100):
        B = random.integers(-9, 10, (n, n - 1)).astype(float)
        A, modes = -B @ B.T, random.standard_normal((n, n))
        wide = modes * 10.0 ** np.linspace(0.0, 2.0, n) @ modes.T
        column = np.zeros((n, 1))
        still = np.zeros((1, 1))
        model = Realization(
            ("d",), (1,), A, column, column.T, still, column[:, :0], none, column.T[:0], none.T, none[:0]
        )
        part = _Subbox(*state_polynomials(model, 1.0), 2, np.zeros(1), np.ones(1), n)
        P = np.array([modes.T @ modes] * 2)
        assert not _is_positive(part, modes, P)[0]
        assert not _is_positive(part, wide, np.array([wide.T @ wide] * 2))[0]
        shifted = state_polynomials(model._replace(A=A - np.eye(n)), 1.0)
        part = part._replace(values=shifted[0], sizes=shifted[1])
        assert _is_positive(part, modes, P)[0]
        assert not _is_positive(part._replace(steps=2**50), modes, P)[0]  # entries off by a quarter


def never(_: Array) -> bool:
    """No deltas are looked at."""
    return False


def bounded(system: System, goal: float, work: float = 1.0) -> tuple[Realization, LyapunovProof | None]:
    """A search for a proof that the gain is below a goal on the box, without a look at samples."""
    model = realization(system, range(len(system.inputs)), range(len(system.outputs)))
    found = searched(model, np.ones(len(model.sizes)), work, never, 1.0 / goal).proof
    assert found is None or isinstance(found, LyapunovProof)
    return model, found


def test_a_gain_is_proved_up_to_what_it_is() -> None:
    """p/(s + 1) with p up to 2, and a direct path of 0.5 beside it: the gain is 2.5."""
    p = Parameter("p", 1.5, low=1.0, high=2.0)
    system = realize([["-1", "1"], ["p", "0.5"]], [p], states=1, inputs=["u"], outputs=["y"])
    assert bounded(system, 2.4999)[1] is None
    assert bounded(system, 2.5)[1] is None
    model, proof = bounded(system, 2.505)
    assert proof is not None
    assert replayed(model, np.ones(1), proof, 1.0 / 2.505)
    assert not replayed(model, np.ones(1), proof, 1.0 / 2.499)
    fast = realize([["-1", "1"], ["p", "3"]], [p], states=1, inputs=["u"], outputs=["y"])
    assert bounded(fast, 2.9)[1] is None


def test_a_part_is_cut_along_the_parameter_that_leaves_it_without_a_function() -> None:
    """A hardly damped mode is as large as the goal at one stiffness; others do not matter."""
    k = Parameter("k", 1.0, low=0.3, high=1.7)
    more = [Parameter(name, 5.0, low=3.0, high=7.0) for name in "ab"]
    rows = "0 1 0 0; -k -0.02*k 0.01 1; 0.01*a 0 -b 0.1; k 0 0 0"
    system = kit.plant(rows, [*more, k], 3, "u", "y")
    largest = mbdlft.worst_case_gain(system, gap=0.5, work=0.01).lower
    model, proof = bounded(system, 1.02 * largest, 4.0)
    assert proof is not None
    cuts = [model.names[step - 1] for step in proof.log if step]
    assert cuts.count("k") > 2 * len(cuts) / 3


def test_a_gain_without_parameters_has_no_part_to_cut() -> None:
    """Modes in coordinates in which the polynomial has few digits: no Lyapunov functions are tried."""
    random, omega, n = np.random.default_rng(0), np.geomspace(0.01, 1e5, 6), 12
    modes = np.zeros((n, n))
    for k, w in enumerate(omega):
        modes[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, w], [-w, -0.01 * w]]
    V = np.eye(n) + 100.0 * np.triu(random.standard_normal((n, n)), 1)
    A, B = V @ modes @ np.linalg.inv(V), V @ random.standard_normal((n, 1))
    C = random.standard_normal((1, n)) @ np.linalg.inv(V)
    system = mbdlft.state_space(A, B, C, [[1.0]], inputs=["u"], outputs=["y"], name="P")
    bounds = mbdlft.worst_case_gain(system, work=0.01)
    with mpmath.workdps(50):
        s = mpmath.mpc(0.0, bounds.frequency)
        x = mpmath.lu_solve(s * mpmath.eye(n) - mpmath.matrix(A), mpmath.matrix(B))
        gain = float(abs((mpmath.matrix(C) * x)[0] + 1.0))
    assert bounds.lower <= gain <= bounds.upper
    assert "cuts of the characteristic polynomial" in bounds.reason


def crossing_with_signals(damping: float) -> System:
    """`crossing` with two forces and three outputs, one of which has a direct path."""
    rates = f"0 0 1 0 0 0; 0 0 0 1 0 0; -a 0 -{damping!r} 0 1 0.5; 0 -b 0 -{damping!r} 0 a"
    rows = f"{rates}; 1 0 0 0 0 0; 1 b 0 0 0 0; -a 0 0 0 1 0"
    return kit.plant(rows, CROSSING, 4, "u v", "x y z", name="crossing")


def test_gains_of_modes_that_cross_are_proved_and_verified() -> None:
    """Of hardly damped modes, with several signals; the bound is above all samples, and near to them."""
    system = crossing_with_signals(0.2)
    largest = mbdlft.worst_case_gain(system, gap=0.5, work=0.01).lower
    goal = 1.05 * largest
    model, proof = bounded(system, goal, 4.0)
    assert proof is not None
    claimed = replace(
        mbdlft.worst_case_gain(system, gap=0.5, work=0.01), upper=goal, proof=proof, reason=""
    )
    assert verify(system, claimed) == ""
    assert verify(system, replace(claimed, upper=1.001 * largest))
    assert verify(system, replace(claimed, inputs=("u",)))
    assert not replayed(model, 1.1 * np.ones(2), proof, 1.0 / goal)
    random = np.random.default_rng(1)
    A, B, C, D = mbdlft.matrices_at(
        system, {p.name: random.uniform(p.low, p.high, 50) for p in system.parameters}
    )
    for k, s in np.ndindex(50, 60):
        w = 1j * (0.6 + 0.012 * s)
        assert np.linalg.norm(C[k] @ np.linalg.solve(w * np.eye(4) - A[k], B[k]) + D[k], 2) <= goal


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_gain_of_one_is_not_below_one_however_products_are_rounded(n: int) -> None:
    """V^-1 (s + 1)^-1 V with integers V and V^-1: the gain is 1, and no P has S > 0 for it."""
    random = np.random.default_rng(n)
    for _ in range(60):
        V = np.tril(random.integers(-2, 3, (n, n)), -1) + np.eye(n)
        V = V @ (np.triu(random.integers(-2, 3, (n, n)), 1) + np.eye(n))
        G, still = np.round(np.linalg.inv(V)), np.zeros((1, 1))
        none = np.zeros((1, n))
        model = Realization(
            ("d",), (1,), -np.eye(n), none.T, none, still, V, none, G, none.T, np.zeros((n, n))
        )
        states = random.standard_normal((n, n))
        P = lyapunov._beside(
            part := _Subbox(*state_polynomials(model, 1.0, 1.0), 2, np.zeros(1), np.ones(1), n, n),
            np.array([states.T @ G.T @ G @ states] * 2),
            1.0,
        )
        assert not _is_positive(part, states, P)[0]
        less = state_polynomials(model, 1.0, 0.9)
        assert _is_positive(part._replace(values=less[0], sizes=less[1]), states, P)[0]


def test_poles_that_are_rounding_reach_no_margin() -> None:
    """A frame that becomes short: near h = 0 entries are so large that computed poles are anywhere."""
    h = Parameter("h", 0.8, low=0.4, high=1.0)
    system = kit.plant("0 0 1 0; 0 0 0 1; -1/h^6 1/h^5 -0.1 0; 1/h^5 -1/h^4-1 0 -0.1", [h], 4)
    assert verify(system, robust_stability(system, gap=0.3, work=0.2)) == ""
