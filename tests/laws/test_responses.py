"""Responses over frequency and time, and norms, against closed forms and other tools."""

import re
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import control
import flint
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.optimize import minimize_scalar

import mbdlft
from mbdlft import StructureError
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.response import frequency, norms
from mbdlft.response.frequency import peaks
from mbdlft.response.modes import samples_at
from mbdlft.response.staircase import Plant
from mbdlft.show.figures.figures import mark_unbounded
from mbdlft.show.report import sentences
from mbdlft.system.sampled import StateMatrices
from tests import kit
from tests.attack.norms import drifting
from tests.close import CHAIN, CLOSED_FORM, ELASTIC, NORM, PEAK, RESPONSE, exact, roundoff, target
from tests.oscillators import (
    free_chain,
    matrices,
    oscillator,
    plain,
    random_system,
    spring_and_mass,
    two_masses,
)

# over frequency -----------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [1e-1, 1e-2, 1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("omega", [1.0, 37.0])
def test_peaks_are_right_whatever_the_damping(damping: float, omega: float) -> None:
    exact_peak = 1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2) * omega**2)
    system = oscillator(damping, omega)
    found = np.max(np.abs(mbdlft.frequency_response(system, {}, mbdlft.response_frequencies(system))))
    target(found, exact_peak, PEAK)


def test_peak_of_every_sample_is_right() -> None:
    model = spring_and_mass("0.0004")
    values = mbdlft.random(model.parameters, 40)
    omega = mbdlft.response_frequencies(model, values)
    found = np.max(np.abs(mbdlft.frequency_response(model, values, omega)), axis=(1, 2, 3))
    k, m, c = values["k"], values["m"], 0.0004
    zeta = c / (2.0 * np.sqrt(k * m))
    target(found, 1.0 / (2.0 * zeta * np.sqrt(1.0 - zeta**2) * k), PEAK)
    # evenly spaced ones alone miss it
    even = np.geomspace(omega[0, 0], omega[0, -1], omega.shape[1])
    missed = np.max(np.abs(mbdlft.frequency_response(model, values, even)), axis=(1, 2, 3))
    assert np.min(missed / found) < 0.5


def test_peaks_of_two_modes_side_by_side() -> None:
    """Modes at 1 and 1.001 rad/s with damping 0.01 % and 0.03 %, against a fine search."""
    A = np.zeros((4, 4))
    for k, (w, z) in enumerate(((1.0, 1e-4), (1.001, 3e-4))):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, 1.0], [-w * w, -2.0 * z * w]]
    system = plain(A, [[0.0], [1.0], [0.0], [1.0]], [[1.0, 0.0, 1.0, 0.0], [1.0, 0.0, -1.0, 0.0]])
    largest = mbdlft.singular_values(
        mbdlft.frequency_response(system, {}, mbdlft.response_frequencies(system))
    )
    fine = np.linspace(0.999, 1.002, 60_001)
    expected = mbdlft.singular_values(mbdlft.frequency_response(system, {}, fine))
    target(np.max(largest[..., 0]), np.max(expected[..., 0]), PEAK)


def test_values_where_eigenvectors_give_no_triangle() -> None:
    """Repeated undamped pairs in one chain: a Jordan block of each frequency, turned."""
    block = np.array([[0.0, 1.0], [-1.0, 0.0]])
    A = np.kron(np.eye(3), block) + np.kron(np.eye(3, k=1), np.eye(2))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(6, 6)))[0]
    system = plain(turn @ A @ turn.T, turn[:, :1], turn[:, 5:].T)
    omega = np.array([0.0, 0.3, 0.9, 1.2, 40.0])
    expected = [
        np.linalg.solve(1j * w * np.eye(6) - A, np.eye(6)[:, :1])[5:] for w in omega
    ]  # turned back
    roundoff(mbdlft.frequency_response(system, {}, omega)[0], expected, kappa=1e4)


def test_values_are_those_of_elimination_and_triangles_are_used() -> None:
    """What triangles would get wrong goes to elimination: slow, and no other test would see it."""
    omega = np.geomspace(1e-3, 1e3, 40)
    for seed in range(5):
        A, B, C, D = matrices(system := random_system(seed, 9, 3, 2, direct=True))
        expected = [C @ np.linalg.solve(1j * w * np.eye(9) - A, B) + D for w in omega]
        roundoff(mbdlft.frequency_response(system, {}, omega)[0], expected, kappa=100.0)
        whole = StateMatrices(A[None], B[None], C[None], D[None])
        values = np.empty((1, 40, 3, 2), complex)
        assert np.all(frequency._by_triangles(whole, 1j * omega[None], values))
        roundoff(values[0], expected, kappa=100.0)


def held_at_root(beam: mbdlft.Beam) -> tuple[Any, ...]:
    """A beam, a weld at its root, and a push across its tip."""
    push = kit.force("push", f"{beam.name}.tip", (0, 1, 0), magnitude=0.0)
    return beam, kit.weld("root", "ground", beam.name), push


