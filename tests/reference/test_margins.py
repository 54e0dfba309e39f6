"""Structured singular values and margins that are published, or known in closed form."""

import numpy as np
import pytest

from mbdlft import Block, ComplexBlock, FullBlock, robust_stability, structured_singular_value, verify
from mbdlft.robust.bisect.boxes import replayed
from mbdlft.robust.bisect.characteristic import polynomials
from mbdlft.robust.evidence import Multipliers
from mbdlft.robust.mu.multipliers import structure_of, upper_bound
from mbdlft.robust.mu.singular_value import channels_at
from mbdlft.robust.realization import realization
from tests.close import MU, published, target
from tests.reference import robust_cases as cases


def test_example_of_slicot() -> None:
    M, blocks = cases.ab13md()
    published(upper_bound(M, structure_of(blocks), tolerance=1e-9).beta, "41.74753408")
    found = structured_singular_value(cases.static(M, *blocks), 0.0)
    target(found.lower, [41.74753408], MU)


def test_a_full_block_and_two_scalars() -> None:
    M = [[2.0, 2.0], [-1.0, -1.0]]
    full = structured_singular_value(cases.static(M, FullBlock("a", 2)), 0.0)
    target([full.lower[0], full.upper[0]], [np.sqrt(10.0)] * 2, MU)
    two = cases.static(M, ComplexBlock("a", 1), ComplexBlock("b", 1))
    found = structured_singular_value(two, 0.0)
    target([found.lower[0], found.upper[0]], [3.0, 3.0], MU)


@pytest.mark.parametrize(
    ("number", "block", "value"),
    [
        (1.0 + 2.0j, ComplexBlock("a", 1), np.sqrt(5.0)),
        (5.34, Block("a", 1), 5.34),
        (6.78j, Block("a", 1), 0.0),
    ],
)
def test_numbers(number: complex, block: Block, value: float) -> None:
    found = structured_singular_value(cases.static([[number]], block), 0.0)
    target([found.lower[0], found.upper[0]], [value, value], MU)


def test_a_rotation_is_regular_for_one_delta_and_not_for_two() -> None:
    M = [[0.0, 1.0], [-1.0, 0.0]]
    one = structured_singular_value(cases.static(M, Block("a", 2)), 0.0)
    assert one.upper[0] <= 1e-9
    two = structured_singular_value(cases.static(M, Block("a", 1), Block("b", 1)), 0.0)
    target([two.lower[0], two.upper[0]], [1.0, 1.0], MU)


def test_two_carts() -> None:
    exact = 2.886359  # at k = 1.577272, m1 = m2 = 0.422728
    found = robust_stability(cases.two_carts(), gap=1e-5)
    assert found.proved
    assert found.lower <= exact * (1.0 + 1e-6)
    assert found.upper >= exact * (1.0 - 1e-6)
    assert found.gap <= 1e-5
    published(found.frequency, "575.034")
    published(found.worst["k"], "1.577272")
    published(found.worst["m1"], "0.422728")
    published(found.worst["m2"], "0.422728")


def test_rational_system_of_two_states() -> None:
    found = robust_stability(cases.rotating(), gap=1e-6)
    (root,) = [x.real for x in np.roots([1.0, 0.0, 5.0, -2.0]) if x.imag == 0.0]
    assert found.lower <= root <= found.upper * (1.0 + 1e-12)
    published(1.0 / found.upper, "2.575385")
    assert found.gap <= 1e-6


def test_a_discrete_pair() -> None:
    found = robust_stability(cases.discrete_pair(), gap=1e-6)
    assert found.lower <= 1.25 <= found.upper * (1.0 + 1e-12)
    assert found.gap <= 1e-6


@pytest.mark.long
def test_transport_aircraft_is_closed() -> None:
    """The best of all 2^14 corners is 5.42812; it had been open from 4.38 on."""
    system = cases.transport_aircraft()
    found = robust_stability(system, gap=1e-4)
    published(found.upper, "5.42812")
    published(found.frequency, "0.6229")
    assert found.lower >= 5.42812 * (1.0 - 1e-4)
    assert found.proof is not None
    model = realization(system)
    again = polynomials(model, found.lower)
    assert replayed(model, found.lower, again, found.proof.log)


def test_transport_aircraft_at_frequencies() -> None:
    """Upper bounds of slycot's ab13md (D-G, no repeated blocks), and never above them by 0.1 %."""
    peers = {0.3: 0.20344, 0.62: 0.22788, 0.6229: 0.22794, 0.66: 0.22831, 1.0: 0.20913}
    peers |= {3.0: 0.12863, 10.0: 0.03095}
    system = cases.transport_aircraft()
    structure, starts = structure_of(system.lft.blocks), list[Multipliers]()
    for omega, peer in peers.items():
        last = upper_bound(channels_at(system, omega), structure, starts=starts)
        starts.append(last)
        assert last.beta <= 1.001 * peer
        assert last.beta >= 0.96 * peer
    found = structured_singular_value(system, 0.6228558)
    assert 0.18422 <= found.lower[0] <= found.upper[0]
    assert found.upper[0] <= 0.22795


def test_distillation_column() -> None:
    system = cases.distillation()
    grid = structured_singular_value(system, np.geomspace(1e-3, 1e3, 61)[28:36])
    published(float(np.max(grid.upper)), "5.77")
    published(float(np.max(grid.lower)), "5.77")
    found = robust_stability(system, gap=2e-3)
    assert 1.0 / found.upper <= 5.783
    assert 5.781 <= 1.0 / found.lower <= 5.782 * 1.002


def test_a_weight_that_nearly_integrates() -> None:
    """Eigenvalues beside the pole at -1e-8 are below the rounding of the pencil in doubles."""
    system = cases.distillation(1e-8)
    found = robust_stability(system, gap=0.03)
    assert found.gap <= 0.03
    assert found.lower <= 1.0 / 5.781
    assert verify(system, found) == ""
