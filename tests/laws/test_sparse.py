"""Sparse LFTs: values, signs, sizes and degrees are those of the dense form; models, archives, errors."""

import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from benchmarks.cases.chains import chain
from mbdlft.base.errors import ArchiveError, StructureError, WellPosednessError
from mbdlft.exact.modular import multiplied
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.determinant import values_at
from mbdlft.lft.lft import LFT, Block, eliminate
from mbdlft.lft.sampling import evaluate_at, rounding_sizes
from mbdlft.lft.sparse import ALWAYS, SparseLFT, in_units, solved_for, value_and_sign
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.sparse_bound import SparseResidues, _at_random, sparse_degrees, value_at_random
from mbdlft.system.sampled import matrices_at
from tests.archive.plain_digest import PAGE
from tests.close import CHAIN, exact, roundoff, target
from tests.errors.table import refused, says
from tests.extracted import exactly
from tests.laws.lfts import lfts, sparse_lfts

KAPPA = 1e4


def sparse(a: LFT) -> SparseLFT:
    """Channels as signals, in the opposite order: w - delta (M11 w + M12 u) = 0."""
    n = a.order
    owner = np.repeat(np.arange(len(a.blocks)), [block.size for block in a.blocks])
    i, j = np.nonzero(np.ones((n + a.shape[0], n + a.shape[1])))
    M = np.block([[-a.M11, -a.M12], [a.M21, a.M22]])
    blocks = np.append(owner, ALWAYS)[np.minimum(i, n)]
    own = np.arange(n)
    return SparseLFT(
        np.append(i, own),
        np.append(np.where(j < n, n - 1 - j, j), n - 1 - own),
        np.append(M[i, j], np.ones(n)),
        np.append(blocks, np.full(n, ALWAYS)),
        n,
        a.shape,
        a.blocks,
    )


def drawn(a: LFT, seed: int, largest: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-largest, largest, (4, len(a.blocks)))


@given(lfts(), st.integers(0, 9))
def test_values_and_sizes(a: LFT, seed: int) -> None:
    at, form = drawn(a, seed), sparse(a)
    expected, of_rounding = evaluate_at(a, at), rounding_sizes(a, at)
    size = float(np.max(of_rounding))
    roundoff(evaluate_at(form, at), expected, KAPPA, size)
    roundoff(rounding_sizes(form, at), of_rounding, KAPPA, size)
    exact(form.M22, a.M22)


@given(lfts(scales=(1.0,)), st.integers(0, 9))
def test_signs_of_the_determinant(a: LFT, seed: int) -> None:
    """Far away, where it has either sign."""
    at = drawn(a, seed, 9.0)
    exact(values_at(sparse(a), at)[1], values_at(a, at)[1])


@given(st.integers(0, 10**6))
def test_signs_of_permuted_factors(seed: int) -> None:
    random, n = np.random.default_rng(seed), 7
    some = random.random((n, n)) < 0.3
    K = random.integers(1, 4, (n, n)) * some + 9.0 * np.eye(n)[random.permutation(n)]
    i, j = np.nonzero(K)
    a = SparseLFT(i, j, K[i, j], np.full(len(i), ALWAYS), n, (0, 0), ())
    assert value_and_sign(a, np.zeros(0))[1] == np.linalg.slogdet(K)[0]


@given(lfts(n_out=3, n_in=3, scales=(1.0,)), st.integers(0, 2), st.integers(0, 9))
def test_inputs_that_are_solved_for(a: LFT, first: int, seed: int) -> None:
    at, solved = drawn(a, seed, 0.2), solved_for(sparse(a), 2, first)
    expected = evaluate_at(eliminate(a, 2), at)[:, [*range(first), 2]]
    roundoff(evaluate_at(solved, at), expected, KAPPA, float(np.max(np.abs(expected))) + 1.0)


@given(lfts(), st.integers(0, 9))
def test_units_and_blocks(a: LFT, seed: int) -> None:
    rows, columns = 2.0 ** np.arange(a.shape[0]), 0.5 ** np.arange(a.shape[1])
    named = in_units(sparse(a), ["a", "aa", "b", "c"], rows, columns)
    assert [block.name for block in named.blocks] == ["a", "aa", "b", "c"]
    assert dict(named.blocks) == dict.fromkeys(["a", "aa", "b", "c"], 0) | dict(a.blocks)
    at = drawn(named, seed)
    chosen = [k for k, block in enumerate(named.blocks) if block in a.blocks and block.name != "aa"]
    known = {named.blocks[k].name: k for k in chosen}
    expected = evaluate_at(a, at[:, [known[block.name] for block in a.blocks]])
    roundoff(evaluate_at(named, at), rows[:, None] * expected * columns, KAPPA, 1e8)


