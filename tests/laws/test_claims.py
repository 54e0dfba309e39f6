"""Any field of an analysis that is changed is refused, or what it claims is still true."""

from dataclasses import replace

import numpy as np
import pytest

from mbdlft import Bounds, MbdlftError, System, verify
from tests.claims import KINDS, analysis, changed, forged, is_true, misstated
from tests.seeds import some

DRAWS = 12
SLOW = ("slow powers", "slow gain", "parts of a gain")


@pytest.mark.parametrize("kind", some([kind for kind in KINDS if kind not in SLOW], SLOW))
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


def test_multipliers_of_a_system_with_a_pole_at_zero_prove_nothing() -> None:
    system, bounds = analysis("mixed")
    whole = system.lft.M22.copy()
    whole[0] = 0.0
    lft = replace(system.lft, M21=0.0 * system.lft.M21, M22=whole)
    other = System("integrator", lft, system.states, system.inputs, system.outputs, system.parameters)
    assert "not proved to be stable" in verify(other, bounds)


def is_accepted(system: System, bounds: Bounds) -> bool:
    try:
        return verify(system, bounds) == ""
    except MbdlftError:
        return False