def test_accelerations_far_below_the_modes_of_a_clamped_beam_keep_their_digits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """-w^2 times the deflection l^3/(3 E I) of the tip: D + C (sI - A)^-1 B has three digits of it."""
    length, E, second = np.array([2.5, 3.3]), 210e9, 2e-6
    beam = mbdlft.Beam(
        name="beam", length="L", density=7800.0, area=1e-2, modulus=E, I_z=second, elements=2,
        deformations=("bending_y",),
    )  # fmt: skip
    scene = kit.scene(
        "held",
        mbdlft.Parameter("L", 3.0, percent=20, unit="m"),
        *held_at_root(beam),
        inputs=["push.force"],
        outputs=["beam.bending_y.3.acceleration"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    omega = np.array([1e-4, 5e-4])  # the slowest mode has 23 rad/s: its part is below 1e-9
    found = mbdlft.frequency_response(model, {"L": length}, omega)[:, :, 0, 0]
    expected = -(omega**2) * (length**3 / (3.0 * E * second))[:, None]
    assert np.max(np.abs(found / expected - 1.0)) < 1e-8
    plain_sum = frequency.resolvent(samples_at(model, {"L": length}), 1j * np.tile(omega, (2, 1)))[
        :, :, 0, 0
    ]
    assert np.max(np.abs(plain_sum / expected - 1.0)) > 1e-6, "what the sum in doubles carries"
    ((omega_6, has_position),) = frequency.carried_from(model).values()
    assert has_position
    omega = omega_6 * np.array([[1.0, 0.01]])
    whole = frequency.resolvent(samples_at(model), 1j * omega).ravel()
    errors = np.abs(whole / mbdlft.frequency_response(model, {}, omega).ravel() - 1.0)
    assert errors[0] < 1e-6 < errors[1] < 1e-2
    assert not any("accelerations" in text for text in sentences.checked_beside(model))
    monkeypatch.setattr(sentences, "_EARLY", 0.0)
    (said,) = (text for text in sentences.checked_beside(model) if "accelerations" in text)
    assert f"six digits of beam.bending_y.3.acceleration from {omega_6:.2g} rad/s on" in said


def short_beam(g: float, *sensors: object, outputs: list[str]) -> mbdlft.LFTModel:
    """A steel beam of 0.2 m, held at its root, below gravity along it; a push and sensors at its tip."""
    beam = mbdlft.Beam(
        name="beam", length=0.2, density=7800.0, area=1e-3, modulus=210e9, I_z=1e-7, elements=8,
        deformations=("bending_y",),
    )  # fmt: skip
    scene = kit.scene(
        "short",
        *held_at_root(beam),
        *(kit.point("cap", 0.1, ports={"end": (0.1, 0.0, 0.0)}), kit.weld("on", "beam.tip", "cap")),
        *sensors,
        gravity=(-g, 0.0, 0.0),
        inputs=["push.force"],
        outputs=outputs,
    )
    return mbdlft.to_lft(scene, search=0.0)


def test_an_accelerometer_feels_gravity_far_below_the_modes_of_a_stiff_beam() -> None:
    """g in a row of 3e12 1/s^2 makes it no acceleration; at 0.01 rad/s nothing else is left."""
    sensors = [
        kind(name=kind.kind, port="beam.tip") for kind in (mbdlft.Accelerometer, mbdlft.SmallRotation)
    ]
    model = short_beam(9.81, *sensors, outputs=["accelerometer.y", "rotation.z"])
    felt, turn = mbdlft.frequency_response(model, {}, [0.01])[0, 0, :, 0]
    assert abs(felt / (-9.81 * turn) - 1.0) < 1e-4  # of 1e-6 m/s^2; the terms of the sum are near 1


def test_accelerations_without_a_position_have_digits_from_where_the_certificate_says() -> None:
    """The place of the end is no coordinate: without what is decided on residues it is a sum."""
    sensors = [kind(name=kind.kind, port="cap.end") for kind in (mbdlft.Acceleration, mbdlft.Position)]
    whole = short_beam(0.0, *sensors, outputs=["acceleration.y", "position.y"])
    assert whole.certificate.accelerations == (0,)
    model = replace(whole, certificate=replace(whole.certificate, accelerations=()))
    omega_6, has_position = frequency.carried_from(model)["acceleration.y"]
    assert not has_position
    assert frequency.carried_from(whole)["acceleration.y"] == (omega_6, True)
    omega = omega_6 * np.array([1.0, 0.01])
    loop = mbdlft.feedback(whole, np.array([[0.1, 5.0]]))  # changes no relation of the two
    assert loop.certificate.accelerations == (0,)
    assert not (whole["acceleration.y", "push.force"] + 1.0).certificate.accelerations
    for system in (model, whole, loop):
        found, place = mbdlft.frequency_response(system, {}, omega)[0, :, :, 0].T
        errors = np.abs(found / (-(omega**2) * place) - 1.0)
        assert errors[0] < 1e-6
        assert errors[1] > 1e-6 if system is model else errors[1] < 1e-9
    said = [text for text in sentences.checked_beside(model) if text.startswith("accelerations")]
    assert said[0].endswith("below, it has fewer: take -w^2 times a position of the same place")


@pytest.mark.parametrize("factor", [1.0, -1000.0])
def test_what_is_free_along_one_axis_is_held_across_it_by_all_forces(factor: float) -> None:
    """By one across, all digits were lost: without a force along it nothing told the free place from
    its rate. By one in both, those of multiples: as -w^2 times a place they were powers of two only.
    """
    pushes = ("both", "cart", (1, 1, 0)), ("across", "slider", (0, 1, 0))
    loads = (kit.force(*push, frame="ground", magnitude=0.0) for push in pushes)
    scene = kit.scene(
        "cart",
        mbdlft.Parameter("k", 400.0, percent=20, unit="N/m"),
        *(kit.body("cart", 2.0, (0.1, 0.1, 0.2)), kit.body("slider", 1.3, (0.1, 0.1, 0.2)), *loads),
        kit.planar(
            "wheels", "ground", "cart", (0, 0, 1), stiffness=(0.0, "k", 50.0), preload=(0.0, 0.0, 0.0)
        ),
        kit.rail("rail", "cart", "slider", (0, 1, 0), position=0.3, stiffness=33.0, damping=0.1),
        *(kind(name=kind.kind, port="cart") for kind in (mbdlft.Acceleration, mbdlft.Position)),
        *(
            kind(name=f"slider_{kind.kind}", port="slider")
            for kind in (mbdlft.Acceleration, mbdlft.Position)
        ),
        inputs=["both.force", "across.force"],
    )
    model, omega = factor * mbdlft.to_lft(scene), np.array([1e-5, 1e-3])  # modes are above 4 rad/s
    square = (omega**2)[:, None]
    by_both = model[["acceleration.y", "position.y"], "both.force"]
    felt, place = np.moveaxis(mbdlft.frequency_response(by_both, {"k": 390.0}, omega)[0], 1, 0)
    target(felt / place / square, -np.ones((2, 1)), RESPONSE)
    across = model[["slider_acceleration.y", "slider_position.y", "position.x"], "across.force"]
    felt, place, _ = np.moveaxis(mbdlft.frequency_response(across, {"k": 390.0}, omega)[0], 1, 0)
    target(felt / place / square, -np.ones((2, 1)), RESPONSE)


def pair(low: float) -> mbdlft.LFTModel:
    """Two masses side by side with a spring between, one on another that may be soft; a force on one."""
    along = 0.6, 0.8, 0.0
    scene = kit.scene(
        "pair",
        mbdlft.Parameter("k", 1e4, low=low, high=2e4, unit="N/m"),
        *(kit.point("near", 3.0), kit.point("far", 3.0)),
        kit.rail("first", "ground", "near", along, position=0.0, stiffness="k"),
        kit.rail("second", "ground", "far", along, position=1.0),
        kit.spring("link", "near", "far", stiffness=7e3, force_density=0.0),
        mbdlft.Acceleration(name="felt", port="far"),
        outputs=["first.acceleration", "felt.x"],
        inputs=["second.force"],
    )
    return mbdlft.to_lft(scene)


def test_what_a_force_at_another_place_accelerates_has_its_digits_far_below_the_modes() -> None:
    """D is zero, and what cancels are the two terms of C x."""
    omega, k, model = 1e-6, np.array([5e3, 2e4]), pair(1e3)
    assert model.certificate.accelerations == (0, 1)
    with patch("mbdlft.pipeline.forms._MOST_EXACT", 0):
        assert pair(1e3).certificate.accelerations == (0, 1)
    assert not mbdlft.truncate(model, 10.0).certificate.accelerations
    first, felt = mbdlft.frequency_response(model, {"k": k}, [omega])[:, 0, :, 0].T
    target(first, -(omega**2) / k, CLOSED_FORM)
    target(felt, -0.6 * omega**2 * (1.0 / k + 1.0 / 7e3), CLOSED_FORM)


def test_accelerations_of_what_a_sample_hardly_holds_are_those_of_its_force() -> None:
    """A stiffness of 1e-9 beside 7e3 gives factors with four digits."""
    k, w = np.array([0.0, 1e-9, 1e4]), 0.1
    rows = np.array([[0.0, 1.0], [1.0, 1.0]])  # a rate, and a sum of two, which has factors
    found = mbdlft.frequency_response(rows @ pair(0.0), {"k": k}, [w])[:, 0, :, 0]
    stiff, soft = 7e3 - 3.0 * w**2, k - 3.0 * w**2
    both = np.array([np.full(3, 7e3), 0.6 * (soft + 7e3)])
    target(found.T, -(w**2) * (rows @ both) / (soft * stiff - 3.0 * w**2 * 7e3), RESPONSE)


def floating(**base: float) -> mbdlft.LFTModel:
    """Two bodies on one axis, a spring, a damper and a motor between them, a torque on the second."""
    scene = kit.scene(
        "floating",
        mbdlft.Parameter("k", 50.0, low=0.0, high=100.0, unit="N m/rad"),
        mbdlft.Parameter("J", 0.7, percent=20, unit="kg m^2"),
        *(kit.body("first", 1.0, zz="J"), kit.body("second", 1.0, zz=0.3)),
        kit.hinge("base", "ground", "first", (0, 0, 1), **base),
        kit.hinge("motor", "first", "second", (0, 0, 1), stiffness="k", damping=0.1),
        mbdlft.AngularAcceleration(name="far", port="second"),
        kit.torque("push", "second", (0, 0, 1), magnitude=0.0),
        inputs=["motor.torque", "push.torque"],
        outputs=["base.angle", "base.acceleration", "far.z", "motor.acceleration"],
    )
    return mbdlft.to_lft(scene, search=0.0)


def test_gains_beside_a_free_structure_leave_its_digits() -> None:
    """In other units, and for sums of accelerations: they were off by 1e4 at 1e-8 rad/s."""
    model, omega = floating(), 10.0 ** np.arange(-8.0, 2.0)
    plain = mbdlft.frequency_response(model, {}, omega)
    sums = np.array([[0.0, 2.0, 0.0, 3.0], [0.0, 0.0, 1.0, -0.5]])
    gains = mbdlft.as_system(np.eye(1), inputs=["apart"], outputs=["too"])
    for whole, expected in (
        (1e3 * model, 1e3 * plain),
        (model * np.diag([2.0, 3.0]), plain * [2.0, 3.0]),
        (sums @ model, sums @ plain),
        (mbdlft.append(model, gains)[:4, :2], plain),
        (mbdlft.feedback(model, np.zeros((2, 4))), plain),
    ):
        found = mbdlft.frequency_response(whole, {}, omega)[..., 0] / expected[..., 0]  # by the motor
        target(found, np.ones(found.shape), RESPONSE)
    assert (sums @ model).certificate.rigid_motions == (1, 1)
    assert (np.ones((1, 4)) @ model).certificate.accelerations == ()  # the angle is in it
    assert (model + np.ones((4, 2))).certificate.accelerations == ()  # and here the torques
    assert mbdlft.feedback(model, np.ones((2, 4))).certificate.momenta == ()
    assert (2.0 * mbdlft.realize([["3"]])).certificate.momenta == ()  # gains alone
    assert ((2.0 + 1.0j) * model).certificate.momenta == ()  # nothing is known beside complex numbers


def test_free_structures_beside_actuators_sensors_and_each_other_keep_their_digits() -> None:
    """Whatever has states took the momenta away: 3e-6 were off at 1e-4 rad/s, all digits at 1e-7."""
    model, lag = floating(), mbdlft.as_system(mbdlft.low_pass(2e-3), name="lag")
    omega, names = 10.0 ** np.arange(-8.0, 2.0), [signal.name for signal in model.outputs]
    plain, g = mbdlft.frequency_response(model, {}, omega)[0], 2e-3 / (1j * omega + 2e-3)
    two = mbdlft.append(model, mbdlft.as_system(model, inputs=["M", "P"], outputs=["a", "b", "c", "d"]))

    def loop(k: int) -> tuple[mbdlft.System, np.ndarray]:
        wires = {"motor.torque": ["M", "-lag.output"], "lag.command": names[k]}
        whole = mbdlft.connect([model, lag], wires, inputs=["M", "push.torque"], outputs=names)
        opened = g[:, None] * plain[:, k]
        return whole, plain - plain[:, :, :1] * (opened / (1.0 + opened[:, :1]))[:, None]

    by_angle, by_acceleration = loop(0), loop(3)
    columns, rows = (np.stack([g, *[np.ones(10)] * n], axis=-1) for n in (1, 3))
    free, of_two = (-1, 1, 1, 1), (-2, 2, 2, 2)
    for whole, expected, motions in (
        (mbdlft.append(model, lag)[:4, :2], plain, free),
        (two[:4, :2], plain, of_two),
        (two[4:, 2:], plain, of_two),
        (mbdlft.series(model, "motor.torque", lag), plain * columns[:, None], free),
        (mbdlft.series(model, "push.torque", lag), plain * columns[:, None, ::-1], free),
        (mbdlft.series(model, "base.angle", lag), plain * rows[:, :, None], free),
        (by_angle[0][:, "M"], by_angle[1][:, :, :1], ()),
        (*by_acceleration, free),
    ):
        assert whole.certificate.rigid_motions == motions
        found = mbdlft.frequency_response(whole, {}, omega)[0] / expected
        target(found, np.ones(found.shape), RESPONSE)


def test_a_motor_between_two_free_bodies_moves_them_as_it_should_at_all_frequencies() -> None:
    """It leaves the momentum, which rounding does not; at k = 0 the bodies have two."""
    model, second = floating(), 0.3
    k, J, w = (
        np.array([[0.0], [1.0], [80.0]]),
        np.array([[0.6], [0.8], [0.7]]),
        10.0 ** np.arange(-6.0, 3.0),
    )
    s, law = 1j * w, k + 0.1j * w
    turn = np.array([1.0 / (J * s**2 + (1.0 + J / second) * law)])  # of the first, back
    between = 1.0 / (second * s**2 + (1.0 + second / J) * law)  # by the push
    base = np.concatenate([-turn, [law * between / (J * s**2)]])
    far = np.concatenate([turn * J / second, [(1.0 / s**2 - J * base[1]) / second]])
    relative = np.concatenate([turn * (1.0 + J / second), [between]])
    expected = np.array([base, s**2 * base, s**2 * far, s**2 * relative])
    values = {"k": k[:, 0], "J": J[:, 0]}
    found = np.moveaxis(mbdlft.frequency_response(model, values, w), (2, 3), (0, 1))
    target((found / expected)[..., 1:, :], np.ones((4, 2, 2, len(w))), CLOSED_FORM)
    # what no spring holds stays as it is, and loses digits
    target((found / expected)[..., 0, 3:], np.ones((4, 2, len(w) - 3)), RESPONSE)
    alone = model["far.z", "motor.torque"]
    target(mbdlft.frequency_response(alone, values, w)[1:, :, 0, 0], expected[2, 0, 1:], CLOSED_FORM)


def test_momenta_that_inputs_leave_are_those_that_nothing_else_changes() -> None:
    model = floating()
    alone, push = model["far.z", "motor.torque"], model["far.z", "push.torque"]
    loop, truncated = mbdlft.feedback(alone, np.array([[0.1]])), mbdlft.truncate(model, 10.0)
    turned = mbdlft.invert_channels(model["motor.acceleration", "motor.torque"], ["motor"])
    for system, momenta, motions, accelerations in (
        (model, (1, 0), (-1, 1, 1, 1), (1, 2, 3)),
        (alone, (1,), (1,), (0,)),
        (push, (), (1,), (0,)),
        (model["base.angle", "push.torque"], (), (-1,), ()),
        (loop, (1,), (1,), (0,)),
        (turned, (1,), (1,), ()),
        (truncated, (), (), ()),
        (floating(damping=0.1), (), (), ()),
        (floating(stiffness=1.0), (), (), (1, 2, 3)),
    ):
        assert system.certificate.momenta == momenta
        assert system.certificate.rigid_motions == motions
        assert system.certificate.accelerations == accelerations
    w = np.array([1e-4])
    found = (mbdlft.frequency_response(system, {}, w)[0, 0] for system in (push, model))
    target(next(found)[0, 0], next(found)[2, 1], CLOSED_FORM)
    said = (
        r"certificate, momenta: push.torque leaves all momenta, and .* at J = 0.7 kg m\^2, k = 50 N m/rad"
    )
    with pytest.raises(StructureError, match=said):
        replace(model, certificate=replace(model.certificate, momenta=(1, 1)))


def test_accelerations_of_what_is_free_are_so_in_loops_that_hold_it() -> None:
    """They were known by inputs that leave momenta only, and the loop lost all digits."""
    plant = floating()[["base.angle", "far.z"], "push.torque"]
    loop, omega = mbdlft.feedback(plant, np.array([[1.0, 0.0]])), 10.0 ** np.arange(-8.0, -3.0)
    assert loop.certificate.accelerations == (1,)
    opened, closed = (mbdlft.frequency_response(s, {}, omega)[0, :, :, 0] for s in (plant, loop))
    target(closed * (1.0 + opened[:, :1]) / opened, np.ones((5, 2)), CLOSED_FORM)


@pytest.mark.parametrize(("first", "share"), [(1e3, 1.0), (0.0, 1.0 / 3.0)], ids=["held", "free"])
def test_what_a_force_far_away_accelerates_has_its_digits_beside_states_that_move_more(
    first: float, share: float
) -> None:
    """A force between two masses of a chain moves those beyond together, with a spring at rest."""
    along = (1, 0, 0)
    scene = kit.scene(
        "chain",
        mbdlft.Parameter("k", 3e3, percent=20, unit="N/m"),
        *(kit.point(name, 1.5) for name in ("a", "b", "c")),
        kit.rail("to_a", "ground", "a", along, position=0.0, stiffness=first),
        kit.rail("to_b", "a", "b", along, position=1.0, stiffness="k"),
        kit.rail("to_c", "b", "c", along, position=1.0, stiffness=4e4),
        mbdlft.Acceleration(name="last", port="c"),
        kit.force("push", "a", along, magnitude=0.0),
        inputs=["to_b.force", "push.force"],
        outputs=["last.x", "to_c.acceleration"],
    )
    omega, k = np.array([1e-5, 1e-4]), np.array([2.5e3, 3.5e3])
    found = mbdlft.frequency_response(mbdlft.to_lft(scene, search=0.0), {"k": k}, omega)
    target(found[:, :, 0, 0] * k[:, None] / omega**2, np.full((2, 2), -share), RESPONSE)
    if not first:  # the last mass is accelerated by its spring
        target(found[:, :, 1, 1] * 4e4 / omega**2, np.full((2, 2), 1.0 / 3.0), RESPONSE)


def sprung() -> mbdlft.Scene:
    """Two bodies in a plane with three springs: no coordinate is rigid."""
    ports = {"a": (0.5, 0.3, 0), "b": (0.5, -0.3, 0), "c": (0.2, 0.5, 0)}
    springs = ("a", 3e4, 0.1), ("b", 200.0, 0.1), ("c", "k", 0.0)
    return kit.scene(
        "sprung",
        mbdlft.Parameter("k", 3e4, percent=20, unit="N/m"),
        kit.body("one", 2.0, (0.1, 0.1, 0.2), ports=ports),
        kit.body("two", 1.5, (0.1, 0.1, 0.2), ports=ports),
        kit.planar("to_one", "ground", "one"),
        kit.planar("to_two", "ground", "two", position=(2.0, 0.1, 0.3)),
        *(
            kit.spring(p, f"one.{p}", f"two.{p}", stiffness=k, damping=c, force_density=0.0)
            for p, k, c in springs
        ),
        *(kind(name=kind.kind, port="two.b") for kind in (mbdlft.Position, mbdlft.Acceleration)),
        inputs=["a.force_density", "c.force_density"],
        outputs=["acceleration.x", "acceleration.y", "position.x", "position.y"],
    )


def in_a_row() -> mbdlft.Scene:
    """Two bodies in a row, springs across: a push along turns them by stretches alone."""
    ports = {"a": (0.5, 0.3, 0), "b": (0.5, -0.3, 0), "c": (0.2, 0.5, 0)}
    springs = ("a", 3e4, 0.1), ("b", 200.0, 0.1), ("c", "k", 0.0)
    kinds = mbdlft.Velocity, mbdlft.Acceleration, mbdlft.AngularRate, mbdlft.AngularAcceleration
    seen = ["velocity.x", "velocity.y", "acceleration.x", "acceleration.y"]
    return kit.scene(
        "in_a_row",
        mbdlft.Parameter("k", 3e4, low=0.0, high=6e4, unit="N/m"),
        *(kit.body(name, m, (0.1, 0.1, 0.2), ports=ports) for name, m in (("one", 2.0), ("two", 1.5))),
        kit.planar("to_one", "ground", "one"),
        kit.planar("to_two", "ground", "two", position=(2.0, 0.0, 0.3)),
        *(
            kit.spring(p, f"one.{p}", f"two.{p}", stiffness=k, damping=c, force_density=0.0)
            for p, k, c in springs
        ),
        *(kind(name=kind.kind, port="two") for kind in kinds),
        kit.force("push", "one", (1, 0, 0), frame="ground", magnitude=0.0),
        kit.torque("turn", "one", (0, 0, 1), magnitude=0.0),
        inputs=["push.force", "turn.torque", "a.force_density"],
        outputs=[*seen, "angular_rate.z", "angular_acceleration.z"],
    )


ACROSS = (0, 1), (1, 0), (2, 1), (3, 0), (4, 0), (5, 0)


def test_what_a_push_moves_by_stretches_alone_has_its_digits() -> None:
    """What rounding makes of the motion along it was in the motion across: 1e-6 rad/s had no digits."""
    scene, omega = in_a_row(), 10.0 ** np.arange(-7.0, 2.0)
    model, at = mbdlft.to_lft(scene, search=0.0), problem_of_scene(scene).reference()
    truth = at.transfers_in_digits([0], omega)[0]
    assert model.certificate.unmoved == ACROSS
    for gains, unmoved in (
        (np.eye(6), ACROSS),
        ([[0.0, 0.0, 2.0, 0.0, 0.0, 0.0]], ((0, 1),)),
        ([[0.0, 1.0, 0.0, 0.0, 3.0, 0.0]], ((0, 0),)),
        ([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]], ()),
    ):
        whole = gains @ model
        assert whole.certificate.unmoved == unmoved
        found = mbdlft.frequency_response(whole, {}, omega)[0] / (gains @ truth)
        target(found, np.ones(found.shape), RESPONSE)
    alone = model["angular_rate.z", "push.force"]
    assert alone.certificate.unmoved == ((0, 0),)
    assert mbdlft.unbounded_frequencies(alone)[0].size == 0
    peak = mbdlft.hinf_norm(alone)
    target(peak.lower[0], np.abs(at.transfers_in_digits([0], peak.frequency)[0, 0, 4, 0]), NORM)
    times = np.array([0.0, 1e8])
    steps = mbdlft.step_response(model, {}, times).values[0, -1]
    target(steps[[3, 5, 4], 0], [0.0, 0.0, 0.0], ELASTIC)
    impulses = mbdlft.impulse_response(model, {}, times).values[0, -1]
    target(impulses[[1, 4, 0], [0, 0, 1]], [0.0, 0.0, 0.0], ELASTIC)
    both, first = (mbdlft.frequency_response(m, {"k": [0.0, 3e4]}, omega) for m in (model, alone))
    target(first[..., 0, 0], both[..., 4, 0], CLOSED_FORM)
    wide = replace(
        model, certificate=replace(model.certificate, rigid_motions=(), momenta=(), unmoved=())
    )
    fast = np.array([0.1, 1.0])  # and without a spring only two are left: what is known says nothing
    found, plain = (mbdlft.frequency_response(m, {"k": 0.0}, fast) for m in (model, wide))
    target(found / plain, np.ones(found.shape), RESPONSE)


def test_what_a_push_does_not_move_is_so_beside_filters_and_in_loops() -> None:
    scene, omega = in_a_row(), 10.0 ** np.arange(-7.0, 2.0)
    model, lag = mbdlft.to_lft(scene, search=0.0), mbdlft.as_system(mbdlft.low_pass(2e-3), name="lag")
    plain, g = mbdlft.frequency_response(model, {}, omega)[0], 2e-3 / (1j * omega + 2e-3)
    columns, rows = np.ones((9, 6, 3), dtype=complex), np.ones((9, 6, 3), dtype=complex)
    columns[:, :, 1], rows[:, 0] = g[:, None], g[:, None]
    names = [signal.name for signal in model.outputs]
    wires = {"a.force_density": ["M", "-lag.output"], "lag.command": "acceleration.y"}
    loop = mbdlft.connect([model, lag], wires, inputs=["push.force", "turn.torque", "M"], outputs=names)
    back = plain[:, :, 2:] * (g[:, None] * plain[:, 3] / (1.0 + g * plain[:, 3, 2])[:, None])[:, None]
    two = mbdlft.append(model, mbdlft.as_system(model, inputs=[*"abc"], outputs=[*"defghi"]))
    for whole, expected, unmoved in (
        (mbdlft.series(model, "turn.torque", lag), plain * columns, ACROSS),
        (mbdlft.series(model, "velocity.x", lag), plain * rows, ACROSS),
        (two[6:, 3:], plain, ACROSS),
        (loop, plain - back, ((1, 0), (3, 0), (4, 0), (5, 0))),
    ):
        assert whole.certificate.unmoved == unmoved
        found = mbdlft.frequency_response(whole, {}, omega)[0] / expected
        y, u = np.transpose(unmoved)
        target(found[:, y, u], np.ones(found[:, y, u].shape), CHAIN)  # K of two copies is singular twice


def test_accelerations_have_their_digits_behind_filters_and_in_loops_with_them() -> None:
    """Their terms cancel in the states of the filter: 1e-3 was lost at 1e-4 rad/s."""
    free, held, omega = mbdlft.to_lft(in_a_row(), search=0.0), pair(1e3), 10.0 ** np.arange(-7.0, 2.0)
    s = 1j * omega
    lag, g = mbdlft.as_system(mbdlft.low_pass(2e-3), name="lag"), 2e-3 / (s + 2e-3)
    A, B, C = [[0.0, 1.0], [-4.0, -0.8]], [[0.0], [4.0]], [[1.0, 0.5]]
    second = mbdlft.state_space(A, B, C, [[0.0]], inputs=["in"], outputs=["out"], name="second")
    both = g * (4.0 + 2.0 * s) / (s**2 + 0.8 * s + 4.0)
    for model, named, force in (
        (free, "acceleration.y", "a.force_density"),
        (held, "felt.x", "second.force"),
    ):
        inputs, n = [signal.name for signal in model.inputs], len(model.states)
        row = [signal.name for signal in model.outputs].index(named)
        plain = mbdlft.frequency_response(model, {}, omega)[0]
        wires = {"lag.command": named, "in": "lag.output"}
        ends = ["lag.output", "out", named]
        opened = mbdlft.connect([lag, model, second], wires, inputs=inputs, outputs=ends)
        assert opened.certificate.accelerations == (0, 1, 2)
        assert opened.certificate.driven == (0, n + 1, n + 2)
        expected = plain[:, row, None] * np.stack([g, both, np.ones(9)], axis=1)[:, :, None]
        found = mbdlft.frequency_response(opened, {}, omega)[0] / expected
        target(found, np.ones(found.shape), CHAIN)
        wires[force] = ["M", "-lag.output"]
        left = [name for name in inputs if name != force]
        loop = mbdlft.connect([lag, model, second], wires, inputs=["M", *left], outputs=ends)
        back = 1.0 + g * plain[:, row, inputs.index(force)]
        found = mbdlft.frequency_response(loop, {}, omega)[0, :, :, 0] * back[:, None]
        target(found / expected[:, :, inputs.index(force)], np.ones((9, 3)), CHAIN)
        beside = {"lag.command": [named, "w"], "in": "lag.output"}
        other = mbdlft.connect([lag, model, second], beside, inputs=[*inputs, "w"], outputs=ends)
        assert other.certificate.accelerations == (2,)
        assert other.certificate.driven == ()
    whole = mbdlft.series(opened, "lag.output", mbdlft.as_system(second, name="third", inputs=["c"]))
    assert whole.certificate.driven == (0, n + 1, n + 2, n + 3, n + 4)
    found = mbdlft.frequency_response(whole, {}, omega)[0, :, 0] / (expected[:, 1])
    target(found, np.ones(found.shape), CHAIN)
    assert mbdlft.series(free, "velocity.x", lag).certificate.driven == ()
    loose, values, some = pair(0.0), {"k": [0.0, 1e4]}, omega[-3:]  # nothing holds the first sample
    plain = mbdlft.frequency_response(loose, values, some)[:, :, 1, 0]
    found = mbdlft.frequency_response(mbdlft.series(loose, "felt.x", lag), values, some)[:, :, 1, 0]
    target(found / (plain * g[-3:]), np.ones((2, 3)), CHAIN)


def test_filters_in_the_form_of_a_mass_on_a_spring_are_no_structure() -> None:
    """Behind rates one held no rigid motion any more: accelerations at 1e-7 rad/s had no digit."""
    free, omega = mbdlft.to_lft(in_a_row(), search=0.0), 10.0 ** np.arange(-7.0, 1.0)
    plain, n = mbdlft.frequency_response(free, {}, omega)[0], len(free.states)
    lag = mbdlft.as_system(mbdlft.low_pass(2e-3), name="lag")
    A, B, s = [[0.0, 1.0], [-1e-8, -1.4e-4]], [[0.0], [1e-8]], 1j * omega
    slow = mbdlft.state_space(A, B, [[1.0, 0.0]], [[0.0]], inputs=["in"], outputs=["out"], name="slow")
    g = (1e-8 / (s**2 + 1.4e-4 * s + 1e-8))[:, None]
    inputs, names = ([signal.name for signal in signals] for signals in (free.inputs, free.outputs))
    for name in ("velocity.x", "acceleration.y"):
        row, ends = names.index(name), [*names, "out"]
        whole = mbdlft.connect([free, slow], {"in": name}, inputs=inputs, outputs=ends)
        assert whole.certificate.beside == (n, n + 1)
        assert mbdlft.series(whole, "out", lag).certificate.beside == (n, n + 1, n + 2)
        found = mbdlft.frequency_response(whole, {}, omega)[0]
        expected = np.concatenate([plain, (g * plain[:, row])[:, None]], axis=1)
        target(found / expected, np.ones(found.shape), CHAIN)
    wires = {"in": name, "a.force_density": ["M", "-out"]}
    loop = mbdlft.connect([free, slow], wires, inputs=["M", *inputs[:2]], outputs=ends)
    back = expected[:, :, 2:] * (g * plain[:, row] / (1.0 + g * plain[:, row, 2:]))[:, None]
    found = mbdlft.frequency_response(loop, {}, omega)[0] / (expected - back)[:, :, [2, 0, 1]]
    target(found[:, :, :2], np.ones((8, 7, 2)), CHAIN)
    assert free.certificate.beside == ()


def test_rigid_motions_keep_their_digits_where_rounding_leaves_entries_that_are_zero() -> None:
    """Springs in a plane leave four motions of each pair of bodies out of it: none of them was known."""
    ports = {"p": (0.4, 0.2, 0), "q": (0.4, -0.2, 0), "r": (-0.4, 0.2, 0), "s": (-0.4, -0.2, 0)}
    names, ends, random = ("b0", "b1", "b2"), ("pr", "qs", "ps"), np.random.default_rng(1)
    scene = kit.scene(
        "free",
        mbdlft.Parameter("m", 2.0, percent=20, unit="kg"),
        *(
            kit.body(b, m, (0.1, 0.12, 0.2), ports=ports)
            for b, m in zip(names, (1.3, "m", 0.7), strict=True)
        ),
        *(
            kit.free(f"to_{b}", "ground", b, position=(1.5 * i, *random.uniform(-0.3, 0.3, 2)))
            for i, b in enumerate(names)
        ),
        *(
            kit.spring(f"{a}{b}{i}", f"b{i}.{a}", f"b{i + 1}.{b}", stiffness=k, force_density=0.0)
            for i in range(2)
            for (a, b), k in zip(ends, (300.0, 20.0, 4e3), strict=True)
        ),
        kit.force("push", "b0", (1, 0, 0), frame="ground", magnitude=0.0),
        inputs=["push.force"],
        outputs=["to_b2.position.x", "to_b1.rotation.y"],
    )
    omega = 10.0 ** np.arange(-8.0, 1.0)
    truth = problem_of_scene(scene).reference().transfers_in_digits([0], omega)[0]
    found = mbdlft.frequency_response(mbdlft.to_lft(scene, search=0.0, prove=0.0), {}, omega)[0] / truth
    target(found, np.ones(found.shape), RESPONSE)


def boom_on_a_cart() -> mbdlft.Scene:
    """A beam that a cart turns: entries of A are 50 roundings from the truth."""
    boom = mbdlft.Beam(
        name="boom", length=1.4, density=2700.0, area=1e-4, modulus="E", I_y=1e-9, I_z=1e-9,
        deformations=("bending_y",), elements=4, stiffness_damping=1e-5,
    )  # fmt: skip
    return kit.scene(
        "boom",
        mbdlft.Parameter("E", 3e9, percent=20, unit="Pa"),
        kit.body("cart", 6.0, zz=0.3, center_of_mass=(0.1, 0.05, 0)),
        boom,
        kit.rail("slide", "ground", "cart", (0, 1, 0)),
        kit.hinge("turn", "cart", "boom", (0, 0, 1), stiffness=50.0, damping=0.1, position=0.0),
        *(kind(name=kind.kind, port="boom.tip") for kind in (mbdlft.Position, mbdlft.Acceleration)),
        inputs=["turn.torque"],
        outputs=["acceleration.y", "slide.acceleration", "position.y", "slide.position"],
    )


def pushed(scene: mbdlft.Scene, *outputs: str) -> mbdlft.Scene:
    """A scene with a force from outside, and outputs."""
    push = kit.force("push", "one.a", (1, 0.3, 0), frame="ground", magnitude=0.0)
    return kit.changed(scene, loads=[*scene.loads, push], inputs=["push.force"], outputs=list(outputs))


def test_a_force_from_outside_gives_finite_accelerations_far_below_the_modes() -> None:
    """Rounding shows the place, which has 1/s^2, to the sum: it was off by 1e7 at 1e-8 rad/s."""
    scene = pushed(sprung(), "acceleration.x", "acceleration.y")
    model, omega = mbdlft.to_lft(scene, search=0.0), 10.0 ** np.arange(-8.0, 2.0)
    assert model.certificate.rigid_motions == (3, 3)
    at = problem_of_scene(scene).reference()
    truth = at.transfers_in_digits([0], omega)[0]
    target(mbdlft.frequency_response(model, {}, omega)[0] / truth, np.ones(truth.shape), RESPONSE)
    assert mbdlft.unbounded_frequencies(model)[0].size == 0
    for k, name in enumerate(scene.outputs):
        peak = mbdlft.hinf_norm(model, outputs=name)
        gain = np.abs(at.transfers_in_digits([0], peak.frequency)[0, 0, k, 0])
        target(peak.lower[0], gain, NORM)
    times = np.linspace(0.0, 1e7, 3)  # the softest spring is damped
    steps = mbdlft.step_response(model, {}, times).values[0, -1]
    target(steps, truth[0].real, RESPONSE)


def test_places_and_rates_by_a_force_from_outside_have_their_digits() -> None:
    """Rounding of A held the bodies: at 1e-8 rad/s nothing was left of their places."""
    scene = pushed(sprung(), "position.x", "position.y", "acceleration.x", "to_one.rate")
    scene = kit.changed(scene, inputs=["push.force", "a.force_density"])
    model, omega = mbdlft.to_lft(scene, search=0.0), 10.0 ** np.arange(-8.0, 5.0)
    assert model.certificate.rigid_motions == (-3, -3, 3, -3)
    at = problem_of_scene(scene).reference()
    truth = at.transfers_in_digits([0], omega)[0]
    target(mbdlft.frequency_response(model, {}, omega)[0] / truth, np.ones(truth.shape), RESPONSE)
    times = np.array([0.0, 1e8])
    steps = mbdlft.step_response(model[:, "push.force"], {}, times).values[0, -1, :2, 0]
    target(steps * 2e-16 / (-(omega[0] ** 2) * truth[0, :2, 0].real), np.ones(2), RESPONSE)
    peak = mbdlft.hinf_norm(model, outputs="acceleration.x")  # by both
    gain = np.linalg.norm(at.transfers_in_digits([0], peak.frequency)[0, 0, 2])
    target(peak.lower[0], gain, NORM)


def test_a_mass_far_from_a_force_has_its_digits_below_and_far_above_the_modes() -> None:
    """Above, places beside the motion of the first one cancel with it."""
    along, n = (1, 0, 0), 5
    scene = kit.scene(
        "row",
        mbdlft.Parameter("m", 2.0, percent=20, unit="kg"),
        *(kit.point(f"b{i}", "m" if i == 2 else 1.5) for i in range(n)),
        *(kit.rail(f"to_b{i}", "ground", f"b{i}", along, position=float(i)) for i in range(n)),
        *(
            kit.spring(f"s{i}", f"b{i}", f"b{i + 1}", stiffness=10.0**i, damping=1e-3, force_density=0.0)
            for i in range(n - 1)
        ),
        *(kit.force(f"push_{i}", f"b{i}", along, frame="ground", magnitude=0.0) for i in range(n)),
        inputs=[f"push_{i}.force" for i in range(n)],
        outputs=[f"to_b{i}.position" for i in range(n)],
    )
    omega = np.append(10.0 ** np.arange(-8.0, 3.0), 200.0)
    truth = problem_of_scene(scene).reference().transfers_in_digits([0], omega)[0]
    found = mbdlft.frequency_response(mbdlft.to_lft(scene, search=0.0), {}, omega)[0]
    target(found / truth, np.ones(truth.shape), RESPONSE)


def test_what_no_entry_of_the_matrices_leads_to_does_not_move() -> None:
    """A free rod that is turned along its axis: rigid motions, in doubles, mix what is apart."""
    rod = mbdlft.Beam(
        name="rod", length=1.5, density=7800.0, area=1e-3, modulus=2.1e11, shear_modulus=8e10,
        I_y=1e-7, I_z=2e-7, torsion_constant=1e-7, elements=2, deformations=("torsion", "bending_y"),
    )  # fmt: skip
    outputs = ["root.rotation.x", "root.rotation.y", "root.position.x", "root.position.z"]
    scene = kit.scene(
        "rod", rod, kit.free("root", "ground", "rod"), inputs=["root.torque.x"], outputs=outputs
    )
    model = mbdlft.to_lft(scene, search=0.0)
    found = mbdlft.frequency_response(model, {}, [0.1, 10.0])[0, :, :, 0]
    assert np.all(found[:, 0] != 0.0)
    exact(found[:, 1:], np.zeros((2, 3)))


def test_rows_that_are_nearly_those_of_rates_are_no_accelerations() -> None:
    """A mass on a spring: its acceleration three times, and with 1e-10 of its place beside."""
    plant = control.ss([[0, 1], [-1, 0]], [[0], [1]], [[-3, 0], [-1 + 1e-10, 0]], [[3], [1]])
    omega = np.array([1e-7, 1e-6])
    found = mbdlft.frequency_response(mbdlft.as_system(plant), {}, omega)[0, :, :, 0]
    target(found[:, 0] / (-3.0 * omega**2 / (1.0 - omega**2)), np.ones(2), RESPONSE)
    assert np.max(np.abs(found[:, 1] / (1e-10 - omega**2) - 1.0)) < 1e-4


def test_a_place_that_a_rigid_motion_changes_grows() -> None:
    """And the rate of it, which sees no place; a state that the rate moves sees both."""
    model = mbdlft.to_lft(pushed(sprung(), "acceleration.x", "position.x"), search=0.0)
    assert model.certificate.rigid_motions == (3, -3)
    turned = model[["position.x", "acceleration.x"], ["push.force"]]
    assert turned.certificate.rigid_motions == (-3, 3)
    assert mbdlft.hinf_norm(turned, outputs="position.x").upper[0] == np.inf
    assert np.isfinite(mbdlft.hinf_norm(turned, outputs="acceleration.x").upper[0])
    both = mbdlft.step_response(model, {}, [0.0, 1e3, 2e3]).values
    other = mbdlft.step_response(model, {}, [0.0, 1e3, 2e3], outputs=["position.x", "acceleration.x"])
    exact(other.values[:, :, ::-1], both)
    alone = floating()[:, "push.torque"]
    less = replace(alone, certificate=replace(alone.certificate, unmoved=()))
    for some in (alone, less):  # in a part of all outputs, and of those that see no motion
        assert [*frequency.carried_from(some)] == ["motor.acceleration"]


@pytest.mark.parametrize("scene", [sprung(), boom_on_a_cart()], ids=["sprung", "boom"])
def test_what_is_free_has_its_digits_and_its_sum_those_that_are_said(scene: mbdlft.Scene) -> None:
    """By efforts between its bodies, against 50 digits."""
    model = mbdlft.to_lft(scene, search=0.0)
    omega_6 = [frequency.carried_from(model)[name][0] for name in scene.outputs[:2]]
    omega = np.append(1e-7, np.outer([1.0, 0.01], omega_6))
    truth = problem_of_scene(scene).reference().transfers_in_digits([0], omega)[0]
    errors = np.abs(mbdlft.frequency_response(model, {}, omega)[0] / truth - 1.0)
    assert np.max(errors) < 1e-9
    whole = frequency.resolvent(samples_at(model), 1j * omega[None])[0]
    errors = np.max(np.abs(whole / truth - 1.0), axis=2)
    assert np.max(np.diag(errors[1:3])) < 1.1e-6
    assert np.min(np.diag(errors[3:])) > 1e-6


def test_an_entry_far_below_its_row_is_named() -> None:
    """The angle of a reaction wheel on a clamped mast, by a push on its head."""
    mast = mbdlft.Beam(
        name="mast", length=20.0, density=2700.0, area=0.02, modulus=7e10, I_z=2e-4, elements=7,
        deformations=("bending_y",),
    )  # fmt: skip
    scene = kit.scene(
        "mast",
        *held_at_root(mast),
        kit.body("wheel", 5.0, zz=0.1),
        kit.hinge("spin", "mast.tip", "wheel", (0, 0, 1), preload=0.0),
        inputs=["spin.torque", "push.force"],
        outputs=["spin.angle"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    (said,) = (text for text in sentences.checked_beside(model) if "small entries" in text)
    numbers = re.search(r"spin.angle by push.force by (\S+) of itself at (\S+) rad/s", said)
    assert numbers is not None
    share, omega = float(numbers[1]), np.array([float(numbers[2])])
    truth = problem_of_scene(scene).reference().transfers_in_digits([0], omega)[0, 0, 0, 1]
    assert abs(mbdlft.frequency_response(model, {}, omega)[0, 0, 0, 1] / truth - 1.0) <= share <= 1e-3


def test_peaks_are_higher_than_their_neighbors() -> None:
    rows = np.array([[9.0, 1.0, 3.0, 2.0, 5.0, 4.0], [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]])
    none = -np.inf
    exact(peaks(rows), [[none, none, 3.0, none, 5.0, none], [none] * 6])
    exact(peaks(rows[1:]), rows[1:])


def test_integrators_that_rounding_has_moved_do_not_widen_the_range() -> None:
    """Two double integrators and a mode at 3 rad/s, turned: rounding leaves poles of 1e-8 and less."""
    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = A[4, 5] = 1.0
    A[5, 4:] = [-9.0, -0.03]
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(6, 6)))[0]
    system = plain(turn @ A @ turn.T, turn[:, 1::2].sum(axis=1, keepdims=True), turn[:, :1].T)
    assert 0.0 < np.min(np.abs(mbdlft.poles(system))) < 1e-6
    omega = mbdlft.response_frequencies(system)[0]
    target(omega[[0, -1]], [0.3, 30.0], RESPONSE)
    target(mbdlft.response_times(system)[-1], 12.0 * 2.0 * np.pi / 3.0, PEAK)


def test_rows_of_frequencies_are_those_of_each_sample() -> None:
    model = spring_and_mass()
    values = mbdlft.random(model.parameters, 5)
    omega = np.random.default_rng(1).uniform(0.1, 9.0, (5, 7))
    found = mbdlft.frequency_response(model, values, omega)
    for k in range(5):
        alone = {name: float(column[k]) for name, column in values.items()}
        exact(mbdlft.frequency_response(model, alone, omega[k])[0], found[k])


def test_frequencies_rise_between_their_ends() -> None:
    model = spring_and_mass()
    values = mbdlft.random(model.parameters, 5)
    found = mbdlft.response_frequencies(model, values, 0.5, 20.0, points=50)
    assert np.all(np.diff(found, axis=1) >= 0.0)
    exact(found[:, 0], np.full(5, 0.5))
    target(found[:, -1], np.full(5, 20.0), CLOSED_FORM)
    slowest = np.sqrt(values["k"] / values["m"])
    wide = mbdlft.response_frequencies(model, values)
    target(wide[0, 0], np.min(slowest) / 10.0, CLOSED_FORM)
    target(wide[0, -1], np.max(slowest) * 10.0, CLOSED_FORM)


def test_unbounded_responses_are_marked_and_avoided() -> None:
    undamped = oscillator(0.0)
    (marks,) = mbdlft.unbounded_frequencies(undamped)
    target(marks, [1.0], CLOSED_FORM)
    omega = mbdlft.response_frequencies(undamped)
    found = mbdlft.frequency_response(undamped, {}, omega)
    target(found[0, :, 0, 0], 1.0 / (1.0 - omega[0] ** 2), RESPONSE)
    assert np.min(np.abs(omega - 1.0)) > 0.99e-4
    assert np.sum(np.abs(omega - 1.0) < 1.01e-4) >= 2  # as near as that, on both sides


def test_unbounded_frequencies_are_those_that_the_channels_see() -> None:
    """Free masses integrate twice; what stretches the spring does not. Undamped, it rings."""
    masses = two_masses([1.0, 1.0], 2.0, 0.0)
    A, B, C, _ = matrices(masses)
    (both,) = mbdlft.unbounded_frequencies(masses)
    target(both, [0.0, 2.0], CLOSED_FORM)
    stretch = plain(A, B, C[:1] - C[1:])
    target(mbdlft.unbounded_frequencies(stretch)[0], [2.0], CLOSED_FORM)
    together = plain(A, B, C[:1] + C[1:])
    target(mbdlft.unbounded_frequencies(together)[0], [0.0], CLOSED_FORM)
    assert mbdlft.unbounded_frequencies(oscillator(1e-6))[0].size == 0


# norms --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.3, 1e-2, 1e-4, 1e-6])
def test_norms_of_an_oscillator(damping: float) -> None:
    """H-infinity 1/(2 zeta sqrt(1 - zeta^2)); H2 (4 zeta)^(-1/2)."""
    peak = mbdlft.hinf_norm(oscillator(damping))
    expected = 1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2))
    assert peak.lower[0] <= expected * (1.0 + CLOSED_FORM)
    assert peak.upper[0] >= expected * (1.0 - CLOSED_FORM)
    assert peak.upper[0] <= peak.lower[0] * (1.0 + 1.01 * NORM)
    target(peak.frequency[0], np.sqrt(1.0 - 2.0 * damping**2), np.sqrt(NORM))  # it is flat there
    assert peak.reason == ("",)
    energy = mbdlft.h2_norm(oscillator(damping))
    target(energy.value[0], np.sqrt(0.25 / damping), RESPONSE)
    assert energy.error[0] < RESPONSE