@given(sparse_lfts(), st.integers(0, 9))
def test_degrees(a: LFT, seed: int) -> None:
    with precision(BITS):
        of_dense, form = exactly(a), sparse(a)
    prime = of_dense.M.prime
    numerators = np.array(np.round(form.entry * 4), dtype=np.int64)
    residues = np.array([int(x) * pow(4, -1, prime) % prime for x in numerators], dtype=np.int64)
    whole = SparseResidues(form, residues, prime)
    assert sparse_degrees(whole, seed) == exact_degrees(of_dense, seed)
    E, _, solved = _at_random(whole, seed)  # ranks would not see a wrong pivot
    n = form.signals
    exact(multiplied(E[:n, :n].toarray(), solved, prime), E[:n, n:].toarray())


def of_fractions(M: list[list[Fraction]], prime: int) -> SparseResidues:
    """[K, B ; Y, D] with one input and one output."""
    row, column = np.nonzero(np.array(M))
    values = [M[i][j] for i, j in zip(row, column, strict=True)]
    none = np.full(len(row), ALWAYS)
    lft = SparseLFT(row, column, np.array(values, dtype=float), none, len(M) - 1, (1, 1), ())
    residues = [x.numerator * pow(x.denominator, -1, prime) % prime for x in values]
    return SparseResidues(lft, np.array(residues), prime)


def test_a_pivot_of_doubles_that_is_zero() -> None:
    """1 - 49 (1/49) is 1.1e-16 in doubles, larger than what is below it."""
    prime, small, one, none = 2**61 - 1, Fraction(1, 10**20), Fraction(1), Fraction(0)
    K = [[one / 49, one, one, one], [one, 49 * one, none, one], [none, small, small, one]]
    # s3 = 1 - 1/49, and small (s2 + s3) = 1
    s2 = 1 / small - 1 + one / 49
    value = -(1 - 49 * s2 + 2 * s2 + 3 * (1 - one / 49))
    found = value_at_random(of_fractions([*K, [one, 2 * one, 3 * one, none]], prime))
    exact(found, [[value.numerator * pow(value.denominator, -1, prime) % prime]])
    with says(WellPosednessError, "singular at all values", "determinant is zero in exact numbers"):
        value_at_random(of_fractions([*(row[:2] + row[3:] for row in K[:2]), [one, one, none]], prime))


def test_a_singular_point_has_no_value() -> None:
    a = LFT([[0.5]], [[1.0]], [[1.0]], [[0.0]], (Block("a", 1),))
    with says(WellPosednessError, "singular at one of the points"):
        evaluate_at(sparse(a), np.array([[2.0]]))


GOOD: dict[str, Any] = {
    "row": [0, 0, 0, 1],
    "column": [0, 0, 1, 0],
    "entry": [1.0, -0.5, -1.0, 1.0],
    "block": [-1, 0, 0, -1],
    "signals": 1,
    "shape": (1, 1),
    "blocks": (Block("a", 1),),
}


test_what_does_not_fit = refused(
    r"""
> SparseLFT(**{**GOOD, **{}}) => StructureError: sparse LFT …
dict(blocks=(Block("b", 1), Block("a", 0))) => sorted by name
dict(row=[0, 0, 0]) => one length
dict(row=[0, 0, 0, 2]) => outside of 0 to 1
dict(column=[0, 0, -1, 0]) => outside of 0 to 1
dict(block=[-1, 0, 1, -1]) => outside of -1 to 0
dict(entry=[1.0, np.nan, 1.0, 1.0]) => not finite
dict(block=[-1, 0, 0, 0]) => an output has one
dict(blocks=(Block("a", 0),)) => equations
dict(nonzero=np.ones((2, 1))) => nonzero needs shape
dict(block=[-1, 0, 1, -1], blocks=(Block("a", 1), Block("b", 1))) => two deltas
dict() => accepted
"""
)


