"""Beams that carry an axial load at equilibrium, or turn with their frame, against exact solutions.

Columns: exact frequencies by transfer matrices. Rotating beams: the first three frequencies over
(E I/(rho A L^4))^(1/2) of a uniform cantilever without hub, for displacements along the axis of the spin,
as published by A. D. Wright, C. E. Smith, R. W. Thresher, J. L. C. Wang, Vibration modes of centrifugally
stiffened beams, Journal of Applied Mechanics 49 (1982) 197-202; the digits are those commonly quoted and
have not been compared with the paper itself. In the plane of the spin, squares of
frequencies are smaller by the square of the rate (R. V. Southwell, F. Gough 1921).
"""

import numpy as np
import pytest

import mbdlft
from mbdlft.multibody.body import Beam, beam_elements
from tests import kit
from tests.close import CLOSED_FORM, LOADED_BEAM, THICK_BEAM, published, target
from tests.laws import elastic as scenes
from tests.reference.beams import CLAMPED, FREE, frequencies
from tests.seeds import some

ROTATING = {
    0.0: ("3.5160", "22.0345", "61.6972"),
    1.0: ("3.6816", "22.1810", "61.8418"),
    2.0: ("4.1373", "22.6149", "62.2732"),
    3.0: ("4.7973", "23.3203", "62.9850"),
    4.0: ("5.5850", "24.2733", "63.9668"),
    5.0: ("6.4495", "25.4461", "65.2050"),
    6.0: ("7.3604", "26.8091", "66.6839"),
    8.0: ("9.2568", "29.9954", "70.2930"),
    10.0: ("11.2023", "33.6404", "74.6493"),
    12.0: ("13.1702", "37.6031", "79.6145"),
}
EULER = np.pi**2 / 4.0  # the buckling load of a cantilever with E I = L = 1
BECK = 20.0509536  # that of flutter under a thrust: Beck 1952; Timoshenko, Gere, section 2.21


def column(load: float, frame: str = "ground", **given: object) -> mbdlft.Scene:
    """A cantilever along x with E I = rho A = L = 1 and a force along x at the tip."""
    shapes = {"modes": 6, "deformations": ("bending_y",), "modulus": 1.0, **given}
    push = kit.force("push", "beam.tip", (1, 0, 0), magnitude=load, frame=frame)
    return kit.scene(
        "column",
        scenes.beam(**shapes),
        kit.weld("root", "ground", "beam"),
        *([push] if load else []),
        inputs=["ground.acceleration.y"],
        outputs=["beam.bending_y.1.displacement"],
    )


def eigenvalues(scene: mbdlft.Scene) -> np.ndarray:
    return np.linalg.eigvals(mbdlft.to_lft(scene, search=0.0).A)


def lowest(scene: mbdlft.Scene, count: int = 3) -> np.ndarray:
    """The lowest frequencies (rad/s)."""
    return np.sort(np.abs(eigenvalues(scene).imag))[::2][:count]


@pytest.mark.parametrize("share", [0.9, 0.5, -3.0])
@pytest.mark.parametrize("shapes", [{"elements": 8, "modes": None}, {"modes": 6}])
def test_loaded_column(share: float, shapes: dict[str, object]) -> None:
    """Up to 0.9 of the buckling load, and pulled: within 0.5 %, the first within 1e-5."""
    exact = frequencies(
        3, CLAMPED, FREE, length=1.0, line=1.0, bending=1.0, tension=-share * EULER, highest=90.0
    )
    found = lowest(column(-share * EULER, **shapes))
    target(found / exact - 1.0, np.zeros(3), LOADED_BEAM, 1.0)
    target(found[0] / exact[0] - 1.0, 0.0, 0.01 * LOADED_BEAM, 1.0)


def test_column_with_shear() -> None:
    """The shear of a short column is that of an axial force on the slope of its axis."""
    own = {"shear_coefficient": 0.8, "shear_modulus": 25.0, "modes": None, "elements": 4}
    for load in (-1.5, 2.0):
        exact = frequencies(
            2, CLAMPED, FREE, length=1.0, line=1.0, bending=1.0, shear=20.0, rotary=1.0,
            tension=load, highest=12.0,
        )  # fmt: skip
        target(lowest(column(load, **own), 2) / exact - 1.0, np.zeros(2), 0.01 * LOADED_BEAM, 1.0)