def highest(system: mbdlft.System) -> float:
    """Largest singular value on a fine grid, and around the highest of it."""
    A, B, C, D = matrices(system)
    plant = control.ss(A, B, C, D)

    def gain(w: float) -> float:
        return -float(np.linalg.norm(np.atleast_2d(plant(1j * w)), 2))

    grid = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 800)])
    k = int(np.argmin([gain(w) for w in grid]))
    around = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    fine = minimize_scalar(gain, bounds=around, method="bounded", options={"xatol": 1e-12})
    return -min(float(fine.fun), gain(0.0), -float(np.linalg.norm(D, 2)))


def test_the_norm_of_a_complex_system_is_that_at_negative_frequencies_too() -> None:
    """G(s + jw) is G at other frequencies; the norm was that of the positive ones alone."""
    for seed in range(4):
        A, B, C, D = matrices(random_system(seed, 4, 2, 2, direct=True))
        real = mbdlft.hinf_norm(mbdlft.state_space(A, B, C, D))
        for shift in (-50.0, 50.0):
            found = mbdlft.hinf_norm(mbdlft.state_space(A - 1j * shift * np.eye(4), B, C, D))
            assert found.lower[0] <= real.upper[0]
            assert found.upper[0] >= real.lower[0]


def test_what_the_channels_do_not_see_leaves_the_norm() -> None:
    """An integrator in coordinates of very different sizes; two oscillators, with rows of such sizes."""
    beside = np.kron(np.eye(2), [[0.0, 1.0], [-1.0, 0.0]])
    for seed in range(6):
        random = np.random.default_rng(seed)
        for unseen, rows, spread in (([[0.0]], [1.0], 2), (beside, [3e5, 1e-4], 0)):
            n, m = 3, len(unseen)
            A = np.zeros((n + m, n + m))
            A[:n, :n], A[n:, n:] = random.normal(size=(n, n)) - 4.0 * np.eye(n), unseen
            A[n:, :n], B = random.normal(size=(m, n)), random.normal(size=(n + m, 1))
            C = np.array(rows)[:, None] * random.normal(size=(1, n)) @ np.eye(n, n + m)
            T = random.normal(size=(n + m, n + m)) * 10.0 ** random.integers(-spread, spread + 1, n + m)
            whole = mbdlft.hinf_norm(plain(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)))
            part = mbdlft.hinf_norm(plain(A[:n, :n], B[:n], C[:, :n]))
            target(whole.upper, part.upper, PEAK)


