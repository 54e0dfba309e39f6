"""Laws of beams with piezoelectric patches: statics of laminates, energy, equilibrium, voltages."""

import numpy as np
import pytest

import mbdlft
from tests import kit
from tests.close import BALANCE, CLOSED_FORM, FREQUENCY_RESPONSE, LAMINATE, target

# a strip bonded to an aluminum beam, as published, with the permittivity of its erratum
L, T, W, H, E, EP, RHO, RHOP = 0.5, 9.53e-3, 0.03, 2e-3, 60e9, 50e9, 2600.0, 7600.0
D31, EPS = -150e-12, 1.59e-8
MATERIAL = {"density": RHOP, "modulus": EP, "d31": D31, "permittivity": EPS}
PLANE = ("x", "y", "rz")
PARAMETERS = [
    mbdlft.Parameter("E", E, percent=20, unit="Pa"),
    mbdlft.Parameter("d31", D31, low=-2e-10, high=-1e-10),
    mbdlft.Parameter("h", 2.0, percent=30, unit="mm"),
]


def patch(start: int = 0, end: int = 3, side: str = "top", **fields) -> mbdlft.PiezoPatch:
    given = {"width": W, "thickness": H} | MATERIAL | fields
    return mbdlft.PiezoPatch(start=start, end=end, side=side, **given)


def strip(*patches: mbdlft.PiezoPatch, **fields) -> mbdlft.PiezoBeam:
    sizes = {"length": L, "area": W * T, "I_z": W * T**3 / 12, "thickness": T}
    given = {"density": RHO, "modulus": E, "elements": 3, "deformations": ("axial", "bending_y")}
    return mbdlft.PiezoBeam(**({"name": "boom", "patches": patches} | sizes | given | fields))


def clamped(body: mbdlft.PiezoBeam | mbdlft.Beam, parameters=()) -> mbdlft.LFTModel:
    """Its static gains are displacements of the tip, and charges."""
    return mbdlft.to_lft(
        kit.scene(
            "clamped",
            *parameters,
            body,
            kit.weld("wall", "ground", "boom"),
            mbdlft.Position(name="tip", port="boom.tip"),
            mbdlft.SmallRotation(name="turn", port="boom.tip"),
        ),
        search=0.0,
    )


def static(model: mbdlft.LFTModel, **values: float) -> dict[str, np.ndarray]:
    """Static gains by output."""
    A, B, C, D = mbdlft.matrices_at(model, values)
    gains = D - C @ np.linalg.solve(A, B)
    return {signal.name: row for signal, row in zip(model.outputs, gains, strict=True)}


def laminate(side: str, modulus: float, d31: float, h: float) -> tuple[float, float, float]:
    """Elongation and curvature for 1 V, and the charge over the length of the patch, by equilibrium.

    N = EA e - ES k and M = EI k - ES e of the section are the actions of the voltage.
    """
    sign = {"top": 1.0, "bottom": -1.0, "both": 0.0}[side]
    layers = 2 if side == "both" else 1
    lower, upper = 0.5 * T, 0.5 * T + h
    EA = modulus * W * T + layers * EP * W * h
    ES = sign * EP * W * (upper**2 - lower**2) / 2
    EI = modulus * W * T**3 / 12 + layers * EP * W * (upper**3 - lower**3) / 3
    stress = EP * d31 / h
    if side == "both":
        N, M = 0.0, -2 * stress * W * (upper**2 - lower**2) / 2
    else:
        N, M = stress * W * h, -sign * stress * W * (upper**2 - lower**2) / 2
    e, k = np.linalg.solve([[EA, -ES], [-ES, EI]], [N, M])
    strain = e - k * sign * 0.5 * (lower + upper)
    through = d31 * EP * W * (strain if side != "both" else -2 * k * 0.5 * (lower + upper))
    return e, k, through + layers * (EPS - d31**2 * EP) * W / h


