"""Errors of the algebra of LFTs and of the extraction: class and message."""

import casadi as ca
import numpy as np
import pytest

from mbdlft import LFT, NotRationalError, Parameter, StructureError, WellPosednessError
from mbdlft.lft.lft import (
    add,
    constant,
    delta,
    eliminate,
    fix,
    inverse,
    multiply,
    stack_columns,
    stack_rows,
    star,
)
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.problem.relations import LinearModel
from tests.errors.scenes import says
from tests.extracted import extracted as in_doubles

D, HALF = delta("mass"), np.array([[0.5]])


def lft(n=1, blocks=(("a", 1),), shapes=None, fill=0.0):
    shapes = {"M11": (n, n), "M12": (n, 3), "M21": (2, n), "M22": (2, 3), **(shapes or {})}
    return LFT(*(np.full(shape, fill) for shape in shapes.values()), blocks=blocks)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: lft(fill=np.nan), "LFT: M11 has an entry that is not finite."),
        (
            lambda: LFT([[0.0]], [[np.inf]], [[0.0]], [[0.0]], (("a", 1),)),
            "LFT: M12 has an entry that is not finite.",
        ),
        (lambda: lft(shapes={"M11": (1, 2)}), "LFT: M11 needs shape (1, 1), got (1, 2)."),
        (lambda: lft(shapes={"M12": (2, 3)}), "LFT: M12 needs shape (1, 3), got (2, 3)."),
        (lambda: lft(shapes={"M21": (3, 1)}), "LFT: M21 needs shape (2, 1), got (3, 1)."),
        (lambda: lft(2), "LFT: the sizes of the blocks add up to 1, M11 is 2 x 2."),
        (lambda: lft(blocks=()), "LFT: the sizes of the blocks add up to 0, M11 is 1 x 1."),
        (lambda: lft(1, (("a", -1), ("b", 2))), "LFT: a block has a negative size: "),
        (
            lambda: lft(2, (("b", 1), ("a", 1))),
            "LFT: blocks must be sorted by name, each name once; got b, a.",
        ),
        (
            lambda: lft(2, (("a", 1), ("a", 1))),
            "LFT: blocks must be sorted by name, each name once; got a, a.",
        ),
        (lambda: add(lft(), D), "LFT: cannot add shapes (2, 3) and (1, 1)."),
        (lambda: D - np.eye(2), "LFT: cannot add shapes (1, 1) and (2, 2)."),
        (lambda: multiply(lft(), D), "LFT: cannot multiply shapes (2, 3) and (1, 1)."),
        (lambda: np.eye(2) @ D, "LFT: cannot multiply shapes (2, 2) and (1, 1)."),
        (lambda: inverse(lft()), "LFT: cannot invert shape (2, 3)."),
        (lambda: stack_rows(lft(), D), "LFT: cannot stack shapes (2, 3) and (1, 1) as rows."),
        (lambda: stack_columns(lft(), D), "LFT: cannot stack shapes"),
        (lambda: star(D, D, 2, 0), "LFT: cannot close 2 signals between (1, 1) and (1, 1)."),
        (lambda: star(D, D, 0, -1), "LFT: cannot close -1 signals between (1, 1) and (1, 1)."),
        (lambda: fix(D, {"mas": 0.5}), "LFT: unknown delta 'mas'. Did you mean 'mass'?"),
        (lambda: evaluate(D, {"mas": 0.5}), "LFT: unknown delta 'mas'. Did you mean 'mass'?"),
        (lambda: evaluate(constant([[1.0]]), {"m": 0.5}), "unknown delta 'm'. Existing: none."),
        (
            lambda: evaluate(D @ delta("x"), {"mass": np.zeros(2), "x": np.zeros(3)}),
            "evaluate: the arrays of deltas have different lengths.",
        ),
        (lambda: evaluate_at(D, [0.5]), "LFT: points need shape (N, 1), got (1,)."),
        (lambda: evaluate_at(D, [[0.5, 0.5]]), "LFT: points need shape (N, 1), got (1, 2)."),
    ],
)
def test_structure(make, message):
    with says(StructureError, message):
        make()


