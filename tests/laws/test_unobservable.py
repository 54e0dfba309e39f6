"""Laws of directions that an exchange leaves out at no cost, in exact numbers."""

import itertools
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import flint
import numpy as np
import pytest

import mbdlft
from benchmarks.cases.orders import CASES
from mbdlft import to_lft
from mbdlft.exact import matrices, modular
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.modular import Residues
from mbdlft.exact.numbers import NOTHING, RESIDUES_ALONE, TooFewBitsError, precision
from mbdlft.exact.pencils import motions_without_outputs
from mbdlft.exact.rounding import or_one
from mbdlft.lft.sampling import evaluate
from mbdlft.order.rational import Terms
from mbdlft.order.unobservable import (
    Motions,
    Unobservable,
    _different,
    _kernels,
    _polynomials,
    _Roots,
    unobservable,
)
from tests.close import SCENARIO, target
from tests.cross.mechanisms import open_tree
from tests.extracted import FIELD
from tests.extracted import with_bits as with_bits
from tests.laws.test_recovery import at, known
from tests.strategies import random_scene

PRIME = FIELD.prime


def integers(a: np.ndarray) -> ExactMatrix:
    return matrices.of_integers(np.asarray(a, dtype=float), PRIME)


def moved(s: np.ndarray, A: np.ndarray, seed: int) -> Motions:
    """Matrices that commute, in other coordinates, and six rows of z."""
    random = np.random.default_rng(seed)
    n = len(s)
    T = np.tril(random.integers(-2, 3, (n, n)), -1) + np.eye(n)
    T = T @ (np.triu(random.integers(-2, 3, (n, n)), 1) + np.eye(n))
    inside = np.round(np.linalg.inv(T))
    assert np.array_equal(T @ inside, np.eye(n))
    return Motions(*map(integers, (T @ s @ inside, T @ A @ inside, random.integers(-9, 10, (6, n)))))


def rows(count: int) -> Residues:
    """Of six, those that are zero on R."""
    return np.eye(6, dtype=np.int64)[:count]


def law_kept(found: Unobservable, outside: Residues) -> None:
    """Independent beside R, and kept by both matrices, in residues and in balls."""
    columns = next(found.columns(values, outside) for values in found.values())
    assert columns.shape == (6, found.size)
    assert modular.rank(modular.multiplied(outside, columns.residues, PRIME), PRIME) == found.size
    motions = found.motions
    inside = motions.z.T @ motions.z  # regular: motions are told by z
    span = inside.solve(motions.z.T @ columns)
    for a in (motions.s, motions.A):
        both = matrices.stacked([[span, a @ span]])
        assert modular.rank(both.residues, PRIME) == found.size
        values = matrices.rough_values(both)
        assert (
            np.linalg.matrix_rank(values / or_one(np.linalg.norm(values, axis=0)), tol=1e-9) == found.size
        )


POINTS = {
    "four points": (np.diag([1, 1, 2, 3]), np.diag([5, 6, 5, 7])),
    "one of them zero": (np.diag([7, 1, 2, 3]), np.diag([-3, 5, 6, 7])),
    "one of order four": (np.eye(4, k=1), np.eye(4, k=2) + 2 * np.eye(4)),
    "two of order two": (np.kron(np.diag([1, 4]), np.eye(2)), np.kron(np.eye(2), np.eye(2, k=1))),
    "a complex pair of order two": (
        np.kron(np.eye(2), [[0, -1], [1, 0]]) + np.kron(np.eye(2, k=1), np.eye(2)),
        3 * np.eye(4),
    ),
}


@pytest.mark.parametrize("name", POINTS)
@pytest.mark.parametrize("most", [2, 4, 5])
def test_parts_are_kept(name: str, most: int) -> None:
    """As many columns as there is room for; all of them without any eigenvalue."""
    motions = moved(*POINTS[name], most)
    found = unobservable(motions, rows(most), most)
    assert found is not None
    assert found.size == min(most, 4)
    assert bool(found.points) == (most < 4)
    law_kept(found, rows(most))
    with precision(RESIDUES_ALONE):
        alone = unobservable(motions.residues(), rows(most), most)
    assert alone is not None
    assert alone.size == found.size


def test_all_motions_are_no_part_where_they_depend_beside_r() -> None:
    found = unobservable(moved(*POINTS["four points"], 3), rows(2), 4)
    assert found is not None
    assert (found.size, bool(found.points)) == (2, True)
    law_kept(found, rows(2))


