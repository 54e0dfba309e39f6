"""Candidates of the search are compared with values, entry by entry, not with what is only rounding."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.lft.lft import LFT, Block, constant, delta, stack_rows
from mbdlft.order.search import Truth, is_same, part_of_largest
from mbdlft.order.work import Work
from mbdlft.pipeline import stages

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def with_row_that_cancels() -> LFT:
    """[d1 d2 ; 0], the zero as (d1 + 0.1)(d2 + 0.7) - d2 d1 - 0.7 d1 - 0.1 d2 - 0.07."""
    first, second = delta("d1"), delta("d2")
    product = (first + constant([[0.1]])) @ (second + constant([[0.7]]))
    rest = second @ first + constant([[0.7]]) @ first + constant([[0.1]]) @ second
    return stack_rows(first @ second, product - (rest + constant([[0.07]])))


def with_zero_row(value: float = 0.0, factor: float = 1.0) -> LFT:
    """[d1 d2 ; value] times a factor."""
    blocks = (Block("d1", 1), Block("d2", 1))
    M11, M12 = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    return LFT(M11, M12, factor * np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.0], [value]]), blocks)


def test_rounding_is_no_value() -> None:
    truth = Truth(with_row_that_cancels, part_of_largest)
    _, values, _ = truth.values
    assert 0.0 < np.max(np.abs(values[:, 1])) < 1e-15
    assert is_same(with_zero_row(), truth, Work())


@pytest.mark.parametrize(("value", "factor"), [(1e-12, 1.0), (0.0, 1.0 + 1e-10)])
def test_small_errors_are_found(value: float, factor: float) -> None:
    truth = Truth(with_row_that_cancels, part_of_largest)
    assert not is_same(with_zero_row(value, factor), truth, Work())


@pytest.mark.long
def test_closing_shows_what_cancels() -> None:
    """Repetitions that the relations need and the closed model does not; its bound is 8."""
    model = mbdlft.to_lft(mbdlft.load_scene(SCENARIOS / "four_bar.toml"))
    assert model.lft.order <= 10
    assert model.certificate.max_relative_error < 1e-12


def test_very_large_models_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mbdlft.load_scene(SCENARIOS / "two_link_arm.toml")
    assert mbdlft.to_lft(scene).order == 16
    monkeypatch.setattr(stages, "_MOST_SEARCHED", 16)
    assert mbdlft.to_lft(scene).order == 17
