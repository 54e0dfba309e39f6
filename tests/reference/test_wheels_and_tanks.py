"""Wheel clusters and slosh tanks against printed numbers and potential theory.

Sources: Dodge, The New "Dynamic Behavior of Liquids in Moving Containers" (2000), table 3.1,
with d = 2 R: d/(4.4 h) tanh(3.68 h/d), d/3.68 coth(3.68 h/d), m g/(1.19 h) tanh^2(3.68 h/d), and
h/2 - d/1.84 tanh(1.84 h/d); Markley, Crassidis (2014), section 7.3.4: the fourth wheel of the NASA
standard at 1/sqrt(3) to each axis.
"""

import numpy as np
import pytest
from scipy.special import jnp_zeros

import mbdlft
from mbdlft import Parameter
from mbdlft.base.errors import SceneError
from mbdlft.library.devices import ZERO
from mbdlft.multibody import JointWrench
from tests import kit
from tests.close import CLOSED_FORM, EVALUATION, published, target


def test_constants_are_those_of_the_table() -> None:
    target(ZERO, jnp_zeros(1, 1)[0], EVALUATION)
    data = mbdlft.slosh_data(0.5, 40.0)  # d = 1 m, deep: tanh = 1
    published(1.0 / (40.0 * data.share), "4.4")
    published(1.0 / data.length, "3.68")
    published(1.0 / (40.0 * data.share * data.frequency_squared), "1.19")
    published(1.0 / (20.0 - data.height), "1.84")