def test_real_and_complex_points() -> None:
    """A value is not that of two points, as there are fewer real ones than residues."""
    s = np.zeros((5, 5))
    s[0, 0], s[1:3, 1:3], s[3:, 3:] = 2, [[0, -1], [1, 0]], [[0, -2], [2, 0]]
    found = unobservable(moved(s, np.eye(5), 0), rows(3), 3)
    assert found is not None
    assert [len(residues) for residues, _ in found.points] == [3]
    law_kept(found, rows(3))


def test_no_part_is_half_of_a_pair() -> None:
    motions = moved(*POINTS["a complex pair of order two"], 0)
    found = unobservable(motions, rows(1), 1)
    assert found is not None
    assert found.size == 0


def test_single_points_are_taken_together() -> None:
    """And a point of higher order after them, where there is room."""
    s = np.diag([1.0, 1, 2, 3, 4])
    s[0, 1] = 1.0
    motions = moved(s, np.eye(5), 0)
    for most, counts in ((3, [3]), (4, [3, 1])):
        found = unobservable(motions, rows(most), most)
        assert found is not None
        assert [len(residues) for residues, _ in found.points] == counts
        double = flint.nmod(3 * 1 + 7, PRIME)
        assert flint.nmod_poly([*found.points[0].residues, 1], PRIME)(double) != 0
        law_kept(found, rows(most))


def test_many_points_are_taken_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of more than can be taken together in balls in some seconds."""
    monkeypatch.setattr("mbdlft.order.unobservable._MOST_TOGETHER", 3)
    found = unobservable(moved(*POINTS["four points"], 2), rows(2), 2)
    assert found is not None
    assert [len(residues) for residues, _ in found.points] == [1, 1]
    assert not found.by_prime


def test_other_primes_have_other_factors() -> None:
    """Two points whose polynomial has no factor of residues are no single one; modulo others they may."""
    square = next(k for k in range(2, 100) if pow(k, (PRIME - 1) // 2, PRIME) != 1)
    motions = moved(np.array([[0, square], [1, 0]]), np.eye(2), 0)
    with precision(RESIDUES_ALONE):
        alone = motions.residues()
        for most, size, by_prime in ((1, 0, True), (2, 2, False), (3, 2, False)):
            found = unobservable(alone, rows(most), most)
            assert found is not None
            assert (found.size, found.by_prime) == (size, by_prime)
        inside = unobservable(alone._replace(z=integers(np.zeros((6, 2)))), rows(1), 1)
        assert inside is not None
        assert not inside.by_prime


def test_polynomials_of_single_roots() -> None:
    """Of as many roots, complex ones in pairs; zero is one of them where it is one as a residue."""
    above = [flint.acb(0, 1), flint.acb(1, 2)]
    roots = _Roots([], [NOTHING, flint.arb(3), flint.arb(4)], above, [], ([True] * 3, [True, False]))
    degrees = {(3, True): [[0, 1, 0], [0, 12, -7]], (3, False): [[-3, 1, -3], [-4, 1, -4]]}
    degrees |= {(1, True): [[0]], (1, False): [[-3], [-4]], (4, False): [[12, -7, 13, -7]]}
    for (degree, has_zero), expected in degrees.items():
        some = [*_polynomials(roots, degree, has_zero=has_zero)]
        assert [[round(float(x)) for x in coefficients] for coefficients in some] == expected
        assert all((coefficients[0] is NOTHING) == has_zero for coefficients in some)
    assert not [*_polynomials(roots, 5, has_zero=False)]
    many = [flint.acb(k, 1) for k in range(40)]
    roots = _Roots([], [], many, [], ([], [True] * 40))
    assert len(next(_polynomials(roots, 40, has_zero=False))) == 40  # of 10^11 choices
    assert not [*_polynomials(roots, 41, has_zero=False)]  # of as many pairs, and nothing for the last


def test_a_value_of_another_point_is_refused() -> None:
    """Where it makes a zero of what is none; no part of a point is beside R where z is not."""
    motions = moved(*POINTS["four points"], 1)
    with pytest.raises(TooFewBitsError):
        _kernels(motions, (-(3 * 1 + 7 * 5) % PRIME,), matrices.balls_of(np.array([-38.5])))
    nothing = motions._replace(z=integers(np.zeros((6, 4))))
    found = unobservable(nothing, rows(2), 2)
    assert found is not None
    assert found.size == 0


def test_points_have_different_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of thirty points that may be any of thirty values, the first of all orders is there at once.

    No more of them is asked for than is tried.
    """
    some = [flint.arb(k) for k in range(30)]
    first = next(_different([some] * 30, ()))
    assert {id(value) for value in first} == {id(value) for value in some}
    nothing = [NOTHING], [NOTHING]  # of two points whose residues are zero
    assert [*_different([nothing[:1], some[:2], some[:1], nothing[1:]], ())] == [
        (nothing[0], *some[1::-1], nothing[1])
    ]
    values = Unobservable.values

    def only_one(self: Unobservable) -> Iterator[tuple[Any, ...]]:
        yield next(values(self))
        raise AssertionError

    monkeypatch.setattr(Unobservable, "values", only_one)
    assert to_lft(random_scene(1)).order == 7


