"""Laws of elastic bodies: symmetry, energy, momentum, statics, rigid limits."""

import numpy as np
import pytest

import mbdlft
from tests import kit
from tests.close import CLOSED_FORM, HARD_NUMERIC, SAME_MESH, SCENARIO, STABLE, conditioned, target
from tests.laws import elastic as scenes

ANGLES = [0.0, 35.0, 90.0, -90.0]


def frequencies(scene: mbdlft.Scene) -> np.ndarray:
    """Squares of frequencies from A; negative for a toppling mode."""
    A = mbdlft.to_lft(scene, search=0.0).A
    n = len(A) // 2
    squares = np.linalg.eigvals(-A[n:, :n])
    target(squares.imag / np.max(np.abs(squares)), np.zeros(n), STABLE, 1.0)
    return np.sort(squares.real)


# conservative loads: symmetric matrices, poles in pairs


@pytest.mark.parametrize("angle", ANGLES)
def test_stiffness_under_gravity_is_symmetric(angle: float) -> None:
    found = scenes.motion(scenes.lever(angle, modulus=40.0))
    target(found.M, found.M.T, CLOSED_FORM)
    target(found.K, found.K.T, CLOSED_FORM)
    assert not found.D.any()
    weightless = scenes.lever(angle, modulus=40.0).model_copy(update={"gravity": (0, 0, 0)})
    by_gravity = np.max(np.abs(found.K - scenes.motion(weightless).K))
    assert (by_gravity > 1.0) == (angle != 0.0)  # a level beam is only pushed aside


def test_stiffness_under_a_torque_in_space_is_symmetric() -> None:
    """A weight beside the tip turns it about three axes, whose order does not matter."""
    found = scenes.motion(scenes.beside_the_tip())
    target(found.K, found.K.T, CLOSED_FORM)
    weightless = scenes.beside_the_tip().model_copy(update={"gravity": (0, 0, 0)})
    assert np.max(np.abs(found.K - scenes.motion(weightless).K)) > 1.0


@pytest.mark.parametrize("angle", ANGLES)
def test_energy_is_kept(angle: float) -> None:
    """d/dt (qdot' M qdot + q' K q)/2 = - qdot' D qdot, for every motion of the model."""
    for damping in (0.0, 1e-3):
        scene = scenes.lever(angle, stiffness_damping=damping)
        M, D, K = scenes.motion(scene)
        A, n = mbdlft.to_lft(scene, search=0.0).A, len(M)
        energy = np.block([[K, np.zeros((n, n))], [np.zeros((n, n)), M]])
        lost = np.block([[np.zeros((n, 2 * n))], [np.zeros((n, n)), D]])
        size = np.abs(A.T) @ np.abs(energy)
        change = 0.5 * (A.T @ energy + energy @ A) + lost
        target(change / np.max(size), np.zeros(A.shape), CLOSED_FORM, 1.0)
        assert np.any(D) == (damping > 0.0)
        poles = np.linalg.eigvals(A)
        mirrored = np.array([np.min(np.abs(poles + pole)) for pole in poles])
        paired = float(np.max(mirrored) / np.max(np.abs(poles)))
        assert (paired <= STABLE) == (damping == 0.0)


def test_hanging_lever_swings_and_inverted_one_topples() -> None:
    """With a stiff beam the slow mode is that of the rigid pendulum (Jg = m L^2 + rho A L^3/3)."""
    weight = scenes.GRAVITY * (1.0 + 0.5)
    for angle, sign in ((90.0, 1.0), (-90.0, -1.0)):  # about y, positive is down
        slow = frequencies(scenes.lever(angle, modulus=1e6))
        slow = slow[np.argmin(np.abs(slow))]
        target(slow / (sign * weight / (1.0 + 1.0 / 3.0)), 1.0, STABLE_PENDULUM)


STABLE_PENDULUM = 1e-4  # of a beam with 1e6 N m^2, not of a rigid one


