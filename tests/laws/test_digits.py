"""Laws of values that are computed in twice the working precision where doubles lose digits.

1. at corners of a model whose values lose digits in doubles, transfer functions have the error of the
   exact matrices, rounded to doubles
2. what is lost is told to a factor of ten
3. values of models that lose nothing, and of very many points, are those in doubles, bit by bit
"""

import numpy as np
import pytest

import mbdlft
from benchmarks import elastic_transfers
from benchmarks.cases.hub import hub
from benchmarks.elastic_transfers import Case, measured
from mbdlft.exact.rounding import equilibrate
from mbdlft.lft.sampling import evaluate_at
from mbdlft.system import sampled as evaluated
from mbdlft.system.sampled import lost, with_digits
from scenarios import two_link_arm

CASE = Case(1, 5, "E rho L")


def test_transfer_functions_at_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elastic_transfers, "OMEGA", np.array([0.1, 30.0, 1e4]))
    row = measured(CASE)
    assert row.error <= 10.0 * row.rounded
    monkeypatch.setattr(evaluated, "with_digits", lambda lft, points, values: values)
    assert measured(CASE).error > 100.0 * row.rounded  # or this test shows nothing


def test_what_is_lost_is_told() -> None:
    model = mbdlft.to_lft(hub(1, 4, ["L"]), search=0.0)
    lft, deltas = model.lft, np.full(model.order, -1.0)
    points = np.array([[-1.0]])
    (doubles,), (better,) = (evaluate_at(lft, points), with_digits(lft, points, evaluate_at(lft, points)))
    rows, columns = equilibrate(better[None])
    size = np.maximum(np.abs(better), evaluated._NEGLIGIBLE / np.outer(rows, columns))
    error = float(np.max(np.abs(doubles - better) / size))
    assert error > 10.0 * evaluated.LOST
    assert 0.1 * error <= lost(lft, deltas, better) <= 10.0 * error


def test_what_loses_nothing_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    model = mbdlft.to_lft(two_link_arm.scene(), search=0.0)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (20, len(model.lft.blocks)))
    values = evaluate_at(model.lft, points)
    assert with_digits(model.lft, points, values) is values
    elastic = mbdlft.to_lft(hub(1, 4, ["L"]), search=0.0).lft
    points = np.linspace(-1.0, 1.0, 20)[:, None]
    values = evaluate_at(elastic, points)
    assert np.any(with_digits(elastic, points, values) != values)
    monkeypatch.setattr(evaluated, "_MOST", 19.0 * elastic.order**3)
    assert with_digits(elastic, points, values) is values