@pytest.mark.parametrize("side", ["top", "bottom", "both"])
def test_tip_of_a_unimorph_and_a_bimorph(side: str) -> None:
    body = strip(patch(side=side, thickness="h", d31="d31"), modulus="E")
    model = clamped(body, PARAMETERS)
    assert model.certificate.max_relative_error < BALANCE
    for modulus, d31, h in ((50e9, -1.2e-10, 1.5), (70e9, -1.9e-10, 2.5)):
        e, k, charge = laminate(side, modulus, d31, 1e-3 * h)
        found = static(model, E=modulus, d31=d31, h=h)
        target(found["tip.x"] / L, [e], FREQUENCY_RESPONSE, scale=abs(k) * T)
        target(found["tip.y"], [k * L**2 / 2], FREQUENCY_RESPONSE)
        target(found["turn.z"], [k * L], FREQUENCY_RESPONSE)
        target(found["boom.charge.1"], [charge * L], FREQUENCY_RESPONSE)


def test_tip_of_a_beam_with_a_short_patch() -> None:
    """The patch bends what it covers, the rest goes on straight."""
    found = static(clamped(strip(patch(1, 2, "both"))))
    k = laminate("both", E, D31, H)[1]
    target(found["tip.y"], [k * (L / 3) * (L / 2)], FREQUENCY_RESPONSE)
    target(found["turn.z"], [k * (L / 3)], FREQUENCY_RESPONSE)


def test_two_sides_against_each_other_are_both() -> None:
    pair = clamped(strip(patch(side="top"), patch(side="bottom")))
    both = clamped(strip(patch(side="both")))
    drive = np.array([1.0, -1.0])
    A, B, C, D = mbdlft.matrices_at(pair, {})
    E_, F, G, J = mbdlft.matrices_at(both, {})
    target(A, E_, CLOSED_FORM)
    target(B @ drive, F[:, 0], CLOSED_FORM)
    charge = [s.name for s in pair.outputs].index("boom.charge.1")
    target(drive @ C[charge:], G[-1], BALANCE)
    target(drive @ D[charge:] @ drive, J[-1, 0], CLOSED_FORM)


def test_without_voltage_it_is_the_laminated_beam() -> None:
    """Two layers over all elements, against a beam of the same mass and stiffness: all its matrices."""
    body = strip(patch(side="both"), deformations=("bending_y",))
    EI = E * W * T**3 / 12 + 2 * EP * W * ((0.5 * T + H) ** 3 - (0.5 * T) ** 3) / 3
    line = RHO * W * T + 2 * RHOP * W * H
    same = mbdlft.Beam(
        name="boom",
        length=L,
        density=line,
        area=1.0,
        modulus=EI,
        I_z=1.0,
        elements=3,
        deformations=("bending_y",),
    )
    found = mbdlft.two_port(body, axes=PLANE, search=0.0)
    expected = mbdlft.two_port(same, axes=PLANE, search=0.0)
    n, m = len(expected.states), len(expected.inputs)
    A, B, C, D = mbdlft.matrices_at(found, {})
    for a, b in zip((A, B[:, :m], C[:m], D[:m, :m]), mbdlft.matrices_at(expected, {}), strict=True):
        target(a, b, BALANCE)
    assert n == len(found.states)


def test_the_neutral_axis_moves() -> None:
    """A moment at the tip of a unimorph: its stiffness is EI - ES^2/EA."""
    scene = kit.scene(
        "bent",
        strip(patch()),
        kit.weld("wall", "ground", "boom"),
        kit.torque("bend", "boom.tip", (0, 0, 1), magnitude=0.0),
        mbdlft.SmallRotation(name="turn", port="boom.tip"),
        inputs=["bend.torque"],
    )
    lower, upper = 0.5 * T, 0.5 * T + H
    EA, ES = E * W * T + EP * W * H, EP * W * (upper**2 - lower**2) / 2
    EI = E * W * T**3 / 12 + EP * W * (upper**3 - lower**3) / 3
    found = static(mbdlft.to_lft(scene, search=0.0))["turn.z"]
    target(found, [L / (EI - ES**2 / EA)], FREQUENCY_RESPONSE)


