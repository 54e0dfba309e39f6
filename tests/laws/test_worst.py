"""Worst cases: proved bounds hold at all that is tried, and closed forms are reached."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, Parameter, System, realize, verify, worst_case
from mbdlft.robust.bisect.characteristic import is_stable_at
from mbdlft.robust.bisect.search import cost_of
from mbdlft.robust.realization import realization
from mbdlft.robust.worst import disk_transfer, h2_and_slope
from tests.close import BOUND, CLOSED_FORM, STABLE, roundoff, target
from tests.laws.random_loops import random_system, state_matrices
from tests.laws.test_margins import arm_loop, random_loop_with_channels


def undamping(poles: np.ndarray) -> np.ndarray:
    return np.asarray(poles.real / np.abs(poles))


def test_an_oscillator_has_the_damping_of_its_corner() -> None:
    """c/(2 sqrt(k m)) at the largest k and m, and -c/(2 m) at the largest m."""
    loop = random_loop_with_channels()
    damping = worst_case(loop, "damping")
    expected = 0.4 / (2.0 * np.sqrt(3.0 * 1.3))
    target(damping.upper, expected, CLOSED_FORM)
    assert 0.99 * expected <= damping.lower <= expected
    real = worst_case(loop, "real part")
    target(real.lower, -0.4 / 2.6, CLOSED_FORM)
    assert real.lower <= real.upper <= 0.99 * real.lower
    for found in (damping, real):
        assert found.proved
        assert found.worst["m"] == 1.3
        assert verify(loop, found) == ""


@pytest.mark.parametrize("seed", [0, 1, 3, 6])
def test_no_pole_is_beyond_a_proved_edge(seed: int) -> None:
    """Unstable systems, too: bounds of poles need no stability."""
    system = random_system(seed, 6, 3)
    random = np.random.default_rng(seed)
    deltas = random.uniform(-1.0, 1.0, (300, len(system.parameters)))
    deltas[:100] = np.sign(deltas[:100])
    poles = np.linalg.eigvals(state_matrices(system, deltas))
    real, damping = (worst_case(system, what) for what in ("real part", "damping"))
    assert np.max(poles.real) <= real.upper
    assert np.max(undamping(poles)) <= -damping.lower
    for found in (real, damping):
        (A,) = state_matrices(system, np.array([list(found.delta.values())]))
        there = np.linalg.eigvals(A)
        size = float(np.max(np.abs(there)))
        if found is real:
            roundoff(np.max(there.real), found.lower, kappa=1e4, scale=size)
        else:
            roundoff(np.max(undamping(there)), -found.upper, kappa=1e4)
        if found.upper > -1.0:
            assert found.proved
            assert verify(system, found) == ""
        else:  # an unstable real pole has the least damping there is
            assert "no damping is below -1" in found.reason


def oscillator(stiffness: str, damping: str) -> System:
    c = Parameter("c", 1.0, percent=20)
    rows = [["0", "1", "0"], [f"-{stiffness}", f"-{damping}", "c"], ["1", "0", "0"]]
    return realize(rows, [c], states=2, inputs=["u"], outputs=["y"])


def test_a_pole_at_zero_has_no_damping() -> None:
    cart = oscillator("0", "c")
    with pytest.raises(AnalysisError, match=r"a pole at 0 at nominal, in which x0 move.*'cyclic': x0\."):
        worst_case(cart, "damping")
    found = worst_case(cart, "damping", leave_out="cyclic")
    assert (found.leave_out, found.upper) == (("x0",), 1.0)
    assert verify(cart, found) == ""


@pytest.mark.parametrize(("stiffness", "damping", "least"), [("1", "0", 0.0), ("(-1)", "c", -1.0)])
def test_no_damping_is_below_that_of_an_unstable_real_pole(
    stiffness: str, damping: str, least: float
) -> None:
    """So that is true without a proof; whether the model reaches its axis is checked."""
    loop = oscillator(stiffness, damping)
    found = worst_case(loop, "damping")
    assert (found.lower, found.upper) == (-1.0, least)
    assert verify(loop, found) == ""
    assert "not reached" in verify(oscillator("1", "c"), found)


def test_poles_of_the_arm() -> None:
    loop = arm_loop()
    samples = mbdlft.random(loop.parameters, 300)
    poles = np.linalg.eigvals(mbdlft.matrices_at(loop, samples).A)
    found = worst_case(loop, "damping", gap=0.01)
    assert found.gap <= 0.0101
    assert found.lower <= np.min(-undamping(poles))


def test_a_sector_of_a_known_pole() -> None:
    """-1 +- 2j has the damping 1/sqrt(5): slope 1/2; the line at -1."""
    model = realization(mbdlft.state_space([[-1.0, 2.0], [-2.0, -1.0]], [[1.0], [0.0]], [[1.0, 0.0]], 0))
    for slope, shift, expected in ((0.49, 0.0, True), (0.51, 0.0, False), (0.0, -0.99, True)):
        region = model._replace(slope=slope, shift=shift)
        assert is_stable_at(region, []) == expected
    assert not is_stable_at(model._replace(shift=-1.01), [])


def test_too_little_work_proves_no_edge() -> None:
    system = random_system(7, 6, 3)
    work = 1.0001 * cost_of(realization(system))
    found = worst_case(system, "real part", work=work)
    assert not found.proved
    assert found.upper == np.inf
    assert found.reason


def servo() -> System:
    own = [Parameter("k", 2.0, low=1.0, high=3.0)]
    matrix = [["0", "1", "0"], ["-k", "-0.4", "1"], ["k", "0.3", "0"]]
    return realize(matrix, own, states=2, inputs=["u"], outputs=["y"])


def test_a_disk_margin_is_that_of_the_loop_on_a_grid() -> None:
    """1/|S - 1/2|, S = 1/(1 + L), over values and frequencies."""
    system = servo()
    found = worst_case(system, "disk margin", gap=0.005)
    omega = np.linspace(0.0, 6.0, 4001)
    margins = []
    for k in np.linspace(1.0, 3.0, 21):
        L = (0.3j * omega + k) / ((1j * omega) ** 2 + 0.4j * omega + k)
        margins.append(1.0 / float(np.max(np.abs(1.0 / (1.0 + L) - 0.5))))
    assert found.lower <= min(margins)
    target(found.upper, min(margins), BOUND)
    assert found.gap <= 0.0051
    assert verify(system, found) == ""
    assert verify(system, replace(found, lower=1.01 * found.upper))
    with pytest.raises(AnalysisError, match="as many inputs as outputs, got 1 and 2"):
        disk_transfer(random_loop_with_channels(), "f")


def test_the_h2_norm_of_an_oscillator() -> None:
    """x'' + c/m x' + k/m x = f/m: the H2 norm from f to x is 1/sqrt(2 c k)."""
    loop = random_loop_with_channels()
    found = worst_case(loop, "H2 norm", "f", "x")
    target(found.lower, 1.0 / np.sqrt(2.0 * 0.4 * 1.0), CLOSED_FORM)
    assert (found.worst["k"], found.proved, found.proof) == (1.0, False, None)
    assert "the largest of" in found.reason
    with_path = worst_case(loop, "H2 norm")
    assert (with_path.lower, with_path.reason) == (np.inf, "the direct path D is not zero")