@pytest.fixture(scope="module")
def both() -> Iterator[tuple[mbdlft.LFTModel, mbdlft.LFTModel]]:
    """A chain as a dense and as a sparse model."""
    scene = chain(3, spatial=True)
    dense = mbdlft.to_lft(scene, search=0.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mbdlft.pipeline.forms._MOST_EXACT", 10)
        yield dense, mbdlft.to_lft(scene, search=0.0)


def test_a_scene(both: tuple[mbdlft.LFTModel, mbdlft.LFTModel]) -> None:
    dense, model = both
    assert isinstance(model.lft, SparseLFT)
    c, d = model.certificate, dense.certificate
    assert (c.lower_bound, c.order_bound) == (d.lower_bound, d.order_bound)
    assert d.order_bound <= dense.order == model.order
    assert (c.well_posed, c.exact_bound, c.raw_order) == (d.well_posed, True, d.raw_order)
    values = {"m0": np.array([1.7, 2.3]), "t1": np.array([5.0, 70.0])}
    for ours, theirs in zip(matrices_at(model, values), matrices_at(dense, values), strict=True):
        target(ours, theirs, CHAIN)
        assert not ours[theirs == 0.0].any()
    for ours, theirs in zip(model.at(m2=1.9).A, dense.at(m2=1.9).A, strict=True):
        target(ours, theirs, CHAIN)
    for array in ("row", "column", "entry", "block"):
        exact(getattr(pickle.loads(pickle.dumps(model.lft)), array), getattr(model.lft, array))


@pytest.mark.parametrize("name", ["gimbal", "half_car", "two_link_arm"])
@pytest.mark.parametrize("most", [0, 5000], ids=["sums", "words"])
def test_scenarios(name: str, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gimbal loses digits in sparse factors; the feedthrough of the half car is zero."""
    scene = mbdlft.load_scene(Path(__file__).parents[2] / "scenarios" / f"{name}.toml")
    dense = mbdlft.to_lft(scene, search=0.0)
    monkeypatch.setattr("mbdlft.pipeline.forms._MOST_EXACT", 0)
    monkeypatch.setattr("mbdlft.pipeline.extract.noncommuting._MANY", most)  # items, before sums stay
    model = mbdlft.to_lft(scene, search=0.0)
    assert (model.order, model.certificate.lower_bound) == (dense.order, dense.certificate.lower_bound)
    assert model.certificate.rounding_ratio <= 10.0
    samples = mbdlft.random(model.parameters, 3, seed=1)
    for ours, theirs in zip(matrices_at(model, samples), matrices_at(dense, samples), strict=True):
        target(ours, theirs, CHAIN)
        assert not ours[theirs == 0.0].any()


def test_singular_equations_name_their_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what is singular in exact numbers only, and not in doubles: here, where x is solved for."""

    def of_singular(a: SparseResidues) -> NoReturn:
        entries = np.where(a.lft.row == 0, 0, a.entries)  # an equation without terms
        value_at_random(replace(a, entries=entries))
        raise AssertionError

    monkeypatch.setattr("mbdlft.pipeline.forms._MOST_EXACT", 0)
    monkeypatch.setattr("mbdlft.pipeline.forms.value_at_random", of_singular)
    with says(WellPosednessError, "scene 'chain': the equations are singular at all values"):
        mbdlft.to_lft(chain(2, spatial=False), search=0.0)


def test_what_needs_matrices_says_so(both: tuple[mbdlft.LFTModel, mbdlft.LFTModel]) -> None:
    model = both[1]
    for use in (
        lambda: model.D_zw,
        lambda: model + model,
        lambda: mbdlft.robust_stability(model),
        lambda: mbdlft.truncate(model, 1e-3),
        lambda: model.with_range(m0=(1.9, 2.1)),
    ):
        with says(StructureError, "stored as sparse equations", "give numbers to some"):
            use()


def test_archive(both: tuple[mbdlft.LFTModel, mbdlft.LFTModel], tmp_path: Path) -> None:
    model, file = both[1], tmp_path / "chain.h5"
    mbdlft.save(file, model)
    read = mbdlft.load(file)
    assert isinstance(read, mbdlft.LFTModel)
    assert read.certificate == model.certificate
    assert read.lft.blocks == model.lft.blocks
    for array in ("row", "column", "entry", "block"):
        exact(getattr(read.lft, array), getattr(model.lft, array))
    exec(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[3], names := {})
    at = np.linspace(-0.9, 0.9, len(model.parameters))
    (expected,) = evaluate_at(model.lft, at[None])
    roundoff(names["sparse_value"](file, "chain", at), expected, model.certificate.condition)
    with h5py.File(file, "r+") as whole:
        del whole["models/chain/sparse/row"]
    with says(ArchiveError, "is not whole", "sparse/row"):
        mbdlft.load(file)


@pytest.mark.long
def test_fifty_links_in_space() -> None:
    model = mbdlft.to_lft(chain(50, spatial=True), search=0.0)
    c = model.certificate
    assert model.order <= 11469
    assert c.order_bound == 7747
    assert c.well_posed == "proved"
    assert c.max_relative_error <= CHAIN
