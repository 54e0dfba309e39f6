"""What is called regular on the whole box is; what is singular in a small ball never is called so."""

from fractions import Fraction

import numpy as np
import pytest

from mbdlft import LFTModel, Parameter, realize
from mbdlft.lft.lft import LFT, Block, add, constant, delta, inverse, multiply
from mbdlft.system import regular, sampled
from mbdlft.system.regular import Box, physical_boxes, regularity
from tests.laws.planted_singular import RADIUS, planted

WORK = 0.02
EYE = np.eye(1)


def inner(matrix: list[list[float]], *sizes: int) -> LFT:
    """An LFT of its M11 alone."""
    n = len(matrix)
    blocks = tuple(Block(f"p{k}", size) for k, size in enumerate(sizes))
    return LFT(np.array(matrix), np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), blocks)


@pytest.mark.parametrize("seed", range(30))
def test_a_ball_that_is_singular_is_never_called_regular(seed: int) -> None:
    a, center = planted(seed)
    known = regularity(a, WORK)
    assert not known.is_proved
    if known.zero is not None:  # the sphere around the center, or what rounding makes of it
        assert np.linalg.norm(known.zero - center) < 10.0 * RADIUS
    else:
        assert any(np.all(np.abs(center - box.center) <= box.half) for box in known.open_boxes)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(30, 530))
def test_five_hundred_balls(seed: int) -> None:
    assert not regularity(planted(seed)[0], WORK).is_proved


@pytest.mark.parametrize("seed", range(20))
def test_a_point_that_is_singular_is_never_called_regular(seed: int) -> None:
    """Without a change of sign, at one point: rounding may have removed it, and still it is not."""
    assert not regularity(planted(seed, 0.0)[0], WORK).is_proved


@pytest.mark.long
def test_what_is_far_from_singular_is_proved() -> None:
    found = [regularity(planted(seed, 0.1)[0], 1.0) for seed in range(16)]
    assert all(known.zero is None for known in found)
    assert sum(known.is_proved for known in found) >= 4


@pytest.mark.parametrize("work", [0.0, 1e-5, 1e-4, 1e-3])
def test_open_boxes_and_proved_parts_cover_the_box(work: float) -> None:
    """With little work the zero is in an open box, or it was found."""
    for seed in range(20):
        a, center = planted(seed)
        known = regularity(a, work)
        assert known.zero is not None or any(
            np.all(np.abs(center - box.center) <= box.half) for box in known.open_boxes
        )


@pytest.mark.parametrize("corner", [1.0, 1.0 - 2.0**-30, 1.0 + 2.0**-31, 1.0 + 2.0**-34])
def test_a_zero_at_the_corner_of_the_box(corner: float) -> None:
    """1 - delta/corner vanishes at the end, or so near to it that the model may be singular there."""
    assert not regularity(inner([[1.0 / corner]], 1)).is_proved


def test_near_the_corner() -> None:
    assert regularity(inner([[1.0 / (1.0 + 2.0**-9)]], 1)).is_proved


def test_loops_alone_matter() -> None:
    """A chain has the determinant 1, whatever its entries are."""
    assert regularity(inner([[0.0, 1e9], [0.0, 0.0]], 2)).is_proved
    assert regularity(inner([[0.0, 1e9], [1e-10, 0.0]], 1, 1)).is_proved
    known = regularity(inner([[0.0, 1e9], [1e-8, 0.0]], 1, 1))
    assert known.zero is not None
    assert abs(np.prod(known.zero) * 10.0 - 1.0) < 1e-9


def test_what_a_test_of_a_box_says_is_true() -> None:
    """The sum x > 0, P x < x in fractions, near the border."""
    random = np.random.default_rng(0)
    proved = 0
    for _ in range(200):
        P = random.random((3, 3))
        P *= (1.0 + random.uniform(-4.0, 4.0) * 2.0**-32) / max(abs(np.linalg.eigvals(P)))
        if regular._contracts(P[None], 3)[0]:
            proved += 1
            exact = [[Fraction(x) for x in row] for row in P.tolist()]
            gap = [[Fraction(i == j) - exact[i][j] for j in range(3)] for i in range(3)]
            minors = [gap[0][0], gap[0][0] * gap[1][1] - gap[0][1] * gap[1][0], _determinant(gap)]
            assert all(minor > 0 for minor in minors)  # of an M-matrix
    assert 20 < proved < 180


def _determinant(m: list[list[Fraction]]) -> Fraction:
    return (
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )


def test_the_same_work_gives_the_same_boxes() -> None:
    a, _ = planted(7)
    first, second = (regularity(a, 1e-3) for _ in range(2))
    assert first.zero is None or np.array_equal(first.zero, second.zero)
    for one, other in zip(first.open_boxes, second.open_boxes, strict=True):
        assert np.array_equal(one.center, other.center)
        assert np.array_equal(one.half, other.half)


def test_physical_boxes() -> None:
    parameters = [Parameter("a", 2.0, 1.0, 4.0, unit="kg"), Parameter("b", 0.0, -1.0, 1.0)]
    boxes = physical_boxes([Box(np.array([-0.5]), np.array([0.5]))], ["a"], parameters)
    assert boxes == (((1.0, 2.0), (-1.0, 1.0)),)


def thin(width: float, *, prove: float = 1.0) -> LFTModel:
    """1/((x - 0.3)^2 + (y - 0.6)^2 + width^2), with a search for nothing."""
    parameters = [Parameter(name, 0.5, 0.0, 1.0) for name in "xy"]
    matrix = [[f"1/((x - 0.3)^2 + (y - 0.6)^2 + {width!r}^2)"]]
    return realize(matrix, parameters, search=0.0, prove=prove)


def test_more_work_proves_more() -> None:
    little = thin(0.05, prove=0.0).certificate
    assert little.well_posed == "sampled"
    assert little.open_boxes
    assert all(low <= high for box in little.open_boxes for low, high in box)
    much = thin(0.05).certificate
    assert much.well_posed == "proved"
    assert much.open_boxes == ()


def test_values_of_a_model_that_is_not_proved() -> None:
    """What is refused is singular; the others have values."""
    parameters = [Parameter("p", 0.0, -1.0, 1.0)]
    a = add(constant([[1.0]]), -2.0 * EYE @ delta("p"))
    found = np.linspace(-1.0, 1.0, 9)[:, None]
    lft = multiply(inverse(a), constant([[1.0]]))
    some = np.abs(1.0 - 2.0 * found[:, 0]) > 0.1
    sampled.check_regular_at(lft, found[some], parameters, "model 'm'")