@pytest.mark.parametrize("direct", [False, True])
def test_norms_of_random_systems(direct: bool) -> None:
    for seed in range(4):
        system = random_system(seed, 6, 3, 2, direct=direct)
        found, expected = mbdlft.hinf_norm(system), highest(system)
        assert found.lower[0] >= expected * (1.0 - NORM)
        assert found.upper[0] >= expected * (1.0 - CLOSED_FORM)
        assert found.upper[0] <= found.lower[0] * (1.0 + 1.01 * NORM)
        energy = mbdlft.h2_norm(system)
        if direct:
            assert energy.value[0] == np.inf
            assert energy.reason == ("the direct path D is not zero",)
            continue
        A, B, C, _ = matrices(system)
        P = control.lyap(A, B @ B.T)
        target(energy.value[0], np.sqrt(np.trace(C @ P @ C.T)), RESPONSE)


@pytest.mark.parametrize("seed", range(12))
def test_no_gain_of_two_modes_side_by_side_is_above_its_level(seed: int) -> None:
    """Of a level near to the peak, rounding moves the eigenvalues of the Hamiltonian off the axis."""
    random = np.random.default_rng(seed)
    damping = 10.0 ** -random.uniform(1.0, 5.0)
    sizes = [1.0, 1.0 + damping * random.uniform(0.2, 3.0)]
    A, B, C = np.zeros((4, 4)), np.array([[0.0], [1.0], [0.0], [1.0]]), np.ones((1, 4))
    for k, size in enumerate(sizes):
        share = damping * random.uniform(0.3, 3.0)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, 1.0], [-(size**2), -2.0 * share * size]]
        C[0, 2 * k : 2 * k + 2] = random.uniform(-1.0, 1.0, 2)
    D = np.array([[random.uniform(-0.3, 0.3) / damping]])
    found = norms.peak_of(Plant(A, B, C, D), 1e-10)
    omega, width = found[2], 3.0 * damping
    for _ in range(6):
        tried = np.linspace(omega - width, omega + width, 41)
        gains = [abs((C @ np.linalg.solve(1j * w * np.eye(4) - A, B) + D)[0, 0]) for w in tried]
        omega, width = tried[int(np.argmax(gains))], 0.1 * width
    assert np.max(gains) <= found[1] * (1.0 + 1e-9)


