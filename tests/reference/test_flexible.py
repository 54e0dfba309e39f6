"""Elastic scenes against published results, and against finite elements written down by themselves."""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.linalg

import mbdlft
from benchmarks import assumed_modes
from benchmarks.cases import beams
from benchmarks.cases import flexible as data
from benchmarks.cases.superelement import superelement_matrix
from mbdlft.problem.references import NEGLIGIBLE
from tests import close
from tests.laws import elastic as scenes

PER_LENGTH = data.STRIP["density"] * data.STRIP["thickness"] * data.STRIP["width"]
BENDING = data.STRIP["modulus"] * data.STRIP["width"] * data.STRIP["thickness"] ** 3 / 12.0
OMEGA = np.array([3.0, 40.0, 500.0, 6000.0])  # rad/s, between the frequencies of the strip


def model(scene: mbdlft.Scene) -> mbdlft.LFTModel:
    found = mbdlft.to_lft(scene, search=0.0)
    assert found.certificate.max_relative_error <= close.ELASTIC
    return found


@pytest.mark.parametrize("elements", [4, pytest.param(9, marks=pytest.mark.long)])
def test_spacecraft_has_the_modes_of_the_table(elements: int) -> None:
    """Each mode with the hub at rest three times, each one with the hub in motion once."""
    found = data.frequencies(model(data.spacecraft(elements)))[:12]
    table = np.array(data.SPACECRAFT[elements])
    close.target(found / np.repeat(table, [3, 1, 3, 1, 3, 1]), np.ones(12), close.SPACECRAFT_TABLE)


def with_long(sizes: Iterable[int], most: int) -> list[Any]:
    """Sizes of a table; those above `most` are long."""
    return [pytest.param(n, marks=[pytest.mark.long] * (n > most)) for n in sizes]


@pytest.mark.parametrize("elements", with_long(data.SPACECRAFT, 14))
def test_one_appendage_has_them_too(elements: int) -> None:
    """By symmetry: a quarter of the hub, or none; up to 50 elements."""
    moving = data.frequencies(model(data.spacecraft(elements, 1)))[:3]
    resting = data.frequencies(model(data.clamped_appendage(elements)))[:3]
    found = np.array([resting, moving]).T.ravel()
    close.target(found / data.SPACECRAFT[elements], np.ones(6), close.SPACECRAFT_TABLE)


def test_imposed_coordinate_beside_stiff_elements() -> None:
    """What an imposed joint does is exactly its input; rounding beside 1e13 1/s^2 is no reference."""
    found = model(data.clamped_appendage(50))
    row = [signal.name for signal in found.states].index("pin.rate")
    assert not found.A[row].any()
    assert found.certificate.max_relative_error < close.STABLE


@pytest.mark.parametrize("count", with_long(data.ASSUMED, 10))
def test_assumed_modes_have_those_of_the_table(count: int) -> None:
    """The rival method of the source, so that the table compares right with right."""
    close.target(
        np.array(assumed_modes.frequencies(count)) / data.ASSUMED[count],
        np.ones(6),
        close.SPACECRAFT_TABLE,
    )


def test_entries_have_the_digits_of_their_terms() -> None:
    """M^-1 K of finite elements entry by entry against 50 digits, where it falls by many orders."""
    scene = data.spacecraft(4)
    M, _, K = scenes.motion(scene)
    with mpmath.workdps(50):
        inverse = mpmath.inverse(mpmath.matrix(M.tolist()))
        solved = -inverse * mpmath.matrix(K.tolist())
        expected = np.array([[float(solved[i, j]) for j in range(len(K))] for i in range(len(K))])
    n = len(K)
    found = model(scene).A[n:, :n]
    size = np.abs(expected)
    clear = size > NEGLIGIBLE * np.max(size, axis=1, keepdims=True)
    assert np.min(size[clear]) < close.STABLE * np.max(size)
    close.target(found[clear] / expected[clear], np.ones(int(clear.sum())), close.CLOSED_FORM)


@pytest.mark.parametrize("angle", data.ARM)
def test_arm_has_the_modes_of_the_table(angle: int) -> None:
    found = data.frequencies(model(data.arm(angle)))[:4]
    close.target(found / data.ARM[angle], np.ones(4), close.ARM_TABLE)


def test_length_of_a_beam() -> None:
    found = counted("length")
    for length, frequency in data.LENGTHS.items():
        hertz = data.frequencies(found, L=length)[0] / (2.0 * np.pi)
        close.target(hertz / frequency, 1.0, close.LENGTH_TABLE)
    assert found.order == data.REPETITIONS["length"]


CUBIC: Callable[[float], beams.Mesh] = lambda h: beams.mesh([h / 3] * 3, BENDING, PER_LENGTH)  # noqa: E731
QUINTIC: Callable[[float], beams.Mesh] = lambda h: beams.superelement(h, BENDING, PER_LENGTH)  # noqa: E731


@pytest.mark.parametrize(
    ("functions", "elements", "mesh"), [("cubic", 3, CUBIC), ("quintic", 1, QUINTIC)]
)
def test_frozen_lft_is_the_mesh_at_this_length(
    functions: str, elements: int, mesh: Callable[[float], beams.Mesh]
) -> None:
    """100 random lengths: frequencies, and all nine frequency responses of the two ports."""
    scene = data.row("length", [data.strip("beam", "L", elements, functions)], [data.VARIED])
    found = model(scene)
    values = mbdlft.random(found.parameters, 100)
    responses = mbdlft.frequency_response(found, values, OMEGA)
    for k, length in enumerate(values["L"]):
        direct = mesh(float(length))
        close.target(
            data.frequencies(found, L=float(length)) / beams.clamped(direct),
            np.ones(len(direct.M) - 2),
            close.SAME_MESH,
        )
        for j, omega in enumerate(OMEGA):
            expected = beams.response(direct, float(omega))
            close.target(responses[k, j] / expected, np.ones((3, 3)), close.SAME_MESH)