def floating(body: mbdlft.PiezoBeam) -> mbdlft.LFTModel:
    return mbdlft.to_lft(
        kit.scene(
            "floating",
            body,
            kit.planar("base", "ground", "boom", (0, 0, 1)),
            mbdlft.Momentum(name="momentum"),
            inputs=["boom.voltage.1"],
            outputs=["momentum.linear.x", "momentum.linear.y", "momentum.angular.z"],
        ),
        search=0.0,
    )


def momentum_rate(accelerations: np.ndarray, slopes: np.ndarray, first: int, last: int) -> complex:
    """Integral of line mass times the cubic interpolation of the accelerations of four nodes."""
    points, weights = np.polynomial.legendre.leggauss(6)
    s, weights = 0.5 * (points + 1.0), 0.5 * weights
    ds = L / 3
    total = 0.0 + 0.0j
    for k in range(3):
        line = RHO * W * T + (RHOP * W * H if first <= k < last else 0.0)
        value = (1 - 3 * s**2 + 2 * s**3) * accelerations[k]
        value += (s - 2 * s**2 + s**3) * ds * slopes[k]
        value += (3 * s**2 - 2 * s**3) * accelerations[k + 1]
        value += (s**3 - s**2) * ds * slopes[k + 1]
        total += line * ds * np.sum(weights * value)
    return total


def test_actuation_is_in_equilibrium_with_itself() -> None:
    """A voltage gives a free beam no momentum, and the clamped one no load but that of what moves."""
    body = strip(patch(1, 2), stiffness_damping=1e-5, stations={"a": 1, "b": 2})
    model = floating(body)
    _, B, C, _ = mbdlft.matrices_at(model, {})
    size = np.max(np.abs(C) @ np.abs(B))  # of the momentum that the parts have, for 1 V
    target(C @ B, np.zeros((3, 1)), BALANCE, scale=float(size))
    held = mbdlft.two_port(body, children=["a", "b", "tip"], axes=("y", "rz"), search=0.0)
    names = [s.name for s in held.outputs]
    for omega in (0.0, 100.0, 900.0):
        A, B, C, D = mbdlft.matrices_at(held, {})
        found = (C @ np.linalg.solve(1j * omega * np.eye(len(A)) - A, B) + D)[:, -1]
        by_name = dict(zip(names, found, strict=True))
        moved = [0.0, *(by_name[f"{port}.acceleration.y"] for port in ("a", "b", "tip"))]
        turned = [0.0, *(by_name[f"{port}.angular_acceleration.z"] for port in ("a", "b", "tip"))]
        expected = -momentum_rate(np.array(moved), np.array(turned), 1, 2)
        scale = max(abs(expected), float(np.abs(D[:, -1]).max()))
        target(by_name["origin.force.y"], expected, BALANCE, scale=scale)


def power(model: mbdlft.LFTModel, omega: float) -> np.ndarray:
    """Hermitian matrix of the mean power into a two-port with voltages: loads, accelerations, volts."""
    G = mbdlft.frequency_response(model, {}, [omega])[0, 0]
    names = [s.name for s in model.inputs]
    children = [k for k, name in enumerate(names) if name.startswith("tip.")]
    parent = [k for k, name in enumerate(names) if name.startswith("origin.")]
    volts = [k for k, name in enumerate(names) if "voltage" in name]
    supplied = np.zeros(G.shape, dtype=complex)
    supplied[children] = G[children] / (1j * omega)
    supplied[volts] = G[volts] * 1j * omega
    supplied[:, parent] += (G[parent] / (1j * omega)).conj().T
    return 0.25 * (supplied + supplied.conj().T)