def test_norm_that_is_reached_at_infinity_or_at_rest() -> None:
    high = plain([[-1.0]], [[1.0]], [[-1.0]], [[1.0]])  # s/(s + 1)
    found = mbdlft.hinf_norm(high)
    assert found.frequency[0] == np.inf
    target(found.lower[0], 1.0, CLOSED_FORM)
    low = mbdlft.hinf_norm(plain([[-2.0]], [[1.0]], [[6.0]]))
    assert low.frequency[0] == 0.0
    target(low.lower[0], 3.0, CLOSED_FORM)
    assert mbdlft.hinf_norm(plain([[-2.0]], [[0.0]], [[6.0]])).upper[0] == 0.0
    static = plain(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[3.0, 4.0]])
    target(mbdlft.hinf_norm(static).lower[0], 5.0, CLOSED_FORM)


def test_infinite_norms_say_why() -> None:
    for system, pole in (
        (oscillator(0.0, 2.0), "0 +- 2j rad/s is on the imaginary axis"),
        (oscillator(-0.1), "0.1 +- 0.994987j rad/s is right of the imaginary axis"),
        (two_masses([1.0, 1.0], 2.0, 0.1), "the pole 0 rad/s is on the imaginary axis"),
    ):
        for found in (mbdlft.hinf_norm(system), mbdlft.h2_norm(system)):
            assert pole in found.reason[0]
        assert mbdlft.hinf_norm(system).upper[0] == mbdlft.h2_norm(system).value[0] == np.inf


