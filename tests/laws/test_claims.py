"""Any field of an analysis that is changed is refused, or what it claims is still true."""

import numpy as np
import pytest

from mbdlft import Bounds, MbdlftError, System, verify
from tests.claims import KINDS, analysis, changed, forged, is_true, misstated

DRAWS = 24


@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_analysis_is_refused_or_true(kind: str) -> None:
    """Any one field, numbers of proofs too; and no claim with the proof or worst case of another."""
    system, bounds = analysis(kind)
    assert verify(system, bounds) == ""
    for what, other in (*forged(bounds), *misstated(system, bounds)):
        assert not is_accepted(system, other), what
    random, refused = np.random.default_rng(KINDS.index(kind)), 0
    for _ in range(DRAWS):
        other, what = changed(bounds, random)
        if is_accepted(system, other):
            assert is_true(system, other, bounds), f"{what}: {other.claim}"
        else:
            refused += 1
    assert refused > DRAWS // 3


def is_accepted(system: System, bounds: Bounds) -> bool:
    try:
        return verify(system, bounds) == ""
    except MbdlftError:
        return False
