"""Laws of two-ports: statics, reciprocity, boundary conditions, energy, assembly; inverted channels."""

from functools import cache

import control
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import mbdlft
from tests import kit
from tests.close import BALANCE, CLOSED_FORM, FINITE_ELEMENTS, FREQUENCY_RESPONSE, roundoff, target
from tests.extracted import lower_bound

E = mbdlft.Parameter("E", 70e9, percent=20, unit="Pa")
L = mbdlft.Parameter("L", 1.2, percent=20, unit="m")
M = mbdlft.Parameter("m", 5.0, percent=30, unit="kg")
PLANE = ("y", "rz")
LOAD, MOTION = ["tip"], ["origin"]


def transport(r: np.ndarray) -> np.ndarray:
    """phi of a rigid displacement: a_C = a_P + alpha x r."""
    found = np.eye(6)
    found[:3, 3:] = np.cross(np.eye(3), r).T
    return found


def rigid_mass(mass: float, center: np.ndarray, about_center: np.ndarray) -> np.ndarray:
    """Mass matrix about the origin: T' diag(m, J) T with T the transport to the center."""
    inner = np.zeros((6, 6))
    inner[:3, :3], inner[3:, 3:] = mass * np.eye(3), about_center
    return transport(center).T @ inner @ transport(center)


def beam(**fields) -> mbdlft.Beam:
    section = {"area": 1e-4, "I_y": 1e-9, "I_z": 2e-9, "torsion_constant": 1.5e-9, "elements": 2}
    steel = {"density": 2700, "modulus": "E", "shear_modulus": 26e9}
    return mbdlft.Beam(**({"name": "beam", "length": 1.2} | section | steel | fields))


def bending(**fields) -> mbdlft.Beam:
    plane = {"deformations": ("bending_y",), "shape_functions": "quintic"}
    return beam(**(plane | fields))


def panel() -> mbdlft.FlexibleBody:
    pulls = (0.1, 0.2, 1.2, 0.2, -1.0, 0.1), (0.0, 1.0, 0.1, 0.1, 0.0, 0.8)
    tips = (0, 0.1, 0.9, 0.1, -0.4, 0), (0.2, 0.7, 0, 0, 0, 0.5)
    sides = (0, 0, 0.3, 0.2, 0, 0), (0, 0.2, 0, 0, 0.1, 0.1)
    return mbdlft.FlexibleBody(
        name="panel",
        mass="m",
        center_of_mass=(0.7, 0.1, -0.2),
        inertia=mbdlft.Inertia(xx=1.0, yy=3.0, zz=2.5, xy=0.1, yz=0.2),
        ports={"tip": (1.5, 0.2, 0.1), "side": (0.4, -0.6, 0.0)},
        modes=[
            mbdlft.Mode(frequency=w, damping=c, participation=pull, shapes={"tip": tip, "side": side})
            for w, c, pull, tip, side in zip((9.0, 31.0), (0.01, 0.02), pulls, tips, sides, strict=True)
        ],
    )


def box() -> mbdlft.RigidBody:
    ports = {"tip": (0.5, 0.5, 0.0), "side": (-1.0, 0.2, 0.3)}
    return kit.body("box", "m", (1.0, 2.0, 1.5), xz=0.2, center_of_mass=(0.3, -0.2, 0.1), ports=ports)


def static_gain(model: mbdlft.LFTModel, **values: float) -> np.ndarray:
    A, B, C, D = mbdlft.matrices_at(model, values)
    return D - C @ np.linalg.solve(A, B) if len(A) else D


def expected_statics(mass: np.ndarray, *arms) -> np.ndarray:
    """[0 phi ; phi' -M]."""
    phi = np.vstack([transport(np.asarray(arm, dtype=float)) for arm in arms])
    zero = np.zeros((len(phi), len(phi)))
    return np.block([[zero, phi], [phi.T, -mass]])