def test_poles_that_the_channels_do_not_see_leave_norms_finite() -> None:
    """The stretch of two free masses with force f on one: 1/(m1 (s^2 + ...)), an oscillator."""
    masses = two_masses([2.0, 2.0], 3.0, 0.3)
    A, B, C, _ = matrices(masses)
    stretch = plain(A, B, C[:1] - C[1:])
    omega, zeta = np.sqrt(3.0), 0.3 / 2.0 / np.sqrt(3.0)
    expected = 0.5 / (2.0 * zeta * np.sqrt(1.0 - zeta**2) * omega**2)
    target(mbdlft.hinf_norm(stretch).lower[0], expected, NORM)
    target(mbdlft.h2_norm(stretch).value[0], 0.5 / np.sqrt(4.0 * zeta * omega**3), RESPONSE)


@pytest.mark.parametrize("seed", [0, 3, 12])
def test_a_force_within_a_free_chain_has_finite_norms_and_moves_it_back_and_forth_only(seed: int) -> None:
    """Rounding moves the center of mass: norms were infinite, or 1e-5 off, and places 7e-5 in time."""
    model, truth = free_chain(np.random.default_rng(seed))
    slowest = np.min(np.abs(np.linalg.eigvals(truth.A)))
    times = np.linspace(0.0, 75.0 / slowest, 61)
    for respond in (mbdlft.step_response, mbdlft.impulse_response):
        moved, expected = (respond(system, {}, times).values[0, :, 0, 0] for system in (model, truth))
        target(moved / np.max(np.abs(expected)), expected / np.max(np.abs(expected)), CHAIN)
    for mine, own in (("place.x", "y0"), ("felt.x", "y1")):
        peak, expected = mbdlft.hinf_norm(model, outputs=mine), mbdlft.hinf_norm(truth, outputs=own)
        assert peak.upper[0] <= peak.lower[0] * (1.0 + 1.01 * NORM)
        target(peak.lower[0], expected.lower[0], ELASTIC)  # as far as rounding changes damping
    assert mbdlft.unbounded_frequencies(model)[0].size == 0
    poles, V = np.linalg.eig(truth.A)  # the integral of each pair of modes
    shares = (truth.C_y[:1] @ V) * np.linalg.solve(V, truth.B_u).T
    energy = -np.sum(shares.T * np.conj(shares) / (poles[:, None] + np.conj(poles))).real
    target(mbdlft.h2_norm(model, outputs="place.x").value[0], np.sqrt(energy), ELASTIC)