@pytest.mark.parametrize("acceleration", [None, "a", 12.0, "12 [m/s^2]", "a/2 + 6"])
@pytest.mark.parametrize("mass", ["m", 15e3, "15e3 [kg]", "0.5*m + 7500"])
def test_tank_has_the_frequency_of_the_liquid(
    mass: float | str, acceleration: float | str | None
) -> None:
    """Held still, w^2 = (a x/R) tanh(x h/R), NASA SP-106; the force on the tank, of both forms, is
    m (1 - share s^2/(s^2 + w^2)) for an acceleration of the track. Numbers and expressions are alike."""
    R, h, m = 1.5, 2.4, 15e3
    tank = mbdlft.slosh_tank("slosh", "stage", radius=R, height=h, mass=mass, acceleration=acceleration)
    a = Parameter("a", 12.0, low=5.0, high=25.0, unit="m/s^2")
    spare = kit.point("spare", "m")  # so that m is used in all of them
    scene = kit.scene(
        "tank",
        *(a, Parameter("m", m, percent=30, unit="kg")),
        *(kit.point("stage", 5e3), spare, *tank.bodies),
        kit.rail("track", "ground", "stage", (1, 0, 0), imposed=True),
        kit.rail("wall", "ground", "spare", (1, 0, 0)),
        *tank.joints,
        JointWrench(name="felt", joint="track"),
        acceleration=(0, 0, "a"),
        inputs=["track.acceleration"],
        outputs=["felt.force.x"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    points = [{"a": 12.0, "m": m}]
    if mass == "m" and acceleration in (None, "a"):
        points += [{"a": 7.0, "m": 11e3}, {"a": 24.0, "m": 19e3}]
    for values in points:
        squared = values["a"] * ZERO / R * np.tanh(ZERO * h / R)
        share = 2.0 * R * np.tanh(ZERO * h / R) / (ZERO * (ZERO**2 - 1.0) * h)
        for s in (2j, 5j, 1.0 + 3j):
            felt = kit.transfer(model, s, values)[0, 0]
            wanted = 5e3 + values["m"] * (1.0 - share * s**2 / (s**2 + squared))
            target(np.array([felt]), np.array([wanted]), CLOSED_FORM)


@pytest.mark.parametrize("mass", [100.0, "100 [kg]", "m", "0.5*m"])
@pytest.mark.parametrize("acceleration", [12.0, "12 [m/s^2]", "a", None])
def test_force_of_the_liquid_is_that_of_potential_theory(
    mass: float | str, acceleration: float | str | None
) -> None:
    """F = -m s^2 x (1 - share s^2/(s^2 + w^2)): Abramson, NASA SP-106 (1966), chapter 6.

    Masses and accelerations are given in all ways. The share

        2 R/((x^2 - 1) x h) tanh(x h/R)

    and w are those of the first mode, in both analogies.
    """
    R, h, stage = 0.5, 0.8, 500.0
    tank = mbdlft.slosh_tank("slosh", "stage", radius=R, height=h, mass=mass, acceleration=acceleration)
    scene = kit.scene(
        "tank",
        Parameter("a", 12.0, percent=50, unit="m/s^2"),
        Parameter("m", 100.0, percent=20, unit="kg"),
        *(kit.point("stage", stage), *tank.bodies),
        *(kit.rail("track", "ground", "stage", (1, 0, 0)), *tank.joints),
        acceleration=(0, 0, "a"),
        inputs=["track.force"],
        outputs=["track.position"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    a, m, s = 12.0, 110.0, 1.0 + 3.0j
    if acceleration in (None, "a"):
        a = 15.0
    liquid = {"m": m, "0.5*m": 0.5 * m}.get(str(mass), 100.0)
    deep = np.tanh(ZERO * h / R)
    squared = a * ZERO / R * deep
    share = 2.0 * R * deep / ((ZERO**2 - 1.0) * ZERO * h)
    wanted = 1.0 / (s**2 * (stage + liquid * (1.0 - share * s**2 / (s**2 + squared))))
    target(kit.transfer(model, s, {"a": a, "m": m})[0, 0], wanted, CLOSED_FORM)


def test_center_of_the_liquid_is_kept() -> None:
    tank = mbdlft.slosh_tank("slosh", "stage", radius=1.5, height=2.4, mass=1000.0)
    data, (rest, _) = mbdlft.slosh_data(1.5, 2.4), tank.bodies
    moment = (1 - data.share) * rest.center_of_mass[2] + data.share * (1.2 + data.height)
    target(moment, 1.2, CLOSED_FORM)
    target(rest.ports["hinge"][2], 1.2 + data.height + data.length, CLOSED_FORM)


def test_sizes_are_positive() -> None:
    with pytest.raises(SceneError, match="positive, got 0 m and 1 m"):
        mbdlft.slosh_data(0.0, 1.0)


def satellite(arrangement: str, count: int) -> tuple[mbdlft.LFTModel, np.ndarray]:
    rates = [f"{k + 1}*W" for k in range(count)]
    wheel = {"mass": 4.0, "axial": "J", "across": "0.6*J"}
    wheels = mbdlft.wheel_cluster("wheel", "hub", arrangement, **wheel, rates=rates)
    scene = kit.scene(
        "satellite",
        Parameter("W", 200.0, percent=40, unit="rad/s"),
        Parameter("J", 0.08, percent=10, unit="kg m^2"),
        *(kit.body("hub", 300.0, (9, 11, 7)), *wheels.bodies),
        *(kit.ball("attitude", "ground", "hub"), *wheels.joints),
    )
    axes = np.array(mbdlft.WHEEL_AXES[arrangement], dtype=float)
    return mbdlft.to_lft(scene, search=0.0), axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize(("arrangement", "count"), [("orthogonal", 3), ("nasa", 4), ("pyramid", 4)])
def test_cluster_is_that_of_its_axes(arrangement: str, count: int) -> None:
    """Torques act along -e_k, and the momentum is the sum of J W_k e_k."""
    model, axes = satellite(arrangement, count)
    W, J = 230.0, 0.085
    A, B, _, _ = mbdlft.matrices_at(model, {"W": W, "J": J})
    # the axial inertia follows the wheels, not the hub
    hub = np.diag([9.0, 11.0, 7.0]) + 0.6 * J * (count * np.eye(3) - axes.T @ axes)
    target(B[3:6, 3:], -np.linalg.solve(hub, axes.T), CLOSED_FORM)
    h = sum(J * (k + 1) * W * e for k, e in enumerate(axes))
    across = np.cross(np.eye(3), h).T  # columns: e_k x h
    target(A[3:6, 3:6], -np.linalg.solve(hub, across), CLOSED_FORM)


def test_nasa_standard_has_equal_angles() -> None:
    _, axes = satellite("nasa", 4)
    published(float(axes[3, 0]), "0.577")
    assert np.ptp(axes[3]) == 0.0


def test_clusters_are_checked() -> None:
    with pytest.raises(SceneError, match="unknown arrangement 'hexagon'"):
        mbdlft.wheel_cluster("w", "hub", "hexagon", mass=1, axial=1, across=1)
    with pytest.raises(SceneError, match="2 rates for 3 wheels"):
        mbdlft.wheel_cluster("w", "hub", "orthogonal", mass=1, axial=1, across=1, rates=[1, 2])
    with pytest.raises(SceneError, match="zero length"):
        mbdlft.wheel_cluster("w", "hub", [(0, 0, 0)], mass=1, axial=1, across=1)