@pytest.mark.parametrize(
    "make",
    [lambda: evaluate(D, {"mass": np.zeros((2, 2))}), lambda: D + np.zeros((1, 1, 1))],
    ids=["deltas of two dimensions", "matrix of three"],
)
def test_number_of_dimensions(make):
    with pytest.raises(StructureError, match=r"LFT|evaluate"):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: inverse(D), "the inverse of an LFT: the matrix is singular to working precision."),
        (
            lambda: inverse(constant([[1.0, 1.0], [1.0, 1.0 + 2.0**-52]])),
            "the inverse of an LFT: the matrix is singular to working precision.",
        ),
        (
            lambda: inverse(D @ D),
            "the inverse of an LFT: the matrix is singular to working precision.",
        ),
        (
            lambda: eliminate(constant([[1.0, 2.0, 0.0], [2.0, 4.0, 1.0]]), 2),
            "the relations to be solved: the matrix is singular to working precision.",
        ),
        (
            lambda: star(constant(np.diag([0.0, 1.0])), constant(np.diag([1.0, 0.0])), 1, 1),
            "the relations to be solved: the matrix is singular to working precision.",
        ),
        (
            lambda: fix(inverse(D + HALF), {"mass": -0.5}),
            "an LFT with fixed deltas: the matrix is singular to working precision.",
        ),
        (
            lambda: evaluate(inverse(D + HALF), {"mass": [0.0, -0.5]}),
            "I - M11 Delta is singular at one of the points.",
        ),
    ],
)
def test_well_posed(make, message):
    with says(WellPosednessError, message):
        make()


def test_well_posed_beside_the_singular_point():
    a = inverse(D + HALF)
    evaluate(a, {"mass": [0.0, -0.4]})
    fix(a, {"mass": -0.4})


P, X, Z = ca.SX.sym("p"), ca.SX.sym("x"), ca.SX.sym("z")


def extracted(residual: ca.SX) -> LFT:
    p = Parameter("ratio", 1.0, 0.5, 2.0)
    return in_doubles(LinearModel(residual, ca.SX(0, 1), X, Z, P, (p,)))


@pytest.mark.parametrize(
    ("residual", "error", "messages"),
    [
        (
            ca.exp(P) * X + Z,
            NotRationalError,
            [
                "OP_EXP at instruction 1 of 'relations' is not a rational operation (parameters: "
                "ratio; acts on a coefficient). Declare the whole function value as a parameter, or "
                "keep the equations implicit."
            ],
        ),
        (ca.fmin(P, 2) * X, NotRationalError, ["OP_FMIN at instruction", "parameters: ratio;"]),
        (ca.sqrt(2 * P) * X, NotRationalError, ["OP_SQRT at instruction", "parameters: ratio;"]),
        (
            ca.sin(X) + Z,
            NotRationalError,
            ["OP_SIN at instruction", "(parameters: none; acts on a signal)."],
        ),
        (
            X * Z,
            NotRationalError,
            ["two signals are multiplied, so the relations are not linear in them."],
        ),
        (X**2, NotRationalError, ["two signals are multiplied"]),
        (
            P / X,
            NotRationalError,
            ["a signal is a divisor, so the relations are not linear in the signals."],
        ),
        (
            X + P,
            NotRationalError,
            ["a signal and a coefficient are added, so the relations are not linear"],
        ),
        (Z - 3, NotRationalError, ["a signal and a coefficient are added"]),
        (
            P * P,
            StructureError,
            [
                "row 0 of the relations does not vanish with the signals: it is not linear in them. "
                "Linearize around an equilibrium first."
            ],
        ),
        (
            X / (P - 1) - Z,
            WellPosednessError,
            [
                "a denominator vanishes at the nominal values of the parameters, so there is no "
                "linear fractional form around them. Move the nominal values."
            ],
        ),
    ],
)
def test_extraction(residual, error, messages):
    with says(error, *messages):
        extracted(residual)


def test_extraction_of_a_rational_relation():
    extracted((P * P - 2) / (P + 3) * X - Z)