def test_motions_without_outputs() -> None:
    """x' = s x with x in a space that A keeps with inputs, and what other outputs are on it."""
    random = np.random.default_rng(0)
    Z, V = np.array([[2, 1], [0, 3]]), random.integers(-3, 4, (2, 2))
    A = np.block([[Z, random.integers(-3, 4, (2, 2))], [np.zeros((2, 2)), np.diag([5, 7])]])
    B, D = random.integers(-3, 4, (4, 1)), np.array([[1], [2]])
    M = np.block([[A, B], [np.eye(4)[2:], D], [np.hstack([V, V]), B[:2]]])
    found = motions_without_outputs(integers(M), 4, 2)
    assert found is not None
    assert np.array_equal(matrices.rough_values(found[0]), Z)
    assert np.array_equal(matrices.rough_values(found[1]), V)
    M[4:6] = 0  # any input does
    assert motions_without_outputs(integers(M), 4, 2) is None


# scenes whose bound is reached so: at one point, at infinity, at poles of higher order, at complex ones;
# modulo the second prime or a later one
@pytest.mark.parametrize(("seed", "order"), [(1, 7), (218, 8), (389, 4), (101, 16), (9, 10)])
def test_scenes_meet_their_bounds(seed: int, order: int) -> None:
    scene = random_scene(seed)
    model, plain = to_lft(scene), to_lft(scene, search=0.0)
    assert model.order == order
    assert model.certificate.minimal
    at = mbdlft.random(model.parameters, 50, seed=2)
    for small, large in zip(mbdlft.matrices_at(model, at), mbdlft.matrices_at(plain, at), strict=True):
        target(small, large, SCENARIO)


# single points; one that is not where a parameter is nominal; relations of another form
@pytest.mark.parametrize("seed", [9, 106, 336, 280, 221, 644])
def test_fractions_of_two_parameters_meet_their_bounds(seed: int) -> None:
    """N/d in lowest terms: zeros that both share are left out, real ones, or complex ones in pairs."""
    F, order = known(seed)
    names = ["a", "b"]
    *entries, d = (written(terms, names) for terms in (*itertools.chain(*F.N), F.d))
    texts = np.reshape([f"({entry})/({d})" for entry in entries], (len(F.N), -1)).tolist()
    model = mbdlft.realize(texts, [mbdlft.Parameter(name, 0.0, -0.1, 0.1) for name in names])
    assert model.order == model.certificate.order_bound == order
    point = [Fraction(1, 16), Fraction(-1, 32)]
    values = [[float(at(x, point) / at(F.d, point)) for x in row] for row in F.N]
    found = evaluate(
        model.lft, {name: np.array([10 * float(x)]) for name, x in zip(names, point, strict=True)}
    )
    target(found[0], np.array(values), SCENARIO)


def written(terms: Terms, names: list[str]) -> str:
    """A polynomial as text."""
    powers = (
        [f"({x})", *(f"{name}^{e}" for name, e in zip(names, exponents, strict=True) if e)]
        for exponents, x in terms.items()
    )
    return " + ".join(map("*".join, powers)) or "0"


def test_a_tree_meets_its_bound() -> None:
    """29 repetitions without a search; degrees add up to 25."""
    model = to_lft(open_tree(2))
    assert dict(model.lft.blocks) == {"k": 4, "th": 22}
    assert model.certificate.minimal


def test_a_polynomial_matrix_meets_its_bound() -> None:
    """All of its points are one, of high order."""
    case = next(case for case in CASES if case.name == "O8")
    model = mbdlft.realize(case.problem())
    assert model.order == model.certificate.order_bound == 17


def test_complex_points() -> None:
    """Eight columns of two conjugate points of higher order; 40 without them."""
    assert to_lft(random_scene(51)).order == 39
