"""Matrices for which doubles proved too much, or lost an entry: numbers that were found, copied in."""

import numpy as np
import pytest

import mbdlft
from mbdlft import Constant, Parameter, realize
from tests.close import CLOSED_FORM, target

# row 0 is the constant -150000: its numerator is -150000 times its denominator
_DENOMINATOR = (
    "(b*(a*(d*(c*((-63/2000)) + (-3/400)) + c*(3/1000)) + d*(c*(9/5) + 3/8) + c*(6/5)) "
    "+ a*(d*((-11/400)) + 1/400) + d*(1) + 1)"
)
CONSTANT = [
    "(b*(a*(d*(c*(4725) + 1125) + c*((-450))) + d*(c*((-270000)) + (-56250)) + c*((-180000))) "
    f"+ a*(d*(4125) + (-375)) + d*((-150000)) + (-150000))/{_DENOMINATOR}"
]
OTHER = [
    "(b*(a*(d*(c*((-231/400000000)) + (-27/80000000)) + c*(3/200000000)) + d*(c*(51/8000000)) "
    "+ c*(3/500000)) + a*(d*(c*((-7/400000000)) + (-9/20000000)) + c*(1/400000000)) "
    f"+ d*(c*(1/200000)) + c*(1/1000000))/{_DENOMINATOR}"
]
FOUR = [
    Parameter("a", -3.6, -18, 18),
    Parameter("b", 0.1098, -0.054, 0.18),
    Parameter("c", -0.36, -1.8, 1.8),
    Parameter("d", 0.162, 0.144, 0.18),
]


def test_pairs_that_rounding_makes_prove_nothing() -> None:
    """An LFT with one repetition of each exists, so no bound is above four."""
    for work in (1.0, 4.0):
        certificate = realize([CONSTANT, OTHER], FOUR, search=work).certificate
        assert certificate.order_bound <= 4
        assert certificate.lower_bound == (1, 1, 1, 1)
    plain = realize([["-150000"], OTHER], FOUR, search=2.0)
    assert plain.order == 4
    assert plain.certificate.minimal


# a product of two matrices whose coefficients have 18 digits: order 2 is enough
_OVER = "(1000000000000000000 + 148097000000000000*b - 406319000000000000*a + 178670437577000000*a*b)"
LONG = [
    [
        "(76481000000000000 + 194290724081000000*b + 327726628730000000*a "
        f"- 48303697709769078*a*b)/{_OVER}",
        "(727303000000000000 + 245589725137000000*b - 39390450518000000*a "
        f"+ 76905211491624577*a*b)/{_OVER}",
    ],
    [
        "(-377699000000000000 + 689792252709000000*b - 490716553271000000*a "
        f"+ 232488005407306081*a*b)/{_OVER}",
        "(460998000000000000 + 630239334629000000*b - 647154166374000000*a "
        f"+ 294962149951187309*a*b)/{_OVER}",
    ],
]
TWO = [Parameter("a", 0.3, 0.1, 0.5), Parameter("b", 0.2, 0.1, 0.4)]


def test_long_literals() -> None:
    assert mbdlft.exact_lower_bound(mbdlft.MatrixProblem(matrix=LONG, parameters=TWO)) == {"a": 1, "b": 1}
    certificate = realize(LONG, TWO, search=1.0).certificate
    assert certificate.order_bound == 2


# the drive train of a wind turbine: in entry (0, 1), terms of 1e11 and more cancel
TURBINE = [
    ["-ds/Jr", "(ds/(Jr*N)) + ks*(Jg+2) - 2*ks - Jg*ks", "-ks/Jr", "1/Jr", "0"],
    ["ds/(N*Jg)", "-ds/(N^2*Jg)", "ks/(N*Jg)", "0", "-1/Jg"],
    ["1", "-1/N", "0", "0", "0"],
    ["0", "1", "0", "0", "0"],
]
TRAIN = {"Jr": 4e7, "Jg": 534.0, "ks": 8.7e8, "ds": 6e6, "N": 97.0}


def law_turbine(names: tuple[str, ...], **other: float) -> None:
    """What is left of the entry is ds/(Jr N), 1.5e-3 beside terms of 4.6e11."""
    train = TRAIN | other
    parameters = [Parameter(name, train[name], percent=25) for name in names]
    constants = {name: Constant(value=x) for name, x in train.items() if name not in names}
    model = realize(TURBINE, parameters, constants=constants, states=3, search=0.0)
    at = mbdlft.random(model.parameters, 50, seed=1)
    found = mbdlft.matrices_at(model, at).A[:, 0, 1]
    known = train | at
    target(found * known["Jr"] * known["N"] / known["ds"], np.ones(50), CLOSED_FORM)
    assert model.certificate.max_relative_error <= CLOSED_FORM


@pytest.mark.parametrize("names", [("Jr",), ("Jr", "N"), ("Jr", "N", "ds"), ("Jr", "Jg")])
def test_an_entry_that_is_small_beside_its_terms_stays(names: tuple[str, ...]) -> None:
    law_turbine(names)
    law_turbine(names, Jg=534.1, ks=870123456.7)


def test_an_entry_that_doubles_do_not_carry_is_right_or_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where both factors are parameters, k J - J k cancels in the values only."""
    law_turbine(tuple(TRAIN))
    monkeypatch.setattr("mbdlft.matrix.relations.least_forms", lambda *_: ())
    law_turbine(tuple(TRAIN))  # as those terms are one function
    monkeypatch.setattr("mbdlft.pipeline.stages.without_dependent_channels", lambda *_: None)
    with pytest.raises(mbdlft.AnalysisError, match="differs from the matrix by"):
        law_turbine(tuple(TRAIN))


# a term that doubles take for rounding, in a model that is not the smallest before a search
NEAR = [[["a*b^2/(2+a*b) + 1e-13*c"]], [["a*b^2/(2+a*b+b)", "b/(3-a*b) + 1e-13*c^2"]]]
THREE = [Parameter("a", 0.2, -0.5, 0.6), Parameter("b", 0.15, -0.4, 0.5), Parameter("c", 0.1, -0.3, 0.7)]


def matrix_of_pairs(g: float) -> list[list[str]]:
    """g [L^2 0 0 ; 0 0 0] + m N(L) as in `test_joint_bound.known`: 5 are needed, and 4 for g = 0."""
    random = np.random.default_rng(0)
    numbers = random.uniform(0.5, 2.0, 9) * random.choice([-1, 1], 9)
    al, be, ga, de, ep, ze, et, ka, th = (f"({x!r})" for x in numbers.tolist())
    slope = f"m*({de} + {ep}*L)"
    return [
        [f"{g!r}*L^2 + m*({al} + {be}*L + {ga}*L^2)", slope, f"m*({ze} + {et}*L)"],
        [slope, f"{ka}*m", f"{th}*m"],
    ]


def test_what_is_small_is_not_left_out_by_a_search() -> None:
    """A search leaves out nothing that exact numbers prove to be there."""
    for rows in NEAR:
        plain, searched = (realize(rows, THREE, search=work).certificate for work in (0.0, 2.0))
        assert searched.lower_bound == plain.lower_bound
        assert searched.lower_bound[2] > 0
        assert all(n >= least for n, least in zip(searched.order, searched.lower_bound, strict=True))
    for size in (1.0, 1e-12, 1e-14):  # without its first term, 4 were enough
        parameters = [Parameter(name, 1.0, low=0.5, high=1.6) for name in "Lm"]
        model = realize(matrix_of_pairs(size), parameters, search=4.0)
        assert model.order == model.certificate.order_bound == 5