@pytest.mark.parametrize("below", [True, False])
def test_buckling_by_a_dead_load_by_own_weight_and_by_a_thrust(below: bool) -> None:
    """pi^2/4 at the tip, 7.837 by its weight (Greenhill), 20.05 (flutter) by a thrust, E I = L = 1."""
    off = 1.0 - 1e-3 if below else 1.0 + 1e-3
    own_weight = column(0.0).model_copy(update={"gravity": (-7.83735 * off, 0.0, 0.0)})
    cases = (column(-EULER * off), own_weight, column(-BECK * off, "body", modes=9))
    for scene in cases:
        stable = np.max(eigenvalues(scene).real) < 1e-9
        assert stable == below


def test_load_as_a_parameter_is_left_in() -> None:
    """One model for all loads from half of the buckling load to the same pull."""
    parameter = mbdlft.Parameter("P", 0.0, low=-1.2, high=1.2, unit="N")
    scene = column(1.0)
    scene = scene.model_copy(
        update={
            "parameters": (parameter,),
            "loads": (scene.loads[0].model_copy(update={"magnitude": "P"}),),
        }
    )
    model = mbdlft.to_lft(scene, search=0.0)
    assert model.certificate.exact
    for load in (-1.2, 0.4, 1.2):
        squares = np.sort(np.linalg.eigvals(mbdlft.matrices_at(model, {"P": load}).A).imag ** 2)
        target(np.sqrt(squares[::2][:3]), lowest(column(load)), 1e4 * CLOSED_FORM)


def test_loads_at_stations_add_up() -> None:
    """Two pulls at inner nodes are one at the farther one, as far as the nearer one."""
    stations = {"near": 1, "far": 3}
    pulls = [
        kit.force(name, f"beam.{name}", (1, 0, 0), magnitude=load, frame="ground")
        for name, load in (("near", 0.7), ("far", -0.4))
    ]
    scene = column(0.0, stations=stations, elements=4, modes=4)
    found = scenes.motion(scene.model_copy(update={"loads": tuple(pulls)})).K
    free = scenes.motion(scene).K
    (_, d, _), *_ = scene.bodies[0].blocks()
    expected = free + 0.7 * beam_elements.products(d, "slope", beam_elements.ONE, 0, 1)
    expected -= 0.4 * beam_elements.products(d, "slope", beam_elements.ONE, 0, 3)
    target(found, expected, CLOSED_FORM)


# in a frame that spins -------------------------------------------------------------------------


def rotor(rate: float | str, deformation: str, **fields: object) -> mbdlft.Scene:
    scene = column(0.0, deformations=(deformation,), modes=12)
    spin = mbdlft.Spin(axis=(0, 0, 1), rate=rate) if rate else None
    outputs = (f"beam.{deformation}.1.displacement",)
    return scene.model_copy(update={"spin": spin, "outputs": outputs, **fields})


@pytest.mark.parametrize("rate", some([*ROTATING][::3], ROTATING))
@pytest.mark.parametrize("deformation", ["bending_y", "bending_z"])
def test_rotating_beam(rate: float, deformation: str) -> None:
    found = lowest(rotor(rate, deformation))
    if deformation == "bending_y":
        found = np.sqrt(found**2 + rate**2)
    for value, printed in zip(found, ROTATING[rate], strict=True):
        published(value, printed)


def test_rate_of_the_spin_is_a_parameter() -> None:
    parameter = mbdlft.Parameter("W", 3.0, low=0.0, high=6.0, unit="rad/s")
    model = mbdlft.to_lft(rotor("W", "bending_z", parameters=(parameter,)), search=0.0)
    assert model.certificate.exact
    for rate in (1.0, 4.0, 6.0):
        squares = np.sort(np.linalg.eigvals(mbdlft.matrices_at(model, {"W": rate}).A).imag ** 2)
        for value, printed in zip(np.sqrt(squares[::2][:3]), ROTATING[rate], strict=True):
            published(value, printed)