def test_inputs_that_leave_momenta_and_others_are_told_apart_in_any_order() -> None:
    model = floating()
    motor = mbdlft.hinf_norm(model, outputs="base.angle", inputs="motor.torque")
    assert motor.reason == ("",)
    assert mbdlft.hinf_norm(model, outputs="base.angle").upper[0] == np.inf
    exact([found[0] for found in mbdlft.unbounded_frequencies(model, outputs="base.angle")], [0.0])
    times = np.linspace(0.0, 10.0, 11)
    both = mbdlft.step_response(model, {}, times).values
    turned = mbdlft.step_response(model, {}, times, inputs=["push.torque", "motor.torque"]).values
    exact(turned[..., ::-1], both)
    alone = mbdlft.step_response(model, {}, times, inputs="motor.torque").values
    target(alone[..., 0], both[..., 0], CLOSED_FORM)


def test_norms_over_samples_are_those_of_each() -> None:
    model = spring_and_mass()
    values = mbdlft.random(model.parameters, 12)
    zeta = 0.01 / np.sqrt(values["k"] * values["m"])
    found = mbdlft.hinf_norm(model, values)
    target(found.lower, 1.0 / (2.0 * zeta * np.sqrt(1.0 - zeta**2) * values["k"]), NORM)
    omega = np.sqrt(values["k"] / values["m"])
    expected = 1.0 / values["m"] / np.sqrt(4.0 * zeta * omega**3)
    target(mbdlft.h2_norm(model, values).value, expected, RESPONSE)


