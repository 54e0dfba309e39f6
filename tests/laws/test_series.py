"""Laws of blocks in series, against products of transfers; the blocks against their formulas."""

import control
import mpmath
import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, FREQUENCY_RESPONSE, published, target

K = mbdlft.Parameter("k", 40.0, low=30.0, high=60.0)
M = mbdlft.Parameter("m", 3.0, percent=20)
W = mbdlft.Parameter("w", 2.0, percent=50, unit="Hz")
T = mbdlft.Parameter("T", 20.0, percent=50, unit="ms")
OMEGA = np.array([0.1, 1.0, 4.0, 30.0, 200.0])
CART = mbdlft.realize(
    [
        ["0", "1", "0", "0"],
        ["-k/m", "-0.4/m", "1/m", "2/m"],
        ["1", "0", "0", "0"],
        ["-k/m", "0", "1/m", "0"],
    ],
    [K, M],
    states=["p", "v"],
    inputs=["force", "gust"],
    outputs=["position", "load"],
)
S = 1j * OMEGA


def response(model: mbdlft.LFTModel, **values: float) -> np.ndarray:
    return mbdlft.frequency_response(model, values, OMEGA)[0]


def known(model: mbdlft.LFTModel, **values: float) -> dict[str, float]:
    names = {p.name for p in model.parameters}
    return {name: value for name, value in values.items() if name in names}


@pytest.mark.parametrize("side", ["inputs", "outputs"])
def test_series_is_the_product(side: str) -> None:
    """G K and K G, with parameters of both, at each place."""
    values = {"k": 51.0, "m": 2.5, "w": 2.7}
    filter_ = mbdlft.low_pass("w", 0.6, [W])
    G = response(CART, k=51.0, m=2.5)
    inner = response(filter_, w=2.7)[:, 0, 0]
    for k, name in enumerate(("force", "gust") if side == "inputs" else ("position", "load")):
        model = mbdlft.series(CART, name, filter_)
        expected = G.copy()
        if side == "inputs":
            expected[:, :, k] *= inner[:, None]
        else:
            expected[:, k, :] *= inner[:, None]
        target(response(model, **values), expected, FREQUENCY_RESPONSE)
        assert [s.name for s in model.inputs] == ["force", "gust"]
        assert [s.name for s in model.states][2:] == [f"{name}.low", f"{name}.low_rate"]
        assert model.certificate.max_relative_error < CLOSED_FORM
        assert [p.name for p in model.parameters] == ["k", "m", "w"]


def test_a_shared_parameter_is_one() -> None:
    """k in the plant and in the filter; orders add up, and no more."""
    model = mbdlft.series(CART, "force", mbdlft.low_pass("0.1*k", parameters=[K]))
    assert [p.name for p in model.parameters] == ["k", "m"]
    expected = response(CART, k=33.0, m=3.0)
    expected[:, :, 0] *= (3.3 / (S + 3.3))[:, None]
    target(response(model, k=33.0, m=3.0), expected, FREQUENCY_RESPONSE)
    assert model.order <= CART.order + 1


def test_a_state_space_of_another_tool() -> None:
    """Two inputs through one coupled block of python-control, and a static gain that adds two outputs."""
    block = control.ss([[-1.0, 2.0], [0.0, -3.0]], np.eye(2), [[1.0, 0.5], [0.0, 1.0]], np.diag([0, 2.0]))
    model = mbdlft.series(CART, ("gust", "force"), block)
    inner = control.frequency_response(block, OMEGA).complex.transpose(2, 0, 1)
    G = response(CART, k=45.0, m=3.0)
    target(response(model, k=45.0, m=3.0), (G[:, :, ::-1] @ inner)[:, :, ::-1], FREQUENCY_RESPONSE)
    assert len(model.states) == 4
    total = control.ss([], [], [], [[1.0, 0.1]], outputs=["sum"])
    added = mbdlft.series(CART, ("position", "load"), total)
    assert [s.name for s in added.outputs] == ["sum"]
    target(response(added, k=45.0, m=3.0), G[:, :1] + 0.1 * G[:, 1:], FREQUENCY_RESPONSE)


def test_two_blocks_in_one_channel() -> None:
    model = mbdlft.series(
        mbdlft.series(CART, "force", mbdlft.low_pass(9.0)), "force", mbdlft.low_pass(5.0)
    )
    assert [s.name for s in model.states][2:] == ["force.lag", "force.2.lag"]
    expected = response(CART)
    expected[:, :, 0] *= (45.0 / (S + 9.0) / (S + 5.0))[:, None]
    target(response(model), expected, FREQUENCY_RESPONSE)


def test_the_trim_of_a_scene_stays() -> None:
    arm = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    model = mbdlft.series(arm, "shoulder.torque", mbdlft.delay("T", 2, [T]))
    values = {"theta1": 60.0, "T": 14.0}
    target(mbdlft.trim_at(model, values), mbdlft.trim_at(arm, known(arm, **values)), CLOSED_FORM)
    lower = dict(zip([p.name for p in model.parameters], model.certificate.lower_bound, strict=True))
    assert lower["T"] == 2