@pytest.mark.parametrize("damping", [0.0, 1e-5])
def test_patches_are_passive(damping: float) -> None:
    """No power comes out over a period; the free capacitance is larger than the clamped one."""
    body = strip(patch(0, 1), patch(2, 3, "bottom"), stiffness_damping=damping)
    model = mbdlft.two_port(body, axes=PLANE, search=0.0)
    for omega in (20.0, 190.0, 1300.0, 9000.0):
        found = power(model, omega)
        G = np.abs(mbdlft.frequency_response(model, {}, [omega])[0, 0])
        size = np.sqrt(np.max(np.abs(found), axis=0)) if damping else np.sqrt(np.max(G, axis=0))
        smallest = np.min(np.linalg.eigvalsh(found / np.outer(size, size)))
        assert smallest > -BALANCE
        if not damping:
            target(found / np.outer(size, size), np.zeros_like(found), BALANCE, scale=1.0)
    charge = static(model)["boom.charge.1"][-2]
    clamped_one = mbdlft.matrices_at(model, {}).D[-2, -2]
    assert charge > clamped_one > 0.0


def test_one_voltage_is_the_sum_of_separate_ones() -> None:
    patches = (patch(0, 1), patch(1, 2, thickness="h"), patch(2, 3, d31="2*d31"))
    separate, common = (
        clamped(strip(*patches, common_voltage=one), PARAMETERS[1:]) for one in (False, True)
    )
    assert [s.name for s in separate.inputs] == [f"boom.voltage.{k}" for k in (1, 2, 3)]
    assert [s.name for s in common.outputs][-1] == "boom.charge.1"
    assert common.outputs[-1].unit == "C"
    values = {"d31": -1.1e-10, "h": 1.6}
    apart, one = (mbdlft.frequency_response(m, values, [30.0, 700.0])[0] for m in (separate, common))
    n = len(common.outputs) - 1
    target(apart[:, :n].sum(axis=2), one[:, :n, 0], BALANCE)
    target(apart[:, n:].sum(axis=(1, 2)), one[:, n, 0], BALANCE)


def test_the_strip_next_to_the_clamp_holds_it_most() -> None:
    """Published for three voltages: v1 has the largest effect on the load at P, v3 the smallest."""
    model = mbdlft.two_port(strip(patch(0, 1), patch(1, 2), patch(2, 3)), axes=PLANE, search=0.0)
    torque = np.abs(mbdlft.frequency_response(model, {}, [150.0])[0, 0, 5, 6:])
    assert torque[0] > torque[1] > torque[2]


def test_a_quintic_beam_with_all_its_numbers_as_parameters() -> None:
    many = [
        mbdlft.Parameter("L", L, percent=5, unit="m"),
        mbdlft.Parameter("t", T, percent=5, unit="m"),
        mbdlft.Parameter("w", W, percent=5, unit="m"),
    ]
    body = strip(
        patch(0, 1, width="w"),
        length="L",
        thickness="t",
        area="w*t",
        I_z="w*t^3/12",
        elements=1,
        shape_functions="quintic",
    )
    model = clamped(body, many)
    assert model.certificate.max_relative_error < LAMINATE
    values = {"L": 0.51, "t": 9.3e-3, "w": 0.031}
    fixed = clamped(
        strip(
            patch(0, 1, width=0.031),
            length=0.51,
            thickness=9.3e-3,
            area=0.031 * 9.3e-3,
            I_z=0.031 * 9.3e-3**3 / 12,
            elements=1,
            shape_functions="quintic",
        )
    )
    target(
        mbdlft.frequency_response(model, values, [40.0, 800.0]),
        mbdlft.frequency_response(fixed, {}, [40.0, 800.0]),
        LAMINATE,
    )


def test_a_scene_file_has_patches() -> None:
    body = strip(patch(0, 1), patch(1, 3, "both"), common_voltage=True)
    scene = kit.scene("s", body, kit.weld("wall", "ground", "boom"))
    text = mbdlft.scene_to_toml(scene)
    assert "[[bodies.boom.patches]]" in text
    assert mbdlft.scene_from_toml(text) == scene
    assert [s.name for s in mbdlft.to_lft(scene, search=0.0).inputs] == ["boom.voltage.1"]
