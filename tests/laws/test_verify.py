"""False claims with the proof of another one: each is refused by one check of the proof, and by it alone.

The worst case is believed here: `tests/laws/test_claims.py` changes all of an analysis.
"""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import mbdlft
from mbdlft.robust import proofs
from mbdlft.robust.evidence import one_over
from tests.reference.robust_cases import of_matrices


@pytest.fixture(autouse=True)
def _worst_cases_are_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proofs, "not_reached", lambda *_: "")


def unit(name: str) -> mbdlft.Parameter:
    return mbdlft.Parameter(name, 0.0, low=-1.0, high=1.0)


def lag(pole: str, names: str = "d", gain: str = "1") -> mbdlft.System:
    """xdot = pole x + u, y = gain x."""
    matrix = [[pole, "1"], [gain, "0"]]
    return mbdlft.realize(matrix, [unit(name) for name in names], states=1, inputs=["u"], outputs=["y"])


def error(pole: float, output: float) -> mbdlft.System:
    """xdot = pole x + w, z = output x, w = e z with a complex e."""
    A, C = np.array([[pole]]), np.array([[output]])
    return of_matrices(A, np.ones((1, 1)), C, np.zeros((1, 1)), mbdlft.ComplexBlock("e", 1))


def margin(pole: str, names: str = "d", **options: object) -> mbdlft.Bounds:
    return mbdlft.robust_stability(lag(pole, names), largest=10.0, work=1.0, **options)  # type: ignore[arg-type]


def false() -> Iterator[tuple[str, mbdlft.System, mbdlft.Bounds]]:
    """Why each is false, the system, and the claim with its proof."""
    half = margin("-1 + f/4 + g/4", "fg", fixed=["f"])
    yield "fixed ones have their whole ranges", lag("-1 + f/2 + g/4", "fg"), half
    stable, system = margin("-1 - d/2"), lag("-1 - d/2")
    yield "it is above what is reached", system, replace(stable, upper=0.5 * stable.lower)
    yield "no margin is negative", system, replace(stable, lower=-0.5)
    yield "the nominal model is unstable", lag("1 + d/2"), stable
    yield (
        "the nominal model with an error is unstable",
        error(1.0, -0.5),
        mbdlft.robust_stability(error(-1.0, 0.5)),
    )
    gain = mbdlft.worst_case_gain(system, gap=0.05)
    yield "no such kind", system, replace(stable, kind="robust beauty")
    yield "of a gain no block is fixed", system, replace(gain, fixed=("d",))
    yield "an infinite gain says nothing", system, replace(gain, upper=np.inf)
    yield "the gain is 2", system, replace(gain, lower=1.0, upper=1.3)
    real = mbdlft.worst_case(system, "real part")
    yield "the real part is -1/2", system, replace(real, lower=-1.0, upper=-0.9)
    weak = lag("-1 + d/100")
    performance = mbdlft.robust_performance(weak, gap=0.05)
    yield "the gain is 1 and not 1/5", weak, replace(performance, lower=5.0, upper=9.0)


def test_a_false_claim_is_refused_whatever_is_reached() -> None:
    for why, system, bounds in false():
        assert bounds.proof is not None, why
        assert mbdlft.verify(system, bounds), why


def test_one_over_a_bound_times_it_is_not_below_one() -> None:
    for bound in np.random.default_rng(0).uniform(0.1, 10.0, 200):
        assert Fraction(one_over(float(bound))) * Fraction(float(bound)) >= 1