@pytest.mark.parametrize(("k", "c"), [("1e8", "0.01"), ("1e-12", "1e-9"), ("1e14", "1e6")])
def test_the_h2_norm_of_a_stiff_mode(k: str, c: str) -> None:
    """x'' + c x' + k (1 + d/10) x = u; it was 0, as LAPACK took states without scales for singular."""
    d = mbdlft.Parameter("d", 0.0, low=-1.0, high=1.0)
    matrix = [["0", "1", "0"], [f"-{k}*(1+d/10)", f"-{c}", "1"], ["1", "0", "0"]]
    found = worst_case(mbdlft.realize(matrix, [d], states=2, inputs=["u"], outputs=["x"]), "H2 norm")
    target(found.lower, 1.0 / np.sqrt(1.8 * float(c) * float(k)), CLOSED_FORM)


def test_poles_are_of_all_signals_but_names_are_checked() -> None:
    with pytest.raises(mbdlft.MbdlftError, match="worst_case: inputs: unknown signal 'zz'"):
        worst_case(random_loop_with_channels(), "damping", "zz")


@pytest.mark.parametrize("what", ["x", None, 3, []])
def test_a_property_is_a_name_or_a_function(what: Any) -> None:
    with pytest.raises(AnalysisError, match="'H2 norm' or a function, got "):
        worst_case(random_loop_with_channels(), what)


@pytest.mark.parametrize("seed", [2, 3])
def test_slopes_of_the_h2_norm_are_those_of_differences(seed: int) -> None:
    system, random = random_system(seed, 5, 3), np.random.default_rng(seed)
    n, N = len(system.A), system.order
    model = realization(system)._replace(
        E=random.standard_normal((n, 2)),
        F=0.0 * random.standard_normal((N, 2)),
        G=random.standard_normal((2, n)),
        H=np.zeros((2, N)),
        J=np.zeros((2, 2)),
    )
    delta, h = 0.1 * random.uniform(-1.0, 1.0, len(model.sizes)), 1e-5
    value, slope = h2_and_slope(model, delta)
    for k, expected in enumerate(slope()):
        step = h * np.eye(len(delta))[k]
        ends = [h2_and_slope(model, delta + side * step)[0] for side in (-1.0, 1.0)]
        assert abs((ends[1] - ends[0]) / (2.0 * h) - expected) <= 1e3 * STABLE * value


def test_a_function_of_a_user_is_climbed() -> None:
    """-k/m is largest at the smallest k and the largest m; |k - 1.7| inside is found, too."""
    loop = random_loop_with_channels()
    found = worst_case(loop, lambda A, B, C, D: float(A[1, 0]))
    target(found.lower, -1.0 / 1.3, CLOSED_FORM)
    inner = worst_case(loop, lambda A, B, C, D: -((A[1, 0] + 1.7) ** 2))
    assert abs(inner.lower) <= STABLE
    with pytest.raises(AnalysisError, match=r"expected a number from 'wrong', got None at deltas"):
        worst_case(loop, wrong)  # type: ignore[arg-type]
    with pytest.raises(AnalysisError, match=r"'real part', .* or a function, got 'real'"):
        worst_case(loop, "real")
    static = mbdlft.as_system(np.eye(1), name="unit", inputs=["a"], outputs=["b"])
    with pytest.raises(AnalysisError, match="has no states, and no poles"):
        worst_case(static, "damping")


def wrong(*_: object) -> None:
    return None
