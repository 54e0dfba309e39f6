"""Numbers that are too near to zero for the bits that balls may have."""

import pytest

import mbdlft
from mbdlft import AnalysisError, MatrixProblem, Parameter, exact_lower_bound
from mbdlft.pipeline import forms

# sqrt(2) in 110 digits: balls of 320 bits cannot tell it from the root
ROOT = (
    "1.4142135623730950488016887242096980785696718753769480731766797379907324784621070388503875343276"
    "415727350138462"
)
NEAR = MatrixProblem(matrix=[[f"(sqrt(2) - {ROOT})*a"]], parameters=[Parameter("a", 0.5, 0.3, 0.8)])


def test_more_bits_tell_numbers_from_zero() -> None:
    assert exact_lower_bound(NEAR) == {"a": 1}


def test_numbers_that_cannot_be_told_from_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forms, "MOST_BITS", 320)
    message = (
        r"matrix 'matrix': numbers that are not zero cannot be told from zero in 320 bits\. .*"
        "make equal what is meant to be equal"
    )
    with pytest.raises(AnalysisError, match=message) as found:
        exact_lower_bound(NEAR)
    assert isinstance(found.value, mbdlft.MbdlftError)
