"""Laws of the lower bound.

1. it is never above the degree in exact arithmetic modulo a prime, and equal if nothing is doubtful
2. what rounding could have made does not count, and what is not clear is said to be doubtful
3. multibody chains have the degrees of exact arithmetic
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import schur

import mbdlft
from mbdlft.lft.lft import LFT, Block, constant, delta, inverse, stack_diagonal, with_blocks
from mbdlft.multibody.assembly import assemble
from mbdlft.order import degree as bound
from mbdlft.order.degree import Bound, degree_bounds
from mbdlft.order.reduction import reduce_order
from mbdlft.problem.relations import linearize
from tests.extracted import extracted, lower_bound
from tests.laws.lfts import padded
from tests.laws.loewner import exact_degree

DENOMINATOR = 4  # entries are integers over this: exact in floating point and modulo a prime


@st.composite
def sparse_lfts(draw: st.DrawFn) -> LFT:
    """LFTs with few entries, small fractions: most are not minimal."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    blocks = tuple(Block(name, draw(st.integers(0, 4))) for name in ("a", "b", "c"))
    n, n_out, n_in = sum(block.size for block in blocks), *random.integers(1, 4, 2)
    density = draw(st.sampled_from([0.15, 0.3, 0.6]))

    def some(rows: int, columns: int) -> np.ndarray:
        entries = random.integers(-3, 4, (rows, columns)) / DENOMINATOR
        return entries * (random.random((rows, columns)) < density)

    return LFT(some(n, n), some(n, n_in), some(n_out, n), some(n_out, n_in), blocks)


def law_degrees(a: LFT) -> None:
    random = np.random.default_rng(0)
    for name, found in degree_bounds(a).items():
        degree = exact_degree(a, name, random)
        assert found.degree <= degree
        assert found.degree == degree or found.doubtful


@given(sparse_lfts())
def test_degrees_of_exact_arithmetic(a: LFT) -> None:
    law_degrees(a)


def some_lft(seed: int) -> LFT:
    """Up to 12 channels, few entries, small fractions: most of them matter to nothing."""
    random = np.random.default_rng(seed)
    blocks = tuple(Block(name, int(random.integers(0, 7))) for name in ("a", "b"))
    n, n_out, n_in = sum(block.size for block in blocks), *random.integers(1, 4, 2)
    density = random.choice([0.1, 0.15, 0.3, 0.6])

    def some(rows: int, columns: int) -> np.ndarray:
        entries = random.integers(-3, 4, (rows, columns)) / DENOMINATOR
        return entries * (random.random((rows, columns)) < density)

    return LFT(some(n, n), some(n, n_in), some(n_out, n), some(n_out, n_in), blocks)


def test_error_that_vanishes() -> None:
    """Moving the entries changes nothing at some points: what is left is the rounding of the matrix."""
    for seed in (305, 4004, 8177):
        law_degrees(some_lft(seed))


def test_constant_in_padded_channels() -> None:
    """Channels that nothing reaches or nobody sees: their functions are rounding of terms that cancel.

    In about one in a hundred draws all of it vanishes in the twin, too.
    """
    a = with_blocks(constant([[1.5]]), ["a", "b"])
    for seed in range(100, 300):
        degrees = degree_bounds(padded(a, np.random.default_rng(seed)))
        assert {name: found.degree for name, found in degrees.items()} == {"a": 0, "b": 0}


def poles_of_high_order() -> LFT:
    """(1 + x^2)^-10 with x = 0.75 + t/4: two poles of order 10."""
    x = np.array([[0.75]]) + 0.25 * np.eye(1) @ delta("t")
    factor = inverse(np.eye(1) + x @ x)
    a = factor
    for _ in range(9):
        a = a @ factor
    return reduce_order(a)


def test_poles_of_high_order() -> None:
    assert degree_bounds(poles_of_high_order())["t"] == Bound(20, 0)


