"""Ranks without a tolerance: hard scales, many parameters, one parameter very often.

The right orders are known by construction: a minimal LFT is hidden by a similarity transformation of each
block, and by channels that nothing reaches or nobody sees.
"""

import numpy as np
import pytest

import mbdlft
from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, Block
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.order.degree import degree_bounds
from mbdlft.order.reduction import reduce_order
from tests.close import roundoff
from tests.extracted import lower_bound
from tests.laws.lfts import padded
from tests.laws.test_reduction import KAPPA, values

TWELVE = (1e-6, 1.0, 1e6)


def scaled_scene(mass: float, length: float) -> mbdlft.Scene:
    """A slide on a swinging arm with its masses and lengths in other sizes; the time stays."""
    inertia, stiffness = mass * length**2, mass
    parameters = [
        mbdlft.Parameter("m", 2.0 * mass, percent=30, unit="kg"),
        mbdlft.Parameter("L", 0.8 * length, percent=20, unit="m"),
        mbdlft.Parameter("J", 0.3 * inertia, percent=10, unit="kg m^2"),
        mbdlft.Parameter("k", 7.0 * stiffness, percent=50, unit="N/m"),
        mbdlft.Angle("t", 20.0, -30.0, 60.0),
    ]
    arm = mbdlft.RigidBody(
        name="arm",
        mass=1.5 * mass,
        center_of_mass=(0, "0.4*L", 0),
        inertia=mbdlft.Inertia(xx="J"),
        ports={"tip": (0, "L", 0)},
    )
    swing = mbdlft.Revolute(
        name="swing", parent="ground", child="arm", axis=(1, 0, 0), position="t", damping=0.1 * inertia
    )
    slide = mbdlft.Prismatic(
        name="slide", parent="arm.tip", child="load", axis=(0, 1, 0), position=0.2 * length, stiffness="k"
    )
    return mbdlft.Scene(
        name="slide",
        gravity=(0, 0, -9.81 * length),
        parameters=parameters,
        bodies=[arm, mbdlft.PointMass(name="load", mass="m")],
        joints=[swing, slide],
    )


@pytest.mark.parametrize("length", TWELVE)
@pytest.mark.parametrize("mass", TWELVE)
def test_units_do_not_change_ranks(mass: float, length: float) -> None:
    """Micrograms to kilotons, micrometers to megameters: order and bound are those of kg and m."""
    found = mbdlft.to_lft(scaled_scene(mass, length), search=0.0).certificate
    expected = mbdlft.to_lft(scaled_scene(1.0, 1.0), search=0.0).certificate
    assert found.order == expected.order
    assert found.lower_bound == expected.lower_bound
    assert not any(found.doubtful)


def minimal(sizes: dict[str, int], signals: int, seed: int = 0) -> LFT:
    """A random LFT; a random LFT with as many signals as its largest block is minimal."""
    random = np.random.default_rng(seed)
    blocks = tuple(Block(name, size) for name, size in sorted(sizes.items()))
    n = sum(sizes.values())
    M11 = random.standard_normal((n, n))
    M11 *= 0.6 / np.linalg.norm(M11, 2)
    M12, M21 = random.standard_normal((n, signals)), random.standard_normal((signals, n))
    return LFT(M11, M12, M21, random.standard_normal((signals, signals)), blocks)


def rescaled(a: LFT, decades: float, random: np.random.Generator) -> LFT:
    """Inputs, outputs and channels in units of random sizes."""

    def sizes(count: int) -> Array:
        return 10.0 ** random.uniform(-decades, decades, count)

    inputs, outputs, channels = sizes(a.shape[1]), sizes(a.shape[0]), sizes(a.order)
    return LFT(
        channels[:, None] * a.M11 / channels,
        channels[:, None] * a.M12 * inputs,
        outputs[:, None] * a.M21 / channels,
        outputs[:, None] * a.M22 * inputs,
        a.blocks,
    )


@pytest.mark.parametrize("seed", range(5))
def test_scales_over_twelve_orders(seed: int) -> None:
    random = np.random.default_rng(seed)
    right = minimal({"a": 5, "b": 3, "c": 4, "d": 1}, 3, seed)
    hidden = rescaled(padded(right, random), 6.0, random)
    small = reduce_order(hidden)
    assert small.blocks == right.blocks
    for item in (hidden, small):
        assert lower_bound(item) == dict(right.blocks)
        assert not any(found.doubtful for found in degree_bounds(item).values())


def test_forty_parameters() -> None:
    random = np.random.default_rng(1)
    right = minimal({f"p{k:02d}": 1 + k % 4 for k in range(40)}, 4)
    hidden = padded(right, random)
    assert hidden.order == right.order + 80
    small = reduce_order(hidden)
    assert small.blocks == right.blocks
    assert lower_bound(small) == lower_bound(hidden) == dict(right.blocks)
    points = random.uniform(-1.0, 1.0, (3, 40))
    roundoff(*(evaluate_at(item, points) for item in (small, right)), KAPPA)


def power(count: int) -> LFT:
    """delta^count: a chain of channels, minimal."""
    eye = np.eye(count)
    return LFT(np.eye(count, k=1), eye[:, -1:], eye[:1], np.zeros((1, 1)), (Block("a", count),))


@pytest.mark.parametrize("count", [150, pytest.param(500, marks=pytest.mark.long)])
def test_one_parameter_very_often(count: int) -> None:
    """delta^count, hidden in two channels more."""
    small = reduce_order(padded(power(count), np.random.default_rng(2)))
    assert small.order == count
    assert degree_bounds(small)["a"] == (count, 0)
    roundoff(values(small, 3), values(power(count), 3), KAPPA)


def test_500_repetitions_of_which_10_are_needed() -> None:
    """A sum of 100 copies of delta/(1 - p delta) R_p with R_p of full rank 2, for 5 values of p."""
    random = np.random.default_rng(3)
    poles = np.repeat([-0.5, -0.2, 0.1, 0.3, 0.6], 100)
    M12, M21 = random.standard_normal((500, 2)), random.standard_normal((2, 500))
    T, _ = np.linalg.qr(random.standard_normal((500, 500)))
    many = LFT(T * poles @ T.T, T @ M12, M21 @ T.T, np.zeros((2, 2)), (Block("a", 500),))
    small = reduce_order(many)
    assert small.order == 10
    assert degree_bounds(small)["a"] == (10, 0)
    d = 0.7
    expected = (M21 * (d / (1.0 - poles * d))) @ M12
    roundoff(evaluate(small, {"a": d}), expected, KAPPA)