# over time ----------------------------------------------------------------------------------------

TIMES = {"even": np.linspace(0.0, 9.0, 50), "uneven": np.geomspace(0.01, 9.0, 40)}


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES.keys())
def test_responses_of_an_oscillator(times: np.ndarray) -> None:
    zeta, w = 0.05, 3.0
    decay, turning = zeta * w, w * np.sqrt(1.0 - zeta**2)
    fall = np.exp(-decay * times)
    waves = np.cos(turning * times), np.sin(turning * times)
    system = oscillator(zeta, w)
    step = mbdlft.step_response(system, {}, times)
    exact(step.times, times)
    expected = (1.0 - fall * (waves[0] + decay / turning * waves[1])) / w**2
    target(step.values[0, :, 0, 0], expected, RESPONSE)
    impulse = mbdlft.impulse_response(system, {}, times).values
    target(impulse[0, :, 0, 0], fall * waves[1] / turning, RESPONSE)
    names = [signal.name for signal in system.states]
    from_rest = mbdlft.initial_response(system, {names[0]: 2.0}, {}, times).values
    target(from_rest[0, :, 0], 2.0 * fall * (waves[0] + decay / turning * waves[1]), RESPONSE)


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES.keys())
def test_responses_of_integrators_and_of_undamped_ones(times: np.ndarray) -> None:
    double = plain([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    target(mbdlft.step_response(double, {}, times).values[0, :, 0, 0], times**2 / 2.0, RESPONSE)
    target(mbdlft.impulse_response(double, {}, times).values[0, :, 0, 0], times, RESPONSE)
    found = mbdlft.step_response(oscillator(0.0, 5.0), {}, times).values[0, :, 0, 0]
    target(found, (1.0 - np.cos(5.0 * times)) / 25.0, RESPONSE)


def test_integrators_alone_take_a_second_in_any_coordinates() -> None:
    """Rounding of their poles, 1e-16 to 1e-9 rad/s, chose times of 1e9 to 1e17 s."""
    for turn in np.linspace(0.3, 2.7, 5):
        T = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        double = plain(T @ [[0.0, 1.0], [0.0, 0.0]] @ T.T, T @ [[0.0], [1.0]], [[1.0, 0.0]] @ T.T)
        times, values = mbdlft.step_response(double)
        target(values[0, :, 0, 0], np.linspace(0.0, 1.0, len(times)) ** 2 / 2.0, RESPONSE)


def test_responses_of_a_stiff_system() -> None:
    """Poles at -1 and -1e8: a step that a fixed-step solver takes a billion steps for."""
    stiff = plain(np.diag([-1.0, -1e8]), [[1.0], [1e8]], [[1.0, 1.0]], [[0.5]])
    times = np.linspace(0.0, 12.0, 300)
    expected = 0.5 + (1.0 - np.exp(-times)) + (times > 0.0)
    target(mbdlft.step_response(stiff, {}, times).values[0, :, 0, 0], expected, RESPONSE)


@pytest.mark.parametrize("times", [np.linspace(0.0, 4e3, 81), np.geomspace(0.1, 4e3, 40)])
def test_a_soft_motion_keeps_its_digits_beside_stiff_ones(times: np.ndarray) -> None:
    """In doubles their accelerations were 2e-6 off; by springs of 2^34, twenty times too large."""
    k, soft, n = 2.0**18, 0.25, 3
    stiffness = np.array([[k, -k, 0.0], [-k, k, 0.0], [0.0, 0.0, soft]])
    stiffness[1:, 1:] += soft * np.array([[1.0, -1.0], [-1.0, 1.0]])
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, np.zeros((n, n))]])
    B = np.zeros((2 * n, 1))
    B[5] = 1.0
    found = mbdlft.step_response(plain(A, B, A[n:]), {}, times).values[0, :, :, 0]
    exponent = flint.arb_mat(np.block([[A, B], [np.zeros((1, 2 * n + 1))]]).tolist())
    with flint.ctx.workprec(300):
        moved = [(exponent * flint.arb(t)).exp().entries()[2 * n :: 2 * n + 1] for t in times]
        rows = flint.arb_mat(A[n:].tolist()) * flint.arb_mat(np.array(moved)[:, :-1].T.tolist())
    expected = np.array(rows.tolist(), dtype=float).T
    target(found / np.max(np.abs(expected), axis=0), expected / np.max(np.abs(expected), axis=0), CHAIN)


def test_free_bodies_drift_from_any_start_as_their_momentum_says() -> None:
    """Rounding of the springs pulled their center back: 4e-5 of the way."""
    names, masses = ("one", "other", "third"), np.array([0.08, 0.0859885, 0.31])
    springs = zip(names[:2], names[1:], (1.68e6, 2.3e5), strict=True)
    model = mbdlft.to_lft(
        kit.scene(
            "row",
            mbdlft.Parameter("m", 0.08, percent=20, unit="kg"),
            *(kit.body(name, m) for name, m in zip(names, ("m", *masses[1:].tolist()), strict=True)),
            *(
                kit.rail(f"to_{name}", "ground", name, (1, 0, 0), position=float(k), preload=0.0)
                for k, name in enumerate(names)
            ),
            *(kit.spring(a, a, b, stiffness=k, force_density=0.0) for a, b, k in springs),
        )
    )
    times = np.linspace(0.0, 1e3, 11)
    start = {"to_one.position": 0.5, "to_one.velocity": 1.0, "to_other.velocity": -2.0}
    places = [f"to_{name}.position" for name in names]
    found = mbdlft.initial_response(model, start, {}, times, outputs=places).values[0]
    expected = 0.5 * masses[0] + (masses[0] - 2.0 * masses[1]) * times
    target(found @ masses, expected, CHAIN)


def test_random_systems_against_python_control() -> None:
    times = np.linspace(0.0, 4.0, 60)
    for seed in range(4):
        system = random_system(seed, 5, 2, 3)
        plant = control.ss(*matrices(system))
        for ours, theirs in (
            (mbdlft.step_response, control.step_response),
            (mbdlft.impulse_response, control.impulse_response),
        ):
            expected = np.moveaxis(theirs(plant, times).outputs, -1, 0)
            target(ours(system, {}, times).values[0, 1:], expected[1:], RESPONSE)


def test_responses_of_samples_are_those_of_each_alone() -> None:
    model = spring_and_mass()
    values = mbdlft.random(model.parameters, 6)
    times = mbdlft.response_times(model, values)
    found = mbdlft.step_response(model, values, times).values
    alone = {name: float(column[4]) for name, column in values.items()}
    target(mbdlft.step_response(model, alone, times).values[0], found[4], CLOSED_FORM)
    for outputs, inputs in ((["position"], ["force"]), ("position", "force")):
        chosen = mbdlft.step_response(model, values, times, outputs=outputs, inputs=inputs)
        exact(chosen.values, found)


def test_times_that_are_chosen_suit_the_poles() -> None:
    slow = mbdlft.response_times(plain(np.diag([-0.1, -50.0]), [[1.0], [1.0]], [[1.0, 1.0]]))
    target(slow[-1], 50.0, CLOSED_FORM)
    undamped = mbdlft.response_times(oscillator(0.0, 2.0))
    target(undamped[-1], 12.0 * np.pi, CLOSED_FORM)
    assert len(undamped) >= 12 * 16
    growing = mbdlft.response_times(plain(np.diag([2.0, -0.01]), [[1.0], [1.0]], [[1.0, 1.0]]))
    target(growing[-1], 2.5, CLOSED_FORM)
    assert mbdlft.response_times(plain([[0.0]], [[1.0]], [[1.0]]))[-1] == 1.0


def test_figures_mark_where_a_response_is_infinite() -> None:
    figure = Figure()
    axes = figure.add_subplot()
    axes.set_xlim(0.1, 10.0)
    mark_unbounded(axes, oscillator(0.0, 3.0))
    (line,) = axes.get_lines()
    roundoff(line.get_xdata()[0], 3.0)
    mark_unbounded(axes, oscillator(0.1, 3.0))
    assert axes.get_lines() == [line]


@pytest.mark.parametrize("seed", [8, 18, 20, 22])
def test_what_a_force_moves_without_end_has_no_norm(seed: int) -> None:
    """Entries of very different size show it: 0 or a finite number was told of 30 in 200."""
    assert drifting(np.random.default_rng(seed)) == "right, drifting"