# rigid motion


def test_momentum_of_a_free_beam() -> None:
    """No load, no change; a force changes it by itself and its moment; the center follows."""
    model = mbdlft.to_lft(scenes.free_beam(), search=0.0)
    momentum = model.C_y[:6]
    size = np.abs(momentum) @ np.abs(model.A)
    target((momentum @ model.A) / np.max(size), np.zeros(model.A.shape)[:6], CLOSED_FORM, 1.0)
    force = np.array([0.0, 0.6, 0.8])
    tip = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    expected = np.concatenate([force, np.cross(tip, force)])
    target((momentum @ model.B_u)[:, 0], expected, SCENARIO)
    velocity = model.C_y[6:] @ model.A  # of the center of mass: 2 kg + 1 kg
    target(3.0 * velocity, model.C_y[:3], SCENARIO)


def test_six_rigid_modes() -> None:
    model = mbdlft.to_lft(scenes.free_beam(), search=0.0)
    n = len(model.A) // 2
    squares = np.sort(np.abs(np.linalg.eigvals(model.A[n:, :n])))
    assert np.sum(squares < STABLE * squares[-1]) == 6
    assert np.max(np.linalg.eigvals(model.A).real) < STABLE * np.sqrt(squares[-1])


# statics


def cantilever(**given: object) -> mbdlft.Scene:
    return kit.scene(
        "cantilever",
        kit.body("root", 1.0, yy=1.0),
        scenes.beam(elements=4, **given),
        kit.hinge("hold", "ground", "root", (0, 1, 0), imposed=True),
        kit.weld("clamp", "root", "beam"),
        kit.force("push", "beam.tip", (0, 0, 1), magnitude=0),
        mbdlft.Position(name="tip", port="beam.tip"),
        inputs=("push.force", "ground.acceleration.z"),
        outputs=("tip.z",),
    )


def deflections(scene: mbdlft.Scene) -> np.ndarray:
    """Of the tip, by a unit force there and by a unit acceleration of the ground."""
    model = mbdlft.to_lft(scene, search=0.0)
    own = [k for k, signal in enumerate(model.states) if signal.name.startswith("beam")]
    A, B = model.A[np.ix_(own, own)], model.B_u[own]
    return np.asarray(-model.C_y[:, own] @ np.linalg.solve(A, B))[0]


def test_static_deflections() -> None:
    """L^3/3EI by a force at the tip, rho A g L^4/8EI by weight: exact with cubic elements."""
    conditioned(deflections(cantilever()), [1.0 / 3e3, -1.0 / 8e3], 3e4, HARD_NUMERIC)


def test_static_deflections_with_shear() -> None:
    """L/kGA more by a force at the tip, rho A g L^2/2kGA by weight."""
    found = deflections(cantilever(shear_coefficient=0.8, shear_modulus=500.0))
    target(found, [1.0 / 3e3 + 1.0 / 400.0, -1.0 / 8e3 - 1.0 / 800.0], SCENARIO)


def test_damping_of_a_beam_is_a_sum() -> None:
    """D = a M + b K of the deformations."""
    M, none, K = scenes.motion(cantilever())
    found = scenes.motion(cantilever(mass_damping=0.3, stiffness_damping=2e-3))
    own = slice(len(M) - 8, None)
    target(found.D[own, own], 0.3 * M[own, own] + 2e-3 * K[own, own], CLOSED_FORM)
    assert not none.any()