def test_statics_of_modes() -> None:
    tensor = np.array([[1.0, 0.1, 0.0], [0.1, 3.0, 0.2], [0.0, 0.2, 2.5]])
    for m in (3.7, 5.0, 6.5):
        mass = rigid_mass(m, np.array([0.7, 0.1, -0.2]), tensor)
        expected = expected_statics(mass, (1.5, 0.2, 0.1), (0.4, -0.6, 0.0))
        target(static_gain(mbdlft.two_port(panel(), [M], search=0.0), m=m), expected, CLOSED_FORM)


def test_statics_of_a_rigid_body_and_a_point_mass() -> None:
    tensor = np.array([[1.0, 0.0, 0.2], [0.0, 2.0, 0.0], [0.2, 0.0, 1.5]])
    mass = rigid_mass(4.2, np.array([0.3, -0.2, 0.1]), tensor)
    model = mbdlft.two_port(box(), [M])
    assert not model.states
    target(
        static_gain(model, m=4.2), expected_statics(mass, (0.5, 0.5, 0.0), (-1.0, 0.2, 0.3)), CLOSED_FORM
    )
    ball = mbdlft.two_port(mbdlft.PointMass(name="ball", mass="m"), [M])
    assert ball.order == ball.certificate.order_bound == 3
    target(static_gain(ball, m=4.2), -np.diag([4.2, 4.2, 4.2, 0, 0, 0]), CLOSED_FORM)


def test_a_rigid_body_can_be_held_at_any_port() -> None:
    """Held at its side: the lever arms and the mass matrix are those about that port."""
    r = np.array([-1.0, 0.2, 0.3])
    tensor = np.array([[1.0, 0.0, 0.2], [0.0, 2.0, 0.0], [0.2, 0.0, 1.5]])
    model = mbdlft.two_port(box(), [M], ["tip", "origin"], parent="side")
    assert model.inputs[-1].name == "side.angular_acceleration.z"
    mass = rigid_mass(5.0, np.array([0.3, -0.2, 0.1]) - r, tensor)
    expected = expected_statics(mass, np.array([0.5, 0.5, 0.0]) - r, -r)
    target(static_gain(model), expected, CLOSED_FORM)


def test_statics_of_a_beam() -> None:
    model = mbdlft.two_port(beam(length="L"), [E, L], search=0.0)
    for length in (0.96, 1.2, 1.4):
        line = 2700 * 1e-4 * length
        polar = 2700 * 3e-9 * length
        mass = rigid_mass(
            line,
            np.array([length / 2, 0, 0]),
            np.diag([polar, line * length**2 / 12, line * length**2 / 12]),
        )
        found = static_gain(model, E=60e9, L=length)
        target(found, expected_statics(mass, (length, 0, 0)), BALANCE)


def test_feed_through_is_symmetric() -> None:
    """A load here and an acceleration there, as there and here."""
    for model in (mbdlft.two_port(panel(), [M], search=0.0), mbdlft.two_port(beam(), [E], search=0.0)):
        D = mbdlft.matrices_at(model, {}).D
        size = np.sqrt(np.abs(np.diag(D)))
        scale = np.where(size > 0, size, 1.0)
        balanced = D / scale / scale[:, None]
        target(balanced, balanced.T, BALANCE)


def root(function, low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-14))


CLAMPED_FREE = [root(lambda b: np.cos(b) + 1 / np.cosh(b), *ends) for ends in ((1, 3), (4, 6), (7, 9))]
FREE_FREE = [root(lambda b: np.cos(b) - 1 / np.cosh(b), *ends) for ends in ((4, 6), (7, 9), (10, 12))]


def wave_numbers(model: mbdlft.LFTModel, modulus: float) -> np.ndarray:
    """beta L of the first three frequencies, omega = beta^2 sqrt(E I/(rho A))."""
    values = np.linalg.eigvals(mbdlft.matrices_at(model, {"E": modulus}).A).imag
    unit = np.sqrt(modulus * 2e-9 / (2700 * 1e-4)) / 1.2**2
    found = np.sort(values[values > 0.1 * unit])
    return np.sqrt(found[:3] / unit)