def test_proved_order_of_the_length() -> None:
    """Exact arithmetic on the superelement: 19 repetitions for rotation and force, none fewer do."""
    problem, order = superelement_matrix(lift=False), data.REPETITIONS["length"]
    assert mbdlft.exact_lower_bound(problem) == {"L": order}
    assert mbdlft.exact_lower_bound(superelement_matrix(lift=True)) == {"L": order + 1}


@cache
def counted(name: str) -> mbdlft.LFTModel:
    """Models whose repetitions the source counts."""
    return model(data.counted(name))


COUNTED = [name for name in data.REPETITIONS if name != "length"]


@pytest.mark.parametrize("name", COUNTED)
def test_fewer_repetitions_than_the_source(name: str) -> None:
    found = counted(name)
    assert found.order < data.REPETITIONS[name]
    assert found.order >= found.certificate.order_bound
    assert found.certificate.exact


@pytest.mark.parametrize("name", COUNTED)
def test_no_unstable_poles_in_the_whole_range(name: str) -> None:
    """1 000 samples and the corners: undamped poles stay on the axis, also the fast ones."""
    found = counted(name)
    values = mbdlft.random(found.parameters, 1000, seed=5)
    outer = mbdlft.corners(found.parameters)
    both = {key: np.concatenate([values[key], outer[key][:64]]) for key in values}
    poles = np.linalg.eigvals(mbdlft.matrices_at(found, both).A)
    # a double pole at zero, of a rigid body, is split by rounding
    fast = np.abs(poles) > data.RIGID
    growth = np.where(fast, poles.real, 0.0)
    close.target(
        growth / np.max(np.abs(poles), axis=1, keepdims=True), np.zeros(growth.shape), close.STABLE, 1.0
    )


def test_two_beams_do_not_feel_where_they_meet() -> None:
    """One beam of 2 m, whatever its division: the first frequencies are those of a fine mesh."""
    found = counted("two beams")
    fine = beams.clamped(beams.mesh([0.1] * 20, BENDING, PER_LENGTH))[:2]
    for length in (0.5, 0.8, 1.3, 1.5):
        direct = beams.joined([QUINTIC(length), QUINTIC(2.0 - length)])
        close.target(
            data.frequencies(found, L=length) / beams.clamped(direct),
            np.ones(len(direct.M) - 2),
            close.CHAIN,
        )
        close.target(data.frequencies(found, L=length)[:2] / fine, np.ones(2), close.LENGTH_TABLE)


def squares(H: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues in order, and their conditions: by the size of the balanced matrix, by its entries."""
    balanced, _ = scipy.linalg.matrix_balance(H)
    values, left, right = scipy.linalg.eig(balanced, left=True)
    order, turned = np.argsort(np.abs(values)), np.abs(values * np.sum(left.conj() * right, axis=0))
    entries = np.einsum("ik,ij,jk->k", np.abs(left), np.abs(balanced), np.abs(right)) / turned
    return np.abs(values)[order], (np.linalg.norm(balanced) / turned)[order], entries[order]


def test_chain_of_beams_is_one_mesh() -> None:
    """Four beams of 7 elements in a row, of L/8, L/4, L/2, L/8, against the 28 elements."""
    parts, length = [0.125, 0.25, 0.5, 0.125], 0.5
    found = model(data.chain([length * part for part in parts], 7))
    own = [k for k, signal in enumerate(found.states) if signal.name.startswith("beam")]
    half = len(own) // 2
    H = -found.A[np.ix_(own[half:], own[:half])]
    fast, by_size, by_entries = squares(H)
    slow, inverse_size, _ = (part[::-1] for part in squares(np.linalg.inv(H)))
    is_slow = np.arange(half) < half // 2
    both = np.sqrt(np.where(is_slow, 1.0 / slow, fast))
    kappa = np.where(is_slow, inverse_size + by_entries, by_size)
    mesh = beams.mesh([length * part / 7 for part in parts for _ in range(7)], BENDING, PER_LENGTH)
    away = (both / beams.clamped(mesh) - 1.0) / kappa
    close.target(away, np.zeros(half), half * close.EPS, 1.0)


def test_mast_has_the_published_properties() -> None:
    found = model(data.mast())
    state = {signal.name: k for k, signal in enumerate(found.states)}
    sense = {signal.name: k for k, signal in enumerate(found.outputs)}
    C = found.C_y
    mass = C[sense["momentum.linear.y"], state["flight.velocity.y"]]
    inertia = C[sense["momentum.angular.z"], state["flight.rate"]]
    center = C[sense["center.y"], state["flight.angle"]]
    close.target(C[sense["center.y"], state["flight.position.y"]], 1.0, close.STABLE)
    for value, name in ((mass, "mass"), (center, "center"), (inertia, "inertia")):
        close.target(value / data.MAST_TOTAL[name], 1.0, close.MAST_TABLE)
    close.target(data.frequencies(found)[:3] / data.MAST, np.ones(3), close.MAST_TABLE)


def test_repeated_modes_are_counted_once() -> None:
    close.exact(data.distinct(np.array([1.0, 1.0, 2.0])), np.array([1.0, 2.0]))