@pytest.mark.parametrize(
    ("power", "expected"), [(-20, (2, 0)), (-30, (2, 0)), (-43, (1, 1)), (-51, (1, 0))]
)
def test_what_is_not_clear_is_doubtful(power: int, expected: tuple[int, int]) -> None:
    """delta [1 1 ; 1 1+e] has degree 2; when e is as small as rounding, that cannot be seen."""
    a = np.array([[1.0, 1.0], [1.0, 1.0 + 2.0**power]]) @ delta("d", 2)
    assert degree_bounds(a)["d"] == Bound(*expected)


def test_a_twin_says_what_may_be_wrong() -> None:
    """The second rank of a matrix that is known to a part in 2^20 is not proved."""

    def known(entry: float) -> LFT:
        return np.array([[1.0, 1.0], [1.0, entry]]) @ delta("d", 2)

    a = known(1.0 + 2.0**-20)
    assert degree_bounds(a)["d"] == Bound(2, 0)
    assert degree_bounds(a, known(1.0 + 2.0**-21))["d"] == Bound(1, 1)


@pytest.mark.parametrize(
    ("fails", "expected"), [({"complex"}, Bound(20, 0)), ({"complex", "real"}, Bound(0, 20))]
)
def test_an_iteration_without_an_end(
    monkeypatch: pytest.MonkeyPatch, fails: set[str], expected: Bound
) -> None:
    """The Schur form is that of real numbers then; without any, nothing is proved and all is doubtful."""

    def failing(matrix: np.ndarray, output: str = "real") -> tuple[np.ndarray, np.ndarray]:
        if output in fails:
            raise np.linalg.LinAlgError
        T, Z = schur(matrix, output=output)
        return T, Z

    monkeypatch.setattr(bound, "schur", failing)
    assert degree_bounds(poles_of_high_order())["t"] == expected


def test_what_cancels_does_not_count() -> None:
    """diag(t, (p q - q p) t) is diag(t, 0): terms that cancel leave rounding, which is not rank."""
    p, q, t = (np.array([[0.3]]) + delta(name) for name in ("p", "q", "t"))
    for seed in range(20):
        a = stack_diagonal(t, (p @ q - q @ p) @ t)
        assert lower_bound(a, seed) == {"p": 0, "q": 0, "t": 1}


def chain(links: int) -> LFT:
    """Relations of a planar chain of equal links with parameters m, L and the angle t of each."""
    parameters: list[mbdlft.Parameter] = []
    bodies, joints = [], []
    for k in range(links):
        parameters += [
            mbdlft.Parameter(f"m{k}", 2.0, percent=20, unit="kg"),
            mbdlft.Parameter(f"L{k}", 1.0, percent=20, unit="m"),
            mbdlft.Angle(f"t{k}", 20.0 + 10 * k, 0.0, 80.0),
        ]
        body = mbdlft.RigidBody(
            name=f"b{k}",
            mass=f"m{k}",
            center_of_mass=(0, f"0.5*L{k}", 0),
            inertia=mbdlft.Inertia(xx=0.1, yy=0.05, zz=0.1),
            ports={"tip": (0, f"L{k}", 0)},
        )
        parent = f"b{k - 1}.tip" if k else "ground"
        bodies.append(body)
        joints.append(
            mbdlft.Revolute(name=f"j{k}", parent=parent, child=f"b{k}", axis=(1, 0, 0), position=f"t{k}")
        )
    scene = mbdlft.Scene(
        name="chain", gravity=(0, 0, -9.81), parameters=parameters, bodies=bodies, joints=joints
    )
    return extracted(linearize(assemble(scene), range(links), range(links)))


def test_degrees_of_a_chain() -> None:
    """85 in exact arithmetic modulo 2^61 - 1, of which mass k has k + 1: the joints that it loads."""
    found = degree_bounds(reduce_order(chain(6)))
    assert sum(item.degree for item in found.values()) == 85
    assert [found[f"m{k}"].degree for k in range(6)] == [1, 2, 3, 4, 5, 6]
    assert not any(item.doubtful for item in found.values())