@pytest.mark.parametrize(
    "deformations", [("torsion", "bending_y", "bending_z"), ("bending_y",), ("axial",)]
)
@pytest.mark.parametrize(
    ("axis", "inertia"), [((1, 0, 0), 0.07), ((0, 1, 0), 1 / 3 + 0.02), ((0, 0, 1), 1 / 3 + 0.05)]
)
def test_inertia_of_a_beam_that_is_not_deformed(
    axis: tuple[int, ...], inertia: float, deformations: tuple[str, ...]
) -> None:
    """rho (I_y + I_z) L about its axis, rho A L^3/3 + rho I L across it, whatever deforms."""
    body = scenes.beam(
        deformations=deformations,
        I_y=0.02,
        I_z=0.05,
        shear_modulus=1e3,
        torsion_constant=1.0,
        rotary_inertia=True,
    )
    hinge = kit.hinge("hinge", "ground", "beam", axis)
    scene = kit.scene("beam", body, hinge)
    target(scenes.motion(scene).M[0, 0], inertia, CLOSED_FORM)


@pytest.mark.parametrize("counts", [(8, 16), pytest.param((16, 32), marks=pytest.mark.long)])
def test_beam_under_gravity_is_the_limit_of_rigid_rods(counts: tuple[int, int]) -> None:
    """Rods on springs converge to the beam with the square of their length."""
    beam = scenes.lever(0.0, elements=20, modulus=100.0)
    fine = frequencies(beam)[1:4]
    errors = []
    for count in counts:
        rods = frequencies(scenes.segments(count, bending=100.0))[1:4]
        errors.append(np.max(np.abs(rods / fine - 1.0)))
    assert errors[1] < errors[0] / 2.5
    torques = [mbdlft.to_lft(scene, search=0.0).trim.nominal[0] for scene in (beam, scenes.segments(2))]
    target(torques[0], torques[1], CLOSED_FORM)


# parameters


def test_all_parameters_of_a_modal_body() -> None:
    model = mbdlft.to_lft(scenes.panel(), search=0.0)
    values = mbdlft.random(model.parameters, 50, seed=2)
    found = mbdlft.matrices_at(model, values)
    for k in range(50):
        A, B = scenes.panel_matrices({name: float(x[k]) for name, x in values.items()})
        target(found.A[k], A, SCENARIO)
        target(found.B[k], B, SCENARIO)


@pytest.mark.parametrize("functions", ["cubic", "quintic"])
def test_parameters_of_a_beam_are_rebuilt(functions: str) -> None:
    """Length, section, modulus, density and tip mass: the model is that of a beam with the numbers."""
    parameters = [
        mbdlft.Parameter("L", 1.0, percent=30, unit="m"),
        mbdlft.Parameter("E", 50.0, percent=30, unit="Pa"),
        mbdlft.Parameter("t", 1.0, percent=20, unit="m"),
        mbdlft.Parameter("rho", 1.2, percent=30, unit="kg m^-3"),
        mbdlft.Parameter("mt", 0.5, percent=50, unit="kg"),
    ]

    def scene(given: dict[str, float] | None) -> mbdlft.Scene:
        v = given or {p.name: p.name for p in parameters}
        wide = {"w": mbdlft.Constant(value=1.0, unit="m")}
        beam = scenes.beam(
            length=v["L"],
            modulus=v["E"],
            density=v["rho"],
            area=v["t"] if given else "w*t",
            I_y=given["t"] ** 3 if given else "w*t^3",
            elements=2,
            shape_functions=functions,
            prestress="neglected",
        )
        bob = kit.point("bob", v["mt"])
        found = () if given else tuple(parameters)
        given_too = {"bodies": (beam, bob), "parameters": found, "constants": wide}
        return scenes.lever(20.0).model_copy(update=given_too)

    model = mbdlft.to_lft(scene(None), search=0.0)
    values = mbdlft.random(model.parameters, 3, seed=8)
    for k in range(3):
        point = {name: float(x[k]) for name, x in values.items()}
        frozen = mbdlft.to_lft(scene(point), search=0.0)
        found = mbdlft.matrices_at(model, point)
        size = np.max(np.abs(frozen.A), axis=1, keepdims=True)
        target((found.A - frozen.A) / size, np.zeros(found.A.shape), SAME_MESH, 1.0)
        target(mbdlft.trim_at(model, point), frozen.trim.nominal, SCENARIO)