def test_frequencies_of_all_boundary_conditions() -> None:
    """Clamped at P and free at C; both exchanged; free at both; clamped at both."""
    model = mbdlft.two_port(bending(elements=8), [E], axes=PLANE, search=0.0)
    for modulus in (58e9, 83e9):
        for channels, expected in (
            ([], CLAMPED_FREE),
            (LOAD + MOTION, CLAMPED_FREE),
            (MOTION, FREE_FREE),
            (LOAD, FREE_FREE),  # clamped at both ends: the same numbers
        ):
            changed = mbdlft.invert_channels(model, channels) if channels else model
            target(wave_numbers(changed, modulus), expected, FINITE_ELEMENTS)


def values_of(model: mbdlft.LFTModel, values: dict[str, float]) -> np.ndarray:
    A, B, C, D = mbdlft.matrices_at(model, values)
    return np.block([[A, B], [C, D]])


CHANNELS = ["tip", "origin", "tip.torque.z", "tip.force.x", "origin.angular_acceleration.x"]


@settings(max_examples=12, deadline=None)
@given(
    channels=st.lists(st.sampled_from(CHANNELS), min_size=1, unique_by=lambda name: name[:3]),
    modulus=st.floats(56e9, 84e9),
)
def test_inverted_twice_is_the_model(channels: list[str], modulus: float) -> None:
    model = flexible()
    once = mbdlft.invert_channels(model, channels)
    changed = [b.name for a, b in zip(model.inputs, once.inputs, strict=True) if a != b]
    assert changed
    twice = mbdlft.invert_channels(once, changed)
    assert twice.inputs == model.inputs
    assert twice.outputs == model.outputs
    assert once.order == twice.order == model.order
    # entries of one size, as the sizes of the deformations and of the loads differ by powers of ten
    found, expected = (values_of(item, {"E": modulus}) for item in (twice, model))
    rows = np.max(np.abs(expected), axis=1, keepdims=True)
    target(found / rows, expected / rows, BALANCE)


@cache
def flexible() -> mbdlft.LFTModel:
    return mbdlft.two_port(beam(stiffness_damping=1e-5), [E], search=0.0)


def test_inversion_is_that_of_state_space() -> None:
    """Against the formulas for A, B, C, D with one channel set inverted, in numbers."""
    model = flexible()
    once = mbdlft.invert_channels(model, ["tip"])
    for modulus in (57e9, 80e9):
        A, B, C, D = mbdlft.matrices_at(model, {"E": modulus})
        i, o = slice(0, 6), slice(6, 12)
        inner = np.linalg.inv(D[i, i])
        expected = np.block(
            [
                [A - B[:, i] @ inner @ C[i], B[:, i] @ inner, B[:, o] - B[:, i] @ inner @ D[i, o]],
                [-inner @ C[i], inner, -inner @ D[i, o]],
                [C[o] - D[o, i] @ inner @ C[i], D[o, i] @ inner, D[o, o] - D[o, i] @ inner @ D[i, o]],
            ]
        )
        # the tip's own rows cancel: it moves as it is told to
        terms = np.maximum(np.abs(expected), np.abs(values_of(model, {"E": modulus})))
        rows = np.max(terms, axis=1, keepdims=True)
        kappa = float(np.linalg.cond(D[i, i]))
        roundoff(values_of(once, {"E": modulus}) / rows, expected / rows, kappa)


def test_lower_bounds_survive_an_inversion() -> None:
    """Measured again, they are those of the model."""
    arm = mbdlft.Parameter("r", 0.5, percent=30, unit="m")
    body = box().model_copy(update={"ports": {"tip": ("r", 0.5, "2*r")}})
    model = mbdlft.two_port(body, [M, arm], search=0.0)
    once = mbdlft.invert_channels(model, ["origin"])
    assert model.certificate.lower_bound > (0, 0)
    assert tuple(lower_bound(once.lft).values()) == once.certificate.lower_bound
    assert once.certificate.lower_bound == model.certificate.lower_bound
    assert once.certificate.max_relative_error < CLOSED_FORM