def test_names_on_both_sides_are_told_apart() -> None:
    static = mbdlft.realize([[2.0, 0.0], [0.0, 3.0]], inputs=["a", "b"], outputs=["a", "b"])
    at_input = mbdlft.series(static, "a", mbdlft.low_pass(1.0), side="inputs")
    at_output = mbdlft.series(static, "a", mbdlft.low_pass(1.0), side="outputs")
    assert at_input.B_u[0, 0] == 1.0
    assert at_output.B_u[0, 0] == 2.0


def test_low_pass() -> None:
    w = 2.0 * np.pi * 2.7
    target(response(mbdlft.low_pass("w", parameters=[W]), w=2.7)[:, 0, 0], w / (S + w), CLOSED_FORM)
    model = mbdlft.low_pass("w", 0.6, [W])
    expected = w**2 / (S**2 + 1.2 * w * S + w**2)
    target(response(model, w=2.7)[:, 0, 0], expected, CLOSED_FORM)
    assert model.certificate.minimal
    assert model.order == 2


def test_band_pass() -> None:
    """Equation (7.10), with the corner frequencies of the actuator of the mast: 0.1 and 1000 Hz."""
    a, b, xi = 0.2 * np.pi, 2000.0 * np.pi, 0.7
    expected = S**2 / (S**2 + 2 * xi * a * S + a**2) * b**2 / (S**2 + 2 * xi * b * S + b**2)
    target(response(mbdlft.band_pass(a, b))[:, 0, 0], expected, CLOSED_FORM)
    model = mbdlft.band_pass(a, "1000*w", "z", [W, mbdlft.Parameter("z", 0.7, percent=10)])
    b = 2000.0 * np.pi * 2.4
    xi = 0.66
    expected = S**2 / (S**2 + 2 * xi * a * S + a**2) * b**2 / (S**2 + 2 * xi * b * S + b**2)
    target(response(model, w=2.4, z=0.66)[:, 0, 0], expected, CLOSED_FORM)
    assert model.certificate.minimal


def pade(order: int, x: complex) -> complex:
    """Numerator over denominator of the approximation of exp(-x), from factorials with 50 digits."""
    with mpmath.workdps(50):
        f = mpmath.factorial
        c = [f(2 * order - k) * f(order) / (f(2 * order) * f(k) * f(order - k)) for k in range(order + 1)]
        x = mpmath.mpc(x)
        upper = mpmath.fsum(ck * (-x) ** k for k, ck in enumerate(c))
        return complex(upper / mpmath.fsum(ck * x**k for k, ck in enumerate(c)))


@pytest.mark.parametrize("order", [1, 2, 3, 6, 11, 20])
def test_delay(order: int) -> None:
    model = mbdlft.delay("T", order, [T])
    expected = [pade(order, s * 0.013) for s in S]
    found = response(model, T=13.0)[:, 0, 0]
    target(found, expected, CLOSED_FORM)
    target(np.abs(found), np.ones(len(S)), CLOSED_FORM)
    assert model.order == order
    assert model.certificate.minimal
    if order == 11:  # the error in x is of order 2 n + 1
        target(found, np.exp(-S * 0.013), FREQUENCY_RESPONSE)


def test_margins_with_a_delay() -> None:
    """Published: 27.4 dB with 10 ms, Kp = Kv = 0.3686 and the two flexible modes of a pointing system."""
    m1, m2, Jh, Jb, L, k1, k2, c = 0.6, 0.4, 0.05, 0.005, 0.56, 16.8, 50.0, 1e-4
    mass = np.array(
        [
            [Jh + Jb + (m1 + m2) * L**2, (m1 + m2) * L, m2 * L],
            [(m1 + m2) * L, m1 + m2, m2],
            [m2 * L, m2, m2],
        ]
    )
    inner = np.linalg.inv(mass)
    A = np.block(
        [[np.zeros((3, 3)), np.eye(3)], [-inner @ np.diag([0, k1, k2]), -inner @ np.diag([0, c, c])]]
    )
    B = np.concatenate([np.zeros(3), inner[:, 0]])[:, None]
    C = 0.3686 * np.eye(6)[[0]] + 0.3686 * np.eye(6)[[3]]
    plant = mbdlft.realize(np.block([[A, B], [C, np.zeros((1, 1))]]), states=6, inputs=["torque"])
    loop = mbdlft.series(plant, "torque", mbdlft.delay(0.01, 2))
    gain, phase, *_ = control.margin(loop.at())
    published(20.0 * np.log10(gain), "27.4")
    published(phase, "49.5")


def test_imbalance() -> None:
    """Force of a mass on a circle, and its moment about the port: a product of vectors."""
    speed = mbdlft.Parameter("n", 3000.0, percent=20, unit="1/min")
    m, r, h = 2e-3, 0.01, 0.04
    w = 2.0 * np.pi * 2700.0 / 60.0
    model = mbdlft.imbalance(m * r, m * r * h, "2*pi*n", [speed])
    for angle in (0.0, 0.7, 2.0):
        found = mbdlft.matrices_at(model, {"n": 2700.0}).D @ [np.cos(angle), np.sin(angle)]
        force = m * w**2 * r * np.array([np.cos(angle), np.sin(angle), 0.0])
        torque = np.cross([r * np.cos(angle), r * np.sin(angle), h], force)
        target(found, [*force[:2], *torque[:2]], CLOSED_FORM)
    assert model.certificate.minimal
