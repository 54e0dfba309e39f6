"""Upper bounds of mu against AB13MD of SLICOT, where slycot (GPL) is installed: the extra `slycot`."""

import numpy as np
import pytest

from mbdlft import Block, ComplexBlock, FullBlock
from mbdlft.robust.mu.multipliers import structure_of, upper_bound
from mbdlft.robust.mu.singular_value import channels_at
from tests.close import MU
from tests.reference.robust_cases import transport_aircraft

slycot = pytest.importorskip("slycot", reason="slycot is not installed: pip install '.[slycot]'")
MORE = 1e-3  # the part by which a bound may be above that of AB13MD


@pytest.mark.parametrize("omega", [0.0, 0.3, 0.62, 1.0, 3.0, 10.0])
def test_fourteen_parameters(omega: float) -> None:
    system = transport_aircraft()
    M = channels_at(system, omega)
    found = upper_bound(M, structure_of(system.lft.blocks)).beta
    other = float(slycot.ab13md(M, np.ones(14, int), np.ones(14, int))[0])
    assert found <= other * (1.0 + MORE)


@pytest.mark.parametrize("seed", range(8))
def test_mixed_blocks(seed: int) -> None:
    """AB13MD has no repeated blocks; both bounds are optima of the same problem."""
    random = np.random.default_rng(seed)
    kinds = random.integers(0, 3, 4)
    sizes = np.where(kinds == 2, random.integers(2, 4, 4), 1)
    makers = (Block, ComplexBlock, FullBlock)
    blocks = [makers[kind](f"b{k}", int(sizes[k])) for k, kind in enumerate(kinds)]
    n = int(np.sum(sizes))
    M = random.standard_normal((n, n)) + 1j * random.standard_normal((n, n))
    found = upper_bound(M, structure_of(blocks), tolerance=MU).beta
    other = float(slycot.ab13md(M, sizes.astype(int), np.where(kinds == 0, 1, 2))[0])
    assert abs(found / other - 1.0) <= MORE