def power(model: mbdlft.LFTModel, omega: float) -> np.ndarray:
    """Hermitian matrix of the mean power that harmonic inputs supply.

    Loads of the children times their velocities, and the load of the parent on the body (minus the
    output) times the velocity of the parent.
    """
    A, B, C, D = mbdlft.matrices_at(model, {})
    G = C @ np.linalg.solve(1j * omega * np.eye(len(A)) - A, B) + D
    n = len(D) // 2
    first, second = G[:n], G[n:]
    supplied = np.zeros((2 * n, 2 * n), dtype=complex)
    supplied[:n] = first / (1j * omega)
    supplied[:, n:] += (second / (1j * omega)).conj().T  # (minus F)^* times a/(j omega), transposed
    return 0.25 * (supplied + supplied.conj().T)


@pytest.mark.parametrize("damping", [0.0, 1e-4])
def test_energy_is_balanced(damping: float) -> None:
    """Without damping no mean power goes in; with it, none comes out."""
    model = mbdlft.two_port(bending(stiffness_damping=damping), [E], axes=PLANE, search=0.0)
    for omega in (3.0, 40.0, 333.0, 5000.0):
        found = power(model, omega)
        size = np.sqrt(np.max(np.abs(found), axis=0)) if damping else np.ones(4)
        smallest = np.min(np.linalg.eigvalsh(found / np.outer(size, size)))
        assert smallest > -BALANCE
        if not damping:
            target(found, np.zeros_like(found), BALANCE)


def test_chained_two_ports_are_the_whole_beam() -> None:
    """Z_up = G22 + G21 Z (1 - G11 Z)^-1 G12 of two halves, against a beam with twice the elements."""
    half = mbdlft.two_port(bending(length=0.6, shape_functions="cubic"), [E], axes=PLANE, search=0.0)
    last = mbdlft.two_port(bending(length=0.6, shape_functions="cubic"), [E], [], axes=PLANE, search=0.0)
    whole = mbdlft.two_port(
        bending(length=1.2, elements=4, shape_functions="cubic"), [E], [], axes=PLANE, search=0.0
    )
    omega = np.array([1.0, 30.0, 170.0, 900.0])
    values = {"E": np.array([60e9])}
    G, Z, expected = (mbdlft.frequency_response(model, values, omega)[0] for model in (half, last, whole))
    inner = np.linalg.solve(np.eye(2) - G[:, :2, :2] @ Z, G[:, :2, 2:])
    target(G[:, 2:, 2:] + G[:, 2:, :2] @ Z @ inner, expected, BALANCE)


def test_a_plane_two_port_needs_no_moment_of_area_across_it() -> None:
    """P does not turn about the axis of the beam; where it does, the polar inertia is needed."""
    bent = {"deformations": ["bending_y"], "I_y": None}
    plain, full = (
        mbdlft.two_port(beam(**fields), [E], axes=("x", *PLANE), search=0.0)
        for fields in (bent, {**bent, "I_y": 1e-9})
    )
    found, expected = (mbdlft.matrices_at(model, {"E": 75e9}) for model in (plain, full))
    for name in "ABCD":
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    with pytest.raises(mbdlft.SceneError, match="I_y: needed"):
        mbdlft.two_port(beam(**bent), [E], axes=("rx",), search=0.0)


# Laws of blocks in series, against products of transfers; the blocks against their formulas.

K = mbdlft.Parameter("k", 40.0, low=30.0, high=60.0)
MASS = mbdlft.Parameter("m", 3.0, percent=20)
W = mbdlft.Parameter("w", 2.0, percent=50, unit="Hz")
T = mbdlft.Parameter("T", 20.0, percent=50, unit="ms")
OMEGA = np.array([0.1, 1.0, 4.0, 30.0, 200.0])
CART = kit.plant(
    "0 1 0 0; -k/m -0.4/m 1/m 2/m; 1 0 0 0; -k/m 0 1/m 0", [K, MASS], "p v", "force gust", "position load"
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
