"""The scaling benchmark at its smallest: verified rows, and exponents of what is known."""

import pytest

from benchmarks.scaling import SHAPES, expected, families, figure, measure, slope, table
from tests.close import conditioned


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("few", [True, False])
def test_rows_are_verified(shape: str, few: bool, tmp_path) -> None:  # type: ignore[no-untyped-def]
    rows = [measure(shape, count, few) for count in (3, 4)]
    assert len(families(rows)) == 1
    assert all(row["bound"] <= row["order"] <= row["raw"] for row in rows)
    assert all(row["parameters"] == (5 if few else 3 * row["bodies"]) for row in rows)
    assert table(rows).count("\n") > len(rows)
    if shape == "star" and few:
        figure(tmp_path / "figure.png", rows)


def test_slope_of_a_power() -> None:
    counts = [10, 20, 40]
    conditioned(slope(counts, [3.0 * n**2.5 for n in counts]), 2.5, 10.0)


def test_what_the_next_member_takes() -> None:
    family = [{"bodies": n, "seconds": 0.01 * n**3} for n in (10, 20)]
    conditioned(expected(family, 40), 640.0, 10.0)
    assert expected(family[:1], 40) == 0.0


def test_a_wrong_model_is_not_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: nothing is accurate enough."""
    monkeypatch.setattr("benchmarks.scaling._ACCEPTED", 0.0)
    with pytest.raises(SystemExit, match="error"):
        measure("star", 3, True)