def whirling() -> mbdlft.Scene:
    """A beam that elongates and bends both ways, askew in a spinning frame, with a mass at its tip."""
    every = ("axial", "bending_y", "bending_z")
    body = scenes.beam(deformations=every, modes=3, modulus=500.0, I_y=0.02, I_z=0.05, prestress="axial")
    turn = kit.turn((0.2, 1.0, -0.5), 0.7)
    bob = kit.body("bob", 0.5, (0.1, 0.2, 0.25))
    return kit.scene(
        "whirl",
        body,
        bob,
        kit.weld("root", "ground", "beam", orientation=(turn,)),
        kit.weld("end", "beam.tip", "bob"),
        spin=mbdlft.Spin(axis=(0, 0, 1), rate=1.5),
        inputs=["ground.acceleration.y"],
        outputs=["beam.axial.1.displacement"],
    )


def spin_terms_are_those_of_energy() -> None:
    """Coriolis terms are skew, centrifugal ones symmetric: M is, D is skew, K is symmetric."""
    found = scenes.motion(whirling())
    target(found.M, found.M.T, 10 * CLOSED_FORM)
    target(found.D, -found.D.T, 10 * CLOSED_FORM)
    target(found.K, found.K.T, 10 * CLOSED_FORM)
    assert np.max(np.abs(found.D)) > 0.1


def test_spin_terms_are_those_of_energy() -> None:
    spin_terms_are_those_of_energy()


def test_spin_on_a_hinge_is_that_of_energy() -> None:
    """As `spin_terms_are_those_of_energy`, with a joint inside: wrench and efforts fit together."""
    scene = whirling()
    hinge = kit.hinge(
        "root", "ground", "beam", (0, 1, 0), stiffness=3.0, orientation=scene.joints[0].orientation
    )
    found = scenes.motion(scene.model_copy(update={"joints": (hinge, scene.joints[1])}))
    target(found.M, found.M.T, 10 * CLOSED_FORM)
    target(found.D, -found.D.T, 10 * CLOSED_FORM)
    target(found.K, found.K.T, 10 * CLOSED_FORM)


# Thick cantilevers against the exact solution of Timoshenko's equations --------------------

E, RHO, NU, K = 70e9, 2700.0, 0.3, 5.0 / 6.0
WIDTH, LENGTH = 0.3, 1.5  # m


def section(slenderness: float) -> dict[str, float]:
    """A rectangular section, by length over height."""
    h = LENGTH / slenderness
    return {"area": WIDTH * h, "I_z": WIDTH * h**3 / 12.0}


def exact(slenderness: float, count: int = 4) -> np.ndarray:
    own = section(slenderness)
    bending, line = E * own["I_z"], RHO * own["area"]
    highest = 130.0 * np.sqrt(bending / line) / LENGTH**2
    return frequencies(
        count, CLAMPED, FREE, length=LENGTH, line=line, bending=bending, rotary=RHO * own["I_z"],
        shear=K * E / (2.0 * (1.0 + NU)) * own["area"], highest=highest,
    )  # fmt: skip


def cantilever(slenderness: float, elements: int) -> mbdlft.Scene:
    body = Beam(
        name="beam",
        length=LENGTH,
        density=RHO,
        modulus=E,
        shear_modulus=E / (2.0 * (1.0 + NU)),
        shear_coefficient=K,
        deformations=("bending_y",),
        elements=elements,
        **section(slenderness),
    )
    return kit.scene(
        "cantilever",
        body,
        kit.weld("root", "ground", "beam"),
        inputs=["ground.acceleration.y"],
        outputs=["beam.bending_y.1.displacement"],
    )


def found(slenderness: float, elements: int, count: int = 4) -> np.ndarray:
    model = mbdlft.to_lft(cantilever(slenderness, elements), search=0.0)
    return np.sort(np.abs(np.linalg.eigvals(model.A).imag))[::2][:count]


@pytest.mark.parametrize("slenderness", some([3.0], [20.0]))
def test_four_frequencies_of_a_thick_beam(slenderness: float) -> None:
    """With 4 elements to a few parts in a thousand; with more they converge to the exact ones."""
    expected = exact(slenderness)
    coarse, fine = (found(slenderness, n) / expected - 1.0 for n in (4, 12))
    target(fine, np.zeros(4), 0.01 * THICK_BEAM, 1.0)
    assert np.max(np.abs(coarse)) <= 1.5 * THICK_BEAM
    assert np.all(coarse >= -1e-9), "Rayleigh: a frequency of shape functions is not too low"
